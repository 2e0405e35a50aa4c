"""Expressions in a tape's builder: the operations of an Algebra of scalars."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from mbsgen.expressions import Algebra
from mbsgen.tape.builder import Builder, Scalar
from mbsgen.tape.types import LITERALS, Op

_FUNCTIONS: Mapping[str, Op] = {
    "sin": Op.SIN,
    "cos": Op.COS,
    "tan": Op.TAN,
    "asin": Op.ASIN,
    "acos": Op.ACOS,
    "atan": Op.ATAN,
    "atan2": Op.ATAN2,
    "sqrt": Op.SQRT,
    "exp": Op.EXP,
    "log": Op.LOG,
    "tanh": Op.TANH,
    "abs": Op.ABS,
}


def make_algebra(builder: Builder) -> Algebra[Scalar]:
    """Make the algebra in which expressions are written to a builder."""
    return Algebra(
        number=builder.number,
        constants={"pi": builder.number(LITERALS.mpf(LITERALS.pi))},
        negate=lambda a: -a,
        operations={
            "+": lambda a, b: a + b,
            "-": lambda a, b: a - b,
            "*": lambda a, b: a * b,
            "/": lambda a, b: a / b,
        },
        power=_raise,
        functions={**{name: _make_function(builder, op) for name, op in _FUNCTIONS.items()}, "max": builder.larger},
    )


def _make_function(builder: Builder, op: Op) -> Callable[..., Scalar]:
    return lambda *operands: builder.apply(op, *operands)


def _raise(base: Scalar, exponent: int) -> Scalar:
    """Return a power by squares: base to the power 1, 2, 4, ..."""
    one = base.builder.number(1.0)
    product, squared = one, base
    for digit in reversed(f"{abs(exponent):b}"):
        product = product * squared if digit == "1" else product
        squared = squared * squared
    return one / product if exponent < 0 else product
