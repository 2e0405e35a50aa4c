"""Regrouping: inertia that a joint cannot feel moves to the body that carries it; base inertial parameters.

Points on a revolute joint's axis belong to both of its bodies. So any mass m, first moment s and second moment p spread
on the axis may change sides: all of p and s leave the body, and of the mass as much as the plan says. Of what remains,
one transverse second moment is spread over a ring about the axis, and the ring counted as spin inertia about it less a
second moment along it, which moves too. On a prismatic joint all of P belongs to the parent. What reaches the base is
gone.
(Khalil, Kleinfinger, 1987; Gautier, 1991; for the free mass, Niemeyer, Slotine, 1991.)
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from operator import add

from mbsgen.algebra.vectors import Matrix, Vector, outer
from mbsgen.formulations.parsimony.plan import Choice, Mass, NoSuchPlanError, Plan
from mbsgen.formulations.parsimony.segments import Moments, Segment, children, unit_matrix
from mbsgen.tape.builder import Builder, Scalar
from mbsgen.tape.types import Op

LARGEST_MOVE = 10.0  # times the mass of all bodies
ROUNDING = 1024.0  # epsilons: what a difference by which is divided must stand out of

Fits = Callable[[int, Moments], bool]  # whether these moments may move from a body to its parent


@dataclass(frozen=True)
class Lump:
    """What a body is left with. All moments about its origin, in its own frame."""

    m: Scalar
    S: Vector[Scalar]  # nothing along the axis of a revolute joint
    P: Matrix[Scalar]  # without what the ring holds
    ring: Scalar  # second moment of the ring about the axis; its spin inertia is twice that
    radius: Scalar | None  # a point mass: its distance from the origin ...
    direction: int  # ... along this axis


@dataclass(frozen=True)
class Transfer:
    """What moves from a body to its parent: moments about the parent's origin, in the parent's frame."""

    moments: Moments
    cancels: int | None = None  # the axis along which they make the parent's first moment vanish

    def join(self, own: Moments) -> Moments:
        """Add what moves to the parent's own moments."""
        sum_ = own + self.moments
        zero = sum_.m.builder.zero
        return sum_ if self.cancels is None else Moments(sum_.m, _clear(zero, sum_.S, self.cancels), sum_.P)


def keep(builder: Builder, segments: Sequence[Segment]) -> dict[int, Lump]:
    """Leave every body what it has."""
    return {
        s.number: Lump(s.moments.m, s.moments.S, s.moments.P, builder.zero, radius=None, direction=0) for s in segments
    }


def regroup(builder: Builder, segments: Sequence[Segment], plan: Plan) -> dict[int, Lump]:
    """Regroup from the leaves to the base. Raises NoSuchPlanError for a plan that does not fit."""
    lumps: dict[int, Lump] = {}
    gathered = {s.number: s.moments for s in segments}
    total = reduce(add, (s.moments.m for s in segments))
    for segment in reversed(segments):
        beyond, balancing = _carried(segments, segment, plan)
        own = gathered[segment.number]
        for child in (*beyond, *balancing):
            lumps[child.number], transfer = _part(builder, child, gathered[child.number], plan, own, total)
            own = transfer.join(own)
        gathered[segment.number] = own
    for segment in children(segments, 0):
        lumps[segment.number] = _rest_on_base(builder, segment, gathered[segment.number], plan[segment.number])
    return lumps


def restrain(builder: Builder, segments: Sequence[Segment], plan: Plan, fits: Fits) -> Plan:
    """Change a plan where what it moves does not fit: move something else, or nothing. Raises NoSuchPlanError.

    What is kept counts as moved for the bodies nearer to the base. So in a long chain all of these keep theirs, and not
    one here and there: cost grows evenly with the number of bodies.
    """
    gathered = {s.number: s.moments for s in segments}
    total = reduce(add, (s.moments.m for s in segments))
    for segment in reversed(segments):
        beyond, balancing = _carried(segments, segment, plan)
        own = gathered[segment.number]
        for child in (*beyond, *balancing):
            for choice in _alternatives(plan[child.number]):
                plan = plan.put(child.number, choice)
                _, transfer = _part(builder, child, gathered[child.number], plan, own, total)
                if fits(child.number, transfer.moments):
                    break
            else:
                plan = plan.put(child.number, replace(choice, mass=Mass.KEPT))
            own = transfer.join(own)
        gathered[segment.number] = own
    return plan


