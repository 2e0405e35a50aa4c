"""A program and the kernels that it applies; each backend makes its functions when they are first asked for."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

from mbsrun.ocp.evaluation.backends import numpy
from mbsrun.ocp.ground.plant import Plant
from mbsrun.ocp.ground.program import Program

if TYPE_CHECKING:
    from mbsrun.ocp.evaluation.backends import casadi


@dataclass(frozen=True)
class Prepared:
    """A program, ready to be evaluated."""

    data: Program
    plant: Plant
    others: tuple[Plant, ...] = ()  # of blocks whose plant is not 0, from 1 on

    @cached_property
    def casadi(self) -> casadi.Functions:
        """The functions for CasADi's solvers."""
        from mbsrun.ocp.evaluation.backends import condensation  # loads CasADi

        return condensation.build(self.data, self.plant, self.others)

    @cached_property
    def numpy(self) -> numpy.Functions:
        """The functions for methods in NumPy."""
        return numpy.build(self.data, self.plant, self.others)
