"""Certificates of optimality: programs whose multipliers and curvatures are known, and a solved problem."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy import sparse

from mbsrun.external import load
from mbsrun.ocp.solution.solution import Solution
from mbsrun.ocp.solving.certificate import Point, certify, certify_motion, find_multipliers, is_convex_on
from mbsrun.ocp.solving.solve import Solver, solve
from mbsrun.ocp.statement.statement import read_problem
from tests.shipped import FOLDER


def point(gradient: list[float], equations: list[list[float]], bounds: list[list[float]]) -> Point:
    """State a point of a program of two variables, on its near bounds."""
    rows = [sparse.csc_array(np.reshape(np.array(part, dtype=float), (-1, 2))) for part in (equations, bounds)]
    return Point(np.array(gradient), rows[0], rows[1], np.zeros(len(bounds)), 0.0)


def test_multipliers_of_an_equation_and_a_bound_are_the_known_ones() -> None:
    """Minimise x + 3 y such that x + y = 1, y >= 0: lam = -1, z = 2 at (1, 0)."""
    lam, z = find_multipliers(point([1, 3], [[1, 1]], [[0, 1]]))
    assert lam == pytest.approx([-1])
    assert z == pytest.approx([2])


def test_a_bound_that_would_have_to_pull_leaves_the_first_order_condition() -> None:
    """Minimise x - y such that y >= 0: at (0, 0) the cost falls with y, which no z >= 0 balances."""
    found = certify(point([0, -1], [], [[0, 1]]), lambda *_: sparse.csc_array(np.eye(2)))
    assert found.stationarity == pytest.approx(1)
    assert found.active == 0


@pytest.mark.parametrize(
    ("equations", "bounds", "expected"),
    [([], [], False), ([[0, 1]], [], True), ([[1, 0]], [], False), ([], [[0, 1]], True)],
)
def test_a_saddle_is_a_minimum_only_where_constraints_hold_its_falling_direction(
    equations: list[list[float]], bounds: list[list[float]], expected: bool
) -> None:
    """The Hessian diag(1, -1) falls along y; equations, or bounds with a multiplier, may forbid that direction."""
    gradient = [0, 1] if bounds else [0, 0]
    saddle = sparse.csc_array(np.diag([1.0, -1.0]))
    assert certify(point(gradient, equations, bounds), lambda *_: saddle).is_minimum is expected


def test_convexity_on_a_null_space_agrees_with_eigenvalues() -> None:
    """Random Hessians and equations: the least eigenvalue of Z' H Z decides, Z a basis of the null space."""
    random = np.random.default_rng(3)
    seen = set()
    for _ in range(40):
        H, A = random.normal(size=(6, 6)) + 1.5 * np.eye(6), random.normal(size=(3, 6))
        basis = np.linalg.svd(A)[2][3:].T
        expected = bool(np.linalg.eigvalsh(basis.T @ (H + H.T) @ basis).min() > 0)
        assert is_convex_on(sparse.csc_array(H + H.T), sparse.csc_array(A)) is expected
        seen.add(expected)
    assert seen == {True, False}


def test_a_solution_is_certified_and_a_motion_beside_it_is_not() -> None:
    problem, plant = read_problem(FOLDER / "planar_arm_reach.ocp.yaml", load)
    found = solve(problem, plant)
    assert isinstance(found, Solution)
    solver = Solver(problem, plant)
    at = certify_motion(problem, solver, found.trajectory)
    assert at.is_minimum
    assert at.stationarity < 1e-5 * at.gradient
    assert at.violation < 1e-7
    beside = dataclasses.replace(found.trajectory, u=found.trajectory.u + 0.1)
    assert certify_motion(problem, solver, beside).stationarity > 1e3 * at.stationarity


def test_multipliers_of_bounds_on_either_side_balance_the_cost() -> None:
    """Inputs of 0.7 of the largest that the free motion takes, either way: both bounds are met."""
    problem, plant = read_problem(FOLDER / "planar_arm_reach.ocp.yaml", load)
    free = solve(problem, plant)
    assert isinstance(free, Solution)
    limits = 0.7 * np.abs(free.trajectory.u).max(axis=0)
    bounds = dataclasses.replace(problem.bounds, u=tuple((-float(x), float(x)) for x in limits))
    problem = dataclasses.replace(problem, bounds=bounds)
    found = solve(problem, plant)
    assert isinstance(found, Solution)
    near = np.array([np.abs(found.trajectory.u - side * limits).min() for side in (-1, 1)])
    assert (near < 1e-6).all()
    at = certify_motion(problem, Solver(problem, plant), found.trajectory)
    assert at.active > 0
    assert at.stationarity < 1e-3 * at.gradient  # bounds that are hardly met lie beyond the distance of near ones


