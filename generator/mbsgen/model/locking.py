"""Locked joints: a Model, and coordinates of joints that are not to move -> a Model in which they are fixed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from mbsgen.expressions import Call, Expression, Negation, Number, Operation
from mbsgen.model.expansion import list_steps
from mbsgen.model.following import list_joints, place_followers
from mbsgen.model.model import HERE, ORIGIN, ZERO, Body, Fixed, Joint, Model, Placement, Rotation, Triple
from mbsgen.model.tree import Motion


def lock(model: Model, coordinates: Mapping[str, Expression]) -> Model:
    """Fix joints, by name, at their coordinates [rad or m]; they lose limits, forces and inputs with their freedom.

    Joints that follow them are fixed where they are then.
    """
    coordinates = place_followers(list_joints(model), coordinates)
    bodies = [part for i, body in enumerate(model.bodies) for part in _lock_body(i, body, coordinates)]
    return replace(model, bodies=tuple(bodies))


def _lock_body(i: int, body: Body, coordinates: Mapping[str, Expression]) -> list[Body]:
    """Fix joints of one body; joints that go on moving have a massless body each, as they have without this."""
    steps = list(list_steps(i, body))
    if not any(step.name in coordinates for step in steps):
        return [body]
    parts: list[Body] = []
    carrier, rest = body.parent, HERE  # what has been fixed since the last joint that moves
    for step in steps:
        placement = compose(rest, step.joint.placement)
        if step.name in coordinates:
            rest = compose(placement, displacement(step.joint, coordinates[step.name]))
        else:
            joint = replace(step.joint, name=step.name, placement=placement)
            parts.append(Body(step.mover, joint, carrier))
            carrier, rest = step.mover, HERE
    if carrier == body.name:  # the last joint moves: it carries the body itself
        return [*parts[:-1], replace(body, joint=parts[-1].joint, parent=parts[-1].parent)]
    return [*parts, replace(body, joint=Fixed(rest), parent=carrier)]


def displacement(joint: Joint, coordinate: Expression) -> Placement:
    """Express a joint's motion as a placement."""
    k = next((k for k in range(3) if all(c == ZERO for i, c in enumerate(joint.axis) if i != k)), None)
    if joint.motion is Motion.PRISMATIC:
        share = _quotient(coordinate, _length(joint.axis))
        x, y, z = (_product(share, component) for component in joint.axis)
        return Placement((x, y, z))
    if k is not None and isinstance(joint.axis[k], Number):
        positive = joint.axis[k].value > 0  # type: ignore[union-attr]
        return Placement(ORIGIN, (Rotation(k, coordinate if positive else Negation(coordinate)),))
    x, y, z = joint.axis  # turned so that z lies along the axis, about it, and back
    azimuth = Call("atan2", (y, x))
    polar = Call("atan2", (Call("sqrt", (_sum(_product(x, x), _product(y, y)),)), z))
    before = (Rotation(2, azimuth), Rotation(1, polar))
    after = (Rotation(1, Negation(polar)), Rotation(2, Negation(azimuth)))
    return Placement(ORIGIN, (*before, Rotation(2, coordinate), *after))


def compose(first: Placement, second: Placement) -> Placement:
    """Place in one frame what `second` places in the frame that `first` places there."""
    moved = second.position
    for rotation in reversed(first.orientation):
        moved = _rotate(rotation, moved)
    x, y, z = (_sum(a, b) for a, b in zip(first.position, moved, strict=True))
    return Placement((x, y, z), first.orientation + second.orientation)


def _rotate(rotation: Rotation, v: Triple) -> Triple:
    if v == ORIGIN:
        return v
    j, k = (rotation.axis + 1) % 3, (rotation.axis + 2) % 3
    c, s = Call("cos", (rotation.angle,)), Call("sin", (rotation.angle,))
    turned = list(v)
    turned[j] = _sum(_product(c, v[j]), _product(Negation(s), v[k]))
    turned[k] = _sum(_product(s, v[j]), _product(c, v[k]))
    x, y, z = turned
    return x, y, z


def _length(axis: Triple) -> Expression:
    numbers = [c.value for c in axis if isinstance(c, Number)]
    if len(numbers) == 3 and sorted(map(abs, numbers)) == [0.0, 0.0, 1.0]:
        return Number(1.0)
    x, y, z = (_product(c, c) for c in axis)
    return Call("sqrt", (_sum(_sum(x, y), z),))


def _sum(a: Expression, b: Expression) -> Expression:
    if a == ZERO or b == ZERO:
        return b if a == ZERO else a
    return Operation("+", a, b)


def _product(a: Expression, b: Expression) -> Expression:
    if a == ZERO or b == ZERO:
        return ZERO
    if Number(1.0) in (a, b):
        return b if a == Number(1.0) else a
    return Operation("*", a, b)


def _quotient(a: Expression, b: Expression) -> Expression:
    return a if b == Number(1.0) else Operation("/", a, b)
