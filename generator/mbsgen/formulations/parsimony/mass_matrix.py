"""Mass matrix of regrouped segments: composite bodies, in the frames of the plan.

All bodies beyond joint i, taken as one rigid body, have m, S and J about its origin, summed from the leaves to the
base. The unit acceleration of joint i needs the load

    revolute:  F = e x S,  N = J e        prismatic:  F = m e,  N = S x e

which is carried down to the base; M_ji is its component along joint j, and the rotor is added to M_ii (Walker, Orin,
1982; Fisette, Samin, 1996; Featherstone, 2008, 6.2).

A body may be *met* instead, where this takes fewer operations: the motions of the joints before it are carried up to
it, and M_ji is the power of its load for the motion of i by the motion of j. In a group of parallel axes, the motions
are levers.

In *absolute* rates the coordinate of a body in a group of parallel axes is its angle to the frame before the group: the
bodies beyond it in the group do not turn with it. Many terms that relative angles add up in M then vanish. A joint with
a rotor keeps its own angle: the rotor, which may be large, is then on the diagonal of M alone.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product
from types import MappingProxyType

from mbsgen.algebra.vectors import Matrix, Vector, outer
from mbsgen.formulations.parsimony.angles import relative_entries
from mbsgen.formulations.parsimony.motion import Kinematics
from mbsgen.formulations.parsimony.plan import Meeting
from mbsgen.formulations.parsimony.regrouping import RegroupedInertia
from mbsgen.formulations.parsimony.residual import Force, Load, lengths_of, slide_lever
from mbsgen.formulations.parsimony.segments import Segment, children, unit_vector
from mbsgen.formulations.parsimony.writing import Writing
from mbsgen.tape.builder import Builder, Scalar

Entries = dict[tuple[int, int], Scalar]  # of M, by body numbers (ancestor, descendant); others are zero


@dataclass(slots=True, unsafe_hash=True)  # as if frozen: many are made
class Motion:
    """The acceleration of a body's origin, and its angular acceleration."""

    a: Vector[Scalar]
    OMp: Vector[Scalar]

    @property
    def is_lever(self) -> bool:
        """Return whether nothing turns."""
        return all(x.is_zero for x in self.OMp)

    def work(self, load: Force) -> Scalar:
        """Form the power of a load."""
        return self.a.dot(load.F) + self.OMp.dot(load.N)

    def __add__(self, other: Motion) -> Motion:
        return Motion(self.a + other.a, self.OMp + other.OMp)

    def scale(self, factor: Scalar) -> Motion:
        """Multiply by a number."""
        return Motion(self.a.scale(factor), self.OMp.scale(factor))

    def shift(self, d: Vector[Scalar]) -> Motion:
        """Refer the motion to a point at d from the origin."""
        return Motion(self.a + self.OMp.cross(d), self.OMp)

    def arrive(self, kinematics: Kinematics, segment: Segment) -> Motion:
        """Take a motion from where the parent is written to where `segment` is."""
        return Motion(kinematics.arrive(segment, self.a), kinematics.arrive(segment, self.OMp))


@dataclass(slots=True, unsafe_hash=True)  # as if frozen: many are made
class Inertia:
    """Inertia at the origin of a body: F = M a + B OMp, N = BT a + J OMp."""

    M: Matrix[Scalar]  # symmetric
    B: Matrix[Scalar]
    J: Matrix[Scalar]  # symmetric

    def resist(self, motion: Motion) -> Load:
        """Form the load that a motion takes."""
        F = self.M.apply(motion.a) + self.B.apply(motion.OMp)
        N = self.B.transposed.apply(motion.a) + self.J.apply(motion.OMp)
        return Load(F, N, N)

    def weigh(self, motion: Motion) -> Scalar:
        """Form the quadratic form of a motion: each product of two components once, doubled."""
        s = (*motion.a, *motion.OMp)
        total = zero = self.M[0, 0].builder.zero
        for r in reversed(range(6)):
            twice = zero
            for c in range(r + 1, 6):
                twice = twice + self._entry(r, c) * s[c]
            total = total + s[r] * (self._entry(r, r) * s[r] + (twice + twice))
        return total

    def _entry(self, r: int, c: int) -> Scalar:
        """Return an entry of the upper triangle of [M, B; BT, J]."""
        if r < 3:
            return self.M[r, c] if c < 3 else self.B[r, c - 3]
        return self.J[r - 3, c - 3]


