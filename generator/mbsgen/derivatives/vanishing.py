"""Entries that are zero for all inputs, though no operation shows it: found by evaluation, and left out.

A derivative may vanish by an identity that value numbering cannot see; for example, a force through an axis has no
moment about it. An expression that is 0 to 35 of 50 digits at several random points is taken to be identically zero
(Schwartz, Zippel). The derivatives of some functions are 0 to all digits in whole regions, without being 0, as of
max(x, 0) for x < 0, or of tanh(100 x). Other functions stand in their place here.
"""

from __future__ import annotations

import random
from collections.abc import Mapping, Sequence
from dataclasses import replace
from decimal import Decimal

from mbsgen.procedure import procedure as procedures
from mbsgen.procedure.procedure import Computation, Procedure
from mbsgen.procedure.solve import Solve
from mbsgen.procedure.stages import Stage
from mbsgen.procedure.wires import Wire
from mbsgen.roles import Role
from mbsgen.tape.interpreter import DECIMALS, evaluate, fifty_digits
from mbsgen.tape.passes import drop_dead
from mbsgen.tape.types import Op, Output, Sparsity, Tape

POINTS = 3
VANISHED = Decimal("1e-35")


def _swing(x: Decimal) -> Decimal:
    """Return a number between -1/2 and 1/2, odd in x, that tends to nothing for large x."""
    return Decimal(DECIMALS.functions[Op.SIN](x)) / 2


_NUMBERS = replace(
    DECIMALS,
    functions={**DECIMALS.functions, Op.SIGN: _swing, Op.TANH: _swing, Op.EXP: lambda x: 1 + _swing(x)},
)


def drop_vanishing(tape: Tape) -> Tape:
    """Leave out of every block of derivatives the nonzeros that vanish identically, and what only they need."""
    with fifty_digits():
        drawn = [evaluate(tape, _draw(tape, seed), _NUMBERS) for seed in range(POINTS)]
    outputs = []
    for output in tape.outputs:
        columns = zip(*(values[output.name] for values in drawn), strict=True)
        is_block = output.port.role is Role.DERIVATIVE  # a function's own values stay where it has them
        kept = [k for k, column in enumerate(columns) if not (is_block and _vanishes(column))]
        outputs.append(_select(output, kept))
    if all(a.sparsity == b.sparsity for a, b in zip(outputs, tape.outputs, strict=True)):
        return tape
    return drop_dead(replace(tape, outputs=tuple(outputs)))


def find_patterns(procedure: Procedure) -> dict[str, Sparsity]:
    """Return the patterns of all blocks of derivatives: the entries that do not vanish."""
    with fifty_digits():
        drawn = [procedures.evaluate(procedure, _draw(procedure, seed), _NUMBERS) for seed in range(POINTS)]
    return {
        wire.name: Sparsity.of(
            wire.sparsity.rows,
            wire.sparsity.cols,
            [
                place
                for k, place in enumerate(wire.sparsity.entries)
                if not _vanishes([values[wire.name][k] for values in drawn])
            ],
        )
        for wire in procedure.outputs
        if wire.port.role is Role.DERIVATIVE
    }


def narrow(procedure: Procedure, patterns: Mapping[str, Sparsity]) -> Procedure:
    """Leave out of the blocks that solutions give the nonzeros that are not in these patterns."""

    def change(wire: Wire) -> Wire:
        return replace(wire, sparsity=patterns[wire.name]) if wire.name in patterns else wire

    def take(stage: Stage) -> Stage:
        if not isinstance(stage, Solve):
            return stage
        return replace(stage, blocks=tuple(replace(block, result=change(block.result)) for block in stage.blocks))

    outputs = tuple(map(change, procedure.outputs))
    return replace(procedure, stages=tuple(map(take, procedure.stages)), outputs=outputs)


def _vanishes(column: Sequence[Decimal]) -> bool:
    return all(not value.is_nan() and abs(value) <= VANISHED for value in column)  # NaN: outside a function's domain


def _draw(tape: Computation, seed: int) -> dict[str, list[Decimal]]:
    """Draw positive numbers of magnitude 1 for every input, so that no divisor among them is zero."""
    source = random.Random(seed)
    return {i.name: [Decimal(source.uniform(0.3, 1.7)) for _ in range(i.sparsity.nnz)] for i in tape.inputs}


def _select(output: Output, kept: list[int]) -> Output:
    entries = output.sparsity.entries
    pattern = Sparsity.of(output.sparsity.rows, output.sparsity.cols, [entries[k] for k in kept])
    return Output(output.port, pattern, tuple(output.values[k] for k in kept))
