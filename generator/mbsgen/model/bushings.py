"""Two frames seen from each other: their places, axes and velocities -> shifts, turns, rates, and moments about turns.

The second frame is turned by R = Rx(a) Ry(b) Rz(c) in the first one, about x, y and z in turn, and shifted by d. With
the axes of the turns, e1 = x of the first frame, e3 = z of the second, and e2 across both, and s = e1.e3 = sin b, the
relative angular velocity w gives the rates

    b' = w.e2,    a' = (w.e1 - s w.e3)/(1 - s^2),    c' = (w.e3 - s w.e1)/(1 - s^2)

and a moment M with the powers f1 a' + f2 b' + f3 c' = M.w is f2 e2 + u e1 + v e3, where u and v follow from f1 and f3
as a' and c' from w.e1 and w.e3. The shift along an axis of the first frame changes with the velocity of the second one
that an observer on the first one sees.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from sympy import Expr, Integer, atan2, sqrt

from mbsgen.model.tree import Vector
from mbsgen.model.triples import add, cross, dot, scale, subtract

TURNS = ("turn_x", "turn_y", "turn_z")
SHIFTS = ("shift_x", "shift_y", "shift_z")
NAMES = tuple(f"{name}{end}" for name in (*SHIFTS, *TURNS) for end in ("", "_rate"))
Define = Callable[[str, Expr], Expr]  # a number by a key


@dataclass(frozen=True)
class Seen:
    """A frame in the base frame."""

    place: Vector
    velocity: Vector
    spin: Vector
    axes: tuple[Vector, Vector, Vector]


class Between:
    """The numbers of a second frame as seen from a first one; each is defined once, where it is read."""

    def __init__(self, first: Seen, second: Seen, define: Define, guard: Define) -> None:
        """Take two frames; `guard` defines a square that must not vanish."""
        self._first, self._second, self._define, self._guard = first, second, define, guard
        self.arm: Vector = subtract(second.place, first.place)

    def list_shifts(self) -> dict[str, Expr]:
        """Return the shifts along the axes of the first frame [m], and their rates [m/s]."""
        first, second = self._first, self._second
        moved = subtract(subtract(second.velocity, first.velocity), cross(first.spin, self.arm))
        found = dict[str, Expr]()
        for name, axis in zip(SHIFTS, first.axes, strict=True):
            found[name] = self._define(name, dot(axis, self.arm))
            found[f"{name}_rate"] = self._define(f"{name}_rate", dot(axis, moved))
        return found

    def list_turns(self) -> dict[str, Expr]:
        """Return the turns about x, y and z [rad], and their rates [rad/s]."""
        A, B = self._first.axes, self._second.axes
        sine, square = self._lean()
        cosine = self._define("cosine", sqrt(square))
        turns = (
            atan2(-dot(A[1], B[2]), dot(A[2], B[2])),
            atan2(sine, cosine),
            atan2(-dot(A[0], B[1]), dot(A[0], B[0])),
        )
        w = subtract(self._second.spin, self._first.spin)
        x, z = self._split(dot(w, A[0]), dot(w, B[2]))
        rates = x, dot(w, self._middle()), z
        found = {name: self._define(name, x) for name, x in zip(TURNS, turns, strict=True)}
        return found | {f"{k}_rate": self._define(f"{k}_rate", x) for k, x in zip(TURNS, rates, strict=True)}

    def sum_moment(self, parts: Vector) -> Vector:
        """Return the moment on the second frame whose powers with the rates of the turns are these parts [N m]."""
        u, v = self._split(parts[0], parts[2])
        ends = add(scale(u, self._first.axes[0]), scale(v, self._second.axes[2]))
        return add(ends, scale(parts[1], self._middle()))

    def sum_along(self, parts: Vector) -> Vector:
        """Return a vector by its components along the axes of the first frame."""
        x, y, z = (scale(part, axis) for part, axis in zip(parts, self._first.axes, strict=True))
        return add(add(x, y), z)

    def _lean(self) -> tuple[Expr, Expr]:
        """Define the sine of the middle turn, and the square of its cosine."""
        A, B = self._first.axes, self._second.axes
        sine = self._define("sine", dot(A[0], B[2]))
        return sine, self._guard("square", dot(A[0], B[0]) ** 2 + dot(A[0], B[1]) ** 2)

    def _middle(self) -> Vector:
        """Return the axis of the middle turn."""
        A, B = self._first.axes, self._second.axes
        _, square = self._lean()
        root = self._define("cosine", sqrt(square))
        y, z = dot(A[2], B[2]) / root, -dot(A[1], B[2]) / root
        return add(scale(y, A[1]), scale(z, A[2]))

    def _split(self, one: Expr, other: Expr) -> tuple[Expr, Expr]:
        sine, square = self._lean()
        return (one - sine * other) / square, (other - sine * one) / square


UNIT = Integer(1)  # the scale of the square of a cosine
