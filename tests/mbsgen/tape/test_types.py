"""A tape's invariants hold from its making on."""

from __future__ import annotations

import pytest

from mbsgen.errors import TapeError
from mbsgen.roles import Role
from mbsgen.tape.ports import Function, Port
from mbsgen.tape.types import LITERALS, Input, Op, Output, Sparsity, Tape

X = Input(Port("x", Role.ARGUMENT), Sparsity.dense(2))


def test_operations_know_the_number_of_their_operands():
    """Besides the four of arithmetic, atan2 alone takes two; each member holds its own number, without a call."""
    assert {op.name for op in Op if op.arity == 2} == {"ADD", "SUB", "MUL", "DIV", "ATAN2"}
    assert all(vars(op)["arity"] == op.value[1] and op.arity in (1, 2) for op in Op)


def test_an_operation_uses_earlier_values_only():
    with pytest.raises(TapeError, match="does not precede"):
        Tape(Function("f"), (X,), (), ((Op.ADD, 0, 2),), ())


def test_an_output_has_a_value_for_each_nonzero():
    with pytest.raises(TapeError, match="2 nonzeros, 1 values"):
        Tape(Function("f"), (X,), (), (), (Output(Port("y", Role.RESULT), Sparsity.dense(2), (0,)),))


def test_an_output_refers_to_values_that_exist():
    with pytest.raises(TapeError, match="does not exist"):
        Tape(Function("f"), (X,), (LITERALS.mpf(1),), (), (Output(Port("y", Role.RESULT), Sparsity.dense(1), (3,)),))


def test_names_are_unique():
    with pytest.raises(TapeError, match="repeat"):
        Tape(Function("f"), (X, X), (), (), ())


def test_patterns_are_kept_in_compressed_columns():
    pattern = Sparsity.of(3, 2, [(2, 0), (0, 1), (0, 0)])
    assert (pattern.colind, pattern.row) == ((0, 2, 3), (0, 2, 0))
    assert pattern.entries == ((0, 0), (2, 0), (0, 1))
    assert Sparsity.dense(2, 2) == Sparsity.of(2, 2, [(r, c) for r in range(2) for c in range(2)])


@pytest.mark.parametrize("row", [(1, 0), (0, 0), (0, 3)])
def test_rows_of_a_column_increase_within_bounds(row: tuple[int, int]):
    with pytest.raises(TapeError, match="strictly increase"):
        Sparsity(3, 1, (0, 2), row)
