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
from mbsgen.tape.types import Tape
from tests.mbsgen.tape.tapes import assert_same, random_brackets, random_signs, random_tape, write


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
@pytest.mark.parametrize("draw", [random_brackets, random_signs])
def test_a_tape_that_is_changed_in_place_is_the_tape_that_is_written_again(
    draw: Callable[[int], Tape], seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """To the last digit, number and label; also where functions have values with another sign."""
    tape = draw(seed)
    found = take_brackets(tape, {Role.PARAMETER})
    monkeypatch.setattr(Draft, "attempt", lambda *_: None)
    assert take_brackets(tape, {Role.PARAMETER}) == found


@pytest.mark.parametrize("draw", [random_brackets, random_signs])
def test_every_change_of_a_tape_that_a_builder_writes_again_as_it_is_is_made_in_place(
    draw: Callable[[int], Tape], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Except for sums with a literal that is new in the tape, which few changes write."""
    attempt, followed = Draft.attempt, list[bool]()

    def follow(draft: Draft, chosen: Collection[int], write: Write, fewest: float) -> int | None:
        count = attempt(draft, chosen, write, fewest)
        followed.append(count is not None)
        return count

    monkeypatch.setattr(Draft, "attempt", follow)
    for seed in range(40):
        again = Draft(draw(seed), {Role.PARAMETER}).write((), lambda *_: 0)
        take_brackets(again, {Role.PARAMETER})
    assert len(followed) > 50
    assert all(followed) if draw is random_signs else followed.count(False) < 0.02 * len(followed)


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
