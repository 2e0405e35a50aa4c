"""Functions of the motion of bodies, for Newton's equations: f, its time derivatives and its gradient.

    fd = G V,    fdd = G Vd + b

where V are velocities, G is the gradient of fd by them, and the bias b is fdd at Vd = 0. For y = g(f):

    yd = g' fd,    G_y = g' G,    b_y = g' b + g'' fd^2.
"""

from __future__ import annotations

import ast
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

from tests.fuzz.kinematics import Array, Numbers, evaluate

Slopes = Callable[[Any, Mapping[str, Callable[..., Any]]], tuple[Any, Any, Any]]
SLOPES: Mapping[str, Slopes] = MappingProxyType(
    {
        "sin": lambda x, f: (f["sin"](x), f["cos"](x), -f["sin"](x)),
        "cos": lambda x, f: (f["cos"](x), -f["sin"](x), -f["cos"](x)),
        "tan": lambda x, f: (t := f["tan"](x), 1 + t**2, 2 * t * (1 + t**2)),
        "asin": lambda x, f: (f["asin"](x), 1 / f["sqrt"](1 - x * x), x / f["sqrt"](1 - x * x) ** 3),
        "acos": lambda x, f: (f["acos"](x), -1 / f["sqrt"](1 - x * x), -x / f["sqrt"](1 - x * x) ** 3),
        "atan": lambda x, f: (f["atan"](x), 1 / (1 + x * x), -2 * x / (1 + x * x) ** 2),
        "sqrt": lambda x, f: (r := f["sqrt"](x), 1 / (2 * r), -1 / (4 * r**3)),
        "exp": lambda x, f: (f["exp"](x),) * 3,
        "log": lambda x, f: (f["log"](x), 1 / x, -1 / x**2),
        "tanh": lambda x, f: (t := f["tanh"](x), 1 - t**2, -2 * t * (1 - t**2)),
        "abs": lambda x, f: (f["abs"](x), 1 if x > 0 else -1, 0),
    }
)  # of each function: its value and two derivatives


@dataclass(frozen=True)
class Jet:
    """A function of the motion: f, fd, G and b of the module's equations."""

    value: Any
    rate: Any
    gradient: Array
    bias: Any

    def __neg__(self) -> Jet:
        return self * -1

    def __add__(self, other: Any) -> Jet:
        if not isinstance(other, Jet):
            return Jet(self.value + other, self.rate, self.gradient, self.bias)
        return Jet(
            self.value + other.value, self.rate + other.rate, self.gradient + other.gradient, self.bias + other.bias
        )

    __radd__ = __add__

    def __sub__(self, other: Any) -> Jet:
        return self + -other

    def __rsub__(self, other: Any) -> Jet:
        return -self + other

    def __mul__(self, other: Any) -> Jet:
        if not isinstance(other, Jet):
            return Jet(self.value * other, self.rate * other, self.gradient * other, self.bias * other)
        return Jet(
            self.value * other.value,
            self.rate * other.value + self.value * other.rate,
            self.gradient * other.value + self.value * other.gradient,
            self.bias * other.value + 2 * self.rate * other.rate + self.value * other.bias,
        )

    __rmul__ = __mul__

    def __truediv__(self, other: Any) -> Jet:
        return self * (other**-1 if isinstance(other, Jet) else 1 / other)

    def __rtruediv__(self, other: Any) -> Jet:
        return self**-1 * other

    def __pow__(self, exponent: Any) -> Jet:
        x, n = self.value, exponent
        return self.apply(x**n, n * x ** (n - 1), n * (n - 1) * x ** (n - 2) if n * (n - 1) else 0)

    def apply(self, value: Any, slope: Any, curvature: Any) -> Jet:
        """Return g(f), by g, g' and g'' at f."""
        bias = slope * self.bias + curvature * self.rate**2
        return Jet(value, slope * self.rate, slope * self.gradient, bias)


def dot(x: Array, y: Array) -> Any:
    """Return the scalar product of vectors of jets."""
    return sum((a * b for a, b in zip(x, y, strict=True)), 0)


def evaluate_jet(text: str, names: Mapping[str, Any], numbers: Numbers) -> Jet:
    """Evaluate an expression of a file, over names that are jets or numbers."""

    def lift(name: str) -> Callable[..., Any]:
        def apply(x: Any) -> Any:
            if not isinstance(x, Jet):
                return numbers.functions[name](x)
            return x.apply(*SLOPES[name](x.value, numbers.functions))

        return apply

    algebra = Numbers(numbers.make, {name: lift(name) for name in SLOPES}, numbers.pi, numbers.kind)
    found = evaluate(ast.parse(text, mode="eval").body, names, algebra)
    assert isinstance(found, Jet), text
    return found
