"""Bodies that can be built: estimated base parameters -> the nearest numbers of bodies with them.

Of all numbers x with G x = beta, the ones nearest to the model's own are taken, in units of each body's mass and size.
Where they belong to a body that nobody can build, the base parameters move too, as little as their covariance C allows:

    minimise (G x - beta)T C^-1 (G x - beta) + |(x - x_0)/scale|^2 / w^2

over numbers whose pseudo-inertias [[tr(J)/2 - J, S], [ST, m]] are positive definite (P. Wensing, S. Kim, J.-J. Slotine,
"Linear matrix inequalities for physically consistent inertial parameter identification", IEEE Robotics and Automation
Letters 3, 2018). The problem is convex; its minimum is approached along the central path of the logarithms of the
determinants. A prior opinion has a small w; without one, w is large. Rotors, dampings and frictions stay above 0.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh, lstsq

from mbsrun.identification.settings import ARMATURE, DAMPING, FRICTION, INERTIA
from mbsrun.identification.unknowns import Unknown

Array = NDArray[np.float64]

FREE = 1e2  # w without an opinion
INSIDE = 1e-3  # of a pseudo-inertia's size: its eigenvalues where the search begins
LAST, FASTER = 1e-9, 0.2  # of the weight of the barrier: the last one, and the factor between two
CLOSE, SHORTEST, MOST = 1e-3, 1e-8, 50  # decrease at which Newton's method ends, in units of mu; step; iterations
ROUNDED = 1e-9  # of a pseudo-inertia's size: below, an eigenvalue is 0
POSITIVE = (ARMATURE, DAMPING, FRICTION)
UPPER = np.triu_indices(3)


@dataclass(frozen=True, eq=False)
class Bodies:
    """The numbers of all unknowns, and what they took."""

    x: Array  # (unknowns,)
    beta: Array  # (base,): G x
    distance: float  # of beta from the estimate, by its covariance [standard deviations]
    is_moved: bool  # whether the estimate itself belongs to no body that can be built


def find_bodies(
    unknowns: Sequence[Unknown], G: Array, x0: Array, beta: Array, covariance: Array, prior: float | None, *, free: bool
) -> Bodies:
    """Find the numbers of bodies near x_0 that explain beta; `free` admits bodies that nobody can build.

    Directions without covariance stay at G x_0.
    """
    owners = _group(unknowns)
    scale = _find_scales(owners, x0)
    weight = _whiten(covariance)
    difference = beta - G @ x0
    A = np.vstack((weight @ (G * scale), np.eye(len(x0)) / (FREE if prior is None else prior)))
    c = np.concatenate((weight @ difference, np.zeros(len(x0))))
    x = np.asarray(x0 + scale * (lstsq(G * scale, difference) if prior is None else lstsq(A, c))[0])
    if free or all(_is_possible(unknowns, owners, x, place) for place in [*owners, None]):
        return Bodies(x, G @ x, _measure(weight, G @ x - beta), False)
    x = _search(unknowns, owners, A, c, x0, scale)
    return Bodies(x, G @ x, _measure(weight, G @ x - beta), True)


def _measure(weight: Array, difference: Array) -> float:
    return float(np.linalg.norm(weight @ difference))


def _whiten(covariance: Array) -> Array:
    """Return L with LT L = C^-1, on the directions that have a covariance, in rows."""
    sizes = np.sqrt(np.diag(covariance))
    known = sizes > 0
    if not known.any():
        return np.zeros((0, len(sizes)))
    scaled = covariance[np.ix_(known, known)] / np.outer(sizes[known], sizes[known])
    values, vectors = eigh(scaled)
    rows = np.zeros((len(values), len(sizes)))
    rows[:, known] = (vectors / np.sqrt(np.maximum(values, 1e-14 * values.max()))).T / sizes[known]
    return rows


def _group(unknowns: Sequence[Unknown]) -> dict[str, list[int]]:
    """Return the places of the ten numbers of each body, in the order of `roles.MOMENTS`."""
    found: dict[str, dict[int, int]] = {}
    for k, x in enumerate(unknowns):
        if x.kind == INERTIA:
            found.setdefault(x.owner, {})[x.moment] = k
    return {owner: [own[m] for m in range(10)] for owner, own in found.items()}


def _find_scales(owners: dict[str, list[int]], x0: Array) -> Array:
    """Return the sizes of numbers: of a body by its mass and radius, else by the number itself, or 1."""
    scale = np.array([abs(v) or 1.0 for v in x0.tolist()])
    masses = [x0[places[0]] for places in owners.values() if x0[places[0]] > 0]
    typical = float(np.mean(masses)) if masses else 1.0
    for places in owners.values():
        own = x0[places]
        m = float(own[0]) if own[0] > 0 else typical
        trace = float(own[4] + own[7] + own[9]) / 2
        r = float(np.sqrt(trace / m)) if trace > 0 else 0.1
        scale[places] = [m, *[m * r] * 3, *[m * r * r] * 6]
    return scale


def make_pseudo(moments: Array) -> Array:
    """Return the pseudo-inertia [[P, S], [ST, m]] of ten moments, with P = tr(J)/2 - J."""
    J = np.zeros((3, 3))
    J[UPPER] = moments[4:]
    J = J + np.triu(J, 1).T
    Z = np.zeros((4, 4))
    Z[:3, :3] = np.trace(J) / 2 * np.eye(3) - J
    Z[:3, 3] = Z[3, :3] = moments[1:4]
    Z[3, 3] = moments[0]
    return Z


def read_pseudo(Z: Array) -> Array:
    """Return the ten moments of pseudo-inertias (..., 4, 4)."""
    P = Z[..., :3, :3]
    J = np.trace(P, axis1=-2, axis2=-1)[..., None, None] * np.eye(3) - P
    return np.asarray(np.concatenate((Z[..., 3:, 3], Z[..., :3, 3], J[..., UPPER[0], UPPER[1]]), axis=-1))


def _is_possible(unknowns: Sequence[Unknown], owners: dict[str, list[int]], x: Array, owner: str | None) -> bool:
    if owner is None:
        return all(x[k] >= 0 for k, own in enumerate(unknowns) if own.kind in POSITIVE)
    Z = _balance(make_pseudo(x[owners[owner]]))
    values = np.linalg.eigvalsh(Z)
    return bool(x[owners[owner][0]] > 0 and values[0] >= -ROUNDED * values[-1])


def _balance(Z: Array) -> Array:
    """Scale lengths so that mass and moments have the same size."""
    trace, m = float(np.trace(Z[:3, :3])), abs(float(Z[3, 3]))
    r = np.sqrt(abs(trace) / m) if m > 0 and trace else 1.0
    D = np.array([1 / r] * 3 + [1.0])
    return Z * np.outer(D, D)


def lift(moments: Array, scale: Array) -> Array:
    """Return moments near the given ones whose pseudo-inertia is positive definite: its eigenvalues are raised."""
    D = _find_units(scale)
    values, vectors = np.linalg.eigh(make_pseudo(moments) * np.outer(D, D))
    raised = np.maximum(values, INSIDE * max(1.0, values[-1]))
    return np.asarray(read_pseudo((vectors * raised) @ vectors.T / np.outer(D, D)))


def _find_units(scale: Array) -> Array:
    """Return the factors of rows and columns of a body's pseudo-inertia that make mass and size 1."""
    m, r = float(scale[0]), float(scale[1] / scale[0])
    return np.asarray(np.array([1 / r] * 3 + [1.0]) / np.sqrt(m))


