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

from mbsgen.algebra.vectors import Matrix, Vector
from mbsgen.formulations.parsimony.mass_matrix import Entries, Motion, link
from mbsgen.formulations.parsimony.motion import Kinematics
from mbsgen.formulations.parsimony.regrouping import RegroupedInertia
from mbsgen.formulations.parsimony.residual import Force, Load
from mbsgen.formulations.parsimony.segments import Segment, children, unit_vector
from mbsgen.formulations.parsimony.sensitivities import (
    Composed,
    Composite,
    Encounter,
    Loads,
    Recursion,
    Sensitivities,
    add_entry,
    cross_matrix,
    own_moments,
    shift_force,
    turn_force,
    turned_outer,
)
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


@dataclass(frozen=True)
class _Changes:
    """How momentum and k change with a joint: with its coordinate; k also with its rate."""

    momentum: Force  # p, and h
    k_q: Vector[Scalar]
    k_qd: Vector[Scalar]

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

    def _move(self, segment: Segment, rate: Scalar) -> Motion:
        """Form v'_O and om' of a body, where it is written."""
        k, along = self.kinematics, unit_vector(self.builder, segment.axis).scale(segment.signed(rate))
        still = along.map(lambda x: x.builder.zero)
        own = Motion(still, along) if segment.is_revolute else Motion(along, still)
        if not segment.parent:
            return own
        return self.others[segment.parent].shift(link(k, segment)).arrive(k, segment) + own

    def compose(self, segment: Segment, inertia: RegroupedInertia) -> Composed:
        body = super().compose(segment, inertia)
        k, i, b = self.kinematics, segment.number, self.builder
        axes = k.frames[i].directions
        own = self.own(segment, inertia)
        moving, turning = self.others[i].a, self.others[i].OMp
        P = own_moments(b, segment, inertia, axes)
        p, h = moving.scale(own.m) + turning.cross(own.S), own.S.cross(moving) + own.J.apply(turning)
        L = turned_outer(moving, own.S) - cross_matrix(turning).times(P)
        twisted = own.p.cross(moving) + own.L.transposed.apply(turning)
        for child in children(k.segments, i):
            carried, d = self._momenta[child.number], link(k, child)
            momentum = k.depart(child, carried.p)
            h = h + k.depart(child, carried.h) + d.cross(momentum)
            L = L + k.depart_tensor(child, carried.L) + turned_outer(momentum, d)
            twisted = twisted + k.depart(child, carried.k) + self.doubled_departure(child, d).cross(momentum)
            p = p + momentum
        self._momenta[i] = _Momentum(p, h, L, twisted)
        return body

    def differentiate(self, segment: Segment) -> None:
        super().differentiate(segment)
        self._write_gradient(segment, self.loads[segment.number])
        changes = self.descend(segment, self._changes(segment, self.composed[segment.number].whole))
        for met, change in zip(self.descend(segment, self.by[segment.number]), changes, strict=True):
            self._write(segment, met, change.carried)

    def _write_gradient(self, segment: Segment, load: Load) -> None:
        i, found, momentum, by = segment.number, self.curvatures, self._momenta[segment.number], self.vary(segment)
        felt = Force(momentum.p, momentum.h)
        q = by.twist.work(load) + by.q.work(felt) + by.rate.dot(momentum.k)
        qd = by.qd.work(felt) + by.e.dot(momentum.k)
        for place, value in ((found.q, q), (found.qd, qd), (found.qdd, by.qdd.work(felt))):
            place[i] = segment.signed(value)

    def _changes(self, segment: Segment, body: Composite) -> _Changes:
        """Return the changes with a joint, where its body is written."""
        axis, momentum = self.axes[segment.number], self._momenta[segment.number]
        twist = self.vary(segment).twist
        v, om, e, rate = twist.a, twist.OMp, axis.e, axis.doubled_rate
        if not segment.is_revolute:
            change = Force(v.scale(body.m), body.S.cross(v) + e.cross(momentum.p))
            return _Changes(change, body.p.cross(v) + rate.cross(momentum.p), e.cross(momentum.p).scale(self.two))
        h = e.cross(momentum.h) + body.S.cross(v) + body.J.apply(om)
        change = Force(e.cross(momentum.p) + v.scale(body.m) + om.cross(body.S), h)
        L = momentum.L.transposed
        k_q = e.cross(momentum.k) - L.apply(rate) + body.p.cross(v) + body.L.transposed.apply(om)
        return _Changes(change, k_q, -L.column(segment.axis).scale(self.two))

    def _write(self, segment: Segment, met: Encounter[Loads], change: _Changes) -> None:
        """Write the entries of a joint and one before it."""
        by, variation, found, momentum = met.carried, met.variation, self.curvatures, change.momentum
        twist, rate, e = variation.twist, variation.rate, variation.e
        q_q = twist.work(by.q) + variation.q.work(momentum) + rate.dot(change.k_q)
        q_qd, q_qdd = twist.work(by.qd) + rate.dot(change.k_qd), twist.work(by.qdd)
        for entries, value in (
            (found.q_q, q_q),
            (found.q_qd, q_qd),
            (found.qd_qd, e.dot(change.k_qd)),
            (found.q_qdd, q_qdd),
        ):
            add_entry(entries, met, segment, value)
        if met.joint is not segment:
            qd_q, qdd_q = variation.qd.work(momentum) + e.dot(change.k_q), variation.qdd.work(momentum)
            add_entry(found.q_qd, met, segment, qd_q, by_column=True)
            add_entry(found.q_qdd, met, segment, qdd_q, by_column=True)
