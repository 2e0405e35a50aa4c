"""Sensitivities of the residual: dPhi/dq, dPhi/dqd and dPhi/dqdd by one recursion over composite bodies.

Each joint i needs three loads on the bodies beyond it, taken as one body with its momentum: for a unit of its
coordinate, rate and acceleration (the motion changes as in `variations`). The entries (j, i) of ancestors j are the
power of these loads by the motion of the axis of j. The entries (i, j) are the power of the third load, and of one more
vector K, by the variations of j.

Loads are carried down to the base, joint by joint. Where the plan says so, they are *met* by the variations of the
joints before, which are carried up: to the body, or displacements to the body and others to the place before its joint.
Between parallel axes of a group, an entry changes by the power of a displacement. Where the plan says so, a column is
the column of the joint that continues the group, and the entries of a displacement, whose loads alone are carried.

After Echeandia, Wensing (2021) and Singh, Russell, Wensing (2022), in the frames and regrouped masses of this folder.
Velocities are stored doubled, as they are used only so.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from operator import add
from typing import Generic, Protocol, Self, TypeVar

from mbsgen.algebra.vectors import Matrix, Vector, outer
from mbsgen.formulations.parsimony.mass_matrix import (
    Entries,
    Motion,
    is_met,
    link,
    list_path,
    own_inertia,
    shift_inertia,
)
from mbsgen.formulations.parsimony.motion import Kinematics, Movement
from mbsgen.formulations.parsimony.plan import Meeting
from mbsgen.formulations.parsimony.regrouping import RegroupedInertia
from mbsgen.formulations.parsimony.residual import Direction, Force, Load, directions_of, join_loads
from mbsgen.formulations.parsimony.segments import Segment, children, unit_vector
from mbsgen.formulations.parsimony.variations import Axis, Displacement, Variation
from mbsgen.formulations.parsimony.writing import Writing
from mbsgen.tape.builder import Builder, Scalar


@dataclass(frozen=True)
class Sensitivities:
    """The residual, and the nonzero entries (row, column) of its derivatives, by body numbers from 1."""

    Phi: dict[int, Scalar]
    weight: dict[int, Scalar]  # Phi at rest
    q: Entries
    qd: Entries
    qdd: Entries  # the mass matrix


@dataclass(frozen=True)
class Composite:
    """A body with all bodies beyond it, about its origin, where it is written; with twice the velocities v relative to
    it.
    """

    m: Scalar
    S: Vector[Scalar]
    J: Matrix[Scalar]
    p: Vector[Scalar]  # integral of 2 v dm
    L: Matrix[Scalar]  # integral of (2 v.r) 1 - 2 v rT dm

    def __add__(self, other: Composite) -> Composite:
        return Composite(self.m + other.m, self.S + other.S, self.J + other.J, self.p + other.p, self.L + other.L)


@dataclass(frozen=True)
class Composed:
    """A body with all bodies beyond it; without the bodies that continue its group; and these, by the child."""

    whole: Composite
    alone: Composite
    grouped: Mapping[int, Composite]  # about the origin of the body


class Carried(Protocol):
    """Quantities that are carried down to the base."""

    def turn(self, kinematics: Kinematics, segment: Segment) -> Self:
        """Write them where the parent of `segment` is written."""

    def shift(self, d: Vector[Scalar], v: Vector[Scalar]) -> Self:
        """Refer them to a point at -d that moves by -v, twice, from the origin."""


L = TypeVar("L", bound=Carried)


@dataclass(frozen=True)
class Encounter(Generic[L]):
    """Quantities that are carried down from a joint, and the variation of a joint before it, in one frame."""

    joint: Segment
    carried: L
    variation: Variation
    after: Segment | None  # the joint that continues the group: then the variation is the difference from this one's


def sensitivities(writing: Writing, qd: Sequence[Scalar], qdd: Sequence[Scalar]) -> Sensitivities:
    """Differentiate Phi(q, qd, qdd) of the bodies, without actuators, force laws, rotors and external wrenches."""
    return Recursion(writing, qd, qdd).run()


class Recursion:
    def __init__(self, writing: Writing, qd: Sequence[Scalar], qdd: Sequence[Scalar]) -> None:
        self.kinematics, self.inertias, self.qd = writing.kinematics, writing.inertias, qd
        self.builder = writing.chain.builder
        self.two = self.builder.number(2.0)
        self.movements = self.kinematics.move(writing.chain.gravity, qd, qdd)
        self.axes = {s.number: self._find_axis(s, self.movements[s.number]) for s in self.kinematics.segments}
        self.composed: dict[int, Composed] = {}
        self.loads: dict[int, Load] = {}
        self.by: dict[int, Loads] = {}
        self.columns: dict[int, Column] = {}
        still = Vector(self.builder.zero, self.builder.zero, self.builder.zero)
        self.others = {s.number: Motion(still, still) for s in self.kinematics.segments}  # other velocities: none
        self.found = Sensitivities({}, {}, {}, {}, {})

    def run(self) -> Sensitivities:
        for segment in reversed(self.kinematics.segments):
            i = segment.number
            self.loads[i] = self._join_loads(segment, grouped=True)
            self.composed[i] = self.compose(segment, self.inertias[i])
            self.found.Phi[i] = segment.signed(
                (self.loads[i].N if segment.is_revolute else self.loads[i].F)[segment.axis]
            )
            self.by[i] = self._load(segment)
            self.differentiate(segment)
        return self.found

    def _join_loads(self, segment: Segment, *, grouped: bool) -> Load:
        i = segment.number
        return join_loads(
            self.kinematics, segment, self.inertias[i], self.movements[i], self.loads, passes=False, grouped=grouped
        )

    # -- the state of bodies ------------------------------------------------------------------------------------

    def _find_axis(self, segment: Segment, movement: Movement) -> Axis:
        return self.builder.remember(("axis",), (segment, movement), lambda: self._axis(segment, movement))

    def _axis(self, segment: Segment, movement: Movement) -> Axis:
        e = unit_vector(self.builder, segment.axis)
        rate = self.kinematics.angular_velocity(segment, movement).cross(e)
        return Axis(e, rate.scale(self.two), rate, movement.A, movement.a0.cross(e))

    def doubled_velocity(self, segment: Segment) -> Vector[Scalar]:
        """Return 2 om, where the body is written."""
        return self.kinematics.angular_velocity(segment, self.movements[segment.number]).scale(self.two)

    def doubled_departure(self, child: Segment, d: Vector[Scalar]) -> Vector[Scalar]:
        """Return twice the velocity of a child's origin relative to its parent's, where the parent is written."""
        parent = self.kinematics.segments[child.parent - 1]
        v = self.doubled_velocity(parent).cross(d)
        if child.is_revolute:
            return v
        return v + axis_before(self.kinematics, child).scale(self.two * child.signed(self.qd[child.number - 1]))

    def own(self, segment: Segment, inertia: RegroupedInertia) -> Composite:
        """Return the composite of a body alone."""
        om, axes = self.doubled_velocity(segment), self.kinematics.frames[segment.number].directions
        S = self.kinematics.fixed(segment.number, inertia.S)
        P = own_moments(self.builder, segment, inertia, axes)
        J = own_inertia(self.builder, segment, inertia, axes)
        return Composite(inertia.m, S, J, om.cross(S), -cross_matrix(om).times(P))

    def compose(self, segment: Segment, inertia: RegroupedInertia) -> Composed:
        """Add the composites of its children to a body."""
        k, i = self.kinematics, segment.number
        beyond = [c.number for c in children(k.segments, i)]
        parts = (*(self.composed[c] for c in beyond), *(k.frames[c] for c in beyond))
        return self.builder.remember(
            ("sensitive composite", *(self.qd[c - 1].ref for c in beyond)),
            (segment, inertia, self.movements[i], k.frames[i], *parts),
            lambda: self._compose(segment, inertia),
        )

    def _compose(self, segment: Segment, inertia: RegroupedInertia) -> Composed:
        alone, beyond = self.own(segment, inertia), children(self.kinematics.segments, segment.number)
        alone = reduce(add, (self._carry(c) for c in beyond if c.opens_group), alone)
        grouped = {c.number: self._carry(c) for c in beyond if not c.opens_group}
        return Composed(reduce(add, grouped.values(), alone), alone, grouped)

    def _carry(self, child: Segment) -> Composite:
        """Refer a body with all bodies beyond it to the origin of its parent."""
        k, body, d = self.kinematics, self.composed[child.number].whole, link(self.kinematics, child)
        v, s, weight = self.doubled_departure(child, d), k.depart(child, body.S), d.scale(body.m)
        momentum = k.depart(child, body.p)
        J = shift_inertia(k.depart_tensor(child, body.J), d, s, weight)
        L = k.depart_tensor(child, body.L) + turned_outer(v, s + weight) + turned_outer(momentum, d)
        return Composite(body.m, s + weight, J, momentum + v.scale(body.m), L)

    # -- loads, and what joints feel of them --------------------------------------------------------------------

    def _load(self, segment: Segment) -> Loads:
        """Form the loads for a joint.

        Where a child continues its group, it turns the bodies beyond as the child's joint does, and displaces them.
        """
        k, body = self.kinematics, self.composed[segment.number]
        parts = (x[c] for c in body.grouped for x in (self.loads, self.by, k.frames))
        own = self._load_alone(segment)

        def write() -> Loads:
            return reduce(add, (self._load_grouped(k.segments[c - 1]) for c in body.grouped), own)

        return self.builder.remember(("loads by",), (segment, own, body, self.movements[segment.number], *parts), write)

    def _load_grouped(self, child: Segment) -> Loads:
        """Form the loads on the bodies of a child that continues the group."""
        d = link(self.kinematics, child)
        turned = self.by[child.number].turn(self.kinematics, child).shift(d, self.doubled_departure(child, d))
        return turned + self._load_displaced(child)

    def _load_displaced(self, child: Segment) -> Loads:
        """Form the loads on the bodies of a child that continues the group, for the displacement by its parent."""
        k, parent = self.kinematics, self.kinematics.segments[child.parent - 1]
        change = self.displace(parent, self.axes[parent.number].e.cross(link(k, child)))
        body, F = self.composed[parent.number].grouped[child.number], self.loads[child.number].F
        return Loads.displacing(body, change, k.depart(child, F))

    def _load_apart(self, segment: Segment) -> Loads:
        """Form the loads for a joint without the turns of bodies that continue its group."""
        k, body = self.kinematics, self.composed[segment.number]
        parts = (x[c] for c in body.grouped for x in (self.loads, k.frames))
        own = self._load_alone(segment)

        def write() -> Loads:
            return reduce(add, (self._load_displaced(k.segments[c - 1]) for c in body.grouped), own)

        return self.builder.remember(
            ("loads apart",), (segment, own, body, self.movements[segment.number], *parts), write
        )

    def _load_alone(self, segment: Segment) -> Loads:
        """Form the loads on a body and all beyond it that does not continue its group."""
        k, i = self.kinematics, segment.number
        body, axis, load = self.composed[i].alone, self.axes[i], self._join_loads(segment, grouped=False)
        by_moments = k.plan[i].by_moments and is_alone(k.segments, segment)

        def write() -> Loads:
            loads = Loads.of(segment, body, axis, load)
            return replace(loads, q=self._turn_moments(segment)) if by_moments else loads

        key = ("loads alone", k.plan[i].scaled, k.plan.by_runtime, by_moments)
        return self.builder.remember(key, (segment, self.inertias[i], body, load, self.movements[i], axis), write)

    def _turn_moments(self, segment: Segment) -> Force:
        """Form the load that a turn of a body alone adds, by its moments S' = e x S and P' = e x P - P x e.

        The field of accelerations does not turn, and the spin inertia stays as it is.
        """
        k, i = self.kinematics, segment.number
        inertia, movement, e = self.inertias[i], self.movements[i], self.axes[i].e
        directions = directions_of(k, segment, inertia, movement)
        turned = [Direction(e.cross(x.e), x.length, movement.field(e.cross(x.e))) for x in directions]
        before, after = weigh(inertia, directions, movement.a0), weigh(inertia, turned, e.scale(self.builder.zero))
        N = reduce(
            add, (t.e.cross(v) + x.e.cross(y) for t, v, x, y in zip(turned, before, directions, after, strict=True))
        )
        if inertia.radius is not None:
            return Force(after[inertia.direction], N)
        return Force(reduce(add, (x.Ue.scale(x.share(s)) for x, s in zip(turned, inertia.S, strict=True))), N)

    def differentiate(self, segment: Segment) -> None:
        """Write the column of a joint in the rows of its ancestors, and its row in their columns."""
        i, path = segment.number, list_path(self.kinematics, segment)
        by, found = self.select(segment), self.found
        parts = (group[j] for j in path for group in (self.axes, self.movements, self.kinematics.frames))
        own = self.builder.remember(
            ("differentiate", *(self.qd[j - 1].ref for j in path), *(self.kinematics.plan[j].meeting for j in path)),
            (segment, by, *parts),
            lambda: self._differentiate(segment, by),
        )
        column = self.columns[i] = reduce(add, (self.columns[c].of_parent for c in self.continue_apart(segment)), own)
        column.write(segment, (found.q, found.qd, found.qdd), (found.q, found.qd))
        found.weight[i] = segment.signed(column.weight)
        for j in path:
            found.qdd[i, j] = found.qdd[j, i]

    def continue_apart(self, segment: Segment) -> Sequence[int]:
        """List the bodies that continue a joint's group, where its column starts from theirs."""
        return [*self.composed[segment.number].grouped] if self.kinematics.plan[segment.number].by_columns else []

    def select(self, segment: Segment) -> Loads:
        """Return the loads that the joints before meet."""
        return self._load_apart(segment) if self.continue_apart(segment) else self.by[segment.number]

    def _differentiate(self, segment: Segment, by: Loads) -> Column:
        felt = tuple(Felt.of(met, segment) for met in self.descend(segment, by))
        *_, (at, carried) = self._lower(segment, by)
        gravity = self.kinematics.arrive_from_base(at, self.movements[0].a0)
        return Column(felt, gravity.dot(carried.qdd.F))

    def _lower(self, segment: Segment, carried: L) -> Iterator[tuple[Segment, L]]:
        """Carry quantities from body to body towards the base, as far as they pass; yield them at each body."""
        at, k = segment, self.kinematics
        yield at, carried
        while at.parent and not is_met(k, at):
            d = link(k, at)
            carried = carried.turn(k, at).shift(d, self.doubled_departure(at, d))
            at = k.segments[at.parent - 1]
            yield at, carried

    def descend(self, segment: Segment, carried: L) -> Iterator[Encounter[L]]:
        """Carry quantities down towards the base, to meet the variations of a body's joint and of all joints before."""
        k, child = self.kinematics, None
        for at, by in self._lower(segment, carried):
            variation = self._vary_before(at, child) if child else self.vary(at)
            yield Encounter(at, by, variation, child if child and not child.opens_group else None)
            child, carried = at, by
        if child and is_met(k, child):
            before = carried.turn(k, child)
            for number in list_path(k, child)[1:]:
                yield self._meet(k.segments[number - 1], child, carried, before)

    def _meet(self, joint: Segment, at: Segment, beyond: L, before: L) -> Encounter[L]:
        """Carry a joint's variation up to a body, or to where its parent is written."""
        k, path = self.kinematics, list_path(self.kinematics, at)
        after = k.segments[path[path.index(joint.number) - 1] - 1]
        variation = self._bring(joint, at)
        meeting, carried = k.plan[at.number].meeting, before
        if meeting is Meeting.BEYOND or variation.is_displacement:
            carried, variation = beyond, variation.arrive(k, at)
        return Encounter(joint, carried, variation, None if after.opens_group else after)

    def _bring(self, joint: Segment, at: Segment) -> Variation:
        """Form a joint's variation at the origin of a body beyond, where its parent is written."""
        parent = self.kinematics.segments[at.parent - 1]
        if parent is joint:
            far = self._vary_before(joint, at)
        else:
            far = self._bring(joint, parent).arrive(self.kinematics, parent)
        d = link(self.kinematics, at)
        return far.shift(d, self.doubled_departure(at, d))

    def vary(self, joint: Segment) -> Variation:
        """Form the variation of a joint's own body."""
        return Variation.of(self.axes[joint.number], joint, self.others[joint.number])

    def displace(self, joint: Segment, change: Vector[Scalar]) -> Displacement:
        """Form the displacement of the bodies beyond a joint by a vector across its axis that turns with its body."""
        movement, om = self.movements[joint.number], self.doubled_velocity(joint)
        return Displacement(movement.field(change), om.cross(change), change, om[joint.axis])

    def _vary_before(self, joint: Segment, child: Segment) -> Variation:
        """Form the variation of a joint, or its difference from the one of a child that continues its group."""
        if child.opens_group:
            return self.vary(joint)
        change = self.displace(joint, self.axes[joint.number].e.cross(link(self.kinematics, child)))
        return Variation.displace(change, self.others[joint.number])


