"""A Model made in Python: parts with the defaults of a file, from numbers and text; checked as a file is.

Every number may be an expression over the parameters, as text, such as `"l1/2"`:

    rod = body("rod", revolute("y", damping=0.1), mass="m", com=(0, 0, "-l/2"), inertia=("m*l**2/12", "m*l**2/12", 0))
    pendulum = make_model("pendulum", [rod], gravity=(0, 0, -9.81), parameters={"l": 1.2, "m": runtime(0.5)})

Every function raises ValueError for a faulty number, axis or order; `make_model` raises InputError with all faults of
the whole. Lengths are in m, angles in rad, masses in kg, inertias in kg m2.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence, Sized
from dataclasses import replace
from numbers import Real
from typing import Literal, TypedDict, Unpack

from mbsgen.documents import Data, WrongValueError, abbreviate, refuse, take, write_path
from mbsgen.errors import Fault
from mbsgen.expressions import Expression, write
from mbsgen.model.checks.checks import find_faults
from mbsgen.model.contact_laws import SphereLaw
from mbsgen.model.file.loops import read_cut
from mbsgen.model.joints import find_joint_type
from mbsgen.model.joints.dh import DhSection
from mbsgen.model.joints.section import JointSection
from mbsgen.model.model import (
    BASE,
    GROUND,
    LOAD,
    STOPS,
    WIDTH,
    ZERO,
    BearingLoad,
    Block,
    Body,
    Cable,
    Capsule,
    Carrier,
    Constraint,
    Contact,
    DryFriction,
    Fixed,
    Follow,
    ForceElement,
    Frame,
    Friction,
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
    Plane,
    Rotation,
    Sphere,
    Stop,
    Stops,
    Triple,
    Wheel,
    Wrench,
)
from mbsgen.model.sections import read_direction, read_friction, read_number
from mbsgen.model.slips import list_slips
from mbsgen.model.tree import Cut, Kind, Motion
from mbsgen.model.tyres import BRUSH, MAGIC, WAYS, Tyre, drop_unread

Quantity = Expression | float | str  # a number, or an expression as text
Vector = Sequence[Quantity]  # three of them
Direction = str | Vector  # x, y, z, -x, -y, -z, or a vector of any length but 0
Turns = Sequence[tuple[str, Quantity]]  # axis and angle of rotations in turn, each about the axes turned so far
Limits = tuple[Quantity | None, Quantity | None]  # None: unbounded
DryKeys = Mapping[str, Quantity | Mapping[str, Quantity]]  # the keys of friction in a file; below `load` its own


class Setting(TypedDict, total=False):
    """The settings of a joint beside its axis; missing ones have the defaults of a file."""

    name: str
    position: Vector  # the pose of the moving frame on the parent, at q = 0
    orientation: Turns
    actuated: bool
    limits: Limits
    max_speed: Quantity  # of qd, either way
    max_force: Quantity  # of u, either way
    stiffness: Quantity  # force: -stiffness (q - rest) - damping qd - T tanh(qd/v) + force
    rest: Quantity
    damping: Quantity
    friction: tuple[Quantity, Quantity] | DryKeys  # T, v; or dry, by the keys of a file
    stops: Mapping[str, Quantity]  # by the keys of a file
    force: Quantity  # over parameters, q and qd
    armature: Quantity  # of the rotor that drives it
    follows: tuple[str, Quantity, Quantity]  # another joint, ratio, offset: it has no coordinate and no input then


_ORIGIN = (0.0, 0.0, 0.0)


def number(value: object) -> Expression:
    """Read a number, or an expression as text. Raises ValueError."""
    if isinstance(value, Expression):
        return value
    if isinstance(value, str):
        return read_number(value)
    if isinstance(value, bool) or not isinstance(value, Real):
        raise WrongValueError(f"found {_show(value)}", "give a number, or an expression such as l1/2")
    return read_number(float(value))


def vector(values: object) -> Triple:
    """Read three numbers. Raises ValueError."""
    if isinstance(values, str) or not isinstance(values, Sized) or not isinstance(values, Iterable) or len(values) != 3:
        raise WrongValueError(f"found {_show(values)}", "give three numbers, e.g. [0.1, 0, 0]")
    a, b, c = map(number, values)
    return a, b, c


def runtime(value: Quantity) -> Parameter:
    """Make a parameter that is an input of the code; `make_model` names it."""
    return Parameter("", number(value), Kind.RUNTIME)


def differentiated(value: Quantity) -> Parameter:
    """Make a parameter that is an input of the code, and by which the kernels are differentiated."""
    return Parameter("", number(value), Kind.DIFFERENTIATED)


def revolute(axis: Direction, **setting: Unpack[Setting]) -> Joint:
    """Make a joint that turns about an axis [rad]."""
    return _make_joint(Motion.REVOLUTE, axis, **setting)


def prismatic(axis: Direction, **setting: Unpack[Setting]) -> Joint:
    """Make a joint that slides along an axis [m]."""
    return _make_joint(Motion.PRISMATIC, axis, **setting)


def fixed(position: Vector = _ORIGIN, orientation: Turns = ()) -> Fixed:
    """Hold a body fast on its parent."""
    return Fixed(_place(position, orientation))


def cardan(
    order: str = "xy", *, position: Vector = _ORIGIN, orientation: Turns = (), actuated: bool = True
) -> tuple[Joint, ...]:
    """Make the two revolute joints of a Cardan, or universal, joint."""
    return _make_row("cardan", position, orientation, order=order, actuated=actuated)


def spherical(
    order: str = "zyx", *, position: Vector = _ORIGIN, orientation: Turns = (), actuated: bool = True
) -> tuple[Joint, ...]:
    """Make three revolute joints about one point; where the second is at a quarter turn, they lock."""
    return _make_row("spherical", position, orientation, order=order, actuated=actuated)


def planar(
    plane: str = "xy", *, position: Vector = _ORIGIN, orientation: Turns = (), actuated: bool = False
) -> tuple[Joint, ...]:
    """Make the joints of a body that moves freely in a plane: along its two axes, and about its normal."""
    return _make_row("planar", position, orientation, plane=plane, actuated=actuated)


def floating(
    order: str = "zyx", *, position: Vector = _ORIGIN, orientation: Turns = (), actuated: bool = False
) -> tuple[Joint, ...]:
    """Make the joints of a free body: along x, y, z, and as a spherical joint; passive by default."""
    return _make_row("floating", position, orientation, order=order, actuated=actuated)


def ball(*, position: Vector = _ORIGIN, orientation: Turns = (), actuated: bool = True) -> tuple[Joint, ...]:
    """Make a joint that turns in any direction, by a quaternion, with angular velocities along the body's axes."""
    return _make_row("ball", position, orientation, actuated=actuated)


