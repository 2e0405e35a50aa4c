"""Order-N form (EXP2): Tree -> Tape of qdd = nu(q, qd, Q) by articulated bodies; O(n) equations.

Docquier, Bruls, Fisette, eq. (19); Schwertassek, Rulka (1989); Featherstone (1983). The recursion is in
`parsimony.articulated`.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

from mbsgen.algebra.dense import find_eigen
from mbsgen.algebra.vectors import Vector
from mbsgen.formulations import ports
from mbsgen.formulations.chain import joint_forces, write_chain
from mbsgen.formulations.condition import give_way
from mbsgen.formulations.parsimony.articulated import Body, accelerations
from mbsgen.formulations.parsimony.proportions import turn_moments
from mbsgen.formulations.parsimony.segments import Segment, align, children, feels_itself, largest_inertias
from mbsgen.formulations.parsimony.writing import Writing, begin
from mbsgen.formulations.planning import find_least_shares, find_plans, finish
from mbsgen.formulations.reductions import ALL, Reductions
from mbsgen.formulations.states import declare_state
from mbsgen.model.tree import Tree
from mbsgen.tape.builder import Builder, Scalar
from mbsgen.tape.types import Tape

# A pivot must stand out of the rounding of the largest inertia that its joint can feel: this bounds the numbers whose
# difference it is. Where axes are in line, it is a sum of products: there, a pivot above rounding is exact enough.
# Elsewhere a result errs by up to 2.5 epsilon over the pivot's ratio to the largest inertia: from 2.5e6 epsilon on,
# errors stay below 1e-6, as in EXP1.
#
# Where the joint's own body has inertia about the axis, the pivot is at least that. Two joints without mass before a
# body that is no rod, all axes through one point: the first pivot is the square of a sine or a cosine times an inertia
# of the body. Nothing is subtracted, so the pivot is right however small it is. It is only bounded where the rounding
# of the angle itself decides, some 1e-14 rad from the lock.
#
# So a joint is safe where the inertia that stays in any position, the body's or the least of the next one with mass, is
# known to be above SURE of the largest: errors then stay below 1e-6. Where numbers are set at run time, their values at
# generation decide, with room for others; beyond it, there is a status. At other joints, as before a tip 1e9 times as
# heavy or a rod on massless joints, pivots say too little: the estimate of `condition` is computed along, and decides.
PIVOT_TOLERANCE = 8.0
OWN_TOLERANCE = 2.0
LOCKING_TOLERANCE = 2.5e6
PRODUCT_TOLERANCE = 1e-12
ESTIMATE_TOLERANCE = 1e3  # the estimate promises errors of 5e-4, and in single precision of 2e-3
ROUNDED_TOLERANCE = 2.5e3  # of inertias that are computed at run time, and rounded beside the largest of their body
WITHOUT_MASS = (PIVOT_TOLERANCE, PRODUCT_TOLERANCE, ROUNDED_TOLERANCE)
ROUND = 1e-3  # the least moment of inertia of such a body, relative to the largest inertia that the joint can feel
SURE = 1e-9  # least inertia relative to the largest, where both are known
SURE_AT_RUN_TIME = 1e-4  # the same by the values at generation of numbers that are set later; single precision has 3e-5


def build(tree: Tree, reductions: Reductions = ALL) -> Tape:
    """Write `exp2`: inputs q, qd, u [, w] [, p]; output qdd, shape (n,). Fails at the joint whose pivot is lost."""
    builder = Builder()
    state = declare_state(tree, builder, accelerations=False)
    chain = write_chain(tree, builder, state)
    segments = align(chain, group=reductions.share_frames)
    largest = largest_inertias(chain, segments)
    demands = _find_demands(tree, segments, largest, find_least_shares(tree, reductions))
    doubtful = {i for i, demand in demands.items() if demand.is_doubtful}
    plan = find_plans(tree, reductions).articulated
    if doubtful:  # their estimate is of the recursion
        plan = replace(plan, together=0)
    writing = begin(chain, segments, plan, reductions)
    found = accelerations(writing, state.qd, joint_forces(chain), absolute=reductions.absolute)
    for i, demand in demands.items():
        if demand.is_rod:
            P = segments[i - 1].moments.P
            one, other = segments[i - 1].across
            builder.guard(P[one, one] + P[other, other], P[0, 0] + P[1, 1] + P[2, 2], ROUNDED_TOLERANCE, i)
        builder.guard(found.pivots[i], largest[i], demand.tolerance, i)
    if doubtful:
        _guard_estimates(writing, found.bodies, doubtful)
    builder.output_dense(ports.ACCELERATIONS, [[x] for x in found.qdd])
    return finish(builder.build("exp2"), reductions)


@dataclass(frozen=True)
class _Demand:
    """The demand on the pivot of a joint."""

    tolerance: float
    is_doubtful: bool = False  # the estimate decides besides
    is_rod: bool = False  # its body may lack inertia about the axis


def _find_demands(
    tree: Tree, segments: Sequence[Segment], largest: Mapping[int, Scalar], shares: Mapping[int, float]
) -> dict[int, _Demand]:
    """Return the demands, from the leaves to the base."""
    demands = {}
    for segment in reversed(segments):
        i = segment.number
        tolerance, is_known = _choose_tolerance(segments, segment, largest[i]), largest[i].literal is not None
        if tolerance not in (OWN_TOLERANCE, PIVOT_TOLERANCE) or (is_known and shares[i] >= SURE):
            demands[i] = _Demand(tolerance)  # its pivot stands out in any position
        elif shares[i] >= SURE_AT_RUN_TIME and not _is_pair(tree, segments, segment):
            demands[i] = _Demand(LOCKING_TOLERANCE)
        elif not is_known and not feels_itself(segment):
            demands[i] = _Demand(ROUNDED_TOLERANCE, is_doubtful=True)
        else:
            demands[i] = _Demand(tolerance, is_doubtful=True, is_rod=not is_known and segment.is_revolute)
    return demands


def _guard_estimates(writing: Writing, bodies: Mapping[int, Body], doubtful: Collection[int]) -> None:
    """Demand digits of the joints in doubt, and of the bodies beyond them, which round what these joints feel."""
    builder, segments = writing.chain.builder, writing.kinematics.segments
    _, lost = give_way(writing.kinematics, bodies)
    concerned: set[int] = set()
    for segment in segments:
        if segment.number in doubtful or segment.parent in concerned:
            concerned.add(segment.number)
    for i in sorted(concerned, reverse=True):
        builder.guard(builder.number(1.0), lost[i], ESTIMATE_TOLERANCE, i)


def _choose_tolerance(segments: Sequence[Segment], segment: Segment, largest: Scalar) -> float:
    if _may_lock(segments, segment):
        return LOCKING_TOLERANCE
    if feels_itself(segment):
        return OWN_TOLERANCE
    return PRODUCT_TOLERANCE if _is_product(segments, segment, largest) else PIVOT_TOLERANCE


def _is_pair(tree: Tree, segments: Sequence[Segment], segment: Segment) -> bool:
    """Return whether two joints without mass follow each other; a quaternion's are at rest, and never lock."""
    if feels_itself(segment) or any(segment.number in x.bodies for x in tree.quaternions):
        return False
    return any(not feels_itself(child) for child in children(segments, segment.number))


