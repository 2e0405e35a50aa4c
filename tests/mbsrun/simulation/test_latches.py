"""Latches and couplings that hold at given times: closed forms, energy in drawn trees, refusals."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import ArrayLike, NDArray
from scipy.integrate import solve_ivp

from mbsgen.errors import InputError
from mbsrun import Mechanism, load
from mbsrun.models import Extent
from mbsrun.simulation import Impacts, Kind, Latch, Motion, Settings, differentiate, simulate
from mbsrun.simulation.drive import control, hold
from mbsrun.simulation.integration.methods import find_refusals
from mbsrun.simulation.statement import read_statement
from tests.mbsrun.simulation.conftest import MODELS, load_texts

Array = NDArray[np.float64]
Make = Callable[[str], Mechanism]

NEEDED = Extent(("exp2", "impl", "semi", "semi_res", "energy", "power", "frames", "touching", "distances"), 1)
TIGHT = {"rtol": 1e-12, "atol": 1e-12}
WHEELS = """
name: wheels
gravity: [0, 0, 0]
bodies:
  - {name: a, joint: {type: revolute, axis: z, actuated: false}, mass: 1, inertia: [0.3, 0.3, 0.3]}
  - {name: b, joint: {type: revolute, axis: z, actuated: false, force: 4*t}, mass: 1, inertia: [0.5, 0.5, 0.5]}
stops:
  - {name: clutch, quantity: q_b - 2*q_a, restitution: 0, hold: 3}
  - {name: weak, quantity: q_b - 2*q_a, restitution: 0, hold: 0.4}
  - {name: turned, quantity: 2*q_a - q_b, restitution: 0, hold: 0.4}
"""
CATCH = """
name: catch
gravity: [0, 0, -9.81]
bodies:
  - {name: load, joint: {type: prismatic, axis: z, actuated: false}, mass: 2}
stops:
  - {name: hook, quantity: q_load, limits: [null, 1], restitution: 0, hold: 100}
