"""Results that are found once for the same objects, and problems that a solve checks once."""

from __future__ import annotations

from dataclasses import replace

import pytest

from mbsrun.ocp.ground.memory import Memory
from mbsrun.ocp.problem.problem import Cost, Problem
from mbsrun.ocp.solution.solution import Solution
from mbsrun.ocp.solving.solve import solve
from mbsrun.ocp.statement import checks
from mbsrun.ocp.statement.checks import ProblemError, check_problem
from tests.mbsrun.ocp.plants import push
from tests.mbsrun.peer import double_integrator


class Thing:
    """An object; all are equal."""

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Thing)

    def __hash__(self) -> int:
        return 0


def test_equal_objects_are_not_the_same() -> None:
    memory, first, second = Memory[int](), Thing(), Thing()
    assert [memory.find(lambda k=k: k, *pair) for k, pair in enumerate(((first, second), (second, first)))] == [0, 1]
    assert memory.find(lambda: 2, first, second) == 0
    assert memory.find(lambda: 3, first) == 3


def test_a_result_lives_as_long_as_its_first_object() -> None:
    """Another object may get the same number in memory."""
    memory, first = Memory[int](), Thing()
    memory.find(lambda: 0, first)
    del first
    assert not memory._known


def test_what_raises_is_asked_again() -> None:
    wrong, manifest = replace(push(4), cost=Cost()), double_integrator().manifest
    for _ in range(2):
        with pytest.raises(ProblemError, match="every weight is 0"):
            check_problem(wrong, manifest)


def test_a_solve_checks_its_problem_once(monkeypatch: pytest.MonkeyPatch) -> None:
    checked: list[Problem] = []
    check = checks._check

    def count(problem: Problem, *rest: object, **named: object) -> None:
        checked.append(problem)
        check(problem, *rest, **named)  # type: ignore[arg-type]

    monkeypatch.setattr(checks, "_check", count)
    problem = push(4)
    assert isinstance(solve(problem, double_integrator()), Solution)
    assert checked == [problem]
