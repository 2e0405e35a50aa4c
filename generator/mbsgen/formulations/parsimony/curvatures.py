"""Curvatures of the residual: the first and second derivatives of lambdaT Phi by one recursion over composite bodies.

With lambda as rates of the joints, lambdaT Phi is the power of the accelerated mass at the velocities v' that lambda
makes: the integral of v'.a dm. The bodies beyond joint j enter its derivatives by force and moment (F, N), by momentum
(p, h) at v', and by k, the integral of 2 v x v' dm. Each is multiplied by the motion of the axis of j (see
`sensitivities`; v'_O x e and om' x e are the change of v', in the frame of the body that turned):

    by q_j: (v'_O x e).F + (om' x e).N + (a x e).p + e''.h + e'.k,    by qd_j: 2 e'.h + e.k,    by qdd_j: e.h.

The motion of that axis does not depend on the joints beyond. So the second derivatives need only the changes of these
few quantities with each joint beyond; the changes are carried down to the base as the loads of `sensitivities` are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import reduce
from operator import add

from mbsgen.algebra.vectors import Matrix, Vector
from mbsgen.formulations.parsimony.mass_matrix import Entries, Motion, link
from mbsgen.formulations.parsimony.motion import Kinematics
from mbsgen.formulations.parsimony.regrouping import RegroupedInertia
from mbsgen.formulations.parsimony.residual import Force, Load
from mbsgen.formulations.parsimony.segments import Segment, children, unit_vector
from mbsgen.formulations.parsimony.sensitivities import (
    Column,
    Composed,
    Composite,
    Encounter,
    Felt,
    Loads,
    Recursion,
    Sensitivities,
    cross_matrix,
    own_moments,
    shift_force,
    turn_force,
    turned_outer,
)
from mbsgen.formulations.parsimony.variations import Displacement
from mbsgen.formulations.parsimony.writing import Writing
from mbsgen.tape.builder import Scalar


@dataclass(frozen=True)
class Curvatures:
    """Derivatives of lambdaT Phi; entries by body numbers from 1, of symmetric blocks (ancestor, descendant) only."""

    q: dict[int, Scalar] = field(default_factory=dict)
    qd: dict[int, Scalar] = field(default_factory=dict)
    qdd: dict[int, Scalar] = field(default_factory=dict)
    q_q: Entries = field(default_factory=dict)  # symmetric
    q_qd: Entries = field(default_factory=dict)  # (by q, by qd)
    qd_qd: Entries = field(default_factory=dict)  # symmetric
    q_qdd: Entries = field(default_factory=dict)  # (by q, by qdd)


def curvatures(
    writing: Writing, qd: Sequence[Scalar], qdd: Sequence[Scalar], multipliers: Sequence[Scalar]
) -> tuple[Sensitivities, Curvatures]:
    """Differentiate Phi once and lambdaT Phi twice, without actuators, force laws, rotors and external wrenches."""
    recursion = _Recursion(writing, qd, qdd, multipliers)
    return recursion.run(), recursion.curvatures


@dataclass(frozen=True)
class _Momentum:
    """A body with all beyond it, about its origin, where it is written, at the velocities v'."""

    p: Vector[Scalar]  # integral of v' dm
    h: Vector[Scalar]  # integral of r x v' dm
    L: Matrix[Scalar]  # integral of (v'.r) 1 - v' rT dm
    k: Vector[Scalar]  # integral of 2 v x v' dm

    def __add__(self, other: _Momentum) -> _Momentum:
        return _Momentum(self.p + other.p, self.h + other.h, self.L + other.L, self.k + other.k)


