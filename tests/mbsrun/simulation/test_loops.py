"""Motions of closed loops, by every way to keep them closed: closed forms, laws of mechanics, orders, each other.

The pendulum is IFToMM's A01 in Cartesian coordinates: 1 kg on a rod of 1 m, let go horizontally. The parallelogram has
rods of 1 m and 1 kg; on the branch where its coupler stays level it is one pendulum: (2/3 + 1) q'' = -g (1 + 1) sin(q)
for the angle q from the downward vertical, and at q = pi/2 its Jacobian loses its rank.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from dataclasses import replace
from math import pi, sqrt
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import null_space
from scipy.special import ellipj

from mbsgen.expressions import parse
from mbsrun import Mechanism, cli, load
from mbsrun.closure import Closure, OpenError
from mbsrun.kernel import find_place
from mbsrun.models import Extent, find_folder
from mbsrun.simulation import Formulation, Keeping, Motion, Settings, follow, record, simulate
from mbsrun.simulation.closing import complete_velocities
from mbsrun.simulation.drive import Drive, control, express, hold
from mbsrun.simulation.integration import multipliers, radau
from mbsrun.simulation.inverse import FreeError, invert
from tests.mbsrun.carousel import CAROUSEL

A01 = """
name: cartesian_pendulum
gravity: [0, 0, -9.81]
bodies:
  - {name: x, joint: {type: prismatic, axis: x, actuated: false}}
  - {name: z, parent: x, joint: {type: prismatic, axis: z, actuated: false}, mass: 1}
loops:
  - {name: rod, type: rod, from: {body: base}, to: {body: z}, length: 1}
assembly: {x: 1}
"""
PARALLELOGRAM = """
name: parallelogram
gravity: [0, 0, -9.81]
bodies:
  - {name: left, joint: {name: q1, type: revolute, axis: -y}, mass: 1, com: [0, 0, -0.5], inertia: [1/12, 1/12, 0]}
  - {name: top, parent: left, joint: {name: q2, type: revolute, axis: -y, position: [0, 0, -1]}, mass: 1,
     com: [0.5, 0, 0], inertia: [0, 1/12, 1/12]}
  - {name: right, joint: {name: q3, type: revolute, axis: -y, position: [1, 0, 0]}, mass: 1, com: [0, 0, -0.5],
     inertia: [1/12, 1/12, 0]}
loops:
  - {name: pin, type: hinge, axis: y, from: {body: top, position: [1, 0, 0]}, to: {body: right, position: [0, 0, -1]}}
assembly: {q1: 1, q2: -1, q3: 1}
independent: [q1]
"""
DRIVEN = (
    PARALLELOGRAM.replace("independent: [q1]", "driven: [q1]")
    .replace("parallelogram", "driven_parallelogram")
    .replace("axis: -y}, mass", "axis: -y, actuated: false}, mass", 1)
)
FUNCTIONS = (
    *("impl", "semi", "semi_res", "exp2", "energy", "power", "frames"),
    *("loops", "loop_rates", "loop_jacobian"),
)
EXPLICIT = [Keeping.PROJECTION, Keeping.MASS_PROJECTION, Keeping.PARTITIONING, Keeping.BAUMGARTE]
INERTIA, WEIGHT = 2 / 3 + 1, 2 * 9.81  # of the parallelogram in its angle


def generate(folder: Path, text: str, *more: str) -> Path:
    """Return a generated folder with the functions that simulation needs, and with more."""
    file = folder / "model.yaml"
    file.write_text(text, encoding="utf-8")
    return find_folder(file, Extent(functions=(*FUNCTIONS, *more), derivatives=1))


def make(folder: Path, text: str, *more: str) -> Mechanism:
    return load(generate(folder, text, *more))


@pytest.fixture(scope="module")
def pendulum(tmp_path_factory: pytest.TempPathFactory) -> Mechanism:
    return make(tmp_path_factory.mktemp("a01"), A01, "exp1")


@pytest.fixture(scope="module")
def parallelogram(tmp_path_factory: pytest.TempPathFactory) -> Mechanism:
    return make(tmp_path_factory.mktemp("parallelogram"), PARALLELOGRAM)


@pytest.fixture(scope="module")
def driven(tmp_path_factory: pytest.TempPathFactory) -> Mechanism:
    return make(tmp_path_factory.mktemp("driven"), DRIVEN)


def exact(t: float) -> np.ndarray:
    """Return the pendulum's place when it was let go at (1, 0)."""
    k = sqrt(0.5)
    _, cn, dn, _ = ellipj(sqrt(9.81) * t, k**2)
    angle = 2 * np.arcsin(k * cn / dn)
    return np.array([np.sin(angle), -np.cos(angle)])


def rest(mechanism: Mechanism) -> Drive:
    return hold(np.zeros(len(mechanism.manifest.actuated)))


