"""Derivatives of motions by their start, through events of loops and rigid contacts: closed forms, differences."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from mbsgen.expressions import parse
from mbsgen.manifest import Friction, Stops
from mbsrun import Mechanism, load
from mbsrun.closure import Closure
from mbsrun.kernel import ArgumentError
from mbsrun.models import Extent
from mbsrun.simulation import Course, Drive, Kind, Settings, differentiate, saltation, simulate
from mbsrun.simulation.closing import complete_velocities
from mbsrun.simulation.course import follow
from mbsrun.simulation.drive import express, hold
from mbsrun.simulation.motion import Impacts
from tests.mbsrun.simulation.conftest import MODELS
from tests.mbsrun.simulation.parts import equip, rub, stop
from tests.mbsrun.simulation.planar import PLANAR, POINT, grip

Array = NDArray[np.float64]
Make = Callable[[str], Mechanism]

G, RADIUS, HEIGHT = 9.81, 0.2, 0.3
STEP = 1e-5  # of central differences, whose errors are its square and roundings over it
TIGHT = {"rtol": 1e-11, "atol": 1e-11}
PLAIN = ("exp2", "impl", "semi", "semi_res", "energy", "power", "frames")
FUNCTIONS = (*PLAIN, "touching", "distances")
LOOPS = (*PLAIN, "loops", "loop_rates", "loop_jacobian", "loop_accelerations", "loop_forces")
DISC = PLANAR.format(inertia=RADIUS**2 / 2) + POINT.format("rim", 0, 0, RADIUS)
BLOCK = PLANAR.format(inertia=(0.1**2 + HEIGHT**2) / 3) + "".join(
    POINT.format(name, x, -HEIGHT, 0) for name, x in (("left", -0.1), ("right", 0.1))
)
BALL = """
name: ball
gravity: [0.4, 0, -9.81]
bodies:
  - {name: ball, joint: {type: free}, mass: 1, inertia: [0.01, 0.01, 0.01], com: [0.01, 0, 0]}
contacts:
  - {name: rim, body: ball, radius: 0.15, restitution: 0.6, friction: {coefficient: 0.2}}
"""
ROPE = """
name: rope
gravity: [0, 0, -9.81]
bodies:
  - name: load
    joint: [{name: x, type: prismatic, axis: x, actuated: false}, {name: z, type: prismatic, axis: z, actuated: false}]
    mass: 2
contacts:
  - {name: rope, body: load, sphere: {radius: 1, inside: true}, restitution: 0.3}
"""
DOG = """
name: dog
gravity: [0, 0, 0]
bodies:
  - {name: a, joint: {type: revolute, axis: z}, mass: 1, inertia: [0.3, 0.3, 0.3]}
  - {name: b, joint: {type: revolute, axis: z, stiffness: 3, actuated: false}, mass: 1, inertia: [0.5, 0.5, 0.5]}
stops:
  - {name: dog, quantity: q_b - q_a, limits: [0, null], restitution: 0, hold: 2}
"""


@pytest.fixture(scope="module")
def make(tmp_path_factory: pytest.TempPathFactory) -> Make:
    """Return a function that loads a model from its text, each text once."""
    known: dict[str, Mechanism] = {}

    def build(text: str) -> Mechanism:
        if text not in known:
            file: Path = tmp_path_factory.mktemp("model") / "model.yaml"
            file.write_text(text, encoding="utf-8")
            rates = ("rates",) if "type: free" in text else ()
            known[text] = load(file, extent=Extent((*FUNCTIONS, *rates), 1))
        return known[text]

    return build


@pytest.fixture(scope="module")
def four_bar() -> Mechanism:
    return load(MODELS / "four_bar.yaml", extent=Extent(LOOPS, 1))


def check(
    kernels: Mechanism,
    drive: Drive,
    start: tuple[Array, Array],
    way: Array,
    settings: Settings,
    course: Course | None = None,
) -> list[Kind]:
    """Compare the derivative along a change of the start with differences; return the kinds of events."""
    found = differentiate(kernels, drive, *start, settings, course)
    assert found.finding is None
    assert found.motion.is_complete
    ends, closure = [], Closure(kernels)
    for sign in (1, -1):
        q, qd = (x + sign * STEP * y for x, y in zip(start, np.split(way, [len(start[0])]), strict=True))
        if kernels.manifest.loops:
            q, qd = closure.project(q, qd, kernels.manifest.driven)
        motion = simulate(kernels, drive, q, qd, settings, course=course)
        assert [(x.joint, x.kind) for x in motion.events] == [(x.joint, x.kind) for x in found.motion.events]
        ends.append(np.concatenate((motion.q[-1], motion.qd[-1])))
    slope = (ends[0] - ends[1]) / (2 * STEP)
    assert found.slopes @ way == pytest.approx(slope, abs=1e-6 * max(1.0, float(np.abs(slope).max())))
    return [event.kind for event in found.motion.events]


def begin(kernels: Mechanism, **rates: float) -> tuple[Array, Array]:
    """Return the model's pose, with velocities of independent joints."""
    names, closure = [c.name for c in kernels.manifest.coordinates], Closure(kernels)
    q, qd = closure.close(np.array(kernels.manifest.pose)), np.zeros(len(names))
    given = [names.index(name) for name in rates]
    qd[given] = list(rates.values())
    return q, complete_velocities(closure, q, qd, given)


