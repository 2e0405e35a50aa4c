"""Explicit form by elimination (EXP1): Tree -> Tape of qdd = gamma(q, qd, Q) = M^-1 (Q - c).

Docquier, Bruls, Fisette, eq. (18). M = LT D L is sparse where the tree branches, and is eliminated from the leaves
(Featherstone, 2008, 6.5). Within a group of parallel axes the unknowns are the accelerations of absolute angles,
because M has fewer terms in these; their differences are the result. The unknown of a joint with a rotor is its own
angle.
"""

from __future__ import annotations

from functools import partial

from mbsgen.formulations import ports
from mbsgen.formulations.chain import check_pivot, joint_forces, write_chain
from mbsgen.formulations.parsimony.angles import absolute_forces, relative_acceleration
from mbsgen.formulations.parsimony.elimination import solve
from mbsgen.formulations.parsimony.segments import align, feels_itself, largest_inertias
from mbsgen.formulations.planning import find_plans, finish
from mbsgen.formulations.reductions import ALL, Reductions
from mbsgen.formulations.semi import terms
from mbsgen.formulations.states import declare_state
from mbsgen.model.tree import Tree
from mbsgen.tape.builder import Builder
from mbsgen.tape.types import Tape

# A result errs by up to 2.5 epsilon times the ratio of the entry of M to the pivot that remains of it. A joint fails
# below n u 1000 = 500 n epsilon, where about three digits remain; above, `condition` estimates how many. A joint whose
# own body has no inertia about its axis may lock. It fails where errors could exceed 1e-6, below 2.5e6 epsilon of the
# largest inertia that it can feel: the smaller bound would let errors of 4e-4 pass.
PIVOT_TOLERANCE = 500.0
LOCKING_TOLERANCE = 2.5e6


def build(tree: Tree, reductions: Reductions = ALL) -> Tape:
    """Write `exp1`: inputs q, qd, u [, w] [, p]; output qdd, shape (n,). Fails at the joint whose pivot is lost."""
    builder = Builder()
    state = declare_state(tree, builder, accelerations=False)
    chain = write_chain(tree, builder, state)
    plan = find_plans(tree, reductions).elimination
    M, c = terms(chain, state, plan, reductions, absolute=reductions.absolute)
    segments = align(chain, group=reductions.share_frames)
    Q = joint_forces(chain)
    forces = absolute_forces(segments, Q) if reductions.absolute else Q
    n = len(segments)
    found = solve(builder, M, {i: forces[i - 1] - c[i - 1] for i in range(1, n + 1)}, n, partial(check_pivot, tree))
    largest = largest_inertias(chain, segments)
    for i in range(n, 0, -1):
        if feels_itself(segments[i - 1]):
            builder.guard(found.pivots[i], M[i, i], n * PIVOT_TOLERANCE, i)
        else:
            builder.guard(found.pivots[i], largest[i], LOCKING_TOLERANCE, i)
    qdd = [relative_acceleration(s, found.x) if reductions.absolute else found.x[s.number] for s in segments]
    builder.output_dense(ports.ACCELERATIONS, [[x] for x in qdd])
    return finish(builder.build("exp1"), reductions)