def _carried(
    segments: Sequence[Segment], segment: Segment, plan: Plan
) -> tuple[tuple[Segment, ...], tuple[Segment, ...]]:
    """List the children of a body: those that do not balance it, and the one that does, if any."""
    beyond = children(segments, segment.number)
    balancing = tuple(s for s in beyond if plan[s.number].mass is Mass.BALANCING)
    if len(balancing) > 1:
        raise NoSuchPlanError("one child can balance a body, not several")
    return tuple(s for s in beyond if s not in balancing), balancing


def _alternatives(choice: Choice) -> Iterator[Choice]:
    """List what a body may move, in the order of trial: what is planned; the free mass, with either ring."""
    if choice.mass is not Mass.PASSED:
        yield choice
    yield replace(choice, mass=Mass.PASSED)
    yield replace(choice, mass=Mass.PASSED, ring=1 - choice.ring)


def _part(
    builder: Builder, segment: Segment, own: Moments, plan: Plan, parent: Moments, total: Scalar
) -> tuple[Lump, Transfer]:
    """Part a body's moments: what stays, and what moves to the parent, whose moments so far are `parent`."""
    zero, axis, choice = builder.zero, segment.axis, plan[segment.number]
    if segment.floats and choice.mass not in (Mass.PASSED, Mass.KEPT):
        raise NoSuchPlanError("nothing moves from a frame that a quaternion turns")
    if choice.mass is Mass.KEPT or segment.floats:
        return Lump(own.m, own.S, own.P, zero, radius=None, direction=0), Transfer(_nothing(builder))
    turn = segment.turn or unit_matrix(builder)
    if not segment.is_revolute:
        if choice.mass is not Mass.PASSED:
            raise NoSuchPlanError("mass cannot move along a prismatic joint")
        flat = own.P.map(lambda _: zero)
        moved = Moments(zero, own.S.map(lambda _: zero), turn.times(own.P).times(turn.transposed))
        return Lump(own.m, own.S, flat, zero, radius=None, direction=0), Transfer(moved)
    ring = own.P[segment.across[choice.ring], segment.across[choice.ring]]
    e = turn.column(axis)
    along, second = own.S[axis], own.P[axis, axis] + ring
    m, radius, direction, cancels = own.m, None, 0, None
    if choice.mass is Mass.BALANCING:
        k = cancels = _lever(segment)
        if (parent.S[k] + e[k] * along).is_zero and own.m.is_zero:
            raise NoSuchPlanError("there is nothing to balance")
        plan.check_divisor(segment.d[k])
        moment = parent.S[k] + e[k] * along
        guard_quotient(segment, moment, segment.d[k], total)
        m = -moment / segment.d[k]
    elif choice.mass is Mass.POINT:
        staying, radius, direction = _percussion(segment, own, plan, total)
        m = own.m - staying
    _check_size(m, total)
    moved = _on_axis(m, along, second, segment.d, e)
    P = _without_ring(builder, segment, own.P, ring)
    return Lump(own.m - m, _clear(zero, own.S, axis), P, ring, radius, direction), Transfer(moved, cancels)


def _nothing(builder: Builder) -> Moments:
    still = Vector(builder.zero, builder.zero, builder.zero)
    return Moments(builder.zero, still, Matrix((still, still, still)))


def _rest_on_base(builder: Builder, segment: Segment, own: Moments, choice: Choice) -> Lump:
    """Keep of a body on the base what its joint can feel."""
    zero = builder.zero
    if choice.mass is not Mass.PASSED:
        raise NoSuchPlanError("the base takes all mass")
    if not segment.is_revolute:
        return Lump(own.m, own.S, own.P.map(lambda _: zero), zero, radius=None, direction=0)
    ring = own.P[segment.across[choice.ring], segment.across[choice.ring]]
    S = _clear(zero, own.S, segment.axis)
    P = _without_ring(builder, segment, own.P, ring)
    return Lump(zero, S, P, ring, radius=None, direction=0)