@dataclass(frozen=True)
class Felt:
    """The entries of a joint and one before it, along the positive axes: for parallel axes, their differences from the
    entries of the axis after it.
    """

    met: Encounter[Loads]
    column: tuple[Scalar, ...]  # of the joint, in each block; of sensitivities, by q, qd and qdd
    row: tuple[Scalar, ...]  # likewise, by q and qd of the joint before; none for the joint itself

    @staticmethod
    def of(met: Encounter[Loads], segment: Segment) -> Felt:
        """Form the entries of a joint where its loads meet the variation of one before."""
        by, variation = met.carried, met.variation
        column = tuple(variation.qdd.work(load) for load in (by.q, by.qd, by.qdd))
        if met.joint is segment:
            return Felt(met, column, ())
        q = variation.q.work(by.qdd) + variation.rate.dot(by.K)
        return Felt(met, column, (q, variation.qd.work(by.qdd) + variation.e.dot(by.K)))

    def __add__(self, other: Felt) -> Felt:
        return Felt(self.met, tuple(map(add, self.column, other.column)), tuple(map(add, self.row, other.row)))


@dataclass(frozen=True)
class Column:
    """The entries of a joint: with itself, and with the joints before it, one by one; and its force at rest."""

    felt: tuple[Felt, ...]
    weight: Scalar

    def __add__(self, other: Column) -> Column:
        return Column(tuple(map(add, self.felt, other.felt)), self.weight + other.weight)

    @property
    def of_parent(self) -> Column:
        """The same column as the parent feels it, where the joint continues its group: from the parent on."""
        own, first, *others = self.felt
        return Column((Felt(first.met, tuple(map(add, own.column, first.column)), ()), *others), self.weight)

    def write(self, segment: Segment, columns: Sequence[Entries], rows: Sequence[Entries]) -> None:
        """Write the entries: the joint's column of some blocks, and its row of others."""
        for felt in self.felt:
            for entries, value in zip(columns, felt.column, strict=True):
                add_entry(entries, felt.met, segment, value)
            for entries, value in zip(rows, felt.row, strict=False):
                add_entry(entries, felt.met, segment, value, by_column=True)


