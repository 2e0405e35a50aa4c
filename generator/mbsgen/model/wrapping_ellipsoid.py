"""A line around an ellipsoid: two points -> whether it wraps, and its length in a plane through both.

The points p and q are in the axes of the ellipsoid of half axes a_i, whose mean is the unit of length. A line that cuts
it between them wraps in the plane through p, q and a point c of the surface: the tangents from p and q, and the arc
between the points where they touch. In the scaled space x_i/a_i the ellipsoid is the unit sphere and the plane cuts a
circle out of it, so both points follow in closed form; the length of the arc is an integral of Gauss and Legendre.

The point c is chosen as OpenSim's WrapEllipsoid does (Apache License 2.0). With the part from r1 to r2 of the line that
lies inside, and the nearest point N(s) of the surface to s:

    midpoint    c = N((r1 + r2)/2)
    axial       c = N(s) where the line crosses the plane s_k = 0, across the axis k to which it is most parallel; this
                point is searched for in that plane; where s is outside, the line takes the nearer way in its plane
    fan         c = N((r1 + r2)/2 + v), with the mean direction v of N(s) - s along the line, by an integral
    hybrid      c = N(w axial + (1 - w) fan), with w from 0 to 1 while the cosine between line and axis goes from 0.7073
                to 0.9, and less where s is within 0.3 of an end

With a side, a point c on the other half is mirrored into that one. The distance of its mirror from the edge between
both halves is taken times w, with w = 1 for midpoint and axial, and c is the nearest point to that.

The nearest point is N(s)_i = a_i^2 s_i/(t + a_i^2), with the largest root t of sum (a_i s_i/(t + a_i^2))^2 = 1.
Newton's method for the inverse of the root of this sum ascends to it from below. On a plane of symmetry, within 1e-7,
the nearest point is in that plane too, as in OpenSim.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

from sympy import Abs, Expr, Float, Rational, Symbol, atan2, cos, pi, sign, sin, sqrt
from sympy.integrals.quadrature import gauss_legendre

from mbsgen.model.steps import Steps
from mbsgen.model.symbols import total
from mbsgen.model.tree import ONE, ZERO, Vector
from mbsgen.model.triples import add, cross, dot, scale, subtract

METHODS = ("hybrid", "midpoint", "axial")

_TINY = Rational(1, 10**24)  # keeps roots and quotients finite where no line wraps
_NEAR = Rational(1, 10**7)  # of a plane of symmetry
_INSIDE = Rational(1, 10**4)  # of an end, beyond which no line wraps
_LOW, _HIGH, _EDGE = Rational(7073, 10000), Rational(9, 10), Rational(3, 10)
_SAMPLES = 300  # of OpenSim's fan, of which it takes all but the last and both ends
_FAN, _ARC = 8, 10  # points of both integrals
_ITERATIONS = 6  # to rounding but within 1e-3 of where the nearest point jumps
_BACK = Rational(1, 10**6)  # rad: an angle that is less by rounding is no whole turn
_DIGITS = 50
_T = Symbol("t", real=True)


@dataclass(frozen=True)
class Ellipsoid:
    """An ellipsoid along its axes."""

    radii: Vector  # half axes
    method: str = "hybrid"
    side: tuple[int, int] | None = None  # an axis and a sign: the half on which the line stays; None: any


def measure_around(ellipsoid: Ellipsoid, p: Vector, q: Vector, steps: Steps) -> tuple[Expr, Expr]:
    """Return 1 where the line from p to q wraps, else 0, and its length around the ellipsoid."""
    mean = total(ellipsoid.radii) / 3
    unit = steps("unit", 1 / mean)
    radii = steps.define_vector("radius", scale(unit, ellipsoid.radii))
    ends = [steps.define_vector(k, scale(unit, x)) for k, x in (("p", p), ("q", q))]
    path = _Path(ellipsoid, radii, (ends[0], ends[1]), steps)
    return path.cuts, mean * path.measure()


class _Path:
    """The parts of a line around an ellipsoid, whose mean half axis is 1."""

    def __init__(self, ellipsoid: Ellipsoid, radii: Vector, ends: tuple[Vector, Vector], steps: Steps) -> None:
        self._ellipsoid, self._a, self._ends, self._steps = ellipsoid, radii, ends, steps
        self._beyond: Expr = ZERO  # 1 where the line takes the nearer way, not the one over c
        self._largest = steps("largest", _larger(_larger(radii[0], radii[1]), radii[2]))
        (p, q), a = ends, radii
        self._scaled = [steps.define_vector(f"scaled_{k}", _divide(x, a)) for k, x in (("p", p), ("q", q))]
        P, Q = self._scaled
        self._d = steps.define_vector("d", subtract(q, p))
        D = subtract(Q, P)
        A, B = steps("A", dot(D, D) + _TINY), steps("B", dot(D, P))
        C = [steps(f"C_{k}", dot(x, x) - 1) for k, x in (("p", P), ("q", Q))]
        below = steps("below", B**2 - A * C[0])
        met = steps("met", _holds(below))
        root = steps("root", sqrt(met * below + _TINY))
        low, high = steps("low", (-B - root) / A), steps("high", (-B + root) / A)
        self._low, self._width = low, steps("width", 2 * root / A)
        inside = met * _holds(low) * _holds(1 - high)
        self.cuts = steps("cuts", inside * _holds(C[0] + _INSIDE) * _holds(C[1] + _INSIDE))
        self._r = [steps.define_vector(f"r{k}", add(p, scale(x, self._d))) for k, x in ((1, low), (2, high))]
        self._part = steps.define_vector("part", subtract(self._r[1], self._r[0]))
        self._middle = steps.define_vector("middle", scale(Rational(1, 2), add(*self._r)))

    def measure(self) -> Expr:
        """Define the length."""
        a, steps = self._a, self._steps
        P, Q = self._scaled
        E = steps.define_vector("top", _divide(self._choose(), a))
        normal = cross(subtract(Q, P), subtract(E, P))
        n = steps.define_vector("n", scale(1 / steps("normal", sqrt(dot(normal, normal) + _TINY)), normal))
        height = steps("height", dot(n, E))
        square = steps("circle", _larger(1 - height**2, _NEAR))
        radius = steps("round", sqrt(square))
        centre = steps.define_vector("centre", scale(height, n))
        if self._beyond != 0:
            longer = _holds(dot(cross(n, subtract(Q, P)), subtract(centre, P)))
            n = steps.define_vector("way", scale(steps("turned", 1 - 2 * self._beyond * longer), n))
        touched, straights = [], []
        for k, x, end, way in (("p", P, self._ends[0], -1), ("q", Q, self._ends[1], 1)):
            v = steps.define_vector(f"v_{k}", subtract(x, centre))
            power = steps(f"power_{k}", dot(v, v) - square)
            beyond = steps(
                f"beyond_{k}", steps(f"outside_{k}", _holds(power)) * power
            )  # a sum would lose what is added
            t = steps(f"t_{k}", radius * sqrt(beyond + _TINY))
            arm = scale(1 / (square + beyond), add(scale(square, v), scale(way * t, cross(n, v))))
            touched.append(steps.define_vector(f"arm_{k}", arm))
            straight = subtract(end, _multiply(add(centre, touched[-1]), a))
            straights.append(steps(f"straight_{k}", sqrt(dot(straight, straight) + _TINY)))
        return steps("length", total([*straights, self._measure_arc(n, radius, touched)]))

    def _measure_arc(self, n: Vector, radius: Expr, touched: Sequence[Vector]) -> Expr:
        """Return the length of the arc from one point where the line touches to the other, turned against n."""
        steps = self._steps
        first = steps.define_vector("first", scale(1 / radius, touched[0]))
        second = steps.define_vector("second", cross(first, n))
        sine, cosine = dot(second, touched[1]), dot(first, touched[1])
        s, c = sin(_BACK), cos(_BACK)
        turned = atan2(-(sine * c + cosine * s), -(cosine * c - sine * s))
        angle = steps("angle", pi - _BACK + turned)
        x, y = (_multiply(v, self._a) for v in (first, second))
        xx, xy, yy = (steps(key, v) for key, v in (("xx", dot(x, x)), ("xy", dot(x, y)), ("yy", dot(y, y))))
        sums = []
        for k, (place, weight) in enumerate(_list_nodes(_ARC), 1):
            turn = steps(f"turn{k}", place * angle)
            sine, cosine = steps(f"sine{k}", sin(turn)), steps(f"cosine{k}", cos(turn))
            sums.append(weight * sqrt(xx * sine**2 - 2 * xy * sine * cosine + yy * cosine**2))
        return radius * angle * steps("mean", total(sums))

    def _choose(self) -> Vector:
        """Return the point c."""
        method, side, steps = self._ellipsoid.method, self._ellipsoid.side, self._steps
        size = steps("size", sqrt(dot(self._d, self._d) + _TINY))
        lines = [steps(f"line.{axis}", _size(x) / size) for axis, x in zip("xyz", self._d, strict=True)]
        x = _holds(lines[0] - lines[1]) * _holds(lines[0] - lines[2])
        y = (1 - x) * _holds(lines[1] - lines[2])
        chosen = steps.define_vector("chosen", (x, y, 1 - x - y))
        parallel = steps("parallel", dot(chosen, (lines[0], lines[1], lines[2])))
        share: Expr = ONE
        if method == "midpoint":
            c = self._approach("c", self._middle)
        elif method == "axial":
            c, place = self._cross_plane(chosen)
            self._beyond = steps("beyond", 1 - _holds(place) * _holds(1 - place))
        else:
            axial, place = self._cross_plane(chosen)
            edge = steps("edge", _clip(_smaller(place, 1 - place) / _EDGE))
            share = steps("faded", _smaller(edge * _larger(parallel - _LOW, ZERO) / (_HIGH - _LOW), ONE))
            fan = self._average()
            c = self._approach("c", steps.define_vector("mixed", add(scale(share, axial), scale(1 - share, fan))))
        return c if side is None else self._mirror(c, side, share)

    def _cross_plane(self, chosen: Vector) -> tuple[Vector, Expr]:
        """Return the axial point, and where the line crosses its plane: from 0 at r1 to 1 at r2."""
        steps, p = self._steps, self._ends[0]
        along = dot(chosen, self._d)
        share = steps("crossing", -dot(chosen, p) * along / (along**2 + _TINY))
        place = steps("place", (share - self._low) / self._width)
        crossed = add(p, scale(share, self._d))
        flat = tuple((1 - k) * x for k, x in zip(chosen, crossed, strict=True))
        point = steps.define_vector("crossed", (flat[0], flat[1], flat[2]))
        return self._approach("axial", point), place

    def _average(self) -> Vector:
        """Return the point of the fan."""
        steps = self._steps
        blades = list[Vector]()
        for k, (place, weight) in enumerate(_list_nodes(_FAN), 1):
            s = steps.define_vector(f"fan{k}", add(self._r[0], scale(place, self._part)))
            v = steps.define_vector(f"blade{k}", subtract(self._approach(f"fan{k}", s), s))
            length = steps(f"blade{k}", sqrt(dot(v, v) + _TINY))
            blades.append(scale(_SAMPLES * weight / length, v))
        for k, (r, missed) in enumerate(zip(self._r, (Rational(1, 2), Rational(3, 2)), strict=True), 1):
            v = steps.define_vector(f"end{k}", _divide(_divide(r, self._a), self._a))
            blades.append(scale(-missed / steps(f"end{k}", sqrt(dot(v, v) + _TINY)), v))
        whole = steps.define_vector("fan", _sum(blades))
        length = steps("fan", sqrt(dot(whole, whole) + _TINY))
        return self._approach("top", steps.define_vector("above", add(self._middle, scale(1 / length, whole))))

    def _mirror(self, c: Vector, side: tuple[int, int], share: Expr) -> Vector:
        """Return the point c on the half where the line stays."""
        axis, way = side
        steps = self._steps
        away = steps("away", 1 - _holds(way * c[axis]))
        moved = tuple(-share * x if k == axis else x for k, x in enumerate(c))
        self._beyond *= 1 - away
        other = self._approach("mirrored", steps.define_vector("mirror", (moved[0], moved[1], moved[2])))
        return steps.define_vector("held", add(scale(1 - away, c), scale(away, other)))

    def _approach(self, key: str, s: Vector) -> Vector:
        """Return the nearest point of the surface."""
        steps, a = self._steps, self._a
        near = [steps(f"{key} near.{k}", _holds(_NEAR - _size(x))) for k, x in zip("xyz", s, strict=True)]
        g = [steps(f"{key} g.{k}", (1 - w) * x * r) for k, w, x, r in zip("xyz", near, s, a, strict=True)]
        most = self._largest**2
        shift = [steps(f"{key} shift.{k}", r**2 + w * most) for k, w, r in zip("xyz", near, a, strict=True)]
        bounds = [_size(x) - r**2 - w * (most - r**2) for x, r, w in zip(g, a, near, strict=True)]
        whole = sqrt(dot((g[0], g[1], g[2]), (g[0], g[1], g[2])) + _TINY) - most
        t = whole
        for k, bound in enumerate(bounds):
            t = steps(f"{key} from{k}", _larger(t, bound))
        for k in range(1, _ITERATIONS + 1):
            parts = [steps(f"{key} e{k}.{i}", x / (t + y)) for i, x, y in zip("xyz", g, shift, strict=True)]
            S = steps(f"{key} S{k}", total(x**2 for x in parts) + _TINY)
            steep = total(x**2 / (t + y) for x, y in zip(parts, shift, strict=True)) + _TINY
            value = t + S * (sqrt(S) - 1) / steep
            if k < _ITERATIONS:
                t = steps(f"{key} t{k}", value)
        equation = total((x / (_T + y)) ** 2 for x, y in zip(g, shift, strict=True)) - 1
        t = steps.solve(f"{key} t", value, _T, equation)
        found = [w * x + r * u / (t + y) for w, x, r, u, y in zip(near, s, a, g, shift, strict=True)]
        return steps.define_vector(f"{key} on", (found[0], found[1], found[2]))


@cache
def _list_nodes(count: int) -> tuple[tuple[Expr, Expr], ...]:
    """Return places from 0 to 1 and weights of the rule of Gauss and Legendre."""
    places, weights = gauss_legendre(count, _DIGITS)
    return tuple((Float((x + 1) / 2, _DIGITS), Float(w / 2, _DIGITS)) for x, w in zip(places, weights, strict=True))


def _larger(x: Expr, y: Expr) -> Expr:
    return (x + y + _size(x - y)) / 2


def _smaller(x: Expr, y: Expr) -> Expr:
    return (x + y - _size(x - y)) / 2


def _clip(x: Expr) -> Expr:
    """Return the number, or the nearest one from 0 to 1."""
    return (1 + _size(x) - _size(x - 1)) / 2


def _holds(x: Expr) -> Expr:
    """Return 1 where x >= 0, else 0, without SymPy's search for its sign."""
    return (1 + sign(2 * sign(x, evaluate=False) + 1, evaluate=False)) / 2


def _size(x: Expr) -> Expr:
    return Abs(x, evaluate=False)


def _sum(vectors: Sequence[Vector]) -> Vector:
    x, y, z = (total(v[k] for v in vectors) for k in range(3))
    return x, y, z


def _multiply(x: Vector, y: Vector) -> Vector:
    return x[0] * y[0], x[1] * y[1], x[2] * y[2]


def _divide(x: Vector, y: Vector) -> Vector:
    return x[0] / y[0], x[1] / y[1], x[2] / y[2]
