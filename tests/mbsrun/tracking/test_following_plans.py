"""Requests of a controller to its solver at each sample: starts, inputs that were given, constants, and horizons.

The solver is a stand-in that returns its guess as the plan, so that every request is seen and takes no time.
"""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from mbsrun.ocp.ground import schemes
from mbsrun.ocp.guessing.guess import Pose
from mbsrun.ocp.problem.problem import Bounds, Control, Delay, Drive, Problem, State, WrenchComponent
from mbsrun.ocp.solution.solution import Failure
from mbsrun.ocp.statement.checks import ProblemError
from mbsrun.tracking import Horizon, SolvingController
from mbsrun.tracking.solving import UNREACHED
from tests.mbsrun.ocp.plants import FREE_RANGE, push
from tests.mbsrun.peer import double_integrator

INF = math.inf
FREE = (FREE_RANGE,)
PERIOD = 0.25


class Asked:
    """Keeps what it is asked for; fails where `fails` is set."""

    def __init__(self) -> None:
        self.problems, self.guesses, self.fails = list[Problem](), list[Any](), False

    def __call__(self, problem: Problem, _plant: Any, *, is_judged: bool) -> Asked:
        assert not is_judged
        self.transcription = SimpleNamespace(scheme=schemes.build(problem.family, problem.degree))
        return self

    def solve(self, problem: Problem, guess: Any) -> Any:
        self.problems.append(problem)
        self.guesses.append(guess)
        run = SimpleNamespace(status="Done", iterations=3, cpu_seconds=0.5)
        if self.fails:
            failed = object.__new__(Failure)
            object.__setattr__(failed, "run", run)
            return failed
        plan = replace(guess, controls=np.zeros((len(guess.u), len(problem.controls))))
        return SimpleNamespace(run=run, trajectory=plan, violation=SimpleNamespace(constraints=1e-9))


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> Asked:
    found = Asked()
    monkeypatch.setattr("mbsrun.tracking.solving.Solver", found)
    return found


def start(horizon: Horizon | None = None, **changes: Any) -> SolvingController:
    return SolvingController(replace(push(4), **changes), double_integrator(), PERIOD, horizon)


def give(controller: SolvingController, q: float = 0.5, qd: float = -2.0) -> Any:
    return controller.feedback(np.array([q]), np.array([qd]))


def test_each_sample_begins_at_the_measured_state(asked: Asked) -> None:
    """States that the problem adds begin there too, unless the plan chooses where."""
    states = (State("heat", "1", start=(0.0, 0.0)), State("open", "1"))
    controller = start(states=states, constants=(("t0", 0.0), ("k", 5.0)))
    controller.measure(np.array([7.0, 8.0]))
    controller.prepare(PERIOD, {"t0": 3.0})
    decision = give(controller)
    (problem,) = asked.problems
    assert (problem.start_q, problem.start_qd) == ((0.5,), (-2.0,))
    assert [state.start for state in problem.states] == [(7.0, 7.0), (-INF, INF)]
    assert problem.constants == (("t0", 3.0), ("k", 5.0))
    assert (decision.status, decision.is_solved, decision.iterations, decision.seconds) == ("Done", True, 3, 0.5)
    assert decision.violation == 1e-9
    assert not decision.is_rescue
    controller.prepare(2 * PERIOD, {})
    give(controller)
    assert asked.problems[1].constants == (("t0", 3.0), ("k", 5.0))
    assert asked.problems[0].solver.fallback is False


def test_states_that_nothing_measures_begin_as_the_problem_says(asked: Asked) -> None:
    give(start(states=(State("heat", "1", start=(0.5, 0.5)),)))
    assert asked.problems[0].states[0].start == (0.5, 0.5)


def test_a_plan_moves_ahead_by_the_time_that_has_passed(asked: Asked) -> None:
    """From rest at 0 to 1 the guess is smooth; two periods later, its second half comes first."""
    controller = start()
    give(controller, 0.0, 0.0)
    first = asked.guesses[0]
    controller.prepare(2 * PERIOD, {})
    give(controller)
    assert asked.guesses[1].q[:3] == pytest.approx(first.q[2:])
    assert controller.planned(3 * PERIOD) == pytest.approx(first.u[3])


