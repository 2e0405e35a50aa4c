"""A line through a torus: two points -> the cylinder around which it turns, and that turn.

The points a and b are in the axes of the torus, whose ring of radius R lies in the plane of x and y. As in OpenSim's
WrapTorus (Apache License 2.0), the line turns around a cylinder of the radius of the tube, whose axis touches the ring,
on the side of the centre. It touches at the direction (x, y)
of the point a + u n of the line, n = (b - a)/|b - a|, with

    (a + u n).n = 2 R (d/du) sqrt(x^2 + y^2).

The nearest point of the line has R in the place of 2 R: the factor is OpenSim's. Of the points that are found from both
ends, the nearer one to the ring counts; with a side, one on that half.
"""

from __future__ import annotations

from dataclasses import dataclass

from sympy import Expr, Rational, Symbol, sqrt

from mbsgen.model.steps import Steps
from mbsgen.model.tree import ONE, ZERO, Vector
from mbsgen.model.triples import add, cross, dot, scale, subtract
from mbsgen.model.wrapping import Round, holds, make_turn

_TINY = Rational(1, 10**24)  # keeps roots and quotients finite
_ITERATIONS = 5  # to rounding; OpenSim ends at 1e-4
_U = Symbol("u", real=True)


@dataclass(frozen=True)
class Torus:
    """A torus about z."""

    ring: Expr  # radius of the circle in its tube
    tube: Expr  # radius of the tube
    side: Vector | None = None  # a direction of length 1 into the half on which the line touches it; None: any


def measure_through(torus: Torus, a: Vector, b: Vector, steps: Steps) -> tuple[Expr, Expr]:
    """Return 1 where the line from a to b may turn in the torus, else 0, and its length then."""
    R, side = torus.ring, torus.side
    found = [_find(torus, name, *ends, steps) for name, ends in (("to", (a, b)), ("back", (b, a)))]
    (one, near), (two, far) = found
    closer = holds(far - near)
    allowed: Expr = ONE
    if side is not None:
        first, second = (holds(dot(side, x)) for x in (one, two))
        allowed = steps("allowed", first + second - first * second)
        closer = first * (1 - second) + (1 - first - second + 2 * first * second) * closer
    closer = steps("closer", closer)
    x, y, _ = steps.define_vector("q", add(scale(closer, one), scale(1 - closer, two)))
    size = steps("size", sqrt(x**2 + y**2 + _TINY * R**2))
    inward: Vector = steps("in.x", -x / size), steps("in.y", -y / size), ZERO
    axis = cross(inward, (ZERO, ZERO, -ONE))
    centre = scale(-R, inward)
    start, end = (steps.define_vector(f"near_{k}", subtract(p, centre)) for k, p in (("a", a), ("b", b)))
    turn = make_turn(Round(torus.tube, axis, None, inward), start, end, steps)
    return steps("touches", (turn.must + turn.may) * allowed), turn.length


def _find(torus: Torus, name: str, a: Vector, b: Vector, steps: Steps) -> tuple[Vector, Expr]:
    """Return the point of the line, from a on, and the square of its distance from the ring."""
    R = torus.ring
    d = steps.define_vector(f"{name} d", subtract(b, a))
    size = steps(f"{name} size", sqrt(dot(d, d) + _TINY * R**2))
    n = steps.define_vector(f"{name} n", scale(1 / size, d))
    along, flat = steps(f"{name} along", dot(a, n)), steps(f"{name} flat", n[0] ** 2 + n[1] ** 2)
    mixed, square = steps(f"{name} mixed", a[0] * n[0] + a[1] * n[1]), steps(f"{name} square", a[0] ** 2 + a[1] ** 2)

    def far(u: Expr) -> Expr:
        return sqrt(flat * u**2 + 2 * mixed * u + square + _TINY * R**2)

    u = steps(f"{name} u0", -along - 2 * R * sqrt(flat))  # the root where the line passes the axis far away
    for k in range(1, _ITERATIONS + 1):
        rho = steps(f"{name} far{k}", far(u))
        slope = steps(f"{name} slope{k}", (mixed + flat * u) / rho)
        change = (along + u - 2 * R * slope) / (1 - 2 * R * (flat - slope**2) / rho)
        if k < _ITERATIONS:
            u = steps(f"{name} u{k}", u - change)
    equation = along + _U - 2 * R * (mixed + flat * _U) / far(_U)
    u = steps.solve(f"{name} u", u - change, _U, equation)
    point = steps.define_vector(f"{name} point", add(a, scale(u, n)))
    x, y, z = point
    rho = steps(f"{name} far", sqrt(x**2 + y**2 + _TINY * R**2))
    return point, steps(f"{name} gap", (rho - R) ** 2 + z**2)
