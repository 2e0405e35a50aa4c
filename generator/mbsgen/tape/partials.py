"""Partial derivatives of single operations, for forward and reverse differentiation."""

from __future__ import annotations

from mbsgen.tape.builder import Builder, Scalar
from mbsgen.tape.types import Op


def partials(builder: Builder, op: Op, a: Scalar, b: Scalar | None, result: Scalar) -> tuple[Scalar, ...]:
    """Differentiate `result` = op(a, b) by each operand; reuse `result` where this is cheaper.

    The derivative of |x| is the sign of x, and 0 at 0.
    """
    one = builder.number(1.0)
    if b is not None:
        return _partials_of_two(builder, op, a, b, result)
    match op:
        case Op.NEG:
            return (-one,)
        case Op.SIN:
            return (builder.cos(a),)
        case Op.COS:
            return (-builder.sin(a),)
        case Op.SQRT:
            return (builder.number(0.5) / result,)
        case Op.TAN:
            return (one + result * result,)
        case Op.ASIN:
            return (one / builder.sqrt((one - a) * (one + a)),)
        case Op.ACOS:
            return (-one / builder.sqrt((one - a) * (one + a)),)
        case Op.ATAN:
            return (one / (one + a * a),)
        case Op.EXP:
            return (result,)
        case Op.LOG:
            return (one / a,)
        case Op.TANH:
            return (one - result * result,)
        case Op.ABS:
            return (builder.apply(Op.SIGN, a),)
        case _:
            return (builder.zero,)


def _partials_of_two(builder: Builder, op: Op, a: Scalar, b: Scalar, result: Scalar) -> tuple[Scalar, ...]:
    one = builder.number(1.0)
    if op is Op.MUL:
        return b, a
    if op is Op.ADD:
        return one, one
    if op is Op.SUB:
        return one, -one
    if op is Op.DIV:
        inverse = one / b
        return inverse, -(result * inverse)
    squared = a * a + b * b  # the angle of (b, a)
    return b / squared, -(a / squared)
