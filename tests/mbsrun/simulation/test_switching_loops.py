"""Stops and dry friction in closed loops: against coordinates of the hand, sums of friction, and the laws of energy."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from mbsgen.expressions import parse
from mbsrun import Mechanism, load
from mbsrun.closure import Closure
from mbsrun.models import Extent
from mbsrun.simulation import Course, Drive, Keeping, Kind, Mode, Motion, Settings, simulate
from mbsrun.simulation.closing import complete_velocities
from mbsrun.simulation.drive import express, hold
from mbsrun.simulation.integration.complementarity import solve_redundant
from tests.mbsrun.simulation.conftest import MODELS
from tests.mbsrun.simulation.parts import equip, rub, stop

Array = NDArray[np.float64]

LOOPS = ("exp2", "impl", "semi", "semi_res", "energy", "power", "frames", "loops", "loop_rates", "loop_jacobian")
TIGHT = {"rtol": 1e-12, "atol": 1e-12}
G, GROUND, CRANK, COUPLER, ROCKER, LINE = 9.81, 0.30, 0.10, 0.28, 0.24, 1.5


@pytest.fixture(scope="session")
def four_bar() -> Mechanism:
    return load(MODELS / "four_bar.yaml", extent=Extent(LOOPS, 1))


@pytest.fixture(scope="session")
def five_bar() -> Mechanism:
    return load(MODELS / "five_bar.yaml", extent=Extent(LOOPS, 1))


def move(kernels: Mechanism, rates: dict[str, float], drive: Drive, settings: Settings) -> Motion:
    """Simulate from the model's pose, with velocities of independent joints."""
    names, closure = [c.name for c in kernels.manifest.coordinates], Closure(kernels)
    q, qd = np.array(kernels.manifest.pose), np.zeros(len(names))
    given = [names.index(name) for name in rates]
    qd[given] = list(rates.values())
    return simulate(kernels, drive, q, complete_velocities(closure, q, qd, given), settings)


def check_laws(motion: Motion, drift: float = 1e-10) -> None:
    """Loops stay closed, no joint passes a stop, energy is lost only, and its balance closes."""
    energy, closure = motion.energy, motion.closure
    assert motion.is_complete
    assert energy is not None
    assert energy.friction is not None
    assert energy.impacts is not None
    assert closure is not None
    assert max(closure.most) < 1e-12
    assert np.abs(energy.drift).max() < drift
    assert np.diff(energy.friction).min() >= 0
    assert np.diff(energy.impacts).min() >= -1e-15
    assert motion.kernels is not None
    for coordinate, column in zip(motion.kernels.manifest.coordinates, motion.q.T, strict=True):
        if coordinate.stops is not None:
            assert column.min() >= (-np.inf if coordinate.stops.lower is None else coordinate.stops.lower) - 1e-14
            assert column.max() <= (np.inf if coordinate.stops.upper is None else coordinate.stops.upper) + 1e-14


@dataclass(frozen=True)
class Reduced:
    """The four-bar in the angle of its crank alone: m(a) a'' + m'(a) a'^2/2 + V'(a) = -friction."""

    friction: tuple[float, float, float]  # of motor, pin and swing

    @staticmethod
    def pose(a: complex) -> tuple[complex, complex]:
        """Return the angles of coupler and rocker: two circles meet above the base."""
        x, y = CRANK * np.cos(a) - GROUND, CRANK * np.sin(a)
        square = x * x + y * y
        along = (square + ROCKER**2 - COUPLER**2) / (2 * square)
        across = np.sqrt(ROCKER**2 / square - along**2)
        u, v = along * x + across * y, along * y - across * x
        return _angle(u - x, v - y), _angle(u, v)

    def rates(self, a: complex) -> tuple[complex, complex]:
        """Return the derivatives of the angles of coupler and rocker."""
        b, c = self.pose(a)
        return (
            CRANK * np.sin(c - a) / (COUPLER * np.sin(b - c)),
            CRANK * np.sin(a - b) / (ROCKER * np.sin(c - b)),
        )

    def mass(self, a: complex) -> complex:
        b, (db, dc) = self.pose(a)[0], self.rates(a)
        rods = CRANK**3 / 3 + ROCKER**3 / 3 * dc**2
        middle = CRANK**2 + COUPLER**2 / 3 * db**2 + CRANK * COUPLER * db * np.cos(a - b)
        return LINE * (rods + COUPLER * middle)

    def height(self, a: complex) -> complex:
        b, c = self.pose(a)
        rods = CRANK**2 / 2 * np.sin(a) + ROCKER**2 / 2 * np.sin(c)
        return LINE * G * (rods + COUPLER * (CRANK * np.sin(a) + COUPLER / 2 * np.sin(b)))

    def slide(self, a: float, speed: float) -> tuple[float, float]:
        """Return the rates of the angle and its velocity."""
        i, tiny = 1j, 1e-30
        slope, weight = (f(a + tiny * i).imag / tiny for f in (self.mass, self.height))
        db, dc = (x.real for x in self.rates(a))
        way = [speed, (db - 1) * speed, dc * speed]
        power = sum(T * np.sign(s) * r for T, s, r in zip(self.friction, way, (1, db - 1, dc), strict=True))
        return speed, -(slope * speed**2 / 2 + weight + power) / self.mass(a).real