def test_conditions_of_a_known_minimum_hold_with_the_multipliers_of_equations_and_bounds() -> None:
    """Minimise x + 3 y such that x + y = 1, y >= 0: grad f + J' lam - z = 0; beside it, what is left is named."""
    hessians: list[tuple[list[float], list[float]]] = []

    def note(lam: np.ndarray, z: np.ndarray) -> sparse.csc_array:
        hessians.append((lam.tolist(), z.tolist()))
        return sparse.csc_array(np.eye(2))

    own = dataclasses.replace(point([1, 3], [[1, 1]], [[0, 1]]), distances=np.array([-0.25]), violation=0.5)
    found = certify(own, note)
    assert found.stationarity == pytest.approx(0, abs=1e-12)
    assert (found.gradient, found.violation, found.active) == (3.0, 0.5, 1)
    assert found.complementarity == pytest.approx(2 * 0.25)
    ((lam, z),) = hessians
    assert lam == pytest.approx([-1])
    assert z == pytest.approx([2])
    assert certify(point([1, 3], [[1, 0]], []), note).stationarity == pytest.approx(3.0)


class Wrapped:
    """A number of CasADi: dense or sparse."""

    def __init__(self, values: object) -> None:
        self.values = np.array(values, dtype=float)

    def full(self) -> np.ndarray:
        return self.values

    def sparse(self) -> sparse.csc_array:
        return sparse.csc_array(self.values)


def test_rows_of_ranges_have_multipliers_with_the_signs_of_their_sides() -> None:
    """Minimise -x + 2 y + (x^2 + y^2)/2 with x + y <= 1 met, x - y >= 1 met, x <= 9 far, at (1, 0); costs over 4.

    grad f = (0, 2)/4 = z_1 (-1, -1) + z_2 (1, -1) has no z >= 0; with -2 y in place of 2 y, z_1 = z_2 = 1/4.
    """
    seen: list[np.ndarray] = []

    def hessian(_: object, __: object, scale: float, multipliers: np.ndarray) -> Wrapped:
        assert scale == 0.25
        seen.append(multipliers)
        return Wrapped([[1.0, 0.5], [0.0, 1.0]])

    for slope, left, rows in ((2.0, 0.5, [0.0, 0.0, 0.0]), (-2.0, 0.0, [0.25, -0.25, 0.0])):
        functions = SimpleNamespace(
            constraint=lambda *_: Wrapped([[1.0], [1.0], [5.0]]),
            jacobian=lambda *_: Wrapped([[1.0, 1.0], [1.0, -1.0], [0.0, 2.0]]),
            gradient=lambda *_, slope=slope: (None, Wrapped([[0.0], [slope]])),
            hessian=hessian,
        )
        transcription = SimpleNamespace(
            pack=lambda _: np.array([1.0, 0.0]),
            parameters=lambda _: None,
            variable_bounds=lambda _: (np.full(2, -np.inf), np.array([9.0, np.inf])),
            constraint_bounds=lambda _: (np.array([-np.inf, 1.0, 0.0]), np.array([1.0, np.inf, 9.0])),
        )
        solver: Any = SimpleNamespace(transcription=transcription, program=SimpleNamespace(casadi=functions))
        problem: Any = SimpleNamespace(cost=SimpleNamespace(weights=(1.0, -4.0)))
        found = certify_motion(problem, solver, None)  # type: ignore[arg-type]
        assert found.stationarity == pytest.approx(left, abs=1e-12)
        assert found.active == np.count_nonzero(rows)
        assert seen.pop() == pytest.approx(np.array(rows), abs=1e-12)
        assert found.violation == 0.0


def test_equations_have_multipliers_of_any_sign_and_violations_are_the_largest() -> None:
    """x - y = 1, violated by 0.5 at (1.5, 0), with a bound on y that is violated by 0.25."""
    seen: list[np.ndarray] = []

    def hessian(*given: Any) -> Wrapped:
        seen.append(given[3])
        return Wrapped(np.eye(2))

    functions = SimpleNamespace(
        constraint=lambda *_: Wrapped([[1.5]]),
        jacobian=lambda *_: Wrapped([[1.0, -1.0]]),
        gradient=lambda *_: (None, Wrapped([[3.0], [-3.0]])),
        hessian=hessian,
    )
    transcription = SimpleNamespace(
        pack=lambda _: np.array([1.5, 0.0]),
        parameters=lambda _: None,
        variable_bounds=lambda _: (np.array([-9.0, 0.25]), np.array([9.0, 9.0])),
        constraint_bounds=lambda _: (np.ones(1), np.ones(1)),
    )
    solver: Any = SimpleNamespace(transcription=transcription, program=SimpleNamespace(casadi=functions))
    problem: Any = SimpleNamespace(cost=SimpleNamespace(weights=(1.0,)))
    found = certify_motion(problem, solver, None)  # type: ignore[arg-type]
    assert found.stationarity == pytest.approx(0, abs=1e-9)
    assert (found.violation, found.gradient) == (0.5, 3.0)
    assert seen[0] == pytest.approx([-3.0])
