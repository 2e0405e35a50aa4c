"""The stage of an iteration: y of g(w, y) = 0, by Newton's method from a given start.

    y <- y - J^-1 g(w, y),    J = dg/dy

The solution does not depend on the start, so by the implicit function theorem, at the solution,

    push    J dy/dx = -(dg/dw) (dw/dx)
    pull    J^T mu = -ybar,  wbar = (dg/dw)^T mu

and no iteration is differentiated.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from mbsgen.errors import TapeError
from mbsgen.procedure import elimination
from mbsgen.procedure.patterns import Pattern
from mbsgen.procedure.sheet import Sheet
from mbsgen.procedure.solve import TOLERANCE, Block, Factor, Solve, check_status
from mbsgen.procedure.stages import Arithmetic, Outcome, Pulled, Stage, Values
from mbsgen.procedure.straight import written
from mbsgen.procedure.wires import Wire
from mbsgen.tape import counts
from mbsgen.tape.builder import Scalar
from mbsgen.tape.counts import Counts
from mbsgen.tape.forward import Gradient, carry
from mbsgen.tape.interpreter import find_threshold, run
from mbsgen.tape.replay import replay, replay_guards
from mbsgen.tape.reverse import sweep
from mbsgen.tape.types import LITERALS, Op, Sparsity, Tape

if TYPE_CHECKING:
    from mbsgen.procedure.adjoints import Adjoints
    from mbsgen.procedure.slopes import Slopes

ITERATIONS = 20


@dataclass(frozen=True)
class Newton(Stage):
    """An iteration. It fails with `status` where J is singular, or where it does not converge.

    The first output of `residual` is g, the second J; of a symmetric pattern, J's triangle below the diagonal.
    """

    name: str
    residual: Tape
    unknown: str  # the input of `residual` that is solved for; the others are wires
    start: Wire
    solution: Wire
    pattern: Pattern
    status: int
    iterations: int = ITERATIONS
    tolerance: float = TOLERANCE  # of the pivots

    def __post_init__(self) -> None:
        check_status(self.name, self.status)
        n, column = self.pattern.size, Sparsity.dense(self.pattern.size)
        if self.unknown not in {i.name for i in self.residual.inputs} or len(self.residual.outputs) != 2:
            raise TapeError(f"{self.name}: the residual has the input {self.unknown}, and the outputs g and J")
        unknown, g = self.residual.input(self.unknown).sparsity, self.residual.outputs[0].sparsity
        if {unknown, g, self.start.sparsity, self.solution.sparsity} != {column}:
            raise TapeError(f"{self.name}: unknown, residual, start and solution are full columns of {n} entries")
        if self.iterations < 1:
            raise TapeError(f"{self.name}: {self.iterations} iterations are none")
        self.pattern.check_matrix(self.jacobian)

    @property
    def jacobian(self) -> Wire:
        """Return the output that is dg/dy."""
        output = self.residual.outputs[1]
        return Wire.of(output)

    @property
    def wires(self) -> tuple[Wire, ...]:
        """List what the residual depends on besides the unknown."""
        return tuple(Wire.of(i) for i in self.residual.inputs if i.name != self.unknown)

    @property
    def reads(self) -> tuple[Wire, ...]:
        """List what the residual depends on, and the start."""
        return tuple(dict.fromkeys((*self.wires, self.start)))

    @property
    def gives(self) -> tuple[Wire, ...]:
        """List the solution."""
        return (self.solution,)

    @property
    def tapes(self) -> tuple[Tape, ...]:
        """Return the tape."""
        return (self.residual,)

    def with_tapes(self, tapes: Sequence[Tape]) -> Newton:
        """Replace the tape."""
        (residual,) = tapes
        return replace(self, residual=residual)

    @property
    def can_fail(self) -> bool:
        """Return that there may be no solution."""
        return True

    def run(self, given: Values, arithmetic: Arithmetic) -> Outcome:
        """Iterate; a guard of the residual fails as it does elsewhere."""
        status, numbers = 0, arithmetic.numbers

        def step(y: Sequence[Any]) -> list[Any] | None:
            nonlocal status
            status, found = run(self.residual, {**given, self.unknown: y}, numbers, tested=arithmetic.tested)
            g, J = (found[output.name] for output in self.residual.outputs)
            A = self.pattern.spread(self.jacobian, J, numbers.literal(LITERALS.mpf(0)))
            factors, failed = self.pattern.factorise(A, find_threshold(self.tolerance, numbers))
            if status or failed:
                return None
            B = [[-x] for x in g]
            self.pattern.solve(factors, B)
            return [row[0] for row in B]

        limit = numbers.functions[Op.SQRT](numbers.epsilon)
        y, has_converged = elimination.iterate(step, given[self.start.name], limit, self.iterations)
        return Outcome(0 if has_converged else status or self.status, {self.solution.name: y} if has_converged else {})

    def count(self) -> Counts:
        """Count one iteration."""
        tape, n = counts.count(self.residual), self.pattern.size
        operations = {**tape.operations}
        for more in (self.pattern.count_factors(), self.pattern.count_solution(1), {Op.SUB: n}):
            for op, times in more.items():
                operations[op] = operations.get(op, 0) + times
        return Counts(operations, tape.equations, tape.guards + n)

    def push(self, slopes: Slopes) -> Sequence[Stage]:
        """Solve for the slopes of the solution."""
        wrt = [x for x in slopes.sizes if any(x in slopes.by(wire) for wire in self.wires)]
        if not wrt:
            return (self,)
        n, sheet = self.pattern.size, Sheet()
        values = self._replay(sheet)
        given: list[Gradient] = []
        for i in self.residual.inputs:
            given += [{} for _ in range(n)] if i.name == self.unknown else slopes.take(sheet, self._wire(i.name))
        gradients = carry(self.residual, sheet.builder, values, given)
        places: dict[tuple[int, int], Scalar] = {}
        blocks, used, g = [], 0, self.residual.outputs[0]
        for x in wrt:
            columns = [k for k in slopes.places[x] if any(slopes.column(x, k) in gradients[v] for v in g.values)]
            pattern = Sparsity.of(n, slopes.sizes[x], [(r, k) for r in range(n) for k in columns])
            blocks.append(Block(slopes.register(self.solution, x, pattern), used))
            for r, value in enumerate(g.values):
                for k in columns:
                    entry = gradients[value].get(slopes.column(x, k))
                    if entry is not None and not entry.is_zero:
                        places[used + k, r] = entry
            used += slopes.sizes[x]
        pattern = Sparsity.of(self.pattern.widen(used), n, places)
        right = Wire(slopes.name(f"{self.name}_slopes_right"), pattern)
        sheet.give(right, [places[place] for place in pattern.entries])
        factor = self._factor(sheet, values, *self._name_factor(slopes.name))
        name = slopes.name(f"{self.name}_slopes")
        solve = Solve(name, self.pattern, factor.gives, right, tuple(blocks), negated=True)
        return (self, *written(sheet, slopes.name(f"{self.name}_sheet")), factor, solve)

    def pull(self, adjoints: Adjoints) -> Pulled:
        """Solve for the multipliers mu, and weigh the residual's derivatives by them."""
        n, first = self.pattern.size, Sheet()
        seeds = adjoints.take(first, self.solution)
        right = Wire(adjoints.name(f"{self.name}_back_right"), Sparsity.dense(1, n))
        first.give(right, seeds)
        values = self._replay(first)
        factor = self._factor(
            first, values, adjoints.name(f"{self.name}_jacobian"), adjoints.name(f"{self.name}_factor")
        )
        mu = Wire(adjoints.name(f"{self.name}_multipliers"), Sparsity.dense(n))
        name = adjoints.name(f"{self.name}_back")
        solve = Solve(name, self.pattern, factor.gives, right, (Block(mu, 0),), negated=True, transposed=True)
        second = Sheet()
        values = self._replay(second)
        weights: dict[int, Scalar] = {}
        for value, weight in zip(self.residual.outputs[0].values, second.take(mu), strict=True):
            weights[value] = weights[value] + weight if value in weights else weight
        found = sweep(self.residual, second.builder, values, weights)
        place = 0
        for i in self.residual.inputs:
            if i.name != self.unknown:
                entries = range(place, place + i.sparsity.nnz)
                adjoints.give(second, self._wire(i.name), [found.get(k, second.builder.zero) for k in entries])
            place += i.sparsity.nnz
        sheets = [adjoints.name(f"{self.name}_sheet") for _ in range(2)]
        return Pulled((self,), (*written(first, sheets[0]), factor, solve, *written(second, sheets[1])))

    def _name_factor(self, name: Callable[[str], str]) -> tuple[str, str]:
        return name(f"{self.name}_jacobian"), name(f"{self.name}_factor")

    def _wire(self, name: str) -> Wire:
        return next(wire for wire in self.wires if wire.name == name)

    def _replay(self, sheet: Sheet) -> list[Scalar]:
        """Compute the residual at the solution."""
        given = {wire.name: sheet.take(wire) for wire in self.wires} | {self.unknown: sheet.take(self.solution)}
        values = replay(self.residual, sheet.builder, given)
        replay_guards(self.residual, sheet.builder, values)
        return values

    def _factor(self, sheet: Sheet, values: Sequence[Scalar], matrix: str, name: str) -> Factor:
        wire = Wire(matrix, self.jacobian.sparsity)
        sheet.give(wire, [values[v] for v in self.residual.outputs[1].values])
        return Factor(name, wire, self.pattern, self.status, self.tolerance)
