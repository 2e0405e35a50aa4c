"""Expressions keep the tape's association, its names where they are fit, and its literals to the last bit."""

from __future__ import annotations

import textwrap
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mbsgen.errors import TapeError
from mbsgen.roles import Role
from mbsgen.tape.counts import INLINED
from mbsgen.tape.ports import Function, Port
from mbsgen.tape.types import LITERALS, Input, Op, Output, Sparsity, Tape
from mbsgen.targets.c.stages import LONGEST, break_line
from mbsgen.targets.statements import Statement, wrap, write_body, write_literal


def tape(operations: list[tuple[Op, int, int]], labels: dict[int, str] | None = None, size: int = 3) -> Tape:
    """Make a tape of x (size) that gives out its last value."""
    last = Output(Port("f", Role.RESULT), Sparsity.dense(1), (size + len(operations) - 1,))
    return Tape(
        Function("impl"),
        (Input(Port("x", Role.ARGUMENT), Sparsity.dense(size)),),
        (),
        tuple(operations),
        (last,),
        labels=labels or {},
    )


def written(found: Tape) -> list[str]:
    body = write_body(found)
    return [f"{s.target} = {s.expression}" for s in (*body.statements, *body.results[0].statements)]


def test_sums_are_written_as_languages_associate() -> None:
    """From the left; a sum on the right comes first, or stands in parentheses where that would change it."""
    left = [(Op.ADD, 0, 1), (Op.ADD, 3, 2)]
    right = [(Op.ADD, 1, 2), (Op.ADD, 0, 3)]
    subtracted = [(Op.ADD, 1, 2), (Op.SUB, 0, 3)]
    both = [(Op.ADD, 0, 1), (Op.SUB, 1, 2), (Op.ADD, 3, 4)]
    assert written(tape(left)) == ["f[0] = x[0] + x[1] + x[2]"]
    assert written(tape(right)) == ["f[0] = x[1] + x[2] + x[0]"]
    assert written(tape(subtracted)) == ["f[0] = x[0] - (x[1] + x[2])"]
    assert written(tape(both)) == ["f[0] = x[0] + x[1] + (x[1] - x[2])"]


def test_products_of_sums_stand_in_parentheses() -> None:
    assert written(tape([(Op.ADD, 0, 1), (Op.DIV, 3, 2)])) == ["f[0] = (x[0] + x[1])/x[2]"]
    assert written(tape([(Op.ADD, 0, 1), (Op.NEG, 3, -1)])) == ["f[0] = -(x[0] + x[1])"]


def test_a_sign_stands_in_parentheses() -> None:
    assert written(tape([(Op.NEG, 0, -1), (Op.SUB, 1, 3), (Op.NEG, 4, -1)])) == ["f[0] = -(x[1] - (-x[0]))"]


def test_a_value_used_twice_is_a_statement() -> None:
    assert written(tape([(Op.MUL, 0, 1), (Op.ADD, 3, 3)])) == ["t1 = x[0]*x[1]", "f[0] = t1 + t1"]


@pytest.mark.parametrize("op", [Op.MUL, Op.DIV, Op.NEG])
def test_expressions_are_not_deep(op: Op) -> None:
    """C promises 63 parentheses, one inside the other; a sum takes none, however long it is."""
    chain = [(Op.ADD, 0, 1)] + [(op, k, 2 if op.arity == 2 else -1) for k in range(3, 60)]
    assert max(line.count("(") for line in written(tape(chain))) <= INLINED + 1
    long = [(Op.ADD, 0, 1)] + [(Op.SUB if k % 2 else Op.ADD, k, 2) for k in range(3, 60)]
    (line,) = written(tape(long))
    assert "(" not in line


@pytest.mark.parametrize(
    "label", ["x", "f", "int", "sin", "M_PI", "MBS_C", "t1", "2a", "a b", "a;b", "é", "NAN", "mbs_real", "_a", ""]
)
def test_a_label_that_cannot_name_a_variable_is_not_used(label: str) -> None:
    lines = written(tape([(Op.MUL, 0, 1), (Op.ADD, 3, 3)], {3: label}))
    assert lines == ["t1 = x[0]*x[1]", "f[0] = t1 + t1"]


def test_a_label_names_its_value_and_numbers_make_room() -> None:
    operations = [(Op.MUL, 0, 1), (Op.MUL, 0, 2), (Op.ADD, 3, 4), (Op.ADD, 5, 4)]
    lines = written(tape(operations, {3: "t1", 5: "twice", 4: "twice"}))
    assert lines == ["t1 = x[0]*x[1]", "t2 = x[0]*x[2]", "f[0] = t1 + t2 + t2"]


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_a_double_is_written_to_the_last_bit(value: float) -> None:
    text = write_literal(LITERALS.mpf(value))
    assert float(text.removeprefix("MBS_C(").removesuffix(")")) == value


@given(st.integers(10**59, 10**60 - 1), st.integers(-40, 40))
def test_sixty_digits_are_rounded_once(digits: int, exponent: int) -> None:
    """Python divides integers with a single rounding."""
    exact = Fraction(digits) * Fraction(10) ** exponent
    nearest = exact.numerator / exact.denominator
    value = LITERALS.mpf(f"{digits}e{exponent}")
    assert write_literal(value) == f"MBS_C({nearest!r})"


def test_a_number_beyond_doubles_is_an_error() -> None:
    with pytest.raises(TapeError, match="beyond the range of a double"):
        write_literal(LITERALS.mpf("1e400"))


def test_inputs_that_nothing_reads_are_told() -> None:
    sources = tuple(
        Input(Port(name, Role.ARGUMENT), Sparsity.dense(size)) for name, size in (("x", 1), ("u", 0), ("z", 2))
    )
    found = Tape(Function("impl"), sources, (), (), (Output(Port("f", Role.RESULT), Sparsity.dense(1), (0,)),))
    body = write_body(found)
    assert body.unused == ("z",)
    assert body.results[0].statements == (Statement("f[0]", "x[0]"),)


def test_words_are_wrapped_at_commas() -> None:
    assert wrap(["1", "22", "333"], width=6) == ("1, 22,", "333")
    assert wrap([]) == ()


@pytest.mark.parametrize("seed", range(20))
def test_long_lines_break_like_wrapped_text(seed: int) -> None:
    """By the standard library's wrapping of words, which takes longer; also around words longer than a line."""
    rng = np.random.default_rng(seed)
    line = " ".join("x" * length for length in rng.integers(1, LONGEST + 20 if seed % 2 else 30, size=40))
    wrapped = textwrap.wrap(line, LONGEST, subsequent_indent="    ", break_long_words=False, break_on_hyphens=False)
    assert break_line(line) == wrapped
