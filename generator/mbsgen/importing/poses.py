"""Poses in numbers, and their form in a model file: rotations in turn, about the axes turned so far."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mbsgen.expressions import Constant, Expression, Negation, Number, Operation
from mbsgen.model.model import Placement, Rotation, Triple

Array = NDArray[np.float64]

QUARTER = math.pi / 2
LOCKED = 1e-12  # the cosine of a middle angle at which only the sum of the two others matters
DOUBTFUL = 1e-4  # angles nearer than this to quarter turns were probably meant as such

_PI = Constant("pi")
_QUARTERS: dict[int, Expression] = {
    0: Number(0.0),
    1: Operation("/", _PI, Number(2.0)),
    2: _PI,
    -1: Operation("/", Negation(_PI), Number(2.0)),
    -2: Negation(_PI),
}


@dataclass(frozen=True, eq=False)
class Pose:
    """A frame in another: `rotation` has its axes as columns, `position` is its origin [m]."""

    rotation: Array
    position: Array
    turns: tuple[tuple[int, float], ...] | None = None  # the same rotation as turns: axis, angle; if known

    def __matmul__(self, inner: Pose) -> Pose:
        """Return the pose of a frame whose pose in this one is `inner`."""
        turns = None
        if self.is_straight:
            turns = inner.turns
        elif inner.is_straight:
            turns = self.turns
        return Pose(self.rotation @ inner.rotation, self.position + self.rotation @ inner.position, turns)

    @property
    def is_straight(self) -> bool:
        """Return whether the axes are parallel to the other frame's."""
        return bool(np.array_equal(self.rotation, np.eye(3)))


ORIGIN = Pose(np.eye(3), np.zeros(3), ())


def place(position: Sequence[float] | Array, turns: Sequence[tuple[int, float]] = ()) -> Pose:
    """Make a pose from its origin and rotations about coordinate axes in turn."""
    rotation = np.eye(3)
    for axis, angle in turns:
        rotation = rotation @ turn(np.eye(3)[axis], angle)
    return Pose(rotation, np.array(position, float), tuple(turns))


def turn(axis: Sequence[float] | Array, angle: float) -> Array:
    """Return the rotation about a direction of any length; quarter turns of the nearest double are exact."""
    x, y, z = np.asarray(axis, float) / np.linalg.norm(axis)
    quarters = round(angle / QUARTER)
    if abs(quarters) < 100 and angle == quarters * QUARTER:
        c, s = (1.0, 0.0, -1.0, 0.0)[quarters % 4], (0.0, 1.0, 0.0, -1.0)[quarters % 4]
    else:
        c, s = math.cos(angle), math.sin(angle)
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    rotation: Array = np.eye(3) + s * cross + (1 - c) * (cross @ cross)
    return rotation


def turn_quaternion(q: Sequence[float]) -> Array:
    """Return the rotation of a quaternion w, x, y, z of any length but 0."""
    w, x, y, z = np.asarray(q, float) / np.linalg.norm(q)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def find_turns(rotation: Array) -> tuple[tuple[int, float], ...]:
    """Return the turns about z, y and x that make a rotation; each is removed before the next is found."""
    z = math.atan2(rotation[1, 0], rotation[0, 0]) if math.hypot(rotation[1, 0], rotation[0, 0]) > LOCKED else 0.0
    rest = turn((0, 0, 1), -z) @ rotation
    y = math.atan2(-rest[2, 0], rest[0, 0])
    rest = turn((0, 1, 0), -y) @ rest
    return (2, z), (1, y), (0, math.atan2(rest[2, 1], rest[1, 1]))


class Writer:
    """Writes poses for a model; angles within `tolerance` of a quarter turn [rad] become that quarter turn.

    An exact quarter turn costs generated code nothing; pi/2 to eleven digits costs as much as any other angle.
    """

    def __init__(self, tolerance: float) -> None:
        self._tolerance = tolerance
        self.doubtful: list[float] = []  # deviations of unchanged angles near quarter turns

    def placement(self, pose: Pose) -> Placement:
        """Write a pose."""
        turns = find_turns(pose.rotation) if pose.turns is None else pose.turns
        written = [(axis, self.angle(angle)) for axis, angle in turns]
        return Placement(write_triple(pose.position), tuple(Rotation(a, x) for a, x in written if x != Number(0.0)))

    def snap(self, angle: float) -> float:
        """Return an angle, rounded to a quarter turn within the tolerance."""
        nearest = round(angle / QUARTER) * QUARTER
        return nearest if abs(angle - nearest) <= self._tolerance else angle

    def angle(self, angle: float) -> Expression:
        """Write an angle [rad]."""
        quarters = round(angle / QUARTER)
        off = abs(angle - quarters * QUARTER)
        if off <= self._tolerance and quarters in _QUARTERS:
            return _QUARTERS[quarters]
        if self._tolerance < off < DOUBTFUL:
            self.doubtful.append(off)
        return Number(angle)


def write_triple(vector: Sequence[float] | Array) -> Triple:
    """Write three numbers."""
    a, b, c = (Number(float(x) or 0.0) for x in vector)
    return a, b, c
