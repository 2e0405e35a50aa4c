"""The inputs of a motion over time: the forces u of actuated joints, then the external forces and moments w.

Time is cut into pieces, within which inputs are smooth: an integrator that steps over a jump would lose its order.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mbsgen.errors import MbsError
from mbsgen.expressions import Algebra, Expression, evaluate, names
from mbsgen.manifest import Manifest

Array = NDArray[np.float64]

TIME = "t"  # the name of time in an expression


class DriveError(MbsError):
    """Inputs that have no value."""


@dataclass(frozen=True)
class Piece:
    """A time span with smooth inputs."""

    start: float
    end: float
    values: Callable[[Array], Array]  # times (K,) -> inputs (K, m)
    is_constant: bool

    def at(self, time: float) -> Array:
        """Give the inputs at one time, shape (m,)."""
        return np.asarray(self.values(np.array([time]))[0])


@dataclass(frozen=True)
class Drive:
    """Inputs from time 0 on, in pieces that follow each other without a gap."""

    pieces: tuple[Piece, ...]

    @property
    def end(self) -> float:
        """Tell until when there are inputs."""
        return self.pieces[-1].end

    def until(self, end: float) -> tuple[Piece, ...]:
        """Cut the pieces off at a time."""
        return tuple(
            Piece(piece.start, min(piece.end, end), piece.values, piece.is_constant)
            for piece in self.pieces
            if piece.start < end
        )


def hold(values: ArrayLike) -> Drive:
    """Hold inputs (m,) for ever."""
    held = np.array(values, dtype=np.float64)
    return Drive((Piece(0.0, np.inf, lambda t: np.broadcast_to(held, (len(t), held.size)), True),))


def hold_steps(times: ArrayLike, values: ArrayLike) -> Drive:
    """Hold values[k] from times[k] to times[k + 1]: times (N + 1,) from 0 on, increasing; values (N, m)."""
    knots, held = np.asarray(times, dtype=np.float64), np.asarray(values, dtype=np.float64)
    if held.ndim != 2 or knots.shape != (len(held) + 1,) or knots[0] != 0 or (np.diff(knots) <= 0).any():
        raise ValueError("inputs held in steps need times from 0 on, that increase, one more than values")
    pieces = [
        Piece(float(a), float(b), hold(row).pieces[0].values, True)
        for a, b, row in zip(knots, knots[1:], held, strict=False)
    ]
    return Drive(tuple(pieces))


def express(expressions: Sequence[Expression], labels: Sequence[str], constants: Mapping[str, float]) -> Drive:
    """Compute each input from an expression in `constants` and the time t; labels name them in a DriveError.

    Raises ExpressionError for a name that is unknown.
    """
    known: dict[str, Array] = {name: np.float64(value) * np.ones(1) for name, value in constants.items()}

    def values(t: Array) -> Array:
        columns = []
        for expression, label in zip(expressions, labels, strict=True):
            with np.errstate(all="ignore"):
                column = np.broadcast_to(evaluate(expression, {**known, TIME: t}, ARRAYS), t.shape)
            wrong = np.flatnonzero(~np.isfinite(column))
            if wrong.size:
                raise DriveError(
                    f"the input of {label} has no finite value at t = {t[wrong[0]]:.6g} s; mend its expression"
                )
            columns.append(column)
        return np.stack(columns, axis=1) if columns else np.zeros((len(t), 0))

    values(np.zeros(1)) if not any(TIME in names(e) for e in expressions) else _check_names(expressions, known)
    is_constant = not any(TIME in names(expression) for expression in expressions)
    return Drive((Piece(0.0, np.inf, values, is_constant),))


def input_labels(manifest: Manifest) -> tuple[str, ...]:
    """Name the inputs: u by their joints, then w by wrench and component."""
    joints = [manifest.coordinates[i].name for i in manifest.actuated]
    parts = [
        f"{wrench.name}.{part}.{axis}"
        for wrench in manifest.wrenches
        for part, is_input in (("force", wrench.force), ("moment", wrench.moment))
        if is_input
        for axis in "xyz"
    ]
    return (*joints, *parts)


def _check_names(expressions: Sequence[Expression], known: Mapping[str, Array]) -> None:
    """Let an unknown name be told before anything runs, wherever the first time lies."""
    for expression in expressions:
        with np.errstate(all="ignore"):
            evaluate(expression, {**known, TIME: np.ones(1)}, ARRAYS)


def _number(value: float) -> Array:
    return np.array([value])


ARRAYS: Algebra[Array] = Algebra(
    number=_number,
    constants={"pi": _number(np.pi)},
    negate=np.negative,
    operations={"+": np.add, "-": np.subtract, "*": np.multiply, "/": np.divide},
    power=lambda base, exponent: np.power(base, float(exponent)),
    functions={
        "sin": np.sin,
        "cos": np.cos,
        "tan": np.tan,
        "asin": np.arcsin,
        "acos": np.arccos,
        "atan": np.arctan,
        "atan2": np.arctan2,
        "sqrt": np.sqrt,
        "exp": np.exp,
        "log": np.log,
        "tanh": np.tanh,
        "abs": np.abs,
    },
)
