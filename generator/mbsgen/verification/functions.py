"""The expected results of each function of the catalogue at a state: by the textbook's recursion, and by geometry.

An expectation compares the results of a function with values that do not depend on any plan. A comparison is of
vectors, relative to the largest number that enters them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from decimal import Decimal
from functools import cached_property
from itertools import islice
from types import MappingProxyType

from sympy import Expr, Symbol

from mbsgen.formulations import ports, textbook
from mbsgen.formulations.chain import assign_symbols, joint_forces, write_chain
from mbsgen.formulations.states import declare_state
from mbsgen.model.elements import list_end_symbols
from mbsgen.model.tree import (
    Barrier,
    Coupling,
    Kind,
    Probe,
    Reading,
    Tree,
    Wrench,
    coordinate_symbol,
    rate_symbol,
    signal_symbol,
)
from mbsgen.procedure.procedure import Computation
from mbsgen.roles import MOMENTS
from mbsgen.tape.builder import Builder
from mbsgen.tape.interpreter import DECIMALS, evaluate
from mbsgen.tape.lowering import lower
from mbsgen.tape.ports import Port
from mbsgen.tape.types import Tape
from mbsgen.verification.geometry import (
    STEP,
    ZERO,
    Mechanism,
    Pose,
    Vector,
    add,
    apply,
    bend,
    cross,
    dot,
    rotation,
    slope,
    times,
    transpose,
    velocity,
    write_numbers,
)
from mbsgen.verification.loops import Closures
from mbsgen.verification.states import Numbers, State, draw

Results = Mapping[str, Numbers]  # nonzeros of each output

LARGEST_INVERSE = 12  # joints, up to which `condition` is compared: this inverts M


@dataclass(frozen=True)
class Comparison:
    """Two vectors that must be equal, and the size of their terms."""

    of: str  # the result
    found: Numbers
    expected: Numbers
    scale: Decimal = ZERO  # beside the largest expected number

    @property
    def deviation(self) -> Decimal:
        """Return the largest difference, relative to the scale; NaN where a number is missing."""
        differences = [abs(a - b) for a, b in zip(self.found, self.expected, strict=True)]
        if any(not x.is_finite() for x in differences):
            return Decimal("nan")
        scale = max(self.scale, largest(self.expected))
        return max(differences, default=ZERO) / (scale or 1)


def largest(numbers: Numbers) -> Decimal:
    """Return the largest magnitude; 0 of nothing."""
    return max(map(abs, numbers), default=ZERO)


def write_equations(tree: Tree) -> Tape:
    """Write the textbook's residual Phi(q, qd, qdd), and the joints' forces Q, of all joints."""
    builder = Builder()
    state = declare_state(tree.uncoupled, builder)
    chain = write_chain(tree.uncoupled, builder, state)
    Phi = textbook.residual(chain, state.qd, chain.accelerate(state.qdd))
    for name, column in (("Phi", Phi), ("Q", joint_forces(chain))):
        builder.output_dense(name, [[entry] for entry in column])
    return builder.build("equations")


class Truth:
    """A tree at one state. Functions have the joints that follow no other; bodies move by all joints."""

    def __init__(self, tree: Tree, equations: Tape, state: State) -> None:
        """Take a tree, its tape of `write_equations`, and a state."""
        self.coupled, self.tree, self.state, self._equations = tree, tree.uncoupled, state, equations
        self.n = len(tree.joints)
        self.qd, self.qdd = state.take("qd", self.n), state.take("qdd", self.n)  # of joints that follow no other
        self.q = self.place(state.take("q", len(tree.coordinates)))  # of all joints
        self.all_qd = self.move(self.qd)
        self.w = state.take("w", tree.open_entries)

    @cached_property
    def _leaders(self) -> dict[str, Coupling]:
        return {self.tree.bodies[x.follower - 1].joint.name: x for x in self.coupled.couplings}

    def place(self, q: Numbers) -> Numbers:
        """Return the coordinates of all joints."""
        free = dict(zip(self.coupled.coordinates, q, strict=True))
        return [self._follow(name, free, is_place=True) for name in self.tree.coordinates]

    def move(self, qd: Numbers) -> Numbers:
        """Return the velocities, or the accelerations, of all joints."""
        free = dict(zip([joint.name for joint in self.coupled.joints], qd, strict=True))
        return [self._follow(body.joint.name, free) for body in self.tree.bodies]

    def select(self, q: Numbers) -> Numbers:
        """Select the independent coordinates from the coordinates of all joints."""
        by_name = dict(zip(self.tree.coordinates, q, strict=True))
        return [by_name[name] for name in self.coupled.coordinates]

    def gather(self, forces: Numbers) -> Numbers:
        """Add the forces of followers to the joints that they follow, by virtual power."""
        felt = {joint.name: ZERO for joint in self.coupled.joints}
        for body, force in zip(self.tree.bodies, forces, strict=True):
            if (coupling := self._leaders.get(body.joint.name)) is None:
                felt[body.joint.name] += force
                continue
            for leader, ratio in coupling.terms:
                felt[self.tree.bodies[leader - 1].joint.name] += force * self._value(ratio)
        return list(felt.values())

    def _follow(self, name: str, free: Mapping[str, Decimal], *, is_place: bool = False) -> Decimal:
        if (coupling := self._leaders.get(name)) is None:
            return free[name]
        leaders = ((self.tree.bodies[leader - 1].joint.name, ratio) for leader, ratio in coupling.terms)
        turned = sum((self._value(ratio) * free[leader] for leader, ratio in leaders), start=ZERO)
        return turned + self._value(coupling.offset) if is_place else turned

    def _value(self, number: Expr, more: Mapping[Symbol, Decimal] = MappingProxyType({})) -> Decimal:
        """Return a number of the tree for the parameters of the state, and the values of further symbols."""
        builder = Builder()
        more = {symbol: more[symbol] for symbol in sorted(number.free_symbols & more.keys(), key=str)}
        own = dict(zip(more, builder.vector("own", len(more)), strict=True)) if more else {}
        given = {
            port: self.state.take(port.name, sum(x.kind is kind for x in self.tree.parameters))
            for port, kind in ((ports.PARAMETERS, Kind.RUNTIME), (ports.DESIGN, Kind.DIFFERENTIATED))
        }
        p, theta = (builder.vector(port, len(values)) if values else [] for port, values in given.items())
        symbols = {**assign_symbols(self.tree, builder, p, theta), **own}
        builder.output_dense("value", [[lower(number, builder, symbols)]])
        inputs = {port.name: values for port, values in given.items() if values} | {"own": list(more.values())}
        (value,) = evaluate(builder.build("value"), inputs, DECIMALS)["value"]
        return Decimal(value)

    @cached_property
    def is_finite(self) -> bool:
        """Return whether the equations have values here: a force law may have none, or a constraint."""
        found = [*self.residual(self.qdd), *self.Q]
        if self.tree.constraints:
            found += [x for column in (self.closures.h, *self.J) for x in column]
        return all(x.is_finite() for x in found)

    @cached_property
    def Q(self) -> Numbers:
        """Return the forces of the joints."""
        return self._evaluate(self.qd, self.qdd)["Q"]

    @cached_property
    def bias(self) -> Numbers:
        """Return Phi(q, qd, 0)."""
        return self.residual([ZERO] * self.n)

    def residual(self, qdd: Numbers, qd: Numbers | None = None) -> Numbers:
        """Return Phi(q, qd, qdd)."""
        return self._evaluate(self.qd if qd is None else qd, qdd)["Phi"]

    def _evaluate(self, qd: Numbers, qdd: Numbers) -> Results:
        moving = {"q": self.q, "qd": self.move(qd), "qdd": self.move(qdd)}
        given = {i.name: moving.get(i.name) or self.state.take(i.name, i.sparsity.nnz) for i in self._equations.inputs}
        return {name: self.gather(forces) for name, forces in evaluate(self._equations, given, DECIMALS).items()}

    @cached_property
    def mechanism(self) -> Mechanism:
        """Return the tree's geometry."""
        return Mechanism(self.tree, write_numbers(self.tree, self.state.parameters))

    @cached_property
    def poses(self) -> list[Pose]:
        """Return the poses of the base and all bodies."""
        return self._motion[0]

    @cached_property
    def speeds(self) -> list[tuple[Vector, Vector]]:
        """Return the velocities of the base and all bodies."""
        return self._motion[1]

    @cached_property
    def _motion(self) -> tuple[list[Pose], list[tuple[Vector, Vector]]]:
        return self.mechanism.speed(self.q, self.all_qd)

    @cached_property
    def closures(self) -> Closures:
        """Return the loops and constraints."""
        return Closures(self.tree, self.mechanism, self.q, self._constrain, self.state.unit)

    def _constrain(self, q: Sequence[Decimal]) -> Numbers:
        """Return the values of the constraints at coordinates of all joints."""
        joints = [coordinate_symbol(body.joint.name) for body in self.tree.bodies]
        return [self._value(x.equation, dict(zip(joints, q, strict=True))) for x in self.tree.constraints]

    @cached_property
    def J(self) -> list[Numbers]:
        """Return the columns of the Jacobian of h, by velocities of joints that follow no other."""
        sizes = self.state.sizes.get(ports.VELOCITIES.name, [Decimal(1)] * self.n)
        moves = [[size * int(i == j) for j in range(self.n)] for i, size in enumerate(sizes)]
        rates = [self.closures.rate(self.move(move)) for move in moves]
        return [[x / size for x in column] for column, size in zip(rates, sizes, strict=True)]

    @property
    def driven(self) -> tuple[int, ...]:
        """List the numbers, from 0, of the driven joints among the joints that follow no other."""
        joints = [joint.name for joint in self.coupled.joints]
        return tuple(joints.index(self.tree.bodies[number - 1].joint.name) for number in self.coupled.driven)

    def hold(self, given: Callable[[Port, int], Numbers]) -> Numbers:
        """Return the joint forces JT lam and tau, of multipliers that are given by their ports and sizes."""
        forces = self.drive(given(ports.DRIVING_FORCES, len(self.driven)))
        if self.coupled.loops or self.coupled.constraints:
            lam = given(ports.MULTIPLIERS, len(self.closures.h))
            forces = [a + dot(column, lam) for a, column in zip(forces, self.J, strict=True)]
        return forces

    def drive(self, tau: Numbers) -> Numbers:
        """Return the joint forces of the driven joints."""
        own = dict(zip(self.driven, tau, strict=True))
        return [own.get(i, ZERO) for i in range(self.n)]

    def extend(self, y: Numbers, right: Numbers) -> Numbers:
        """Return the velocities of which the independent ones are y, and by which h changes as `right`."""
        closure, found = self.coupled.closure, [ZERO] * self.n
        assert closure is not None, "a tree with loops is assembled"
        for i, value in zip(closure.independent, y, strict=True):
            found[i] = value
        rows = [[self.J[i][r] for i in closure.dependent] for r in range(len(right))]
        left = [x - dot([column[r] for column in self.J], found) for r, x in enumerate(right)]
        for i, row in zip(closure.dependent, _invert(rows), strict=True):
            found[i] = dot(row, left)
        return found

    @cached_property
    def Z(self) -> list[Numbers]:
        """Return the velocities of each unit of the independent ones."""
        assert self.coupled.closure is not None, "a tree with loops is assembled"
        f, m = len(self.coupled.closure.independent), len(self.coupled.closure.kept)
        return [self.extend([Decimal(int(i == j)) for j in range(f)], [ZERO] * m) for i in range(f)]

    @cached_property
    def reduced(self) -> Truth:
        """Return the same place, moved by the independent velocities and accelerations that are inputs."""
        found, f = Truth(self.coupled, self._equations, self.state), len(self.Z)
        found.qd = self.extend(self.state.take(ports.INDEPENDENT_VELOCITIES.name, f), [ZERO] * len(self.closures.h))
        found.all_qd = self.move(found.qd)
        found.qdd = found.accelerate(self.state.take(ports.INDEPENDENT_ACCELERATIONS.name, f))
        return found

    def accelerate(self, ydd: Numbers) -> Numbers:
        """Return the accelerations of which the independent ones are ydd, and which keep loops closed."""
        gamma = self.closures.accelerate(self.all_qd, [ZERO] * len(self.all_qd))
        return self.extend(ydd, [-x for x in gamma])

    def at(self, q: Numbers) -> Truth:
        """Return the same state at other coordinates."""
        return Truth(self.coupled, self._equations, replace(self.state, coordinates=tuple(q)))

    def moving_point(self, body: int, r: Vector) -> Vector:
        """Return the velocity of a point fixed in a body."""
        v, OM = self.speeds[body]
        return add(v, cross(OM, apply(self.poses[body].R, r)))

    def carry(self, body: int, place: Vector) -> Vector:
        """Return the velocity at a place of the point of a body that passes it."""
        v, OM = self.speeds[body]
        return add(v, cross(OM, [a - b for a, b in zip(place, self.poses[body].p, strict=True)]))

    def sensor(self, k: int) -> Pose:
        """Place a sensor."""
        pose = self.poses[self.tree.sensors[k].body]
        turn = self.mechanism.matrix(f"turn_{k}")
        return Pose(pose.place(self.mechanism.vector(f"place_{k}")), times(pose.R, turn))

    @cached_property
    def readings(self) -> Mapping[Symbol, Decimal]:
        """Return the numbers of the state that forces may depend on, by symbol."""
        joints = [body.joint.name for body in self.tree.bodies]
        known = dict(zip(map(rate_symbol, joints), self.all_qd, strict=True))
        known |= zip(map(coordinate_symbol, self.tree.coordinates), self.q, strict=True)  # of quaternions: not read
        first = len(self.w) - len(self.tree.signals)
        known |= zip(map(signal_symbol, self.tree.signals), self.w[first:], strict=True)
        for k, probe in enumerate(self.tree.probes):
            known |= zip(probe.symbols, self._probe(probe, self.mechanism.vector(f"probe_{k}")), strict=True)
        for definition in self.tree.definitions:
            known[definition.symbol] = self._value(definition.value, known)
        return known

    def _probe(self, probe: Probe, point: Vector) -> Vector:
        match probe.reading:
            case Reading.POSITION:
                return self.poses[probe.body].place(point)
            case Reading.VELOCITY:
                return self.moving_point(probe.body, point)
            case Reading.DIRECTION:
                return apply(self.poses[probe.body].R, point)
        return self.speeds[probe.body][1]

    def move_ends(self, name: str) -> tuple[Vector, Vector]:
        """Return the velocities of both ends of a force element."""
        first, second = (
            self.moving_point(x.body, self.mechanism.vector(f"probe_{k}"))
            for k, x in enumerate(self.tree.probes)
            if x.symbols[0] in list_end_symbols(name)
        )
        return first, second

    def read(self, components: Sequence[Expr]) -> Vector:
        """Return the components of a force or moment."""
        return [self._value(x, self.readings) for x in components]

    @property
    def moving(self) -> Truth:
        """Return the same place with velocities, where these are 0."""
        if not self.state.is_still:
            return self
        return Truth(self.coupled, self._equations, replace(self.state, is_still=False))

    @cached_property
    def sensor_speeds(self) -> list[tuple[Vector, Vector]]:
        """Return the velocities of all sensors."""
        places = [self.mechanism.vector(f"place_{k}") for k in range(len(self.tree.sensors))]
        return [
            (self.moving_point(s.body, r), self.speeds[s.body][1])
            for s, r in zip(self.tree.sensors, places, strict=True)
        ]

    @cached_property
    def bends(self) -> list[Pose]:
        """Return the second time derivatives of the origins and axes of the base and all bodies."""

        def measure(displacement: Numbers | None) -> Numbers:
            poses = self.mechanism.poses(self.q, displacement)
            return [x for pose in poses for v in (pose.p, *pose.R) for x in v]

        size = self.closures.size
        found = iter(bend(self.tree, measure, self.all_qd, self.move(self.qdd), size))
        vectors = iter(lambda: list(islice(found, 3)), [])
        return [Pose(p, [next(vectors) for _ in range(3)]) for p in vectors]

    def bend_place(self, body: int, r: Vector) -> Vector:
        """Return the acceleration of a point fixed in a body."""
        return self.bends[body].place(r)

    def bend_turn(self, body: int) -> Vector:
        """Return the angular acceleration of a body: the skew part of R'' RT."""
        W = times(self.bends[body].R, transpose(self.poses[body].R))
        return [(W[2][1] - W[1][2]) / 2, (W[0][2] - W[2][0]) / 2, (W[1][0] - W[0][1]) / 2]

    def list_beyond(self, body: int) -> frozenset[int]:
        """Number a body, and all that it carries."""
        found = {body}
        for i in range(body + 1, len(self.tree.bodies) + 1):
            if self.tree.bodies[i - 1].parent in found:
                found.add(i)
        return frozenset(found)

    def list_inertial(self, bodies: frozenset[int]) -> Iterator[tuple[Vector, Vector, Vector]]:
        """Yield the places of masses, what their momentum gains less their weight, and their spin's gain.

        The spin's gain is the sum of r x r'' dm about the centre, with r = R s and P the integral of s sT dm.
        """
        for mass in (x for x in self.mechanism.masses if x.body in bodies):
            R, change = self.poses[mass.body].R, self.bends[mass.body].R
            a = add(self.bend_place(mass.body, mass.com), [-x for x in self.mechanism.gravity])
            half = sum((mass.inertia[k][k] for k in range(3)), ZERO) / 2
            P = [[half * int(r == c) - mass.inertia[r][c] for c in range(3)] for r in range(3)]
            S = times(times(R, P), transpose(change))
            spin = [S[1][2] - S[2][1], S[2][0] - S[0][2], S[0][1] - S[1][0]]
            yield self.poses[mass.body].place(mass.com), [mass.m * x for x in a], spin

    def gain(self, body: int, moments: Sequence[Decimal]) -> tuple[Vector, Vector]:
        """Return what momentum and moment of momentum about its origin a body of given moments gains, less the weight.

        The moment is S x A with a sum of r x r'' dm, where P = tr(J)/2 - J is the integral of s sT dm.
        """
        R, change, axes = self.poses[body].R, self.bends[body].R, self.mechanism.matrix(f"axes_{body}")
        m, S, (xx, xy, xz, yy, yz, zz) = moments[0], apply(axes, list(moments[1:4])), moments[4:]
        J = times(times(axes, [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]), transpose(axes))
        A = add(self.bends[body].p, [-x for x in self.mechanism.gravity])
        P = [[(J[0][0] + J[1][1] + J[2][2]) / 2 * int(r == c) - J[r][c] for c in range(3)] for r in range(3)]
        W = times(times(R, P), transpose(change))
        spin = [W[1][2] - W[2][1], W[2][0] - W[0][2], W[0][1] - W[1][0]]
        return add([m * x for x in A], apply(change, S)), add(cross(apply(R, S), A), spin)

    def list_applied(self, bodies: frozenset[int]) -> Iterator[tuple[Vector, Vector, Vector]]:
        """Yield the places of external wrenches, with the opposites of their forces and moments, in the base frame."""
        for wrench, place, force, moment in self.list_wrenches():
            if wrench.body in bodies:
                yield place, [-x for x in force], [-x for x in moment]

    def list_wrenches(self) -> Iterator[tuple[Wrench, Vector, Vector, Vector]]:
        """Yield each external wrench, its place, force and moment, in the base frame."""
        open_ones = iter(self.w)
        for k, wrench in enumerate(self.tree.wrenches):
            force, moment = (
                self.read(vector) if vector is not None else list(islice(open_ones, 3))
                for vector in (wrench.force, wrench.moment)
            )
            if not wrench.in_base:
                axes = times(self.poses[wrench.body].R, self.mechanism.matrix(f"axes_of_{k}"))
                force, moment = apply(axes, force), apply(axes, moment)
            yield wrench, self.poses[wrench.body].place(self.mechanism.vector(f"point_{k}")), force, moment

    def find(self, owner: str, *keys: str) -> list[Symbol]:
        """Return the definitions of a force element or a contact."""
        own = {x.key: x.symbol for x in self.tree.definitions if x.owner == owner}
        return [own[key] for key in keys]

    @cached_property
    def reach(self) -> Decimal:
        """Bound the lengths of which places are sums, also where they cancel: of bodies, masses, sensors, wrenches."""
        mechanism, points = self.mechanism, [(x.body, x.com) for x in self.mechanism.masses]
        points += [(x.body, mechanism.vector(f"place_{k}")) for k, x in enumerate(self.tree.sensors)]
        points += [(x.body, mechanism.vector(f"point_{k}")) for k, x in enumerate(self.tree.wrenches)]
        places = [self.poses[body].place(r) for body, r in points]
        return max(map(largest, [*(pose.p for pose in self.poses), *(r for _, r in points), *places]))

    @cached_property
    def swing(self) -> Decimal:
        """Bound the velocities of which velocities are sums: the terms of a point on an axis cancel."""
        return max(largest(v) + self.reach * largest(OM) for v, OM in self.speeds)


