"""Where the nonzeros of functions at many places belong in a Jacobian or a Hessian; indices and coefficients alone.

With y = C x the parts of x that a block reads, J = F' C and H = C' (lam' F'') C: a nonzero of F' or F'' at a place
contributes to the entries at which its rows of C are not 0. So patterns are exact, whatever backend has the values.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from mbsrun.ocp.ground.functions import Array, Indices, Pattern
from mbsrun.ocp.ground.program import Block, Matrix


@dataclass(frozen=True)
class Scatter:
    """Entries of a matrix: coefficient * values[source], at (row, col)."""

    row: Indices
    col: Indices
    coefficient: Array
    source: Indices

    def upper(self) -> Scatter:
        """Keep the upper triangle."""
        kept = np.flatnonzero(self.row <= self.col)
        return Scatter(self.row[kept], self.col[kept], self.coefficient[kept], self.source[kept])

    def transposed(self) -> Scatter:
        """Swap rows and columns."""
        return Scatter(self.col, self.row, self.coefficient, self.source)


@dataclass(frozen=True)
class Parts:
    """The parts of x that a block reads, in the forms that assembly and evaluation need."""

    block: Block
    columns: tuple[Indices | Matrix, ...]  # indices, (size, places); or a matrix, (places * size, variables)

    @property
    def places(self) -> int:
        """Count the places."""
        return self.block.places

    def scatter_jacobian(self, pattern: Pattern, part: int) -> Scatter:
        """Place the nonzeros of F' by one part, place by place: rows are the block's rows."""
        row, col = pattern.row, pattern.col
        source, coefficient = self._all(row.size)
        row_at = self.block.rows[row].T.ravel()
        which, col_at, factor = self._find(part, self._entries(col, pattern.shape[1]))
        return Scatter(row_at[which], col_at, coefficient[which] * factor, source[which])

    def scatter_gradient(self, rows: Indices, size: int, part: int) -> Scatter:
        """Place derivatives by some entries of one part, of `size`, in a column."""
        source, coefficient = self._all(rows.size)
        which, row_at, factor = self._find(part, self._entries(rows, size))
        return Scatter(row_at, np.zeros_like(row_at), coefficient[which] * factor, source[which])

    def scatter_hessian(self, pattern: Pattern, first: int, second: int) -> Scatter:
        """Place the nonzeros of F'' by two parts."""
        source, coefficient = self._all(pattern.row.size)
        which, row_at, factor = self._find(first, self._entries(pattern.row, pattern.shape[0]))
        source, coefficient = source[which], coefficient[which] * factor
        which, col_at, factor = self._find(second, self._entries(pattern.col, pattern.shape[1])[source])
        return Scatter(row_at[which], col_at, coefficient[which] * factor, source[which])

    def scatter_results(self) -> Scatter:
        """Place the results themselves in a column: row, scale."""
        source, coefficient = self._all(self.block.rows.shape[0])
        row = self.block.rows.T.ravel()
        return Scatter(row, np.zeros_like(row), coefficient, source)

    def _all(self, nonzeros: int) -> tuple[Indices, Array]:
        return np.arange(self.places * nonzeros), np.repeat(self.block.scales, nonzeros)

    def _entries(self, entries: Indices, size: int) -> Indices:
        """Number entries of a part at all places, place by place."""
        return (np.arange(self.places)[:, None] * size + entries).ravel()

    def _find(self, part: int, entries: Indices) -> tuple[Indices, Indices, Array]:
        """Find the variables that make some entries of a part: position in `entries`, variable and coefficient."""
        columns = self.columns[part]
        if isinstance(columns, np.ndarray):
            return np.arange(entries.size), columns.T.ravel()[entries], np.ones(entries.size)
        rows = sparse.csr_array(columns)
        first = rows.indptr[entries].astype(np.int64)
        counts = rows.indptr[entries + 1] - first
        which = np.repeat(np.arange(entries.size), counts)
        at = np.arange(which.size) - np.repeat(np.cumsum(counts) - counts, counts) + first[which]
        return which, rows.indices[at].astype(np.int64), rows.data[at]


def prepare(block: Block, variables: int) -> Parts:
    """Write the combinations of a block as matrices."""
    return Parts(
        block, tuple(part if isinstance(part, np.ndarray) else part.matrix(variables) for part in block.columns)
    )


def scatter_matrix(matrix: Matrix) -> Scatter:
    """Place the nonzeros of a constant matrix."""
    coo = matrix.tocoo()
    row, col = (k.astype(np.int64) for k in coo.coords)
    return Scatter(row, col, np.ones(coo.nnz), np.arange(coo.nnz))


def scatter_weighted(matrices: Sequence[Matrix]) -> Scatter:
    """Place the nonzeros of constant matrices with weights, which are the values."""
    coos = [matrix.tocoo() for matrix in matrices]
    row, col = (np.concatenate([c.coords[axis] for c in coos]).astype(np.int64) for axis in (0, 1))
    which = np.repeat(np.arange(len(coos)), [c.nnz for c in coos])
    return Scatter(row, col, np.concatenate([c.data for c in coos]), which)


@dataclass(frozen=True)
class Assembled:
    """The sum of scatters of values that lie one after the other: pattern by columns, and the nonzero of each entry."""

    row: Indices  # of the nonzeros
    col: Indices
    nonzero: Indices  # of each entry
    coefficient: Array  # of each entry
    source: Indices  # of each entry, in all values

    @property
    def is_permutation(self) -> bool:
        """Return whether no two entries meet, and all coefficients are 1."""
        return len(self.row) == len(self.nonzero) and bool((self.coefficient == 1.0).all())


def assemble(shape: tuple[int, int], parts: Sequence[Scatter], sizes: Sequence[int]) -> Assembled:
    """Sum scatters; `sizes` count their values. Nonzeros are ordered column by column."""
    offsets = np.cumsum([0, *sizes])[:-1]
    row, col = (np.concatenate([getattr(p, k) for p in parts] or [np.zeros(0, np.int64)]) for k in ("row", "col"))
    coefficient = np.concatenate([p.coefficient for p in parts] or [np.zeros(0)])
    shifted = [p.source + offset for p, offset in zip(parts, offsets, strict=True)]
    source = np.concatenate(shifted or [np.zeros(0, dtype=np.int64)])
    places, nonzero = np.unique(col * shape[0] + row, return_inverse=True)
    return Assembled(places % shape[0], places // shape[0], nonzero, coefficient, source)
