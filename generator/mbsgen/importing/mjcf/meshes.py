"""The meshes of MJCF -> solids, and shapes that are fitted to them.

Vertices and faces are in the file, or in a file in STL, OBJ or MSH that it names. A shape fitted to a mesh lies along
the principal axes of the mesh's solid, the last one along the longest, and has the extents of the box of the same
inertia; with `fitaabb`, it has the extents of the smallest box along these axes that holds all corners. Where the
products of inertia are 0, equal axes are the axes of the mesh, in their order; else MuJoCo's rounding decides.

Source: MuJoCo 4.0, XML reference, `asset/mesh`, `geom/mesh`, and its compiler's sizes of fitted shapes.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path, PurePosixPath

import numpy as np

from mbsgen.documents import abbreviate, nearest
from mbsgen.importing.findings import Findings
from mbsgen.importing.markup import Element
from mbsgen.importing.mjcf.geoms import Assets
from mbsgen.importing.mjcf.inheritance import MAIN, find_file
from mbsgen.importing.mjcf.mesh_solids import (
    FORMATS,
    MEDIA,
    RULES,
    Faces,
    MeshError,
    Rule,
    enclose,
    measure,
    read_triangles,
)
from mbsgen.importing.poses import Array, Pose
from mbsgen.importing.rotations import turn_quaternion
from mbsgen.importing.solids import Solid

MAX_NUMBERS = 3_000_000
ALIKE = 1e-5  # of two extents: MuJoCo's corners have single precision
EQUAL = 1e-12  # of the largest moment of inertia: the rounding of double precision
INERTIAL = "give the body an <inertial>"


class Meshes:
    """The solids of a file's meshes, each measured once."""

    def __init__(
        self, assets: Assets, compiler: Mapping[str, str], top: Element, root: Path | None, findings: Findings
    ) -> None:
        self._assets = assets
        self._folder = Path(top.file).parent
        self._root = (self._folder if root is None else root).resolve()
        self._usual: Rule = "exact" if compiler.get("exactmeshinertia") == "true" else "legacy"
        self._is_bounded = compiler.get("fitaabb") == "true"
        self._findings = findings
        self._known: dict[str, Solid] = {}

    def weigh(self, name: str, mass: float | None, density: float) -> Solid:
        """Return the solid of a mesh in its own frame, of a mass or a density. Raises MeshError."""
        unit = self._look_up(name)
        return unit.scaled(density if mass is None else mass / unit.mass)

    def enclose(self, name: str) -> Array:
        """Return the corners of a mesh's convex hull, in its own frame (k, 3). Raises MeshError."""
        _, corners = self._measure(name)
        _, faces = enclose(corners)
        return corners[np.unique(faces)]

    def fit(self, name: str, shape: str, scale: float) -> tuple[list[float], Pose]:
        """Return the sizes of a shape fitted to a mesh, and its pose in the mesh's frame. Raises MeshError."""
        unit = self._look_up(name)
        moments, axes = np.linalg.eigh(unit.inertia)
        moments, axes = moments[::-1], axes[:, ::-1]
        a, b, c = np.sqrt(np.maximum(1.5 * (moments.sum() - 2 * moments) / unit.mass, 0.0))
        is_long = shape in ("capsule", "cylinder")
        if (is_long and c - b < ALIKE * c) or (self._is_bounded and min(b - a, c - b) < ALIKE * c):
            axes = self._find_equal_axes(name, shape)
        axes = axes * np.linalg.det(axes)
        middle = np.zeros(3)
        if self._is_bounded:
            rounded, corners = self._measure(name, is_rounded=True)
            seen = (corners - rounded.com) @ axes
            a, b, c = np.ptp(seen, axis=0) / 2
            middle = (seen.min(axis=0) + seen.max(axis=0)) / 2
            width, least = max(a, b), max(a, b, c)
            rounding = width
        else:
            width, least, rounding = (a + b) / 2, (a + b + c) / 3, (a + b) / 4
        sizes = {"sphere": (least,), "capsule": (width, max(0.0, c - rounding)), "cylinder": (width, c)}.get(
            shape, (a, b, c)
        )
        return [scale * float(size) for size in sizes], Pose(axes, unit.com + axes @ middle)

    def _find_equal_axes(self, name: str, shape: str) -> Array:
        """Return the axes of a mesh with equal ones, in MuJoCo's order. Raises MeshError where its rounding decides."""
        tensor = self._measure(name, is_rounded=True)[0].inertia
        moments = np.diag(tensor)
        unit = EQUAL * float(moments.max())
        if np.abs(tensor - np.diag(moments)).max() > unit:
            text = (
                f"the mesh {abbreviate(name)} has equal axes: by which of them a {shape} is fitted is MuJoCo's rounding"
            )
            raise MeshError(text, f"give the {shape} a size and a pose instead of a mesh, or the body an <inertial>")
        axes: Array = np.eye(3)[:, np.argsort(-np.rint(moments / unit), kind="stable")]
        return axes

    def _look_up(self, name: str) -> Solid:
        if name not in self._known:
            self._known[name], _ = self._measure(name)
        return self._known[name]

    def _measure(self, name: str, *, is_rounded: bool = False) -> tuple[Solid, Array]:
        """Return the solid of unit density, and the corners; MuJoCo rounds corners to single precision."""
        element = self._assets.meshes.get(name)
        if element is None:
            meant = nearest(name, list(self._assets.meshes))
            remedy = f"did you mean {abbreviate(meant)}?" if meant else "define it under <asset>"
            raise MeshError(f"there is no mesh {abbreviate(name)}", remedy)
        attributes = self._assets.defaults.resolve(element, MAIN)
        rule = next((rule for rule in RULES if rule == attributes.get("inertia", self._usual)), None)
        if rule is None:
            raise MeshError(f"inertia is {abbreviate(attributes['inertia'])}", f"give {', '.join(RULES)}")
        if "builtin" in attributes or element.first("plugin") is not None:
            raise MeshError("the inertia of a mesh that MuJoCo makes is not computed here", INERTIAL)
        corners, faces = self._read(element, attributes)
        is_hull = rule == "convex" or not len(faces)
        if is_hull and self._findings.number(element, "maxhullvert", -1.0, attributes) > 0:
            remedy = "take maxhullvert away, or give the body an <inertial>"
            raise MeshError("the inertia of a hull of fewer corners is not computed here", remedy)
        corners = corners.astype(np.float32).astype(float) if is_rounded else corners
        corners, mirrored = self._place(element, attributes, corners)
        if not len(faces):
            corners, faces = enclose(corners)
        elif mirrored:
            faces = faces[:, ::-1]
        return measure(corners, faces, rule), corners

    def _place(self, element: Element, attributes: Mapping[str, str], corners: Array) -> tuple[Array, bool]:
        """Move, turn, then scale corners, as MuJoCo does; the second result is whether they are mirrored."""
        read = self._findings.numbers
        scale = np.array(read(element, "scale", (1.0, 1.0, 1.0), attributes=attributes))
        position = np.array(read(element, "refpos", (0.0, 0.0, 0.0), attributes=attributes))
        quaternion = read(element, "refquat", (1.0, 0.0, 0.0, 0.0), attributes=attributes)
        if not scale.all() or not any(quaternion):
            raise MeshError("scale or refquat of the mesh is 0", "give other numbers")
        return (corners - position) @ turn_quaternion(quaternion) * scale, bool(np.prod(scale) < 0)

    def _read(self, element: Element, attributes: Mapping[str, str]) -> tuple[Array, Faces]:
        """Read corners and triangles; no triangles where the file leaves them to the convex hull. Raises MeshError."""
        if "file" in attributes:
            kind = self._find_kind(attributes)
            corners, faces, left_out = read_triangles(self._find(element, attributes["file"]), kind)
            if left_out:
                text = f"{left_out} faces of further objects are left out, as MuJoCo does"
                self._findings.tell(element, text)
            return corners, faces
        corners = _read_rows(attributes.get("vertex", ""), float)
        rows = _read_rows(attributes.get("face", ""), int)
        if len(corners) < 4:
            raise MeshError("the mesh has neither a file nor four vertices", "give one of these")
        return corners, rows.astype(np.int64)

    def _find_kind(self, attributes: Mapping[str, str]) -> str:
        suffix = PurePosixPath(attributes["file"]).suffix.lower()
        kind = MEDIA.get(attributes.get("content_type", ""), FORMATS.get(suffix))
        if kind is None:
            remedy = f"give {' or '.join(FORMATS)}, or an <inertial>"
            raise MeshError(
                f"the inertia of a mesh in {suffix or 'a file without a suffix'} is not computed here", remedy
            )
        return kind

    def _find(self, element: Element, given: str) -> Path:
        """Return the path of a mesh's file, below the folder of the model or the stated root. Raises MeshError.

        The path begins at the folder of meshes; where no such file is there, at the same place in that folder at which
        the file that defines the mesh is in the model's.
        """
        folder = self._folder / self._assets.folder
        if self._assets.stripped:
            path = find_file([folder], PurePosixPath(given).name)
        else:
            inner = os.path.relpath(Path(element.file).resolve().parent, self._folder.resolve())
            path = find_file((folder, folder / inner), given)
        if not path.is_relative_to(self._root):
            remedy = "put it there, or name a folder that holds all files: --root"
            raise MeshError(f"{abbreviate(given)} is not in the folder of the model", remedy)
        return path


def _read_rows(text: str, kind: type[float] | type[int]) -> Array:
    """Read rows of three numbers. Raises MeshError."""
    words = text.split()
    if len(words) > MAX_NUMBERS:
        raise MeshError(f"a mesh of {len(words)} numbers", f"give at most {MAX_NUMBERS}, or a file")
    try:
        numbers = np.array([kind(word) for word in words], dtype=float)
    except (ValueError, OverflowError):
        raise MeshError("vertices or faces of the mesh are no numbers", "mend them") from None
    if len(numbers) % 3 or not np.isfinite(numbers).all():
        raise MeshError("vertices or faces of the mesh are no rows of three numbers", "mend them")
    return numbers.reshape(-1, 3)