@dataclass(frozen=True)
class _Changes:
    """How momentum and k change with a joint: with its coordinate; k also with its rate."""

    momentum: Force  # p, and h
    k_q: Vector[Scalar]
    k_qd: Vector[Scalar]

    @staticmethod
    def displacing(body: Composite, p: Vector[Scalar], by: Displacement, v: Vector[Scalar]) -> _Changes:
        """Form the changes by a displacement of a body with the momentum p, which changes its velocities v' by v."""
        momentum = Force(v.scale(body.m), body.S.cross(v) + by.qdd.cross(p))
        doubled = by.qdd.cross(p).scale(p.x.builder.number(2.0))
        return _Changes(momentum, body.p.cross(v) + by.qd.cross(p), doubled)

    def __add__(self, other: _Changes) -> _Changes:
        return _Changes(self.momentum + other.momentum, self.k_q + other.k_q, self.k_qd + other.k_qd)

    def turn(self, kinematics: Kinematics, segment: Segment) -> _Changes:
        """Write the changes where the parent of `segment` is written."""
        k_q, k_qd = (kinematics.depart(segment, x) for x in (self.k_q, self.k_qd))
        return _Changes(turn_force(kinematics, segment, self.momentum), k_q, k_qd)

    def shift(self, d: Vector[Scalar], v: Vector[Scalar]) -> _Changes:
        """Refer the changes to a point at -d that moves by -v, twice, from the origin."""
        return _Changes(shift_force(self.momentum, d), self.k_q + v.cross(self.momentum.F), self.k_qd)


