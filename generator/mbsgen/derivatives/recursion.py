"""The Jacobian of the residual by the recursion of its sensitivities: Tree -> Tape of `jac_impl` or `lin_impl`.

What the recursion leaves out, the forces of joints and external wrenches, is a residual too: that of the same tree
without mass. It is differentiated as a tape.
"""

from __future__ import annotations

from dataclasses import replace

from sympy import Integer

from mbsgen.derivatives import forward
from mbsgen.formulations import impl
from mbsgen.formulations.links import PARAMETERS, State, declare_state, write_chain
from mbsgen.formulations.parsimony.segments import align
from mbsgen.formulations.parsimony.sensitivities import Sensitivities, sensitivities
from mbsgen.formulations.parsimony.writing import begin
from mbsgen.formulations.planning import dynamics_alone, find_plans, finish
from mbsgen.formulations.reductions import Reductions
from mbsgen.model.tree import Tree
from mbsgen.tape.builder import Builder
from mbsgen.tape.replay import replay
from mbsgen.tape.types import Tape

_NONE = (Integer(0),) * 3


def jacobian(tree: Tree, reductions: Reductions) -> Tape:
    """Write `jac_impl`: inputs of `impl`; outputs jac_Phi_q, jac_Phi_qd, jac_Phi_qdd, jac_Phi_u [, jac_Phi_w]."""
    return _write(tree, reductions, "jac_impl", valued=False)


def linearisation(tree: Tree, reductions: Reductions) -> Tape:
    """Write `lin_impl`: outputs Phi and those of `jac_impl`."""
    return _write(tree, reductions, "lin_impl", valued=True)


def _write(tree: Tree, reductions: Reductions, name: str, *, valued: bool) -> Tape:
    builder = Builder()
    state = declare_state(tree, builder)
    n = len(tree.bodies)
    found = _differentiate(tree, builder, state, reductions)
    named = {"jac_Phi_q": found.q, "jac_Phi_qd": found.qd, "jac_Phi_qdd": found.qdd}
    blocks = {name: {(i - 1, j - 1): v for (i, j), v in block.items()} for name, block in named.items()}
    forces = _forces(tree, reductions)
    slopes = forward.jacobian(forces, [i.name for i in forces.inputs if i.name != PARAMETERS], name)
    given = {"q": state.q, "qd": state.qd, "qdd": state.qdd, "u": state.u, "w": state.w, PARAMETERS: state.p}
    if valued:
        values = replay(forces, builder, given)
        (output,) = forces.outputs
        builder.output_dense("Phi", [[found.Phi[i] + values[v]] for i, v in enumerate(output.values, 1)])
    values = replay(slopes, builder, given)
    for output in slopes.outputs:
        block = blocks.get(output.name, {})
        for place, value in zip(output.sparsity.entries, output.values, strict=True):
            block[place] = block[place] + values[value] if place in block else values[value]
        builder.output_nonzeros(output.name, n, output.sparsity.cols, block)
    return finish(builder.build(name), reductions)


def _differentiate(tree: Tree, builder: Builder, state: State, reductions: Reductions) -> Sensitivities:
    chain = write_chain(dynamics_alone(tree, driven=False), builder, state)
    segments = align(chain, group=reductions.share_frames)
    plan = find_plans(tree, reductions).sensitivities
    return sensitivities(begin(chain, segments, plan, reductions), state.qd, state.qdd)


def _forces(tree: Tree, reductions: Reductions) -> Tape:
    """Write the residual of the tree without mass."""
    bodies = tuple(replace(body, mass=Integer(0), com=_NONE, inertia=(_NONE, _NONE, _NONE)) for body in tree.bodies)
    massless = replace(tree, gravity=_NONE, bodies=bodies)
    return impl.build(massless, replace(reductions, trials=1))
