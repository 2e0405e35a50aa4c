"""Evaluate a tape in any number type: the oracle for every target.

`FLOATS` computes in float64 (scalars, or NumPy arrays along a batch), `DIGITS` in 50 decimal digits.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from mpmath import MPContext, mpf

from mbsgen.errors import TapeError
from mbsgen.tape.types import Op, Tape


@dataclass(frozen=True)
class Numbers:
    """A number type: how to make a literal, and the functions that operators do not cover."""

    literal: Callable[[mpf], Any]
    functions: Mapping[Op, Callable[[Any], Any]]


FLOATS = Numbers(float, {Op.SIN: np.sin, Op.COS: np.cos, Op.SQRT: np.sqrt})

_FIFTY = MPContext()
_FIFTY.dps = 50
DIGITS = Numbers(_FIFTY.mpf, {Op.SIN: _FIFTY.sin, Op.COS: _FIFTY.cos, Op.SQRT: _FIFTY.sqrt})


def evaluate(tape: Tape, arguments: Mapping[str, Sequence[Any]], numbers: Numbers = FLOATS) -> dict[str, list[Any]]:
    """Evaluate every output: its nonzeros in storage order. `arguments` hold the nonzeros of each input likewise."""
    values: list[Any] = []
    for i in tape.inputs:
        given = arguments[i.name]
        if len(given) != i.sparsity.nnz:
            raise TapeError(f"{tape.name}: input {i.name} has {i.sparsity.nnz} nonzeros, {len(given)} were given")
        values.extend(given)
    values.extend(map(numbers.literal, tape.literals))
    for op, a, b in tape.operations:
        values.append(_apply(op, values[a], values[b] if b >= 0 else None, numbers))
    return {o.name: [values[v] for v in o.values] for o in tape.outputs}


def _apply(op: Op, a: Any, b: Any, numbers: Numbers) -> Any:
    match op:
        case Op.ADD:
            return a + b
        case Op.SUB:
            return a - b
        case Op.MUL:
            return a * b
        case Op.DIV:
            return a / b
        case Op.NEG:
            return -a
        case _:
            return numbers.functions[op](a)
