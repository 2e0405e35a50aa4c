"""Given motions of driven joints: q(t), with the exact first and second derivatives of its expressions."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mbsgen.expressions import Call, Expression, Operation, evaluate, list_operands, names
from mbsgen.manifest import Manifest
from mbsrun.jets import make_jets, vary
from mbsrun.simulation.drive import ARRAYS, TIME, DriveError

Array = NDArray[np.float64]

START = 1e-9  # how far a start may be from the course, absolute and relative
KINKS = ("abs", "max", "min")
SAMPLES = 2001  # times at which a kink is looked for
HALVINGS = 60  # of the time between two of them
BESIDE = 1e-6  # of the duration: where velocities on both sides of a kink are compared
NO_JUMP = 1e-6  # of velocities, relative to the largest


@dataclass(frozen=True)
class Course:
    """The motion of d driven joints."""

    states: Callable[[Array], tuple[Array, Array, Array]]  # times (K,) -> q, qd, qdd (K, d)
    is_constant: bool

    def at(self, time: float) -> tuple[Array, Array, Array]:
        """Return q, qd and qdd at one time, (d,) each."""
        q, qd, qdd = self.states(np.array([time]))
        return q[0], qd[0], qdd[0]


def stand(values: ArrayLike) -> Course:
    """Keep driven joints at coordinates (d,)."""
    kept = np.array(values, dtype=np.float64)

    def states(t: Array) -> tuple[Array, Array, Array]:
        rest = np.zeros((len(t), kept.size))
        return np.broadcast_to(kept, rest.shape), rest, rest

    return Course(states, True)


def follow(expressions: Sequence[Expression], labels: Sequence[str], constants: Mapping[str, float]) -> Course:
    """Move each driven joint along an expression in `constants` and the time t; labels name joints in a DriveError.

    Raises ExpressionError for a name that is unknown.
    """
    algebra = make_jets(1)
    known = {name: algebra.number(value) for name, value in constants.items()}

    def states(t: Array) -> tuple[Array, Array, Array]:
        found = np.zeros((3, len(t), len(expressions)))
        for k, (expression, label) in enumerate(zip(expressions, labels, strict=True)):
            with np.errstate(all="ignore"):
                jet = evaluate(expression, {**known, TIME: vary(t, 0, 1)}, algebra)
            found[0, :, k], found[1, :, k], found[2, :, k] = jet.f, jet.g[..., 0], jet.H[..., 0, 0]
            wrong = np.flatnonzero(~np.isfinite(found[:, :, k]).all(axis=0))
            if wrong.size:
                finding = f"the motion of joint {label} has no finite value or derivative at t = {t[wrong[0]]:.6g} s"
                raise DriveError(finding, "mend its expression")
        return found[0], found[1], found[2]

    for expression in expressions:  # an unknown name is an error before anything runs
        with np.errstate(all="ignore"):
            evaluate(expression, {**known, TIME: vary(np.zeros(1), 0, 1)}, algebra)
    return Course(states, not any(TIME in names(expression) for expression in expressions))


@dataclass(frozen=True)
class Jump:
    """A velocity that changes in an instant."""

    time: float
    change: float
    function: str


def find_jump(expression: Expression, constants: Mapping[str, float], duration: float) -> Jump | None:
    """Find the first time at which abs, max or min makes the velocity of a driven joint jump."""
    found = [
        Jump(time, change, kink.function)
        for kink in _list_kinks(expression)
        for time in _find_zeros(_measure_gap(kink), constants, duration)
        if (change := _measure_jump(expression, constants, time, duration))
    ]
    return min(found, key=lambda jump: jump.time, default=None)


def _list_kinks(expression: Expression) -> Iterator[Call]:
    if isinstance(expression, Call) and expression.function in KINKS and TIME in names(expression):
        yield expression
    for part in list_operands(expression):
        yield from _list_kinks(part)


def _measure_gap(kink: Call) -> Expression:
    """Return the number whose sign decides on the side of a kink."""
    return kink.arguments[0] if kink.function == "abs" else Operation("-", *kink.arguments)


def _find_zeros(gap: Expression, constants: Mapping[str, float], duration: float) -> list[float]:
    """Find the times at which a gap changes its sign, by bisection between samples."""
    known = {name: np.full(1, value) for name, value in constants.items()}

    def measure(t: Array) -> Array:
        with np.errstate(all="ignore"):
            return np.asarray(np.sign(np.broadcast_to(evaluate(gap, {**known, TIME: t}, ARRAYS), t.shape)))

    t = np.linspace(0.0, duration, SAMPLES)
    signs = measure(t)
    zeros = []
    for k in np.flatnonzero(signs[1:] != signs[:-1]).tolist():
        low, high = t[k], t[k + 1]
        for _ in range(HALVINGS):
            middle = (low + high) / 2
            low, high = (middle, high) if measure(np.array([middle]))[0] == signs[k] else (low, middle)
        zeros.append(float(low))
    return zeros


def _measure_jump(expression: Expression, constants: Mapping[str, float], time: float, duration: float) -> float:
    """Return by how much the velocity jumps at a time; 0 where it is continuous, so that its change is the step's."""
    course = follow([expression], [""], constants)
    near, far = BESIDE / 10 * duration, BESIDE * duration
    times = np.clip(time + np.array([-far, -near, near, far]), 0.0, duration)
    v = course.states(times)[1][:, 0]
    largest = np.abs(course.states(np.linspace(0.0, duration, SAMPLES))[1]).max()
    jump = v[2] - v[1]
    return float(jump) if abs(jump) > max(NO_JUMP * largest, abs(v[3] - v[0]) / 2) else 0.0


def is_constrained(manifest: Manifest) -> bool:
    """Return whether loops or driven joints restrict the motion."""
    return bool(manifest.loops or manifest.driven)


def check_course(manifest: Manifest, course: Course, q: Array, qd: Array) -> None:
    """Check that a start is where the motion of driven joints begins. Raises ValueError."""
    names = [manifest.coordinates[i].name for i in manifest.driven]
    if not names:
        return
    given = course.at(0.0)
    if any(x.shape != (len(names),) for x in given):
        raise ValueError(f"the course has shape {given[0].shape}; {len(names)} driven joints expected")
    pairs = (("q", q[place_driven(manifest)], given[0]), ("qd", qd[list(manifest.driven)], given[1]))
    for kind, found, wanted in pairs:
        for name, a, b in zip(names, found, wanted, strict=True):
            if abs(a - b) > START * (1 + abs(b)):
                raise ValueError(f"{kind} of driven joint {name} starts at {a:.9g}, its course at {b:.9g}")


def place_driven(manifest: Manifest) -> list[int]:
    """List the entries of q that are coordinates of driven joints."""
    return [manifest.positions.index(manifest.coordinates[i].name) for i in manifest.driven]
