"""Implicit form (IMPL): Tree -> Tape of the residual Phi(q, qd, qdd) - Q(q, qd, u).

Docquier, Bruls, Fisette, eqs. (12)-(15). O(n) equations, by the reduced recursion of `parsimony.residual` or, with all
reductions off, the textbook's.
"""

from __future__ import annotations

from mbsgen.formulations import ports, textbook
from mbsgen.formulations.chain import joint_forces, write_chain
from mbsgen.formulations.closure import add_multipliers
from mbsgen.formulations.parsimony.residual import residual
from mbsgen.formulations.parsimony.segments import align
from mbsgen.formulations.parsimony.writing import begin
from mbsgen.formulations.planning import find_plans, finish
from mbsgen.formulations.reductions import ALL, Reductions
from mbsgen.formulations.states import declare_state
from mbsgen.model.tree import Tree
from mbsgen.tape.builder import Builder
from mbsgen.tape.ports import Function
from mbsgen.tape.types import Tape

FUNCTION = Function("impl")


def build(tree: Tree, reductions: Reductions = ALL) -> Tape:
    """Write `impl`: inputs q, qd, qdd, u [, w] [, p]; output Phi, shape (n,), N m or N: Phi(q, qd, qdd) - Q.

    With loops, also the input lam, and the output less JT lam.
    """
    builder = Builder()
    state = declare_state(tree, builder)
    chain = write_chain(tree, builder, state)
    if reductions.is_textbook:
        Phi = textbook.residual(chain, state.qd, chain.accelerate(state.qdd))
    else:
        segments = align(chain, group=reductions.share_frames)
        plan = find_plans(tree, reductions).residual
        Phi = residual(begin(chain, segments, plan, reductions), state.qd, chain.accelerate(state.qdd))
    Q = joint_forces(chain)
    builder.output_dense(ports.RESIDUAL, [[phi - force] for phi, force in zip(Phi, Q, strict=True)])
    return finish(add_multipliers(builder.build(FUNCTION), tree), reductions)
