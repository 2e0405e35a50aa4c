"""The methods of integration, and the formulations that they work on, by the names that a user says."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from types import MappingProxyType

from mbsrun import forms
from mbsrun.forms import Form


class Formulation(Enum):
    """The form in which the equations of motion are evaluated."""

    IMPL = forms.IMPL.function  # residual; for accelerations solved with its Jacobian by qdd
    SEMI = forms.SEMI.function  # mass matrix and bias
    EXP1 = forms.EXP1.function  # accelerations, by elimination in the mass matrix
    EXP2 = forms.EXP2.function  # accelerations, by articulated bodies

    @property
    def form(self) -> Form:
        """Return the functions of the form."""
        return next(form for form in forms.FORMS if form.function == self.value)


class Family(Enum):
    """Who takes the steps."""

    EXPLICIT = "explicit, fixed step"
    IMPLICIT = "implicit, fixed step"
    ADAPTIVE = "adaptive"


@dataclass(frozen=True)
class Method:
    """A way to integrate."""

    family: Family
    order: int | None  # None: varies
    title: str
    stability: float | None = None  # explicit: how far along the negative real axis h lambda may lie


SYMPLECTIC = "symplectic-euler"

METHODS: Mapping[str, Method] = MappingProxyType(
    {
        "euler": Method(Family.EXPLICIT, 1, "explicit Euler", 2.0),
        SYMPLECTIC: Method(Family.IMPLICIT, 1, "symplectic Euler in coordinates and momenta"),
        "rk4": Method(Family.EXPLICIT, 4, "the classical Runge-Kutta method", 2.785),
        "dop853": Method(Family.ADAPTIVE, 8, "explicit Runge-Kutta of Dormand and Prince", 6.1),
        "rk45": Method(Family.ADAPTIVE, 5, "explicit Runge-Kutta of Dormand and Prince", 3.3),
        "lsoda": Method(Family.ADAPTIVE, None, "Adams or BDF, as the stiffness asks for"),
        "radau": Method(Family.ADAPTIVE, 5, "implicit Runge-Kutta, three Radau IIA stages"),
        "bdf": Method(Family.ADAPTIVE, None, "backward differentiation formulas"),
        "generalized-alpha": Method(Family.IMPLICIT, 2, "generalised alpha of Chung and Hulbert"),
        "radau-iia": Method(Family.IMPLICIT, None, "Radau collocation: order 2 stages - 1; 1 stage is implicit Euler"),
        "gauss": Method(
            Family.IMPLICIT, None, "Gauss collocation: order 2 stages; 1 stage is the implicit midpoint rule"
        ),
    }
)


def choose_formulation(method: str, formulation: Formulation) -> Formulation:
    """Return what a method evaluates: symplectic Euler needs the mass matrix, and so a residual."""
    return Formulation.IMPL if method == SYMPLECTIC and formulation.form.is_direct else formulation
