"""Kinematics in chosen frames: forward recursion over segments, from the base to the leaves.

A body is *written in* a frame whose axis `axis` is its joint's: its own frame, or the frame in which its predecessor in
the group is written, or, where it opens a group, the parent's. Its state there:

    p, q    angular velocity across the axis, in cyclic order      w, wp   angular velocity and acceleration along it
    A       U e_axis, the field along the axis                     a0      acceleration of the origin, less gravity

with U = OMp~ + OM~ OM~, which maps a vector r fixed in the body to the acceleration of its end relative to its start.
p, q and A are the same for all bodies of a group, up to the turn between their frames, because points of the axis do
not move with the joint. The other columns of U follow: with e1, e2 across the axis,

    U e1 = -(q2 + w2) e1 + (p q + wp) e2 + (2 w p - A1) e,    U e2 = (p q - wp) e1 - (p2 + w2) e2 + (2 w q - A2) e.

Where the angular acceleration across the axis takes fewer operations than A, the last entries are from it instead: with
its components o1, o2 before the joint, they are (w + qd) p - o2 and (w + qd) q + o1.

From parent h to body i, revolute: a0 = a0_h + U_h d, w = w_h + qd, wp = wp_h + qdd; and A = U_h e where a group opens.
A prismatic joint adds A q + 2 OM x e qd + e qdd to a0 instead.

A joint at rest has the acceleration by which its body does not accelerate along the axis: wp, or a0 along a slide, is 0
there, and what the bodies before carry is `carried`.
"""

from __future__ import annotations

from collections.abc import Container, Sequence
from dataclasses import dataclass
from functools import partial

from mbsgen.algebra.vectors import Matrix, Vector
from mbsgen.formulations.parsimony.plan import Plan
from mbsgen.formulations.parsimony.segments import Segment, unit_vector
from mbsgen.tape.builder import Builder, Scalar


@dataclass(frozen=True)
class Turn:
    """A rotation about a coordinate axis, by its sine and cosine."""

    axis: int
    sine: Scalar
    cosine: Scalar
    by_squares: bool = False  # matrices without entries across the diagonal by products of sine and cosine

    def into(self, v: Vector[Scalar]) -> Vector[Scalar]:
        """Convert components to the turned frame."""
        return self._turn(v, self.sine)

    def back(self, v: Vector[Scalar]) -> Vector[Scalar]:
        """Convert components back from the turned frame."""
        return self._turn(v, -self.sine)

    def back_tensor(self, B: Matrix[Scalar], *, faithful: bool = False) -> Matrix[Scalar]:
        """Convert a matrix back from the turned frame: 11 operations across the axis, 12 along it.

        The diagonal changes by products with the sine. In a stretched or folded chain, whose links have little inertia
        along and much across, neither leaks into the other. By cosines it would, by rounding; but cosines may save
        operations where an entry of the diagonal is the structural zero. `faithful`: not even there.
        """
        a, j, k = self.axis, (self.axis + 1) % 3, (self.axis + 2) % 3
        c, s = self.cosine, self.sine
        change, both = B[j, j] - B[k, k], B[j, k] + B[k, j]
        by_sine, by_cosine = s * change + c * both, c * change - s * both
        across = {
            (j, j): B[j, j] - s * by_sine,
            (k, k): B[k, k] + s * by_sine,
            (j, k): c * by_sine - B[k, j],
            (k, j): c * by_sine - B[j, k],
        }
        is_flat = B[j, j].is_zero or B[k, k].is_zero
        if is_flat:
            images = {(j, j): B[k, k] + c * by_cosine, (k, k): B[j, j] - c * by_cosine}
            if not faithful:
                across = images | {(j, k): B[j, k] + s * by_cosine, (k, j): B[k, j] + s * by_cosine}
            elif both.is_zero:  # then each entry is a product
                kept = (j, j) if B[k, k].is_zero else (k, k)
                across[kept] = images[kept]
        if self.by_squares and (change.is_zero or (both.is_zero and not is_flat)):
            squared, mixed = s * s * (change + both), s * c * (change + both)
            if both.is_zero:
                across = {(j, j): B[j, j] - squared, (k, k): B[k, k] + squared}
                across |= {(j, k): mixed - B[k, j], (k, j): mixed - B[j, k]}
            else:
                across = {(j, j): B[j, j] - mixed, (k, k): B[k, k] + mixed}
                across |= {(j, k): B[j, k] - squared, (k, j): B[k, j] - squared}
        along = {
            (j, a): c * B[j, a] - s * B[k, a],
            (k, a): c * B[k, a] + s * B[j, a],
            (a, j): c * B[a, j] - s * B[a, k],
            (a, k): c * B[a, k] + s * B[a, j],
            (a, a): B[a, a],
        }
        entries = across | along
        return Matrix.of([entries[r, q] for q in range(3)] for r in range(3))

    def _turn(self, v: Vector[Scalar], sine: Scalar) -> Vector[Scalar]:
        x, y, z, c = v.x, v.y, v.z, self.cosine
        if self.axis == 0:
            return Vector(x, c * y + sine * z, c * z - sine * y)
        if self.axis == 1:
            first = c * z + sine * x
            return Vector(c * x - sine * z, y, first)
        return Vector(c * x + sine * y, c * y - sine * x, z)


