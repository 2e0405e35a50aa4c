"""The picture of a mechanism in a browser: manifest -> frames, solids and lines for `renderer.js`, without NumPy.

A body is drawn by its own shapes; without any, by the homogeneous cylinder or box of its mass and inertia, as
`mbsrun.animation.actors` draws it. Sizes that depend on the size of the mechanism are left to the page, which knows it:
solids of the layer "solids" are to be limited, masses without inertia have a share of the largest ball as their size,
and solids of the layer "joints" have none.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence, Set
from itertools import pairwise
from typing import Any

from mbsgen.algebra.dense import Dense, Row, add, apply, cross, find_eigen, transpose
from mbsgen.manifest import Appearance, Corners, Drawing, Manifest, Mass, Point, Touch
from mbsgen.style import PALETTE, mix

Solid = dict[str, Any]
ALIKE = 0.02  # relative difference of moments that count as equal
SMALL_MASS = 1e-3  # relative to the heaviest body: lighter points are not drawn
LEAST_BALL = 0.35  # of a mass without inertia, relative to the heaviest one's
POINT = 1e-6  # m: a smaller solid is a point
FIXED, BONE, TOUCH = "#9aa7b5", "#5d6b7a", "#009e73"
IDENTITY = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)


def describe_picture(manifest: Manifest) -> dict[str, Any]:
    """Return the frames, the solids and lines in them, the vertical, and the ends that no frame marks."""
    appearance = manifest.appearance
    assert appearance is not None, "a generated manifest has an appearance"
    g = appearance.gravity
    length = math.hypot(*g)
    return {
        "frames": [
            {"name": x.name, "parent": x.parent, "sensor": x.sensor, "slide": x.slides} for x in manifest.frames
        ],
        "up": [-x / length + 0.0 for x in g] if length else [0.0, 0.0, 1.0],
        "ends": [{"frame": i, "at": x.com} for i, x in enumerate(manifest.frames) if x.com is not None],
        "solids": [*_list_solids(manifest, appearance)],
        "lines": [*_list_lines(appearance)],
    }


def list_meshes(manifest: Manifest) -> list[str]:
    """List the bodies with meshes; a page in a browser cannot read the files."""
    assert manifest.appearance is not None, "a generated manifest has an appearance"
    return list(dict.fromkeys(x.body for x in manifest.appearance.drawings if x.shape == "mesh"))


def _list_solids(manifest: Manifest, appearance: Appearance) -> Iterator[Solid]:
    colors = _color_frames(appearance.masses)
    drawings = [x for x in appearance.drawings if x.shape != "mesh"]
    for each in drawings:
        yield from _draw(each, each.color or colors.get(each.frame, _tint(0)))
    yield from _draw_masses(appearance.masses, colors, {x.body for x in drawings})
    if not drawings:
        yield from _draw_joints(manifest, appearance)
    for touch in appearance.contacts:
        yield from _draw_contact(touch)


def _solid(
    layer: str, frame: int, kind: str, size: Sequence[float], color: str, at: Row, axes: Row = IDENTITY
) -> Solid:
    return {
        "layer": layer,
        "frame": frame,
        "kind": kind,
        "size": list(size),
        "color": color,
        "at": list(at),
        "axes": list(axes),
    }


def _color_frames(masses: Sequence[Mass]) -> dict[int, str]:
    """Choose a colour for each frame with masses; what is fixed to the base is grey."""
    frames = dict.fromkeys(x.frame for x in masses if x.frame >= 0)
    return {-1: FIXED} | {frame: _tint(i) for i, frame in enumerate(frames)}


def _tint(i: int) -> str:
    return mix(PALETTE[i % len(PALETTE)], "#ffffff", 0.18)


def _draw(drawing: Drawing, color: str) -> Iterator[Solid]:
    """Draw a shape of a body, with the sizes of `Drawing`."""
    frame, at, axes, size = drawing.frame, drawing.at, drawing.axes, drawing.size
    match drawing.shape:
        case "box" | "ellipsoid":
            yield _solid("meshes", frame, drawing.shape, size, color, at, axes)
        case "sphere":
            yield _solid("meshes", frame, "ellipsoid", (2 * size[0],) * 3, color, at, axes)
        case "cylinder":
            yield _solid("meshes", frame, "cylinder", (2 * size[0], 2 * size[0], size[1]), color, at, axes)
        case "capsule":
            yield from _draw_capsule("meshes", frame, size[0], size[1], color, at, axes)


def _draw_capsule(
    layer: str, frame: int, radius: float, length: float, color: str, at: Row, axes: Row
) -> Iterator[Solid]:
    width, along = 2 * radius, axes[6:]
    yield _solid(layer, frame, "cylinder", (width, width, length), color, at, axes)
    for side in (-length / 2, length / 2):
        yield _solid(layer, frame, "ellipsoid", (width,) * 3, color, add(at, tuple(side * x for x in along)), axes)


def _draw_masses(masses: Sequence[Mass], colors: dict[int, str], drawn: Set[str]) -> Iterator[Solid]:
    heaviest = max((x.mass for x in masses), default=0.0)
    for each in masses:
        if each.name in drawn:
            continue
        kind, size, axes = fit_solid(each)
        if max(size) > POINT:
            yield _solid("solids", each.frame, kind, size, colors[each.frame], each.com, axes)
        elif each.mass > SMALL_MASS * heaviest:
            share = max((each.mass / heaviest) ** (1 / 3), LEAST_BALL)
            yield _solid("solids", each.frame, "ellipsoid", (share,) * 3, colors[each.frame], each.com) | {"ball": True}


def fit_solid(mass: Mass) -> tuple[str, Row, Row]:
    """Fit the homogeneous solid of a mass and its inertia: its kind, its sizes, and its axes one after the other.

    A cylinder of radius r and height h where two moments are equal, m r^2 / 2 and m (3 r^2 + h^2) / 12; else a box of
    edges a, b, c, with moments such as m (b^2 + c^2) / 12.
    """
    xx, yy, zz, xy, xz, yz = mass.inertia
    moments, axes = find_eigen(((xx, xy, xz), (xy, yy, yz), (xz, yz, zz)))
    total, m = sum(moments), mass.mass
    near = [moments[k + 1] - moments[k] <= ALIKE * moments[2] for k in (0, 1)]
    if near[0] == near[1]:
        return "box", tuple(math.sqrt(max(6 * (total - 2 * x) / m, 0.0)) for x in moments), _join(axes)
    axial = 2 if near[0] else 0
    across, squared = (total - moments[axial]) / 2, 2 * moments[axial] / m
    radius, height = math.sqrt(max(squared, 0.0)), math.sqrt(max(12 * across / m - 3 * squared, 0.0))
    turned = tuple(axes[(axial + k) % 3] for k in (1, 2, 3))
    return "cylinder", (2 * radius, 2 * radius, height), _join(turned)


def _join(axes: Dense) -> Row:
    return tuple(x for axis in axes for x in axis)


def _draw_joints(manifest: Manifest, appearance: Appearance) -> Iterator[Solid]:
    """Draw a drum along the axis of each joint that turns; none for a body that moves freely."""
    free = _count_floating(manifest, appearance)
    spins = {k for first in manifest.quaternions for k in _list_spins(manifest, first)}
    for i, axle in enumerate(appearance.axles):
        if i >= free and not manifest.frames[i].slides and axle.coordinate not in spins:
            yield _solid("joints", i, "cylinder", (0.0,) * 3, mix(BONE, "#000000", 0.3), (0.0,) * 3, _along(axle.axis))


def _list_spins(manifest: Manifest, first: int) -> Iterator[int]:
    """Yield the velocities that a quaternion, which begins at an entry of q, turns with: each has one entry more."""
    before = sum(1 for other in manifest.quaternions if other < first)
    yield from range(first - before, first - before + 3)


def _count_floating(manifest: Manifest, appearance: Appearance) -> int:
    """Count the frames by which a body moves freely from the base: two massless ones or more, and the body's."""
    heavy, count = {x.frame for x in appearance.masses}, 0
    for i, frame in enumerate(manifest.frames):
        if frame.sensor or frame.parent != i - 1 or i in heavy:
            break
        count += 1
    return count + 1 if count >= 2 and manifest.frames[0].slides else 0


