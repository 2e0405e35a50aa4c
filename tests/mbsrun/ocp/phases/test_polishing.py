"""A step onto equations, against closed forms."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy import sparse

from mbsrun.ocp.ground.functions import Array
from mbsrun.ocp.ground.program import Matrix
from mbsrun.ocp.solving.polishing import Equations, polish

NONE = np.full(3, np.inf)


def _evaluate(x: Array) -> Array:
    """Return the length of a vector, and its first entry again in a row that is no equation."""
    return np.array([x @ x, x[0]])


def _differentiate(x: Array) -> Matrix:
    return sparse.csc_array(np.array([2 * x, [1.0, 0.0, 0.0]]))


def _on_sphere(rows: float = np.inf, upper: Array = NONE) -> Equations:
    return Equations(_evaluate, _differentiate, (np.array([1.0, -np.inf]), np.array([1.0, rows])), (-NONE, upper))


def test_the_nearest_point_of_a_sphere_is_along_the_radius() -> None:
    """Newton's error is quadratic: of 1e-6 remains some 1e-12."""
    unit = np.array([2.0, -1.0, 2.0]) / 3
    moved = polish((1 + 1e-6) * unit, _on_sphere(), 1.0)
    assert np.abs(moved - unit).max() < 1e-12


def test_a_variable_at_its_bound_stays() -> None:
    x = np.array([0.6, 0.8 + 1e-7, 0.0])
    moved = polish(x, _on_sphere(upper=np.array([0.6, np.inf, np.inf])), 1.0)
    assert moved == pytest.approx([0.6, 0.8, 0.0], abs=1e-13)
    assert moved[0] == 0.6


def test_a_step_that_violates_another_row_is_not_taken() -> None:
    """Towards the sphere from within, the first entry would grow by 1e-5 beyond its range."""
    x = np.array([1 - 1e-5, 0.0, 0.0])
    assert polish(x, _on_sphere(rows=x[0]), 1e-6) is x


def solve_for(x: list[float], rows: list[float], right: list[float], most: float = 1.0, limits: Any = None) -> Array:
    """Polish the linear equations with these rows, in x of some size."""
    J, g = np.array([rows]), np.array(right)
    free = np.full(len(x), -np.inf), np.full(len(x), np.inf)
    own = Equations(lambda x: J @ x, lambda _: sparse.csc_array(J), (g, g), limits or free)
    return polish(np.array(x), own, most)


def test_equations_with_a_right_side_are_met_by_the_shortest_step() -> None:
    """x0 + x1 = 7: each takes the part of its size squared, 1 and 9 tenths; sizes are 1 at least."""
    assert solve_for([0.5, 3.0], [1.0, 1.0], [7.0], most=10.0) == pytest.approx([0.85, 6.15], abs=1e-12)
    assert solve_for([0.5, -3.0], [1.0, 1.0], [-7.0], most=10.0) == pytest.approx([0.05, -7.05], abs=1e-12)


def test_a_step_that_lowers_no_residual_is_not_taken() -> None:
    """Exact already, or with a slope of the wrong sign."""
    exact = np.array([3.0, 4.0])
    own = Equations(
        lambda x: x[:1] + x[1:], lambda _: sparse.csc_array([[1.0, 1.0]]), (np.array([7.0]),) * 2, (-NONE[:2], NONE[:2])
    )
    assert polish(exact, own, 1.0) is exact
    wrong = Equations(own.evaluate, lambda _: sparse.csc_array([[-1.0, -1.0]]), own.rows, own.variables)
    beside = np.array([3.0, 4.001])
    assert polish(beside, wrong, 1.0) is beside
    none = Equations(own.evaluate, lambda _: sparse.csc_array([[0.0, 0.0]]), own.rows, own.variables)
    assert polish(beside, none, 1.0) is beside


@pytest.mark.parametrize(("rows", "stays"), [(60, False), (61, True)])
def test_variables_of_more_than_sixty_rows_stay(rows: int, *, stays: bool) -> None:
    """x_k + T = 1 for all k: each x_k moves, and T does not where its rows are more than 60."""
    J = np.hstack((np.eye(rows), np.ones((rows, 1))))
    ones = np.ones(rows)
    free = np.full(rows + 1, -np.inf), np.full(rows + 1, np.inf)
    own = Equations(lambda x: J @ x, lambda _: sparse.csc_array(J), (ones, ones), free)
    x = np.append(np.full(rows, 0.25), 0.5)
    moved = polish(x, own, 1.0)
    assert bool(moved[-1] == 0.5) is stays
    assert J @ moved == pytest.approx(ones, abs=1e-10)


def test_a_variable_is_at_its_bound_within_a_millionth_of_its_size() -> None:
    for x, off, stays in ((2.0, 1.9e-6, True), (2.0, 2.1e-6, False), (0.5, 0.9e-6, True), (0.5, 1.1e-6, False)):
        for lower, upper in ((x - off, np.inf), (-np.inf, x + off)):
            limits = np.array([lower, -np.inf]), np.array([upper, np.inf])
            moved = solve_for([x, 1.0], [1.0, 1.0], [x + 1.0 + 1e-8], limits=limits)
            assert bool(moved[0] == x) is stays
            assert moved.sum() == pytest.approx(x + 1.0 + 1e-8, abs=1e-12)