def change(size: int, seed: int = 1) -> Array:
    return np.random.default_rng(seed).normal(size=size)


@pytest.mark.parametrize(
    ("parts", "speed", "kinds"),
    [
        ({"swing": stop(None, float(np.deg2rad(108)), 0.6)}, 4.0, {Kind.IMPACT}),
        ({"motor": rub(0.2), "pin": rub(0.1), "swing": rub(0.2)}, 5.0, {Kind.REVERSE, Kind.STICK}),
        ({"swing": stop(None, float(np.deg2rad(108)), 0.0)}, 4.0, {Kind.IMPACT, Kind.REST, Kind.LEAVE}),
    ],
)
def test_derivatives_through_events_of_loops_are_the_differences(
    parts: dict[str, Stops | Friction], speed: float, kinds: set[Kind], four_bar: Mechanism
) -> None:
    """A four-bar hits a stop of its rocker, rests there, or slides and sticks in three joints at once."""
    bar = equip(four_bar, **parts)
    seen = check(bar, hold([0.0]), begin(bar, motor=speed), change(6), Settings(0.52, **TIGHT))
    assert set(seen) & kinds


def test_the_slip_of_a_locked_loop_is_differentiated_by_its_load(four_bar: Mechanism) -> None:
    """Stuck in three joints, it slips at the sum of their friction, whose time depends on the pose."""
    bar = equip(four_bar, motor=rub(0.15, 0.3), pin=rub(0.05, 0.1), swing=rub(0.1, 0.2))
    way = np.concatenate((change(3), np.zeros(3)))
    seen = check(bar, express([parse("-t")], ["u"], {}), begin(bar, motor=0.0), way, Settings(0.6, **TIGHT))
    assert Kind.SLIP in seen


@pytest.mark.parametrize(
    ("coefficient", "impacts"), [(0.0, Impacts.NEWTON), (0.1, Impacts.NEWTON), (0.1, Impacts.POISSON)]
)
def test_derivatives_through_a_bounce_on_a_slope_are_the_closed_form(
    coefficient: float, impacts: Impacts, make: Make
) -> None:
    """A disc from z falls r = z - R with g' = g cos; impulses of friction are mu (1 + e) w. Slip lasts."""
    e, slope, end, z, speed = 0.7, 0.3, 0.9, 1.2, 5.0
    disc = grip(make(DISC), coefficient, e).with_parameters(gx=G * np.sin(slope), gz=-G * np.cos(slope))
    q, qd = np.array([0.0, z, 0.0]), np.array([speed, 0.0, 0.2])
    found = differentiate(disc, hold([]), q, qd, Settings(end, impacts=impacts, **TIGHT))
    assert found.finding is None
    assert [event.kind for event in found.motion.events] == [Kind.IMPACT]
    g = G * np.cos(slope)
    hit = np.sqrt(2 * (z - RADIUS) / g)  # with the speed g hit; by z, its time changes by 1/(g hit)
    rest, by_z = end - hit, 1 / (g * hit)
    lost = coefficient * (1 + e)
    across = -lost * (g * rest - g * hit) * by_z
    turn = across / (RADIUS / 2)
    expected = [across, ((1 + e) * g * rest - e * g * hit) * by_z, -turn, -lost * g * by_z, (1 + e) * g * by_z]
    assert np.abs(found.slopes[[0, 1, 3, 4], 1]) == pytest.approx(np.abs([*expected[:2], *expected[3:]]), abs=1e-9)
    assert abs(found.slopes[2, 1]) == pytest.approx(abs(turn), abs=1e-9)


@pytest.mark.parametrize("impacts", [Impacts.NEWTON, Impacts.POISSON])
def test_derivatives_through_an_impact_that_sticks_are_the_differences(impacts: Impacts, make: Make) -> None:
    start = np.array([0, HEIGHT + 0.3, 0.3]), np.array([0.4, 0, 0.5])
    settings = Settings(0.3, impacts=impacts, **TIGHT)
    assert check(grip(make(BLOCK), 0.3, 0.4), hold([]), start, change(6), settings) == [Kind.IMPACT]


@pytest.mark.parametrize("impacts", [Impacts.NEWTON, Impacts.POISSON])
@pytest.mark.parametrize("coefficient", [0.2, 1.5])
def test_derivatives_through_impacts_in_space_are_the_differences(
    coefficient: float, impacts: Impacts, make: Make
) -> None:
    """A ball with an eccentric mass slips or sticks; the way of its slip depends on the impact."""
    start = np.array([0, 0, 0.4, 1, 0, 0, 0]), np.array([1.0, 0.5, 0, 2, 1, 0.5])
    way = change(13)
    way[3:7] = 0.0
    settings = Settings(0.3, impacts=impacts, **TIGHT)
    assert check(grip(make(BALL), coefficient, 0.6), hold([]), start, way, settings) == [Kind.IMPACT]


