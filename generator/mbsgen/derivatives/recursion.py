"""The Jacobian of the residual by the recursion of its sensitivities: Tree -> Tape of `jac_impl`.

What the recursion leaves out, the forces of joints and external wrenches, is a residual too: that of the same tree
without mass. It is differentiated as a tape.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from sympy import Integer

from mbsgen.derivatives import forward
from mbsgen.formulations import impl
from mbsgen.formulations.links import PARAMETERS, State, declare_state, write_chain
from mbsgen.formulations.parsimony.segments import align
from mbsgen.formulations.parsimony.sensitivities import sensitivities
from mbsgen.formulations.parsimony.writing import begin
from mbsgen.formulations.planning import dynamics_alone, find_plans, finish
from mbsgen.formulations.reductions import Reductions
from mbsgen.model.tree import Tree
from mbsgen.tape.builder import Builder, Scalar
from mbsgen.tape.replay import replay
from mbsgen.tape.types import Tape

Block = dict[tuple[int, int], Scalar]  # by (row, column), from 0
_NONE = (Integer(0),) * 3


def jacobian(tree: Tree, reductions: Reductions) -> Tape:
    """Write `jac_impl`: inputs of `impl`; outputs jac_Phi_q, jac_Phi_qd, jac_Phi_qdd, jac_Phi_u [, jac_Phi_w]."""
    builder = Builder()
    state = declare_state(tree, builder)
    n = len(tree.bodies)
    blocks = _inertial_blocks(tree, builder, state, reductions)
    forces = _forces_jacobian(tree, reductions)
    given = {"q": state.q, "qd": state.qd, "qdd": state.qdd, "u": state.u, "w": state.w, PARAMETERS: state.p}
    values = replay(forces, builder, given)
    for output in forces.outputs:
        block = blocks.get(output.name, {})
        for place, value in zip(output.sparsity.entries, output.values, strict=True):
            block[place] = block[place] + values[value] if place in block else values[value]
        builder.output_nonzeros(output.name, n, output.sparsity.cols, block)
    return finish(builder.build("jac_impl"), reductions)


def _inertial_blocks(tree: Tree, builder: Builder, state: State, reductions: Reductions) -> Mapping[str, Block]:
    chain = write_chain(dynamics_alone(tree, driven=False), builder, state)
    segments = align(chain, group=reductions.share_frames)
    plan = find_plans(tree, reductions).sensitivities
    found = sensitivities(begin(chain, segments, plan, reductions), state.qd, state.qdd)
    named = {"jac_Phi_q": found.q, "jac_Phi_qd": found.qd, "jac_Phi_qdd": found.qdd}
    return {name: {(i - 1, j - 1): v for (i, j), v in block.items()} for name, block in named.items()}


def _forces_jacobian(tree: Tree, reductions: Reductions) -> Tape:
    bodies = tuple(replace(body, mass=Integer(0), com=_NONE, inertia=(_NONE, _NONE, _NONE)) for body in tree.bodies)
    massless = replace(tree, gravity=_NONE, bodies=bodies)
    tape = impl.build(massless, replace(reductions, trials=1))
    return forward.jacobian(tape, [i.name for i in tape.inputs if i.name != PARAMETERS], "jac_impl")
