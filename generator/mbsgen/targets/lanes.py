"""Many states in C by the widest vectors of the processor that the program runs on.

The library holds each kernel for one state and, by CMake, for 2, 4 and 8 at once. A function for each kernel chooses.
"""

from __future__ import annotations

from collections.abc import Mapping

from mbsgen import resources
from mbsgen.targets.c.symbols import write_own
from mbsgen.targets.contract import faces, name_symbol
from mbsgen.targets.layout import lay_out
from mbsgen.targets.unit import Unit

LOOP = ("mbs_many.h", "mbs_many.c")  # in csrc
WIDTHS = (2, 4, 8)
_INTEGER = "casadi_int"  # the integers of kernels that the loop calls


def write_lanes(unit: Unit) -> Mapping[str, str]:
    """Write the functions that choose, and the loop over states, path -> text."""
    found = [face for family in unit.families if family.integer == _INTEGER for face in faces(family, unit.prefix)]
    common = {"prefix": unit.prefix, "own": unit.own, "version": unit.version, "faces": found, "widths": WIDTHS}
    symbols = {face.kernel: write_own(name_symbol(unit.own, face.family, face.tape), unit.own) for face in found}
    header, loop = ((resources.folder("csrc") / name).read_text(encoding="utf-8") for name in LOOP)
    return {
        name_header(unit.prefix): lay_out("c/many.h", **common),
        f"{unit.prefix}_many.c": lay_out("c/many.c", symbols=symbols, **common),
        f"{unit.prefix}_loops.h": lay_out("c/loops.h", **common),
        LOOP[0]: header,
        LOOP[1]: f'#include "{unit.prefix}_loops.h"\n{loop}',
    }


def list_lane_headers(prefix: str) -> tuple[str, ...]:
    """List the headers that are installed beside the model's."""
    return (name_header(prefix), LOOP[0])


def name_header(prefix: str) -> str:
    """Name the header of a model's functions for many states."""
    return f"{prefix}_many.h"
