"""Entries that are zero for all inputs, though no operation shows it: found by evaluation, and left out.

A derivative may vanish by an identity that value numbering cannot see; for example, a force through an axis has no
moment about it. An expression that is 0 to 35 of 50 digits at several random points is taken to be identically zero
(Schwartz, Zippel).
"""

from __future__ import annotations

import random
from collections.abc import Mapping, Sequence
from dataclasses import replace
from decimal import Decimal

from mbsgen.roles import Role
from mbsgen.tape.columns import Columns
from mbsgen.tape.interpreter import DECIMALS, evaluate, fifty_digits
from mbsgen.tape.passes import drop_dead
from mbsgen.tape.ports import Port
from mbsgen.tape.types import Output, Sparsity, Tape

POINTS = 3
VANISHED = Decimal("1e-35")


def drop_vanishing(tape: Tape) -> Tape:
    """Leave out of every block of derivatives the nonzeros that vanish identically, and what only they need."""
    with fifty_digits():
        drawn = [evaluate(tape, _draw(tape, seed), DECIMALS) for seed in range(POINTS)]
    outputs = []
    for output in tape.outputs:
        columns = zip(*(values[output.name] for values in drawn), strict=True)
        is_block = output.port.role is Role.DERIVATIVE  # a function's own values stay where it has them
        kept = [k for k, column in enumerate(columns) if not (is_block and _vanishes(column))]
        outputs.append(_select(output, kept))
    if all(a.sparsity == b.sparsity for a, b in zip(outputs, tape.outputs, strict=True)):
        return tape
    return drop_dead(replace(tape, outputs=tuple(outputs)))


def find_patterns(loop: Columns, columns: Mapping[Port, int]) -> dict[Port, Sparsity]:
    """Return the patterns of the blocks that a loop computes: the entries that do not vanish."""
    with fifty_digits():
        drawn = [loop.solve(evaluate(loop.tape, _draw(loop.tape, seed), DECIMALS)) for seed in range(POINTS)]
    return {
        port: Sparsity.of(
            loop.size,
            width,
            [
                (r, c)
                for r in range(loop.size)
                for c in range(width)
                if not _vanishes([rows[r][loop.blocks[port.name] + c] for rows in drawn])
            ],
        )
        for port, width in columns.items()
    }


def _vanishes(column: Sequence[Decimal]) -> bool:
    return all(not value.is_nan() and abs(value) <= VANISHED for value in column)  # NaN: outside a function's domain


def _draw(tape: Tape, seed: int) -> dict[str, list[Decimal]]:
    """Draw positive numbers of magnitude 1 for every input, so that no divisor among them is zero."""
    source = random.Random(seed)
    return {i.name: [Decimal(source.uniform(0.3, 1.7)) for _ in range(i.sparsity.nnz)] for i in tape.inputs}


def _select(output: Output, kept: list[int]) -> Output:
    entries = output.sparsity.entries
    pattern = Sparsity.of(output.sparsity.rows, output.sparsity.cols, [entries[k] for k in kept])
    return Output(output.port, pattern, tuple(output.values[k] for k in kept))
