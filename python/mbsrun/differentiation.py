"""Expression, rates of names -> the derivative of the expression by the chain rule, exact.

    d/dt f(x) = sum over x of df/dx xd

With the rate 1 of one name, it is the derivative by that name. Functions with a kink (abs, max, min) are refused where
their arguments change. `step` and `softplus` have all derivatives: softplus(x, w)' = step(x, w) (x' - x w'/w) +
softplus(x, w) w'/w, and step' follows from z = x/w.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

from mbsgen.expressions import (
    BEZIER,
    Call,
    Expression,
    ExpressionError,
    Name,
    Negation,
    Number,
    Operation,
    Power,
    measure,
    names,
    parse,
    substitute,
    write,
)

MAX_TERMS = 5000  # of a derivative
SMOOTH = "take sin, exp, step, softplus, ..., which have all derivatives"

_ZERO, _ONE = Number(0.0), Number(1.0)
_SLOPES: Mapping[str, Expression] = {  # of functions of x
    "sin": parse("cos(x)"),
    "cos": parse("-sin(x)"),
    "tan": parse("1 + tan(x)**2"),
    "asin": parse("1/sqrt(1 - x**2)"),
    "acos": parse("-1/sqrt(1 - x**2)"),
    "atan": parse("1/(1 + x**2)"),
    "sqrt": parse("1/(2*sqrt(x))"),
    "exp": parse("exp(x)"),
    "log": parse("1/x"),
    "tanh": parse("1 - tanh(x)**2"),
}
_PAIRS: Mapping[str, tuple[Expression, Expression]] = {  # of functions of x and w, by each
    "atan2": (parse("w/(x**2 + w**2)"), parse("-x/(x**2 + w**2)")),
    "step": (parse("step(x, w)*step(-x, w)/w"), parse("-x*step(x, w)*step(-x, w)/w**2")),
    "softplus": (parse("step(x, w)"), parse("(softplus(x, w) - x*step(x, w))/w")),
}
_SMOOTHMAX = parse("x + (y - x)*step(y - x, w)")


class DerivativeError(ExpressionError):
    """An expression without a derivative, or with one that is too long."""


def differentiate(expression: Expression, rates: Mapping[str, Expression]) -> Expression:
    """Return the derivative of an expression; names without a rate are constant.

    Raises DerivativeError for a function with a kink, and for a derivative of more than MAX_TERMS terms.
    """
    found = _differentiate(expression, rates)
    if (terms := measure(found).terms) > MAX_TERMS:
        finding = f"a derivative has {terms} terms, of {MAX_TERMS} at most"
        raise DerivativeError(finding, "give a shorter expression, nested less deeply")
    return found


def differentiate_by(expression: Expression, name: str) -> Expression:
    """Return the derivative of an expression by a name. Raises DerivativeError as `differentiate` does."""
    return differentiate(expression, {name: _ONE})


def _differentiate(expression: Expression, rates: Mapping[str, Expression]) -> Expression:
    if names(expression).isdisjoint(rates):
        return _ZERO
    match expression:
        case Name(name):
            return rates[name]
        case Negation(operand):
            return _negate(_differentiate(operand, rates))
        case Operation(symbol, left, right):
            return _differentiate_operation(symbol, (left, right), rates)
        case Power(base, exponent):
            slope = _multiply(Number(float(exponent)), _raise(base, exponent - 1))
            return _multiply(slope, _differentiate(base, rates))
        case Call(function, arguments):
            return _differentiate_call(function, arguments, rates)
    raise AssertionError("numbers read no name")


def _differentiate_operation(
    symbol: Literal["+", "-", "*", "/"], operands: tuple[Expression, Expression], rates: Mapping[str, Expression]
) -> Expression:
    left, right = operands
    a, b = _differentiate(left, rates), _differentiate(right, rates)
    match symbol:
        case "+":
            return _add(a, b)
        case "-":
            return _add(a, _negate(b))
        case "*":
            return _add(_multiply(a, right), _multiply(left, b))
    return _add(_divide(a, right), _negate(_divide(_multiply(left, b), _raise(right, 2))))


def _differentiate_call(
    function: str, arguments: tuple[Expression, ...], rates: Mapping[str, Expression]
) -> Expression:
    inner = [_differentiate(argument, rates) for argument in arguments]
    if function in _SLOPES:
        return _multiply(substitute(_SLOPES[function], {"x": arguments[0]}), inner[0])
    if function == "smoothmax":
        return _differentiate(substitute(_SMOOTHMAX, dict(zip("xyw", arguments, strict=True))), rates)
    if function == BEZIER:
        raise DerivativeError(f"{write(Call(function, arguments))} is not differentiated here", SMOOTH)
    if function not in _PAIRS:
        raise DerivativeError(f"{write(Call(function, arguments))} has a kink, where it has no derivative", SMOOTH)
    values = dict(zip("xw", arguments, strict=True))
    first, second = (_multiply(substitute(slope, values), x) for slope, x in zip(_PAIRS[function], inner, strict=True))
    return _add(first, second)


def _add(a: Expression, b: Expression) -> Expression:
    if a == _ZERO:
        return b
    if b == _ZERO:
        return a
    return Operation("-", a, b.operand) if isinstance(b, Negation) else Operation("+", a, b)


def _negate(a: Expression) -> Expression:
    if a == _ZERO:
        return _ZERO
    return a.operand if isinstance(a, Negation) else Negation(a)


def _multiply(a: Expression, b: Expression) -> Expression:
    if _ZERO in (a, b):
        return _ZERO
    if a == _ONE:
        return b
    return a if b == _ONE else Operation("*", a, b)


def _divide(a: Expression, b: Expression) -> Expression:
    return _ZERO if a == _ZERO else Operation("/", a, b)


def _raise(base: Expression, exponent: int) -> Expression:
    if exponent == 0:
        return _ONE
    return base if exponent == 1 else Power(base, exponent)
