"""Controls and inputs by expressions in the closed loop: a pendulum with a motor, by the solver and in C.

The motion is compared with an integration of the motor's own equations by SciPy, from one row of track.csv to the next:

    L i' = V - R i - k w,    J w' = n k i - d w - m g l sin(a),    a' = w.
"""

from __future__ import annotations

import csv
import json
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from mbsgen.errors import InputError
from mbsrun.cli import cli

Array = NDArray[np.float64]
MASS, LENGTH, INERTIA, GRAVITY = 1.0, 0.5, 0.02, 9.81
R, L, K, GEAR, DAMPING = 0.5, 0.05, 0.4, 5.0, 0.05
PERIOD = 0.05
MODEL = f"""\
name: motor
gravity: [0, 0, -{GRAVITY}]
bodies:
  - name: link
    joint: {{name: arm, type: revolute, axis: y, actuated: true}}
    mass: {MASS}
    com: [0, 0, -{LENGTH}]
    inertia: {{xx: {INERTIA}, yy: {INERTIA}, zz: 0.001}}
"""
PROBLEM = f"""\
model: motor.yaml
horizon: 0.6
intervals: 12
scheme: radau
degree: 3
constants: {{t0: 0}}
states: {{i: {{rate: (volt - {R}*i - {K}*qd_arm)/{L}, start: 0}}}}
controls: {{volt: {{range: [-24, 24]}}}}
forces: {{arm: {GEAR * K}*i - {DAMPING}*qd_arm}}
cost:
  inputs: 0
  running:
    - {{expression: (q_arm - 0.5*sin(2*(t0 + t)))**2, weight: 100}}
    - {{expression: volt**2, weight: 1e-3}}
start: {{pose: {{arm: 0.3}}}}
"""
TRIAL = """\
duration: 0.5
rate: 20
updates: {t0: t}
noise: {inputs: {volt: 0.3}}
kicks: [{time: 0.22, velocity: {arm: 0.5}}]
measures: [{name: current, expression: abs(i), most: 100}]
"""


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the files of the motor, and its controller in C."""
    place = tmp_path_factory.mktemp("motor")
    for name, text in (("motor.yaml", MODEL), ("follow.ocp.yaml", PROBLEM), ("loop.track.yaml", TRIAL)):
        (place / name).write_text(text)
    done = CliRunner().invoke(cli, ["controller", str(place / "follow.ocp.yaml"), "-o", str(place / "c")])
    assert done.exit_code == 0, done.output
    return place


def run(place: Path, out: Path, *options: str) -> list[dict[str, float]]:
    """Run the loop, and return the rows of its table; all samples have plans."""
    command = ["track", str(place / "follow.ocp.yaml"), "--settings", str(place / "loop.track.yaml"), "-o", str(out)]
    done = CliRunner().invoke(cli, [*command, *options])
    assert done.exit_code == 0, done.output
    assert "energy drift  not checked: inputs follow expressions" in done.output
    summary = json.loads((out / "summary.json").read_text())
    assert summary["failures"] == 0
    assert summary["energy_drift"] is None
    with (out / "track.csv").open() as file:
        rows = [{k: float(v) for k, v in row.items() if k != "status"} for row in csv.DictReader(file)]
    return [*rows, {"t": 0.5, "end": 1.0, **summary["end"]}]


def move(state: Array, voltage: float, seconds: float) -> Array:
    """Integrate the motor's own equations under a constant voltage."""
    inertia = INERTIA + MASS * LENGTH**2

    def rate(_: float, x: Array) -> list[float]:
        angle, speed, current = x
        moment = GEAR * K * current - DAMPING * speed - MASS * GRAVITY * LENGTH * np.sin(angle)
        return [speed, moment / inertia, (voltage - R * current - K * speed) / L]

    return np.asarray(solve_ivp(rate, (0, seconds), state, method="DOP853", rtol=1e-12, atol=1e-12).y[:, -1])


