"""A triangulated surface -> the solid that it bounds, or that it is, by the four rules of MuJoCo.

Pyramids join each triangle to a point; their volumes are signed by the side on which the point lies.

- exact: the sum of the signed pyramids, which the point does not change where the surface is closed.
- legacy: the sum of the pyramids without their signs, so that what is not convex weighs more. The centre of mass comes
  from pyramids at the centroid of the surface, mass and inertia from pyramids at this centre of mass.
- convex: the convex hull, exactly.
- shell: the triangles themselves, of uniform density per area.

Sources: MuJoCo, XML reference, `asset/mesh`; the integrals of a simplex by its corners: Tonon, Explicit exact formulas
for the 3-D tetrahedron inertia tensor, 2004. Files are untrusted: trimesh reads STL from bytes of limited size, and
`obj_files` reads OBJ. An MSH file, MuJoCo's own, holds four counts, then corners, normals and texture coordinates in
single precision, and triangles: all numbers have four bytes, in the order of the machines that MuJoCo runs on.
"""

from __future__ import annotations

import importlib
import io
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from mbsgen.documents import read_bytes
from mbsgen.errors import InputError
from mbsgen.importing.mjcf.obj_files import ObjError, read_obj
from mbsgen.importing.poses import Array
from mbsgen.importing.solids import Solid

Rule = Literal["legacy", "exact", "convex", "shell"]
Faces = NDArray[np.int64]

RULES: tuple[Rule, ...] = ("legacy", "exact", "convex", "shell")
FORMATS = {".stl": "stl", ".obj": "obj", ".msh": "msh"}
MEDIA = {"model/stl": "stl", "model/obj": "obj", "model/vnd.mujoco.msh": "msh"}
MAX_BYTES = 1 << 27
MAX_FACES = 2_000_000
LEAST = 1e-14  # MuJoCo's least volume [m3]


class MeshError(Exception):
    """Raised for a mesh without a solid."""

    def __init__(self, finding: str, remedy: str) -> None:
        self.finding = finding
        self.remedy = remedy
        super().__init__(finding)


def read_triangles(path: Path, kind: str) -> tuple[Array, Faces, int]:
    """Read the corners and the triangles of a file of this kind, and the number of its faces that do not count.

    Raises MeshError.
    """
    try:
        content = read_bytes(path, MAX_BYTES)
    except InputError as error:
        fault = error.faults[0]
        raise MeshError(f"the mesh {path.name}: {fault.finding}", fault.remedy) from None
    left_out = 0
    if kind == "obj":
        corners, faces, left_out = _read_obj(content, path.name)
    else:
        corners, faces = (_read_msh if kind == "msh" else _read_stl)(content, path.name)
    if len(faces) > MAX_FACES:
        raise MeshError(f"{path.name} has {len(faces)} triangles", f"give at most {MAX_FACES}, or an <inertial>")
    return corners, faces, left_out


def _read_obj(content: bytes, name: str) -> tuple[Array, Faces, int]:
    try:
        file = read_obj(content)
        return file.places, file.triangulate(), file.left_out
    except ObjError as error:
        raise MeshError(f"{name} cannot be read as a mesh: {error}", "export it again, in triangles") from None


def _read_msh(content: bytes, name: str) -> tuple[Array, Faces]:
    counts = np.frombuffer(content[:16], "<i4") if len(content) >= 16 else np.zeros(4, np.int32)
    corners, normals, textures, faces = map(int, counts)
    fits = corners > 3 and faces >= 0 and normals in (0, corners) and textures in (0, corners)
    if not fits or len(content) != 16 + 4 * (3 * corners + 3 * normals + 2 * textures + 3 * faces):
        raise MeshError(f"{name} cannot be read as a mesh: its counts are of another size", "export it again")
    places = np.frombuffer(content, "<f4", 3 * corners, 16).astype(float)
    triangles = np.frombuffer(content, "<i4", 3 * faces, len(content) - 12 * faces).astype(np.int64)
    return places.reshape(-1, 3), triangles.reshape(-1, 3)


