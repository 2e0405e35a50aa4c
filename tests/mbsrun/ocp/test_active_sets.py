"""Optima with their active sets, and their movement, of random quadratic programs: against all active sets."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import sparse

from mbsrun.ocp.evaluation.backends.prepared import Prepared
from mbsrun.ocp.ground.program import Matrix, Program
from mbsrun.ocp.methods import Instance
from mbsrun.ocp.optima.movement import Movement, Numbers
from mbsrun.ocp.optima.neighbours import move_one_sided, predict
from mbsrun.ocp.optima.point import Optimum, _Search, find_optimum
from mbsrun.ocp.optima.status import CHANGING, DEPENDENT, FLAT, NOT_CONVERGED, SMOOTH
from mbsrun.ocp.optima.thinning import thin

Array = NDArray[np.float64]
SCALE = 0.5  # of the cost
NONE = np.inf


@dataclass(frozen=True, eq=False)
class Quadratic:
    """Minimise w1 x'Hx/2 + w2 c'x with limits of x and of A x, and a first row that is an equation."""

    H: Array
    c: Array
    A: Array
    w: Array
    lower: Array
    upper: Array
    least: Array
    most: Array

    # --- as the search calls a program ---

    def terms(self, x: Array, _: Array) -> Array:
        return np.array([x @ self.H @ x / 2, self.c @ x])

    def gradient(self, x: Array, w: Array) -> Array:
        return np.asarray(w[0] * self.H @ x + w[1] * self.c)

    def constraint(self, x: Array, _: Array) -> Array:
        return np.asarray(self.A @ x)

    def jacobian(self, *_: Array) -> Matrix:
        return Matrix(sparse.csc_array(self.A))

    def hessian(self, _: Array, w: Array, factor: float, __: Array) -> Matrix:
        return Matrix(sparse.csc_array(np.triu(factor * w[0] * self.H)))

    # --- by hand ---

    def solve(self) -> tuple[Array, Array]:
        """Return the solution and the multipliers of rows: the only active set that meets all conditions."""
        n, m = self.c.size, self.least.size
        low, high = np.append(self.lower, self.least), np.append(self.upper, self.most)
        sides = [
            (2,) if a == b else (0, *((-1,) if a > -NONE else ()), *((1,) if b < NONE else ()))
            for a, b in zip(low, high, strict=True)
        ]
        G = np.vstack((np.eye(n), self.A))
        for chosen in product(*sides):
            at = np.flatnonzero(chosen)
            goal = np.where(np.array(chosen)[at] == 1, high[at], low[at])
            K = np.block([[self.w[0] * self.H, G[at].T], [G[at], np.zeros((at.size, at.size))]])
            if at.size > n or np.linalg.matrix_rank(K) < len(K):
                continue
            found = np.linalg.solve(K, np.concatenate((-self.w[1] * self.c, goal)))
            x, force = found[:n], np.zeros(n + m)
            force[at] = found[n:]
            values, side = G @ x, np.array(chosen)
            if (values < low - 1e-9).any() or (values > high + 1e-9).any():
                continue
            if (force[side == -1] <= 1e-9).all() and (force[side == 1] >= -1e-9).all():
                return x, force[n:]
        raise AssertionError("a convex program within limits has a solution")

    def move(self, change: Numbers, by: float) -> Quadratic:
        """Return the program with other numbers."""
        parts = (self.w, self.lower, self.upper, self.least, self.most)
        names = ("w", "lower", "upper", "least", "most")
        return replace(self, **{k: a + by * d for k, a, d in zip(names, parts, change.parts, strict=True)})


def draw(rng: np.random.Generator) -> Quadratic:
    """Draw a program of four variables and two rows, some of whose limits are open."""
    root = rng.normal(size=(4, 4))
    inside, A = rng.normal(size=4), rng.normal(size=(2, 4))
    gaps = np.where(rng.random((4, 4)) < 0.3, NONE, rng.uniform(0.05, 1.5, (4, 4)))
    lower, upper = inside - gaps[0], inside + gaps[1]
    least, most = A @ inside - gaps[2, :2], A @ inside + gaps[3, :2]
    least[0] = most[0] = A[0] @ inside
    c, w = 3 * rng.normal(size=4), rng.uniform(0.5, 2, 2)
    return Quadratic(root @ root.T + 0.2 * np.eye(4), c, A, w, lower, upper, least, most)


def draw_change(task: Quadratic, rng: np.random.Generator) -> Numbers:
    """Draw rates of the linear cost and of limits; both of an equation move alike."""
    lower, upper, least, most = (
        np.where(np.isfinite(x), rng.normal(size=x.size), 0.0) for x in (task.lower, task.upper, task.least, task.most)
    )
    least[0] = most[0]
    return Numbers(np.array([0.0, rng.normal()]), lower, upper, least, most)


def find(task: Quadratic, off: float = 1e-7) -> Optimum:
    """Search from a solution that is off by some digits."""
    x, lam = task.solve()
    noise = np.random.default_rng(1)
    n, m = x.size, lam.size
    x, lam = x + off * noise.normal(size=n), lam + off * noise.normal(size=m)
    none = sparse.csc_array((n, n))
    program = Program(sparse.csc_array(task.A), (none, none), ())
    start = Instance(x, task.w, task.lower, task.upper, task.least, task.most)
    return find_optimum(task, program, start, SCALE, (x, lam))


def follow(task: Quadratic, *changes: Numbers) -> Movement:
    prepared = SimpleNamespace(data=SimpleNamespace(H=(0, 0)), numpy=task)
    return Movement(cast(Prepared, cast(Any, prepared)), find(task), changes)


@pytest.mark.parametrize("off", [1e-7, 3e-6, 1e-4])
def test_an_optimum_and_its_multipliers_are_exact(off: float, rng: np.random.Generator) -> None:
    """From an answer of a few digits; the sides of limits have the signs of their multipliers."""
    for _ in range(12):
        task = draw(rng)
        found = find(task, off)
        x, lam = task.solve()
        assert found.status == SMOOTH
        assert found.x == pytest.approx(x, abs=1e-11)
        assert found.multipliers == pytest.approx(SCALE * lam, abs=1e-10)
        slope = SCALE * task.gradient(x, task.w) + task.A.T @ (SCALE * lam)
        assert found.zeta == pytest.approx(slope, abs=1e-10)
        assert found.active.variables.tolist() == [-1 if z > 1e-9 else 1 if z < -1e-9 else 0 for z in slope]
        assert found.active.rows.tolist() == [2, 1 if lam[1] > 1e-9 else -1 if lam[1] < -1e-9 else 0]
        assert found.moved == pytest.approx(
            np.abs((x - found.instance.x) / np.maximum(1, np.abs(found.instance.x))).max()
        )


def test_derivatives_are_the_differences_of_optima(rng: np.random.Generator) -> None:
    """While the active set stays, optima of a quadratic program move along straight lines; adjoints agree."""
    for _ in range(10):
        task = draw(rng)
        change = draw_change(task, rng)
        movement, h = follow(task, change), 1e-6
        ahead, behind = (task.move(change, step).solve()[0] for step in (h, -h))
        moved = movement.move(0)
        assert movement.find_status(0) == SMOOTH
        assert moved == pytest.approx((ahead - behind) / (2 * h), abs=1e-6)
        gradient = rng.normal(size=4)
        assert movement.pull(gradient) == pytest.approx([gradient @ moved], rel=1e-9, abs=1e-9)
        costs = [new.w @ new.terms(new.solve()[0], new.w) for step in (h, -h) for new in [task.move(change, step)]]
        assert movement.find_costs() == pytest.approx([(costs[0] - costs[1]) / (2 * h)], rel=1e-5, abs=1e-6)


def test_predictions_follow_changes_of_the_active_set(rng: np.random.Generator) -> None:
    """The optimum of a quadratic program after a finite change, by however many limits that begin or cease to act."""
    changes = []
    for _ in range(25):
        task = draw(rng)
        change = draw_change(task, rng)
        by = 0.02
        while by < 0.4 and (task.move(change, 2 * by).lower < task.move(change, 2 * by).upper).all():
            by *= 2
        goal = task.move(change, by)
        if (goal.lower >= goal.upper).any() or goal.least[1] >= goal.most[1]:
            continue
        try:
            x = goal.solve()[0]
        except AssertionError:  # limits that contradict each other
            continue
        found = predict(follow(task, change), [by])
        if found.status == FLAT:  # a limit takes the place of another one
            continue
        assert found.status == SMOOTH
        assert task.solve()[0] + found.dx == pytest.approx(x, abs=1e-8)
        changes.append(found.changes)
    assert len(changes) > 10
    assert max(changes) > 1


@pytest.mark.parametrize("side", [-1, 1])
@pytest.mark.parametrize("of_row", [False, True])
def test_a_limit_without_a_force_has_derivatives_of_one_side(side: int, of_row: bool, rng: np.random.Generator) -> None:
    """A limit is put where the solution without it lies: it acts in one direction of a change, and not in the other."""
    for _ in range(8):
        task = draw(rng)
        name = ("most" if of_row else "upper") if side == 1 else ("least" if of_row else "lower")
        free = task.solve()[0]
        inner = np.flatnonzero((free > task.lower + 1e-3) & (free < task.upper - 1e-3))
        held = abs(task.solve()[1][1]) > 1e-9
        if inner.size < 3 + held or (of_row and held):  # others give the variables already
            continue
        at = 1 if of_row else int(inner[0])
        value = (task.A @ free)[1] if of_row else free[at]
        limit = getattr(task, name).copy()
        limit[at] = value
        task = replace(task, **{name: limit})
        change, h = draw_change(task, rng), 1e-5
        movement = follow(task, change)
        assert movement.optimum.status == CHANGING
        weak = movement.optimum.weak.rows if of_row else movement.optimum.weak.variables
        assert weak[at] == side
        for direction in (1.0, -1.0):
            found = move_one_sided(movement, [direction])
            x = task.move(change, direction * h).solve()[0]
            assert found.status == SMOOTH
            assert found.dx == pytest.approx((x - free) / h, abs=1e-5)


def test_optima_without_a_derivative_say_why() -> None:
    """A direction that costs nothing, and two rows that say the same."""
    none, one = np.full(2, NONE), np.array([1.0, 1.0])
    flat = Quadratic(np.diag([1.0, 0.0]), np.zeros(2), np.array([[1.0, 0.0]]), one, -none, none, one[:1], one[:1])
    start = Instance(np.array([1.0, 0.3]), one, flat.lower, flat.upper, flat.least, flat.most)
    program = Program(sparse.csc_array(flat.A), (sparse.csc_array((2, 2)),) * 2, ())
    assert find_optimum(flat, program, start, 1.0, (start.x, np.array([-1.0]))).status in (FLAT, DEPENDENT)
    saddle = replace(flat, H=np.diag([1.0, -1.0]))
    start = replace(start, x=np.array([1.0, 0.0]))
    assert find_optimum(saddle, program, start, 1.0, (start.x, np.array([-1.0]))).status == FLAT
    twice = replace(flat, H=np.eye(2), A=np.array([[1.0, 0], [2.0, 0]]), least=one * [1, 2], most=one * [1, 2])
    program = replace(program, A=sparse.csc_array(twice.A))
    start = replace(start, g_lower=twice.least, g_upper=twice.most)
    assert find_optimum(twice, program, start, 1.0, (start.x, np.array([-1.0, 0.0]))).status == DEPENDENT


def imply(task: Quadratic, rng: np.random.Generator) -> tuple[Quadratic, float]:
    """Make the second row a multiple of the first, which is an equation: its limit there is implied."""
    factor = float(rng.choice([-1, 1]) * rng.uniform(0.5, 2.0))
    A = np.stack((task.A[0], factor * task.A[0]))
    limits = {"least": np.array([task.least[0], -NONE]), "most": np.array([task.most[0], NONE])}
    limits["most" if rng.random() < 0.5 else "least"][1] = factor * task.least[0]
    return replace(task, A=A, **limits), factor


def open_row(task: Quadratic) -> Quadratic:
    """Leave out the limits of the second row."""
    return replace(task, least=np.array([task.least[0], -NONE]), most=np.array([task.most[0], NONE]))


def find_implied(task: Quadratic, share: float) -> Optimum:
    """Search with multipliers of which the implied limit has a share."""
    x, lam = open_row(task).solve()
    side, factor = (1.0 if np.isfinite(task.most[1]) else -1.0), task.A[1, 0] / task.A[0, 0]
    lam = np.array([lam[0] - side * share * factor, side * share])
    none = sparse.csc_array((4, 4))
    program = Program(sparse.csc_array(task.A), (none, none), ())
    start = Instance(x, task.w, task.lower, task.upper, task.least, task.most)
    return find_optimum(task, program, start, SCALE, (x, lam))


@pytest.mark.parametrize("status", [DEPENDENT, NOT_CONVERGED])
def test_implied_limits_are_left_out_however_the_search_fails(
    status: str, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By rounding, dependent limits are seen to be so, or lead away."""
    task, _ = imply(draw(rng), rng)
    monkeypatch.setattr(_Search, "_guess", lambda *_: status)
    found = find_implied(task, 0.3)
    assert found.status == SMOOTH
    assert found.x == pytest.approx(open_row(task).solve()[0], abs=1e-10)


