"""Sensitivities of the residual: dPhi/dq, dPhi/dqd and dPhi/dqdd by one recursion over composite bodies.

When joint j turns by dq, a point r beyond it moves by (e x r) dq, with r from the joint's origin. In the frame of the
body that turned, the accelerations of the points change by

    by q: a x e + e'' x r + 2 e' x v,    by qd: 2 e' x r + 2 e x v,    by qdd: e x r

with the axis e, its derivatives e' = om x e and e'' = U e as a direction of the body before the joint, the acceleration
a of the origin, and the velocity v of the point relative to the origin. For a prismatic joint: e'', 2 e' and e.

So each joint i needs three loads on the bodies beyond it, taken as one body with its momentum. They are carried down to
the base and give the entries (j, i) of ancestors j. The entries (i, j) use the third load alone, with the motion of the
axis of j, and one carried vector K. Between parallel axes of a group, an entry changes by U (e x d).

After Echeandia, Wensing (2021) and Singh, Russell, Wensing (2022), in the frames and regrouped masses of this folder.
Velocities are stored doubled, as they are used only so.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol, Self, TypeVar

from mbsgen.algebra.vectors import Matrix, Vector, outer
from mbsgen.formulations.parsimony.mass_matrix import Entries, link, list_path, own_inertia, shift_inertia
from mbsgen.formulations.parsimony.motion import Kinematics, Movement
from mbsgen.formulations.parsimony.regrouping import RegroupedInertia
from mbsgen.formulations.parsimony.residual import Load, join_loads
from mbsgen.formulations.parsimony.segments import Segment, children, unit_vector
from mbsgen.formulations.parsimony.writing import Writing
from mbsgen.tape.builder import Builder, Scalar


@dataclass(frozen=True)
class Sensitivities:
    """The residual, and the nonzero entries (row, column) of its derivatives, by body numbers from 1."""

    Phi: dict[int, Scalar]
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


@dataclass(frozen=True)
class Axis:
    """A joint's axis, where its body is written, and its motion with the body before the joint."""

    e: Vector[Scalar]
    doubled_rate: Vector[Scalar]  # 2 e'
    rate: Vector[Scalar]  # e'
    acceleration: Vector[Scalar]  # e''
    turned: Vector[Scalar]  # a x e


@dataclass(frozen=True)
class Force:
    """A force with its moment about the origin of the body that it is written at."""

    F: Vector[Scalar]
    N: Vector[Scalar]

    def depart(self, kinematics: Kinematics, segment: Segment, d: Vector[Scalar]) -> Force:
        """Refer the force to the origin of the body before `segment`, which is at d from there, and write it there."""
        F = kinematics.depart(segment, self.F)
        return Force(F, kinematics.depart(segment, self.N) + d.cross(F))


@dataclass(frozen=True)
class Step:
    """A step down between parallel axes: turning about `at`'s axis or the one before it differs by the translation
    `change`.
    """

    at: Segment
    change: Vector[Scalar]  # e x d


class Carried(Protocol):
    """Quantities that are carried down to the base."""

    def depart(self, kinematics: Kinematics, segment: Segment, d: Vector[Scalar], v: Vector[Scalar]) -> Self:
        """Carry them to the body before `segment`, whose origin is at -d and moves by -v, twice, from there."""


