"""Model -> the text of a model file that `read_model` reads as the same Model.

Values that are the defaults are left out. Joints in a row that have a common name are written by it.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

from mbsgen.expressions import Expression, Number, write
from mbsgen.model.contact_laws import SphereLaw
from mbsgen.model.joints import describe_joint
from mbsgen.model.model import (
    BASE,
    FREE,
    GROUND,
    HERE,
    HERTZ,
    LOAD,
    ONE,
    ORIGIN,
    STOPS,
    UNITS,
    WIDTH,
    ZERO,
    BearingLoad,
    Block,
    Body,
    Capsule,
    Constraint,
    Contact,
    DryFriction,
    Follow,
    ForceElement,
    Frame,
    Grip,
    Hull,
    Inertia,
    Joint,
    Law,
    Loop,
    LoopEnd,
    Model,
    Other,
    Parameter,
    PathPoint,
    Placement,
    Sphere,
    Stop,
    Stops,
    Triple,
    Visual,
    Wrap,
    Wrench,
)
from mbsgen.model.muscles import Muscle
from mbsgen.model.tree import Kind
from mbsgen.model.tyres import BRUSH, FADING, MAGIC, Tyre

MAX_WIDTH = 110  # of a line that holds a mapping or a list as a whole

Value = str | Sequence["Value"] | Mapping[str, "Value"]  # strings are YAML already
Mapped = dict[str, Value]


def write_model(model: Model) -> str:
    """Write a checked model as a model file."""
    content: Mapped = {"name": _quote(model.name), "gravity": _write_triple(model.gravity)}
    if model.parameters:
        content["parameters"] = {_quote(parameter.name): _write_parameter(parameter) for parameter in model.parameters}
    content["bodies"] = [_write_body(body) for body in model.bodies if not body.slips_at]
    if model.frames:
        content["frames"] = [_write_frame(frame) for frame in model.frames]
    if model.wrenches:
        content["wrenches"] = [_write_wrench(wrench) for wrench in model.wrenches]
    if model.forces:
        content["forces"] = [_write_element(element) for element in model.forces]
    if model.contacts:
        content["contacts"] = [_write_contact(contact) for contact in model.contacts]
    if model.stops:
        content["stops"] = [_write_stop(stop) for stop in model.stops]
    if model.loops:
        content["loops"] = [_write_loop(loop) for loop in model.loops]
    if model.constraints:
        content["constraints"] = [_write_constraint(constraint) for constraint in model.constraints]
    for key, listed in (("signals", model.signals), ("driven", model.driven), ("independent", model.independent)):
        if listed:
            content[key] = [_quote(name) for name in listed]
    if model.assembly:
        content["assembly"] = {_quote(joint): _write_number(value) for joint, value in model.assembly}
    if model.loop_tolerance is not None:
        content["loop_tolerance"] = _write_number(model.loop_tolerance)
    if model.allow_unphysical:
        content["allow_unphysical"] = _write_truth(True)
    return "\n".join(_lay_out(content)) + "\n"


# --- what is said ----------------------------------------------------------------------------------------------------


def _write_parameter(parameter: Parameter) -> Value:
    value = _write_number(parameter.value)
    return value if parameter.kind is Kind.CONSTANT else {"value": value, "kind": parameter.kind.value}


def _write_body(body: Body) -> Mapped:
    content: Mapped = {"name": _quote(body.name)}
    if body.parent != BASE:
        content["parent"] = _quote(body.parent)
    content["joint"] = _write_carrier(body)
    if body.mass != ZERO:
        content["mass"] = _write_number(body.mass)
    if body.com != ORIGIN:
        content["com"] = _write_triple(body.com)
    if body.inertia != Inertia():
        content["inertia"] = _write_inertia(body.inertia)
    if body.visuals:
        content["visual"] = [_write_visual(visual) for visual in body.visuals]
    return content


def _write_visual(visual: Visual) -> Mapped:
    numbers = [_write_number(x) for x in visual.size]
    content: Mapped = {"shape": visual.shape}
    match visual.shape:
        case "box" | "ellipsoid":
            content["size"] = numbers
        case "mesh":
            content["file"] = _quote(visual.file)
            if visual.size != (ONE,) * 3:
                content["scale"] = numbers
        case _:
            content |= dict(zip(("radius", "length"), numbers, strict=False))
    content |= _write_placement(visual.placement)
    return {**content, "color": _quote(visual.color)} if visual.color else content


def _write_carrier(body: Body) -> Value:
    described = None if body.is_list else describe_joint(body)
    if described is None:
        return [_write_carrier(replace(body, joint=joint, is_list=False)) for joint in body.joints]
    content: Mapped = {"type": described.type}
    content |= {key: _write_field(value) for key, value in described.fields.items()}
    content |= _write_placement(described.placement)
    if described.setting is not None:
        return _write_name(described.setting) | content | _write_setting(described.setting, actuated=True)
    actuated = described.actuated
    if described.axes and all(joint.actuated != actuated for joint in described.axes.values()):
        actuated = not actuated
        content["actuated"] = _write_truth(actuated)
    axes: Mapped = {}
    for label, joint in described.axes.items():
        if setting := _write_name(joint) | _write_setting(joint, actuated=actuated):
            axes[label] = setting
    return content | ({"axes": axes} if axes else {})


def _write_field(value: str | Expression | Triple) -> Value:
    if isinstance(value, str):
        return value
    return _write_axis(value) if isinstance(value, tuple) else _write_number(value)


def _write_name(joint: Joint) -> Mapped:
    return {} if joint.name is None else {"name": _quote(joint.name)}


def _write_setting(joint: Joint, *, actuated: bool) -> Mapped:
    """Write what a joint is given beside name, axis and place; it is `actuated` without saying."""
    content: Mapped = {}
    if joint.follows is not None:
        content["follows"] = _write_follow(joint.follows)
    if joint.actuated != (actuated and joint.follows is None):
        content["actuated"] = _write_truth(joint.actuated)
    if (joint.lower, joint.upper) != (None, None):
        content["limits"] = _write_limits(joint)
    for key, bound in (("max_speed", joint.max_speed), ("max_force", joint.max_force)):
        if bound is not None:
            content[key] = _write_number(bound)
    content |= _write_law(joint.law)
    if joint.dry is not None:
        content["friction"] = _write_dry(joint.dry)
    if joint.stops is not None:
        content["stops"] = _write_given(joint.stops, STOPS)
    if joint.armature != ZERO:
        content["armature"] = _write_number(joint.armature)
    return content


def _write_limits(part: Joint | Stop) -> list[str]:
    return ["null" if x is None else _write_number(x) for x in (part.lower, part.upper)]


def _write_follow(follow: Follow) -> Mapped:
    content: Mapped = {"joint": _quote(follow.joint)}
    if follow.ratio != ONE:
        content["ratio"] = _write_number(follow.ratio)
    if follow.offset != ZERO:
        content["offset"] = _write_number(follow.offset)
    return content


def _write_law(law: Law) -> Mapped:
    content: Mapped = {
        key: _write_number(getattr(law, key))
        for key in ("stiffness", "rest", "damping", "force")
        if getattr(law, key) != getattr(FREE, key)
    }
    if law.friction is not None:
        speed, torque = _write_number(law.friction.speed), _write_number(law.friction.torque)
        content["friction"] = {"torque": torque, "speed": speed}
    return content


def _write_dry(dry: DryFriction) -> Mapped:
    content = _write_given(dry, ("torque", "static", "stribeck", "one_way"))
    if dry.load is not None:
        content["load"] = _write_given(dry.load, LOAD)
    return content


def _write_given(part: BearingLoad | DryFriction | Stops | Grip, keys: tuple[str, ...]) -> Mapped:
    given = {key: x for key in keys if (x := getattr(part, key)) is not None}
    return {key: _write_number(x) for key, x in given.items() if key != "dissipation" or x != ZERO}


def _write_placement(placement: Placement) -> Mapped:
    content: Mapped = {}
    if placement.position != HERE.position:
        content["position"] = _write_triple(placement.position)
    if placement.orientation:
        content["orientation"] = [
            {"axis": "xyz"[turn.axis], "angle": _write_number(turn.angle)} for turn in placement.orientation
        ]
    return content


def _write_inertia(inertia: Inertia) -> Value:
    entries = {"xx": inertia.xx, "yy": inertia.yy, "zz": inertia.zz}
    mixed = {key: x for key in ("xy", "xz", "yz") if (x := getattr(inertia, key)) != ZERO}
    if not mixed and inertia.about is None:
        return _write_triple((inertia.xx, inertia.yy, inertia.zz))
    content: Mapped = {key: _write_number(entry) for key, entry in (entries | mixed).items()}
    return content if inertia.about is None else {**content, "about": _write_triple(inertia.about)}


def _write_frame(frame: Frame) -> Mapped:
    content: Mapped = {"name": _quote(frame.name), "body": _quote(frame.body), **_write_placement(frame.placement)}
    return content if frame.is_sensor else {**content, "sensor": _write_truth(False)}


def _write_wrench(wrench: Wrench) -> Mapped:
    content: Mapped = {"name": _quote(wrench.name), "body": _quote(wrench.body)}
    content |= _write_placement(wrench.placement)
    if wrench.against is None:
        content["frame"] = "base" if wrench.in_base else "body"
    else:
        content["against"] = _write_end(wrench.against)
    if wrench.by_turns:
        content["about"] = "turns"
    for key, vector in (("force", wrench.force), ("moment", wrench.moment)):
        if vector != ORIGIN:
            content[key] = "input" if vector is None else _write_triple(vector)
    return content


def _write_element(element: ForceElement) -> Mapped:
    content: Mapped = {"name": _quote(element.name)}
    if element.cable is not None:
        content["type"] = "cable"
    if element.muscle is not None:
        content["type"] = "muscle"
    content |= {"from": _write_point(element.first), "to": _write_point(element.second)}
    if element.via:
        content["via"] = [_write_point(point) for point in element.via]
    if element.wraps:
        content["wraps"] = [_write_wrap(wrap) for wrap in element.wraps]
    if element.muscle is not None:
        content["muscle"] = _write_muscle(element.muscle)
    content |= _write_numbers(element, ("stiffness", "rest", "damping"))
    if element.cable is not None:
        content |= _write_numbers(element.cable, ("dissipation",))
        if element.cable.width != WIDTH:
            content["width"] = _write_number(element.cable.width)
    return content | _write_numbers(element, ("force",))


def _write_wrap(wrap: Wrap) -> Mapped:
    content: Mapped = {"type": wrap.kind, "body": _quote(wrap.body)}
    content |= _write_placement(wrap.placement)
    sizes = [_write_number(x) for x in wrap.size]
    if wrap.kind == "ellipsoid":
        content["radii"] = sizes
        content |= {} if wrap.method == "hybrid" else {"method": wrap.method}
    else:
        content |= dict(zip(wrap.keys, sizes, strict=True))
    if wrap.length is not None:
        content["length"] = _write_number(wrap.length)
    if wrap.side:
        content["side"] = _quote(wrap.side)
    return content if wrap.between is None else {**content, "between": [str(x) for x in wrap.between]}


def _write_muscle(muscle: Muscle) -> Mapped:
    usual = Muscle(ZERO, ZERO, ZERO, ZERO)
    content: Mapped = {
        key: _write_number(getattr(muscle, key)) for key in ("strength", "fibre", "tendon", "activation")
    }
    for key in ("pennation", "speed", "damping", "passive", "width"):
        if muscle.numbers[key] != usual.numbers[key]:
            content[key] = _write_number(muscle.numbers[key])
    if muscle.tendon_state is not None:
        strain = {"strain": _write_number(muscle.tendon_strain)} if muscle.tendon_strain != usual.tendon_strain else {}
        content["elastic"] = {"state": _write_number(muscle.tendon_state), **strain}
    if muscle.curves != usual.curves:
        plain = type(muscle.curves)().numbers
        own = {key: _write_number(x) for key, x in muscle.curves.numbers.items() if x != plain.get(key)}
        content["curves"] = {"type": muscle.curves.name, **own}
    return content


def _write_stop(stop: Stop) -> Mapped:
    named: Mapped = {"name": _quote(stop.name), "quantity": _write_number(stop.quantity)}
    named |= {} if stop.is_coupling else {"limits": _write_limits(stop)}
    return named | _write_given(stop.law, STOPS) | _write_numbers(stop, ("hold",))


def _write_contact(contact: Contact) -> Mapped:
    content: Mapped = {"name": _quote(contact.name), "body": _quote(contact.body)}
    content |= _write_placement(contact.placement) | _write_numbers(contact, ("radius",))
    if contact.size is not None:
        content["size"] = _write_triple(contact.size)
    if contact.points:
        content["points"] = [_write_triple(point) for point in contact.points]
    if contact.wheel is not None:
        content["wheel"] = {
            "radius": _write_number(contact.wheel.radius),
            "axis": _write_axis(contact.wheel.axis),
        } | _write_numbers(contact.wheel, ("length",))
    if contact.other != GROUND:
        content[contact.key] = _write_other(contact.other)
    if contact.restitution is None:
        content["stiffness"] = _write_number(contact.stiffness)
    else:
        content["restitution"] = _write_number(contact.restitution)
    if contact.exponent != HERTZ:
        content["exponent"] = _write_number(contact.exponent)
    content |= _write_numbers(contact, ("dissipation",))
    if contact.width != WIDTH:
        content["width"] = _write_number(contact.width)
    if contact.friction is not None:
        content["friction"] = _write_given(contact.friction, ("coefficient", "speed"))
    if contact.tyre is not None:
        content["tyre"] = _write_tyre(contact.tyre)
    if contact.law is not None:
        content["law"] = _write_sphere_law(contact.law)
    return content


def _write_sphere_law(law: SphereLaw) -> Mapped:
    usual = SphereLaw(law.kind)
    given = {key: x for key in law.keys if (x := getattr(law, key)) != getattr(usual, key)}
    content: Mapped = {"type": law.kind}
    return content | {key: _write_number(x) for key, x in given.items()}


def _write_tyre(tyre: Tyre) -> Mapped:
    usual = BRUSH if tyre.kind == "brush" else {key: None if x is None else Number(x) for key, x in MAGIC.items()}
    numbers = {key: _write_number(x) for key, x in tyre.numbers if x != usual[key]}
    own: Mapped = {**numbers}
    if tyre.lengths:
        own["relaxation"] = {way: _write_number(x) for way, x in tyre.lengths}
    content: Mapped = {"brush" if tyre.kind == "brush" else "coefficients": own}
    if tyre.transient:
        content["transient"] = "true"
    if tyre.mirrored:
        content["mirrored"] = "true"
    if tyre.speed != FADING:
        content["speed"] = _write_number(tyre.speed)
    return content


def _write_other(other: Other) -> Mapped:
    content: Mapped = {} if other.body == BASE else {"body": _quote(other.body)}
    content |= _write_placement(other.placement)
    if isinstance(other, Sphere):
        return {**content, "radius": _write_number(other.radius), **({"inside": "true"} if other.inside else {})}
    if isinstance(other, Block):
        return {**content, "size": _write_triple(other.size)}
    if isinstance(other, Capsule):
        return content | {key: _write_number(getattr(other, key)) for key in ("radius", "length")}
    if isinstance(other, Hull):
        return {**content, "points": [_write_triple(x) for x in other.points], **_write_numbers(other, ("radius",))}
    return content if other.normal == GROUND.normal else {**content, "normal": _write_axis(other.normal)}


def _write_numbers(part: object, keys: Sequence[str]) -> Mapped:
    """Write the numbers of a part that are not 0."""
    return {key: _write_number(getattr(part, key)) for key in keys if getattr(part, key) != ZERO}


def _write_loop(loop: Loop) -> Mapped:
    content: Mapped = {
        "name": _quote(loop.name),
        "type": loop.cut.value,
        "from": _write_end(loop.first),
        "to": _write_end(loop.second),
    }
    for key, axis, default in (("axis", loop.axis, UNITS["z"]), ("axis2", loop.axis2, UNITS["x"])):
        if axis != default:
            content[key] = _write_axis(axis)
    numbers = {"length": loop.length, "pitch": loop.pitch}
    return content | {key: _write_number(x) for key, x in numbers.items() if x != ZERO}


def _write_end(end: LoopEnd) -> Mapped:
    return {"body": _quote(end.body), **_write_placement(end.placement)}


def _write_point(point: PathPoint) -> Mapped:
    content = _write_end(point)
    if point.shift != ORIGIN:
        content["shift"] = _write_triple(point.shift)
    if (own := point.presence) is not None:
        bounds = [_write_number(x) for x in (own.lower, own.upper)]
        content["while"] = {"number": _quote(own.number), "range": bounds}
    return content


def _write_constraint(constraint: Constraint) -> Mapped:
    return {"name": _quote(constraint.name), "equation": _write_number(constraint.equation)}


def _write_axis(axis: Triple) -> Value:
    return next((name for name, unit in UNITS.items() if unit == axis), None) or _write_triple(axis)


def _write_triple(triple: Triple) -> Value:
    return [_write_number(component) for component in triple]


def _write_truth(truth: bool) -> str:
    return "true" if truth else "false"


def _write_number(expression: Expression) -> str:
    """Write a number as one, and an expression as text, in quotes where YAML would read something else."""
    text = write(expression)
    return text if isinstance(expression, Number) else _quote(text)


# --- how it is laid out ----------------------------------------------------------------------------------------------

_PLAIN = re.compile(r"[\w(-][\w.+*/()-]*( [\w.+*/()-]+)*", re.ASCII)
_MEANT = re.compile(r"[-+]?\.?\d[\w.+-]*|-?\.?(null|true|false|inf|nan)|- .*", re.IGNORECASE)  # numbers and words


def _quote(text: str) -> str:
    """Put text into quotes, unless YAML reads it as itself without."""
    plain = _PLAIN.fullmatch(text) and not _MEANT.fullmatch(text)
    return text if plain else json.dumps(text, ensure_ascii=False)


def _lay_out(content: Mapped) -> Iterator[str]:
    """Lay a file out: a line for each parameter, frame and wrench that fits into one, a paragraph for each body."""
    for key, value in content.items():
        if isinstance(value, str) or key == "gravity":
            yield f"{key}: {_flow(value)}"
            continue
        yield f"\n{key}:"
        if isinstance(value, Mapping):
            yield from (line for name, inner in value.items() for line in _entry(name, inner, "  "))
            continue
        for i, item in enumerate(value):
            yield from ([""] if i and key == "bodies" else [])
            yield from _item(item, "  ", open=key == "bodies")


def _entry(key: str, value: Value, indent: str) -> Iterator[str]:
    line = f"{indent}{key}: {_flow(value)}"
    if isinstance(value, str) or len(line) <= MAX_WIDTH:
        yield line
        return
    yield f"{indent}{key}:"
    if isinstance(value, Mapping):
        yield from (line for name, inner in value.items() for line in _entry(name, inner, indent + "  "))
    else:
        yield from (line for item in value for line in _item(item, indent + "  "))


def _item(value: Value, indent: str, *, open: bool = False) -> Iterator[str]:
    line = f"{indent}- {_flow(value)}"
    if not isinstance(value, Mapping) or (len(line) <= MAX_WIDTH and not open):
        yield line
        return
    first, *rest = (line for key, inner in value.items() for line in _entry(key, inner, indent + "  "))
    yield f"{indent}- {first.lstrip()}"
    yield from rest


def _flow(value: Value) -> str:
    match value:
        case str():
            return value
        case Mapping():
            return "{" + ", ".join(f"{key}: {_flow(inner)}" for key, inner in value.items()) + "}"
    return "[" + ", ".join(map(_flow, value)) + "]"