def _draw_contact(touch: Touch) -> Iterator[Solid]:
    """Draw the sphere, box or points of a contact, and the solid that it touches; planes are not drawn."""
    frame, at = touch.centre.frame, touch.centre.at
    if touch.size is not None:
        yield _solid("contacts", frame, "box", touch.size, TOUCH, at, touch.axes)
    else:
        points = touch.points or ((0.0, 0.0, 0.0),)
        yield from _draw_corners(Corners(centre=touch.centre, axes=touch.axes, radius=touch.radius, points=points))
    if touch.hull is not None:
        yield from _draw_corners(touch.hull)
    if touch.box is not None:
        yield _solid(
            "contacts", touch.box.centre.frame, "box", touch.box.size, TOUCH, touch.box.centre.at, touch.box.axes
        )
    if touch.sphere is not None:
        ball = touch.sphere
        yield _solid("contacts", ball.centre.frame, "ellipsoid", (2 * ball.radius,) * 3, TOUCH, ball.centre.at)
    if touch.capsule is not None:
        rod = touch.capsule
        axes = _along(rod.axis)
        yield from _draw_capsule("contacts", rod.centre.frame, rod.radius, rod.length, TOUCH, rod.centre.at, axes)


def _draw_corners(hull: Corners) -> Iterator[Solid]:
    x, y, z = hull.axes[:3], hull.axes[3:6], hull.axes[6:]
    for point in hull.points:
        place = add(hull.centre.at, apply(transpose((x, y, z)), point))
        yield _solid("contacts", hull.centre.frame, "ellipsoid", (2 * hull.radius,) * 3, TOUCH, place)


def _along(z: Row) -> Row:
    """Return axes, one after the other, of which the third is a unit vector z."""
    aside = (1.0, 0.0, 0.0) if abs(z[0]) < 0.6 else (0.0, 1.0, 0.0)
    x = cross(z, aside)
    x = tuple(c / math.hypot(*x) for c in x)
    return (*x, *cross(z, x), *z)


def _list_lines(appearance: Appearance) -> Iterator[dict[str, Any]]:
    """List the stretches of springs and cables."""
    for element in appearance.elements:
        for ends in pairwise((element.first, *element.via, element.second)):
            yield {"kind": "cable" if element.cable else "spring", "ends": [_place(end) for end in ends]}


def _place(point: Point) -> dict[str, Any]:
    return {"frame": point.frame, "at": list(point.at)}
