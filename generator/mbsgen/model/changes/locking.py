"""Locked joints: a Model, and coordinates of joints that are not to move -> a Model in which they are fixed.

Equations keep the coordinates of locked joints as numbers. An equation between locked joints that holds is left out;
one that does not hold stays, and `checks` finds it. Loops stay: whether the other joints of a loop can still move is
found where loops are assembled.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace

from mbsgen.expressions import Call, Expression, Negation, Number, Operation, names, substitute
from mbsgen.model.elimination import eliminate
from mbsgen.model.expansion import list_steps
from mbsgen.model.following import find_rules, list_joints, place_followers
from mbsgen.model.model import (
    HERE,
    ORIGIN,
    ZERO,
    Body,
    Constraint,
    Fixed,
    ForceElement,
    Joint,
    Model,
    PathPoint,
    Placement,
    Rotation,
    Triple,
    Wrench,
)
from mbsgen.model.placements import add, compose, divide, multiply
from mbsgen.model.quantities import list_quantities
from mbsgen.model.tree import Motion, coordinate_symbol
from mbsgen.model.valuation import Valuation

OPEN = 1e-9  # largest residual of an equation between locked joints, m or rad: users round the coordinates they write


def lock(model: Model, coordinates: Mapping[str, Expression]) -> Model:
    """Fix joints, by name, at their coordinates [rad or m]; they lose limits, forces and inputs with their freedom.

    Joints that follow them, or that a linear constraint ties to them alone, are fixed accordingly.
    """
    if not coordinates:
        return model
    coordinates = _place_tied(model, coordinates)
    fixed = _fix_quantities(model, coordinates)
    valuation = Valuation(model.parameters, ())
    bodies = [part for i, body in enumerate(model.bodies) for part in _lock_body(i, body, coordinates, fixed)]
    return replace(
        model,
        bodies=tuple(bodies),
        wrenches=tuple(_lock_wrench(wrench, fixed) for wrench in model.wrenches),
        forces=tuple(_lock_element(x, fixed, valuation) for x in model.forces),
        stops=tuple(replace(x, quantity=substitute(x.quantity, fixed)) for x in model.stops),
        constraints=tuple(_lock_constraints(model, coordinates)),
        driven=tuple(name for name in model.driven if name not in coordinates),
        independent=tuple(name for name in model.independent if name not in coordinates),
        assembly=tuple((name, rough) for name, rough in model.assembly if name not in coordinates),
    )


def _place_tied(model: Model, coordinates: Mapping[str, Expression]) -> dict[str, Expression]:
    """Return the coordinates of some joints, and of all joints that these determine by rules of followers."""
    steps = list_joints(eliminate(model))
    placed = dict(coordinates)
    for name, rule in find_rules(steps).items():
        if name in coordinates:
            difference = coordinates[name] if rule.offset == ZERO else Operation("-", coordinates[name], rule.offset)
            placed.setdefault(rule.joint, divide(difference, rule.ratio))
    return place_followers(steps, placed)


def _lock_constraints(model: Model, coordinates: Mapping[str, Expression]) -> Iterator[Constraint]:
    valuation, known = Valuation(model.parameters, ()), {p.name for p in model.parameters}
    for constraint in model.constraints:
        equation = substitute(constraint.equation, coordinates)
        if names(equation) <= known:
            left = valuation.form((), equation, {})
            if left is not None and left.is_number and abs(left) <= OPEN:
                continue
        yield replace(constraint, equation=equation)


def _fix_quantities(model: Model, coordinates: Mapping[str, Expression]) -> dict[str, Expression]:
    """Return the coordinates and velocities of locked joints, by the names that forces have for them."""
    known = {name: x for name, x in list_quantities(model).items() if x.joint in coordinates}
    return {
        name: coordinates[x.source] if x.symbol == coordinate_symbol(x.source) else ZERO for name, x in known.items()
    }


def _lock_wrench(wrench: Wrench, fixed: Mapping[str, Expression]) -> Wrench:
    force, moment = (
        None if vector is None else _triple(substitute(x, fixed) for x in vector)
        for vector in (wrench.force, wrench.moment)
    )
    return replace(wrench, force=force, moment=moment)


def _lock_element(element: ForceElement, fixed: Mapping[str, Expression], valuation: Valuation) -> ForceElement:
    """Fix what a line reads of locked joints; points that it does not pass then are left out."""

    def is_passed(point: PathPoint) -> bool:
        own = point.presence
        if own is None or own.number not in fixed:
            return True
        lower, q, upper = (valuation.number((), x) for x in (own.lower, fixed[own.number], own.upper))
        return lower <= q <= upper

    def settle(point: PathPoint) -> PathPoint:
        own = point.presence
        presence = None if own is None or own.number in fixed else own
        return replace(point, shift=_triple(substitute(x, fixed) for x in point.shift), presence=presence)

    return replace(
        element,
        first=settle(element.first),
        second=settle(element.second),
        via=tuple(settle(x) for x in element.via if is_passed(x)),
        force=substitute(element.force, fixed),
    )


def _triple(components: Iterable[Expression]) -> Triple:
    x, y, z = components
    return x, y, z


def _lock_body(
    i: int, body: Body, coordinates: Mapping[str, Expression], fixed: Mapping[str, Expression]
) -> list[Body]:
    """Fix joints of one body; joints that go on moving have a massless body each, as they have without this."""
    steps = list(list_steps(i, body))
    if not any(step.name in coordinates for step in steps):
        return [_read_fixed(body, fixed)]
    parts: list[Body] = []
    carrier, rest = body.parent, HERE  # what has been fixed since the last joint that moves
    for step in steps:
        placement = compose(rest, step.joint.placement)
        if step.name in coordinates:
            rest = compose(placement, displacement(step.joint, coordinates[step.name]))
        else:
            law = replace(step.joint.law, force=substitute(step.joint.law.force, fixed))
            joint = replace(step.joint, name=step.name, placement=placement, law=law)
            parts.append(Body(step.mover, joint, carrier))
            carrier, rest = step.mover, HERE
    if carrier == body.name:  # the last joint moves: it carries the body itself
        return [*parts[:-1], replace(body, joint=parts[-1].joint, parent=parts[-1].parent)]
    return [*parts, replace(body, joint=Fixed(rest), parent=carrier)]


def _read_fixed(body: Body, fixed: Mapping[str, Expression]) -> Body:
    """Replace coordinates and velocities of locked joints in the force laws of a body's joints by numbers."""

    def read(joint: Joint) -> Joint:
        return replace(joint, law=replace(joint.law, force=substitute(joint.law.force, fixed)))

    match body.joint:
        case Fixed():
            return body
        case Joint():
            return replace(body, joint=read(body.joint))
    return replace(body, joint=tuple(map(read, body.joint)))


