"""Pairs of solids in rigid contact, as `csrc/mbs_solids.c` takes them; their distances along a motion."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbsgen.manifest import Manifest, RigidPair, Solid
from mbsrun.kernel import Kernels
from mbsrun.simulation.memory import load_functions

Array = NDArray[np.float64]

FLAT = 1e-9  # of the size: triangles whose corners are as near to one plane are one face
ROUND = 16  # points at most of a pair of which one solid is round

CDEF = """
typedef struct {
    long long points, faces, edges;
    double radius;
    const double *point;
    const long long *corner, *start;
    const double *normal;
    const long long *edge;
} mbs_solid;
typedef struct { double gap, at[3], normal[3]; } mbs_spot;
long long mbs_solids_reals(const mbs_solid *first, const mbs_solid *other);
long long mbs_solids_meet(const mbs_solid *first, const double *place_first, const double *axes_first,
                          const mbs_solid *other, const double *place_other, const double *axes_other,
                          long long most, mbs_spot *spots, double *reals);
void mbs_solids_distance(const mbs_solid *first, const double *place_first, const double *axes_first,
                         const mbs_solid *other, const double *place_other, const double *axes_other,
                         mbs_spot *nearest, double *reals);
"""


@dataclass(frozen=True)
class Shape:
    """A convex hull: its corners, faces and edges."""

    points: Array  # (P, 3) [m]
    faces: tuple[tuple[int, ...], ...]  # corners of each, counterclockwise seen from outside
    normals: Array  # (F, 3)
    edges: tuple[tuple[int, int, int, int], ...]  # two corners and the faces on both sides; -1: none
    radius: float


def make_shape(solid: Solid) -> Shape:
    """Find the faces and the edges of a solid."""
    points = np.array(solid.points)
    if len(points) <= 2:
        return Shape(points, (), np.zeros((0, 3)), ((0, 1, -1, -1),) * (len(points) - 1), solid.radius)
    from scipy.spatial import ConvexHull  # here: it takes long to load, and few simulations need it

    hull = ConvexHull(points)
    used = np.unique(hull.simplices)
    kept, size = points[used], float(np.abs(points - points.mean(axis=0)).max())
    planes = list[Array]()
    for plane in hull.equations[np.lexsort(hull.equations.T[::-1])]:
        if not any(_is_same(plane, other, kept, size) for other in planes):
            planes.append(plane)
    faces, normals = zip(*(_go_around(plane, kept, size) for plane in planes), strict=True)
    sides = {pair: k for k, face in enumerate(faces) for pair in pairwise((*face, face[0]))}
    edges = tuple((a, b, k, sides[b, a]) for (a, b), k in sides.items() if a < b)
    return Shape(kept, faces, np.array(normals), edges, solid.radius)


def _is_same(plane: Array, other: Array, points: Array, size: float) -> bool:
    """Return whether two planes of a hull have the same corners in them."""
    near = np.abs(points @ plane[:3] + plane[3]) <= FLAT * size
    return bool((np.abs(points[near] @ other[:3] + other[3]) <= FLAT * size).all())


def _go_around(plane: Array, points: Array, size: float) -> tuple[tuple[int, ...], Array]:
    """List the corners in a plane around its outward normal; return a normal of length 1, too."""
    near = np.flatnonzero(np.abs(points @ plane[:3] + plane[3]) <= FLAT * size)
    middle, normal = points[near].mean(axis=0), plane[:3]
    x = points[near[0]] - middle
    angles = np.arctan2((points[near] - middle) @ np.cross(normal, x), (points[near] - middle) @ x)
    face = near[np.argsort(angles, kind="stable")]
    area = sum((np.cross(points[a] - middle, points[b] - middle) for a, b in pairwise((*face, face[0]))), np.zeros(3))
    return tuple(map(int, face)), area / np.linalg.norm(area)


class Pairs:
    """The pairs of solids of a model, laid out for C."""

    def __init__(self, pairs: Sequence[RigidPair], ffi: Any, lib: Any) -> None:
        """Take pairs, and functions that declare `CDEF`."""
        self.ffi, self.lib, self.kept = ffi, lib, list[Any]()
        shapes = [make_shape(solid) for pair in pairs for solid in (pair.first, pair.other)]
        self.solids = self._keep("mbs_solid[]", [self._lay(shape) for shape in shapes])
        self.slots = [self._count(*shapes[2 * k : 2 * k + 2]) for k in range(len(pairs))]  # points of each pair
        sizes = [lib.mbs_solids_reals(self.solids + 2 * k, self.solids + 2 * k + 1) for k in range(len(pairs))]
        self.room = max(sizes, default=0)

    def _count(self, first: Shape, other: Shape) -> int:
        if first.radius + other.radius > 0 or not (first.faces and other.faces):
            return ROUND
        return 1 + sum(max(map(len, shape.faces)) for shape in (first, other))

    def _keep(self, kind: str, values: Any) -> Any:
        self.kept.append(self.ffi.new(kind, values))
        return self.kept[-1]

    def _lay(self, shape: Shape) -> tuple[Any, ...]:
        corners = [k for face in shape.faces for k in face]
        starts = np.cumsum([0, *map(len, shape.faces)]).tolist()
        return (
            len(shape.points),
            len(shape.faces),
            len(shape.edges),
            shape.radius,
            self._keep("double[]", shape.points.ravel().tolist()),
            self._keep("long long[]", [*corners, 0]),
            self._keep("long long[]", starts),
            self._keep("double[]", [*shape.normals.ravel().tolist(), 0.0]),
            self._keep("long long[]", [*(x for edge in shape.edges for x in edge), 0]),
        )

    def measure(self, places: Array, axes: Array) -> tuple[Array, Array]:
        """Return distances (K, pairs), below 0 inside, and normals (K, pairs, 3) at poses.

        `places` (K, 3, 2 pairs) and `axes` (K, 3, 6 pairs) are the results of the kernel `meetings`.
        """
        reals, nearest = np.empty(self.room + 1), self.ffi.new("mbs_spot *")
        distances, normals = np.empty((len(places), len(self.slots))), np.empty((len(places), len(self.slots), 3))
        for i, (place, turn) in enumerate(zip(places, axes, strict=True)):
            p, R = np.ascontiguousarray(place.T), np.ascontiguousarray(turn.T)
            for k in range(len(self.slots)):
                sides = [
                    x for j in (2 * k, 2 * k + 1) for x in (self.solids + j, self.point(p[j:]), self.point(R[3 * j :]))
                ]
                self.lib.mbs_solids_distance(*sides, nearest, self.point(reals))
                distances[i, k], normals[i, k] = nearest.gap, list(nearest.normal)
        return distances, normals

    def point(self, array: Array) -> Any:
        """Return a pointer to an array."""
        return self.ffi.cast("double *", array.ctypes.data)


def list_pairs(manifest: Manifest) -> Iterator[tuple[str, int]]:
    """Yield the names of the pairs of a model, each with its number."""
    yield from ((pair.name, k) for k, pair in enumerate(manifest.meetings))


def measure_pairs(kernels: Kernels, q: Array) -> tuple[Array, Array]:
    """Return distances (K, pairs) and normals (K, pairs, 3) of all pairs of solids at poses q (K, nq)."""
    found = kernels("meetings", q=q)
    pairs = Pairs(kernels.manifest.meetings, *load_functions(CDEF, "mbs_solids.c"))
    return pairs.measure(found["place"], found["axes"])
