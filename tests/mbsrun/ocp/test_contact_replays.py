"""Contacts that stand, of mechanisms with quaternions; and the motion of a leg, replayed in MuJoCo."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from mbsrun import load
from mbsrun.ocp.solution.solution import Solution
from mbsrun.ocp.solving.resimulation import resimulate
from mbsrun.ocp.solving.solve import solve
from mbsrun.ocp.statement.statement import read_problem
from tests.mbsrun.ocp.legs import LEG, SQUAT

SPINNER = """
name: spinner
gravity: [0, 0, -9.81]
bodies:
  - {name: hull, joint: {type: free, actuated: true}, mass: 3, inertia: [0.1, 0.12, 0.05]}
frames:
  - {name: foot, body: hull, position: [0.1, 0, -0.3]}
wrenches:
  - {name: foot, body: hull, position: [0.1, 0, -0.3], frame: base, force: input}
"""
TILT = """
model: spinner.yaml
horizon: 0.6
intervals: 6
scheme: radau
degree: 3
start: {pose: {}}
end: {pose: {hull.qx: 0, hull.qy: sin(0.2), hull.qz: 0, hull.qw: cos(0.2)}, velocity: zero}
contacts: [{sensor: foot}]
cost: {inputs: 1}
"""
# The leg of LEG, written from its numbers: bodies at their joints, y out of the plane, a ball of 1 mm as the foot.
MJCF = """
<mujoco>
  <option timestep="0.0001" gravity="0 0 -9.81" integrator="implicitfast" cone="elliptic" impratio="1000"/>
  <worldbody>
    <geom type="plane" size="5 5 1" friction="5 0 0" solref="0.001 1" solimp="0.999 0.9999 0.0001"/>
    <body pos="0 0 HEIGHT">
      <joint type="slide" axis="1 0 0"/>
      <joint type="slide" axis="0 0 1"/>
      <inertial pos="0 0 0" mass="5" diaginertia="1 1 1"/>
      <body>
        <joint name="hip" axis="0 1 0"/>
        <inertial pos="0 0 -0.2" mass="1" diaginertia="0.02 0.02 0.001"/>
        <body pos="0 0 -0.4">
          <joint name="knee" axis="0 1 0"/>
          <inertial pos="0 0 -0.2" mass="0.5" diaginertia="0.01 0.01 0.001"/>
          <geom type="sphere" size="0.001" pos="0 0 -0.4" friction="5 0 0"
                solref="0.001 1" solimp="0.999 0.9999 0.0001"/>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator><motor joint="hip"/><motor joint="knee"/></actuator>
</mujoco>
"""


def find(folder: Path, name: str, model: str, text: str) -> Solution:
    (folder / f"{name}.yaml").write_text(model)
    (folder / f"{name}.ocp.yaml").write_text(text)
    problem, plant = read_problem(folder / f"{name}.ocp.yaml", load)
    found = solve(problem, plant)
    assert isinstance(found, Solution), found
    return resimulate(found, plant)


def test_a_free_body_tilts_about_its_foot(tmp_path: Path) -> None:
    """The foot stays, by rotations that are written out here; the end at rest has no condition too many."""
    solution = find(tmp_path, "spinner", SPINNER, TILT)
    motion, check = solution.trajectory, solution.resimulation
    x, y, z, w = motion.q[:, 3:].T
    arm = np.array([0.1, 0.0, -0.3])
    turned = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 1 - 2 * (x * x + y * y)],
        ]
    )
    foot = motion.q[:, :3].T + turned[:, 0] * arm[0] + turned[:, 1] * arm[2]
    assert foot == pytest.approx(np.tile(arm[:, None], (1, 7)), abs=1e-6)
    assert len(solution.problem.end.velocities) == 3  # the foot gives the other three
    assert motion.qd[-1] == pytest.approx(np.zeros(6), abs=1e-8)
    assert check is not None
    assert check.slip_along is not None
    assert check.slip_along < 1e-10
    assert check.defect is not None
    assert check.defect < 1e-5


def test_mujoco_moves_a_leg_the_same_way(tmp_path: Path) -> None:
    """Under the computed inputs a leg that presses a ball on a plane squats as it does; MuJoCo's contact is soft."""
    motion = find(tmp_path, "leg", LEG, SQUAT).trajectory
    depth = 0.4 * np.cos(motion.q[0, 2]) + 0.4 * np.cos(motion.q[0, 2] + motion.q[0, 3])
    model = mujoco.MjModel.from_xml_string(MJCF.replace("HEIGHT", repr(float(depth + 0.001))))
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = motion.q[0], motion.qd[0]
    for k, u in enumerate(motion.u):
        data.ctrl[:] = u
        while data.time < motion.t[k + 1] - 5e-5:
            mujoco.mj_step(model, data)
        assert data.qpos == pytest.approx(motion.q[k + 1], abs=5e-3)
    assert data.qvel == pytest.approx(motion.qd[-1], abs=2e-2)
