"""Model -> Tree: bodies in order, and every joint about or along a positive coordinate axis of its body.

Massless bodies are inserted in a sequence of joints. A fixed body is merged with its parent. A body whose joint has
another axis gets a new frame: the author's, turned by a constant rotation C with a = C e_k. Masses, sensors, wrenches,
loops and child joints are transformed to their new frames; sensors keep their poses, and bodies and wrenches the axes
in the model file. The axis of a loop is the z axis of its two frames. Linear constraints of joints become followers
(see `elimination`); other constraints become equations in coordinates that do not follow others.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product

from sympy import Expr, Symbol

from mbsgen.expressions import Algebra, Expression, Name, evaluate, names
from mbsgen.model import model, tree
from mbsgen.model.digits import find_tolerance, list_geometry
from mbsgen.model.elements import Anchor, Circle, Loads, PlacedHull, Side, Sight, Spot, Surface
from mbsgen.model.elimination import Linear, eliminate, find_sums
from mbsgen.model.expansion import expand
from mbsgen.model.following import Range, find_range, find_rules, list_joints
from mbsgen.model.model import BASE, Model
from mbsgen.model.placements import centre_inertia
from mbsgen.model.quantities import (
    Quantity,
    find_read_frames,
    find_read_signals,
    find_stopped,
    list_poses,
    list_quantities,
    name_lengths,
    probe_symbols,
)
from mbsgen.model.solids import Corner, find_solids
from mbsgen.model.symbols import exact, round_number, symbolic, to_double, total
from mbsgen.model.topology import sort_bodies
from mbsgen.model.tree import (
    COORDINATE,
    IDENTITY,
    ONE,
    RATE,
    ZERO,
    Coupling,
    Cut,
    Kind,
    Matrix,
    Parameter,
    Probe,
    Quaternion,
    Reading,
    RigidPart,
    Tree,
    Vector,
    coordinate_symbol,
    rate_symbol,
)
from mbsgen.model.wrapping_ellipsoid import Ellipsoid
from mbsgen.model.wrapping_shapes import Shape
from mbsgen.model.wrapping_torus import Torus


def build_tree(description: Model, *, readable: bool = False) -> Tree:
    """Make the Tree of a checked model. In a readable one, which has no code, forces keep smooth functions."""
    description = eliminate(description)
    sums = find_sums(description)
    description = replace(description, constraints=sums.remaining)
    parameters, reader = _read_parameters(description, readable=readable)
    expanded = expand(description).model
    seats = {BASE: _Seat(0)}
    carried: dict[int, list[RigidPart]] = {0: []}  # what is fixed to the base is not felt
    moving: list[_Mover] = []
    for body in (expanded.bodies[i] for i in sort_bodies(expanded)):
        assert not isinstance(body.joint, tuple), "an expanded model has no sequences"
        seat = seats[body.parent].carry(body.joint.placement, reader)
        if isinstance(body.joint, model.Joint):
            axis, own = align(reader.direction(body.joint.axis))
            orientation, author = _product(seat.axes, own), _transpose(own)
            moving.append(_Mover(body.name, body.joint, axis, seat.number, seat.position, orientation, author))
            seat = _Seat(len(moving), axes=author)
            carried[seat.number] = []
        seats[body.name] = seat
        carried[seat.number].append(_read_part(body, seat, reader))
    bodies = tuple(_make_body(mover, *_merge(carried[i]), reader=reader) for i, mover in enumerate(moving, 1))
    couplings = tuple(_find_couplings(description, sums.rules, moving, reader))
    numbers = {mover.joint.name: i for i, mover in enumerate(moving, 1) if mover.joint.name is not None}
    coordinates = _express_coordinates(bodies, couplings)
    loads = _collect_loads(description, seats, reader)
    return Tree(
        name=description.name,
        gravity=reader.vector(description.gravity),
        parameters=parameters,
        bodies=_push(_bind(bodies, couplings), loads.pushes),
        sensors=tuple(_make_sensor(x, seats[x.body], reader) for x in description.frames if x.is_sensor),
        wrenches=(
            *(_make_wrench(x, seats[x.body], reader) for x in description.wrenches if x.against is None),
            *loads.wrenches,
        ),
        probes=(*_probe_frames(description, seats, reader), *loads.probes),
        definitions=tuple(loads.definitions),
        distances=tuple(loads.distances),
        meetings=tuple(loads.meetings),
        signals=find_read_signals(description),
        quaternions=tuple(_find_quaternions(description, moving)),
        couplings=couplings,
        loops=tuple(_make_loop(loop, seats, reader) for loop in description.loops),
        constraints=tuple(
            tree.Constraint(constraint.name, reader.equation(constraint.equation, coordinates))
            for constraint in description.constraints
        ),
        driven=tuple(sorted(numbers[name] for name in description.driven)),
        chosen=tuple(sorted(numbers[name] for name in description.independent)),
        rough=tuple(
            sorted((numbers[name], reader.estimate(x)) for name, x in description.assembly if name not in sums.rules)
        ),
        loop_tolerance=_find_tolerance(description, reader) if description.loops or description.constraints else 0.0,
    )


def _push(bodies: Sequence[tree.Body], pushes: Sequence[tuple[str, Expr]]) -> tuple[tree.Body, ...]:
    """Add forces in joints that moving points of lines feel."""
    found = {body.joint.name: body.joint.law for body in bodies}
    for name, push in pushes:
        found[name] += push
    return tuple(
        body
        if found[body.joint.name] == body.joint.law
        else replace(body, joint=replace(body.joint, law=found[body.joint.name]))
        for body in bodies
    )


def _find_tolerance(description: model.Model, reader: _Reader) -> float:
    given = description.loop_tolerance
    return find_tolerance(list_geometry(description)) if given is None else reader.estimate(given)


def align(direction: Vector) -> tuple[int, Matrix]:
    """Find the coordinate axis k nearest to a direction of numbers, and a rotation C with C e_k along it.

    C is the identity for +x, +y, +z and a half turn for -x, -y, -z; else the smallest turn from there (Rodrigues).
    """
    size = max(abs(component) for component in direction)
    k = next(i for i in range(3) if abs(direction[i]) == size)
    near = IDENTITY if direction[k] > 0 else _HALF_TURNS[k]
    scaled = [component / size for component in direction]
    length = _NUMBERS.functions["sqrt"](total(component * component for component in scaled))
    u = [component / length for component in scaled]
    i, j = (k + 1) % 3, (k + 2) % 3
    if u[i] == u[j] == 0:
        return k, near
    sign = near[k][k]  # the turn is from e = sign e_k to u, about v = e x u, by the angle of cosine c
    v = {i: -sign * u[j], j: sign * u[i], k: ZERO}
    c = sign * u[k]
    cross = {(i, j): ZERO, (j, k): -v[i], (k, i): -v[j], (j, i): ZERO, (k, j): v[i], (i, k): v[j]}
    squared = total(x * x for x in v.values())
    turn = [
        [
            total((cross[r, s], v[r] * v[s] / (1 + c))) if r != s else total((ONE, (v[r] * v[r] - squared) / (1 + c)))
            for s in range(3)
        ]
        for r in range(3)
    ]
    return k, _product(_matrix(turn), near)


_NUMBERS = symbolic({})
_OWN: Mapping[str, Expr] = {model.COORDINATE: COORDINATE, model.RATE: RATE}
_HALF_TURNS: tuple[Matrix, ...] = tuple(  # about z, x, x: they turn x, y, z round
    ((x, ZERO, ZERO), (ZERO, y, ZERO), (ZERO, ZERO, z))
    for x, y, z in ((-ONE, -ONE, ONE), (ONE, -ONE, -ONE), (ONE, -ONE, -ONE))
)


@dataclass(frozen=True)
class _Reader:
    """Reads expressions of a model as SymPy expressions."""

    algebra: Algebra[Expr]
    symbols: Mapping[str, Expr]  # parameters; a constant 0 is structural
    values: Mapping[str, Expr]  # constants by their values
    present: Mapping[str, Expr]  # all parameters by their present values
    state: Mapping[str, Expr]  # numbers of the state by their symbols
    forces: Algebra[Expr]  # of forces

    def number(self, expression: Expression) -> Expr:
        """Read a length, mass or inertia over symbols."""
        return evaluate(expression, self.symbols, self.algebra)

    def vector(self, triple: model.Triple) -> Vector:
        """Read three numbers."""
        x, y, z = map(self.number, triple)
        return x, y, z

    def matrix(self, rows: tuple[model.Triple, ...]) -> Matrix:
        """Read nine numbers."""
        return _matrix([self.vector(row) for row in rows])

    def direction(self, triple: model.Triple) -> Vector:
        """Read the components of an axis, which are constant."""
        x, y, z = (evaluate(component, self.values, self.algebra) for component in triple)
        return x, y, z

    def constant(self, expression: Expression) -> float:
        """Read a number that is constant."""
        return to_double(evaluate(expression, self.values, self.algebra))

    def coefficient(self, expression: Expression) -> Expr:
        """Read a number of a coupling: a double, or an expression over run-time parameters."""
        value = evaluate(expression, self.values, self.algebra)
        return exact(to_double(value)) if value.is_number else self.number(expression)

    def limit(self, expression: Expression | None) -> float | None:
        """Read a limit of a joint, which is constant."""
        return None if expression is None else self.constant(expression)

    def law(self, law: model.Law) -> Expr:
        """Read a joint's own force, over its q and qd."""
        return self.force(law.total, _OWN)

    def force(self, expression: Expression, own: Mapping[str, Expr]) -> Expr:
        """Read an expression over parameters, numbers of the state, and a force's own numbers."""
        return evaluate(expression, {**self.state, **self.symbols, **own}, self.forces)

    def estimate(self, expression: Expression) -> float:
        """Read a number by the present values of parameters."""
        return to_double(evaluate(expression, self.present, self.algebra))

    def equation(self, equation: Expression, coordinates: Mapping[str, Expr]) -> Expr:
        """Read the equation of a constraint, over coordinates."""
        return evaluate(equation, {**self.symbols, **coordinates}, self.algebra)

    def rotation(self, placement: model.Placement) -> Matrix:
        """Read an orientation; constants enter by value, so that a quarter turn has its zeros."""
        product = IDENTITY
        for step in placement.orientation:
            angle = evaluate(step.angle, self.values, self.algebra)
            sine, cosine = (self.algebra.functions[name](angle) for name in ("sin", "cos"))
            rows = [[ONE if r == s == step.axis else ZERO for s in range(3)] for r in range(3)]
            j, k = (step.axis + 1) % 3, (step.axis + 2) % 3
            rows[j][j] = rows[k][k] = cosine
            rows[j][k], rows[k][j] = -sine, sine
            product = _product(product, _matrix(rows))
        return product


