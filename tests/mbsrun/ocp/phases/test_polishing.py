"""A step onto equations, against closed forms."""

from __future__ import annotations

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
