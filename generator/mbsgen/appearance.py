"""The appearance of a model: Model, Tree -> masses, shapes, axes of joints, springs, contacts, as numbers for pictures.

Points and axes are in the frames of the manifest, at the model's numbers; numbers that depend on run-time or
differentiated parameters also have formulas. They are placed by the reduction of the model itself: a frame is added at
each body and each end, and found again among the sensors of the Tree.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from sympy import Expr, ImmutableMatrix, eye

from mbsgen.algebra.dense import Dense, Row, add, apply, combine, dot, identity, list_columns, times, transpose
from mbsgen.algebra.rotations import axis_rotation
from mbsgen.arrows import Texts, add_forces, rotate
from mbsgen.expressions import FLOATS, Expression, evaluate
from mbsgen.manifest import (
    Appearance,
    Axle,
    Ball,
    Brick,
    Corners,
    Drawing,
    Element,
    Foot,
    Formula,
    Grip,
    Mass,
    Point,
    Rod,
    Seat,
    Tension,
    Touch,
)
from mbsgen.model.changes.reduction import build_tree
from mbsgen.model.model import (
    BASE,
    HERE,
    WIDTH,
    Block,
    Body,
    Capsule,
    Contact,
    ForceElement,
    Frame,
    Hull,
    LoopEnd,
    Model,
    Placement,
    Plane,
    Sphere,
    Triple,
    Visual,
    Wrench,
)
from mbsgen.model.placements import centre_inertia
from mbsgen.model.quantities import find_read_frames
from mbsgen.model.symbols import exact, to_double
from mbsgen.model.tree import IDENTITY, Kind, Matrix, Sensor, Tree, Vector


def describe_appearance(model: Model, tree: Tree) -> Appearance:
    """Describe a model for pictures; `tree` is its tree, in the order of the manifest's frames."""
    values = _read_parameters(model)
    texts = Texts(model, values)
    seats = _Seats(model, texts)
    gravity = _floats(model.gravity, values)
    found = Appearance(
        gravity=_triple(gravity),
        masses=tuple(x for body in model.bodies if (x := _weigh(body, seats.find(body.name), values)) is not None),
        axles=tuple(_describe_axle(tree, i) for i in range(1, len(tree.bodies) + 1)),
        bodies=tuple(_describe_body(body.name, seats.find(body.name)) for body in model.bodies),
        elements=tuple(_describe_element(x, seats, values) for x in model.forces),
        contacts=tuple(_describe_contact(x, seats, values) for x in model.contacts),
        wrenches=tuple(
            _describe_foot(x, seats.find(x.body), values) for x in model.wrenches if x.force is None or x.moment is None
        ),
        drawings=tuple(
            _describe_visual(body.name, x, seats.find(body.name), texts, values)
            for body in model.bodies
            for x in body.visuals
        ),
    )
    return add_forces(found, model, tree.coordinates, texts, seats)


def write_formulas(model: Model, points: Mapping[tuple[str | int, ...], Sequence[Expr]]) -> tuple[Formula, ...]:
    """Write the components of points, by their places in a manifest, that depend on parameters of a model."""
    return Texts(model, _read_parameters(model)).write_changing(points)


@dataclass(frozen=True)
class _Seat:
    """Where a frame of the model stands, in a frame of the manifest; -1: the base."""

    frame: int
    position: Row
    axes: Dense  # columns
    place_symbols: ImmutableMatrix  # the position, (3, 1), over symbols of run-time parameters
    axes_symbols: ImmutableMatrix

    def place(self, point: Row) -> tuple[int, Row]:
        """Find the place of a point."""
        return self.frame, add(self.position, apply(self.axes, point))