@pytest.mark.parametrize("share", [0.0, 0.3, 40.0])
def test_a_limit_that_others_imply_keeps_derivatives(share: float, rng: np.random.Generator) -> None:
    """They are the ones without this limit while it moves with the equation; else it is passed, or opens."""
    for _ in range(8):
        task, factor = imply(draw(rng), rng)
        alone = open_row(task)
        change = draw_change(task, rng)
        moved, opening = change.least[0] * np.array([1, factor]), 0.1 if np.isfinite(task.most[1]) else -0.1
        along, opened, passed = (
            replace(change, least=limits, most=limits)
            for limits in (moved + np.array([0, by]) for by in (0.0, opening, -opening))
        )
        prepared = SimpleNamespace(data=SimpleNamespace(H=(0, 0)), numpy=task)
        movement = Movement(cast(Prepared, cast(Any, prepared)), find_implied(task, share), (along, opened, passed))
        assert movement.status == SMOOTH
        assert movement.optimum.implied.rows.tolist() == [0, np.sign(opening)]
        assert movement.optimum.x == pytest.approx(alone.solve()[0], abs=1e-10)
        h = 1e-6
        ahead, behind = (alone.move(along, step).solve()[0] for step in (h, -h))
        assert [movement.find_status(k) for k in range(3)] == [SMOOTH, CHANGING, CHANGING]
        assert movement.move(0) == pytest.approx((ahead - behind) / (2 * h), abs=1e-6)
        assert move_one_sided(movement, [0, 1.0, 0]).dx == pytest.approx(movement.move(0), abs=1e-9)
        assert move_one_sided(movement, [0, 0, 1.0]).status == DEPENDENT
        assert predict(movement, [0, h, 0]).dx == pytest.approx(h * movement.move(0), abs=1e-12)


