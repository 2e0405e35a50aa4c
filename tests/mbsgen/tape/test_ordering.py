"""The order of operations: it changes no result, brings sines together, and lets results follow each other."""

from __future__ import annotations

import random
from itertools import pairwise

import pytest

from mbsgen.roles import Role
from mbsgen.tape.builder import Builder
from mbsgen.tape.interpreter import evaluate, find_failure
from mbsgen.tape.ordering import arrange
from mbsgen.tape.passes import drop_dead
from mbsgen.tape.ports import Function, Port
from mbsgen.tape.types import Input, Op, Output, Sparsity, Tape
from tests.mbsgen.targets.guarded import guarded_tape
from tests.sample import sample_families

SINES = (Op.SIN, Op.COS)


def random_tape(seed: int) -> Tape:
    """Draw operations, sines of sines among them; some lead nowhere."""
    rng = random.Random(seed)
    operations = []
    for value in range(3, 103):
        op = rng.choice([Op.ADD, Op.SUB, Op.MUL, Op.NEG, Op.SIN, Op.COS])
        operations.append((op, rng.randrange(value), rng.randrange(value) if op.arity == 2 else -1))
    outputs = (Output(Port("f", Role.RESULT), Sparsity.dense(4), tuple(rng.randrange(103) for _ in range(4))),)
    return Tape(
        Function("impl"),
        (Input(Port("x", Role.ARGUMENT), Sparsity.dense(3)),),
        (),
        tuple(operations),
        outputs,
        labels={50: "a", 60: "b"},
    )


@pytest.mark.parametrize("seed", range(20))
def test_no_result_changes_by_a_bit(seed: int) -> None:
    given = {"x": [0.3, -0.7, 1.1]}
    assert evaluate(arrange(random_tape(seed)), given) == evaluate(random_tape(seed), given)


@pytest.mark.parametrize("tape", [t for f in sample_families() for t in f.tapes], ids=lambda t: t.name)
def test_inputs_results_and_labelled_values_stay(tape: Tape) -> None:
    rng = random.Random(1)
    given = {i.name: [rng.uniform(0.5, 2) for _ in range(i.sparsity.nnz)] for i in tape.inputs}
    found = arrange(tape)
    assert (found.inputs, [o.name for o in found.outputs]) == (tape.inputs, [o.name for o in tape.outputs])
    assert evaluate(found, given) == evaluate(tape, given)
    assert set(found.labels.values()) == set(tape.labels.values())
    for value, label in found.labels.items():
        before = next(v for v, name in tape.labels.items() if name == label)
        assert found.operations[value - found.first_operation][0] is tape.operations[before - tape.first_operation][0]


def test_guards_are_tested_in_their_order() -> None:
    found = arrange(guarded_tape())
    assert [g.joint for g in found.guards] == [2, 3]
    assert find_failure(found, {"x": [3.0, 5.0], "y": [1.0, 0.0, 1.0]}) == 3


@pytest.mark.parametrize("seed", range(20))
def test_sines_stand_together_and_nothing_else_before_them(seed: int) -> None:
    """In as many groups as there are sines of sines; before the last one only what some sine is taken of."""
    tape = arrange(drop_dead(random_tape(seed)))
    first = tape.first_operation
    levels = [0] * first
    for op, *operands in tape.operations:
        levels.append(max(levels[x] for x in operands[: op.arity]) + (op in SINES))
    places = [k for k, (op, _, _) in enumerate(tape.operations) if op in SINES]
    groups = 1 + sum(b != a + 1 for a, b in pairwise(places)) if places else 0
    assert groups <= max(levels)
    needed: set[int] = set()
    for k in range(max(places, default=-1), -1, -1):
        op, *operands = tape.operations[k]
        if op in SINES or first + k in needed:
            needed.update(operands[: op.arity])
        assert op in SINES or first + k in needed


def test_results_that_need_nothing_of_each_other_follow_each_other() -> None:
    """Squares first, then their products: 8 values at a time; one product after the other: 2."""
    b = Builder()
    x = b.vector("x", 8)
    squares = [a * a for a in x]
    b.output_dense("f", [[a * (a + c)] for a, c in zip(squares, x, strict=True)])
    tape = b.build("impl")
    steps = [op for op, _, _ in arrange(tape).operations]
    assert [op for op, _, _ in tape.operations][:8] == [Op.MUL] * 8
    assert steps == [Op.MUL, Op.ADD, Op.MUL] * 8