Expectation = Callable[[Truth, Computation, Results], Iterator[Comparison]]


def _residual(truth: Truth, _: Computation, results: Results) -> Iterator[Comparison]:
    Phi, held = truth.residual(truth.qdd), truth.hold(lambda port, size: truth.state.take(port.name, size))
    scale = max(map(largest, (Phi, truth.Q, truth.bias, held)))
    expected = [a - b - c for a, b, c in zip(Phi, truth.Q, held, strict=True)]
    yield Comparison("Phi", results["Phi"], expected, scale)


def _terms(truth: Truth, _: Computation, results: Results) -> Iterator[Comparison]:
    """Compare M qdd, which holds every entry of M, and c."""
    if "M" in results:
        M, n = results["M"], truth.n
        product = [dot([M[r + n * c] for c in range(n)], truth.qdd) for r in range(n)]
        gain = [a - b for a, b in zip(truth.residual(truth.qdd), truth.bias, strict=True)]
        yield Comparison("M", product, gain)
    if "c" in results:
        yield Comparison("c", results["c"], truth.bias, largest(truth.residual(truth.qdd)))


def _accelerations(truth: Truth, _: Computation, results: Results) -> Iterator[Comparison]:
    """Compare Phi at the computed accelerations with Q and the forces of constraints, which must hold."""
    Phi, held = truth.residual(results["qdd"]), truth.hold(lambda port, size: results.get(port.name, [ZERO] * size))
    inertial = [a - b for a, b in zip(Phi, truth.bias, strict=True)]
    scale = max(map(largest, (inertial, truth.Q, truth.bias, held)))
    yield Comparison("qdd", Phi, [a + b for a, b in zip(truth.Q, held, strict=True)], scale)
    if truth.coupled.loops or truth.coupled.constraints:
        qdd = truth.move(results["qdd"])
        sizes = [largest([x * a for x, a in zip(row, qdd, strict=False)]) for row in truth.J]
        left = truth.closures.accelerate(truth.all_qd, qdd)
        yield Comparison("qdd", left, [ZERO] * len(left), max([*sizes, largest(qdd)]))
    given = truth.state.take(ports.DRIVE.name, len(truth.driven))
    yield Comparison("qdd", [results["qdd"][i] for i in truth.driven], given)


