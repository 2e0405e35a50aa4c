"""Entries that are zero for all inputs, though no operation shows it: found by evaluation, and left out.

A derivative may vanish by an identity that value numbering cannot see; for example, a force through an axis has no
moment about it. An expression that is 0 to 35 of 50 digits at random points is taken to be identically zero (Schwartz,
Zippel), unless it stays: where masses or lengths are tiny, such an entry may be right, though it has lost all of its 50
digits beside others. With 100 digits, the rounding of a 0 is smaller by 50 orders of magnitude, and an entry is not.
Large entries of the same block do not matter: forces of loops are drawn like all inputs, and may exceed any weight of a
tiny mechanism.

The derivatives of some functions are 0 to all digits in whole regions, without being 0, as of max(x, 0) for x < 0, or
of tanh(100 x). Other functions stand in their place here.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from decimal import Context, Decimal, localcontext

from mbsgen.procedure import procedure as procedures
from mbsgen.procedure.procedure import Computation, Procedure
from mbsgen.procedure.solve import Solve
from mbsgen.procedure.stages import Stage
from mbsgen.procedure.wires import Wire
from mbsgen.roles import Role
from mbsgen.tape.interpreter import DECIMALS, evaluate, fifty_digits
from mbsgen.tape.passes import drop_dead
from mbsgen.tape.types import Op, Output, Sparsity, Tape

POINTS = 2
VANISHED = Decimal("1e-35")
FINE = 100  # digits
STAYED = Decimal("1e-40")  # of a number with 50 digits, or of their rounding: the part that stays of it with FINE ones


def _swing(x: Decimal) -> Decimal:
    """Return a number between -1/2 and 1/2, odd in x, that tends to nothing for large x."""
    return Decimal(DECIMALS.functions[Op.SIN](x)) / 2


_NUMBERS = replace(
    DECIMALS,
    functions={**DECIMALS.functions, Op.SIGN: _swing, Op.TANH: _swing, Op.EXP: lambda x: 1 + _swing(x)},
)


def drop_vanishing(tape: Tape) -> Tape:
    """Leave out of every block of derivatives the nonzeros that vanish identically, and what only they need."""
    kept = _find_kept(tape.outputs, lambda seed: evaluate(tape, _draw(tape, seed), _NUMBERS))
    outputs = [_select(o, kept[o.name]) if o.name in kept else o for o in tape.outputs]  # values stay where they are
    if all(a.sparsity == b.sparsity for a, b in zip(outputs, tape.outputs, strict=True)):
        return tape
    return drop_dead(replace(tape, outputs=tuple(outputs)))


def find_patterns(procedure: Procedure) -> dict[str, Sparsity]:
    """Return the patterns of all blocks of derivatives: the entries that do not vanish."""
    kept = _find_kept(procedure.outputs, lambda seed: procedures.evaluate(procedure, _draw(procedure, seed), _NUMBERS))
    wires = {wire.name: wire.sparsity for wire in procedure.outputs}
    return {
        name: Sparsity.of(wires[name].rows, wires[name].cols, [wires[name].entries[k] for k in places])
        for name, places in kept.items()
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


def _find_kept(
    outputs: Sequence[Output | Wire], compute: Callable[[int], Mapping[str, Sequence[Decimal]]]
) -> dict[str, list[int]]:
    """Return the nonzeros of each block of derivatives that do not vanish; `compute` takes the seed of a point."""
    with fifty_digits():
        drawn = [compute(seed) for seed in range(POINTS)]
    blocks = {o.name: [values[o.name] for values in drawn] for o in outputs if o.port.role is Role.DERIVATIVE}
    columns = {name: list(zip(*rows, strict=True)) for name, rows in blocks.items()}
    small = {name: [_is_below(x, VANISHED) for x in columns[name]] for name in blocks}
    doubtful = {name: {k for k, x in enumerate(small[name]) if x and columns[name][k][0] != 0} for name in blocks}
    fine: Mapping[str, Sequence[Decimal]] = {}
    if any(doubtful.values()):
        with localcontext(Context(prec=FINE, traps=[])):
            fine = compute(0)
    return {
        name: [
            k
            for k, x in enumerate(small[name])
            if not x or (k in doubtful[name] and abs(fine[name][k]) > STAYED * abs(blocks[name][0][k]))
        ]
        for name in blocks
    }


def _is_below(column: Sequence[Decimal], limit: Decimal) -> bool:
    return all(not value.is_nan() and abs(value) <= limit for value in column)  # NaN: outside a function's domain


def _draw(tape: Computation, seed: int) -> dict[str, list[Decimal]]:
    """Draw positive numbers of magnitude 1 for every input, so that no divisor among them is zero."""
    source = random.Random(seed)
    return {i.name: [Decimal(source.uniform(0.3, 1.7)) for _ in range(i.sparsity.nnz)] for i in tape.inputs}


def _select(output: Output, kept: list[int]) -> Output:
    entries = output.sparsity.entries
    pattern = Sparsity.of(output.sparsity.rows, output.sparsity.cols, [entries[k] for k in kept])
    return Output(output.port, pattern, tuple(output.values[k] for k in kept))
