"""Checks of a Model with valid shape: its meaning.

A place listed as doubtful has a finding already; its value is nan here, and nothing is concluded from it.
"""

from __future__ import annotations

import math
from collections.abc import Container, Iterator
from dataclasses import dataclass
from decimal import Decimal

from mbsgen.algebra.dense import Dense, find_eigen, find_largest, identity
from mbsgen.documents import Finding, Place, abbreviate
from mbsgen.expressions import Expression, Negation, Number, write
from mbsgen.model import tree
from mbsgen.model.checks.force_checks import State, check_bodies, check_forces, check_law, list_state
from mbsgen.model.checks.loop_checks import check_loops
from mbsgen.model.checks.naming import check_names
from mbsgen.model.checks.stop_checks import check_stops
from mbsgen.model.checks.undetermined import check_undetermined_joints
from mbsgen.model.elimination import check_constraints
from mbsgen.model.expansion import list_steps
from mbsgen.model.following import check_followers
from mbsgen.model.joints.quaternions import is_pure
from mbsgen.model.model import BASE, COORDINATE, RATE, ZERO, Body, Fixed, Inertia, Joint, Law, Model
from mbsgen.model.placements import centre_inertia
from mbsgen.model.topology import check_tree, find_carriers
from mbsgen.model.tree import Motion
from mbsgen.model.valuation import LARGEST, Valuation

MAX_BODIES = 1000
MAX_VISUALS = 1000  # of a body
LIGHTEST = 1e-150  # the product of two masses does not vanish
INERTIA_TOLERANCE = 1e-9  # of the largest moment
FEW = 0.005  # of a number that is written with one or two digits, which may be meant exactly
_OWN = {COORDINATE: tree.COORDINATE, RATE: tree.RATE}


def find_faults(model: Model, doubtful: Container[Place] = frozenset()) -> list[Finding]:
    """Find all that is wrong with a model. A model without findings makes a Tree."""
    count = sum(max(1, len(body.joints)) for body in model.bodies)
    if not 0 < count <= MAX_BODIES:
        finding = f"{count} bodies{', those between joints included' if count > len(model.bodies) else ''}"
        return [Finding(("bodies",), finding, f"give at least one, and at most {MAX_BODIES}")]
    findings = [*check_names(model, doubtful), *check_tree(model, doubtful)]
    valuation = Valuation(model.parameters, doubtful)
    valuation.triple(("gravity",), model.gravity)
    state = list_state(model)
    for i, body in enumerate(model.bodies):
        findings += _check_carrier(i, body, valuation, state)
        findings += _check_body(("bodies", i), body, valuation, allow_unphysical=model.allow_unphysical)
        findings += _check_visuals(("bodies", i, "visual"), body, valuation)
    for i, frame in enumerate(model.frames):
        valuation.placement(("frames", i), frame.placement)
    findings += check_forces(model, valuation)
    findings += check_followers(model, valuation)
    findings += check_stops(model, valuation)
    findings += check_loops(model, valuation, doubtful)
    findings += valuation.findings
    if findings or not valuation.is_complete:  # a doubtful number is a fault of the file already
        return findings
    return [
        *check_undetermined_joints(model),
        *_check_fixed(model),
        *check_bodies(model),
        *check_constraints(model),
    ]


def _check_carrier(i: int, body: Body, valuation: Valuation, state: State) -> Iterator[Finding]:
    if isinstance(body.joint, Fixed):
        valuation.placement(("bodies", i, "joint"), body.joint.placement)
    elif isinstance(body.joint, tuple) and len(body.joint) < 2:
        finding = f"a sequence of {len(body.joint)} joints"
        yield Finding(("bodies", i, "joint"), finding, "give two or more, or one joint by itself")
    for step in list_steps(i, body):
        yield from _check_joint(step.place, step.joint, valuation, state)
    if any(joint.floats for joint in body.joints) and not is_pure(body.joints):  # only a model made in Python has them
        finding = "joints of a quaternion with other joints, or with names, limits, forces or rotors"
        yield Finding(("bodies", i, "joint"), finding, "make them by ball() or free(), and leave them as they are")


