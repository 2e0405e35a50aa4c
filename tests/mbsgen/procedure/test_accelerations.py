"""The accelerations of a tree in stages have the derivatives that the engine writes as straight-line programs."""

from __future__ import annotations

import numpy as np

from mbsgen.derivatives.dynamics import Dynamics
from mbsgen.formulations.catalogue import FUNCTIONS
from mbsgen.formulations.reductions import Reductions
from mbsgen.model.tree import Tree as Mechanism
from mbsgen.procedure.differentiation import adjoint, jacobian
from mbsgen.procedure.patterns import Tree
from mbsgen.procedure.procedure import Procedure, evaluate
from mbsgen.procedure.sheet import Sheet
from mbsgen.procedure.solve import Block, Factor, Solve
from mbsgen.procedure.straight import Straight
from mbsgen.procedure.wires import Wire
from mbsgen.tape import forward
from mbsgen.tape.replay import replay
from mbsgen.tape.types import Sparsity
from tests.random_trees import random_tree

ONE_PLAN = Reductions(trials=1)


def in_stages(tree: Mechanism) -> Procedure:
    """Write M(q) and Phi(q, qd, 0) - Q, factorise M by the tree's pattern, and solve M qdd = -(Phi - Q)."""
    exp1, impl = FUNCTIONS["exp1"].build(tree, ONE_PLAN), FUNCTIONS["impl"].build(tree, ONE_PLAN)
    n, sheet = len(tree.joints), Sheet()
    inputs = {wire.name: wire for wire in map(Wire.of, exp1.inputs)}
    still = [sheet.builder.zero] * n
    at_rest = {i.name: sheet.take(inputs[i.name]) if i.name in inputs else still for i in impl.inputs}
    slopes = forward.jacobian(impl, ["qdd"])
    (M,) = slopes.outputs
    values = replay(slopes, sheet.builder, at_rest)
    entries = {(r, c): values[v] for (r, c), v in zip(M.sparsity.entries, M.values, strict=True) if r >= c}
    matrix = Wire("mass", Sparsity.of(n, n, entries))
    sheet.give(matrix, [entries[place] for place in matrix.sparsity.entries])
    values = replay(impl, sheet.builder, at_rest)
    right = Wire("bias", Sparsity.dense(1, n))
    sheet.give(right, [values[v] for v in impl.outputs[0].values])
    pattern = Tree(tuple(tuple(i for i in range(k) if (k, i) in entries) for k in range(n)))
    factor = Factor("factors", matrix, pattern, n)
    solve = Solve("solved", pattern, factor.gives, right, (Block(Wire.of(exp1.outputs[0]), 0),), negated=True)
    stages = (Straight(sheet.finish("equations")), factor, solve)
    return Procedure(exp1.function, tuple(inputs.values()), stages, solve.gives)


def test_stages_have_the_derivatives_of_exp1() -> None:
    """First and second, to 1e-11 of the largest entry, for a branched tree; stages have a few zeros more."""
    tree = random_tree(3, 4)
    procedure = in_stages(tree)
    straight = Dynamics(tree, ONE_PLAN).differentiate(FUNCTIONS["exp1"].build(tree, ONE_PLAN))
    back = adjoint(procedure, straight.wrt)
    seeds = [i.name for i in back.inputs if i.name not in {wire.name for wire in procedure.inputs}]
    found = (procedure, jacobian(procedure, straight.wrt), back, jacobian(back, [*straight.wrt, *seeds]))
    rng = np.random.default_rng(3)
    drawn = {i.name: list(rng.uniform(0.3, 1.2, i.sparsity.nnz)) for i in back.inputs}
    for mine, theirs in zip(found, (straight.tape, straight.jac, straight.adj1, straight.jac_adj1), strict=True):
        assert mine.function == theirs.function
        values, expected = evaluate(mine, drawn), evaluate(theirs, drawn)
        for wire in mine.outputs:
            full = dict(zip(wire.sparsity.entries, values[wire.name], strict=True))
            other = next((o for o in theirs.outputs if o.port == wire.port), None)
            wanted = dict(zip(other.sparsity.entries, expected[wire.name], strict=True)) if other else {}
            scale = max(1.0, *map(abs, wanted.values()), 0.0)
            assert all(abs(value - wanted.get(place, 0.0)) < 1e-11 * scale for place, value in full.items())
            assert wanted.keys() <= full.keys()
