"""Closure of loops: Tree -> Tapes of h(q), its time derivatives, and its Jacobian J.

    h(q) = 0,    hd = J qd,    hdd = J qdd + gamma,    gamma = Jd qd

With d from the origin of a loop's first frame to the origin of its second, the axes x1, y1, z1 and x2, y2, z2 of the
two frames, and the author's axes x, y, z of the last body that carries both, its equations are

    rod            (d.d - L2) / (2 L)
    ball           d.x, d.y, d.z
    hinge          a ball's, x1.z2, y1.z2
    universal      a ball's, z1.z2 - cosine
    cylindrical    d.x1, d.y1, x1.z2, y1.z2
    helical        a cylindrical joint's, 2 p tan((d.z1 / p - t) / 2), with cos(t) = x1.x2, sin(t) = y1.x2
    prismatic      a cylindrical joint's, y1.x2
    planar         d.z1, x1.z2, y1.z2
    solid          a hinge's, y1.x2

(Wittenburg, 2008, 5.2; Shabana, 2013, 3.) All vectors are in the frame of that last body, so joints before it do not
appear. Joints with parallel axes turn by the sum of their angles: a planar loop is a sum of vectors, each turned once.
An equation of coordinates is an entry of h itself. Time derivatives are directional derivatives of the tape of h, so
they hold for quaternions too.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace

from mbsgen.algebra.rotations import axis_rotation
from mbsgen.algebra.vectors import Vector
from mbsgen.formulations import ports, rates
from mbsgen.formulations.chain import Chain, write_chain
from mbsgen.formulations.parsimony.segments import Segment, align
from mbsgen.formulations.states import declare_state
from mbsgen.model.tree import Constraint, Cut, Loop, LoopFrame, Tree, coordinate_symbol
from mbsgen.roles import Role
from mbsgen.tape import forward, reverse
from mbsgen.tape.builder import Builder, Scalar
from mbsgen.tape.counts import count_paper
from mbsgen.tape.lowering import lower
from mbsgen.tape.passes import drop_unused_inputs
from mbsgen.tape.ports import Port, adjoint_port, seed_port
from mbsgen.tape.replay import replay
from mbsgen.tape.types import Tape

Write = Callable[[Tree], Tape]

SCREW = "screw"  # the equation of a shift and a turn [m]: whole turns lead on to the next thread, half ones are far off
_PLACE = ("x", "y", "z")
_TURN = ("turn_x", "turn_y")
EQUATIONS: Mapping[Cut, tuple[str, ...]] = {
    Cut.ROD: ("distance",),
    Cut.BALL: _PLACE,
    Cut.HINGE: (*_PLACE, *_TURN),
    Cut.UNIVERSAL: (*_PLACE, "angle"),
    Cut.CYLINDRICAL: ("x", "y", *_TURN),
    Cut.HELICAL: ("x", "y", *_TURN, SCREW),
    Cut.PRISMATIC: ("x", "y", *_TURN, "turn_z"),
    Cut.PLANAR: ("z", *_TURN),
    Cut.SOLID: (*_PLACE, *_TURN, "turn_z"),
}


def list_equations(tree: Tree) -> tuple[tuple[int, str], ...]:
    """List all equations: the number, from 0, of the loop or constraint (loops come first), and a name."""
    named = [(k, name) for k, loop in enumerate(tree.loops) for name in EQUATIONS[loop.cut]]
    return (*named, *((k, "equation") for k, _ in enumerate(tree.constraints, len(tree.loops))))


def kept_equations(tree: Tree) -> tuple[tuple[int, str], ...]:
    """List the entries of h likewise: all equations but the redundant ones, once these are known."""
    every = list_equations(tree)
    return every if tree.closure is None else tuple(every[i] for i in tree.closure.kept)


def find_status(tree: Tree, loop: int) -> int:
    """Return what a kernel returns where it fails at a loop or constraint, by its number: they follow the joints."""
    return len(tree.joints) + 1 + loop


def list_statuses(tree: Tree) -> tuple[int, ...]:
    """List the status of each entry of h."""
    return tuple(find_status(tree, loop) for loop, _ in kept_equations(tree))


def build(tree: Tree) -> Tape:
    """Write `loops`: inputs q [, p]; output gap = h(q), shape (m,): what is left open of loops and constraints."""
    builder = Builder()
    chain = _write_chain(tree, builder)
    entries = [x for loop in tree.loops for x in _close_loop(chain, loop)]
    entries += [_lower(chain, constraint) for constraint in tree.constraints]
    if tree.closure is not None:
        entries = [entries[i] for i in tree.closure.kept]
    builder.output_dense(ports.CLOSURE, [[x] for x in entries])
    return builder.build("loops")


_SENSES: Mapping[Cut, tuple[int, ...]] = {  # the axes that must not be turned round
    Cut.HINGE: (2,),
    Cut.CYLINDRICAL: (2,),
    Cut.HELICAL: (2,),
    Cut.PLANAR: (2,),
    Cut.PRISMATIC: (2, 0),
    Cut.SOLID: (2, 0),
}


def _write_chain(tree: Tree, builder: Builder) -> Chain:
    """Write the links of a tree at q; wrenches do not matter for closures."""
    state = declare_state(tree, builder, rates=False, accelerations=False, forces=False, wrenches=False)
    return write_chain(replace(tree, wrenches=()), builder, state)


def list_senses(tree: Tree) -> tuple[int, ...]:
    """List the number of the loop of each result of `build_senses`."""
    return tuple(k for k, loop in enumerate(tree.loops) for _ in _SENSES.get(loop.cut, ()))


def build_senses(tree: Tree) -> Tape:
    """Write the cosines between axes that loops keep in one direction: h vanishes for the opposite one too."""
    builder = Builder()
    chain = _write_chain(tree, builder)
    found = []
    for loop in tree.loops:
        first, second = _End.make(chain, loop)
        found += [first.axis(k).dot(second.axis(k)) for k in _SENSES.get(loop.cut, ())]
    builder.output_dense("senses", [[x] for x in found])
    return builder.build("senses")


def build_rates(tree: Tree) -> Tape:
    """Write `loop_rates`: inputs q, qd [, p]; output hd = J qd, shape (m,)."""
    closure = build(tree)
    builder = Builder()
    given = _declare(builder, closure, tree, [ports.VELOCITIES])
    slopes = _carry(closure, builder, given, {Role.COORDINATE: _move(tree, builder, given)})
    builder.output_dense(ports.CLOSURE_RATE, [[x] for x in slopes])
    return builder.build("loop_rates")


def build_accelerations(tree: Tree) -> Tape:
    """Write `loop_accelerations`: inputs q, qd, qdd [, p]; output hdd = J qdd + gamma, shape (m,)."""
    speeds = build_rates(tree)
    builder = Builder()
    given = _declare(builder, speeds, tree, [ports.ACCELERATIONS])
    moves = {Role.COORDINATE: _move(tree, builder, given), Role.VELOCITY: given[ports.ACCELERATIONS.name]}
    slopes = _carry(speeds, builder, given, moves)
    builder.output_dense(ports.CLOSURE_ACCELERATION, [[x] for x in slopes])
    return builder.build("loop_accelerations")


def build_jacobian(tree: Tree) -> Tape:
    """Write `loop_jacobian`: inputs q, qd [, p]; outputs J, shape (m, n), nonzeros only, and gamma, shape (m,)."""
    jacobian, bias = write_jacobian(tree), build_accelerations(tree)
    builder = Builder()
    kept = (i for i in bias.inputs if not _is_acceleration(i.port))
    given = {i.name: builder.input(i.port, i.sparsity) for i in kept}
    found = jacobian.outputs[0]
    values = replay(jacobian, builder, given)
    entries = dict(zip(found.sparsity.entries, (values[v] for v in found.values), strict=True))
    builder.output_nonzeros(ports.CLOSURE_JACOBIAN, found.sparsity.rows, found.sparsity.cols, entries)
    rest = {i.name: [builder.zero] * i.sparsity.nnz for i in bias.inputs if _is_acceleration(i.port)}
    values = replay(bias, builder, {**given, **rest})
    builder.output_dense(ports.CLOSURE_BIAS, [[values[v]] for v in bias.outputs[0].values])
    return builder.build("loop_jacobian")


def write_jacobian(tree: Tree, spread: Callable[[Builder, Sequence[Scalar]], list[Scalar]] | None = None) -> Tape:
    """Write J from hd, which is linear in qd: its derivative by qd depends on q alone.

    With `spread`, the derivative is by the unknowns from which it computes qd.
    """
    tape, by = build_rates(tree), [ports.VELOCITIES.name]
    if spread:
        builder = Builder(cancel=True)
        given = {i.name: builder.input(i.port, i.sparsity) for i in tape.inputs}
        given[ports.VELOCITIES.name] = spread(builder, given[ports.VELOCITIES.name])
        values = replay(tape, builder, given)
        builder.output_dense(ports.CLOSURE_RATE, [[values[v]] for v in tape.outputs[0].values])
        tape = builder.build(tape.function)
    return drop_unused_inputs(min(forward.jacobian(tape, by), reverse.jacobian(tape, by), key=count_paper))


def write_forces(tree: Tree) -> Tape:
    """Write the joint forces JT lam of multipliers: inputs q, lam [, p]; output Q, shape (n,)."""
    tape = reverse.adjoint(build_rates(tree), [ports.VELOCITIES.name])
    builder = Builder()
    seed = seed_port(ports.CLOSURE_RATE)
    used = {i.name for i in drop_unused_inputs(tape).inputs}
    parameters = [i for i in tape.inputs if i.port.role is Role.PARAMETER]  # of which a setup is made, used or not
    given = {
        i.name: builder.input(ports.MULTIPLIERS if i.port == seed else i.port, i.sparsity)
        for i in (*(i for i in tape.inputs if i.name in used and i not in parameters), *parameters)
    }
    given |= {i.name: [builder.zero] * i.sparsity.nnz for i in tape.inputs if i.name not in given}
    values = replay(tape, builder, given)
    found = tape.output(adjoint_port(ports.VELOCITIES).name)
    builder.output_dense(ports.JOINT_FORCES, [[values[v]] for v in found.values])
    return builder.build("loop_forces")


def count_forces(tree: Tree) -> dict[Port, int]:
    """Return the sizes of lam and tau, the forces of a tree's equations and of its driven joints, where it has some."""
    sizes = {ports.MULTIPLIERS: len(kept_equations(tree)), ports.DRIVING_FORCES: len(tree.driven)}
    return {port: size for port, size in sizes.items() if size}