def test_the_derivative_where_a_disc_comes_to_roll_is_the_closed_form(make: Make) -> None:
    """It rolls with (2 v + R w)/3 from the time s = (v - R w)/(3 mu g) on, at x = v s - mu g s^2/2."""
    mu, v, w, end = 0.3, 0.5, 0.2, 0.1
    found = differentiate(grip(make(DISC), mu), hold([]), [0, RADIUS, 0], [v, 0, w], Settings(end, **TIGHT))
    assert found.finding is None
    assert [event.kind for event in found.motion.events] == [Kind.STICK]
    s = (v - RADIUS * w) / (3 * mu * G)
    by_v = 1 / (3 * mu * G)
    x_by_v = s + (v - mu * G * s) * by_v + (end - s) * 2 / 3 - (2 * v + RADIUS * w) / 3 * by_v
    assert found.slopes[[0, 3, 1, 4], 3] == pytest.approx([x_by_v, 2 / 3, 0, 0], abs=1e-9)


def test_derivatives_of_a_block_that_comes_to_rest_on_two_corners_are_those_of_its_way(make: Make) -> None:
    """Both corners stick at once, for all starts that touch: x = v^2/(2 a), a = g (mu cos - sin)."""
    slope, mu, v = 0.3, 0.32, 0.01
    block = grip(make(BLOCK), mu).with_parameters(gx=G * np.sin(slope), gz=-G * np.cos(slope))
    found = differentiate(block, hold([]), [0, HEIGHT, 0], [v, 0, 0], Settings(0.12, **TIGHT))
    assert found.finding is None
    assert {event.kind for event in found.motion.events} == {Kind.STICK}
    expected = np.zeros((6, 6))
    expected[0, [0, 3]] = 1, v / (G * (mu * np.cos(slope) - np.sin(slope)))
    assert found.slopes == pytest.approx(expected, abs=1e-9)


def test_derivatives_through_a_jerk_of_a_rope_and_its_rest_are_the_differences(make: Make) -> None:
    """The normal turns: a load in a hollow sphere bounces, or stays at its end, and slides round."""
    start = np.array([0.2, -0.5]), np.array([2.0, 2.0])
    for e in (0.3, 0.0):
        kinds = check(grip(make(ROPE), 0, e), hold([]), start, change(4), Settings(0.6, **TIGHT))
        assert Kind.IMPACT in kinds


def test_derivatives_through_a_latch_that_engages_and_opens_are_the_differences(make: Make) -> None:
    start = np.array([0, 1.0]), np.array([2.0, 0])
    kinds = check(make(DOG), express([parse("-3*t")], ["u"], {}), start, change(4), Settings(1.4, **TIGHT))
    assert Kind.IMPACT in kinds
    assert Kind.LEAVE in kinds


def test_contacts_that_graze_or_meet_have_a_finding(make: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    """A disc that is thrown down against a pull upward turns round at the ground, and misses or hits it by a hair."""
    monkeypatch.setattr(saltation, "GRAZING", 1e3)
    disc = grip(make(DISC), 0, 0.7).with_parameters(gz=G)
    q, qd, settings = [0, RADIUS + 1e-2, 0], [0, -np.sqrt(2e-2 * G) * (1 + 1e-4), 0], Settings(0.1, "rk4", step=1e-3)
    found = differentiate(disc, hold([]), q, qd, settings)
    assert [event.kind for event in found.motion.events] == [Kind.IMPACT]
    assert found.finding is not None
    assert "contact rim grazes at t = 0.04" in found.finding
    flat = differentiate(grip(make(BLOCK), 0, 0.4), hold([]), [0, HEIGHT + 0.1, 0], [0, 0, 0], Settings(0.2, **TIGHT))
    assert flat.finding is not None
    assert "several contacts switch at once" in flat.finding
    assert np.isnan(flat.slopes).all()
    struck = differentiate(disc, hold([]), [0, RADIUS, 0], [0, -1, 0], Settings(0.1, **TIGHT))
    assert struck.finding == "the motion begins with an impact at t = 0 s, where there is no derivative"


def test_derivatives_beside_a_driven_joint_are_the_differences() -> None:
    """An arm on a turntable that turns by sin 3t: its shoulder hits a stop, and its elbow slides."""
    arm = load(MODELS / "driven" / "turntable_arm.yaml", extent=Extent(PLAIN, 1))
    arm = equip(arm, shoulder=stop(None, 1.0, 0.5), elbow=rub(0.3))
    course = follow([parse("sin(3*t)")], ["table"], {})
    start, way = (np.array([0, 0.8, 0.3]), np.array([3.0, 1.0, 0.5])), change(6)
    way[[0, 3]] = 0.0
    assert Kind.IMPACT in check(arm, hold([0.0, 0.0]), start, way, Settings(0.3, **TIGHT), course)


def test_kernels_that_are_missing_are_named() -> None:
    bar = load(MODELS / "four_bar.yaml", extent=Extent(LOOPS[:-1], 1))
    with pytest.raises(ArgumentError, match="generated without jac_loop_forces; generate all functions"):
        differentiate(bar, hold([0.0]), *begin(bar, motor=1.0), Settings(0.1))
