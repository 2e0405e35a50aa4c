"""Samples of a loop by a plant that is written down here: which inputs act when, and which figures come out.

The plant is a row of formulas, so that each number of the track is known: x' = 1, v' = -1, s' = 2.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from mbsrun.ocp.problem.problem import Bounds
from mbsrun.simulation.motion import Halt, Settings
from mbsrun.tracking import Decision, Fallback, Noise, Track, Trial, track
from mbsrun.tracking.added import Line
from mbsrun.tracking.loop import UNPREDICTED
from mbsrun.tracking.plant import Stretch

Array = NDArray[np.float64]

FREE = (-np.inf, np.inf)
BOUNDS = Bounds((FREE,), (FREE,), (FREE, FREE))
QUIET = Noise(np.zeros(1), np.zeros(1), np.zeros(2))
TRIAL = Trial(
    "rail",
    0.5,
    0.1,
    np.array([3.0]),
    np.array([5.0]),
    QUIET,
    Settings(1.0),
    start_states=np.array([7.0]),
    states=("s",),
)
RATES = np.array([1.0, -1.0, 2.0])


class Rail:
    """A plant whose drifts are given by period; noise adds 0.5 to every input that acts."""

    def __init__(self, drifts: tuple[float | None, ...] = (0.0,) * 9, *, is_whole: bool = True, late: int = 0) -> None:
        self.drifts, self.is_whole, self.acted = drifts, is_whole, list[list[float]]()
        self.lines = (Line(1, late, 9.0),) if late else ()
        self.added = Added(self)

    def measure(self, _k: int, q: Array, qd: Array) -> tuple[Array, Array]:
        return q, qd

    def disturb(self, _k: int, u: Array) -> Array:
        return u + 0.5

    def complete(self, _q: Array, _qd: Array, states: Array, start: float, times: Array, u: Array) -> Array:
        """Return the first input by an expression: a hundred for each second of the period, and s, less the second."""
        every = np.tile(u, (len(times), 1))
        if self.is_whole:
            every[:, 0] = 100 * (times - start) + states[:, 0] - u[1]
        return every

    def advance(self, q: Array, qd: Array, states: Array, start: float, end: float, u: Array) -> Stretch:
        k = len(self.acted)
        self.acted.append(u.tolist())
        t = np.linspace(start, end, 12)
        rows = np.concatenate((q, qd, states)) + np.outer(t - start, RATES)
        drift = self.drifts[k]
        halt = Halt(float(end), None, "it stops", "start anew") if k == len(self.drifts) - 1 else None
        return Stretch(t, rows[:, :1], rows[:, 1:2], rows[:, 2:], drift, drift is None or abs(drift) < 1, halt)


class Added:
    """States that a problem adds, as a controller's model predicts them: twice as fast as the plant moves."""

    def __init__(self, plant: Rail) -> None:
        self.plant, self.calls = plant, list[tuple[float, float, list[float], list[float]]]()
        self.bounds = (FREE,)

    def move_to(self, _model: object) -> Added:
        return self

    def carry(
        self, state: tuple[Array, ...], force: Any, sample: float, times: Array, _trial: Trial, *, controls: Array
    ) -> Array | str:
        self.calls.append((sample, float(times[-1]), force(0.0).tolist(), controls.tolist()))
        if len(self.calls) > 6:
            return "it stops"
        return np.concatenate(state)[None] + np.outer(times - sample, 2 * RATES)


class Asking:
    """Asks for (k, -k) in sample k, and keeps all notes."""

    def __init__(self) -> None:
        self.k, self.states, self.noted = -1, list[list[float]](), list[tuple[float, float]]()
        self.added: Array = np.zeros(0)

    def prepare(self, time: float, constants: Mapping[str, float]) -> None:
        """Nothing follows from the time."""

    def measure(self, states: Array) -> None:
        self.added = states

    def note(self, time: float, inputs: Array) -> None:
        self.noted.append((time, float(inputs[0])))

    def feedback(self, q: Array, qd: Array) -> Decision:
        self.states.append([*q, *qd, *self.added])
        u = np.array([self.k, -self.k], dtype=float)
        self.k += 1
        return Decision(u, "Solved", True, 1, 1e-3, 0.0)

    def planned(self, time: float) -> Array:
        return np.array([50 + time, 60 + time])


def run(plant: Rail, controller: Asking | None = None, **changes: Any) -> Track:
    model: Any = SimpleNamespace(
        manifest=SimpleNamespace(actuated=(0,), inputs=("u",), positions=("x",), quaternions=())
    )
    given: Any = plant
    return track(replace(TRIAL, **changes), BOUNDS, given, controller or Asking(), model)


def test_inputs_that_were_asked_for_belong_to_the_period_that_ends_at_their_time() -> None:
    """The first ones act at 0 as well; inputs by expressions follow each time, from their sample on."""
    found = run(Rail())
    assert len(found.t) == 5 * 11 + 1
    k = np.maximum(np.ceil(found.t / 0.1 * (1 - 1e-12)).astype(int) - 1, 0)
    assert found.u[:, 1] == pytest.approx(-k)
    assert found.u[:, 0] == pytest.approx(100 * (found.t - 0.1 * k) + 7 + 2 * found.t + k)
    assert found.u.shape == (56, 2)
    assert run(Rail(is_whole=False)).u[:, 0] == pytest.approx(k)