"""


@pytest.fixture(scope="session")
def make(tmp_path_factory: pytest.TempPathFactory) -> Make:
    """Return a function that loads a model from its text, each text once."""
    return load_texts(tmp_path_factory, NEEDED)


def run(wheels: Mechanism, end: float, name: str, *times: tuple[float, float], **options: object) -> Motion:
    latches = (Latch(name, times),) if times else ()
    settings = Settings(end, **TIGHT, latches=latches, **options)  # type: ignore[arg-type]
    return simulate(wheels, hold([]), [0.2, 0.5], [4, 1], settings)


@pytest.mark.parametrize("impacts", list(Impacts))
def test_a_clutch_engages_at_its_time_wherever_it_is_and_lets_go_at_another(make: Make, impacts: Impacts) -> None:
    """With b = 2 a + c, J = (-2, 1): the impulse P = -J w/(J M^-1 J^T), and 4/0.3 + 1/0.5 = 46/3."""
    motion = run(make(WHEELS), 0.8, "clutch", (0.5, 0.75), impacts=impacts)
    before = np.array([4, 1 + 4 * 0.5**2])
    P = -(before[1] - 2 * before[0]) / (46 / 3)
    after = before + P * np.array([-2 / 0.3, 1 / 0.5])
    assert [(x.joint, x.kind) for x in motion.events] == [("clutch", k) for k in (Kind.IMPACT, Kind.REST, Kind.LEAVE)]
    assert [x.time for x in motion.events] == [0.5, 0.5, 0.75]
    rate = np.array([1, 2]) / (0.3 + 4 * 0.5)  # by a torque T on b: a gains 2 T/(0.3 + 4 0.5)
    together = after + 2 * rate * 2 * (0.75**2 - 0.5**2)
    end = together + np.array([0, 4 * (0.8**2 - 0.75**2)])
    np.testing.assert_allclose(motion.qd[-1], end, rtol=1e-12)
    held = (motion.t > 0.501) & (motion.t < 0.75)
    assert np.ptp(motion["gap_clutch"][held]) < 1e-14
    np.testing.assert_allclose(motion["normal_clutch"][held], -0.3 / 2.3 * 4 * motion.t[held], rtol=1e-11)
    assert motion.energy is not None
    assert motion.energy.impacts is not None
    np.testing.assert_allclose(motion.energy.impacts[-1], 0.5 * P**2 * 46 / 3, rtol=1e-12)
    assert np.abs(motion.energy.drift).max() < 1e-11


@pytest.mark.parametrize("name", ["weak", "turned"])
def test_a_clutch_parts_where_its_force_is_exceeded_and_engages_anew_at_the_next_time(make: Make, name: str) -> None:
    """It bears 0.3/2.3 of the torque 4 t, either way, up to `hold`; then it stays open until the next pair of times."""
    motion, parts = run(make(WHEELS), 1.0, name, (0.25, 0.85), (0.9, 0.95)), 0.4 * 2.3 / 0.3 / 4
    events = [(x.joint, x.kind, pytest.approx(x.time, abs=1e-12)) for x in motion.events]
    first = [(name, Kind.IMPACT, 0.25), (name, Kind.REST, 0.25), (name, Kind.LEAVE, parts)]
    assert events == [*first, (name, Kind.IMPACT, 0.9)]  # at the second time the torque exceeds its force
    held = (motion.t > 0.251) & (motion.t < parts)
    assert np.ptp(motion[f"gap_{name}"][held]) < 1e-14
    np.testing.assert_allclose(np.abs(motion[f"normal_{name}"][held]), 0.3 / 2.3 * 4 * motion.t[held], rtol=1e-11)


def test_without_times_a_coupling_does_nothing(make: Make) -> None:
    motion = run(make(WHEELS), 0.8, "clutch")
    assert not motion.events
    np.testing.assert_allclose(motion.qd[-1], [4, 1 + 4 * 0.8**2], rtol=1e-12)


@pytest.mark.parametrize("period", [None, 0.1])
def test_a_catch_drops_its_load_at_the_end_of_its_times(make: Make, period: float | None) -> None:
    """Thrown up to the hook, the load hangs until 1.3 s, and falls; also with sampled inputs."""
    drive = hold([]) if period is None else control(lambda *_: np.zeros(0), period)
    speed = np.sqrt(2 * 9.81 * 1.2)
    settings = Settings(1.5, **TIGHT, latches=(Latch("hook", ((0.2, 1.3),)),))  # type: ignore[arg-type]
    motion = simulate(make(CATCH), drive, [0], [speed], settings)
    arrives = (speed - np.sqrt(speed**2 - 2 * 9.81)) / 9.81
    events = [(x.kind, pytest.approx(x.time, abs=1e-12)) for x in motion.events]
    assert events == [(Kind.IMPACT, arrives), (Kind.REST, arrives), (Kind.LEAVE, 1.3)]
    np.testing.assert_allclose(motion.q[-1], 1 - 9.81 * 0.2**2 / 2, rtol=1e-12)


def test_a_catch_whose_time_has_not_come_lets_its_load_fall(make: Make) -> None:
    settings = Settings(1.5, **TIGHT, latches=(Latch("hook", ((1.0, np.inf),)),))  # type: ignore[arg-type]
    motion = simulate(make(CATCH), hold([]), [0], [5.0], settings)
    assert [x.kind for x in motion.events] == [Kind.IMPACT]


def test_couplings_of_a_drawn_tree_create_no_energy_and_keep_their_numbers(make: Make) -> None:
    rng = np.random.default_rng(1)
    text = "name: drawn\ngravity: [0, 0, 0]\nbodies:\n"
    for i in range(3):
        kind, axis = rng.choice(["revolute", "prismatic"]), rng.normal(size=3).round(3).tolist()
        place, com = ((0.3 * rng.normal(size=3)).round(3).tolist() for _ in range(2))
        parent = f"b{i - 1}" if i else "base"
        joint = f"{{type: {kind}, axis: {axis}, position: {place}, actuated: false}}"
        text += (
            f"  - {{name: b{i}, parent: {parent}, joint: {joint}, mass: 1, com: {com}, inertia: [0.1, 0.2, 0.15]}}\n"
        )
    text += "frames: [{name: tip, body: b2, position: [0.3, 0.2, 0.1], sensor: false}]\n"
    text += "stops:\n  - {name: one, quantity: q_b0 - q_b1*q_b2, restitution: 0, hold: 1e6}\n"
    text += "  - {name: two, quantity: z_tip + x_tip**2, restitution: 0, hold: 1e6}\n"
    latches = (Latch("one", ((0.1, 0.5),)), Latch("two", ((0.2, 0.3), (0.4, 0.6))))
    settings = Settings(0.7, rtol=1e-10, atol=1e-10, latches=latches, output_step=0.01)
    motion = simulate(make(text), hold([]), rng.normal(size=3), rng.normal(size=3), settings)
    assert motion.halt is None
    assert motion.energy is not None
    assert motion.energy.impacts is not None
    assert (np.diff(motion.energy.impacts) >= 0).all()
    assert motion.energy.impacts[-1] > 0
    assert np.abs(motion.energy.drift).max() < 1e-8
    for name, (start, end) in (("one", (0.1, 0.5)), ("two", (0.2, 0.3)), ("two", (0.4, 0.6))):
        assert np.ptp(motion[f"gap_{name}"][(motion.t > start + 1e-6) & (motion.t < end - 1e-6)]) < 1e-13


def test_times_that_mean_nothing_are_refused(make: Make) -> None:
    wheels = make(WHEELS)
    for latches, told in (
        ((Latch("dog", ((0, 1),)),), "the model has no latch or coupling dog; give one of clutch, turned, weak"),
        ((Latch("clutch", ()),), "clutch has no times"),
        ((Latch("clutch", ((1, 0.5),)),), "the times of clutch do not increase"),
        ((Latch("clutch", ((-1, 0.5),)),), "the times of clutch do not increase"),
        ((Latch("clutch", ((0, 1), (1, 2))),), "the times of clutch do not increase"),
        ((Latch("clutch", ((0, float("nan")),)),), "the times of clutch do not increase"),
        ((Latch("clutch", ((0, 1),)), Latch("clutch", ((2, 3),))), "clutch stands there twice"),
    ):
        with pytest.raises(ValueError, match=told):
            simulate(wheels, hold([]), [0, 0], [0, 0], Settings(1.0, latches=latches))
    settings = Settings(1.0, latches=(Latch("clutch", ((0, 1),)),))
    with pytest.raises(ValueError, match="latches that hold at given times are not differentiated"):
        differentiate(wheels, hold([]), [0, 0], [0, 0], settings)
    assert [x[0] for x in find_refusals(Settings(1.0, "moreau"), wheels.manifest)] == ["method"]


def test_a_file_of_settings_gives_times(make: Make, tmp_path: Path) -> None:
    file = tmp_path / "wheels.yaml"
    file.write_text("duration: 2\nconstants: {T: 0.5}\nlatches: {clutch: [[T, 2*T], [1.5, null]]}\n", encoding="utf-8")
    found = read_statement(file, {}, make(WHEELS).manifest)
    assert found.settings.latches == (Latch("clutch", ((0.5, 1.0), (1.5, np.inf))),)
    file.write_text("duration: 2\nlatches: {dog: [[0, 1]], clutch: [[2, 1]]}\n", encoding="utf-8")
    with pytest.raises(InputError) as error:
        read_statement(file, {}, make(WHEELS).manifest)
    assert "no latch or coupling dog" in str(error.value)
    assert "the times of clutch do not increase" in str(error.value)


def test_a_coupling_has_a_force(tmp_path: Path) -> None:
    file = tmp_path / "model.yaml"
    file.write_text(WHEELS.replace(", hold: 3", ""), encoding="utf-8")
    with pytest.raises(InputError, match=r"stops\[0\].limits: no limit"):
        load(file)


def test_the_clutch_of_the_models_engages_and_lets_go_as_settings_say() -> None:
    """SciPy's DOP853 on both apart, then as one: 0.02 w' = 12 - 0.08 w and 1.924 w' = 60 g 0.02 sin q - 0.01 w."""
    model = load(MODELS / "switching" / "clutch.yaml", extent=NEEDED)
    motion = simulate(model, hold([]), [0, 0], [0, 0], Settings(6.0, **TIGHT, latches=(Latch("clutch", ((1, 4),)),)))
    I, J, c, d, weight = 0.02, 1.9 + 60 * 0.02**2, 0.08, 0.01, 60 * 9.81 * 0.02

    def apart(_: float, x: Array) -> list[float]:
        return [x[2], x[3], (12 - c * x[2]) / I, (weight * np.sin(x[1]) - d * x[3]) / J]

    def together(_: float, x: Array) -> list[float]:
        rate = (12 - (c + d) * x[2] + weight * np.sin(x[1])) / (I + J)
        return [x[2], x[3], rate, rate]

    def follow(law: Callable[[float, Array], list[float]], start: ArrayLike, *span: float) -> Any:
        return solve_ivp(law, span, start, "DOP853", rtol=1e-13, atol=1e-13, dense_output=True)

    speed, turned = 150 * (1 - np.exp(-4)), 150 * (1 - (1 - np.exp(-4)) / 4)
    joined = I * speed / (I + J)
    held = follow(together, [turned, 0, joined, joined], 1, 4)
    torque = I * np.array([together(t, held.sol(t))[2] for t in held.t]) + c * held.y[2] - 12
    assert np.abs(torque).max() < 60  # it does not part before its time
    events = [("clutch", Kind.IMPACT, 1.0), ("clutch", Kind.REST, 1.0), ("clutch", Kind.LEAVE, 4.0)]
    assert [(x.joint, x.kind, x.time) for x in motion.events] == events
    end = follow(apart, held.y[:, -1], 4, 6).y[:, -1]
    np.testing.assert_allclose([*motion.q[-1], *motion.qd[-1]], end, rtol=1e-9)
    k = int(np.flatnonzero(motion.t >= 2.5)[0])
    found = held.sol(motion.t[k])
    np.testing.assert_allclose([*motion.q[k], *motion.qd[k]], found, rtol=1e-10)
    expected = 12 - c * found[2] - I * together(0, found)[2]
    np.testing.assert_allclose(motion["normal_clutch"][k], expected, rtol=1e-9)
    assert motion.energy is not None
    assert motion.energy.impacts is not None
    lost = I * J / (I + J) * speed**2 / 2
    np.testing.assert_allclose(motion.energy.impacts[-1], lost, rtol=1e-11)