def _closure(truth: Truth, _: Computation, results: Results) -> Iterator[Comparison]:
    """Compare what is left open, relative to lengths of 1."""
    yield Comparison("gap", results["gap"], truth.closures.h, Decimal(1))


def _closure_rate(truth: Truth, _: Computation, results: Results) -> Iterator[Comparison]:
    yield Comparison("hd", results["hd"], truth.closures.rate(truth.all_qd), largest(truth.all_qd))


def _closure_acceleration(truth: Truth, _: Computation, results: Results) -> Iterator[Comparison]:
    """Compare the second derivative of h, with accelerations or, as gamma, without."""
    for name, qdd in (("hdd", truth.qdd), ("gamma", [ZERO] * truth.n)):
        if name in results:
            expected = truth.closures.accelerate(truth.all_qd, truth.move(qdd))
            yield Comparison(name, results[name], expected, largest(truth.all_qd) ** 2 + largest(qdd))


def _closure_jacobian(truth: Truth, tape: Computation, results: Results) -> Iterator[Comparison]:
    """Compare every entry of J, those left out included."""
    output = tape.output("J")
    found = dict(zip(output.sparsity.entries, results["J"], strict=True))
    rows, cols = range(output.sparsity.rows), range(output.sparsity.cols)
    expected = [truth.J[c][r] for c in cols for r in rows]
    yield Comparison("J", [found.get((r, c), ZERO) for c in cols for r in rows], expected, Decimal(1))


