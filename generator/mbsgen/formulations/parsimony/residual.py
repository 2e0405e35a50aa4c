"""Newton-Euler residual, direction by direction: Phi(q, qd, qdd) of regrouped segments.

This is the recursion of `textbook` (Luh, Walker, Paul, 1980), with its terms grouped otherwise. With directions e_t
fixed in a body, S = sum s_t e_t, links d = sum l_t e_t and P = sum p_tu e_t e_uT, the moment about its origin is

    N = sum e_t x V_t,    V_t = s_t a0 + sum p_tu U e_u + sum l_t F_child,    F = m a0 + sum s_t U e_t + sum F_child

So one product U e_t serves link, first and second moment. External wrenches are subtracted, and moments of children
added; the spin inertia 2 r adds 2 r (wp e + w OM x e).

*Momentum.* The axis e of a joint is fixed in both of its bodies, so OM x e is the same with OM of either. The momentum
h = 2 r w along it may turn with the body before, OM x h e, together with the momenta of other joints there.

*Rates.* A second moment p in the direction e needs e x p U e = p (OMp - (e.OMp) e) - p (e.OM) (OM x e): angular
acceleration across e, and a momentum -p e.OM that turns. In a frame that does not turn with the body, U splits instead:
across the axis, w and wp add -w2 r + wp e x r to U r, so that e x p U e is p wp along the axis, and the rest of U is of
the group.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product

from mbsgen.algebra.vectors import Vector
from mbsgen.formulations.links import AppliedWrench
from mbsgen.formulations.parsimony.motion import Kinematics, Movement, by_axis
from mbsgen.formulations.parsimony.regrouping import RegroupedInertia, guard_divisor
from mbsgen.formulations.parsimony.segments import Segment, children, unit_vector
from mbsgen.formulations.parsimony.writing import Writing
from mbsgen.tape.builder import Builder, Scalar


@dataclass(slots=True, unsafe_hash=True)  # as if frozen: many are made
class Force:
    """A force with its moment about the origin of the body that it is written at."""

    F: Vector[Scalar]
    N: Vector[Scalar]

    def __add__(self, other: Force) -> Force:
        return Force(self.F + other.F, self.N + other.N)


@dataclass(slots=True, unsafe_hash=True)  # as if frozen: many are made
class Load(Force):
    """The force, and the moment about the body's origin, that a joint transmits, where the body is written."""

    alone: Vector[Scalar]  # N without the moments of bodies that have relative angles
    momentum: Scalar | None = None  # along the joint's axis: its rate of change is not in N; it turns with the parent


def unloaded(builder: Builder, momentum: Scalar | None = None) -> Load:
    """Make no load but a momentum."""
    none = Vector(builder.zero, builder.zero, builder.zero)
    return Load(none, none, none, momentum)


@dataclass(slots=True, unsafe_hash=True)  # as if frozen: many are made
class _Inertial:
    """A body's own load without its spin inertia."""

    F: Vector[Scalar]
    N: Vector[Scalar]
    V: list[Vector[Scalar]]  # by direction
    momentum: Vector[Scalar]  # in its own frame: its rate of change is not in N
    felt: Scalar  # more inertia along the axis


@dataclass(slots=True, unsafe_hash=True)  # as if frozen: many are made
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
    loads: Mapping[int, Load],
    *,
    slack: bool = False,
    passes: bool = True,
    grouped: bool = True,
) -> Load:
    """Add to a body's own load what its joints carry, and what acts on it from outside.

    slack: leave out the force of a point mass along its joint's axis. passes: momentum may turn with the parent.
    grouped: include the bodies that continue the group.
    """
    choice = kinematics.plan[segment.number]
    passes = passes and choice.passes_spin and segment.parent != 0
    beyond = [c.number for c in children(kinematics.segments, segment.number) if grouped or c.opens_group]
    loads = {i: loads[i] for i in beyond}

    def write() -> Load:
        return _join_loads(kinematics, segment, inertia, movement, loads, slack=slack, passes=passes)

    if segment.wrenches:  # components in the base frame need the frames of all bodies before
        return write()
    parts = (*(loads[i] for i in beyond), *(kinematics.frames[i] for i in beyond))
    return kinematics.builder.remember(
        ("loads", slack, passes, choice.scaled, choice.by_rates, kinematics.plan.by_runtime),
        (segment, inertia, movement, kinematics.frames[segment.number], *parts),
        write,
    )


def _join_loads(
    kinematics: Kinematics,
    segment: Segment,
    inertia: RegroupedInertia,
    movement: Movement,
    loads: Mapping[int, Load],
    *,
    slack: bool,
    passes: bool,
) -> Load:
    directions = directions_of(kinematics, segment, inertia, movement)
    own, spin = _inertial_load(kinematics, segment, inertia, movement, directions), _double(inertia.half_spin)
    F, N, V, zero = own.F, own.N, own.V, kinematics.builder.zero
    along, others = _gather_momentum(kinematics, loads)
    N = N.along(segment.axis, (spin + own.felt) * movement.wp)
    if along.is_zero and not passes:  # products of rates that U has too
        N = N + _turn(kinematics, segment, movement, zero, others + own.momentum)
        N = N + _turn_spin(segment, movement, spin)
    else:
        along = along + spin * movement.w
        N = N + _turn(kinematics, segment, movement, zero if passes else along, others + own.momentum)
    if slack:
        F = Vector.of(zero if r == segment.axis else x for r, x in enumerate(F))
        V[inertia.direction] = F
    grouped = Vector(zero, zero, zero)
    for child in (kinematics.segments[i - 1] for i in loads):
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
    return Load(F, N + grouped, N, along if passes else None)


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
    axes, lengths = kinematics.frames[segment.number].directions, lengths_of(kinematics, segment, inertia)
    for e, length in zip(axes, lengths, strict=True):
        scaled = e if length is None else e.scale(length)
        found.append(Direction(scaled, length, movement.field(scaled)))
    return found


