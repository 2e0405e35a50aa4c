"""Random quadratic programs of stages: answers of the project's method meet the conditions of optimality.

Numbers of variables and rows are drawn, so that nothing lies in the order of stages. The programs are convex, and the
conditions, with the multipliers that the method returns, are enough:

    x within its bounds, g = A x within its own,    H x + c + A' lam = z,
    z_i = 0 within bounds, >= 0 at the lower one and <= 0 at the upper one; lam_i likewise, with the other sign
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy import sparse

from mbsrun.ocp.evaluation.backends.prepared import Prepared
from mbsrun.ocp.evaluation.stages.binding import INFINITE, Numbers, find_crossed, set_bounds
from mbsrun.ocp.evaluation.stages.building import build
from mbsrun.ocp.ground.program import Program, Stages
from mbsrun.ocp.ground.status import SOLVED
from mbsrun.ocp.methods import METHODS, Answer, Assignment, Instance
from mbsrun.ocp.methods.stages import INFEASIBLE
from tests.mbsrun.peer import double_integrator

SEEDS = range(8)
NEAR = 1e-6  # of a solve to 1e-9
N, NX, M = 4, 2, 2


@dataclass(frozen=True)
class _Drawn:
    program: Program
    start: Instance


def draw(seed: int) -> _Drawn:
    """Draw a program whose rows a random point meets: dynamics, inner variables, rows of one stage and of two."""
    rng = np.random.default_rng(seed)
    inner, common, further = int(rng.integers(0, 3)), int(rng.integers(0, 2)), 3
    sizes = [(N + 1) * NX, N * M, N * inner, common]
    parts = np.split(rng.permutation(sum(sizes)), np.cumsum(sizes)[:-1])
    states, inputs, y = parts[0].reshape(N + 1, NX), parts[1].reshape(N, M), parts[2].reshape(N, 1, inner)
    counts = [N * inner, N * NX, N * further, NX]
    rows = np.split(rng.permutation(sum(counts)), np.cumsum(counts)[:-1])
    equations, continuity, others = rows[0].reshape(y.shape), rows[1].reshape(N, NX), rows[2].reshape(N, further)
    A = np.zeros((sum(counts), sum(sizes)))
    for k in range(N):
        own = np.concatenate((states[k], inputs[k], parts[3]))
        A[np.ix_(equations[k, 0], own)] = rng.uniform(-1, 1, (inner, own.size))
        A[np.ix_(equations[k, 0], y[k, 0])] = np.eye(inner) + 0.2 * rng.uniform(-1, 1, (inner, inner))
        own = np.concatenate((own, y[k, 0]))
        A[np.ix_(continuity[k], own)] = rng.uniform(-0.7, 0.7, (NX, own.size))
        A[continuity[k], states[k + 1]] = rng.choice([1.0, -1.0, 2.0], NX)
        beside = states[k + 1] if k % 2 else inputs[max(k - 1, 0)]
        for row, read in zip(others[k], (own, np.concatenate((own, beside)), beside), strict=True):
            A[row, read] = rng.uniform(-1, 1, read.size)
    A[rows[3], states[0]] = 1.0
    stage = np.zeros(sum(counts), dtype=np.int64)
    for part in (equations, continuity, others):
        stage[part] = np.arange(N).reshape(-1, *[1] * (part.ndim - 1))
    size = sum(sizes)
    squares = tuple(sparse.csc_array(np.diag(rng.uniform(0.5, 2, size))) for _ in range(2))
    stages = Stages(states, inputs, y, equations, continuity, parts[3], stage)
    program = Program(sparse.csc_array(A), squares, (), (), 0, stages)
    zero = np.concatenate((rows[0], rows[1]))  # equations and dynamics
    inside = rng.uniform(-1, 1, size)
    inside -= np.linalg.pinv(A[zero]) @ A[zero] @ inside
    g, width = A @ inside, rng.uniform(0.01, 0.3, sum(counts))
    g[zero] = width[zero] = width[rows[3]] = 0.0
    room = rng.uniform(0.05, 1.5, size)
    open_ = rng.random(size) < 0.3
    lower, upper = np.where(open_, -np.inf, inside - room), np.where(open_, np.inf, inside + rng.uniform(0, 1) * room)
    start = Instance(np.zeros(size), rng.uniform(0.5, 2, 2), lower, upper, g - width, g + width)
    return _Drawn(program, start)


def solve(program: Program, start: Instance) -> Answer:
    """Solve with a scale of the cost, and with scales of variables."""
    order = Assignment(Prepared(program, double_integrator()), 1e-9, 200, scaling=0.3, options={}, threads=1)
    scales = np.random.default_rng(0).uniform(0.5, 2, start.x.size)
    return METHODS["mbs"].make(order)(replace(start, scales=scales))


def is_optimal(drawn: _Drawn, answer: Answer) -> None:
    program, start, x = drawn.program, drawn.start, answer.x
    assert answer.status == SOLVED
    assert answer.multipliers is not None
    lam, g, A = answer.multipliers, program.A @ x, program.A.toarray()
    assert (x >= start.lower - NEAR).all()
    assert (x <= start.upper + NEAR).all()
    assert start.measure(g) <= NEAR
    H = sum(p * part.toarray() for p, part in zip(start.parameters, program.H, strict=True))
    z = H @ x + A.T @ lam
    for value, low, high, force in ((x, start.lower, start.upper, z), (g, start.g_lower, start.g_upper, -lam)):
        free = low < high
        assert (np.abs(force[free & (value - low > 1e-4) & (high - value > 1e-4)]) < NEAR * 100).all()
        assert (force[free & (value - low <= 1e-4)] > -NEAR * 100).all()
        assert (force[free & (high - value <= 1e-4)] < NEAR * 100).all()


@pytest.mark.parametrize("seed", SEEDS)
def test_answers_meet_the_conditions_of_optimality(seed: int) -> None:
    drawn = draw(seed)
    is_optimal(drawn, solve(drawn.program, drawn.start))


@pytest.mark.parametrize("seed", SEEDS)
def test_rows_that_contradict_each_other_are_named(seed: int) -> None:
    """One row of an interval is asked to be where its own bounds of variables do not let it."""
    drawn = draw(seed)
    start, program = drawn.start, drawn.program
    assert program.stages is not None
    lower, upper = (
        np.where(np.isfinite(start.lower), start.lower, -3.0),
        np.where(np.isfinite(start.upper), start.upper, 3.0),
    )
    A = program.A.toarray()
    free = [row for row in range(len(A)) if start.g_lower[row] < start.g_upper[row]]
    row = free[seed % len(free)]
    most = np.maximum(A[row] * lower, A[row] * upper).sum()
    least, above = start.g_lower.copy(), start.g_upper.copy()
    least[row], above[row] = most + 1.0, most + 2.0
    answer = solve(program, Instance(start.x, start.parameters, lower, upper, least, above))
    assert answer.status == INFEASIBLE
    assert row in answer.clash


def _number(start: Instance) -> Numbers:
    return Numbers(start.parameters, start.lower, start.upper, start.g_lower, start.g_upper)


@pytest.mark.parametrize("seed", SEEDS)
def test_tables_have_the_bounds_of_the_program(seed: int) -> None:
    """Each variable has its bounds in one place, where a row gives the first states too; each row has its own."""
    drawn = draw(seed)
    start, data = drawn.start, build(drawn.program, double_integrator())
    lower, upper, least, most = set_bounds(data, _number(start))
    where = {int(i): k for k, i in enumerate(data.bounded) if i >= 0}
    assert sorted(where) == [*range(drawn.program.variables)]
    given = {int(data.bounded[k]): int(row) for k, row in data.fixed}
    assert len(given) == NX
    for i, k in where.items():
        row = given.get(i)
        low, high = (start.g_lower[row], start.g_upper[row]) if row is not None else (start.lower[i], start.upper[i])
        assert (lower[k], upper[k]) == (max(low, -INFINITE), min(high, INFINITE))
    others = np.delete(np.arange(data.bounded.size), [*where.values()])
    assert (lower[others] == -INFINITE).all()
    assert (upper[others] == INFINITE).all()
    placed = data.rows_g >= 0
    assert least[placed].tolist() == start.g_lower[data.rows_g[placed]].tolist()
    assert most[placed].tolist() == start.g_upper[data.rows_g[placed]].tolist()
    assert not least[~placed].any()
    assert not most[~placed].any()


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("size", [0.5, 20.0])
def test_a_start_beyond_a_bound_is_named_unless_it_is_rounding(seed: int, size: float) -> None:
    """By 2e-8 of its size it is beyond, by 0.5e-8 it is on the bound."""
    drawn = draw(seed)
    data = build(drawn.program, double_integrator())
    for variable, row in data.fixed.tolist():
        i = int(data.bounded[variable])
        for sign in (1.0, -1.0):
            for part, is_beyond in ((2e-8, True), (0.5e-8, False), (-0.1, False)):
                start = drawn.start
                lower, upper = np.full(start.lower.size, -np.inf), np.full(start.upper.size, np.inf)
                (upper if sign > 0 else lower)[i] = sign * size
                value = sign * size * (1 + part * max(1.0, size) / size)
                least, most = start.g_lower.copy(), start.g_upper.copy()
                least[row] = most[row] = value
                numbers = Numbers(start.parameters, lower, upper, least, most)
                assert find_crossed(data, numbers) == ((row,) if is_beyond else ())
                low, high, *_ = set_bounds(data, numbers)
                assert low[variable] == high[variable]
