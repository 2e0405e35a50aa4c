"""Poses in numbers, and their form in a model file: rotations in turn, about the axes turned so far."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mbsgen.expressions import Expression, Number
from mbsgen.importing.rotations import find_turns, turn
from mbsgen.model.model import UNITS, Placement, Rotation, Triple
from mbsgen.model.orientations import QUARTER, write_angle

Array = NDArray[np.float64]

DOUBTFUL = 1e-4  # angles nearer than this to quarter turns were probably meant as such


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
        off = abs(angle - round(angle / QUARTER) * QUARTER)
        if self._tolerance < off < DOUBTFUL:
            self.doubtful.append(off)
        return write_angle(angle, self._tolerance)


def write_triple(vector: Sequence[float] | Array) -> Triple:
    """Write three numbers."""
    a, b, c = (Number(float(x) or 0.0) for x in vector)
    return a, b, c


def write_axis(axis: Array) -> Triple:
    """Write a direction; coordinate axes in their own form, whatever their length."""
    present = [k for k in range(3) if axis[k] != 0]
    if len(present) == 1:
        return UNITS[("-" if axis[present[0]] < 0 else "") + "xyz"[present[0]]]
    return write_triple(axis)
