"""Solve M x = b by M = LT D L, from the leaves to the base; only ancestors have entries (Featherstone, 2008, 6.5).

For k = n, ..., 1, over the ancestors i, j of k:    L_ik = M_ik / D_k,    M_ij -= L_ik D_k L_jk,    D_k = M_kk.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

from mbsgen.tape.builder import Builder, Scalar

Entries = dict[tuple[int, int], Scalar]  # of a symmetric matrix, by numbers (ancestor, descendant), from 1
Check = Callable[[int, Scalar], None]  # of a pivot, with its number
Column = dict[int, Scalar]  # by number, from 1


@dataclass(frozen=True)
class Solution:
    """The solution and its pivots."""

    x: Column
    pivots: Column


@dataclass(frozen=True)
class Factors:
    """M = LT D L, with L of unit diagonal."""

    builder: Builder
    size: int
    L: Entries  # by (ancestor, descendant)
    D: Column
    inverses: Column  # of D

    def solve(self, b: Mapping[int, Scalar]) -> Column:
        """Solve M x = b; entries that b leaves out are zero."""
        return self.rise(self.descend(b))

    def solve_once(self, b: Mapping[int, Scalar]) -> Column:
        """Solve M x = b where no other column follows: the last pivot divides its unknown, without an inverse."""
        y, known = self.descend(b), {}
        for k in range(1, self.size + 1):
            if not self.ancestors(k):
                known[k] = y[k] / self.D[k]
        return self.rise(y, known)

    def descend(self, b: Mapping[int, Scalar]) -> Column:
        """Solve LT y = b, from the leaves to the base."""
        y = {k: b.get(k, self.builder.zero) for k in range(1, self.size + 1)}
        for k in range(self.size, 0, -1):
            for i in self.ancestors(k):
                y[i] = y[i] - self.L[i, k] * y[k]
        return y

    def rise(self, y: Mapping[int, Scalar], known: Mapping[int, Scalar] | None = None) -> Column:
        """Solve D L x = y, from the base to the leaves; known entries of x are taken over."""
        x: Column = dict(known or {})
        for k in range(1, self.size + 1):
            if k not in x:
                value = y[k] * self.inverses[k]
                for i in self.ancestors(k):
                    value = value - self.L[i, k] * x[i]
                x[k] = value
        return x

    def invert(self, columns: Iterable[int]) -> dict[int, Column]:
        """Compute columns of the inverse of M; an entry that two columns share by symmetry is computed once."""
        found: dict[int, Column] = {}
        for j in sorted(columns, reverse=True):
            y = self.descend({j: self.builder.number(1.0)})
            found[j] = self.rise(y, {i: column[j] for i, column in found.items()})
        return found

    def ancestors(self, k: int) -> Sequence[int]:
        """List the unknowns from which k is eliminated."""
        return [i for i in range(1, k) if (i, k) in self.L]


def factorise(
    builder: Builder, matrix: Mapping[tuple[int, int], Scalar], size: int, check: Check = lambda *_: None
) -> Factors:
    """Factorise a matrix of the unknowns 1 to `size`; each later unknown is eliminated from the earlier ones.

    `check` sees each pivot, with its number, before a division by it.
    """
    H = dict(matrix)
    L: Entries = {}
    inverses: Column = {}
    one = builder.number(1.0)
    for k in range(size, 0, -1):
        column = [i for i in range(1, k) if (i, k) in H and not H[i, k].is_zero]
        check(k, H[k, k])
        inverses[k] = one / H[k, k]
        for i in column:
            L[i, k] = H[i, k] * inverses[k]
        for n, i in enumerate(column):
            for j in column[n:]:
                H[i, j] = H.get((i, j), builder.zero) - L[i, k] * H[j, k]
    return Factors(builder, size, L, {k: H[k, k] for k in inverses}, inverses)


def solve(
    builder: Builder, matrix: Mapping[tuple[int, int], Scalar], b: Mapping[int, Scalar], size: int, check: Check
) -> Solution:
    """Solve for the unknowns 1 to `size` at once."""
    factors = factorise(builder, matrix, size, check)
    return Solution(factors.solve_once(b), factors.D)