def _check_joint(place: Place, joint: Joint, valuation: Valuation, state: State) -> Iterator[Finding]:
    valuation.placement(place, joint.placement)
    axis = [valuation.constant((*place, "axis"), component) for component in joint.axis]
    if axis == [0, 0, 0]:
        finding = f"[{', '.join(map(write, joint.axis))}] has no direction"
        yield Finding((*place, "axis"), finding, "give a nonzero 3-vector, e.g. [0, 1, 0]")
    lower, upper = (
        math.nan if limit is None else valuation.constant((*place, "limits", k), limit)
        for k, limit in enumerate((joint.lower, joint.upper))
    )
    if lower > upper:
        yield Finding((*place, "limits"), f"the lower limit {lower:g} is above the upper {upper:g}", "swap them")
    yield from _check_law(place, joint.law, valuation, state)
    for key, bound in (("max_speed", joint.max_speed), ("max_force", joint.max_force)):
        value = math.nan if bound is None else valuation.constant((*place, key), bound)
        if value <= 0:
            yield Finding((*place, key), f"found {value:g}", "give more than 0, or leave it out")
    armature = valuation.number((*place, "armature"), joint.armature)
    if armature < 0:
        yield Finding((*place, "armature"), f"an armature of {armature:g}", "give 0 or more")


def _check_law(place: Place, law: Law, valuation: Valuation, state: State) -> Iterator[Finding]:
    before = len(valuation.findings)
    findings = [*_check_law_numbers(place, law, valuation)]
    yield from findings
    if not findings and len(valuation.findings) == before:
        yield from check_law((*place, "force"), law.total, valuation, state, _OWN)


def _check_law_numbers(place: Place, law: Law, valuation: Valuation) -> Iterator[Finding]:
    """Spring, damper and friction take energy out; only the author's own expression may add some."""
    given: dict[Place, Expression] = {("stiffness",): law.stiffness, ("damping",): law.damping}
    if law.friction is not None:
        given["friction", "torque"] = law.friction.torque
        speed = valuation.number((*place, "friction", "speed"), law.friction.speed)
        if speed <= 0:
            yield Finding((*place, "friction", "speed"), f"a speed of {speed:g}", "give more than 0")
    for key, expression in given.items():
        value = valuation.number((*place, *key), expression)
        if value < 0:
            remedy = f"give 0 or more; a law of another kind goes into force, in {COORDINATE} and {RATE}"
            yield Finding((*place, *key), f"{key[-1]} {value:g}", remedy)
    valuation.number((*place, "rest"), law.rest)
    if law.rest != ZERO and law.stiffness == ZERO:
        yield Finding((*place, "rest"), "a rest position without a spring", "give a stiffness too")


def _check_body(place: Place, body: Body, valuation: Valuation, *, allow_unphysical: bool) -> Iterator[Finding]:
    valuation.triple((*place, "com"), body.com)
    mass = valuation.number((*place, "mass"), body.mass)
    if mass < 0:
        yield Finding((*place, "mass"), f"a mass of {mass:g}", "give 0 or more")
    if 0 < mass < LIGHTEST:
        yield Finding((*place, "mass"), f"a mass of {mass:g}", f"give 0, or {LIGHTEST:g} to {LARGEST:g}")
    place = (*place, "inertia")
    given, inertia = (
        tuple(tuple(valuation.number(place, entry) for entry in row) for row in tensor.rows)
        for tensor in (body.inertia, centre_inertia(body))
    )
    if allow_unphysical or not all(math.isfinite(x) for row in inertia for x in row):
        return
    if mass == 0 and any(map(any, inertia)) and not valuation.changes(body.mass):
        yield Finding(place, "an inertia without a mass", "give the body a mass too, or set allow_unphysical: true")
    excess = _measure_excess(body.inertia, inertia)
    if excess.amount > max(INERTIA_TOLERANCE * find_largest(given), excess.rounding):
        remedy = "none may be more than the sum of the others; mend them, or set allow_unphysical: true"
        yield Finding(place, f"no body has {excess.describe()}", remedy)


