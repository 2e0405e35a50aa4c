"""Inputs whose delays differ across a link: each phase reads the commands as they were its own delay ago.

Let the input act d later in the phase that ends at the time T, and d' later in the next one:

    u(t) = command(t - d)  for t <= T,    u'(t) = command(t - d')  for t >= T

Where the delay grows by s = d' - d > 0, the commands of the last s seconds act a second time, and

    u'(t) = u(t - s),    T <= t <= T + s

The commands of the d seconds before the link act in the next phase alone. Where the delay shrinks, no command acts
twice, and the ones of s seconds never act: they carry a continuous input on within the bounds of its rate,

    -s lower <= u'(T) - u(T) <= -s upper
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from mbsgen.manifest import Manifest
from mbsrun.ocp.ground import schemes
from mbsrun.ocp.ground.functions import Array, Indices
from mbsrun.ocp.problem.problem import SAME_TIME, Delay, Problem
from mbsrun.ocp.transcription.linking import Defined, Rows
from mbsrun.ocp.transcription.transcription import Transcription

USUAL = "give both phases the same delay, or history: a number, or free"


@dataclass(frozen=True)
class Shift:
    """An input whose delay differs across a link."""

    kind: str  # input, control, or state: a continuous input
    name: str  # of the coordinate, the control or the state
    rate: str  # the control that is the rate of a continuous input
    before: float  # s
    after: float
    is_linked: bool  # whether the commands of the phase before act first

    @property
    def seconds(self) -> float:
        """Return how much later the input acts after the link."""
        return self.after - self.before

    @property
    def repeats(self) -> bool:
        """Return whether commands act again."""
        return self.is_linked and self.seconds > 0


@dataclass(frozen=True)
class Half:
    """A phase beside a link."""

    name: str
    problem: Problem
    manifest: Manifest

    def find(self, shift: Shift) -> int | None:
        """Return the number of an input, of a control, or of the rate of a continuous input; None: there is none."""
        problem = self.problem
        if shift.kind == "input":
            names = [self.manifest.coordinates[i].name for i in self.manifest.actuated]
            given = [names[force.input] for force in problem.forces]
            return names.index(shift.name) if shift.name in names and shift.name not in given else None
        name, controls = shift.rate or shift.name, [control.name for control in problem.controls]
        has_state = shift.kind != "state" or shift.name in [state.name for state in problem.states]
        return controls.index(name) if name in controls and has_state else None


@dataclass(frozen=True)
class Placed:
    """The variables of a phase beside a link, which begin at an offset."""

    half: Half
    own: Transcription
    offset: int

    def find_values(self, shift: Shift) -> Indices:
        """Return the variables of an input, (N, values in an interval)."""
        index, layout, extras = self.half.find(shift), self.own.layout, self.own.layout.extras
        assert index is not None, "a phase whose inputs act again has them"
        is_constant = self.half.problem.inputs == "constant"
        if shift.kind == "input":
            column = extras.free.index(index)
            found = layout.inputs[:, None, column] if is_constant else layout.point_inputs[..., column]
        else:
            found = extras.controls[:, None, index] if is_constant else extras.point_controls[..., index]
        return np.asarray(found + self.offset)

    def find_state(self, shift: Shift, k: int) -> int:
        """Return the variable of a continuous input at a mesh point."""
        names = [state.name for state in self.half.problem.states]
        return int(self.own.layout.extras.states[k, names.index(shift.name)]) + self.offset


def find_shifts(before: Half, after: Half) -> list[Shift]:
    """Find the inputs whose delays differ."""
    left, right = ({_name(delay, half): delay for delay in half.problem.delays} for half in (before, after))
    found = []
    for kind, name in dict.fromkeys((*left, *right)):
        late, later = left.get((kind, name)), right.get((kind, name))
        first, second = (0.0 if delay is None else delay.seconds for delay in (late, later))
        if abs(second - first) > SAME_TIME * max(first, second):
            rate = ""
            if kind == "state":
                half, delay = (before, late) if later is None else (after, later)
                assert delay is not None, "one of the phases has the delay"
                rate = half.problem.controls[delay.index].name
            found.append(Shift(kind, name, rate, first, second, later is not None and later.is_linked))
    return found


def _name(delay: Delay, half: Half) -> tuple[str, str]:
    """Return the kind and the name of a delayed input."""
    if delay.state is not None:
        return "state", half.problem.states[delay.state].name
    if delay.kind == "input":
        return delay.kind, half.manifest.coordinates[half.manifest.actuated[delay.index]].name
    return delay.kind, half.problem.controls[delay.index].name


def find_misfits(shift: Shift, before: Half, after: Half) -> Iterator[tuple[str, str]]:
    """Find why an input of the phase before cannot act again: finding and remedy."""
    source, target = before.problem, after.problem
    text = f"{shift.name} acts {shift.after:g} s later, and {shift.before:g} s later in phase {before.name}"
    if before.find(shift) is None:
        yield f"{text}, which has no such input, or one of another course", USUAL
    elif not source.is_timed:
        yield f"{text}, whose horizon is free, so its mesh points move", f"give that horizon; or {USUAL}"
    elif shift.seconds > source.horizon * (1 + SAME_TIME):
        finding = f"{text}, which lasts {source.horizon:g} s, less than the difference"
        yield finding, USUAL
    elif source.inputs != target.inputs:
        yield f"{text}, where inputs are {source.inputs}, and here {target.inputs}", f"take the same; or {USUAL}"
    elif source.inputs != "constant" and source.degree > target.degree:
        finding = f"{text}, where the degree is {source.degree}, and here {target.degree}"
        yield finding, f"take at least the same degree here; or {USUAL}"
    elif source.refine is not None:
        yield f"{text}, whose grid is refined", f"leave refine out of phase {before.name}; or {USUAL}"
    else:
        yield from _find_missing_points(text, shift.seconds, source, target)


def _find_missing_points(text: str, seconds: float, source: Problem, target: Problem) -> Iterator[tuple[str, str]]:
    """Find the mesh points that a phase needs so that the inputs of the phase before can act again."""
    ends = source.grid.mesh(source.horizon) - source.horizon + seconds  # times in the phase after
    own, same = target.grid.mesh(target.horizon), SAME_TIME * max(source.horizon, target.horizon)
    if not (abs(ends) <= same).any():
        finding = f"{text}, which has no mesh point {seconds:g} s before its end"
        yield finding, f"let an interval begin there; or {USUAL}"
        return
    missing = [t for t in ends[ends > same].tolist() if not (abs(own - t) <= same).any()]
    if missing:
        finding = f"{text}; so mesh points are missing here, at {', '.join(f'{t:g}' for t in missing)} s"
        yield finding, f"let intervals end there; or {USUAL}"


def write_repeats(rows: Rows, text: str, shifts: Sequence[Shift], before: Placed, after: Placed) -> Indices:
    """Write that the last inputs of the phase before act again; return the rows.

    Variables that all stages share hold them, so that no row reads two distant stages.
    """
    first = rows.rows
    for shift in shifts:
        if shift.repeats:
            _repeat(rows, text, shift, before, after)
    return np.arange(first, rows.rows)


def _repeat(rows: Rows, text: str, shift: Shift, before: Placed, after: Placed) -> None:
    source, target = before.half.problem, after.half.problem
    t, own = source.grid.mesh(source.horizon) - source.horizon + shift.seconds, target.grid.mesh(target.horizon)
    last, same = before.find_values(shift), SAME_TIME * max(source.horizon, target.horizon)
    first = int(np.argmin(abs(t)))
    held = _hold(rows, text, last[first:])
    for j, values in enumerate(after.find_values(shift)):
        if own[j + 1] > shift.seconds + same:
            break
        k = int(np.searchsorted(t, own[j] + same)) - 1
        E = _read(source, target, (own[j] - t[k], own[j + 1] - own[j], t[k + 1] - t[k]))
        found = rows.add_rows(len(values), f"{text}: {shift.name}, {own[j]:g} s after it")
        rows.A.put(found, values, 1.0)
        rows.A.put(found[:, None], held[k - first], -E)
    if shift.kind == "state":
        (start,) = _hold(rows, text, np.array([[before.find_state(shift, first)]]))
        found = rows.add_rows(1, f"{text}: {shift.name}")
        rows.A.put(found, [after.find_state(shift, 0)], 1.0)
        rows.A.put(found, start, -1.0)


def _hold(rows: Rows, text: str, values: Indices) -> Indices:
    """Return variables that are equal to others."""
    held = rows.add_variables(values.size)
    found = rows.add_rows(values.size, f"{text}: inputs that act again")
    rows.A.put(found, held, 1.0)
    rows.A.put(found, values.ravel(), -1.0)
    rows.defined.append(Defined(held, found))
    return held.reshape(values.shape)


def _read(source: Problem, target: Problem, place: tuple[float, float, float]) -> Array:
    """Return the matrix that reads values of an interval at points within: where it begins, its length, the other's."""
    if source.inputs == "constant":
        return np.ones((1, 1))
    begin, length, whole = place
    given, asked = (schemes.build(problem.family, problem.degree).points for problem in (source, target))
    return np.array([schemes.read_basis(given, float(c)) for c in _snap((begin + asked * length) / whole, given)])


def _snap(places: Array, nodes: Array) -> Array:
    """Return places, nodes in their stead where they differ by rounding."""
    nearest = nodes[np.argmin(abs(places[:, None] - nodes), axis=1)]
    return np.where(abs(places - nearest) <= SAME_TIME, nearest, places)


def write_jumps(rows: Rows, text: str, shifts: Sequence[Shift], before: Placed, after: Placed) -> None:
    """Bound the changes of continuous inputs over commands that never act."""
    for shift in shifts:
        index = before.half.find(shift)
        if shift.kind != "state" or shift.seconds > 0 or index is None or after.half.find(shift) is None:
            continue
        limits = -shift.seconds * np.array(before.half.problem.controls[index].bounds)
        if np.isfinite(limits).any():
            found = rows.add_rows(1, f"{text}: the rate of {shift.name}", *limits.tolist())
            rows.A.put(found, [after.find_state(shift, 0)], 1.0)
            rows.A.put(found, [before.find_state(shift, before.half.problem.intervals)], -1.0)
