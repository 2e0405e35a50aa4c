"""Checks of stops, and of dry friction of joints."""

from __future__ import annotations

import math
from collections.abc import Iterator

from sympy import Symbol

from mbsgen.documents import Finding, Place, abbreviate
from mbsgen.expressions import names
from mbsgen.model.checks.force_checks import State, check_law, list_state
from mbsgen.model.following import list_joints
from mbsgen.model.model import LENGTH, ZERO, BearingLoad, DryFriction, Joint, Model, Stop, Stops
from mbsgen.model.quantities import list_poses, name_lengths
from mbsgen.model.tree import Motion
from mbsgen.model.valuation import Valuation


def check_stops(model: Model, valuation: Valuation) -> Iterator[Finding]:
    """Find what is wrong with stops and dry friction."""
    for step in list_joints(model):
        joint, place = step.joint, step.place
        if joint.stops is not None:
            yield from _check_joint_stops(place, joint, joint.stops, valuation)
        if joint.dry is not None:
            yield from _check_dry((*place, "friction"), joint, joint.dry, valuation)
        keys = [key for key, is_own in (("friction", joint.dry), ("stops", _is_rigid(joint.stops))) if is_own]
        for key in keys:
            what = "dry friction" if key == "friction" else "rigid stops"
            if joint.follows is not None:
                finding = f"{what} on a joint that follows {abbreviate(joint.follows.joint)}"
                yield Finding((*place, key), finding, "give it to the other joint")
            elif step.name in model.driven:
                finding = f"{what} on a joint whose motion is given (driven)"
                yield Finding((*place, key), finding, "leave it out: the given motion needs the force that it needs")

    known = {name: x.symbol for name, x in list_poses(model).items()}
    known |= {
        name: Symbol(f"{LENGTH} {own}", real=True) for name, own in name_lengths([x.name for x in model.forces]).items()
    }
    yield from _check_company(model)
    for i, stop in enumerate(model.stops):
        yield from _check_stop(("stops", i), stop, known, valuation, list_state(model))


def _is_rigid(stops: Stops | None) -> bool:
    return stops is not None and stops.restitution is not None


def _check_joint_stops(place: Place, joint: Joint, stops: Stops, valuation: Valuation) -> Iterator[Finding]:
    yield from _check_law((*place, "stops"), stops, valuation)
    if joint.lower is None and joint.upper is None:
        finding = "stops of a joint without limits"
        yield Finding((*place, "stops"), finding, "give limits: [-1, 1], or null at an end without a stop")
    if stops.restitution is not None:
        lower, upper = (
            math.nan if x is None else valuation.constant((*place, "limits", k), x)
            for k, x in enumerate((joint.lower, joint.upper))
        )
        if lower == upper:
            finding = f"both stops are at {lower:g}"
            yield Finding((*place, "limits"), finding, "leave the joint room, or make it fixed")


def _check_law(place: Place, stops: Stops, valuation: Valuation) -> Iterator[Finding]:
    if (stops.restitution is None) == (stops.stiffness is None):
        found = "neither restitution nor stiffness" if stops.stiffness is None else "both restitution and stiffness"
        yield Finding(place, found, "give restitution of rigid stops, or stiffness of compliant ones")
    if stops.restitution is not None:
        value = valuation.constant((*place, "restitution"), stops.restitution)
        if value < 0 or value > 1:
            yield Finding((*place, "restitution"), f"found {value:g}", "give 0, where nothing rebounds, to 1")
        if stops.dissipation != ZERO:
            yield Finding((*place, "dissipation"), "the dissipation of rigid stops", "leave it out, or give stiffness")
    elif stops.stiffness is not None:
        value = valuation.number((*place, "stiffness"), stops.stiffness)
        if value <= 0:
            yield Finding((*place, "stiffness"), f"found {value:g}", "give more than 0")
        value = valuation.number((*place, "dissipation"), stops.dissipation)
        if value < 0:
            yield Finding((*place, "dissipation"), f"found {value:g}", "give 0 or more")


def _check_stop(place: Place, stop: Stop, known: State, valuation: Valuation, state: State) -> Iterator[Finding]:
    """Find what is wrong with stops at limits of a number of the pose; `known` are the numbers that it may read."""
    yield from _check_law(place, stop.law, valuation)
    hold = valuation.constant((*place, "hold"), stop.hold)
    if hold < 0:
        yield Finding((*place, "hold"), f"found {hold:g}", "give 0 or more")
    if hold > 0 and stop.law.restitution != ZERO:
        remedy = "give restitution: 0: a latch holds no number that rebounds"
        yield Finding((*place, "hold"), "a latch that is not rigid, or rebounds", remedy)
    at = (*place, "quantity")
    for name in sorted(names(stop.quantity) & (state.keys() - known.keys()) - valuation.names):
        remedy = "use q_NAME of joints, x_, y_, z_NAME of frames, length_NAME of forces, and parameters"
        yield Finding(at, f"{name} is no number of the pose", remedy)
        return
    yield from check_law(at, stop.quantity, valuation, known)
    lower, upper = (
        math.nan if x is None else valuation.number((*place, "limits", k), x)
        for k, x in enumerate((stop.lower, stop.upper))
    )
    if stop.is_coupling and not hold > 0:
        yield Finding((*place, "limits"), "no limit", "give one or two numbers: [0, null], [null, 1], [0, 1]")
    elif lower >= upper:
        finding = f"limits from {lower:g} to {upper:g}"
        yield Finding((*place, "limits"), finding, "give the lower one first, and leave room between them")


