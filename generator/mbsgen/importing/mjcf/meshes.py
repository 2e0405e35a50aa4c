"""The meshes of MJCF -> solids, and shapes that are fitted to them.

Vertices and faces are in the file, or in a file in STL, OBJ or MSH that it names. A shape fitted to a mesh lies along
the principal axes of the mesh's solid, the last one along the longest, and has the extents of the box of the same
inertia. Source: MuJoCo, XML reference, `asset/mesh`, `geom/mesh`.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path, PurePosixPath

import numpy as np

from mbsgen.documents import abbreviate, nearest
from mbsgen.importing.findings import Findings
from mbsgen.importing.markup import Element
from mbsgen.importing.mjcf.geoms import Assets
from mbsgen.importing.mjcf.inheritance import MAIN
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
from mbsgen.importing.solids import Solid
from mbsgen.model.orientations import turn_quaternion

MAX_NUMBERS = 3_000_000
ALIKE = 1e-5  # of two extents: MuJoCo's corners have single precision
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

    def fit(self, name: str, shape: str, scale: float) -> tuple[list[float], Pose]:
        """Return the sizes of a shape fitted to a mesh, and its pose in the mesh's frame. Raises MeshError."""
        if self._is_bounded:
            raise MeshError(f"a {shape} fitted to the box of a mesh (fitaabb) is not computed here", INERTIAL)
        unit = self._look_up(name)
        moments, axes = np.linalg.eigh(unit.inertia)
        moments, axes = moments[::-1], axes[:, ::-1] * np.linalg.det(axes[:, ::-1])
        a, b, c = np.sqrt(np.maximum(1.5 * (moments.sum() - 2 * moments) / unit.mass, 0.0))
        if shape in ("capsule", "cylinder") and c - b < ALIKE * c:
            text = f"the mesh {abbreviate(name)} has no longest axis, along which a {shape} could be fitted"
            raise MeshError(text, f"give the {shape} a size and a pose instead of a mesh, or the body an <inertial>")
        sizes = {
            "sphere": ((a + b + c) / 3,),
            "capsule": ((a + b) / 2, max(0.0, c - (a + b) / 4)),
            "cylinder": ((a + b) / 2, c),
        }.get(shape, (a, b, c))
        return [scale * float(size) for size in sizes], Pose(axes, unit.com)

    def _look_up(self, name: str) -> Solid:
        if name not in self._known:
            self._known[name] = self._measure(name)
        return self._known[name]

    def _measure(self, name: str) -> Solid:
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
        corners, mirrored = self._place(element, attributes, corners)
        if not len(faces):
            corners, faces = enclose(corners)
        elif mirrored:
            faces = faces[:, ::-1]
        return measure(corners, faces, rule)

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
            corners, faces, left_out = read_triangles(self._find(attributes["file"]), kind)
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

    def _find(self, given: str) -> Path:
        """Return the path of a mesh's file, below the folder of the model or the stated root. Raises MeshError."""
        name = PurePosixPath(given).name if self._assets.stripped else given
        try:
            path = (self._folder / self._assets.folder / name).resolve()
        except (OSError, ValueError, RuntimeError):
            path = Path("/")
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
