"""A Model -> the same Model with its numbers as parameters at run time, each by its path in the file.

Parameters are the numbers that the author wrote: `elbow.position.x` and `elbow.damping` of a joint, `forearm.mass`,
`forearm.com.z` and `forearm.inertia.xy` of a body, `gravity.z`, `frames.tip.position.x`, `wrenches.push.force.y`,
`forces.strut.stiffness`, `forces.strut.from.position.x` and `contacts.heel.friction.speed` of forces,
`loops.knee.from.position.x`, `loops.strut.length` and `loops.nut.pitch` of loops. Positions are in the frames, and
centres of mass and tensors along the axes, that the author gave them in. Rotations are counted from 1, as are the
numbers of a force law and of an equation: `elbow.orientation.1` [rad], `constraints.cam.2`. Other forms keep their
words: `elbow.orientation.roll`, `forearm.inertia.about.x`, and `elbow.alpha` of a row in a Denavit-Hartenberg table. An
expression over parameters stays that expression. Exponents and normals of contacts stay, and so do coefficients of a
Magic Formula, apart from its factors.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

from mbsgen.expressions import Expression, Name, Number, evaluate, names
from mbsgen.model.bushings import NAMES
from mbsgen.model.contact_laws import SphereLaw
from mbsgen.model.elimination import Sums, eliminate, find_sums
from mbsgen.model.expansion import Step, list_steps
from mbsgen.model.following import list_joints
from mbsgen.model.joints import describe_joint
from mbsgen.model.joints.dh import place_joint, place_tail
from mbsgen.model.laws import replace_counted, replace_numbers
from mbsgen.model.model import (
    ZERO,
    BearingLoad,
    Block,
    Body,
    Cable,
    Capsule,
    Constraint,
    Contact,
    DryFriction,
    Fixed,
    ForceElement,
    Frame,
    Grip,
    Hull,
    Inertia,
    Joint,
    Law,
    Loop,
    Model,
    Other,
    Parameter,
    PathPoint,
    Placement,
    Plane,
    Row,
    Sphere,
    Stop,
    Stops,
    Triple,
    Wheel,
    Wrap,
    Wrench,
)
from mbsgen.model.muscles import Muscle
from mbsgen.model.quantities import list_quantities
from mbsgen.model.symbols import symbolic, to_double
from mbsgen.model.tree import Cut, Kind
from mbsgen.model.tyres import Tyre
from mbsgen.model.valuation import Valuation

_NUMBERS = symbolic({})
_TENSOR = ("xx", "yy", "zz", "xy", "xz", "yz")


def with_runtime_numbers(model: Model, *, zeros: bool = False) -> Model:
    """Make the numbers of a checked model parameters at run time, and its constants too.

    A number that is 0 stays, and so does an angle that is a multiple of a quarter turn: they make equations short. With
    `zeros` they become parameters too, also zeros that the file does not mention. Axes of joints stay, with the
    constants that they depend on. So do constraints that make a joint follow others, and the rules of followers with
    limits: the limits bind the leader by these rules. Of other rules the numbers stay, and constants become parameters.
    Limits keep their values, since they are not in the equations.
    """
    eliminated = eliminate(model)
    sums = find_sums(eliminated)
    remaining = {constraint.name for constraint in sums.remaining}
    return _Release(eliminated, zeros, _find_fixed(model, remaining), sums).apply()


class _Release:
    """Replaces numbers by names, and collects the parameters."""

    def __init__(self, model: Model, zeros: bool, fixed: set[str], sums: Sums) -> None:
        """Take a model, the parameters that stay constant, and the constraints whose numbers stay."""
        self._model = model
        self._solved = sums.solved
        self._zeros = zeros
        self._valuation = Valuation(model.parameters, ())
        steps = [*list_joints(model)]
        self._coordinates = {step.name for step in steps} if model.constraints else set()
        self._movers = {step.mover: step.name for step in steps}
        self._rows: dict[str, Row] = {}  # of tables, by the joints
        self._state = list_quantities(model).keys()
        self._parameters = {
            p.name: replace(p, kind=Kind.RUNTIME)
            if p.kind is Kind.CONSTANT and p.name not in fixed and not names(p.value)
            else p
            for p in model.parameters
        }

    def apply(self) -> Model:
        model = self._model
        released = replace(
            model,
            gravity=self._triple("gravity", model.gravity),
            bodies=tuple(self._body(i, body) for i, body in enumerate(model.bodies)),
            frames=tuple(map(self._frame, model.frames)),
            wrenches=tuple(map(self._wrench, model.wrenches)),
            forces=tuple(map(self._element, model.forces)),
            contacts=tuple(map(self._contact, model.contacts)),
            stops=tuple(map(self._stop, model.stops)),
            loops=tuple(map(self._loop, model.loops)),
            constraints=tuple(map(self._constraint, model.constraints)),
        )
        return replace(released, parameters=tuple(self._parameters.values()))

    def _number(self, path: str, expression: Expression, *, of_turn: bool = False) -> Expression:
        if names(expression):
            return expression
        value = evaluate(expression, {}, _NUMBERS)
        if not self._zeros and (value == 0 or (of_turn and _is_quarter_turn(expression))):
            return expression
        name, count = path, 1
        while name in self._parameters or name in self._coordinates:  # names of bodies, joints and frames may be alike
            name, count = f"{path}.{count + 1}", count + 1
        self._parameters[name] = Parameter(name, expression, Kind.RUNTIME)
        return Name(name)

    def _triple(self, path: str, triple: Triple) -> Triple:
        x, y, z = (self._number(f"{path}.{axis}", number) for axis, number in zip("xyz", triple, strict=True))
        return x, y, z

    def _placement(self, path: str, placement: Placement) -> Placement:
        turns = tuple(
            replace(turn, angle=self._number(f"{path}.orientation.{turn.name or k}", turn.angle, of_turn=True))
            for k, turn in enumerate(placement.orientation, 1)
        )
        return Placement(self._triple(f"{path}.position", placement.position), turns)

    def _body(self, i: int, body: Body) -> Body:
        if any(joint.row is not None and joint.row.is_standard for joint in body.joints):
            return replace(body, joint=self._carrier(i, body))  # it is not in the file, and has no mass
        path, about = f"{body.name}.inertia", body.inertia.about
        entries = (self._number(f"{path}.{key}", getattr(body.inertia, key)) for key in _TENSOR)
        return replace(
            body,
            joint=self._carrier(i, body),
            mass=self._number(f"{body.name}.mass", body.mass),
            com=self._triple(f"{body.name}.com", body.com),
            inertia=Inertia(*entries, about=about and self._triple(f"{path}.about", about)),
        )

    def _carrier(self, i: int, body: Body) -> Joint | Fixed | tuple[Joint, ...]:
        if isinstance(body.joint, Fixed):
            if body.joint.row is None:
                return Fixed(self._placement(body.name, body.joint.placement))
            row = self._row(self._movers[body.parent], body.joint.row)
            return Fixed(place_tail(row), row)
        if not isinstance(body.joint, tuple):
            (step,) = list_steps(i, body)
            if step.joint.row is None:
                return self._joint(step, self._placement(step.name, step.joint.placement))
            row = self._row(step.name, step.joint.row)
            return replace(self._joint(step, place_joint(row)), row=row)
        steps = [*list_steps(i, body)]
        if body.is_list or describe_joint(body) is None:
            return tuple(self._joint(step, self._placement(step.name, step.joint.placement)) for step in steps)
        first, *rest = steps  # a joint with one name has one place, the first joint's
        placement = self._placement(body.name, first.joint.placement)
        return self._joint(first, placement), *(self._part(step, first.name) for step in rest)

    def _row(self, path: str, row: Row) -> Row:
        """Release the row of a table once, for the joint and for the body beyond it."""
        if path not in self._rows:
            angles = (self._number(f"{path}.{key}", getattr(row, key), of_turn=True) for key in ("alpha", "theta"))
            lengths = (self._number(f"{path}.{key}", getattr(row, key)) for key in ("a", "d"))
            base, (a, d), (alpha, theta) = self._placement(path, row.base), lengths, angles
            self._rows[path] = Row(row.is_standard, base, a, alpha, d, theta)
        return self._rows[path]

    def _part(self, step: Step, first: str) -> Joint:
        """Release a part of a joint with a name for all of it; the slide of a screw has no settings in the file."""
        if step.joint.follows is not None and step.joint.follows.joint == first:
            return step.joint
        return self._joint(step, step.joint.placement)

    def _joint(self, step: Step, placement: Placement) -> Joint:
        if step.joint.floats:
            return replace(step.joint, placement=placement)
        return replace(
            step.joint,
            placement=placement,
            lower=self._keep(step.joint.lower),
            upper=self._keep(step.joint.upper),
            max_speed=self._keep(step.joint.max_speed),
            max_force=self._keep(step.joint.max_force),
            law=self._law(step.joint.law, step.name),
            dry=self._dry(step.joint.dry),
            stops=step.joint.stops and self._law_of_stops(step.joint.stops, f"{step.name}.stops"),
            armature=self._number(f"{step.name}.armature", step.joint.armature),
        )

    def _keep(self, limit: Expression | None) -> Expression | None:
        return None if limit is None else Number(self._valuation.number((), limit))

    def _dry(self, dry: DryFriction | None) -> DryFriction | None:
        if dry is None:
            return None
        torque = Number(self._valuation.number((), dry.torque))
        static, stribeck, way = map(self._keep, (dry.static, dry.stribeck, dry.one_way))
        return DryFriction(torque, static, stribeck, way, None if dry.load is None else self._load(dry.load))

    def _load(self, load: BearingLoad) -> BearingLoad:
        sliding = Number(self._valuation.number((), load.coefficient))
        return BearingLoad(sliding, *map(self._keep, (load.static, load.radius, load.length)))

    def _law_of_stops(self, stops: Stops, path: str) -> Stops:
        """Release compliant stops; a restitution stays."""
        if stops.stiffness is None:
            return replace(stops, restitution=self._keep(stops.restitution))
        return replace(
            stops,
            stiffness=self._number(f"{path}.stiffness", stops.stiffness),
            dissipation=self._number(f"{path}.dissipation", stops.dissipation),
        )

    def _law(self, law: Law, joint: str) -> Law:
        released = replace_numbers(law, joint, self._number)
        if not self._zeros:
            return released
        return replace(
            released,
            stiffness=self._number(f"{joint}.stiffness", released.stiffness),
            rest=self._number(f"{joint}.rest", released.rest),
            damping=self._number(f"{joint}.damping", released.damping),
        )

    def _frame(self, frame: Frame) -> Frame:
        return replace(frame, placement=self._placement(f"frames.{frame.name}", frame.placement))

    def _wrench(self, wrench: Wrench) -> Wrench:
        path = f"wrenches.{wrench.name}"
        other = wrench.against
        if other is not None:
            other = replace(other, placement=self._placement(f"{path}.against", other.placement))
        own = self._placement(path, wrench.placement)
        return replace(
            wrench,
            position=own.position,
            orientation=own.orientation,
            force=wrench.force and self._components(f"{path}.force", wrench.force),
            moment=wrench.moment and self._components(f"{path}.moment", wrench.moment),
            against=other,
        )

    def _components(self, path: str, components: Triple) -> Triple:
        """Release numbers, and the numbers of expressions that read the state."""
        x, y, z = (
            replace_counted(component, f"{path}.{axis}", self._number)
            if names(component) & {*self._state, *NAMES}
            else self._number(f"{path}.{axis}", component)
            for axis, component in zip("xyz", components, strict=True)
        )
        return x, y, z

    def _element(self, element: ForceElement) -> ForceElement:
        path = f"forces.{element.name}"
        first, second = (
            self._point(f"{path}.{key}", x) for key, x in (("from", element.first), ("to", element.second))
        )
        cable = element.cable and Cable(
            self._number(f"{path}.width", element.cable.width),
            self._number(f"{path}.dissipation", element.cable.dissipation),
        )
        return ForceElement(
            element.name,
            first,
            second,
            self._number(f"{path}.stiffness", element.stiffness),
            self._number(f"{path}.rest", element.rest),
            self._number(f"{path}.damping", element.damping) if cable is None else element.damping,
            cable,
            replace_counted(element.force, f"{path}.force", self._number),
            tuple(self._point(f"{path}.via.{k}", point) for k, point in enumerate(element.via, 1)),
            element.muscle and self._muscle(f"{path}.muscle", element.muscle),
            tuple(self._wrap(f"{path}.wraps.{k}", wrap) for k, wrap in enumerate(element.wraps, 1)),
        )

    def _wrap(self, path: str, wrap: Wrap) -> Wrap:
        return replace(
            wrap,
            size=tuple(self._number(f"{path}.{key}", x) for key, x in zip(wrap.keys, wrap.size, strict=True)),
            placement=self._placement(path, wrap.placement),
            length=wrap.length and self._number(f"{path}.length", wrap.length),
        )

    def _point(self, path: str, point: PathPoint) -> PathPoint:
        """Release the place of a point; numbers of a shift and of a range stay."""
        return replace(point, placement=self._placement(path, point.placement))

    def _muscle(self, path: str, muscle: Muscle) -> Muscle:
        """Release the numbers of a muscle; activation and force of a tendon are given by a use."""
        kept = {"pennation", "passive"} & {key for key, x in muscle.numbers.items() if x == ZERO}
        if muscle.tendon_state is None:
            kept.add("tendon_strain")
        curves = muscle.curves.exchange(lambda key, x: self._number(f"{path}.curves.{key}", x))
        numbers = {key: self._number(f"{path}.{key}", x) for key, x in muscle.numbers.items() if key not in kept}
        return replace(muscle, **numbers, curves=curves)

    def _contact(self, contact: Contact) -> Contact:
        path = f"contacts.{contact.name}"
        if contact.is_of_solids:  # their shapes are constant
            return replace(contact, placement=self._placement(path, contact.placement))
        grip = contact.friction
        if grip is not None and grip.speed is not None:
            grip = Grip(
                self._number(f"{path}.friction.coefficient", grip.coefficient),
                self._number(f"{path}.friction.speed", grip.speed),
            )
        is_rigid = contact.is_rigid  # its law is constant
        is_lossless = is_rigid or (contact.law is not None and contact.dissipation == ZERO)
        return replace(
            contact,
            stiffness=contact.stiffness if is_rigid else self._number(f"{path}.stiffness", contact.stiffness),
            placement=self._placement(path, contact.placement),
            radius=self._number(f"{path}.radius", contact.radius) if contact.size is None else contact.radius,
            size=contact.size and self._triple(f"{path}.size", contact.size),
            other=self._other(f"{path}.{contact.key}", contact.other),
            dissipation=contact.dissipation
            if is_lossless
            else self._number(f"{path}.dissipation", contact.dissipation),
            width=self._number(f"{path}.width", contact.width),
            wheel=contact.wheel and self._wheel(f"{path}.wheel", contact.wheel),
            points=tuple(self._triple(f"{path}.points.{k}", point) for k, point in enumerate(contact.points, 1)),
            friction=grip,
            tyre=contact.tyre and self._tyre(f"{path}.tyre", contact.tyre),
            law=contact.law and self._sphere_law(f"{path}.law", contact.law),
        )

    def _sphere_law(self, path: str, law: SphereLaw) -> SphereLaw:
        static, viscous, share, *smooth = (
            (x := getattr(law, key)) and self._number(f"{path}.{key}", x) for key in law.keys
        )
        return SphereLaw(law.kind, static, viscous, share, *smooth)

    def _wheel(self, path: str, wheel: Wheel) -> Wheel:
        length = wheel.length if wheel.length == ZERO else self._number(f"{path}.length", wheel.length)
        return replace(wheel, radius=self._number(f"{path}.radius", wheel.radius), length=length)

    def _stop(self, stop: Stop) -> Stop:
        path = f"stops.{stop.name}"
        lower, upper = (
            x and self._number(f"{path}.{key}", x) for key, x in (("lower", stop.lower), ("upper", stop.upper))
        )
        quantity = replace_counted(stop.quantity, path, self._number)
        return replace(
            stop,
            quantity=quantity,
            lower=lower,
            upper=upper,
            law=self._law_of_stops(stop.law, path),
            hold=self._keep(stop.hold) or ZERO,
        )

    def _tyre(self, path: str, tyre: Tyre) -> Tyre:
        """Release the numbers of a brush, and the factors of a Magic Formula; its other coefficients stay."""
        released = tuple(
            (key, self._number(f"{path}.{key}", x) if tyre.kind == "brush" or key.startswith("L") else x)
            for key, x in tyre.numbers
        )
        lengths = tuple((way, self._number(f"{path}.relaxation.{way}", x)) for way, x in tyre.lengths)
        return replace(tyre, numbers=released, lengths=lengths)

    def _other(self, path: str, other: Other) -> Other:
        if isinstance(other, Block):
            placement = self._placement(path, other.placement)
            return replace(other, placement=placement, size=self._triple(f"{path}.size", other.size))
        if isinstance(other, Capsule):
            radius, length = (self._number(f"{path}.{key}", getattr(other, key)) for key in ("radius", "length"))
            return replace(other, placement=self._placement(path, other.placement), radius=radius, length=length)
        if isinstance(other, Hull):
            return replace(other, placement=self._placement(path, other.placement))
        position = self._triple(f"{path}.position", other.position)
        if isinstance(other, Sphere):
            return replace(other, position=position, radius=self._number(f"{path}.radius", other.radius))
        return replace(other, position=position)

    def _loop(self, loop: Loop) -> Loop:
        path = f"loops.{loop.name}"
        first, second = (
            replace(end, placement=self._placement(f"{path}.{key}", end.placement))
            for key, end in (("from", loop.first), ("to", loop.second))
        )
        length = self._number(f"{path}.length", loop.length) if loop.cut is Cut.ROD else loop.length
        pitch = self._number(f"{path}.pitch", loop.pitch) if loop.cut is Cut.HELICAL else loop.pitch
        return replace(loop, first=first, second=second, length=length, pitch=pitch)

    def _constraint(self, constraint: Constraint) -> Constraint:
        path = f"constraints.{constraint.name}"
        if constraint.name in self._solved:
            return self._solved[constraint.name]
        return replace(constraint, equation=replace_counted(constraint.equation, path, self._number))


def _find_fixed(model: Model, remaining: set[str]) -> set[str]:
    """Find the parameters that must be constant, by themselves or by the values of others."""
    found = {name for expression in _list_constants(model, remaining) for name in names(expression)}
    for parameter in reversed(model.parameters):  # a value depends on parameters that stand before it
        if parameter.name in found:
            found |= names(parameter.value)
    return found


def _list_constants(model: Model, remaining: set[str]) -> Iterator[Expression]:
    """List the expressions that a model needs constants in."""
    yield from (component for axis in _list_axes(model) for component in axis)
    yield from (contact.exponent for contact in model.contacts)
    joints = {step.name: step.joint for step in list_joints(model)}
    for name, joint in joints.items():
        if any(bound is not None for bound in (joint.lower, joint.upper, joint.max_speed)):
            yield from _list_rules(joints, name)
    for constraint in model.constraints:
        if constraint.name not in remaining:
            yield constraint.equation
            yield from (x for name in names(constraint.equation) & joints.keys() for x in _list_rules(joints, name))


def _list_rules(joints: Mapping[str, Joint], name: str) -> Iterator[Expression]:
    """List the ratios and offsets between a joint and the leader at the end of its chain."""
    follow = joints[name].follows
    while follow is not None:
        yield from (follow.ratio, follow.offset)
        follow = joints[follow.joint].follows


def _list_axes(model: Model) -> Iterator[Triple]:
    yield from (joint.axis for body in model.bodies for joint in body.joints)
    yield from (axis for loop in model.loops for axis in (loop.axis, loop.axis2))
    yield from (x.other.normal for x in model.contacts if isinstance(x.other, Plane))
    yield from (x.wheel.axis for x in model.contacts if x.wheel is not None)


def _is_quarter_turn(angle: Expression) -> bool:
    """Return whether a sine or a cosine of this is 0."""
    turned = evaluate(angle, {}, _NUMBERS)
    return any(to_double(_NUMBERS.functions[name](turned)) == 0 for name in ("sin", "cos"))
