"""The skeleton of a mechanism, for pictures: frames, the edges between them, and their places at given coordinates.

A body that carries neither another body nor a sensor has one more frame, at its centre of mass. Each end of a loop is a
frame on its body, too; `links` joins the two ends.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mbsgen.manifest import Frame, Loop
from mbsrun.appearance import complete_manifest
from mbsrun.ocp.ground.plant import Plant

Array = NDArray[np.float64]

CONSTRAINT, ROD = "constraint", "rod"  # cuts in a manifest


@dataclass(frozen=True)
class Link:
    """A loop, by the indices of the frames at its ends."""

    name: str
    first: int
    second: int
    is_rod: bool  # the ends are apart; else they coincide where the loop is closed


@dataclass(frozen=True)
class Skeleton:
    """Frames at K states; F of them."""

    frames: tuple[Frame, ...]
    p: Array  # origins in the base frame, (K, 3, F) [m]
    R: Array  # axes as columns, in the base frame, (K, 3, 3 F)
    links: tuple[Link, ...] = ()


def place(plant: Plant, q: ArrayLike) -> Skeleton:
    """Compute the skeleton at coordinates q, shape (K, n)."""
    manifest, poses = complete_manifest(plant), plant("frames", q=q)
    frames, loops = manifest.frames, [loop for loop in manifest.loops if loop.cut != CONSTRAINT]
    p, R = poses["p"], poses["R"]
    added = [(f"{frame.name}, centre of mass", i, frame.com) for i, frame in enumerate(frames) if frame.com is not None]
    first = len(frames) + len(added)
    added += [end for loop in loops for end in _list_ends(loop)]
    places, turns = [p], [R]
    for _, i, point in added:
        axes = R[:, :, 3 * i : 3 * i + 3] if i >= 0 else np.broadcast_to(np.eye(3), (len(p), 3, 3))
        origin = p[:, :, i : i + 1] if i >= 0 else np.zeros((len(p), 3, 1))
        places.append(origin + axes @ np.array(point)[:, None])
        turns.append(axes)
    ends = (Frame(name=name, parent=i, sensor=False) for name, i, _ in added)
    links = (Link(x.name, first + 2 * k, first + 2 * k + 1, x.cut == ROD) for k, x in enumerate(loops))
    return Skeleton((*frames, *ends), np.concatenate(places, axis=2), np.concatenate(turns, axis=2), tuple(links))


def _list_ends(loop: Loop) -> Iterator[tuple[str, int, tuple[float, float, float]]]:
    """Yield the two ends of a loop: name, frame, point in it."""
    yield f"{loop.name}, first end", loop.first, loop.first_point
    yield f"{loop.name}, second end", loop.second, loop.second_point
