"""The inputs of a motion: the forces u of actuated joints, then the external forces and moments w.

Time is cut into pieces, within which inputs are smooth: an integrator that steps over a jump would lose its order.

Inputs are given over time, or follow the state: feedback. A feedback acts at once, and is then part of the differential
equations, or it is sampled: computed every `period`, and held in between, so that each period is a piece.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mbsgen.errors import MbsError
from mbsgen.expressions import FLOATS, Expression, ExpressionError, Program, names
from mbsrun.kernel import Kernels
from mbsrun.quantities import ARRAYS as ARRAYS
from mbsrun.quantities import SENSED, Quantity, lay_out

Array = NDArray[np.float64]

Law = Callable[[Array, Array, Array], Array]  # times (K,), q (K, nq), qd (K, n) -> inputs (K, m)
Control = Callable[[Kernels, Array, Array, Array], Array]  # a law that calls kernels, for sensors

TIME = "t"  # the name of time in an expression
STATE = ("q", "qd", *SENSED)  # the kinds of quantities that a feedback can read


class DriveError(MbsError):
    """Inputs that have no value."""

    def __init__(self, finding: str, remedy: str) -> None:
        self.finding, self.remedy = finding, remedy
        super().__init__(f"{finding}; {remedy}")


_NONE: Array = np.zeros(0)


@dataclass(frozen=True)
class Piece:
    """A time span with smooth inputs."""

    start: float
    end: float
    values: Callable[[Array], Array]  # times (K,) -> inputs (K, m); not where a law is given
    is_constant: bool
    law: Law | None = None  # inputs that follow the state

    def follow(self, times: Array, q: Array, qd: Array) -> Array:
        """Return the inputs at times (K,) and states (K, nq), (K, n), shape (K, m)."""
        return self.values(times) if self.law is None else self.law(times, q, qd)

    def at(self, time: float, q: Array = _NONE, qd: Array = _NONE) -> Array:
        """Return the inputs at one time and state, shape (m,); a state matters to a law only."""
        return np.asarray(self.follow(np.array([time]), q[None], qd[None])[0])


@dataclass(frozen=True)
class Drive:
    """Inputs from time 0 on, in pieces that follow each other without a gap; or a feedback."""

    pieces: tuple[Piece, ...] = ()
    control: Control | None = None  # in place of pieces
    period: float | None = None  # s: how long the inputs of a control are held; None: it acts at once

    @property
    def end(self) -> float:
        """Return the time until which there are inputs."""
        return self.pieces[-1].end if self.pieces else np.inf

    def until(self, end: float) -> tuple[Piece, ...]:
        """Cut the pieces off at a time."""
        return tuple(
            Piece(piece.start, min(piece.end, end), piece.values, piece.is_constant)
            for piece in self.pieces
            if piece.start < end
        )

    def play(self, kernels: Kernels, end: float, state: Callable[[], tuple[Array, Array]]) -> Iterator[Piece]:
        """Yield the pieces until `end`; `state` returns q and qd at the time that was reached.

        Where forces read the time, it is the last input of every piece.
        """
        pieces = self._play(kernels, end, state)
        if kernels.manifest.reads_time:
            count = len(kernels.manifest.inputs)
            yield from (_add_time(piece, count) for piece in pieces)
        else:
            yield from pieces

    def _play(self, kernels: Kernels, end: float, state: Callable[[], tuple[Array, Array]]) -> Iterator[Piece]:
        if self.control is None:
            yield from self.until(end)
        elif self.period is None:
            yield Piece(0.0, end, _follow_nothing, False, partial(self.control, kernels))
        else:
            for k in range(int(np.ceil(end / self.period * (1 - 1e-12)))):
                start = k * self.period
                q, qd = state()
                held = self.control(kernels, np.array([start]), q[None], qd[None])[0]
                yield Piece(start, min(start + self.period, end), hold(held).pieces[0].values, True)


def cut(pieces: Iterator[Piece], times: Collection[float]) -> Iterator[Piece]:
    """Cut pieces at some times."""
    for piece in pieces:
        inner = sorted(t for t in {*times} if piece.start < t < piece.end)
        for start, end in itertools.pairwise((piece.start, *inner, piece.end)):
            yield replace(piece, start=start, end=end)


def _add_time(piece: Piece, count: int) -> Piece:
    """Return a piece with the time as the last of `count` inputs; a recorded one in its place is left out."""

    def join(times: Array, values: Array) -> Array:
        return np.column_stack((values[:, : count - 1], times))

    def follow(times: Array, q: Array, qd: Array) -> Array:
        return join(times, piece.follow(times, q, qd))

    law = None if piece.law is None else follow
    return Piece(piece.start, piece.end, lambda times: join(times, piece.values(times)), False, law)


def _follow_nothing(_: Array) -> Array:
    raise AssertionError("inputs that follow the state have no value over time alone")


def control(law: Callable[[float, Array, Array], ArrayLike], period: float | None = None) -> Drive:
    """Return inputs that follow the state: `law` takes t, q (nq,), qd (n,), and returns u and then w, m numbers.

    With a period [s] it is called once in each, and its inputs are held in between; a law with a memory needs that.
    Without a period it must be a smooth function: integrators call it at any time, and for states beside the motion
    too.
    """
    if period is not None and not (np.isfinite(period) and period > 0):
        raise ValueError(f"period = {period} must be a positive number")

    def compute(_: Kernels, times: Array, q: Array, qd: Array) -> Array:
        rows = [np.array(law(float(t), *x), dtype=np.float64) for t, *x in zip(times, q, qd, strict=True)]
        for t, row in zip(times, rows, strict=True):
            if row.ndim != 1 or not np.isfinite(row).all():
                found = f"{row.tolist()!s:.60}"
                raise DriveError(f"the control returned {found} at t = {t:.6g} s", "let it return finite numbers")
        return np.array(rows)

    return Drive(control=compute, period=period)


def differentiate(law: Law, times: Array, q: Array, qd: Array) -> tuple[Array, Array]:
    """Differentiate a law by q and qd, by central differences: shapes (K, m, nq) and (K, m, n)."""
    x = np.hstack((q, qd))
    count, size = x.shape
    steps = 1e-6 * (1 + np.abs(x))  # relative errors of some 1e-10, which suffice for Newton's method
    shifts = steps[:, :, None] * np.eye(size)  # (K, size, size): one entry of the state at a time
    ends = [
        law(np.repeat(times, size), *np.split((x[:, None] + sign * shifts).reshape(-1, size), [q.shape[1]], axis=1))
        for sign in (1, -1)
    ]
    slopes = (ends[0] - ends[1]).reshape(count, size, -1) / (2 * steps[:, :, None])
    by_q, by_qd = np.split(slopes.transpose(0, 2, 1), [q.shape[1]], axis=2)
    return by_q, by_qd


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


def follow_polynomials(times: ArrayLike, nodes: ArrayLike, values: ArrayLike) -> Drive:
    """Follow, from times[k] to times[k + 1], the polynomial through values[k] (d, m) at nodes[k] (d,)."""
    knots, at, given = (np.asarray(x, dtype=np.float64) for x in (times, nodes, values))
    from scipy.interpolate import BarycentricInterpolator  # takes long to load, and few motions need it

    pieces = [
        Piece(float(a), float(b), BarycentricInterpolator(x, y), False)
        for a, b, x, y in zip(knots, knots[1:], at, given, strict=False)
    ]
    return Drive(tuple(pieces))


def express(
    expressions: Sequence[Expression],
    labels: Sequence[str],
    constants: Mapping[str, float],
    quantities: Mapping[str, Quantity] = MappingProxyType({}),
    period: float | None = None,
) -> Drive:
    """Compute each input from an expression in `constants`, the time t, and `quantities` of the state.

    Labels name inputs in a DriveError. With a period, inputs are held so long. Raises ExpressionError for a
    name that is unknown.
    """
    known: dict[str, Array] = {name: np.float64(value) * np.ones(1) for name, value in constants.items()}
    known[TIME] = np.ones(1)
    used = {
        name: quantities[name] for e in expressions for name in names(e) if name in quantities and name not in known
    }

    program, single = Program(expressions, ARRAYS), Program(expressions, FLOATS)

    def compute(t: Array, state: Mapping[str, Array]) -> Array:
        if len(t) == 1:  # floats take a third of the time of arrays
            numbers = {TIME: t.item(), **{name: x.item() for name, x in state.items()}}
            values = _evaluate(single, {**constants, **numbers})
            if values is not None:
                return values[None]
        with np.errstate(all="ignore"):
            columns = [np.broadcast_to(x, t.shape) for x in program.evaluate({**known, TIME: t, **state})]
        for column, label in zip(columns, labels, strict=True):
            wrong = np.flatnonzero(~np.isfinite(column))
            if wrong.size:
                finding = f"the input of {label} has no finite value at t = {t[wrong[0]]:.6g} s"
                raise DriveError(finding, "mend its expression")
        return np.stack(columns, axis=1) if columns else np.zeros((len(t), 0))

    def follow(kernels: Kernels, t: Array, q: Array, qd: Array) -> Array:
        return compute(t, measure(used, kernels, q, qd))

    with np.errstate(all="ignore"):  # an unknown name is an error before anything runs
        program.evaluate({**known, **dict.fromkeys(used, np.ones(1))})
    if used or period is not None:
        return Drive(control=follow, period=period)
    is_constant = not any(TIME in names(expression) for expression in expressions)
    return Drive((Piece(0.0, np.inf, lambda t: compute(t, {}), is_constant),))


def _evaluate(program: Program[float], values: Mapping[str, float]) -> Array | None:
    """Compute expressions; None where one has no finite value."""
    try:
        found = program.evaluate(values)
    except ExpressionError:
        return None
    return np.array(found) if all(map(math.isfinite, found)) else None


def measure(used: Mapping[str, Quantity], kernels: Kernels, q: Array, qd: Array) -> dict[str, Array]:
    """Compute quantities of states (K, nq), (K, n): shape (K,) each."""
    kinds = {quantity.kind for quantity in used.values()}
    found = {"q": q, "qd": qd}
    for kind, sensed in SENSED.items():
        if kind in kinds:
            given: dict[str, Any] = {name: found[name] for name in sensed.inputs}
            found[kind] = lay_out(kernels(sensed.kernel, **given)[sensed.result])
    return {name: found[quantity.kind][:, quantity.index] for name, quantity in used.items()}
