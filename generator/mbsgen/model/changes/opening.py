"""Forces that no kernel has, opened: Model -> the same without rigid stops, dry friction and rigid points, and inputs.

A joint with rigid stops or dry friction gets a signal, the force of both in the direction of q. A rigid point of
contact becomes a sensor and an open wrench in axes of the base. The limits of joints stay. So a use can give these
forces, as each phase of a motion has them.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

from mbsgen.expressions import Name, Operation
from mbsgen.manifest import BearingLoad, Friction, OpenContact, OpenJoint, Stops
from mbsgen.model import model as parts
from mbsgen.model.expansion import list_steps
from mbsgen.model.model import BASE, ZERO, Body, Contact, Fixed, Frame, Joint, Model, Placement, Plane, Wrench
from mbsgen.model.valuation import Valuation

HOLD = "hold_{}"  # the signal of a joint
AXIS = 1e-12  # components across a normal, relative to it: smaller ones count as 0


@dataclass(frozen=True)
class Opened:
    """A model whose switching forces are inputs, and their laws."""

    model: Model
    joints: tuple[OpenJoint, ...] = ()
    contacts: tuple[OpenContact, ...] = ()


def open_forces(model: Model) -> Opened:
    """Open the forces of a checked model; other shapes than points on planes of the base stay rigid contacts."""
    valuation = Valuation(model.parameters, ())
    taken = {*valuation.names, *model.signals, "t"}
    joints: list[OpenJoint] = []
    bodies = tuple(_open_body(i, body, valuation, taken, joints) for i, body in enumerate(model.bodies))
    names = {x.name for x in model.frames} | {x.name for x in model.wrenches} | {x.name for x in model.bodies}
    points = list(_open_contacts(model, valuation, names))
    opened = {contact.name for contact, _ in points}
    kept = [contact for contact in model.contacts if contact.name not in opened]
    changed = replace(
        model,
        bodies=bodies,
        signals=(*model.signals, *(joint.signal for joint in joints)),
        contacts=tuple(kept),
        frames=(*model.frames, *(_make_frame(contact, law.point) for contact, law in points)),
        wrenches=(*model.wrenches, *(_make_wrench(contact, law.point) for contact, law in points)),
    )
    return Opened(changed, tuple(joints), tuple(law for _, law in points))


def _open_body(i: int, body: Body, valuation: Valuation, taken: set[str], found: list[OpenJoint]) -> Body:
    """Open the joints of a body; add their laws to `found` and their signals to `taken`."""
    if isinstance(body.joint, Fixed):
        return body
    joints = [_open_joint(step.joint, step.name, valuation, taken, found) for step in list_steps(i, body)]
    return replace(body, joint=joints[0] if isinstance(body.joint, Joint) else tuple(joints))


def _open_joint(joint: Joint, name: str, valuation: Valuation, taken: set[str], found: list[OpenJoint]) -> Joint:
    stops = joint.stops if joint.stops is not None and joint.stops.restitution is not None else None
    if (stops is None and joint.dry is None) or joint.follows is not None:
        return joint
    signal = _find_free(HOLD.format("".join(x if x.isalnum() else "_" for x in name)), taken)

    def read(expression: object) -> float | None:
        return None if expression is None else valuation.number((), expression)  # type: ignore[arg-type]

    ends = friction = None
    if stops is not None:
        ends = Stops(lower=read(joint.lower), upper=read(joint.upper), restitution=read(stops.restitution))
    if joint.dry is not None:
        torque, way = valuation.number((), joint.dry.torque), read(joint.dry.one_way)
        static = torque if joint.dry.static is None else valuation.number((), joint.dry.static)
        friction = Friction(
            torque=torque,
            static=static,
            stribeck=read(joint.dry.stribeck),
            one_way=0 if way is None else 1 if way > 0 else -1,
            load=_describe_load(joint.dry.load, valuation),
        )
    found.append(OpenJoint(name=name, signal=signal, stops=ends, friction=friction))
    force = Name(signal) if joint.law.force == ZERO else Operation("+", joint.law.force, Name(signal))
    law = replace(joint.law, force=force)
    return replace(joint, law=law, dry=None, stops=joint.stops if stops is None else None)


def _describe_load(load: parts.BearingLoad | None, valuation: Valuation) -> BearingLoad | None:
    if load is None:
        return None
    coefficient, static, radius, length = (
        None if x is None else valuation.number((), x)
        for x in (load.coefficient, load.static, load.radius, load.length)
    )
    assert coefficient is not None, "a coefficient is required"
    return BearingLoad(
        coefficient=coefficient,
        static=coefficient if static is None else static,
        arm=1.0 if radius is None else radius,
        length=length,
    )


def _open_contacts(model: Model, valuation: Valuation, taken: set[str]) -> Iterator[tuple[Contact, OpenContact]]:
    """Yield the rigid points on planes of the base whose normals are its axes, and their laws."""
    for contact in model.contacts:
        other = contact.other
        is_point = contact.radius == ZERO and not contact.has_points and contact.wheel is None
        if contact.restitution is None or not is_point or not isinstance(other, Plane) or other.body != BASE:
            continue
        normal, position = valuation.triple((), other.normal), valuation.triple((), other.position)
        axis = max(range(3), key=lambda k: float(normal[k]))
        changing = any(map(valuation.changes, (*other.normal, *other.position)))
        if changing or math.hypot(*(x for k, x in enumerate(normal) if k != axis)) > AXIS * normal[axis]:
            continue
        grip = 0.0 if contact.friction is None else valuation.number((), contact.friction.coefficient)
        yield (
            contact,
            OpenContact(
                name=contact.name,
                point=_find_free(contact.name, taken),
                axis=axis,
                height=float(position[axis]),
                restitution=valuation.number((), contact.restitution),
                coefficient=grip,
            ),
        )


def _make_frame(contact: Contact, name: str) -> Frame:
    return Frame(name, contact.body, Placement(contact.placement.position))


def _make_wrench(contact: Contact, name: str) -> Wrench:
    return Wrench(name, contact.body, contact.placement.position, force=None)


def _find_free(name: str, taken: set[str]) -> str:
    """Return a name that nothing has, and take it."""
    while name in taken:
        name += "_"
    taken.add(name)
    return name
