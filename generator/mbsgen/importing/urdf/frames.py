"""Origins and axes of URDF: roll, pitch and yaw are turns about z by yaw, about y by pitch, about x by roll.

From version 1.1 on, a quaternion x, y, z, w may stand in their place.
"""

from __future__ import annotations

import numpy as np

from mbsgen.importing.findings import Findings
from mbsgen.importing.markup import Element
from mbsgen.importing.poses import ORIGIN, Array, Pose, Writer, place
from mbsgen.importing.rotations import turn_quaternion

DEFAULT_AXIS = (1.0, 0.0, 0.0)


def read_origin(element: Element, findings: Findings, writer: Writer) -> Pose:
    """Read the <origin> of an element."""
    origin = element.first("origin")
    return ORIGIN if origin is None else read_pose(origin, findings, writer)


def read_pose(element: Element, findings: Findings, writer: Writer) -> Pose:
    """Read the attributes xyz and rpy of an element."""
    position = findings.numbers(element, "xyz", (0.0, 0.0, 0.0))
    if "quat_xyzw" in element.attributes:
        if "rpy" in element.attributes:
            findings.fault(element, "rpy beside quat_xyzw", "give one of the two")
        x, y, z, w = findings.numbers(element, "quat_xyzw", (0.0, 0.0, 0.0, 1.0))
        if not any((x, y, z, w)):
            findings.fault(element, "a quaternion of length 0", "give x, y, z, w")
            return place(position)
        return Pose(turn_quaternion((w, x, y, z)), np.array(position))
    roll, pitch, yaw = map(writer.snap, findings.numbers(element, "rpy", (0.0, 0.0, 0.0)))
    return place(position, [(k, angle) for k, angle in ((2, yaw), (1, pitch), (0, roll)) if angle])


def read_axis(joint: Element, findings: Findings) -> Array:
    """Read the <axis> of an element."""
    element = joint.first("axis")
    axis = DEFAULT_AXIS if element is None else findings.numbers(element, "xyz", DEFAULT_AXIS)
    if not any(axis) and element is not None:
        findings.fault(element, "an axis without direction", "give a nonzero one, e.g. 0 0 1")
        axis = DEFAULT_AXIS
    return np.array(axis)


def tilt_z(direction: Array) -> Array:
    """Return the rotation that turns the z axis to a direction the shortest way; a half turn about x where it is -z."""
    x, y, z = direction / np.linalg.norm(direction)
    if z <= -1:
        return np.diag([1.0, -1.0, -1.0])
    return np.array(
        [
            [1 - x * x / (1 + z), -x * y / (1 + z), x],
            [-x * y / (1 + z), 1 - y * y / (1 + z), y],
            [-x, -y, z],
        ]
    )
