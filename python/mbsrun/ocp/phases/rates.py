"""The time derivative of an expression by the chain rule: names that change with time have rates.

    d/dt f(x) = sum over x of df/dx xd

Functions with a kink (abs, max, min) have none.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import reduce
from types import MappingProxyType

from mbsgen.expressions import (
    Call,
    Constant,
    Expression,
    ExpressionError,
    Name,
    Negation,
    Number,
    Operation,
    Power,
)


def differentiate(expression: Expression, rates: Mapping[str, Expression]) -> Expression:
    """Return the time derivative of an expression; names without a rate are constant.

    Raises ExpressionError for a function that has no derivative here.
    """
    return _rate(expression, rates) or Number(0.0)


def _rate(expression: Expression, rates: Mapping[str, Expression]) -> Expression | None:
    """Return the derivative; None where it is 0."""
    match expression:
        case Number() | Constant():
            return None
        case Name(name):
            return rates.get(name)
        case Negation(operand):
            rate = _rate(operand, rates)
            return None if rate is None else Negation(rate)
        case Power(base, exponent):
            rate = _rate(base, rates)
            if rate is None or exponent == 0:
                return None
            slope = Operation("*", Number(float(exponent)), Power(base, exponent - 1))
            return Operation("*", slope, rate)
        case Operation("+" | "-" as symbol, left, right):
            return _add(symbol, _rate(left, rates), _rate(right, rates))
        case Operation("*", left, right):
            parts = ((_rate(left, rates), right), (_rate(right, rates), left))
            return _sum([Operation("*", rate, other) for rate, other in parts if rate is not None])
        case Operation(_, left, right):
            above, below = _rate(left, rates), _rate(right, rates)
            if below is not None:
                below = Operation("*", expression, below)
            top = _add("-", above, below)
            return None if top is None else Operation("/", top, right)
        case Call(function, arguments):
            if function not in _SLOPES:
                raise ExpressionError(f"{function} has no rate in a map", f"take one of {', '.join(_SLOPES)}")
            slopes = _SLOPES[function](*arguments)
            found = [(_rate(x, rates), slope) for x, slope in zip(arguments, slopes, strict=True)]
            return _sum([Operation("*", slope, rate) for rate, slope in found if rate is not None])


def _add(symbol: str, left: Expression | None, right: Expression | None) -> Expression | None:
    if right is None:
        return left
    if left is None:
        return Negation(right) if symbol == "-" else right
    return Operation("-" if symbol == "-" else "+", left, right)


def _sum(terms: list[Expression]) -> Expression | None:
    return reduce(lambda a, b: Operation("+", a, b), terms) if terms else None


def _times(a: Expression, b: Expression) -> Expression:
    return Operation("*", a, b)


def _over(a: Expression, b: Expression) -> Expression:
    return Operation("/", a, b)


_ONE = Number(1.0)


def _call(function: str, x: Expression) -> Expression:
    return Call(function, (x,))


def _turn(y: Expression, x: Expression) -> tuple[Expression, ...]:
    square = Operation("+", _times(x, x), _times(y, y))
    return (_over(x, square), Negation(_over(y, square)))


def _step(x: Expression, w: Expression) -> tuple[Expression, ...]:
    """Differentiate 1/(1 + exp(-x/w)) by x and w: s (1 - s) (1/w, -x/w^2)."""
    own = Call("step", (x, w))
    slope = _over(_times(own, Operation("-", _ONE, own)), w)
    return (slope, Negation(_times(slope, _over(x, w))))


def _softplus(x: Expression, w: Expression) -> tuple[Expression, ...]:
    """Differentiate w log(1 + exp(x/w)) by x and w."""
    step, own = Call("step", (x, w)), Call("softplus", (x, w))
    return (step, _over(Operation("-", own, _times(x, step)), w))


def _across(x: Expression) -> Expression:
    """Return sqrt(1 - x^2)."""
    return _call("sqrt", Operation("-", _ONE, _times(x, x)))


_SLOPES: Mapping[str, Callable[..., tuple[Expression, ...]]] = MappingProxyType(
    {
        "sin": lambda x: (_call("cos", x),),
        "cos": lambda x: (Negation(_call("sin", x)),),
        "tan": lambda x: (Operation("+", _ONE, _times(_call("tan", x), _call("tan", x))),),
        "asin": lambda x: (_over(_ONE, _across(x)),),
        "acos": lambda x: (Negation(_over(_ONE, _across(x))),),
        "atan": lambda x: (_over(_ONE, Operation("+", _ONE, _times(x, x))),),
        "atan2": _turn,
        "sqrt": lambda x: (_over(Number(0.5), _call("sqrt", x)),),
        "exp": lambda x: (_call("exp", x),),
        "log": lambda x: (_over(_ONE, x),),
        "tanh": lambda x: (Operation("-", _ONE, _times(_call("tanh", x), _call("tanh", x))),),
        "step": _step,
        "softplus": _softplus,
    }
)
