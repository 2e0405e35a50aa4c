"""Checks of wrenches, force elements and contacts."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from types import MappingProxyType

from sympy import Expr, Symbol

from mbsgen.documents import Finding, Place, abbreviate, nearest
from mbsgen.expressions import Expression, names, parse, substitute, write
from mbsgen.model.bushings import NAMES
from mbsgen.model.contact_laws import SphereLaw
from mbsgen.model.elements import POWERS
from mbsgen.model.model import (
    BASE,
    HERTZ,
    LENGTH,
    LENGTH_RATE,
    WIDTH,
    ZERO,
    Block,
    Capsule,
    Contact,
    ForceElement,
    Hull,
    Model,
    PathPoint,
    Plane,
    Sphere,
    Triple,
    Wrap,
    Wrench,
)
from mbsgen.model.muscles import Muscle
from mbsgen.model.quantities import find_moving, find_stopped, list_quantities, name_lengths
from mbsgen.model.solids import find_solids, has_inside, list_expressions
from mbsgen.model.topology import find_carriers
from mbsgen.model.tyres import LATERAL, LONGITUDINAL, MAGIC, NEEDED, POSITIVE, Tyre
from mbsgen.model.valuation import Valuation

MOST_POINTS = 100  # of a hull
State = Mapping[str, Expr]  # the symbols that forces may read, by name


def list_state(model: Model) -> State:
    """Return the symbols of all numbers of the state, by name."""
    return {name: quantity.symbol for name, quantity in list_quantities(model).items()}


def check_forces(model: Model, valuation: Valuation) -> Iterator[Finding]:
    """Find what is wrong with the values of wrenches, force elements and contacts."""
    state, lengths = list_state(model), name_lengths([x.name for x in model.forces])
    read = {own for name, own in lengths.items() if name in find_stopped(model)}
    for i, wrench in enumerate(model.wrenches):
        yield from _check_wrench(("wrenches", i), wrench, valuation, state)
    for i, element in enumerate(model.forces):
        yield from _check_element(("forces", i), element, valuation, state, is_read=element.name in read)
    for i, contact in enumerate(model.contacts):
        yield from _check_contact(("contacts", i), contact, valuation)


def check_law(
    place: Place, expression: Expression, valuation: Valuation, state: State, own: State = MappingProxyType({})
) -> Iterator[Finding]:
    """Find what is wrong with an expression over parameters, the state, and a joint's own numbers, by their symbols."""
    both = sorted(names(expression) & (state.keys() - own.keys()) & valuation.names)
    for name in both:
        finding = f"{name} is a parameter, and a number of the state too"
        yield Finding(place, finding, "give the parameter another name")
    if not both:
        valuation.form(place, expression, {**state, **own})


def _check_wrench(place: Place, wrench: Wrench, valuation: Valuation, state: State) -> Iterator[Finding]:
    valuation.placement(place, wrench.placement)
    own: State = {}
    if wrench.against is not None:
        valuation.placement((*place, "against"), wrench.against.placement)
        own = {name: Symbol(name, real=True) for name in NAMES}
        state = {**state, **own}
    elif wrench.body == BASE:
        yield Finding((*place, "body"), f"{BASE} does not move", "name the body that the wrench acts on")
    yield from _check_sides(place, wrench)
    idle = True
    for key, vector in (("force", wrench.force), ("moment", wrench.moment)):
        if vector is None:
            idle = False
            continue
        for k, component in enumerate(vector):
            if names(component) & state.keys():
                idle = False
                yield from check_law((*place, key, k), component, valuation, state, own)
            else:
                value = valuation.number((*place, key, k), component)
                idle = idle and value == 0 and not valuation.changes(component)
    if idle:
        yield Finding(place, "a wrench without force and moment", "give one of them numbers, or input")


def _check_sides(place: Place, wrench: Wrench) -> Iterator[Finding]:
    """Find keys of a wrench that have no meaning with, or without, another frame."""
    if wrench.against is None:
        for key, is_given in (("orientation", bool(wrench.orientation)), ("about", wrench.by_turns)):
            if is_given:
                yield Finding((*place, key), "it has no meaning without `against`", "take it away, or give `against`")
        return
    if not wrench.in_base:
        finding = "its components are along the axes of `against`"
        yield Finding((*place, "frame"), finding, "take it away; give `against` the orientation")
    for key, vector in (("force", wrench.force), ("moment", wrench.moment)):
        if vector is None:
            yield Finding((*place, key), "an input between two frames", "give three expressions, which read signals")


