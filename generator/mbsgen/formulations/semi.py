"""Semi-explicit form (SEMI): Tree -> Tapes of M(q), c(q, qd), and of the residual M qdd + c - Q.

Docquier, Bruls, Fisette, eqs. (16)-(17); Fisette, Samin (1996). c is the Newton-Euler recursion at qdd = 0; M is summed
over composite bodies (Walker, Orin, 1982). O(n2) equations.
"""

from __future__ import annotations

from functools import reduce
from operator import add

from mbsgen.formulations import ports
from mbsgen.formulations.chain import Chain, joint_forces, write_chain
from mbsgen.formulations.closure import add_multipliers
from mbsgen.formulations.parsimony.mass_matrix import Entries, joint_matrix, mass_matrix
from mbsgen.formulations.parsimony.plan import Plan
from mbsgen.formulations.parsimony.residual import residual
from mbsgen.formulations.parsimony.segments import align
from mbsgen.formulations.parsimony.writing import begin
from mbsgen.formulations.planning import find_plans, finish
from mbsgen.formulations.reductions import ALL, Reductions
from mbsgen.formulations.states import State, declare_state
from mbsgen.model.tree import Tree
from mbsgen.tape.builder import Builder, Scalar
from mbsgen.tape.types import Tape


def build(tree: Tree, reductions: Reductions = ALL) -> Tape:
    """Write `semi`: inputs q, qd [, w] [, p]; outputs M, shape (n, n), and c, shape (n,)."""
    builder = Builder()
    state = declare_state(tree, builder, accelerations=False, forces=False)
    chain = write_chain(tree, builder, state)
    M, c = terms(chain, state, find_plans(tree, reductions).mass_matrix, reductions)
    n = len(tree.bodies)
    full = {(i - 1, j - 1): v for (i, j), v in M.items()} | {(j - 1, i - 1): v for (i, j), v in M.items()}
    builder.output_dense(ports.MASS_MATRIX, [[full.get((i, j), builder.zero) for j in range(n)] for i in range(n)])
    builder.output_dense(ports.BIAS, [[x] for x in c])
    return finish(builder.build("semi"), reductions)


def build_residual(tree: Tree, reductions: Reductions = ALL) -> Tape:
    """Write `semi_res`: inputs q, qd, qdd, u [, w] [, p]; output Phi, shape (n,): M qdd + c - Q."""
    builder = Builder()
    state = declare_state(tree, builder)
    chain = write_chain(tree, builder, state)
    M, c = terms(chain, state, find_plans(tree, reductions).mass_matrix, reductions)
    Q = joint_forces(chain)

    def row(i: int) -> Scalar:
        products = [v * state.qdd[a + b - i - 1] for (a, b), v in M.items() if i in (a, b)]
        return reduce(add, products, c[i - 1]) - Q[i - 1]

    builder.output_dense(ports.RESIDUAL, [[row(i)] for i in range(1, len(tree.bodies) + 1)])
    return finish(add_multipliers(builder.build("semi_res"), tree), reductions)


def terms(
    chain: Chain, state: State, plan: Plan, reductions: Reductions, *, absolute: bool = False
) -> tuple[Entries, list[Scalar]]:
    """Write one triangle of M by `plan`, and c; for relative or absolute rates."""
    bias = find_plans(chain.tree, reductions).bias
    segments = align(chain, group=reductions.share_frames)
    writing = begin(chain, segments, plan, reductions)
    M = mass_matrix(writing, absolute=True) if absolute else joint_matrix(writing)
    return M, residual(begin(chain, segments, bias, reductions), state.qd, chain.drift, absolute=absolute)
