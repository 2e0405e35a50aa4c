"""Decisions at events of a differentiated motion, by hand: which guard counts, what grazes, and what is no event."""

from __future__ import annotations

from functools import partial
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from mbsrun.simulation.integration.tableaus import DOP853, RK4
from mbsrun.simulation.motion import Segment
from mbsrun.simulation.saltation import _Watcher
from mbsrun.simulation.variation import Crossing, SlopeError
from tests.mbsrun.simulation.curved import slope

Array = NDArray[np.float64]
OLD, NEW = Segment((0,)), Segment((2,))
X = np.array([[1.0, 2.0], [3.0, 4.0]])


class Script:
    """A field whose rates, guards and impacts are given."""

    def __init__(self, before: list[float], after: list[float], **given: Any) -> None:
        self.rates = {id(OLD): np.array(before), id(NEW): np.array(after)}
        self.crossings: list[Crossing] = given.get("crossings", [])
        self.impact: Array | None = given.get("impact")
        self.guards = given.get("guards", True)
        self.projection = np.array(given.get("projection", np.eye(2)))

    def strike(self, _segment: Segment, _before: Array) -> Array | None:
        """Return the derivative of an impact."""
        return self.impact

    def has_guards(self, _: Segment) -> bool:
        """Return whether there are guards."""
        return bool(self.guards)

    def project(self, _x: Array, _segment: Segment) -> Array:
        """Return what keeps equations."""
        return self.projection

    def at(self, _t: Array, _x: Array, _piece: Any, segment: Segment) -> tuple[Array, None]:
        """Return rates."""
        return self.rates[id(segment)][None], None

    def list_crossings(self, *_: Any) -> list[Crossing]:
        """Return the guards."""
        return self.crossings


def cross(slope: list[float], drift: float = 0.0, rebound: float | None = None, name: str = "joint a") -> Crossing:
    """Make a guard."""
    return Crossing(np.array(slope), drift, name, 0, rebound)


def jump(field: Script, rebounds: dict[int, float] | None = None) -> _Watcher:
    """Pass an event."""
    watcher = _Watcher(RK4, 2)
    watcher.X = X.copy()
    watcher.last = np.array([0.0, 0.0]), None, OLD  # type: ignore[assignment]
    watcher.rebounds = rebounds or {}
    given: Any = field
    watcher.jump(given, 2.0, NEW, np.array([0.0, 0.0]))
    return watcher


def test_an_event_multiplies_by_its_saltation_matrix() -> None:
    """R + (f+ - R f-) g'/(g' f- + g_t), with R of the impact, and what keeps the equations after it."""
    R, P = np.array([[1.0, 0.5], [0.0, -0.5]]), np.array([[1.0, 0.0], [0.25, 1.0]])
    before, after, slope, drift = [3.0, -1.0], [2.0, 0.5], [0.5, 2.0], 0.75
    for impact, guards in ((R, False), (R, True), (None, True)):
        field = Script(before, after, crossings=[cross(slope, drift)], impact=impact, guards=guards, projection=P)
        whole = P @ (np.eye(2) if impact is None else R)
        change = np.array(after) - whole @ before
        expected = (whole + np.outer(change, slope) / (np.dot(slope, before) + drift)) @ X
        watcher = jump(field)
        assert pytest.approx(expected, rel=1e-12) == watcher.X
        assert watcher.finding is None


def test_without_guards_and_impacts_nothing_happens() -> None:
    watcher = jump(Script([1.0, 1.0], [5.0, 5.0], guards=False, projection=2 * np.eye(2)))
    assert watcher.X.tolist() == X.tolist()


@pytest.mark.parametrize(("part", "is_event"), [(0.9e-10, False), (1.1e-10, True)])
@pytest.mark.parametrize("sign", [1, -1])
def test_an_event_that_changes_no_rate_is_none(part: float, is_event: bool, sign: int) -> None:
    """Up to 1e-10 of the larger rates; an impact is one in any case."""
    for before, after in (([4.0, 1.0], [4.0, 1 + sign * 4 * part]), ([1.0, -4.0], [1 + sign * 4 * part, -4.0])):
        watcher = jump(Script(before, after, crossings=[cross([0.0, 1.0]), cross([1.0, 0.0])]))
        assert (watcher.finding is not None) == is_event
    watcher = jump(Script([4.0, 1.0], [4.0, 1.0], crossings=[], impact=np.eye(2)))
    assert watcher.finding == "a joint hits a stop as an input jumps at t = 2 s, where there is no derivative"


