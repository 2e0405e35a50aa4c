"""Motions under random inputs on the grid of a problem: collocation and Runge-Kutta steps in plain NumPy.

Polynomials are products of their roots, equations are solved by iteration, accelerations are the kernel's that
`mechanisms` examines. No line is shared with `mbsrun.ocp`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.polynomial import Polynomial, legendre
from numpy.typing import NDArray

Array = NDArray[np.float64]
Parts = tuple[Array, ...]  # coordinates, velocities, further states: (places, ...) each

ITERATIONS = 60
NEWTON = 15  # iterations of Newton's method
SOLVED = 1e-13  # relative: the change of the last iteration
LARGE = 1e3  # of states: a motion that goes further is not followed


class NoMotionError(Exception):
    """The iteration does not converge."""


def find_points(family: str, degree: int) -> Array:
    """Return the collocation points in [0, 1]: roots of Legendre polynomials, or of a difference of two."""
    if family == "legendre":
        roots = legendre.legroots(np.eye(degree + 1)[degree])
    else:
        roots = legendre.legroots(np.eye(degree + 1)[degree] - np.eye(degree + 1)[degree - 1])
    return np.asarray((np.sort(roots.real) + 1) / 2)


def make_basis(nodes: Array) -> list[Polynomial]:
    """Return the Lagrange polynomials of some nodes."""
    found = []
    for i, node in enumerate(nodes):
        others = np.delete(nodes, i)
        product = Polynomial.fromroots(others) if others.size else Polynomial([1.0])
        found.append(product / product(node))
    return found


def read(nodes: Array, values: Array, c: float) -> Array:
    """Evaluate at c the polynomial through values (nodes, ...)."""
    weights = np.array([basis(c) for basis in make_basis(nodes)])
    return np.asarray(np.tensordot(weights, values, 1))


def find_weights(nodes: Array) -> Array:
    """Return the weights of the quadrature over [0, 1]."""
    return np.array([basis.integ()(1.0) for basis in make_basis(nodes)])


@dataclass(frozen=True)
class Rates:
    """The derivatives of states at some places: of coordinates, velocities and further states."""

    parts: Parts


Law = Callable[[Array, Parts], Rates]  # times within an interval over its length, states -> rates


@dataclass(frozen=True)
class Step:
    """One step: states at its start and at stages, derivatives at the stages, and the ways to read it."""

    h: float
    nodes: Array
    start: Parts
    stages: Parts
    rates: Rates
    is_second_order: bool = False

    def state(self, c: float) -> Parts:
        """Read the states at c in [0, 1]."""
        every = np.concatenate(([0.0], self.nodes))
        found = [read(every, np.concatenate((a[None], b)), c) for a, b in zip(self.start, self.stages, strict=True)]
        if self.is_second_order:
            speeds = np.concatenate((self.start[1][None], self.stages[1]))
            weights = np.array([basis.integ()(c) for basis in make_basis(every)])
            found[0] = self.start[0] + self.h * np.tensordot(weights, speeds, 1)
        return tuple(found)

    def acceleration(self, c: float) -> Array:
        """Read the accelerations at c in [0, 1]."""
        return read(self.nodes, self.rates.parts[1], c)


@dataclass(frozen=True)
class ClassicalStep(Step):
    """A step of Runge and Kutta's method of order 4, with its continuous extension of order 3."""

    def state(self, c: float) -> Parts:
        """Read the states at c in [0, 1]: Hairer, Norsett, Wanner, section II.6."""
        first, middle, last = c - 1.5 * c**2 + 2 / 3 * c**3, c**2 - 2 / 3 * c**3, -0.5 * c**2 + 2 / 3 * c**3
        weights = self.h * np.array([first, middle, middle, last])
        return tuple(x + np.tensordot(weights, k, 1) for x, k in zip(self.start, self.rates.parts, strict=True))

    def acceleration(self, c: float) -> Array:  # noqa: ARG002  # such steps need accelerations of states
        """Return no numbers: only the equations of motion give accelerations."""
        return np.full_like(self.start[1], np.nan)


def collocate(law: Law, start: Parts, h: float, nodes: Array, *, is_second_order: bool) -> Step:
    """Solve the equations of a collocation. Raises NoMotionError."""
    every = np.concatenate(([0.0], nodes))
    A = np.array([[basis.integ()(c) for basis in make_basis(nodes)] for c in nodes])
    B = np.array([[basis.integ()(c) for basis in make_basis(every)] for c in nodes])
    sizes = np.cumsum([part.size * len(nodes) for part in start])

    def split(flat: Array) -> Parts:
        parts = np.split(flat, sizes[:-1])
        return tuple(part.reshape(len(nodes), -1) for part in parts)

    def integrate(flat: Array) -> Array:
        rates = law(nodes, split(flat))
        found = [x + h * np.tensordot(A, k, 1) for x, k in zip(start, rates.parts, strict=True)]
        if is_second_order:
            found[0] = start[0] + h * np.tensordot(B, np.concatenate((start[1][None], found[1])), 1)
        return np.concatenate([part.ravel() for part in found])

    stages = split(find_fixed_point(integrate, np.concatenate([np.tile(part, len(nodes)) for part in start])))
    return Step(h, nodes, start, stages, law(nodes, stages), is_second_order)


