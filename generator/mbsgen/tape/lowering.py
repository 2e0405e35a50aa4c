"""SymPy expression -> tape: the numbers of a model, over its parameters, and force laws."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache, reduce
from operator import add, mul

from mpmath import mpf
from sympy import (
    Abs,
    Add,
    Expr,
    Float,
    Mul,
    Pow,
    Rational,
    Symbol,
    acos,
    asin,
    atan,
    atan2,
    cos,
    exp,
    log,
    sign,
    sin,
    tan,
    tanh,
)

from mbsgen.errors import TapeError
from mbsgen.expressions import BEZIER, DEFINED, Call, Name, evaluate
from mbsgen.model.smooth import bezier
from mbsgen.tape.arithmetic import make_algebra
from mbsgen.tape.builder import Builder, Scalar
from mbsgen.tape.types import LITERALS, Op

_FUNCTIONS: Mapping[type[Expr], Op] = {
    sin: Op.SIN,
    cos: Op.COS,
    tan: Op.TAN,
    asin: Op.ASIN,
    acos: Op.ACOS,
    atan: Op.ATAN,
    atan2: Op.ATAN2,
    exp: Op.EXP,
    log: Op.LOG,
    tanh: Op.TANH,
    Abs: Op.ABS,
    sign: Op.SIGN,
}
_BEZIER = DEFINED[BEZIER]


def lower(expression: Expr, builder: Builder, symbols: Mapping[Symbol, Scalar]) -> Scalar:
    """Write `expression` to the builder; its symbols stand for the given scalars.

    Raises TapeError for a function or power that no operation computes, and for a number that is not real.
    """
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
        case _ if expression.func in _FUNCTIONS:
            operands = (lower(operand, builder, symbols) for operand in expression.args)
            return builder.apply(_FUNCTIONS[expression.func], *operands)
        case bezier():
            values = {name: lower(x, builder, symbols) for name, x in zip(_BEZIER, expression.args, strict=True)}
            return evaluate(Call(BEZIER, tuple(map(Name, _BEZIER))), values, make_algebra(builder))
    raise TapeError(f"no operation of the tape computes {expression.func}")


def _lower_power(power: Expr, builder: Builder, symbols: Mapping[Symbol, Scalar]) -> Scalar:
    base = lower(power.args[0], builder, symbols)
    exponent = 2 * power.args[1]
    if not exponent.is_Integer:
        raise TapeError(f"no operation of the tape raises to the power {power.args[1]}")
    halves = abs(int(exponent))
    product = builder.sqrt(base) if halves % 2 else builder.number(1.0)
    squared = base  # base to the power 1, 2, 4, ...
    for digit in reversed(f"{halves // 2:b}"):
        product = product * squared if digit == "1" else product
        squared = squared * squared
    return builder.number(1.0) / product if exponent < 0 else product


@lru_cache(maxsize=4096)
def _digits(number: Expr) -> mpf:
    """Take a number to the precision of literals; a Float is the double that it was made of."""
    if isinstance(number, Float):
        return LITERALS.make_mpf(number._mpf_)
    if isinstance(number, Rational):
        return LITERALS.mpf(number.p) / number.q
    value = number.evalf(LITERALS.dps + 5)
    if not isinstance(value, Float | Rational):
        raise TapeError(f"{number} is no real number")
    return _digits(value)
