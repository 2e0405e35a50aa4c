"""Patterns of matrices that are solved with: how each is factorised, solved with, and what that costs.

    Tree        A = LT D L > 0, L of unit diagonal, with entries only at a row's ancestors
    Symmetric   P A PT = L D LT, indefinite
    General     P A = L U

Of symmetric matrices, wires hold the triangle below the diagonal, and the diagonal.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate
from typing import Any

from mbsgen.errors import TapeError
from mbsgen.procedure import elimination
from mbsgen.procedure.wires import Wire
from mbsgen.tape.types import Op, Sparsity

Rows = list[list[Any]]
Operations = dict[Op, int]
LANES = 16  # columns that the C computes together, MBS_LANES


class Pattern(ABC):
    """A kind of matrix, of `size` rows."""

    size: int
    is_symmetric: bool

    @abstractmethod
    def factors(self, name: str) -> tuple[Wire, ...]:
        """Name the wires that hold the factors of a matrix."""

    @abstractmethod
    def factorise(self, A: Rows, threshold: Any) -> tuple[list[list[Any]], int]:
        """Return the nonzeros of the factors, and the number of the row that fails, or 0."""

    @abstractmethod
    def solve(self, factors: Sequence[Sequence[Any]], B: Rows) -> None:
        """Put A^-1 B in the place of B."""

    def solve_transposed(self, factors: Sequence[Sequence[Any]], B: Rows) -> None:
        """Put A^-T B in the place of B."""
        self.solve(factors, B)

    @abstractmethod
    def count_factors(self) -> Operations:
        """Count the operations of a factorisation, the tests of its pivots aside."""

    @abstractmethod
    def count_solution(self, width: int) -> Operations:
        """Count the operations of a solution for a number of columns."""

    def widen(self, width: int) -> int:
        """Return how many of the given columns are best computed together."""
        return width

    def check_matrix(self, matrix: Wire) -> None:
        """Refuse a wire that cannot be the matrix. Raises TapeError."""
        pattern, n = matrix.sparsity, self.size
        if (pattern.rows, pattern.cols) != (n, n):
            raise TapeError(f"{matrix.name} is {pattern.rows} x {pattern.cols}, where {n} unknowns are solved for")
        if self.is_symmetric and any(c > r for r, c in pattern.entries):
            raise TapeError(f"{matrix.name} has entries above the diagonal, where the triangle below stands for both")

    def spread(self, matrix: Wire, values: Sequence[Any], zero: Any) -> Rows:
        """Write the full matrix by rows."""
        A = [[zero] * self.size for _ in range(self.size)]
        for (r, c), value in zip(matrix.sparsity.entries, values, strict=True):
            A[r][c] = value
            if self.is_symmetric:
                A[c][r] = value
        return A


@dataclass(frozen=True)
class Tree(Pattern):
    """A positive definite matrix that couples each row with its ancestors."""

    ancestors: tuple[tuple[int, ...], ...]  # of each row of L, the columns of its entries, from 0, upwards

    is_symmetric = True

    def __post_init__(self) -> None:
        for k, row in enumerate(self.ancestors):
            if list(row) != sorted(set(row)) or any(not 0 <= i < k for i in row):
                raise TapeError(f"the ancestors {row} of row {k} must lie in 0..{k - 1} and strictly increase")

    @property
    def size(self) -> int:  # type: ignore[override]
        """Count the rows."""
        return len(self.ancestors)

    @property
    def starts(self) -> tuple[int, ...]:
        """Number the first entry of each row of L, and the end."""
        starts = [0]
        for row in self.ancestors:
            starts.append(starts[-1] + len(row))
        return tuple(starts)

    @property
    def below(self) -> tuple[tuple[tuple[int, int], ...], ...]:
        """List the entries of each column of L, from the last row: the row, and its place among all entries."""
        columns: list[list[tuple[int, int]]] = [[] for _ in self.ancestors]
        for k in reversed(range(self.size)):
            for place, i in enumerate(self.ancestors[k], self.starts[k]):
                columns[i].append((k, place))
        return tuple(map(tuple, columns))

    @property
    def below_starts(self) -> tuple[int, ...]:
        """Number the first entry of each column of L, and the end."""
        return (0, *accumulate(map(len, self.below)))

    def factors(self, name: str) -> tuple[Wire, ...]:
        """Name L's entries below the diagonal, row by row, and 1/D."""
        lower, inverses = Sparsity.dense(self.starts[-1]), Sparsity.dense(self.size)
        return Wire(f"{name}_lower", lower), Wire(f"{name}_inverses", inverses)

    def factorise(self, A: Rows, threshold: Any) -> tuple[list[list[Any]], int]:
        """Eliminate from the last row to the first."""
        lower, inverses, failed = elimination.factorise_tree(A, self.ancestors, threshold)
        return [[entry for row in lower for entry in row], inverses], failed

    def solve(self, factors: Sequence[Sequence[Any]], B: Rows) -> None:
        """Substitute from the last row to the first, and back."""
        entries = iter(factors[0])
        lower = [[next(entries) for _ in row] for row in self.ancestors]
        elimination.solve_tree(self.ancestors, lower, factors[1], B)

    def count_factors(self) -> Operations:
        """Count a division for each row, and for each pair of its ancestors a product and a difference."""
        pairs = sum(len(row) * (len(row) + 1) // 2 for row in self.ancestors)
        return {Op.DIV: self.size, Op.MUL: self.starts[-1] + pairs, Op.SUB: pairs}

    def count_solution(self, width: int) -> Operations:
        """Count two products and two differences for each entry of L, and a product for each row."""
        entries = 2 * self.starts[-1] * width
        return {Op.MUL: entries + self.size * width, Op.SUB: entries}

    def widen(self, width: int) -> int:
        """Round up to a multiple of LANES, unless few columns would be computed for nothing."""
        return -(-width // LANES) * LANES if width > LANES // 2 else width


@dataclass(frozen=True)
class Symmetric(Pattern):
    """A symmetric matrix that need not be definite, such as one of an optimum's conditions."""

    size: int

    is_symmetric = True

    def factors(self, name: str) -> tuple[Wire, ...]:
        """Name L with D on its diagonal, by rows, and the exchanges."""
        square, places = Sparsity.dense(self.size**2), Sparsity.dense(self.size)
        return Wire(f"{name}_factors", square), Wire(f"{name}_exchanges", places, is_whole=True)

    def factorise(self, A: Rows, threshold: Any) -> tuple[list[list[Any]], int]:
        """Eliminate by pivots of one row or two."""
        F, exchanges, failed = elimination.factorise_symmetric(A, threshold)
        return [[x for row in F for x in row], exchanges], failed

    def solve(self, factors: Sequence[Sequence[Any]], B: Rows) -> None:
        """Substitute from the first row to the last, and back."""
        elimination.solve_symmetric(_rows(factors[0], self.size), factors[1], B)

    def count_factors(self) -> Operations:
        """Count as if all pivots were of one row; pivots of two rows take about as much."""
        n = self.size
        updates = (n - 1) * n * (n + 1) // 6
        return {Op.DIV: n, Op.MUL: updates + n * (n - 1) // 2, Op.SUB: updates}

    def count_solution(self, width: int) -> Operations:
        """Count as if all pivots were of one row."""
        n = self.size
        return {Op.MUL: n * n * width, Op.SUB: n * (n - 1) * width}


@dataclass(frozen=True)
class General(Pattern):
    """Any regular matrix."""

    size: int

    is_symmetric = False

    def factors(self, name: str) -> tuple[Wire, ...]:
        """Name L and U, by rows, and the exchanges."""
        square, places = Sparsity.dense(self.size**2), Sparsity.dense(self.size)
        return Wire(f"{name}_factors", square), Wire(f"{name}_exchanges", places, is_whole=True)

    def factorise(self, A: Rows, threshold: Any) -> tuple[list[list[Any]], int]:
        """Eliminate by the largest pivot of each column."""
        F, exchanges, failed = elimination.factorise_general(A, threshold)
        return [[x for row in F for x in row], exchanges], failed

    def solve(self, factors: Sequence[Sequence[Any]], B: Rows) -> None:
        """Substitute from the first row to the last, and back."""
        elimination.solve_general(_rows(factors[0], self.size), factors[1], B)

    def solve_transposed(self, factors: Sequence[Sequence[Any]], B: Rows) -> None:
        """Substitute likewise, by columns."""
        elimination.solve_transposed(_rows(factors[0], self.size), factors[1], B)

    def count_factors(self) -> Operations:
        """Count n^3/3 products and differences, nearly."""
        n = self.size
        updates = (n - 1) * n * (2 * n - 1) // 6
        return {Op.DIV: n, Op.MUL: updates + n * (n - 1) // 2, Op.SUB: updates}

    def count_solution(self, width: int) -> Operations:
        """Count n^2 products, and differences except on the diagonal."""
        n = self.size
        return {Op.MUL: n * n * width, Op.SUB: n * (n - 1) * width}


def _rows(values: Sequence[Any], n: int) -> Rows:
    return [list(values[k * n : (k + 1) * n]) for k in range(n)]
