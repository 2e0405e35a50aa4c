"""Numbers of a Tree: expressions -> SymPy expressions over parameter symbols.

A literal is the rational number that its nearest double is; 0 is Integer 0, which is structural. What is irrational
(pi, sqrt(2), cos(0.3)) is a Float of 60 digits, so that rounding happens once, in the target; what 50 of them cannot
tell from a whole number is that number: cos(pi/2) is a structural 0. No other kinds of numbers occur.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Mapping
from types import MappingProxyType

from mpmath import MPContext, mpf
from sympy import Expr, Float, Integer, Rational, Symbol, cos, sin, sqrt

from mbsgen.expressions import FUNCTIONS, Algebra, ExpressionError

_DIGITS = MPContext()
_DIGITS.dps = 60
_NOISE = _DIGITS.mpf(10) ** -50

_SYMBOLIC: Mapping[str, Callable[..., Expr]] = (
    MappingProxyType(  # functions that generated code can compute at run time
        {"sin": sin, "cos": cos, "tan": lambda x: sin(x) / cos(x), "sqrt": sqrt}
    )
)


def exact(value: float) -> Expr:
    """Make the number that is exactly a double."""
    return Rational(value)


def symbolic(constants: Mapping[Symbol, Expr]) -> Algebra[Expr]:
    """Make the algebra of expressions over symbols, given the values of those that are constants.

    A function of constants alone is a number; of run-time parameters only sin, cos, tan and sqrt can be had.
    """

    def function(name: str) -> Callable[..., Expr]:
        def apply(*arguments: Expr) -> Expr:
            values = [argument.xreplace(constants) for argument in arguments]
            if all(value.is_number for value in values):
                return _compute(name, values)
            if name in _SYMBOLIC:
                return _SYMBOLIC[name](*arguments)
            remedy = f"make the parameter constant; at run time there are {', '.join(_SYMBOLIC)}"
            raise ExpressionError(f"{name} of a run-time parameter", remedy)

        return apply

    return Algebra(
        number=exact,
        constants={"pi": round_noise(_DIGITS.pi())},
        negate=operator.neg,
        operations={"+": operator.add, "-": operator.sub, "*": operator.mul, "/": _divide},
        power=lambda base, exponent: base**exponent if exponent >= 0 else _divide(Integer(1), base**-exponent),
        functions={name: function(name) for name in FUNCTIONS},
    )


def round_noise(number: mpf) -> Expr:
    """Make a number of 60 digits; what is a whole number to 50 digits is that number."""
    whole = _DIGITS.nint(number)
    if abs(number - whole) < _NOISE:
        return Integer(int(whole))
    return Float(number._mpf_, precision=_DIGITS.prec)


def to_digits(number: Expr) -> mpf:
    """Take a Rational or a Float to 60 digits."""
    return _DIGITS.make_mpf(number._mpf_) if isinstance(number, Float) else _DIGITS.mpf(number.p) / number.q


def _compute(name: str, values: list[Expr]) -> Expr:
    function = abs if name == "abs" else getattr(_DIGITS, name)
    result = function(*map(to_digits, values))
    if not isinstance(result, _DIGITS.mpf) or not _DIGITS.isfinite(result):
        raise ValueError(f"{name} has no real value here")
    return round_noise(result)


def _divide(numerator: Expr, denominator: Expr) -> Expr:
    if denominator == 0:
        raise ZeroDivisionError
    return numerator / denominator
