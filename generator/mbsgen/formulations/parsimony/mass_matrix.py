"""Mass matrix of regrouped segments: composite bodies, in the frames of the plan.

All bodies beyond joint i, taken as one rigid body, have m, S and J about its origin, summed from the leaves to the
base. The unit acceleration of joint i needs the load

    revolute:  F = e x S,  N = J e        prismatic:  F = m e,  N = S x e

which is carried down to the base; M_ji is its component along joint j, and the rotor is added to M_ii (Walker, Orin,
1982; Fisette, Samin, 1996; Featherstone, 2008, 6.2).

In *absolute* rates the coordinate of a body in a group of parallel axes is its angle to the frame before the group: the
bodies beyond it in the group do not turn with it. Many terms that relative angles add up in M then vanish. A joint with
a rotor keeps its own angle: the rotor, which may be large, is then on the diagonal of M alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

from mbsgen.algebra.vectors import Matrix, Vector, outer
from mbsgen.formulations.parsimony.motion import Kinematics
from mbsgen.formulations.parsimony.regrouping import RegroupedInertia
from mbsgen.formulations.parsimony.residual import Load, slide_lever
from mbsgen.formulations.parsimony.segments import Segment, children, unit_vector
from mbsgen.formulations.parsimony.writing import Writing
from mbsgen.tape.builder import Builder, Scalar

Entries = dict[tuple[int, int], Scalar]  # of M, by body numbers (ancestor, descendant); others are zero


@dataclass(frozen=True)
class Composite:
    """A body with all bodies beyond it: mass, first moment and inertia about its origin, where it is written."""

    m: Scalar
    S: Vector[Scalar]
    J: Matrix[Scalar]
    alone: Part


@dataclass(frozen=True)
class Part:
    """The part that turns when a body's absolute angle changes: without bodies that have an absolute angle too."""

    S: Vector[Scalar]
    Je: Vector[Scalar]  # J e_axis: the moment for a unit acceleration, including bodies that only follow
    axial: Scalar  # the component of it along the joint


def mass_matrix(writing: Writing, *, absolute: bool = False) -> Entries:
    """Compute one triangle of M, in relative or absolute rates; bodies on different branches have no entry."""
    kinematics, inertias = writing.kinematics, writing.inertias
    composites: dict[int, Composite] = {}
    M: Entries = {}
    for segment in reversed(kinematics.segments):
        body = compose(kinematics, segment, inertias[segment.number], composites)
        composites[segment.number] = body
        M |= kinematics.builder.remember(
            ("column", absolute),
            (segment, body, *(kinematics.frames[i] for i in list_path(kinematics, segment))),
            partial(_column, kinematics, segment, body, absolute=absolute),
        )
        own = segment.number, segment.number
        M[own] = M[own] + writing.chain.armatures[segment.number - 1]
    return M


def compose(
    kinematics: Kinematics, segment: Segment, inertia: RegroupedInertia, composites: dict[int, Composite]
) -> Composite:
    """Add to a body what its joints carry."""
    beyond = [c.number for c in children(kinematics.segments, segment.number)]
    parts = (*(composites[i] for i in beyond), *(kinematics.frames[i] for i in beyond))
    return kinematics.builder.remember(
        ("composite",),
        (segment, inertia, kinematics.frames[segment.number], *parts),
        lambda: _compose(kinematics, segment, inertia, composites),
    )


def _compose(
    kinematics: Kinematics, segment: Segment, inertia: RegroupedInertia, composites: dict[int, Composite]
) -> Composite:
    b, axis = kinematics.builder, segment.axis
    axes = kinematics.frames[segment.number].directions
    m, S, J = inertia.m, kinematics.fixed(segment.number, inertia.S), own_inertia(b, segment, inertia, axes)
    beyond = children(kinematics.segments, segment.number)
    for child in (x for x in beyond if x.counts_angle):
        carried, d = composites[child.number], link(kinematics, child)
        s, weight = kinematics.depart(child, carried.S), d.scale(carried.m)
        J = shift_inertia(kinematics.depart_tensor(child, carried.J), d, s, weight) + J
        S, m = S + s + weight, m + carried.m
    alone = Part(S, J.column(axis), J[axis, axis])
    for child in (x for x in beyond if not x.counts_angle):
        carried, d = composites[child.number], link(kinematics, child)
        s, weight = kinematics.depart(child, carried.S), d.scale(carried.m)
        follows = [-(d[r] * (s[axis] + weight[axis])) for r in range(3)]
        follows[axis] = sum_across(segment, d, s) + sum_across(segment, d, weight)
        axial = alone.axial + sum_across(segment, d, weight)
        alone = Part(alone.S + weight, alone.Je + Vector.of(follows), axial)
        J = shift_inertia(kinematics.depart_tensor(child, carried.J), d, s, weight) + J
        S, m = S + s + weight, m + carried.m
    return Composite(m, S, J, alone)


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
    for t, a in enumerate(axes):
        for u, e in enumerate(axes):
            if not inertia.P[t, u].is_zero:
                total = total - outer(a, e).scale(inertia.P[t, u])
    return total


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
        below = kinematics.segments[at.parent - 1]
        F = kinematics.depart(at, load.F)
        lever = link(kinematics, at).cross(F)
        N = kinematics.depart(at, load.N) + lever
        load = Load(F, N, N)
        keeps_angle = absolute and not at.counts_angle  # bodies beyond `at` only follow its origin
        along = lever[below.axis] if keeps_angle else _along(load, below)
        same = absolute or below.sense == segment.sense
        column[below.number, segment.number] = along if same else -along
        at = below
    return column


def _along(load: Load, segment: Segment) -> Scalar:
    return (load.N if segment.is_revolute else load.F)[segment.axis]
