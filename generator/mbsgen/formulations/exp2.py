"""Order-N form (EXP2): Tree -> Tape of qdd = nu(q, qd, Q) by articulated bodies; O(n) equations.

Docquier, Bruls, Fisette, eq. (19); Schwertassek, Rulka (1989); Featherstone (1983). The recursion is in
`parsimony.articulated`.
"""

from __future__ import annotations

from collections.abc import Sequence

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
# difference it is. Where the joint's own body has inertia about the axis, the pivot is at least that; where axes are in
# line, it is a sum of products: there, a pivot above rounding is exact enough. Elsewhere a result errs by up to 2.5
# epsilon over the pivot's ratio to the largest inertia: from 2.5e6 epsilon on, errors stay below 1e-6, as in EXP1.
PIVOT_TOLERANCE = 8.0
LOCKING_TOLERANCE = 2.5e6


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
        tolerance = LOCKING_TOLERANCE if _may_lock(segments, segments[i - 1]) else PIVOT_TOLERANCE
        builder.guard(bodies[i].pivot, largest[i], tolerance, i)
    builder.output_dense(ports.ACCELERATIONS, [[x] for x in qdd])
    return finish(builder.build("exp2"), reductions)


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
