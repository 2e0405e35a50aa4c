"""Decisions of a closed loop, each by hand: noise, kicks, pushes, plans that are read, figures, and pictures."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure
from numpy.typing import NDArray

from mbsgen.expressions import ExpressionError, parse
from mbsrun import Mechanism
from mbsrun.ocp.problem.problem import State
from mbsrun.simulation.motion import Settings
from mbsrun.tracking import Kick, Noise, Plant, Push, Trial
from mbsrun.tracking.analysis import Margin, Measured, Times
from mbsrun.tracking.loop import INSIDE, _Loop
from mbsrun.tracking.pictures import _draw_held, _draw_measure, _draw_pair, _shorten, draw_times
from mbsrun.tracking.solving import SolvingController, _begin
from mbsrun.tracking.trial import Horizon
from tests.mbsrun.ocp.plants import push

Array = NDArray[np.float64]
NOISE = Noise(np.array([0.5]), np.array([0.25]), np.array([2.0]), seed=7)
TRIAL = Trial("puck", 1.0, 0.1, np.array([0.5]), np.array([-1.0]), NOISE, Settings(1.0))
INF = np.inf


def test_noise_is_drawn_by_seed_sample_and_stream(puck: Mechanism) -> None:
    """Coordinates first, then velocities, of one stream; inputs of another."""
    plant = Plant(puck, TRIAL)
    q, qd = plant.measure(3, np.array([1.0]), np.array([2.0]))
    draws = np.random.default_rng((7, 3, 0)).standard_normal(2)
    assert (q[0], qd[0]) == pytest.approx((1 + 0.5 * draws[0], 2 + 0.25 * draws[1]))
    u = plant.disturb(3, np.array([4.0]))
    assert u[0] == pytest.approx(4 + 2 * np.random.default_rng((7, 3, 1)).standard_normal())
    assert plant.measure(4, np.array([1.0]), np.array([2.0]))[0][0] != q[0]


def test_a_period_is_cut_where_a_push_begins_or_ends_or_a_kick_falls(pushed: Mechanism) -> None:
    trial = replace(
        TRIAL,
        kicks=(Kick(0.1, ((0, 3.0),)), Kick(0.17, ((0, 1.0),)), Kick(0.17, ((0, 0.5),))),
        pushes=(Push(0.15, 0.3, ((0, parse("6")),)), Push(0.12, 0.15, ((0, parse("10*t")),))),
    )
    plant = Plant(pushed, trial)
    assert list(plant._cut(0.1, 0.2)) == [(0.1, 0.12), (0.12, 0.15), (0.15, 0.17), (0.17, 0.2)]
    assert list(plant._cut(0.2, 0.3)) == [(0.2, 0.3)]
    for start, w in ((0.1, 0.0), (0.12, 1.2), (0.15, 6.0), (0.29, 6.0), (0.3, 0.0)):
        assert plant._act(start, np.array([7.0]))(start).tolist()[0] == 7.0
        assert plant._act(start, np.array([7.0]))(start)[1] == pytest.approx(w)
        assert (plant._drive(start, np.array([7.0])).control is None) == (w == 0.0)
    qd = np.array([1.0])
    assert [plant._kick(t, np.zeros(1), qd)[0] for t in (0.1, 0.17, 0.2)] == [4.0, 2.5, 1.0]
    assert qd[0] == 1.0


def test_a_period_keeps_ten_states_and_follows_its_parabola(puck: Mechanism) -> None:
    """x'' = u/2; a kick at its start counts in it, one at its end in the next."""
    trial = replace(TRIAL, kicks=(Kick(0.5, ((0, 3.0),)), Kick(0.6, ((0, 9.0),))))
    found = Plant(puck, trial).advance(np.array([0.5]), np.array([-1.0]), np.zeros(0), 0.5, 0.6, np.array([4.0]))
    assert found.t == pytest.approx(np.linspace(0.5, 0.6, 11))
    s = found.t[1:] - 0.5
    assert found.q[1:, 0] == pytest.approx(0.5 + 2 * s + s**2, abs=1e-12)
    assert found.qd[:, 0] == pytest.approx([-1.0, *(2 + 2 * s)], abs=1e-12)
    assert (found.states.shape, found.is_kept, found.halt) == ((11, 0), True, None)
    assert found.drift == pytest.approx(0.0, abs=1e-12)


def test_states_of_a_problem_go_on_through_a_kick(puck: Mechanism) -> None:
    """x'' = u/2, s' = x, r' = t of a plan that begins with the period: both are integrals over its two pieces."""
    problem = replace(
        push(4), states=(State("s", "q_x"), State("r", "t")), start_q=(0.0,), start_qd=(0.0,)
    )  # fmt: skip
    trial = replace(TRIAL, kicks=(Kick(0.53, ((0, 3.0),)),), states=("s", "r"))
    plant = Plant(puck, trial, problem)
    found = plant.advance(np.array([0.5]), np.array([-1.0]), np.array([7.0, 9.0]), 0.5, 0.6, np.array([4.0]))
    x, after = found.t - 0.5, np.maximum(found.t - 0.53, 0.0)
    assert (np.diff(found.t) > 0).all()
    assert found.t[[0, -1]] == pytest.approx([0.5, 0.6])
    assert found.q[:, 0] == pytest.approx(0.5 - x + x**2 + 3 * after, abs=1e-10)
    assert found.states[:, 0] == pytest.approx(7 + 0.5 * x - x**2 / 2 + x**3 / 3 + 3 * after**2 / 2, abs=1e-9)
    assert found.states[:, 1] == pytest.approx(9 + x**2 / 2, abs=1e-9)
    assert found.halt is None


def test_the_drift_of_a_period_is_the_sum_of_its_pieces(puck: Mechanism, monkeypatch: pytest.MonkeyPatch) -> None:
    """At the end of each; unknown energy is an infinite drift, and one lossy piece makes the period lossy."""
    drifts = {0.25: ([0.0, 9.0, 1.0], True), 0.5: ([0.0, 7.0, -3.0], True), 0.75: ([0.0, 0.0, 0.5], False)}

    def simulate(_kernels: Any, _drive: Any, q: Array, qd: Array, settings: Settings) -> Any:
        energy = drifts.get(settings.duration)
        of = None if energy is None else SimpleNamespace(drift=np.array(energy[0]), is_kept=energy[1])
        t = np.array([0.0, settings.duration / 2, settings.duration])
        return SimpleNamespace(t=t, q=np.tile(q, (3, 1)), qd=np.tile(qd, (3, 1)), energy=of, halt=None)

    monkeypatch.setattr("mbsrun.tracking.plant.simulate", simulate)
    for end, kick, drift, is_kept in (
        (0.75, 0.25, -2.0, True), (1.25, 0.5, -2.5, False), (1.25, 0.75, -2.5, False), (2.25, 0.5, np.inf, False)
    ):  # fmt: skip
        plant = Plant(puck, replace(TRIAL, kicks=(Kick(kick, ()),)))
        found = plant.advance(np.zeros(1), np.zeros(1), np.zeros(0), 0.0, end, np.zeros(1))
        assert (found.drift, found.is_kept) == (drift, is_kept)
        assert found.t.tolist() == [0.0, kick / 2, kick, (kick + end) / 2, end]


def test_states_beyond_bounds_are_put_just_inside() -> None:
    own: Any = SimpleNamespace(lower=np.array([-1.0, -2.0, -INF]), upper=np.array([1.0, 2.0, 5.0]))
    q, qd, states, moved = _Loop._move_inside(own, np.array([-3.0]), np.array([2.5]), np.array([9.0]))
    assert moved
    assert (q[0], qd[0], states[0]) == pytest.approx((-1 + 4 * INSIDE, 2 - 3.5 * INSIDE, 5 - 10 * INSIDE), rel=1e-15)
    for inside in ([-1.0, 2.0, 5.0], [1.0, -2.0, -99.0]):
        found = _Loop._move_inside(own, *(np.array([x]) for x in inside))
        assert [float(x[0]) for x in found[:3]] == inside
        assert not found[3]


def test_a_horizon_shrinks_until_it_is_short() -> None:
    horizon = Horizon(1.0, 0.25)
    assert [horizon.length(t) for t in (0.0, 0.5, 0.75, 0.8, 3.0)] == [1.0, 0.5, 0.25, 0.25, 0.25]
    for duration, count in ((1.0, 10), (1.01, 11), (0.05, 1), (1.0 + 1e-14, 10)):
        assert replace(TRIAL, duration=duration).samples == count
    trial = replace(TRIAL, constants={"a": 2.0}, updates={"t0": parse("a*t"), "b": parse("1/(t - 1)")})
    assert trial.constants_at(0.5) == {"t0": 1.0, "b": -2.0}
    with pytest.raises(ExpressionError, match=r"updates.b: .* at t = 1 s"):
        trial.constants_at(1.0)


def make(plan: bool = True, **given: Any) -> SolvingController:
    """Make a controller with a plan of two inputs and a control, of which the second input acts a period late."""
    own: Any = object.__new__(SolvingController)
    own.period, own.horizon = 0.5, None
    own._plan = SimpleNamespace(
        t=np.array([0.0, 0.5, 1.0, 1.5]), u=np.array([[1.0, 10.0], [2.0, 20.0], [3.0, 30.0]]),
        controls=np.array([[5.0], [6.0], [7.0]]),
    ) if plan else None  # fmt: skip
    own._problem = SimpleNamespace(bounds=SimpleNamespace(u=(1, 1)), controls=(1,), forces=())
    own._begun, own._time, own._given = 2.0, 2.0, {}
    own._lines = (SimpleNamespace(input=1, periods=1, history=9.0),)
    for name, value in given.items():
        setattr(own, name, value)
    return own  # type: ignore[no-any-return]


def test_plans_are_read_a_period_at_a_time_and_late_inputs_earlier(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mbsrun.tracking.solving.list_chosen", lambda _: [0, 1, 2])
    own = make()
    assert own.planned(2.0) == pytest.approx([1.0, 20.0, 5.0])
    assert own.planned(2.25) == pytest.approx([1.5, 25.0, 5.5])
    assert own.planned(9.0) == pytest.approx([3.0, 30.0, 7.0])
    assert make(plan=False).planned(2.0).tolist() == [0.0, 0.0, 0.0]


def test_given_inputs_are_remembered_by_period() -> None:
    """First inputs keep their rates after the last ones; an input that acts late has no such range."""
    own = make()
    own.note(1.5, np.array([4.0, 8.0, 6.0]))
    assert [own._number(t) for t in (1.5, 1.74, 1.76)] == [3, 3, 4]
    assert own._take(3, 1, 9.0) == 8.0
    assert own._take(2, 1, 9.0) == 9.0
    assert own._limit_first([(-1.0, 2.0), (-3.0, 3.0)], 0, 4) == ((3.5, 5.0), (-math.inf, math.inf))
    assert own._limit_first([(-4.0, 1.0)], 2, 4) == ((4.0, 6.5),)
    assert own._limit_first([(-4.0, 1.0)], 2, 3) == ()
    assert own._limit_first([], 0, 4) == ()


def test_measured_states_begin_where_they_are_unless_the_plan_chooses() -> None:
    fixed, chosen = State("s", "1", start=(1.0, 1.0)), State("s", "1", start=(0.0, 2.0))
    assert _begin(fixed, 3.0).start == (3.0, 3.0)
    assert _begin(fixed, None) is fixed
    assert _begin(chosen, 3.0) is chosen


def test_figures_of_a_track() -> None:
    """Median, tail and largest time; the largest value and the mean square; the least distance and its place."""
    found = Times.of([float(x) for x in range(1001)])
    assert (found.median, found.tail, found.largest) == pytest.approx((500.0, 999.0, 1000.0))
    t, values = np.array([0.0, 1.0, 2.0]), np.array([3.0, -4.0, 0.0])
    measured = Measured("x", t, values, 3.0)
    assert (measured.largest, measured.rms) == (3.0, pytest.approx(5 / np.sqrt(3)))
    assert [replace(measured, most=most).is_met for most in (None, 3.0, 2.9)] == [True, True, False]
    nothing = Measured("x", t[:0], values[:0], 3.0)
    assert math.isnan(nothing.largest)
    assert math.isnan(nothing.rms)
    assert not nothing.is_met
    margin = Margin("x", t, np.array([1.0, -0.25, 2.0]), True, 0.25, np.array([4.0, 5.25, 3.0]), (0.0, 5.0))
    assert (margin.least, margin.time, margin.worst) == (-0.25, 1.0, (5.25, 5.0))
    assert [replace(margin, tolerated=x).is_kept for x in (0.25, 0.24)] == [True, False]
    low = replace(margin, numbers=np.array([4.0, -0.25, 3.0]))
    assert low.worst == (-0.25, 0.0)


def track(*seconds: float) -> Any:
    samples = [
        SimpleNamespace(time=0.1 * k, u=np.array([k, 10.0 * k]), decision=SimpleNamespace(seconds=x))
        for k, x in enumerate(seconds)
    ]
    return SimpleNamespace(samples=samples, t=np.array([0.0, 0.1 * len(samples)]), trial=TRIAL)


def test_inputs_are_drawn_in_steps_with_their_finite_bounds() -> None:
    axes = Figure().subplots()
    _draw_held(track(1, 1, 1), 1, (-INF, 25.0), "C0")(axes, "u")
    (steps,) = axes.patches
    values, edges, _ = steps.get_data()  # type: ignore[attr-defined]
    assert (values.tolist(), edges.tolist()) == ([0.0, 10.0, 20.0], pytest.approx([0, 0.1, 0.2, 0.3]))
    (limit,) = axes.lines
    assert (set(limit.get_ydata()), limit.get_linestyle(), limit.get_linewidth()) == ({25.0}, "--", 0.7)
    assert steps.get_linewidth() == 1.2
    ended = track(1, 1, 1)
    ended.t[-1] = 0.2
    axes = Figure().subplots()
    _draw_held(ended, 0, (-INF, INF), "C0")(axes, "u")
    assert axes.patches[0].get_data().edges == pytest.approx([0, 0.1, 0.2, 0.3])  # type: ignore[attr-defined]


def test_references_and_limits_are_dashed() -> None:
    axes = Figure().subplots()
    t = np.array([0.0, 1.0])
    _draw_pair(t, t, 2 * t, "C0")(axes, "x")
    assert [(line.get_linestyle(), line.get_linewidth()) for line in axes.lines] == [("-", 1.2), ("--", 1.0)]
    for most, count in ((None, 1), (3.0, 2)):
        axes = Figure().subplots()
        _draw_measure(Measured("x", t, t, most), "C0")(axes, "x")
        assert len(axes.lines) == count
        assert axes.lines[0].get_linewidth() == 1.2


def test_computing_times_are_a_histogram_with_their_median_and_tail() -> None:
    """40 bins from the shortest to the longest, in ms; a line for the median, the tail and the period."""
    found = track(0.001, 0.002, 0.004, 0.008)
    figure = draw_times(found, Times.of([0.001, 0.002, 0.004, 0.008]))
    (axes,) = figure.axes
    assert figure.get_size_inches().tolist() == [8, 3.6]
    assert len(axes.patches) == 40
    assert sum(bar.get_height() for bar in axes.patches) == 4  # type: ignore[attr-defined]
    first, last = axes.patches[0], axes.patches[-1]
    assert first.get_x() == pytest.approx(1.0)  # type: ignore[attr-defined]
    assert last.get_x() + last.get_width() == pytest.approx(8 * 1.001)  # type: ignore[attr-defined]
    assert [line.get_xdata()[0] for line in axes.lines] == pytest.approx([3.0, 7.988, 100.0])  # type: ignore[index]
    quick = draw_times(track(0.0, 1e-9), Times.of([0.0, 1e-9])).axes[0].patches
    assert quick[0].get_x() == pytest.approx(1e-4)  # type: ignore[attr-defined]
    assert quick[-1].get_x() + quick[-1].get_width() == pytest.approx(2.002e-4)  # type: ignore[attr-defined]


def test_long_names_are_shortened_to_thirty_two_characters() -> None:
    assert _shorten("x" * 32) == "x" * 32
    assert _shorten("x" * 33) == "x" * 29 + "..."
