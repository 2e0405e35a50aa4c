"""A point mass behind two joints: its inertia along the last axis, in series with a rotor about the axis before.

The point's acceleration along its joint's axis is f.(a, OMp), with f fixed by the lever: the joint does not change it.
So m f fT is a part of the articulated inertia, and may be kept as such. At the next joint let the rest of the inertia
be J about the axis e, and be free of e otherwise, as where two axes at right angles meet in a point. With f = f' + g e,

    D / m = J / m + g2,    IA - K UT = rest + l f' f'T,    l = J m / D,

so mass and rotor are in series: nothing is subtracted, and without a rotor the joint leaves no inertia in this
direction. The bias load is a tension T along f, T = m c for the acceleration c of the bias motion. With the force u
that the joint has left without it, and the increment a',

    T' = (J c + g u) m / D,    e.a' = (u / m - g (c + f'.a')) m / D.
"""

from __future__ import annotations

from dataclasses import dataclass

from mbsgen.algebra.vectors import Matrix, Vector, outer
from mbsgen.formulations.parsimony.mass_matrix import Inertia, Motion
from mbsgen.formulations.parsimony.motion import Kinematics, Movement
from mbsgen.formulations.parsimony.regrouping import RegroupedInertia
from mbsgen.formulations.parsimony.residual import Load, directions_of
from mbsgen.formulations.parsimony.segments import Segment, unit_vector
from mbsgen.tape.builder import Scalar


@dataclass(frozen=True)
class Line:
    """The inertia m f fT of a point in one direction."""

    m: Scalar
    f: Motion

    @property
    def inertia(self) -> Inertia:
        """The same as matrices."""
        a, n = self.f.a, self.f.OMp
        return Inertia(outer(a.scale(self.m), a), outer(a.scale(self.m), n), outer(n.scale(self.m), n))


@dataclass(frozen=True)
class Series:
    """A joint that feels its own rotor J and, by g, the line of a point."""

    point: int  # the number of the body that is the point
    line: Line
    J: Scalar
    g: Scalar
    pivot: Scalar  # D
    share: Scalar  # m / D
    left: Line  # l f' f'T

    def tighten(self, c: Scalar, u: Scalar) -> Load:
        """Form the load of the tension with the joint free."""
        tension = (self.J * c + self.g * u) * self.share
        N = self.left.f.OMp.scale(tension)
        return Load(self.left.f.a.scale(tension), N, N)

    def accelerate(self, c: Scalar, u: Scalar, a: Vector[Scalar], OMp: Vector[Scalar]) -> Scalar:
        """Form the joint's increment along its axis."""
        f, one = self.left.f, self.J.builder.number(1.0)
        felt = c + f.a.dot(a) + f.OMp.dot(OMp)
        return (u * (one / self.line.m) - self.g * felt) * self.share


def split(
    kinematics: Kinematics, segment: Segment, inertia: RegroupedInertia, own: Inertia
) -> tuple[Line, Inertia] | None:
    """Split the own inertia of a point mass: its line, and the rest; None for other bodies."""
    if inertia.radius is None:
        return None
    b, e = kinematics.builder, unit_vector(kinematics.builder, segment.axis)
    lever = kinematics.frames[segment.number].directions[inertia.direction].scale(inertia.radius)

    def keep(X: Matrix[Scalar], *rows: int) -> Matrix[Scalar]:
        return Matrix.of([X[r, c] if r in rows else b.zero for c in range(3)] for r in range(3))

    rest = Inertia(keep(own.M, *segment.across), keep(own.B, *segment.across), keep(own.J, segment.axis))
    return Line(inertia.m, Motion(e, lever.cross(e))), rest


def passes(kinematics: Kinematics, segment: Segment) -> bool:
    """Return whether a body has the origin of its parent, and is written in the same frame."""
    rest = kinematics.frames[segment.parent].rest if segment.parent else None
    return (
        segment.parent != 0
        and segment.is_revolute
        and kinematics.frames[segment.number].step is None
        and (not segment.opens_group or (segment.turn is None and rest is None))
        and all(x.is_zero for x in segment.d)
    )


def join(segment: Segment, point: int, line: Line, rest: Inertia) -> Series | None:
    """Put a line and the rest of a body's inertia in series; None where the joint feels them otherwise."""
    e, g = segment.axis, line.f.OMp[segment.axis]
    others = (*rest.B.column(e), *(rest.J[r, e] for r in segment.across))
    if not segment.is_revolute or g.is_zero or not all(x.is_zero for x in others):
        return None
    b = g.builder
    J, one = rest.J[e, e], b.number(1.0)
    felt = J * (one / line.m) + g * g
    share = one / felt
    f = Motion(line.f.a, Vector.of(b.zero if r == e else x for r, x in enumerate(line.f.OMp)))
    return Series(point, line, J, g, line.m * felt, share, Line(J * share, f))


def follow(kinematics: Kinematics, segment: Segment, inertia: RegroupedInertia, movement: Movement) -> Scalar:
    """Form the acceleration of a point mass along the axis of its joint."""
    lever = directions_of(kinematics, segment, inertia, movement)[inertia.direction]
    return (movement.a0 + lever.Ue)[segment.axis]
