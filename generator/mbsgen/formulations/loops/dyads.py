"""Closed forms: one or two equations of a loop, solved without an iteration where their structure allows it.

Equations g(y) = 0 are solved from a start, at which g, its slopes g' and, of one unknown, g'' are known. The steps
from there are angles d, and slides s. With unit vectors turned, E = [0 -1; 1 0] and R(d) = exp(d E), these are

    crank        a + b cos d + c sin d = 0,  with a = g + g'', b = -g'', c = g'
    rod          g + g' s + g'' s2/2 = 0
    two turns    C + R(d1) u + R(d2) v = 0                     circle and circle (a four-bar)
    two turns    C + R(d1) (u + R(d2) v) = 0                   the same triangle, in a chain
    turn, slide  C + R(d) u + s e = 0                          circle and line (a slider-crank)
    turn, slide  C + R(d) (u + s e) = 0                        circle and line, where the slide turns

with u, v and e from the columns of g': E u = dg/dd1, and so on. Of two solutions, the one on the start's side is
taken. Both meet at a change point, where the sine between the vectors vanishes; there it fails (Wampler and Sommese,
2011, 2).

The structure is found by identities among derivatives, g11 = E g1, g12 = 0 and the like, in 50 digits at random points.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from decimal import Decimal

from mbsgen.formulations.loops.partition import SQUARED_TOLERANCE
from mbsgen.tape import forward
from mbsgen.tape.builder import Builder, Scalar
from mbsgen.tape.interpreter import DECIMALS, evaluate, fifty_digits
from mbsgen.tape.types import Op, Tape

POINTS = 2
SAME = Decimal("1e-30")  # of differences, relative to the numbers
_Plane = tuple[Scalar, Scalar]
_Numbers = tuple[Decimal, ...]


@dataclass(frozen=True)
class Start:
    """The equations at the start: g, and its slopes by columns; of one unknown, also g''."""

    builder: Builder
    status: int
    g: tuple[Scalar, ...]
    slopes: tuple[tuple[Scalar, ...], ...]
    curvature: Scalar | None = None

    def guard(self, value: Scalar, scale: Scalar) -> None:
        """Fail where a squared sine is lost in rounding."""
        self.builder.guard(value, scale, SQUARED_TOLERANCE, self.status)


Solve = Callable[[Start], list[Scalar]]  # the steps from the start


def find(residual: Tape, unknown: str) -> Solve | None:
    """Find the closed form of equations, the first output of a tape; None where they have none of the known forms."""
    size = residual.input(unknown).sparsity.nnz
    if size > 2:
        return None
    with fifty_digits():
        return _match([_differentiate(residual, unknown, seed) for seed in range(POINTS)], size)


def _match(points: Sequence[_Point], size: int) -> Solve | None:
    if size == 1:
        return next((solve for solve, fits in _SINGLES if all(fits(x) for x in points)), None)
    for first in (1, -1):
        for second in (1, -1):
            for order in ((0, 1), (1, 0)):
                for fits, solve in _PAIRS:
                    if all(fits(x, first, second, order) for x in points):
                        return _arrange(solve, first, second, order)
    return None


# -- structure ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Point:
    """The derivatives at a point: by one unknown g' to g''', or the columns of g' and of g''."""

    first: tuple[_Numbers, ...]
    second: dict[tuple[int, int], _Numbers]
    third: Decimal


def _differentiate(residual: Tape, unknown: str, seed: int) -> _Point:
    size = residual.input(unknown).sparsity.nnz
    once = forward.jacobian(residual, [unknown])
    twice = forward.jacobian(once, [unknown])
    draw = random.Random(seed)
    given = {i.name: [Decimal(draw.uniform(0.3, 1.7)) for _ in range(i.sparsity.nnz)] for i in residual.inputs}

    def value(tape: Tape) -> dict[tuple[int, int], Decimal]:
        output = tape.outputs[0]
        values = evaluate(tape, given, DECIMALS)[output.name]
        return dict(zip(output.sparsity.entries, map(Decimal, values), strict=True))

    slopes, curvatures = value(once), value(twice)
    third = value(forward.jacobian(twice, [unknown])).get((0, 0), Decimal(0)) if size == 1 else Decimal(0)
    zero, rows = Decimal(0), range(size)
    return _Point(
        tuple(tuple(slopes.get((r, c), zero) for r in rows) for c in rows),
        {(c, k): tuple(curvatures.get((r + c * size, k), zero) for r in rows) for c in rows for k in rows},
        third,
    )


