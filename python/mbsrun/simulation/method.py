"""Kinds of methods, and the formulations of the equations of motion that they evaluate."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mbsgen.roles import Order, name_kernel
from mbsrun import forms

if TYPE_CHECKING:  # these modules read formulations
    from mbsrun.limits import Allowance
    from mbsrun.simulation.drive import Piece
    from mbsrun.simulation.dynamics import Dynamics
    from mbsrun.simulation.motion import Chunk, Settings

Array = NDArray[np.float64]


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


class Family(Enum):
    """How the steps of a method are found."""

    EXPLICIT = "explicit, fixed step"
    IMPLICIT = "implicit, fixed step"
    ADAPTIVE = "adaptive"


# dynamics, a piece of the inputs, q and qd at its start, settings, what may be spent -> the steps through the piece.
# Raises HaltError, after yielding them, where a kernel, a state or a step fails, or the allowance is used up.
Integrator = Callable[["Dynamics", "Piece", Array, Array, "Settings", "Allowance"], Iterator["Chunk"]]


@dataclass(frozen=True)
class Method:
    """A way to integrate."""

    family: Family
    order: int | None  # None: varies
    title: str
    integrate: Integrator
    settings: tuple[str, ...]  # the names of the settings that matter to it
    stability: float | None = None  # explicit: how far along the negative real axis h lambda may lie
    takes_quaternions: bool = True
    needs_residual: bool = False  # of a formulation that has one: accelerations are not enough

    @property
    def has_fixed_steps(self) -> bool:
        """Return whether `Settings.step` is the length of a step."""
        return self.family is not Family.ADAPTIVE
