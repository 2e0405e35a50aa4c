"""Numbers of a mechanism that one solve finds: what becomes of the problem, its unknowns and its start; by hand."""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from mbsrun.ocp.problem.problem import Unknown
from mbsrun.ocp.solution.solution import Failure, Run
from mbsrun.ocp.solving import fixing
from mbsrun.ocp.solving.fixing import fix_numbers, list_numbers
from tests.mbsrun.ocp.plants import push

UNKNOWNS = (*(Unknown(name, (0.0, 99.0), 1.0) for name in ("length", "gain", "mass")),)
PROBLEM = replace(
    push(2),
    unknowns=UNKNOWNS,
    parameters=(("mass", 7.0), ("friction", 0.5)),
    constants=(("c", 9.0),),
    free_start=(0, 1),
)


@dataclass(frozen=True)
class Motion:
    """A motion of which the unknowns count."""

    unknowns: Any
    q: Any = None
    qd: Any = None


def make_plant(*names: str) -> Any:
    return SimpleNamespace(manifest=SimpleNamespace(design=[SimpleNamespace(name=name) for name in names]))


@pytest.fixture(autouse=True)
def solved(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Find the numbers 10, 20, 30, and note what is solved and equipped."""
    seen: list[Any] = []
    motion = Motion(np.array([10.0, 20.0, 30.0]), np.array([[1.0], [8.0]]), np.array([[2.0], [8.0]]))
    outcome = SimpleNamespace(trajectory=motion)

    def solve(problem: Any, _: Any, guess: Any) -> Any:
        seen.append((problem, guess))
        return outcome

    monkeypatch.setattr(fixing, "solve", solve)
    monkeypatch.setattr(fixing, "equip", lambda _, problem: ("equipped", problem.parameters))
    return seen


def test_unknowns_that_are_parameters_are_numbers_of_the_mechanism() -> None:
    assert list_numbers(PROBLEM, make_plant("mass", "other", "length").manifest) == ("length", "mass")
    assert list_numbers(PROBLEM, make_plant("other").manifest) == ()


def test_a_problem_without_such_numbers_is_not_solved(solved: list[Any]) -> None:
    guess: Any = Motion(None)
    found = fix_numbers(PROBLEM, make_plant("other"), guess)
    assert not isinstance(found, Failure)
    assert (found.problem, found.guess, found.numbers, solved) == (PROBLEM, guess, {}, [])
    assert found.plant == ("equipped", PROBLEM.parameters)


def test_found_numbers_become_parameters_and_constants(solved: list[Any]) -> None:
    """In place of earlier ones; other unknowns stay, with their values in the motion; given values count instead."""
    guess: Any = Motion(None)
    for given, length in ((None, 10.0), ({"length": 11.0, "gain": 99.0}, 11.0)):
        found = fix_numbers(PROBLEM, make_plant("mass", "length"), guess, given)
        assert not isinstance(found, Failure)
        assert found.numbers == {"length": length, "mass": 30.0}
        assert found.problem.unknowns == UNKNOWNS[1:2]
        assert found.problem.parameters == (("mass", 30.0), ("friction", 0.5), ("length", length))
        assert found.problem.constants == (("c", 9.0), ("length", length), ("mass", 30.0))
        assert found.problem.free_start == (0, 1)
        assert found.problem.start_q == PROBLEM.start_q
        assert found.guess is not None
        assert found.guess.unknowns.tolist() == [20.0]
        assert found.plant == ("equipped", found.problem.parameters)
    assert solved == [(PROBLEM, guess)] * 2


def test_a_start_that_follows_is_closed_with_the_numbers(monkeypatch: pytest.MonkeyPatch) -> None:
    """The first state of the solution, whose free entries that follow are free no longer."""
    closure = SimpleNamespace(project=lambda q, qd: (10 * q, 10 * qd))
    monkeypatch.setattr(fixing, "find_closure", lambda _: closure)
    found = fix_numbers(replace(PROBLEM, following=(1,)), make_plant("mass"))
    assert not isinstance(found, Failure)
    assert (found.problem.start_q, found.problem.start_qd) == ((10.0,), (20.0,))
    assert (found.problem.free_start, found.problem.following) == ((0,), ())


def test_a_solve_that_fails_is_the_failure(monkeypatch: pytest.MonkeyPatch) -> None:
    failure = Failure(PROBLEM, Run("slow", 3, 0.0, 0.0), "it took too long", "wait")
    monkeypatch.setattr(fixing, "solve", lambda *_, **__: failure)
    assert fix_numbers(PROBLEM, make_plant("mass")) is failure
