"""Joints of OpenSim -> slides and turns in a row, each by a sum over the coordinates of the joint.

All joints slide in the parent's frame first, and then turn, each axis turned by the turns before it.

| joint | slides | turns |
|---|---|---|
| WeldJoint | | |
| PinJoint | | z |
| SliderJoint | x | |
| UniversalJoint | | x, y |
| GimbalJoint, BallJoint | | x, y, z |
| PlanarJoint | x, y by its second and third coordinates | z by its first |
| FreeJoint | x, y, z by its last three coordinates | x, y, z by its first three |
| CustomJoint | three, about any axes, by functions | three, about any axes, by functions |

Source: OpenSim's documentation of its classes of joints.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from mbsgen.documents import abbreviate
from mbsgen.importing.findings import Findings
from mbsgen.importing.markup import Element
from mbsgen.importing.osim.functions import Sum, find_function, read_function
from mbsgen.importing.poses import Array, Pose, place
from mbsgen.importing.rotations import turn
from mbsgen.model.tree import Motion

SLIDE, TURN = Motion.PRISMATIC, Motion.REVOLUTE
CUSTOM = "CustomJoint"
KINDS: dict[str, tuple[tuple[Motion, int, int], ...]] = {  # motions, axes, and numbers of their coordinates
    "WeldJoint": (),
    "PinJoint": ((TURN, 2, 0),),
    "SliderJoint": ((SLIDE, 0, 0),),
    "UniversalJoint": ((TURN, 0, 0), (TURN, 1, 1)),
    "GimbalJoint": ((TURN, 0, 0), (TURN, 1, 1), (TURN, 2, 2)),
    "BallJoint": ((TURN, 0, 0), (TURN, 1, 1), (TURN, 2, 2)),
    "PlanarJoint": ((SLIDE, 0, 1), (SLIDE, 1, 2), (TURN, 2, 0)),
    "FreeJoint": ((SLIDE, 0, 3), (SLIDE, 1, 4), (SLIDE, 2, 5), (TURN, 0, 0), (TURN, 1, 1), (TURN, 2, 2)),
}
JOINTS = (*KINDS, CUSTOM)
_AXES = ("rotation1", "rotation2", "rotation3", "translation1", "translation2", "translation3")


@dataclass(frozen=True, eq=False)
class Axis:
    """A slide or a turn of a joint."""

    motion: Motion
    direction: Array
    amount: Sum  # [rad or m]
    name: str
    source: Element
    is_direct: bool = True  # not by a spline or another function that happens to be linear

    def at(self, amount: float) -> Pose:
        """Return the pose after the motion by an amount."""
        if self.motion is SLIDE:
            return place(self.direction / np.linalg.norm(self.direction) * amount)
        along = np.flatnonzero(self.direction)
        if len(along) == 1:
            k = int(along[0])
            return place((0.0, 0.0, 0.0), [(k, amount if self.direction[k] > 0 else -amount)] if amount else [])
        return Pose(turn(self.direction, amount), np.zeros(3), None if amount else ())

    def turned_back(self) -> Axis:
        """Return the same motion of the parent in the child."""
        return replace(self, direction=-self.direction)


def list_coordinates(joint: Element) -> list[Element]:
    """List the coordinates of a joint."""
    found = joint.first("coordinates")
    if found is None:
        outer = joint.first("CoordinateSet")
        found = None if outer is None else outer.first("objects")
    return [] if found is None else [*found.all("Coordinate")]


def is_angle(coordinate: str, axes: Sequence[Axis]) -> bool:
    """Return whether OpenSim counts a coordinate as an angle: it is the amount of a turn, and of no slide."""
    direct = {
        axis.motion for axis in axes if axis.is_direct and axis.amount.line in ((coordinate, 1.0), (coordinate, -1.0))
    }
    return direct == {TURN}


def list_axes(joint: Element, coordinates: Sequence[str], findings: Findings) -> list[Axis]:
    """List the slides and turns of a joint, given the names of its coordinates."""
    if joint.tag == CUSTOM:
        return [*_read_transform(joint, coordinates, findings)]
    return [
        Axis(motion, np.eye(3)[axis], Sum(slopes={coordinates[k]: 1.0}), f"{motion.value}_{axis}", joint)
        for motion, axis, k in KINDS[joint.tag]
    ]


def count_coordinates(joint: Element) -> int | None:
    """Return the number of coordinates of a joint; None where its functions decide."""
    return None if joint.tag == CUSTOM else len(KINDS[joint.tag])


def _read_transform(joint: Element, coordinates: Sequence[str], findings: Findings) -> Iterator[Axis]:
    transform = joint.first("SpatialTransform")
    if transform is None:
        findings.fault(joint, "a CustomJoint without a SpatialTransform", "give its axes")
        return
    given = {axis.attributes.get("name", ""): axis for axis in transform.all("TransformAxis")}
    for name in given:
        if name not in _AXES:
            findings.fault(given[name], f"an axis called {abbreviate(name)}", f"call the axes {', '.join(_AXES)}")
    for name in (*_AXES[3:], *_AXES[:3]):
        if name in given:
            motion = TURN if name.startswith("rotation") else SLIDE
            yield _read_axis(given[name], motion, name, coordinates, findings)


def _read_axis(element: Element, motion: Motion, name: str, coordinates: Sequence[str], findings: Findings) -> Axis:
    named = element.first("coordinates")
    words = [] if named is None else named.text.split()
    for word in words:
        if word not in coordinates:
            remedy = f"name {', '.join(coordinates)}" if coordinates else "give the joint coordinates"
            findings.fault(named or element, f"{abbreviate(word)} is no coordinate of this joint", remedy)
    function = find_function(element)
    if function is None and words:
        findings.fault(element, "coordinates without a function", "give a function, e.g. a LinearFunction")
    amount = Sum() if function is None else read_function(function, words, findings)
    is_direct = function is not None and function.tag == "LinearFunction"
    return Axis(motion, _read_direction(element, amount, findings), amount, name, element, is_direct)


def _read_direction(element: Element, amount: Sum, findings: Findings) -> Array:
    child = element.first("axis")
    direction: tuple[float, ...] = (1.0, 0.0, 0.0)
    if child is None and amount != Sum():
        findings.fault(element, "an axis without a direction", "give an <axis>, e.g. 0 0 1")
    elif child is not None:
        direction = findings.numbers(child, "axis", direction, attributes={"axis": child.text})
        if not any(direction):
            findings.fault(child, "the axis is 0 0 0", "give a direction, e.g. 0 0 1")
            direction = (1.0, 0.0, 0.0)
    return np.array(direction)
