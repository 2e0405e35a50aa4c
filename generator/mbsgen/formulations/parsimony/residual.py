"""Newton-Euler residual, direction by direction: Phi(q, qd, qdd) of regrouped segments.

This is the recursion of `textbook` (Luh, Walker, Paul, 1980), with its terms grouped otherwise. With directions e_t
fixed in a body, S = sum s_t e_t, links d = sum l_t e_t and P = sum p_tu e_t e_uT, the moment about its origin is

    N = sum e_t x V_t,    V_t = s_t a0 + sum p_tu U e_u + sum l_t F_child,    F = m a0 + sum s_t U e_t + sum F_child

So one product U e_t serves link, first and second moment. External wrenches are subtracted, and moments of children
added; the spin inertia 2 r adds 2 r (wp e + w OM x e).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from mbsgen.algebra.vectors import Vector
from mbsgen.formulations.links import AppliedWrench
from mbsgen.formulations.parsimony.motion import Kinematics, Movement
from mbsgen.formulations.parsimony.regrouping import RegroupedInertia, guard_divisor
from mbsgen.formulations.parsimony.segments import Segment, children, unit_vector
from mbsgen.formulations.parsimony.writing import Writing
from mbsgen.tape.builder import Builder, Scalar


@dataclass(frozen=True)
class Load:
    """The force, and the moment about the body's origin, that a joint transmits, where the body is written."""

    F: Vector[Scalar]
    N: Vector[Scalar]
    alone: Vector[Scalar]  # N without the moments of bodies that have relative angles


def unloaded(builder: Builder) -> Load:
    """Make no load."""
    none = Vector(builder.zero, builder.zero, builder.zero)
    return Load(none, none, none)


@dataclass(frozen=True)
class Direction:
    """A direction fixed in a body, where the body is written, with its length and its field."""

    e: Vector[Scalar]
    length: Scalar | None  # None: a unit vector
    Ue: Vector[Scalar]

    def share(self, amount: Scalar) -> Scalar:
        """Convert an amount along the unit vector to an amount along e."""
        if self.length is None:
            return amount
        return _one(amount) if amount.ref == self.length.ref else amount / self.length


def _one(scalar: Scalar) -> Scalar:
    return scalar.builder.number(1.0)


def residual(writing: Writing, qd: Sequence[Scalar], qdd: Sequence[Scalar], *, absolute: bool = False) -> list[Scalar]:
    """Compute Phi: the joint forces of the given motion; or, with `absolute`, the forces of absolute rates.

    Forces of absolute rates are along the positive axes. For a body in a group of parallel axes, the force is its
    joint's moment less the moments of the joints that continue the group. Both include the rotors' forces: a joint with
    a rotor has its own angle as absolute coordinate.
    """
    kinematics, inertias = writing.kinematics, writing.inertias
    segments = kinematics.segments
    movements = kinematics.move(writing.chain.gravity, qd, qdd)
    loads: dict[int, Load] = {}
    for segment in reversed(segments):
        loads[segment.number] = join_loads(
            kinematics, segment, inertias[segment.number], movements[segment.number], loads
        )
    felt = [_along(s, loads[s.number], absolute=absolute) for s in segments]
    rotors = (rotor * a for rotor, a in zip(writing.chain.armatures, qdd, strict=True))
    return [
        force + (s.signed(rotor) if absolute else rotor) for s, force, rotor in zip(segments, felt, rotors, strict=True)
    ]


def _along(segment: Segment, load: Load, *, absolute: bool) -> Scalar:
    if absolute:
        return (load.alone if segment.is_revolute else load.F)[segment.axis]
    return segment.signed((load.N if segment.is_revolute else load.F)[segment.axis])


def join_loads(
    kinematics: Kinematics,
    segment: Segment,
    inertia: RegroupedInertia,
    movement: Movement,
    loads: dict[int, Load],
    *,
    slack: bool = False,
) -> Load:
    """Add to a body's own load what its joints carry, and what acts on it from outside.

    slack: leave out the force of a point mass along its joint's axis.
    """

    def write() -> Load:
        return _join_loads(kinematics, segment, inertia, movement, loads, slack=slack)

    if segment.wrenches:  # components in the base frame need the frames of all bodies before
        return write()
    beyond = [c.number for c in children(kinematics.segments, segment.number)]
    parts = (*(loads[i] for i in beyond), *(kinematics.frames[i] for i in beyond))
    return kinematics.builder.remember(
        ("loads", slack, kinematics.plan[segment.number].scaled, kinematics.plan.by_runtime),
        (segment, inertia, movement, kinematics.frames[segment.number], *parts),
        write,
    )


