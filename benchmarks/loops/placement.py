"""A tree at a state -> the places and velocities of its bodies, for programs that want them in absolute coordinates."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mbsgen.model.tree import Motion, Tree

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Place:
    """A body in the base's frame: its frame, its centre of mass, and the velocities of that point and of the frame."""

    origin: Array
    axes: Array  # columns
    com: Array
    velocity: Array  # of the centre of mass
    omega: Array
    mass: float
    inertia: Array  # about the centre of mass, in the body's frame
    joint: Array  # the axis of its joint


def place_bodies(tree: Tree, q: Sequence[float], qd: Sequence[float]) -> tuple[Place, ...]:
    """Place the base, as a body without mass, and all bodies."""
    zero = np.zeros(3)
    places = [Place(zero, np.eye(3), zero, zero, zero, 0.0, np.zeros((3, 3)), zero)]
    points = [zero]  # velocities of the frames' origins
    values = {parameter.symbol: parameter.value for parameter in tree.parameters}

    def number(entries: Sequence[object]) -> Array:
        return np.array([float(x.subs(values)) for x in entries])  # type: ignore[attr-defined]

    for body, x, rate in zip(tree.bodies, q, qd, strict=True):
        parent = places[body.parent]
        offset = parent.axes @ number(body.position)
        origin, axes = parent.origin + offset, parent.axes @ np.array([number(row) for row in body.orientation])
        velocity, omega = points[body.parent] + np.cross(parent.omega, offset), parent.omega
        axis = axes[:, body.joint.axis]
        if body.joint.motion is Motion.REVOLUTE:
            axes, omega = axes @ turn(body.joint.axis, x), omega + rate * axis
        else:
            origin = origin + x * axis
            velocity = velocity + np.cross(omega, x * axis) + rate * axis
        arm, (mass,) = axes @ number(body.com), number((body.mass,))
        inertia = np.array([number(row) for row in body.inertia])
        com = velocity + np.cross(omega, arm)
        places.append(Place(origin, axes, origin + arm, com, omega, float(mass), inertia, axis))
        points.append(velocity)
    return tuple(places)


def turn(axis: int, angle: float) -> Array:
    """Return the rotation about a coordinate axis."""
    j, k, c, s = (axis + 1) % 3, (axis + 2) % 3, np.cos(angle), np.sin(angle)
    matrix = np.eye(3)
    matrix[j, j] = matrix[k, k] = c
    matrix[k, j], matrix[j, k] = s, -s
    return matrix


def find_angle(parent: Array, child: Array, axis: int) -> float:
    """Return the angle between two frames about a coordinate axis that both share."""
    relative = parent.T @ child
    return float(np.arctan2(relative[(axis + 2) % 3, (axis + 1) % 3], relative[(axis + 1) % 3, (axis + 1) % 3]))