def _read_parameters(description: Model, *, readable: bool) -> tuple[tuple[Parameter, ...], _Reader]:
    symbols: dict[str, Expr] = {}
    values: dict[str, Expr] = {}
    known: dict[str, Expr] = {}
    constants: dict[Symbol, Expr] = {}
    algebra, changing = symbolic(constants), set[str]()
    parameters = []
    for parameter in description.parameters:
        name, symbol = parameter.name, Symbol(parameter.name)
        known[name] = round_number(evaluate(parameter.value, known, _NUMBERS))
        is_constant = parameter.kind is Kind.CONSTANT
        if is_constant and not changing.isdisjoint(names(parameter.value)):  # it stands for an expression
            symbols[name], values[name] = (evaluate(parameter.value, given, algebra) for given in (symbols, values))
            changing.add(name)
            continue
        parameters.append(Parameter(name, symbol, to_double(known[name]), parameter.kind))
        symbols[name] = ZERO if is_constant and known[name] == 0 else symbol
        values[name] = known[name] if is_constant else symbol
        if is_constant:
            constants[symbol] = known[name]
        else:
            changing.add(name)
    state = {name: quantity.symbol for name, quantity in list_quantities(description).items()}
    forces = symbolic(constants, readable=readable)
    return tuple(parameters), _Reader(algebra, symbols, values, known, state, forces)


