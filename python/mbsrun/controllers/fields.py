"""The run-time data of a controller: Problem -> named fields of numbers, and where bounds and parameters read them.

All numbers of a controller lie in one vector. Fields are parts of it: start, targets, bounds, weights, constants,
masses. A mark replaces each number before the transcription puts it in place, and shows which bound the number becomes.
So nothing here repeats the transcription. Numbers that nothing reads are left out, except for the start.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from mbsgen.manifest import Manifest
from mbsgen.roles import Role
from mbsrun.external import Mechanism
from mbsrun.ocp.evaluation.stages.tables import StageProgram
from mbsrun.ocp.ground.functions import Array, Indices
from mbsrun.ocp.problem.problem import (
    Bounds,
    Constraint,
    Control,
    Cost,
    Delay,
    End,
    Problem,
    Range,
    State,
    Target,
    Term,
    count_delayed,
)
from mbsrun.ocp.problem.structure import list_bounded
from mbsrun.ocp.transcription.transcription import Transcription

MARK = 2.0**40  # number k is marked by MARK + k: far above any number of a problem, and exact
AXES = ("x", "y", "z")


@dataclass(frozen=True)
class Entry:
    """One number of the run-time data."""

    name: str
    unit: str
    value: float  # as the problem has it; infinite where there is no bound
    note: str = ""  # the expression that it belongs to


@dataclass(frozen=True)
class Field:
    """Numbers that belong together."""

    name: str  # in C and in Python
    meaning: str
    entries: tuple[Entry, ...]
    rows: int = 0  # of a matrix, row by row; 0: a vector


@dataclass(frozen=True)
class Sources:
    """Where the vectors of a solver come from: numbers of the data; those from `count` on are constants."""

    fields: tuple[Field, ...]
    count: int  # numbers of all fields
    constants: tuple[float, ...]  # follow them
    lower: Indices  # of each variable
    upper: Indices
    least: Indices  # of each inequality
    most: Indices
    parameters: Indices  # of each entry of p

    @property
    def values(self) -> Array:
        """Return all numbers, as the problem has them."""
        return np.array([*(entry.value for field in self.fields for entry in field.entries), *self.constants])

    def place(self, name: str) -> int:
        """Return where a field begins."""
        names = [field.name for field in self.fields]
        return sum(len(field.entries) for field in self.fields[: names.index(name)])

    def field(self, name: str) -> Field:
        """Look a field up."""
        return next(field for field in self.fields if field.name == name)


def find_sources(problem: Problem, transcription: Transcription, tables: StageProgram, kernels: Mechanism) -> Sources:
    """Collect the data of a problem, and find where they go."""
    marks, manifest = _Marks(), kernels.manifest
    marked = _mark(problem, transcription, manifest, marks)
    lower, upper = transcription.variable_bounds(marked)
    least, most = transcription.constraint_bounds(marked)
    p = transcription.parameters(marked)
    _add_model(tables, kernels, marks)
    program = transcription.program
    everywhere = [
        _spread(bounds, program.kept, program.variables, other) for bounds, other in ((lower, -np.inf), (upper, np.inf))
    ]
    rows = [_spread(bounds, program.kept_rows, program.constraints, 0.0) for bounds in (least, most)]
    vectors = [
        np.where(tables.bounded < 0, sign * np.inf, bounds[tables.bounded])
        for bounds, sign in zip(everywhere, (-1, 1), strict=True)
    ]
    for vector, bounds in zip(vectors, rows, strict=True):
        for variable, row in tables.fixed:
            if np.isfinite(bounds[row]):  # a start that is free has none
                vector[variable] = bounds[row]
    vectors += [bounds[tables.rows_g] for bounds in rows]
    return marks.sort([*vectors, p], np.concatenate([*vectors, p[find_read(tables)]]))


def find_read(tables: StageProgram) -> Indices:
    """Find the entries of p that the tables read: terms do, and calls whose arguments begin there."""
    read: set[int] = set()
    for kind in tables.kinds:
        first = kind.nx + kind.nv
        for step in (step for script in kind.scripts for step in script.steps):
            if step.terms is not None:
                by = [] if step.terms.by is None else step.terms.by.tolist()
                read.update(i - first for i in (*step.terms.from_.tolist(), *by))
            for begin in () if step.call is None else step.call.arguments:
                if first <= begin < first + tables.parameters:
                    read.update(range(begin - first, tables.parameters))
    return np.array(sorted(i for i in read if 0 <= i < tables.parameters), dtype=np.int64)


def _spread(bounds: Array, kept: Indices, size: int, other: float) -> Array:
    """Put the bounds that a solver sees among all variables or rows."""
    whole = np.full(size, other)
    whole[kept] = bounds
    return whole


def list_inputs(problem: Problem, manifest: Manifest) -> list[tuple[str, str]]:
    """List what a controller chooses, with units: inputs of the model that no expression gives, then controls."""
    own = [manifest.coordinates[manifest.actuated[i]] for i in _list_free(problem)]
    return [*((c.name, c.force_unit) for c in own), *((control.name, "") for control in problem.controls)]


def _list_free(problem: Problem) -> list[int]:
    """List the entries of u that no expression gives."""
    given = {force.input for force in problem.forces}
    return [i for i in range(len(problem.bounds.u)) if i not in given]


def list_delays(problem: Problem) -> tuple[int, ...]:
    """List the intervals until each chosen input acts; empty where all act at once."""
    late = {history.place: history.delay for history in list_histories(problem) if history.delay}
    return tuple(late.get(i, 0) for i in range(len(_list_free(problem)) + len(problem.controls))) if late else ()


class _Marks:
    """Numbers of fields while they are collected."""

    def __init__(self) -> None:
        self.fields: list[Field] = []
        self.count = 0

    def add(self, name: str, meaning: str, entries: Iterable[Entry]) -> list[float]:
        """Add a field, and return the marks of its numbers."""
        field = Field(name, meaning, tuple(entries))
        self.fields.append(field)
        first = self.count
        self.count += len(field.entries)
        return [MARK + k for k in range(first, self.count)]

    def sort(self, vectors: Sequence[Array], read_numbers: Array) -> Sources:
        """Replace marks by places, other numbers by places of constants; leave out marks that nothing reads."""
        read = {int(x - MARK) for x in read_numbers if x >= MARK and np.isfinite(x)}
        places: dict[int, int] = {}
        fields, first = [], 0
        for field in self.fields:
            is_kept = [field.name in ALWAYS or first + i in read for i in range(len(field.entries))]
            for i, kept in enumerate(is_kept):
                if kept:
                    places[first + i] = len(places)
            chosen = tuple(entry for entry, kept in zip(field.entries, is_kept, strict=True) if kept)
            if chosen:
                fields.append(replace(field, entries=chosen))
            first += len(field.entries)
        constants: dict[float, int] = {}

        def find(x: float) -> int:
            if x >= MARK and np.isfinite(x):
                return places.get(int(x - MARK), len(places) + constants.setdefault(0.0, len(constants)))
            return len(places) + constants.setdefault(x, len(constants))

        found = [np.array([find(float(x)) for x in vector], dtype=np.int64) for vector in vectors]
        return Sources(tuple(fields), len(places), tuple(constants), *found)


START_Q, START_QD, START_STATES = "start_q", "start_qd", "start_states"
BEFORE, GIVEN = "inputs_before", "inputs_given"
RATES_LOWER, RATES_UPPER = "input_rates_lower", "input_rates_upper"
MASSES, DESIGN, NUMBERS = "parameters", "theta", "numbers"
ALWAYS = (START_Q, START_QD, START_STATES, BEFORE, GIVEN, RATES_LOWER, RATES_UPPER, MASSES, DESIGN, NUMBERS)


@dataclass(frozen=True)
class History:
    """An input of which a controller remembers what was given before: it acts late, or its rate has bounds."""

    input: int  # index into u
    place: int  # among all that the controller chooses
    delay: int  # intervals until it acts
    is_rated: bool

    @property
    def count(self) -> int:
        """Count the commands that are remembered."""
        return max(self.delay, 1)


def list_histories(problem: Problem) -> tuple[History, ...]:
    """List the inputs with delays or bounds on rates, by index."""
    late = {delay.index: count_delayed(delay, problem) or 0 for delay in problem.delays if delay.kind == "input"}
    rated = set(list_bounded(problem.bounds.rates))
    free = _list_free(problem)
    return tuple(History(i, free.index(i), late.get(i, 0), i in rated) for i in sorted({*late, *rated}))


def _mark(problem: Problem, transcription: Transcription, manifest: Manifest, marks: _Marks) -> Problem:
    """Replace every number that may change at run time by its mark."""
    q = [(name, _unit_of_position(name, manifest)) for name in manifest.positions]
    qd = [(c.name, f"{c.unit}/s") for c in manifest.coordinates]
    u = [(manifest.coordinates[i].name, manifest.coordinates[i].force_unit) for i in manifest.actuated]
    return replace(
        problem,
        start_q=tuple(marks.add(START_Q, "coordinates at the start", _pair(q, problem.start_q))),
        start_qd=_mark_velocities(problem, transcription, qd, marks),
        states=_mark_states(problem, marks),
        end=_mark_end(problem.end, q, qd, marks),
        bounds=Bounds(
            _mark_ranges("q", "coordinates", problem.bounds.q, q, marks),
            _mark_ranges("qd", "velocities", problem.bounds.qd, qd, marks),
            _mark_ranges("u", "inputs", problem.bounds.u, u, marks),
            _mark_rates(problem, u, marks),
        ),
        controls=_mark_controls(problem, marks),
        delays=_mark_histories(problem, u, list_inputs(problem, manifest), marks),
        constraints=_mark_constraints(problem.constraints, marks),
        horizon_range=None
        if problem.horizon_range is None
        else _mark_ranges("horizon", "horizon", (problem.horizon_range,), [("horizon", "s")], marks)[0],
        cost=_mark_weights(problem, marks),
        constants=_mark_constants(problem, marks),
    )


def _mark_states(problem: Problem, marks: _Marks) -> tuple[State, ...]:
    """Mark the states that the problem adds; a start or an end in a range keeps that."""
    states = problem.states
    named = [(state.name, "") for state in states]
    begins = [state.start[0] if _is_given(state.start) else 0.0 for state in states]
    starts = marks.add(START_STATES, "states that the problem adds, at the start", _pair(named, begins))
    aims = [state for state in states if _is_given(state.end)]
    entries = [Entry(state.name, "", state.end[0]) for state in aims]
    found = marks.add("end_states", "states that the problem adds, at the end", entries)
    ends = {state.name: mark for state, mark in zip(aims, found, strict=True)}
    ranges = _mark_ranges("states", "states that the problem adds", [state.bounds for state in states], named, marks)
    return tuple(
        replace(
            state,
            bounds=bounds,
            start=(start, start) if _is_given(state.start) else state.start,
            end=(ends[state.name],) * 2 if state.name in ends else state.end,
        )
        for state, start, bounds in zip(states, starts, ranges, strict=True)
    )


def _is_given(range_: Range) -> bool:
    return range_[0] == range_[1]


def _mark_rates(problem: Problem, u: Sequence[tuple[str, str]], marks: _Marks) -> tuple[Range, ...]:
    """Mark the bounds of rates, of the inputs that have some."""
    rated = list_bounded(problem.bounds.rates)
    ranges = [problem.bounds.rates[i] for i in rated]
    named = [(u[i][0], f"{u[i][1]}/s") for i in rated]
    found = dict(zip(rated, _mark_ranges("input_rates", "rates of inputs", ranges, named, marks), strict=True))
    return tuple(found.get(i, limits) for i, limits in enumerate(problem.bounds.rates))


def _mark_controls(problem: Problem, marks: _Marks) -> tuple[Control, ...]:
    """Mark the bounds of the controls that the problem adds."""
    named, ranges = [(part.name, "") for part in problem.controls], [part.bounds for part in problem.controls]
    found = _mark_ranges("controls", "controls that the problem adds", ranges, named, marks)
    return tuple(replace(part, bounds=bounds) for part, bounds in zip(problem.controls, found, strict=True))


def _mark_histories(
    problem: Problem, u: Sequence[tuple[str, str]], inputs: Sequence[tuple[str, str]], marks: _Marks
) -> tuple[Delay, ...]:
    """Mark the commands before the start, which fix inputs that act late."""
    histories = list_histories(problem)
    if not histories:
        return problem.delays
    delays = {delay.index: delay for delay in problem.delays}
    entries = [
        Entry(f"{u[x.input][0]}_{k}", u[x.input][1], delays[x.input].history or 0.0 if x.delay else np.inf)
        for x in histories
        for k in range(x.count, 0, -1)
    ]
    meaning = "inputs of the periods before, oldest first; infinite: unknown"
    commands = iter(marks.add(BEFORE, meaning, entries))
    marks.add(GIVEN, "inputs given since, which are before the next period", _pair(inputs, [0.0] * len(inputs)))
    taken = {x.input: tuple(next(commands) for _ in range(x.count)) for x in histories}
    return tuple(replace(delay, commands=taken[delay.index]) for delay in problem.delays)


def _add_model(tables: StageProgram, kernels: Mechanism, marks: _Marks) -> None:
    """Add the model's parameters that kernels read, at their present values, and the numbers of stages."""
    manifest, present = kernels.manifest, kernels.parameters
    arguments = {(kernel.name, a.name): a for kernel in manifest.kernels for a in kernel.inputs}
    roles = {arguments[part.kernel, part.name].role for part in tables.given}
    if roles & {Role.SETUP, Role.PARAMETER}:
        entries = [Entry(p.name, "", present[p.name]) for p in manifest.parameters]
        marks.add(MASSES, "run-time parameters of the model", entries)
    if Role.DESIGN in roles:
        entries = [Entry(p.name, "", present[p.name]) for p in manifest.design]
        marks.add(DESIGN, "differentiated parameters of the model", entries)
    if tables.numbers.size:
        meaning = "numbers of the stages, stage by stage: relative times that expressions read"
        marks.add(NUMBERS, meaning, [Entry("", "", float(x)) for x in tables.numbers.ravel()])
        marks.fields[-1] = replace(marks.fields[-1], rows=len(tables.numbers))