def add_entry(entries: Entries, met: Encounter[L], segment: Segment, value: Scalar, *, by_column: bool = False) -> None:
    """Write the entry of a joint before `segment`: `value`, for parallel axes with the entry of the axis after it."""
    place, total = (met.joint.number, segment.number), value if met.joint.sense == segment.sense else -value
    if met.after:
        before = (met.after.number, segment.number)
        known = entries[before[::-1] if by_column else before]
        total = (known if met.after.sense == met.joint.sense else -known) + total
    entries[place[::-1] if by_column else place] = total


@dataclass(slots=True, unsafe_hash=True)  # as if frozen: many are made
class Loads:
    """The loads on all bodies beyond a joint for a unit of its coordinate, rate and acceleration; and K.

    e.K is the moment of 2 e x v about the joint: K = integral of 2 v x (e x r) dm.
    """

    q: Force
    qd: Force
    qdd: Force
    K: Vector[Scalar]

    @staticmethod
    def of(segment: Segment, body: Composite, axis: Axis, load: Force) -> Loads:
        """Form the loads where the joint's body is written, for a joint that moves a body under a load."""
        if not segment.is_revolute:
            return Loads.displacing(body, Displacement(axis.acceleration, axis.doubled_rate, axis.e), load.F)
        e, S, p = axis.e, body.S, body.p
        K = body.L.rows[segment.axis]
        qdd = Force(e.cross(S), body.J.column(segment.axis))
        qd = Force(
            axis.doubled_rate.cross(S) + e.cross(p), body.J.apply(axis.doubled_rate) + body.L.column(segment.axis)
        )
        q = Force(
            e.cross(load.F) + axis.turned.scale(body.m) + axis.acceleration.cross(S) + axis.rate.cross(p),
            e.cross(load.N) + S.cross(axis.turned) + body.J.apply(axis.acceleration) + body.L.apply(axis.rate),
        )
        return Loads(q, qd, qdd, K)

    @staticmethod
    def displacing(body: Composite, by: Displacement, F: Vector[Scalar]) -> Loads:
        """Form the loads for a displacement of a body that the force F accelerates."""
        q, qd, qdd = (Force(x.scale(body.m), body.S.cross(x)) for x in (by.q, by.qd, by.qdd))
        return Loads(Force(q.F, q.N + by.qdd.cross(F)), qd, qdd, body.p.cross(by.qdd))

    def __add__(self, other: Loads) -> Loads:
        return Loads(self.q + other.q, self.qd + other.qd, self.qdd + other.qdd, self.K + other.K)

    def turn(self, kinematics: Kinematics, segment: Segment) -> Loads:
        """Write the loads where the parent of `segment` is written."""
        q, qd, qdd = (turn_force(kinematics, segment, x) for x in (self.q, self.qd, self.qdd))
        return Loads(q, qd, qdd, kinematics.depart(segment, self.K))

    def shift(self, d: Vector[Scalar], v: Vector[Scalar]) -> Loads:
        """Refer the loads to a point at -d that moves by -v, twice, from the origin."""
        q, qd, qdd = (shift_force(x, d) for x in (self.q, self.qd, self.qdd))
        return Loads(q, qd, qdd, self.K + v.cross(qdd.F))


