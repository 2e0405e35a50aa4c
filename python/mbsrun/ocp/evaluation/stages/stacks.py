"""Many problems of one kind solved in one call of C, or one for each thread: stacks of numbers -> stacks of points.

A stack has a row for each case. Cases whose bounds are equal in the same places share a solver; threads take parts of a
stack, each with a separate solver. No number depends on these parts.
"""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbsrun.ocp.evaluation.stages.binding import INFINITE, ROUNDING, Settings, Tables, Workspace
from mbsrun.ocp.evaluation.stages.tables import StageProgram
from mbsrun.ocp.ground.functions import Array, Indices

Counts = NDArray[np.intc]
KEPT = 4  # places of equal bounds whose solvers are kept


@dataclass(frozen=True, eq=False)
class NumbersStack:
    """The numbers of many solves, in the program's order, (cases, size) each; see `binding.Numbers`."""

    parameters: Array
    lower: Array
    upper: Array
    least: Array
    most: Array
    scales: Array


@dataclass(frozen=True, eq=False)
class PointStack:
    """Iterates of many solves, in the order of the tables, (cases, size) each; see `binding.Point`."""

    w: Array
    below: Array
    above: Array
    y: Array

    @property
    def parts(self) -> tuple[Array, ...]:
        """Return the arrays."""
        return self.w, self.below, self.above, self.y


@dataclass(frozen=True, eq=False)
class OutcomeStack:
    """The ends of many solves, (cases,) each, beside their points."""

    points: PointStack
    statuses: tuple[str, ...]  # of the C enumeration
    iterations: Counts
    seconds: Array
    evaluating: Array  # s of these in functions and derivatives
    cpu_seconds: Array


