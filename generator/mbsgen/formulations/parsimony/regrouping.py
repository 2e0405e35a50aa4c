"""Regrouping: inertia that a joint cannot feel moves to the body that carries it; base inertial parameters.

Points on a revolute joint's axis belong to both of its bodies. So any mass m, first moment s and second moment p spread
on the axis may change sides: all of p and s leave the body, and as much of the mass as the plan says. One transverse
second moment r is then split off: diag(r, r, 0) = diag(r, r, -r) + r e eT, with e along the axis. The first part has
only the spin inertia 2 r about the axis, and stays. The second part lies on the axis, and moves. On a prismatic joint
all of P moves to the parent. Moments that reach the base are dropped.
(Khalil, Kleinfinger, 1987; Gautier, 1991; for the free mass, Niemeyer, Slotine, 1991.)
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial, reduce
from operator import add

from mbsgen.algebra.vectors import Matrix, Vector, outer
from mbsgen.formulations.parsimony.plan import Choice, Mass, NoSuchPlanError, Plan
from mbsgen.formulations.parsimony.segments import Moments, Segment, children, unit_matrix
from mbsgen.tape.builder import Builder, Scalar
from mbsgen.tape.types import Op

LARGEST_MOVE = 10.0  # times the mass of all bodies
ROUNDING = 1024.0  # epsilons: the least size of a difference that is divided by

Fits = Callable[[int, Moments], bool]  # whether these moments may move from a body to its parent


@dataclass(frozen=True)
class RegroupedInertia:
    """The inertia of a body after regrouping. All moments are about its origin, in its own frame."""

    m: Scalar
    S: Vector[Scalar]  # nothing along the axis of a revolute joint
    P: Matrix[Scalar]  # less the transverse moment that became spin inertia
    half_spin: Scalar  # half the spin inertia about the axis
    radius: Scalar | None  # a point mass: its distance from the origin ...
    direction: int  # ... along this axis


@dataclass(frozen=True)
class Transfer:
    """The moments that move from a body to its parent: about the parent's origin, in the parent's frame."""

    moments: Moments
    cancels: int | None = None  # the axis along which they make the parent's first moment vanish

    def join(self, own: Moments) -> Moments:
        """Add the transfer to the parent's own moments."""
        sum_ = own + self.moments
        zero = sum_.m.builder.zero
        return sum_ if self.cancels is None else Moments(sum_.m, _clear(zero, sum_.S, self.cancels), sum_.P)


def keep(builder: Builder, segments: Sequence[Segment]) -> dict[int, RegroupedInertia]:
    """Keep the moments of every body."""
    return {
        s.number: RegroupedInertia(s.moments.m, s.moments.S, s.moments.P, builder.zero, radius=None, direction=0)
        for s in segments
    }


def regroup(builder: Builder, segments: Sequence[Segment], plan: Plan) -> Mapping[int, RegroupedInertia]:
    """Regroup from the leaves to the base. Raises NoSuchPlanError for a plan that does not fit."""
    write = partial(_regroup, builder, segments, plan)
    return builder.remember(("regrouped", plan.by_runtime, *plan.moved), (segments,), write)  # all it depends on


def _regroup(builder: Builder, segments: Sequence[Segment], plan: Plan) -> Mapping[int, RegroupedInertia]:
    inertias: dict[int, RegroupedInertia] = {}
    gathered = {s.number: s.moments for s in segments}
    total = reduce(add, (s.moments.m for s in segments))
    for segment in reversed(segments):
        beyond, balancing = _carried(segments, segment, plan)
        own = gathered[segment.number]
        for child in (*beyond, *balancing):
            inertias[child.number], _, own = _move(builder, child, gathered[child.number], plan, own, total)
        gathered[segment.number] = own
    for segment in children(segments, 0):
        own, choice = gathered[segment.number], plan[segment.number]
        inertias[segment.number] = builder.remember(
            ("rest", choice.mass, choice.spin_from),
            (segment, own),
            partial(_rest_on_base, builder, segment, own, choice),
        )
    return inertias


def _move(
    builder: Builder, child: Segment, own: Moments, plan: Plan, parent: Moments, total: Scalar
) -> tuple[RegroupedInertia, Moments, Moments]:
    """Split a body's moments: return the rest, what moves to the parent, and the parent's moments with it."""
    choice = plan[child.number]

    def move() -> tuple[RegroupedInertia, Moments, Moments]:
        rest, transfer = _part(builder, child, own, plan, parent, total)
        return rest, transfer.moments, transfer.join(parent)

    return builder.remember(
        ("part", choice.mass, choice.spin_from, plan.by_runtime, total.ref), (child, own, parent), move
    )


def restrain(builder: Builder, segments: Sequence[Segment], plan: Plan, fits: Fits) -> Plan:
    """Change a plan where a transfer does not fit: move something else, or nothing. Raises NoSuchPlanError.

    Moments that are kept count as moved for the bodies nearer to the base. So in a long chain all of these keep theirs,
    not one here and there: cost grows evenly with the number of bodies.
    """
    gathered = {s.number: s.moments for s in segments}
    total = reduce(add, (s.moments.m for s in segments))
    for segment in reversed(segments):
        beyond, balancing = _carried(segments, segment, plan)
        own = gathered[segment.number]
        for child in (*beyond, *balancing):
            for choice in _alternatives(plan[child.number]):
                plan = plan.put(child.number, choice)
                _, moved, joined = _move(builder, child, gathered[child.number], plan, own, total)
                if fits(child.number, moved):
                    break
            else:
                plan = plan.put(child.number, replace(choice, mass=Mass.KEPT))
            own = joined
        gathered[segment.number] = own
    return plan


