"""Passes keep what a tape computes, and lower what they are there to lower."""

from __future__ import annotations

from dataclasses import replace

import pytest

from mbsgen.formulations import ports
from mbsgen.tape.builder import Builder
from mbsgen.tape.counts import count
from mbsgen.tape.interpreter import evaluate
from mbsgen.tape.passes import drop_dead, hoist
from mbsgen.tape.replay import declare_inputs, replay
from mbsgen.tape.types import Op, Sparsity, Tape


def wasteful() -> Tape:
    """Write, without folding or numbering: y = (x0 + 0) * 1 + x0 * x1 + x1 * x0, and z = x1."""
    b = Builder(fold=False, number=False)
    x = b.vector("x", 2)
    one = b.number(1.0)
    y = x[0] * one + x[0] * x[1] + x[1] * x[0]
    b.output("y", Sparsity.dense(1), [y])
    b.output("z", Sparsity.dense(1), [x[1] * x[1]])
    return b.build("wasteful")


def rewrite(tape: Tape, *, fold: bool, number: bool) -> Tape:
    """Write a tape again, with a builder that folds literals or numbers equal values."""
    builder = Builder(fold=fold, number=number)
    values = replay(tape, builder, declare_inputs(tape, builder))
    for o in tape.outputs:
        builder.output(o.name, o.sparsity, [values[v] for v in o.values])
    return builder.build(tape.name)


@pytest.mark.parametrize(
    ("fold", "number", "products"), [(False, False, 4), (True, False, 3), (False, True, 3), (True, True, 2)]
)
def test_folding_and_numbering_keep_the_results_and_lower_the_count(fold, number, products):
    written, x = rewrite(wasteful(), fold=fold, number=number), {"x": [3.0, 5.0]}
    assert evaluate(written, x) == evaluate(wasteful(), x) == {"y": [33.0], "z": [25.0]}
    assert count(written).of(Op.MUL) == products


def test_dead_operations_are_dropped():
    whole = wasteful()
    kept = drop_dead(replace(whole, outputs=(whole.output("z"),)))
    assert evaluate(kept, {"x": [3.0, 5.0]}) == {"z": [25.0]}
    assert count(kept).operations == {Op.MUL: 1}


def parametric(name: str) -> Tape:
    """Write y = p0 p1 x + p1 / p0, and z = -(p0 p1)."""
    b = Builder()
    (x,), p = b.vector("x", 1), b.vector(ports.PARAMETERS, 2)
    b.output("y", Sparsity.dense(1), [p[0] * p[1] * x + p[1] / p[0]])
    b.output("z", Sparsity.dense(1), [-(p[0] * p[1])])
    return b.build(name)


def test_what_depends_on_parameters_alone_moves_to_setup_once_for_all_tapes():
    setup, tapes = hoist([parametric("a"), parametric("b")], ports.PARAMETERS, ports.SETUP)
    assert count(setup).operations == {Op.MUL: 1, Op.DIV: 1, Op.NEG: 1}  # the sign belongs to the stored value
    p, x = [2.0, 7.0], [3.0]
    h = evaluate(setup, {"p": p})["h"]
    for tape in tapes:
        assert count(tape).operations == {Op.MUL: 1, Op.SUB: 1}
        assert evaluate(tape, {"x": x, "h": h}) == evaluate(parametric("a"), {"x": x, "p": p})


def test_a_parameter_used_as_it_is_is_handed_through():
    b = Builder()
    (x,), p = b.vector("x", 1), b.vector(ports.PARAMETERS, 1)
    b.output("y", Sparsity.dense(1), [p[0] * x])
    setup, (tape,) = hoist([b.build("f")], ports.PARAMETERS, ports.SETUP)
    assert evaluate(tape, {"x": [3.0], "h": evaluate(setup, {"p": [5.0]})["h"]}) == {"y": [15.0]}


def test_a_tape_that_reads_no_parameter_keeps_its_results():
    b = Builder()
    (x,) = b.vector("x", 1)
    b.output("y", Sparsity.dense(1), [x + x])
    setup, (tape, _) = hoist([b.build("f"), parametric("a")], ports.PARAMETERS, ports.SETUP)
    h = evaluate(setup, {"p": [2.0, 7.0]})["h"]
    assert evaluate(tape, {"x": [5.0], "h": h}) == {"y": [10.0]}