@dataclass(frozen=True)
class Freed:
    """A body whose joint is free, as it is felt by the joints before: by `left`, or by `whole` - U UT / D."""

    axis: int
    is_revolute: bool
    left: Inertia
    whole: Inertia  # with the joint locked
    U: Load  # of a unit acceleration of the joint
    inverse: Scalar  # of D
    is_apart: bool  # motions that turn meet `whole`; then the joint has no rotor

    def parts(self, motion: Brought) -> bool:
        """Return whether a motion meets `whole`."""
        return self.is_apart and not motion.is_before and not motion.beyond.is_lever

    def feel(self, motion: Motion) -> Scalar:
        """Form U.s: the joint's force for a motion, with the joint locked."""
        return self.relieve(motion).work(self.U)

    def relieve(self, motion: Motion) -> Motion:
        """Leave out what the joint takes up: the motion along its axis."""
        zero = self.inverse.builder.zero
        a, OMp = (
            Vector.of(zero if r == self.axis and is_along else x for r, x in enumerate(v))
            for v, is_along in ((motion.a, not self.is_revolute), (motion.OMp, self.is_revolute))
        )
        return Motion(a, OMp)

    def meet(self, one: Motion, other: Motion) -> Scalar:
        """Form the entry of two motions, of which at least one turns."""
        if one.is_lever:
            one, other = other, one
        felt, turning = self.feel(one), self.relieve(one)
        if one is other:
            return self.whole.weigh(turning) - felt * self.inverse * felt
        load = self.whole.resist(turning)
        if not other.is_lever:
            return self.relieve(other).work(load) - felt * self.inverse * self.feel(other)
        share = felt * self.inverse
        load = Load(load.F - self.U.F.scale(share), load.N, load.alone)
        return self.relieve(other).work(load)


@dataclass(frozen=True)
class Composite:
    """A body with all bodies beyond it: mass, first moment and inertia about its origin, where it is written."""

    m: Scalar
    S: Vector[Scalar]
    J: Matrix[Scalar]
    alone: Part

    @property
    def moments(self) -> Inertia:
        """The inertia without the mass."""
        builder = self.m.builder
        return Inertia(self.J.map(lambda _: builder.zero), cross_matrix(builder, -self.S), self.J)


@dataclass(frozen=True)
class Part:
    """The part that turns when a body's absolute angle changes: without bodies that have an absolute angle too."""

    S: Vector[Scalar]
    Je: Vector[Scalar]  # J e_axis: the moment for a unit acceleration, including bodies that only follow
    axial: Scalar  # the component of it along the joint


def mass_matrix(
    writing: Writing, *, absolute: bool = False, freed: Mapping[int, Freed] = MappingProxyType({})
) -> Entries:
    """Compute one triangle of M, in relative or absolute rates; bodies on different branches have no entry.

    The joints of bodies in `freed`, and all joints beyond, are free, and have no entries: these bodies have the
    articulated inertia that is given, as their parents feel it.
    """
    kinematics, inertias = writing.kinematics, writing.inertias
    composites: dict[int, Composite] = {}
    M: Entries = {}

    def add(kind: str, write: Callable[[], Entries], *parts: object) -> None:
        path = list_path(kinematics, segment)
        key = (kind, absolute, kinematics.plan.first_resists, *(kinematics.plan[i].meeting for i in path))
        frames = (kinematics.frames[i] for i in path)
        for place, value in kinematics.builder.remember(key, (segment, *parts, *frames), write).items():
            M[place] = M[place] + value if place in M else value

    for segment in reversed(kinematics.segments):
        i = segment.number
        if i in freed:
            left = partial(_meet, kinematics, segment, freed[i].left, absolute=absolute, freed=freed[i])
            add("freed", left, *(freed[i].left, freed[i].whole) if freed[i].is_apart else (freed[i].left,))
        if not freed.keys().isdisjoint(list_path(kinematics, segment)):
            continue
        body = composites[i] = compose(kinematics, segment, inertias[i], composites)
        if is_met(kinematics, segment):
            add("met", partial(_meet, kinematics, segment, body.moments, absolute=absolute), body)
        add("column", partial(_column, kinematics, segment, body, absolute=absolute), body)
        M[i, i] = M[i, i] + writing.chain.armatures[i - 1]
    return M


