"""Order-N form (EXP2): Tree -> Tape of qdd = nu(q, qd, Q) by articulated bodies.

Docquier, Bruls, Fisette, eq. (19); Schwertassek, Rulka (1989). O(n) equations.
"""

from __future__ import annotations

from mbsgen.formulations.links import declare_state, joint_forces, write_chain
from mbsgen.formulations.parsimony.articulated import accelerations
from mbsgen.formulations.parsimony.segments import align, largest_inertias
from mbsgen.formulations.parsimony.writing import begin
from mbsgen.formulations.planning import find_plans, finish
from mbsgen.formulations.reductions import ALL, Reductions
from mbsgen.model.tree import Tree
from mbsgen.tape.builder import Builder
from mbsgen.tape.types import Tape

# A pivot must stand out of the rounding of the largest inertia that its joint can feel: that bounds what was subtracted
# to make it. Where that much was, a result that passes has a digit left; where nothing was, it has all.
PIVOT_TOLERANCE = 8.0


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
        builder.guard(bodies[i].pivot, largest[i], PIVOT_TOLERANCE, i)
    builder.output_dense("qdd", [[x] for x in qdd])
    return finish(builder.build("exp2"), reductions)
