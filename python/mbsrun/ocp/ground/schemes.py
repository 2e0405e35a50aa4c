"""Collocation on [0, 1]: (family, degree) -> points, differentiation matrix, end row, quadrature weights.

A state is the polynomial of degree d through its values at 0 and at the d collocation points; an algebraic variable the
one of degree d - 1 through its values at the points. Points are Gauss-Radau points (the last is 1), Gauss-Legendre
points, or Gauss-Lobatto points (the first is 0, the last is 1). At Lobatto's first point the value is the one at 0, and
the slope at 0 takes its place among the numbers that determine a state: Lobatto IIIA, of which degree 3 is Hermite
and Simpson's rule, degree 2 the trapezoidal rule (Hairer, Wanner, "Solving ordinary differential equations II",
section IV.5).
Everything is computed from barycentric weights and Legendre polynomials, which keep their digits at every degree in
DEGREES: Berrut, Trefethen, "Barycentric Lagrange interpolation", SIAM Review 46 (2004), section 9.3.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum
from functools import cache

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray

Array = NDArray[np.float64]

DEGREES = range(1, 10)

_RADAU = (  # by degree: the roots in (0, 1) of Jacobi's polynomials with exponents 1 and 0, on [0, 1]
    (),
    (0.33333333333333337,),
    (0.15505102572168217, 0.6449489742783179),
    (0.08858795951270393, 0.40946686444073477, 0.787659461760847),
    (0.057104196114517725, 0.2768430136381238, 0.5835904323689168, 0.8602401356562195),
    (0.03980985705146872, 0.1980134178736082, 0.43797481024738616, 0.6954642733536361, 0.9014649142011736),
    (
        0.02931642715978494,
        0.1480785996684843,
        0.3369846902811543,
        0.5586715187715502,
        0.7692338620300545,
        0.926945671319741,
    ),
    (
        0.0224793864387125,
        0.11467905316090415,
        0.2657898227845895,
        0.45284637366944464,
        0.6473752828868303,
        0.8197593082631076,
        0.9437374394630779,
    ),
    (
        0.017779915147363434,
        0.09132360789979399,
        0.21430847939563075,
        0.3719321645832723,
        0.5451866848034267,
        0.7131752428555694,
        0.8556337429578544,
        0.9553660447100302,
    ),
)


class Family(Enum):
    """The polynomials of which collocation points are roots; POINTS computes them."""

    RADAU = "radau"
    LEGENDRE = "legendre"
    LOBATTO = "lobatto"


@dataclass(frozen=True)
class Scheme:
    """Coefficients of one collocation scheme; nodes are 0 and the d points, in this order.

    Where the first point is 0, node 1 is no value: it is the slope at 0.
    """

    family: Family
    degree: int
    points: Array  # (d,), in [0, 1]
    D: Array  # (d, d + 1): derivative at point j of the basis polynomial of node r
    end: Array  # (d + 1,): value at 1 of the basis polynomial of node r
    end_of_points: Array  # (d,): the same for the basis on the points alone
    start_of_points: Array  # (d,): value of that basis at 0
    weights: Array  # (d,): the integral over [0, 1] is sum(weights * values at the points)

    @property
    def ends_interval(self) -> bool:
        """Return whether the last point is the end."""
        return bool(self.points[-1] == 1.0)

    @property
    def begins_interval(self) -> bool:
        """Return whether the first point is the start."""
        return bool(self.points[0] == 0.0)

    @property
    def integration(self) -> Array:
        """Return A, (d, d): values at the points are the value at 0 plus A times the derivatives at the points."""
        A = np.asarray(np.linalg.inv(self.D[:, 1:]))
        A[: int(self.begins_interval)] = 0.0
        return A

    @property
    def order(self) -> int:
        """Return the order of convergence at the ends of intervals."""
        return 2 * self.degree - self.ends_interval - self.begins_interval

    def integrate(self, places: Array) -> Array:
        """Return (k, d + 1): the integrals from 0 to k places of the basis polynomials of all nodes."""
        return integrate_basis(np.concatenate(([0.0], self.points)), places)

    @property
    def exactness(self) -> int:
        """Return the highest degree of a polynomial that the quadrature integrates exactly."""
        return 2 * self.degree - 1 - self.ends_interval - self.begins_interval

    def read_slope(self) -> Array:
        """Return (d,): the slope at 0 of the polynomial of degree d - 1 through values at 0 and at all later points."""
        return np.asarray(_differentiation(np.concatenate(([0.0], self.points[self.points > 0])))[0])


def list_degrees(family: Family) -> range:
    """List the degrees of a family: two ends are two points at least."""
    return DEGREES[1:] if family is Family.LOBATTO else DEGREES


@cache
def build(family: Family, degree: int) -> Scheme:
    """Compute the scheme of a family and a degree from 1 to 9, once; of Lobatto points, from 2 on."""
    degrees = list_degrees(family)
    if degree not in degrees:
        raise ValueError(f"degree {degree} is not in {degrees[0]}..{degrees[-1]}")
    points = POINTS[family](degree)
    nodes = np.concatenate(([0.0], points))
    return Scheme(
        family=family,
        degree=degree,
        points=points,
        D=_differentiation_with_slope(points) if points[0] == 0.0 else _differentiation(nodes)[1:],
        end=np.eye(degree + 1)[-1] if points[0] == 0.0 else read_basis(nodes, 1.0),
        end_of_points=read_basis(points, 1.0),
        start_of_points=read_basis(points, 0.0),
        weights=_weights(points),
    )


def _find_legendre_points(degree: int) -> Array:
    return np.asarray((legendre.leggauss(degree)[0] + 1) / 2)


def _find_radau_points(degree: int) -> Array:
    return np.array([*_RADAU[degree - 1], 1.0])


def _find_lobatto_points(degree: int) -> Array:
    inner: Array = np.asarray(legendre.Legendre.basis(degree - 1).deriv().roots(), dtype=np.float64)
    return np.array([0.0, *((inner + 1) / 2), 1.0])


POINTS: Mapping[Family, Callable[[int], Array]] = {
    Family.RADAU: _find_radau_points,
    Family.LEGENDRE: _find_legendre_points,
    Family.LOBATTO: _find_lobatto_points,
}


def _barycentric(nodes: Array) -> Array:
    gaps = nodes[:, None] - nodes[None, :]
    np.fill_diagonal(gaps, 1.0)
    return np.asarray(1.0 / gaps.prod(axis=1))


def _differentiation(nodes: Array) -> Array:
    """Differentiate the basis at every node; a row sums to 0, which gives its diagonal without cancellation."""
    w = _barycentric(nodes)
    gaps = nodes[:, None] - nodes[None, :]
    np.fill_diagonal(gaps, 1.0)
    D = w[None, :] / w[:, None] / gaps
    np.fill_diagonal(D, 0.0)
    np.fill_diagonal(D, -D.sum(axis=1))
    return np.asarray(D)


def _differentiation_with_slope(points: Array) -> Array:
    """Differentiate, at points that begin with 0, by the value at 0, the slope there, and values at later points.

    Polynomials p = a + s (b + s r), with r through its values at the later points c: r = ((p - a)/c - b)/c there.
    """
    later = points[1:]
    values = np.concatenate([read_basis(later, float(c))[None] for c in points])  # of r
    slopes = np.concatenate([_slope_basis(later, float(c))[None] for c in points])
    by_r = 2 * points[:, None] * values + points[:, None] ** 2 * slopes  # p' = b + 2 s r + s^2 r'
    weights = by_r / later**2
    return np.column_stack((-weights.sum(axis=1), 1.0 - by_r @ (1.0 / later), weights))


def _slope_basis(nodes: Array, s: float) -> Array:
    """Return the slopes at s of the basis polynomials of some nodes."""
    if s in nodes:
        return np.asarray(_differentiation(nodes)[np.flatnonzero(nodes == s)[0]])
    whole = np.concatenate(([s], nodes))
    D = _differentiation(whole)[0]
    return np.asarray(D[1:] + D[0] * read_basis(nodes, s))


def read_basis(nodes: Array, s: float) -> Array:
    """Evaluate the basis polynomials of some nodes at s; at a node the row is exactly a unit vector."""
    if s in nodes:
        return np.asarray((nodes == s).astype(np.float64))
    terms = _barycentric(nodes) / (s - nodes)
    return np.asarray(terms / terms.sum())


def integrate_basis(nodes: Array, places: Array, moment: int = 0) -> Array:
    """Return the integrals from 0 to each place c of (c - s)^moment times the basis polynomials of some nodes."""
    x, w = legendre.leggauss(len(nodes) + moment)  # exact for more than the degree of the integrand
    rows = []
    for c in places:
        s = c * (x + 1) / 2
        basis = np.stack([read_basis(nodes, float(at)) for at in s])
        rows.append((w * (c - s) ** moment * c / 2) @ basis)
    return np.stack(rows)


def _weights(points: Array) -> Array:
    """Solve for weights that integrate Legendre polynomials of degree < d exactly: a well-conditioned system."""
    moments = np.eye(len(points))[0]
    return np.asarray(np.linalg.solve(legendre.legvander(2 * points - 1, len(points) - 1).T, moments))
