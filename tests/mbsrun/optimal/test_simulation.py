"""Simulations in Python: the motion of the command, by the keys of its file."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.special import ellipk

import mbsrun
from mbsgen.errors import InputError
from mbsrun.results import UnknownNameError
from mbsrun.simulation import Settings
from mbsrun.simulation import simulate as integrate
from mbsrun.simulation.drive import hold

MODELS = Path(__file__).parents[3] / "models"
PENDULUM = """\
name: rod
gravity: [0, 0, -9.81]
bodies:
  - {name: bob, joint: {name: hinge, type: revolute, axis: y}, mass: 2, com: [0, 0, -0.5]}
"""


@pytest.fixture(scope="module")
def rod(tmp_path_factory: pytest.TempPathFactory) -> mbsrun.Mechanism:
    path = tmp_path_factory.mktemp("rod") / "rod.yaml"
    path.write_text(PENDULUM, encoding="utf-8")
    return mbsrun.load(path)


def test_a_pendulum_keeps_its_period_and_energy(rod: mbsrun.Mechanism) -> None:
    """4 K(sin²(a/2)) sqrt(l/g) from rest at an angle a: there it is again after a period."""
    a = 2.0
    period = 4 * ellipk(np.sin(a / 2) ** 2) * np.sqrt(0.5 / 9.81)
    motion = mbsrun.simulate(rod, duration=period, start={"pose": {"hinge": a}}, rtol=1e-12, atol=1e-12)
    assert motion.is_complete
    assert motion["q_hinge"][-1] == pytest.approx(a, abs=1e-9)
    assert motion["energy"] == pytest.approx(-2 * 9.81 * 0.5 * np.cos(a), rel=1e-10)
    assert motion.unit("energy") == "J"
    assert motion.energy is not None
    assert np.abs(motion.energy.drift).max() < 1e-9


def test_it_is_the_motion_of_arrays(rod: mbsrun.Mechanism) -> None:
    """Bit by bit; and a function of the state is the expression that says the same."""
    given = {"duration": 1, "start": {"pose": {"hinge": "pi/2"}, "velocity": {"hinge": np.float64(0.5)}}}
    found = mbsrun.simulate(rod, **given, inputs={"hinge": 0.3}, method="rk4", step=1e-2)
    same = integrate(rod, hold([0.3]), [np.pi / 2], [0.5], Settings(1.0, "rk4", step=1e-2))
    assert np.array_equal(found.q, same.q)
    text = mbsrun.simulate(rod, **given, inputs={"hinge": "-2*qd_hinge"})
    law = mbsrun.simulate(rod, **given, inputs=lambda _, __, qd: -2 * qd)
    assert law["q_hinge"] == pytest.approx(text["q_hinge"], abs=1e-12)


def test_a_law_with_a_period_is_called_once_in_each(rod: mbsrun.Mechanism) -> None:
    times: list[float] = []

    def law(t: float, *_: np.ndarray) -> list[float]:
        times.append(t)
        return [0.0]

    mbsrun.simulate(rod, duration=1, inputs=law, input_period=0.25)
    assert times == pytest.approx([0, 0.25, 0.5, 0.75])


def test_the_folder_is_the_command_s(rod: mbsrun.Mechanism, tmp_path: Path) -> None:
    motion = mbsrun.simulate(rod, duration=0.5, start={"pose": {"hinge": 1}})
    motion.save(tmp_path / "out", "reaction_hinge")
    assert json.loads((tmp_path / "out" / "simulation.json").read_text("utf-8"))["complete"]
    assert "reaction_hinge [N]" in (tmp_path / "out" / "trajectory.csv").read_text("utf-8").partition("\n")[0]
    motion.plot("q_*", "energy").save(tmp_path / "two.png")
    motion.plot().save(tmp_path / "all.png")
    motion.animate().save(tmp_path / "page.html")
    assert all((tmp_path / name).stat().st_size > 1000 for name in ("two.png", "all.png", "page.html"))
    frame = motion.to_frame("energy")
    assert frame["q_hinge"].to_numpy() == pytest.approx(motion["q_hinge"])
    with pytest.raises(UnknownNameError, match="q_hing"):
        motion.plot("q_hing")


def test_what_ends_early_says_so(rod: mbsrun.Mechanism) -> None:
    motion = mbsrun.simulate(rod, duration=10, start={"pose": {"hinge": 1}}, max_steps=5)
    assert not motion.is_complete
    assert 0 < motion.t[-1] < 10
    assert "stopped at t" in repr(motion)
    assert "incomplete" in motion._repr_html_()


def test_loops_are_closed_at_the_start() -> None:
    motion = mbsrun.simulate(MODELS / "four_bar.yaml", duration=0.1)
    assert motion.closure is not None
    assert motion.closure.position.max() < 1e-12


def test_every_fault_has_a_place_and_a_remedy(rod: mbsrun.Mechanism) -> None:
    with pytest.raises(InputError) as told:
        mbsrun.simulate(rod, duration=-1, start={"pose": {"hing": 1}}, inputs={"hinge": "__import__('os')"})
    lines = str(told.value).splitlines()
    for line in (
        "simulation of rod: duration: found -1; give a positive number",
        'simulation of rod: start.pose.hing: the model has no coordinate "hing"',
        "simulation of rod: inputs.hinge:",
    ):
        assert any(found.startswith(line) for found in lines), lines
