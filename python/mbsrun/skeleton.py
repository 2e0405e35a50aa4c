"""The skeleton of a mechanism, for pictures: frames, the edges between them, and their places at given coordinates.

A body that carries neither another body nor a sensor has one more frame, at its centre of mass.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mbsgen.manifest import Frame
from mbsrun.ocp.plant import Plant

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Skeleton:
    """Frames at K states; F of them."""

    frames: tuple[Frame, ...]
    p: Array  # origins in the base frame, (K, 3, F) [m]
    R: Array  # axes as columns, in the base frame, (K, 3, 3 F)


def place(plant: Plant, q: ArrayLike) -> Skeleton:
    """Compute the skeleton at coordinates q, shape (K, n)."""
    frames, poses = plant.manifest.frames, plant("frames", q=q)
    p, R = poses["p"], poses["R"]
    ends = [(i, frame, frame.com) for i, frame in enumerate(frames) if frame.com is not None]
    places, turns = [p], [R]
    for i, _, com in ends:
        axes = R[:, :, 3 * i : 3 * i + 3]
        places.append(p[:, :, i : i + 1] + axes @ np.array(com)[:, None])
        turns.append(axes)
    added = (Frame(name=f"{frame.name}, centre of mass", parent=i, sensor=False) for i, frame, _ in ends)
    return Skeleton((*frames, *added), np.concatenate(places, axis=2), np.concatenate(turns, axis=2))
