"""The numbers in a joint's own force, by name: Law -> the same Law with something else in place of each number.

A number that fills a place is called after it, such as `elbow.damping` or `elbow.friction.torque`. In `force`, whatever
depends on nothing is one number, and they are counted as they are written: -3/2*q**3 + 0.1*qd has `elbow.force.1`,
-3/2, and `elbow.force.2`. Exponents stay, and so does pi; an expression over parameters in another place stays whole.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import count

from mbsgen.expressions import Call, Constant, Expression, Negation, Operation, Power, names
from mbsgen.model.model import ZERO, Friction, Law

Exchange = Callable[[str, Expression], Expression]  # of a name and a number


def replace_numbers(law: Law, joint: str, exchange: Exchange) -> Law:
    """Replace each number in the law of a joint by the result of `exchange` for its name and its value."""

    def take(name: str, expression: Expression) -> Expression:
        return exchange(name, expression) if _is_number(expression) else expression

    return Law(
        stiffness=take(f"{joint}.stiffness", law.stiffness),
        rest=take(f"{joint}.rest", law.rest),
        damping=take(f"{joint}.damping", law.damping),
        friction=law.friction
        and Friction(
            torque=take(f"{joint}.friction.torque", law.friction.torque),
            speed=take(f"{joint}.friction.speed", law.friction.speed),
        ),
        force=replace_counted(law.force, f"{joint}.force", exchange),
    )


def replace_counted(expression: Expression, path: str, exchange: Exchange) -> Expression:
    """Replace each number in an expression by the result of `exchange` for `path`.1, `path`.2, ... and its value."""
    counted = (f"{path}.{k}" for k in count(1))

    def take(inner: Expression) -> Expression:
        if _is_number(inner):
            return exchange(next(counted), inner)
        match inner:
            case Negation(operand):
                return Negation(take(operand))
            case Operation(_, left, right):
                return replace(inner, left=take(left), right=take(right))
            case Power(base):
                return replace(inner, base=take(base))
            case Call(_, arguments):
                return replace(inner, arguments=tuple(map(take, arguments)))
        return inner

    return take(expression)


def _is_number(expression: Expression) -> bool:
    """Return whether this can have another value: pi and a plain 0 cannot, and names have theirs."""
    return not (names(expression) or isinstance(expression, Constant) or expression == ZERO)