def _is_same(a: Sequence[Decimal], b: Sequence[Decimal]) -> bool:
    return all(
        not x.is_nan() and abs(x - y) <= SAME * max(abs(x), abs(y), Decimal(1)) for x, y in zip(a, b, strict=True)
    )


def _is_turned(found: _Numbers, v: _Numbers, sense: int) -> bool:
    """Return whether a vector is sense E v."""
    return _is_same(found, (-sense * v[1], sense * v[0]))


def _is_null(found: _Numbers) -> bool:
    return _is_same(found, (Decimal(0),) * len(found))


def _are_apart(x: _Point, first: int, second: int, order: tuple[int, int]) -> bool:
    i, k = order
    turn = _is_turned(x.second[i, i], x.first[i], first), _is_turned(x.second[k, k], x.first[k], second)
    return all(turn) and _is_null(x.second[i, k])


def _are_in_chain(x: _Point, first: int, second: int, order: tuple[int, int]) -> bool:
    i, k = order
    turn = _is_turned(x.second[i, i], x.first[i], first), _is_turned(x.second[k, k], x.first[k], second)
    return all(turn) and _is_turned(x.second[i, k], x.first[k], first)


def _slides_apart(x: _Point, first: int, _: int, order: tuple[int, int]) -> bool:
    i, k = order
    turn = _is_turned(x.second[i, i], x.first[i], first)
    return turn and _is_null(x.second[k, k]) and _is_null(x.second[i, k])


def _slides_in_chain(x: _Point, first: int, _: int, order: tuple[int, int]) -> bool:
    i, k = order
    turn = _is_turned(x.second[i, i], x.first[i], first)
    return turn and _is_null(x.second[k, k]) and _is_turned(x.second[i, k], x.first[k], first)


# -- solutions ------------------------------------------------------------------------------------------------------


def _solve_crank(start: Start) -> list[Scalar]:
    b = start.builder
    (g,), ((c,),) = start.g, start.slopes
    curvature = _known(start.curvature)
    a, cosine = g + curvature, -curvature
    squared = cosine * cosine + c * c
    side = b.apply(Op.SIGN, c)
    left = squared - a * a
    root = side * b.sqrt(left)
    start.guard(side * side * left, squared)
    return [b.apply(Op.ATAN2, -(a * c + root * cosine), root * c - a * cosine)]


def _solve_rod(start: Start) -> list[Scalar]:
    b = start.builder
    (g,), ((slope,),) = start.g, start.slopes
    product = g * _known(start.curvature)
    squared = slope * slope
    left = squared - (product + product)
    side = b.apply(Op.SIGN, slope)
    start.guard(side * side * left, squared + _size(product))
    return [-(g + g) / (slope + side * b.sqrt(left))]


_Pair = Callable[[Start, _Plane, _Plane], tuple[Scalar, Scalar]]  # by the vectors that E turns into the columns of g'


def _solve_triangle(start: Start, C: _Plane, u: _Plane, v: _Plane) -> tuple[_Plane, _Plane]:
    """Return x and y of C + x + y = 0, as long as u and v, on u's side of C."""
    b = start.builder
    base, one, other = _dot(C, C), _dot(u, u), _dot(v, v)
    inverse = b.number(1.0) / base
    along = b.number(0.5) + (one - other) * (inverse * b.number(0.5))  # x = -along C + across E C
    side = b.apply(Op.SIGN, _cross(C, u))
    across = side * b.sqrt(one * inverse - along * along)
    height = across * base
    start.guard(height * height, one * other)
    x = -(along * C[0] + across * C[1]), across * C[0] - along * C[1]
    return x, (-(C[0] + x[0]), -(C[1] + x[1]))


