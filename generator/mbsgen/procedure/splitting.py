"""Split off what one input alone decides: of all stages of several functions, into one tape that is computed before.

y = s(p, x)  ->  h = s0(p),  y = s1(h, x)
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

from mbsgen.procedure.procedure import Computation
from mbsgen.procedure.wires import Wire
from mbsgen.tape import passes
from mbsgen.tape.ports import Port
from mbsgen.tape.types import Input, Tape


def hoist(functions: Sequence[Computation], source: Port, target: Port) -> tuple[Tape, tuple[Computation, ...]]:
    """Move what depends on the input `source` alone into one tape, as `tape.passes.hoist` does for tapes.

    Returns the tape of `target`, and the functions, which read that instead of `source`.
    """
    tapes = [tape for function in functions for tape in _list_tapes(function) if _reads(tape, source)]
    setup, split = passes.hoist(tapes, source, target)
    given = Input(target, setup.output(target.name).sparsity)
    rest = iter(split)
    return setup, tuple(_rewrite(function, rest, source, given) for function in functions)


def _list_tapes(function: Computation) -> tuple[Tape, ...]:
    if isinstance(function, Tape):
        return (function,)
    return tuple(tape for stage in function.stages for tape in stage.tapes)


def _reads(tape: Tape, source: Port) -> bool:
    return any(i.port == source for i in tape.inputs)


def _rewrite(function: Computation, rest: Iterator[Tape], source: Port, given: Input) -> Computation:
    """Take the tapes that are left, in the order in which they were listed."""
    if isinstance(function, Tape):
        return next(rest) if _reads(function, source) else function
    inputs = (*(wire for wire in function.inputs if wire.port != source), Wire.of(given))
    stages = tuple(
        stage.with_tapes([next(rest) if _reads(tape, source) else tape for tape in stage.tapes])
        for stage in function.stages
    )
    return replace(function, inputs=inputs, stages=stages)