def _loop_forces(truth: Truth, _: Computation, results: Results) -> Iterator[Comparison]:
    lam = truth.state.take(ports.MULTIPLIERS.name, len(truth.closures.h))
    yield Comparison("Q", results["Q"], [dot(column, lam) for column in truth.J], largest(lam))


def _project(truth: Truth, forces: Numbers) -> Numbers:
    return [dot(column, forces) for column in truth.Z]


def _reduced_residual(truth: Truth, _: Computation, results: Results) -> Iterator[Comparison]:
    own = truth.reduced
    Phi, held = own.residual(own.qdd), own.drive(own.state.take(ports.DRIVING_FORCES.name, len(own.driven)))
    expected = _project(own, [a - b - c for a, b, c in zip(Phi, own.Q, held, strict=True)])
    yield Comparison("Phi", results["Phi"], expected, _size(own, Phi, own.Q, held))


def _reduced_terms(truth: Truth, _: Computation, results: Results) -> Iterator[Comparison]:
    """Compare M ydd, which holds every entry of M, and c."""
    own, f = truth.reduced, len(truth.Z)
    ydd = own.state.take(ports.INDEPENDENT_ACCELERATIONS.name, f)
    Phi, bias = own.residual(own.qdd), own.residual(own.accelerate([ZERO] * f))
    if "M" in results:
        product = [dot([results["M"][r + f * c] for c in range(f)], ydd) for r in range(f)]
        gain = _project(own, [a - b for a, b in zip(Phi, bias, strict=True)])
        yield Comparison("M", product, gain, _size(own, Phi, bias))
    if "c" in results:
        yield Comparison("c", results["c"], _project(own, bias), _size(own, bias))


