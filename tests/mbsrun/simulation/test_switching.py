"""Rigid stops and dry friction: closed forms, conditions of unilateral contact, and energy."""

from __future__ import annotations

import itertools
import json
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from mbsgen.errors import InputError
from mbsgen.expressions import parse
from mbsrun import Mechanism, cli, load
from mbsrun.models import INTEGRATED, Extent
from mbsrun.simulation import Course, Drive, Kind, Mode, Motion, Settings, control, differentiate, simulate
from mbsrun.simulation.drive import express, hold
from mbsrun.simulation.integration import switching
from mbsrun.simulation.integration.complementarity import ComplementarityError, solve_bounded
from mbsrun.simulation.motion import Chunk
from tests.mbsrun.simulation.conftest import MODELS, load_texts
from tests.mbsrun.simulation.drawn_trees import draw_tree
from tests.mbsrun.simulation.pulses import RATE, find_slip, write_pulses

Array = NDArray[np.float64]
Make = Callable[[str], Mechanism]

G = 9.81
NEEDED = Extent(("exp2", "impl", "semi", "semi_res", "energy", "power", "frames"), 1)
TIGHT = {"rtol": 1e-13, "atol": 1e-13}
SLIDER = """
name: slider
gravity: [0, 0, -9.81]
bodies:
  - name: block
    joint: {{type: prismatic, axis: {axis}, {options}}}
    mass: {mass}
"""


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Callable[..., tuple[object, str]]:
    """Return a function that runs `mbsrun` and returns its exit code and its messages on one line."""

    def call(*arguments: str) -> tuple[object, str]:
        monkeypatch.setattr("sys.argv", ["mbsrun", *arguments])
        with pytest.raises(SystemExit) as end:
            cli.main()
        return end.value.code, " ".join(capsys.readouterr().err.split())

    return call


@pytest.fixture(scope="session")
def make(tmp_path_factory: pytest.TempPathFactory) -> Make:
    """Return a function that loads a model from its text, each text once."""
    return load_texts(tmp_path_factory, NEEDED)


def slide(make: Make, options: str, axis: str = "x", mass: float = 2.0) -> Mechanism:
    return make(SLIDER.format(options=options, axis=axis, mass=mass))


def times(motion: Motion, kind: Kind) -> Array:
    return np.array([event.time for event in motion.events if event.kind is kind])


@pytest.mark.parametrize("method", ["dop853", "rk45", "rk4"])
def test_a_ball_bounces_up_to_its_accumulation_point_and_rests(method: str, make: Make) -> None:
    """From height h it hits at t0 (1 + 2 (e + e^2 + ...)), and rests from t0 (1 + e)/(1 - e) on; all energy is lost."""
    e, h = 0.5, 1.0
    ball = slide(make, f"limits: [0, null], stops: {{restitution: {e}}}, actuated: false", "z", 1.0)
    motion = simulate(ball, hold([]), [h], [0.0], Settings(3.0, method, step=0.01))
    t0, hits = np.sqrt(2 * h / G), times(motion, Kind.IMPACT)
    expected = t0 * (1 + 2 * np.cumsum(e ** np.arange(1, 21)))
    assert hits[0] == pytest.approx(t0, abs=1e-13)
    assert hits[1:21] == pytest.approx(expected, abs=1e-12)
    assert times(motion, Kind.REST) == pytest.approx([t0 * (1 + e) / (1 - e)], abs=1e-12)
    assert (motion.q[-1], motion.qd[-1]) == (0, 0)
    assert motion.energy is not None
    assert motion.energy.impacts is not None
    assert motion.energy.impacts[-1] == pytest.approx(G * h, abs=1e-12)
    assert np.abs(motion.energy.drift).max() < 1e-12
    assert motion.modes is not None
    assert motion.modes[-1] == Mode.LOWER
    assert motion.q.min() >= 0
    assert np.isin(motion.qdd.round(9), (-G, 0)).all()


def test_ten_thousand_impacts_keep_energy_and_period(make: Make) -> None:
    """With e = 1 nothing is lost: each flight takes 2 sqrt(2 h/g), to rounding of the time."""
    ball, h = slide(make, "limits: [0, null], stops: {restitution: 1}, actuated: false", "z", 1.0), 0.02
    flight = 2 * np.sqrt(2 * h / G)
    motion = simulate(ball, hold([]), [h], [0.0], Settings(flight * 9999.75, output_step=10.0))
    hits = times(motion, Kind.IMPACT)
    assert len(hits) == 10_000
    assert hits / flight == pytest.approx(np.arange(10_000) + 0.5, rel=1e-12)
    assert motion.energy is not None
    assert np.abs(motion.energy.drift).max() < 1e-13