def joint_matrix(writing: Writing) -> Entries:
    """Compute one triangle of M in the joints' own angles, by absolute ones if the plan says so."""
    if not writing.kinematics.plan.by_angles:
        return mass_matrix(writing)
    return relative_entries(writing.kinematics.segments, mass_matrix(writing, absolute=True))


def is_met(kinematics: Kinematics, segment: Segment) -> bool:
    """Return whether the motions of the joints before a body are carried to it; all of its mass passes nevertheless."""
    return segment.parent != 0 and kinematics.plan[segment.number].meeting is not Meeting.PASSED


def compose(
    kinematics: Kinematics, segment: Segment, inertia: RegroupedInertia, composites: dict[int, Composite]
) -> Composite:
    """Add to a body what its joints carry."""
    beyond = [c for c in children(kinematics.segments, segment.number) if c.number in composites]
    parts = (*(composites[c.number] for c in beyond), *(kinematics.frames[c.number] for c in beyond))
    return kinematics.builder.remember(
        ("composite", _has_levers(kinematics, segment, inertia), *(is_met(kinematics, c) for c in beyond)),
        (segment, inertia, kinematics.frames[segment.number], *parts),
        lambda: _compose(kinematics, segment, inertia, composites),
    )


def _compose(
    kinematics: Kinematics, segment: Segment, inertia: RegroupedInertia, composites: dict[int, Composite]
) -> Composite:
    b, axis = kinematics.builder, segment.axis
    axes = kinematics.frames[segment.number].directions
    m, S, J = inertia.m, kinematics.fixed(segment.number, inertia.S), own_inertia(b, segment, inertia, axes)
    if _has_levers(kinematics, segment, inertia):
        J = _inertia_by_levers(kinematics, segment, inertia)
    beyond = [c for c in children(kinematics.segments, segment.number) if c.number in composites]
    for child in (x for x in beyond if x.counts_angle):
        carried, d = composites[child.number], link(kinematics, child)
        (s, own), weight = _pass(kinematics, child, carried), d.scale(carried.m)
        J = shift_inertia(own, d, s, weight) + J
        S, m = S + s + weight, m + carried.m
    alone = Part(S, J.column(axis), J[axis, axis])
    for child in (x for x in beyond if not x.counts_angle):
        carried, d = composites[child.number], link(kinematics, child)
        (s, own), weight = _pass(kinematics, child, carried), d.scale(carried.m)
        follows = [-(d[r] * (s[axis] + weight[axis])) for r in range(3)]
        follows[axis] = sum_across(segment, d, s) + sum_across(segment, d, weight)
        axial = alone.axial + sum_across(segment, d, weight)
        alone = Part(alone.S + weight, alone.Je + Vector.of(follows), axial)
        J = shift_inertia(own, d, s, weight) + J
        S, m = S + s + weight, m + carried.m
    return Composite(m, S, J, alone)


def _pass(kinematics: Kinematics, child: Segment, body: Composite) -> tuple[Vector[Scalar], Matrix[Scalar]]:
    """Carry the first moment and the inertia of a body down to where its parent is written, unless they are met."""
    if is_met(kinematics, child):
        return body.S.map(lambda x: x.builder.zero), body.J.map(lambda x: x.builder.zero)
    return kinematics.depart(child, body.S), kinematics.depart_tensor(child, body.J)