L = TypeVar("L", bound=Carried)


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
        self.composites: dict[int, Composite] = {}
        self.found = Sensitivities({}, {}, {}, {})

    def run(self) -> Sensitivities:
        loads: dict[int, Load] = {}
        for segment in reversed(self.kinematics.segments):
            i = segment.number
            loads[i] = join_loads(self.kinematics, segment, self.inertias[i], self.movements[i], loads, passes=False)
            self.composites[i] = self.compose(segment, self.inertias[i])
            self.found.Phi[i] = segment.signed((loads[i].N if segment.is_revolute else loads[i].F)[segment.axis])
            self.differentiate(segment, self.composites[i], loads[i])
        return self.found

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

    def compose(self, segment: Segment, inertia: RegroupedInertia) -> Composite:
        """Add the composites of its children to a body."""
        k, i = self.kinematics, segment.number
        beyond = [c.number for c in children(k.segments, i)]
        parts = (*(self.composites[c] for c in beyond), *(k.frames[c] for c in beyond))
        return self.builder.remember(
            ("sensitive composite", *(self.qd[c - 1].ref for c in beyond)),
            (segment, inertia, self.movements[i], k.frames[i], *parts),
            lambda: self._compose(segment, inertia),
        )

    def _compose(self, segment: Segment, inertia: RegroupedInertia) -> Composite:
        k, own = self.kinematics, self.own(segment, inertia)
        m, S, J, p, L = own.m, own.S, own.J, own.p, own.L
        for child in children(k.segments, segment.number):
            carried, d = self.composites[child.number], link(k, child)
            v, s, weight = self.doubled_departure(child, d), k.depart(child, carried.S), d.scale(carried.m)
            momentum = k.depart(child, carried.p)
            J = shift_inertia(k.depart_tensor(child, carried.J), d, s, weight) + J
            L = L + k.depart_tensor(child, carried.L) + turned_outer(v, s + weight) + turned_outer(momentum, d)
            p, S, m = p + momentum + v.scale(carried.m), S + s + weight, m + carried.m
        return Composite(m, S, J, p, L)

    # -- loads, and what joints feel of them --------------------------------------------------------------------

    def differentiate(self, segment: Segment, body: Composite, load: Load) -> None:
        """Write the column of a joint in the rows of its ancestors, and its row in their columns."""
        path = list_path(self.kinematics, segment)
        parts = (group[i] for i in path for group in (self.axes, self.movements, self.kinematics.frames))
        found = self.builder.remember(
            ("differentiate", *(self.qd[i - 1].ref for i in path)),
            (segment, body, load, *parts),
            lambda: self._differentiate(segment, body, load),
        )
        for entries, more in ((self.found.q, found.q), (self.found.qd, found.qd), (self.found.qdd, found.qdd)):
            entries |= more

    def _differentiate(self, segment: Segment, body: Composite, load: Load) -> Sensitivities:
        found = Sensitivities({}, {}, {}, {})
        for below, by, through in self.descend(segment, Loads.of(segment, body, self.axes[segment.number], load)):
            _write_column(found, below, segment, by)
            if below is not segment:
                self._write_row(found, below, segment, by, through)
        return found

    def descend(self, segment: Segment, by: L) -> Iterator[tuple[Segment, L, Step | None]]:
        """Carry loads from a body down to the base; also yield the last step, if it was between parallel axes."""
        yield segment, by, None
        at = segment
        while at.parent:
            d = link(self.kinematics, at)
            by = by.depart(self.kinematics, at, d, self.doubled_departure(at, d))
            below = self.kinematics.segments[at.parent - 1]
            yield below, by, None if at.opens_group else Step(at, self.axes[below.number].e.cross(d))
            at = below

    def _write_row(self, found: Sensitivities, column: Segment, row: Segment, by: Loads, through: Step | None) -> None:
        """Write the entries of a row in the column of an ancestor."""
        axis, first, same = self.axes[column.number], by.qdd, row.sense == column.sense
        if through:
            field = self.movements[column.number].field(through.change)
            turning = self.doubled_velocity(column).cross(through.change)
            for entries, more in ((found.q, field.dot(first.F)), (found.qd, turning.dot(first.F))):
                add_to(entries, through, column, row, more, by_column=True)
            return
        if column.is_revolute:
            q = axis.turned.dot(first.F) + axis.acceleration.dot(first.N) + axis.rate.dot(by.K)
            qd = axis.doubled_rate.dot(first.N) + by.K[column.axis]
        else:
            q, qd = axis.acceleration.dot(first.F), axis.doubled_rate.dot(first.F)
        found.q[row.number, column.number] = q if same else -q
        found.qd[row.number, column.number] = qd if same else -qd


def _write_column(found: Sensitivities, row: Segment, column: Segment, by: Loads) -> None:
    place, same = (row.number, column.number), row.sense == column.sense
    for entries, load in ((found.q, by.q), (found.qd, by.qd), (found.qdd, by.qdd)):
        felt = (load.N if row.is_revolute else load.F)[row.axis]
        entries[place] = felt if same else -felt
    found.qdd[column.number, row.number] = found.qdd[place]


def add_to(
    entries: Entries, through: Step, below: Segment, segment: Segment, more: Scalar, *, by_column: bool = False
) -> None:
    """Write the entry of `below` and `segment`: the entry of the parallel axis before, plus `more`."""
    place, before = (below.number, segment.number), (through.at.number, segment.number)
    if by_column:
        place, before = place[::-1], before[::-1]
    known = entries[before] if through.at.sense == below.sense else -entries[before]
    entries[place] = known + (more if below.sense == segment.sense else -more)


@dataclass(frozen=True)
class Loads:
    """The loads on all bodies beyond a joint for a unit of its coordinate, rate and acceleration; and K.

    e.K is the moment of 2 e x v about the joint: K = integral of 2 v x (e x r) dm.
    """

    q: Force
    qd: Force
    qdd: Force
    K: Vector[Scalar]

    @staticmethod
    def of(segment: Segment, body: Composite, axis: Axis, load: Load) -> Loads:
        """Form the loads where the joint's body is written."""
        e, S, p = axis.e, body.S, body.p
        if not segment.is_revolute:
            m, rate, acceleration = body.m, axis.doubled_rate, axis.acceleration
            q = Force(acceleration.scale(m), S.cross(acceleration) + e.cross(load.F))
            return Loads(q, Force(rate.scale(m), S.cross(rate)), Force(e.scale(m), S.cross(e)), p.cross(e))
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

    def depart(self, kinematics: Kinematics, segment: Segment, d: Vector[Scalar], v: Vector[Scalar]) -> Loads:
        """Carry the loads to the body before `segment`, whose origin is at -d and moves by -v, twice, from there."""
        q, qd, qdd = (x.depart(kinematics, segment, d) for x in (self.q, self.qd, self.qdd))
        return Loads(q, qd, qdd, kinematics.depart(segment, self.K) + v.cross(qdd.F))


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
