"""Mass, centre of mass and inertia in numbers: moved, added, and compared with the inertias that a body can have."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from mbsgen.expressions import Number
from mbsgen.importing.poses import Array, Pose
from mbsgen.model.model import Inertia

ROUNDING = 1e-15  # of the largest entry: the rounding of a 0 by a rotation


@dataclass(frozen=True, eq=False)
class Solid:
    """Mass, centre of mass and inertia, in a frame."""

    mass: float  # [kg]
    com: Array  # [m]
    inertia: Array  # about com [kg m2]

    def seen_from(self, pose: Pose) -> Solid:
        """Return the solid in the frame in which its own frame has the given pose."""
        R = pose.rotation
        inertia = self.inertia
        if not pose.is_straight:
            inertia = R @ inertia @ R.T
            inertia = (inertia + inertia.T) / 2
            inertia = np.where(np.abs(inertia) <= ROUNDING * np.abs(inertia).max(), 0.0, inertia)
        return Solid(self.mass, pose.position + R @ self.com, inertia)

    def shifted(self, shift: Array) -> Solid:
        """Return the solid in a frame whose origin is at `shift`, along the same axes."""
        return Solid(self.mass, self.com - shift, self.inertia) if shift.any() else self

    def scaled(self, factor: float) -> Solid:
        """Return the solid with another density."""
        return Solid(self.mass * factor, self.com, self.inertia * factor)


NOTHING = Solid(0.0, np.zeros(3), np.zeros((3, 3)))


def add(solids: Iterable[Solid]) -> Solid:
    """Combine solids in one frame to one."""
    heavy = [solid for solid in solids if solid.mass != 0]
    if len(heavy) < 2:
        return heavy[0] if heavy else NOTHING
    mass = sum(solid.mass for solid in heavy)
    com: Array = np.sum([solid.mass * solid.com for solid in heavy], axis=0) / mass
    inertia = np.zeros((3, 3))
    for solid in heavy:
        r = solid.com - com
        inertia += solid.inertia + solid.mass * (r @ r * np.eye(3) - np.outer(r, r))
    return Solid(mass, com, inertia)


def find_miss(solid: Solid) -> float:
    """Return the violation of an inertia, in terms of its largest moment; negative for a possible inertia."""
    a, b, c = np.linalg.eigvalsh(solid.inertia)
    scale = float(np.abs([a, b, c]).max())
    return float(max(c - a - b, -a)) / scale if scale else 0.0


def show_moments(solid: Solid) -> str:
    """Write the principal moments of inertia."""
    return ", ".join(f"{moment:.6g}" for moment in np.linalg.eigvalsh(solid.inertia)) + " kg m2"


def write_inertia(tensor: Array) -> Inertia:
    """Write a symmetric tensor."""
    entries = (tensor[0, 0], tensor[1, 1], tensor[2, 2], tensor[0, 1], tensor[0, 2], tensor[1, 2])
    return Inertia(*(Number(float(entry) or 0.0) for entry in entries))
