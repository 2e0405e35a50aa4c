"""Rows and bounds that hold a point, but whose gradients depend on each other -> which bound to release.

At such a point multipliers are not unique: with y'A = 0, A the derivatives of held rows by free numbers, lam + s y is
as good as lam. At some s, the multiplier of a held bound reaches 0. It is released, and then y'A is no longer 0. This
is a step of the dual simplex method, in the direction that goes further: a bound that was just reached has the
multiplier 0, which may only grow.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import splu

Array = NDArray[np.float64]
Signs = NDArray[np.int8]
Matrix = sparse.csc_array

SHIFT = 1e-12  # of A A', whose rows have the length 1
DEPENDENT = 1e-7  # |y'A| for |y| = 1; independent rows of the problems have more
ROUNDS = 4


@dataclass(frozen=True)
class Release:
    """A bound to release, by its place among all bounds, and the step of the multipliers along y."""

    place: int
    step: float


def find_dependence(A: Matrix) -> Array | None:
    """Return a combination y of rows with y'A nearly 0, or None: by inverse iteration with A A' + SHIFT I."""
    m, n = A.shape
    lengths = np.sqrt(np.asarray(A.multiply(A).sum(axis=1)).ravel())
    if not lengths.all():
        return np.asarray(np.eye(m)[np.flatnonzero(lengths == 0)[0]])
    scaled = Matrix(sparse.diags_array(1 / lengths) @ A)
    factors = splu(
        Matrix(sparse.block_array([[sparse.eye_array(n), scaled.T], [scaled, -SHIFT * sparse.eye_array(m)]]))
    )
    y = np.random.default_rng(0).standard_normal(m)
    for _ in range(ROUNDS):
        y = factors.solve(np.concatenate([np.zeros(n), -y]))[n:]
        y /= np.linalg.norm(y)
    return y / lengths if np.linalg.norm(scaled.T @ y) < DEPENDENT else None


def choose_release(signs: Signs, multipliers: Array, changes: Array) -> Release | None:
    """Return the bound whose multiplier reaches 0 first in the direction that goes further; None where none does.

    signs: the side of each held bound, 0 for equations and numbers that are free; changes: of multipliers along y.
    """
    held = np.flatnonzero((signs != 0) & (np.abs(changes) > 1e-9 * np.abs(changes).max(initial=0.0)))
    pushes, rates = np.maximum(0.0, signs[held] * multipliers[held]), signs[held] * changes[held]
    found = [
        Release(int(places[k]), float(direction * steps[k]))
        for direction in (1.0, -1.0)
        if len(places := held[direction * rates < 0])
        for steps in [(pushes / np.abs(rates))[direction * rates < 0]]
        for k in [int(steps.argmin())]
    ]
    return max(found, key=lambda release: abs(release.step), default=None)
