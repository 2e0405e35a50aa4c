"""The project's own method for many problems at once: Stack -> AnswerStack, in one call of C; see csrc/cases.

Solves start near solutions of others, as in `stages`, and end in the same numbers as there, one by one.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from mbsrun.ocp.evaluation.stages import binding
from mbsrun.ocp.evaluation.stages.building import build
from mbsrun.ocp.evaluation.stages.stacks import (
    NumbersStack,
    OutcomeStack,
    PointStack,
    StackSolver,
    find_crossed,
)
from mbsrun.ocp.evaluation.stages.tables import StageProgram
from mbsrun.ocp.ground.functions import Array, Indices
from mbsrun.ocp.ground.memory import Memory
from mbsrun.ocp.ground.program import Program
from mbsrun.ocp.methods import stages
from mbsrun.ocp.methods.method import AnswerStack, Assignment, Near, Stack
from mbsrun.ocp.methods.method import StackSolver as Solver

Mask = NDArray[np.bool_]


def make_stacks(order: Assignment, threads: int) -> Solver:
    """Make the method for stacks of a program; the scaling of the order is not read."""
    settings = stages.read_settings(order)
    near, has_lanes = stages.start_near(settings, 0), order.options.get(stages.LANES) == "yes"
    made: dict[bytes, StackSolver] = {}
    program, plants = order.program.data, (order.program.plant, order.program.others)

    def find(key: bytes, numbers: NumbersStack) -> StackSolver:
        if key not in made:
            weights, rows = _find_places(program, numbers, 0)
            tables = binding.Tables(build(program, plants[0], weights, rows, plants[1]), *plants)
            made[key] = StackSolver(tables, threads, has_lanes=has_lanes)
        return made[key]

    def solve(stack: Stack) -> AnswerStack:
        numbers, factors = _expand(program, stack), stack.scaling
        parts: list[tuple[Indices, AnswerStack]] = []
        for key, chosen in _group(program, numbers):
            own = chosen[[stack.near[k].layout == key for k in chosen.tolist()]]
            if not own.size:
                continue
            solver = find(key, _pick(numbers, own))
            own = own[~find_crossed(solver.tables.data, _pick(numbers, own))]
            if own.size:
                starts = _stack_points([stack.near[k] for k in own.tolist()], factors[own])
                limits = stack.most_iterations[own].astype(np.intc)
                found = solver.solve(starts, _pick(numbers, own), near, limits)
                parts.append((own, _read(program, solver.tables.data, found, key, factors[own])))
        return _join(program, stack, parts)

    return solve


def _join(program: Program, stack: Stack, parts: Sequence[tuple[Indices, AnswerStack]]) -> AnswerStack:
    """Return the answers of all cases; starts in no part do not fit their problems."""
    count = stack.count
    x, lam = np.full((count, program.kept.size), np.nan), np.full((count, program.kept_rows.size), np.nan)
    statuses, near, iterations = [stages.OTHER_LAYOUT] * count, list(stack.near), np.zeros(count, np.int64)
    times = np.zeros((3, count))
    for chosen, own in parts:
        x[chosen], lam[chosen], iterations[chosen] = own.x, own.multipliers, own.iterations
        times[:, chosen] = own.seconds, own.evaluating, own.cpu_seconds
        for i, k in enumerate(chosen.tolist()):
            statuses[k], near[k] = own.statuses[i], own.near[i]
    return AnswerStack(x, tuple(statuses), iterations, lam, tuple(near), *times)


def _expand(program: Program, stack: Stack) -> NumbersStack:
    """Return the numbers of solves for all variables and rows; equations of inner variables are 0."""
    count = stack.count
    lower, upper = np.full((count, program.variables), -np.inf), np.full((count, program.variables), np.inf)
    lower[:, program.kept], upper[:, program.kept] = stack.lower, stack.upper
    least, most = np.zeros((count, program.constraints)), np.zeros((count, program.constraints))
    least[:, program.kept_rows], most[:, program.kept_rows] = stack.g_lower, stack.g_upper
    parameters, scales = stack.parameters.astype(np.float64), np.ones((count, program.variables))
    parameters[:, : len(program.H)] *= stack.scaling[:, None]
    scales[:, program.kept] = stack.scales
    return NumbersStack(parameters, lower, upper, least, most, scales)


def _find_places(program: Program, numbers: NumbersStack, k: int) -> tuple[Mask, Mask]:
    """Return which weights of a case are not 0, and which rows have bounds; see `stages`."""
    weights = numbers.parameters[k, : len(program.H)] != 0
    return weights, np.isfinite(numbers.least[k]) | np.isfinite(numbers.most[k])


def _group(program: Program, numbers: NumbersStack) -> Iterator[tuple[bytes, Indices]]:
    """Yield the layouts, and the cases that have them."""
    groups: dict[bytes, list[int]] = {}
    for k in range(len(numbers.parameters)):
        weights, rows = _find_places(program, numbers, k)
        groups.setdefault(bytes(weights.tobytes() + rows.tobytes()), []).append(k)
    yield from ((key, np.array(cases, dtype=np.int64)) for key, cases in groups.items())


def _pick(numbers: NumbersStack, chosen: Indices) -> NumbersStack:
    """Return the numbers of some cases."""
    parts = (numbers.parameters, numbers.lower, numbers.upper, numbers.least, numbers.most, numbers.scales)
    return NumbersStack(*(part[chosen] for part in parts))


def _stack_points(near: Sequence[Near], factors: Array) -> PointStack:
    """Return the points of starts, whose multipliers belong to the cost itself, as the solver sees the cost."""
    w, below, above, y = (np.stack(parts) for parts in zip(*(one.point.parts for one in near), strict=True))
    return PointStack(w, *(part * factors[:, None] for part in (below, above, y)))


def _read(program: Program, tables: StageProgram, found: OutcomeStack, layout: bytes, factors: Array) -> AnswerStack:
    """Return answers, with multipliers of the cost itself."""
    points = found.points
    x = np.zeros((len(points.w), program.variables))
    known = tables.variables >= 0
    x[:, tables.variables[known]] = points.w[:, known]
    below, above, y = (part * (1 / factors)[:, None] for part in (points.below, points.above, points.y))
    near = tuple(Near(layout, binding.Point(*row)) for row in zip(points.w, below, above, y, strict=True))
    lam = _read_multipliers(program, tables, y, above - below)
    told = tuple(stages.STATUSES.get(status, status) for status in found.statuses)
    iterations = found.iterations.astype(np.int64)
    times = found.seconds, found.evaluating, found.cpu_seconds
    return AnswerStack(x[:, program.kept], told, iterations, lam, near, *times)


def _read_multipliers(program: Program, tables: StageProgram, y: Array, z: Array) -> Array:
    """Return multipliers of the program's rows; see `stages`."""
    sums = _SUMS.find(lambda: _make_sums(program, tables), tables, program)
    found = np.asarray(y @ sums)
    variable, row = tables.fixed.T
    found[:, row] += z[:, variable]
    return found[:, program.kept_rows]


def _make_sums(program: Program, tables: StageProgram) -> sparse.csr_array:
    """Return the matrix from multipliers of the tables to the ones of the program's rows."""
    places, rows, factors = stages.place_multipliers(program, tables)
    count = sum(tables.kinds[kind].ne + tables.kinds[kind].ng for kind in tables.kind_of_stage)
    count += sum(tables.kinds[kind].nx for kind in tables.kind_of_stage[1:])
    return sparse.csr_array((factors, (places, rows)), shape=(count, program.constraints))


_SUMS = Memory[sparse.csr_array]()