def _unit_of_position(name: str, manifest: Manifest) -> str:
    """Return the unit of an entry of q; entries of quaternions have none."""
    return next((c.unit for c in manifest.coordinates if c.name == name), "")


def _pair(named: Sequence[tuple[str, str]], values: Sequence[float]) -> list[Entry]:
    return [Entry(name, unit, value) for (name, unit), value in zip(named, values, strict=True)]


def _mark_velocities(
    problem: Problem, transcription: Transcription, qd: Sequence[tuple[str, str]], marks: _Marks
) -> tuple[float, ...]:
    """Mark the velocities that are variables; the loops give the others."""
    chosen = transcription.layout.motions.velocities
    entries = _pair([qd[i] for i in chosen], [problem.start_qd[i] for i in chosen])
    found = dict(zip(chosen, marks.add(START_QD, "velocities at the start", entries), strict=True))
    return tuple(found.get(i, value) for i, value in enumerate(problem.start_qd))


def _mark_ranges(
    name: str,
    meaning: str,
    ranges: Sequence[tuple[float, float]],
    named: Sequence[tuple[str, str]],
    marks: _Marks,
) -> tuple[tuple[float, float], ...]:
    lower = marks.add(f"{name}_lower", f"lower bounds of {meaning}", _pair(named, [r[0] for r in ranges]))
    upper = marks.add(f"{name}_upper", f"upper bounds of {meaning}", _pair(named, [r[1] for r in ranges]))
    return tuple(zip(lower, upper, strict=True))