def _join_loads(
    kinematics: Kinematics,
    segment: Segment,
    inertia: RegroupedInertia,
    movement: Movement,
    loads: dict[int, Load],
    *,
    slack: bool,
) -> Load:
    directions = directions_of(kinematics, segment, inertia, movement)
    F, N, V = inertial_load(kinematics.builder, segment, inertia, movement, directions)
    zero = kinematics.builder.zero
    if slack:
        F = Vector.of(zero if r == segment.axis else x for r, x in enumerate(F))
        V[inertia.direction] = F
    grouped = Vector(zero, zero, zero)
    for child in children(kinematics.segments, segment.number):
        force, moment = (kinematics.depart(child, x) for x in (loads[child.number].F, loads[child.number].N))
        if child.counts_angle:
            N = N + moment
        else:
            grouped = grouped + moment
        F = F + force
        for t, direction in enumerate(directions):
            V[t] = V[t] + force.scale(direction.share(child.d[t]))
        if not child.is_revolute:
            N = N + slide_lever(kinematics, child).cross(force)
    for t, direction in enumerate(directions):
        N = N + direction.e.cross(V[t])
    for wrench in segment.wrenches:
        force, moment = (_write_part(kinematics, segment, wrench, v) for v in (wrench.force, wrench.moment))
        F, N = F - force, N - moment - kinematics.fixed(segment.number, wrench.position).cross(force)
    i = segment.number
    kinematics.builder.label((*F, *(N + grouped)), [f"{x}{r}_{i}" for x in "FN" for r in "123"])
    return Load(F, N + grouped, N)


def _write_part(kinematics: Kinematics, segment: Segment, wrench: AppliedWrench, v: Vector[Scalar]) -> Vector[Scalar]:
    """Write an external force or moment in the frame that its body is written in."""
    return kinematics.arrive_from_base(segment, v) if wrench.in_base else kinematics.fixed(segment.number, v)


def slide_lever(kinematics: Kinematics, child: Segment) -> Vector[Scalar]:
    """Return the displacement of a prismatic child, where its parent is written."""
    e = child.turn.column(child.axis) if child.turn else unit_vector(kinematics.builder, child.axis)
    return kinematics.fixed(child.parent, e.scale(kinematics.slide(child)))


def directions_of(
    kinematics: Kinematics, segment: Segment, inertia: RegroupedInertia, movement: Movement
) -> list[Direction]:
    """List a body's own axes as directions, with the lengths that the plan gives them."""
    found = []
    for t, e in enumerate(kinematics.frames[segment.number].directions):
        length = None
        if inertia.radius is not None and t == inertia.direction:
            length = inertia.radius
        elif kinematics.plan[segment.number].scaled and t != segment.axis:
            links = [c.d[t] for c in children(kinematics.segments, segment.number) if not c.d[t].is_zero]
            length = links[0] if links else None
            if length is not None:
                kinematics.plan.check_divisor(length)
                guard_divisor(segment, length, length.builder.zero)
        e = e if length is None else e.scale(length)
        found.append(Direction(e, length, movement.field(e)))
    return found


def inertial_load(
    builder: Builder, segment: Segment, inertia: RegroupedInertia, movement: Movement, directions: Sequence[Direction]
) -> tuple[Vector[Scalar], Vector[Scalar], list[Vector[Scalar]]]:
    """Form a body's own force, the moment of its spin inertia, and its V by direction."""
    still = Vector(builder.zero, builder.zero, builder.zero)
    if inertia.radius is not None:  # a point mass: its force acts at the end of its direction
        F = (movement.a0 + directions[inertia.direction].Ue).scale(inertia.m)
        V = [F if t == inertia.direction else still for t in range(3)]
        return F, _spin_moment(builder, segment, inertia, movement), V
    F, V = movement.a0.scale(inertia.m), []
    for t, direction in enumerate(directions):
        F = F + direction.Ue.scale(direction.share(inertia.S[t]))
        v = movement.a0.scale(direction.share(inertia.S[t]))
        for u, other in enumerate(directions):
            v = v + other.Ue.scale(other.share(direction.share(inertia.P[t, u])))
        V.append(v)
    return F, _spin_moment(builder, segment, inertia, movement), V


def _spin_moment(builder: Builder, segment: Segment, inertia: RegroupedInertia, movement: Movement) -> Vector[Scalar]:
    """Form the moment of the spin inertia: 2 r (wp e + w OM x e)."""
    j, k = segment.across
    spin = builder.number(2.0) * inertia.half_spin
    parts = {
        segment.axis: spin * movement.wp,
        j: spin * (movement.w * movement.q),
        k: -(spin * (movement.w * movement.p)),
    }
    return Vector.of(parts[t] for t in range(3))
