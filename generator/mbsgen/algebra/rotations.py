"""Rotation about a coordinate axis, as a matrix over any ring; its zeros and ones make products with it cheaper."""

from __future__ import annotations

from mbsgen.algebra.vectors import Matrix, T


def axis_rotation(axis: int, sine: T, cosine: T, zero: T, one: T) -> Matrix[T]:
    """Rotate about coordinate axis 0, 1 or 2; columns are the turned axes in the frame turned from."""
    rows = [[one if r == c == axis else zero for c in range(3)] for r in range(3)]
    j, k = (axis + 1) % 3, (axis + 2) % 3
    rows[j][j] = rows[k][k] = cosine
    rows[j][k], rows[k][j] = -sine, sine
    return Matrix.of(rows)
