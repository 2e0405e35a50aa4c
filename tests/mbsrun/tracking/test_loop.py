"""The closed loop of a puck on a rail, whose motion under constant inputs is a parabola."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from mbsgen.expressions import ExpressionError, parse
from mbsrun import Mechanism
from mbsrun.ocp.problem.problem import Bounds
from mbsrun.simulation.motion import Settings
from mbsrun.tracking import Decision, Fallback, Kick, Noise, NoPlanError, Plant, Push, Track, Trial, track

Array = NDArray[np.float64]

FREE = (-np.inf, np.inf)
BOUNDS = Bounds((FREE,), (FREE,), (FREE,))
MASS = 2.0
QUIET = Noise(np.zeros(1), np.zeros(1), np.zeros(1))
TRIAL = Trial("puck", 1.0, 0.1, np.array([0.5]), np.array([-1.0]), QUIET, Settings(1.0))


class Counter:
    """Asks for the number of the sample as the input, and keeps the states that it is given; fails at some samples."""

    def __init__(self, failing: tuple[int, ...] = ()) -> None:
        self.failing, self.asked = failing, -1  # the first plan is made before the loop
        self.times: list[float] = []
        self.states: list[float] = []
        self.constants: list[Mapping[str, float]] = []

    def prepare(self, time: float, constants: Mapping[str, float]) -> None:
        self.times.append(time)
        self.constants.append(constants)

    def feedback(self, q: Array, qd: Array) -> Decision:  # noqa: ARG002  # the protocol's
        self.states.append(float(q[0]))
        k, self.asked = self.asked, self.asked + 1
        is_solved = k not in self.failing
        u = np.array([float(k)]) if is_solved else self.planned(self.times[-1])
        return Decision(u, "Solved" if is_solved else "Lost", is_solved, 1, 1e-3, 0.0)

    def planned(self, time: float) -> Array:
        return np.array([100 + 10 * time])


def run(plant: Mechanism, controller: Counter, bounds: Bounds = BOUNDS, **changes: Any) -> Track:
    trial = replace(TRIAL, **changes)
    return track(trial, bounds, Plant(plant, trial), controller, plant)


def move(x: float, v: float, forces: list[float]) -> Array:
    """Return the places of the puck at the samples, for forces held over the periods."""
    h, places = TRIAL.period, [x]
    for force in forces:
        x, v = x + v * h + force / MASS * h**2 / 2, v + force / MASS * h
        places.append(x)
    return np.array(places)


def test_inputs_are_held_over_periods(puck: Mechanism) -> None:
    found = run(puck, Counter())
    inputs = [float(k) for k in range(10)]
    assert [float(sample.u[0]) for sample in found.samples] == inputs
    places = [*(float(sample.q[0]) for sample in found.samples), float(found.q[-1, 0])]
    assert places == pytest.approx(move(0.5, -1.0, inputs), abs=1e-9)
    assert found.is_complete
    assert found.t[-1] == pytest.approx(1.0)


@pytest.mark.parametrize("predicts", [True, False])
def test_a_delay_lets_inputs_act_later(puck: Mechanism, predicts: bool) -> None:
    """At first the plan from the start acts. With prediction, the controller plans from the state two periods later."""
    controller = Counter()
    found = run(puck, controller, delay=2, predicts=predicts)
    inputs = [100.0, 101.0, *(float(k) for k in range(8))]
    assert [float(sample.u[0]) for sample in found.samples] == pytest.approx(inputs)
    places = move(0.5, -1.0, [*inputs, 8.0, 9.0])
    later = 2 * predicts
    assert controller.states[1:] == pytest.approx(places[later : later + 10], abs=1e-6)
    assert controller.times[1:] == pytest.approx(0.1 * (np.arange(10) + later))


@pytest.mark.parametrize(
    ("fallback", "inputs"), [(Fallback.PLAN, [0, 1, 102, 103, 4]), (Fallback.HOLD, [0, 1, 1, 1, 4])]
)
def test_a_sample_without_a_plan_is_counted(puck: Mechanism, fallback: Fallback, inputs: list[float]) -> None:
    found = run(puck, Counter(failing=(2, 3)), duration=0.5, fallback=fallback)
    assert [float(sample.u[0]) for sample in found.samples] == pytest.approx(inputs)
    assert found.failures == 2
    assert [sample.decision.status for sample in found.samples] == ["Solved", "Solved", "Lost", "Lost", "Solved"]


def test_a_sample_without_a_plan_holds_the_inputs_asked_for_last(puck: Mechanism) -> None:
    """Not the ones that act now: with a delay of two periods, others are on their way."""
    found = run(puck, Counter(failing=(2, 3)), duration=0.7, delay=2, fallback=Fallback.HOLD)
    assert [float(sample.u[0]) for sample in found.samples] == pytest.approx([100, 101, 0, 1, 1, 1, 4])


def test_a_failure_can_stop_the_loop(puck: Mechanism) -> None:
    found = run(puck, Counter(failing=(4,)), fallback=Fallback.STOP)
    assert found.halt is not None
    assert found.halt.time == pytest.approx(0.4)
    assert "Lost" in found.halt.finding
    assert found.t[-1] == pytest.approx(0.4)


def test_no_plan_from_the_start_is_an_error(puck: Mechanism) -> None:
    with pytest.raises(NoPlanError, match="no plan from the start"):
        run(puck, Counter(failing=(-1,)))


def test_a_kick_and_a_push_act_between_samples(pushed: Mechanism) -> None:
    """Impulses: 3 m/s at 0.23 s, and a force of 12 t from 0.31 to 0.47 s."""
    push = Push(0.31, 0.47, ((0, parse("12*t")),))
    found = run(pushed, Counter(), kicks=(Kick(0.23, ((0, 3.0),)),), pushes=(push,))
    impulse = 6 * (0.47**2 - 0.31**2)
    speed = -1.0 + 3.0 + (sum(range(10)) * 0.1 + impulse) / MASS
    assert found.qd[-1, 0] == pytest.approx(speed, abs=1e-9)
    reached = 6 * (0.47**3 / 3 - 0.31**2 * 0.47 + 2 * 0.31**3 / 3) + impulse * (1 - 0.47)  # twice integrated
    base = move(0.5, -1.0, [float(k) for k in range(10)])[-1]
    assert found.q[-1, 0] == pytest.approx(base + 3.0 * (1 - 0.23) + reached / MASS, abs=1e-9)


def test_noise_depends_on_the_seed_alone(puck: Mechanism) -> None:
    noise = Noise(np.array([0.1]), np.array([0.2]), np.array([0.3]), seed=1)
    first, again, other = (run(puck, Counter(), noise=x) for x in (noise, noise, replace(noise, seed=2)))
    for name in ("q", "measured_q", "measured_qd", "acting"):
        values = [np.array([getattr(sample, name)[0] for sample in x.samples]) for x in (first, again, other)]
        assert np.array_equal(values[0], values[1])
        assert not np.array_equal(values[0][1:], values[2][1:])
    assert first.samples[0].acting[0] != first.samples[0].u[0]


def test_a_measured_quaternion_turns_by_the_noise() -> None:
    """The deviation of each component of the rotation vector is the one that was asked for, to four of its errors."""
    deviation, count = 0.01, 2000
    manifest = SimpleNamespace(positions=[*"abcd"], quaternions=(0,), dependent=())
    noise = Noise(np.full(4, deviation), np.zeros(3), np.zeros(0))
    plant = Plant.__new__(Plant)
    plant.kernels, plant.trial = SimpleNamespace(manifest=manifest), replace(TRIAL, noise=noise)  # type: ignore[assignment]
    q = Rotation.from_rotvec([0.3, -0.2, 0.5])
    measured = np.array([plant.measure(k, q.as_quat(), np.zeros(3))[0] for k in range(count)])
    assert np.linalg.norm(measured, axis=1) == pytest.approx(1.0)
    turned = (q.inv() * Rotation.from_quat(measured)).as_rotvec()
    assert turned.std(axis=0) == pytest.approx(deviation, rel=4 / np.sqrt(2 * count))


def test_a_state_beyond_a_bound_is_put_inside_for_the_controller(puck: Mechanism) -> None:
    controller = Counter()
    found = run(puck, controller, Bounds(((0.45, 2.0),), (FREE,), (FREE,)), duration=0.3)
    assert [sample.is_moved for sample in found.samples] == [False, True, True]
    assert all(0.45 < x < 0.45 + 1e-5 for x in controller.states[2:])
    assert float(found.samples[1].measured_q[0]) < 0.45


@pytest.mark.parametrize(
    ("kind", "limits"), [("q", (0.6, 2.0)), ("q", (-2.0, 0.4)), ("qd", (-0.5, 2.0)), ("qd", (-3, -2))]
)
def test_a_state_is_put_inside_from_either_side(puck: Mechanism, kind: str, limits: tuple[float, float]) -> None:
    """Within the bound, by the stated margin: 1e-6 of 1 + |state|; coordinates and velocities."""
    states: list[tuple[float, float]] = []

    class Watching(Counter):
        def feedback(self, q: Array, qd: Array) -> Decision:
            states.append((float(q[0]), float(qd[0])))
            return super().feedback(q, qd)

    ranges = {"q": FREE, "qd": FREE, kind: limits}
    run(puck, Watching(), Bounds((ranges["q"],), (ranges["qd"],), (FREE,)), duration=0.1)
    start, given = (0.5, -1.0), states[0]
    at = kind == "qd"
    bound, way = (limits[0], 1) if start[at] < limits[0] else (limits[1], -1)
    assert given[at] == pytest.approx(bound + way * 1e-6 * (1 + abs(start[at])), abs=1e-12)
    assert given[not at] == start[not at]


def test_constants_are_those_of_the_time_of_the_plan(puck: Mechanism) -> None:
    controller = Counter()
    run(puck, controller, duration=0.3, delay=1, updates={"t0": parse("2*t")})
    assert [values["t0"] for values in controller.constants] == pytest.approx([0.0, 0.2, 0.4, 0.6])


@pytest.mark.parametrize("where", ["updates", "wrenches"])
def test_an_expression_without_a_value_ends_the_loop(pushed: Mechanism, where: str) -> None:
    root = parse("sqrt(0.25 - t)")
    push = Push(0.2, 0.9, ((0, root),))
    changes: dict[str, Any] = {"updates": {"t0": root}} if where == "updates" else {"pushes": (push,)}
    found = run(pushed, Counter(), **changes)
    assert found.halt is not None
    assert found.halt.finding.startswith(where)
    assert 0.2 <= found.t[-1] <= found.halt.time == pytest.approx(0.3 if where == "updates" else 0.2)
    with pytest.raises(ExpressionError, match=r"updates\.t0"):
        run(pushed, Counter(), updates={"t0": parse("1/t")})
