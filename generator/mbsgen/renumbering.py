"""The numbers of a model that an identification changes: inertias of bodies, friction and rotors of joints.

They are read as floats, and written back into the model, from which a model file follows. A body's moments are its
mass, first moment and tensor about the origin of its frame, along its axes: `roles.MOMENTS`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

from mbsgen.algebra.dense import Dense, Row, combine, dot, identity, subtract
from mbsgen.expressions import FLOATS, Expression, Number, Operation, evaluate, parse
from mbsgen.model.expansion import list_steps
from mbsgen.model.model import Body, Fixed, Friction, Inertia, Joint, Law, Model

DIGITS = 13  # of written numbers


@dataclass(frozen=True)
class Carried:
    """A body, without the bodies that are fixed to it."""

    name: str
    moments: tuple[float, ...]  # ten, of `roles.MOMENTS`
    is_carried: bool  # by its own joint; else it is fixed to another body


@dataclass(frozen=True)
class Moved:
    """The terms of a joint that an identification knows."""

    name: str
    damping: float
    torque: float  # of dry friction [N m or N]
    speed: float  # of dry friction [rad/s or m/s]; 0: the model has none
    armature: float


@dataclass(frozen=True)
class Numbers:
    """The present numbers of a model."""

    bodies: tuple[Carried, ...]
    joints: tuple[Moved, ...]
    allows_unphysical: bool


@dataclass(frozen=True)
class Changes:
    """New numbers, by the names of bodies and joints; further terms of a joint's force are expressions."""

    moments: Mapping[str, Sequence[float]]
    damping: Mapping[str, float]
    friction: Mapping[str, tuple[float, float]]  # torque and speed
    armature: Mapping[str, float]
    force: Mapping[str, str]
    parameters: Mapping[str, float]


def read_numbers(model: Model, parameters: Mapping[str, float]) -> Numbers:
    """Read the numbers of bodies and joints; `parameters` replace the model's."""
    values = _evaluate_parameters(model, parameters)
    return Numbers(
        tuple(Carried(body.name, _read_moments(body, values), _is_carried(body)) for body in model.bodies),
        tuple(_read_joint(name, joint, values) for name, joint in _list_joints(model)),
        model.allow_unphysical,
    )


def change_numbers(model: Model, changes: Changes) -> Model:
    """Return a model with other numbers."""
    bodies = (_change_body(i, body, changes) for i, body in enumerate(model.bodies))
    parameters = (
        replace(p, value=_round(changes.parameters[p.name])) if p.name in changes.parameters else p
        for p in model.parameters
    )
    return replace(model, bodies=tuple(bodies), parameters=tuple(parameters))


def _evaluate_parameters(model: Model, given: Mapping[str, float]) -> dict[str, float]:
    values: dict[str, float] = {}
    for parameter in model.parameters:
        values[parameter.name] = given.get(parameter.name, evaluate(parameter.value, values, FLOATS))
    return values


def _list_joints(model: Model) -> Iterator[tuple[str, Joint]]:
    for i, body in enumerate(model.bodies):
        if not isinstance(body.joint, Fixed):
            yield from ((step.name, step.joint) for step in list_steps(i, body))


def _is_carried(body: Body) -> bool:
    """Return whether a joint carries a body; one of a standard table lies beyond its joint."""
    return not isinstance(body.joint, Fixed) or body.joint.row is not None


def _read_joint(name: str, joint: Joint, values: Mapping[str, float]) -> Moved:
    def read(number: Expression) -> float:
        return evaluate(number, values, FLOATS)

    dry = joint.law.friction
    torque, speed = (0.0, 0.0) if dry is None else (read(dry.torque), read(dry.speed))
    return Moved(name, read(joint.law.damping), torque, speed, read(joint.armature))


def _read_moments(body: Body, values: Mapping[str, float]) -> tuple[float, ...]:
    def read(number: Expression) -> float:
        return evaluate(number, values, FLOATS)

    m, com = read(body.mass), tuple(read(x) for x in body.com)
    about = com if body.inertia.about is None else tuple(read(x) for x in body.inertia.about)
    own = tuple(tuple(read(x) for x in row) for row in body.inertia.rows)
    J = combine(lambda x, y, z: x + y - z, own, steiner(m, com), steiner(m, subtract(com, about)))
    return (m, *(m * x for x in com), *(J[r][c] for r in range(3) for c in range(r, 3)))


def steiner(m: float, r: Row) -> Dense:
    """Return the tensor of a point mass at r."""
    square = dot(r, r)
    products = tuple(tuple(x * y for y in r) for x in r)
    return combine(lambda one, product: m * (square * one - product), identity(3), products)


def _change_body(i: int, body: Body, changes: Changes) -> Body:
    if not isinstance(body.joint, Fixed):
        steps = [_change_joint(step.name, step.joint, changes) for step in list_steps(i, body)]
        body = replace(body, joint=steps[0] if isinstance(body.joint, Joint) else tuple(steps))
    if body.name not in changes.moments:
        return body
    m, *rest = (float(x) for x in changes.moments[body.name])
    com = tuple(moment / m for moment in rest[:3])
    shift = steiner(m, com)
    places = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
    J = (_round(moment - shift[r][c]) for moment, (r, c) in zip(rest[3:], places, strict=True))
    x, y, z = (_round(c) for c in com)
    xx, xy, xz, yy, yz, zz = J
    return replace(body, mass=_round(m), com=(x, y, z), inertia=Inertia(xx, yy, zz, xy, xz, yz))


def _round(x: float) -> Number:
    """Write a number without the last digits, which roundings make."""
    return Number(float(f"{x:.{DIGITS}g}"))


def _change_joint(name: str, joint: Joint, changes: Changes) -> Joint:
    law: Law = joint.law
    if name in changes.damping:
        law = replace(law, damping=_round(changes.damping[name]))
    if name in changes.friction:
        torque, speed = changes.friction[name]
        law = replace(law, friction=Friction(_round(torque), _round(speed)))
    if name in changes.force:
        more = parse(changes.force[name])
        law = replace(law, force=more if law.force == Number(0.0) else Operation("+", law.force, more))
    armature = _round(changes.armature[name]) if name in changes.armature else joint.armature
    return replace(joint, law=law, armature=armature)