def _check_element(
    place: Place, element: ForceElement, valuation: Valuation, state: State, *, is_read: bool
) -> Iterator[Finding]:
    """Find what is wrong with a force element, whose length a stop may read."""
    points = [
        (("from",), element.first),
        *((("via", k), x) for k, x in enumerate(element.via)),
        (("to",), element.second),
    ]
    for keys, point in points:
        yield from _check_point((*place, *keys), point, valuation, state)
    for key, end in (("from", element.first), ("to", element.second)):
        if end.presence is not None:
            yield Finding(
                (*place, key, "while"),
                "an end with a range, outside of which the line would have no end",
                "give such a point under via",
            )
    for k, wrap in enumerate(element.wraps):
        yield from _check_wrap((*place, "wraps", k), wrap, element.wraps[:k], len(element.path), valuation)
    own: State = {LENGTH: Symbol(LENGTH, real=True), LENGTH_RATE: Symbol(LENGTH_RATE, real=True)}
    yield from check_law((*place, "force"), element.force, valuation, {**state, **own})
    if element.muscle is not None:
        yield from _check_muscle(place, element, element.muscle, valuation, {**state, **own})
        return
    given = {"stiffness": element.stiffness, "rest": element.rest, "damping": element.damping}
    if element.cable is not None:
        given["dissipation"] = element.cable.dissipation
        yield from _check_positive((*place, "width"), element.cable.width, valuation)
        if element.damping != ZERO:
            remedy = "give dissipation: a part of the tension, so that it cannot push"
            yield Finding((*place, "damping"), "the damping of a cable", remedy)
    for key, expression in given.items():
        yield from _check_not_negative((*place, key), expression, valuation)
    if element.stiffness == ZERO and (element.rest != ZERO or element.cable is not None):
        key = "rest" if element.rest != ZERO else "type"
        yield Finding(
            (*place, key),
            f"{write(element.rest)} at rest without a spring" if key == "rest" else "a cable without stiffness",
            "give a stiffness too",
        )
    elif (element.stiffness, element.damping, element.force) == (ZERO, ZERO, ZERO) and not is_read:
        remedy = "give a stiffness, a damping or a force, or a stop for its length"
        yield Finding(place, "a force element without force", remedy)


def _check_point(place: Place, point: PathPoint, valuation: Valuation, state: State) -> Iterator[Finding]:
    """Find what is wrong with a point of a line."""
    valuation.placement(place, point.placement)
    coordinates = {name: x for name, x in state.items() if name.startswith("q_")}
    remedy = "use q_NAME of joints, and parameters"
    for k, component in enumerate(point.shift):
        for name in sorted(names(component) & (state.keys() - coordinates.keys()) - valuation.names):
            yield Finding((*place, "shift", k), f"a point that moves with {name}", remedy)
            return
        yield from check_law((*place, "shift", k), component, valuation, coordinates)
    if (own := point.presence) is not None:
        if own.number not in coordinates:
            meant = nearest(own.number, [*coordinates])
            remedy = f"did you mean {meant}?" if meant else "give q_NAME of a joint without quaternion"
            yield Finding((*place, "while", "number"), f"there is no coordinate {abbreviate(own.number)}", remedy)
        bounds = [valuation.number((*place, "while", "range", k), x) for k, x in enumerate((own.lower, own.upper))]
        if bounds[0] >= bounds[1]:
            yield Finding((*place, "while", "range"), f"a range from {bounds[0]:g} to {bounds[1]:g}", "swap them")


