"""Coordinates as a Lie group: numbers add, turns are composed.

A velocity v, held for a time h, moves q to q tau(x), x = h v, which is q + x for numbers. A ball turns by w; a free
body turns by w, and shifts by d along the mean of both attitudes, so that tau(-x) is the inverse of tau(x):

    SO(3): the quaternion q becomes q * exp(w / 2)
    SO(3) and shift: the place moves by R (1 + exp(w~)) d / 2 = R (d + (2 c x d + c x (c x d)) / (4 + c.c)) as well

with c = k w, k = 2 tan(|w| / 2) / |w|. The left trivialised derivatives are d(q tau(x)) = q tau(x) A(-x)^-1 dx; at the
other end A(x)^-1, with

    A(x) (a, b) = ((1 - c~/2) (a - d~ b / 2), (1 - w~/2 + s w~ w~) b),    s = (1 - 1/k) / w.w

Iserles, Munthe-Kaas, Norsett, Zanna, Acta Numerica 9 (2000), section B.2, for the turns; the first row follows from the
place. Joints of one coordinate have A = 1. The velocity of a free body is (a, b) along its own axes: the shift first.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mbsrun.kernel import Kernels
from mbsrun.quaternions import Quaternion, list_quaternions, multiply, rotate

Array = NDArray[np.float64]


STRAIGHT = 1e-6  # of a square of an angle: below it functions of the angle are at their limits


def cross(w: Array) -> Array:
    """Return the matrix w~ of the product w x."""
    return np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])


@dataclass(frozen=True, eq=False)
class Turn:
    """A turn by w (3,), with the factors above."""

    w: Array

    @cached_property
    def square(self) -> float:
        """Return the square of the angle."""
        return float(self.w @ self.w)

    @cached_property
    def k(self) -> float:
        """Return 2 tan(|w| / 2) / |w|."""
        if self.square < STRAIGHT**2:
            return 1.0
        angle = np.sqrt(self.square)
        return float(2 * np.tan(angle / 2) / angle)

    @cached_property
    def s(self) -> float:
        """Return (1 - 1/k) / w.w; the error of the limit is STRAIGHT / 720."""
        return 1 / 12 if self.square < STRAIGHT else (1 - 1 / self.k) / self.square

    @cached_property
    def c(self) -> Array:
        """Return k w."""
        return self.k * self.w

    @cached_property
    def c_by_w(self) -> Array:
        """Differentiate c by w."""
        slope = 1 / 6 if self.square < STRAIGHT else (1 + self.square * self.k**2 / 4 - self.k) / self.square
        return self.k * np.eye(3) + slope * np.outer(self.w, self.w)

    @cached_property
    def quaternion(self) -> Array:
        """Return the quaternion of the turn, (4,), of length 1."""
        half = np.sqrt(self.square) / 2
        return np.append(np.sinc(half / np.pi) / 2 * self.w, np.cos(half))

    @cached_property
    def A(self) -> Array:
        """Return 1 - w~/2 + s w~ w~."""
        W = cross(self.w)
        return np.eye(3) - W / 2 + self.s * W @ W

    def vary(self, p: Array) -> Array:
        """Differentiate A^T p by w."""
        w, square, along = self.w, self.square, self.w @ p
        slope = 1 / 360
        if square >= STRAIGHT:
            slope = ((1 + square * self.k**2 / 4 - self.k) / (square * self.k**2) - 2 * self.s) / square
        doubled = along * np.eye(3) + np.outer(w, p) - 2 * np.outer(p, w)  # of w x (w x p), by w
        return -cross(p) / 2 + self.s * doubled + slope * np.outer(along * w - square * p, w)


@dataclass(frozen=True)
class Attitude:
    """A joint with a quaternion: a ball, or a free body, whose shift stands before its turn."""

    quaternion: Quaternion
    is_free: bool

    @property
    def velocities(self) -> slice:
        """Return its entries of qd."""
        return slice(self.quaternion.spin - 3 * self.is_free, self.quaternion.spin + 3)

    def move(self, q: Array, x: Array) -> None:
        """Move its entries of q (nq,) by x (n,), in place."""
        first, own = self.quaternion.first, x[self.velocities]
        d, turn, start = own[:-3], Turn(own[-3:]), q[first : first + 4].copy()
        if self.is_free:
            c = turn.c
            q[first - 3 : first] += rotate(start, d + (2 * np.cross(c, d) + np.cross(c, np.cross(c, d))) / (4 + c @ c))
        found = multiply(start, turn.quaternion)
        q[first : first + 4] = found / np.sqrt(found @ found)

    def trivialise(self, x: Array) -> Array:
        """Return A(x), (3, 3) or (6, 6)."""
        own = x[self.velocities]
        d, turn = own[:-3], Turn(own[-3:])
        if not self.is_free:
            return turn.A
        half = np.eye(3) - cross(turn.c) / 2
        return np.block([[half, -half @ cross(d) / 2], [np.zeros((3, 3)), turn.A]])

    def vary(self, x: Array, p: Array) -> Array:
        """Differentiate A(x)^T p by x."""
        own, momentum = x[self.velocities], p[self.velocities]
        d, turn, f, k = own[:-3], Turn(own[-3:]), momentum[:-3], momentum[-3:]
        if not self.is_free:
            return turn.vary(k)
        by_w = -cross(f) / 2 @ turn.c_by_w
        seen = f + np.cross(turn.c, f) / 2
        return np.block([[np.zeros((3, 3)), by_w], [-cross(seen) / 2, turn.vary(k) + cross(d) @ by_w / 2]])

    def gyrate(self, v: Array, p: Array) -> Array:
        """Return w x p for a moment, and likewise with a shift: see `Group.gyrate`."""
        own, momentum = v[self.velocities], p[self.velocities]
        d, w, f, k = own[:-3], own[-3:], momentum[:-3], momentum[-3:]
        turned = np.cross(w, k)
        return np.concatenate((np.cross(w, f), turned + np.cross(d, f))) if self.is_free else turned


@dataclass(frozen=True, eq=False)
class Group:
    """The coordinates of a model."""

    attitudes: tuple[Attitude, ...]
    size: int  # of qd
    scalars: tuple[NDArray[np.intp], NDArray[np.intp]]  # the joints of one coordinate: entries of q, of qd

    @cached_property
    def is_flat(self) -> bool:
        """Return whether all coordinates add."""
        return not self.attitudes

    def move(self, q: Array, x: Array) -> Array:
        """Return q tau(x), (nq,)."""
        if self.is_flat:
            return q + x
        moved, (places, rates) = q.copy(), self.scalars
        moved[places] += x[rates]
        for attitude in self.attitudes:
            attitude.move(moved, x)
        return moved

    def trivialise(self, x: Array) -> Array:
        """Return A(x), (n, n)."""
        A = np.eye(self.size)
        for attitude in self.attitudes:
            A[attitude.velocities, attitude.velocities] = attitude.trivialise(x)
        return A

    def carry(self, x: Array) -> Array:
        """Return A(-x)^-1, (n, n): the way of q tau(x) along the group, by x."""
        return np.asarray(np.linalg.inv(self.trivialise(-x)))

    def vary(self, x: Array, p: Array) -> Array:
        """Differentiate A(x)^T p by x, (n, n)."""
        found = np.zeros((self.size, self.size))
        for attitude in self.attitudes:
            found[attitude.velocities, attitude.velocities] = attitude.vary(x, p)
        return found

    def gyrate(self, v: Array, p: Array) -> Array:
        """Return the terms (n,) that moving axes add to the rates of momenta p in the equations of motion."""
        found = np.zeros(self.size)
        for attitude in self.attitudes:
            found[attitude.velocities] = attitude.gyrate(v, p)
        return found


def find_group(kernels: Kernels) -> Group:
    """Return the group of a model's coordinates."""
    manifest = kernels.manifest
    attitudes = tuple(Attitude(x, _is_free(kernels, x)) for x in list_quaternions(manifest))
    taken_q = {i for x in attitudes for i in range(x.quaternion.first - 3 * x.is_free, x.quaternion.first + 4)}
    taken_v = {i for x in attitudes for i in range(*x.velocities.indices(len(manifest.coordinates)))}
    places = [i for i in range(len(manifest.positions)) if i not in taken_q]
    rates = [i for i in range(len(manifest.coordinates)) if i not in taken_v]
    scalars = np.array(places, dtype=np.intp), np.array(rates, dtype=np.intp)
    return Group(attitudes, len(manifest.coordinates), scalars)


def _is_free(kernels: Kernels, quaternion: Quaternion) -> bool:
    """Return whether a quaternion's joint shifts too: the rates of the three coordinates before it depend on it."""
    first, manifest = quaternion.first, kernels.manifest
    if first < 3:
        return False
    q, qd = np.ones(len(manifest.positions)), np.arange(1.0, len(manifest.coordinates) + 1)
    q[first : first + 4] = 0.1, 0.3, -0.5, 0.8  # a turn about no axis of symmetry
    return bool(kernels("jac_rates", q=q, qd=qd)["jac_rate_q"][first - 3 : first, first : first + 4].any())
