"""The rules of refinement: how many pieces, which degree, how many steps, and when it ends, by its formulas."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from mbsrun.ocp.ground.schemes import Family
from mbsrun.ocp.problem.problem import Form, Problem, Refinement, Representation, SolverOptions
from mbsrun.ocp.searching.refinement import (
    _count,
    _find_order,
    _split,
    _take_steps,
    choose_grid,
    find_end,
    find_violated,
)
from mbsrun.ocp.solution.solution import Resimulation
from tests.mbsrun.ocp.plants import push

ASKED = 1e-8
NONE = np.zeros(2)


def asked(degree: int = 3, **changes: Any) -> Problem:
    return replace(push(2, degree=degree), **{"refine": Refinement(ASKED, 3), **changes})


def judged(defects: tuple[float, ...] = (1e-3, 0.0), *, violated: bool = False, **given: Any) -> Resimulation:
    margins: Any = SimpleNamespace(violated=[1] if violated else [], intervals=given.pop("intervals", (0.0, 0.0)))
    return Resimulation(None, None, None, given.pop("is_accurate", False), defects=defects, margins=margins, **given)


def solution(problem: Problem, check: Resimulation, violation: float = 0.0) -> Any:
    return SimpleNamespace(problem=problem, resimulation=check, violation=SimpleNamespace(constraints=violation))


def test_pieces_follow_from_the_orders_of_local_errors() -> None:
    """One more than the scheme's: 2 d for Radau, 2 d + 1 for Legendre; 5 for RK4."""
    assert [_find_order(asked(), d) for d in (1, 3)] == [2, 6]
    assert _find_order(asked(family=Family.LEGENDRE), 3) == 7
    assert _find_order(asked(integrator="rk4"), 3) == 5
    found = _count(np.array([1e-3, 1e-9]), asked(), 4)
    assert found == pytest.approx(np.array([1e-3, 1e-9]) ** (1 / 6) / (0.3 * ASKED) ** (1 / 8), rel=1e-12)


def test_the_degree_with_the_least_work_is_taken() -> None:
    """Pieces times degree to the power 1.5; at least two pieces of an inaccurate interval at the same degree."""
    for defect in (1.5e-8, 1e-6, 1e-3, 0.5):
        problem = asked()
        best = None
        for degree in (3, 4, 5):
            pieces = np.ceil(defect ** (1 / 6) / (0.3 * ASKED) ** (1 / (2 * degree)))
            wanted = max(pieces, 2 if degree == 3 else 1) + 1
            if best is None or wanted * degree**1.5 < best[0]:
                best = wanted * degree**1.5, degree, int(min(wanted - 1, 8))
        assert best is not None
        found = _split(problem, np.array([defect, 1e-9]), NONE)
        assert found is not None
        assert (found[0].degree, found[0].intervals) == (best[1], best[2] + 1)


def test_degrees_end_at_nine_and_an_accurate_interval_stays() -> None:
    found = _split(asked(degree=9), np.array([1.0, 1e-8]), NONE)
    assert found is not None
    assert found[0].degree == 9
    assert 2 < found[0].intervals <= 9
    rough = _split(asked(degree=9, refine=Refinement(1e-13, 3)), np.array([1.0, 1e-14]), NONE)
    assert rough is not None
    assert (rough[0].degree, rough[0].intervals) == (9, 7)
    assert rough[1] == "1 of 2 intervals split into 6"


@pytest.mark.parametrize(("violation", "pieces"), [(1.0, 1), (1.01, 2), (1.1, 2), (3.0, 4), (10.0, 6), (100.0, 8)])
def test_violated_intervals_are_split_by_the_root_of_the_violation(violation: float, pieces: int) -> None:
    """Into sqrt(violation / 0.3), two at least; the degree stays where nothing is inaccurate."""
    found = _split(asked(), np.full(2, 1e-9), np.array([violation, 0.0]))
    assert found is not None
    assert (found[0].degree, found[0].intervals) == (3, pieces + 1)


def test_steps_grow_with_the_worst_interval() -> None:
    """By its pieces, 8 times at most, and by one at least; no more than the limit."""
    problem = asked(integrator="rk4", steps=4, form=Form.SHOOTING)
    worst = 1e-4 ** (1 / 5) / (0.3 * ASKED) ** (1 / 5)
    found = _take_steps(problem, np.array([1e-9, 1e-4]))
    assert found is not None
    assert found[0].steps == int(np.ceil(min(worst, 8) * 4))
    assert found[1] == f"{found[0].steps} steps in each interval, 4 before"
    least = _take_steps(problem, np.array([1e-9, 1e-9]))
    assert least is not None
    assert least[0].steps == 5
    most = _take_steps(problem, np.array([1.0, 1.0]))
    assert most is not None
    assert most[0].steps == 32


def test_a_tolerance_that_is_too_loose_is_reduced_first() -> None:
    """To 1e-2 of the accuracy, 1e-12 at least, where constraints are violated by more than 0.3 of the accuracy."""
    problem = asked(solver=SolverOptions(tolerance=1e-6))
    for violation, is_reduced in ((0.29e-8, False), (0.31e-8, True)):
        found = choose_grid(solution(problem, judged(), violation))
        assert found is not None
        assert (found[0].solver.tolerance == pytest.approx(1e-10)) == is_reduced
        assert (found[0].intervals == 2) == is_reduced
    tight = replace(problem, refine=Refinement(1e-11, 3))
    found = choose_grid(solution(tight, judged(), 1.0))
    assert found is not None
    assert found[0].solver.tolerance == 1e-12
    done = replace(problem, solver=SolverOptions(tolerance=1e-10))
    found = choose_grid(solution(done, judged(), 1.0))
    assert found is not None
    assert found[0].intervals > 2


def test_shooting_takes_steps_but_where_a_violation_needs_intervals() -> None:
    problem = asked(integrator="rk4", steps=2, form=Form.SHOOTING, representation=Representation.EXP2_O)
    found = choose_grid(solution(problem, judged()))
    assert found is not None
    assert (found[0].intervals, found[0].steps > 2) == (2, True)
    found = choose_grid(solution(problem, judged(intervals=(1.01, 0.0))))
    assert found is not None
    assert (found[0].intervals, found[0].steps) == (4, 2)
    found = choose_grid(solution(problem, judged(intervals=(1.0, 1.0))))
    assert found is not None
    assert found[0].intervals == 2


@pytest.mark.parametrize(
    ("check", "made", "words"),
    [
        (judged(is_accurate=True), 0, "confirms the accuracy"),
        (judged(is_accurate=True, violated=True), 0, ""),
        (judged(unfinished="the limit"), 0, "did not finish, the limit"),
        (judged(()), 0, "gave up"),
        (judged((0.9e-8, 1e-8)), 0, "the loops open"),
        (judged((0.9e-8, 1e-8), violated=True), 0, ""),
        (judged((0.9e-8, 1.1e-8)), 2, ""),
        (judged((0.9e-8, 1.1e-8)), 3, "3 rounds are over"),
    ],
)
def test_refinement_ends_for_a_reason(check: Resimulation, made: int, words: str) -> None:
    found = find_end(solution(asked(), check), made, 3)
    assert words in found
    assert bool(found) == bool(words)
    assert find_violated(check) == bool(check.margins and check.margins.violated)


def test_one_round_is_in_the_singular() -> None:
    assert find_end(solution(asked(), judged()), 1, 1) == "1 round is over"
    assert not find_violated(replace(judged(), margins=None))
