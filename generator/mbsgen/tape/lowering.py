"""SymPy expression -> tape: the numbers of a model, over its parameters."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache, reduce
from operator import add, mul

from mpmath import mpf
from sympy import Add, Expr, Float, Mul, Pow, Rational, Symbol, cos, sin

from mbsgen.errors import TapeError
from mbsgen.tape.builder import Builder, Scalar
from mbsgen.tape.types import LITERALS


def lower(expression: Expr, builder: Builder, symbols: Mapping[Symbol, Scalar]) -> Scalar:
    """Write `expression` to the builder; its symbols stand for the given scalars."""
    match expression:
        case Symbol():
            return symbols[expression]
        case _ if expression.is_number:
            return builder.number(_digits(expression))
        case Add():
            return reduce(add, (lower(term, builder, symbols) for term in expression.args))
        case Mul():
            return reduce(mul, (lower(factor, builder, symbols) for factor in expression.args))
        case Pow():
            return _lower_power(expression, builder, symbols)
        case sin():
            return builder.sin(lower(expression.args[0], builder, symbols))
        case cos():
            return builder.cos(lower(expression.args[0], builder, symbols))
    raise TapeError(f"no operation of the tape computes {type(expression).__name__} of a parameter")


def _lower_power(power: Expr, builder: Builder, symbols: Mapping[Symbol, Scalar]) -> Scalar:
    base = lower(power.args[0], builder, symbols)
    exponent = 2 * power.args[1]
    if not exponent.is_Integer:
        raise TapeError(f"no operation of the tape raises to the power {power.args[1]}")
    halves = abs(int(exponent))
    factors = [base] * (halves // 2) + ([builder.sqrt(base)] if halves % 2 else [])
    product = reduce(mul, factors, builder.number(1.0))
    return builder.number(1.0) / product if exponent < 0 else product


@lru_cache(maxsize=4096)
def _digits(number: Expr) -> mpf:
    """Take a number to the precision of literals; a Float is the double that it was made of."""
    if isinstance(number, Float):
        return LITERALS.make_mpf(number._mpf_)
    if isinstance(number, Rational):
        return LITERALS.mpf(number.p) / number.q
    return LITERALS.make_mpf(number.evalf(LITERALS.dps + 5)._mpf_)
