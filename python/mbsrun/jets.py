"""Expressions with first and second derivatives, over arrays: second-order forward differentiation.

A jet is f with its gradient g and Hessian H by n variables, at many places at once:

    (a b)' = a' b + a b',    (a b)'' = a'' b + a b'' + a' b'T + b' a'T,
    phi(a)' = phi' a',       phi(a)'' = phi' a'' + phi'' a' a'T.

Griewank, Walther, "Evaluating derivatives", SIAM 2008, chapter 13. `DEPENDENCE` finds the nonzeros by the same rules.
Flat jets have no Hessian, and the same values and gradients.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mbsgen.expressions import Algebra

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Jet:
    """A value at every place with its derivatives; shapes broadcast to (places,), (places, n), (places, n, n)."""

    f: Array
    g: Array
    H: Array  # of a flat jet: (0,)

    @property
    def is_flat(self) -> bool:
        """Return whether there is no Hessian."""
        return self.H.ndim == 1


@dataclass(frozen=True)
class Dependence:
    """Which first and second derivatives, (n,) and (n, n), may be nonzero."""

    g: Mask
    H: Mask


NO_HESSIAN = np.zeros(0)


def vary(values: Array, index: int, n: int, *, is_flat: bool = False) -> Jet:
    """Return the jet of a variable: number `index` of n."""
    return Jet(values, np.eye(n)[index], NO_HESSIAN if is_flat else np.zeros((n, n)))


def depend(index: int, n: int) -> Dependence:
    """Return the dependence of a variable: number `index` of n."""
    return Dependence(np.arange(n) == index, np.zeros((n, n), dtype=bool))


def make_jets(n: int, *, is_flat: bool = False) -> Algebra[Jet]:
    """Make the algebra of jets in n variables, or of flat ones."""

    def number(value: float) -> Jet:
        return Jet(np.array(value), np.zeros(n), NO_HESSIAN if is_flat else np.zeros((n, n)))

    def power(a: Jet, k: int) -> Jet:
        first = k * a.f ** float(k - 1) if k else np.zeros_like(a.f)
        second = k * (k - 1) * a.f ** float(k - 2) if k not in (0, 1) else np.zeros_like(a.f)
        return _chain(a, a.f ** float(k), first, second)

    return Algebra(
        number=number,
        constants={"pi": number(np.pi)},
        negate=lambda a: Jet(-a.f, -a.g, -a.H),
        operations={
            "+": lambda a, b: Jet(a.f + b.f, a.g + b.g, a.H + b.H),
            "-": lambda a, b: Jet(a.f - b.f, a.g - b.g, a.H - b.H),
            "*": _multiply,
            "/": lambda a, b: _multiply(a, power(b, -1)),
        },
        power=power,
        functions={
            **{name: _lift(derivatives) for name, derivatives in _FUNCTIONS.items()},
            "atan2": _atan2,
            "max": _choose_larger,
        },
    )


def make_dependences(n: int) -> Algebra[Dependence]:
    """Make the algebra of dependences on n variables."""

    def number(_: float) -> Dependence:
        return Dependence(np.zeros(n, dtype=bool), np.zeros((n, n), dtype=bool))

    def add(a: Dependence, b: Dependence) -> Dependence:
        return Dependence(a.g | b.g, a.H | b.H)

    def multiply(a: Dependence, b: Dependence) -> Dependence:
        mixed = np.outer(a.g, b.g)
        return Dependence(a.g | b.g, a.H | b.H | mixed | mixed.T)

    def bend(a: Dependence) -> Dependence:
        return Dependence(a.g, a.H | np.outer(a.g, a.g))

    def power(a: Dependence, k: int) -> Dependence:
        return number(1.0) if k == 0 else a if k == 1 else bend(a)

    return Algebra(
        number=number,
        constants={"pi": number(np.pi)},
        negate=lambda a: a,
        operations={"+": add, "-": add, "*": multiply, "/": lambda a, b: multiply(a, bend(b))},
        power=power,
        functions={
            **dict.fromkeys(_FUNCTIONS, bend),
            "abs": lambda a: a,
            "max": add,
            "atan2": lambda y, x: bend(add(y, x)),
        },
    )


def compose(f: Array, g: Array, H: Array, arguments: Sequence[Jet]) -> Jet:
    """Apply a function of several jets: its value (places,), gradient (places, k), and Hessian (places, k, k)."""
    by = np.stack([np.broadcast_to(a.g, (*f.shape, a.g.shape[-1])) for a in arguments], axis=1)
    if all(a.is_flat for a in arguments):
        return Jet(f, np.einsum("pk,pkn->pn", g, by), NO_HESSIAN)
    curved = np.einsum("pkn,pkl,plm->pnm", by, H, by)
    for i, a in enumerate(arguments):
        curved = curved + g[:, i, None, None] * a.H
    return Jet(f, np.einsum("pk,pkn->pn", g, by), curved)


def compose_dependences(g: Mask, H: Mask, arguments: Sequence[Dependence]) -> Dependence:
    """Return the dependence of a function of several; g (k,) and H (k, k) mark its own derivatives."""
    by = np.stack([a.g for a in arguments]).astype(np.int64)
    mixed = (by.T @ H.astype(np.int64) @ by) > 0
    own = [a.H for a, is_read in zip(arguments, g, strict=True) if is_read]
    return Dependence((g.astype(np.int64) @ by) > 0, np.any([mixed, *own], axis=0))


def _chain(a: Jet, value: Array, first: Array, second: Array) -> Jet:
    """Apply a function with its two derivatives."""
    if a.is_flat:
        return Jet(value, first[..., None] * a.g, NO_HESSIAN)
    first, second = first[..., None], second[..., None, None]
    return Jet(value, first * a.g, first[..., None] * a.H + second * a.g[..., :, None] * a.g[..., None, :])


def _multiply(a: Jet, b: Jet) -> Jet:
    af, bf = a.f[..., None], b.f[..., None]
    if a.is_flat:
        return Jet(a.f * b.f, af * b.g + bf * a.g, NO_HESSIAN)
    mixed = a.g[..., :, None] * b.g[..., None, :]
    H = af[..., None] * b.H + bf[..., None] * a.H + mixed + np.swapaxes(mixed, -1, -2)
    return Jet(a.f * b.f, af * b.g + bf * a.g, H)


def _lift(derivatives: Callable[[Array], tuple[Array, Array, Array]]) -> Callable[[Jet], Jet]:
    return lambda a: _chain(a, *derivatives(a.f))


def _atan2(y: Jet, x: Jet) -> Jet:
    """The gradient of the angle is (x, -y) / r^2 by (y, x)."""
    r2 = x.f**2 + y.f**2
    by_y, by_x = x.f / r2, -y.f / r2
    if y.is_flat:
        return Jet(np.arctan2(y.f, x.f), by_y[..., None] * y.g + by_x[..., None] * x.g, NO_HESSIAN)
    yy, yx = -2 * by_y * y.f / r2, (y.f**2 - x.f**2) / r2**2
    gy, gx = y.g, x.g

    def outer(a: Array, b: Array) -> Array:
        return np.asarray(a[..., :, None] * b[..., None, :])

    def scale(weight: Array, matrix: Array) -> Array:
        return np.asarray(weight[..., None, None] * matrix)

    H = scale(by_y, y.H) + scale(by_x, x.H) + scale(yy, outer(gy, gy) - outer(gx, gx))
    H = H + scale(yx, outer(gy, gx) + outer(gx, gy))
    return Jet(np.arctan2(y.f, x.f), by_y[..., None] * gy + by_x[..., None] * gx, H)


def _choose_larger(a: Jet, b: Jet) -> Jet:
    """Return the larger one; half of each where they are equal."""
    s = (1 + np.sign(a.f - b.f)) / 2

    def choose(x: Array, y: Array, axes: int) -> Array:
        shape = (..., *[None] * axes)
        return np.asarray(s[shape] * x + (1 - s)[shape] * y)

    H = NO_HESSIAN if a.is_flat else choose(a.H, b.H, 2)
    return Jet(choose(a.f, b.f, 0), choose(a.g, b.g, 1), H)


def _tan(x: Array) -> tuple[Array, Array, Array]:
    t = np.tan(x)
    return t, 1 + t**2, 2 * t * (1 + t**2)


def _tanh(x: Array) -> tuple[Array, Array, Array]:
    t = np.tanh(x)
    return t, 1 - t**2, -2 * t * (1 - t**2)


def _asin(x: Array) -> tuple[Array, Array, Array]:
    root = np.sqrt(1 - x**2)
    return np.arcsin(x), 1 / root, x / root**3


def _acos(x: Array) -> tuple[Array, Array, Array]:
    root = np.sqrt(1 - x**2)
    return np.arccos(x), -1 / root, -x / root**3


def _sqrt(x: Array) -> tuple[Array, Array, Array]:
    root = np.sqrt(x)
    return root, 0.5 / root, -0.25 / root**3


_FUNCTIONS: Mapping[str, Callable[[Array], tuple[Array, Array, Array]]] = {
    "sin": lambda x: (np.sin(x), np.cos(x), -np.sin(x)),
    "cos": lambda x: (np.cos(x), -np.sin(x), -np.cos(x)),
    "tan": _tan,
    "asin": _asin,
    "acos": _acos,
    "atan": lambda x: (np.arctan(x), 1 / (1 + x**2), -2 * x / (1 + x**2) ** 2),
    "sqrt": _sqrt,
    "exp": lambda x: (np.exp(x), np.exp(x), np.exp(x)),
    "log": lambda x: (np.log(x), 1 / x, -1 / x**2),
    "tanh": _tanh,
    "abs": lambda x: (np.abs(x), np.sign(x), np.zeros_like(x)),
}
