"""The equations and the coordinates to compute with: independent rows and columns of J, the same at all poses.

Rows and columns are chosen one by one, each with a large part outside of the span of the chosen ones (elimination with
pivots, by orthogonal projection), at the pose where this part is smallest.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mbsgen.assembly.mechanism import Array

ENOUGH = 0.3  # of the largest part: of rows above, the first is taken, so that a choice keeps the author's order
NOISE = 1e-12  # of the largest row: rows below are rounding of rows that vanish
NEARLY = 0.999  # likewise of columns, whose weights decide
REGULAR = 1e-6  # the least singular value of the dependent columns, as a part of the largest one of J


def choose_rows(poses: Sequence[Array], count: int, noise: float = NOISE) -> tuple[int, ...]:
    """Choose independent rows of J, given at several poses; rows below `noise` of the largest count by their size."""
    sizes = [np.linalg.norm(J, axis=1, keepdims=True) for J in poses]
    left = [
        J / np.maximum(size, max(noise * size.max(initial=0.0), 1e-300)) for J, size in zip(poses, sizes, strict=True)
    ]
    return tuple(sorted(_choose(left, count, np.ones(left[0].shape[0]), ENOUGH)))


def choose_columns(poses: Sequence[Array], weights: Array) -> tuple[int, ...]:
    """Choose independent columns of J, as many as it has rows; of those alike, the ones of the largest weight."""
    return tuple(sorted(_choose([J.T.copy() for J in poses], poses[0].shape[0], weights, NEARLY)))


def measure(J: Array, columns: Sequence[int]) -> float:
    """Return the least singular value of some columns of J, as a part of the largest one of J."""
    if not columns:
        return 1.0
    values = np.linalg.svd(J[:, list(columns)], compute_uv=False)
    return float(values.min() / np.linalg.svd(J, compute_uv=False).max())


def _choose(left: list[Array], count: int, weights: Array, enough: float) -> list[int]:
    chosen: list[int] = []
    for _ in range(count):
        parts = np.min([np.linalg.norm(A, axis=1) for A in left], axis=0) * weights
        parts[chosen] = 0.0
        k = int(np.flatnonzero(parts >= enough * parts.max())[0])
        chosen.append(k)
        for A in left:
            unit = A[k] / max(float(np.linalg.norm(A[k])), 1e-300)
            A -= np.outer(A @ unit, unit)
    return chosen
