"""Figures of a track: what was measured, how near bounds and constraints came, and how long the controller took."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mbsgen.expressions import Expression, evaluate, names, parse
from mbsrun.external import Mechanism
from mbsrun.ocp.problem.problem import Problem, Range
from mbsrun.ocp.solving.margins import find_tolerated
from mbsrun.quantities import list_quantities, name_quantities
from mbsrun.simulation.drive import ARRAYS, STATE, measure
from mbsrun.tracking.loop import Track
from mbsrun.tracking.trial import TIME

Array = NDArray[np.float64]

TAIL = 99.9  # the percentile of computing times that is reported


@dataclass(frozen=True, eq=False)
class Measured:
    """A measure over its span of time."""

    name: str
    t: Array  # (K,)
    values: Array  # (K,)
    most: float | None

    @property
    def largest(self) -> float:
        """Return the largest value; NaN where the track ended before."""
        return float(self.values.max()) if self.values.size else math.nan

    @property
    def rms(self) -> float:
        """Return the root of the mean square."""
        return float(np.sqrt(np.mean(self.values**2))) if self.values.size else math.nan

    @property
    def is_met(self) -> bool:
        """Return whether every value is known, and small enough."""
        return self.most is None or self.largest <= self.most


@dataclass(frozen=True, eq=False)
class Margin:
    """The distance of a quantity from the nearer end of its range; negative where it left the range."""

    name: str
    t: Array  # (K,)
    values: Array  # (K,)
    is_bound: bool  # of a coordinate, a velocity or an input; else a constraint along the path
    tolerated: float  # the violation from which on it counts
    numbers: Array  # (K,): of the quantity
    range: Range

    @property
    def least(self) -> float:
        """Return the least distance."""
        return float(self.values.min())

    @property
    def time(self) -> float:
        """Return the time of the least distance."""
        return float(self.t[self.values.argmin()])

    @property
    def worst(self) -> tuple[float, float]:
        """Return the number at the least distance, and the limit that is near."""
        number = float(self.numbers[self.values.argmin()])
        return number, min(self.range, key=lambda limit: abs(number - limit))

    @property
    def is_kept(self) -> bool:
        """Return whether a violation, if there is one, is tolerated."""
        return self.least >= -self.tolerated


@dataclass(frozen=True)
class Times:
    """Computing times [s], of the processor."""

    median: float
    tail: float  # the 99.9th percentile
    largest: float

    @staticmethod
    def of(seconds: Sequence[float]) -> Times:
        """Summarise the times of at least one sample."""
        return Times(*np.percentile(np.array(seconds), [50, TAIL, 100]).tolist())


def measure_track(found: Track, plant: Mechanism) -> list[Measured]:
    """Evaluate the measures of a trial along the true motion."""
    measured = []
    for x in found.trial.measures:
        inside = (found.t >= x.start) & (found.t <= x.end)
        values = _evaluate([x.expression], found, plant)[0]
        measured.append(Measured(x.name, found.t[inside], values[inside], x.most))
    return measured


def follow_references(found: Track) -> Mapping[str, Array]:
    """Evaluate the references at the times of the motion, (K,) each, by the quantity that has one."""
    known = _list_constants(found)
    shape = found.t.shape
    return {
        name: np.broadcast_to(evaluate(expression, known, ARRAYS), shape)
        for name, expression in found.trial.references.items()
    }


def read_quantities(wanted: Sequence[str], found: Track, plant: Mechanism) -> list[Array]:
    """Return quantities of the state along the motion, (K,) each."""
    quantities = list_quantities(plant.manifest)
    values = measure({name: quantities[name] for name in wanted}, plant, found.q, found.qd)
    return [values[name] for name in wanted]


def find_margins(found: Track, problem: Problem, plant: Mechanism) -> tuple[list[Margin], list[str]]:
    """Return the margins of bounds and of constraints along the path, and the constraints that have none here.

    The time t of a constraint counts from the start of a plan, so that it is 0 along the motion. A constraint that
    reads accelerations, or a number that each plan chooses, has no margin. Leeways of the trial allow more than is
    tolerated otherwise.
    """
    manifest, margins, left = plant.manifest, [], []
    coordinates = [c.name for c in manifest.coordinates]
    inputs, added = [coordinates[i] for i in manifest.actuated], found.trial.states
    controls = [(i, x) for i, x in enumerate(problem.controls, len(inputs)) if not x.is_auxiliary]
    named = [x.name for _, x in controls]
    columns = [
        (f"{kind} {name}", key, column, limits, True)
        for kind, known, keys, values, ranges in (
            ("coordinate", manifest.positions, name_quantities("q", manifest.positions), found.q, problem.bounds.q),
            ("velocity", coordinates, name_quantities("qd", coordinates), found.qd, problem.bounds.qd),
            ("input", inputs, name_quantities("u", inputs), found.u[:, : len(inputs)], problem.bounds.u),
            ("control", named, named, found.u[:, [i for i, _ in controls]], [x.bounds for _, x in controls]),
            ("state", added, added, found.states, [state.bounds for state in problem.states]),
        )
        for name, key, column, limits in zip(known, keys, values.T, ranges, strict=True)
    ]
    planned = {x.name for x in problem.unknowns}
    for constraint in problem.constraints:
        expression = parse(constraint.expression)
        if constraint.at != "path" or planned & names(expression):
            continue
        if any(x.kind == "qdd" for name, x in list_quantities(manifest).items() if name in names(expression)):
            left.append(constraint.expression)
            continue
        values = _evaluate([expression], found, plant, {TIME: 0.0, "T": problem.horizon})[0]
        columns.append((constraint.label, constraint.expression, values, constraint.range, False))
    for name, key, values, (lower, upper), is_bound in columns:
        if math.isfinite(lower) or math.isfinite(upper):
            distances = np.minimum(values - lower, upper - values)
            tolerated = max(find_tolerated((lower, upper), values), found.trial.leeway.get(key, 0.0))
            margins.append(Margin(name, found.t, distances, is_bound, tolerated, values, (lower, upper)))
    return margins, left


def _list_constants(found: Track) -> dict[str, Array]:
    """List the constants, updated ones over time, and the time itself."""
    trial = found.trial
    known: dict[str, Array] = {name: np.array([value]) for name, value in trial.constants.items()}
    known[TIME] = found.t
    with np.errstate(all="ignore"):  # a value that is not finite ends the loop, and fails measures
        return known | {name: evaluate(expression, known, ARRAYS) for name, expression in trial.updates.items()}


def _evaluate(
    expressions: Sequence[Expression], found: Track, plant: Mechanism, others: Mapping[str, float] | None = None
) -> list[Array]:
    """Evaluate expressions of the time, constants, the true state and the inputs: shape (K,) each."""
    quantities = list_quantities(plant.manifest)
    wanted = {name: quantities[name] for e in expressions for name in names(e) if name in quantities}
    known = _list_constants(found)
    known |= {name: found.u[:, x.index] for name, x in wanted.items() if x.kind == "u"}
    known |= {name: np.array([value]) for name, value in (others or {}).items()}
    states = {name: x for name, x in wanted.items() if x.kind in STATE}
    known |= measure(states, plant, found.q, found.qd)
    known |= dict(zip(found.trial.states, found.states.T, strict=True))
    if found.trial.controls:
        known |= dict(zip(found.trial.controls, found.u.T[-len(found.trial.controls) :], strict=True))
    with np.errstate(all="ignore"):  # a value that is not finite fails its measure
        return [np.broadcast_to(evaluate(e, known, ARRAYS), found.t.shape) for e in expressions]