def follow_backlash(end: float) -> Array:
    """Return angles and velocities of gear and arm of models/switching/backlash.yaml, by SciPy and events by hand.

    A stop that is hit throws back until the rebound is slow; then gear and arm turn together while it pushes.
    """
    J, weight, play, e = np.array([0.3, 0.18]), 0.4 * G, np.radians(2.0), 0.1
    side, t, x = 0, 0.0, np.zeros(4)

    def free(t: float, x: Array) -> Array:
        torques = np.array([3 * np.sin(2 * t) - 0.5 * x[2], -weight * np.sin(x[1])])
        return np.concatenate((x[2:], torques / J if not side else np.full(2, torques.sum() / J.sum())))

    def push(t: float, x: Array) -> float:  # of the stop on the arm, away from it
        return float(-side * (J[1] * free(t, x)[3] + weight * np.sin(x[1])))

    def room(_t: float, x: Array) -> float:
        return float(play - abs(x[1] - x[0]))

    for event in (push, room):
        event.terminal, event.direction = True, -1  # type: ignore[attr-defined]
    while t < end:
        found = solve_ivp(free, (t, end), x, "DOP853", events=push if side else room, rtol=1e-12, atol=1e-13)
        t, x = found.t[-1], found.y[:, -1]
        if found.status == 0:
            break
        if side:
            side = 0
            continue
        w = x[3] - x[2]
        together = J @ x[2:] / J.sum()
        after = -e * w if abs(w) > 1e-7 else 0.0
        x[2:] = together + np.array([-J[1], J[0]]) / J.sum() * after
        x[1] = x[0] + np.sign(x[1] - x[0]) * play * (1 - 1e-15)
        side = 0 if after else int(np.sign(x[1] - x[0]))
    return x


def test_backlash_of_a_gear_is_as_by_hand() -> None:
    """A joint that plays between stops carries the arm: SciPy's DOP853 with hand-written events ends where it does."""
    model, end = load(MODELS / "switching" / "backlash.yaml", extent=NEEDED), 3.0
    torque = control(lambda t, _q, qd: [3 * np.sin(2 * t) - 0.5 * qd[0]])
    motion = simulate(model, torque, [0, 0], [0, 0], Settings(end, **TIGHT))
    gear, arm, spin, turn = follow_backlash(end)
    assert motion.q[-1] == pytest.approx([gear, arm - gear], abs=1e-7)
    assert motion.qd[-1] == pytest.approx([spin, turn - spin], abs=1e-6)
    assert {Kind.IMPACT, Kind.REST, Kind.LEAVE} == {event.kind for event in motion.events}
    assert np.abs(motion.q[:, 1]).max() <= np.radians(2.0)


FLAIL = """
name: flail
gravity: [0, 0, -9.81]
bodies:
  - name: upper
    joint: {type: revolute, axis: y, actuated: false, limits: [-0.5, 2], stops: {restitution: 0.9}}
    mass: 1
    com: [0, 0, -0.5]
    inertia: [0.1, 0.1, 0.01]
  - name: lower
    parent: upper
    joint:
      type: revolute
      axis: y
      position: [0, 0, -1]
      actuated: false
      limits: [-1, 1]
      stops: {restitution: 0.8}
      friction: {torque: 0.02}
    mass: 1
    com: [0, 0, -0.5]
    inertia: [0.1, 0.1, 0.01]
"""


