"""Runge-Kutta methods over an interval, for equations of second order: a motion as matrices on accelerations.

With z the accelerations at the stages, states are linear in z wherever they are read, c being the time over the
length h of the interval:

    qd = qd_0 + h V z,    q = q_0 + h c qd_0 + h^2 P z,    qdd = W z

At the stages V is the method's matrix A, P is A A: positions are integrated as if they were unrelated to velocities,
so q' = qd holds at the points alone. The second-order method of a scheme has q' = qd at all times: V z is a polynomial
of degree d, and P z is its integral, of degree d + 1 (Moreno-Martin, Ros, Celaya, "Collocation methods for second and
higher order systems", arXiv 2302.09056; as an integrator, Runge-Kutta-Nystrom collocation: Hairer, Norsett, Wanner,
section II.14). In between a collocation is read off its polynomials, the classical
method of order 4 by its continuous extension of order 3: Hairer, Norsett, Wanner, "Solving ordinary differential
equations I", section II.6. Several steps in an interval are one method with more stages.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from mbsrun.ocp.ground.schemes import Scheme, integrate_basis, read_basis

Array = NDArray[np.float64]
IntegratorName = str  # a key of INTEGRATORS
SECOND_ORDER = "second-order"


@dataclass(frozen=True)
class Reading:
    """How a motion is read at k places of an interval, from the accelerations at S stages."""

    c: Array  # (k,): time, over the interval's length
    V: Array  # (k, S)
    P: Array  # (k, S)
    W: Array  # (k, S)

    @property
    def are_stages(self) -> bool:
        """Return whether the places are the stages themselves."""
        return np.array_equal(self.W, np.eye(len(self.W)))


@dataclass(frozen=True)
class Integrator:
    """A method over an interval, and where its motion is read."""

    stages: Reading
    points: Reading  # the points of a scheme
    ends: Reading  # the interval's start and end

    @property
    def is_explicit(self) -> bool:
        """Return whether each stage follows from those before it."""
        return not np.triu(self.stages.V).any()

    @property
    def closed(self) -> Reading:
        """Return the places where loops are closed: stages, points that are no stages, and the interval's end."""
        parts = [self.stages] if self.points.are_stages else [self.stages, self.points]
        last = _pick(self.ends, 1)
        return _join(parts if self.points.c[-1] == 1.0 else [*parts, last])

    @property
    def first_point(self) -> int:
        """Return the number of the first point among `closed`."""
        return 0 if self.points.are_stages else len(self.stages.c)


def build(name: IntegratorName, scheme: Scheme, steps: int) -> Integrator:
    """Return a method that takes `steps` of equal length over an interval, and is read at the points of a scheme."""
    step = INTEGRATORS[name].make(scheme)
    whole = _Composition(step, steps)
    stages = [whole.stage(i, j) for i in range(steps) for j in range(len(step.c))]
    return Integrator(
        stages=_stack(stages),
        points=_stack([whole.read(c) for c in scheme.points]),
        ends=_stack([whole.read(0.0), whole.read(1.0)]),
    )


class Step(Protocol):
    """One step of length 1: its stages, and its motion in between."""

    @property
    def c(self) -> Array:
        """Times of the stages, (s,)."""

    @property
    def A(self) -> Array:
        """The method's matrix, (s, s)."""

    def read(self, c: float) -> tuple[Array, Array]:
        """Return the rows of V and W at any c in [0, 1]; V at 1 holds the weights."""

    def integrate(self, c: float, v: Array) -> Array:
        """Return the row of P where the row of V is v; a method for systems of first order returns v A."""


class _Collocation:
    def __init__(self, scheme: Scheme) -> None:
        self.c, self.A, self.begins_interval = scheme.points, scheme.integration, scheme.begins_interval

    def read(self, c: float) -> tuple[Array, Array]:
        if self.begins_interval:
            return integrate_basis(self.c, np.array([c]))[0], read_basis(self.c, c)
        with_start = read_basis(np.concatenate(([0.0], self.c)), c)
        return with_start[1:] @ self.A, read_basis(self.c, c)

    def integrate(self, c: float, v: Array) -> Array:  # noqa: ARG002  # of a step: c
        return np.asarray(v @ self.A)


