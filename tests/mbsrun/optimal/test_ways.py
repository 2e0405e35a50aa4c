"""Ways along a number by hand: steps that grow and shrink, what is noted of each, turning points, and errors."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from mbsrun.ocp.optima.status import SMOOTH
from mbsrun.ocp.statement.checks import ProblemError
from mbsrun.optimal import continuation
from mbsrun.optimal.continuation import (
    FIRST,
    GROWTH,
    LIMIT,
    MOST,
    REACHED,
    SHORTEST,
    SHRINKING,
    STUCK,
    TURNING,
    WISHED,
    Stop,
    _compare,
    _find_turning,
    follow,
)


class Lost:
    """A solve without an answer."""

    status = "bad"
    failure = SimpleNamespace(run=SimpleNamespace(iterations=9))


class Right:
    """A solution at a value; the error of its prediction is the control's."""

    status = "good"

    def __init__(self, value: float) -> None:
        self.value, self.cost = value, 10 * value
        self.solution = SimpleNamespace(run=SimpleNamespace(iterations=3))


class Control:
    """A problem of a number that starts at 1; `errors` are of the solves in turn, None of one that fails."""

    name = "task"

    def __init__(self, *errors: float | None, first: bool = True, speed: Any = lambda _: 1.0) -> None:
        self.errors, self.first, self.speed = list(errors), first, speed
        self.at, self.aims, self.asked = 1.0, list[float](), list[Any]()

    def read_number(self, name: str) -> float:
        assert name == "n"
        return self.at

    def with_numbers(self, numbers: dict[str, float]) -> Any:
        own = Control.__new__(Control)
        own.__dict__ = {**self.__dict__, "at": numbers["n"]}
        return own

    def derivatives(self, found: Any, by: list[str]) -> Any:
        assert (found.value, by) == (self.at, ["n"])
        dx = np.array([0.0, -self.speed(self.at)])
        return SimpleNamespace(
            statuses={"n": SMOOTH}, answer=SimpleNamespace(movement=SimpleNamespace(move=lambda _: dx))
        )

    def solve(self, guess: Any) -> Any:
        if guess in (None, "own"):
            self.asked.append(guess)
            return Right(1.0) if self.first else Lost()
        self.aims.append(self.at)
        error = self.errors.pop(0) if len(self.errors) > 1 else self.errors[0]
        found = Lost() if error is None else Right(self.at)
        found.error = error  # type: ignore[union-attr]
        return found


