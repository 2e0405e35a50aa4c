"""A line around a cylinder or a sphere: two points -> whether it wraps, its length, and how both points change it.

With a and b from the centre to the points, n along the axis of the cylinder (of a sphere: along a x b), and s = 1 for a
turn about n, else -1, the line leaves the surface of radius r at r e, in planes across n, where it is tangent:

    e_a = (r a + s t_a n x a)/|a|^2,  e_b = (r b - s t_b n x b)/|b|^2,  t^2 = |a|^2 - r^2    (a, b across n)
    length^2 = (t_a + r angle(e_a, e_b) + t_b)^2 + (n.(b - a))^2

since a cylinder unrolls to a plane, on which the shortest line is straight. Its slopes are the directions of its ends.

Which lines wrap is decided as OpenSim's WrapCylinder and WrapSphere do (Apache License 2.0): a line that cuts the
surface between its points must; with a side, a line may that is on the other side. Points inside the surface, and
tangents beyond both ends of a cylinder, prevent it. With a side the angle is between 0 and a whole turn.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from sympy import Abs, Expr, Rational, atan2, cos, pi, sign, sin, sqrt

from mbsgen.model.tree import ONE, ZERO, Vector
from mbsgen.model.triples import add, cross, dot, scale, subtract

Define = Callable[[str, Expr], Expr]  # a number by a key
_TINY = Rational(1, 10**24)  # keeps roots and quotients finite where no line wraps
_BACK = Rational(1, 10**6)  # rad: an angle that is less by rounding is no whole turn


@dataclass(frozen=True)
class Round:
    """A surface in the base frame."""

    radius: Expr
    axis: Vector | None  # of a cylinder, of length 1; None: a sphere
    half: Expr | None = None  # of its length; None: no ends
    side: Vector | None = None  # a direction of length 1 into the half on which the line stays; None: the nearer way


@dataclass(frozen=True)
class Turn:
    """The line around a surface between two points."""

    must: Expr  # 1 where it wraps, else 0
    may: Expr  # 1 where it wraps if no other part of the line does
    length: Expr
    slopes: tuple[Vector, Vector]  # derivatives of the length by both points


def holds(x: Expr) -> Expr:
    """Return 1 where x >= 0, else 0."""
    return (1 + sign(2 * sign(x) + 1)) / 2


def make_turn(surface: Round, a: Vector, b: Vector, define: Define) -> Turn:
    """Describe the line from a to b, which are seen from the centre of the surface."""
    return _Turn(surface, a, b, define).make()


class _Turn:
    """The parts of a turn."""

    def __init__(self, surface: Round, a: Vector, b: Vector, define: Define) -> None:
        self._surface, self._whole, self._define = surface, (a, b), define
        r = surface.radius
        if surface.axis is None:
            w = self._vector("w", cross(a, b))
            self._n = self._vector("n", scale(1 / sqrt(dot(w, w) + _TINY * r**4), w))
            self._heights: tuple[Expr, Expr] = (ZERO, ZERO)
            self._points = (a, b)
        else:
            self._n = n = surface.axis
            za, zb = define("za", dot(n, a)), define("zb", dot(n, b))
            self._heights = (za, zb)
            self._points = (
                self._vector("a", subtract(a, scale(za, n))),
                self._vector("b", subtract(b, scale(zb, n))),
            )
        powers = [define(f"power_{k}", dot(x, x) - r**2) for k, x in zip("ab", self._points, strict=True)]
        outside = [define(f"outside_{k}", holds(x)) for k, x in zip("ab", powers, strict=True)]
        self._out = define("out", outside[0] * outside[1])
        # 0 inside: a sum would lose what keeps the root above 0, and its slope would be infinite
        beyond = [define(f"beyond_{k}", w * x) for k, w, x in zip("ab", outside, powers, strict=True)]
        self._squares = [define(f"far_{k}", r**2 + x) for k, x in zip("ab", beyond, strict=True)]
        self._tangents = [define(f"t{k}", sqrt(x + _TINY * r**2)) for k, x in zip("ab", beyond, strict=True)]
        self._around = [self._vector(f"n{k}", cross(self._n, x)) for k, x in zip("ab", self._points, strict=True)]

    def make(self) -> Turn:
        """Describe the line."""
        r, define = self._surface.radius, self._define
        must, may = self._decide()
        way = self._choose()
        ea, eb = (self._vector(f"e{k}", x) for k, x in zip("ab", self._leave(way), strict=True))
        sine, cosine = define("sine", way * dot(self._n, cross(ea, eb))), define("cosine", dot(ea, eb))
        if self._surface.side is None:
            angle = atan2(sine, cosine)
        else:
            s, c = sin(_BACK), cos(_BACK)
            angle = pi - _BACK + atan2(-(sine * c + cosine * s), -(cosine * c - sine * s))
        (ta, tb), (za, zb) = self._tangents, self._heights
        flat = define("flat", ta + r * define("angle", angle) + tb)
        directions = [scale(way, cross(self._n, e)) for e in (ea, eb)]
        rise = zb - za
        length = flat
        if self._surface.axis is not None:
            length = define("line", sqrt(flat**2 + rise**2))
            along = scale(define("climb", rise / length), self._n)
            share = define("share", flat / length)
            directions = [add(scale(share, x), along) for x in directions]
        slopes = scale(-1, directions[0]), directions[1]
        first, second = (self._vector(f"g{k}", x) for k, x in zip("ab", slopes, strict=True))
        if self._surface.half is not None:
            half = self._surface.half
            ends = [holds(half - Abs(za + rise * ta / flat)), holds(half - Abs(zb - rise * tb / flat))]
            inside = define("inside", 1 - (1 - ends[0]) * (1 - ends[1]))
            must, may = must * inside, may * inside
        return Turn(define("must", must), ZERO if may == ZERO else define("may", may), length, (first, second))

    def _decide(self) -> tuple[Expr, Expr]:
        """Return whether the line must wrap, and whether it may, apart from ends."""
        (a, b), r, side = self._points, self._surface.radius, self._surface.side
        d = self._vector("d", subtract(b, a))
        square = self._define("square_d", dot(d, d) + _TINY * r**2)
        w = cross(a, d)
        near = holds(r**2 * square - dot(w, w)) * holds(-dot(a, d)) * holds(dot(b, d))
        cuts = self._define("cuts", near * self._out)
        if side is None:
            return cuts, ZERO
        there = [self._define(f"there_{k}", holds(dot(side, x))) for k, x in zip("ab", self._whole, strict=True)]
        either = there[0] + there[1] - there[0] * there[1]
        if self._surface.axis is None:
            return either * cuts, (1 - either) * cuts
        way = subtract(*self._whole[::-1])
        at = add(self._whole[0], scale(-dot(a, d) / square, way))
        beyond = (there[0] + there[1] - 2 * there[0] * there[1]) * (1 - holds(dot(side, at)))
        return either * cuts, self._out * (1 - either + either * (1 - cuts) * beyond)

    def _leave(self, way: Expr | int) -> tuple[Vector, Vector]:
        """Return the directions from the axis to the points where the line leaves the surface."""
        found = []
        for x, around, t, square, turn in zip(
            self._points, self._around, self._tangents, self._squares, (way, -way), strict=True
        ):
            found.append(scale(1 / square, add(scale(self._surface.radius, x), scale(turn * t, around))))
        return found[0], found[1]

    def _choose(self) -> Expr:
        """Return 1 for a turn about n, else -1."""
        side, r = self._surface.side, self._surface.radius
        if side is None:
            return ONE if self._surface.axis is None else self._define("way", sign(dot(self._n, cross(*self._points))))
        left, right = (
            [self._vector(f"{name}_{k}", x) for k, x in zip("ab", self._leave(way), strict=True)]
            for name, way in (("left", 1), ("right", -1))
        )
        if self._surface.axis is None:
            moved = [subtract(scale(r, e), x) for e, x in zip(right, self._points, strict=True)]
            long = holds(dot(side, add(*moved)))
            both = holds(dot(side, self._points[0])) * holds(dot(side, self._points[1]))
            return self._define("way", 1 - 2 * long * (1 - both))
        one, two = (self._define(f"stays_left_{k}", holds(dot(side, x))) for k, x in zip("ab", left, strict=True))
        other, back = (self._define(f"stays_right_{k}", holds(dot(side, x))) for k, x in zip("ab", right, strict=True))
        tie = holds(dot(*left) - dot(*right))
        last = back + (1 - back) * (1 - two) * tie
        clockwise = one * other * back + (1 - one) * (other + (1 - other) * last)
        return self._define("way", 1 - 2 * clockwise)

    def _vector(self, key: str, vector: Vector) -> Vector:
        x, y, z = (self._define(f"{key}.{axis}", value) for axis, value in zip("xyz", vector, strict=True))
        return x, y, z