def displacement(joint: Joint, coordinate: Expression) -> Placement:
    """Express a joint's motion as a placement."""
    k = next((k for k in range(3) if all(c == ZERO for i, c in enumerate(joint.axis) if i != k)), None)
    if joint.motion is Motion.PRISMATIC:
        share = divide(coordinate, _length(joint.axis))
        x, y, z = (multiply(share, component) for component in joint.axis)
        return Placement((x, y, z))
    if k is not None and isinstance(joint.axis[k], Number):
        positive = joint.axis[k].value > 0  # type: ignore[union-attr]
        return Placement(ORIGIN, (Rotation(k, coordinate if positive else Negation(coordinate)),))
    x, y, z = joint.axis  # turned so that z lies along the axis, about it, and back
    azimuth = Call("atan2", (y, x))
    polar = Call("atan2", (Call("sqrt", (add(multiply(x, x), multiply(y, y)),)), z))
    before = (Rotation(2, azimuth), Rotation(1, polar))
    after = (Rotation(1, Negation(polar)), Rotation(2, Negation(azimuth)))
    return Placement(ORIGIN, (*before, Rotation(2, coordinate), *after))


def _length(axis: Triple) -> Expression:
    numbers = [c.value for c in axis if isinstance(c, Number)]
    if len(numbers) == 3 and sorted(map(abs, numbers)) == [0.0, 0.0, 1.0]:
        return Number(1.0)
    x, y, z = (multiply(c, c) for c in axis)
    return Call("sqrt", (add(add(x, y), z),))