def _solve_apart(start: Start, u: _Plane, v: _Plane) -> tuple[Scalar, Scalar]:
    C = _subtract(_subtract(_plane(start.g), u), v)
    x, y = _solve_triangle(start, C, u, v)
    return _angle(u, x), _angle(v, y)


def _solve_chain(start: Start, whole: _Plane, v: _Plane) -> tuple[Scalar, Scalar]:
    u = _subtract(whole, v)
    x, y = _solve_triangle(start, _subtract(_plane(start.g), whole), u, v)
    first = _angle(u, x)
    return first, _angle(v, y) - first


def _solve_slider(start: Start, u: _Plane, e: _Plane) -> tuple[Scalar, Scalar]:
    C = _subtract(_plane(start.g), u)
    s = _meet_line(start, C, e, _dot(u, u), -_dot(u, e))
    return _angle(u, (-(C[0] + s * e[0]), -(C[1] + s * e[1]))), s


def _solve_turned_slider(start: Start, u: _Plane, e: _Plane) -> tuple[Scalar, Scalar]:
    C = _subtract(_plane(start.g), u)
    s = _meet_line(start, u, e, _dot(C, C), _dot(u, e))
    return _angle((u[0] + s * e[0], u[1] + s * e[1]), (-C[0], -C[1])), s


def _meet_line(start: Start, C: _Plane, e: _Plane, squared: Scalar, before: Scalar) -> Scalar:
    """Return s at which C + s e has a squared length, and a product with e of the sign of `before`."""
    b = start.builder
    own, across = _dot(e, e), _cross(e, C)
    side = b.apply(Op.SIGN, before)
    left = own * squared - across * across
    start.guard(side * side * left, own * squared)
    return (side * b.sqrt(left) - _dot(C, e)) / own


def _arrange(solve: _Pair, first: int, second: int, order: tuple[int, int]) -> Solve:
    """Make a solution from the columns of g': of turns, the vectors that E turns into them."""
    i, k = order
    turns = solve in (_solve_apart, _solve_chain)

    def steps(start: Start) -> list[Scalar]:
        one = _unturn(_plane(start.slopes[i]), first)
        other = _plane(start.slopes[k])
        a, b = solve(start, one, _unturn(other, second) if turns else other)
        found = {i: a if first > 0 else -a, k: -b if turns and second < 0 else b}
        return [found[0], found[1]]

    return steps


_SINGLES: tuple[tuple[Solve, Callable[[_Point], bool]], ...] = (
    (_solve_rod, lambda x: _is_null((x.third,))),
    (_solve_crank, lambda x: _is_same((x.third,), (-x.first[0][0],))),
)
_PAIRS: tuple[tuple[Callable[[_Point, int, int, tuple[int, int]], bool], _Pair], ...] = (
    (_are_apart, _solve_apart),
    (_are_in_chain, _solve_chain),
    (_slides_apart, _solve_slider),
    (_slides_in_chain, _solve_turned_slider),
)


def _plane(v: Sequence[Scalar]) -> _Plane:
    x, y = v
    return x, y


def _unturn(v: _Plane, sense: int) -> _Plane:
    """Return u of sense E u = v."""
    return (v[1], -v[0]) if sense > 0 else (-v[1], v[0])


def _subtract(a: _Plane, b: _Plane) -> _Plane:
    return a[0] - b[0], a[1] - b[1]


def _dot(a: _Plane, b: _Plane) -> Scalar:
    return a[0] * b[0] + a[1] * b[1]


def _cross(a: _Plane, b: _Plane) -> Scalar:
    return a[0] * b[1] - a[1] * b[0]


def _angle(a: _Plane, b: _Plane) -> Scalar:
    """Return the angle from a to b."""
    return a[0].builder.apply(Op.ATAN2, _cross(a, b), _dot(a, b))


def _size(x: Scalar) -> Scalar:
    return x if x.is_zero else x.builder.apply(Op.ABS, x)


def _known(curvature: Scalar | None) -> Scalar:
    assert curvature is not None, "one unknown comes with g''"
    return curvature