class _SecondOrder(_Collocation):
    """The same points, with coordinates that are the integral of the velocities' polynomial."""

    def integrate(self, c: float, v: Array) -> Array:  # noqa: ARG002  # of a step: v
        return np.asarray(integrate_basis(self.c, np.array([c]), moment=1)[0])


class _Classical:
    """Runge and Kutta's method of order 4."""

    c = np.array([0.0, 0.5, 0.5, 1.0])
    A = np.array([[0.0, 0, 0, 0], [0.5, 0, 0, 0], [0, 0.5, 0, 0], [0, 0, 1, 0]])

    def read(self, c: float) -> tuple[Array, Array]:
        first, last = np.polynomial.Polynomial([0, 1, -3 / 2, 2 / 3]), np.polynomial.Polynomial([0, 0, -1 / 2, 2 / 3])
        middle = np.polynomial.Polynomial([0, 0, 1, -2 / 3])
        weights = (first, middle, middle, last)
        return np.array([b(c) for b in weights]), np.array([b.deriv()(c) for b in weights])

    def integrate(self, c: float, v: Array) -> Array:  # noqa: ARG002  # of a step: c
        return np.asarray(v @ self.A)


class _Composition:
    """Equal steps one after the other, over an interval of length 1."""

    def __init__(self, step: Step, steps: int) -> None:
        self.step, self.steps, self.size = step, steps, len(step.c)

    def stage(self, i: int, j: int) -> tuple[float, Array, Array, Array]:
        """Read stage j of step i."""
        return self._place(i, float(self.step.c[j]), self.step.A[j], np.eye(self.size)[j])

    def read(self, c: float) -> tuple[float, Array, Array, Array]:
        """Read the motion at c; where two steps meet, off the one before."""
        i = int(np.clip(np.ceil(c * self.steps - 1e-12) - 1, 0, self.steps - 1))
        local = c * self.steps - i
        return self._place(i, local, *self.step.read(local))

    def _place(self, i: int, local: float, v: Array, w: Array) -> tuple[float, Array, Array, Array]:
        """Return c and rows of V, P and W at a place of step i, where the step's own rows are v and w."""
        length = 1 / self.steps
        b, _ = self.step.read(1.0)
        whole, part = self.step.integrate(1.0, b), self.step.integrate(local, v)
        V, P, W = np.zeros((3, self.steps, self.size))
        for k in range(i):  # the contributions of earlier steps to the start of step i
            P += length * V
            P[k] += length**2 * whole
            V[k] += length * b
        P += length * local * V
        P[i] += length**2 * part
        V[i] += length * v
        W[i] = w
        return (i + local) * length, V.ravel(), P.ravel(), W.ravel()


def _pick(reading: Reading, place: int) -> Reading:
    """Keep one place."""
    one = slice(place, place + 1)
    return Reading(reading.c[one], reading.V[one], reading.P[one], reading.W[one])


def _join(parts: Sequence[Reading]) -> Reading:
    """Put places one after the other."""
    return Reading(*(np.concatenate(every) for every in zip(*((x.c, x.V, x.P, x.W) for x in parts), strict=True)))


def _stack(places: Sequence[tuple[float, Array, Array, Array]]) -> Reading:
    c, V, P, W = zip(*places, strict=True)
    return Reading(np.array(c), np.stack(V), np.stack(P), np.stack(W))


@dataclass(frozen=True)
class Kind:
    """A kind of integrator: how a step is made, for a problem's scheme."""

    title: str
    make: Callable[[Scheme], Step]
    is_explicit: bool  # its stages need accelerations, which a residual does not return
    is_collocation: bool = False  # it has the points of the scheme, so other forms than shooting can take it


# To add one, write a class of one step, and an entry here.
INTEGRATORS: Mapping[str, Kind] = {
    "collocation": Kind("the method of the problem's scheme", _Collocation, is_explicit=False, is_collocation=True),
    SECOND_ORDER: Kind(
        "the same points, and coordinates that are the integrals of the velocities",
        _SecondOrder,
        is_explicit=False,
        is_collocation=True,
    ),
    "rk4": Kind("the classical Runge-Kutta method of order 4", lambda _: _Classical(), is_explicit=True),
}
