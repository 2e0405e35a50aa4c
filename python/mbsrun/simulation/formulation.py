"""The formulations of the equations of motion, as a simulation evaluates them."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from mbsgen.roles import Order, name_kernel
from mbsrun import forms


@dataclass(frozen=True)
class Evaluated:
    """The kernels that a formulation evaluates."""

    function: str  # accelerations, or a residual that is linear in them
    mass: str | None  # the kernel with the mass matrix among its results; None where `function` returns accelerations

    @property
    def is_direct(self) -> bool:
        """Return whether the kernel returns accelerations."""
        return self.mass is None


class Formulation(Enum):
    """The form in which the equations of motion are evaluated."""

    IMPL = forms.IMPL.function  # residual; for accelerations solved with its Jacobian by qdd
    SEMI = forms.SEMI.function  # mass matrix and bias
    EXP1 = forms.EXP1.function  # accelerations, by elimination in the mass matrix
    EXP2 = forms.EXP2.function  # accelerations, by articulated bodies

    @property
    def evaluated(self) -> Evaluated:
        """Return the kernels of the form."""
        form = next(form for form in forms.FORMS if form.function == self.value)
        if form.is_direct:
            return Evaluated(form.function, None)
        has_matrix = form.function != form.residual
        mass = form.function if has_matrix else name_kernel(form.function, Order.JACOBIAN)
        return Evaluated(form.differentiated, mass)