def _read_stl(content: bytes, name: str) -> tuple[Array, Faces]:
    trimesh = _find_trimesh(name)
    try:
        mesh = trimesh.load(io.BytesIO(content), file_type="stl", force="mesh", process=False)
        corners, faces = np.asarray(mesh.vertices, dtype=float), np.asarray(mesh.faces, dtype=np.int64)
    except Exception as error:  # readers of untrusted files fail in any way
        told = str(error).splitlines() or [type(error).__name__]
        raise MeshError(f"{name} cannot be read as a mesh: {told[0][:120]}", "export it again") from None
    if not len(faces):
        raise MeshError(f"{name} cannot be read as a mesh: it has no triangles", "export it again")
    corners, shared = np.unique(corners, axis=0, return_inverse=True)  # triangles of STL share no corners
    return corners, shared.reshape(-1)[faces]


def enclose(corners: Array) -> tuple[Array, Faces]:
    """Return the triangles of the convex hull, seen from outside. Raises MeshError for points in a plane."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        hull = ConvexHull(corners)
    except (QhullError, ValueError):
        raise MeshError("the points of the mesh enclose no volume", "give points that do, or an <inertial>") from None
    a, b, c = (corners[hull.simplices[:, k]] for k in range(3))
    inward = np.einsum("ij,ij->i", np.cross(b - a, c - a), hull.equations[:, :3]) < 0
    faces = np.where(inward[:, None], hull.simplices[:, ::-1], hull.simplices)
    return corners, faces.astype(np.int64)


def measure(corners: Array, faces: Faces, rule: Rule) -> Solid:
    """Return the solid of unit density: its mass is a volume [m3], of a shell an area [m2]. Raises MeshError."""
    if not len(faces) or not np.isfinite(corners).all() or faces.min() < 0 or faces.max() >= len(corners):
        raise MeshError("the mesh holds no triangles with finite corners", "mend it, or give an <inertial>")
    if rule == "convex":
        corners, faces = enclose(corners)
    if rule == "exact" and not _is_oriented(faces):
        remedy = "turn them to the outside, or use another rule (inertia), or give an <inertial>"
        raise MeshError("neighbouring triangles of the mesh show different sides", remedy)
    triangles = corners[faces]
    middles = triangles.mean(axis=1)
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]) / 2
    areas = np.linalg.norm(normals, axis=1)
    if not areas.sum() > 0:
        raise MeshError("the triangles of the mesh have no area", "mend it, or give an <inertial>")
    centroid = areas @ middles / areas.sum()
    if rule == "shell":
        return _gather(triangles - centroid, areas, 12, centroid)

    def measure_pyramids(point: Array) -> Array:
        volumes: Array = np.einsum("ij,ij->i", middles - point, normals) / 3
        return np.abs(volumes) if rule == "legacy" else volumes

    volumes = measure_pyramids(centroid)
    if not volumes.sum() > LEAST:
        remedy = "turn its triangles to the outside, or use another rule (inertia), or give an <inertial>"
        raise MeshError(f"the mesh has a volume of {volumes.sum():.3g} m3", remedy)
    com = centroid + 0.75 * (volumes @ (middles - centroid)) / volumes.sum()
    return _gather(triangles - com, measure_pyramids(com), 20, com)


def _gather(triangles: Array, weights: Array, divisor: int, com: Array) -> Solid:
    """Sum second moments of triangles (divisor 12), or of pyramids between these and the origin (divisor 20).

    Of corners a, b, c the second moment is weight/divisor (a aT + b bT + c cT + s sT), with their sum s.
    """
    points = np.concatenate([triangles, triangles.sum(axis=1, keepdims=True)], axis=1)
    second = np.einsum("i,ijk,ijl->kl", weights, points, points) / divisor
    return Solid(float(weights.sum()), com, np.trace(second) * np.eye(3) - second)


def _is_oriented(faces: Faces) -> bool:
    """Return whether no two triangles pass through an edge in the same direction."""
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    return len(np.unique(edges, axis=0)) == len(edges)


def _find_trimesh(name: str) -> Any:
    try:
        return importlib.import_module("trimesh")
    except ImportError:
        remedy = "install it, pip install trimesh, or give the body an <inertial>"
        raise MeshError(f"trimesh, which reads {name}, is missing", remedy) from None
