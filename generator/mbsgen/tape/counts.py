"""The cost of a tape: one table of policy, two conventions.

An equation is an assignment in the C function that computes something: a named value (a sine and a cosine have one
each), or a nonzero of a result that is computed where it is stored. The targets write the names of `named_values`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from functools import wraps
from operator import itemgetter
from typing import TypeVar

from mbsgen.manifest import Flops
from mbsgen.tape.types import ADD, DIV, MUL, NEG, SUB, Op, Tape

ARITHMETIC = frozenset({ADD, SUB, MUL, DIV})
PAPER = ARITHMETIC | {NEG, Op.SQRT, Op.SIN, Op.COS}  # the closest match to the counts that Robotran prints
INLINED = 3  # the most operations of a value that is written into another expression; a sum may be of any length
_SUMS = frozenset({ADD, SUB})
_TURNS = frozenset({Op.SIN, Op.COS})
_OP, _FIRST, _SECOND = map(itemgetter, range(3))

T = TypeVar("T")


def once(find: Callable[[Tape], T]) -> Callable[[Tape], T]:
    """Return a function that a tape remembers: counts, reports and targets ask for the same."""
    key = f"once {find.__name__}"

    @wraps(find)
    def remembered(tape: Tape) -> T:
        known = tape.__dict__
        if key not in known:
            known[key] = find(tape)
        found: T = known[key]
        return found

    return remembered


@dataclass(frozen=True)
class Counts:
    """Operations by kind, and the number of equations."""

    operations: dict[Op, int]
    equations: int
    guards: int = 0  # products and signs in the tests of guards; they are not operations of the tape

    def of(self, *ops: Op) -> int:
        """Return the number of operations of the given kinds."""
        return sum(self.operations.get(op, 0) for op in ops)

    @property
    def flops(self) -> Flops:
        """Return the table of operations in manifest and report."""
        return Flops(
            paper=self.paper,
            arithmetic=self.arithmetic,
            add=self.of(ADD, SUB),
            mul=self.of(MUL),
            div=self.of(DIV),
            neg=self.of(NEG),
            sqrt=self.of(Op.SQRT),
            trig=self.of(Op.SIN, Op.COS),
            other=sum(self.operations.values()) - self.of(*PAPER),
            guard=self.guards,
        )

    @property
    def paper(self) -> int:
        """Return the count by the paper's convention: + - * /, unary minus, sqrt, sin and cos, one each."""
        return self.of(*PAPER)

    @property
    def arithmetic(self) -> int:
        """Return the count of + - * /."""
        return self.of(*ARITHMETIC)


def count_paper(tape: Tape) -> int:
    """Count the operations of a tape by the paper's convention, without its equations, which takes longer."""
    return sum(number for op, number in Counter(map(_OP, tape.operations)).items() if op in PAPER)


@once
def count(tape: Tape) -> Counts:
    """Count the operations of a tape, the operations of its guards, and its equations."""
    operations = dict(Counter(map(_OP, tape.operations)))
    return Counts(operations, _count_equations(tape), sum(1 + guard.negated for guard in tape.guards))


def _count_equations(tape: Tape) -> int:
    """Count the named values, and the nonzeros of results that are computed where they are stored."""
    named = named_values(tape)
    stored = (v for o in tape.outputs for v in o.values if v >= tape.first_operation)
    return len(named) + sum(v not in named for v in stored)


@once
def named_values(tape: Tape) -> frozenset[int]:
    """Choose the values that get a name: with a label, sines and cosines, used several times, or with long expressions.

    Other values are written into the expression that uses them; unused values are not written.
    """
    first, uses = tape.first_operation, count_uses(tape)
    labels = Counter(tape.labels.values())
    named = {v for v, text in tape.labels.items() if v >= first and labels[text] == 1 and uses[v]}
    going_on, stored = find_sums(tape), {v for o in tape.outputs for v in o.values}
    sizes = [0] * first  # the operations of the expression that stands for a value
    for value, (op, a, b) in enumerate(tape.operations, first):
        used = uses[value]
        if used > 1 or value in named:
            named.add(value)
            sizes.append(0)
            continue
        size = 1 + sizes[a] + (sizes[b] if b >= 0 else 0)
        if used and (op in _TURNS or (size > INLINED and value not in stored and value not in going_on)):
            named.add(value)
            size = 0
        sizes.append(size)
    return frozenset(named)


@once
def count_uses(tape: Tape) -> Counter[int]:
    """Count how often operations, outputs and guards use each value."""
    uses = Counter(map(_FIRST, tape.operations))
    uses.update(map(_SECOND, tape.operations))
    del uses[-1]  # of operations with one operand
    uses.update(v for o in tape.outputs for v in o.values)
    uses.update(v for g in tape.guards for v in (g.value, g.scale))
    return uses


@once
def find_sums(tape: Tape) -> frozenset[int]:
    """Find the sums that another sum continues: its first operand that has no other use."""
    first, operations, uses = tape.first_operation, tape.operations, count_uses(tape)
    continued = {v for v, (op, _, _) in enumerate(operations, first) if op in _SUMS and uses[v] == 1}
    found = set()
    for op, a, b in operations:
        if op in _SUMS and a in continued:
            found.add(a)
        elif op is ADD and b in continued:
            found.add(b)
    return frozenset(found)
