"""Coefficients of Runge-Kutta methods are SciPy's; Radau points are roots of Jacobi's polynomials."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import integrate
from scipy.special import roots_jacobi

from mbsrun.ocp.ground import schemes
from mbsrun.simulation.integration.tableaus import DOP853, EULER, FIXED, RK4, RK45, Pair


def test_dormand_and_princes_methods_are_scipys() -> None:
    stages = len(integrate.DOP853.B)
    assert np.array_equal(DOP853.tableau.A, integrate.DOP853.A[:stages, :stages])
    assert np.array_equal(DOP853.tableau.b, integrate.DOP853.B)
    assert np.array_equal(DOP853.E, [integrate.DOP853.E5[:stages], integrate.DOP853.E3[:stages]])
    A = np.zeros((7, 7))
    A[:6, :5], A[6, :6] = integrate.RK45.A, integrate.RK45.B
    assert np.allclose(RK45.tableau.A, A, rtol=4e-16, atol=0)
    assert np.allclose(RK45.E, [integrate.RK45.E], rtol=4e-16, atol=0)


@pytest.mark.parametrize(("pair", "order"), [(EULER, 1), (RK4, 4), (RK45, 5), (DOP853, 8)])
def test_methods_meet_the_conditions_of_their_orders(pair: Pair, order: int) -> None:
    """Of all rooted trees of at most four nodes, and of the bushy ones: sums of weights by 1 / density.

    Hairer, Norsett, Wanner, section II.2. An explicit method reads the stages before alone.
    """
    A, b, c = np.array(pair.tableau.A), np.array(pair.tableau.b), pair.tableau.c
    assert np.array_equal(A, np.tril(A, -1))
    trees = {1: [(b.sum(), 1)], 2: [(b @ c, 2)], 3: [(b @ c**2, 3), (b @ A @ c, 6)]}
    trees[4] = [(b @ c**3, 4), (b @ (c * (A @ c)), 8), (b @ A @ c**2, 12), (b @ A @ A @ c, 24)]
    trees |= {k: [(b @ c ** (k - 1), k)] for k in range(5, 9)}
    for k in range(1, order + 1):
        for found, density in trees[k]:
            assert found == pytest.approx(1 / density, rel=1e-13)
    if order + 1 in trees:
        assert any(abs(found * density - 1) > 1e-3 for found, density in trees[order + 1])


def test_errors_are_estimated_to_their_orders() -> None:
    """Orders are of the lower methods, plus 1. Where rates are constant there is no error."""
    assert (RK45.order, DOP853.order) == (5, 8)
    assert (EULER.E, EULER.order, RK4.E, RK4.order) == ((), 0, (), 0)
    assert dict(FIXED) == {"euler": EULER.tableau, "rk4": RK4.tableau}
    for estimate in (*RK45.E, *DOP853.E):
        assert sum(estimate) == pytest.approx(0.0, abs=1e-14)


@pytest.mark.parametrize("degree", schemes.DEGREES)
def test_radau_points_are_roots_of_jacobis_polynomials(degree: int) -> None:
    points = schemes.build(schemes.Family.RADAU, degree).points
    inner = roots_jacobi(degree - 1, 1, 0)[0] if degree > 1 else np.empty(0)
    assert points == pytest.approx(np.append((inner + 1) / 2, 1.0), rel=4e-16)