@dataclass(frozen=True)
class _Seat:
    """Where an author's frame is: in a body of the Tree."""

    number: int  # of the body; 0: the base
    position: Vector = (ZERO, ZERO, ZERO)
    axes: Matrix = IDENTITY  # columns: the author's axes

    def point(self, v: Vector) -> Vector:
        """Find the place of a point that is given in the author's frame."""
        x, y, z = (total((a, b)) for a, b in zip(self.position, self.vector(v), strict=True))
        return x, y, z

    def vector(self, v: Vector) -> Vector:
        """Write a vector of the author's frame in the body's."""
        return _express(v, _transpose(self.axes))

    def carry(self, placement: model.Placement, reader: _Reader) -> _Seat:
        """Find the seat of a frame that is placed on this one."""
        return _Seat(
            self.number,
            self.point(reader.vector(placement.position)),
            _product(self.axes, reader.rotation(placement)),
        )


@dataclass(frozen=True)
class _Mover:
    """A body of the Tree, without its mass."""

    name: str
    joint: model.Joint
    axis: int
    parent: int
    position: Vector
    orientation: Matrix
    axes: Matrix


def _is_null(part: RigidPart) -> bool:
    """Return whether a part is empty, for all parameters."""
    return part.mass is ZERO and all(entry is ZERO for row in part.inertia for entry in row)


