"""H, A in doubles -> a lower bound of d'Hd for all steps d of length 1 with A d = 0.

With a basis Z of nearly such steps, scaled so that Z'HZ is nearly 1, and K = (H A'; A 0), the columns of Z + E with
K (E; .) = (0; -A Z) are such steps exactly. There are as many as A leaves free, so they are a basis of all. For |y| = 1

    y'(Z + E)'H(Z + E)y >= 1 - |Z'HZ - 1| - 2 e'|HZ| - e'|H|e,   |E y| <= e by a bound of the inverse of K.

Products are computed in doubles; n u times the same products of absolute values bounds their rounding.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import splu

Array = NDArray[np.float64]
Matrix = sparse.csc_array

UNIT = 2.0**-53
ROOM = 1 + 1e-9  # covers roundings of sums of norms
REFINEMENTS = 3


@dataclass(frozen=True, eq=False)
class Steps:
    """Nearly all steps that rows permit."""

    Z: Array  # (n, p)
    leak: Array  # (m,): bounds of |A Z y| for |y| = 1


def find_steps(H: Matrix, A: Matrix) -> Steps | None:
    """Find a basis; None where Z'HZ is not positive definite, or A has as many rows as columns."""
    m, n = A.shape
    if n <= m:
        return None
    factors = splu(Matrix(sparse.block_array([[sparse.eye_array(n), A.T], [A, None]], format="csc")))
    guess = np.zeros((n + m, n - m))
    guess[:n] = np.random.default_rng(0).standard_normal((n, n - m))
    Z, _ = np.linalg.qr(factors.solve(guess)[:n])
    values, vectors = np.linalg.eigh(_symmetric(Z.T @ (H @ Z)))
    if values[0] <= 0:
        return None
    Z = Z @ (vectors / np.sqrt(values))
    for _ in range(REFINEMENTS):
        guess[:n], guess[n:] = 0.0, A @ Z
        Z = Z - factors.solve(guess)[:n]
    residual = np.abs(A @ Z) + _count_terms(A) * UNIT * (abs(A) @ np.abs(Z))
    return Steps(Z, ROOM * np.linalg.norm(residual, axis=1))


def bound_curvature(H: Matrix, steps: Steps, error: Array) -> float:
    """Return a lower bound of d'Hd for steps d of length 1, where |E y| <= error (n,) for |y| = 1; 0: none is found."""
    Z, wide = steps.Z, abs(H) @ np.abs(steps.Z)
    product, rounding = H @ Z, _count_terms(H) * UNIT * wide
    gap = np.abs(_symmetric(Z.T @ product) - np.eye(Z.shape[1]))
    doubt = np.abs(Z).T @ (rounding + (len(Z) + 8) * UNIT * (np.abs(product) + rounding))
    moved = 2 * error @ np.linalg.norm(np.abs(product) + rounding, axis=1) + error @ (abs(H) @ error)
    least = 1 - ROOM * float((gap + doubt + doubt.T).sum(axis=1).max() + moved)
    length = ROOM * (np.linalg.norm(Z) + np.linalg.norm(error))
    return max(0.0, least / float(length) ** 2 / ROOM)


def _symmetric(matrix: Array) -> Array:
    return (matrix + matrix.T) / 2


def _count_terms(matrix: Matrix) -> float:
    """Count the most terms of products with rows of a matrix, with room."""
    return float(np.diff(sparse.csr_array(matrix).indptr).max() + 4)