def swing(pendulum: Mechanism, **settings: Any) -> Motion:
    return simulate(pendulum, rest(pendulum), [1, 0], [0, 0], Settings(**{"output_step": 0.1, **settings}))


def level(angle: float) -> np.ndarray:
    """Return the parallelogram's pose with a level coupler."""
    return np.array([angle, -angle, angle])


def roll(parallelogram: Mechanism, angle: float, speed: float, **settings: Any) -> Motion:
    """Release the parallelogram with a level coupler."""
    qd = np.array([speed, -speed, speed])
    return simulate(parallelogram, rest(parallelogram), level(angle), qd, Settings(**{"output_step": 0.1, **settings}))


def turn(angle: float, speed: float, t: float) -> float:
    """Integrate the parallelogram's angle as a pendulum's."""

    def rate(_: float, y: np.ndarray) -> list[float]:
        return [y[1], -WEIGHT / INERTIA * np.sin(y[0])]

    return float(solve_ivp(rate, (0, t), [angle, speed], "DOP853", rtol=1e-12, atol=1e-12).y[0, -1])


# --- accuracy ------------------------------------------------------------------------------------------------------

ORDERS = [
    *[({"method": "rk4", "loops": keeping}, 4, 0.02) for keeping in EXPLICIT],
    ({"method": "euler"}, 1, 2e-3),
    ({"method": "generalized-alpha"}, 2, 0.02),
    ({"method": "variational"}, 2, 0.02),
    ({"method": "radau-iia", "stages": 1}, 1, 5e-3),
    ({"method": "radau-iia", "stages": 2}, 3, 1e-2),
    ({"method": "radau-iia", "stages": 3}, 5, 0.05),
]


@pytest.mark.parametrize(("settings", "order", "step"), ORDERS)
def test_methods_have_their_order(pendulum: Mechanism, settings: dict[str, Any], order: int, step: float) -> None:
    """Halving the step divides the error by 2^order, to a tenth of an order (at least)."""
    errors = [
        np.abs(swing(pendulum, duration=0.6, step=h, **settings).q[-1] - exact(0.6)).max() for h in (step, step / 2)
    ]
    assert errors[1] > 1e-13, "the error must not be rounding"
    assert np.log2(errors[0] / errors[1]) >= order - 0.1


@pytest.mark.parametrize(
    ("method", "keeping"), [*(("dop853", keeping) for keeping in EXPLICIT), ("rk45", Keeping.PROJECTION)]
)
def test_adaptive_methods_keep_their_tolerance(pendulum: Mechanism, method: str, keeping: Keeping) -> None:
    """At the end, and between the steps; the pendulum passes through both axes, where one coordinate is no choice."""
    motion = swing(pendulum, duration=2.0, method=method, loops=keeping)
    assert motion.energy is not None
    assert motion.closure is not None
    assert np.abs(motion.q[-1] - exact(2.0)).max() < 1e-6
    assert np.abs(motion.energy.drift).max() < 1e-6
    inside = len(motion.t) // 3
    assert np.abs(motion.q[inside] - exact(motion.t[inside])).max() < 1e-6
    assert (motion.effort.switches > 0) == (keeping is Keeping.PARTITIONING)
    if keeping is not Keeping.BAUMGARTE:
        assert max(motion.closure.most) < 1e-13


def test_baumgarte_is_as_accurate_as_measured(pendulum: Mechanism) -> None:
    """The drift of RK4 at h = 0.01 in 10 s, which an independent program measured: 1.0e-7 at 5 1/s, 3.6e-5 without."""
    drifts = []
    for gain in (0.0, 5.0):
        motion = swing(pendulum, duration=10.0, method="rk4", step=1e-2, loops=Keeping.BAUMGARTE, alpha=gain, beta=gain)
        assert motion.closure is not None
        drifts.append(motion.closure.most[0])
    assert drifts[0] == pytest.approx(3.6e-5, rel=0.5)
    assert drifts[1] == pytest.approx(1.0e-7, rel=0.5)


def test_baumgarte_refuses_stiff_gains(pendulum: Mechanism) -> None:
    with pytest.raises(ValueError, match=r"the gain 300 1/s times the step 0.01 s is 3; keep it below 1"):
        swing(pendulum, duration=1.0, method="rk4", step=1e-2, loops=Keeping.BAUMGARTE, alpha=300.0)


@pytest.mark.parametrize("formulation", ["exp1", "semi", "impl"])
def test_formulations_agree(pendulum: Mechanism, formulation: str) -> None:
    """Articulated bodies and orthogonal decomposition give accelerations that differ by rounding."""
    kind = type(Settings(1.0).formulation)
    a, b = (swing(pendulum, duration=1.0, method="rk4", formulation=x) for x in (kind.EXP2, kind(formulation)))
    assert np.abs(a.q[-1] - b.q[-1]).max() < 1e-12


