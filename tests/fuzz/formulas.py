"""Expressions as trees that are drawn: written as text for a file, and computed by NumPy's own arithmetic.

A tree is a number, a name, or a tuple of an operation and its operands. Nothing here reads text.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SMOOTH = ("sin", "cos", "tanh", "atan", "exp", "sqrt", "log")
_BINDING = {"+": 1, "-": 1, "*": 2, "/": 2, "neg": 3, "**": 4}
_KINKED = ("abs", "max", "min")


@dataclass(frozen=True)
class Formula:
    """An expression."""

    tree: Any

    @property
    def text(self) -> str:
        """Write it, with brackets only where they are needed."""
        return _write(self.tree, 0)

    @property
    def names(self) -> frozenset[str]:
        """List the names that it reads."""
        return frozenset(_list_names(self.tree))

    def evaluate(self, known: Mapping[str, Array | float]) -> Array:
        """Compute it where names have these values."""
        return np.asarray(_compute(self.tree, known), dtype=np.float64)


@dataclass(frozen=True)
class Drive(Formula):
    """An expression of the time, with its first and second derivative."""

    rate: Formula
    second: Formula


def draw_drive(pick: random.Random, start: float, unknowns: Sequence[str]) -> Drive:
    """Draw a motion from a place, at rest or at a velocity that is a number; unknowns may scale what follows."""
    a, w, k = round(pick.uniform(-0.4, 0.4), 3), pick.choice([1.5, "pi", "c0"]), pick.choice([2, 3])
    t, by = ("/", "t", "T"), ("/", 1, "T")
    scale = pick.choice([a, *unknowns, "c1"])
    wave = ("*", w, "t")
    parts = [
        (
            ("*", a, ("sin", wave)),
            ("*", ("*", a, w), ("cos", wave)),
            ("neg", ("*", ("*", a, ("**", w, 2)), ("sin", wave))),
        ),
        (
            ("*", scale, ("**", t, k)),
            ("*", ("*", scale, k), ("*", ("**", t, k - 1), by)),
            ("*", ("*", scale, k * (k - 1)), ("*", ("**", t, k - 2), ("**", by, 2))),
        ),
    ]
    chosen = pick.choice([parts, parts[:1], parts[1:]])
    found: list[Any] = [start, 0, 0]
    for part in chosen:
        found = [("+", x, y) for x, y in zip(found, part, strict=True)]
    return Drive(found[0], Formula(found[1]), Formula(found[2]))


def write(part: Any) -> Any:
    """Return data for a file: formulas become text."""
    match part:
        case Formula():
            return part.text
        case dict():
            return {key: write(value) for key, value in part.items()}
        case list():
            return [write(value) for value in part]
    return part


def draw(pick: random.Random, names: Sequence[str], depth: int = 3, *, kinks: bool = False) -> Formula:
    """Draw an expression that reads some of the names, one at least, and that is finite everywhere."""
    tree = _draw(pick, names, depth, kinks=kinks)
    if not any(True for _ in _list_names(tree)):
        tree = ("*", tree, pick.choice(names))
    return Formula(tree)


def draw_quantity(pick: random.Random, names: Sequence[str], depth: int = 2) -> Formula:
    """Draw a sum in which each term reads names: derivatives are seldom 0."""
    return Formula(("+", draw(pick, names, depth).tree, draw(pick, names, depth).tree))


def _draw(pick: random.Random, names: Sequence[str], depth: int, *, kinks: bool) -> Any:
    if depth == 0 or pick.random() < 0.2:
        return pick.choice(names) if pick.random() < 0.75 else round(pick.uniform(-2, 2), 2)

    def inner() -> Any:
        return _draw(pick, names, depth - 1, kinks=kinks)

    kind = pick.choice(["+", "-", "*", "*", "/", "neg", "**", "smooth", "smooth", "two", "kink" if kinks else "**"])
    match kind:
        case "+" | "-" | "*":
            return (kind, inner(), inner())
        case "/":
            return (kind, inner(), ("+", 1.5, ("**", inner(), 2)))
        case "neg":
            return (kind, inner())
        case "**":
            return (kind, inner(), pick.choice([2, 2, 3]))
        case "smooth":
            return _draw_smooth(pick, inner)
        case "two":
            return (pick.choice(["step", "softplus", "atan2"]), inner(), pick.choice([0.3, 0.7]))
    name = pick.choice(_KINKED)
    return (name, inner()) if name == "abs" else (name, inner(), inner())


def _draw_smooth(pick: random.Random, inner: Callable[[], Any]) -> Any:
    """Draw a function of an argument for which it is defined, and does not grow too much."""
    name = pick.choice(SMOOTH)
    match name:
        case "exp":
            return (name, ("sin", inner()))
        case "sqrt" | "log":
            return (name, ("+", 1.2, ("**", inner(), 2)))
    return (name, inner())


def _list_names(tree: Any) -> list[str]:
    if isinstance(tree, str):
        return [tree]
    return [name for part in tree[1:] for name in _list_names(part)] if isinstance(tree, tuple) else []


def _write(tree: Any, binding: int) -> str:
    if isinstance(tree, str):
        return tree
    if not isinstance(tree, tuple):
        return f"({tree})" if tree < 0 and binding > 1 else str(tree)
    kind, *parts = tree
    strength = _BINDING.get(kind)
    match kind:
        case "+" | "-" | "*" | "/":
            assert strength is not None
            text = f"{_write(parts[0], strength)} {kind} {_write(parts[1], strength + 1)}"
        case "neg":
            text = f"-{_write(parts[0], 3)}"
        case "**":
            text = f"{_write(parts[0], 5)}**{parts[1]}"
        case _:
            return f"{kind}({', '.join(_write(part, 0) for part in parts)})"
    return f"({text})" if strength is not None and strength < binding else text


def _step(x: Array, w: Array) -> Array:
    return np.asarray(1 / (1 + np.exp(-x / w)))


def _softplus(x: Array, w: Array) -> Array:
    return np.asarray(w * np.logaddexp(0.0, x / w))


_FUNCTIONS: Mapping[str, Callable[..., Any]] = {
    "+": np.add,
    "-": np.subtract,
    "*": np.multiply,
    "/": np.divide,
    "neg": np.negative,
    "**": np.power,
    **{name: getattr(np, name) for name in ("sin", "cos", "tanh", "exp", "sqrt", "log", "abs")},
    "atan": np.arctan,
    "atan2": np.arctan2,
    "max": np.maximum,
    "min": np.minimum,
    "step": _step,
    "softplus": _softplus,
}


def _compute(tree: Any, known: Mapping[str, Array | float]) -> Any:
    if isinstance(tree, str):
        return np.pi if tree == "pi" else known[tree]
    if not isinstance(tree, tuple):
        return float(tree)
    kind, *parts = tree
    if kind == "**":
        return _compute(parts[0], known) ** parts[1]
    return _FUNCTIONS[kind](*(_compute(part, known) for part in parts))
