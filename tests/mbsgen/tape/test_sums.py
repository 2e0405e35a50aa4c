"""Sums written anew keep what a tape computes: common parts come once, and terms are added as they are ready."""

from __future__ import annotations

from collections.abc import Callable, Sequence, Set

import numpy as np
import pytest

from mbsgen.formulations.planning import count_own, take_factors, write_sums, write_sums_again
from mbsgen.formulations.reductions import ALL
from mbsgen.roles import Role
from mbsgen.tape.builder import Builder, Scalar
from mbsgen.tape.counts import count_paper
from mbsgen.tape.ports import Port
from mbsgen.tape.replay import find_constants
from mbsgen.tape.sums import rewrite
from mbsgen.tape.types import Tape
from tests.mbsgen.tape.tapes import assert_same, random_brackets, random_tape, write

PARAMETERS = Port("p", Role.PARAMETER)


def share(tape: Tape, constant: Set[Role] = frozenset()) -> Tape:
    return rewrite(tape, constant, order=False)[0].plain


def order(tape: Tape) -> Tape:
    return rewrite(tape, share=False)[0].ordered


@pytest.mark.parametrize(
    ("results", "before", "after"),
    [
        pytest.param(lambda x: [x[0] + x[1] + x[2], x[0] + x[3] + x[2]], 4, 3, id="sums"),
        pytest.param(lambda x: [x[0] * x[1] * x[2], x[0] * x[3] * x[2]], 4, 3, id="products"),
        pytest.param(lambda x: [x[0] - x[1] + x[2], x[3] + x[1] - x[0]], 4, 3, id="differences of both signs"),
        pytest.param(lambda x: [x[0] + x[1], x[0] + x[2] + x[1]], 3, 2, id="one within another"),
        pytest.param(lambda x: [x[0] + x[1] + x[2], x[0] - x[1] + x[3]], 4, 4, id="a sum is no difference"),
        pytest.param(lambda x: [x[0] * x[0] * x[1], x[0] * x[2] * x[0]], 4, 3, id="squares"),
        pytest.param(lambda x: [x[2] + x[0] - (x[0] - x[1])], 3, 1, id="terms that cancel"),
        pytest.param(lambda x: [x[0] * (x[3] - (x[3] - x[1]))], 3, 1, id="all terms cancel but one"),
        pytest.param(lambda x: [(x[0] - x[1]) + (x[1] - x[2]) + (x[2] - x[0])], 5, 5, id="a sum without terms is left"),
        pytest.param(lambda x: [x[0] + x[1] + x[2] + x[3], x[3] + x[2] + x[1]], 5, 3, id="three terms"),
    ],
)
def test_common_parts_are_computed_once(
    results: Callable[[Sequence[Scalar]], Sequence[Scalar]], before: int, after: int
) -> None:
    tape = write(4, results)
    assert (count_paper(tape), count_paper(share(tape))) == (before, after)
    assert_same(tape, share(tape))


@pytest.mark.parametrize("seed", range(20))
def test_any_tape_keeps_its_values(seed: int) -> None:
    """In 50 digits, as the order of sums changes; and the same tape is written again."""
    tape = random_tape(seed)
    for found in (share(tape), order(tape), *(x.ordered for x in rewrite(tape))):
        assert_same(tape, found)
    assert rewrite(tape) == rewrite(tape)


@pytest.mark.parametrize("seed", range(10))
def test_sums_that_are_written_again_take_no_more_operations(seed: int) -> None:
    """To the same values, after sums were written by all rules once."""
    tape = write_sums(take_factors(random_tape(seed), ALL), ALL)
    again = write_sums_again(tape, ALL)
    assert count_own(again) <= count_own(tape)
    assert_same(tape, again)


def test_a_tape_is_written_once_where_nothing_is_handed_on_or_waits() -> None:
    """Without constants there is one way; terms that are ready at once keep their order. Constants give two ways."""
    (way,) = rewrite(write(3, lambda x: [x[0] + x[1] + x[2], x[0] * x[1] * x[2]]))
    assert way.ordered is way.plain
    assert len(rewrite(random_brackets(1), {Role.PARAMETER})) == 2
    assert len(rewrite(random_brackets(1), {Role.PARAMETER}, share=False)) == 1


@pytest.mark.parametrize("seed", range(5))
def test_sums_over_few_products_take_a_fraction_of_their_operations(seed: int) -> None:
    """Each of 20 sums holds half of the same 10 products: of 90 operations, pairs save more than a quarter."""
    rng = np.random.default_rng(seed)

    def sums(x: Sequence[Scalar]) -> list[Scalar]:
        products = [a * b for k, a in enumerate(x) for b in x[k + 1 :]]
        return [sum((products[i] for i in rng.permutation(10)[:5]), start=x[0].builder.zero) for _ in range(20)]

    tape = write(5, sums)
    assert_same(tape, share(tape))
    assert count_paper(share(share(tape))) <= count_paper(share(tape)) < 0.75 * count_paper(tape)


def test_constants_of_a_product_come_together() -> None:
    """p0 x p1 y is (p0 p1) x y: one product of three varies."""
    builder = Builder()
    (x, y), (p, r) = builder.vector("x", 2), builder.vector(PARAMETERS, 2)
    builder.output_dense("z", [[(p * x) * r * y], [x * y]])
    shared = share(builder.build("product"), {Role.PARAMETER})
    assert count_paper(shared) == 3
    assert shared.operations[0][1:] == (2, 3) or shared.operations[1][1:] == (2, 3)


def test_a_constant_goes_into_products_with_constants() -> None:
    """Of p x and r p x, 3 p x, the first is not computed: two products vary. With p x + y too, all three do."""
    for needed, varying in ((False, 2), (True, 4)):
        builder = Builder()
        (x, y), (p, r) = builder.vector("x", 2), builder.vector(PARAMETERS, 2)
        scaled = p * x
        results = [r * scaled, scaled * builder.number(3.0), *([scaled + y] if needed else [])]
        builder.output_dense("z", [[z] for z in results])
        tape = rewrite(builder.build("constants"), {Role.PARAMETER}, order=False)[-1].plain
        fixed = find_constants(tape, {Role.PARAMETER})[tape.first_operation :]
        assert fixed.count(False) == varying


def test_sums_longer_than_the_limit_are_left() -> None:
    """Their pairs would be thousands; the values stay."""
    tape = write(60, lambda x: [sum(x[1:], start=x[0]), sum(x[1:], start=x[0]) * x[0], sum(x[2:], start=x[0])])
    assert_same(tape, share(tape))


def test_the_term_that_is_ready_last_is_added_last() -> None:
    """Of sin(sin x2) + x0 - x1, the difference x0 - x1 does not wait for the sines."""
    builder = Builder()
    x = builder.vector("x", 3)
    late = builder.sin(builder.sin(x[2]))
    builder.output_dense("y", [[(late + x[0]) - x[1]]])
    tape = builder.build("late")
    assert longest_wait(order(tape)) == 3
    assert longest_wait(tape) == 4
    assert_same(tape, order(tape))


def longest_wait(tape: Tape) -> int:
    """Count the operations of the longest chain of operands."""
    depths = [0] * tape.first_operation
    for _, a, b in tape.operations:
        depths.append(1 + max(depths[a], depths[b] if b >= 0 else 0))
    return max(depths)