def _check_dry(place: Place, joint: Joint, dry: DryFriction, valuation: Valuation) -> Iterator[Finding]:
    if joint.law.friction is not None:
        finding = "smoothed friction (speed) that is dry too (static, stribeck, one_way, load)"
        yield Finding(place, finding, "leave out speed, or static, stribeck, one_way and load")
        return
    torque = valuation.constant((*place, "torque"), dry.torque)
    static = torque if dry.static is None else valuation.constant((*place, "static"), dry.static)
    stribeck = math.nan if dry.stribeck is None else valuation.constant((*place, "stribeck"), dry.stribeck)
    if torque < 0:
        yield Finding((*place, "torque"), f"found {torque:g}", "give 0 or more")
    if static < torque:
        finding = f"{static:g} holds the joint at rest, and {torque:g} brakes it when it slides"
        yield Finding((*place, "static"), finding, f"give {torque:g} or more")
    if stribeck <= 0:
        yield Finding((*place, "stribeck"), f"a speed of {stribeck:g}", "give more than 0")
    if dry.load is not None:
        yield from _check_load((*place, "load"), joint, dry.load, valuation)
        if dry.one_way is not None:
            finding = "a one-way clutch with friction by its load"
            yield Finding((*place, "one_way"), finding, "leave out load, or one_way")
    if dry.stribeck is not None and dry.static is None and (dry.load is None or dry.load.static is None):
        yield Finding((*place, "stribeck"), "a stribeck speed without static", "give static too")
    if dry.one_way is not None:
        way = valuation.constant((*place, "one_way"), dry.one_way)
        if way not in (-1, 1):
            yield Finding((*place, "one_way"), f"found {way:g}", "give 1, where the joint moves forward alone, or -1")
        if _is_rigid(joint.stops):
            finding = "a one-way clutch in a joint with rigid stops"
            yield Finding((*place, "one_way"), finding, "give one of them, or give the stops a stiffness")


def _check_load(place: Place, joint: Joint, load: BearingLoad, valuation: Valuation) -> Iterator[Finding]:
    sliding = valuation.constant((*place, "coefficient"), load.coefficient)
    static = sliding if load.static is None else valuation.constant((*place, "static"), load.static)
    if sliding < 0:
        yield Finding((*place, "coefficient"), f"found {sliding:g}", "give 0 or more")
    if static < sliding:
        finding = f"{static:g} holds the joint at rest, and {sliding:g} brakes it when it slides"
        yield Finding((*place, "static"), finding, f"give {sliding:g} or more")
    for key, length in (("radius", load.radius), ("length", load.length)):
        if length is not None and (value := valuation.constant((*place, key), length)) <= 0:
            yield Finding((*place, key), f"found {value:g}", "give more than 0 m")
    if joint.motion is Motion.REVOLUTE and load.radius is None:
        yield Finding(place, "friction of a pin without its radius", "give radius: 0.01, in m")
    if joint.motion is Motion.PRISMATIC and load.radius is not None:
        finding = "the radius of a pin, of a joint that slides"
        yield Finding((*place, "radius"), finding, "leave it out: its friction is the coefficient times the load")


def _check_company(model: Model) -> Iterator[Finding]:
    """Find what a model has beside friction by loads that simulations do not take together."""
    steps = [step for step in list_joints(model) if step.joint.dry is not None and step.joint.dry.load is not None]
    stopped = [step.name for step in list_joints(model) if _is_rigid(step.joint.stops)]
    others = {
        "loops": model.loops,
        "constraints": model.constraints,
        "driven joints": model.driven,
        "rigid stops": (*stopped, *(x for x in model.stops if x.law.restitution is not None)),
        "rigid contacts": [x for x in model.contacts if x.restitution is not None],
    }
    for what in [what for what, found in others.items() if found] if steps else ():
        remedy = "give a torque in place of load, which does not depend on it"
        if what.startswith("rigid"):
            remedy += "; or give a stiffness in place of a restitution"
        place = (*steps[0].place, "friction", "load")
        yield Finding(place, f"friction by the load of a joint, in a model with {what}", remedy)