def free(*, position: Vector = _ORIGIN, orientation: Turns = (), actuated: bool = False) -> tuple[Joint, ...]:
    """Make the joint of a body that moves freely, by its place and a quaternion, with velocities along its axes."""
    return _make_row("free", position, orientation, actuated=actuated)


def joint(type: str, *, position: Vector = _ORIGIN, orientation: Turns = (), **fields: object) -> JointSection:
    """Describe a joint of any type by its fields in a file; `body` makes its elementary joints.

    joint("helical", axis="z", pitch="p/(2*pi)", limits=(0, 6)), for example.
    """
    turns: Data = [{"axis": axis, "angle": _to_data(angle)} for axis, angle in orientation]
    own = {key: _to_data(value) for key, value in fields.items()}
    given = {"type": type, "position": _to_data(position), "orientation": turns, **own}
    described = take(given, find_joint_type(type))
    for found in described.find_faults():
        raise WrongValueError(f"{write_path(found.place)}: {found.finding}", found.remedy)
    return described


def body(
    name: str,
    joint: Carrier | JointSection,
    *,
    parent: str = BASE,
    mass: Quantity = 0.0,
    com: Vector = _ORIGIN,
    inertia: Vector | Inertia = _ORIGIN,
) -> Body:
    """Make a body; three numbers for its inertia are the diagonal of the tensor."""
    tensor = inertia if isinstance(inertia, Inertia) else Inertia(*vector(inertia))
    if isinstance(joint, DhSection) and joint.convention == "standard":
        remedy = "give the modified parameters, or a joint and a fixed body in its tail"
        raise WrongValueError(f"body {abbreviate(name)} has its frame beyond its joint", remedy)
    carrier = joint.make(name) if isinstance(joint, JointSection) else joint
    return Body(name, carrier, parent, number(mass), vector(com), tensor)