def list_path(kinematics: Kinematics, segment: Segment) -> list[int]:
    """List the numbers of the bodies from one down to the base."""
    path = [segment.number]
    while (parent := kinematics.segments[path[-1] - 1].parent) != 0:
        path.append(parent)
    return path


def sum_across(segment: Segment, a: Vector[Scalar], b: Vector[Scalar]) -> Scalar:
    """Form the scalar product across a joint's axis."""
    j, k = segment.across
    return a[j] * b[j] + a[k] * b[k]


def shift_inertia(J: Matrix[Scalar], d: Vector[Scalar], s: Vector[Scalar], weight: Vector[Scalar]) -> Matrix[Scalar]:
    """Refer an inertia to a point from which its own is at d; `s` is the first moment about its own, weight = m d.

    A diagonal entry grows by the lever d.s across its axis twice: the load of one joint on the next holds it once.
    """

    def entry(r: int, c: int) -> Scalar:
        if r != c:
            return J[r, c] - (d[r] * (s[c] + weight[c]) + s[r] * d[c])
        j, k = (r + 1) % 3, (r + 2) % 3
        lever = d[j] * s[j] + d[k] * s[k]
        return (J[r, r] + lever) + (lever + (d[j] * weight[j] + d[k] * weight[k]))

    upper = {(r, c): entry(r, c) for r in range(3) for c in range(r, 3)}
    return Matrix.of([upper[min(r, c), max(r, c)] for c in range(3)] for r in range(3))


def own_inertia(
    builder: Builder, segment: Segment, inertia: RegroupedInertia, axes: Sequence[Vector[Scalar]]
) -> Matrix[Scalar]:
    """Write a body's own inertia where the body is written; its spin inertia is the same at all angles."""
    trace = inertia.P[0, 0] + inertia.P[1, 1] + inertia.P[2, 2]
    along = trace + inertia.half_spin + inertia.half_spin
    total = Matrix.of(
        [(along if r == segment.axis else trace) if r == c else builder.zero for c in range(3)] for r in range(3)
    )
    if inertia.radius is not None:  # a point mass: its first moment times its distance
        e = axes[inertia.direction]
        return total - outer(e.scale(inertia.S[inertia.direction]), e.scale(inertia.radius))
    for t, a in enumerate(axes):
        for u, e in enumerate(axes):
            if not inertia.P[t, u].is_zero:
                total = total - outer(a, e).scale(inertia.P[t, u])
    return total


def _has_levers(kinematics: Kinematics, segment: Segment, inertia: RegroupedInertia) -> bool:
    is_turned = kinematics.frames[segment.number].rest is not None
    return kinematics.plan.by_levers and is_turned and kinematics.plan[segment.number].scaled and inertia.radius is None


def _inertia_by_levers(kinematics: Kinematics, segment: Segment, inertia: RegroupedInertia) -> Matrix[Scalar]:
    """Write the same as tr(P) 1 - P, with P by directions of the lengths that the residual gives them."""
    (j, k), a, zero = segment.across, segment.axis, kinematics.builder.zero
    axes, lengths = kinematics.frames[segment.number].directions, lengths_of(kinematics, segment, inertia)
    P = Matrix.of([zero] * 3 for _ in range(3))
    for t, u in product(range(3), repeat=2):
        amount, levers = inertia.P[t, u], []
        for axis, length in ((axes[t], lengths[t]), (axes[u], lengths[u])):
            amount, lever = (amount, axis) if length is None else (amount / length, axis.scale(length))
            levers.append(lever)
        P = P + outer(levers[0].scale(amount), levers[1])
    spin = inertia.half_spin + inertia.half_spin
    J = {(r, c): -P[r, c] for r in range(3) for c in range(3)}
    J[j, j], J[k, k] = P[k, k] + P[a, a], P[j, j] + P[a, a]
    J[a, a] = inertia.P[j, j] + inertia.P[k, k] + spin  # at all angles
    return Matrix.of([J[r, c] for c in range(3)] for r in range(3))


