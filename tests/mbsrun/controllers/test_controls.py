"""Controllers whose problems add controls and numbers: an actuator with its own dynamics, slacks, largest values."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import mbsrun
from mbsrun.cli import cli
from mbsrun.optimal.control import OptimalControl

MODEL = """\
name: carts
gravity: [0, 0, 0]
bodies:
  - {name: a, joint: {type: prismatic, axis: x}, mass: 1}
  - {name: b, joint: {type: prismatic, axis: x}, mass: 2}
"""
MOTOR = """\
model: carts.yaml
horizon: 1
intervals: 8
scheme: radau
degree: 2
states: {pull: {rate: 5*(volt - pull), start: 0, range: [-6, 6]}}
controls: {volt: {range: [-4, 4], rate: {weight: 0.001}}}
forces: {a: pull - 0.2*qd_a}
cost:
  inputs: 0.01
  running: [{expression: 10*(q_a - 1)**2 + 10*(q_b - q_a)**2 + 0.1*volt**2}]
start: {pose: {a: 0, b: 0}}
"""


def read(folder: Path, start: float) -> OptimalControl:
    """Return the problem from another place of the first cart."""
    (folder / "carts.yaml").write_text(MODEL, encoding="utf-8")
    (folder / "motor.ocp.yaml").write_text(MOTOR.replace("a: 0,", f"a: {start},"), encoding="utf-8")
    return mbsrun.read_problem(folder / "motor.ocp.yaml")


def test_a_controller_chooses_controls_where_expressions_give_forces(tmp_path: Path) -> None:
    """Its optimum and its first commands are a solve's, from any start; steps in real time lead there."""
    ready, moved = read(tmp_path, 0.0), read(tmp_path, 0.3).solve()
    read(tmp_path, 0.0)
    made = CliRunner().invoke(cli, ["controller", str(tmp_path / "motor.ocp.yaml"), "-o", str(tmp_path / "out")])
    assert made.exit_code == 0, made.output
    controller = mbsrun.controller(tmp_path / "out")
    assert [(x.name, x.unit) for x in controller.manifest.inputs] == [("b", "N"), ("volt", "")]
    assert not controller.manifest.predicts
    assert controller.solve().cost == pytest.approx(ready.solve().cost, rel=1e-7)
    state = [0.3, 0.0, 0.0, 0.0, 0.0]  # coordinates, velocities, the added state
    motion = moved.trajectory
    assert motion is not None
    expected = [motion.u[0, 1], motion.controls[0, 0]]
    for _ in range(10):
        assert controller.prepare().status == "prepared"
        inputs, step = controller.feedback(state)
    assert step.violation < 1e-9
    assert inputs == pytest.approx(expected, abs=0.1)  # the barrier's own distance
    inputs, result = controller.rescue(state)
    assert result.cost == pytest.approx(moved.cost, rel=1e-7)
    assert inputs == pytest.approx(expected, abs=1e-4)
    controller.data["controls_upper"][:] = 1.5
    assert controller.solve().is_solved
    assert np.max(controller.plan().inputs[:, 1]) == pytest.approx(1.5, abs=1e-6)


NUMBERS = """\
model: carts.yaml
horizon: 1
intervals: 8
scheme: radau
degree: 2
start: {pose: {a: 0, b: 0}}
unknowns: {meeting: {range: [-1, 1], guess: 0}}
constraints:
  - {expression: q_a, range: [null, 0.3], soft: 5}
  - {expression: q_b - 1, range: [0, 0], at: end, soft: {linear: 1, quadratic: 5, name: miss}}
  - {expression: q_a - meeting, range: [0, 0], at: end}
cost:
  inputs: 0.01
  running: [{expression: abs(u_b), weight: 0.05}]
  terminal: [{expression: abs(q_a - 0.5)}, {expression: (meeting - 0.6)**2}]
  largest: [{expression: u_b, absolute: true, weight: 0.1, name: peak}]
"""
HELD = ["absolute_0_", "meeting", "miss", "peak"]


def test_numbers_are_states_that_hold_still(tmp_path: Path) -> None:
    """Slacks, largest values, absolute values and unknowns: costs and commands are a solve's, from any start."""
    (tmp_path / "carts.yaml").write_text(MODEL, encoding="utf-8")
    (tmp_path / "task.ocp.yaml").write_text(NUMBERS, encoding="utf-8")
    problem = mbsrun.read_problem(tmp_path / "task.ocp.yaml")
    made = CliRunner().invoke(cli, ["controller", str(tmp_path / "task.ocp.yaml"), "-o", str(tmp_path / "out")])
    assert made.exit_code == 0, made.output
    controller = mbsrun.controller(tmp_path / "out")
    assert [x.name for x in controller.manifest.inputs] == ["a", "b", "slack_0", "absolute_0"]
    assert sorted(x.name for x in controller.manifest.states[4:]) == HELD
    solved = problem.solve()
    assert controller.solve().cost == pytest.approx(solved.cost, rel=1e-7)
    plan = controller.plan()
    for name, state in zip([x.name for x in controller.manifest.states[4:]], plan.states[:, 4:].T, strict=True):
        assert state == pytest.approx(solved.unknowns[name], abs=2e-5), name

    (tmp_path / "task.ocp.yaml").write_text(NUMBERS.replace("a: 0,", "a: 0.2,"), encoding="utf-8")
    moved = mbsrun.read_problem(tmp_path / "task.ocp.yaml").solve()
    assert moved.trajectory is not None
    inputs, result = controller.rescue([0.2, 0, 0, 0, 7, 7, 7, 7])  # the last four are read by nobody
    assert result.cost == pytest.approx(moved.cost, rel=1e-6)
    assert inputs[:2] == pytest.approx(moved.trajectory.u[0], abs=1e-4)