@dataclass(frozen=True)
class BodyFrame:
    """The frame that a body is written in, by the turns between it, the body's own frame and its predecessor's."""

    segment: Segment
    step: Turn | None  # from the frame before the joint, or the predecessor's, to the frame that the body is written in
    rest: Turn | None  # from there to its own frame
    angle: Scalar | None  # of `rest`
    sum: str  # the joints whose angles add up in it: `2p3`
    directions: tuple[Vector[Scalar], Vector[Scalar], Vector[Scalar]]  # the own axes, by number, in this frame

    def own(self, v: Vector[Scalar]) -> Vector[Scalar]:
        """Convert components from where the body is written to its own frame."""
        return self.rest.into(v) if self.rest else v

    def written(self, v: Vector[Scalar]) -> Vector[Scalar]:
        """Convert components from the body's own frame to where it is written."""
        return self.rest.back(v) if self.rest else v


@dataclass(frozen=True)
class Movement:
    """The state of a body, and its field U by columns."""

    p: Scalar
    q: Scalar
    w: Scalar
    wp: Scalar
    A: Vector[Scalar]
    a0: Vector[Scalar]
    U: Matrix[Scalar]
    carried: Scalar  # the acceleration along the axis, for the given qdd
    spin: tuple[Scalar, Scalar]  # the angular acceleration across the axis

    def field(self, v: Vector[Scalar]) -> Vector[Scalar]:
        """Form U v."""
        return self.U.apply(v)

    def field_of_group(self, segment: Segment, v: Vector[Scalar]) -> Vector[Scalar]:
        """Form U v for v across the axis, less what w and wp add across the axis."""
        j, k = segment.across
        pp, pq, qq = self.p * self.p, self.p * self.q, self.q * self.q
        first, second = pq * v[k] - qq * v[j], pq * v[j] - pp * v[k]
        return by_axis(segment, self.U[segment.axis, j] * v[j] + self.U[segment.axis, k] * v[k], first, second)


def by_axis(segment: Segment, along: Scalar, first: Scalar, second: Scalar) -> Vector[Scalar]:
    """Make a vector of its components along a joint's axis, and across it in cyclic order."""
    if segment.axis == 0:
        return Vector(along, first, second)
    return Vector(second, along, first) if segment.axis == 1 else Vector(first, second, along)