class _Seats:
    """The seats of bodies and of placements on bodies, found by one reduction of the model."""

    def __init__(self, model: Model, texts: Texts) -> None:
        ends: list[LoopEnd] = [end for x in model.forces for end in x.path]
        ends += [LoopEnd(x.body, x.placement) for x in model.contacts]
        turned = [x.other for x in model.contacts if isinstance(x.other, Block | Capsule | Hull)]
        ends += [LoopEnd(x.body, x.placement) for x in turned]
        ends += [LoopEnd(body.name) for body in model.bodies]
        ends += [LoopEnd(x.body, x.placement) for x in model.frames if x.name in find_read_frames(model)]
        wanted = list(dict.fromkeys((end.body, end.placement) for end in ends if end.body != BASE))
        added = tuple(Frame(f"appearance.{k}", body, placement) for k, (body, placement) in enumerate(wanted))
        tree = build_tree(replace(model, frames=(*model.frames, *added)))
        sensors = tree.sensors[len(tree.sensors) - len(added) :]
        values = {p.symbol: exact(p.value) for p in tree.parameters}
        constants = {p.symbol: values[p.symbol] for p in tree.parameters if p.kind is Kind.CONSTANT}

        def number(matrix: tuple[Vector, ...]) -> Dense:
            return tuple(tuple(to_double(x.xreplace(values)) for x in row) for row in matrix)

        def seat(sensor: Sensor) -> _Seat:
            own: Matrix = tree.bodies[sensor.body - 1].axes if sensor.body else IDENTITY
            own_axes = transpose(number(own))
            position, turned = number((sensor.position,))[0], number(sensor.orientation)
            back = ImmutableMatrix(own).T.xreplace(constants)
            symbolic = (x.xreplace(constants) for x in map(ImmutableMatrix, (sensor.position, sensor.orientation)))
            place, orientation = (back * x for x in symbolic)
            return _Seat(sensor.body - 1, apply(own_axes, position), times(own_axes, turned), place, orientation)

        self._found = dict(zip(wanted, map(seat, sensors), strict=True))
        self._base = _Base(_read_parameters(model), texts)

    def find(self, body: str, placement: Placement = HERE) -> _Seat:
        """Find the seat of a body, or of a placement on it."""
        return self._base.seat(placement) if body == BASE else self._found[body, placement]


@dataclass(frozen=True)
class _Base:
    """Places frames on the base."""

    values: Mapping[str, float]
    texts: Texts

    def seat(self, placement: Placement) -> _Seat:
        """Return the seat of a placement on the base."""
        axes, symbols = combine(float, identity(3)), eye(3)
        for step in placement.orientation:
            symbols *= rotate(step.axis, self.texts.symbolize(step.angle))
            c, s = (f(_float(step.angle, self.values)) for f in (math.cos, math.sin))
            axes = times(axes, tuple(map(tuple, axis_rotation(step.axis, s, c, 0.0, 1.0).rows)))
        place = ImmutableMatrix([self.texts.symbolize(x) for x in placement.position])
        return _Seat(-1, _floats(placement.position, self.values), axes, place, ImmutableMatrix(symbols))


def _weigh(body: Body, seat: _Seat, values: Mapping[str, float]) -> Mass | None:
    """Return the mass of a body with its centre and its inertia in its frame; None without a mass."""
    mass = _float(body.mass, values)
    if not mass > 0:
        return None
    own = tuple(_floats(row, values) for row in centre_inertia(body).rows)
    tensor = times(times(seat.axes, own), transpose(seat.axes))
    frame, centre = seat.place(_floats(body.com, values))
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = tensor
    inertia = (xx, yy, zz, xy, xz, yz)
    return Mass(name=body.name, frame=frame, mass=mass, com=_triple(centre), inertia=inertia)


def _describe_body(name: str, seat: _Seat) -> Seat:
    return Seat(name=name, frame=seat.frame, at=_triple(seat.position), axes=list_columns(seat.axes))


def _describe_foot(wrench: Wrench, seat: _Seat, values: Mapping[str, float]) -> Foot:
    """Return the point of an open wrench; the axes of its body where they are not the axes of the frame."""
    frame, at = seat.place(_floats(wrench.position, values))
    is_turned = bool(seat.axes_symbols.free_symbols) or seat.axes != identity(3)
    axes = list_columns(seat.axes) if is_turned and not wrench.in_base else ()
    return Foot(frame=frame, at=_triple(at), axes=axes)


def _describe_visual(name: str, visual: Visual, seat: _Seat, texts: Texts, values: Mapping[str, float]) -> Drawing:
    own = _Base(values, texts).seat(visual.placement)
    frame, at = seat.place(own.position)
    return Drawing(
        body=name,
        frame=frame,
        shape=visual.shape,
        size=tuple(_float(x, values) for x in visual.size),
        at=_triple(at),
        axes=list_columns(times(seat.axes, own.axes)),
        color=visual.color,
        file=visual.file,
    )


def _describe_axle(tree: Tree, i: int) -> Axle:
    """Return the axis of a body's joint in the author's axes, and the joint's entry of qd."""
    body = tree.bodies[i - 1]
    x, y, z = (to_double(body.axes[body.joint.axis][c]) for c in range(3))
    name = body.joint.name
    entry = next((k for k, joint in enumerate(tree.joints) if joint is body.joint), None)
    return Axle(name=name, coordinate=entry, axis=(x, y, z))