def add_multipliers(tape: Tape, tree: Tree) -> Tape:
    """Write a residual of the tree with its constraints: Phi - Q - JT lam, less tau in the driven joints.

    The inputs lam, shape (m,), and tau, the forces of the driven joints, follow the accelerations.
    """
    if not tree.is_constrained:
        return tape
    builder = Builder()
    given: dict[str, list[Scalar]] = {}
    for i in tape.inputs:
        given[i.name] = builder.input(i.port, i.sparsity)
        if i.port == ports.ACCELERATIONS:
            given |= {port.name: builder.vector(port, size) for port, size in count_forces(tree).items()}
    values = replay(tape, builder, given)
    found = tape.output(ports.RESIDUAL.name)
    Phi = [values[v] for v in found.values]
    if ports.MULTIPLIERS.name in given:
        forces = write_forces(tree)
        own = replay(forces, builder, given)
        Phi = [a - own[v] for a, v in zip(Phi, forces.outputs[0].values, strict=True)]
    for k, number in enumerate(tree.driven):
        Phi[number - 1] = Phi[number - 1] - given[ports.DRIVING_FORCES.name][k]
    builder.output_dense(ports.RESIDUAL, [[x] for x in Phi])
    for guard in tape.guards:
        pivot = -values[guard.value] if guard.negated else values[guard.value]
        builder.guard(pivot, values[guard.scale], guard.tolerance, guard.joint, early=guard.early)
    return builder.build(tape.function)


