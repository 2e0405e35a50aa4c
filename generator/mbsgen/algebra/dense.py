"""Matrices of a few rows over any numbers, as tuples of rows: products, and eigenvalues of symmetric ones.

Models are read and planned with these, so that neither needs an array library. Sums run from left to right.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any, TypeVar

Number = Any  # of one ring: floats, or numbers of many digits
Row = tuple[Number, ...]
Dense = tuple[Row, ...]
T = TypeVar("T")

ROUNDING = 1e-15  # of eigenvalues, relative to the largest: smaller ones are 0, as for NumPy's pinv
SWEEPS = 60  # some six do; the bound ends the search where entries are no numbers


def dot(a: Iterable[Number], b: Iterable[Number]) -> Number:
    """Return the scalar product."""
    total: Number = 0  # not by sum(), which rounds in other ways from Python 3.12 on
    for x, y in zip(a, b, strict=True):
        total += x * y
    return total


def cross(a: Sequence[Number], b: Sequence[Number]) -> Row:
    """Return the vector product of three components each."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def skew(v: Sequence[Number]) -> Dense:
    """Return the matrix of the vector product with v."""
    x, y, z = v
    return (0 * x, -z, y), (z, 0 * x, -x), (-y, x, 0 * x)


def add(a: Iterable[Number], b: Iterable[Number]) -> Row:
    """Return the sum of two rows."""
    return tuple(x + y for x, y in zip(a, b, strict=True))


def subtract(a: Iterable[Number], b: Iterable[Number]) -> Row:
    """Return the difference of two rows."""
    return tuple(x - y for x, y in zip(a, b, strict=True))


def identity(size: int) -> Dense:
    """Return the identity, of whole numbers."""
    return tuple(tuple(int(i == k) for k in range(size)) for i in range(size))


def transpose(A: Dense) -> Dense:
    """Return the transpose."""
    return tuple(zip(*A, strict=True))


def apply(A: Dense, v: Sequence[Number]) -> Row:
    """Return the product with a column."""
    return tuple(dot(row, v) for row in A)


def times(A: Dense, B: Dense) -> Dense:
    """Return the product of two matrices."""
    columns = transpose(B)
    return tuple(tuple(dot(row, column) for column in columns) for row in A)


def divide_both(A: Dense, scale: Row) -> Dense:
    """Divide rows and columns by the same numbers."""
    rows = zip(A, scale, strict=True)
    return tuple(tuple(entry / (x * y) for entry, y in zip(row, scale, strict=True)) for row, x in rows)


def project(A: Dense, u: Row, pivot: Number) -> Dense:
    """Return A - u uT / pivot."""
    rows = zip(A, u, strict=True)
    return tuple(tuple(entry - x * y / pivot for entry, y in zip(row, u, strict=True)) for row, x in rows)


def combine(function: Callable[..., T], *matrices: Dense) -> tuple[tuple[T, ...], ...]:
    """Apply a function to the entries of matrices of one size."""
    return tuple(tuple(map(function, *rows)) for rows in zip(*matrices, strict=True))


def stack(blocks: Sequence[Sequence[Dense]]) -> Dense:
    """Put blocks side by side, and rows of blocks below each other."""
    return tuple(sum(rows, ()) for row in blocks for rows in zip(*row, strict=True))


def find_largest(A: Dense) -> float:
    """Return the largest size of an entry; 0 where there is none."""
    return max((abs(float(x)) for row in A for x in row), default=0.0)


def list_columns(A: Dense) -> Row:
    """Return the entries column by column."""
    return tuple(x for column in transpose(A) for x in column)


def find_eigen(A: Dense) -> tuple[tuple[float, ...], Dense]:
    """Return the eigenvalues of a symmetric matrix of floats, ascending, and its eigenvectors as rows.

    Jacobi's rotations (Golub, Van Loan, Matrix Computations, 8.5); small eigenvalues are exact to rounding of the
    largest entry. Only the lower triangle is read.
    """
    S = [[float(A[max(i, k)][min(i, k)]) for k in range(len(A))] for i in range(len(A))]
    V = [[float(x) for x in row] for row in identity(len(A))]
    places = [(p, q) for p in range(len(S)) for q in range(p + 1, len(S))]
    for _ in range(SWEEPS):
        turned = [_rotate(S, V, p, q) for p, q in places]
        if not any(turned):
            break
    order = sorted(range(len(S)), key=lambda k: S[k][k])
    return tuple(S[k][k] for k in order), tuple(tuple(V[k]) for k in order)


def invert_symmetric(A: Dense) -> Dense:
    """Return the pseudo-inverse of a symmetric matrix of floats: of motions without inertia, 0."""
    values, vectors = find_eigen(A)
    least = ROUNDING * max(map(abs, values))
    scaled = tuple(
        tuple(x / value if abs(value) > least else 0.0 for x in vector)
        for value, vector in zip(values, vectors, strict=True)
    )
    return times(transpose(vectors), scaled)


def _rotate(S: list[list[float]], V: list[list[float]], p: int, q: int) -> bool:
    """Turn two axes such that S[p][q] vanishes; return whether it did not before, beside the diagonal."""
    off = S[p][q]
    if abs(S[p][p]) + abs(off) == abs(S[p][p]) and abs(S[q][q]) + abs(off) == abs(S[q][q]):
        S[p][q] = S[q][p] = 0.0
        return False
    ratio = (S[q][q] - S[p][p]) / (2 * off)
    t = math.copysign(1.0, ratio) / (abs(ratio) + math.hypot(1.0, ratio))
    c = 1 / math.hypot(1.0, t)
    s = t * c
    for row in S:
        row[p], row[q] = c * row[p] - s * row[q], s * row[p] + c * row[q]
    for M in (S, V):
        M[p], M[q] = (
            [c * x - s * y for x, y in zip(M[p], M[q], strict=True)],
            [s * x + c * y for x, y in zip(M[p], M[q], strict=True)],
        )
    return True
