"""Files of OBJ -> corners and triangles of their first object, which is the one that MuJoCo reads.

A line `o` or `g` with a name, after a face, begins the next object; all objects share their corners. A quadrangle is
cut along its shorter diagonal, a polygon of more corners from the first one. Materials, normals and textures are
skipped, and no other file is opened.

Source: Wavefront, Object Files (.obj), appendix B1; MuJoCo, XML reference, `asset/mesh`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from mbsgen.importing.poses import Array

OTHERS = ("l", "p")  # elements of an object that have no area


class ObjError(Exception):
    """Raised for a text that is no OBJ file, with the reason."""


@dataclass
class ObjFile:
    """A file of OBJ."""

    corners: list[tuple[float, float, float]] = field(default_factory=list)
    polygons: list[tuple[int, ...]] = field(default_factory=list)  # of the first object, by corners from 0
    left_out: int = 0  # polygons of further objects

    @property
    def places(self) -> Array:
        """Return the corners as rows."""
        return np.array(self.corners, dtype=float).reshape(-1, 3)

    def triangulate(self) -> NDArray[np.int64]:
        """Cut the polygons of the first object into triangles. Raises ObjError."""
        places = self.places
        found = [triangle for polygon in self.polygons for triangle in _cut(polygon, places)]
        return np.array(found, dtype=np.int64).reshape(-1, 3)


def read_obj(content: bytes) -> ObjFile:
    """Read the text of an OBJ file. Raises ObjError."""
    found, has_begun, is_first = ObjFile(), False, True
    for number, line in enumerate(content.decode("utf-8", "replace").splitlines(), 1):
        word, *rest = line.partition("#")[0].split() or [""]
        if line.endswith("\\"):
            raise ObjError(f"line {number} continues in the next line, which MuJoCo does not read")
        try:
            if word == "v":
                x, y, z = map(float, rest[:3])
                found.corners.append((x, y, z))
            elif word in ("o", "g") and line.lstrip()[1:2].isspace():
                is_first = is_first and not has_begun
            elif word in ("f", *OTHERS):
                has_begun = True
                polygon = tuple(_count(token, len(found.corners)) for token in rest) if word == "f" else ()
                if len(polygon) > 2 and is_first:
                    found.polygons.append(polygon)
                else:
                    found.left_out += word == "f"
        except ValueError:
            raise ObjError(f"line {number} is not a line of an OBJ file") from None
    return found


def _count(token: str, corners: int) -> int:
    """Return the number of a corner from 0; negative ones count back from the last corner so far."""
    number = int(token.split("/")[0])
    return number - 1 if number > 0 else corners + number


def _cut(polygon: Sequence[int], places: Array) -> Iterator[tuple[int, int, int]]:
    if not all(0 <= i < len(places) for i in polygon):
        raise ObjError("a face has a corner that does not exist")
    first, *others = polygon
    if len(polygon) == 4:
        points = places[list(polygon)].astype(np.float32)  # as MuJoCo's reader has them
        diagonals = [float(np.square(points[k + 2] - points[k]).sum(dtype=np.float32)) for k in (0, 1)]
        if not diagonals[0] < diagonals[1]:
            first, *others = *polygon[1:], polygon[0]
    elif len(polygon) > 4 and not _is_convex(places[list(polygon)]):
        raise ObjError(f"a face of {len(polygon)} corners is not convex")
    yield from ((first, a, b) for a, b in pairwise(others))


def _is_convex(points: Array) -> bool:
    edges = np.roll(points, -1, axis=0) - points
    turns = np.cross(edges, np.roll(edges, -1, axis=0))
    return bool((turns @ turns.sum(axis=0) >= 0).all())