def _search(
    unknowns: Sequence[Unknown], owners: Mapping[str, list[int]], A: Array, c: Array, x0: Array, scale: Array
) -> Array:
    """Minimise |A y - c|^2 over x = x_0 + scale y within the cones, along the central path by Newton's method."""
    cones = [_Cone.of(places, x0, scale) for places in owners.values()]
    signs = [k for k, x in enumerate(unknowns) if x.kind in POSITIVE]
    y = np.zeros(len(x0))
    for cone in cones:
        y[cone.places] = (lift(x0[cone.places], scale[cone.places]) - x0[cone.places]) / scale[cone.places]
    y[signs] = np.maximum(x0[signs] / scale[signs], INSIDE) - x0[signs] / scale[signs]
    H, mu = A.T @ A, 1.0

    def evaluate(y: Array) -> float:
        logs = [cone.measure(y) for cone in cones]
        rest = (x0[signs] + scale[signs] * y[signs]) / scale[signs]
        if not all(np.isfinite(logs)) or (rest <= 0).any():
            return float("inf")
        r = A @ y - c
        return float(r @ r) / 2 - mu * (sum(logs) + float(np.log(rest).sum()))

    while mu > LAST:
        for _ in range(MOST):
            slope, curve = A.T @ (A @ y - c), H.copy()
            for cone in cones:
                cone.add(y, mu, slope, curve)
            rest = x0[signs] / scale[signs] + y[signs]
            slope[signs] -= mu / rest
            curve[signs, signs] += mu / rest**2
            step = -np.linalg.solve(curve, slope)
            decrease = float(-slope @ step)
            if decrease < CLOSE * mu:
                break
            length, present = 1.0, evaluate(y)
            while evaluate(y + length * step) > present - 0.1 * length * decrease and length > SHORTEST:
                length /= 2
            if length <= SHORTEST:
                break
            y = y + length * step
        mu *= FASTER
    return np.asarray(x0 + scale * y)


@dataclass(frozen=True, eq=False)
class _Cone:
    """The pseudo-inertia of a body, in units of its mass and size: Z = Z_0 + sum of y_i E_i."""

    places: list[int]
    Z: Array  # (4, 4)
    E: Array  # (10, 4, 4)

    @staticmethod
    def of(places: list[int], x0: Array, scale: Array) -> _Cone:
        D = _find_units(scale[places])
        unit = np.outer(D, D)
        return _Cone(
            places, make_pseudo(x0[places]) * unit, np.array([make_pseudo(e) * unit for e in np.diag(scale[places])])
        )

    def measure(self, y: Array) -> float:
        """Return the logarithm of the determinant; minus infinity where it is not positive definite."""
        try:
            L = np.linalg.cholesky(self.Z + np.tensordot(y[self.places], self.E, 1))
        except np.linalg.LinAlgError:
            return float("-inf")
        return 2 * float(np.log(np.diag(L)).sum())

    def add(self, y: Array, mu: float, slope: Array, curve: Array) -> None:
        """Add the derivatives of the barrier."""
        inverse = np.linalg.inv(self.Z + np.tensordot(y[self.places], self.E, 1))
        parts = inverse @ self.E
        slope[self.places] -= mu * np.trace(parts, axis1=1, axis2=2)
        curve[np.ix_(self.places, self.places)] += mu * np.einsum("iab,jba->ij", parts, parts)
