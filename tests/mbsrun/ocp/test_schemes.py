"""Laws of collocation coefficients; the reference values are mpmath's and Butcher's tables."""

from __future__ import annotations

import mpmath
import numpy as np
import pytest

from mbsrun.ocp.ground import schemes
from mbsrun.ocp.ground.schemes import Family, Scheme

EPS = np.finfo(float).eps
ALL = [(family, degree) for family in Family for degree in schemes.DEGREES]


@pytest.fixture(params=ALL, ids=lambda p: f"{p[0].value}{p[1]}")
def scheme(request: pytest.FixtureRequest) -> Scheme:
    return schemes.build(*request.param)


def test_weights_sum_to_one(scheme: Scheme) -> None:
    """The integral of 1 is 1, at degree 1 too, where other tables give one half for Radau."""
    assert abs(scheme.weights.sum() - 1) < 1e-12


def test_quadrature_is_exact_up_to_its_degree_and_no_further(scheme: Scheme) -> None:
    """Gauss points integrate degree 2d - 1, Radau points 2d - 2, and miss the next degree by more than rounding."""
    for p in range(scheme.exactness + 1):
        assert abs(scheme.weights @ scheme.points**p - 1 / (p + 1)) < 100 * EPS
    p = scheme.exactness + 1
    assert abs(scheme.weights @ scheme.points**p - 1 / (p + 1)) > 1e-13


def test_derivatives_of_monomials(scheme: Scheme) -> None:
    """D differentiates every polynomial of degree <= d, up to a few roundings of its entries."""
    nodes = np.concatenate(([0.0], scheme.points))
    for p in range(scheme.degree + 1):
        exact = p * scheme.points ** max(p - 1, 0)
        assert np.abs(scheme.D @ nodes**p - exact).max() < 8 * EPS * np.abs(scheme.D).sum(axis=1).max()


def test_end_rows_extrapolate_monomials(scheme: Scheme) -> None:
    """The end rows give the value at 1 of a state, of degree d, and of an acceleration, of degree d - 1."""
    nodes = np.concatenate(([0.0], scheme.points))
    for p in range(scheme.degree + 1):
        assert abs(scheme.end @ nodes**p - 1) < 8 * EPS * np.abs(scheme.end).sum()
    for p in range(scheme.degree):
        assert abs(scheme.end_of_points @ scheme.points**p - 1) < 8 * EPS * np.abs(scheme.end_of_points).sum()


def test_weights_integrate_what_collocation_integrates(scheme: Scheme) -> None:
    """x(1) - x(0) = sum of weights times derivatives at the points: end row and weights belong together."""
    lift = np.linalg.solve(scheme.D[:, 1:], np.eye(scheme.degree))  # values at the points for x(0) = 0
    assert np.abs(scheme.end[1:] @ lift - scheme.weights).max() < 100 * EPS


@pytest.mark.parametrize("degree", schemes.DEGREES)
def test_radau_ends_at_one(degree: int) -> None:
    """The end row of Radau is exactly a unit vector, so that its zeros stay out of the sparsity."""
    scheme = schemes.build(Family.RADAU, degree)
    assert scheme.points[-1] == 1.0
    assert np.array_equal(scheme.end, np.eye(degree + 1)[-1])
    assert np.array_equal(scheme.end_of_points, np.eye(degree)[-1])


def test_no_entry_of_the_differentiation_matrix_vanishes(scheme: Scheme) -> None:
    """All of D is structural, so the pattern of a collocation equation is full in its nodes."""
    assert np.abs(scheme.D).min() > 1e-3


@pytest.mark.parametrize("degree", schemes.DEGREES)
def test_points_to_fifty_digits(degree: int) -> None:
    """Radau points are the roots of P_d - P_(d-1), Gauss points the roots of P_d, in 2 t - 1 (mpmath, 50 digits)."""
    with mpmath.workdps(50):
        for family in Family:
            for t in schemes.build(family, degree).points:
                x = 2 * mpmath.mpf(float(t)) - 1

                def f(x: mpmath.mpf, family: Family = family) -> mpmath.mpf:
                    lower = mpmath.legendre(degree - 1, x) if family is Family.RADAU else 0
                    return mpmath.legendre(degree, x) - lower

                assert abs(f(x) / mpmath.diff(f, x)) < 8 * EPS  # one Newton step to the root


def test_radau_two_is_butchers() -> None:
    """Radau IIA of order 3: c = (1/3, 1), b = (3/4, 1/4)."""
    scheme = schemes.build(Family.RADAU, 2)
    assert scheme.points == pytest.approx([1 / 3, 1], abs=2 * EPS)
    assert scheme.weights == pytest.approx([3 / 4, 1 / 4], abs=2 * EPS)


@pytest.mark.parametrize("degree", [0, 10, -1])
def test_degrees_outside_the_range_are_refused(degree: int) -> None:
    with pytest.raises(ValueError, match="not in 1"):
        schemes.build(Family.RADAU, degree)