def _read_part(body: model.Body, seat: _Seat, reader: _Reader) -> RigidPart:
    tensor = _express_tensor(reader.matrix(centre_inertia(body).rows), _transpose(seat.axes))
    return RigidPart(body.name, reader.number(body.mass), seat.point(reader.vector(body.com)), tensor)


def _merge(parts: Sequence[RigidPart]) -> list[RigidPart]:
    """Merge parts that are fixed together into few; if none has mass, the first one is kept.

    Parts whose masses are numbers become one, and parts at one place become one. The others stay separate: their centre
    of mass would be 0/0 if their masses are 0 at run time.
    """
    present = [part for part in parts if not _is_null(part)] or parts[:1]
    if all(part.com == present[0].com for part in present):
        return [_join(present)]
    groups: dict[object, list[RigidPart]] = {}
    for part in present:
        groups.setdefault(None if part.mass.is_number else part.com, []).append(part)
    return [_join(group) for group in groups.values()]


def _join(parts: Sequence[RigidPart]) -> RigidPart:
    """Make one of parts with masses of numbers, or at one place."""
    first, *rest = parts
    if not rest:
        return first
    mass, com = total(part.mass for part in parts), first.com
    if mass is not ZERO and any(part.com != com for part in parts):
        x, y, z = (_tidy(total(part.mass * part.com[k] for part in parts) / mass) for k in range(3))
        com = x, y, z
    pairs = [(i, j) for i in range(3) for j in range(i, 3)]
    shifted = [_shift(part, com) for part in parts]
    tensor = _symmetric({(i, j): _tidy(total(tensor[i][j] for tensor in shifted)) for i, j in pairs})
    return RigidPart(first.name, _tidy(mass), com, tensor)


def _shift(part: RigidPart, point: Vector) -> Matrix:
    """Take a tensor about another point: I + m (d.d 1 - d dT), d from the centre of mass to it (Steiner)."""
    d = [total((a, -b)) for a, b in zip(part.com, point, strict=True)]
    squared = total(x * x for x in d)
    return _symmetric(
        {
            (i, j): total((part.inertia[i][j], part.mass * total((squared if i == j else ZERO, -d[i] * d[j]))))
            for i in range(3)
            for j in range(i, 3)
        }
    )


def _tidy(number: Expr) -> Expr:
    return round_number(number) if number.is_number else number


def _find_quaternions(description: Model, moving: Sequence[_Mover]) -> Iterator[Quaternion]:
    """Find the bodies that stand for quaternions: those between a body and what carries it, in a row."""
    numbers = {mover.name: i for i, mover in enumerate(moving, 1)}
    for body in description.bodies:
        if any(joint.floats for joint in body.joints):
            count = len(body.joints)
            yield Quaternion(body.name, numbers[body.name] - count + 1, is_free=count == 6)


