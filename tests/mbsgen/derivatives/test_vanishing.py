"""Entries that vanish by an identity are left out, and no others."""

from __future__ import annotations

from pathlib import Path

import pytest

from mbsgen.derivatives.kernels import differentiate
from mbsgen.derivatives.vanishing import drop_vanishing
from mbsgen.formulations import impl
from mbsgen.model.changes.reduction import build_tree
from mbsgen.model.reader import read_model
from mbsgen.roles import Role
from mbsgen.tape.builder import Builder
from mbsgen.tape.counts import count
from mbsgen.tape.interpreter import evaluate
from mbsgen.tape.ports import Port
from mbsgen.tape.types import Op, Sparsity, Tape

ARM = Path(__file__).parents[3] / "models" / "arm_pendulum.yaml"


def with_identity() -> Tape:
    """Write y = (sin2 x + cos2 x - 1, x / (x - x y), 1e-30 x): the first is 0, whatever x; the others are not."""
    b = Builder()
    x, y = b.vector("x", 2)
    one = b.sin(x) * b.sin(x) + b.cos(x) * b.cos(x)
    values = [one - b.number(1.0), x / (x - x * y), b.number(1e-30) * x]
    b.output(Port("jac_y_x", Role.DERIVATIVE), Sparsity.dense(3), values)
    return b.build("f")


def test_what_vanishes_by_an_identity_is_left_out():
    pruned = drop_vanishing(with_identity())
    assert pruned.output("jac_y_x").sparsity == Sparsity.of(3, 1, [(1, 0), (2, 0)])
    assert evaluate(pruned, {"x": [0.5, 0.25]})["jac_y_x"] == [1 / 0.75, 0.5e-30]


def test_what_it_alone_needed_goes_too():
    assert not any(op.name in ("SIN", "COS") for op, _, _ in drop_vanishing(with_identity()).operations)


def test_a_tape_without_such_entries_stays_as_it_is():
    tape = drop_vanishing(with_identity())
    assert drop_vanishing(tape) is tape


def test_large_entries_of_a_block_do_not_hide_a_tiny_one():
    """A force of a loop is drawn near 1 N, and may stand beside the weight of 1e-27 kg, or be added to it."""
    b = Builder()
    x, y = b.vector("x", 2)
    one = b.sin(x) * b.sin(x) + b.cos(x) * b.cos(x)
    sums = [(x + b.number(small)) - x for small in (1e-44, 1e-60)]  # the second has none of 50 digits
    values = [x, b.number(1e-48) * y, one - b.number(1.0), *sums]
    b.output(Port("jac_y_x", Role.DERIVATIVE), Sparsity.dense(5), values)
    pruned = drop_vanishing(b.build("f"))
    assert [r for r, _ in pruned.output("jac_y_x").sparsity.entries] == [0, 1, 3]


def test_what_is_zero_in_a_region_alone_is_kept():
    """max(x - 9, 0), exp(-400 x) and tanh(400 x) have no slope, to 35 digits, where points are drawn."""
    b = Builder()
    (x,) = b.vector("x", 1)
    fast = b.number(400.0) * x
    values = [b.larger(x - b.number(9.0), b.zero), b.apply(Op.EXP, -fast), b.apply(Op.TANH, fast)]
    b.output("y", Sparsity.dense(3), values)
    jac = differentiate(b.build("f"), ["x"]).jac
    assert drop_vanishing(jac).output("jac_y_x").sparsity == Sparsity.dense(3)


def test_the_arm_has_the_zeros_that_mechanics_promises():
    """30, 35, 34 and 4 nonzeros by q, qd, qdd, u: dPhi/dq1 = 0, dPhi6/dqd6 = 0 and M56 = 0 (Table 3 of the paper)."""
    tree = build_tree(read_model(ARM))
    jac = differentiate(impl.build(tree), ["q", "qd", "qdd", "u"]).jac
    assert [o.sparsity.nnz for o in jac.outputs] == [30, 35, 34, 4]
    assert count(jac).arithmetic < 2036  # a short Newton-Euler with base parameters, differentiated by CasADi with cse


TINY = """
name: chain
gravity: [0, 0, -9.81]
bodies:
  - {{name: a, joint: {{type: revolute, axis: y}}, mass: {m}, com: [0, 0, 0.5], inertia: [{m}, {m}, {m}]}}
  - {{name: b, parent: a, joint: {{type: revolute, axis: x, position: [0, 0, 1]}}, mass: {m}, com: [0.1, 0, 0.5]}}
  - {{name: c, parent: b, joint: {{type: revolute, axis: y, position: [0, 0, 1]}}, mass: {m}, com: [0.1, 0, 0.5]}}
"""


def test_derivatives_of_tiny_masses_are_the_same_ones(tmp_path: Path):
    """Of 1e-60 kg, torques differ from torques of 1 kg by a factor alone, though derivatives are below 1e-35."""
    blocks = []
    for mass in ("1.0", "1.0e-60"):
        (path := tmp_path / "chain.yaml").write_text(TINY.format(m=mass), "utf-8")
        jac = differentiate(impl.build(build_tree(read_model(path))), ["q", "qd", "qdd"]).jac
        given = {i.name: [0.3 + 0.1 * k for k in range(i.sparsity.nnz)] for i in jac.inputs}
        found = evaluate(drop_vanishing(jac), given)
        blocks.append({o.name: (o.sparsity, found[o.name]) for o in drop_vanishing(jac).outputs})
    for name, (pattern, values) in blocks[0].items():
        assert blocks[1][name][0] == pattern
        assert [1e60 * x for x in blocks[1][name][1]] == pytest.approx(values, rel=1e-12, abs=1e-13)