def link(kinematics: Kinematics, child: Segment) -> Vector[Scalar]:
    """Return the link to a child, where its parent is written, including the displacement of a prismatic joint."""
    d = kinematics.fixed(child.parent, child.d)
    return d if child.is_revolute else d + slide_lever(kinematics, child)


def unit_load(builder: Builder, segment: Segment, body: Composite, *, absolute: bool) -> Load:
    """Compute the load, about the body's origin, for a unit acceleration of the joint."""
    e = unit_vector(builder, segment.axis)
    if not segment.is_revolute:
        N = body.S.cross(e)
        return Load(e.scale(body.m), N, N)
    part = body.alone if absolute else Part(body.S, body.J.column(segment.axis), body.J[segment.axis, segment.axis])
    return Load(e.cross(part.S), part.Je, part.Je)


def _column(kinematics: Kinematics, segment: Segment, body: Composite, *, absolute: bool) -> Entries:
    """Carry a joint's load down to the base, and take its component along every joint on the way."""
    load = unit_load(kinematics.builder, segment, body, absolute=absolute)
    own = body.alone.axial if absolute and segment.is_revolute else _along(load, segment)
    column = {(segment.number, segment.number): own}
    at = segment
    while at.parent:
        if is_met(kinematics, at):
            return column | _meet_load(kinematics, at, load, segment, absolute=absolute)
        below = kinematics.segments[at.parent - 1]
        F = kinematics.depart(at, load.F)
        lever = link(kinematics, at).cross(F)
        N = kinematics.depart(at, load.N) + lever
        load = Load(F, N, N)
        keeps_angle = absolute and not at.counts_angle  # bodies beyond `at` only follow its origin
        along = lever[below.axis] if keeps_angle else _along(load, below)
        column[below.number, segment.number] = _sign(below, segment, along, absolute=absolute)
        at = below
    return column


def _along(load: Load, segment: Segment) -> Scalar:
    return (load.N if segment.is_revolute else load.F)[segment.axis]


def _sign(one: Segment, other: Segment, entry: Scalar, *, absolute: bool) -> Scalar:
    """Return an entry of M with its sign: absolute rates are along the positive axes."""
    return entry if absolute or one.sense == other.sense else -entry


# -- motions that are carried up to inertia -------------------------------------------------------------------------


def _meet(
    kinematics: Kinematics, segment: Segment, inertia: Inertia, *, absolute: bool, freed: Freed | None = None
) -> Entries:
    """Compute what a body's inertia adds to the entries of M of all joints before it."""
    M, B, J = (kinematics.depart_tensor(segment, x, faithful=True) for x in (inertia.M, inertia.B, inertia.J))
    sides = {True: Inertia(M, B, J), False: inertia}
    motions = bring_all(kinematics, segment, absolute=absolute)
    before = [kinematics.segments[i - 1] for i in motions]
    entries: Entries = {}
    for number, k in enumerate(before):  # from the last to the first
        for j in before[number:]:
            one, other = motions[j.number], motions[k.number]
            side = one.is_before or other.is_before
            if kinematics.plan.first_resists:
                one, other = other, one
            if freed and freed.is_apart and not side and not (one.beyond.is_lever and other.beyond.is_lever):
                entries[j.number, k.number] = _sign(j, k, freed.meet(one.beyond, other.beyond), absolute=absolute)
                continue
            load = sides[side].resist(other.at(before=side))
            entries[j.number, k.number] = _sign(j, k, one.at(before=side).work(load), absolute=absolute)
    return entries


def _meet_load(kinematics: Kinematics, at: Segment, load: Load, segment: Segment, *, absolute: bool) -> Entries:
    """Compute the entries of a joint and all joints before a body, from the joint's load on this body."""
    felt = meet_load(kinematics, at, load, absolute=absolute)
    return {
        (j, segment.number): _sign(kinematics.segments[j - 1], segment, work, absolute=absolute)
        for j, work in felt.items()
    }


