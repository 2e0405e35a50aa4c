"""Corners of convex hulls."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def draw_points(rng: np.random.Generator, count: int, size: float) -> tuple[tuple[float, float, float], ...]:
    points = rng.normal(size=(count, 3))
    return tuple(map(tuple, (points * size / np.linalg.norm(points, axis=1)[:, None]).tolist()))


def make_box(edges: Array) -> tuple[tuple[float, float, float], ...]:
    signs = np.array([(a, b, c) for a in (-1, 1) for b in (-1, 1) for c in (-1, 1)])
    return tuple(map(tuple, (signs * edges / 2).tolist()))
