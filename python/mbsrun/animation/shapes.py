"""Shapes of triangles with normals: ball, cylinder, cone, box with round edges, and meshes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, lru_cache

import numpy as np
from numpy.typing import NDArray

from mbsrun.animation.film import Kind, Mesh, Solid

Array = NDArray[np.float64]

ROUNDING = 0.22  # radius of a box's edges, relative to half its shortest edge
CREASE = 0.766  # cosine of the angle up to which faces of a mesh share a normal


@dataclass(frozen=True, eq=False)
class Shape:
    """Triangles: corners (T, 3, 3), and a normal at each."""

    corners: Array
    normals: Array

    def placed(self, turn: Array, at: Array, scale: Array) -> Shape:
        """Return the shape scaled, turned by a matrix, and moved."""
        normals = (self.normals / np.maximum(scale, 1e-9)) @ turn.T
        lengths = np.linalg.norm(normals, axis=2, keepdims=True)
        return Shape(at + (self.corners * scale) @ turn.T, normals / np.where(lengths > 0, lengths, 1.0))


def join(shapes: Sequence[Shape]) -> Shape:
    """Return the triangles of all shapes."""
    if not shapes:
        return Shape(np.zeros((0, 3, 3)), np.zeros((0, 3, 3)))
    return Shape(np.concatenate([x.corners for x in shapes]), np.concatenate([x.normals for x in shapes]))


def make_shape(solid: Solid, meshes: Sequence[Mesh]) -> Shape:
    """Make the shape of a solid in its own axes."""
    size = np.array(solid.size)
    match solid.kind:
        case Kind.BOX:
            return make_box(solid.size)
        case Kind.ELLIPSOID:
            return make_ball().placed(np.eye(3), np.zeros(3), size / 2)
        case Kind.CYLINDER:
            shape = make_drum()
            return shape.placed(np.eye(3), np.zeros(3), np.array([size[0] / 2, size[1] / 2, size[2]]))
        case Kind.MESH:
            assert solid.mesh is not None
            return smooth(meshes[solid.mesh]).placed(np.eye(3), np.zeros(3), size)


def _sweep(rows: Sequence[tuple[float, float, float, float]], sides: int) -> Shape:
    """Return a solid of revolution about z: rows of radius, z, and the normal's radius and z."""
    angles = 2 * np.pi * np.arange(sides + 1) / sides
    c, s, one = np.cos(angles), np.sin(angles), np.ones(sides + 1)
    points = np.array([np.stack((r * c, r * s, z * one), 1) for r, z, _, _ in rows])
    normals = np.array([np.stack((n * c, n * s, m * one), 1) for _, _, n, m in rows])

    def cover(x: Array) -> Array:
        a, b, d, e = x[:-1, :-1], x[:-1, 1:], x[1:, 1:], x[1:, :-1]
        both = np.stack((np.stack((a, b, d), 2), np.stack((a, d, e), 2)))
        return both.reshape(-1, 3, 3)

    corners, shades = cover(points), cover(normals)
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    return Shape(corners[areas > 1e-12], shades[areas > 1e-12])


@cache
def make_ball() -> Shape:
    """Return a ball of radius 1."""
    angles = np.linspace(-np.pi / 2, np.pi / 2, 10)
    return _sweep([(float(np.cos(t)), float(np.sin(t)), float(np.cos(t)), float(np.sin(t))) for t in angles], 18)


@cache
def make_tube() -> Shape:
    """Return a tube of radius 1, from z = 0 to z = 1."""
    return _sweep([(1, 0, 1, 0), (1, 1, 1, 0)], 10)


@cache
def make_cone() -> Shape:
    """Return a cone of radius 1, from its foot at z = 0 to its tip at z = 1."""
    return _sweep([(0, 0, 0, -1), (1, 0, 0, -1), (1, 0, 0.9, 0.4), (0, 1, 0.9, 0.4)], 14)


@cache
def make_drum() -> Shape:
    """Return a cylinder of radius 1 and length 1 about the origin."""
    return _sweep(
        [(0, -0.5, 0, -1), (1, -0.5, 0, -1), (1, -0.5, 1, 0), (1, 0.5, 1, 0), (1, 0.5, 0, 1), (0, 0.5, 0, 1)], 28
    )


@lru_cache(maxsize=256)
def make_box(edges: tuple[float, float, float]) -> Shape:
    """Return a box with round edges, about the origin."""
    half = np.array(edges) / 2
    radius = ROUNDING * float(half.min())
    inner, steps = half - radius, [(-1.0, 0.0), (-1.0, 1.0), (1.0, 1.0), (1.0, 0.0)]  # side; 1: on the flat part
    corners, normals = [], []
    for axis in range(3):
        for sign in (-1.0, 1.0):
            grid = [[_corner(axis, sign, u, v, inner, radius) for v in steps] for u in steps]
            for a in range(3):
                for b in range(3):
                    quad = grid[a][b], grid[a + 1][b], grid[a + 1][b + 1], grid[a][b + 1]
                    for pick in ((0, 1, 2), (0, 2, 3)):
                        corners.append([quad[i][0] for i in pick])
                        normals.append([quad[i][1] for i in pick])
    return Shape(np.array(corners), np.array(normals))


def _corner(
    axis: int, sign: float, u: tuple[float, float], v: tuple[float, float], inner: Array, radius: float
) -> tuple[Array, Array]:
    """Return a point of a face's grid, moved onto the rounding, and its normal."""
    way, base = np.zeros(3), np.zeros(3)
    way[axis], base[axis] = sign, sign * inner[axis]
    for offset, (side, flat) in ((1, u), (2, v)):
        i = (axis + offset) % 3
        way[i], base[i] = side * (1 - flat), side * inner[i]
    normal = way / np.linalg.norm(way)
    return base + radius * normal, normal


@lru_cache(maxsize=64)
def smooth(mesh: Mesh) -> Shape:
    """Return a mesh with normals that are averaged over faces which meet at small angles."""
    corners = mesh.vertices.astype(float)[mesh.faces]
    areas = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(areas, axis=1, keepdims=True)
    own = areas / np.where(lengths > 0, lengths, 1.0)
    sums = np.zeros((len(mesh.vertices), 3))
    for k in range(3):
        np.add.at(sums, mesh.faces[:, k], areas)
    shared = sums / np.maximum(np.linalg.norm(sums, axis=1, keepdims=True), 1e-30)
    normals = shared[mesh.faces]
    is_smooth = np.einsum("tkc,tc->tk", normals, own) > CREASE
    return Shape(corners, np.where(is_smooth[:, :, None], normals, own[:, None]))


def point_along(way: Array) -> Array:
    """Return a rotation, by its columns, the third of which is a unit vector."""
    x = np.cross(way, [1.0, 0.0, 0.0] if abs(way[0]) < 0.6 else [0.0, 1.0, 0.0])
    x /= np.linalg.norm(x)
    return np.stack((x, np.cross(way, x), way), axis=1)


def make_stick(a: Array, b: Array, radius: float) -> Shape:
    """Return a tube between two points; nothing between equal ones."""
    length = float(np.linalg.norm(b - a))
    if length < 1e-12:
        return join([])
    return make_tube().placed(point_along((b - a) / length), a, np.array([radius, radius, length]))


def make_bead(at: Array, radius: float) -> Shape:
    """Return a ball."""
    return make_ball().placed(np.eye(3), at, np.full(3, radius))