def find_fixed_point(function: Callable[[Array], Array], x: Array) -> Array:
    """Solve x = function(x): by iteration, then by Newton's method with differences. Raises NoMotionError."""
    place = x
    for _ in range(ITERATIONS):
        found = function(place)
        if not np.isfinite(found).all() or abs(found).max(initial=0) > LARGE:
            break
        change, place = float(abs(found - place).max(initial=0)), found
        if change <= SOLVED * (1 + abs(found).max(initial=0)):
            return found
    place = x
    for _ in range(NEWTON):
        off, step = function(place) - place, 1e-7
        if not np.isfinite(off).all() or abs(place).max(initial=0) > LARGE:
            break
        if abs(off).max(initial=0) <= SOLVED * (1 + abs(place).max(initial=0)):
            return function(place)
        columns = [(function(place + step * unit) - place - off) / step for unit in np.eye(x.size)]
        place = place - np.linalg.solve(np.array(columns).T - np.eye(x.size), off)
    raise NoMotionError("the collocation does not converge")


def step_classically(law: Law, start: Parts, h: float) -> Step:
    """Take a step of Runge and Kutta's method of order 4. Raises NoMotionError where it goes too far."""
    nodes, states = np.array([0.0, 0.5, 0.5, 1.0]), []
    slopes: list[Parts] = []
    for c, before in ((0.0, 0.0), (0.5, 0.5), (0.5, 0.5), (1.0, 1.0)):
        state = tuple(x + before * h * k for x, k in zip(start, slopes[-1], strict=True)) if slopes else start
        _limit(state)
        states.append(state)
        found = law(np.array([c]), tuple(x[None] for x in state)).parts
        slopes.append(tuple(k[0] for k in found))
    stages = tuple(np.array(part) for part in zip(*states, strict=True))
    rates = Rates(tuple(np.array(part) for part in zip(*slopes, strict=True)))
    step = ClassicalStep(h, nodes, start, stages, rates)
    _limit(step.state(1.0))
    return step


def _limit(state: Parts) -> None:
    """Raise NoMotionError for states that are too large: rounding errors would grow as they do."""
    if not all((abs(part) <= LARGE).all() for part in state):
        raise NoMotionError("the steps of Runge and Kutta's method go too far")


@dataclass(frozen=True)
class Interval:
    """Steps of equal length."""

    steps: tuple[Step, ...]

    def find(self, c: float) -> tuple[Step, float]:
        """Find the step at c in [0, 1], and the place in it; where two meet, the first."""
        count = len(self.steps)
        k = int(np.clip(np.ceil(c * count - 1e-12) - 1, 0, count - 1))
        return self.steps[k], c * count - k

    def state(self, c: float) -> Parts:
        """Read the states."""
        step, local = self.find(c)
        return step.state(local)

    def acceleration(self, c: float) -> Array:
        """Read the accelerations."""
        step, local = self.find(c)
        return step.acceleration(local)


@dataclass
class Motion:
    """A motion on a grid of N intervals with d points each, by the names of a problem."""

    T: float
    t: Array  # (N + 1,)
    point_t: Array  # (N, d)
    nodes: Array  # (d,)
    q: Array  # (N + 1, nq)
    qd: Array  # (N + 1, n)
    point_q: Array  # (N, d, nq)
    point_qd: Array  # (N, d, n)
    point_qdd: Array  # (N, d, n)
    end_qdd: Array  # (2, carried): at the start of the first interval and the end of the last one, as it is read off
    u: Array  # (N, d, m)
    w: Array  # (N, d, nw)
    tau: Array  # (N, d, ...): forces of driven joints
    unknowns: Mapping[str, float]
    states: dict[str, Array] = field(default_factory=dict)  # (N + 1,) each
    point_states: dict[str, Array] = field(default_factory=dict)  # (N, d) each
    controls: dict[str, Array] = field(default_factory=dict)  # (N, d) each

    @property
    def intervals(self) -> int:
        """Count the intervals."""
        return len(self.t) - 1

    def at_end(self, points: Array, which: int) -> Array:
        """Read a quantity of points (N, d, ...) at the start (0) or the end (1) of the motion."""
        return read(self.nodes, points[-1 if which else 0], float(which))


def chain(
    law: Callable[[int], Law],
    start: Parts,
    lengths: Sequence[float],
    nodes: Array,
    method: str,
    steps: int,
) -> list[Interval]:
    """Follow the states over all intervals; `law` gives the law of each."""
    found = []
    for k, h in enumerate(lengths):
        own, taken = law(k), []
        for i in range(steps):

            def shifted(c: Array, states: Parts, i: int = i, own: Law = own) -> Rates:
                return own((c + i) / steps, states)

            if method == "rk4":
                taken.append(step_classically(shifted, start, h / steps))
            else:
                second = method == "second-order"
                taken.append(collocate(shifted, start, h / steps, nodes, is_second_order=second))
            start = taken[-1].state(1.0)
        found.append(Interval(tuple(taken)))
    return found