class _Recursion(Recursion):
    def __init__(
        self, writing: Writing, qd: Sequence[Scalar], qdd: Sequence[Scalar], multipliers: Sequence[Scalar]
    ) -> None:
        super().__init__(writing, qd, qdd)
        self.curvatures = Curvatures()
        for segment in self.kinematics.segments:
            self.others[segment.number] = self._move(segment, multipliers[segment.number - 1])
        self._momenta: dict[int, _Momentum] = {}
        self._alone: dict[int, _Momentum] = {}  # without bodies that continue the group
        self._changed: dict[int, _Changes] = {}
        self._columns: dict[int, Column] = {}

    def _move(self, segment: Segment, rate: Scalar) -> Motion:
        """Form v'_O and om' of a body, where it is written."""
        k, along = self.kinematics, unit_vector(self.builder, segment.axis).scale(segment.signed(rate))
        still = along.map(lambda x: x.builder.zero)
        own = Motion(still, along) if segment.is_revolute else Motion(along, still)
        if not segment.parent:
            return own
        return self.others[segment.parent].shift(link(k, segment)).arrive(k, segment) + own

    def compose(self, segment: Segment, inertia: RegroupedInertia) -> Composed:
        body, i = super().compose(segment, inertia), segment.number
        beyond = children(self.kinematics.segments, i)
        own = self._own_momentum(segment, inertia)
        self._alone[i] = reduce(add, (self._carry_momentum(c) for c in beyond if c.opens_group), own)
        self._momenta[i] = reduce(add, (self._carry_momentum(c) for c in beyond if not c.opens_group), self._alone[i])
        return body

    def _own_momentum(self, segment: Segment, inertia: RegroupedInertia) -> _Momentum:
        """Return the momentum of a body alone."""
        moving, turning = self.others[segment.number].a, self.others[segment.number].OMp
        own, axes = self.own(segment, inertia), self.kinematics.frames[segment.number].directions
        P = own_moments(self.builder, segment, inertia, axes)
        p, h = moving.scale(own.m) + turning.cross(own.S), own.S.cross(moving) + own.J.apply(turning)
        L = turned_outer(moving, own.S) - cross_matrix(turning).times(P)
        return _Momentum(p, h, L, own.p.cross(moving) + own.L.transposed.apply(turning))

    def _carry_momentum(self, child: Segment) -> _Momentum:
        """Refer the momentum of a body with all beyond it to the origin of its parent."""
        k, carried, d = self.kinematics, self._momenta[child.number], link(self.kinematics, child)
        p = k.depart(child, carried.p)
        h, L = k.depart(child, carried.h) + d.cross(p), k.depart_tensor(child, carried.L) + turned_outer(p, d)
        return _Momentum(p, h, L, k.depart(child, carried.k) + self.doubled_departure(child, d).cross(p))

    def differentiate(self, segment: Segment) -> None:
        super().differentiate(segment)
        i, continuing = segment.number, self.continue_apart(segment)
        self._write_gradient(segment, self.loads[i])
        self._changed[i] = self._changes(segment)
        changes = self._change_apart(segment) if continuing else self._changed[i]
        loads = self.descend(segment, self.select(segment))
        met = zip(loads, self.descend(segment, changes), strict=True)
        own = Column(tuple(_feel(by, change.carried, segment) for by, change in met), self.builder.zero)
        self._columns[i] = reduce(add, (self._columns[c].of_parent for c in continuing), own)
        found = self.curvatures
        columns, rows = (found.q_q, found.q_qd, found.qd_qd, found.q_qdd), (found.q_qd, found.q_qdd)
        self._columns[i].write(segment, columns, rows)

    def _write_gradient(self, segment: Segment, load: Load) -> None:
        i, found, momentum, by = segment.number, self.curvatures, self._momenta[segment.number], self.vary(segment)
        felt = Force(momentum.p, momentum.h)
        q = by.twist.work(load) + by.q.work(felt) + by.rate.dot(momentum.k)
        qd = by.qd.work(felt) + by.e.dot(momentum.k)
        for place, value in ((found.q, q), (found.qd, qd), (found.qdd, by.qdd.work(felt))):
            place[i] = segment.signed(value)

    def _changes(self, segment: Segment) -> _Changes:
        """Return the changes with a joint, where its body is written; in a group, by the changes of the next joint."""
        grouped = (self.kinematics.segments[c - 1] for c in self.composed[segment.number].grouped)
        return reduce(add, (self._change_grouped(segment, child) for child in grouped), self._change_alone(segment))

    def _change_grouped(self, segment: Segment, child: Segment) -> _Changes:
        """Return the changes of the bodies of a child that continues the group."""
        k, d = self.kinematics, link(self.kinematics, child)
        turned = self._changed[child.number].turn(k, child).shift(d, self.doubled_departure(child, d))
        return turned + self._change_displaced(segment, child)

    def _change_apart(self, segment: Segment) -> _Changes:
        """Return the changes without the turns of bodies that continue the group."""
        grouped = (self.kinematics.segments[c - 1] for c in self.composed[segment.number].grouped)
        return reduce(add, (self._change_displaced(segment, child) for child in grouped), self._change_alone(segment))

    def _change_displaced(self, segment: Segment, child: Segment) -> _Changes:
        """Return the changes by the displacement of a child that continues the group."""
        k = self.kinematics
        change = self.displace(segment, self.axes[segment.number].e.cross(link(k, child)))
        body, p = self.composed[segment.number].grouped[child.number], self._momenta[child.number].p
        v = self.others[segment.number].OMp.cross(change.qdd)
        return _Changes.displacing(body, k.depart(child, p), change, v)

    def _change_alone(self, segment: Segment) -> _Changes:
        """Return the changes of a body and all beyond it that does not continue its group."""
        body, momentum = self.composed[segment.number].alone, self._alone[segment.number]
        axis, twist = self.axes[segment.number], self.vary(segment).twist
        v, om, e = twist.a, twist.OMp, axis.e
        if not segment.is_revolute:
            by = Displacement(axis.acceleration, axis.doubled_rate, e)
            return _Changes.displacing(body, momentum.p, by, v)
        h = e.cross(momentum.h) + body.S.cross(v) + body.J.apply(om)
        change = Force(e.cross(momentum.p) + v.scale(body.m) + om.cross(body.S), h)
        L = momentum.L.transposed
        k_q = e.cross(momentum.k) - L.apply(axis.doubled_rate) + body.p.cross(v) + body.L.transposed.apply(om)
        return _Changes(change, k_q, -L.column(segment.axis).scale(self.two))


def _feel(met: Encounter[Loads], change: _Changes, segment: Segment) -> Felt:
    """Form the entries of a joint and one before it."""
    by, variation, momentum = met.carried, met.variation, change.momentum
    twist, rate, e = variation.twist, variation.rate, variation.e
    q_q = twist.work(by.q) + variation.q.work(momentum) + rate.dot(change.k_q)
    q_qd, q_qdd = twist.work(by.qd) + rate.dot(change.k_qd), twist.work(by.qdd)
    column = q_q, q_qd, e.dot(change.k_qd), q_qdd
    if met.joint is segment:
        return Felt(met, column, ())
    return Felt(met, column, (variation.qd.work(momentum) + e.dot(change.k_q), variation.qdd.work(momentum)))
