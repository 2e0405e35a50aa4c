"""Numbers of a Tree: expressions -> SymPy expressions over parameter symbols.

A literal is the rational number that its nearest double is; 0 is Integer 0, which is structural. An irrational number
(pi, sqrt(2), cos(0.3)) is a Float of 60 digits, so that rounding happens once, in the target. A number that 50 digits
do not distinguish from 0 is a structural 0: cos(pi/2), or a sum whose terms cancel. No other kinds of numbers occur.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Iterable, Mapping
from types import MappingProxyType

from mpmath import MPContext, mpf
from sympy import (
    Abs,
    Add,
    Expr,
    Float,
    Integer,
    Pow,
    Rational,
    S,
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
    sqrt,
    tanh,
)

from mbsgen.expressions import BEZIER, PRIMITIVES, Algebra, ExpressionError
from mbsgen.model.smooth import READ, bezier

DIGITS = MPContext()
DIGITS.dps = 60
_NOISE = DIGITS.mpf(10) ** -50

_ROUNDING = ("sin", "cos", "tan", "sqrt")  # their results near 0 are 0 where the angle brings its rounding
_BUILT_IN: Mapping[str, Callable[..., mpf]] = {"abs": abs, "max": max}
_KEPT = {"asin": asin, "acos": acos, "atan": atan, "atan2": atan2, "exp": exp, "log": log, "tanh": tanh, "abs": Abs}


def _keep(function: type[Expr]) -> Callable[..., Expr]:
    """Make a function whose calls stay as they are written: SymPy makes exp(re(x)) of abs(exp(x))."""
    return lambda *arguments: function(*arguments, evaluate=False)


def _choose_larger(a: Expr, b: Expr) -> Expr:
    """Return the larger of two expressions, s a + (1 - s) b, with s = 1 where a > b, 0 where a < b, else 1/2."""
    s = (1 + sign(total((a, -b)), evaluate=False)) / 2
    return total((s * a, b, -s * b))


_SYMBOLIC: Mapping[str, Callable[..., Expr]] = MappingProxyType(
    {"sin": sin, "cos": cos, "tan": lambda x: sin(x) / cos(x), "sqrt": sqrt, "max": _choose_larger}
    | {name: _keep(function) for name, function in _KEPT.items()}
)


def exact(value: float) -> Expr:
    """Make the number that is exactly a double."""
    return Rational(value)


def symbolic(constants: Mapping[Symbol, Expr], *, readable: bool = False) -> Algebra[Expr]:
    """Make the algebra of expressions over symbols, given the values of constants.

    A function of constants alone is a number. Where expressions are to be read, smooth functions stay functions; a
    Bezier curve always does, since its definition repeats its steps many times where none has a name.
    """

    def function(name: str) -> Callable[..., Expr]:
        def apply(*arguments: Expr) -> Expr:
            values = [argument.xreplace(constants) for argument in arguments]
            if all(value.is_number for value in values):
                return _compute(name, values)
            return _SYMBOLIC[name](*arguments)

        return apply

    return Algebra(
        number=exact,
        constants={"pi": _settle(+DIGITS.pi, DIGITS.zero)},
        negate=operator.neg,
        operations={"+": lambda a, b: total((a, b)), "-": lambda a, b: total((a, -b)), "*": operator.mul, "/": _divide},
        power=lambda base, exponent: base**exponent if exponent >= 0 else _divide(Integer(1), base**-exponent),
        functions={name: function(name) for name in PRIMITIVES} | {BEZIER: bezier} | (READ if readable else {}),
    )


def total(terms: Iterable[Expr]) -> Expr:
    """Add expressions; like terms that cancel to 50 digits leave a structural 0."""
    present = [term for term in terms if term is not S.Zero]
    if len(present) < 2:
        return present[0] if present else S.Zero
    factors: dict[Expr, list[Expr]] = {}
    for term in present:
        for part in Add.make_args(term):
            factor, rest = part.as_coeff_Mul()
            factors.setdefault(rest, []).append(factor)
    return Add(*(_add(like) * rest for rest, like in factors.items()))


def check_powers(expression: Expr) -> None:
    """Refuse powers that generated code does not compute, such as roots of roots. Raises ExpressionError.

    It is a multiple that is looked at, for that is what will be written: SymPy makes 2*x**0.3 of 2*exp(0.3*log(x)).
    """
    if any(not (2 * power.exp).is_integer for power in (3 * expression).atoms(Pow)):
        finding = "a power that is neither whole nor a square root"
        raise ExpressionError(finding, "keep to those, or to constant parameters")


def round_number(number: Expr) -> Expr:
    """Keep a double as it is; of any other number, which may be a fraction of very many digits, keep 60 digits."""
    if isinstance(number, Rational) and exact(to_double(number)) == number:
        return number
    return _settle(to_digits(number), DIGITS.zero)


def to_digits(number: Expr) -> mpf:
    """Take a number to 60 digits: a Rational, a Float, or a function of such, as a symbol's value makes one."""
    if isinstance(number, Rational):
        return DIGITS.mpf(number.p) / number.q
    value = number if isinstance(number, Float) else number.evalf(DIGITS.dps)
    if not isinstance(value, Float | Rational):
        raise ExpressionError(f"{number} is no real number", "keep to what its functions are defined for")
    return DIGITS.make_mpf(value._mpf_) if isinstance(value, Float) else to_digits(value)


def to_double(number: Expr) -> float:
    """Round a number to the nearest double. Raises ExpressionError where there is none near."""
    try:
        double = number.p / number.q if isinstance(number, Rational) else float(to_digits(number))
    except OverflowError:
        double = math.inf
    if math.isinf(double):
        raise ExpressionError("a value beyond the largest double", "make it smaller")
    if double == 0 and number != 0:
        raise ExpressionError("a value below the smallest double", "make it 0 or larger")
    return double


def _add(numbers: list[Expr]) -> Expr:
    if all(isinstance(number, Rational) for number in numbers) or len(numbers) == 1:
        return Add(*numbers)
    digits = [to_digits(number) for number in numbers]
    return _settle(sum(digits), DIGITS.fsum(digits, absolute=True))


def _compute(name: str, values: list[Expr]) -> Expr:
    if name == "tan":
        return _divide(_compute("sin", values), _compute("cos", values))
    operands = [to_digits(value) for value in values]
    if not all(map(_is_ordinary, operands)):  # 60 digits of exp(exp(exp(9))) fill any memory
        raise OverflowError
    result = _BUILT_IN[name](*operands) if name in _BUILT_IN else getattr(DIGITS, name)(*operands)
    if not isinstance(result, DIGITS.mpf) or not _is_ordinary(result):
        raise ValueError(f"{name} has no real value here")
    return _settle(result, abs(operands[0]) if name in _ROUNDING else DIGITS.zero)  # an angle brings its rounding


def _is_ordinary(number: mpf) -> bool:
    return bool(number == 0 or 1e-300 < abs(number) < 1e300)


def _settle(number: mpf, size: mpf) -> Expr:
    """Round a number computed from numbers of some size to 60 digits, or to the whole number that 50 of them show."""
    if abs(number) < 1e15:
        whole = DIGITS.nint(number)
        if abs(number - whole) <= _NOISE * size:
            return Integer(int(whole))
    return Float(number._mpf_, precision=DIGITS.prec)


def _divide(numerator: Expr, denominator: Expr) -> Expr:
    if denominator.is_zero:
        raise ZeroDivisionError
    return numerator / denominator
