"""Variations: the changes of a body's motion with a joint before it, where this body is written.

When joint j turns by dq, a point r beyond it moves by (e x r) dq, with r from the joint's origin. In the frame of the
body that turned, the accelerations of the points change by

    by q: a x e + e'' x r + 2 e' x v,    by qd: 2 e' x r + 2 e x v,    by qdd: e x r

with the axis e, its derivatives e' = om x e and e'' = U e as a direction of the body before the joint, the acceleration
a of the origin, and the velocity v of the point relative to the origin. For a prismatic joint: e'', 2 e' and e.

Each is the motion of a body's origin, the turning of this body, and a turning of the velocities relative to the origin.
From a body to the origin of the next one, at d with the relative velocity v, the first grows by the other two; then all
are turned into its frame. Between parallel axes of a group, they change by the displacement e x d, which turns nothing:

    by q: U (e x d),    by qd: 2 om x (e x d),    by qdd: e x d

Other velocities v' of all points, as of `curvatures`, change by q likewise: by v'_O x e + (om' x e) x r.
Velocities are stored doubled, as they are used only so.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from mbsgen.algebra.vectors import Vector
from mbsgen.formulations.parsimony.mass_matrix import Motion
from mbsgen.formulations.parsimony.motion import Kinematics, by_axis
from mbsgen.formulations.parsimony.segments import Segment
from mbsgen.tape.builder import Scalar


@dataclass(frozen=True)
class Axis:
    """A joint's axis, where its body is written, and its motion with the body before the joint."""

    e: Vector[Scalar]
    doubled_rate: Vector[Scalar]  # 2 e'
    rate: Vector[Scalar]  # e'
    acceleration: Vector[Scalar]  # e''
    turned: Vector[Scalar]  # a x e


@dataclass(frozen=True)
class Displacement:
    """The changes of the accelerations of all points by a displacement, its rate and its acceleration."""

    q: Vector[Scalar]
    qd: Vector[Scalar]
    qdd: Vector[Scalar]  # the displacement itself
    spin: Scalar | None = None  # across the axis of a group: twice the angular velocity w along it


@dataclass(slots=True, unsafe_hash=True)  # as if frozen: many are made
class Variation:
    """The changes of a body's accelerations with a joint's coordinate, rate and acceleration.

    The velocities relative to its origin turn too: by q with the rate e', by qd with the axis e.
    """

    q: Motion
    qd: Motion
    qdd: Motion
    rate: Vector[Scalar]  # e'
    twist: Motion  # of other velocities
    spin: Scalar | None = None  # of a displacement across the axis of the group that it is in: 2 w

    @staticmethod
    def of(axis: Axis, segment: Segment, other: Motion) -> Variation:
        """Form the variation of a joint's own body, with its other velocities."""
        e, still = axis.e, axis.e.map(lambda x: x.builder.zero)
        if not segment.is_revolute:
            return Variation.displace(Displacement(axis.acceleration, axis.doubled_rate, e), other)
        q, qd, qdd = Motion(axis.turned, axis.acceleration), Motion(still, axis.doubled_rate), Motion(still, e)
        return Variation(q, qd, qdd, axis.rate, Motion(other.a.cross(e), other.OMp.cross(e)))

    @staticmethod
    def displace(by: Displacement, other: Motion) -> Variation:
        """Form the variation of a displacement, which turns nothing; it turns with other velocities."""
        still = by.q.map(lambda x: x.builder.zero)
        q, qd, qdd = (Motion(x, still) for x in (by.q, by.qd, by.qdd))
        return Variation(q, qd, qdd, still, Motion(other.OMp.cross(by.qdd), still), by.spin)

    @property
    def e(self) -> Vector[Scalar]:
        """The axis of turning."""
        return self.qdd.OMp

    @property
    def is_displacement(self) -> bool:
        """Return whether nothing turns."""
        return self.qdd.is_lever

    def shift(self, d: Vector[Scalar], v: Vector[Scalar]) -> Variation:
        """Refer the variation to a point at d from the origin, which moves by v, twice, from there."""
        q, qd, qdd = (x.shift(d) for x in (self.q, self.qd, self.qdd))
        q, qd = Motion(q.a + self.rate.cross(v), q.OMp), Motion(qd.a + self.e.cross(v), qd.OMp)
        return replace(self, q=q, qd=qd, qdd=qdd, twist=self.twist.shift(d))

    def arrive(self, kinematics: Kinematics, segment: Segment) -> Variation:
        """Take a variation from where the parent is written to where `segment` is."""
        q, qdd, twist = (x.arrive(kinematics, segment) for x in (self.q, self.qdd, self.twist))
        rate = kinematics.arrive(segment, self.rate)
        if self.spin is None or segment.opens_group:
            return Variation(q, self.qd.arrive(kinematics, segment), qdd, rate, twist)
        return Variation(q, self._turn_rate(segment, qdd.a, self.spin), qdd, rate, twist, self.spin)

    def _turn_rate(self, segment: Segment, change: Vector[Scalar], spin: Scalar) -> Motion:
        """Form 2 om x (e x d) of the turned displacement: its component along the axis stays."""
        (j, k), along = segment.across, self.qd.a[segment.axis]
        return Motion(by_axis(segment, along, -(spin * change[k]), spin * change[j]), self.qd.OMp)
