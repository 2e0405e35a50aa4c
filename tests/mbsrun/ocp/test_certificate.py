"""Certificates of optimality: programs whose multipliers and curvatures are known, and a solved problem."""

from __future__ import annotations

import dataclasses

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
