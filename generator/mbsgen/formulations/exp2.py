"""Order-N form (EXP2): Tree -> Tape of qdd = nu(q, qd, Q) by articulated bodies; O(n) equations.

Docquier, Bruls, Fisette, eq. (19); Schwertassek, Rulka (1989); Featherstone (1983). The recursion is in
`parsimony.articulated`.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mbsgen.algebra.vectors import Vector
from mbsgen.formulations import ports
from mbsgen.formulations.links import declare_state, joint_forces, write_chain
from mbsgen.formulations.parsimony.articulated import accelerations
from mbsgen.formulations.parsimony.segments import Segment, align, children, feels_itself, largest_inertias
from mbsgen.formulations.parsimony.writing import begin
from mbsgen.formulations.planning import find_plans, finish
from mbsgen.formulations.reductions import ALL, Reductions
from mbsgen.model.tree import Tree
from mbsgen.tape.builder import Builder, Scalar
from mbsgen.tape.types import Tape

# A pivot must stand out of the rounding of the largest inertia that its joint can feel: this bounds the numbers whose
# difference it is. Where axes are in line, it is a sum of products: there, a pivot above rounding is exact enough.
# Elsewhere a result errs by up to 2.5 epsilon over the pivot's ratio to the largest inertia: from 2.5e6 epsilon on,
# errors stay below 1e-6, as in EXP1.
#
# Where the joint's own body has inertia about the axis, the pivot is at least that. The bound holds in any position,
# and most positions subtract less: above 2 epsilon, chains with a heavy tip err by 8e-3 at most.
#
# Two joints without mass before a body that is no rod, all axes through one point: the first pivot is the square of a
# sine or a cosine times an inertia of the body. Nothing is subtracted, so the pivot is right however small it is. It is
# only bounded where the rounding of the angle itself decides, some 1e-14 rad from the lock.
PIVOT_TOLERANCE = 8.0
OWN_TOLERANCE = 2.0
LOCKING_TOLERANCE = 2.5e6
PRODUCT_TOLERANCE = 1e-12
ROUND = 1e-3  # the least moment of inertia of such a body, relative to the largest inertia that the joint can feel


def build(tree: Tree, reductions: Reductions = ALL) -> Tape:
    """Write `exp2`: inputs q, qd, u [, w] [, p]; output qdd, shape (n,). Fails at the joint whose pivot is lost."""
    builder = Builder()
    state = declare_state(tree, builder, accelerations=False)
    chain = write_chain(tree, builder, state)
    segments = align(chain, group=reductions.share_frames)
    plan = find_plans(tree, reductions).articulated
    Q = joint_forces(chain)
    qdd, bodies = accelerations(begin(chain, segments, plan, reductions), state.qd, Q)
    largest = largest_inertias(chain, segments)
    for i in range(len(tree.bodies), 0, -1):
        builder.guard(bodies[i].pivot, largest[i], _choose_tolerance(segments, segments[i - 1], largest[i]), i)
    builder.output_dense(ports.ACCELERATIONS, [[x] for x in qdd])
    return finish(builder.build("exp2"), reductions)


def _choose_tolerance(segments: Sequence[Segment], segment: Segment, largest: Scalar) -> float:
    if _may_lock(segments, segment):
        return LOCKING_TOLERANCE
    if feels_itself(segment):
        return OWN_TOLERANCE
    return PRODUCT_TOLERANCE if _is_product(segments, segment, largest) else PIVOT_TOLERANCE


def _is_product(segments: Sequence[Segment], segment: Segment, largest: Scalar) -> bool:
    """Return whether a massless joint has one more massless joint, and then a known body that is no rod."""
    following = children(segments, segment.number)
    if len(following) != 1 or feels_itself(following[0]):
        return False
    beyond = children(segments, following[0].number)
    if len(beyond) != 1 or not feels_itself(beyond[0]) or largest.literal is None:
        return False
    P = [[beyond[0].moments.P[r, c].literal for c in range(3)] for r in range(3)]
    if any(x is None for row in P for x in row):
        return False
    second = np.array(P, dtype=np.float64)
    moments = np.linalg.eigvalsh(np.trace(second) * np.eye(3) - second)
    return bool(moments[0] >= ROUND * float(largest.literal))


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
