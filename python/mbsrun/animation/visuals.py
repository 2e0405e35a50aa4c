"""Visuals: shapes and meshes of bodies, from the model, a URDF file or one by one, in the axes of their bodies."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from xml.etree.ElementTree import Element, TreeBuilder
from xml.parsers import expat

import numpy as np
from numpy.typing import NDArray

from mbsgen.errors import Fault, InputError
from mbsgen.manifest import Manifest, Shape
from mbsrun.animation.film import Kind
from mbsrun.animation.meshes import Body, find_mesh, mirror, read_mesh

Array = NDArray[np.float64]

MAX_BYTES = 20_000_000  # of a URDF file
GREY = "#aab4c0"


@dataclass(frozen=True, eq=False)
class Visual:
    """A shape that is fixed in a body of the model."""

    body: str
    kind: Kind
    size: Array  # (3,), as of a solid
    at: Array  # (3,) of its centre, in the body's frame [m]
    axes: Array  # (3, 3), columns
    color: str = GREY  # empty: one of the palette
    mesh: Body | None = None


def show_mesh(body: str, mesh: Body, at: Array, axes: Array, scale: Array, color: str = GREY) -> Visual:
    """Place a mesh whose file has its origin at a point of the body; negative scales mirror it."""
    signs, scale = np.sign(scale), np.abs(scale)
    if (signs < 0).any():
        mesh = mirror(mesh, signs)
    return Visual(body, Kind.MESH, mesh.edges * scale, at + axes @ (mesh.centre * scale), axes, color, mesh)


def give_mesh(body: str, path: Path) -> Visual:
    """Read the mesh of a body, in the body's own frame."""
    return show_mesh(body, read_mesh(path), np.zeros(3), np.eye(3), np.ones(3))


def show_shape(body: str, shape: Shape, size: Array, at: Array, axes: Array, color: str) -> Iterator[Visual]:
    """Yield the solids of a shape other than a mesh, which has the sizes of the manifest's `Drawing`."""
    match shape:
        case "box":
            yield Visual(body, Kind.BOX, size, at, axes, color)
        case "ellipsoid":
            yield Visual(body, Kind.ELLIPSOID, size, at, axes, color)
        case "sphere":
            yield Visual(body, Kind.ELLIPSOID, np.full(3, 2 * size[0]), at, axes, color)
        case "cylinder" | "capsule":
            width, length = 2 * size[0], size[1]
            yield Visual(body, Kind.CYLINDER, np.array([width, width, length]), at, axes, color)
            for end in (-length / 2, length / 2) if shape == "capsule" else ():
                yield Visual(body, Kind.ELLIPSOID, np.full(3, width), at + end * axes[:, 2], axes, color)


def show_drawings(
    manifest: Manifest, folder: Path | None = None, warn: Callable[[str], None] | None = None
) -> list[Visual]:
    """List the shapes that a model has for its bodies; meshes only where the model's folder is known.

    A mesh that cannot be shown is left out, and `warn` gets the reason.
    """
    appearance = manifest.appearance
    if appearance is None:
        return []
    seats, found, read = {x.name: x for x in appearance.bodies}, list[Visual](), dict[Path, Body]()
    for each in appearance.drawings:
        seat = seats[each.body]
        C, size = np.array(seat.axes).reshape(3, 3), np.array(each.size)
        at, axes = C @ (np.array(each.at) - np.array(seat.at)), C @ np.array(each.axes).reshape(3, 3).T
        if each.shape != "mesh":
            found += show_shape(each.body, each.shape, size, at, axes, each.color)
        elif folder is not None:
            try:
                file = find_mesh(each.file, folder, ())
                if file not in read:
                    read[file] = read_mesh(file)
            except InputError as error:
                if warn is not None:
                    warn(str(error))
            else:
                found.append(show_mesh(each.body, read[file], at, axes, size, each.color))
    return found


