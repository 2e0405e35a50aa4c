"""Laws of collocation coefficients; the reference values are mpmath's and Butcher's tables."""

from __future__ import annotations

import math

import mpmath
import numpy as np
import pytest

from mbsrun.ocp.ground import schemes
from mbsrun.ocp.ground.schemes import Family, Scheme

EPS = np.finfo(float).eps
ALL = [(family, degree) for family in Family for degree in schemes.list_degrees(family)]


@pytest.fixture(params=ALL, ids=lambda p: f"{p[0].value}{p[1]}")
def scheme(request: pytest.FixtureRequest) -> Scheme:
    return schemes.build(*request.param)


def list_values(scheme: Scheme, p: int) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """List the numbers that determine t^p: its value at 0, then the ones at the points; of Lobatto, a slope first."""
    nodes = np.concatenate(([0.0], scheme.points)) ** p
    if scheme.begins_interval:
        nodes[1] = float(p == 1)
    return nodes


def test_weights_sum_to_one(scheme: Scheme) -> None:
    """The integral of 1 is 1, at degree 1 too, where other tables give one half for Radau."""
    assert abs(scheme.weights.sum() - 1) < 1e-12


def test_quadrature_is_exact_up_to_its_degree_and_no_further(scheme: Scheme) -> None:
    """Gauss points integrate degree 2d - 1, Radau's 2d - 2, Lobatto's 2d - 3, and no higher one."""
    for p in range(scheme.exactness + 1):
        assert abs(scheme.weights @ scheme.points**p - 1 / (p + 1)) < 100 * EPS
    p = scheme.exactness + 1
    assert abs(scheme.weights @ scheme.points**p - 1 / (p + 1)) > 1e-13


def test_derivatives_of_monomials(scheme: Scheme) -> None:
    """D differentiates every polynomial of degree <= d, up to a few roundings of its entries."""
    for p in range(scheme.degree + 1):
        exact = p * scheme.points ** max(p - 1, 0)
        assert np.abs(scheme.D @ list_values(scheme, p) - exact).max() < 8 * EPS * np.abs(scheme.D).sum(axis=1).max()


def test_end_rows_extrapolate_monomials(scheme: Scheme) -> None:
    """The end rows give the value at 1 of a state, of degree d, and of an acceleration, of degree d - 1."""
    for p in range(scheme.degree + 1):
        assert abs(scheme.end @ list_values(scheme, p) - 1) < 8 * EPS * np.abs(scheme.end).sum()
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
    """All of D is structural, so the pattern of a collocation equation is full in its nodes; a slope is a variable."""
    assert np.abs(scheme.D[int(scheme.begins_interval) :]).min() > 1e-3
    if scheme.begins_interval:
        assert np.array_equal(scheme.D[0], np.eye(scheme.degree + 1)[1])


@pytest.mark.parametrize("degree", schemes.DEGREES)
def test_points_to_fifty_digits(degree: int) -> None:
    """Radau points are the roots of P_d - P_(d-1), Gauss points the roots of P_d, in 2 t - 1 (mpmath, 50 digits)."""
    with mpmath.workdps(50):
        for family in (Family.RADAU, Family.LEGENDRE):
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


@pytest.mark.parametrize(
    ("degree", "numerators", "denominator"),
    [(2, [[0, 0], [1, 1]], 2), (3, [[0, 0, 0], [5, 8, -1], [4, 16, 4]], 24)],
)
def test_lobatto_has_its_matrix(degree: int, numerators: list[list[int]], denominator: int) -> None:
    """Lobatto IIIA: Hairer, Wanner, table IV.5.7; the trapezoidal rule, and Hermite and Simpson's."""
    scheme = schemes.build(Family.LOBATTO, degree)
    assert scheme.integration == pytest.approx(np.array(numerators) / denominator, abs=4 * EPS)
    assert scheme.order == 2 * degree - 2


@pytest.mark.parametrize("degree", range(2, 10))
def test_lobatto_points_to_fifty_digits(degree: int) -> None:
    """The inner ones are the roots of the derivative of P_(d-1) (mpmath, 50 digits)."""
    points = schemes.build(Family.LOBATTO, degree).points
    assert (points[0], points[-1]) == (0.0, 1.0)
    with mpmath.workdps(50):
        for t in points[1:-1]:

            def slope(x: mpmath.mpf) -> mpmath.mpf:
                return mpmath.diff(lambda y: mpmath.legendre(degree - 1, y), x)

            x = 2 * mpmath.mpf(float(t)) - 1
            assert abs(slope(x) / mpmath.diff(slope, x)) < 16 * EPS


@pytest.mark.parametrize("degree", [0, 10, -1])
def test_degrees_outside_the_range_are_refused(degree: int) -> None:
    with pytest.raises(ValueError, match="not in 1"):
        schemes.build(Family.RADAU, degree)


@pytest.mark.parametrize("moment", range(4))
def test_integrals_of_bases_are_exact(scheme: Scheme, moment: int) -> None:
    """The integral of (c - s)^m s^p from 0 to c is c^(m + p + 1) m! p! / (m + p + 1)!."""
    nodes, places = np.concatenate(([0.0], np.unique(scheme.points[scheme.points > 0]))), np.array([0.3, 1.0])
    rows = schemes.integrate_basis(nodes, places, moment)
    for p in range(len(nodes)):
        beta = math.factorial(moment) * math.factorial(p) / math.factorial(moment + p + 1)
        assert rows @ nodes**p == pytest.approx(beta * places ** (moment + p + 1), rel=1e-11, abs=1e-14)
