"""Actors: manifest -> solids and lines.

The solid of a body is the homogeneous one of its mass m and principal moments of inertia I1, I2, I3, at its centre of
mass and along its principal axes. It is a cylinder of radius r and length h where two moments are equal,

    m r^2 / 2 = I3,   m (3 r^2 + h^2) / 12 = I1 = I2,

and else a box, whose edges a, b, c satisfy m (b^2 + c^2) / 12 = I1 and so on: a = sqrt(6 (I2 + I3 - I1) / m). These are
the moments of any textbook (Meriam, Kraige, Dynamics, table D/4). A mass without inertia is a ball, whose volume is
proportional to the mass. Edges are limited by the size of the mechanism, so that rods stay visible, and rotors with
large inertia do not hide it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence, Set
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from mbsgen.manifest import Appearance, Corners, Manifest, Mass, Point, Rod
from mbsgen.style import PALETTE, mix
from mbsrun.animation.film import Actor, Course, Kind, Layer, Line, Mesh, Solid, Triple
from mbsrun.animation.visuals import Visual
from mbsrun.quaternions import list_quaternions
from mbsrun.skeleton import Skeleton

Array = NDArray[np.float64]

THINNEST = 0.024  # of an edge of a solid, relative to the size of the mechanism
LARGEST = 0.5
SMALL_MASS = 1e-3  # relative to the heaviest body: lighter points are not drawn
BALL = 0.12  # largest diameter of a mass without inertia, relative to the size
ALIKE = 0.02  # relative difference of moments that count as equal
SMALLEST = 1e-6  # m, of a mechanism
BONE = "#5d6b7a"


@dataclass(frozen=True)
class Look:
    """The colours of an actor: one for each body in turn, or one for all."""

    solids: tuple[str, ...]
    edges: str = BONE


BY_BODY = Look(tuple(mix(color, "#ffffff", 0.18) for color in PALETTE))


def look_alike(color: str) -> Look:
    """Return the colours of an actor that is shown beside others."""
    return Look((mix(color, "#ffffff", 0.25),), mix(color, "#000000", 0.25))


def make_actor(
    name: str,
    manifest: Manifest,
    skeleton: Skeleton,
    look: Look = BY_BODY,
    visuals: tuple[Visual, ...] = (),
) -> Actor:
    """Make the actor of a mechanism at poses of its motion."""
    appearance, size = manifest.appearance, measure(manifest, skeleton)
    solids: list[Solid] = []
    links = (Line(Course.ROD if x.is_rod else Course.GAP, (_at(x.first), _at(x.second))) for x in skeleton.links)
    lines = [*links]
    if appearance is not None:
        solids += _place_visuals(appearance, look, visuals)
        drawn = {x.body for x in visuals}
        solids += [*_draw_masses(appearance, size, look, drawn)]
        solids += _draw_joints(manifest, size, look) if not drawn else ()
        solids += dict.fromkeys(_draw_contacts(appearance, size))  # a sphere may have many contacts
        kinds = {True: Course.CABLE, False: Course.SPRING}
        lines += [
            Line(kinds[x.cable], ends) for x in appearance.elements for ends in pairwise((x.first, *x.via, x.second))
        ]
    return Actor(name, look.edges, skeleton.frames, tuple(solids), tuple(lines), find_floating(manifest), size)


def _at(frame: int) -> Point:
    return Point(frame=frame, at=(0.0, 0.0, 0.0))


def measure(manifest: Manifest, skeleton: Skeleton) -> float:
    """Return the size of a mechanism: the largest diagonal of the box around its frames at one time [m]."""
    floating = find_floating(manifest)
    chosen = [i for i in range(len(skeleton.frames)) if i not in floating]
    points = skeleton.p[:, :, chosen or range(len(skeleton.frames))]
    if not floating:  # the base belongs to it
        points = np.concatenate((points, np.zeros((len(points), 3, 1))), axis=2)
    size = float(np.linalg.norm(np.ptp(points, axis=2), axis=1).max(initial=0.0))
    if size > SMALLEST or manifest.appearance is None:
        return size if size > SMALLEST else 1.0
    edges = [float(fit_solid(x.mass, x.inertia).size.max()) for x in manifest.appearance.masses]
    return 1.6 * max(edges, default=0.0) or 1.0


@dataclass(frozen=True, eq=False)
class Fit:
    """A homogeneous solid with a given mass and inertia: its shape, edges, and axes as columns."""

    kind: Kind
    size: Array
    axes: Array


def fit_solid(mass: float, inertia: tuple[float, ...]) -> Fit:
    """Fit a cylinder where two principal moments are equal and the third one differs, else a box."""
    xx, yy, zz, xy, xz, yz = inertia
    moments, axes = np.linalg.eigh(np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]))
    if np.linalg.det(axes) < 0:
        axes = -axes
    gaps = np.diff(moments) <= ALIKE * moments[2]
    if gaps[0] != gaps[1]:
        axial = 2 if gaps[0] else 0
        across = (moments.sum() - moments[axial]) / 2
        squared = 2.0 * moments[axial] / mass
        radius, height = np.sqrt(max(squared, 0.0)), np.sqrt(max(12.0 * across / mass - 3.0 * squared, 0.0))
        order = [(axial + 1) % 3, (axial + 2) % 3, axial]
        return Fit(Kind.CYLINDER, np.array([2.0 * radius, 2.0 * radius, height]), axes[:, order])
    squares = 6.0 * (moments.sum() - 2.0 * moments) / mass
    return Fit(Kind.BOX, np.sqrt(np.maximum(squares, 0.0)), axes)


def list_meshes(visuals: Sequence[Visual]) -> tuple[Mesh, ...]:
    """List the meshes of visuals, each once, in the order in which solids count them."""
    return tuple(dict.fromkeys(x.mesh.mesh for x in visuals if x.mesh is not None))


def _place_visuals(appearance: Appearance, look: Look, visuals: tuple[Visual, ...]) -> Iterator[Solid]:
    """Place shapes and meshes on the frames that their bodies move with; other bodies' are left out."""
    seats, meshes = {x.name: x for x in appearance.bodies}, list_meshes(visuals)
    colors = _color_bodies(appearance.masses, look)
    for each in visuals:
        seat = seats.get(each.body)
        if seat is not None:
            C = np.array(seat.axes).reshape(3, 3).T
            at, axes = np.array(seat.at) + C @ each.at, tuple((C @ each.axes).T.ravel().tolist())
            mesh = None if each.mesh is None else meshes.index(each.mesh.mesh)
            color = each.color or colors.get(seat.frame, look.solids[0])
            yield Solid(Layer.MESHES, seat.frame, each.kind, _triple(each.size), color, _triple(at), axes, mesh)