def read_visuals(path: Path, packages: tuple[Path, ...], warn: Callable[[str], None]) -> list[Visual]:
    """Read the visuals of a URDF file; links are bodies of their names. A mesh that cannot be shown is warned of.

    Raises InputError for a file that is no XML, or that declares entities.
    """
    root = _parse(path)
    colors = {x.get("name"): _read_color(x) for x in root.findall("material")}
    found, read = list[Visual](), dict[Path, Body]()
    for link in root.findall("link"):
        for visual in link.findall("visual"):
            try:
                found += _read_visual(link.get("name", ""), visual, colors, path.parent, packages, read)
            except InputError as error:
                warn(str(error))
            except ValueError as error:
                warn(f"{path}: a visual of link {link.get('name', '')[:60]} is left out: {error}")
    return found


def _read_visual(
    body: str,
    visual: Element,
    colors: dict[str | None, str | None],
    folder: Path,
    packages: tuple[Path, ...],
    read: dict[Path, Body],
) -> Iterator[Visual]:
    at, axes = np.zeros(3), np.eye(3)
    origin, material, shape = visual.find("origin"), visual.find("material"), visual.find("geometry/*")
    if origin is not None:
        at = _numbers(origin.get("xyz", "0 0 0"), 3)
        from scipy.spatial.transform import Rotation  # here, and late: it takes long to load

        axes = Rotation.from_euler("xyz", _numbers(origin.get("rpy", "0 0 0"), 3)).as_matrix()
    color = None if material is None else _read_color(material) or colors.get(material.get("name"))
    if shape is None:
        return
    match shape.tag:
        case "box":
            yield from show_shape(body, "box", _numbers(shape.get("size", ""), 3), at, axes, color or GREY)
        case "sphere":
            yield from show_shape(body, "sphere", _numbers(shape.get("radius", ""), 1), at, axes, color or GREY)
        case "cylinder" | "capsule":
            size = np.concatenate([_numbers(shape.get(key, ""), 1) for key in ("radius", "length")])
            kind: Shape = "cylinder" if shape.tag == "cylinder" else "capsule"
            yield from show_shape(body, kind, size, at, axes, color or GREY)
        case "mesh":
            file = find_mesh(shape.get("filename", ""), folder, packages)
            if file not in read:
                read[file] = read_mesh(file)
            yield show_mesh(body, read[file], at, axes, _numbers(shape.get("scale", "1 1 1"), 3), color or GREY)


def _parse(path: Path) -> Element:
    def refuse(*_: object) -> None:
        raise InputError([Fault(str(path), 0, "", "the file declares an entity", "write its text out")])

    builder, parser = TreeBuilder(), expat.ParserCreate()
    parser.StartElementHandler = lambda tag, attributes: builder.start(tag, attributes) and None
    parser.EndElementHandler = lambda tag: builder.end(tag) and None
    parser.EntityDeclHandler = refuse
    try:
        if path.stat().st_size > MAX_BYTES:
            finding = f"it has {path.stat().st_size} bytes"
            raise InputError([Fault(str(path), 0, "", finding, f"give a file of at most {MAX_BYTES}")])
        parser.Parse(path.read_bytes(), True)
        return builder.close()
    except expat.ExpatError as error:
        raise InputError([Fault(str(path), 0, "", f"it is no XML: {error}", "check the file")]) from None
    except OSError as error:
        raise InputError([Fault(str(path), 0, "", f"cannot be read: {error.strerror}", "check the path")]) from None


def _numbers(text: str, count: int) -> Array:
    values = np.array([float(x) for x in text.split()])
    if values.shape != (count,) or not np.isfinite(values).all() or np.abs(values).max(initial=0.0) > 1e6:
        raise ValueError(f"found {text[:60]!r}, expected {count} numbers")
    return values


def _read_color(material: Element) -> str | None:
    color = material.find("color")
    if color is None:
        return None
    try:
        rgba = np.clip(_numbers(color.get("rgba", ""), 4), 0, 1)
    except ValueError:
        return None
    return "#" + "".join(f"{round(255 * x):02x}" for x in rgba[:3])