def _angle(x: complex, y: complex) -> complex:
    """Return the angle of a direction above the base, analytic in both."""
    return np.arccos(x / np.sqrt(x * x + y * y))


def test_a_four_bar_hits_its_stop_when_its_reduction_does(four_bar: Mechanism) -> None:
    """Each impact turns all velocities round, times e: as the crank's, in the coordinate of the crank."""
    limit, e, end = np.deg2rad(108), 0.6, 0.52
    motion = move(
        equip(four_bar, swing=stop(None, float(limit), e)), {"motor": 4.0}, hold([0.0]), Settings(end, **TIGHT)
    )
    check_laws(motion, 1e-12)
    hand, time, found = Reduced((0, 0, 0)), 0.0, []
    state = np.array([motion.q[0, 0], 4.0])

    def gap(_: float, y: Array) -> float:
        return float(limit - hand.pose(y[0])[1].real)

    gap.terminal, gap.direction = True, -1  # type: ignore[attr-defined]
    while time < end:
        run = solve_ivp(lambda _, y: hand.slide(*y), (time, end), state, "DOP853", events=gap, rtol=1e-12, atol=1e-13)
        time, state = float(run.t[-1]), run.y[:, -1] * [1, -e if run.status == 1 else 1]
        found += [time] if run.status == 1 else []
    hits = [event.time for event in motion.events]
    assert len(hits) >= 2
    assert hits == pytest.approx(found, abs=1e-10)
    assert motion.q[-1, 0] == pytest.approx(state[0], abs=1e-9)
    assert {event.kind for event in motion.events} == {Kind.IMPACT}


def test_friction_in_all_joints_of_a_four_bar_adds_up_by_their_rates(four_bar: Mechanism) -> None:
    """The crank turns back where the reduction does, and all joints stick at once in the end."""
    torques = (0.05, 0.02, 0.04)
    bar = equip(four_bar, motor=rub(torques[0]), pin=rub(torques[1]), swing=rub(torques[2]))
    motion = move(bar, {"motor": 10.0}, hold([0.0]), Settings(6.0, **TIGHT))
    check_laws(motion, 1e-10)
    hand = Reduced(torques)

    def turn(_: float, y: Array) -> float:
        return float(y[1])

    turn.terminal = True  # type: ignore[attr-defined]
    start = [motion.q[0, 0], 10.0]
    run = solve_ivp(
        lambda _, y: hand.slide(*y), (0, 2), start, "DOP853", events=turn, rtol=1e-10, atol=1e-10, max_step=2e-3
    )
    turns = [event.time for event in motion.events if event.joint == "motor"]
    assert turns[0] == pytest.approx(run.t[-1], abs=1e-6)  # steps of the hand pass over the switches of the rocker
    assert motion.modes is not None
    assert (motion.modes[-1] == Mode.STICKS).all()
    assert len({event.time for event in motion.events[-3:]}) == 1
    still = np.flatnonzero(motion.t > motion.events[-1].time)
    assert np.ptp(motion.q[still], axis=0).max() == 0


def test_a_locked_mechanism_slips_at_the_sum_of_its_friction(four_bar: Mechanism) -> None:
    """Stuck in several joints, forces are shared in many ways; it slips once none suffices. Loads go up and down."""
    statics = {"motor": 0.3, "pin": 0.1, "swing": 0.2}
    bar = equip(four_bar, **{name: rub(0.5 * T, T) for name, T in statics.items()})
    motion = move(bar, {"motor": 0.0}, express([parse("-0.1*t + 0.2*sin(5*t)")], ["u"], {}), Settings(3.3))
    hand, (pose, *_) = Reduced((0, 0, 0)), motion.q
    db, dc = (x.real for x in hand.rates(pose[0]))
    capacity = statics["motor"] + statics["pin"] * abs(db - 1) + statics["swing"] * abs(dc)
    weight = hand.height(pose[0] + 1e-30j).imag / 1e-30
    slips = [event for event in motion.events if event.kind is Kind.SLIP]
    assert {event.joint for event in slips[:3]} == set(statics)
    time = slips[0].time
    assert abs(-0.1 * time + 0.2 * np.sin(5 * time) - weight) == pytest.approx(capacity, abs=1e-11)
    assert np.ptp(motion.q[motion.t < time], axis=0).max() == 0