def _find_couplings(
    description: Model, sums: Mapping[str, Linear], moving: Sequence[_Mover], reader: _Reader
) -> Iterator[Coupling]:
    """Find the joints that follow others, or sums of others, and what leads them in the end."""
    numbers = {mover.joint.name: i for i, mover in enumerate(moving, 1)}
    exactly = {name: _round(form) for name, form in sums.items()}

    def couple(name: str, terms: Sequence[tuple[str, Expr]], offset: Expr) -> Coupling:
        (leader, ratio), *more = sorted((numbers[leader], ratio) for leader, ratio in terms)
        return Coupling(numbers[name], leader, ratio, offset, tuple(more))

    for name, rule in find_rules(list_joints(description)).items():
        ratio, offset = map(reader.coefficient, (rule.ratio, rule.offset))
        terms = [(rule.joint, ratio)]
        if rule.joint in exactly:
            own, shift = exactly[rule.joint]
            terms, offset = [(leader, _tidy(ratio * x)) for leader, x in own], _tidy(total((ratio * shift, offset)))
        yield couple(name, terms, offset)
    for name, (terms, offset) in exactly.items():
        yield couple(name, terms, offset)


def _round(form: Linear) -> tuple[list[tuple[str, Expr]], Expr]:
    """Return the terms and the constant of a form, in doubles."""
    return [(name, exact(float(x))) for name, x in form.coefficients.items()], exact(float(form.constant))


def _bind(bodies: tuple[tree.Body, ...], couplings: Sequence[Coupling]) -> tuple[tree.Body, ...]:
    """Bound joints by the limits of their followers."""
    ranges = {body.joint.name: _find_range(body.joint) for body in bodies}
    joints = [body.joint.name for body in bodies]
    rules = {
        joints[x.follower - 1]: (joints[x.leader - 1], to_double(x.ratio), to_double(x.offset))
        for x in couplings
        if x.ratio.is_number and x.offset.is_number and not x.more  # else the follower has no limits
    }
    bound = list(bodies)
    for i in {x.leader - 1 for x in couplings}:
        found = find_range(joints[i], ranges, rules)
        lower, upper, speed = (x if math.isfinite(x) else None for x in (found.lower, found.upper, found.speed))
        bound[i] = replace(bodies[i], joint=replace(bodies[i].joint, lower=lower, upper=upper, max_speed=speed))
    return tuple(bound)


def _find_range(joint: tree.Joint) -> Range:
    lower, upper = (-math.inf if joint.lower is None else joint.lower, math.inf if joint.upper is None else joint.upper)
    return Range(lower, upper, math.inf if joint.max_speed is None else joint.max_speed)


def _make_body(mover: _Mover, part: RigidPart, *parts: RigidPart, reader: _Reader) -> tree.Body:
    assert mover.joint.name is not None, "the joints of an expanded model have names"
    return tree.Body(
        name=mover.name,
        parent=mover.parent,
        joint=tree.Joint(
            name=mover.joint.name,
            motion=mover.joint.motion,
            axis=mover.axis,
            actuated=mover.joint.actuated,
            lower=reader.limit(mover.joint.lower),
            upper=reader.limit(mover.joint.upper),
            law=reader.law(mover.joint.acting_law),
            max_speed=reader.limit(mover.joint.max_speed),
            max_force=reader.limit(mover.joint.max_force),
            stops=_make_stops(mover.joint, reader),
            dry=_make_dry(mover.joint, reader),
            armature=reader.number(mover.joint.armature),
        ),
        position=mover.position,
        orientation=mover.orientation,
        mass=part.mass,
        com=part.com,
        inertia=part.inertia,
        axes=mover.axes,
        parts=parts,
    )


def _make_stops(joint: model.Joint, reader: _Reader) -> tree.Stops | None:
    if joint.stops is None:
        return None
    ends = reader.limit(joint.lower), reader.limit(joint.upper)
    return tree.Stops(*ends, reader.limit(joint.stops.restitution))


def _make_dry(joint: model.Joint, reader: _Reader) -> tree.DryFriction | None:
    dry = joint.dry
    if dry is None:
        return None
    torque = reader.constant(dry.torque)
    static = torque if dry.static is None else reader.constant(dry.static)
    way = 0 if dry.one_way is None else round(reader.constant(dry.one_way))
    return tree.DryFriction(torque, static, reader.limit(dry.stribeck), way, _make_load(dry.load, reader))


