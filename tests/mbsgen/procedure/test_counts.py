"""Counts of stages, against counts by hand, and what a procedure refuses."""

from __future__ import annotations

from dataclasses import replace

import pytest

from mbsgen.errors import TapeError
from mbsgen.procedure.differentiation import adjoint, jacobian
from mbsgen.procedure.patterns import General, Symmetric, Tree
from mbsgen.procedure.procedure import Procedure, count
from mbsgen.procedure.repeat import Gather, Repeat
from mbsgen.procedure.solve import Block, Factor, Solve
from mbsgen.procedure.straight import Straight
from mbsgen.procedure.wires import Wire
from mbsgen.tape.ports import Function
from mbsgen.tape.types import Op, Sparsity
from tests.mbsgen.procedure.examples import EXAMPLES, Q, X, four_bar, repeat, solve, straight, system


@pytest.mark.parametrize(
    ("pattern", "operations"),
    [
        # L of 2 entries: 3 divisions, 2 products for L, 2 products and differences below; for each of 2 columns, 2 of
        # either in each direction, and 3 products by 1/D
        (Tree(((), (0,), (0,))), {Op.DIV: 3, Op.MUL: 2 + 2 + 2 * (4 + 3), Op.SUB: 2 + 2 * 4}),
        # 3 divisions, 3 products for L, 3 + 1 below; for each of 2 columns, 3 in each direction, and 3 products by 1/D
        (Symmetric(3), {Op.DIV: 3, Op.MUL: 3 + 4 + 2 * 9, Op.SUB: 4 + 2 * 6}),
        # 3 divisions, 3 products for L, 4 + 1 beside; for each of 2 columns as before
        (General(3), {Op.DIV: 3, Op.MUL: 3 + 5 + 2 * 9, Op.SUB: 5 + 2 * 6}),
    ],
    ids=["tree", "symmetric", "general"],
)
def test_systems_are_counted(pattern: Tree | Symmetric | General, operations: dict[Op, int]) -> None:
    """A system of 3 rows with 2 right-hand sides; a product for the test of each pivot; 6 signs where negated."""
    found = count(system(pattern, 2))
    assert (found.operations, found.guards) == (operations, 3)
    assert count(system(pattern, 2, negated=True)).operations == operations | {Op.NEG: 6}


def test_a_map_is_counted_for_each_index() -> None:
    """sin, and two products and a division, three times; the guard, too."""
    found = count(repeat())
    assert found.operations == {Op.SIN: 3, Op.MUL: 6, Op.DIV: 3}
    assert found.guards == 3


def test_an_iteration_is_counted_once() -> None:
    """The closure with its Jacobian; 2 divisions, 1 + 1 + 4 products, 1 + 2 differences; 2 for the step."""
    tape = {Op.SIN: 3, Op.COS: 3, Op.MUL: 6, Op.ADD: 2, Op.SUB: 3, Op.NEG: 2}
    assert count(four_bar()).operations == {**tape, Op.MUL: 6 + 6, Op.SUB: 3 + 3 + 2, Op.DIV: 2}


def test_few_columns_are_not_widened_many_are() -> None:
    """The Jacobian of a tree's solution by 3 inputs has 6 columns; one by 6 inputs or more has a multiple of 16."""
    (solved,) = (s for s in jacobian(solve(Tree(((), (0,), (0,), (0, 2)))), ["x"]).stages if s.name == "solved_slopes")
    assert isinstance(solved, Solve)
    assert solved.width == 6
    assert [Tree(()).widen(width) for width in (1, 8, 9, 16, 17)] == [1, 8, 16, 16, 32]


def test_a_procedure_is_checked_when_it_is_built() -> None:
    """Stages read what is known, with the pattern that it has, and give what is not."""
    (stage,) = straight().stages
    y = Wire("y", Sparsity.dense(2))
    for inputs, stages, outputs, fault in (
        ((), (stage,), (y,), "stage all reads x, which no input or earlier stage gives"),
        ((Wire("x", Sparsity.dense(4)),), (stage,), (y,), "stage all reads x with another pattern"),
        ((X, y), (stage,), (y,), "stage all gives y, which is known before"),
        ((X,), (stage, stage), (y,), "names repeat"),
        ((X, X), (stage,), (y,), "names repeat"),
        ((X,), (stage,), (Q,), "a result is q, which no input or earlier stage gives"),
        ((X,), (stage,), (Wire("y", Sparsity.dense(1, 2)),), "a result is y with another pattern"),
    ):
        with pytest.raises(TapeError, match=fault):
            Procedure(Function("p"), inputs, stages, outputs)


def test_stages_are_checked_when_they_are_built() -> None:
    """Shapes, tables of places, and statuses that nobody would see."""
    square, column = Wire("A", Sparsity.dense(3, 3)), Wire("b", Sparsity.dense(1, 3))
    factors, X = General(3).factors("F"), Wire("X", Sparsity.dense(3))
    each, newton = repeat().stages[0], four_bar().stages[0]
    assert isinstance(each, Repeat)
    gather = each.gathers[0]
    for make, fault in (
        (lambda: Factor("F", column, General(3), 1), "b is 1 x 3, where 3 unknowns are solved for"),
        (lambda: Factor("F", square, Symmetric(3), 1), "A has entries above the diagonal"),
        (lambda: Factor("F", square, General(3), 0), "a failure has a status above 0, not 0"),
        (lambda: Solve("S", General(3), factors, square, (Block(X, 3),)), "X does not lie within 3 columns of 3 rows"),
        (lambda: Solve("S", General(3), factors, X, ()), "X has 1 columns for 3 unknowns"),
        (lambda: Solve("S", Tree(((), (0,), ())), factors, column, ()), "are no factors of such a matrix"),
        (lambda: Tree(((), (1,))), "the ancestors .* of row 1 must lie in 0..0"),
        (lambda: replace(each, gathers=()), "a map is over at least one place"),
        (lambda: replace(each, times=2), "a takes 1 places for each of 2"),
        (
            lambda: replace(each, gathers=(Gather("a", gather.source, ((0,), (3,), (0,))),)),
            "places that x does not have",
        ),
        (lambda: replace(newton, unknown="z"), "the residual has the input z"),  # type: ignore[type-var]
        (lambda: replace(newton, start=Q), "are full columns of 2 entries"),  # type: ignore[type-var]
        (lambda: replace(newton, iterations=0), "0 iterations are none"),  # type: ignore[type-var]
    ):
        with pytest.raises(TapeError, match=fault):
            make()


def test_straight_stages_join_before_systems_are_solved() -> None:
    """The adjoint of a saddle point lays out its right-hand sides in the stage that lays out the matrix."""
    procedure = EXAMPLES["saddle point"].procedure
    kinds = [type(stage) for stage in adjoint(procedure, ("f", "g", "J")).stages]
    assert kinds == [Straight, Factor, Solve, Solve, Straight]