def _check_wrap(
    place: Place, wrap: Wrap, before: Sequence[Wrap], count: int, valuation: Valuation
) -> Iterator[Finding]:
    """Find what is wrong with a surface around which a line of some points wraps."""
    valuation.placement(place, wrap.placement)
    for k, (key, size) in enumerate(zip(wrap.keys, wrap.size, strict=True)):
        at = ("radii", k) if wrap.kind == "ellipsoid" else (key,)
        yield from _check_positive((*place, *at), size, valuation)
    if wrap.kind == "torus":
        ring, tube = (valuation.number((*place, key), x) for key, x in zip(wrap.keys, wrap.size, strict=True))
        if ring <= tube:
            yield Finding((*place, "tube"), f"a tube of {tube:g} m in a ring of {ring:g} m", "give a thinner one")
    if wrap.length is not None:
        yield from _check_positive((*place, "length"), wrap.length, valuation)
        if wrap.kind != "cylinder":
            finding = f"the length of {'an' if wrap.kind == 'ellipsoid' else 'a'} {wrap.kind}"
            yield Finding((*place, "length"), finding, "take it away, or give type: cylinder")
    if wrap.side.endswith("z") and wrap.axial:
        yield Finding((*place, "side"), f"a side along the axis of a {wrap.kind}", "give x, -x, y or -y")
    first, last = wrap.span(count)
    if not 0 <= first < last < count:
        finding = f"points {first + 1} and {last + 1} of a line of {count}"
        yield Finding((*place, "between"), finding, "give the numbers of two of its points, from 1, in order")
    for start, end in (other.span(count) for other in before):
        if max(first, start) < min(last, end):
            finding = "two surfaces between the same points"
            yield Finding((*place, "between"), finding, "let each surface have other points, by between")


def _check_muscle(
    place: Place, element: ForceElement, muscle: Muscle, valuation: Valuation, state: State
) -> Iterator[Finding]:
    """Find what is wrong with the numbers of a muscle."""
    for key, number in (("stiffness", element.stiffness), ("damping", element.damping), ("force", element.force)):
        if number != ZERO:
            yield Finding((*place, key), f"a {key} beside the law of a muscle", "add a spring beside the muscle")
    if element.cable is not None:
        yield Finding((*place, "type"), "a cable that is a muscle", "give type: muscle")
    place = (*place, "muscle")
    yield from check_law((*place, "activation"), muscle.activation, valuation, state)
    if muscle.tendon_state is not None:
        yield from check_law((*place, "elastic", "state"), muscle.tendon_state, valuation, state)
        yield from _check_positive((*place, "elastic", "strain"), muscle.tendon_strain, valuation)
    for key in ("strength", "fibre", "speed", "width"):
        yield from _check_positive((*place, key), muscle.numbers[key], valuation)
    for key in ("tendon", "pennation", "damping", "passive"):
        yield from _check_not_negative((*place, key), muscle.numbers[key], valuation)
    if (angle := valuation.number((*place, "pennation"), muscle.pennation)) >= math.pi / 2:
        yield Finding(
            (*place, "pennation"), f"an angle of {angle:g} rad", "give less than a quarter turn; 15 deg has a unit"
        )
    yield from _check_curves((*place, "curves"), muscle, valuation)


def _check_curves(place: Place, muscle: Muscle, valuation: Valuation) -> Iterator[Finding]:
    """Find numbers of curves with which no smooth curve joins their points."""
    numbers = muscle.curves.numbers
    given: dict[str, Expression] = {**numbers, "passive": muscle.passive, "strain": muscle.tendon_strain}
    meant = set(given) - {"passive"} if muscle.passive == ZERO else set(given)
    meant -= {"strain"} if muscle.tendon_state is None else set()
    for limits in muscle.curves.limits:
        if limits.key not in numbers or not limits.reads <= meant:
            continue
        value = valuation.number((*place, limits.key), numbers[limits.key])
        lower, upper = (
            valuation.number((*place, limits.key), substitute(parse(text), given)) if text else math.inf
            for text in (limits.lower, limits.upper)
        )
        if not (lower < value < upper or (not limits.is_strict and value in (lower, upper))):
            between = f"more than {lower:.4g}" if upper == math.inf else f"a number between {lower:.4g} and {upper:.4g}"
            yield Finding((*place, limits.key), f"found {value:g}", f"give {between}")