def lengths_of(kinematics: Kinematics, segment: Segment, inertia: RegroupedInertia) -> list[Scalar | None]:
    """List the lengths of a body's directions; None: a unit vector."""
    found: list[Scalar | None] = [None] * 3
    for t in range(3):
        if inertia.radius is not None and t == inertia.direction:
            found[t] = inertia.radius
        elif kinematics.plan[segment.number].scaled and t != segment.axis:
            links = [c.d[t] for c in children(kinematics.segments, segment.number) if not c.d[t].is_zero]
            found[t] = length = links[0] if links else None
            if length is not None:
                kinematics.plan.check_divisor(length)
                guard_divisor(segment, length, length.builder.zero)
    return found


def _gather_momentum(kinematics: Kinematics, loads: Mapping[int, Load]) -> tuple[Scalar, Vector[Scalar]]:
    """Sum the momenta that turn with a body: of joints that continue its group, along its axis; of others, in its own
    frame.
    """
    zero = kinematics.builder.zero
    along, others = zero, Vector(zero, zero, zero)
    for child in (kinematics.segments[i - 1] for i in loads):
        momentum = loads[child.number].momentum
        if momentum is None:
            continue
        if child.opens_group:
            e = child.turn.column(child.axis) if child.turn else unit_vector(kinematics.builder, child.axis)
            others = others + e.scale(momentum)
        else:
            along = along + momentum
    return along, others


def _double(x: Scalar) -> Scalar:
    return x.builder.number(2.0) * x


def _turn_spin(segment: Segment, movement: Movement, spin: Scalar) -> Vector[Scalar]:
    """Form the moment of the spin inertia across the axis: spin w OM x e."""
    first = spin * (movement.w * movement.q)
    return by_axis(segment, spin.builder.zero, first, -(spin * (movement.w * movement.p)))


def _turn(
    kinematics: Kinematics, segment: Segment, movement: Movement, along: Scalar, others: Vector[Scalar]
) -> Vector[Scalar]:
    """Form the moment OM x h of momenta that turn with a body."""
    across = by_axis(segment, kinematics.builder.zero, along * movement.q, -(along * movement.p))
    OM = kinematics.angular_velocity(segment, movement)
    return across + OM.cross(kinematics.fixed(segment.number, others))


def _inertial_load(
    kinematics: Kinematics,
    segment: Segment,
    inertia: RegroupedInertia,
    movement: Movement,
    directions: Sequence[Direction],
) -> _Inertial:
    """Form a body's own load without its spin inertia."""
    zero = kinematics.builder.zero
    still = Vector(zero, zero, zero)
    if inertia.radius is not None:  # a point mass: its force acts at the end of its direction
        F = (movement.a0 + directions[inertia.direction].Ue).scale(inertia.m)
        return _Inertial(F, still, [F if t == inertia.direction else still for t in range(3)], still, zero)
    F, V = movement.a0.scale(inertia.m), []
    for direction, s in zip(directions, inertia.S, strict=True):
        F = F + direction.Ue.scale(direction.share(s))
        V.append(movement.a0.scale(direction.share(s)))
    N, momentum, felt, rates = still, still, zero, _list_rates(kinematics, segment, directions)
    OM, OMp = kinematics.angular_velocity(segment, movement), kinematics.angular_acceleration(segment, movement)
    is_turned = kinematics.frames[segment.number].rest is not None
    for t, u in product(range(3), repeat=2):
        p = inertia.P[t, u]
        if p.is_zero and not is_turned:
            continue
        by_rates = {t, u} <= rates
        if by_rates and t == u and not is_turned:
            N = N + Vector.of(zero if r == t else x * p for r, x in enumerate(OMp))
            momentum = momentum + unit_vector(kinematics.builder, t).scale(-(OM[t] * p))
            continue
        Ue = directions[u].Ue
        if by_rates and is_turned:
            Ue = movement.field_of_group(segment, directions[u].e)
            felt = felt + p if t == u else felt
        V[t] = V[t] + Ue.scale(directions[u].share(directions[t].share(p)))
    return _Inertial(F, N, V, momentum, felt)


def _list_rates(kinematics: Kinematics, segment: Segment, directions: Sequence[Direction]) -> set[int]:
    """List the directions across a joint's axis whose second moments are by rates."""
    if not (segment.is_revolute and kinematics.plan[segment.number].by_rates):
        return set()
    is_turned = kinematics.frames[segment.number].rest is not None
    return {t for t in segment.across if is_turned or directions[t].length is None}
