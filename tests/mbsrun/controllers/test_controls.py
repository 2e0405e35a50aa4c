"""Controllers whose problems add controls, and give forces by expressions: an actuator with its own dynamics."""

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
