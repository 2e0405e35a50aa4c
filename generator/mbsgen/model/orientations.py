"""Rotations in numbers as turns in a row, about the axes turned so far: matrix, quaternion -> turns about z, y, x."""

from __future__ import annotations

import math
from collections.abc import Sequence

from mbsgen.algebra.dense import Dense, Row, combine, dot, identity, skew, times
from mbsgen.expressions import Constant, Expression, Negation, Number, Operation
from mbsgen.model.model import Rotation

QUARTER = math.pi / 2
LOCKED = 1e-12  # the cosine of a middle angle at which only the sum of the two others matters
ROUNDING = 1e-12  # of angles that are computed from written digits: nearer to a quarter turn, they are one

_PI = Constant("pi")
QUARTERS: dict[int, Expression] = {
    0: Number(0.0),
    1: Operation("/", _PI, Number(2.0)),
    2: _PI,
    -1: Operation("/", Negation(_PI), Number(2.0)),
    -2: Negation(_PI),
}


def turn(axis: Sequence[float], angle: float) -> Dense:
    """Return the rotation about a direction of any length; quarter turns of the nearest double are exact."""
    cross = skew(_normalise(axis))
    quarters = round(angle / QUARTER)
    if abs(quarters) < 100 and angle == quarters * QUARTER:
        c, s = (1.0, 0.0, -1.0, 0.0)[quarters % 4], (0.0, 1.0, 0.0, -1.0)[quarters % 4]
    else:
        c, s = math.cos(angle), math.sin(angle)
    return combine(lambda one, a, b: one + s * a + (1 - c) * b, identity(3), cross, times(cross, cross))


def _normalise(v: Sequence[float]) -> Row:
    length = math.sqrt(dot(v, v))
    return tuple(x / length for x in v)


def turn_quaternion(q: Sequence[float]) -> Dense:
    """Return the rotation of a quaternion w, x, y, z of any length but 0."""
    w, x, y, z = _normalise(q)
    return (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )


def find_turns(rotation: Dense) -> tuple[tuple[int, float], ...]:
    """Return the turns about z, y and x that make a rotation; each is removed before the next is found."""
    c, s = rotation[0][0], rotation[1][0]
    z = math.atan2(s, c) if math.hypot(s, c) > LOCKED else 0.0
    rest = times(turn((0, 0, 1), -z), rotation)
    y = math.atan2(-rest[2][0], rest[0][0])
    rest = times(turn((0, 1, 0), -y), rest)
    return (2, z), (1, y), (0, math.atan2(rest[2][1], rest[1][1]))


def write_turns(rotation: Dense) -> tuple[Rotation, ...]:
    """Write a rotation as turns of a model, quarter turns exactly."""
    written = [(axis, write_angle(angle, ROUNDING)) for axis, angle in find_turns(rotation)]
    return tuple(Rotation(axis, angle) for axis, angle in written if angle != Number(0.0))


def write_angle(angle: float, tolerance: float) -> Expression:
    """Write an angle [rad]; within the tolerance of a quarter turn, that quarter turn."""
    quarters = round(angle / QUARTER)
    if abs(angle - quarters * QUARTER) <= tolerance and quarters in QUARTERS:
        return QUARTERS[quarters]
    return Number(angle)
