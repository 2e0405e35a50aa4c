"""When a controller in C moves its plan ahead, makes steps, or solves anew; the controller is a stand-in.

It notes each call. Its plan has inputs 0, 1, 2, 3 in four intervals of 0.2 s, from the last move on.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from mbsrun.ocp.problem.problem import Control, Force, Problem, State, Unknown
from mbsrun.tracking.compiled import CompiledController, MisfitError, Stepping
from tests.mbsrun.ocp.plants import push

Array = NDArray[np.float64]

INTERVAL = 0.2
PROBLEM = replace(push(4), horizon=0.8, states=(State("heat", "1"),))


def describe(**changes: Any) -> Any:
    data = {"start_q": ("slide",), "start_qd": ("slide",), "start_states": ("heat",), "constants": ("k", "t0")}
    usual = {
        "data": tuple(
            SimpleNamespace(name=name, entries=[SimpleNamespace(name=x) for x in entries])
            for name, entries in (data | changes.pop("data", {})).items()
        ),
        "states": tuple(SimpleNamespace(name=name) for name in ("q_slide", "qd_slide", "s_heat")),
        "inputs": ("slide",), "intervals": 4, "horizon": 0.8, "prefix": "push", "cost": -5.0, "scale": 0.1,
        "delays": (),
    }  # fmt: skip
    return SimpleNamespace(**(usual | changes))


class Called:
    """Notes calls; each has the status and violation that is set beforehand."""

    folder, period = Path("place"), INTERVAL

    def __init__(self, **changes: Any) -> None:
        self.manifest = describe(**changes)
        self.options = SimpleNamespace(mu_target=0.0)
        self.data = {field.name: np.zeros(len(field.entries)) for field in self.manifest.data}
        self.calls, self.is_solved = list[Any](), True
        self.prepared, self.stepped, self.violation = "prepared", "stepped", 0.0

    def solve(self, *, warm: bool) -> Any:
        self.calls.append(("solve", warm))
        return SimpleNamespace(status="solved", is_solved=self.is_solved, iterations=7, violation=1e-9)

    def rescue(self, state: Array) -> Any:
        self.calls.append(("rescue", state.tolist()))
        return np.array([8.0]), SimpleNamespace(status="solved", is_solved=self.is_solved, iterations=5)

    def prepare(self, *, shift: bool = False) -> Any:
        self.calls.append("shift" if shift else "prepare")
        return SimpleNamespace(status=self.prepared, violation=self.violation)

    def feedback(self, state: Array) -> Any:
        self.calls.append(("feedback", state.tolist()))
        return np.array([9.0]), SimpleNamespace(status=self.stepped, violation=self.violation)

    def plan(self) -> Any:
        inputs = np.arange(4.0)[:, None] * np.ones(len(self.manifest.inputs))
        return SimpleNamespace(times=3.0 + INTERVAL * np.arange(5), inputs=inputs)


def start(
    called: Called, stepping: Stepping | None = None, period: float = INTERVAL, problem: Problem = PROBLEM
) -> CompiledController:
    given: Any = called
    return CompiledController(given, problem, period, stepping)


def ask(controller: CompiledController, time: float = 0.0, **constants: float) -> Any:
    controller.prepare(time, constants)
    controller.measure(np.array([4.0]))
    return controller.feedback(np.array([1.0]), np.array([2.0]))


STATE = [1.0, 2.0, 4.0]


def test_each_solve_begins_at_the_measured_state_from_the_plan_moved_ahead() -> None:
    """The first one has no plan to begin with; a failed first one leaves none."""
    called = Called()
    controller = start(called)
    called.is_solved = False
    assert not ask(controller).is_solved
    called.is_solved = True
    decision = ask(controller, 0.0, t0=6.0)
    assert (decision.status, decision.is_solved, decision.iterations, decision.violation) == ("solved", True, 7, 1e-9)
    assert decision.inputs.tolist() == [0.0]
    assert {name: x.tolist() for name, x in called.data.items()} == {
        "start_q": [1.0], "start_qd": [2.0], "start_states": [4.0], "constants": [0.0, 6.0]
    }  # fmt: skip
    ask(controller, 3 * INTERVAL)
    called.is_solved = False
    ask(controller, 3 * INTERVAL)
    assert called.calls == [("solve", False), ("solve", False), *["shift"] * 3, ("solve", True), ("solve", True)]


def test_states_that_nothing_measures_stay_as_they_are_in_the_data() -> None:
    called = Called()
    called.data["start_states"][:] = 7.0
    start(called).feedback(np.array([1.0]), np.array([2.0]))
    assert called.data["start_states"].tolist() == [7.0]


def test_steps_in_real_time_are_prepared_once_and_made_as_often_as_asked() -> None:
    """In periods of half an interval, every other one moves the plan ahead; the first plan is solved for."""
    called = Called()
    controller = start(called, Stepping(3), INTERVAL / 2)
    assert ask(controller).status == "solved"
    called.calls.clear()
    decision = ask(controller, INTERVAL / 2)
    assert (decision.status, decision.is_solved, decision.iterations) == ("stepped", True, 3)
    assert (decision.inputs.tolist(), decision.is_rescue) == ([9.0], False)
    step = ("feedback", STATE)
    assert called.calls == ["prepare", step, "prepare", step, "prepare", step]
    called.calls.clear()
    ask(controller, INTERVAL)
    assert called.calls == ["shift", step, "prepare", step, "prepare", step]


def test_a_step_that_fails_keeps_the_plan() -> None:
    called = Called()
    controller = start(called, Stepping(2))
    ask(controller)
    called.stepped, called.violation = "not_finite", 0.25
    called.calls.clear()
    decision = ask(controller, INTERVAL)
    assert (decision.status, decision.is_solved, decision.violation) == ("not_finite", False, 0.25)
    assert called.calls == ["shift", ("feedback", STATE)]
    assert decision.inputs.tolist() == [0.0]


def test_a_plan_that_is_lost_or_violates_too_much_is_solved_for_anew() -> None:
    """By its status before a step or between steps, and by a violation above the limit, or none."""
    called = Called()
    controller = start(called, Stepping(2, rescue=0.5))
    ask(controller)
    for k, (status, violation, is_rescue) in enumerate(
        [("prepared", 0.5, False), ("prepared", 0.51, True), ("diverged", 0.0, True), ("prepared", math.nan, True)], 1
    ):
        called.prepared, called.violation = status, violation
        decision = ask(controller, k * INTERVAL)
        assert decision.is_rescue is is_rescue
        if is_rescue:
            assert (decision.status, decision.is_solved, decision.iterations) == ("solved", True, 5)
            assert (decision.inputs.tolist(), called.calls[-1]) == ([8.0], ("rescue", STATE))
    called.is_solved, called.prepared, called.violation = False, "diverged", 0.0
    decision = ask(controller, 5 * INTERVAL)
    assert (decision.is_solved, decision.is_rescue, decision.inputs.tolist()) == (False, True, [0.0])


def test_a_plan_that_is_lost_between_steps_is_solved_for_anew() -> None:
    called = Called()
    controller = start(called, Stepping(2))
    ask(controller)
    shift = called.prepare
    called.prepare = lambda *, shift_=shift, shift=False: (  # type: ignore[assignment,misc]
        shift_(shift=shift) if shift else SimpleNamespace(status="diverged", violation=0.0)
    )
    decision = ask(controller, INTERVAL)
    assert decision.is_rescue
    assert [call if isinstance(call, str) else call[0] for call in called.calls[-3:]] == ["shift", "feedback", "rescue"]


def test_plans_are_read_over_a_period_from_the_time_of_their_start() -> None:
    """Means over the period; an input that acts late is given as many intervals earlier."""
    called = Called()
    controller = start(called, period=INTERVAL)
    ask(controller, 0.0)
    assert controller.planned(1.5 * INTERVAL)[0] == pytest.approx(1.5)
    assert controller.planned(9.0)[0] == pytest.approx(3.0)
    ask(controller, 2 * INTERVAL)
    assert controller.planned(2 * INTERVAL)[0] == pytest.approx(0.0)
    late = start(Called(delays=(2,)))
    ask(late)
    assert late.planned(0.0)[0] == pytest.approx(2.0)
    halves = start(Called(), period=INTERVAL / 2)
    ask(halves)
    assert halves.planned(1.75 * INTERVAL)[0] == pytest.approx(1.5)


def test_inputs_that_are_given_are_written_down_for_the_plan_of_now() -> None:
    """The ones of later periods are the plan's own; an input that an expression gives is none of the controller's."""
    called = Called(data={"inputs_given": ("c",)}, inputs=("c",))
    problem = replace(PROBLEM, controls=(Control("c"),), forces=(Force(0, "c"),))
    controller = start(called, problem=problem)
    for time, given in ((0.0, 6.0), (0.49 * INTERVAL, 7.0), (0.51 * INTERVAL, 7.0), (-INTERVAL, 7.0)):
        controller.note(time, np.array([5.0, 6.0 + (time != 0)]))
        assert called.data["inputs_given"].tolist() == [given]
    assert ask(controller).inputs.tolist() == [0.0, 0.0]
    assert controller.planned(INTERVAL) == pytest.approx([0.0, 1.0])
    start(Called()).note(0.0, np.array([5.0]))


def test_steps_go_on_beside_the_cost_of_the_optimum() -> None:
    """mu = barrier * scale * |cost|; solves keep their own."""
    for stepping, cost, expected in (
        (Stepping(1, barrier=0.02), -5.0, 0.02 * 0.1 * 5),
        (Stepping(1), -5.0, 3e-4 * 0.1 * 5),
        (Stepping(1), 0.0, 0.0),
        (None, -5.0, 0.0),
    ):
        called = Called(cost=cost)
        start(called, stepping)
        assert called.options.mu_target == pytest.approx(expected)


def test_numbers_that_a_problem_chooses_are_held_states() -> None:
    """Nothing measures them: steps begin at 0 there."""
    states = tuple(SimpleNamespace(name=name) for name in ("q_slide", "qd_slide", "s_heat", "p"))
    called = Called(states=states)
    controller = start(called, Stepping(1), problem=replace(PROBLEM, unknowns=(Unknown("p"),)))
    ask(controller)
    ask(controller, INTERVAL)
    assert called.calls[-1] == ("feedback", [*STATE, 0.0])


def test_what_does_not_fit_is_refused_with_its_folder() -> None:
    with pytest.raises(MisfitError, match=r"^place/manifest.json: push is of another problem: .*; write it again"):
        start(Called(intervals=5))
    with pytest.raises(MisfitError, match=r"^place/manifest.json: the controller's intervals of 0.2 s are no multiple"):
        start(Called(), period=0.15)
