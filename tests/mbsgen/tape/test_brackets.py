"""Brackets that several sums share are computed once, and values stay."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence

import pytest

from mbsgen.roles import Role
from mbsgen.tape.brackets import take_brackets
from mbsgen.tape.builder import Builder, Scalar
from mbsgen.tape.counts import count_paper
from mbsgen.tape.draft import Draft, Write
from mbsgen.tape.ports import Port
from mbsgen.tape.replay import find_constants
from tests.mbsgen.tape.tapes import assert_same, random_brackets, random_tape, write


@pytest.mark.parametrize(
    ("results", "before", "after"),
    [
        pytest.param(lambda x: [x[0] * x[1] + x[0] * x[2], x[3] * x[2] + x[3] * x[1]], 6, 3, id="two sums"),
        pytest.param(
            lambda x: [x[0] * x[1] - x[0] * x[2], x[3] * x[2] - x[3] * x[1]], 6, 4, id="of both signs, and a minus"
        ),
        pytest.param(lambda x: [x[1] + x[2], x[0] * x[1] + x[3] + x[0] * x[2]], 5, 3, id="one sum is the bracket"),
        pytest.param(
            lambda x: [x[0] * x[1] + x[0] * x[2], x[3] * x[2] - x[3] * x[1]], 6, 6, id="a sum is no difference"
        ),
        pytest.param(
            lambda x: [x[0] * x[1] + x[2] * (x[3] * x[1]), (x[0] + x[2] * x[3]) * x[4], x[3] * x[1]], 7, 5, id="shared"
        ),
    ],
)
def test_brackets_are_computed_once(
    results: Callable[[Sequence[Scalar]], Sequence[Scalar]], before: int, after: int
) -> None:
    tape = write(5, results)
    found = take_brackets(tape)
    assert (count_paper(tape), count_paper(found)) == (before, after)
    assert_same(tape, found)


@pytest.mark.parametrize("seed", range(20))
def test_any_tape_keeps_its_values(seed: int) -> None:
    """In 50 digits, in no more operations; and the same tape is written again."""
    tape = random_tape(seed)
    found = take_brackets(tape)
    assert_same(tape, found)
    assert count_paper(found) <= count_paper(tape)
    assert take_brackets(tape) == found


@pytest.mark.parametrize("seed", range(40))
def test_a_tape_that_is_changed_in_place_is_the_tape_that_is_written_again(
    seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """To the last digit, number and label."""
    tape, attempt, followed = random_brackets(seed), Draft.attempt, list[bool]()

    def follow(draft: Draft, chosen: Collection[int], write: Write) -> int | None:
        count = attempt(draft, chosen, write)
        followed.append(count is not None)
        return count

    monkeypatch.setattr(Draft, "attempt", follow)
    found = take_brackets(tape, {Role.PARAMETER})
    monkeypatch.setattr(Draft, "attempt", lambda *_: None)
    assert take_brackets(tape, {Role.PARAMETER}) == found
    assert any(followed) or not followed or seed % 4 == 0  # a square root of a negative value is not followed


@pytest.mark.parametrize("seed", [58, 109, 114, 155, 231, 257])  # of few in which this decides
def test_changes_that_are_not_followed_change_nothing(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """A tape that is written again for some brackets has other numbers, by which the next brackets are found."""
    tape, attempt = random_brackets(seed), Draft.attempt
    found = take_brackets(tape, {Role.PARAMETER})
    monkeypatch.setattr(Draft, "attempt", lambda d, *given: None if d.is_changed else attempt(d, *given))
    assert take_brackets(tape, {Role.PARAMETER}) == found


def test_operations_on_parameters_do_not_count() -> None:
    """x p1 + x p2 and y p1 + y p2 need two products that vary, and no sum."""
    builder = Builder()
    (x, y), (p, r) = builder.vector("x", 2), builder.vector(Port("p", Role.PARAMETER), 2)
    builder.output_dense("z", [[v * p + v * r + x * y] for v in (x, y)])
    tape = builder.build("parameters")
    found = take_brackets(tape, {Role.PARAMETER})
    varying = find_constants(found, {Role.PARAMETER})[found.first_operation :].count(False)
    assert varying <= find_constants(tape, {Role.PARAMETER})[tape.first_operation :].count(False)
