"""A trial of a controller, as a value: the loop's clock, the plant's disturbances, and what is measured.

Times are in s from the start of the loop. `statement` reads a trial from a file and options.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from mbsgen.expressions import FLOATS, Expression, ExpressionError, evaluate
from mbsrun.simulation.motion import Settings

Array = NDArray[np.float64]

TIME = "t"  # the name of the loop's time in expressions


class Fallback(Enum):
    """The inputs of a sample at which the controller finds no plan."""

    PLAN = "plan"  # the last plan's for this time
    HOLD = "hold"  # the inputs of the period before
    STOP = "stop"  # none: the trial ends


@dataclass(frozen=True)
class Horizon:
    """A horizon that ends at a fixed time until it is as short as `least`, and then moves ahead."""

    end: float
    least: float

    def length(self, time: float) -> float:
        """Return the length of a plan that begins at a time."""
        return max(self.end - time, self.least)


@dataclass(frozen=True, eq=False)
class Noise:
    """Standard deviations of normal noise, drawn anew at each sample."""

    q: Array  # (nq,): of measured coordinates
    qd: Array  # (n,): of measured velocities
    u: Array  # (m + k,): of the inputs and controls that act, held over a period
    seed: int = 0


@dataclass(frozen=True)
class Kick:
    """A jump of velocities."""

    time: float
    velocities: tuple[tuple[int, float], ...]  # index into qd, change


@dataclass(frozen=True)
class Push:
    """An external wrench in a span of time: expressions in t for entries of w."""

    start: float
    end: float
    entries: tuple[tuple[int, Expression], ...]  # index into w


@dataclass(frozen=True)
class Measure:
    """An expression of the time and the state that is recorded, and may have to stay below a limit."""

    name: str
    expression: Expression
    start: float = 0.0
    end: float = math.inf
    most: float | None = None


@dataclass(frozen=True, eq=False)
class Trial:
    """A closed loop to run."""

    name: str
    duration: float
    period: float  # of the samples
    start_q: Array  # (nq,): of the plant
    start_qd: Array  # (n,)
    noise: Noise
    integration: Settings  # of the plant, for one period: its duration is not used
    constants: Mapping[str, float] = field(default_factory=dict)  # of expressions: the problem's, and the trial's
    updates: Mapping[str, Expression] = field(default_factory=dict)  # of the problem's constants, over the time t
    states: tuple[str, ...] = ()  # that the problem adds
    start_states: Array = field(default_factory=lambda: np.zeros(0))  # (ns,): of the plant
    controls: tuple[str, ...] = ()  # that the problem adds
    delay: int = 0  # periods from a measurement to the inputs that follow from it
    predicts: bool = True  # the controller plans from the state that it predicts for the end of the delay
    fallback: Fallback = Fallback.PLAN
    horizon: Horizon | None = None  # None: it has the problem's length, and moves ahead
    kicks: tuple[Kick, ...] = ()
    pushes: tuple[Push, ...] = ()
    measures: tuple[Measure, ...] = ()
    # by how much a bound (by its quantity) or a constraint (by its expression) may be violated
    leeway: Mapping[str, float] = field(default_factory=dict)
    references: Mapping[str, Expression] = field(default_factory=dict)  # by quantity of the state, for plots

    @property
    def samples(self) -> int:
        """Count the samples."""
        return max(1, math.ceil(self.duration / self.period * (1 - 1e-12)))

    def constants_at(self, time: float) -> dict[str, float]:
        """Return the problem's constants that the loop changes, at a time. Raises ExpressionError without a value."""
        return {name: self.evaluate(f"updates.{name}", expression, time) for name, expression in self.updates.items()}

    def evaluate(self, place: str, expression: Expression, time: float) -> float:
        """Evaluate an expression at a time. Raises ExpressionError, with the place, where it has no value."""
        try:
            return evaluate(expression, {**self.constants, TIME: time}, FLOATS)
        except ExpressionError as error:
            finding = f"{place}: {error.finding} at t = {time:.6g} s"
            raise ExpressionError(finding, error.remedy) from None