def test_commands_that_act_late_are_the_ones_that_were_given(asked: Asked) -> None:
    """The oldest first; where nothing was given yet, the history."""
    delays = (Delay("control", 0, 0.5, 9.0), Delay("input", 0, 0.25, 8.0))
    controller = start(delays=delays, controls=(Control("c"),), bounds=Bounds(FREE, FREE, FREE))
    for k, (u, c) in enumerate([(1.0, 10.0), (2.0, 20.0), (3.0, 30.0)]):
        controller.note(k * PERIOD, np.array([u, c]))
    for k, commands in ((0, [(9.0, 9.0), (8.0,)]), (1, [(9.0, 10.0), (1.0,)]), (3, [(20.0, 30.0), (3.0,)])):
        controller.prepare(k * PERIOD, {})
        give(controller)
        assert [delay.commands for delay in asked.problems[-1].delays] == commands


def test_first_inputs_and_controls_keep_their_rates_after_the_last(asked: Asked) -> None:
    bounds = Bounds(FREE, FREE, FREE, ((-2.0, 4.0),))
    controller = start(bounds=bounds, controls=(Control("c", rates=(-8.0, 12.0)),))
    give(controller)
    assert (asked.problems[0].first_inputs, asked.problems[0].first_controls) == ((), ())
    controller.note(0.0, np.array([10.0, 20.0]))
    controller.prepare(PERIOD, {})
    give(controller)
    assert (asked.problems[1].first_inputs, asked.problems[1].first_controls) == (((9.5, 11.0),), ((18.0, 23.0),))


def test_a_horizon_ends_at_a_fixed_time_until_it_is_short(asked: Asked) -> None:
    controller = start(Horizon(1.0, 0.5))
    for time, length in ((0.0, 1.0), (0.25, 0.75), (0.75, 0.5)):
        controller.prepare(time, {})
        give(controller)
        assert (asked.problems[-1].horizon, asked.problems[-1].horizon_range) == (length, (length, length))


def test_a_solve_that_fails_keeps_the_plan(asked: Asked) -> None:
    controller = start()
    first = give(controller, 0.0, 0.0)
    asked.fails = True
    controller.prepare(PERIOD, {})
    lost = give(controller)
    assert (lost.status, lost.is_solved, lost.iterations, lost.seconds) == ("Done", False, 3, 0.5)
    assert math.isnan(lost.violation)
    assert lost.inputs == pytest.approx(asked.guesses[0].u[1])
    assert first.inputs == pytest.approx(asked.guesses[0].u[0])


def test_after_a_first_solve_that_fails_the_next_one_begins_at_a_guess(asked: Asked) -> None:
    """Inputs are 0 until there is a plan."""
    controller = start()
    asked.fails = True
    assert give(controller).inputs.tolist() == [0.0]
    asked.fails = False
    controller.prepare(PERIOD, {})
    assert give(controller).is_solved
    assert asked.guesses[1].q[0, 0] == 0.5


def test_without_a_pose_for_a_guess_nothing_is_solved(asked: Asked, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mbsrun.tracking.solving.make_guess", lambda *_: object.__new__(Pose))
    decision = give(start())
    assert (decision.status, decision.is_solved, decision.iterations, decision.seconds) == (UNREACHED, False, 0, 0.0)
    assert math.isnan(decision.violation)
    assert (decision.inputs.tolist(), asked.problems) == ([0.0], [])


LATE = (Delay("input", 0, 0.25),)
REFUSED: list[tuple[dict[str, Any], Horizon | None, str]] = [
    ({"inputs": "polynomial"}, None, "inputs: a sample holds its inputs from sample to sample"),
    ({"wrenches": (WrenchComponent("w", 0),)}, None, "wrenches: the simulated plant takes inputs u and controls"),
    ({"driven": (Drive(0, "t"),)}, None, "driven: each plan would move driven joints"),
    ({"delays": (Delay("input", 0, 0.25, None),)}, None, "inputs.history: the loop knows the inputs before its start"),
    ({"delays": LATE}, Horizon(1.0, 0.5), r"inputs.delay: .* a horizon of one length"),
    ({"delays": LATE, "intervals": 8}, None, r"periods of 0.25 s are none; give a rate of 8 Hz"),
]


@pytest.mark.parametrize(("changes", "horizon", "message"), REFUSED)
def test_problems_that_no_sample_serves_are_refused(
    changes: dict[str, Any], horizon: Horizon | None, message: str
) -> None:
    with pytest.raises(ProblemError, match=message):
        start(horizon, **changes)