def _mark_end(end: End, q: Sequence[tuple[str, str]], qd: Sequence[tuple[str, str]], marks: _Marks) -> End:
    def mark_entries(
        name: str, meaning: str, targets: Sequence[tuple[int, float]], named: Sequence[tuple[str, str]], per: str = ""
    ) -> tuple[tuple[int, float], ...]:
        entries = [Entry(named[i][0], f"{named[i][1]}{per}", value) for i, value in targets]
        return tuple((i, mark) for (i, _), mark in zip(targets, marks.add(name, meaning, entries), strict=True))

    def mark_points(
        name: str, meaning: str, targets: Sequence[tuple[str, Target]], unit: str
    ) -> tuple[tuple[str, Target], ...]:
        given = [(sensor, AXES[i], x) for sensor, point in targets for i, x in enumerate(point) if x is not None]
        found = iter(marks.add(name, meaning, [Entry(f"{sensor}.{axis}", unit, x) for sensor, axis, x in given]))

        def place(point: Target) -> Target:
            x, y, z = (None if x is None else next(found) for x in point)
            return x, y, z

        return tuple((sensor, place(point)) for sensor, point in targets)

    return replace(
        end,
        sensors=mark_points("end_sensors", "positions of sensors at the end", end.sensors, "m"),
        coordinates=mark_entries("end_q", "coordinates at the end", end.coordinates, q),
        velocities=mark_entries("end_qd", "velocities at the end", end.velocities, qd),
        accelerations=mark_entries("end_qdd", "accelerations at the end", end.accelerations, qd, "^2"),
        sensor_velocities=mark_points(
            "end_sensor_velocities", "velocities of sensors at the end", end.sensor_velocities, "m/s"
        ),
    )


