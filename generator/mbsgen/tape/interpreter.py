"""Evaluate a tape in any number type: the oracle for every target.

`FLOATS` computes in float64 (scalars, or NumPy arrays along a batch), `DIGITS` in 50 decimal digits. `DECIMALS` has 50
digits too, in Python's `decimal`: about seven times as quick, but valid only within `fifty_digits()`.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from decimal import Context, Decimal, localcontext
from functools import lru_cache
from typing import Any

from mpmath import MPContext, mpf

from mbsgen.errors import TapeError
from mbsgen.tape.types import FUNCTIONS, LARGEST_THRESHOLD, LITERALS, Op, Tape


@dataclass(frozen=True)
class Numbers:
    """A number type: its literals, and the functions that operators do not cover."""

    literal: Callable[[mpf], Any]
    functions: Mapping[Op, Callable[..., Any]]
    epsilon: Any  # the distance from 1 to the next number


def _by_numpy(name: str) -> Callable[..., Any]:
    def apply(*operands: Any) -> Any:
        import numpy as np  # here alone: what generates needs no arrays

        return getattr(np, name)(*operands)

    return apply


FLOATS = Numbers(float, {op: _by_numpy(op.value[0]) for op in FUNCTIONS}, 2.0**-52)

_FIFTY = MPContext()
_FIFTY.dps = 50
DIGITS = Numbers(_FIFTY.mpf, {op: getattr(_FIFTY, op.value[0]) for op in FUNCTIONS}, _FIFTY.eps)


def fifty_digits() -> AbstractContextManager[Context]:
    """Make `decimal` compute in 50 digits; an undefined result is NaN or infinite, and raises nothing."""
    return localcontext(Context(prec=_FIFTY.dps, traps=[]))


@lru_cache(maxsize=4096)
def _to_decimal(number: mpf) -> Decimal:
    return Decimal(_SIXTY.nstr(number, _SIXTY.dps))


def _by_mpmath(op: Op) -> Callable[..., Decimal]:
    def apply(*operands: Decimal) -> Decimal:
        value = DIGITS.functions[op](*(_FIFTY.mpf(str(x)) for x in operands))
        return Decimal(_FIFTY.nstr(value, _SIXTY.dps)) if isinstance(value, _FIFTY.mpf) else Decimal("nan")

    return apply


_SIXTY = MPContext()
_SIXTY.dps = 60
DECIMALS = Numbers(
    _to_decimal,
    {op: _by_mpmath(op) for op in FUNCTIONS} | {Op.SQRT: Decimal.sqrt, Op.ABS: abs},
    Decimal(str(_FIFTY.eps)),
)


def evaluate(tape: Tape, arguments: Mapping[str, Sequence[Any]], numbers: Numbers = FLOATS) -> dict[str, list[Any]]:
    """Evaluate the nonzeros of every output, in storage order. `arguments` hold the nonzeros of each input likewise.

    Guards are not tested: `find_failure` does that.
    """
    return run(tape, arguments, numbers, tested=False)[1]


def find_failure(tape: Tape, arguments: Mapping[str, Sequence[Any]], numbers: Numbers = FLOATS) -> int:
    """Return the joint at which the kernel fails for these arguments, or 0: the status that generated code returns."""
    return run(tape, arguments, numbers, tested=True)[0]


def run(
    tape: Tape, arguments: Mapping[str, Sequence[Any]], numbers: Numbers, *, tested: bool
) -> tuple[int, dict[str, list[Any]]]:
    """Return the status, which is 0 unless a guard is `tested` and fails, and every output."""
    values = _evaluate_values(tape, arguments, numbers)
    status = _test(tape, values, numbers) if tested else 0
    return status, {o.name: [values[v] for v in o.values] for o in tape.outputs}


def _test(tape: Tape, values: Sequence[Any], numbers: Numbers) -> int:
    for guard in tape.guards:
        pivot = -values[guard.value] if guard.negated else values[guard.value]
        if not pivot > find_threshold(guard.tolerance, numbers) * values[guard.scale]:
            return guard.joint
    return 0


def find_threshold(tolerance: float, numbers: Numbers) -> Any:
    """Return the part of its scale that a pivot must exceed, in the numbers that are computed with."""
    return min(_literal(tolerance, numbers) * numbers.epsilon, _literal(LARGEST_THRESHOLD, numbers))


def _literal(number: float, numbers: Numbers) -> Any:
    return numbers.literal(LITERALS.mpf(number))


def _evaluate_values(tape: Tape, arguments: Mapping[str, Sequence[Any]], numbers: Numbers) -> list[Any]:
    values: list[Any] = []
    for i in tape.inputs:
        given = arguments[i.name]
        if len(given) != i.sparsity.nnz:
            raise TapeError(f"{tape.name}: input {i.name} has {i.sparsity.nnz} nonzeros, {len(given)} were given")
        values.extend(given)
    values.extend(map(numbers.literal, tape.literals))
    functions = {**_SIGNS, **numbers.functions}
    for op, a, b in tape.operations:
        values.append(functions[op](values[a]) if b < 0 else functions[op](values[a], values[b]))
    return values


def _divide(a: Any, b: Any) -> Any:
    """Divide; a division by zero gives NaN, for the guard that is tested after it."""
    try:
        return a / b
    except ZeroDivisionError:
        return a * math.nan


_SIGNS: Mapping[Op, Callable[..., Any]] = {
    Op.ADD: operator.add,
    Op.SUB: operator.sub,
    Op.MUL: operator.mul,
    Op.DIV: _divide,
    Op.NEG: operator.neg,
}
