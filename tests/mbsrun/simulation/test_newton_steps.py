"""Newton's steps of implicit methods, and derivatives of kernels that have no entry."""

from __future__ import annotations

import numpy as np
import pytest

from mbsrun.simulation.integration.multipliers import _pick, solve_step


def test_a_step_solves_the_linear_equations(rng: np.random.Generator) -> None:
    matrix, right = rng.standard_normal((5, 5)), rng.standard_normal(5)
    assert matrix @ solve_step(matrix, right) == pytest.approx(-right, abs=1e-12)


def test_a_step_of_a_singular_matrix_has_the_least_norm() -> None:
    """Of all steps that leave the smallest residual; parts of 1e-12 of the largest are rounding."""
    matrix, right = np.array([[2.0, 2.0], [0.0, 0.0]]), np.array([4.0, 3.0])
    assert solve_step(matrix, right) == pytest.approx([-1.0, -1.0], abs=1e-14)
    zeros = np.diag([1.0, 0.5e-12, 0.0])
    assert solve_step(zeros, np.array([1.0, 1.0, 0.0])) == pytest.approx([-1.0, 0.0, 0.0])
    small = np.diag([1.0, 2e-12, 0.0])
    assert solve_step(small, np.array([1.0, 1.0, 0.0])) == pytest.approx([-1.0, -5e11, 0.0])


def test_a_derivative_without_entries_is_zero() -> None:
    known = np.arange(6.0).reshape(1, 2, 3)
    assert _pick({"jac_Phi_q": known}, "Phi", "q", (1, 2, 3)) is known
    assert np.array_equal(_pick({"jac_Phi_q": known}, "Phi", "qd", (1, 2, 3)), np.zeros((1, 2, 3)))