def turn_force(kinematics: Kinematics, segment: Segment, force: Force) -> Force:
    """Write a force where the parent of `segment` is written."""
    return Force(kinematics.depart(segment, force.F), kinematics.depart(segment, force.N))


def shift_force(force: Force, d: Vector[Scalar]) -> Force:
    """Refer a force to a point at -d from the origin."""
    return Force(force.F, force.N + d.cross(force.F))


def is_alone(segments: Sequence[Segment], segment: Segment) -> bool:
    """Return whether a revolute joint turns a body, and no bodies beyond it about other axes."""
    return segment.is_revolute and not any(c.opens_group for c in children(segments, segment.number))


def weigh(inertia: RegroupedInertia, directions: Sequence[Direction], a: Vector[Scalar]) -> list[Vector[Scalar]]:
    """Form what a body's moments weigh in each direction, s a + sum p U e, without its spin; see `residual`."""
    if inertia.radius is not None:
        F = (a + directions[inertia.direction].Ue).scale(inertia.m)
        return [F if t == inertia.direction else F.scale(a.x.builder.zero) for t in range(3)]
    V = []
    for t, one in enumerate(directions):
        parts = (x.Ue.scale(x.share(one.share(inertia.P[t, u]))) for u, x in enumerate(directions))
        V.append(reduce(add, parts, a.scale(one.share(inertia.S[t]))))
    return V


