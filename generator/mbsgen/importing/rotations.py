"""Rotations of `model.orientations` as arrays, for files whose poses are computed with."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mbsgen.model import orientations

Array = NDArray[np.float64]


def turn(axis: Sequence[float] | Array, angle: float) -> Array:
    """Return the rotation about a direction of any length; quarter turns of the nearest double are exact."""
    return np.array(orientations.turn([float(x) for x in axis], angle))


def turn_quaternion(q: Sequence[float] | Array) -> Array:
    """Return the rotation of a quaternion w, x, y, z of any length but 0."""
    return np.array(orientations.turn_quaternion([float(x) for x in q]))


def find_turns(rotation: Array) -> tuple[tuple[int, float], ...]:
    """Return the turns about z, y and x that make a rotation."""
    return orientations.find_turns(rotation.tolist())
