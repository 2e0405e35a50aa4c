"""The methods of integration, by the names that a user says. To add one, write how it steps, and an entry here."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

from mbsrun.ocp import schemes
from mbsrun.simulation import adaptive, explicit, implicit
from mbsrun.simulation.formulation import Formulation
from mbsrun.simulation.method import Family, Integrator, Method
from mbsrun.simulation.motion import Settings

__all__ = ["METHODS", "Family", "Formulation", "Method", "choose_formulation", "takes_too_many_steps"]

_STEP, _TOLERANCES = ("step",), ("rtol", "atol")


def _explicit(order: int, title: str, tableau: explicit.Tableau, stability: float) -> Method:
    return Method(Family.EXPLICIT, order, title, partial(explicit.integrate, tableau), _STEP, stability)


def _adaptive(order: int | None, title: str, stepper: adaptive.Stepper, stability: float | None = None) -> Method:
    return Method(Family.ADAPTIVE, order, title, partial(adaptive.integrate, stepper), _TOLERANCES, stability)


def _implicit(make: implicit.Make) -> Integrator:
    return partial(implicit.integrate, make)


METHODS: Mapping[str, Method] = {
    "euler": _explicit(1, "explicit Euler", explicit.EULER, 2.0),
    "symplectic-euler": Method(
        Family.IMPLICIT,
        1,
        "symplectic Euler in coordinates and momenta",
        _implicit(implicit.make_symplectic),
        _STEP,
        takes_quaternions=False,
        needs_residual=True,
    ),
    "rk4": _explicit(4, "the classical Runge-Kutta method", explicit.RK4, 2.785),
    "dop853": _adaptive(8, "explicit Runge-Kutta of Dormand and Prince", adaptive.DOP853, 6.1),
    "rk45": _adaptive(5, "explicit Runge-Kutta of Dormand and Prince", adaptive.RK45, 3.3),
    "lsoda": _adaptive(None, "Adams or BDF, as the stiffness asks for", adaptive.LSODA),
    "radau": _adaptive(5, "implicit Runge-Kutta, three Radau IIA stages", adaptive.RADAU),
    "bdf": _adaptive(None, "backward differentiation formulas", adaptive.BDF),
    "generalized-alpha": Method(
        Family.IMPLICIT,
        2,
        "generalised alpha of Chung and Hulbert",
        _implicit(implicit.make_alpha),
        (*_STEP, "rho"),
    ),
    "radau-iia": Method(
        Family.IMPLICIT,
        None,
        "Radau collocation: order 2 stages - 1; 1 stage is implicit Euler",
        _implicit(partial(implicit.make_collocation, schemes.Family.RADAU)),
        (*_STEP, "stages"),
    ),
    "gauss": Method(
        Family.IMPLICIT,
        None,
        "Gauss collocation: order 2 stages; 1 stage is the implicit midpoint rule",
        _implicit(partial(implicit.make_collocation, schemes.Family.LEGENDRE)),
        (*_STEP, "stages"),
    ),
}


def choose_formulation(method: str, formulation: Formulation) -> Formulation:
    """Return the formulation that a method evaluates: the residual, where it needs one and is given accelerations."""
    lacks_residual = METHODS[method].needs_residual and formulation.evaluated.is_direct
    return Formulation.IMPL if lacks_residual else formulation


def takes_too_many_steps(settings: Settings) -> bool:
    """Return whether a method with a fixed step cannot reach the end within `max_steps`."""
    is_fixed = METHODS[settings.method].has_fixed_steps
    return is_fixed and settings.duration / settings.step > settings.max_steps * (1 + 1e-12)  # to rounding