def test_an_implied_limit_is_found_beside_equations_that_nearly_depend(rng: np.random.Generator) -> None:
    """Twenty equations are a millionth from depending on twenty others; the last row depends on them indeed."""
    first, noise = rng.standard_normal((2, 20, 60))
    A = np.concatenate((first, first + 1e-6 * noise))
    A = np.concatenate((A, [rng.standard_normal(40) @ A]))
    sides = np.array([2] * 40 + [1], dtype=np.int8)
    lam = np.append(rng.standard_normal(40), 1.0)
    left = thin(sparse.csr_array(A), np.zeros(60, np.int8), sides, lam, np.zeros(60))
    assert left is not None
    assert left.rows.tolist() == [2] * 40 + [0]
    assert left.lam @ A == pytest.approx(lam @ A, abs=1e-6)


def test_a_derivative_of_an_active_set_that_stays_too_short_is_none(rng: np.random.Generator) -> None:
    """A number has its derivative where it may move by its span, to either side, before the first limit changes."""
    for _ in range(8):
        task = draw(rng)
        change = draw_change(task, rng)
        free = follow(task, change)
        reach = free.measure_reach(0)
        for side in (1.0, -1.0):
            near = task.move(change, side * reach * (1 - 1e-6))
            assert find(near).active.is_same(free.optimum.active)
        sets = [find(task.move(change, side * reach * (1 + 1e-4))).active for side in (1.0, -1.0)]
        assert not all(x.is_same(free.optimum.active) for x in sets)
        for factor, status in ((1 - 1e-9, SMOOTH), (1 + 1e-9, CHANGING)):
            assert replace(free, spans=(factor * reach,)).find_status(0) == status


def test_variables_that_a_row_makes_equal_share_their_tightest_bounds() -> None:
    """x0 = x1 with different limits: the one that acts is held, once."""
    A, one = np.array([[1.0, -1.0]]), np.array([1.0, 1.0])
    for lower, held in (([0.5, 0.4], [-1, 0]), ([0.4, 0.5], [0, -1])):
        task = Quadratic(np.eye(2), np.zeros(2), A, one, np.array(lower), one * 2, np.zeros(1), np.zeros(1))
        program = Program(sparse.csc_array(A), (sparse.csc_array((2, 2)),) * 2, ())
        start = Instance(one / 2, one, task.lower, task.upper, task.least, task.most)
        found = find_optimum(task, program, start, 1.0, (start.x, np.array([0.0])))
        assert found.status == SMOOTH
        assert found.x == pytest.approx([0.5, 0.5], abs=1e-12)
        assert found.active.variables.tolist() == held
        assert sorted(found.limits.upper) == [2.0, NONE]
        assert found.limits.ties[0] == found.limits.ties[1]
        assert np.abs(found.zeta).max() == pytest.approx(1.0, abs=1e-12)