def _draw_masses(appearance: Appearance, size: float, look: Look, drawn: Set[str]) -> Iterator[Solid]:
    masses = appearance.masses
    heaviest = max((x.mass for x in masses), default=0.0)
    colors = _color_bodies(masses, look)
    for each in masses:
        if each.name in drawn:
            continue
        fit = fit_solid(each.mass, each.inertia)
        color = colors[each.frame]
        if fit.size.max() > 1e-6 * size:
            limited = np.clip(fit.size, THINNEST * size, LARGEST * size)
            columns = tuple(fit.axes.T.ravel().tolist())
            yield Solid(Layer.SOLIDS, each.frame, fit.kind, _triple(limited), color, each.com, columns)
        elif each.mass > SMALL_MASS * heaviest:
            diameter = BALL * size * max((each.mass / heaviest) ** (1 / 3), 0.35)
            yield Solid(Layer.SOLIDS, each.frame, Kind.ELLIPSOID, (diameter,) * 3, color, each.com)


def _color_bodies(masses: Sequence[Mass], look: Look) -> dict[int, str]:
    """Choose a colour for each frame with masses; what is fixed to the base is grey."""
    frames = [frame for frame in dict.fromkeys(x.frame for x in masses) if frame >= 0]
    return {-1: "#9aa7b5"} | {frame: look.solids[i % len(look.solids)] for i, frame in enumerate(frames)}


