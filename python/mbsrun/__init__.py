"""mbsrun: compile, load and call generated kernels; solve optimal control problems with them."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mbsrun.controllers.loading import Controller, controller
    from mbsrun.external import Mechanism, load
    from mbsrun.identification.excitation import excite
    from mbsrun.identification.identify import identify
    from mbsrun.motions import Motions, simulate_many
    from mbsrun.ocp.statement.checks import ProblemError
    from mbsrun.optimal.control import OptimalControl, problem, read_problem
    from mbsrun.optimal.simulation import Simulated, simulate
    from mbsrun.rollouts import rollout

__all__ = [
    "Controller",
    "Mechanism",
    "Motions",
    "OptimalControl",
    "ProblemError",
    "Simulated",
    "controller",
    "excite",
    "identify",
    "load",
    "problem",
    "read_problem",
    "rollout",
    "simulate",
    "simulate_many",
]

_MODULES = {
    **dict.fromkeys(("Controller", "controller"), "controllers.loading"),
    **dict.fromkeys(("Mechanism", "load"), "external"),
    "ProblemError": "ocp.statement.checks",
    "excite": "identification.excitation",
    "identify": "identification.identify",
    **dict.fromkeys(("OptimalControl", "problem", "read_problem"), "optimal.control"),
    **dict.fromkeys(("Motions", "simulate_many"), "motions"),
    **dict.fromkeys(("Simulated", "simulate"), "optimal.simulation"),
    "rollout": "rollouts",
}


def __getattr__(name: str) -> Any:
    """Import what is used, at its first use: NumPy for kernels, SciPy and CasADi for optimal control."""
    if name not in _MODULES:
        raise AttributeError(f"module {__name__} has no attribute {name}")
    found = globals()[name] = getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)
    return found


def __dir__() -> list[str]:
    """List the names that modules give at their first use, too."""
    return sorted({*globals(), *__all__})
