"""Solve M x = b by LT D L, from the leaves to the base; only ancestors have entries (Featherstone, 2008, 6.5)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from mbsgen.tape.builder import Builder, Scalar

Entries = dict[tuple[int, int], Scalar]  # of a symmetric matrix, by numbers (ancestor, descendant), from 1


@dataclass(frozen=True)
class Solution:
    """The solution, and the pivots by which it was found."""

    x: dict[int, Scalar]
    pivots: dict[int, Scalar]


def solve(builder: Builder, matrix: Mapping[tuple[int, int], Scalar], b: Mapping[int, Scalar], size: int) -> Solution:
    """Solve for the unknowns 1 to `size`; each later one is eliminated from those before it."""
    H, right = dict(matrix), dict(b)
    factors: Entries = {}
    inverses: dict[int, Scalar] = {}
    one = builder.number(1.0)
    for k in range(size, 0, -1):
        column = [i for i in range(1, k) if (i, k) in H and not H[i, k].is_zero]
        inverses[k] = one / H[k, k]
        for i in column:
            factors[i, k] = H[i, k] * inverses[k]
        for n, i in enumerate(column):
            right[i] = right[i] - factors[i, k] * right[k]
            for j in column[n:]:
                H[i, j] = H.get((i, j), builder.zero) - factors[i, k] * H[j, k]
    x: dict[int, Scalar] = {}
    for k in range(1, size + 1):
        value = right[k] * inverses[k]
        for i in _rows(factors, k):
            value = value - factors[i, k] * x[i]
        x[k] = value
    return Solution(x, {k: H[k, k] for k in inverses})


def _rows(factors: Entries, k: int) -> Sequence[int]:
    return [i for i in range(1, k) if (i, k) in factors]