# -- lost equations -------------------------------------------------------------------------------------------------


def group_equations(tree: Tree) -> tuple[tuple[int, bool], ...]:
    """Return the group of each entry of h: its loop, and whether it compares directions, not places."""
    return tuple((loop, name.startswith("turn") or name == "angle") for loop, name in kept_equations(tree))


def find_lone_equations(tree: Tree) -> tuple[int, ...]:
    """List the entries of h, from 0, that are alone in their groups; entries of constraints have no known size."""
    groups = group_equations(tree)
    return tuple(k for k, group in enumerate(groups) if groups.count(group) == 1 and group[0] < len(tree.loops))


def build_levers(tree: Tree) -> Tape:
    """Write bounds on the entries of J in lone equations: how far a joint may be from the end that it moves, or 1.

    The output `levers`, shape (lone equations, n), depends on parameters, and not on angles.
    """
    builder = Builder()
    state = declare_state(tree, builder, rates=False, accelerations=False, forces=False, wrenches=False)
    chain = write_chain(replace(tree, wrenches=()), builder, state)
    groups, rows = group_equations(tree), []
    for k in find_lone_equations(tree):
        number, is_turn = groups[k]
        first, second = _End.make(chain, tree.loops[number])
        bounds = {**first.bound(is_turn=is_turn), **second.bound(is_turn=is_turn)}
        if kept_equations(tree)[k][1] == SCREW:
            lead = _length(chain.still.along(0, chain.scalar(tree.loops[number].value)))
            turns = {**first.bound(is_turn=True), **second.bound(is_turn=True)}
            bounds = {i: bound + lead * turns[i] for i, bound in bounds.items()}
        rows.append([bounds.get(i, builder.zero) for i in range(1, len(tree.bodies) + 1)])
    builder.output_dense("levers", rows)
    return builder.build("levers")