def _check_visuals(place: Place, body: Body, valuation: Valuation) -> Iterator[Finding]:
    if len(body.visuals) > MAX_VISUALS:
        yield Finding(place, f"{len(body.visuals)} shapes", f"give at most {MAX_VISUALS}, or one mesh")
    for k, visual in enumerate(body.visuals[:MAX_VISUALS]):
        valuation.placement((*place, k), visual.placement)
        key = {"box": "size", "ellipsoid": "size", "mesh": "scale"}.get(visual.shape)
        for j, expression in enumerate(visual.size):
            at = (*place, k, ("radius", "length")[j]) if key is None else (*place, k, key, j)
            value = valuation.number(at, expression)
            if value == 0 or (value < 0 and key != "scale"):
                remedy = "give another number; a negative one mirrors" if key == "scale" else "give more than 0"
                yield Finding(at, f"found {value:g}", remedy)


@dataclass(frozen=True)
class _Excess:
    """By how much the largest principal moment of a tensor is more than the sum of the others."""

    moments: tuple[float, float, float]
    amount: float
    rounding: float  # what of it the last digits may account for, as they are written

    def describe(self) -> str:
        """Write the moments with as many digits as it takes to see the excess."""
        for digits in range(6, 18):
            shown = [f"{moment:.{digits}g}" for moment in self.moments]
            a, b, c = map(float, shown)
            if a + b < c:
                break
        return f"the principal moments of inertia {', '.join(shown)}"


def _measure_excess(written: Inertia, inertia: Dense) -> _Excess:
    """Compare the moments; to first order, an entry that is off by d changes the excess by d times its weight."""
    (a, b, c), (*_, e) = find_eigen(inertia)
    rows = zip(identity(3), e, written.rows, strict=True)
    rounding = sum(
        abs(one - 2 * x * y) * _measure_rounding(entry)
        for ones, x, row in rows
        for one, y, entry in zip(ones, e, row, strict=True)
    )
    return _Excess((a, b, c), c - a - b, rounding)


def _measure_rounding(entry: Expression) -> float:
    """Measure half of the last digit of a number as it is written; of few digits, FEW of the number."""
    match entry:
        case Negation(operand):
            return _measure_rounding(operand)
        case Number(value) if value:
            exponent = Decimal(repr(abs(value))).as_tuple().exponent
            assert isinstance(exponent, int), "a number of a file is finite"
            return min(0.5 * 10.0**exponent, FEW * abs(value))
    return 0.0


def find_doubts(model: Model) -> list[Finding]:
    """Find what a checked model may err in: tensors that are physical only if their last digits are rounded."""
    valuation, findings = Valuation(model.parameters, ()), []
    for i, body in enumerate(() if model.allow_unphysical else model.bodies):
        given, inertia = (
            tuple(valuation.triple((), row) for row in tensor.rows) for tensor in (body.inertia, centre_inertia(body))
        )
        excess = _measure_excess(body.inertia, inertia)
        if excess.amount > INERTIA_TOLERANCE * find_largest(given):
            finding = f"rounding to the digits given has made a possible inertia {excess.describe()}"
            findings.append(Finding(("bodies", i, "inertia"), finding, "give more digits"))
    return findings


def _check_fixed(model: Model) -> Iterator[Finding]:
    """Find what goes wrong where bodies that are fixed to each other become one."""
    carriers = find_carriers(model)
    for i, body in enumerate(model.bodies):
        is_free = any(joint.floats and joint.motion is Motion.PRISMATIC for joint in body.joints)
        if is_free and carriers[body.parent] != BASE:
            finding = f"a free body within the tree, on {abbreviate(body.parent)}"
            yield Finding(("bodies", i, "joint"), finding, f"let only bodies on {BASE} move freely")
    if set(carriers.values()) == {BASE}:
        yield Finding(("bodies",), "nothing moves", "give a body a joint that is not fixed")
