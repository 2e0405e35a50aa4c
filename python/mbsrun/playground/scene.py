"""The picture of the mechanism, for `renderer.js`: solids, edges, and the bounds of the places that they may reach."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbsrun.animation import RATE, Motion, Part, make_film
from mbsrun.animation.page import describe_scene
from mbsrun.appearance import complete_manifest
from mbsrun.closure import Closure
from mbsrun.external import Mechanism
from mbsrun.quaternions import normalise

Array = NDArray[np.float64]

SAMPLES = 100  # poses over the ranges of the coordinates


def describe_picture(kernels: Mechanism, start: Array, lower: Array, upper: Array) -> dict[str, Any]:
    """Return the scene, and the frames that the kernel `frames` does not compute: centres of mass at the ends.

    Poses spread over the ranges of the coordinates, with loops closed, the same ones each time, decide its bounds.
    """
    spread = np.random.default_rng(0).random((SAMPLES - 1, start.size))
    manifest = kernels.manifest
    poses = np.array([start, *(normalise(pose, manifest) for pose in lower + (upper - lower) * spread)])
    if manifest.loops:
        closure, given = Closure(kernels), [] if manifest.configuration else list(manifest.independent)
        poses = np.vstack((start, closure.spread(start, given, poses[1:, given])))
    film = make_film([Motion((Part(kernels, np.arange(SAMPLES) / RATE, poses),))])
    ends = [(i, frame.com) for i, frame in enumerate(complete_manifest(kernels).frames) if frame.com is not None]
    return {"scene": describe_scene(film), "added": [{"frame": i, "at": list(com)} for i, com in ends]}