class StackSolver:
    """Solvers of tables, for stacks of cases."""

    def __init__(self, tables: Tables, threads: int = 1, *, has_lanes: bool = False) -> None:
        """Take the tables; memory follows with the first solve."""
        self.tables, self.ffi, self.lib = tables, tables.ffi, tables.lib
        self._threads, self._has_lanes = threads, has_lanes
        self._made: dict[bytes, list[Workspace]] = {}

    def solve(
        self, starts: PointStack, numbers: NumbersStack, settings: Settings, most_iterations: Counts
    ) -> OutcomeStack:
        """Solve all cases from points near them; the points are copied."""
        count = len(numbers.parameters)
        bounds = set_bounds(self.tables.data, numbers)
        scales, known = np.ones(bounds[0].shape), self.tables.data.variables >= 0
        scales[:, known] = numbers.scales[:, self.tables.data.variables[known]]
        own = [np.array(part, dtype=np.float64, order="C") for part in starts.parts]
        given = [np.ascontiguousarray(part) for part in (numbers.parameters, *bounds, scales)]
        limits = np.ascontiguousarray(most_iterations, dtype=np.intc)
        status, iterations = np.zeros(count, np.intc), np.zeros(count, np.intc)
        times = np.zeros((3, count))
        for chosen, key in _group(bounds):
            parts = [_pick(part, chosen) for part in (*own, *given, limits)]
            found = [np.zeros(chosen.size, np.intc), np.zeros(chosen.size, np.intc)]
            spent = np.zeros((3, chosen.size))
            self._solve_group(self._prepare(key, parts, chosen.size), parts, (*found, *spent), settings)
            times[:, chosen] = spent
            status[chosen], iterations[chosen] = found
            for whole, part in zip(own, parts[:4], strict=True):
                whole[chosen] = part
        names = self.ffi.typeof("mbs_stages_status").elements
        told = tuple(names[number] for number in status.tolist())
        return OutcomeStack(PointStack(*own), told, iterations, *times)

    def _prepare(self, key: bytes, parts: list[Array], count: int) -> list[Workspace]:
        """Return the memory of as many solvers as there is work, for bounds that are equal in some places."""
        if key not in self._made and len(self._made) >= KEPT:
            self._made.pop(next(iter(self._made)))
        made = self._made.setdefault(key, [])
        parameters, *bounds = parts[4:9]
        first = bounds[0][0], bounds[1][0], bounds[2][0], bounds[3][0]
        while len(made) < min(self._threads, count):
            made.append(Workspace(self.tables, parameters[0], first, has_lanes=self._has_lanes))
        return made

    def _solve_group(
        self, made: list[Workspace], parts: list[Array], found: tuple[Any, ...], settings: Settings
    ) -> None:
        count = len(parts[0])
        stack = self._lay_stack(parts, found)
        options = self._write_options(settings)
        workers = [self._lay_worker(own, options, parts) for own in made[: min(self._threads, count)]]
        ends = [count * k // len(workers) for k in range(len(workers) + 1)]
        if len(workers) == 1:
            self.lib.mbs_cases_solve(workers[0], stack, 0, count)
            return
        with ThreadPoolExecutor(len(workers)) as pool:
            work = zip(workers, ends, ends[1:], strict=False)
            for _ in pool.map(lambda part: self.lib.mbs_cases_solve(part[0], stack, part[1], part[2]), work):
                pass

    def _lay_stack(self, parts: list[Array], found: tuple[Any, ...]) -> Any:
        """Return the stack in C's structure; the arrays must outlive it."""
        stack = self.ffi.new("mbs_cases_stack *")
        names = "w", "below", "above", "y", "parameters", "lower", "upper", "least", "most", "scale"
        for name, part in zip(names, parts[:-1], strict=True):
            setattr(stack, name, self.ffi.cast("double *", part.ctypes.data))
        stack.most_iterations = self.ffi.cast("int *", parts[-1].ctypes.data)
        for name, part in zip(("status", "iterations"), found[:2], strict=True):
            setattr(stack, name, self.ffi.cast("int *", part.ctypes.data))
        for name, part in zip(("seconds", "evaluating", "cpu_seconds"), found[2:], strict=True):
            setattr(stack, name, self.ffi.cast("double *", part.ctypes.data))
        return stack

    def _lay_worker(self, memory: Workspace, options: Any, parts: list[Array]) -> Any:
        worker = self.ffi.new("mbs_cases_worker *")
        worker.solver, worker.options, worker.timed = memory.solver, options, memory.team.contexts
        worker.given, worker.variables, worker.rows = parts[4].shape[1], parts[5].shape[1], parts[7].shape[1]
        worker.parameters = self.ffi.from_buffer("double[]", memory.evaluator.parameters)
        for name, held in zip(("lower", "upper", "least", "most"), memory.bounds, strict=True):
            setattr(worker, name, self.ffi.from_buffer("double[]", held))
        worker.scale = self.ffi.from_buffer("double[]", memory.scales)
        memory.problem.watch, memory.problem.clock = self.ffi.NULL, self.ffi.NULL
        return worker

    def _write_options(self, settings: Settings) -> Any:
        options = self.ffi.new("mbs_stages_options *", self.lib.mbs_stages_default_options())
        for name, value in settings.values.items():
            setattr(options, name, int(value) if isinstance(getattr(options, name), int) else value)
        return options


def _pick(part: Any, chosen: Indices) -> Any:
    """Return some rows, which lie one after the other; all of them are copied nevertheless."""
    return np.ascontiguousarray(part[chosen])


def _group(bounds: tuple[Array, ...]) -> Iterator[tuple[Indices, bytes]]:
    """Yield the cases whose bounds are equal in the same places, with the name of these places."""
    equal = np.concatenate((bounds[0] == bounds[1], bounds[2] == bounds[3]), axis=1)
    groups: dict[bytes, list[int]] = {}
    for k, row in enumerate(equal):
        groups.setdefault(row.tobytes(), []).append(k)
    yield from ((np.array(cases, dtype=np.int64), key) for key, cases in groups.items())


def find_crossed(data: StageProgram, numbers: NumbersStack) -> NDArray[np.bool_]:
    """Return the cases whose rows give states of the start values beyond the bounds of these states."""
    variable, row = data.fixed.T
    bounded, least = data.bounded[variable], numbers.least[:, row]
    excess = np.maximum(least - numbers.upper[:, bounded], numbers.lower[:, bounded] - numbers.most[:, row])
    return np.asarray((excess > ROUNDING * np.maximum(1.0, np.abs(least))).any(axis=1))


def set_bounds(data: StageProgram, numbers: NumbersStack) -> tuple[Array, Array, Array, Array]:
    """Return bounds of variables and of inequalities, in the order of the tables; see `binding.set_bounds`."""
    bounded, known = data.bounded, data.bounded >= 0
    shape = len(numbers.lower), bounded.size
    lower, upper = np.full(shape, -INFINITE), np.full(shape, INFINITE)
    lower[:, known], upper[:, known] = numbers.lower[:, bounded[known]], numbers.upper[:, bounded[known]]
    variable, row = data.fixed.T
    lower[:, variable] = np.maximum(lower[:, variable], numbers.least[:, row])
    upper[:, variable] = np.minimum(upper[:, variable], numbers.most[:, row])
    upper = np.maximum(lower, upper)  # a start beyond a bound by rounding is on it
    of_program = data.rows_g >= 0
    least, most = (np.where(of_program, rows[:, data.rows_g], 0.0) for rows in (numbers.least, numbers.most))
    given = (lower, upper, least, most)
    lower, upper, least, most = (np.clip(part, -INFINITE, INFINITE) for part in given)
    return lower, upper, least, most