def meet_hooked(
    kinematics: Kinematics, at: Segment, bias: Load, hooked: Load, residual: Scalar, freed: Freed, *, absolute: bool
) -> dict[int, Scalar]:
    """Compute the same for a body whose joint is free: by its hooked load; or by its bias load, and what the joint's
    force residual adds.
    """
    felt = meet_load(kinematics, at, hooked, absolute=absolute)
    one = freed.inverse.builder.number(1.0)
    for i, motion in bring_all(kinematics, at, absolute=absolute).items():
        if freed.parts(motion):
            share, rest = freed.feel(motion.beyond) * freed.inverse, freed.relieve(motion.beyond)
            along = motion.beyond + rest.scale(-one)
            felt[i] = rest.work(bias) + share * residual + along.work(hooked)
    return felt


def meet_load(kinematics: Kinematics, at: Segment, load: Load, *, absolute: bool) -> dict[int, Scalar]:
    """Compute the power of a body's load by the motion of each joint before it, along the positive axis."""
    F, N = kinematics.depart(at, load.F), kinematics.depart(at, load.N)
    sides = {True: Load(F, N, N), False: load}
    felt = {}
    for i, motion in bring_all(kinematics, at, absolute=absolute).items():
        felt[i] = motion.at(before=motion.is_before).work(sides[motion.is_before])
    return felt


@dataclass(frozen=True)
class Brought:
    """The motion of a body for a unit acceleration of a joint before it, and the side of its joint where it is met."""

    before: Motion  # where the parent is written
    beyond: Motion  # where the body is written
    is_before: bool

    def at(self, *, before: bool) -> Motion:
        return self.before if before else self.beyond


def bring_all(kinematics: Kinematics, segment: Segment, *, absolute: bool) -> dict[int, Brought]:
    """Carry the motions of all joints before a body up to it, from the last to the first."""
    before = (kinematics.segments[i - 1] for i in list_path(kinematics, segment)[1:])
    return {j.number: _bring(kinematics, j, segment, absolute=absolute) for j in before}


def _bring(kinematics: Kinematics, joint: Segment, segment: Segment, *, absolute: bool) -> Brought:
    """Carry a joint's motion up to a body that is met."""
    b, meeting = kinematics.builder, kinematics.plan[segment.number].meeting

    def write() -> Brought:
        before = _arrive(kinematics, joint, segment, absolute=absolute)
        beyond = before.arrive(kinematics, segment)
        is_beyond = meeting is Meeting.BEYOND or (meeting is Meeting.SPLIT and before.is_lever)
        return Brought(before, beyond, not is_beyond)

    frames = (kinematics.frames[i] for i in list_path(kinematics, segment))
    return b.remember(("bring", absolute, meeting), (joint, segment, *frames), write)


def _arrive(kinematics: Kinematics, joint: Segment, segment: Segment, *, absolute: bool) -> Motion:
    """Compute the acceleration of a body's origin, and its angular one, where its parent is written.

    In absolute rates, a body that continues the joint's group only follows.
    """
    b = kinematics.builder
    still = Vector(b.zero, b.zero, b.zero)
    if segment.parent == joint.number:
        e = unit_vector(b, joint.axis)
        at = Motion(still, e) if joint.is_revolute else Motion(e, still)
    else:
        parent = kinematics.segments[segment.parent - 1]
        far = _arrive(kinematics, joint, parent, absolute=absolute)
        at = far.arrive(kinematics, parent)
    follows = absolute and segment.parent == joint.number and not segment.counts_angle
    return Motion(at.a + at.OMp.cross(link(kinematics, segment)), still if follows else at.OMp)


def cross_matrix(builder: Builder, v: Vector[Scalar]) -> Matrix[Scalar]:
    """Make v~, with v~ w = v x w."""
    zero = builder.zero
    return Matrix.of([[zero, -v.z, v.y], [v.z, zero, -v.x], [-v.y, v.x, zero]])