# -- time derivatives ---------------------------------------------------------------------------------------------


def _is_acceleration(port: Port) -> bool:
    return port.role is Role.ACCELERATION


def _declare(builder: Builder, tape: Tape, tree: Tree, more: Sequence[Port]) -> dict[str, list[Scalar]]:
    """Declare the inputs of a tape with further columns of joints behind the ones of the state."""
    given: dict[str, list[Scalar]] = {}
    state = (Role.COORDINATE, Role.VELOCITY)
    for i in (i for i in tape.inputs if i.port.role in state):
        given[i.name] = builder.input(i.port, i.sparsity)
    for port in more:
        given[port.name] = builder.vector(port, len(tree.bodies))
    for i in (i for i in tape.inputs if i.port.role not in state):
        given[i.name] = builder.input(i.port, i.sparsity)
    return given


def _move(tree: Tree, builder: Builder, given: Mapping[str, Sequence[Scalar]]) -> Sequence[Scalar]:
    """Return the time derivatives of q."""
    if not tree.quaternions:
        return given[ports.VELOCITIES.name]
    tape = rates.build(tree)
    values = replay(tape, builder, {i.name: given.get(i.name, []) for i in tape.inputs})
    return [values[v] for v in tape.outputs[0].values]


def _carry(
    tape: Tape, builder: Builder, given: Mapping[str, Sequence[Scalar]], moves: Mapping[Role, Sequence[Scalar]]
) -> list[Scalar]:
    """Differentiate the first output of a tape along a direction: the entries of `moves` by the roles of inputs."""
    values = replay(tape, builder, {i.name: given[i.name] for i in tape.inputs})
    seeds: list[forward.Gradient] = []
    for i in tape.inputs:
        direction = moves.get(i.port.role)
        seeds += [{} if direction is None else {0: direction[k]} for k in range(i.sparsity.nnz)]
    gradients = forward.carry(tape, builder, values, seeds)
    return [gradients[v].get(0, builder.zero) for v in tape.outputs[0].values]


# -- equations ----------------------------------------------------------------------------------------------------


def _lower(chain: Chain, constraint: Constraint) -> Scalar:
    names = [body.joint.name for body in chain.tree.bodies]
    own = {coordinate_symbol(name): q for name, q in zip(names, chain.state.q, strict=True)}
    return lower(constraint.equation, chain.builder, {**chain.symbols, **own})


def _close_loop(chain: Chain, loop: Loop) -> list[Scalar]:
    """Write the equations of a loop, in the order of EQUATIONS."""
    first, second = _End.make(chain, loop)
    match loop.cut:
        case Cut.ROD:
            d, length = second.place - first.place, chain.scalar(loop.value)
            return [(d.dot(d) - length * length) / (length + length)]
        case Cut.UNIVERSAL:
            return [*_join(first, second), first.axis(2).dot(second.axis(2)) - chain.scalar(loop.value)]
        case Cut.SOLID:
            z2 = second.axis(2)
            turns = first.axis(0).dot(z2), first.axis(1).dot(z2), first.axis(1).dot(second.axis(0))
            return [*_join(first, second), *turns]
        case Cut.BALL:
            return [*_join(first, second)]
        case Cut.HELICAL:
            return [*_line_up(first, second, loop.cut), _screw(first, second, chain.scalar(loop.value))]
    return [*_line_up(first, second, loop.cut)]


def _line_up(first: _End, second: _End, cut: Cut) -> Iterator[Scalar]:
    """Yield the equations of the cuts that keep two axes in one direction."""
    x1, y1 = first.axis(0), first.axis(1)
    if cut is Cut.HINGE:
        yield from _join(first, second)
    else:
        d = second.place - first.place
        yield from (d.dot(first.axis(2)),) if cut is Cut.PLANAR else (d.dot(x1), d.dot(y1))
    z2 = second.axis(2)
    yield from (x1.dot(z2), y1.dot(z2))
    if cut is Cut.PRISMATIC:
        yield y1.dot(second.axis(0))