def _reduced_accelerations(truth: Truth, _: Computation, results: Results) -> Iterator[Comparison]:
    """Compare the residual at the computed accelerations with the forces, and the driven ones with the inputs."""
    own, ydd = truth.reduced, results["ydd"]
    Phi, held = own.residual(own.accelerate(ydd)), own.drive(results.get("tau", [ZERO] * len(own.driven)))
    forces = _project(own, [a + b for a, b in zip(own.Q, held, strict=True)])
    yield Comparison("ydd", _project(own, Phi), forces, _size(own, Phi, own.Q, held))
    given = own.state.take(ports.DRIVE.name, len(own.driven))
    yield Comparison("ydd", [dot(ydd, [column[i] for column in own.Z]) for i in own.driven], given)


def _size(truth: Truth, *forces: Numbers) -> Decimal:
    """Bound the terms of forces on the independent velocities."""
    return max(map(largest, forces)) * max(map(largest, truth.Z))


def _places(truth: Truth, _: Computation, results: Results) -> Iterator[Comparison]:
    expected = [x for k in range(len(truth.tree.sensors)) for x in truth.sensor(k).p]
    yield Comparison("position", results["position"], expected, truth.reach)


def _distances(truth: Truth, _: Computation, results: Results) -> Iterator[Comparison]:
    yield Comparison("distance", results["distance"], truth.read([x.symbol for x in truth.tree.distances]), Decimal(1))


def _velocities(truth: Truth, _: Computation, results: Results) -> Iterator[Comparison]:
    turning = max(largest(OM) for _, OM in truth.speeds)
    for place, (name, scale) in enumerate((("v", truth.swing), ("omega", turning))):
        if name in results:
            yield Comparison(name, results[name], [x for speed in truth.sensor_speeds for x in speed[place]], scale)


def _accelerations_of_sensors(truth: Truth, _: Computation, results: Results) -> Iterator[Comparison]:
    """Compare with second differences of places and axes."""
    turning = 1 + max(largest(OM) for _, OM in truth.speeds)
    scale = turning**2 * (1 + truth.reach) + largest(truth.qdd) * truth.reach + truth.swing * turning
    places = [truth.mechanism.vector(f"place_{k}") for k in range(len(truth.tree.sensors))]
    found = {
        "acceleration": [truth.bend_place(s.body, r) for s, r in zip(truth.tree.sensors, places, strict=True)],
        "alpha": [truth.bend_turn(s.body) for s in truth.tree.sensors],
    }
    for name in (name for name in found if name in results):
        yield Comparison(name, results[name], [x for v in found[name] for x in v], scale)


def _attitudes(truth: Truth, _: Computation, results: Results) -> Iterator[Comparison]:
    axes = [column for k in range(len(truth.tree.sensors)) for column in transpose(truth.sensor(k).R)]
    yield Comparison("attitude", results["attitude"], [x for column in axes for x in column], Decimal(1))


def _touching(truth: Truth, tape: Computation, results: Results) -> Iterator[Comparison]:
    """Compare distances, normals, and the velocity at each point, from both bodies' velocities; rates of stops."""
    truth = truth.moving
    rigid = [x for _, x in truth.tree.rigid]
    gaps = [x.symbol for x in truth.tree.distances if x.rigid is not None]
    yield Comparison("clearance", results["clearance"], truth.read(gaps), Decimal(1))
    along = (Decimal(1), ZERO, ZERO)  # of stops, which have no normal
    normals = [x for one in rigid for x in (along if isinstance(one, Barrier) else truth.read(one.normal))]
    yield Comparison("direction", results["direction"], normals, Decimal(1))
    found, expected, scale = [ZERO] * (3 * len(rigid)), list[Decimal](), truth.swing
    for (r, c), value in zip(tape.output("slide").sparsity.entries, results["slide"], strict=True):
        found[r] += value * truth.qd[c]
    for contact in rigid:
        if isinstance(contact, Barrier):
            expected += [*truth.read([contact.rate]), ZERO, ZERO]
            scale = max(scale, abs(expected[-3]))
            continue
        place = truth.read(contact.point)
        first, other = (truth.carry(body, place) for body in contact.bodies)
        expected += [a - b for a, b in zip(first, other, strict=True)]
        scale = max(scale, *(largest(OM) * largest(place) for _, OM in truth.speeds))
    yield Comparison("slide", found, expected, scale)


