"""A model of this project and factors of its bodies -> the model with other lengths, masses and inertias.

As with OpenSim's files (`osim`), everything fixed on a body is stretched along the axes of the body's frame. The joint
of a body stands on its parent, and is stretched with it. Masses and inertias become numbers; lengths stay expressions.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from mbsgen.expressions import FLOATS, Expression, Number, Operation, evaluate
from mbsgen.importing.poses import Array
from mbsgen.importing.rotations import turn
from mbsgen.model.model import (
    BASE,
    ORIGIN,
    ZERO,
    Block,
    Body,
    Capsule,
    Contact,
    Fixed,
    ForceElement,
    Inertia,
    Joint,
    Model,
    Other,
    PathPoint,
    Placement,
    Plane,
    Sphere,
    Visual,
    Wheel,
    Wrap,
    Wrench,
)
from mbsgen.model.model import Triple as Position
from mbsgen.subjects.osim import Masses, Triple, scale_moments

WHOLE: Triple = (1.0, 1.0, 1.0)


def scale_model(model: Model, factors: Mapping[str, Triple], masses: Masses) -> Model:
    """Scale all but the lengths of muscles and springs. The model has no tables of Denavit and Hartenberg."""
    values = evaluate_parameters(model)
    bodies = tuple(_scale_body(body, factors, masses, values) for body in model.bodies)
    if masses.total is not None:
        ratio = masses.total / sum(evaluate(x.mass, values, FLOATS) for x in bodies)
        bodies = tuple(_weigh(x, ratio, values) for x in bodies)
    return replace(
        model,
        bodies=bodies,
        frames=tuple(replace(x, placement=_move(x.placement, _of(factors, x.body))) for x in model.frames),
        wrenches=tuple(_scale_wrench(x, factors) for x in model.wrenches),
        forces=tuple(_scale_line(x, factors, values) for x in model.forces),
        contacts=tuple(_scale_contact(x, factors, values) for x in model.contacts),
    )


def evaluate_parameters(model: Model) -> dict[str, float]:
    """Return the values of all parameters."""
    values: dict[str, float] = {}
    for parameter in model.parameters:
        values[parameter.name] = evaluate(parameter.value, values, FLOATS)
    return values


def scale_model_lines(model: Model, ratios: Mapping[str, float]) -> Model:
    """Scale the lengths of fibres, slack tendons and slack springs, by the names of forces."""
    return replace(model, forces=tuple(_scale_lengths(x, ratios.get(x.name, 1.0)) for x in model.forces))


def set_model_solid(
    model: Model, name: str, mass: float | None, centre: Array | None, moments: tuple[float, ...] | None
) -> Model:
    """Set the mass of a body, its centre and its inertia about it; without moments, they grow with the mass."""
    values = evaluate_parameters(model)

    def change(body: Body) -> Body:
        if body.name != name:
            return body
        if moments is None:
            old = evaluate(body.mass, values, FLOATS)
            return _weigh(body, (old if mass is None else mass) / old, values)
        x, y, z = body.com if centre is None else map(Number, centre.tolist())
        m = body.mass if mass is None else Number(mass)
        return replace(body, mass=m, com=(x, y, z), inertia=Inertia(*map(Number, moments)))

    return replace(model, bodies=tuple(map(change, model.bodies)))


def move_frames(model: Model, shifts: Mapping[str, Array]) -> Model:
    """Shift frames along their own axes [m], by name."""
    values, frames = evaluate_parameters(model), []
    for frame in model.frames:
        if frame.name in shifts:
            old = np.array([evaluate(x, values, FLOATS) for x in frame.placement.position])
            x, y, z = map(Number, (old + _rotate(frame.placement, values) @ shifts[frame.name]).tolist())
            frames.append(replace(frame, placement=replace(frame.placement, position=(x, y, z))))
        else:
            frames.append(frame)
    return replace(model, frames=tuple(frames))


def _rotate(placement: Placement, values: Mapping[str, float]) -> Array:
    """Return the rotation of a frame, in the frame that it stands in."""
    R = np.eye(3)
    for rotation in placement.orientation:
        R = R @ turn(np.eye(3)[rotation.axis], evaluate(rotation.angle, values, FLOATS))
    return R


def _of(factors: Mapping[str, Triple], body: str) -> Triple:
    return WHOLE if body == BASE else factors.get(body, WHOLE)


def _times(x: Expression, factor: float) -> Expression:
    if factor == 1 or x == ZERO:
        return x
    return Number(x.value * factor) if isinstance(x, Number) else Operation("*", x, Number(factor))


def _stretch(position: Position, factors: Triple) -> Position:
    x, y, z = (_times(a, f) for a, f in zip(position, factors, strict=True))
    return x, y, z


def _move(placement: Placement, factors: Triple) -> Placement:
    return replace(placement, position=_stretch(placement.position, factors))


def _scale_body(body: Body, factors: Mapping[str, Triple], masses: Masses, values: Mapping[str, float]) -> Body:
    own, above = _of(factors, body.name), _of(factors, body.parent)
    joint = body.joint
    if isinstance(joint, Fixed | Joint):
        joint = replace(joint, placement=_move(joint.placement, above))
    else:
        joint = tuple(replace(x, placement=_move(x.placement, above)) for x in joint)
    m, moments = _read_solid(body, values)
    grown = 1.0 if masses.keeps_distribution else abs(math.prod(own))
    inertia = Inertia(*map(Number, scale_moments(m, moments, own, grown)))
    return replace(
        body,
        joint=joint,
        mass=_times(body.mass, grown),
        com=_stretch(body.com, own),
        inertia=inertia if m > 0 and own != WHOLE else body.inertia,
        visuals=tuple(_scale_visual(x, own) for x in body.visuals),
    )


def _read_solid(body: Body, values: Mapping[str, float]) -> tuple[float, list[float]]:
    """Return the mass, and xx, yy, zz, xy, xz, yz about the centre of mass."""
    m, com = evaluate(body.mass, values, FLOATS), np.array([evaluate(x, values, FLOATS) for x in body.com])
    tensor = np.array([[evaluate(x, values, FLOATS) for x in row] for row in body.inertia.rows])
    if body.inertia.about is not None:
        r = com - np.array([evaluate(x, values, FLOATS) for x in body.inertia.about])
        tensor = tensor - m * (r @ r * np.eye(3) - np.outer(r, r))
    return m, [float(tensor[k]) for k in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]


def _weigh(body: Body, ratio: float, values: Mapping[str, float]) -> Body:
    """Multiply the mass and the inertia of a body."""
    moments = [x * ratio for x in _read_solid(body, values)[1]]
    return replace(body, mass=_times(body.mass, ratio), inertia=Inertia(*(Number(x or 0.0) for x in moments)))


def _scale_visual(visual: Visual, factors: Triple) -> Visual:
    mean = sum(factors) / 3
    size = tuple(_times(x, mean) for x in visual.size)
    return replace(visual, placement=_move(visual.placement, factors), size=size)


def _scale_point(point: PathPoint, factors: Mapping[str, Triple]) -> PathPoint:
    own = _of(factors, point.body)
    shift = point.shift if point.shift == ORIGIN else _stretch(point.shift, own)
    return replace(point, placement=_move(point.placement, own), shift=shift)


def _scale_line(line: ForceElement, factors: Mapping[str, Triple], values: Mapping[str, float]) -> ForceElement:
    return replace(
        line,
        first=_scale_point(line.first, factors),
        second=_scale_point(line.second, factors),
        via=tuple(_scale_point(x, factors) for x in line.via),
        wraps=tuple(_scale_wrap(x, _of(factors, x.body), values) for x in line.wraps),
    )


def _scale_wrap(wrap: Wrap, factors: Triple, values: Mapping[str, float]) -> Wrap:
    along = np.linalg.norm(np.array(factors)[:, None] * _rotate(wrap.placement, values), axis=0)
    mean = float(along[:2].mean() if wrap.axial else np.mean(factors))
    around = along.tolist() if wrap.kind == "ellipsoid" else [mean] * len(wrap.size)
    length = None if wrap.length is None else _times(wrap.length, float(along[2]))
    size = tuple(_times(x, float(factor)) for x, factor in zip(wrap.size, around, strict=True))
    return replace(wrap, placement=_move(wrap.placement, factors), size=size, length=length)


def _scale_wrench(wrench: Wrench, factors: Mapping[str, Triple]) -> Wrench:
    other = wrench.against
    if other is not None:
        other = replace(other, placement=_move(other.placement, _of(factors, other.body)))
    return replace(wrench, position=_stretch(wrench.position, _of(factors, wrench.body)), against=other)


def _scale_contact(contact: Contact, factors: Mapping[str, Triple], values: Mapping[str, float]) -> Contact:
    """Stretch both sides. A sphere, and the round edge of a solid, keep their shape: by the mean factor."""
    contact = replace(contact, other=_scale_side(contact.other, _of(factors, contact.other.body), values))
    own = _of(factors, contact.body)
    if own == WHOLE:
        return contact
    within = _turn_factors(contact.placement, own, values)
    size = None if contact.size is None else _stretch_size(contact.size, within)
    return replace(
        contact,
        placement=_move(contact.placement, own),
        radius=_times(contact.radius, sum(own) / 3),
        size=size,
        points=tuple(_deform(x, within, values) for x in contact.points),
        wheel=None if contact.wheel is None else _scale_wheel(contact.wheel, within, values),
    )


def _scale_side(side: Other, factors: Triple, values: Mapping[str, float]) -> Other:
    if factors == WHOLE:
        return side
    if isinstance(side, Plane):
        a, b, c = (_times(x, 1 / f) for x, f in zip(side.normal, factors, strict=True))
        return replace(side, position=_stretch(side.position, factors), normal=(a, b, c))
    mean = sum(factors) / 3
    if isinstance(side, Sphere):
        return replace(side, position=_stretch(side.position, factors), radius=_times(side.radius, mean))
    within, placement = _turn_factors(side.placement, factors, values), _move(side.placement, factors)
    if isinstance(side, Block):
        return replace(side, placement=placement, size=_stretch_size(side.size, within))
    if isinstance(side, Capsule):
        along = float(np.linalg.norm(within[:, 2]))
        return replace(side, placement=placement, radius=_times(side.radius, mean), length=_times(side.length, along))
    points = tuple(_deform(x, within, values) for x in side.points)
    return replace(side, placement=placement, radius=_times(side.radius, mean), points=points)


def _turn_factors(placement: Placement, factors: Triple, values: Mapping[str, float]) -> Array:
    """Return the stretch of a body (3, 3) along the axes of a frame on it."""
    R = _rotate(placement, values)
    turned: Array = R.T @ np.diag(factors) @ R
    return turned


def _stretch_size(size: Position, within: Array) -> Position:
    """Stretch the edges of a box: each by as much as its direction, so that it stays a box."""
    x, y, z = (float(a) for a in np.linalg.norm(within, axis=0))
    return _stretch(size, (x, y, z))


def _deform(position: Position, within: Array, values: Mapping[str, float]) -> Position:
    """Move a point, given in a frame, with the stretch along the axes of that frame."""
    diagonal = np.diag(within)
    if np.array_equal(within, np.diag(diagonal)):
        x, y, z = map(float, diagonal)
        return _stretch(position, (x, y, z))
    moved = within @ np.array([evaluate(x, values, FLOATS) for x in position])
    a, b, c = map(Number, moved.tolist())
    return a, b, c


def _scale_wheel(wheel: Wheel, within: Array, values: Mapping[str, float]) -> Wheel:
    """Stretch a wheel: its axis as its body, its radius by the mean in its plane, so that it stays round."""
    axis = np.array([evaluate(x, values, FLOATS) for x in wheel.axis])
    axis /= np.linalg.norm(axis)
    across = float(np.trace(within) - axis @ within @ axis) / 2
    along = float(np.linalg.norm(within @ axis))
    return replace(
        wheel,
        radius=_times(wheel.radius, across),
        axis=_deform(wheel.axis, within, values),
        length=_times(wheel.length, along),
    )


def _scale_lengths(line: ForceElement, ratio: float) -> ForceElement:
    muscle = line.muscle
    if muscle is not None:
        muscle = replace(muscle, fibre=_times(muscle.fibre, ratio), tendon=_times(muscle.tendon, ratio))
    return replace(line, rest=_times(line.rest, ratio), muscle=muscle)
