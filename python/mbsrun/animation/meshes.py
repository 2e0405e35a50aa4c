"""Meshes of untrusted files: STL, OBJ and glTF -> triangles, by trimesh.

A file is read as bytes of limited size, and nothing that it names is opened. Its triangles are scaled into the unit
cube; the size and the place of the solid bring them back. Too many triangles are thinned: vertices in one cell of a
grid become one (Rossignac, Borrel, Multi-resolution 3D approximations for rendering complex scenes, 1993).
"""

from __future__ import annotations

import importlib
import io
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mbsgen.errors import Fault, InputError
from mbsrun.animation.film import Mesh

Array = NDArray[np.float64]

FORMATS = (".stl", ".obj", ".glb", ".gltf", ".ply")
MAX_BYTES = 100_000_000
MAX_FACES = 2_000_000
SHOWN = 20_000  # faces of a mesh in a picture
PACKAGE = "package://"


@dataclass(frozen=True, eq=False)
class Body:
    """A mesh within the unit cube, and the box that it fills."""

    mesh: Mesh
    centre: Array  # (3,) [m]
    edges: Array  # (3,) [m]


def read_mesh(path: Path) -> Body:
    """Read a mesh. Raises InputError for a file that is too large or no mesh, or without the package trimesh."""
    vertices, faces = _load(path)
    if len(faces) > SHOWN:
        vertices, faces = thin(vertices, faces, SHOWN)
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    edges = np.maximum(high - low, 1e-9 * max(float((high - low).max()), 1e-9))
    unit = (vertices - (low + high) / 2) / edges
    return Body(Mesh(unit.astype(np.float32), faces.astype(np.uint32)), (low + high) / 2, edges)


def mirror(body: Body, signs: Array) -> Body:
    """Return a mesh with the signs of some coordinates changed; its faces still show their outer side."""
    faces = body.mesh.faces[:, ::-1] if np.prod(signs) < 0 else body.mesh.faces
    vertices = (body.mesh.vertices * signs).astype(np.float32)
    return Body(Mesh(vertices, np.ascontiguousarray(faces)), body.centre * signs, body.edges)


def find_mesh(name: str, folder: Path, packages: tuple[Path, ...]) -> Path:
    """Find the file of a mesh that a description names: below its folder, or below the folder of a package.

    Raises InputError for a name that leads elsewhere, or to no file.
    """
    if name.startswith(PACKAGE):
        package, _, rest = name.removeprefix(PACKAGE).partition("/")
        places = [(root, root / rest) for root in packages if root.resolve().name == package]
        places += [(root, root / package / rest) for root in packages]
        remedy = f"give the folder of the package {package[:60]}, or the one above it, by --package"
    elif "://" in name:
        raise _refuse(folder, f"the mesh {name[:80]} is no file of the description", "name it relative to its folder")
    else:
        places, remedy = [(root, root / name) for root in (folder, *packages)], "check the name, or give --package"
    inside = [path.resolve() for root, path in places if path.resolve().is_relative_to(root.resolve())]
    found = next((path for path in inside if path.is_file()), None)
    if found is None and len(inside) < len(places):
        raise _refuse(folder, f"the mesh {name[:80]} lies outside of the given folders", "name a file below them")
    if found is None:
        raise _refuse(folder, f"there is no mesh {name[:80]}", remedy)
    return found


def thin(vertices: Array, faces: NDArray[np.int64], most: int) -> tuple[Array, NDArray[np.int64]]:
    """Merge vertices cell by cell of a grid, until no more than some faces are left."""
    low, span = vertices.min(axis=0), float(np.ptp(vertices, axis=0).max()) or 1.0
    cells = int(np.sqrt(most))
    while True:
        _, cell = np.unique(np.floor((vertices - low) / span * cells).astype(np.int64), axis=0, return_inverse=True)
        cell = cell.reshape(-1)
        counts = np.bincount(cell)
        merged = np.stack([np.bincount(cell, vertices[:, k]) / counts for k in range(3)], axis=1)
        corners = cell[faces]
        apart = (np.diff(np.sort(corners, axis=1), axis=1) > 0).all(axis=1)
        kept = corners[apart]
        if len(kept) <= most or cells <= 4:
            return merged, kept[:most]
        cells = int(0.8 * cells)


def _load(path: Path) -> tuple[Array, NDArray[np.int64]]:
    if path.suffix.lower() not in FORMATS:
        raise _refuse(path, f"found {path.suffix or 'nothing'} at the end of its name", f"give {', '.join(FORMATS)}")
    try:
        trimesh = importlib.import_module("trimesh")
    except ImportError:
        remedy = "run in the folder of the project: pip install '.[mesh]'"
        raise _refuse(path, "trimesh, which reads meshes, is missing", remedy) from None
    try:
        size = path.stat().st_size
        content = path.read_bytes() if size <= MAX_BYTES else b""
    except OSError as error:
        raise _refuse(path, f"cannot be read: {error.strerror}", "check the path") from None
    if size > MAX_BYTES:
        raise _refuse(path, f"it has {size} bytes", f"give a mesh of at most {MAX_BYTES}, decimated in another program")
    more = {"skip_materials": True} if path.suffix.lower() == ".obj" else {}
    try:
        mesh = trimesh.load(io.BytesIO(content), file_type=path.suffix.lower()[1:], force="mesh", **more)
        vertices, faces = np.asarray(mesh.vertices, dtype=float), np.asarray(mesh.faces, dtype=np.int64)
    except Exception as error:  # readers of untrusted files fail in any way
        told = str(error).splitlines() or [type(error).__name__]
        raise _refuse(path, f"it cannot be read as a mesh: {told[0][:120]}", "export it again") from None
    if not len(faces) or not np.isfinite(vertices).all() or faces.min() < 0 or faces.max() >= len(vertices):
        raise _refuse(path, "it holds no triangles with finite corners", "export it again")
    if len(faces) > MAX_FACES:
        raise _refuse(path, f"it has {len(faces)} faces", f"give a mesh of at most {MAX_FACES}")
    return vertices, faces


def _refuse(path: Path, finding: str, remedy: str) -> InputError:
    return InputError([Fault(str(path), 0, "", finding, remedy)])
