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
from mbsgen.formulations.parsimony.mass_matrix import Entries, link
from mbsgen.formulations.parsimony.motion import Kinematics
from mbsgen.formulations.parsimony.regrouping import RegroupedInertia
from mbsgen.formulations.parsimony.residual import Load
from mbsgen.formulations.parsimony.segments import Segment, children
from mbsgen.formulations.parsimony.sensitivities import (
    Composite,
    Force,
    Loads,
    Recursion,
    Sensitivities,
    Step,
    add_to,
    cross_matrix,
    own_moments,
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

    def depart(self, kinematics: Kinematics, segment: Segment, d: Vector[Scalar], v: Vector[Scalar]) -> _Changes:
        """Carry the changes to the body before `segment`, whose origin is at -d and moves by -v, twice, from there."""
        momentum = self.momentum.depart(kinematics, segment, d)
        k_q, k_qd = (kinematics.depart(segment, x) for x in (self.k_q, self.k_qd))
        return _Changes(momentum, k_q + v.cross(momentum.F), k_qd)


class _Recursion(Recursion):
    def __init__(
        self, writing: Writing, qd: Sequence[Scalar], qdd: Sequence[Scalar], multipliers: Sequence[Scalar]
    ) -> None:
        super().__init__(writing, qd, qdd)
        self.curvatures = Curvatures()
        self._multipliers = multipliers
        zero = self.builder.zero
        still = Vector(zero, zero, zero)
        self._turning, self._moving = {0: still}, {0: still}  # om' and v'_O of each body, where it is written
        for segment in self.kinematics.segments:
            self._move(segment)
        self._momenta: dict[int, _Momentum] = {}

    def _move(self, segment: Segment) -> None:
        k, i, before = self.kinematics, segment.number, segment.parent
        rate = segment.signed(self._multipliers[i - 1])
        turning = k.arrive(segment, self._turning[before])
        moving = k.arrive(segment, self._moving[before] + self._turning[before].cross(link(k, segment)))
        if segment.is_revolute:
            turning = turning.along(segment.axis, rate)
        else:
            moving = moving.along(segment.axis, rate)
        self._turning[i], self._moving[i] = turning, moving

    def compose(self, segment: Segment, inertia: RegroupedInertia) -> Composite:
        body = super().compose(segment, inertia)
        k, i, b = self.kinematics, segment.number, self.builder
        axes = k.frames[i].directions
        own = self.own(segment, inertia)
        moving, turning = self._moving[i], self._turning[i]
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

    def differentiate(self, segment: Segment, body: Composite, load: Load) -> None:
        super().differentiate(segment, body, load)
        self._write_gradient(segment, load)
        loads = Loads.of(segment, body, self.axes[segment.number], load)
        changes = self._changes(segment, body)
        for (below, by, through), (_, change, _) in zip(
            self.descend(segment, loads), self.descend(segment, changes), strict=True
        ):
            if through:
                self._add(below, segment, by, change, through)
            else:
                self._write(below, segment, by, change)

    def _twist(self, segment: Segment) -> tuple[Vector[Scalar], Vector[Scalar]]:
        """Return the change of v', in the frame of the body that turns: v'_O x e and om' x e; or slides: om' x e."""
        e, i = self.axes[segment.number].e, segment.number
        turned = self._turning[i].cross(e)
        return (self._moving[i].cross(e), turned) if segment.is_revolute else (turned, turned.scale(self.builder.zero))

    def _write_gradient(self, segment: Segment, load: Load) -> None:
        i, axis, momentum, found = (
            segment.number,
            self.axes[segment.number],
            self._momenta[segment.number],
            self.curvatures,
        )
        v, om = self._twist(segment)
        if segment.is_revolute:
            q = v.dot(load.F) + om.dot(load.N) + axis.turned.dot(momentum.p)
            q = q + axis.acceleration.dot(momentum.h) + axis.rate.dot(momentum.k)
            qd = axis.doubled_rate.dot(momentum.h) + momentum.k[segment.axis]
            qdd = momentum.h[segment.axis]
        else:
            q = v.dot(load.F) + axis.acceleration.dot(momentum.p)
            qd, qdd = axis.doubled_rate.dot(momentum.p), momentum.p[segment.axis]
        for place, value in ((found.q, q), (found.qd, qd), (found.qdd, qdd)):
            place[i] = segment.signed(value)

    def _changes(self, segment: Segment, body: Composite) -> _Changes:
        """Return the changes with a joint, where its body is written."""
        axis, momentum = self.axes[segment.number], self._momenta[segment.number]
        v, om = self._twist(segment)
        e, rate = axis.e, axis.doubled_rate
        if not segment.is_revolute:
            change = Force(v.scale(body.m), body.S.cross(v) + e.cross(momentum.p))
            return _Changes(change, body.p.cross(v) + rate.cross(momentum.p), e.cross(momentum.p).scale(self.two))
        h = e.cross(momentum.h) + body.S.cross(v) + body.J.apply(om)
        change = Force(e.cross(momentum.p) + v.scale(body.m) + om.cross(body.S), h)
        L = momentum.L.transposed
        k_q = e.cross(momentum.k) - L.apply(rate) + body.p.cross(v) + body.L.transposed.apply(om)
        return _Changes(change, k_q, -L.column(segment.axis).scale(self.two))

    def _write(self, below: Segment, segment: Segment, by: Loads, change: _Changes) -> None:
        axis, momentum = self.axes[below.number], change.momentum
        v, om = self._twist(below)
        if below.is_revolute:
            q_q = v.dot(by.q.F) + om.dot(by.q.N) + axis.turned.dot(momentum.F)
            q_q = q_q + axis.acceleration.dot(momentum.N) + axis.rate.dot(change.k_q)
            q_qd = v.dot(by.qd.F) + om.dot(by.qd.N) + axis.rate.dot(change.k_qd)
            qd_q = axis.doubled_rate.dot(momentum.N) + change.k_q[below.axis]
            qd_qd = change.k_qd[below.axis]
            q_qdd, qdd_q = v.dot(by.qdd.F) + om.dot(by.qdd.N), momentum.N[below.axis]
        else:
            q_q = v.dot(by.q.F) + axis.acceleration.dot(momentum.F)
            q_qd, qd_q, qd_qd = v.dot(by.qd.F), axis.doubled_rate.dot(momentum.F), self.builder.zero
            q_qdd, qdd_q = v.dot(by.qdd.F), momentum.F[below.axis]
        found, place, same = self.curvatures, (below.number, segment.number), below.sense == segment.sense
        for entries, value in ((found.q_q, q_q), (found.q_qd, q_qd), (found.qd_qd, qd_qd), (found.q_qdd, q_qdd)):
            entries[place] = value if same else -value
        if below is not segment:
            for entries, value in ((found.q_qd, qd_q), (found.q_qdd, qdd_q)):
                entries[place[::-1]] = value if same else -value

    def _add(self, below: Segment, segment: Segment, by: Loads, change: _Changes, through: Step) -> None:
        """Write the entries of an axis that is parallel to the one before."""
        found, p = self.curvatures, change.momentum.F
        v = self._turning[below.number].cross(through.change)
        a = self.movements[below.number].field(through.change)
        turning = self.doubled_velocity(below).cross(through.change)
        add_to(found.q_q, through, below, segment, v.dot(by.q.F) + a.dot(p))
        add_to(found.q_qd, through, below, segment, v.dot(by.qd.F))
        add_to(found.q_qdd, through, below, segment, v.dot(by.qdd.F))
        add_to(found.qd_qd, through, below, segment, self.builder.zero)
        add_to(found.q_qd, through, below, segment, turning.dot(p), by_column=True)
        add_to(found.q_qdd, through, below, segment, through.change.dot(p), by_column=True)
