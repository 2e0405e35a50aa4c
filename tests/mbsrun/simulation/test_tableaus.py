"""Coefficients of Runge-Kutta methods are SciPy's; Radau points are roots of Jacobi's polynomials."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import integrate
from scipy.special import roots_jacobi

from mbsrun.ocp.ground import schemes
from mbsrun.simulation.integration.tableaus import DOP853, RK45


def test_dormand_and_princes_methods_are_scipys() -> None:
    stages = len(integrate.DOP853.B)
    assert np.array_equal(DOP853.tableau.A, integrate.DOP853.A[:stages, :stages])
    assert np.array_equal(DOP853.tableau.b, integrate.DOP853.B)
    assert np.array_equal(DOP853.E, [integrate.DOP853.E5[:stages], integrate.DOP853.E3[:stages]])
    A = np.zeros((7, 7))
    A[:6, :5], A[6, :6] = integrate.RK45.A, integrate.RK45.B
    assert np.allclose(RK45.tableau.A, A, rtol=4e-16, atol=0)
    assert np.allclose(RK45.E, [integrate.RK45.E], rtol=4e-16, atol=0)


@pytest.mark.parametrize("degree", schemes.DEGREES)
def test_radau_points_are_roots_of_jacobis_polynomials(degree: int) -> None:
    points = schemes.build(schemes.Family.RADAU, degree).points
    inner = roots_jacobi(degree - 1, 1, 0)[0] if degree > 1 else np.empty(0)
    assert points == pytest.approx(np.append((inner + 1) / 2, 1.0), rel=4e-16)
