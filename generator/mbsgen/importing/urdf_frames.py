"""Origins and axes of URDF: roll, pitch and yaw are turns about z by yaw, about y by pitch, about x by roll."""

from __future__ import annotations

import numpy as np

from mbsgen.importing.findings import Findings
from mbsgen.importing.markup import Element
from mbsgen.importing.poses import ORIGIN, Array, Pose, Writer, place

DEFAULT_AXIS = (1.0, 0.0, 0.0)


def read_origin(element: Element, findings: Findings, writer: Writer) -> Pose:
    """Read the <origin> of an element."""
    origin = element.first("origin")
    return ORIGIN if origin is None else read_pose(origin, findings, writer)


def read_pose(element: Element, findings: Findings, writer: Writer) -> Pose:
    """Read the attributes xyz and rpy of an element."""
    position = findings.numbers(element, "xyz", (0.0, 0.0, 0.0))
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