def inertia(
    xx: Quantity, yy: Quantity, zz: Quantity, xy: Quantity = 0.0, xz: Quantity = 0.0, yz: Quantity = 0.0
) -> Inertia:
    """Make a full inertia tensor; products of inertia are the off-diagonal entries themselves, sign included."""
    return Inertia(*map(number, (xx, yy, zz, xy, xz, yz)))


def frame(name: str, body: str, *, position: Vector = _ORIGIN, orientation: Turns = (), sensor: bool = True) -> Frame:
    """Make a frame on a body; its pose is an output if it is a sensor."""
    return Frame(name, body, _place(position, orientation), sensor)


def wrench(
    name: str,
    body: str,
    *,
    position: Vector = _ORIGIN,
    frame: Literal["base", "body"] = "base",
    force: Vector | Literal["input"] = _ORIGIN,
    moment: Vector | Literal["input"] = _ORIGIN,
    orientation: Turns = (),
    against: LoopEnd | None = None,
    about: Literal["axes", "turns"] = "axes",
) -> Wrench:
    """Make an external force and moment on a body, with components in the base's frame or in the body's.

    With `against`, its components are along the axes of that frame, whose body has the opposite.
    """
    if frame not in ("base", "body"):
        raise WrongValueError(f"found {_show(frame)}", "give base or body")
    if about not in ("axes", "turns"):
        raise WrongValueError(f"found {_show(about)}", "give axes or turns")
    own, other = (None if isinstance(v, str) and v == "input" else vector(v) for v in (force, moment))
    at = _place(position, orientation)
    return Wrench(name, body, at.position, frame == "base", own, other, at.orientation, against, about == "turns")


def end(body: str, *, position: Vector = _ORIGIN, orientation: Turns = ()) -> LoopEnd:
    """Make one end of a loop: a frame on a body, or on the base."""
    return LoopEnd(body, _place(position, orientation))


def spring(
    name: str,
    first: LoopEnd,
    second: LoopEnd,
    *,
    stiffness: Quantity = 0.0,
    rest: Quantity = 0.0,
    damping: Quantity = 0.0,
    force: Quantity = 0.0,
) -> ForceElement:
    """Make a spring and damper between two points; `force` is further tension, over length, rate and the state."""
    k, l, d = map(number, (stiffness, rest, damping))
    return ForceElement(name, _pass(first), _pass(second), k, l, d, force=number(force))


def cable(
    name: str,
    first: LoopEnd,
    second: LoopEnd,
    *,
    stiffness: Quantity,
    rest: Quantity = 0.0,
    dissipation: Quantity = 0.0,
    width: Quantity | None = None,
    force: Quantity = 0.0,
) -> ForceElement:
    """Make a cable between two points, which cannot push."""
    slack = Cable(WIDTH if width is None else number(width), number(dissipation))
    return ForceElement(name, _pass(first), _pass(second), number(stiffness), number(rest), ZERO, slack, number(force))


def _pass(end: LoopEnd) -> PathPoint:
    return PathPoint(end.body, end.placement)


def plane(body: str = BASE, *, position: Vector = _ORIGIN, normal: Direction = "z") -> Plane:
    """Make a plane on a body, or on the base."""
    return Plane(body, vector(position), _direct(normal))