def _check_size(moved: Scalar, total: Scalar) -> None:
    """Refuse to move a mass that dwarfs the mechanism's: digits would be lost in the differences that it makes."""
    if moved.literal is not None and total.literal is not None and abs(moved.literal) > LARGEST_MOVE * total.literal:
        raise NoSuchPlanError("the mass to move is out of proportion")


def guard_quotient(segment: Segment, moment: Scalar, divisor: Scalar, total: Scalar) -> None:
    """Refuse parameters by which a mass to move, moment / divisor, would dwarf the mechanism's, or be no number."""
    if not divisor.is_literal:
        builder = divisor.builder
        amount, size = builder.apply(Op.ABS, moment), builder.apply(Op.ABS, divisor)
        room = builder.number(LARGEST_MOVE) * total * size
        builder.guard(room - amount, room, ROUNDING, segment.number, early=True)


def guard_divisor(segment: Segment, divisor: Scalar, scale: Scalar) -> None:
    """Refuse parameters by which a divisor is 0, or no more than the rounding of what has that scale."""
    if not divisor.is_literal:
        divisor.builder.guard(divisor.builder.apply(Op.ABS, divisor), scale, ROUNDING, segment.number, early=True)


def _without_ring(builder: Builder, segment: Segment, P: Matrix[Scalar], ring: Scalar) -> Matrix[Scalar]:
    zero, axis = builder.zero, segment.axis
    rows = [[P[r, c] for c in range(3)] for r in range(3)]
    rows[axis][axis] = zero
    for k in segment.across:
        rows[k][k] = rows[k][k] - ring
    return Matrix.of(rows)


def _on_axis(m: Scalar, s: Scalar, p: Scalar, d: Vector[Scalar], e: Vector[Scalar]) -> Moments:
    """Form the moments about the parent's origin of m, s and p spread on the axis e through d."""
    along = e.scale(s)
    P = outer(d.scale(m), d) + outer(d, along) + outer(along, d) + outer(e.scale(p), e)
    return Moments(m, d.scale(m) + along, P)


def _lever(segment: Segment) -> int:
    """Find the axis of the parent along which the link to `segment` is longest, among lengths that are known."""
    along = [k for k in range(3) if not segment.d[k].is_zero]
    if not along:
        raise NoSuchPlanError("there is no link between the two joints")
    return max(along, key=lambda k: abs(segment.d[k].literal or 0.0))


def _percussion(segment: Segment, own: Moments, plan: Plan, total: Scalar) -> tuple[Scalar, Scalar, int]:
    """Find the mass, distance and direction of the point that has a body's S and P, its ring apart."""
    choice = plan[segment.number]
    k, other = segment.across[1 - choice.ring], segment.across[choice.ring]
    rest = (own.S[other], own.P[k, other], own.P[k, segment.axis], own.P[other, segment.axis])
    if own.S[k].is_zero or not all(x.is_zero for x in rest):
        raise NoSuchPlanError("the body is no pendulum in a plane of symmetry")
    second = own.P[k, k] - own.P[other, other]
    if second.is_zero:
        raise NoSuchPlanError("the body has no centre of percussion")
    plan.check_divisor(second)
    plan.check_divisor(own.S[k])
    guard_quotient(segment, own.S[k] * own.S[k], second, total)
    guard_divisor(segment, second, second.builder.apply(Op.ABS, own.P[k, k]))
    guard_divisor(segment, own.S[k], second.builder.zero)
    return own.S[k] * own.S[k] / second, second / own.S[k], k


def _clear(zero: Scalar, v: Vector[Scalar], axis: int) -> Vector[Scalar]:
    return Vector.of(zero if k == axis else v[k] for k in range(3))
