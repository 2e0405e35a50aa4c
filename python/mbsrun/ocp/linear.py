"""The linear solvers that IPOPT may use: MUMPS, which comes with it, and the project's own, csrc/kkt.

The systems of interior-point steps are sparse, symmetric and indefinite, and many have one pattern. They are small for
MUMPS, which spends most of its time on other things than arithmetic. The project's own solver is compiled once, as
kernels are; IPOPT loads it.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from functools import cache
from pathlib import Path

from mbsgen import resources
from mbsrun.library import compile_library, find_compiler

OWN, MUMPS = "mbs", "mumps"
LINEAR_SOLVERS = (OWN, MUMPS)
_SOURCES = ("mbs_order.c", "mbs_partners.c", "mbs_plan.c", "mbs_front.c", "mbs_ldl.c", "mbs_ipopt.c")

# MUMPS orders by AMD, and neither scales nor permutes: it is fastest so on the banded systems of collocation.
_MUMPS: Mapping[str, str | int] = {
    "linear_solver": "mumps",
    "mumps_pivot_order": 0,
    "mumps_scaling": 0,
    "mumps_permuting_scaling": 0,
}


def set_up(name: str) -> Mapping[str, str | int]:
    """Return the options of IPOPT for a solver of LINEAR_SOLVERS. Raises CompileError."""
    if name == MUMPS:
        return _MUMPS
    return {"linear_solver": "ma97", "hsllib": str(compile_own()), "ma97_order": "amd", "ma97_scaling": "none"}


@cache
def compile_own() -> Path:
    """Compile csrc/kkt to a library with the interface of mbs_ipopt.h. Raises CompileError."""
    return compile_library(resources.folder("csrc") / "kkt", "mbs_kkt", _SOURCES, find_compiler(os.environ))
