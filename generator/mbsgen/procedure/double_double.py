"""The stage in double-double arithmetic: a tape whose numbers are sums of two doubles, with some 31 digits.

Each input x has a second one beside it, low_x, and each result y a second one, low_y: the numbers are x + low_x and
y + low_y. In a number type with more digits, the second parts of results are 0.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from mbsgen.procedure.stages import Arithmetic, Outcome, Pulled, Stage, TapeStage, Values
from mbsgen.procedure.wires import Wire
from mbsgen.roles import Role, name_low
from mbsgen.tape import counts
from mbsgen.tape.counts import Counts
from mbsgen.tape.interpreter import run
from mbsgen.tape.ports import Port
from mbsgen.tape.types import Op

if TYPE_CHECKING:
    from mbsgen.procedure.adjoints import Adjoints
    from mbsgen.procedure.slopes import Slopes

# Operations of doubles, with fused multiply-add, which counts as two; functions without an entry count as one.
COSTS: Mapping[Op, Mapping[Op, int]] = {
    Op.ADD: {Op.ADD: 20},
    Op.SUB: {Op.ADD: 20, Op.NEG: 2},
    Op.MUL: {Op.ADD: 7, Op.MUL: 5, Op.NEG: 1},
    Op.DIV: {Op.ADD: 11, Op.MUL: 3, Op.DIV: 2, Op.NEG: 1},
    Op.NEG: {Op.NEG: 2},
    Op.SQRT: {Op.ADD: 7, Op.MUL: 3, Op.DIV: 1, Op.SQRT: 1, Op.NEG: 1},
}


def make_low(port: Port) -> Port:
    """Make the port of the second part of an argument."""
    meaning = f"second part of {port.name}: the number is the sum of both"
    return Port(name_low(port.name), Role.REMAINDER, port.rows, port.cols, unit=port.unit, meaning=meaning)


@dataclass(frozen=True)
class DoubleDouble(TapeStage):
    """A straight-line program in double-double arithmetic; wires are its inputs and outputs, each in two parts."""

    @property
    def name(self) -> str:  # type: ignore[override]
        """Return the name of the tape."""
        return self.tape.name

    @property
    def reads(self) -> tuple[Wire, ...]:
        """List the inputs, then their second parts."""
        wires = [Wire.of(i) for i in self.tape.inputs]
        return (*wires, *map(_make_low_wire, wires))

    @property
    def gives(self) -> tuple[Wire, ...]:
        """List the outputs, then their second parts."""
        wires = [Wire.of(o) for o in self.tape.outputs]
        return (*wires, *map(_make_low_wire, wires))

    def run(self, given: Values, arithmetic: Arithmetic) -> Outcome:
        """Compute operation by operation, in the numbers at hand."""
        names = [i.name for i in self.tape.inputs]
        whole = {x: [a + b for a, b in zip(given[x], given[name_low(x)], strict=True)] for x in names}
        status, results = run(self.tape, whole, arithmetic.numbers, tested=arithmetic.tested)
        lows = {name_low(name): [x - x for x in values] for name, values in results.items()}
        return Outcome(status, {**results, **lows})

    def count(self) -> Counts:
        """Count operations of doubles."""
        found = counts.count(self.tape)
        operations: Counter[Op] = Counter()
        for op, number in found.operations.items():
            for own, cost in COSTS.get(op, {op: 1}).items():
                operations[own] += number * cost
        return replace(found, operations=dict(operations))

    def push(self, slopes: Slopes) -> Sequence[Stage]:
        """Refuse: derivatives are made before numbers get two parts."""
        raise _refuse(self, slopes)

    def pull(self, adjoints: Adjoints) -> Pulled:
        """Refuse: derivatives are made before numbers get two parts."""
        raise _refuse(self, adjoints)


def _refuse(stage: DoubleDouble, asked: Slopes | Adjoints) -> AssertionError:
    return AssertionError(f"{stage.name}: no {type(asked).__name__.lower()} of a stage in double-double")


def _make_low_wire(wire: Wire) -> Wire:
    return Wire.to(make_low(wire.port), wire.sparsity)