def _screw(first: _End, second: _End, pitch: Scalar) -> Scalar:
    """Compare the shift of the second frame along z1 with its turn about it: tan(a / 2) = sin(a) / (1 + cos(a))."""
    b = pitch.builder
    shift = (second.place - first.place).dot(first.axis(2)) / pitch
    x2, s, c = second.axis(0), b.sin(shift), b.cos(shift)
    along, across = first.axis(0).dot(x2), first.axis(1).dot(x2)
    return (pitch + pitch) * (s * along - c * across) / (b.number(1.0) + c * along + s * across)


def _join(first: _End, second: _End) -> Iterator[Scalar]:
    yield from second.place - first.place


class _End:
    """One end of a loop in the frame of the last body that carries both; axes are carried there when asked for."""

    def __init__(self, chain: Chain, end: LoopFrame, path: Sequence[Segment], carrier: Segment | None) -> None:
        self._chain, self._path = chain, path
        own = path[0].frame if path else carrier.frame if carrier else None
        # the author's axes of the last body that carries both ends; None: the base's
        self._along = carrier.frame.times(chain.matrix(chain.tree.bodies[carrier.number - 1].axes)) if carrier else None
        axes, place = chain.matrix(end.axes), chain.vector(end.position)
        self._axes = own.times(axes) if own else axes
        self._point = own.apply(place) if own else place
        self.place = self._carry(self._point, is_point=True)

    @staticmethod
    def make(chain: Chain, loop: Loop) -> tuple[_End, _End]:
        """Carry both ends of a loop to the last body that carries both."""
        segments = align(chain)
        one, other = (_climb(segments, end.body) for end in (loop.first, loop.second))
        carrier = None
        while one and other and one[-1] is other[-1]:
            carrier = one.pop()
            other.pop()
        return _End(chain, loop.first, one, carrier), _End(chain, loop.second, other, carrier)

    def bound(self, *, is_turn: bool) -> dict[int, Scalar]:
        """Bound the velocity of the end, or with `is_turn` its angular velocity, for unit rates of its joints."""
        one, zero, found = self._chain.builder.number(1.0), self._chain.builder.zero, dict[int, Scalar]()
        reach = _length(self._point)
        for segment in self._path:
            found[segment.number] = (one if is_turn else reach) if segment.is_revolute else (zero if is_turn else one)
            reach = reach + _length(segment.d)
        return found

    def axis(self, k: int) -> Vector[Scalar]:
        """Return an axis of the frame."""
        return self._carry(self._axes.column(k), is_point=False)

    def _carry(self, v: Vector[Scalar], *, is_point: bool) -> Vector[Scalar]:
        """Carry a point or a direction from the body of the end to the carrier, a group of parallel axes at a time."""
        still, path = self._chain.still, list(self._path)
        while path:
            group = [path.pop(0)]
            while path and not group[-1].opens_group:
                group.append(path.pop(0))
            angles = self._add_angles(group)
            total = still
            for segment, angle in zip(group, angles, strict=True):
                slide = still if angle else still.along(segment.axis, self._coordinate(segment))
                own = v + slide if is_point else v
                total = total + (_turn(segment.axis, angle, own) if angle else own)
                v = segment.d if is_point else still
            first = group[-1]
            v = first.turn.apply(total) + v if first.turn else total + v
        return self._along.transposed.apply(v) if self._along else v

    def _add_angles(self, group: Sequence[Segment]) -> list[Scalar | None]:
        """Return the angle of each segment of a group from where its first joint is carried; None of a slide."""
        angles: list[Scalar | None] = []
        total: Scalar | None = None
        for segment in reversed(group):
            own = self._coordinate(segment)
            total = None if not segment.is_revolute else own if total is None else total + own
            angles.insert(0, total)
        return angles

    def _coordinate(self, segment: Segment) -> Scalar:
        return segment.signed(self._chain.state.q[segment.number - 1])


def _length(v: Vector[Scalar]) -> Scalar:
    squared = v.dot(v)
    return squared if squared.is_zero else squared.builder.sqrt(squared)


def _turn(axis: int, angle: Scalar, v: Vector[Scalar]) -> Vector[Scalar]:
    b = angle.builder
    return axis_rotation(axis, b.sin(angle), b.cos(angle), b.zero, b.number(1.0)).apply(v)


def _climb(segments: Sequence[Segment], body: int) -> list[Segment]:
    """List a body and all that carry it, up to the base."""
    path = []
    while body:
        path.append(segments[body - 1])
        body = path[-1].parent
    return path


def jacobian_entries(tape: Tape, values: Sequence[Scalar]) -> dict[tuple[int, int], Scalar]:
    """Return the entries of J by row and column, from the values of a replayed tape that gives J first."""
    found = tape.outputs[0]
    return {place: values[v] for place, v in zip(found.sparsity.entries, found.values, strict=True)}
