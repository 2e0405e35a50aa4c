"""The intervals of a horizon: equal ones, or with given lengths.

Interval k is as long as the fraction f_k of the horizon T, and the fractions sum to 1:

    h_k = T f_k,    t_k = T (f_0 + ... + f_(k-1)),    t_kj = t_k + c_j h_k

with collocation points c_j in [0, 1]. Equal intervals have f_k = 1 / N.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Grid:
    """N intervals."""

    intervals: int
    fractions: tuple[float, ...] | None = None  # of the horizon, one for each interval; None: they are equal

    @property
    def is_equal(self) -> bool:
        """Return whether all intervals have the same length."""
        return self.fractions is None

    def lengths(self, horizon: float = 1.0) -> Array:
        """Return the lengths of the intervals, (N,)."""
        if self.fractions is None:
            return np.full(self.intervals, horizon / self.intervals)
        return horizon * np.array(self.fractions)

    def mesh(self, horizon: float = 1.0) -> Array:
        """Return the times of the mesh points, (N + 1,)."""
        if self.fractions is None:
            return np.linspace(0.0, horizon, self.intervals + 1)
        t = np.concatenate(([0.0], np.cumsum(self.lengths(horizon))))
        t[-1] = horizon  # the sum is rounded
        return t

    def times(self, horizon: float, points: Array) -> tuple[Array, Array]:
        """Return the times of the mesh points (N + 1,), and of the points (N, d) at `points` of each interval."""
        t = self.mesh(horizon)
        return t, t[:-1, None] + points * self.lengths(horizon)[:, None]

    def places(self, points: Array) -> Array:
        """Return the times of points over the horizon, (N, d)."""
        if self.fractions is None:
            return np.asarray((np.arange(self.intervals)[:, None] + points) / self.intervals)
        return self.times(1.0, points)[1]


def split(lengths: Array, pieces: NDArray[np.int64]) -> Array:
    """Return the lengths after each interval is split into equal pieces."""
    return np.repeat(lengths / pieces, pieces)


def divide(lengths: Array) -> tuple[float, ...] | None:
    """Return the fractions of a horizon that relative lengths make; None where all are equal."""
    if (lengths == lengths[0]).all():
        return None
    return tuple((lengths / lengths.sum()).tolist())