def test_friction_of_a_driven_mechanism_turns_with_its_joints(tmp_path: Path) -> None:
    """A driven crank leaves no freedom: the rocker's friction changes its sign at both dead points, and is paid for."""
    file = tmp_path / "driven.yaml"
    text = (MODELS / "four_bar.yaml").read_text(encoding="utf-8").replace("independent: [motor]", "driven: [motor]")
    text = text.replace("{name: motor,", "{name: motor, actuated: false,", 1)
    file.write_text(text, encoding="utf-8")
    bar = equip(load(file, extent=Extent(LOOPS, 1)), swing=rub(0.5))
    start, speed = bar.manifest.pose[0], 20.0

    def turn(t: Array) -> tuple[Array, Array, Array]:
        return start + speed * t[:, None], np.full((len(t), 1), speed), np.zeros((len(t), 1))

    closure, end = Closure(bar), 2 * np.pi / speed
    q = np.array(bar.manifest.pose)
    qd = complete_velocities(closure, q, np.array([speed, 0.0, 0.0]), [0])
    motion = simulate(bar, hold([]), q, qd, Settings(end, **TIGHT), course=Course(turn, False))
    check_laws(motion, 1e-10)
    assert [event.kind for event in motion.events] == [Kind.REVERSE] * 2
    reach = [
        np.arccos((GROUND**2 + ROCKER**2 - x**2) / (2 * GROUND * ROCKER)) for x in (COUPLER + CRANK, COUPLER - CRANK)
    ]
    assert motion.energy is not None
    assert motion.energy.friction is not None
    assert motion.energy.friction[-1] == pytest.approx(0.5 * 2 * (reach[0] - reach[1]), abs=1e-11)


@pytest.mark.parametrize("keeping", [Keeping.PROJECTION, Keeping.MASS_PROJECTION, Keeping.PARTITIONING])
def test_a_mechanism_of_two_freedoms_obeys_its_stops(keeping: Keeping, five_bar: Mechanism) -> None:
    """Random stops and friction in all joints: nothing passes, energy is lost only."""
    names = [c.name for c in five_bar.manifest.coordinates]
    pose = dict(zip(names, five_bar.manifest.pose, strict=True))
    parts = {
        name: (stop(pose[name] - 0.3 - 0.1 * k, pose[name] + 0.25 + 0.1 * k, 0.2 * k), rub(0.02 * k, 0.03 * k))
        for k, name in enumerate(names)
    }
    free = [names[i] for i in five_bar.manifest.independent]
    settings = Settings(0.8, loops=keeping, rtol=1e-11, atol=1e-11)
    motion = move(equip(five_bar, **parts), dict(zip(free, (3.0, -2.0), strict=True)), hold([0.0, 0.0]), settings)
    check_laws(motion, 1e-9)
    assert {event.kind for event in motion.events} >= {Kind.IMPACT, Kind.REVERSE}


def test_redundant_problems_have_a_solution_near_the_last_one() -> None:
    """Two springs' forces that hold one body: only their sum matters, and bounds divert it.

    What is added to a singular matrix leaves seven digits of the difference.
    """
    A, b, low, high = np.ones((2, 2)), np.full(2, -3.0), np.zeros(2), np.array([1.0, 4.0])
    x, y, _ = solve_redundant(A, b, low, high, np.array([0.5, 1.5]), np.ones(2))
    assert x == pytest.approx([1.0, 2.0], abs=1e-6)
    assert x.sum() == pytest.approx(3.0, abs=1e-12)
    assert y == pytest.approx([0.0, 0.0], abs=1e-12)


def test_loops_that_may_open_are_refused(four_bar: Mechanism) -> None:
    bar = equip(four_bar, motor=rub(0.1))
    with pytest.raises(ValueError, match="loops: baumgarte lets loops open"):
        move(bar, {"motor": 1.0}, hold([0.0]), Settings(1.0, loops=Keeping.BAUMGARTE))