def _make_load(load: model.BearingLoad | None, reader: _Reader) -> tree.BearingLoad | None:
    if load is None:
        return None
    sliding = reader.constant(load.coefficient)
    static = sliding if load.static is None else reader.constant(load.static)
    arm = 1.0 if load.radius is None else reader.constant(load.radius)
    return tree.BearingLoad(sliding, static, arm, reader.limit(load.length))


def _make_sensor(frame: model.Frame, seat: _Seat, reader: _Reader) -> tree.Sensor:
    placed = seat.carry(frame.placement, reader)
    return tree.Sensor(frame.name, placed.number, placed.position, placed.axes)


def _express_coordinates(bodies: Sequence[tree.Body], couplings: Sequence[Coupling]) -> dict[str, Expr]:
    """Express the coordinate of every joint by the coordinates of joints that do not follow others."""
    own = {body.joint.name: coordinate_symbol(body.joint.name) for body in bodies}
    names = [*own]
    followers = {
        names[x.follower - 1]: total((*(ratio * own[names[leader - 1]] for leader, ratio in x.terms), x.offset))
        for x in couplings
    }
    return {**own, **followers}


def _make_loop(loop: model.Loop, seats: Mapping[str, _Seat], reader: _Reader) -> tree.Loop:
    first, second = reader.direction(loop.axis), reader.direction(loop.axis)
    value = ZERO
    match loop.cut:
        case Cut.ROD:
            value = reader.number(loop.length)
        case Cut.HELICAL:
            value = reader.number(loop.pitch)
        case Cut.UNIVERSAL:
            second = reader.direction(loop.axis2)
            value = _tidy(cosine(first, second))
    ends = ((loop.first, first), (loop.second, second))
    one, other = (_make_loop_frame(seats[end.body].carry(end.placement, reader), axis) for end, axis in ends)
    return tree.Loop(loop.name, loop.cut, one, other, value)


def _make_loop_frame(seat: _Seat, axis: Vector) -> tree.LoopFrame:
    """Turn a frame so that its z axis lies along an axis that is given in it."""
    k, turn = align(axis)
    cyclic = _matrix([[ONE if (r - k) % 3 == (s - 2) % 3 else ZERO for s in range(3)] for r in range(3)])
    return tree.LoopFrame(seat.number, seat.position, _product(seat.axes, _product(turn, cyclic)))


def cosine(a: Vector, b: Vector) -> Expr:
    """Compute the cosine of the angle between two directions of numbers."""
    product, *squares = (total(x * y for x, y in zip(*pair, strict=True)) for pair in ((a, b), (a, a), (b, b)))
    lengths = [_NUMBERS.functions["sqrt"](square) for square in squares]
    return product / (lengths[0] * lengths[1])


def _make_wrench(wrench: model.Wrench, seat: _Seat, reader: _Reader) -> tree.Wrench:
    force, moment = (
        None if v is None else _vector(reader.force(x, {}) for x in v) for v in (wrench.force, wrench.moment)
    )
    position = seat.point(reader.vector(wrench.position))
    axes = IDENTITY if wrench.in_base else seat.axes
    return tree.Wrench(wrench.name, seat.number, position, wrench.in_base, force, moment, axes)


def _probe_frames(description: Model, seats: Mapping[str, _Seat], reader: _Reader) -> Iterator[Probe]:
    """Make the probes of the frames that forces read."""
    read = find_read_frames(description)
    for frame in description.frames:
        if frame.name in read:
            at = seats[frame.body].carry(frame.placement, reader)
            for reading in (Reading.POSITION, Reading.VELOCITY):
                yield Probe(probe_symbols(frame.name, reading), reading, at.number, at.position)