def sphere(radius: Quantity, body: str = BASE, *, position: Vector = _ORIGIN, inside: bool = False) -> Sphere:
    """Make a sphere on a body, or on the base, that the sphere of a contact touches, from outside or from inside."""
    return Sphere(number(radius), body, vector(position), inside)


def box(size: Vector, body: str = BASE, *, position: Vector = _ORIGIN, orientation: Turns = ()) -> Block:
    """Make a box on a body, or on the base, that the sphere of a contact touches; its centre is at the position."""
    return Block(vector(size), body, _place(position, orientation))


def capsule(
    radius: Quantity,
    length: Quantity,
    body: str = BASE,
    *,
    position: Vector = _ORIGIN,
    orientation: Turns = (),
) -> Capsule:
    """Make a cylinder with round ends on a body, or on the base, that the sphere of a contact touches.

    Its centre is at the position, and its axis is z; the length is between the centres of its ends.
    """
    return Capsule(number(radius), number(length), body, _place(position, orientation))


def hull(
    points: Sequence[Vector],
    radius: Quantity = 0.0,
    body: str = BASE,
    *,
    position: Vector = _ORIGIN,
    orientation: Turns = (),
) -> Hull:
    """Make the convex hull of points on a body, or on the base; its edges are rounded by the radius."""
    return Hull(tuple(map(vector, points)), number(radius), body, _place(position, orientation))


def contact(
    name: str,
    body: str,
    *,
    stiffness: Quantity = 0.0,
    position: Vector = _ORIGIN,
    orientation: Turns = (),
    radius: Quantity = 0.0,
    size: Vector | None = None,
    other: Other = GROUND,
    exponent: float = 1.5,
    dissipation: Quantity = 0.0,
    width: Quantity | None = None,
    friction: tuple[Quantity, Quantity] | Quantity | None = None,
    restitution: Quantity | None = None,
    wheel: tuple[Quantity, Direction] | tuple[Quantity, Direction, Quantity] | None = None,
    tyre: Tyre | None = None,
    points: Sequence[Vector] = (),
    law: SphereLaw | None = None,
) -> Contact:
    """Make a contact of a sphere, a box or a hull with a plane, a sphere, a box, a capsule or a hull.

    A compliant contact has a stiffness, and `friction` is a coefficient and a speed [m/s]; a rigid one has a
    restitution, and `friction` is a coefficient. `wheel` is the radius of a circle, its axis, and perhaps the length of
    a cylinder; a `tyre` is made by `brush` or `magic`. `points` are the corners of a hull, rounded by the radius.
    A `law` of a sphere is OpenSim's, in place of the usual one.
    """
    grip = None
    if isinstance(friction, tuple):
        grip = Grip(*map(number, friction))
    elif friction is not None:
        grip = Grip(number(friction), None)
    edges, placement = None if size is None else vector(size), _place(position, orientation)
    depth = WIDTH if width is None else number(width)
    body_part = (name, body, number(stiffness), placement, number(radius), edges)
    own = number(exponent), number(dissipation), depth, grip, None if restitution is None else number(restitution)
    circle = None if wheel is None else Wheel(number(wheel[0]), _direct(wheel[1]), *map(number, wheel[2:]))
    return Contact(*body_part, other, *own, circle, tyre, tuple(map(vector, points)), law)


def stop(
    name: str, quantity: Quantity, limits: Limits = (None, None), *, hold: Quantity = 0.0, **law: Quantity
) -> Stop:
    """Make stops at limits of a number of the pose, such as "q1 - 2*z_tip".

    `law` is the restitution of rigid stops, or the stiffness of compliant ones, and perhaps their dissipation. A rigid
    stop holds what reaches it against a pull up to `hold`; without limits it is a coupling.
    """
    lower, upper = (None if x is None else number(x) for x in limits)
    return Stop(name, number(quantity), lower, upper, Stops(**_read_keys(law, STOPS)), number(hold))


