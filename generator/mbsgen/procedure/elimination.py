"""Factors of matrices, and solutions by them, in any number type. The Python target prints these functions as they are.

    factorise_tree         A = LT D L, rows from the last to the first; L only where `ancestors` has entries
                           (Featherstone, 2008, 6.5)
    factorise_symmetric    P A PT = L D LT, D of blocks of 1 or 2 rows (Bunch and Kaufman, 1977; LAPACK's dsytf2)
    factorise_general      P A = L U, partial pivoting (Golub and Van Loan, 3.4)

Each returns the factors, then the number of the row, from 1, whose pivot fails, or 0. A pivot must exceed `threshold`
times the largest entry of its column of A, or the entry on its diagonal for a tree; NaN does not. Factors that
fail solve nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

Rows = list[list[Any]]


def factorise_tree(A: Rows, ancestors: Sequence[Sequence[int]], threshold: Any) -> tuple[Rows, list[Any], int]:
    """Return the rows of L without their unit diagonal, 1/D, and the row that fails."""
    n = len(A)
    H = [list(row) for row in A]
    lower: Rows = [[] for _ in range(n)]
    inverses: list[Any] = [None] * n
    for k in reversed(range(n)):
        if not H[k][k] > threshold * abs(A[k][k]):
            return lower, inverses, k + 1
        inverses[k] = 1 / H[k][k]
        lower[k] = [H[k][i] * inverses[k] for i in ancestors[k]]
        for n_i, i in enumerate(ancestors[k]):
            for j in ancestors[k][: n_i + 1]:
                H[i][j] = H[i][j] - lower[k][n_i] * H[k][j]
    return lower, inverses, 0


def solve_tree(ancestors: Sequence[Sequence[int]], lower: Rows, inverses: Sequence[Any], B: Rows) -> None:
    """Put A^-1 B in the place of the rows B."""
    for k in reversed(range(len(B))):
        for i, entry in zip(ancestors[k], lower[k], strict=True):
            B[i] = [x - entry * y for x, y in zip(B[i], B[k], strict=True)]
    for k in range(len(B)):
        B[k] = [inverses[k] * x for x in B[k]]
        for i, entry in zip(ancestors[k], lower[k], strict=True):
            B[k] = [x - entry * y for x, y in zip(B[k], B[i], strict=True)]


def factorise_symmetric(A: Rows, threshold: Any) -> tuple[Rows, list[int], int]:
    """Return L below and the inverse of D on the diagonal, the exchanges, and the row that fails.

    An exchange is p for a block of one row, and -1 - p twice for a block of two, whose second row it is. Only the
    triangle below the diagonal is read.
    """
    n = len(A)
    A = [[A[max(i, j)][min(i, j)] for j in range(n)] for i in range(n)]
    scales = [max(abs(x) for x in row) for row in A]
    exchanges: list[int] = []
    k = 0
    while k < n:
        width, p = _choose_block(A, k)
        if not max(abs(A[i][k]) for i in range(k, n)) > threshold * scales[k]:
            return A, exchanges, k + 1
        last = k + width - 1
        scales[last], scales[p] = scales[p], scales[last]
        _exchange(A, k, last, p)
        exchanges += [p] if width == 1 else [-1 - p, -1 - p]
        if width == 1:
            A[k][k] = 1 / A[k][k]
            for i in range(k + 1, n):
                entry = A[i][k] * A[k][k]
                for j in range(k + 1, i + 1):
                    A[i][j] = A[j][i] = A[i][j] - entry * A[k][j]
                A[i][k] = entry
        else:
            a, b, c = A[k][k], A[last][k], A[last][last]
            scale = 1 / (b * ((a / b) * (c / b) - 1))
            A[k][k], A[last][k], A[last][last] = (c / b) * scale, -scale, (a / b) * scale
            for i in range(last + 1, n):
                x, y = A[i][k], A[i][last]
                first, second = x * A[k][k] + y * A[last][k], x * A[last][k] + y * A[last][last]
                for j in range(last + 1, i + 1):
                    A[i][j] = A[j][i] = A[i][j] - (first * A[k][j] + second * A[last][j])
                A[i][k], A[i][last] = first, second
        k += width
    return A, exchanges, 0


def _choose_block(A: Rows, k: int) -> tuple[int, int]:
    """Return how many rows the next pivot has, and the row that is exchanged with its last."""
    n = len(A)
    if k == n - 1:
        return 1, k
    r = max(range(k + 1, n), key=lambda i: abs(A[i][k]))
    diagonal, largest = abs(A[k][k]), abs(A[r][k])
    if not 64 * diagonal < 41 * largest:  # 41/64 is (1 + sqrt(17))/8, nearly: the least growth
        return 1, k
    other = max(abs(A[r][i]) for i in range(k, n) if i != r)
    if not 64 * diagonal * other < 41 * largest * largest:
        return 1, k
    return (2, r) if 64 * abs(A[r][r]) < 41 * other else (1, r)


def _exchange(A: Rows, k: int, i: int, j: int) -> None:
    """Exchange two rows and columns of what is left from row k on."""
    A[i][k:], A[j][k:] = A[j][k:], A[i][k:]
    for row in A[k:]:
        row[i], row[j] = row[j], row[i]


def solve_symmetric(A: Rows, exchanges: Sequence[int], B: Rows) -> None:
    """Put the solution in the place of the rows B."""
    n = len(A)
    k = 0
    while k < n:
        width = 1 if exchanges[k] >= 0 else 2
        last, p = k + width - 1, exchanges[k] if width == 1 else -1 - exchanges[k]
        B[last], B[p] = B[p], B[last]
        for i in range(last + 1, n):
            for j in range(k, last + 1):
                B[i] = [x - A[i][j] * y for x, y in zip(B[i], B[j], strict=True)]
        if width == 1:
            B[k] = [A[k][k] * x for x in B[k]]
        else:
            a, b, c = A[k][k], A[last][k], A[last][last]
            B[k], B[last] = (
                [a * x + b * y for x, y in zip(B[k], B[last], strict=True)],
                [b * x + c * y for x, y in zip(B[k], B[last], strict=True)],
            )
        k += width
    while k > 0:
        width = 1 if exchanges[k - 1] >= 0 else 2
        last, p = k - 1, exchanges[k - 1] if width == 1 else -1 - exchanges[k - 1]
        k -= width
        for j in range(k, last + 1):
            for i in range(last + 1, n):
                B[j] = [x - A[i][j] * y for x, y in zip(B[j], B[i], strict=True)]
        B[last], B[p] = B[p], B[last]


def factorise_general(A: Rows, threshold: Any) -> tuple[Rows, list[int], int]:
    """Return L below, U above and its inverse diagonal, the exchanges of rows, and the column that fails."""
    n = len(A)
    A = [list(row) for row in A]
    scales = [max(abs(row[k]) for row in A) for k in range(n)]
    exchanges: list[int] = []
    for k in range(n):
        p = max(range(k, n), key=lambda i: abs(A[i][k]))
        A[k], A[p] = A[p], A[k]
        exchanges.append(p)
        if not abs(A[k][k]) > threshold * scales[k]:
            return A, exchanges, k + 1
        A[k][k] = 1 / A[k][k]
        for i in range(k + 1, n):
            A[i][k] = A[i][k] * A[k][k]
            for j in range(k + 1, n):
                A[i][j] = A[i][j] - A[i][k] * A[k][j]
    return A, exchanges, 0


def solve_general(A: Rows, exchanges: Sequence[int], B: Rows) -> None:
    """Put the solution in the place of the rows B."""
    n = len(A)
    for k in range(n):
        B[k], B[exchanges[k]] = B[exchanges[k]], B[k]
    for k in range(n):
        for i in range(k + 1, n):
            B[i] = [x - A[i][k] * y for x, y in zip(B[i], B[k], strict=True)]
    for k in reversed(range(n)):
        B[k] = [A[k][k] * x for x in B[k]]
        for i in range(k):
            B[i] = [x - A[i][k] * y for x, y in zip(B[i], B[k], strict=True)]


def solve_transposed(A: Rows, exchanges: Sequence[int], B: Rows) -> None:
    """Put the solution for the transposed matrix in the place of the rows B."""
    n = len(A)
    for k in range(n):
        B[k] = [A[k][k] * x for x in B[k]]
        for i in range(k + 1, n):
            B[i] = [x - A[k][i] * y for x, y in zip(B[i], B[k], strict=True)]
    for k in reversed(range(n)):
        for i in range(k):
            B[i] = [x - A[k][i] * y for x, y in zip(B[i], B[k], strict=True)]
    for k in reversed(range(n)):
        B[k], B[exchanges[k]] = B[exchanges[k]], B[k]


def iterate(
    step: Callable[[list[Any]], list[Any] | None], start: Sequence[Any], limit: Any, iterations: int
) -> tuple[list[Any], bool]:
    """Return y of Newton's method and whether it has converged; `step` returns -J^-1 g(y), or None where J is singular.

    The last step is no longer than `limit`, relative to y or to 1, and a tenth of the one before: then the error is of
    the order of its square. Where J is singular at the solution, steps only halve.
    """
    y, before = list(start), None
    for _ in range(iterations):
        found = step(y)
        if found is None:
            return y, False
        y = [a + b for a, b in zip(y, found, strict=True)]
        sizes = [abs(b) / max(abs(a), 1) for a, b in zip(y, found, strict=True)]
        size = max(sizes)
        if all(x <= limit for x in sizes) and (before is None or 10 * size <= before):  # not so for NaN
            return y, True
        before = size
    return y, False