def test_each_period_begins_where_the_one_before_ended() -> None:
    """The last one ends with the loop, and holds for a part of a period."""
    found = run(Rail(), duration=0.25)
    assert [sample.time for sample in found.samples] == pytest.approx([0.0, 0.1, 0.2])
    assert found.t[[0, -1]] == pytest.approx([0.0, 0.25])
    for values, start, rate in ((found.q, 3, 1), (found.qd, 5, -1), (found.states, 7, 2)):
        assert values[:, 0] == pytest.approx(start + rate * found.t)
    for k, sample in enumerate(found.samples):
        assert (sample.q[0], sample.qd[0], sample.states[0]) == pytest.approx((3 + 0.1 * k, 5 - 0.1 * k, 7 + 0.2 * k))
        assert sample.acting[1] == sample.u[1] + 0.5
    assert found.is_complete


@pytest.mark.parametrize(
    ("drifts", "drift", "lossy"),
    [
        ((0.25, -0.5, 0.125, 0.0, 0.0, 0.0), 0.5, 0),
        ((0.1, 2.0, -3.0, 0.5, 0.2, 0.0), 3.0, 2),
        ((0.1, None, 0.2, 4.0, 0.1, 0.0), None, 1),
    ],
)
def test_the_largest_drift_of_a_period_is_kept_unless_one_is_unknown(
    drifts: tuple[float | None, ...], drift: float | None, lossy: int
) -> None:
    found = run(Rail(drifts))
    assert (found.drift, found.lossy) == (drift, lossy)


def test_a_halt_of_the_plant_ends_the_loop_after_its_period() -> None:
    found = run(Rail((0.0, 0.0)))
    assert found.halt is not None
    assert (found.halt.finding, len(found.samples), found.t[-1]) == ("it stops", 2, pytest.approx(0.2))
    assert not found.is_complete
    assert repr(found).startswith("Track(0.2 s, 2 samples, 0 without a new plan, incomplete: ")


def test_an_input_that_acts_late_waits_behind_its_history() -> None:
    """Two periods later, and with a delay of the loop a third one."""
    plant = Rail(late=2)
    found = run(plant)
    assert [sample.acting[0] - sample.u[0] for sample in found.samples] == pytest.approx([-0.5] * 5)
    assert [sample.u[1] for sample in found.samples] == [9.0, 9.0, 0.0, -1.0, -2.0]
    assert [u[1] for u in plant.acted] == [9.5, 9.5, 0.5, -0.5, -1.5]
    found = run(Rail(late=2), delay=1, predicts=False)
    assert [sample.u[1] for sample in found.samples] == [9.0, 9.0, 60.0, 0.0, -1.0]


def test_a_controller_plans_from_the_end_of_the_delay_and_is_told_what_was_given() -> None:
    """Its model moves twice as fast; the two periods begin at the sample, under the inputs that are on their way."""
    plant, controller = Rail(late=1), Asking()
    run(plant, controller, delay=2)
    first, second = plant.added.calls[:2]
    assert first == (pytest.approx(0.0), pytest.approx(0.1), [50.0], [9.0])
    assert second == (pytest.approx(0.1), pytest.approx(0.2), [50.1], [60.0])
    assert controller.states[0] == pytest.approx([3, 5, 7])
    assert controller.states[1] == pytest.approx([3.4, 4.6, 7.8])
    assert controller.states[2] == pytest.approx([3.5, 4.5, 8.0])
    assert controller.noted[:4] == [(0.0, 50.0), (0.1, 50.1), (pytest.approx(0.2), 0.0), (pytest.approx(0.3), 1.0)]


@pytest.mark.parametrize("delay", [0, 1, 3])
def test_a_sample_that_fails_holds_the_inputs_asked_for_last(delay: int) -> None:
    """Behind all others that are on their way."""

    class Failing(Asking):
        def feedback(self, q: Array, qd: Array) -> Decision:
            found = super().feedback(q, qd)
            return replace(found, is_solved=self.k != 3)  # the third sample, as the first plan comes before

    found = run(Rail(is_whole=False), Failing(), duration=0.8, delay=delay, predicts=False, fallback=Fallback.HOLD)
    asked = [-60.0, -60.1, -60.2][:delay] + [0.0, 1.0, 1.0, 3.0, 4.0, 5.0, 6.0, 7.0][: 8 - delay]
    assert [sample.u[1] for sample in found.samples] == pytest.approx([-x for x in asked])


def test_without_a_prediction_the_plan_before_gives_the_inputs() -> None:
    """The model stops in the fourth sample: it is counted, and it stops the loop where that is asked for."""
    plant = Rail()
    found = run(plant, delay=2)
    decision = found.samples[3].decision
    assert (decision.status, decision.is_solved, decision.iterations) == (UNPREDICTED, False, 0)
    assert decision.inputs == pytest.approx([50.5, 60.5])
    assert np.isnan(decision.violation)
    assert decision.seconds == 0.0
    assert found.failures == 2
    stopped = run(Rail(), delay=2, fallback=Fallback.STOP)
    assert stopped.halt is not None
    assert stopped.halt.time == pytest.approx(0.3)
    assert len(stopped.samples) == 4


@pytest.mark.parametrize("after", [0, 2])
def test_a_user_who_stops_it_keeps_the_samples(after: int) -> None:
    """The first one is needed: without it nothing is kept."""

    class Stopped(Asking):
        def feedback(self, q: Array, qd: Array) -> Decision:
            if self.k == after:
                raise KeyboardInterrupt
            return super().feedback(q, qd)

    if not after:
        with pytest.raises(KeyboardInterrupt):
            run(Rail(), Stopped())
        return
    found = run(Rail(), Stopped())
    assert found.halt is not None
    assert (found.halt.time, found.halt.finding) == (pytest.approx(0.2), "the user stopped it")
    assert len(found.samples) == after