def _carried(
    segments: Sequence[Segment], segment: Segment, plan: Plan
) -> tuple[tuple[Segment, ...], tuple[Segment, ...]]:
    """List the children of a body: the children that do not balance it, and the child that does, if any."""
    beyond = children(segments, segment.number)
    balancing = tuple(s for s in beyond if plan[s.number].mass is Mass.BALANCING)
    if len(balancing) > 1:
        raise NoSuchPlanError("one child can balance a body, not several")
    return tuple(s for s in beyond if s not in balancing), balancing


def _alternatives(choice: Choice) -> Iterator[Choice]:
    """List the transfers of a body, in the order of trial: the planned one; the free mass, with spin from each axis."""
    if choice.mass is not Mass.PASSED:
        yield choice
    yield replace(choice, mass=Mass.PASSED)
    yield replace(choice, mass=Mass.PASSED, spin_from=1 - choice.spin_from)


def _part(
    builder: Builder, segment: Segment, own: Moments, plan: Plan, parent: Moments, total: Scalar
) -> tuple[RegroupedInertia, Transfer]:
    """Split a body's moments: the rest, and the transfer to the parent, whose moments so far are `parent`."""
    zero, axis, choice = builder.zero, segment.axis, plan[segment.number]
    if segment.floats and choice.mass not in (Mass.PASSED, Mass.KEPT):
        raise NoSuchPlanError("nothing moves from a frame that a quaternion turns")
    if choice.mass is Mass.KEPT or segment.floats:
        return RegroupedInertia(own.m, own.S, own.P, zero, radius=None, direction=0), Transfer(_nothing(builder))
    turn = segment.turn or unit_matrix(builder)
    if not segment.is_revolute:
        if choice.mass is not Mass.PASSED:
            raise NoSuchPlanError("mass cannot move along a prismatic joint")
        flat = own.P.map(lambda _: zero)
        moved = Moments(zero, own.S.map(lambda _: zero), turn.times(own.P).times(turn.transposed))
        return RegroupedInertia(own.m, own.S, flat, zero, radius=None, direction=0), Transfer(moved)
    half_spin = own.P[segment.across[choice.spin_from], segment.across[choice.spin_from]]
    e = turn.column(axis)
    along, second = own.S[axis], own.P[axis, axis] + half_spin
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
    P = _without_spin(builder, segment, own.P, half_spin)
    return RegroupedInertia(own.m - m, _clear(zero, own.S, axis), P, half_spin, radius, direction), Transfer(
        moved, cancels
    )


def _nothing(builder: Builder) -> Moments:
    still = Vector(builder.zero, builder.zero, builder.zero)
    return Moments(builder.zero, still, Matrix((still, still, still)))


def _rest_on_base(builder: Builder, segment: Segment, own: Moments, choice: Choice) -> RegroupedInertia:
    """Keep the inertia of a body on the base that its joint can feel."""
    zero = builder.zero
    if choice.mass is not Mass.PASSED:
        raise NoSuchPlanError("the base takes all mass")
    if not segment.is_revolute:
        return RegroupedInertia(own.m, own.S, own.P.map(lambda _: zero), zero, radius=None, direction=0)
    half_spin = own.P[segment.across[choice.spin_from], segment.across[choice.spin_from]]
    S = _clear(zero, own.S, segment.axis)
    P = _without_spin(builder, segment, own.P, half_spin)
    return RegroupedInertia(zero, S, P, half_spin, radius=None, direction=0)


def _check_size(moved: Scalar, total: Scalar) -> None:
    """Refuse to move a mass that dwarfs the mechanism's: its differences would lose digits."""
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
    """Refuse parameters by which a divisor is 0, or within the rounding of the given scale."""
    if not divisor.is_literal:
        divisor.builder.guard(divisor.builder.apply(Op.ABS, divisor), scale, ROUNDING, segment.number, early=True)


def _without_spin(builder: Builder, segment: Segment, P: Matrix[Scalar], half_spin: Scalar) -> Matrix[Scalar]:
    zero, axis = builder.zero, segment.axis
    rows = [[P[r, c] for c in range(3)] for r in range(3)]
    rows[axis][axis] = zero
    for k in segment.across:
        rows[k][k] = rows[k][k] - half_spin
    return Matrix.of(rows)


def _on_axis(m: Scalar, s: Scalar, p: Scalar, d: Vector[Scalar], e: Vector[Scalar]) -> Moments:
    """Return the moments about the parent's origin of m, s and p spread on the axis e through d."""
    along = e.scale(s)
    P = outer(d.scale(m), d) + outer(d, along) + outer(along, d) + outer(e.scale(p), e)
    return Moments(m, d.scale(m) + along, P)


def _lever(segment: Segment) -> int:
    """Return the axis of the parent along which the link to `segment` is longest, among known lengths."""
    along = [k for k in range(3) if not segment.d[k].is_zero]
    if not along:
        raise NoSuchPlanError("there is no link between the two joints")
    return max(along, key=lambda k: abs(segment.d[k].literal or 0.0))


def _percussion(segment: Segment, own: Moments, plan: Plan, total: Scalar) -> tuple[Scalar, Scalar, int]:
    """Return the mass, distance and direction of the point with a body's S and P, without its spin inertia."""
    choice = plan[segment.number]
    k, other = segment.across[1 - choice.spin_from], segment.across[choice.spin_from]
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
