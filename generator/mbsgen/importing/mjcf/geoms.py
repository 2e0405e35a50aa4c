"""Geoms of MJCF as shapes that draw a body: sizes, colours, and the mesh files of assets.

Shown are the groups that MuJoCo's viewer shows, 0 to 2. Sizes in the file are halves of a shape's extents.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import PurePosixPath

from mbsgen.documents import abbreviate
from mbsgen.expressions import Number
from mbsgen.importing.findings import Findings
from mbsgen.importing.markup import Element
from mbsgen.importing.mjcf.inheritance import MAIN, Defaults
from mbsgen.importing.poses import Pose, Writer
from mbsgen.manifest import Shape
from mbsgen.model.file.visual_sections import MESHES, find_escape
from mbsgen.model.model import Visual

LAST_GROUP = 2  # that is shown
MOST = 500  # shapes of one body


class UndrawnError(Exception):
    """Raised for a geom that cannot be drawn, with the reason."""


@dataclass(frozen=True)
class Assets:
    """The meshes and the colours of a file, by name."""

    meshes: Mapping[str, Element]
    colors: Mapping[str, str]  # of materials
    folder: str  # of meshes, in the file's folder
    stripped: bool  # folders in the names of files do not count
    defaults: Defaults

    def find_mesh(self, name: str, findings: Findings) -> tuple[str, tuple[float, ...]]:
        """Find the file of a mesh, and its scale. Raises UndrawnError."""
        element = self.meshes.get(name)
        if element is None:
            raise UndrawnError(f"there is no mesh {abbreviate(name)}")
        attributes = self.defaults.resolve(element, MAIN)
        if "file" not in attributes:
            raise UndrawnError("its mesh has no file")
        if "refpos" in attributes or "refquat" in attributes:
            raise UndrawnError("its mesh has refpos or refquat")
        given = PurePosixPath(attributes["file"])
        file = (PurePosixPath(self.folder) / (given.name if self.stripped else given)).as_posix()
        if find_escape(file):
            raise UndrawnError(f"{abbreviate(file)} leads out of the file's folder")
        if given.suffix.lower() not in MESHES:
            raise UndrawnError(f"{abbreviate(file)} is none of {', '.join(MESHES)}")
        scale = findings.numbers(element, "scale", (1.0, 1.0, 1.0), attributes=attributes)
        if not all(scale):
            raise UndrawnError("the scale of its mesh is 0")
        return file, scale


def read_assets(root: Element, settings: Mapping[str, str], defaults: Defaults, findings: Findings) -> Assets:
    """Read the assets of a file; `settings` are its compiler's."""
    every = [x for section in root.all("asset") for x in section.children]
    colors = {}
    for material in (x for x in every if x.tag == "material"):
        attributes = defaults.resolve(material, MAIN)
        colors[attributes.get("name", "")] = read_color(material, attributes, findings) or ""
    meshes = {_name_mesh(x): x for x in every if x.tag == "mesh"}
    folder = settings.get("meshdir", settings.get("assetdir", ""))
    return Assets(meshes, colors, folder, settings.get("strippath") == "true", defaults)


def _name_mesh(mesh: Element) -> str:
    return mesh.attributes.get("name") or PurePosixPath(mesh.attributes.get("file", "")).stem


def read_color(element: Element, attributes: Mapping[str, str], findings: Findings) -> str | None:
    """Read a colour; None for one that is not given, empty for one that is invisible."""
    if "rgba" not in attributes:
        return None
    *rgb, alpha = findings.numbers(element, "rgba", (0.5, 0.5, 0.5, 1.0), attributes=attributes)
    return "#" + "".join(f"{round(255 * min(max(x, 0.0), 1.0)):02x}" for x in rgb) if alpha > 0 else ""


def scale_shape(shape: str, half: Sequence[float]) -> tuple[Shape, tuple[float, ...]]:
    """Convert the sizes of a geom to the sizes of a model file. Raises UndrawnError."""
    if min(half) <= 0:
        raise UndrawnError("its size is not above 0")
    match shape:
        case "box" | "ellipsoid":
            return shape, tuple(2 * x for x in half)
        case "sphere":
            return "sphere", tuple(half)
        case "cylinder" | "capsule":
            return shape, (half[0], 2 * half[1])
    raise AssertionError(shape)


def make_visual(
    shape: Shape, size: Sequence[float], pose: Pose, quarter_turns: float, color: str, file: str = ""
) -> Visual:
    """Make a shape of a body, at a pose in the body's frame."""
    placement = Writer(quarter_turns).placement(pose)
    return Visual(shape, tuple(Number(float(x)) for x in size), placement, color, file)
