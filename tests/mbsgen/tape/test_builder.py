"""The builder: folding, value numbering, signs; every tape it builds computes what was written."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mbsgen.errors import TapeError
from mbsgen.tape.builder import Builder, Scalar
from mbsgen.tape.counts import count
from mbsgen.tape.interpreter import DIGITS, evaluate
from mbsgen.tape.types import Op, Sparsity


def built(*results: Scalar):
    builder = results[0].builder
    builder.output("y", Sparsity.dense(len(results)), results)
    return builder.build("test")


def inputs(n: int, **options: bool) -> list[Scalar]:
    return Builder(**options).vector("x", n)


def operations(tape) -> dict[Op, int]:
    return count(tape).operations


def test_equal_operations_are_computed_once_whatever_their_order_and_sign():
    a, b = inputs(2)
    tape = built((a - b) * (b + a), (a + b) * (b - a))
    assert operations(tape) == {Op.ADD: 1, Op.SUB: 1, Op.MUL: 1, Op.NEG: 1}
    assert evaluate(tape, {"x": [3.0, 5.0]}) == {"y": [-16.0, 16.0]}


def test_zero_and_one_cost_nothing():
    (a,) = inputs(1)
    b = a.builder
    tape = built(a * b.number(1.0) + b.zero * a, a - a, b.zero * a, a / a, a / -a)
    assert operations(tape) == {}
    assert evaluate(tape, {"x": [7.0]}) == {"y": [7.0, 0.0, 0.0, 1.0, -1.0]}


def test_literal_factors_are_gathered():
    (a,) = inputs(1)
    b = a.builder
    tape = built(b.number(2.0) * (b.number(0.25) * a) + a + a / b.number(4.0))
    assert operations(tape) == {Op.MUL: 1}
    assert evaluate(tape, {"x": [8.0]}) == {"y": [14.0]}


def test_literals_keep_sixty_digits_until_the_end():
    (a,) = inputs(1)
    third = a.builder.number(1.0) / a.builder.number(3.0)
    value = evaluate(built(a * third), {"x": [3]}, DIGITS)["y"][0]
    assert abs(value - 1) < 1e-49


def test_sine_is_odd_and_cosine_even():
    (a,) = inputs(1)
    b = a.builder
    tape = built(b.sin(a) * b.sin(-a), b.cos(-a) * b.cos(a))
    assert operations(tape)[Op.SIN] == operations(tape)[Op.COS] == 1
    assert evaluate(tape, {"x": [0.5]})["y"] == pytest.approx([-(math.sin(0.5) ** 2), math.cos(0.5) ** 2])


@pytest.mark.parametrize("turn", ["difference", "product", "literal", "sum"])
def test_a_negated_result_turns_a_difference_round(turn: str):
    """No unary minus where a difference or a literal that serves nothing else can be turned."""
    a, b, c = inputs(3)
    two = a.builder.number(2.0)
    y = {
        "difference": -(a - b),
        "product": -(c * (a - b)),
        "literal": -(two * a * b),
        "sum": -(a * b + (b - c)),
    }[turn]
    tape = built(y)
    assert Op.NEG not in operations(tape)
    exact = {"difference": 3.0, "product": 21.0, "literal": -20.0, "sum": -8.0}[turn]
    assert evaluate(tape, {"x": [2.0, 5.0, 7.0]}) == {"y": [exact]}


def test_a_negated_input_costs_one_operation_only_once():
    (a,) = inputs(1)
    tape = built(-a, -a)
    assert operations(tape) == {Op.NEG: 1}


def test_division_by_the_structural_zero_is_refused():
    (a,) = inputs(1)
    with pytest.raises(TapeError, match="structural zero"):
        a / a.builder.zero


def test_literals_must_be_finite():
    with pytest.raises(TapeError, match="finite"):
        Builder().number(math.inf)


@st.composite
def programs(draw: st.DrawFn) -> list[tuple[str, int, int]]:
    """Draw a random program over two inputs and the literals -2, -1, 0, 1, 3."""
    size = draw(st.integers(1, 25))
    step = st.tuples(st.sampled_from(["+", "-", "*", "neg", "sin", "cos"]), st.integers(0, 30), st.integers(0, 30))
    return draw(st.lists(step, min_size=size, max_size=size))


def run(program, values: list, sin, cos) -> list:
    for op, i, j in program:
        a, b = values[i % len(values)], values[j % len(values)]
        match op:
            case "+":
                values.append(a + b)
            case "-":
                values.append(a - b)
            case "*":
                values.append(a * b)
            case "neg":
                values.append(-a)
            case "sin":
                values.append(sin(a))
            case "cos":
                values.append(cos(a))
    return values


@given(programs(), st.booleans(), st.booleans())
def test_a_built_tape_computes_what_was_written(program, fold: bool, number: bool):
    builder = Builder(fold=fold, number=number)
    start = [*builder.vector("x", 2), *(builder.number(float(v)) for v in (-2, -1, 0, 1, 3))]
    written = run(program, start, builder.sin, builder.cos)[-8:]
    builder.output("y", Sparsity.dense(len(written)), written)
    x = [0.3, -0.7]
    values = run(program, [*map(DIGITS.literal, x), *map(DIGITS.literal, (-2, -1, 0, 1, 3))],
                 DIGITS.functions[Op.SIN], DIGITS.functions[Op.COS])[-8:]  # fmt: skip
    found = evaluate(builder.build("program"), {"x": list(map(DIGITS.literal, x))}, DIGITS)["y"]
    for a, b in zip(found, values, strict=True):
        assert abs(a - b) <= 1e-38 * (1 + abs(b))


def test_batches_are_evaluated_along_arrays():
    a, b = inputs(2)
    x = np.linspace(0, 1, 5)
    y = evaluate(built(a * b + a), {"x": [x, 2 * x]})["y"][0]
    assert np.array_equal(y, x * (2 * x) + x)
