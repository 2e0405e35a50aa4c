"""A controller as the closed loop calls it.

    prepare(time, constants)    move the kept plan to the time at which the next one begins
    feedback(q, qd)             plan from a state: inputs from that time on, and a status

`planned` reads inputs off the kept plan, for samples at which no new one was found. A controller holds its plan between
samples; the loop knows no solver. A controller of a problem that adds states, delays or bounds on rates has two more
methods: see `Remembering`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Decision:
    """The result of one sample."""

    # (m + k,), inputs and controls, for the period that begins at the time that was prepared; kept ones where nothing
    # was found. Inputs that expressions of the problem give have any number.
    inputs: Array
    status: str  # the solver's word
    is_solved: bool
    iterations: int
    seconds: float  # of processor time, from the state to the inputs: other programs do not lengthen it
    violation: float  # of the plan's constraints, the largest; in real time before the last step. NaN: unknown
    is_rescue: bool = False  # a solve in place of steps in real time, which went wrong


class Controller(Protocol):
    """A model predictive controller: n_q coordinates, n velocities, m inputs, k controls that the problem adds."""

    def prepare(self, time: float, constants: Mapping[str, float]) -> None:
        """Move the plan to begin at `time` [s], with values of the problem's constants."""

    def feedback(self, q: Array, qd: Array) -> Decision:
        """Plan from a state at the prepared time."""

    def planned(self, time: float) -> Array:
        """Return inputs and controls (m + k,) of the kept plan for the period from a time on; later its last."""


@runtime_checkable
class Remembering(Controller, Protocol):
    """A controller whose plans depend on more than the mechanism's state."""

    def measure(self, states: Array) -> None:
        """Take the states that the problem adds, (ns,), before the feedback of a sample."""

    def note(self, time: float, inputs: Array) -> None:
        """Take note of the inputs and controls (m + k,) that are given for the period from a time on."""