# --- forces --------------------------------------------------------------------------------------------------------


def test_the_rods_force_is_the_pendulums(pendulum: Mechanism) -> None:
    """lam = -m (g cos(angle) + l angle'^2) = -3 m g cos(angle) for a release at pi/2, in the rod's direction."""
    motion = swing(pendulum, duration=1.0)
    assert motion.closure is not None
    assert np.allclose(motion.closure.multipliers[:, 0], 3 * 9.81 * motion.q[:, 1], rtol=0, atol=1e-6)


def test_the_record_of_a_loop_is_its_gaps_at_every_state(pendulum: Mechanism) -> None:
    """The rod opens by the drift of coarse steps; the most of all steps counts the ones that no output shows."""
    motion = swing(pendulum, duration=1.0, method="euler", step=0.01, loops=Keeping.BAUMGARTE, output_step=0.35)
    closure, own = Closure(pendulum), motion.closure
    assert own is not None
    assert motion.t == pytest.approx([0.0, 0.35, 0.7, 1.0])
    gaps, rates = np.abs(closure.gaps(motion.q)), np.abs(closure.rates(motion.q, motion.qd))
    assert own.position.tolist() == gaps.max(axis=1).tolist()
    assert own.velocity.tolist() == rates.max(axis=1).tolist()
    assert own.position.max() > 1e-6
    every = swing(pendulum, duration=1.0, method="euler", step=0.01, loops=Keeping.BAUMGARTE, output_step=0.01).closure
    assert every is not None
    assert own.most == pytest.approx((every.position.max(), every.velocity.max()), rel=1e-12)
    assert own.most[1] > own.velocity.max()
    assert own.driving.shape == (4, 0)