def brush(
    longitudinal: Quantity,
    lateral: Quantity,
    friction: Quantity,
    length: Quantity = 0.0,
    relaxation: Mapping[str, Quantity] | None = None,
) -> Tyre:
    """Make a tyre of bristles: its stiffnesses [N], its friction, and half the length of its contact [m].

    `relaxation` has its relaxation lengths [m], `longitudinal` and `lateral`; slips are states that way.
    """
    values, lengths = (longitudinal, lateral, friction, length), relaxation or {}
    if strange := [key for key in lengths if key not in WAYS]:
        raise WrongValueError(f"a relaxation {abbreviate(strange[0])}", f"give {' or '.join(WAYS)}")
    known = tuple((way, number(lengths[way])) for way in WAYS if way in lengths)
    return Tyre("brush", tuple(zip(BRUSH, map(number, values), strict=True)), lengths=known)


def magic(coefficients: Mapping[str, Quantity], *, mirrored: bool = False, transient: bool = False) -> Tyre:
    """Make a tyre by the Magic Formula, of coefficients by their names in TIR files.

    The slips of a transient one are states, which relax by the lengths of its coefficients.
    """
    given = {**{key: 0.0 if x is None else x for key, x in MAGIC.items()}, **coefficients}
    numbers = drop_unread(tuple((key, number(x)) for key, x in given.items()), transient)
    return Tyre("magic", numbers, mirrored=mirrored, transient=transient)


def loop(
    name: str,
    type: str,
    first: LoopEnd,
    second: LoopEnd,
    *,
    axis: Direction = "z",
    axis2: Direction = "x",
    pitch: Quantity = 0,
) -> Loop:
    """Make a joint that closes a loop between two frames, of a type that a file may name; `rod` makes rods."""
    return Loop(name, read_cut(type), first, second, _direct(axis), _direct(axis2), pitch=number(pitch))


def rod(name: str, first: LoopEnd, second: LoopEnd, length: Quantity) -> Loop:
    """Make a rod without mass, which keeps two points at a distance [m]."""
    return Loop(name, Cut.ROD, first, second, length=number(length))


def constraint(name: str, equation: Quantity) -> Constraint:
    """Make an equation over names of joints and parameters: an expression that vanishes, such as "q1 + 2*q2"."""
    return Constraint(name, number(equation))


def make_model(
    name: str,
    bodies: Sequence[Body],
    *,
    gravity: Vector,
    parameters: Mapping[str, Quantity | Parameter] | None = None,
    frames: Sequence[Frame] = (),
    wrenches: Sequence[Wrench] = (),
    forces: Sequence[ForceElement] = (),
    contacts: Sequence[Contact] = (),
    stops: Sequence[Stop] = (),
    signals: Sequence[str] = (),
    loops: Sequence[Loop] = (),
    constraints: Sequence[Constraint] = (),
    driven: Sequence[str] = (),
    independent: Sequence[str] = (),
    assembly: Mapping[str, Quantity] | None = None,
    loop_tolerance: Quantity | None = None,
    allow_unphysical: bool = False,
) -> Model:
    """Make a model of its parts. Raises InputError with all that is wrong with it, by the rules for files."""
    named = tuple(
        replace(value, name=key) if isinstance(value, Parameter) else Parameter(key, number(value))
        for key, value in (parameters or {}).items()
    )
    made = Model(
        name,
        vector(gravity),
        (*bodies, *list_slips(contacts)),
        named,
        tuple(frames),
        tuple(wrenches),
        tuple(forces),
        tuple(contacts),
        tuple(stops),
        tuple(signals),
        tuple(loops),
        tuple(constraints),
        tuple(driven),
        tuple(independent),
        tuple((joint, number(value)) for joint, value in (assembly or {}).items()),
        loop_tolerance=None if loop_tolerance is None else number(loop_tolerance),
        allow_unphysical=allow_unphysical,
    )
    if findings := find_faults(made):
        where = f"model {abbreviate(name)}"
        raise refuse([Fault(where, 0, write_path(f.place), f.finding, f.remedy) for f in findings])
    return made