@pytest.mark.parametrize("options", [(), ("--controller",), ("--controller", "--steps"), ("--delay",)])
def test_the_motion_is_the_motors(place: Path, tmp_path: Path, options: tuple[str, ...]) -> None:
    """Each period moves by the equations of motor and pendulum, from one row to the next, kick included."""
    values = {"--controller": str(place / "c"), "--steps": "1", "--delay": "1"}
    rows = run(place, tmp_path / "out", *(word for option in options for word in (option, values[option])))
    for row, after in pairwise(rows):
        state = np.array([row["q[arm]"], row["qd[arm]"], row["state[i]"]])
        volt = row["acting_control[volt]"]
        first = 0.22 - row["t"] if 0 < 0.22 - row["t"] < PERIOD else 0.0
        if first:
            state = move(state, volt, first) + np.array([0, 0.5, 0])
        expected = move(state, volt, PERIOD - first)
        found = [after["q"][0], after["qd"][0], after["states"][0]] if "end" in after else None  # type: ignore[index]
        found = found or [after["q[arm]"], after["qd[arm]"], after["state[i]"]]
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9)
        assert row["u[arm]"] == pytest.approx(GEAR * K * row["state[i]"] - DAMPING * row["qd[arm]"], abs=1e-12)
        assert 0 < abs(volt - row["control[volt]"]) < 2, "noise acts on the voltage"
    assert any(abs(row["control[volt]"]) > 1 for row in rows[:-1])


def test_the_controller_in_c_gives_the_solvers_voltages(place: Path, tmp_path: Path) -> None:
    """Both solve the same problem from the same states."""
    by_solver, by_c = run(place, tmp_path / "a"), run(place, tmp_path / "b", "--controller", str(place / "c"))
    for row, other in zip(by_solver[:-1], by_c[:-1], strict=True):
        assert other["control[volt]"] == pytest.approx(row["control[volt]"], rel=1e-4, abs=1e-4)


def test_rates_of_controls_hold_from_the_last_one_on(tmp_path: Path) -> None:
    """Between samples, too; without the bound the voltage jumps further."""
    (tmp_path / "motor.yaml").write_text(MODEL)
    (tmp_path / "loop.track.yaml").write_text(TRIAL.replace("noise: {inputs: {volt: 0.3}}\n", ""))
    largest = []
    for rate in ("", ", rate: {range: [-100, 100]}"):
        (tmp_path / "follow.ocp.yaml").write_text(PROBLEM.replace("range: [-24, 24]", f"range: [-24, 24]{rate}"))
        rows = run(tmp_path, tmp_path / "out")[:-1]
        largest.append(max(abs(b["control[volt]"] - a["control[volt]"]) / PERIOD for a, b in pairwise(rows)))
    assert largest[0] > 200
    assert 99 < largest[1] < 100 + 1e-4


SOFT = """\
model: motor.yaml
horizon: 0.5
intervals: 5
scheme: radau
degree: 3
cost: {inputs: 1}
start: {pose: {arm: 0.3}}
constraints: [{expression: q_arm, range: [null, 0.2], at: path, soft: 1000}]
"""


def test_slacks_of_soft_constraints_do_not_act(tmp_path: Path) -> None:
    """A slack is a control of the plan alone: the pendulum moves under its torque, from beyond the soft limit."""
    problem, settings = tmp_path / "soft.ocp.yaml", tmp_path / "loop.track.yaml"
    (tmp_path / "motor.yaml").write_text(MODEL)
    problem.write_text(SOFT)
    settings.write_text("duration: 0.3\nrate: 10\n")
    done = CliRunner().invoke(cli, ["track", str(problem), "--settings", str(settings), "-o", str(tmp_path / "out")])
    assert "3 Solve_Succeeded" in done.output, done.output
    with (tmp_path / "out" / "track.csv").open() as file:
        rows = list(csv.DictReader(file))

    def rate(_: float, x: Array, torque: float) -> list[float]:
        return [x[1], (torque - MASS * GRAVITY * LENGTH * np.sin(x[0])) / (INERTIA + MASS * LENGTH**2)]

    for row, after in pairwise(rows):
        start = [float(row["q[arm]"]), float(row["qd[arm]"])]
        end = solve_ivp(rate, (0, 0.1), start, "DOP853", args=(float(row["u[arm]"]),), rtol=1e-12, atol=1e-12).y[:, -1]
        np.testing.assert_allclose([float(after["q[arm]"]), float(after["qd[arm]"])], end, rtol=0, atol=1e-9)


def test_the_integrator_of_the_plant_is_not_for_such_problems(place: Path, tmp_path: Path) -> None:
    """A method that would be ignored is refused."""
    command = ["track", str(place / "follow.ocp.yaml"), "--settings", str(place / "loop.track.yaml")]
    done = CliRunner().invoke(cli, [*command, "-o", str(tmp_path / "out"), "--method", "rk4"])
    assert isinstance(done.exception, InputError)
    assert "controls and forces of the problem move the plant with its states" in str(done.exception)