def test_a_state_that_stays_at_rest_has_no_event() -> None:
    """No rate changes, however large the rates are."""
    watcher = jump(Script([0.0, 0.0], [0.0, 0.0], crossings=[]))
    assert (watcher.finding, watcher.X.tolist()) == (None, X.tolist())


def test_an_event_whose_guard_nothing_moves_grazes() -> None:
    """Its rate is 0, and so is its slope: its time is undetermined."""
    watcher = jump(Script([1.0, 0.0], [2.0, 0.0], crossings=[cross([0.0, 0.0])]))
    assert watcher.finding == "joint a grazes at t = 2 s, where there is no derivative"
    assert watcher.X.tolist() == X.tolist()


def test_guards_that_meet_at_all_neighbouring_starts_are_one_event() -> None:
    """The times of guards have the same derivative by the start, to 1e-6 of the largest."""
    before, after = [2.0, 3.0], [5.0, 5.0]
    first = cross([1.0, 0.0])
    for off, is_same in ((0.9e-6, True), (1.1e-6, False)):
        second = cross([2.0 * (1 + off), 0.0])
        moved = cross([2.0, 0.0], 4.0 / (1 + off) - 4.0)
        assert jump(Script(before, after, crossings=[first, second])).finding is None
        watcher = jump(Script(before, after, crossings=[first, moved]))
        if is_same:
            assert watcher.finding is None
            expected = np.eye(2) + np.outer([3.0, 2.0], [1.0, 0.0]) / 2
            assert pytest.approx(expected @ X) == watcher.X
        else:
            assert watcher.finding == "several joints switch at once at t = 2 s, where there is no derivative"
    third = jump(Script(before, after, crossings=[first, first, cross([0.0, 1.0], name="contact b")]))
    assert third.finding == "several joints switch at once at t = 2 s, where there is no derivative"
    still = jump(Script(before, after, crossings=[first, cross([3.0, -2.0])]))
    assert still.finding is not None
    assert pytest.approx(X) == still.X


@pytest.mark.parametrize(("part", "grazes"), [(0.9e6, False), (1.1e6, True)])
@pytest.mark.parametrize("sign", [1, -1])
def test_an_event_that_makes_a_million_of_a_small_change_grazes(part: float, grazes: bool, sign: int) -> None:
    """Unless the guard's rate is above a tenth of the speed after the last impact there: one of many bounces."""
    before, after, slope = [sign * 1e-3, 0.0], [sign * 1e-3, -part * 1e-3 / 2], [2.0, 0.0]
    field = Script(before, [after[0], 2 * after[1]], crossings=[cross(slope, 0.0, 7.0, "joint c")])
    watcher = jump(field)
    assert watcher.finding == ("joint c grazes at t = 2 s, where there is no derivative" if grazes else None)
    assert watcher.rebounds == {0: 7.0}
    for last, returns in ((1.9e-2, True), (2.1e-2, False)):
        watcher = jump(field, {0: last})
        assert (watcher.finding is None) == (returns or not grazes)
        other = jump(field, {1: last})
        assert (other.finding is None) == (not grazes)
    slow = Script(before, [after[0], 2 * after[1]], crossings=[cross(slope, 0.0, None, "joint c")])
    watcher = jump(slow, {0: 1e-9})
    assert (watcher.finding is None) == (not grazes)
    assert watcher.rebounds == {0: 1e-9}


def test_the_first_finding_is_kept() -> None:
    watcher = _Watcher(RK4, 2)
    watcher.note("one", 0.25)
    watcher.note("two", 0.5)
    assert watcher.finding == "one at t = 0.25 s, where there is no derivative"


