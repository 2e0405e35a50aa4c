"""Linear complementarity with bounds: x in [low, high], y = A x + b, for a symmetric, positive definite A:

    low < x < high and y = 0,    or    x = low and y >= 0,    or    x = high and y <= 0

There is one solution, and pivoting finds it: all faulty entries change their place at once, while that leaves fewer of
them; else the first one alone does, which ends after finitely many steps (Judice, Pires, "Basic-set algorithm for a
generalized linear complementarity problem", J. Optim. Theory Appl. 74 (1992); Murty, "Note on a Bard-type scheme",
Opsearch 11 (1974)).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mbsgen.errors import MbsError

Array = NDArray[np.float64]

NOISE = 1e-12  # of the terms of a number: a smaller one is 0
PATIENCE = 8  # exchanges of many entries at once that leave no fewer faulty ones
PROXIMITY = 1e-9  # of a diagonal entry: what is added to a singular matrix
PROXIMAL = 200  # steps of the proximal point method
SETTLED = 1e-14  # of the terms of a number: a smaller change ends it
LOW, WITHIN, HIGH = -1, 0, 1  # where an entry of x is


class ComplementarityError(MbsError):
    """A problem without a solution, or with several: its matrix is not positive definite to rounding."""

    def __init__(self, finding: str = "") -> None:
        known = "the complementarity problem has no solution, or several: its matrix is singular to rounding"
        super().__init__(finding or known)


def solve_bounded(A: Array, b: Array, low: Array, high: Array) -> tuple[Array, Array, NDArray[np.int_]]:
    """Return x, y and where each entry of x is: LOW, WITHIN or HIGH; A (m, m), bounds may be infinite.

    Numbers that rounding may have made of 0 count as 0. Raises ComplementarityError.
    """
    count = len(b)
    place = np.zeros(count, dtype=np.int_)
    fewest, patience = count + 1, PATIENCE
    for _ in range(_count_attempts(count)):
        x, y = _evaluate(A, b, low, high, place)
        moves = _find_moves(A, b, low, high, place, x, y)
        faulty = np.flatnonzero(moves != place)
        if not faulty.size:
            return x, y, place
        if faulty.size < fewest:
            fewest, patience = faulty.size, PATIENCE
        else:
            patience -= 1
        if patience < 0:
            faulty = faulty[:1]
        place[faulty] = moves[faulty]
    raise ComplementarityError


def solve_redundant(
    A: Array, b: Array, low: Array, high: Array, near: Array, sizes: Array
) -> tuple[Array, Array, NDArray[np.int_]]:
    """Solve the same for a singular A >= 0; of several solutions return one near `near`, (m,).

    Each x minimises x^T A x/2 + b^T x + PROXIMITY/2 |x - last|^2, weighted by `sizes` (m,), as large as the diagonal
    of A may be (Rockafellar, "Monotone operators and the proximal point algorithm", SIAM J. Control Optim. 14 (1976)).
    Raises ComplementarityError where no x is a solution.
    """
    x, weight = np.clip(near, low, high), PROXIMITY * sizes
    for _ in range(PROXIMAL):
        last = x
        x, _, place = solve_bounded(A + np.diag(weight), b - weight * last, low, high)
        noise = SETTLED * (np.abs(A) @ np.abs(x) + np.abs(b))
        if (weight * np.abs(x - last) <= noise).all():
            y = A @ x + b
            return x, np.where(place == WITHIN, 0.0, y), place
    raise ComplementarityError


def _count_attempts(count: int) -> int:
    return 100 + int(3 ** min(count, 9))  # each place once, of a few entries; many take far fewer


def _evaluate(A: Array, b: Array, low: Array, high: Array, place: NDArray[np.int_]) -> tuple[Array, Array]:
    """Return x and y for given places."""
    x = np.where(place == LOW, low, np.where(place == HIGH, high, 0.0))
    within = np.flatnonzero(place == WITHIN)
    if within.size:
        block = A[np.ix_(within, within)]
        try:
            np.linalg.cholesky(block)
        except np.linalg.LinAlgError:
            raise ComplementarityError from None
        x[within] = -np.linalg.solve(block, (A @ x + b)[within])
    y = A @ x + b
    y[within] = 0.0
    return x, y


def _find_moves(
    A: Array, b: Array, low: Array, high: Array, place: NDArray[np.int_], x: Array, y: Array
) -> NDArray[np.int_]:
    """Return where entries belong that are at a faulty place; others stay."""
    y_noise = NOISE * (np.abs(A) @ np.abs(x) + np.abs(b))
    x_noise = NOISE * (np.abs(x) + (np.abs(A) @ np.abs(x) + np.abs(b)) / np.diagonal(A))
    moves = place.copy()
    moves[(place == WITHIN) & (x < low - x_noise)] = LOW
    moves[(place == WITHIN) & (x > high + x_noise)] = HIGH
    moves[(place == LOW) & (y < -y_noise)] = WITHIN
    moves[(place == HIGH) & (y > y_noise)] = WITHIN
    return moves