def _meetings(truth: Truth, tape: Computation, results: Results) -> Iterator[Comparison]:
    """Compare poses of solids, and the twist with the velocities of both bodies at the base's origin."""
    truth = truth.moving
    pairs = truth.tree.meetings
    solids = [x for pair in pairs for x in (pair.first, pair.other)]
    yield Comparison("place", results["place"], [x for solid in solids for x in truth.read(solid.place)], truth.reach)
    axes = [x for solid in solids for axis in solid.axes for x in truth.read(axis)]
    yield Comparison("axes", results["axes"], axes, Decimal(1))
    found, expected = [ZERO] * (6 * len(pairs)), list[Decimal]()
    for (r, c), value in zip(tape.output("twist").sparsity.entries, results["twist"], strict=True):
        found[r] += value * truth.qd[c]
    for pair in pairs:
        bodies = pair.first.body, pair.other.body
        for first, other in (
            [truth.carry(body, [ZERO] * 3) for body in bodies],
            [truth.speeds[body][1] for body in bodies],
        ):
            expected += [a - b for a, b in zip(first, other, strict=True)]
    yield Comparison("twist", found, expected, truth.swing)


def _elements(truth: Truth, _: Computation, results: Results) -> Iterator[Comparison]:
    """Compare with the force F on the first end, and with d to the second one."""
    lengths, tensions, rates = [], [], []
    for name in truth.tree.elements:
        known = {x.key: x.symbol for x in truth.tree.definitions if x.owner == name}
        if "tension" in known:  # through further points
            length, rate, tension = truth.read([known[key] for key in ("length", "rate", "tension")])
            lengths.append(length)
            rates.append(rate)
            tensions.append(tension)
            continue
        a, b = truth.move_ends(name)
        d, F = (truth.read(truth.find(name, *(f"{key}.{axis}" for axis in "xyz"))) for key in "dF")
        lengths.append(dot(d, d).sqrt())
        tensions.append(dot(F, d) / lengths[-1])
        rates.append(dot([y - x for x, y in zip(a, b, strict=True)], d) / lengths[-1])
    if "stretch" in results:
        yield Comparison("stretch", results["stretch"], rates, truth.swing)
    for name, expected in (("length", lengths), ("tension", tensions)):
        if name in results:
            yield Comparison(name, results[name], expected, truth.reach)


def _contact_forces(truth: Truth, _: Computation, results: Results) -> Iterator[Comparison]:
    names = [x.name for x in truth.tree.distances]
    found = {"normal": ("N",), "contact_force": ("F.x", "F.y", "F.z")}
    for name, keys in ((name, keys) for name, keys in found.items() if name in results):
        expected = [x for owner in names for x in truth.read(truth.find(owner, *keys))]
        yield Comparison(name, results[name], expected)


def _reactions(truth: Truth, tape: Computation, results: Results) -> Iterator[Comparison]:
    """Compare with the momentum that all beyond a joint gains, less the forces on it; of loops, by virtual power."""
    lam = truth.state.take(ports.MULTIPLIERS.name, len(truth.closures.h)) if _takes(tape, ports.MULTIPLIERS) else []
    forces, moments, size = list[Decimal](), list[Decimal](), ZERO
    for i in range(1, len(truth.tree.bodies) + 1):
        beyond, at = truth.list_beyond(i), truth.poses[i].p
        wrenches = [*truth.list_inertial(beyond), *truth.list_applied(beyond)]
        F, N = [ZERO] * 3, [ZERO] * 3
        for place, force, moment in wrenches:
            arm = add(place, [-x for x in at])
            F, N = add(F, force), add(N, add(moment, cross(arm, force)))
            size = max(size, largest(force), largest(moment), largest(arm) * largest(force))
        if lam:
            loops = [dot(truth.closures.push(i, beyond, way), lam) for way in range(6)]
            F, N, size = add(F, [-x for x in loops[:3]]), add(N, [-x for x in loops[3:]]), max(size, largest(lam))
        forces += F
        moments += N
    for name, expected in (("force", forces), ("moment", moments)):
        if name in results:
            yield Comparison(name, results[name], expected, size)