@pytest.fixture(autouse=True)
def plain(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(continuation, "Unsolved", Lost)
    monkeypatch.setattr(continuation, "_guess", lambda *_: "predicted")
    monkeypatch.setattr(continuation, "_give", lambda guess, _: guess)
    monkeypatch.setattr(continuation, "_compare", lambda _, found: found.error)
    monkeypatch.setattr(
        continuation,
        "_list_solutions",
        lambda found: [SimpleNamespace(resimulation=SimpleNamespace(defect=found.value))],
    )


def go(*errors: float | None, to: float = 5.0, **given: Any) -> tuple[Any, Control]:
    control = Control(*errors, **given)
    return follow(control, "n", to), control


def test_steps_grow_while_predictions_are_good_and_end_at_the_value() -> None:
    """By at most a factor; the last one ends there exactly. Each is noted with its cost, error and defect."""
    for to, way in ((5.0, 4.0), (-3.0, -4.0)):
        found, control = go(0.0, to=to)
        steps = np.diff([1.0, *control.aims])
        assert steps[0] == pytest.approx(FIRST * way)
        assert steps[1] == pytest.approx(GROWTH * FIRST * way)
        assert control.aims[-1] == to
        assert (found.status, found.value, found.is_reached, found.solution.value) == (REACHED, to, True, to)
        assert found.stops[0] == Stop(1.0, True, "good", 10.0, 3, pytest.approx(math.nan, nan_ok=True), 1.0)
        assert found.stops[-1] == Stop(to, True, "good", 10 * to, 3, 0.0, to)
    assert follow(Control(0.0), "n", 1.0).status == REACHED


def test_steps_follow_the_root_of_the_error() -> None:
    """A prediction with the wished error keeps the length; a worse one that is taken shortens it."""
    _, control = go(WISHED)
    assert np.diff([1.0, *control.aims])[1] == pytest.approx(4 * FIRST)
    wanted = WISHED / 0.64
    if wanted <= MOST:
        _, control = go(wanted)
        assert np.diff([1.0, *control.aims])[1] == pytest.approx(4 * FIRST * 0.8)


def test_a_step_that_fails_or_errs_too_much_is_taken_anew_shorter() -> None:
    """By at least a half, and by no less than a factor."""
    for error, factor in ((None, SHRINKING), (1e6, SHRINKING), (1.0001 * MOST, min(0.5, math.sqrt(WISHED / MOST)))):
        found, control = go(error, 0.0)
        assert control.aims[0] == pytest.approx(1.0 + 4 * FIRST)
        assert control.aims[1] - 1.0 == pytest.approx(4 * FIRST * factor, rel=1e-3)
        assert [stop.is_taken for stop in found.stops][:3] == [True, False, True]
        assert found.status == REACHED
    found, _ = go(None, 0.0)
    assert found.stops[1].status == "bad"
    assert (found.stops[1].iterations, math.isnan(found.stops[1].cost), math.isnan(found.stops[1].error)) == (
        9,
        True,
        True,
    )


def test_a_way_that_no_step_is_short_enough_for_is_stuck_or_turns() -> None:
    """It turns where the inverse of the squared speed of motions vanishes near the last value."""
    found, control = go(None)
    assert (found.status, found.value, found.solution.value) == (STUCK, 1.0, 1.0)
    assert abs(control.aims[-1] - 1.0) >= SHORTEST * 4
    end = 1.0 + 4 * FIRST * 1.03
    found, _ = go(0.0, None, speed=lambda v: (end - v) ** -0.5)
    assert (found.status, found.turning) == (TURNING, pytest.approx(end))
    assert f"at about {end:.6g}" in found.reason
    found, _ = go(0.0, None, speed=lambda _: 1.0)
    assert (found.status, math.isnan(found.turning)) == (STUCK, True)


def test_a_problem_that_is_not_solved_at_its_start_goes_nowhere() -> None:
    shown: list[Stop] = []
    found = follow(Control(0.0, first=False), "n", 5.0, "own", shown.append)
    (stop,) = found.stops
    assert (stop.value, stop.is_taken, stop.status, stop.iterations) == (1.0, False, "bad", 9)
    assert (found.status, math.isnan(found.value), shown) == ("bad", True, [stop])
    with pytest.raises(ProblemError, match="found the value inf; give a finite one"):
        follow(Control(0.0), "n", math.inf)


def test_ways_end_after_their_most_solves(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(continuation, "LIMIT", 2)
    found, control = go(0.0)
    assert (found.status, len(found.stops), len(control.aims)) == (STUCK, 2, 1)
    assert LIMIT > 2


@pytest.mark.parametrize(
    ("speeds", "turning"),
    [
        ([], math.nan),
        ([(1.0, 1.0)], math.nan),
        ([(1.0, 1.0), (2.0, math.sqrt(2.0))], 3.0),
        ([(9.0, 9.0), (1.0, 1.0), (2.0, 2.0)], 2.0 + 0.25 / 0.75),
        ([(1.0, 1.0), (2.0, 1.0)], math.nan),
        ([(1.0, 2.0), (2.0, 1.0)], math.nan),
        ([(1.0, 0.0), (2.0, 1.0)], math.nan),
    ],
)
def test_ways_turn_where_the_inverse_of_the_squared_speed_vanishes(speeds: Any, turning: float) -> None:
    assert _find_turning(speeds) == pytest.approx(turning, nan_ok=True)


def test_errors_are_relative_to_the_size_of_each_kind_of_numbers(monkeypatch: pytest.MonkeyPatch) -> None:
    """Coordinates, velocities and states; the largest of all phases."""

    def motion(q: float, qd: float, states: list[float]) -> Any:
        return SimpleNamespace(q=np.array([[q, 4.0]]), qd=np.array([[qd, 2.0]]), states=np.array([states]))

    def compare(*pairs: Any) -> float:
        solutions = [SimpleNamespace(trajectory=b) for _, b in pairs]
        monkeypatch.setattr(continuation, "_list_solutions", lambda _: solutions)
        guess: Any = SimpleNamespace(trajectories=[a for a, _ in pairs])
        return _compare(guess, None)

    same = motion(1.0, 1.0, [])
    assert compare((same, same)) == 0.0
    assert compare((motion(1.5, 1.0, []), same)) == pytest.approx(0.5 / 4)
    assert compare((motion(1.5, 1.5, []), same)) == pytest.approx(0.5 / 2)
    assert compare((same, same), (motion(1.0, 1.0, [3.0]), motion(1.0, 1.0, [2.0]))) == pytest.approx(0.5)