def _check_contact(place: Place, contact: Contact, valuation: Valuation) -> Iterator[Finding]:
    valuation.placement(place, contact.placement)
    yield from _check_other(place, contact, valuation)
    yield from _check_not_negative((*place, "radius"), contact.radius, valuation)
    if contact.size is not None:
        for k, edge in enumerate(contact.size):
            yield from _check_positive((*place, "size", k), edge, valuation)
        if contact.radius != ZERO:
            finding = "a box with a radius"
            yield Finding((*place, "radius"), finding, "give a size or a radius, or its corners as points")
    yield from _check_points(place, contact, valuation)
    if contact.tyre is not None:
        yield from _check_tyre(place, contact, contact.tyre, valuation)
    if contact.wheel is not None:
        yield from _check_positive((*place, "wheel", "radius"), contact.wheel.radius, valuation)
        if contact.size is not None:
            yield Finding((*place, "wheel"), "a wheel with a size", "give one of them")
        yield from _check_not_negative((*place, "wheel", "length"), contact.wheel.length, valuation)
        if not isinstance(contact.other, Plane):
            yield Finding((*place, "wheel"), f"a wheel and a {contact.key}", "a wheel touches a plane alone")
    yield from _check_positive((*place, "width"), contact.width, valuation)
    if contact.law is not None:
        yield from _check_law(place, contact, contact.law, valuation)
    if contact.is_rigid:
        yield from _check_rigid(place, contact, valuation)
        return
    yield from _check_positive((*place, "stiffness"), contact.stiffness, valuation)
    yield from _check_not_negative((*place, "dissipation"), contact.dissipation, valuation)
    exponent = valuation.constant((*place, "exponent"), contact.exponent)
    if exponent == exponent and exponent not in POWERS:  # nan: it has a finding
        yield Finding((*place, "exponent"), f"found {exponent:g}", f"give one of {', '.join(f'{x:g}' for x in POWERS)}")
    if contact.friction is not None:
        at = (*place, "friction")
        yield from _check_not_negative((*at, "coefficient"), contact.friction.coefficient, valuation)
        if contact.friction.speed is None:
            finding = "dry friction of a compliant contact"
            yield Finding(at, finding, "give a speed that smooths it, or restitution in place of stiffness")
        else:
            yield from _check_positive((*at, "speed"), contact.friction.speed, valuation)


def _check_law(place: Place, contact: Contact, law: SphereLaw, valuation: Valuation) -> Iterator[Finding]:
    """Find what is wrong with a law of a sphere, and numbers that it has no use for."""
    at, other = (*place, "law"), contact.other
    is_ball = isinstance(other, Plane) or (isinstance(other, Sphere) and not other.inside)
    if contact.has_points or contact.wheel is not None or contact.radius == ZERO or not is_ball:
        yield Finding(at, "a law that is not of a sphere on a plane or a sphere", "leave it out, or give a radius")
    if law.kind == "smooth" and isinstance(other, Sphere):
        yield Finding(at, "a smooth law of two spheres", "give hunt_crossley, or a plane")
    for key, usual in (("exponent", HERTZ), ("width", WIDTH)):
        if getattr(contact, key) != usual:
            yield Finding((*place, key), f"the {key} beside a law", "leave it out: the law has its own")
    if contact.is_rigid:
        yield Finding(at, "the law of a rigid contact", "leave it out, or give stiffness in place of restitution")
    if contact.friction is None and (law.static is not None or law.viscous != ZERO):
        yield Finding((*place, "friction"), "missing", "give a coefficient and a speed beside static and viscous")
    for key in law.keys:
        number = getattr(law, key)
        if key in ("depth_slope", "speed_slope"):
            yield from _check_positive((*at, key), number, valuation)
        elif number is not None:
            yield from _check_not_negative((*at, key), number, valuation)
    if valuation.number((*at, "share"), law.share) > 1:
        yield Finding((*at, "share"), "more than 1", "give a part of the depth")


def _check_points(place: Place, contact: Contact, valuation: Valuation) -> Iterator[Finding]:
    """Find what is wrong with the points of a hull."""
    at = (*place, "points")
    for k, point in enumerate(contact.points):
        for axis, number in enumerate(point):
            valuation.number((*at, k, axis), number)
    if len(contact.points) == 1:
        yield Finding(at, "one point", "give it as position, or further points")
    if len(contact.points) > MOST_POINTS:
        finding = f"{len(contact.points)} points, where {MOST_POINTS} are allowed"
        yield Finding(at, finding, "give the corners of a coarser hull: each point adds equations")
    if contact.points and (contact.size is not None or contact.wheel is not None):
        other = "a wheel" if contact.size is None else "a size"
        yield Finding(at, f"points with {other}", "give one of them")


