"""The six representations of the equations of motion as constraints, in one table.

Docquier, Bruls, Fisette, section 3.3. With accelerations z at the collocation points,

    residual         Phi(q, qd, z) - Q(q, qd, u) = 0          IMPL; SEMI: M(q) z + c(q, qd) - Q(q, qd, u) = 0
    ODE              d/dt qd = gamma(q, qd, u)                EXP1-O, EXP2-O: accelerations are no variables
    algebraic        d/dt qd = z,  z - gamma(q, qd, u) = 0    EXP1-A, EXP2-A

Closed loops take one of two ways: see `Loops`. With multipliers, a residual reads them too. In the reduced form, the
kernels take and give the velocities yd and accelerations ydd of the independent coordinates.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from types import MappingProxyType

from mbsrun import forms
from mbsrun.forms import Form
from mbsrun.ocp.ground.functions import KernelResult


class Loops(Enum):
    """How a motion with closed loops becomes variables."""

    MULTIPLIERS = "multipliers"  # all coordinates and velocities are states; loop forces are found with them
    REDUCED = "reduced"  # the independent ones are states; the loops give the other coordinates


REDUCED = "_red"  # ends the names of the kernels of the reduced form


@dataclass(frozen=True)
class Equations:
    """How the equations of motion are written."""

    form: Form
    has_accelerations: bool  # accelerations at the collocation points are variables

    @property
    def kernel(self) -> str:
        """Name the kernel."""
        return self.form.differentiated

    @property
    def is_explicit(self) -> bool:
        """Return whether the kernel returns accelerations; else it returns a residual that reads them."""
        return self.form.is_direct

    def write(self, loops: Loops | None = None) -> KernelResult:
        """Return the kernel's result as a program applies it; `loops` is None where there are none."""
        if loops is Loops.REDUCED:
            inputs = ("q", "yd", "u") if self.is_explicit else ("q", "yd", "ydd", "u")
            return KernelResult(self.kernel + REDUCED, inputs, "ydd" if self.is_explicit else "Phi")
        if self.is_explicit:
            return KernelResult(self.kernel, ("q", "qd", "u"), "qdd")
        multipliers = () if loops is None else ("lam",)
        return KernelResult(self.kernel, ("q", "qd", "qdd", *multipliers, "u"), "Phi")


class Representation(Enum):
    """The name of a representation: a formulation, and O for an ODE or A for algebraic accelerations."""

    IMPL = "IMPL"
    SEMI = "SEMI"
    EXP1_O = "EXP1-O"
    EXP1_A = "EXP1-A"
    EXP2_O = "EXP2-O"
    EXP2_A = "EXP2-A"

    @property
    def equations(self) -> Equations:
        """Return the entry of the table."""
        return REPRESENTATIONS[self]

    @property
    def kernel(self) -> str:
        """Name the kernel."""
        return self.equations.kernel

    @property
    def is_explicit(self) -> bool:
        """Return whether the kernel returns accelerations, not a residual."""
        return self.equations.is_explicit

    @property
    def is_ode(self) -> bool:
        """Return whether accelerations are no variables."""
        return not self.equations.has_accelerations

    @property
    def as_ode(self) -> Representation | None:
        """Return the representation by the same kernel that has no accelerations as variables, if there is one."""
        same = (other for other in REPRESENTATIONS if other.kernel == self.kernel and other.is_ode)
        return next(same, None)


REPRESENTATIONS: Mapping[Representation, Equations] = MappingProxyType(
    {
        Representation.IMPL: Equations(forms.IMPL, has_accelerations=True),
        Representation.SEMI: Equations(forms.SEMI, has_accelerations=True),
        Representation.EXP1_O: Equations(forms.EXP1, has_accelerations=False),
        Representation.EXP1_A: Equations(forms.EXP1, has_accelerations=True),
        Representation.EXP2_O: Equations(forms.EXP2, has_accelerations=False),
        Representation.EXP2_A: Equations(forms.EXP2, has_accelerations=True),
    }
)
