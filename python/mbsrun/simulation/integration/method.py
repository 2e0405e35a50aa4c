"""Methods of integration: their kinds and their properties."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from mbsrun.limits import Allowance
from mbsrun.simulation.drive import Piece
from mbsrun.simulation.dynamics import Dynamics
from mbsrun.simulation.motion import Chunk, Keeping, Settings

Array = NDArray[np.float64]


class Family(Enum):
    """How the steps of a method are found."""

    EXPLICIT = "explicit, fixed step"
    IMPLICIT = "implicit, fixed step"
    ADAPTIVE = "adaptive"


# dynamics, a piece of the inputs, q and qd at its start, settings, what may be spent -> the steps through the piece.
# Raises HaltError, after yielding them, where a kernel, a state or a step fails, or the allowance is used up.
Integrator = Callable[[Dynamics, Piece, Array, Array, Settings, Allowance], Iterator[Chunk]]


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
    closed: Integrator | None = None  # how it steps with loops or driven joints; None: it does not
    keeps: tuple[Keeping, ...] = ()  # the ways in which it keeps loops closed; the first is the default
    strikes: bool = False  # it takes rigid contacts, and spreads impulses over its steps

    @property
    def has_fixed_steps(self) -> bool:
        """Return whether `Settings.step` is the length of a step."""
        return self.family is not Family.ADAPTIVE