def _mark_constraints(constraints: Sequence[Constraint], marks: _Marks) -> tuple[Constraint, ...]:
    sides = []
    for side, name in enumerate(("lower", "upper")):
        entries = [Entry(f"{c.at}{k}", "", c.range[side], c.expression) for k, c in enumerate(constraints)]
        sides.append(marks.add(f"constraints_{name}", f"{name} bounds of constraints", entries))
    ranges = zip(*sides, strict=True)
    return tuple(replace(c, range=r) for c, r in zip(constraints, ranges, strict=True))


def _mark_weights(problem: Problem, marks: _Marks) -> Cost:
    """Mark the weights of the terms that are part of the controller; a term of weight 0 is not."""
    cost = problem.cost
    used = [i for i, weight in enumerate(cost.weights) if weight]
    names = ["inputs", "input_rates", *(f"running{k}" for k, _ in enumerate(cost.running))]
    names += [f"terminal{k}" for k, _ in enumerate(cost.terminal)]
    names += [f"rate_{name}" for name, _ in cost.control_rates]
    entries = [Entry(names[i], "", cost.weights[i], cost.names[i] if i > 1 else "") for i in used]
    found = dict(zip(used, marks.add("weights", "weights of the terms of the cost", entries), strict=True))
    w = [found.get(i, 0.0) for i in range(len(cost.weights))]
    terms, r = [*cost.running, *cost.terminal], len(cost.running)
    marked = [Term(term.expression, weight) for term, weight in zip(terms, w[2:], strict=False)]
    rates = tuple((name, x) for (name, _), x in zip(cost.control_rates, w[2 + len(terms) :], strict=True))
    running, terminal = tuple(marked[:r]), tuple(marked[r:])
    return Cost(inputs=w[0], input_rates=w[1], running=running, terminal=terminal, control_rates=rates)


def _mark_constants(problem: Problem, marks: _Marks) -> tuple[tuple[str, float], ...]:
    entries = [Entry(name, "", value) for name, value in problem.constants]
    found = marks.add("constants", "constants of expressions", entries)
    return tuple((name, mark) for (name, _), mark in zip(problem.constants, found, strict=True))