def _collect_loads(description: Model, seats: Mapping[str, _Seat], reader: _Reader) -> Loads:
    """Write force elements and contacts as wrenches."""
    loads = Loads(reader.force)

    def anchor(body: str, placement: model.Placement) -> Anchor:
        at = seats[body].carry(placement, reader)
        return Anchor(at.number, at.position)

    known, frames = list_poses(description), {x.name: x for x in description.frames}
    lengths, read = name_lengths([x.name for x in description.forces]), find_stopped(description)
    measured = {own for key, own in lengths.items() if key in read}
    for element in description.forces:
        path = [_make_spot(point, seats[point.body], reader, description) for point in element.path]
        around = [_make_surface(x, seats[x.body], reader, len(path)) for x in element.wraps]
        loads.add_element(element, path, around, is_read=element.name in measured)
    for wrench in description.wrenches:
        if wrench.against is not None:
            ends = (wrench.against.body, wrench.against.placement), (wrench.body, wrench.placement)
            first, second = (seats[body].carry(placement, reader) for body, placement in ends)
            loads.add_between(
                wrench, *((anchor(*x), _transpose(y.axes)) for x, y in zip(ends, (first, second), strict=True))
            )
    for contact in description.contacts:
        at, other = seats[contact.body].carry(contact.placement, reader), contact.other
        if contact.is_of_solids:
            sides = at, seats[other.body].carry(other.placement, reader)
            shapes = [_place_hull(*x) for x in zip(sides, find_solids(contact, reader.constant), strict=True)]
            loads.add_meeting(contact.name, shapes, _read_rigid(contact, reader))
            continue
        points = [(name, Anchor(at.number, at.point(point))) for name, point in _list_points(contact, reader)]
        seat = seats[other.body].carry(other.placement, reader)
        axes: tuple[Vector, ...] = _transpose(seat.axes)
        if isinstance(other, model.Plane):
            axes = (seat.vector(normalise(reader.direction(other.normal))),)
        circle = None
        if contact.wheel is not None:
            circle = Circle(contact.wheel.radius, at.vector(normalise(reader.direction(contact.wheel.axis))))
        side = Side(Anchor(seat.number, seat.position), axes)
        if contact.restitution is None:
            loads.add_contact(contact, points, side, reader.constant(contact.exponent), circle)
            continue
        loads.add_rigid(contact, points, side, _read_rigid(contact, reader), circle)
    sights = [_make_sight(x, frames, anchor) for key, x in known.items() if key in read]
    for stop in description.stops:
        lower, upper = (None if x is None else reader.number(x) for x in (stop.lower, stop.upper))
        bounce, hold = reader.limit(stop.law.restitution), reader.constant(stop.hold)
        loads.add_stop(stop, sights, (lower, upper), None if bounce is None else (bounce, hold))
    return loads


def _make_sight(
    quantity: Quantity, frames: Mapping[str, model.Frame], anchor: Callable[[str, model.Placement], Anchor]
) -> Sight:
    if quantity.joint is not None:
        return Sight(quantity.symbol, rate_symbol(quantity.joint), quantity.joint)
    frame = frames[quantity.source]
    axis = probe_symbols(frame.name, Reading.POSITION).index(quantity.symbol)
    rate = probe_symbols(frame.name, Reading.VELOCITY)[axis]
    return Sight(quantity.symbol, rate, "", anchor(frame.body, frame.placement), axis)


def _make_spot(point: model.PathPoint, seat: _Seat, reader: _Reader, description: model.Model) -> Spot:
    at = seat.carry(point.placement, reader)
    anchor = Anchor(at.number, at.position)
    presence = None
    if (own := point.presence) is not None:
        presence = reader.force(Name(own.number), {}), reader.number(own.lower), reader.number(own.upper)
    if point.shift == model.ORIGIN:
        return Spot(anchor, presence=presence)
    known = list_quantities(description)
    read = [known[name] for name in sorted(frozenset[str]().union(*map(names, point.shift)) & known.keys())]
    coordinates = tuple((x.symbol, rate_symbol(x.joint), x.joint) for x in read if x.joint is not None)
    shift = tuple(reader.force(x, {}) for x in point.shift)
    return Spot(anchor, _transpose(at.axes), shift, coordinates, presence)