@pytest.mark.parametrize("pair", [RK4, DOP853])
def test_steps_are_differentiated_as_they_are_taken(pair: Any) -> None:
    """The derivative of a step of x' = (sin(t) x_1 + x_2^2, t x_1 x_2 - 2) is the one by complex steps."""
    tableau = pair.tableau

    def rate(t: float, x: NDArray[Any]) -> NDArray[Any]:
        return np.array([np.sin(t) * x[0] + x[1] ** 2, t * x[0] * x[1] - 2])

    def at(t: Array, x: Array, *_: Any) -> tuple[Array, Array]:
        pairs = list(zip(t, x, strict=True))
        return np.array([rate(*y) for y in pairs]), np.array([slope(partial(rate, s), y) for s, y in pairs])

    def step(x: NDArray[Any], start: float, h: float) -> NDArray[Any]:
        slopes = list[NDArray[Any]]()
        for row, c in zip(tableau.A, tableau.c, strict=True):
            y = x + h * sum((float(a) * s for a, s in zip(row, slopes, strict=False)), np.zeros(2))
            slopes.append(rate(start + float(c) * h, y))
        return np.asarray(x + h * sum((float(b) * s for b, s in zip(tableau.b, slopes, strict=True)), np.zeros(2)))

    t, x = np.array([0.2, 0.5, 1.1]), np.array([[1.0, -0.5], [0.75, 2.0], [0.0, 0.0]])
    found = _Watcher(pair, 2).differentiate(SimpleNamespace(at=at), None, t, x, OLD)  # type: ignore[arg-type]
    for k in range(2):
        expected = slope(partial(step, start=t[k], h=t[k + 1] - t[k]), x[k])
        assert found[k] == pytest.approx(expected, rel=1e-11, abs=1e-12)


def test_a_motion_that_begins_with_an_impact_has_no_derivative() -> None:
    """Steps carry the derivative, between what keeps the equations at both ends."""
    chunk: Any = SimpleNamespace(t=np.array([0.0, 1.0]), q=np.zeros((2, 1)), qd=np.zeros((2, 1)), segment=NEW)
    for impact in (None, np.eye(2)):
        watcher = _Watcher(RK4, 2)
        field: Any = Script([0.0, 0.0], [0.0, 0.0], impact=impact, projection=[[1.0, 2.0], [0.0, 1.0]])
        watcher.field = field
        watcher.differentiate = lambda *_: [np.diag([2.0, 3.0]), np.diag([5.0, 7.0])]  # type: ignore[method-assign,assignment]
        given: Any = None
        watcher.add(given, given, chunk)
        if impact is None:
            P = field.projection
            assert (P @ np.diag([10.0, 21.0]) @ P).tolist() == watcher.X.tolist()
            assert watcher.finding is None
            watcher.finding = "done"
            watcher.add(given, given, chunk)
            assert (P @ np.diag([10.0, 21.0]) @ P).tolist() == watcher.X.tolist()
        else:
            expected = "the motion begins with an impact at t = 0 s, where there is no derivative"
            assert watcher.finding == expected
    assert issubclass(SlopeError, Exception)


def test_equations_are_kept_at_both_ends_of_steps() -> None:
    """By the states there, first to last; steps without a mode have free joints, one for each velocity."""
    asked: list[tuple[list[float], Segment]] = []

    def project(x: Array, segment: Segment) -> Array:
        asked.append((x.tolist(), segment))
        return np.eye(3)

    watcher = _Watcher(RK4, 3)
    field: Any = SimpleNamespace(strike=lambda *_: None, project=project)
    watcher.field = field
    watcher.differentiate = lambda *_: []  # type: ignore[method-assign,assignment]
    q, qd = np.array([[1.0], [4.0], [7.0]]), np.array([[2.0, 3.0], [5.0, 6.0], [8.0, 9.0]])
    chunk: Any = SimpleNamespace(t=np.array([0.0, 1.0, 2.0]), q=q, qd=qd, segment=None)
    given: Any = None
    watcher.add(given, given, chunk)
    assert [x for x, _ in asked] == [[1.0, 2.0, 3.0], [7.0, 8.0, 9.0]]
    assert all(segment.modes == (0, 0) for _, segment in asked)
    assert watcher.last is not None
    assert watcher.last[0].tolist() == [7.0, 8.0, 9.0]
