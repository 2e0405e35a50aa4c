"""Many small systems of equations, factorised in C."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from mbsrun.ocp.ground.factors import Factors


@pytest.mark.parametrize("n", [1, 2, 7, 24])
def test_systems_are_solved(n: int, requires: Callable[[str], str]) -> None:
    """A x = b and AT y = c to rounding, times the condition, whatever rows have to be exchanged."""
    requires("cc")
    rng = np.random.default_rng(n)
    A = rng.normal(size=(30, n, n)) * 10.0 ** rng.integers(-3, 4, (30, n, 1))
    A[:, 0, 0] = 0.0 if n > 1 else 1.0
    x, y = rng.normal(size=(30, n, 3)), rng.normal(size=(30, n))
    given = A.copy()
    factors, condition = Factors(A), np.linalg.cond(A).max()
    assert np.array_equal(A, given)
    assert factors.solve(A @ x) == pytest.approx(x, abs=16 * n * condition * np.finfo(float).eps)
    found = factors.solve_transposed((y[:, None] @ A)[:, 0])
    assert found == pytest.approx(y, abs=16 * n * condition * np.finfo(float).eps)


def test_a_singular_system_gives_no_numbers(requires: Callable[[str], str]) -> None:
    """And leaves the others alone."""
    requires("cc")
    A = np.stack((np.eye(2), np.ones((2, 2)), np.full((2, 2), np.nan), 2 * np.eye(2)))
    found = Factors(A).solve_transposed(np.ones((4, 2)))
    assert np.isfinite(found).all(axis=1).tolist() == [True, False, False, True]
    assert found[3] == pytest.approx([0.5, 0.5])
