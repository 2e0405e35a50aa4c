"""mbsrun: compile, load and call generated kernels; solve optimal control problems with them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from mbsrun.controllers.loading import Controller, controller
from mbsrun.external import Mechanism, load

if TYPE_CHECKING:
    from mbsrun.ocp.checks import ProblemError
    from mbsrun.optimal.control import OptimalControl, problem, read_problem

__all__ = ["Controller", "Mechanism", "OptimalControl", "ProblemError", "controller", "load", "problem", "read_problem"]


def __getattr__(name: str) -> Any:
    """Import optimal control at its first use: it takes SciPy, which kernels do without."""
    if name in ("OptimalControl", "problem", "read_problem"):
        from mbsrun.optimal import control

        return getattr(control, name)
    if name == "ProblemError":
        from mbsrun.ocp.checks import ProblemError

        return ProblemError
    raise AttributeError(f"module {__name__} has no attribute {name}")