def _draw_joints(manifest: Manifest, size: float, look: Look) -> Iterator[Solid]:
    """Draw a drum along the axis of each joint that turns; none for a body that moves freely."""
    appearance = manifest.appearance
    assert appearance is not None
    free = find_floating(manifest)
    quaternions = {k for x in list_quaternions(manifest) for k in x.spins}
    length, diameter = 0.05 * size, 0.034 * size
    for i, axle in enumerate(appearance.axles):
        if not manifest.frames[i].slides and i not in free and axle.coordinate not in quaternions:
            axes = tuple(_complete(np.array(axle.axis)).T.ravel().tolist())
            bar = (diameter, diameter, length)
            yield Solid(Layer.JOINTS, i, Kind.CYLINDER, bar, mix(look.edges, "#000000", 0.3), axes=axes)


def find_floating(manifest: Manifest) -> frozenset[int]:
    """Find the frames by which a body moves freely from the base: two massless ones or more, and the body's."""
    if manifest.appearance is None:
        return frozenset()
    heavy = {x.frame for x in manifest.appearance.masses}
    count = 0
    for i, frame in enumerate(manifest.frames):
        if frame.sensor or frame.parent != i - 1 or i in heavy:
            break
        count += 1
    if count < 2 or not manifest.frames[0].slides:
        return frozenset()
    return frozenset(range(count + 1))


def _draw_contacts(appearance: Appearance, size: float) -> Iterator[Solid]:
    for each in appearance.contacts:
        frame, at = each.centre.frame, each.centre.at
        if each.size is not None:
            yield Solid(Layer.CONTACTS, frame, Kind.BOX, each.size, "#009e73", at, each.axes)
        else:
            diameter = max(2.0 * each.radius, 0.018 * size)
            C = np.array(each.axes).reshape(3, 3)  # one a row
            for point in each.points or ((0.0, 0.0, 0.0),):
                place = _triple(np.array(at) + np.array(point) @ C)
                yield Solid(Layer.CONTACTS, frame, Kind.ELLIPSOID, (diameter,) * 3, "#009e73", place)
        if each.hull is not None:
            yield from _draw_corners(each.hull, size)
        if each.box is not None:
            frame, at = each.box.centre.frame, each.box.centre.at
            yield Solid(Layer.CONTACTS, frame, Kind.BOX, each.box.size, "#009e73", at, each.box.axes)
        if each.sphere is not None:
            frame, at, diameter = each.sphere.centre.frame, each.sphere.centre.at, 2.0 * each.sphere.radius
            yield Solid(Layer.CONTACTS, frame, Kind.ELLIPSOID, (diameter,) * 3, "#009e73", at)
        if each.capsule is not None:
            yield from _draw_capsule(each.capsule)


def _draw_corners(hull: Corners, size: float) -> Iterator[Solid]:
    diameter = max(2.0 * hull.radius, 0.018 * size)
    C = np.array(hull.axes).reshape(3, 3)  # one a row
    for point in hull.points:
        place = _triple(np.array(hull.centre.at) + np.array(point) @ C)
        yield Solid(Layer.CONTACTS, hull.centre.frame, Kind.ELLIPSOID, (diameter,) * 3, "#009e73", place)


def _draw_capsule(rod: Rod) -> Iterator[Solid]:
    frame, at, axis, diameter = rod.centre.frame, np.array(rod.centre.at), np.array(rod.axis), 2.0 * rod.radius
    columns = tuple(_complete(axis).T.ravel().tolist())
    yield Solid(
        Layer.CONTACTS, frame, Kind.CYLINDER, (diameter, diameter, rod.length), "#009e73", rod.centre.at, columns
    )
    for side in (-0.5, 0.5):
        place = _triple(at + side * rod.length * axis)
        yield Solid(Layer.CONTACTS, frame, Kind.ELLIPSOID, (diameter,) * 3, "#009e73", place)


def _complete(z: Array) -> Array:
    """Return axes, as columns, the third of which is z."""
    x = np.cross(z, [1.0, 0.0, 0.0] if abs(z[0]) < 0.6 else [0.0, 1.0, 0.0])
    x /= np.linalg.norm(x)
    return np.stack((x, np.cross(z, x), z), axis=1)


def _triple(v: Array) -> Triple:
    x, y, z = v.tolist()
    return x, y, z