def _find_moments(segment: Segment) -> tuple[float, ...] | None:
    """Return the principal moments of inertia of a body about its origin, ascending; None unless they are known."""
    P = tuple(tuple(segment.moments.P[r, c].literal for c in range(3)) for r in range(3))
    if any(x is None for row in P for x in row):
        return None
    return find_eigen(turn_moments(P))[0]


def _is_product(segments: Sequence[Segment], segment: Segment, largest: Scalar) -> bool:
    """Return whether a massless joint has one more massless joint, and then a known body that is no rod."""
    following = children(segments, segment.number)
    if len(following) != 1 or feels_itself(following[0]):
        return False
    beyond = children(segments, following[0].number)
    if len(beyond) != 1 or not feels_itself(beyond[0]) or largest.literal is None:
        return False
    moments = _find_moments(beyond[0])
    return moments is not None and bool(moments[0] >= ROUND * float(largest.literal))


def _may_lock(segments: Sequence[Segment], segment: Segment) -> bool:
    """Return whether a joint feels only inertia off its axis or askew, so that its pivot is a difference."""
    return not feels_itself(segment) and any(
        child.turn is not None or not _is_null(child.d) or (_is_massless(child) and _may_lock(segments, child))
        for child in children(segments, segment.number)
    )


def _is_massless(segment: Segment) -> bool:
    return all(segment.moments.P[k, k].is_zero for k in range(3)) and segment.moments.m.is_zero


def _is_null(v: Vector[Scalar]) -> bool:
    return all(x.is_zero for x in v)