def _place(position: Vector, orientation: Turns) -> Placement:
    turns = []
    for axis, angle in orientation:
        if axis not in ("x", "y", "z"):
            raise WrongValueError(f"found {_show(axis)}", "give x, y or z")
        turns.append(Rotation("xyz".index(axis), number(angle)))
    return Placement(vector(position), tuple(turns))


def _make_joint(
    motion: Motion,
    axis: Direction,
    *,
    name: str | None = None,
    position: Vector = _ORIGIN,
    orientation: Turns = (),
    actuated: bool = True,
    limits: Limits = (None, None),
    max_speed: Quantity | None = None,
    max_force: Quantity | None = None,
    stiffness: Quantity = 0.0,
    rest: Quantity = 0.0,
    damping: Quantity = 0.0,
    friction: tuple[Quantity, Quantity] | DryKeys | None = None,
    stops: Mapping[str, Quantity] | None = None,
    force: Quantity = 0.0,
    armature: Quantity = 0.0,
    follows: tuple[str, Quantity, Quantity] | None = None,
) -> Joint:
    lower, upper, speed, effort = (None if x is None else number(x) for x in (*limits, max_speed, max_force))
    smooth, dry = (None, None) if friction is None else _read_friction(friction)
    ends = None if stops is None else Stops(**_read_keys(stops, STOPS))
    law = Law(number(stiffness), number(rest), number(damping), smooth, number(force))
    direction = _direct(axis)
    place = _place(position, orientation)
    follow = None if follows is None else Follow(follows[0], number(follows[1]), number(follows[2]))
    driven = actuated and follow is None
    bounds = lower, upper, law, speed, effort, number(armature), follow
    return Joint(motion, direction, name, place, driven, *bounds, dry=dry, stops=ends)


def _read_friction(
    friction: tuple[Quantity, Quantity] | DryKeys,
) -> tuple[Friction | None, DryFriction | None]:
    if not isinstance(friction, Mapping):
        return read_friction(number(friction[0]), number(friction[1]))
    load = friction.get("load")
    given = {key: x for key, x in friction.items() if key != "load" and not isinstance(x, Mapping)}
    numbers = _read_keys(given, ("torque", "speed", "static", "stribeck", "one_way"))
    if "torque" not in numbers:
        raise WrongValueError("friction without a torque", 'give one: {"torque": 0.5}')
    return read_friction(**numbers, load=None if load is None else _read_load(load))


def _read_load(load: Quantity | Mapping[str, Quantity]) -> BearingLoad:
    if not isinstance(load, Mapping):
        raise WrongValueError(f"found {_show(load)}", 'give {"coefficient": 0.15, "radius": 0.01}')
    numbers = _read_keys(load, LOAD)
    if "coefficient" not in numbers:
        raise WrongValueError("load without a coefficient", 'give one: {"coefficient": 0.15}')
    return BearingLoad(**numbers)


def _read_keys(values: Mapping[str, Quantity], known: Sequence[str]) -> dict[str, Expression]:
    if unknown := sorted(values.keys() - {*known}):
        raise WrongValueError(f"found {_show(unknown[0])}", f"give some of {', '.join(known)}")
    return {key: number(value) for key, value in values.items()}


def _direct(axis: Direction) -> Triple:
    return read_direction(axis) if isinstance(axis, str) else vector(axis)


def _make_row(type: str, position: Vector, orientation: Turns, **fields: object) -> tuple[Joint, ...]:
    made = joint(type, position=position, orientation=orientation, **fields).make("")
    assert isinstance(made, tuple), "the type is one of joints in a row"
    return made


def _to_data(value: object) -> Data:
    """Return a value as a file would have it."""
    match value:
        case None | bool() | str():
            return value
        case Real():
            return float(value)
        case Mapping():
            return {str(key): _to_data(entry) for key, entry in value.items()}
        case Iterable():
            return [*map(_to_data, value)]
    return write(number(value))


def _show(value: object) -> str:
    return repr(value) if len(repr(value)) <= 40 else f"{repr(value)[:37]}..."
