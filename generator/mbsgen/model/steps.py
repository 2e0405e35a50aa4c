"""Steps of a computation, each a definition over earlier ones -> the derivatives of a result by its inputs, in reverse.

A step may be the root of an equation, whose value an iteration gives: its derivatives follow from the equation. A jump
has no derivative here: the sign of a number is taken as constant.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from sympy import Abs, DiracDelta, Expr, Mul, Pow, Symbol, atan2, cos, sign, sin

from mbsgen.model.symbols import total
from mbsgen.model.tree import ONE, ZERO, Vector

Define = Callable[[str, Expr], Expr]  # a number by a key


@dataclass(frozen=True)
class _Root:
    """A root of an equation."""

    symbol: Symbol  # in the equation
    equation: Expr
    steepness: Expr  # its slope by the root


class Steps:
    """Numbers that are defined one after the other, with their derivatives by earlier ones."""

    def __init__(self, define: Define) -> None:
        """Take what defines a number."""
        self._define = define
        self._steps: dict[Expr, Expr | _Root] = {}

    def __call__(self, key: str, value: Expr) -> Expr:
        """Define a number."""
        if value.is_Atom:
            return value
        defined = self._define(key, value)
        self._steps[defined] = value
        return defined

    def define_vector(self, key: str, vector: Vector) -> Vector:
        """Define the components of a vector."""
        x, y, z = (self(f"{key}.{axis}", value) for axis, value in zip("xyz", vector, strict=True))
        return x, y, z

    def solve(self, key: str, value: Expr, root: Symbol, equation: Expr) -> Expr:
        """Define a root of an equation, over `root`, by its value; its derivatives are the equation's."""
        defined = self._define(key, value)
        steepness = self._define(f"{key} steepness", _slope(equation, root).xreplace({root: defined}))
        self._steps[defined] = _Root(root, equation, steepness)
        return defined

    def differentiate(self, result: Expr, inputs: Sequence[Expr]) -> list[Expr]:
        """Return the derivatives of a defined number by some inputs."""
        moving = set(inputs)
        for symbol, step in self._steps.items():
            if not moving.isdisjoint(_list_symbols(step)):
                moving.add(symbol)
        parts: dict[Expr, list[Expr]] = {result: []}
        for symbol, step in reversed(self._steps.items()):
            if symbol not in parts:
                continue
            share = None if symbol == result else self._define(f"{symbol} share", total(parts[symbol]))
            for x in _list_symbols(step):
                slope = _find_slope(step, x, symbol) if x in moving else ZERO
                if slope != 0:
                    parts.setdefault(x, []).append(slope if share is None else share * slope)
        return [total(parts[x]) if x in parts else ZERO for x in inputs]


def differentiate(value: Expr, symbol: Symbol) -> Expr:
    """Differentiate a number; at a jump, which no number of a file has, its slope is taken as that beside it."""
    return value.diff(symbol).replace(DiracDelta, lambda *_: ZERO)


def _slope(value: Expr, x: Symbol) -> Expr:
    """Differentiate a number as `differentiate` does, by a few rules, which are quicker."""
    if value == x:
        return ONE
    if value.is_Atom or isinstance(value, sign):
        return ZERO
    inner = [_slope(argument, x) for argument in value.args]
    if all(slope == 0 for slope in inner):
        return ZERO
    if value.is_Add:
        return total(inner)
    if value.is_Mul:
        ways = [Mul(*value.args[:k], slope, *value.args[k + 1 :]) for k, slope in enumerate(inner) if slope != 0]
        return total(ways)
    first = value.args[0]
    if isinstance(value, Pow) and inner[1] == 0:
        return value.exp * Pow(first, value.exp - 1) * inner[0]
    if isinstance(value, Abs):
        return sign(first, evaluate=False) * inner[0]
    if isinstance(value, sin):
        return cos(first) * inner[0]
    if isinstance(value, cos):
        return -sin(first) * inner[0]
    if isinstance(value, atan2):
        y, z = value.args
        return (z * inner[0] - y * inner[1]) / (y**2 + z**2)
    return differentiate(value, x)


def _find_slope(step: Expr | _Root, x: Symbol, defined: Expr) -> Expr:
    if isinstance(step, _Root):
        return -_slope(step.equation, x).xreplace({step.symbol: defined}) / step.steepness
    return _slope(step, x)


def _list_symbols(step: Expr | _Root) -> list[Symbol]:
    """List the symbols that a step reads, apart from a root."""
    if isinstance(step, _Root):
        return [x for x in _list_symbols(step.equation) if x != step.symbol]
    return sorted(step.free_symbols, key=str)  # sets have no order
