"""Limits that other conditions imply, left out: an active set that depends on itself -> one that does not.

A speed that has to be 0 at the end lies on its limit of 0 there, whatever the limit's own multiplier is. Such limits
change nothing while the conditions that imply them hold. With A the gradients of all that holds with equality, y the
multipliers and A'n = 0, y + t n are multipliers as well. From the solution's, t goes until the first limit has none:
it is left out, and takes a dimension of such n with it, until no n moves a limit (Caratheodory's theorem). The
multipliers that remain have the right signs. Equations are never left out.

Vectors n come from random ones by projection: d (J J' + d)^-1, with small d, keeps what J' takes to 0.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from mbsrun.ocp.ground.functions import Array, Indices
from mbsrun.ocp.ground.program import Matrix
from mbsrun.ocp.optima.symmetric import Factors

Sides = NDArray[np.int8]

SOFT = 1e-13  # d, where rows of J have entries of about 1
PROJECTIONS = 8
DEPENDENT = 1e-8  # of |J'n|, with n of length 1: it is 0
FIRST, MOST = 8, 4096  # vectors that are projected at once
ENTRY = 1e-7  # of an entry of n, over the largest one: it is none


@dataclass(frozen=True, eq=False)
class Thinned:
    """The rest of an active set, its multipliers of rows, and how these may change with the whole set."""

    variables: Sides
    rows: Sides
    lam: Array
    directions: Array  # (directions, rows): multipliers of rows that add nothing to the gradient of free variables


def thin(jacobian: sparse.csr_array, variables: Sides, rows: Sides, lam: Array, zeta: Array) -> Thinned | None:
    """Leave out the limits that depend on other conditions; None where equations depend on each other.

    `lam` are multipliers of all rows, `zeta` the gradient of the Lagrangian, which is 0 except for held variables.
    """
    chosen, held, free = np.flatnonzero(rows), np.flatnonzero(variables), np.flatnonzero(variables == 0)
    whole = jacobian[chosen]
    found = _find_null(whole[:, free])
    if found is None:
        return None
    way = np.concatenate((found, whole[:, held].T @ found))
    sides = np.concatenate((rows[chosen], -variables[held] * (np.abs(variables[held]) == 1))).astype(np.int8)
    limited = np.abs(sides) == 1
    dropped = _purify(np.concatenate((lam[chosen], zeta[held])), way, np.where(limited, sides, 0))
    if dropped is None:
        return None
    y, gone = dropped
    own_rows, own_variables, own_lam = rows.copy(), variables.copy(), np.zeros_like(lam)
    own_lam[chosen] = y[: chosen.size]
    own_rows[chosen[gone[gone < chosen.size]]] = 0
    own_variables[held[gone[gone >= chosen.size] - chosen.size]] = 0
    directions = np.zeros((found.shape[1], lam.size))
    directions[:, chosen] = found.T
    return Thinned(own_variables, own_rows, own_lam, directions)


def _find_null(J: sparse.csr_array) -> Array | None:
    """Return a basis (rows, k) of the n with J'n = 0; None where there are too many."""
    sizes = np.asarray(abs(J).max(axis=1).toarray()).ravel()
    scales = 1 / np.where(sizes > 0, sizes, 1.0)
    scaled = sparse.csr_array(sparse.diags_array(scales) @ J)
    m, n = scaled.shape
    square, corner = sparse.eye_array(n).tocsc(), -SOFT * sparse.eye_array(m).tocsc()
    lower = sparse.vstack((sparse.hstack((square, sparse.csc_array((n, m)))), sparse.hstack((scaled, corner))))
    factors = Factors(Matrix(sparse.csc_array(lower)), zero=0.0)
    rng, count = np.random.default_rng(0), FIRST
    while True:
        taken = min(count, m)
        vectors = rng.standard_normal((m, taken))
        for _ in range(PROJECTIONS):
            below = factors.solve(np.concatenate((np.zeros((n, taken)), vectors)))[n:]
            vectors = np.linalg.qr(-SOFT * below)[0]
        moved = np.concatenate((np.asarray(scaled.T @ vectors), np.zeros((max(taken - n, 0), taken))))
        _, size, right = np.linalg.svd(moved, full_matrices=False)
        kept = right[size < DEPENDENT]
        if kept.shape[0] < taken or taken == m:
            return np.asarray(scales[:, None] * (vectors @ kept.T))
        count *= 4
        if count > MOST:
            return None


def _purify(y: Array, way: Array, sides: Sides) -> tuple[Array, Indices] | None:
    """Return multipliers that directions change by limits below 0 alone, and the limits that were left out for it.

    `sides` has the sign of each limit's multiplier, and 0 for equations. None where equations depend on each other.
    """
    gone: list[int] = []
    limited, way = np.flatnonzero(sides), np.asfortranarray(way / np.abs(way).max(axis=0, initial=0.0))
    for column in reversed(range(way.shape[1])):
        own = way[:, column] / np.abs(way[:, column]).max()
        if np.abs(own[limited]).max(initial=0.0) <= ENTRY:
            return None
        above, rates = sides[limited] * y[limited], sides[limited] * own[limited]
        length, at, sign = min((*_find_first(above, sign * rates), sign) for sign in (1.0, -1.0))
        first = int(limited[at])
        y = y + sign * length * own
        gone.append(first)
        y[first] = 0.0
        way[:, :column] -= np.outer(own / own[first], way[first, :column])
        way[gone] = 0.0
    return y, np.array(gone, dtype=np.int64)


def _find_first(y: Array, rates: Array) -> tuple[float, int]:
    """Return how far multipliers stay above 0, and which one has none first."""
    falling = np.flatnonzero(rates < -ENTRY)
    lengths = np.maximum(y[falling], 0.0) / -rates[falling]
    first = int(np.argmin(lengths)) if falling.size else 0
    return (float(lengths[first]), int(falling[first])) if falling.size else (np.inf, -1)
