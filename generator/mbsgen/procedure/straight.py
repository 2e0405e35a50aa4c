"""The straight stage: a tape.

push    dz/dx = sum over w of (dz/dw) (dw/dx), operation by operation
pull    wbar = (dz/dw)T zbar, operation by operation, from the last to the first
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from mbsgen.procedure.sheet import Sheet
from mbsgen.procedure.stages import Arithmetic, Outcome, Pulled, Stage, TapeStage, Values
from mbsgen.procedure.wires import Wire
from mbsgen.tape import counts
from mbsgen.tape.builder import Scalar
from mbsgen.tape.counts import Counts
from mbsgen.tape.forward import carry
from mbsgen.tape.interpreter import run
from mbsgen.tape.passes import drop_unused_inputs, keep_results
from mbsgen.tape.replay import replay, replay_guards
from mbsgen.tape.reverse import sweep

if TYPE_CHECKING:
    from mbsgen.procedure.adjoints import Adjoints
    from mbsgen.procedure.slopes import Slopes


@dataclass(frozen=True)
class Straight(TapeStage):
    """A straight-line program; wires are its inputs and outputs, by name."""

    @property
    def name(self) -> str:  # type: ignore[override]
        """Return the name of the tape."""
        return self.tape.name

    @property
    def reads(self) -> tuple[Wire, ...]:
        """List the inputs of the tape."""
        return tuple(Wire.of(i) for i in self.tape.inputs)

    @property
    def gives(self) -> tuple[Wire, ...]:
        """List the outputs of the tape."""
        return tuple(Wire.of(o) for o in self.tape.outputs)

    def run(self, given: Values, arithmetic: Arithmetic) -> Outcome:
        """Compute operation by operation."""
        status, results = run(self.tape, given, arithmetic.numbers, tested=arithmetic.tested)
        return Outcome(status, dict(results))

    def count(self) -> Counts:
        """Count the operations of the tape."""
        return counts.count(self.tape)

    def keep(self, names: frozenset[str]) -> Straight:
        """Leave out the other outputs, and what only they need: operations, and inputs."""
        is_whole = all(o.name in names for o in self.tape.outputs)
        return Straight(drop_unused_inputs(self.tape if is_whole else keep_results(self.tape, names)))

    def push(self, slopes: Slopes) -> Sequence[Stage]:
        """Differentiate operation by operation, in the same tape."""
        if not any(slopes.has(wire) for wire in self.reads):
            return (self,)
        sheet = Sheet()
        values = replay(self.tape, sheet.builder, {wire.name: sheet.take(wire) for wire in self.reads})
        replay_guards(self.tape, sheet.builder, values)
        given = [gradient for wire in self.reads for gradient in slopes.take(sheet, wire)]
        gradients = carry(self.tape, sheet.builder, values, given)
        for wire, output in zip(self.gives, self.tape.outputs, strict=True):
            sheet.give(wire, [values[v] for v in output.values])
            slopes.give(sheet, wire, [gradients[v] for v in output.values])
        return (Straight(sheet.finish(self.name)),)

    def pull(self, adjoints: Adjoints) -> Pulled:
        """Carry adjoints from the last operation to the first."""
        sheet = Sheet()
        values = replay(self.tape, sheet.builder, {wire.name: sheet.take(wire) for wire in self.reads})
        replay_guards(self.tape, sheet.builder, values)
        seeds: dict[int, Scalar] = {}
        for wire, output in zip(self.gives, self.tape.outputs, strict=True):
            for value, seed in zip(output.values, adjoints.take(sheet, wire), strict=True):
                seeds[value] = seeds[value] + seed if value in seeds else seed
        found = sweep(self.tape, sheet.builder, values, seeds)
        first = 0
        for wire in self.reads:
            nnz = wire.sparsity.nnz
            adjoints.give(sheet, wire, [found.get(first + k, sheet.builder.zero) for k in range(nnz)])
            first += nnz
        return Pulled((self,), written(sheet, adjoints.name(f"{self.name}_back")))


def written(sheet: Sheet, name: str) -> tuple[Straight, ...]:
    """Make the stage of a sheet; none where it writes no wire."""
    return () if sheet.is_empty else (Straight(sheet.finish(name)),)
