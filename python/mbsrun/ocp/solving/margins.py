"""Constraints and bounds between the points of a grid: a motion -> by how much it violates each, and when.

A transcription holds constraints at collocation and mesh points. Between them a motion may pass through an obstacle.
So each bound and each constraint of the path is evaluated along the re-simulated motion, at SAMPLES places of every
interval, and around the worst of them on ever finer meshes. A sample that a constraint sees on one side of its range
alone is exact to the last mesh; a violation shorter than an interval over SAMPLES can be missed.

A violation counts from TOLERATED times a scale of the constraint on: the length of its range, or the magnitude of the
only limit; or the spread of its values along the motion, where that is less. Zeros are no scale. By less than ROUNDED
and ROUNDING, a solver leaves limits everywhere.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from mbsrun.ocp.evaluation.values import Values
from mbsrun.ocp.ground.functions import Array, Indices
from mbsrun.ocp.ground.plant import Plant
from mbsrun.ocp.problem.contacts import write_friction
from mbsrun.ocp.problem.problem import Problem, Range, list_names
from mbsrun.ocp.solution.solution import Margin, Margins
from mbsrun.quantities import SENSED, find_component

SAMPLES = 16  # of an interval
TOLERATED = 1e-2  # of the scale of a constraint
MOST = 1e6  # of the violations of intervals, over the tolerated ones
ZOOMS = 4  # meshes around the worst sample, each of 2 * SAMPLES places between the neighbours of the worst
ROUNDED, ROUNDING = 1e-6, 1e-7  # relative to a limit and to values, and absolute: by less a solver leaves limits

Parts = Mapping[str, Array]
Read = Callable[[Indices, Array], Parts]  # the parts of a motion at fractions (B,) of intervals (B,)


@dataclass(frozen=True)
class Watched:
    """A number that stays within a range: an entry of a part of the motion, or an expression."""

    name: str
    range: Range
    kind: str = ""
    index: int = 0
    expression: str = ""


def list_watched(problem: Problem, plant: Plant) -> list[Watched]:
    """List the bounds and constraints of the whole path that have a limit."""
    return [part for part in _list(problem, plant) if any(map(math.isfinite, part.range))]


def _list(problem: Problem, plant: Plant) -> Iterator[Watched]:
    manifest, bounds = plant.manifest, problem.bounds
    names = [c.name for c in manifest.coordinates]
    inputs = [f"the input {names[i]}" for i in manifest.actuated]
    driven = [f"the force of the driven joint {names[i]}" for i in manifest.driven]
    for kind, texts, ranges in (
        ("q", manifest.positions, bounds.q),
        ("qd", [f"the velocity of {name}" for name in names], bounds.qd),
        ("u", inputs, bounds.u),
        ("tau", driven, bounds.tau or ((-math.inf, math.inf),) * len(driven)),
        ("states", problem.added.states, [state.bounds for state in problem.every_state]),
        ("controls", problem.added.controls, [control.bounds for control in problem.controls]),
    ):
        for i, (text, limits) in enumerate(zip(texts, ranges, strict=True)):
            yield Watched(f"the bounds of {text}", limits, kind, i)
    for part in problem.every_component:
        component = find_component(manifest, part.wrench, part.component)
        if component is not None:
            name = f"{'fff mmm'[part.component]}{'xyz xyz'[part.component]} of {part.wrench}"
            yield Watched(f"the bounds of {name if part.component >= 0 else part.wrench}", part.bounds, "w", component)
    for contact in problem.contacts:
        for text in write_friction(contact, manifest):
            yield Watched(f"friction of {contact.sensor}", (0.0, math.inf), expression=text)
    for constraint in problem.constraints:
        if constraint.at == "path" and not constraint.is_relaxed:
            yield Watched(f"constraint {constraint.label}", constraint.range, expression=constraint.expression)


class Watch:
    """The bounds and constraints of a problem, ready to be evaluated along a motion."""

    def __init__(self, problem: Problem, plant: Plant) -> None:
        """Prepare the expressions."""
        self.watched = list_watched(problem, plant)
        self._values = Values([part.expression for part in self.watched if part.expression], problem, plant)
        self.kinds = self._values.kinds | {part.kind for part in self.watched}
        self._intervals = problem.intervals
        self._slacks = [i for i, control in enumerate(problem.controls) if control.softens]

    def measure(self, read: Read) -> Margins:
        """Return the largest violation of each, and the worst of every interval over the tolerated one."""
        N = self._intervals
        if not self.watched:
            return Margins((), (0.0,) * N)
        read = self._widen(read) if self._slacks else read
        places = np.linspace(0.0, 1.0, SAMPLES + 1)
        k, c = np.repeat(np.arange(N), places.size), np.tile(places, N)
        values = self._evaluate(read(k, c)).reshape(N, places.size, -1)
        worst = self._find_worst(values, places, read)
        excess = np.zeros(N)
        for i, margin in enumerate(worst):
            excess = np.maximum(excess, _measure(values[:, :, i], margin.range).max(axis=1) / margin.tolerated)
            excess[margin.interval] = max(excess[margin.interval], margin.violation / margin.tolerated)
        return Margins(tuple(worst), tuple(np.clip(excess, 0.0, MOST).tolist()))

    def _widen(self, read: Read) -> Read:
        """Return a motion whose slacks, constant over intervals, also widen ranges in the intervals beside theirs.

        Else a soft constraint would count as violated where an interval with a smaller slack begins.
        """
        own = read(np.arange(self._intervals), np.zeros(self._intervals))["controls"][:, self._slacks]
        beside = np.pad(own, ((1, 1), (0, 0)), mode="edge")
        widest = np.maximum(own, np.maximum(beside[:-2], beside[2:]))

        def read_widened(k: Indices, c: Array) -> Parts:
            parts = read(k, c)
            controls = parts["controls"].copy()
            controls[:, self._slacks] = widest[k]
            return {**parts, "controls": controls}

        return read_widened

    def _evaluate(self, parts: Parts) -> Array:
        """Return the values (B, watched)."""
        expressions = iter(self._values(parts).T)
        columns = [next(expressions) if part.expression else parts[part.kind][:, part.index] for part in self.watched]
        return np.stack(columns, axis=1)

    def _find_worst(self, values: Array, places: Array, read: Read) -> list[Margin]:
        """Return the worst place of each number, by ever finer meshes, of values (N, places, watched)."""
        ranges = [part.range for part in self.watched]
        own = [values[:, :, i] for i in range(len(ranges))]
        indices = [np.unravel_index(_measure(x, part).argmax(), x.shape) for x, part in zip(own, ranges, strict=True)]
        k = np.array([int(index[0]) for index in indices])
        c, step = places[[int(index[1]) for index in indices]], 1.0 / SAMPLES
        found = np.array([x[index] for x, index in zip(own, indices, strict=True)])
        moving = np.flatnonzero([np.ptp(x[i]) > 0 for x, i in zip(own, k.tolist(), strict=True)])
        for _ in range(ZOOMS if moving.size else 0):
            mesh = np.clip(c[moving, None] + step * np.linspace(-1.0, 1.0, 2 * SAMPLES + 1), 0.0, 1.0)
            every = self._evaluate(read(np.repeat(k[moving], mesh.shape[1]), mesh.ravel()))
            for row, i in enumerate(moving.tolist()):
                finer = every[row * mesh.shape[1] : (row + 1) * mesh.shape[1], i]
                best = int(_measure(finer, ranges[i]).argmax())
                found[i], c[i] = finer[best], mesh[row, best]
            step /= SAMPLES
        times = read(k, c)["t"][:, 0]
        return [
            Margin(part.name, value, part.range, time, interval, find_tolerated(part.range, x))
            for part, value, time, interval, x in zip(
                self.watched, found.tolist(), times.tolist(), k.tolist(), own, strict=True
            )
        ]


def find_wrong_start(problem: Problem, plant: Plant) -> tuple[str, str] | None:
    """Find a constraint of the path that a start violates which is given whole: the finding, and its place.

    No motion from there keeps it. A program leaves such a constraint out at the start, where nothing can change.
    Constraints that read a state without a given start are not judged.
    """
    states, horizon = problem.every_state, np.full((1, 1), problem.horizon)
    if problem.free_start:
        return None
    free = {state.name for state in states if state.start[0] != state.start[1]}
    begin = {"t": np.zeros((1, 1)), "T": horizon, "q": np.array([problem.start_q]), "qd": np.array([problem.start_qd])}
    begin["states"] = np.array([[state.start[0] for state in states]])
    for i, constraint in enumerate(problem.constraints):
        if free & list_names(constraint.expression, problem.functions) or constraint.at != "path":
            continue
        values = Values([constraint.expression], problem, plant)
        if constraint.is_relaxed or not values.kinds <= {"q", "qd", "states", "t", *SENSED}:
            continue
        value, limits = values(begin)[0], constraint.range
        margin = Margin(constraint.label, float(value[0]), limits, 0.0, 0, find_tolerated(limits, value))
        if not margin.is_kept:
            return f"the given start violates a constraint of the path: {margin.describe()}", f"constraints[{i}]"
    return None


def find_tolerated(limits: Range, values: Array) -> float:
    """Return the violation of a range from which on it counts, for a number with these values along a motion."""
    values = values[np.isfinite(values)]
    if not values.size:
        return ROUNDING
    below, above = limits[0] - values.min(), values.max() - limits[1]
    violated = limits[0] if below > above else limits[1]
    length = limits[1] - limits[0]
    scales = (length if 0 < length < math.inf else abs(violated), float(np.ptp(values)))
    scale = min((scale for scale in scales if scale > 0), default=0.0)
    return max(TOLERATED * scale, ROUNDED * max(abs(violated), float(np.abs(values).max())), ROUNDING)


def _measure(values: Array, limits: Range) -> Array:
    """Return by how much values leave their range, negative inside; what has no value leaves it without end."""
    return np.nan_to_num(np.maximum(limits[0] - values, values - limits[1]), nan=np.inf, posinf=np.inf, neginf=-np.inf)