def axis_before(kinematics: Kinematics, child: Segment) -> Vector[Scalar]:
    """Return a joint's axis, where its parent is written."""
    e = child.turn.column(child.axis) if child.turn else unit_vector(kinematics.builder, child.axis)
    return kinematics.fixed(child.parent, e)


def cross_matrix(v: Vector[Scalar]) -> Matrix[Scalar]:
    """Return the matrix of v x."""
    zero = v.x.builder.zero
    return Matrix.of([[zero, -v.z, v.y], [v.z, zero, -v.x], [-v.y, v.x, zero]])


def turned_outer(a: Vector[Scalar], b: Vector[Scalar]) -> Matrix[Scalar]:
    """Form (a.b) 1 - a bT."""

    def entry(r: int, c: int) -> Scalar:
        if r != c:
            return -(a[r] * b[c])
        j, k = (r + 1) % 3, (r + 2) % 3
        return a[j] * b[j] + a[k] * b[k]

    return Matrix.of([entry(r, c) for c in range(3)] for r in range(3))


def own_moments(
    builder: Builder, segment: Segment, inertia: RegroupedInertia, axes: Sequence[Vector[Scalar]]
) -> Matrix[Scalar]:
    """Write a body's own second moments where the body is written; its spin inertia is the same at all angles."""
    along = builder.zero - inertia.half_spin
    total = Matrix.of(
        [(along if r == segment.axis else inertia.half_spin) if r == c else builder.zero for c in range(3)]
        for r in range(3)
    )
    for t, a in enumerate(axes):
        for u, e in enumerate(axes):
            if not inertia.P[t, u].is_zero:
                total = total + outer(a, e).scale(inertia.P[t, u])
    return total