def test_impacts_that_c_passes_are_those_that_end_a_run(make: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two rods between stops, one with friction: the same events, states and losses, whichever side passes them."""
    flail, settings = make(FLAIL), Settings(4.0, output_step=0.013, **TIGHT)
    runs, counts = list[Motion](), list[int]()
    for is_passed in (True, False):
        chunks = list[Chunk]()
        if not is_passed:
            monkeypatch.setattr(switching._Course, "bounces", False)
        motion = simulate(
            flail, hold([]), [1.0, 0.2], [0.0, 0.0], settings, watch=lambda *x, own=chunks: own.append(x[2])
        )
        runs.append(motion)
        counts.append(sum(len(chunk.segment.guards) for chunk in chunks if chunk.segment is not None))
    one, other = runs
    assert len(times(one, Kind.IMPACT)) == 7
    assert counts[0] == counts[1]
    assert [(x.joint, x.kind) for x in one.events] == [(x.joint, x.kind) for x in other.events]
    for name in ("time", "before", "after"):
        found, expected = ([getattr(event, name) for event in run.events] for run in runs)
        assert found == pytest.approx(expected, abs=1e-9)
    assert one.t == pytest.approx(other.t)
    assert one.q == pytest.approx(other.q, abs=1e-9)
    assert one.energy is not None
    assert other.energy is not None
    assert one.energy.impacts == pytest.approx(other.energy.impacts, abs=1e-9)
    assert one.energy.friction == pytest.approx(other.energy.friction, abs=1e-9)
    assert np.abs(one.energy.drift).max() < 1e-10


@pytest.mark.parametrize(("method", "order"), [("rk4", 4), ("euler", 1)])
def test_the_order_is_kept_through_impacts(method: str, order: int, make: Make) -> None:
    """A pendulum that hits a stop fifteen times: halved steps have 2^-order of the error."""
    rod = make(PENDULUM.format(options="limits: [-0.3, 2], stops: {restitution: 0.95}"))
    start = [1.0], [0.0]
    best = simulate(rod, hold([]), *start, Settings(15.0, **TIGHT)).q[-1]
    step = 0.01 if order > 1 else 2e-4
    errors = [abs(simulate(rod, hold([]), *start, Settings(15.0, method, step=step / k)).q[-1] - best) for k in (1, 2)]
    assert len(times(simulate(rod, hold([]), *start, Settings(15.0, method, step=step)), Kind.IMPACT)) == 15
    assert errors[0] / errors[1] == pytest.approx(2.0**order, rel=0.3)


PENDULUM = """
name: pendulum
gravity: [0, 0, -9.81]
bodies:
  - name: rod
    joint: {{type: revolute, axis: y, actuated: false, {options}}}
    mass: 0.5
    com: [0, 0, -0.6]
"""


def test_an_oscillator_with_dry_friction_loses_a_given_amplitude_in_each_half_swing(make: Make) -> None:
    """x = 1 - 2 n T/k after n half periods of pi sqrt(m/k), until |k x| < T, where it sticks."""
    block = slide(make, "actuated: false, stiffness: 40, friction: {torque: 3}", mass=0.5)
    motion = simulate(block, hold([]), [1.0], [0.0], Settings(5.0, **TIGHT))
    half = np.pi * np.sqrt(0.5 / 40)
    assert [event.kind for event in motion.events] == [Kind.REVERSE] * 6 + [Kind.STICK]
    assert [event.time for event in motion.events] == pytest.approx(half * np.arange(1, 8), abs=1e-12)
    assert motion.q[-1] == pytest.approx(-(1.0 - 7 * 2 * 3 / 40), abs=1e-12)
    assert motion.energy is not None
    assert motion.energy.friction is not None
    assert motion.energy.friction[-1] == pytest.approx(3 * sum(2.0 - 0.15 * (2 * n + 1) for n in range(7)), abs=1e-11)


def test_a_pendulum_with_dry_friction_stops_where_energy_says(make: Make) -> None:
    """m g l (cos b - cos a) = T (a + b) gives the swing b after a swing a; it sticks where m g l sin b < T."""
    rod = make(PENDULUM.format(options="friction: {torque: 0.4}"))
    motion = simulate(rod, hold([]), [2.5], [0.0], Settings(30.0, **TIGHT))
    weight, swings = 0.5 * G * 0.6, [2.5]

    def balance(b: float, a: float) -> float:
        return float(weight * (np.cos(b) - np.cos(a)) - 0.4 * (a + b))

    while weight * np.sin(swings[-1]) > 0.4:
        swings.append(brentq(balance, -swings[-1] + 1e-6, swings[-1], swings[-1], xtol=1e-15))
    assert len(motion.events) == len(swings) - 1
    assert motion.q[-1] == pytest.approx(swings[-1] * (-1) ** (len(swings) - 1), abs=1e-12)


def test_stick_slip_on_a_belt_has_its_period() -> None:
    """The spring gains 2 (Fs - Fk)/k at the belt's speed v; slipping takes 2/w (pi - atan(w (Fs - Fk)/(k v)))."""
    belt = load(MODELS / "switching" / "belt.yaml", extent=INTEGRATED)
    v, m, k, static, sliding = 0.3, 2.0, 50.0, 4.0, 1.5
    one = np.ones((1, 1))
    course = Course(lambda t: (v * t[:, None], v * one.repeat(len(t), 0), 0 * one.repeat(len(t), 0)), False)
    motion = simulate(belt, hold([]), [0, 0], [v, 0], Settings(10.0, **TIGHT), course=course)
    w, gain = np.sqrt(k / m), (static - sliding) / k
    period = 2 * gain / v + 2 / w * (np.pi - np.arctan(gain * w / v))
    slips = times(motion, Kind.SLIP)
    assert slips == pytest.approx(static / (k * v) + period * np.arange(8), abs=3e-12)
    assert motion.energy is not None
    assert np.abs(motion.energy.drift).max() < 1e-10
    closure = motion.closure
    assert closure is not None
    held = np.flatnonzero(motion.modes[:, 1] == Mode.STICKS) if motion.modes is not None else []
    assert closure.driving[held, 0] == pytest.approx(50 * (motion.q[held, 0] + motion.q[held, 1]), abs=1e-9)


INCLINE = "friction: {torque: 10, static: 12}"


def test_a_block_on_an_incline_does_not_creep_slips_at_its_limit_and_stops(make: Make) -> None:
    """Down a slope of 3 in 5 the weight pulls by 3/5 m g = 11.772 N: it sticks for 10^4 s, and slips at 12 N."""
    block, pull = slide(make, INCLINE, "[0.8, 0, -0.6]"), 2 * G * 0.6
    motion = simulate(block, hold([0.2]), [0.3], [0.0], Settings(1e4))
    assert np.ptp(motion.q) == 0
    assert motion.events == ()
    motion = simulate(block, express([parse("t/2 - 2")], ["u"], {}), [0.3], [0.0], Settings(6.0))
    assert times(motion, Kind.SLIP) == pytest.approx([(12 + 2 - pull) * 2], abs=1e-12)
    rest = 6.0 - (14 - pull) * 2
    assert motion.q[-1] - 0.3 == pytest.approx((2 * rest**2 / 2 + 0.5 * rest**3 / 6) / 2, abs=1e-9)
    motion = simulate(block, hold([0.0]), [0.3], [-1.0], Settings(1.0))
    assert times(motion, Kind.STICK) == pytest.approx([2 / (pull + 10)], abs=1e-13)
    assert motion.q[-1] == pytest.approx(0.3 - 1 / (pull + 10), abs=1e-13)


def test_forces_that_vary_while_all_joints_rest_are_seen(make: Make) -> None:
    """Rates are 0 while the force rises above friction: 35 times in 10 s, each time by the same way."""
    block = slide(make, "friction: {torque: 5}", mass=2.0)
    motion = simulate(block, express([parse(write_pulses(5.0))], ["block"], {}), [0.0], [0.0], Settings(10.0))
    begin, end, way = find_slip(5.0, 2.0)
    every = np.arange(35) * np.pi / RATE
    assert times(motion, Kind.SLIP) == pytest.approx(every + begin, abs=1e-9)
    assert times(motion, Kind.STICK) == pytest.approx(every + end, abs=1e-8)
    assert motion.q[-1] == pytest.approx([35 * way], rel=1e-6)


def test_a_stribeck_law_starts_at_the_static_force(make: Make) -> None:
    """Just above Ts the block starts without a jump, and speeds up as friction falls to T."""
    block = slide(make, "friction: {torque: 2, static: 5, stribeck: 0.1}", mass=1.0)
    motion = simulate(block, hold([5.5]), [0.0], [0.0], Settings(2.0, **TIGHT))
    assert motion.qdd[0, 0] == pytest.approx(0.5)
    assert motion.qdd[-1, 0] == pytest.approx(3.5)
    assert motion.energy is not None
    assert np.abs(motion.energy.drift).max() < 1e-10
    assert simulate(block, hold([4.9]), [0.0], [0.0], Settings(2.0)).q[-1] == 0


def chain(gaps: int, restitution: float) -> str:
    lines = "gravity: [0, 0, 0]\nname: cradle\nbodies:\n"
    for k in range(gaps + 1):
        stops = "" if k == 0 else f", limits: [0, null], stops: {{restitution: {restitution}}}"
        lines += f"  - name: b{k}\n    parent: {f'b{k - 1}' if k else 'base'}\n"
        lines += f"    joint: {{type: prismatic, axis: x, actuated: false{stops}}}\n    mass: 1\n"
    return lines


def test_a_cradle_passes_the_velocity_on_through_gaps(make: Make) -> None:
    """Equal masses exchange velocities; coordinates are the gaps between neighbours."""
    motion = simulate(make(chain(4, 1)), hold([]), [0, 1, 0.1, 0.1, 0.1], [1, -1, 0, 0, 0], Settings(3.0))
    assert np.cumsum(motion.qd[-1]) == pytest.approx([0, 0, 0, 0, 1], abs=1e-14)
    assert times(motion, Kind.IMPACT) == pytest.approx([1, 1.1, 1.2, 1.3], abs=1e-13)


def test_masses_that_touch_follow_newtons_hypothesis_at_once(make: Make) -> None:
    """Gaps at rest stay closed: with e = 1 the first of three returns with 1/3, and the others leave with 2/3."""
    motion = simulate(make(chain(2, 1)), hold([]), [0, 1, 0], [1, -1, 0], Settings(2.0))
    assert np.cumsum(motion.qd[-1]) == pytest.approx([-1 / 3, 2 / 3, 2 / 3], abs=1e-14)
    motion = simulate(make(chain(2, 0.5)), hold([]), [0, 1, 0], [1, -1, 0], Settings(2.0))
    assert np.cumsum(motion.qd[-1]) == pytest.approx([0, 0.5, 0.5], abs=1e-14)  # w+ = e w-, (1 + e)/3 of it to each


def test_two_masses_between_walls_exchange_their_impacts(make: Make) -> None:
    """A heavy mass drives a light one, 100 times lighter, at a wall: the digits of pi count their 31 collisions."""
    text = """
name: galperin
gravity: [0, 0, 0]
bodies:
  - name: light
    joint: {type: prismatic, axis: x, limits: [0, null], stops: {restitution: 1}, actuated: false}
    mass: 1
  - name: heavy
    parent: light
    joint: {type: prismatic, axis: x, limits: [0, null], stops: {restitution: 1}, actuated: false}
    mass: 100
"""
    motion = simulate(make(text), hold([]), [1.0, 1.0], [0.0, -1.0], Settings(30.0))
    assert len(times(motion, Kind.IMPACT)) == 31
    assert motion.energy is not None
    assert np.abs(motion.energy.drift).max() < 1e-12


def test_impacts_that_alternate_at_one_time_end(make: Make) -> None:
    """A light mass touches two heavy ones that close on each other: it is squeezed, and all go on together."""
    text = chain(2, 0.5).replace("mass: 1\n  - name: b1", "mass: 1e6\n  - name: b1")
    text = text[: text.rindex("mass: 1")] + "mass: 1e6\n"
    motion = simulate(make(text), hold([]), [0, 0, 0], [0, -1, 0.5], Settings(0.1))
    assert motion.is_complete
    assert {event.time for event in motion.events if event.kind is Kind.IMPACT} == {0.0}
    assert motion.qd[-1, 1:] == pytest.approx([0, 0], abs=1e-12)
    assert motion.qd[-1, 0] == pytest.approx(-0.25, abs=1e-5)
    assert motion.energy is not None
    assert motion.energy.total[-1] < motion.energy.total[0]
    assert np.abs(motion.energy.drift).max() < 1e-9 * motion.energy.total[0]


def test_a_stop_lets_go_when_the_force_turns(make: Make) -> None:
    """Pressed on its stop by -cos t, the block leaves at pi/2, and moves freely from there."""
    block = slide(make, "limits: [0, null], stops: {restitution: 0}", mass=1.0)
    motion = simulate(block, express([parse("-cos(t)")], ["u"], {}), [0.0], [0.0], Settings(3.0, **TIGHT))
    assert times(motion, Kind.LEAVE) == pytest.approx([np.pi / 2], abs=1e-12)
    assert motion.q[-1] == pytest.approx(np.cos(3.0) - np.cos(np.pi / 2) + (3.0 - np.pi / 2), abs=1e-12)


def test_sampled_feedback_goes_on_working(make: Make) -> None:
    """A controller at 100 Hz pushes a block with dry friction to its target, where it sticks."""
    block = slide(make, "friction: {torque: 1, static: 1.5}, limits: [-1, 1], stops: {restitution: 0.2}")
    drive = control(lambda _, q, qd: [30 * (0.5 - q[0]) - 12 * qd[0]], period=0.01)
    motion = simulate(block, drive, [0.0], [0.0], Settings(5.0))
    assert motion.is_complete
    assert motion.modes is not None
    assert motion.modes[-1] == Mode.STICKS
    assert abs(motion.q[-1, 0] - 0.5) < 1.5 / 30
    at_once = control(lambda _, q, qd: [30 * (0.5 - q[0]) - 12 * qd[0]])
    assert simulate(block, at_once, [0.0], [0.0], Settings(5.0)).q[-1] == pytest.approx(motion.q[-1], abs=0.01)


@pytest.mark.parametrize("seed", range(4))
def test_random_trees_obey_their_stops_and_lose_energy(seed: int, make: Make) -> None:
    """No joint passes a stop, friction and impacts take energy only, the balance closes, and two methods agree."""
    tree, start = make(draw_tree(seed)), np.random.default_rng(seed + 100).normal(size=4)
    motion = simulate(tree, hold([]), np.zeros(4), start, Settings(2.0, rtol=1e-11, atol=1e-11))
    assert motion.is_complete
    for coordinate, column in zip(tree.manifest.coordinates, motion.q.T, strict=True):
        if coordinate.stops is not None:
            assert coordinate.lower is not None
            assert coordinate.upper is not None
            assert column.min() >= coordinate.lower - 1e-14
            assert column.max() <= coordinate.upper + 1e-14
    energy = motion.energy
    assert energy is not None
    assert energy.friction is not None
    assert energy.impacts is not None
    assert (np.diff(energy.friction) >= 0).all()
    assert (np.diff(energy.impacts) >= -1e-15).all()
    assert np.abs(energy.drift).max() < 1e-8
    assert np.diff(energy.total).max() < 1e-9
    other = simulate(tree, hold([]), np.zeros(4), start, Settings(2.0, "rk4", step=2e-4))
    assert [(e.joint, e.kind) for e in other.events] == [(e.joint, e.kind) for e in motion.events]
    assert other.q == pytest.approx(motion.q, abs=1e-7)


def test_a_tight_regularisation_ends_at_the_same_place(make: Make) -> None:
    """The smooth law -T tanh(qd/speed) and stiff stops approach the events as their numbers grow."""
    hard = make(PENDULUM.format(options="friction: {torque: 0.1}, limits: [-0.4, 2], stops: {stiffness: 1e6}"))
    soft = "friction: {torque: 0.1, speed: %g}, limits: [-0.4, 2], stops: {stiffness: 1e6}"
    sharp = simulate(hard, hold([]), [1.0], [0.0], Settings(3.0, rtol=1e-10, atol=1e-10)).q
    errors = [
        np.abs(simulate(make(PENDULUM.format(options=soft % s)), hold([]), [1.0], [0.0], Settings(3.0)).q - sharp).max()
        for s in (1e-2, 1e-3)
    ]
    assert errors[1] < 2e-3
    assert errors[1] < 0.3 * errors[0]


def test_a_compliant_stop_approaches_a_rigid_one(make: Make) -> None:
    """Without dissipation a stop returns the energy: as with e = 1, half a period pi sqrt(m/k) later."""
    ball = slide(make, "limits: [0, null], stops: {stiffness: 1e6}, actuated: false", "z", 1.0)
    motion = simulate(ball, hold([]), [1.0], [0.0], Settings(1.0, rtol=1e-11, atol=1e-11))
    t = 1.0 - np.sqrt(2 / G) - np.pi / 1e3
    assert motion.q[-1] == pytest.approx(np.sqrt(2 * G) * t - G * t**2 / 2, abs=1e-4)
    assert motion.warnings == ()
    assert motion.modes is None


def brute_force(A: Array, b: Array, low: Array, high: Array) -> list[Array]:
    """Try all places of a problem with bounds."""
    found = []
    for places in itertools.product((-1, 0, 1), repeat=len(b)):
        place = np.array(places)
        x = np.where(place < 0, low, np.where(place > 0, high, 0.0))
        if not np.isfinite(x).all():
            continue
        inside = place == 0
        x[inside] = np.linalg.solve(A[np.ix_(inside, inside)], -(A @ x + b)[inside])
        y = A @ x + b
        fits = ((x >= low - 1e-9) & (x <= high + 1e-9)).all()
        if fits and (y[place < 0] >= -1e-9).all() and (y[place > 0] <= 1e-9).all():
            found.append(x)
    return found


@pytest.mark.parametrize("seed", range(20))
def test_complementarity_finds_the_one_solution(seed: int) -> None:
    rng = np.random.default_rng(seed)
    size = 1 + seed % 5
    B = rng.normal(size=(size, size + 1))
    A, b = B @ B.T, 3 * rng.normal(size=size)
    low = np.where(rng.random(size) < 0.3, -np.inf, -rng.random(size))
    high = np.where(rng.random(size) < 0.3, np.inf, rng.random(size))
    x, y, _ = solve_bounded(A, b, low, high)
    for expected in brute_force(A, b, low, high):
        assert x == pytest.approx(expected, abs=1e-8)
    assert y == pytest.approx(A @ x + b, abs=1e-9)


def test_complementarity_refuses_a_singular_matrix() -> None:
    with pytest.raises(ComplementarityError, match="no solution, or several"):
        solve_bounded(np.ones((2, 2)), -np.ones(2), np.zeros(2), np.full(2, np.inf))


REFUSED = "limits: [0, 1], stops: {restitution: 0.5}, friction: {torque: 1}"


@pytest.mark.parametrize("method", ["radau", "gauss", "variational", "symplectic-euler", "generalized-alpha"])
def test_other_methods_are_refused(method: str, make: Make) -> None:
    with pytest.raises(ValueError, match="takes no rigid stops or dry friction"):
        simulate(slide(make, REFUSED), hold([0.0]), [0.5], [0.0], Settings(1.0, method))


def test_a_start_beyond_a_stop_is_refused(make: Make, run: Callable[..., tuple[object, str]], tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="beyond its stop at 1"):
        simulate(slide(make, REFUSED), hold([0.0]), [1.1], [0.0], Settings(1.0))
    file = tmp_path / "slider.yaml"
    file.write_text(SLIDER.format(options=REFUSED, axis="x", mass=2.0), encoding="utf-8")
    code, message = run("simulate", str(file), "--duration", "1", "--pose", "block=2", "-o", str(tmp_path / "o"))
    assert code == 2
    assert "start.pose.block: 2 is beyond the stop at 1; start within" in message


USES = {
    "linearise": ([], "a linearisation"),
    "fmu": ([], "a functional mock-up unit"),
    "playground": ([], "a playground"),
    "inverse": (["--motion", "block=t", "--duration", "1"], "inverse dynamics"),
}


@pytest.mark.parametrize("use", USES)
def test_uses_that_would_miss_forces_are_refused(
    use: str, run: Callable[..., tuple[object, str]], tmp_path: Path
) -> None:
    file = tmp_path / "slider.yaml"
    file.write_text(SLIDER.format(options=REFUSED, axis="x", mass=2.0), encoding="utf-8")
    options, name = USES[use]
    code, message = run(use, str(file), *options, "-o", str(tmp_path / "out"))
    assert code == 2
    assert f"{name} would miss dry friction of joints block, which is in no kernel; smooth it by a speed" in message


def test_an_optimal_control_problem_is_refused(run: Callable[..., tuple[object, str]], tmp_path: Path) -> None:
    file, problem = tmp_path / "slider.yaml", tmp_path / "reach.ocp.yaml"
    file.write_text(SLIDER.format(options=REFUSED, axis="x", mass=2.0), encoding="utf-8")
    lines = "model: slider.yaml\nhorizon: 1\nintervals: 10\nstart: {pose: {block: 0.1}}\nend: {pose: {block: 0.5}}\n"
    problem.write_text(lines, encoding="utf-8")
    code, message = run("solve", str(problem), "-o", str(tmp_path / "out"))
    assert code == 2
    assert "model: an optimal control problem would miss dry friction of joints block" in message


def test_tables_hold_modes_losses_and_events(run: Callable[..., tuple[object, str]], tmp_path: Path) -> None:
    model, settings = (MODELS / "switching" / name for name in ("door.yaml", "door.settings.yaml"))
    assert run("simulate", str(model), "--settings", str(settings), "-o", str(tmp_path))[0] == 0
    header = (tmp_path / "trajectory.csv").read_text().splitlines()[0].split(",")
    assert header[-3:] == ["friction [J]", "impacts [J]", "mode[hinge]"]
    summary = json.loads((tmp_path / "simulation.json").read_text())
    assert {event["event"] for event in summary["events"]} >= {"hits", "rests", "reverses"}
    assert summary["energy"]["impacts"] > 0
    assert summary["events"][-1]["event"] == "rests"


def difference(kernels: Mechanism, drive: Drive, start: Array, settings: Settings) -> Array:
    """Differentiate the end of a motion by its start, by central differences."""
    count, step, columns = len(kernels.manifest.positions), 1e-6, []
    for shift in step * np.eye(len(start)):
        ends = [simulate(kernels, drive, *np.split(start + sign * shift, [count]), settings) for sign in (1, -1)]
        forward, back = (np.concatenate((motion.q[-1], motion.qd[-1])) for motion in ends)
        columns.append((forward - back) / (2 * step))
    return np.stack(columns, axis=1)


def test_the_derivative_through_an_impact_is_the_closed_form(make: Make) -> None:
    """A ball from h with velocity w hits at s, h + w s = g s^2/2; then it is at r e (g s - w) - g r^2/2, r = T - s."""
    e, h, w, end = 0.5, 1.0, 0.3, 0.8
    ball = slide(make, f"limits: [0, null], stops: {{restitution: {e}}}, actuated: false", "z", 1.0)
    found = differentiate(ball, hold([]), [h], [w], Settings(end, **TIGHT))
    s = (w + np.sqrt(w**2 + 2 * G * h)) / G
    by_h, by_w = 1 / (G * s - w), s / (G * s - w)  # of s
    rest = end - s
    position = [(-e * (G * s - w) + rest * e * G + G * rest) * d - rest * e * own for d, own in ((by_h, 0), (by_w, 1))]
    velocity = [(e * G + G) * d - e * own for d, own in ((by_h, 0), (by_w, 1))]
    assert found.finding is None
    assert found.slopes == pytest.approx(np.array([position, velocity]), abs=1e-11)


@pytest.mark.parametrize("seed", [0, 3, 5])
def test_derivatives_through_random_events_are_the_differences(seed: int, make: Make) -> None:
    """Impacts, rest, stick, slip and reversal in trees of three joints."""
    tree, start = make(draw_tree(seed, 3)), np.full(6, 0.01)
    start[3:] = np.random.default_rng(seed).normal(size=3)
    settings = Settings(0.6, **TIGHT)
    found = differentiate(tree, hold([]), start[:3], start[3:], settings)
    assert found.finding is None
    assert len(found.motion.events) > 3
    assert found.slopes == pytest.approx(difference(tree, hold([]), start, settings), abs=2e-7)


def test_derivatives_pass_a_slip_whose_load_grows_with_time(make: Make) -> None:
    block = slide(make, "friction: {torque: 3, static: 5}, stiffness: 40", mass=1.0)
    drive, settings = express([parse("12*sin(2*t)")], ["u"], {}), Settings(4.0, **TIGHT)
    found = differentiate(block, drive, [0.1], [0.5], settings)
    assert {Kind.SLIP, Kind.STICK} <= {event.kind for event in found.motion.events}
    assert found.slopes == pytest.approx(difference(block, drive, np.array([0.1, 0.5]), settings), abs=1e-7)


def test_a_grazing_event_and_two_at_once_have_a_finding(make: Make) -> None:
    ball = slide(make, "limits: [0, null], stops: {restitution: 0.5}, actuated: false", "z", 1.0)
    upward = slide(make, "limits: [null, 1], stops: {restitution: 0.5}, actuated: false", "z", 1.0)
    grazing = differentiate(upward, hold([]), [0.0], [np.sqrt(2 * G) * (1 + 1e-13)], Settings(0.8, **TIGHT))
    assert grazing.finding is not None
    assert "joint block grazes at t = 0.4515" in grazing.finding
    twins = """
name: twins
gravity: [0, 0, -9.81]
bodies:
  - name: a
    joint: {type: prismatic, axis: z, limits: [0, null], stops: {restitution: 0.5}}
    mass: 1
  - name: b
    joint: {type: prismatic, axis: z, limits: [0, null], stops: {restitution: 0.5}}
    mass: 1
"""
    found = differentiate(make(twins), hold([0.0, 0.0]), [1.0, 1.0], [0.0, 0.0], Settings(0.6))
    assert found.finding is not None
    assert "several joints switch at once at t = 0.45" in found.finding
    assert np.isnan(found.slopes).all()
    with pytest.raises(ValueError, match="radau is not differentiated"):
        differentiate(ball, hold([]), [1.0], [0.0], Settings(0.5, "radau"))
    with pytest.raises(ValueError, match="follow the state"):
        differentiate(ball, control(lambda *_: []), [1.0], [0.0], Settings(0.5))


def test_a_motion_without_events_has_the_derivative_of_its_steps(make: Make) -> None:
    """Of a smooth pendulum too, and of a body with a quaternion."""
    rod = make(PENDULUM.format(options="damping: 0.1"))
    settings = Settings(2.0, **TIGHT)
    found = differentiate(rod, hold([]), [1.0], [0.5], settings)
    assert found.slopes == pytest.approx(difference(rod, hold([]), np.array([1.0, 0.5]), settings), abs=1e-8)


def test_a_one_way_clutch_holds_one_way_and_lets_go_the_other(make: Make) -> None:
    """Under -sin t - c it is held until sin t = -c, moves by cos t - cos t1 - c (t - t1), and is held at speed 0."""
    c, block = 0.2, slide(make, "friction: {torque: 0, one_way: 1}", mass=1.0)
    motion = simulate(block, express([parse("-sin(t) - 0.2")], ["u"], {}), [0.0], [0.0], Settings(8.0, **TIGHT))
    starts = np.pi + np.arcsin(c)
    ends = brentq(lambda t: np.cos(t) - np.cos(starts) - c * (t - starts), 5.0, 8.0, xtol=1e-15)
    assert times(motion, Kind.SLIP) == pytest.approx([starts], abs=1e-12)
    assert times(motion, Kind.STICK) == pytest.approx([ends], abs=1e-12)
    assert motion.qd.min() == 0
    assert motion.q[-1] == pytest.approx(
        np.sin(ends) - np.sin(starts) - (ends - starts) * np.cos(starts) - c * (ends - starts) ** 2 / 2, abs=1e-12
    )
    motion = simulate(block, hold([1.0]), [0.0], [-2.0], Settings(1.0))
    assert (motion.events[0].kind, motion.events[0].after) == (Kind.IMPACT, 0)
    assert motion.energy is not None
    assert motion.energy.impacts is not None
    assert motion.energy.impacts[-1] == pytest.approx(2.0)
    assert motion.q[-1] == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ("friction: {torque: 1, one_way: 2}", "found 2; give 1, where the joint moves forward alone, or -1"),
        ("friction: {torque: 1, one_way: 1, speed: 0.1}", "smoothed friction .speed. that is dry too"),
        ("friction: {torque: 1, one_way: 1}, limits: [0, 1], stops: {restitution: 0}", "a one-way clutch in a joint"),
    ],
)
def test_clutches_that_contradict_themselves_are_refused(options: str, message: str, make: Make) -> None:
    with pytest.raises(InputError, match=message):
        slide(make, options)


def test_what_happened_at_a_time_waits_for_a_step() -> None:
    """Events, losses and jumps belong to the chunk that has the next step; one without a step leaves them."""
    happened = {"passed": ("hit",), "loss": 1.5, "driven": 2.5, "guards": ("stop",), "jumps": ("jump",)}
    course = SimpleNamespace(
        **happened,
        modes=np.array([1]),
        locking=np.zeros(0, dtype=np.intp),
        holding=np.zeros(1),
        is_locked=False,
        push=lambda _: None,
        dynamics=SimpleNamespace(places=1),
        plant=SimpleNamespace(make_dense=lambda *_: None),
    )
    for count in (1, 3):
        chunk = switching._Course.gather(course, None, np.arange(float(count)), np.zeros((count, 2)), None, None)  # type: ignore[arg-type]
        assert chunk.segment is not None
        assert (chunk.segment.events, chunk.segment.loss) == (("hit",), 1.5)
        left = {name: getattr(course, name) for name in happened}
        assert left == (
            happened if count == 1 else {"passed": (), "loss": 0.0, "driven": 0.0, "guards": (), "jumps": ()}
        )
