"""The linear solvers that IPOPT may use: MUMPS, which comes with it, and the project's own, csrc/kkt.

The systems of interior-point steps are sparse, symmetric and indefinite, and many have one pattern. They are small for
MUMPS, which spends most of its time on other things than arithmetic. The project's own solver is compiled once, as
kernels are. IPOPT loads it under the name of another solver, and passes structures of that solver's interface. Their
layout depends on IPOPT's version, so IPOPT is asked for its version first.
"""

from __future__ import annotations

import logging
import os
import re
import tempfile
from collections.abc import Mapping
from functools import cache
from pathlib import Path

from mbsgen import resources
from mbsrun.library import compile_library, find_compiler

OWN, MUMPS = "mbs", "mumps"
LINEAR_SOLVERS = (OWN, MUMPS)
_SOURCES = ("mbs_order.c", "mbs_partners.c", "mbs_plan.c", "mbs_front.c", "mbs_ldl.c", "mbs_ipopt.c")
_LOG = logging.getLogger("mbsrun")

Version = tuple[int, ...]

# IPOPT's hsl_ma97d.h changed once from 3.14.0 on, in 3.14.12, and kept its layout: a spare integer got a name.
FIRST: Version = (3, 14, 11)
LAST: Version = (3, 14, 19)

# MUMPS orders by AMD, and neither scales nor permutes: it is fastest so on the banded systems of collocation.
_MUMPS: Mapping[str, str | int] = {
    "linear_solver": "mumps",
    "mumps_pivot_order": 0,
    "mumps_scaling": 0,
    "mumps_permuting_scaling": 0,
}


def choose(name: str) -> str:
    """Return a solver of LINEAR_SOLVERS, or MUMPS in its place where IPOPT cannot load it; warn once of that."""
    return MUMPS if name == OWN and not _is_loadable() else name


def set_up(name: str) -> Mapping[str, str | int]:
    """Return the options of IPOPT for a solver of LINEAR_SOLVERS. Raises CompileError."""
    if choose(name) == MUMPS:
        return _MUMPS
    return {"linear_solver": "ma97", "hsllib": str(compile_own()), "ma97_order": "amd", "ma97_scaling": "none"}


@cache
def compile_own() -> Path:
    """Compile csrc/kkt to a library with the interface of mbs_ipopt.h. Raises CompileError."""
    return compile_library(resources.folder("csrc") / "kkt", "mbs_kkt", _SOURCES, find_compiler(os.environ))


def read_version() -> Version | None:
    """Return the version of CasADi's IPOPT, by its first words in a file; None if it writes none."""
    import casadi as ca

    x = ca.SX.sym("x")
    with tempfile.TemporaryDirectory() as folder:
        words = Path(folder) / "ipopt.txt"
        options: dict[str, str | int] = {"output_file": str(words), "file_print_level": 5, "max_iter": 0}
        options |= {"sb": "yes", "print_level": 0}
        ca.nlpsol("version", "ipopt", {"x": x, "f": x**2}, {"print_time": False, "ipopt": options})()
        told = words.read_text("utf-8", errors="replace") if words.exists() else ""
    found = re.search(r"Ipopt version (\d+(?:\.\d+)*)", told)
    return tuple(int(number) for number in found[1].split(".")) if found else None


@cache
def _is_loadable() -> bool:
    """Return whether IPOPT has a version that the project's solver is written for; warn if it has not."""
    version = read_version()
    if version is not None and FIRST <= version <= LAST:
        return True
    _LOG.warning(
        "CasADi's IPOPT has version %s, but the linear solver %s needs %s to %s, so %s replaces it",
        "unknown" if version is None else _write(version),
        OWN,
        _write(FIRST),
        _write(LAST),
        MUMPS.upper(),
    )
    return False


def _write(version: Version) -> str:
    return ".".join(map(str, version))
