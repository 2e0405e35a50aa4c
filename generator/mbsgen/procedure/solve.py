"""The stages of linear systems A X = B: factors of A, and solutions by them.

With factors of A once for all right-hand sides,

    push    A dX/dx = dB/dx - (dA/dx) X
    pull    A^T Bbar = Xbar,  Abar = -Bbar X^T

so that no factorisation is differentiated. B is given as B^T, which holds the rows of B one after another.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from mbsgen.errors import TapeError
from mbsgen.procedure.patterns import Pattern
from mbsgen.procedure.sheet import Sheet
from mbsgen.procedure.stages import Arithmetic, Outcome, Pulled, Stage, Values
from mbsgen.procedure.straight import written
from mbsgen.procedure.wires import Wire
from mbsgen.tape.builder import Scalar
from mbsgen.tape.counts import Counts
from mbsgen.tape.forward import Gradient
from mbsgen.tape.interpreter import find_threshold
from mbsgen.tape.types import LITERALS, Op, Sparsity

if TYPE_CHECKING:
    from mbsgen.procedure.adjoints import Adjoints
    from mbsgen.procedure.slopes import Slopes

TOLERANCE = 64.0  # roundings of a column's size that a pivot must exceed


@dataclass(frozen=True)
class Factor(Stage):
    """The factors of a matrix. It fails with `status` where a pivot is lost in rounding."""

    name: str
    matrix: Wire
    pattern: Pattern
    status: int
    tolerance: float = TOLERANCE

    def __post_init__(self) -> None:
        self.pattern.check_matrix(self.matrix)
        check_status(self.name, self.status)

    @property
    def reads(self) -> tuple[Wire, ...]:
        """List the matrix."""
        return (self.matrix,)

    @property
    def gives(self) -> tuple[Wire, ...]:
        """List the factors."""
        return self.pattern.factors(self.name)

    @property
    def can_fail(self) -> bool:
        """Return that any matrix may be singular."""
        return True

    def run(self, given: Values, arithmetic: Arithmetic) -> Outcome:
        """Factorise by pivots."""
        A = self.pattern.spread(self.matrix, given[self.matrix.name], _zero(arithmetic))
        factors, failed = self.pattern.factorise(A, find_threshold(self.tolerance, arithmetic.numbers))
        if failed:
            return Outcome(self.status, {})
        return Outcome(0, {wire.name: values for wire, values in zip(self.gives, factors, strict=True)})

    def count(self) -> Counts:
        """Count the factorisation, with a product for the test of each pivot."""
        return Counts(self.pattern.count_factors(), 0, self.pattern.size)

    def push(self, slopes: Slopes) -> Sequence[Stage]:
        """Return the stage alone: solutions have slopes, factors have none."""
        assert not any(map(slopes.has, self.gives)), "no stage gives factors a slope"
        return (self,)

    def pull(self, adjoints: Adjoints) -> Pulled:
        """Return the stage alone: solutions carry adjoints to the matrix."""
        assert not any(map(adjoints.has, self.gives)), "no stage gives factors an adjoint"
        return Pulled((self,), ())


@dataclass(frozen=True)
class Block:
    """A result, of columns of X one after another; a column of the result may hold several of them."""

    result: Wire  # of n rows, or of a multiple: as many columns of X are one of the result
    first: int  # the column of X that its first one is

    def entries(self, n: int) -> Iterator[tuple[int, int]]:
        """Yield the row and the column of X that each nonzero is."""
        together = self.result.sparsity.rows // n
        for r, c in self.result.sparsity.entries:
            yield r % n, self.first + c * together + r // n

    def last(self, n: int) -> int:
        """Number the column of X after its last one."""
        return self.first + self.result.numel // n


@dataclass(frozen=True)
class Solve(Stage):
    """X of A X = B, or of A^T X = B, by the factors of A. Results are blocks of X, or of -X."""

    name: str
    pattern: Pattern
    factors: tuple[Wire, ...]
    right: Wire  # B^T
    blocks: tuple[Block, ...]
    negated: bool = False
    transposed: bool = False

    def __post_init__(self) -> None:
        n, width = self.pattern.size, self.right.sparsity.rows
        if self.right.sparsity.cols != n:
            raise TapeError(f"{self.name}: {self.right.name} has {self.right.sparsity.cols} columns for {n} unknowns")
        expected = [wire.sparsity for wire in self.pattern.factors(self.name)]
        if [wire.sparsity for wire in self.factors] != expected:
            raise TapeError(f"{self.name}: {[wire.name for wire in self.factors]} are no factors of such a matrix")
        for block in self.blocks:
            if block.result.sparsity.rows % n or not 0 <= block.first <= block.last(n) <= width:
                raise TapeError(f"{self.name}: {block.result.name} does not lie within {width} columns of {n} rows")

    @property
    def width(self) -> int:
        """Count the columns."""
        return self.right.sparsity.rows

    @property
    def reads(self) -> tuple[Wire, ...]:
        """List the factors and the right-hand sides."""
        return (*self.factors, self.right)

    @property
    def gives(self) -> tuple[Wire, ...]:
        """List the results."""
        return tuple(block.result for block in self.blocks)

    @property
    def can_fail(self) -> bool:
        """Return that factors were tested before."""
        return False

    def run(self, given: Values, arithmetic: Arithmetic) -> Outcome:
        """Substitute."""
        B: list[list[Any]] = [[_zero(arithmetic)] * self.width for _ in range(self.pattern.size)]
        for (c, r), value in zip(self.right.sparsity.entries, given[self.right.name], strict=True):
            B[r][c] = value
        substitute = self.pattern.solve_transposed if self.transposed else self.pattern.solve
        substitute([given[wire.name] for wire in self.factors], B)
        sign = -1 if self.negated else 1
        return Outcome(
            0, {b.result.name: [sign * B[r][c] for r, c in b.entries(self.pattern.size)] for b in self.blocks}
        )

    def count(self) -> Counts:
        """Count the substitutions for all columns, and the signs of the results."""
        signs = {Op.NEG: sum(block.result.sparsity.nnz for block in self.blocks)} if self.negated else {}
        return Counts(dict(Counter(self.pattern.count_solution(self.width)) + Counter(signs)), 0)

    def keep(self, names: frozenset[str]) -> Solve:
        """Leave out the other blocks."""
        kept = tuple(block for block in self.blocks if block.result.name in names)
        return self if kept == self.blocks else replace(self, blocks=kept)

    def push(self, slopes: Slopes) -> Sequence[Stage]:
        """Solve with the same factors for dB/dx - (dA/dx) X."""
        matrix = self._find_matrix(slopes.matrix(self.factors))
        wrt = [x for x in slopes.sizes if x in {*slopes.by(self.right), *slopes.by(matrix)}]
        if not wrt:
            return (self,)
        whole = self._whole(slopes.name(f"{self.name}_whole")) if slopes.has(matrix) else self
        sheet = Sheet()
        right = self._differentiate(sheet, slopes, matrix, whole)
        places: dict[tuple[int, int], Scalar] = {}
        blocks, used, n = [], 0, self.pattern.size
        for block in self.blocks:
            together = block.result.numel // n
            for x in wrt:
                size = slopes.sizes[x]
                entries = [(row, d) for row in block.result.places for d in slopes.places[x]]
                wire = slopes.register(block.result, x, Sparsity.of(block.result.numel, size, entries))
                blocks.append(Block(wire, used))
                for (r, c), gradient in right.items():
                    if block.first <= c < block.first + together:
                        for d in slopes.places[x]:
                            value = gradient.get(slopes.column(x, d))
                            if value is not None and not value.is_zero:
                                places[used + d * together + c - block.first, r] = value
                used += size * together
        wire = _give(sheet, slopes.name(f"{self.name}_slopes_right"), self.pattern.widen(used), n, places)
        solve = replace(self, name=slopes.name(f"{self.name}_slopes"), right=wire, blocks=tuple(blocks))
        return (whole, *written(sheet, slopes.name(f"{wire.name}_sheet")), solve)

    def _differentiate(
        self, sheet: Sheet, slopes: Slopes, matrix: Wire, whole: Solve
    ) -> dict[tuple[int, int], Gradient]:
        """Compute the gradients of the entries of B - A X, at fixed X."""
        right: dict[tuple[int, int], Gradient] = {
            (r, c): gradient
            for (c, r), gradient in zip(self.right.sparsity.entries, slopes.take(sheet, self.right), strict=True)
        }
        if not slopes.has(matrix):
            return right
        X = whole.read(sheet)
        for (i, j), gradient in zip(matrix.sparsity.entries, slopes.take(sheet, matrix), strict=True):
            for r, k in self._pairs(i, j):
                for (row, c), x in X.items():
                    if row == k:
                        total = right.setdefault((r, c), {})
                        for column, value in gradient.items():
                            product = value * x
                            total[column] = total[column] - product if column in total else -product
        return right

    def _pairs(self, i: int, j: int) -> tuple[tuple[int, int], ...]:
        """List the rows and the columns of the system's matrix at which a nonzero of A stands."""
        if self.pattern.is_symmetric:
            return ((i, j),) if i == j else ((i, j), (j, i))
        return ((j, i),) if self.transposed else ((i, j),)

    def pull(self, adjoints: Adjoints) -> Pulled:
        """Solve with the transposed matrix for the adjoint of B; the adjoint of A is its product with X."""
        matrix = self._find_matrix(adjoints.matrix(self.factors))
        n = self.pattern.size
        seeds = Sheet()
        Xbar: dict[tuple[int, int], Scalar] = {}
        for block in self.blocks:
            if adjoints.has(block.result):
                for (r, c), seed in zip(block.entries(n), adjoints.take(seeds, block.result), strict=True):
                    Xbar[c, r] = Xbar[c, r] + seed if (c, r) in Xbar else seed
        wire = _give(seeds, adjoints.name(f"{self.name}_back_right"), self.width, n, Xbar)
        whole = self._whole(adjoints.name(f"{self.name}_whole")) if adjoints.is_active(matrix) else self
        back = replace(
            self,
            name=adjoints.name(f"{self.name}_back"),
            right=wire,
            blocks=(Block(Wire(adjoints.name(f"{self.name}_back_x"), Sparsity.dense(n, self.width)), 0),),
            transposed=not self.transposed,
        )
        sheet = Sheet()
        B = back.read(sheet, negated=False)  # back.negated: the sign of X in the results is in it
        adjoints.give(sheet, self.right, [B.get((r, c), sheet.builder.zero) for c, r in self.right.sparsity.entries])
        if adjoints.is_active(matrix):
            X = whole.read(sheet)
            adjoints.give(sheet, matrix, [self._weigh(sheet, B, X, i, j) for i, j in matrix.sparsity.entries])
        names = adjoints.name(f"{wire.name}_sheet"), adjoints.name(f"{back.name}_sheet")
        return Pulled((whole,), (*written(seeds, names[0]), back, *written(sheet, names[1])))

    def _weigh(
        self, sheet: Sheet, B: dict[tuple[int, int], Scalar], X: dict[tuple[int, int], Scalar], i: int, j: int
    ) -> Scalar:
        total = sheet.builder.zero
        for r, k in self._pairs(i, j):
            for c in range(self.width):
                if (k, c) in X and (r, c) in B:
                    total = total - B[r, c] * X[k, c]
        return total

    def _find_matrix(self, matrix: Wire | None) -> Wire:
        if matrix is None:
            raise TapeError(f"{self.name} cannot be differentiated: no stage factorises {self.factors[0].name}")
        return matrix

    @property
    def used(self) -> frozenset[int]:
        """Collect the columns that are not zero from the start."""
        return frozenset(c for c, _ in self.right.sparsity.entries)

    def _whole(self, name: str) -> Solve:
        """Return the stage with all used columns of X among its results."""
        n = self.pattern.size
        held = {place for block in self.blocks for place in block.entries(n)}
        if all((r, c) in held for r in range(n) for c in self.used):
            return self
        entries = [(r, c) for r in range(n) for c in self.used]
        wire = Wire(name, Sparsity.of(n, self.width, entries))
        return replace(self, blocks=(*self.blocks, Block(wire, 0)))

    def read(self, sheet: Sheet, *, negated: bool | None = None) -> dict[tuple[int, int], Scalar]:
        """Read X from the results, by row and column."""
        minus = self.negated if negated is None else negated
        return {
            place: -value if minus else value
            for block in self.blocks
            for place, value in zip(block.entries(self.pattern.size), sheet.take(block.result), strict=True)
            if place[1] in self.used
        }


def _give(sheet: Sheet, name: str, width: int, n: int, places: dict[tuple[int, int], Scalar]) -> Wire:
    """Write right-hand sides, by column and row."""
    pattern = Sparsity.of(width, n, places)
    wire = Wire(name, pattern)
    sheet.give(wire, [places[place] for place in pattern.entries])
    return wire


def check_status(name: str, status: int) -> None:
    """Refuse a status that would not be seen. Raises TapeError."""
    if status <= 0:
        raise TapeError(f"{name}: a failure has a status above 0, not {status}")


def _zero(arithmetic: Arithmetic) -> Any:
    return arithmetic.numbers.literal(LITERALS.mpf(0))
