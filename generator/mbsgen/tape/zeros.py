"""The cost of a tape with entries of an input set to 0, counted for many sets of entries at once."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mbsgen.tape.counts import PAPER
from mbsgen.tape.types import ODD, Op, Tape

Sets = NDArray[np.bool_]

_KEEPING = ODD | {Op.NEG, Op.SQRT, Op.ABS}  # f(0) = 0


def count_without(tape: Tape, source: str, sets: Sets) -> NDArray[np.int64]:
    """Count flops, by the paper's convention, with the entries of the input `source` in each set 0: (k, size).

    Operations on literals and on `source` alone are not counted: they move to the setup, or are folded. Values that
    merely become equal to each other are still counted twice.
    """
    zero = _find_zeros(tape, source, sets)
    live = _find_live(tape, zero)
    fixed = _find_fixed(tape, source)
    total = np.zeros(len(sets), np.int64)
    for value, (op, a, b) in enumerate(tape.operations, tape.first_operation):
        if op in PAPER and not fixed[value]:
            counted = live[value] & ~zero[value]
            if op in (Op.ADD, Op.SUB):  # with one operand 0, nothing is computed
                counted &= ~(zero[a] | zero[b])
            total += counted
    return total


def _find_zeros(tape: Tape, source: str, sets: Sets) -> Sets:
    """Return which values are 0: (values, k)."""
    zero = np.zeros((tape.first_operation + len(tape.operations), len(sets)), bool)
    first = 0
    for i in tape.inputs:
        if i.name == source:
            zero[first : first + i.sparsity.nnz] = sets.T
        first += i.sparsity.nnz
    for value, (op, a, b) in enumerate(tape.operations, tape.first_operation):
        if op is Op.MUL:
            zero[value] = zero[a] | zero[b]
        elif op in (Op.ADD, Op.SUB):
            zero[value] = zero[a] & zero[b]
        elif op is Op.DIV or op in _KEEPING:
            zero[value] = zero[a]
    return zero


def _find_live(tape: Tape, zero: Sets) -> Sets:
    """Return which values a result or a guard needs."""
    live = np.zeros_like(zero)
    live[[v for o in tape.outputs for v in o.values] + [v for g in tape.guards for v in (g.value, g.scale)]] = True
    for value in range(len(zero) - 1, tape.first_operation - 1, -1):
        _, a, b = tape.operations[value - tape.first_operation]
        needed = live[value] & ~zero[value]
        live[a] |= needed
        if b >= 0:
            live[b] |= needed
    return live


def _find_fixed(tape: Tape, source: str) -> list[bool]:
    """Return which values depend on literals and `source` alone."""
    fixed = [i.name == source for i in tape.inputs for _ in range(i.sparsity.nnz)] + [True] * len(tape.literals)
    for op, *operands in tape.operations:
        fixed.append(all(fixed[x] for x in operands[: op.arity]))
    return fixed