def _check_tyre(place: Place, contact: Contact, tyre: Tyre, valuation: Valuation) -> Iterator[Finding]:
    """Find what is wrong with a tyre and its numbers."""
    at = (*place, "tyre")
    if contact.wheel is None:
        yield Finding(at, "a tyre without a wheel", "give the contact a wheel")
    elif contact.wheel.length != ZERO:
        yield Finding(at, "a tyre on a cylinder", "leave out the length of the wheel: a tyre touches at one point")
    for key, given in (("friction", contact.friction), ("restitution", contact.restitution)):
        if given is not None:
            yield Finding((*place, key), f"{key} beside a tyre", "leave it out: the tyre has its own law")
    yield from _check_positive((*at, "speed"), tyre.speed, valuation)
    inner = (*at, "brush" if tyre.kind == "brush" else "coefficients")
    for key, number in tyre.numbers:
        if tyre.kind == "brush" and key == "length":
            yield from _check_not_negative((*inner, key), number, valuation)
        elif tyre.kind == "brush" or (key in POSITIVE and number != ZERO):
            yield from _check_positive((*inner, key), number, valuation)
        elif key not in MAGIC:
            meant = nearest(key, [*MAGIC])
            remedy = f"did you mean {meant}?" if meant else "give names as in TIR files of MF-Tyre 5.2"
            yield Finding((*inner, key), f"there is no coefficient {abbreviate(key)}", remedy)
        else:
            valuation.number((*inner, key), number)
    for way, length in tyre.lengths:
        yield from _check_positive((*at, "brush", "relaxation", way), length, valuation)
    values = dict(tyre.numbers)
    yield from _check_transient(at, tyre, values, valuation)
    if missing := [key for key in (*NEEDED, *POSITIVE) if tyre.kind == "magic" and values[key] == ZERO]:
        finding = f"{', '.join(dict.fromkeys(missing))} missing, or 0"
        yield Finding(inner, finding, "give them, or a file: the formulas divide by them")


def _check_transient(
    at: Place, tyre: Tyre, values: Mapping[str, Expression], valuation: Valuation
) -> Iterator[Finding]:
    """Find what is wrong with the coefficients by which the slips of a Magic Formula relax."""
    if not tyre.transient:
        return
    if not tyre.relaxed:
        finding = "no relaxation length: PTX1 and PTY1 are missing, or 0"
        yield Finding((*at, "transient"), finding, "give them under coefficients, or leave out transient")
    read = {LONGITUDINAL: ("PTX1", "LSGKP"), LATERAL: ("PTY1", "PTY2", "LSGAL")}
    for key in (key for way in tyre.relaxed for key in read[way]):
        yield from _check_positive((*at, "coefficients", key), values[key], valuation)


def _check_rigid(place: Place, contact: Contact, valuation: Valuation) -> Iterator[Finding]:
    assert contact.restitution is not None, "a rigid contact"
    for key, number, none in (
        ("stiffness", contact.stiffness, ZERO),
        ("dissipation", contact.dissipation, ZERO),
        ("exponent", contact.exponent, HERTZ),
    ):
        if number != none:
            yield Finding((*place, key), f"the {key} of a rigid contact", "leave it out, or leave out restitution")
    value = valuation.constant((*place, "restitution"), contact.restitution)
    if value < 0 or value > 1:
        yield Finding((*place, "restitution"), f"found {value:g}", "give 0, where nothing rebounds, to 1")
    if contact.friction is not None:
        at = (*place, "friction")
        value = valuation.constant((*at, "coefficient"), contact.friction.coefficient)
        if value < 0:
            yield Finding((*at, "coefficient"), f"found {value:g}", "give 0 or more")
        if contact.friction.speed is not None:
            finding = "smoothed friction of a rigid contact"
            yield Finding((*at, "speed"), finding, "leave out speed: its friction is dry")


def _check_other(place: Place, contact: Contact, valuation: Valuation) -> Iterator[Finding]:
    """Find what is wrong with the side that is touched."""
    other, at = contact.other, (*place, contact.key)
    valuation.placement(at, other.placement)
    if isinstance(other, Plane):
        yield from _check_normal((*at, "normal"), other.normal, valuation)
    elif isinstance(other, Block):
        for k, edge in enumerate(other.size):
            yield from _check_positive((*at, "size", k), edge, valuation)
    elif isinstance(other, Capsule):
        for key in ("radius", "length"):
            yield from _check_positive((*at, key), getattr(other, key), valuation)
    elif isinstance(other, Hull):
        yield from _check_not_negative((*at, "radius"), other.radius, valuation)
        if not 2 <= len(other.points) <= MOST_POINTS:
            finding = f"{len(other.points)} points, where 2 to {MOST_POINTS} are allowed"
            yield Finding((*at, "points"), finding, "give the corners of a hull, or a sphere")
            return
    else:
        yield from _check_positive((*at, "radius"), other.radius, valuation)
        if other.inside:
            within = valuation.number((*at, "radius"), other.radius)
            own = valuation.number((*place, "radius"), contact.radius)
            if 0 < within <= own:
                finding = f"found {within:g}, where the contact's own radius is {own:g}"
                yield Finding((*at, "radius"), finding, "give more: that sphere stays within")
    if contact.is_of_solids:
        yield from _check_solids(place, contact, valuation)
        return


