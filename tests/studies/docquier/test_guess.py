"""The share of the guess and the share of the formulation in differences, on results of known numbers."""

from __future__ import annotations

from dataclasses import replace

import pytest

from mbsrun.measuring.sections import Table
from mbsrun.ocp.solution.record import Attempt
from studies.docquier.questions import answer_guess
from studies.docquier.results import Results
from tests.studies.docquier.made import ROUGH, SMOOTH, make


def guess_again(a: Attempt, cost: float, iterations: int, cpu: float) -> Attempt:
    """Return the attempt at the same task from the inputs of the guessed motion."""
    renamed = replace(a, protocol="question", part="guess", guess="dynamic")
    return replace(renamed, cost=cost, iterations=iterations, cpu_seconds=cpu)


def test_guess_and_formulation_are_told_apart() -> None:
    """The guess halves iterations and changes IMPL's minimum at 2 of 4 places; EXP1-A takes four times as many."""
    results = make(iterations=lambda _, name, __: 80.0 if name == "EXP1-A" else 20.0)
    compared = [
        a
        for a in results.attempts
        if a.task.weights == ROUGH and a.task.representation in ("IMPL", "EXP1-O", "EXP1-A") and a.task.place[0] < 4
    ]
    again = [
        guess_again(
            a,
            6.0 if a.task.representation == "IMPL" and a.task.place[0] < 2 else 5.01,
            a.iterations // 2,
            a.cpu_seconds / 3,
        )
        for a in compared
    ]
    section = answer_guess(replace(results, attempts=(*results.attempts, *again)))
    assert section is not None
    apart, by_guess = section.items
    assert isinstance(apart, Table)
    assert isinstance(by_guess, Table)
    other = 16 ** (1 / 3)  # ratios of three pairs of formulations: 1, 4 and 4
    expected = [(12, 100 * 2 / 12, 2.0, 3.0), (12, 0.0, other, 1.0), (12, 100 * 4 / 12, other, 1.0)]
    for row, numbers in zip(apart.rows, expected, strict=True):
        assert [float(str(x)) for x in row[3:]] == pytest.approx(numbers, rel=1e-3)  # four digits
    assert "at 4 of 9 targets" in section.text
    assert {row[1] for row in by_guess.rows} == {"IMPL", "EXP1-O", "EXP1-A"}
    assert {row[3] for row in by_guess.rows} == {4}


def test_a_record_without_the_other_guess_says_nothing() -> None:
    """One guess alone separates nothing; a cost without common places is left out."""
    results = make()
    assert answer_guess(results) is None
    one = next(a for a in results.attempts if a.task.weights == SMOOTH)
    alone: Results = replace(results, attempts=(*results.attempts, guess_again(one, 5.0, 10, 1.0)))
    section = answer_guess(alone)
    assert section is not None
    assert not section.text