def drive_angle(t: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return 0.3 + 0.5 sin(2 t) with its derivatives."""
    return 0.3 + 0.5 * np.sin(2 * t), np.cos(2 * t), -2 * np.sin(2 * t)


COURSE = follow([parse("0.3 + 0.5*sin(2*t)")], ["q1"], {})


@pytest.mark.parametrize(
    "settings",
    [
        {"method": "dop853"},
        {"method": "dop853", "loops": Keeping.PARTITIONING},
        {"method": "radau-iia", "step": 0.02},
        {"method": "generalized-alpha", "step": 2e-3},
        {"method": "variational", "step": 2e-3},
    ],
)
def test_driven_joints_move_as_given_and_show_their_force(driven: Mechanism, settings: dict[str, Any]) -> None:
    """The force is the pendulum's, I q'' + W sin(q); its work is the change of energy."""
    start = np.array([1.0, -1.0, 1.0])
    motion = simulate(
        driven, rest(driven), level(0.3), start, Settings(1.0, **settings, output_step=0.05), course=COURSE
    )
    q, _, qdd = drive_angle(motion.t)
    assert motion.closure is not None
    assert motion.energy is not None
    assert np.abs(motion.q[:, 0] - q).max() < 1e-12
    assert np.abs(motion.q[:, 2] - q).max() < 1e-12
    assert np.allclose(motion.closure.driving[:, 0], INERTIA * qdd + WEIGHT * np.sin(q), rtol=0, atol=1e-3)
    assert np.abs(motion.energy.drift).max() < 1e-4
    assert motion.energy.work.max() > 1


def test_the_torque_of_the_compressor_is_that_of_virtual_power() -> None:
    """At constant speed w: tau = d/dq (I(q) w^2 / 2 + V(q)) - F dz/dq, with the forces F of gas and drag on the piston.

    I(q) w^2 / 2 is the energy of rod and piston: the centre of the rod is 0.3 of its length above the crank's pin.
    """
    file, w = Path(__file__).parents[3] / "models" / "compressor.yaml", 100.0
    compressor = load(find_folder(file, Extent(functions=FUNCTIONS, derivatives=1)))
    closure = Closure(compressor)
    start = closure.move(np.array(compressor.manifest.pose), [0], np.array([0.7]))
    qd = closure.complete_velocities(start, [0], np.array([w]))
    course = follow([parse("0.7 + 100*t")], ["crank"], {})
    motion = simulate(compressor, rest(compressor), start, qd, Settings(0.06, output_step=0.01), course=course)
    assert motion.closure is not None
    crank, l = 0.045, 0.14

    def tilt(q: np.ndarray) -> np.ndarray:
        return np.asarray(np.arcsin(crank / l * np.sin(q)))

    def place(q: np.ndarray) -> np.ndarray:
        return np.asarray(crank * np.cos(q) + l * np.cos(tilt(q)))

    def across(q: np.ndarray) -> np.ndarray:
        return np.asarray(0.7 * crank * np.sin(q))

    def up(q: np.ndarray) -> np.ndarray:
        return np.asarray(0.7 * crank * np.cos(q) + 0.3 * place(q))

    def slope(f: Callable[[np.ndarray], np.ndarray], q: np.ndarray, h: float = 1e-3) -> np.ndarray:
        return np.asarray((8 * (f(q + h) - f(q - h)) - f(q + 2 * h) + f(q - 2 * h)) / (12 * h))

    def energy(q: np.ndarray) -> np.ndarray:
        inertia = 0.52 * (slope(across, q) ** 2 + slope(up, q) ** 2) + 1.6e-3 * slope(tilt, q) ** 2
        weight = 9.81 * (6.2 * 0.004 * np.cos(q) + 0.52 * up(q) + 0.41 * place(q))
        return np.asarray((inertia + 0.41 * slope(place, q) ** 2) * w**2 / 2 + weight)

    q = 0.7 + w * motion.t
    gas = -0.0046 * 1e5 * (0.102 / (0.012 + crank + l - place(q)) - 1)
    expected = slope(energy, q) - (gas - 15 * slope(place, q) * w) * slope(place, q)
    assert np.ptp(expected) > 30
    assert np.allclose(motion.closure.driving[:, 0], expected, rtol=0, atol=1e-6)


@pytest.mark.parametrize("method", ["dop853", "rk4"])
def test_a_driven_mechanism_at_rest_stays_at_rest(driven: Mechanism, method: str) -> None:
    """Velocities are rounding, which may change by any part of itself; the energy drifts by rounding, too."""
    at_rest = Closure(driven).close(np.array(driven.manifest.pose), [])
    course = follow([parse(repr(float(at_rest[driven.manifest.driven[0]])))], ["q1"], {})
    settings = Settings(0.2, method=method, output_step=0.1)
    motion = simulate(
        driven, rest(driven), at_rest, np.zeros(len(driven.manifest.coordinates)), settings, course=course
    )
    assert motion.t[-1] == 0.2
    assert np.abs(motion.qd).max() < 1e-9
    assert motion.warnings == ()


SHAKEN = """
name: shaken
gravity: [0, 0, -9.81]
bodies:
  - {name: cart, joint: {name: q1, type: prismatic, axis: x, actuated: false}, mass: 1}
  - {name: pole, parent: cart, joint: {name: q2, type: revolute, axis: y}, mass: 1, com: [0, 0, -0.5]}
driven: [q1]
"""


@pytest.fixture(scope="module")
def shaken(tmp_path_factory: pytest.TempPathFactory) -> Mechanism:
    """A driven cart with a pole, which its accelerations move."""
    path = tmp_path_factory.mktemp("shaken") / "model.yaml"
    path.write_text(SHAKEN, encoding="utf-8")
    return load(find_folder(path, Extent(functions=FUNCTIONS[:7], derivatives=1)))


@pytest.mark.parametrize("name", ["parallelogram", "driven", "shaken"])
def test_steps_in_c_are_the_ones_in_python(
    name: str, request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Radau collocation, with inputs over time: the same iterations, and results to their rounding."""
    mechanism = request.getfixturevalue(name)
    texts, course = (["5*sin(3*t)", "0", "0"], None) if name == "parallelogram" else (["0", "0"], COURSE)
    q, qd = (level(0.3), [1, -1, 1]) if name != "shaken" else (np.array([0.3, 0.2]), [1, 0])
    texts = texts[: len(mechanism.manifest.actuated)]
    drive = express([parse(text) for text in texts], texts, {})
    motions = []
    for is_taken in (True, False):
        if is_taken:  # steps in Python repeat the ones that fail in C
            monkeypatch.setattr(multipliers, "iterate", lambda *_: pytest.fail("a step in C failed"))
        else:
            monkeypatch.undo()
            monkeypatch.setattr(radau, "is_taken", lambda *_: False)
        settings = Settings(0.5, "radau-iia", step=0.05, stages=3)
        motions.append(simulate(mechanism, drive, q, qd, settings, course=course))
    first, other = motions
    assert first.effort.iterations == other.effort.iterations > 10
    assert np.allclose(first.q, other.q, rtol=0, atol=1e-12)
    assert np.allclose(first.qd, other.qd, rtol=0, atol=1e-11)
    assert np.ptp(first.q[:, 0]) > 0.1


def test_a_driven_start_must_be_on_its_course(driven: Mechanism) -> None:
    with pytest.raises(ValueError, match="qd of driven joint q1 starts at 0, its course at 1"):
        simulate(driven, rest(driven), level(0.3), np.zeros(3), Settings(1.0), course=COURSE)


def test_inputs_follow_the_state_and_the_time(parallelogram: Mechanism) -> None:
    """A force that takes the weight off leaves the input's own turn, by explicit and by implicit steps."""

    def carry(t: float, q: np.ndarray, _: np.ndarray) -> list[float]:
        return [WEIGHT * np.sin(q[0]) + INERTIA * np.cos(t), 0, 0]

    for settings in ({"method": "dop853"}, {"method": "rk4", "step": 5e-3}, {"method": "radau-iia", "step": 0.05}):
        motion = simulate(
            parallelogram,
            control(carry),
            level(0.2),
            [0.5, -0.5, 0.5],
            Settings(0.5, output_step=0.1, **settings),  # type: ignore[arg-type]
        )
        assert motion.q[-1, 0] == pytest.approx(0.2 + 0.5 * 0.5 + 1 - np.cos(0.5), abs=1e-6)


@pytest.mark.parametrize("keeping", EXPLICIT)
@pytest.mark.parametrize("formulation", [Formulation.IMPL, Formulation.SEMI, Formulation.EXP2])
def test_driven_joints_need_no_loops(tmp_path: Path, formulation: Formulation, keeping: Keeping) -> None:
    """A mass on an arm of length l, whose hinge circles at the speed w and the radius d: by its Lagrangian,

        l q'' = g cos(q) - w^2 (d + l cos(q)) sin(q)

    for every formulation and way to keep loops closed.
    """
    file = tmp_path / "carousel.yaml"
    file.write_text(CAROUSEL, "utf-8")
    carousel = load(find_folder(file, Extent(derivatives=1)))
    w, d, arm, end = 3.0, 0.3, 0.2, 0.4
    settings = Settings(end, "rk4", step=1e-3, formulation=formulation, loops=keeping, output_step=0.1)
    motion = simulate(carousel, rest(carousel), [0, 0], [w, 0], settings, course=follow([parse("3*t")], ["q1"], {}))

    def rate(_: float, y: np.ndarray) -> list[float]:
        return [y[1], (9.81 * np.cos(y[0]) - w**2 * (d + arm * np.cos(y[0])) * np.sin(y[0])) / arm]

    exact = solve_ivp(rate, (0, end), [0, 0], "DOP853", rtol=1e-12, atol=1e-12).y[:, -1]
    assert motion.q[-1] == pytest.approx([w * end, exact[0]], abs=1e-9)  # 400 steps, each off by some 1e-12
    assert motion.qd[-1] == pytest.approx([w, exact[1]], abs=1e-8)


# --- singular poses ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "settings",
    [
        {"method": "rk4", "step": 5e-3},
        {"method": "rk4", "step": 5e-3, "loops": Keeping.MASS_PROJECTION},
        {"method": "rk4", "step": 5e-3, "loops": Keeping.PARTITIONING},
        {"method": "generalized-alpha", "step": 5e-3},
        {"method": "dop853"},
    ],
)
def test_a_parallelogram_passes_its_singular_pose(parallelogram: Mechanism, settings: dict[str, Any]) -> None:
    """It turns over through pi/2 and 3 pi/2, where its coupler might fold over, and stays level."""
    motion = roll(parallelogram, 0.1, 8.0, duration=1.5, **settings)
    assert motion.is_complete
    assert motion.q[-1, 0] > 2 * pi
    assert np.abs(motion.q[-1] - level(turn(0.1, 8.0, 1.5))).max() < 1e-3


@pytest.mark.parametrize("keeping", [Keeping.PROJECTION, Keeping.MASS_PROJECTION, Keeping.PARTITIONING])
def test_a_jump_of_velocities_stops(pendulum: Mechanism, keeping: Keeping) -> None:
    """Closing the loop may not change velocities by a tenth in a step: the step was too long, and lost the motion.

    A step of 0.2 s with Euler's method leaves the circle by 0.6 m; in steps of 2 ms it stays.
    """
    for step, is_complete in ((0.2, False), (2e-3, True)):
        settings = Settings(0.4, "euler", step=step, output_step=0.2, loops=keeping)
        motion = simulate(pendulum, rest(pendulum), [1, 0], [0, -3.0], settings)
        assert motion.is_complete is is_complete
        if not is_complete:
            assert "to close it would change the velocities by a tenth in one step" in str(motion.halt)


def test_a_jump_is_measured_beside_what_a_step_adds(pendulum: Mechanism) -> None:
    """Closing may change velocities by a tenth of the largest |v| + h |a| of a joint: v after the step, a before it."""
    closure, q, qd, found = Closure(pendulum), np.array([1.0, 0.0]), np.array([0.0, -3.0]), []
    for h in np.linspace(0.02, 0.2, 46):
        qdd = pendulum("exp1", q=q, qd=qd, u=np.zeros(0))["qdd"]
        moved = qd + h * qdd
        change = np.abs(closure.project_velocities(closure.close(q + h * qd), moved) - moved).max()
        most = 0.1 * (np.abs(moved) + h * np.abs(qdd)).max()
        settings = Settings(h, "euler", step=h, output_step=h, loops=Keeping.PROJECTION)
        assert simulate(pendulum, rest(pendulum), q, qd, settings).is_complete is bool(change <= most), h
        found.append(change <= most)
    assert (found[0], found[-1]) == (True, False)


def test_a_start_at_a_change_point_needs_all_of_it(parallelogram: Mechanism) -> None:
    """There, one velocity does not decide how the loop goes on; a pose with a rounding of 1e-8 shows it."""
    q = level(pi / 2) + np.array([0.0, 1e-7, 1e-7])
    with pytest.raises(OpenError, match=r"the pose is a change point, .* give all coordinates and velocities"):
        complete_velocities(Closure(parallelogram), q, np.array([1.0, 0.0, 0.0]), [0])


def test_baumgarte_warns_of_a_singular_pose(parallelogram: Mechanism, pendulum: Mechanism) -> None:
    """Its terms do not know the branches that meet there."""
    settings = Settings(0.5, "rk4", loops=Keeping.BAUMGARTE)
    qd = 8 * np.array([1.0, -1.0, 1.0])
    motion = simulate(parallelogram, rest(parallelogram), level(0.1), qd, settings)
    assert any("passes a singular pose of the loops" in warning for warning in motion.warnings)
    assert not swing(pendulum, duration=0.5, method="rk4", loops=Keeping.BAUMGARTE).warnings


def test_a_start_at_a_singular_pose_is_solved_if_it_is_consistent(parallelogram: Mechanism) -> None:
    """On the level branch; velocities of both branches at once contradict the loop's second derivative."""
    motion = roll(parallelogram, pi / 2, 6.0, duration=0.2, method="rk4")
    assert np.abs(motion.q[-1] - level(turn(pi / 2, 6.0, 0.2))).max() < 1e-8
    J = parallelogram("loop_jacobian", q=level(pi / 2), qd=np.zeros(3))["J"]
    both = np.array([6.0, -6.0, 6.0]) + null_space(J, rcond=1e-9).sum(axis=1)
    stuck = simulate(parallelogram, rest(parallelogram), level(pi / 2), both, Settings(0.2, "rk4"))
    assert stuck.halt is not None
    assert stuck.halt.loop == "pin"


def test_a_kernels_failure_names_the_loop(parallelogram: Mechanism) -> None:
    """Statuses up to the number of joints name these; the next ones name loops."""
    places = [find_place(parallelogram.manifest, status) for status in (3, 4, 5)]
    assert [str(place) for place in places] == ["joint q3", "loop pin", "number 5"]


# --- starts --------------------------------------------------------------------------------------------------------


def test_a_start_is_closed_from_what_is_given(parallelogram: Mechanism) -> None:
    """The other coordinates follow along the same assembly, far from the pose that the manifest holds."""
    closure = Closure(parallelogram)
    q = closure.move(np.array(parallelogram.manifest.pose), [0], np.array([-1.2]))
    assert np.allclose(q, level(-1.2), rtol=0, atol=1e-12)
    qd = complete_velocities(closure, q, np.array([2.0, 0, 0]), [0])
    assert np.allclose(qd, [2, -2, 2], rtol=0, atol=1e-12)
    with pytest.raises(OpenError, match="the given velocities open it at a rate of"):
        complete_velocities(closure, q, np.array([2.0, 2.0, 0]), [0, 1])


def test_an_open_start_is_refused(parallelogram: Mechanism) -> None:
    with pytest.raises(OpenError, match=r"loop pin: it is open by 0\.0867"):
        simulate(parallelogram, rest(parallelogram), [1, -1, 1.1], np.zeros(3), Settings(1.0))
    with pytest.raises(OpenError, match=r"loop pin: it opens at 0\.841"):
        simulate(parallelogram, rest(parallelogram), level(1), [1, -1, 0], Settings(1.0))


@pytest.mark.parametrize("method", ["lsoda", "gauss", "symplectic-euler"])
def test_other_methods_are_refused(parallelogram: Mechanism, method: str) -> None:
    with pytest.raises(ValueError, match=f"{method} takes no loops or driven joints; give one of euler, rk4"):
        roll(parallelogram, 1.0, 0.0, duration=1.0, method=method)
    wrong = replace(Settings(1.0), loops=Keeping.GGL)
    with pytest.raises(ValueError, match="dop853 does not keep them closed by ggl; give one of projection"):
        simulate(parallelogram, rest(parallelogram), level(1), np.zeros(3), wrong)


# --- inverse dynamics ----------------------------------------------------------------------------------------------

TIMES = np.linspace(0, 1, 11)


def test_spare_actuators_share_the_force(parallelogram: Mechanism) -> None:
    """All three joints turn alike, so the least forces for I q'' + W sin(q) at one are thirds of it."""
    forces = invert(parallelogram, [0], COURSE, TIMES)
    q, qd, qdd = drive_angle(TIMES)
    assert np.allclose(forces.q, np.outer(q, [1, -1, 1]), rtol=0, atol=1e-12)
    assert np.allclose(forces.qd, np.outer(qd, [1, -1, 1]), rtol=0, atol=1e-12)
    assert np.allclose(forces.qdd, np.outer(qdd, [1, -1, 1]), rtol=0, atol=1e-11)
    whole = INERTIA * qdd + WEIGHT * np.sin(q)
    assert np.allclose(forces.u, np.outer(whole, [1, -1, 1]) / 3, rtol=0, atol=1e-11)
    assert forces.spare == 2
    residual = parallelogram("impl", q=forces.q, qd=forces.qd, qdd=forces.qdd, lam=forces.multipliers, u=forces.u)
    assert np.abs(residual["Phi"]).max() < 1e-11


TURN = follow([parse("1 + 3*t")], ["q1"], {})


@pytest.mark.parametrize("rows", [41, 401, 4001])
def test_a_parallelogram_stays_one_through_its_change_points(parallelogram: Mechanism, rows: int) -> None:
    """Where its links are in line, it could go on as a crossed four-bar: two whole turns pass four such points."""
    times = np.linspace(0, 4, rows)
    forces = invert(parallelogram, [0], TURN, times)
    q = 1 + 3 * times
    np.testing.assert_allclose(forces.q, np.outer(q, [1, -1, 1]), rtol=0, atol=1e-9)
    np.testing.assert_allclose(forces.qd, np.full((rows, 3), [3.0, -3, 3]), rtol=0, atol=1e-6)
    np.testing.assert_allclose(forces.u, np.outer(WEIGHT * np.sin(q), [1, -1, 1]) / 3, rtol=0, atol=1e-5)
    assert forces.find_jump(parallelogram.manifest) is None


def test_a_change_of_branches_is_found(parallelogram: Mechanism) -> None:
    """One joint turns back within a row, and its velocity does not say so."""
    times = np.linspace(0, 1, 101)
    forces = invert(parallelogram, [0], TURN, times)
    q, qd = forces.q.copy(), forces.qd.copy()
    q[60:, 2], qd[60:, 2] = 2 * q[59, 2] - q[60:, 2], -1.5
    assert replace(forces, q=q, qd=qd).find_jump(parallelogram.manifest) == (pytest.approx(0.6), "q3")


def test_faults_of_a_motion_name_time_and_place(parallelogram: Mechanism, pendulum: Mechanism) -> None:
    with pytest.raises(FreeError, match=r"at t = 1 s, q1 = 1\.5708, ways to go on meet, as at a change point; take an"):
        invert(parallelogram, [0], follow([parse("pi*t/2")], ["q1"], {}), np.linspace(0, 2, 21))
    with pytest.raises(OpenError, match=r"it stays open by .* at t = 1 s, z = -2; give other coordinates"):
        invert(pendulum, [1], follow([parse("-0.5 - 1.5*t")], ["z"], {}), np.linspace(0, 1, 2))


def test_a_driven_joint_needs_the_pendulums_force(driven: Mechanism) -> None:
    """Its two other joints are actuated, and share the work."""
    forces = invert(driven, [0], COURSE, TIMES)
    q, _, qdd = drive_angle(TIMES)
    whole = INERTIA * qdd + WEIGHT * np.sin(q)
    assert np.allclose(forces.tau[:, 0] - forces.u[:, 0] + forces.u[:, 1], whole, rtol=0, atol=1e-11)


def test_missing_forces_are_told(pendulum: Mechanism) -> None:
    """Held at z = -1/2 without actuators, the part of the weight along the circle is missing; and z must be given."""
    forces = invert(pendulum, [1], follow([parse("-0.5")], ["z"], {}), np.zeros(1))
    assert forces.q[0, 0] == pytest.approx(sqrt(0.75), abs=1e-12)
    assert forces.unbalanced[0] == pytest.approx(9.81 * 0.75, abs=1e-11)
    with pytest.raises(FreeError, match="1 freedom is left when nothing moves"):
        invert(pendulum, [], follow([], [], {}), np.zeros(1))


def test_the_inverse_command_writes_a_table(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, out = generate(tmp_path, PARALLELOGRAM), tmp_path / "forces.csv"
    words = ["mbsrun", "inverse", str(folder), "--duration", "1", "--output-step", "0.5", "-o", str(out)]
    monkeypatch.setattr(sys, "argv", [*words, "--motion", "q1=0.3 + 0.5*sin(2*t)"])
    with pytest.raises(SystemExit) as end:
        cli.main()
    assert not end.value.code
    assert "2 more forces than degrees of freedom: the ones of least norm are shown" in capsys.readouterr().out
    header, *rows = out.read_text().splitlines()
    assert header.endswith("u[q1] [N m],u[q2] [N m],u[q3] [N m],lam[pin.x] [N],lam[pin.z] [N],unbalanced")
    assert len(rows) == 3
    monkeypatch.setattr(sys, "argv", [*words, "--motion", "knee=t"])
    with pytest.raises(SystemExit) as end:
        cli.main()
    assert end.value.code == 2
    assert "found 'knee=t'; give NAME=EXPRESSION once for some of q1, q2, q3" in " ".join(
        capsys.readouterr().err.split()
    )


# --- the command ---------------------------------------------------------------------------------------------------


Run = Callable[..., tuple[int, str, dict[str, Any]]]


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    """Run the command on a model's text; it returns the exit code, what was said, and the summary."""

    def run(text: str, *options: str) -> tuple[int, str, dict[str, Any]]:
        folder, out = generate(tmp_path, text), tmp_path / "out"
        words = ["mbsrun", "simulate", str(folder), "--duration", "0.5", "-o", str(out), *options]
        monkeypatch.setattr(sys, "argv", words)
        with pytest.raises(SystemExit) as end:
            cli.main()
        said, summary = "".join(capsys.readouterr()), out / "simulation.json"
        return (
            int(end.value.code or 0),
            " ".join(said.split()),
            json.loads(summary.read_text()) if summary.exists() else {},
        )

    return run


def test_the_command_closes_the_start_and_reports_closure(run: Run, tmp_path: Path) -> None:
    """Summary, JSON and table hold the closure; the table holds the forces of the loop."""
    code, said, summary = run(PARALLELOGRAM, "--pose", "q1=0.4", "--velocity", "q1=1")
    assert code == 0
    assert "loops open" in said
    assert summary["closure"]["loops"] == ["pin"]
    assert summary["closure"]["largest_position"] < 1e-13
    assert summary["settings"]["loops"] == "projection"
    lines = (tmp_path / "out" / "trajectory.csv").read_text().splitlines()
    assert lines[0].endswith("open,opening,lam[pin.x] [N],lam[pin.z] [N]")
    first = dict(zip(lines[0].split(","), map(float, lines[1].split(",")), strict=True))
    assert [first[f"q[q{i}] [rad]"] for i in (1, 2, 3)] == pytest.approx([0.4, -0.4, 0.4], abs=1e-12)
    assert [first[f"qd[q{i}] [rad/s]"] for i in (1, 2, 3)] == pytest.approx([1, -1, 1], abs=1e-12)


@pytest.fixture
def no_plots(monkeypatch: pytest.MonkeyPatch) -> None:
    """Draw nothing: another test looks at the files."""
    monkeypatch.setattr(record, "plot_motion", lambda *_: None)


@pytest.mark.usefixtures("no_plots")
def test_the_command_takes_driven_joints(run: Run, tmp_path: Path) -> None:
    code, _, summary = run(DRIVEN, "--driven", "q1=0.3 + 0.5*sin(2*t)", "--loops", "partitioning")
    assert code == 0
    assert summary["end"]["q"][0] == pytest.approx(0.3 + 0.5 * np.sin(1), abs=1e-12)
    assert (tmp_path / "out" / "trajectory.csv").read_text().splitlines()[0].endswith("tau[q1] [N m]")


REFUSED = {
    "an open start": (["--pose", "q1=0.4", "--pose", "q2=1", "--pose", "q3=0"], "loop pin: it stays open by"),
    "a start that contradicts itself": (
        ["--velocity", "q1=1", "--velocity", "q2=1"],
        "loop pin: the given velocities open it at a rate of",
    ),
    "a method without loops": (["--method", "gauss"], "gauss takes no loops"),
    "a joint that is not driven": (["--driven", "q1=t"], 'the model has no driven joint "q1"'),
    "a stiff gain": (["--method", "rk4", "--loops", "baumgarte", "--alpha", "2000"], "is 2; keep it below 1"),
}


@pytest.mark.parametrize(("options", "message"), REFUSED.values(), ids=REFUSED.keys())
def test_the_command_refuses(run: Run, options: list[str], message: str) -> None:
    code, said, summary = run(PARALLELOGRAM, *options)
    assert code == 2
    assert message in said
    assert not summary


@pytest.mark.usefixtures("no_plots")
def test_a_start_that_is_nearly_closed_is_told(run: Run) -> None:
    code, said, _ = run(PARALLELOGRAM, "--pose", "q1=0.4", "--pose", "q2=-0.4001", "--pose", "q3=0.4")
    assert code == 0
    assert "the loops were not closed at the given start: coordinates were changed by up to" in said


def test_time_is_an_input_too(parallelogram: Mechanism) -> None:
    """Inputs over time are part of the stages: the order holds."""
    push = express([parse("3*sin(4*t)"), parse("0"), parse("0")], ["q1", "q2", "q3"], {})
    ends = [
        simulate(parallelogram, push, level(0.3), np.zeros(3), Settings(0.5, "rk4", step=h)).q[-1]
        for h in (0.02, 0.01, 0.005)
    ]
    assert np.log2(np.abs(ends[0] - ends[1]).max() / np.abs(ends[1] - ends[2]).max()) > 3.8