def _describe_element(element: ForceElement, seats: _Seats, values: Mapping[str, float]) -> Element:
    ends = (seats.find(end.body, end.placement) for end in (element.first, element.second))
    first, second = (_point((seat.frame, seat.position)) for seat in ends)
    cable = element.cable
    tension = Tension(
        stiffness=_float(element.stiffness, values),
        rest=_float(element.rest, values),
        damping=_float(element.damping, values),
        dissipation=0.0 if cable is None else _float(cable.dissipation, values),
        width=_float(WIDTH if cable is None else cable.width, values),
    )
    via = (seats.find(end.body, end.placement) for end in element.via)
    return Element(
        name=element.name,
        cable=element.cable is not None,
        first=first,
        second=second,
        law=None if element.via or element.wraps else tension,  # arrows are of straight lines
        via=tuple(_point((seat.frame, seat.position)) for seat in via),
    )


def _has_arrow(contact: Contact) -> bool:
    is_hollow = isinstance(contact.other, Sphere) and contact.other.inside
    return not (contact.is_rigid or contact.wheel is not None or is_hollow or contact.law is not None)


def _describe_contact(contact: Contact, seats: _Seats, values: Mapping[str, float]) -> Touch:
    seat, other = seats.find(contact.body, contact.placement), contact.other
    carrier = seats.find(other.body, HERE if isinstance(other, Plane | Sphere) else other.placement)
    plane, normal, ball, brick, rod, corners = None, None, None, None, None, None
    match other:
        case Plane():
            direction = apply(carrier.axes, _floats(other.normal, values))
            length = math.sqrt(dot(direction, direction))
            plane = _point(carrier.place(_floats(other.position, values)))
            normal = _triple(tuple(x / length for x in direction))
        case Sphere() if not other.inside:  # a hollow one would hide what is within
            ball = Ball(
                centre=_point(carrier.place(_floats(other.position, values))), radius=_float(other.radius, values)
            )
        case Block():
            edges, axes = _triple(_floats(other.size, values)), list_columns(carrier.axes)
            brick = Brick(centre=_point((carrier.frame, carrier.position)), axes=axes, size=edges)
        case Capsule():
            rod = Rod(
                centre=_point((carrier.frame, carrier.position)),
                axis=_triple(transpose(carrier.axes)[2]),
                radius=_float(other.radius, values),
                length=_float(other.length, values),
            )
        case Hull():
            corners = Corners(
                centre=_point((carrier.frame, carrier.position)),
                axes=list_columns(carrier.axes),
                radius=_float(other.radius, values),
                points=tuple(_triple(_floats(x, values)) for x in other.points),
            )
    return Touch(
        name=contact.name,
        centre=_point((seat.frame, seat.position)),
        axes=list_columns(seat.axes),
        radius=_float(contact.radius, values),
        size=None if contact.size is None else _triple(_floats(contact.size, values)),
        plane=plane,
        normal=normal,
        law=_describe_grip(contact, values) if _has_arrow(contact) else None,
        sphere=ball,
        box=brick,
        capsule=rod,
        hull=corners,
        points=tuple(_triple(_floats(x, values)) for x in contact.points) or None,
    )


def _describe_grip(contact: Contact, values: Mapping[str, float]) -> Grip:
    coefficient, speed = 0.0, 1.0
    if contact.friction is not None and contact.friction.speed is not None:
        coefficient, speed = (_float(x, values) for x in (contact.friction.coefficient, contact.friction.speed))
    return Grip(
        stiffness=_float(contact.stiffness, values),
        exponent=_float(contact.exponent, values),
        dissipation=_float(contact.dissipation, values),
        width=_float(contact.width, values),
        coefficient=coefficient,
        speed=speed,
    )


# --- numbers ---------------------------------------------------------------------------------------------------------


def _read_parameters(model: Model) -> dict[str, float]:
    values: dict[str, float] = {}
    for parameter in model.parameters:
        values[parameter.name] = _float(parameter.value, values)
    return values


def _float(expression: Expression, values: Mapping[str, float]) -> float:
    return float(evaluate(expression, values, FLOATS))


def _floats(triple: Triple, values: Mapping[str, float]) -> Row:
    return tuple(_float(x, values) for x in triple)


def _triple(v: Row) -> tuple[float, float, float]:
    x, y, z = v
    return x, y, z


def _point(placed: tuple[int, Row]) -> Point:
    return Point(frame=placed[0], at=_triple(placed[1]))