def _make_surface(wrap: model.Wrap, seat: _Seat, reader: _Reader, points: int) -> Surface:
    at = seat.carry(wrap.placement, reader)
    axes, size = _transpose(at.axes), [reader.number(x) for x in wrap.size]
    number, sign = ("xyz".index(wrap.side[-1]), -1 if wrap.side[0] == "-" else 1) if wrap.side else (0, 0)
    if wrap.kind in ("ellipsoid", "torus"):
        shape: Shape
        if wrap.kind == "ellipsoid":
            shape = Ellipsoid(_vector(size), wrap.method, (number, sign) if sign else None)
        else:
            shape = Torus(size[0], size[1], _vector(sign * x for x in IDENTITY[number]) if sign else None)
        anchor = Anchor(at.number, at.position)
        return Surface(anchor, None, None, size[0], None, *wrap.span(points), shape, tuple(axes))
    side = axes[number] if sign == 1 else _vector(-x for x in axes[number])
    return Surface(
        Anchor(at.number, at.position),
        None if wrap.kind == "sphere" else axes[2],
        side if sign else None,
        size[0],
        None if wrap.length is None else reader.number(wrap.length) / 2,
        *wrap.span(points),
    )


def _list_points(contact: model.Contact, reader: _Reader) -> Iterator[tuple[str, Vector]]:
    """List the centre of a sphere or a wheel, or the corners of a box or a hull, with their names."""
    if not contact.has_points:
        yield contact.name, (ZERO, ZERO, ZERO)
        return
    yield from ((f"{contact.name}.{k}", point) for k, point in enumerate(_list_corners(contact, reader), 1))


def _list_corners(contact: model.Contact, reader: _Reader) -> Iterator[Vector]:
    """List the corners of a box or a hull, or the centres of the circles of a cylinder, in the contact's frame."""
    if contact.size is not None:
        for signs in product((-1, 1), repeat=3):
            yield _vector(s * side / 2 for s, side in zip(signs, reader.vector(contact.size), strict=True))
    if contact.wheel is not None:
        axis, half = normalise(reader.direction(contact.wheel.axis)), reader.number(contact.wheel.length) / 2
        yield from (_vector(side * half * a for a in axis) for side in (-1, 1))
    yield from map(reader.vector, contact.points)


def _read_rigid(contact: model.Contact, reader: _Reader) -> tuple[float, float]:
    """Read the restitution and the coefficient of friction of a rigid contact."""
    assert contact.restitution is not None, "the contact is rigid"
    grip = 0.0 if contact.friction is None else reader.constant(contact.friction.coefficient)
    return reader.constant(contact.restitution), grip


def _place_hull(seat: _Seat, solid: tuple[tuple[Corner, ...], float]) -> PlacedHull:
    return PlacedHull(Anchor(seat.number, seat.position), _transpose(seat.axes), *solid)


def normalise(direction: Vector) -> Vector:
    """Return the unit vector along a direction of numbers."""
    length = _NUMBERS.functions["sqrt"](total(x * x for x in direction))
    return _vector(_tidy(x / length) for x in direction)


def _vector(components: Iterable[Expr]) -> Vector:
    x, y, z = components
    return x, y, z


def _express(v: Vector, C: Matrix) -> Vector:
    """Write a vector in the axes that are the columns of C: C^T v."""
    x, y, z = (total(C[k][i] * v[k] for k in range(3)) for i in range(3))
    return x, y, z


def _express_tensor(tensor: Matrix, C: Matrix) -> Matrix:
    """Write a symmetric tensor in the axes that are the columns of C: C^T T C."""
    pairs = [(k, l) for k in range(3) for l in range(3)]
    entries = {(i, j): total(C[k][i] * C[l][j] * tensor[k][l] for k, l in pairs) for i in range(3) for j in range(i, 3)}
    return _symmetric(entries)


def _symmetric(upper: Mapping[tuple[int, int], Expr]) -> Matrix:
    return _matrix([[upper[min(i, j), max(i, j)] for j in range(3)] for i in range(3)])


def _product(A: Matrix, B: Matrix) -> Matrix:
    return _matrix([[total(A[i][k] * B[k][j] for k in range(3)) for j in range(3)] for i in range(3)])


def _transpose(A: Matrix) -> Matrix:
    return _matrix([[A[k][i] for k in range(3)] for i in range(3)])


def _matrix(rows: Sequence[Sequence[Expr]]) -> Matrix:
    (a, b, c), (d, e, f), (g, h, i) = rows
    return (a, b, c), (d, e, f), (g, h, i)
