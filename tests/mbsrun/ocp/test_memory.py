"""Results that are found once for the same objects, and problems that a solve checks once."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mbsrun.ocp.ground import schemes
from mbsrun.ocp.ground.memory import Memory
from mbsrun.ocp.guessing.guess import find_inputs, rest
from mbsrun.ocp.problem.problem import Cost, Problem
from mbsrun.ocp.problem.structure import structure
from mbsrun.ocp.solution.solution import Solution
from mbsrun.ocp.solving.solve import Solver, solve
from mbsrun.ocp.statement import checks
from mbsrun.ocp.statement.checks import ProblemError, check_problem
from mbsrun.ocp.statement.statement import state_problem
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
    assert memory.knows(first, second)
    assert not memory.knows(second)


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


def test_bounds_of_the_latest_problem_are_found_once_and_stay() -> None:
    """Another problem has its own; nobody can write to bounds that others read."""
    plant, problem = double_integrator(), push(8)
    own = Solver(problem, plant).transcription
    for find in (own.variable_bounds, own.constraint_bounds):
        first = find(problem)
        assert find(problem) is first
        other = replace(problem, start_q=(0.25,), bounds=replace(problem.bounds, q=((-3.0, 4.0),)))
        assert any((a != b).any() for a, b in zip(find(other), first, strict=True))
        assert all(np.array_equal(a, b) for a, b in zip(find(problem), first, strict=True))
        with pytest.raises(ValueError, match="read-only"):
            first[0][0] = 1.0


def test_schemes_structures_and_grids_of_guesses_are_found_once() -> None:
    problem = push(8)
    assert structure(problem) is structure(problem)
    assert structure(replace(problem)) == structure(problem)
    scheme = schemes.build(problem.family, problem.degree)
    assert schemes.build(problem.family, problem.degree) is scheme
    first, other = (rest(replace(problem, start_q=(x,)), scheme) for x in (0.0, 0.5))
    assert first.point_t is other.point_t
    assert (other.q == 0.5).all()


def test_inputs_of_states_with_one_effect_are_the_bits_of_each_alone() -> None:
    """B is the same in all states of a mass, so one pseudoinverse serves all."""
    plant, rng = double_integrator(), np.random.default_rng(0)
    q, qd, qdd = rng.normal(size=(3, 7, 1))
    found = find_inputs(plant, q, qd, qdd)
    alone = [find_inputs(plant, q[k : k + 1], qd[k : k + 1], qdd[k : k + 1]) for k in range(7)]
    assert np.array_equal(found, np.concatenate(alone))


def test_types_of_a_problem_that_a_file_states_are_not_checked_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """A changed copy is another problem, whose types are."""
    plant = double_integrator()
    data = {"horizon": 1, "cost": {}, "start": {"pose": {}}, "end": {"pose": [1], "velocity": "zero"}}
    seen = []
    find = checks._find_wrong_types
    monkeypatch.setattr(checks, "_find_wrong_types", lambda problem: [seen.append(problem), *find(problem)][1:])
    problem = state_problem(data, "push", plant, Path())
    check_problem(problem, plant.manifest)
    assert seen == []
    with pytest.raises(ProblemError, match="intervals"):
        check_problem(replace(problem, intervals=2.5), plant.manifest)
    assert len(seen) == 1
