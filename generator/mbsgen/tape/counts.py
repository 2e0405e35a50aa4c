"""What a tape costs: one table of policy, two conventions."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

from mbsgen.manifest import Flops
from mbsgen.tape.types import Op, Tape

ARITHMETIC = frozenset({Op.ADD, Op.SUB, Op.MUL, Op.DIV})
PAPER = ARITHMETIC | {Op.NEG, Op.SQRT, Op.SIN, Op.COS}  # the closest match to the counts that Robotran prints


@dataclass(frozen=True)
class Counts:
    """Operations by kind, and the number of equations."""

    operations: dict[Op, int]
    equations: int

    def of(self, *ops: Op) -> int:
        """Add up the operations of the given kinds."""
        return sum(self.operations.get(op, 0) for op in ops)

    @property
    def flops(self) -> Flops:
        """Table the operations as manifest and report carry them."""
        return Flops(
            paper=self.paper,
            arithmetic=self.arithmetic,
            add=self.of(Op.ADD, Op.SUB),
            mul=self.of(Op.MUL),
            div=self.of(Op.DIV),
            neg=self.of(Op.NEG),
            sqrt=self.of(Op.SQRT),
            trig=self.of(Op.SIN, Op.COS),
            other=sum(self.operations.values()) - self.of(*PAPER),
        )

    @property
    def paper(self) -> int:
        """Count by the paper's convention: + - * /, unary minus, sqrt, sin and cos, one each."""
        return self.of(*PAPER)

    @property
    def arithmetic(self) -> int:
        """Count + - * /."""
        return self.of(*ARITHMETIC)


def count(tape: Tape) -> Counts:
    """Count a tape's operations, and its equations: the assignments left when values used once are inlined."""
    return Counts(dict(Counter(op for op, _, _ in tape.operations)), len(equation_values(tape)))


def equation_values(tape: Tape) -> tuple[int, ...]:
    """List the values that get an equation of their own: operations used other than once, or given out."""
    uses = Counter(x for op, *operands in tape.operations for x in operands[: op.arity])
    given = {v for o in tape.outputs for v in o.values}
    numbered = range(tape.first_operation, tape.first_operation + len(tape.operations))
    return tuple(v for v in numbered if v in given or uses[v] != 1)
