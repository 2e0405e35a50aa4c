"""Faces and edges of convex hulls: laws of every closed polyhedron, wherever it lies."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from mbsgen.manifest import Solid
from mbsrun.simulation.solids import Shape, make_shape
from tests.mbsrun.simulation.corners import draw_points, make_box

FLAT = 1e-9


def list_shapes() -> list[Shape]:
    """List hulls of points on a sphere and boxes, shifted far, one with points in its middle and on its edges."""
    rng = np.random.default_rng(5)
    shapes = []
    for k in range(6):
        corners = np.array(draw_points(rng, 9 + k, 0.5) if k < 3 else make_box(rng.uniform(0.3, 1, 3)))
        inside = np.array([corners.mean(axis=0), corners[[0, 1]].mean(axis=0)])
        points = np.concatenate((inside, corners)) if k % 2 else corners
        shifted = points + (k > 1) * rng.uniform(2, 5, 3)
        shapes.append(make_shape(Solid(points=tuple(map(tuple, shifted.tolist())), radius=0.125 * k)))
    return shapes


@pytest.mark.parametrize("k", range(6))
def test_hulls_are_closed_and_convex(k: int) -> None:
    """Euler: P - E + F = 2. Each edge is passed once each way, and no corner lies outside of a face's plane."""
    shape = list_shapes()[k]
    points, middle = shape.points, shape.points.mean(axis=0)
    assert shape.radius == 0.125 * k
    assert len(points) - len(shape.edges) + len(shape.faces) == 2
    if k >= 3:
        assert (len(points), len(shape.edges), len(shape.faces)) == (8, 12, 6)
    for face, n in zip(shape.faces, shape.normals, strict=True):
        assert np.linalg.norm(n) == pytest.approx(1, abs=1e-14)
        heights = (points - points[face[0]]) @ n
        assert heights.max() <= FLAT
        assert sorted(face) == np.flatnonzero(np.abs(heights) <= FLAT).tolist()
        assert (middle - points[face[0]]) @ n < 0
        for a, b, c in zip(face, (*face[1:], face[0]), (*face[2:], *face[:2]), strict=True):
            assert np.cross(points[b] - points[a], points[c] - points[b]) @ n > 0  # to the left at each corner
    passed = [(pair, i) for i, face in enumerate(shape.faces) for pair in pairwise((*face, face[0]))]
    sides = dict(passed)
    assert len(sides) == len(passed) == 2 * len(shape.edges)
    for a, b, left, right in shape.edges:
        assert (sides[a, b], sides[b, a]) == (left, right)


def test_points_and_bars_have_no_faces() -> None:
    ball = make_shape(Solid(points=((1.0, 2.0, 3.0),), radius=0.2))
    bar = make_shape(Solid(points=((1.0, 2.0, 3.0), (1.0, 2.0, 4.0)), radius=0.1))
    assert (ball.faces, ball.edges, ball.radius) == ((), (), 0.2)
    assert (bar.faces, bar.edges, bar.radius) == ((), ((0, 1, -1, -1),), 0.1)
    assert ball.normals.shape == bar.normals.shape == (0, 3)
    assert ball.points.tolist() == [[1, 2, 3]]
