"""Order-N form (EXP2): Tree -> Tape of qdd = nu(q, qd, Q) by articulated bodies.

Docquier, Bruls, Fisette, eq. (19); Schwertassek, Rulka (1989). O(n) equations.
"""

from __future__ import annotations

from mbsgen.formulations.links import Chain, declare_state, joint_forces, write_chain
from mbsgen.formulations.parsimony.articulated import accelerations
from mbsgen.formulations.parsimony.segments import align, children
from mbsgen.formulations.parsimony.writing import begin
from mbsgen.formulations.planning import find_plans, finish
from mbsgen.formulations.reductions import ALL, Reductions
from mbsgen.model.tree import Tree
from mbsgen.tape.builder import Builder, Scalar
from mbsgen.tape.types import Tape

# A pivot must stand out of the rounding of the largest inertia that its joint can feel: what was subtracted to make it.
PIVOT_TOLERANCE = 1.0


def build(tree: Tree, reductions: Reductions = ALL) -> Tape:
    """Write `exp2`: inputs q, qd, u [, p]; output qdd, shape (n,). Fails at the joint whose pivot is lost."""
    builder = Builder()
    state = declare_state(tree, builder, accelerations=False)
    chain = write_chain(tree, builder, state.q, state.p)
    plan = find_plans(tree, reductions).articulated
    Q = joint_forces(tree, builder, state.u)
    qdd, joints = accelerations(begin(chain, plan, reductions), state.qd, Q)
    largest = _largest_inertias(chain)
    for i in range(len(tree.bodies), 0, -1):
        builder.guard(joints[i].pivot, largest[i], PIVOT_TOLERANCE, i)
    builder.output_dense("qdd", [[x] for x in qdd])
    return finish(builder.build("exp2"), reductions)


def _largest_inertias(chain: Chain) -> dict[int, Scalar]:
    """Bound what each joint can feel of what it carries, stretched out: moment of inertia, or mass.

    From parameters alone. By the triangle inequality in the norm (integral of r2 dm)^1/2; a slider's way is left out.
    """
    b = chain.builder
    segments = align(chain)
    bounds: dict[int, Scalar] = {}
    second: dict[int, Scalar] = {}
    mass: dict[int, Scalar] = {}
    for s in reversed(segments):
        P = s.moments.P
        total, m = P[0, 0] + P[1, 1] + P[2, 2], s.moments.m
        for child in children(segments, s.number):
            reach = b.sqrt(second[child.number]) + b.sqrt(child.d.dot(child.d) * mass[child.number])
            total, m = total + reach * reach, m + mass[child.number]
        second[s.number], mass[s.number] = total, m
        bounds[s.number] = total if s.is_revolute else m
    return bounds