def _check_solids(place: Place, contact: Contact, valuation: Valuation) -> Iterator[Finding]:
    """Find what is wrong with two solids with corners."""
    own = "size" if contact.size is not None else "points" if contact.points else contact.key
    if not contact.is_rigid:
        finding = f"a compliant {'box' if own == 'size' else 'hull'} and a {contact.key}"
        finding += f": its corners miss a {contact.key} between them"
        remedy = "give the contact a radius, one for each sphere of the solid"
        if isinstance(contact.other, Sphere) and (contact.size is not None or len(contact.points) == 2):
            remedy = "exchange the sides: a contact with a radius touches a box or a capsule"
        remedy = f"give restitution in place of stiffness; or {remedy}"
        yield Finding((*place, own), finding, remedy)
        return
    if any(math.isnan(valuation.constant((*place, contact.key), x)) for x in list_expressions(contact)):
        return  # it has a finding
    for key, (corners, radius) in zip(
        (own, contact.key), find_solids(contact, lambda x: valuation.number(place, x)), strict=True
    ):
        if not has_inside(corners):
            yield Finding((*place, key), "all points lie in a plane", "give the corners of a solid, or two points")
        if len(corners) == 2 and radius == 0:
            yield Finding((*place, key), "two points without a radius", "give a radius: they make a capsule")


def _check_normal(place: Place, normal: Triple, valuation: Valuation) -> Iterator[Finding]:
    if [valuation.constant(place, component) for component in normal] == [0, 0, 0]:
        finding = f"[{', '.join(map(write, normal))}] has no direction"
        yield Finding(place, finding, "give a nonzero 3-vector, e.g. [0, 0, 1]")


def _check_positive(place: Place, number: Expression, valuation: Valuation) -> Iterator[Finding]:
    if (value := valuation.number(place, number)) <= 0:
        yield Finding(place, f"found {value:g}", "give more than 0")


def _check_not_negative(place: Place, number: Expression, valuation: Valuation) -> Iterator[Finding]:
    if (value := valuation.number(place, number)) < 0:
        yield Finding(place, f"found {value:g}", "give 0 or more")


def check_bodies(model: Model) -> Iterator[Finding]:
    """Find forces that do nothing, because their bodies do not move, or not relative to each other."""
    carriers = find_carriers(model)
    for i, stop in enumerate(model.stops):
        if not find_moving(stop.quantity, model, carriers):
            finding = f"{write(stop.quantity)} does not change"
            yield Finding(("stops", i, "quantity"), finding, "let it depend on a coordinate, or take the stop away")
    for i, wrench in enumerate(model.wrenches):
        if wrench.against is None and carriers.get(wrench.body) == BASE and wrench.body != BASE:
            finding = f"{abbreviate(wrench.body)} is fixed to {BASE}, and does not move"
            yield Finding(("wrenches", i, "body"), finding, "take the wrench away")
    pairs = [(("forces", i), x.first.body, x.second.body) for i, x in enumerate(model.forces) if x.is_straight]
    for i, x in enumerate(model.forces):
        if not x.is_straight and len({carriers.get(body, body) for body in x.bodies}) == 1:
            finding = "its points do not move relative to each other"
            yield Finding(("forces", i), finding, "name bodies that move relative to each other, or take it away")
    pairs += [(("contacts", i), x.body, x.other.body) for i, x in enumerate(model.contacts)]
    pairs += [(("wrenches", i), x.body, x.against.body) for i, x in enumerate(model.wrenches) if x.against is not None]
    for place, first, second in pairs:
        if first in carriers and carriers[first] == carriers.get(second):  # a body that is missing has a finding
            finding = f"{abbreviate(first)} and {abbreviate(second)} do not move relative to each other"
            yield Finding(
                place,
                finding if first != second else f"both ends are on {abbreviate(first)}",
                "name two bodies that move relative to each other, or take it away",
            )