class Kinematics:
    """The frames and movements of all bodies, in order."""

    def __init__(self, builder: Builder, segments: Sequence[Segment], plan: Plan, q: Sequence[Scalar]) -> None:
        self.builder, self.segments, self.plan, self._q = builder, segments, plan, q
        self.frames: dict[int, BodyFrame] = {}
        for segment in segments:
            before = None if segment.opens_group else self.frames.get(segment.parent)
            self.frames[segment.number] = builder.remember(
                ("place", plan[segment.number].own_frame, plan.by_squares, q[segment.number - 1].ref),
                (segment, before),
                partial(self._place, segment),
            )

    # -- where bodies are written -------------------------------------------------------------------------------

    def _place(self, segment: Segment) -> BodyFrame:
        b = self.builder
        axes = unit_vector(b, 0), unit_vector(b, 1), unit_vector(b, 2)
        if not segment.is_revolute:
            return BodyFrame(segment, None, None, None, "", axes)
        angle, joints = segment.signed(self._q[segment.number - 1]), str(segment.number)
        before = None if segment.opens_group else self.frames[segment.parent]
        if before and before.angle:
            angle, joints = before.angle + angle, f"{before.sum}{'p' if segment.sense > 0 else 'm'}{joints}"
        turn = Turn(segment.axis, b.sin(angle), b.cos(angle), self.plan.by_squares)
        b.label((turn.sine, turn.cosine), (f"S{joints}", f"C{joints}"))
        if self.plan[segment.number].own_frame:
            return BodyFrame(segment, turn, None, None, "", axes)
        x, y, z = (turn.back(e) for e in axes)
        return BodyFrame(segment, None, turn, angle, joints, (x, y, z))

    def slide(self, segment: Segment) -> Scalar:
        """Return how far a prismatic joint is moved along its axis."""
        return segment.signed(self._q[segment.number - 1])

    def arrive(self, segment: Segment, v: Vector[Scalar]) -> Vector[Scalar]:
        """Take components from where the parent is written to where `segment` is."""
        frame = self.frames[segment.number]
        if segment.opens_group:
            v = self.frames[segment.parent].own(v) if segment.parent else v
            v = segment.turn.transposed.apply(v) if segment.turn else v
        return frame.step.into(v) if frame.step else v

    def arrive_from_base(self, segment: Segment, v: Vector[Scalar]) -> Vector[Scalar]:
        """Take components from the base frame to where `segment` is written."""
        before = self.arrive_from_base(self.segments[segment.parent - 1], v) if segment.parent else v
        return self.arrive(segment, before)

    def depart(self, segment: Segment, v: Vector[Scalar]) -> Vector[Scalar]:
        """Take components from where `segment` is written to where its parent is."""
        frame = self.frames[segment.number]
        v = frame.step.back(v) if frame.step else v
        if segment.opens_group:
            v = segment.turn.apply(v) if segment.turn else v
            v = self.frames[segment.parent].written(v) if segment.parent else v
        return v

    def fixed(self, number: int, v: Vector[Scalar]) -> Vector[Scalar]:
        """Write a vector that is fixed in body `number`, given in its own frame, where the body is written."""
        return self.frames[number].written(v) if number else v

    def depart_tensor(self, segment: Segment, B: Matrix[Scalar], *, faithful: bool = False) -> Matrix[Scalar]:
        """Take a matrix from where `segment` is written to where its parent is."""
        frame = self.frames[segment.number]
        B = frame.step.back_tensor(B, faithful=faithful) if frame.step else B
        if segment.opens_group:
            B = segment.turn.times(B).times(segment.turn.transposed) if segment.turn else B
            rest = self.frames[segment.parent].rest if segment.parent else None
            B = rest.back_tensor(B, faithful=faithful) if rest else B
        return B

    # -- how they move ------------------------------------------------------------------------------------------

    def move(
        self, gravity: Vector[Scalar], qd: Sequence[Scalar], qdd: Sequence[Scalar], still: Container[int] = ()
    ) -> dict[int, Movement]:
        """Compute the movement of every body; the base accelerates against gravity, and joints in `still` rest."""
        zero = self.builder.zero
        unmoved = Vector(zero, zero, zero)
        base = Movement(
            zero, zero, zero, zero, unmoved, -gravity, Matrix((unmoved, unmoved, unmoved)), zero, (zero, zero)
        )
        movements = {0: self.builder.remember(("base", *(x.ref for x in gravity)), (), lambda: base)}
        for segment in self.segments:
            parent, frames = movements[segment.parent], (self.frames[segment.number], self.frames.get(segment.parent))
            rates = [segment.signed(x[segment.number - 1]) for x in (qd, qdd)]
            scaled = bool(segment.parent) and self.plan[segment.parent].scaled
            is_still, by_spin = segment.number in still, self.plan[segment.number].by_spin
            movements[segment.number] = self.builder.remember(
                ("move", scaled, is_still, by_spin, *(x.ref for x in rates)),
                (segment, parent, *frames),
                partial(self._move, segment, parent, *rates, is_still=is_still),
            )
        return movements

    def _move(self, segment: Segment, parent: Movement, qd: Scalar, qdd: Scalar, *, is_still: bool) -> Movement:
        a0 = self.arrive(segment, parent.a0 + self._lever(segment, parent))
        if not segment.opens_group:
            turned = self.arrive(segment, self._across(segment, parent.p, parent.q))
            A = self.arrive(segment, parent.A)
            w, carried = parent.w + qd, parent.wp + qdd
        else:
            turned = self.arrive(segment, self._angular_velocity(segment, parent))
            A = self.arrive(segment, self._lever_field(segment, parent, self._axis_before(segment)))
            w, wp = turned[segment.axis], self._axial_acceleration(segment, parent)
            if segment.is_revolute:
                w, carried = w + qd, wp + qdd
            else:
                slide, e = self.slide(segment), unit_vector(self.builder, segment.axis)
                coriolis = turned.cross(e).scale(self.builder.number(2.0) * qd)
                a0 = (a0 + A.scale(slide) + coriolis).along(segment.axis, qdd)
                carried = a0[segment.axis]
                a0 = a0.along(segment.axis, -carried) if is_still else a0
        if segment.is_revolute:
            wp = self.builder.zero if is_still else carried
        j, k = segment.across
        before = None
        if self.plan[segment.number].by_spin and segment.is_revolute:
            spin = self.arrive(segment, self._spin_before(segment, parent))
            before = qd, spin[j], spin[k]
        return self._complete(segment, turned[j], turned[k], w, wp, A, a0, carried, before)

    def _complete(
        self,
        segment: Segment,
        p: Scalar,
        q: Scalar,
        w: Scalar,
        wp: Scalar,
        A: Vector[Scalar],
        a0: Vector[Scalar],
        carried: Scalar,
        before: tuple[Scalar, Scalar, Scalar] | None,
    ) -> Movement:
        """Write U from a body's state."""
        j, k = segment.across
        a, ww, pq, wp_, wq_ = segment.axis, w * w, p * q, w * p, w * q
        if before is None:
            along, spin = (wp_ + (wp_ - A[j]), wq_ + (wq_ - A[k])), (wq_ - A[k], A[j] - wp_)
        else:
            qd, first, second = before
            twice = w + qd
            along, spin = (twice * p - second, twice * q + first), (first + qd * q, second - qd * p)
        columns = {j: by_axis(segment, along[0], -(q * q + ww), pq + wp)}
        columns[k] = by_axis(segment, along[1], pq - wp, -(p * p + ww))
        columns[a] = A
        i = segment.number
        self.builder.label((w, wp, *a0), (f"w_{i}", f"wp_{i}", *(f"a{r}_{i}" for r in "123")))
        U = Matrix((columns[0], columns[1], columns[2])).transposed
        return Movement(p, q, w, wp, A, a0, U, carried, spin)

    def _across(self, segment: Segment, p: Scalar, q: Scalar) -> Vector[Scalar]:
        return by_axis(segment, self.builder.zero, p, q)

    def _axis_before(self, segment: Segment) -> Vector[Scalar]:
        """The joint's axis in the parent's own frame."""
        if segment.turn:
            return segment.turn.column(segment.axis)
        return unit_vector(self.builder, segment.axis)

    def _lever(self, segment: Segment, parent: Movement) -> Vector[Scalar]:
        """Form U d for the link to `segment`, where the parent is written."""
        return self._lever_field(segment, parent, segment.d)

    def _lever_field(self, segment: Segment, parent: Movement, v: Vector[Scalar]) -> Vector[Scalar]:
        """Form U v for a vector fixed in the parent, given in its own frame; direction by direction."""
        zero = self.builder.zero
        total = Vector(zero, zero, zero)
        if segment.parent:
            scaled = self.plan[segment.parent].scaled
            for e, length in zip(self.frames[segment.parent].directions, v, strict=True):
                part = parent.field(e.scale(length)) if scaled else parent.field(e).scale(length)
                total = total + part
        return total

    def _angular_velocity(self, segment: Segment, parent: Movement) -> Vector[Scalar]:
        """Form the parent's angular velocity, where it is written."""
        if not segment.parent:
            return Vector(parent.p, parent.q, parent.w)
        return self.angular_velocity(self.segments[segment.parent - 1], parent)

    def angular_velocity(self, segment: Segment, movement: Movement) -> Vector[Scalar]:
        """Form a body's own angular velocity, where it is written."""
        return by_axis(segment, movement.w, movement.p, movement.q)

    def angular_acceleration(self, segment: Segment, movement: Movement) -> Vector[Scalar]:
        """Form a body's own angular acceleration, where it is written."""
        return by_axis(segment, movement.wp, *movement.spin)

    def _axial_acceleration(self, segment: Segment, parent: Movement) -> Scalar:
        """Form the component of the parent's angular acceleration along the joint's axis."""
        if not segment.parent:
            return parent.wp
        OMp = self._spin_before(segment, parent)
        return self.frames[segment.parent].own(OMp).dot(self._axis_before(segment))

    def _spin_before(self, segment: Segment, parent: Movement) -> Vector[Scalar]:
        """Form the parent's angular acceleration, where it is written."""
        if not segment.parent:
            return Vector(*parent.spin, parent.wp)
        return by_axis(self.segments[segment.parent - 1], parent.wp, *parent.spin)