def _regressor(truth: Truth, tape: Computation, results: Results) -> Iterator[Comparison]:
    """Compare Y pi, of drawn moments pi, with the virtual power of inertia and weight."""
    output = tape.output("Y")
    width, count = len(MOMENTS), len(truth.tree.bodies)
    drawn = draw("moments", width * count, truth.state.number)
    written = {c // width for _, c in output.sparsity.entries}
    drawn = tuple(x if k // width in written else ZERO for k, x in enumerate(drawn))
    found = [ZERO] * truth.n
    for (r, c), value in zip(output.sparsity.entries, results["Y"], strict=True):
        found[r] += value * drawn[c]
    wrenches = [truth.gain(i, drawn[width * (i - 1) : width * i]) for i in range(1, count + 1)]
    expected, size = [], ZERO
    for j in range(truth.n):
        unit = truth.move([Decimal(int(i == j)) for i in range(truth.n)])
        speeds = truth.mechanism.speed(truth.q, unit)[1][1:]
        powers = [dot(F, v) + dot(N, OM) for (F, N), (v, OM) in zip(wrenches, speeds, strict=True)]
        expected.append(sum(powers, ZERO))
        size = max(size, largest(powers))
    yield Comparison("Y", found, expected, size)


def _takes(tape: Computation, port: Port) -> bool:
    return any(i.port == port for i in tape.inputs)


def _jacobian(truth: Truth, tape: Computation, results: Results) -> Iterator[Comparison]:
    """Compare J qd with the velocities, also where functions have no velocities."""
    truth = truth.moving
    found = [ZERO] * (6 * len(truth.tree.sensors))
    for (r, c), value in zip(tape.output("J").sparsity.entries, results["J"], strict=True):
        found[r] += value * truth.qd[c]
    yield Comparison("J", found, [x for v, OM in truth.sensor_speeds for x in (*v, *OM)], truth.swing)


def _frames(truth: Truth, _: Computation, results: Results) -> Iterator[Comparison]:
    bodies = [
        Pose(truth.poses[i].p, times(truth.poses[i].R, truth.mechanism.matrix(f"axes_{i}")))
        for i in range(1, len(truth.tree.bodies) + 1)
    ]
    drawn = [*bodies, *(truth.sensor(k) for k in range(len(truth.tree.sensors)))]
    if "p" in results:
        yield Comparison("p", results["p"], [x for pose in drawn for x in pose.p], truth.reach)
    if "R" in results:
        yield Comparison("R", results["R"], [x for pose in drawn for column in transpose(pose.R) for x in column])


def _rates(truth: Truth, _: Computation, results: Results) -> Iterator[Comparison]:
    """Move along the rates: bodies must have their velocities, and quaternions keep their lengths."""
    ahead, behind = (
        truth.mechanism.poses(
            truth.place([a + h * b for a, b in zip(truth.select(truth.q), results["rate"], strict=True)])
        )
        for h in (STEP, -STEP)
    )
    speeds = [velocity(*three) for three in zip(truth.poses, ahead, behind, strict=True)]
    found, expected = ([x for speed in way for v in speed for x in v] for way in (speeds, truth.speeds))
    yield Comparison("rate", found, expected, truth.swing)
    for x in truth.tree.quaternions:
        first = truth.coupled.coordinates.index(x.coordinates[-4])
        q, rate = truth.select(truth.q)[first : first + 4], results["rate"][first : first + 4]
        yield Comparison("rate", [dot(q, rate)], [ZERO], largest(q) * largest(rate))


def _energy(truth: Truth, _: Computation, results: Results) -> Iterator[Comparison]:
    """Sum over the bodies."""
    zero = [ZERO] * 3
    kinetic, momentum, turning, first, total, size, spins = ZERO, zero, zero, zero, ZERO, ZERO, ZERO
    for mass in truth.mechanism.masses:
        pose, OM = truth.poses[mass.body], truth.speeds[mass.body][1]
        place, v = pose.place(mass.com), truth.moving_point(mass.body, mass.com)
        spin = apply(pose.R, apply(mass.inertia, apply(transpose(pose.R), OM)))
        P = [mass.m * x for x in v]
        kinetic += (dot(P, v) + dot(spin, OM)) / 2
        momentum, turning = add(momentum, P), add(turning, add(spin, cross(place, P)))
        first, total = add(first, [mass.m * x for x in place]), total + mass.m
        size += abs(mass.m) * truth.reach
        spins += largest([largest(row) for row in mass.inertia]) * largest(OM)
    for i, rate in enumerate(truth.all_qd, 1):
        kinetic += truth.mechanism.vector(f"rotor_{i}")[0] * rate * rate / 2
    moving = sum((abs(mass.m) for mass in truth.mechanism.masses), ZERO) * truth.swing
    expected = {
        "kinetic": ([kinetic], ZERO),
        "potential": ([-dot(truth.mechanism.gravity, first)], size * largest(truth.mechanism.gravity)),
        "momentum": (momentum, moving),
        "angular_momentum": (turning, moving * truth.reach + spins),
    }
    if ports.CENTRE_OF_MASS.name in results:
        expected[ports.CENTRE_OF_MASS.name] = ([x / total for x in first], size / abs(total))
    for name in (name for name in expected if name in results):
        yield Comparison(name, results[name], *expected[name])


def _power(truth: Truth, _: Computation, results: Results) -> Iterator[Comparison]:
    """Sum the power of each force."""
    work, size = _work(truth)
    parts = [*(Q * qd for Q, qd in zip(truth.Q, truth.qd, strict=True)), *work]
    yield Comparison("power", results["power"], [sum(parts, ZERO)], max(largest(parts), size))


def _work(truth: Truth) -> tuple[Numbers, Decimal]:
    """Return the power of each external force and moment, and a bound of the products of which they are sums."""
    turning = max(largest(OM) for _, OM in truth.speeds)
    powers, size = [], ZERO
    for k, (wrench, _, force, moment) in enumerate(truth.list_wrenches()):
        powers.append(dot(force, truth.moving_point(wrench.body, truth.mechanism.vector(f"point_{k}"))))
        powers.append(dot(moment, truth.speeds[wrench.body][1]))
        size = max(size, largest(force) * truth.swing, largest(moment) * turning)
    return powers, size


def _condition(truth: Truth, _: Computation, results: Results) -> Iterator[Comparison]:
    """Compare M_ii (M^-1)_ii; `articulated` depends on the plan of EXP2, so it has no reference."""
    if "elimination" in results and truth.n <= LARGEST_INVERSE:
        rest = truth.residual([ZERO] * truth.n)
        units = [[Decimal(int(i == j)) for j in range(truth.n)] for i in range(truth.n)]
        M = [[a - b for a, b in zip(truth.residual(e), rest, strict=True)] for e in units]
        inverse = _invert(M)
        yield Comparison("elimination", results["elimination"], [abs(M[i][i] * inverse[i][i]) for i in range(truth.n)])


def _closed(truth: Truth, _: Computation, results: Results) -> Iterator[Comparison]:
    """Compare the gaps of loops at closed coordinates, relative to lengths of 1, with 0."""
    left = truth.at(results["closed"]).closures.h
    yield Comparison("closed", left, [ZERO] * len(left), Decimal(1))


def _projected(truth: Truth, _: Computation, results: Results) -> Iterator[Comparison]:
    """Compare the rates of the gaps of loops with 0."""
    qd = results["closed_qd"]
    left = truth.at(results["closed"]).closures.rate(truth.move(qd))
    yield Comparison("closed_qd", left, [ZERO] * len(left), largest(qd))


def _closed_velocities(truth: Truth, _: Computation, results: Results) -> Iterator[Comparison]:
    yield Comparison("qd", results["qd"], truth.reduced.qd)


def _closed_accelerations(truth: Truth, _: Computation, results: Results) -> Iterator[Comparison]:
    yield Comparison("qdd", results["qdd"], truth.reduced.qdd)


def _invert(M: list[Numbers]) -> list[Numbers]:
    """Invert a matrix by elimination with partial pivoting."""
    n = len(M)
    rows = [[*row, *(Decimal(int(i == j)) for j in range(n))] for i, row in enumerate(M)]
    for k in range(n):
        best = max(range(k, n), key=lambda i: abs(rows[i][k]))
        rows[k], rows[best] = rows[best], rows[k]
        rows[k] = [x / rows[k][k] for x in rows[k]]
        for i in (i for i in range(n) if i != k):
            rows[i] = [x - rows[i][k] * y for x, y in zip(rows[i], rows[k], strict=True)]
    return [row[n:] for row in rows]


# Of each result that has one, whatever function gives it. A plain dictionary, so that a test may add an entry.
EXPECTATIONS: Mapping[Port, Expectation] = {
    ports.RESIDUAL: _residual,
    ports.MASS_MATRIX: _terms,
    ports.BIAS: _terms,
    ports.ACCELERATIONS: _accelerations,
    ports.CLOSURE: _closure,
    ports.CLOSURE_RATE: _closure_rate,
    ports.CLOSURE_ACCELERATION: _closure_acceleration,
    ports.CLOSURE_BIAS: _closure_acceleration,
    ports.CLOSURE_JACOBIAN: _closure_jacobian,
    ports.JOINT_FORCES: _loop_forces,
    ports.REDUCED_RESIDUAL: _reduced_residual,
    ports.REDUCED_MASS_MATRIX: _reduced_terms,
    ports.REDUCED_BIAS: _reduced_terms,
    ports.INDEPENDENT_ACCELERATIONS: _reduced_accelerations,
    ports.CLOSED: _closed,
    ports.PROJECTED_VELOCITIES: _projected,
    ports.CLOSED_VELOCITIES: _closed_velocities,
    ports.CLOSED_ACCELERATIONS: _closed_accelerations,
    ports.POSITION: _places,
    ports.DISTANCE: _distances,
    ports.CLEARANCE: _touching,
    ports.CONTACT_NORMAL: _touching,
    ports.CONTACT_JACOBIAN: _touching,
    ports.SOLID_PLACES: _meetings,
    ports.SOLID_AXES: _meetings,
    ports.SOLID_TWISTS: _meetings,
    ports.VELOCITY: _velocities,
    ports.ANGULAR_VELOCITY: _velocities,
    ports.ACCELERATION: _accelerations_of_sensors,
    ports.ANGULAR_ACCELERATION: _accelerations_of_sensors,
    ports.ATTITUDE: _attitudes,
    ports.LENGTH: _elements,
    ports.TENSION: _elements,
    ports.STRETCH: _elements,
    ports.NORMAL_FORCE: _contact_forces,
    ports.CONTACT_FORCE: _contact_forces,
    ports.REACTION_FORCE: _reactions,
    ports.REACTION_MOMENT: _reactions,
    ports.REGRESSOR: _regressor,
    ports.SENSOR_JACOBIAN: _jacobian,
    ports.ORIGINS: _frames,
    ports.ROTATIONS: _frames,
    ports.RATES: _rates,
    ports.KINETIC: _energy,
    ports.POTENTIAL: _energy,
    ports.MOMENTUM: _energy,
    ports.ANGULAR_MOMENTUM: _energy,
    ports.CENTRE_OF_MASS: _energy,
    ports.POWER: _power,
    ports.ELIMINATION: _condition,
    ports.ARTICULATED: _condition,
}


def list_expectations(tape: Computation) -> tuple[Expectation, ...]:
    """List the expectations of a function's results, each once."""
    return tuple(dict.fromkeys(EXPECTATIONS[o.port] for o in tape.outputs if o.port in EXPECTATIONS))


def grow_energy(truth: Truth, energy: Callable[[dict[str, Numbers]], Results]) -> Comparison:
    """Compare the growth of `energy`, a function of q and qd, with the power by the textbook's recursion.

    Along qd and qdd, T + V grows by qd . Phi plus the power of wrenches, which Phi does not contain.
    """
    totals = []
    for h in (STEP, -STEP):
        moved = {
            "q": truth.select(_advance(truth, h)),
            "qd": [a + h * b for a, b in zip(truth.qd, truth.qdd, strict=True)],
        }
        results = energy(moved)
        totals.append([results["kinetic"][0] + results["potential"][0]])
    parts = [a * b for a, b in zip(truth.residual(truth.qdd), truth.qd, strict=True)]
    work, size = _work(truth)
    parts += work
    return Comparison("growth", slope(*totals), [sum(parts, ZERO)], max(largest(parts), size))


def _advance(truth: Truth, h: Decimal) -> Numbers:
    """Move all coordinates along the velocities: a quaternion (v, s) by h / 2 (s w + v x w, -v.w), w its velocity."""
    inside, entries = {i: x for x in truth.tree.quaternions for i in x.bodies}, iter(truth.q)
    moved: Numbers = []
    for i in range(1, len(truth.tree.bodies) + 1):
        if i not in inside:
            moved.append(next(entries) + h * truth.all_qd[i - 1])
        elif inside[i].first == i:
            own = [truth.all_qd[k - 1] for k in inside[i].bodies]
            place = [next(entries) for _ in own[:-3]]
            *v, s = (next(entries) for _ in range(4))
            w = own[-3:]
            if place:
                place = add(place, [h * x for x in apply(rotation(v, s), own[:3])])
            turned = add([s * x for x in w], cross(v, w))
            moved += [*place, *(a + h * b / 2 for a, b in zip(v, turned, strict=True)), s - h * dot(v, w) / 2]
    return moved
