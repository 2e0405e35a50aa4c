"""Inputs and open wrenches by expressions, and unknown ones: closed forms, and programs of CasADi's Opti."""

from __future__ import annotations

from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from mbsgen.errors import InputError
from mbsrun import load
from mbsrun.ocp.ground import schemes
from mbsrun.ocp.ground.plant import Plant
from mbsrun.ocp.problem.problem import Problem
from mbsrun.ocp.solution.solution import Solution
from mbsrun.ocp.solution.table import write_table
from mbsrun.ocp.solving.resimulation import resimulate
from mbsrun.ocp.solving.solve import solve
from mbsrun.ocp.statement.statement import read_problem

BLOCK = """
name: block
gravity: [0, 0, -10]
bodies:
  - {name: rail, joint: {name: x, type: prismatic, axis: x}, mass: 0}
  - name: block
    parent: rail
    joint: {name: z, type: prismatic, axis: z, actuated: %s}
    mass: 2
frames:
  - {name: sole, body: block}
wrenches:
  - {name: foot, body: block, force: input}
"""
FREE_BLOCK = BLOCK % "false"
PROBLEM = """
model: block.yaml
horizon: 0.5
intervals: 10
scheme: radau
degree: 3
"""


def read(folder: Path, text: str, model: str = FREE_BLOCK) -> tuple[Problem, Plant]:
    (folder / "block.yaml").write_text(model)
    (folder / "block.ocp.yaml").write_text(PROBLEM + text)
    return read_problem(folder / "block.ocp.yaml", load)


def found(problem: Problem, plant: Plant) -> Solution:
    outcome = solve(problem, plant)
    assert isinstance(outcome, Solution), outcome
    return outcome


SPRING = """
constants: {k: 800, c: 8}
wrenches:
  foot: {force: [0, 0, k*(0.1 - z_sole) - c*qd_z]}
start: {pose: {x: 0, z: 0.1}, velocity: {x: 1}}
cost: {running: [{expression: push**2}]}
forces: {x: 3*push}
controls: {push: {}}
end: {pose: {x: 1}}
"""


def test_a_spring_under_a_block_follows_its_closed_form(tmp_path: Path) -> None:
    """2 z'' = k (0.1 - z) - c z' - 20: a damped oscillation. 2 x'' = 3 push: 1 m from 1 m/s in 0.5 s, at least effort.

    The least integral of a^2 that moves by s in T from v is 3 (s - v T)^2 / T^3; N steps need
    1 / (1 - 1 / (4 N^2)) of it.
    """
    problem, plant = read(tmp_path, SPRING, FREE_BLOCK)
    solution = found(problem, plant)
    t, w0, d = solution.trajectory.t, 20.0, 0.1
    w1 = w0 * np.sqrt(1 - d**2)
    decay = np.exp(-d * w0 * t) * (np.cos(w1 * t) + d * w0 / w1 * np.sin(w1 * t))
    assert solution.trajectory.q[:, 1] == pytest.approx(0.1 - 20 / 800 * (1 - decay), abs=2e-4)
    effort = 3 * 0.5**2 / 0.5**3 * (2 / 3) ** 2
    assert solution.cost.total == pytest.approx(effort / (1 - 1 / (4 * 10**2)), rel=1e-9)
    points = solution.trajectory
    lift = 800 * (0.1 - points.point_q[..., 1]) - 8 * points.point_qd[..., 1]
    assert points.point_w[..., 2] == pytest.approx(lift, abs=1e-9)
    assert points.point_u[..., 0] == pytest.approx(np.repeat(3 * points.controls, 3, axis=1), abs=1e-9)
    check = resimulate(solution, plant).resimulation
    assert check is not None
    assert check.defect is not None
    assert check.defect < 1e-4
    assert check.open_loop_error is not None
    assert check.open_loop_error < 1e-3
    by_stages = found(problem.with_solver("mbs"), plant)
    assert by_stages.cost.total == pytest.approx(solution.cost.total, rel=1e-8)


UNKNOWN = """
wrenches:
  foot: {force: [0, 0, {range: [0, 60], guess: 20}]}
start: {pose: {z: 0}}
end: {pose: {z: 0.3}, velocity: zero}
cost: {running: [{expression: (fz_foot/20 - 1)**2}]}
"""


def test_an_unknown_force_has_the_optimum_of_another_program(tmp_path: Path) -> None:
    """The same collocation by Opti, with a force at every point: equal costs and forces."""
    problem, plant = read(tmp_path, UNKNOWN)
    solution = found(problem, plant)
    scheme, h, N = schemes.build(problem.family, problem.degree), 0.05, 10
    opti = ca.Opti()
    x, z, f = opti.variable(2, N + 1), opti.variable(2, 3 * N), opti.variable(1, 3 * N)
    cost = 0
    for k in range(N):
        own = z[:, 3 * k : 3 * k + 3]
        nodes = ca.horzcat(x[:, k], own)
        for j in range(3):
            force = f[3 * k + j]
            opti.subject_to(nodes @ ca.DM(scheme.D[j]) == h * ca.vertcat(own[1, j], force / 2 - 10))
            cost += h * scheme.weights[j] * (force / 20 - 1) ** 2
        opti.subject_to(x[:, k + 1] == own[:, 2])
    opti.subject_to(x[:, 0] == 0)
    opti.subject_to(x[:, N] == ca.DM([0.3, 0]))
    opti.subject_to(opti.bounded(0, f, 60))
    opti.minimize(cost)
    opti.solver("ipopt", {"ipopt.print_level": 0, "print_time": False, "ipopt.sb": "yes", "ipopt.tol": 1e-10})
    peer = opti.solve()
    assert solution.cost.total == pytest.approx(float(peer.value(cost)), rel=1e-7)
    assert solution.trajectory.point_w[..., 2].ravel() == pytest.approx(peer.value(f), abs=1e-4)
    check = resimulate(solution, plant).resimulation
    assert check is not None
    assert check.is_accurate
    by_stages = found(problem.with_solver("mbs"), plant)
    assert by_stages.cost.total == pytest.approx(solution.cost.total, rel=1e-7)
    write_table(solution, plant, tmp_path / "solution.csv")
    header, *rows = (tmp_path / "solution.csv").read_text().splitlines()
    assert header.endswith("w[fx_foot] [N],w[fy_foot] [N],w[fz_foot] [N]")
    assert float(rows[1].rpartition(",")[2]) == solution.trajectory.point_w[0, 0, 2]


BAD = """
wrenches:
  foot: {force: [0, fz_foot, {range: [3, 2]}], moment: [0, 0, 0]}
  hand: {force: [0, 0, 0]}
forces: {y: 1, z: "qdd_z + sin(a)"}
start: {pose: {z: 0}}
cost: {inputs: 1}
controls: {b: {}}
"""


def test_every_fault_of_forces_is_reported(tmp_path: Path) -> None:
    """Faults come with file, line, place and a remedy, all at once."""
    with pytest.raises(InputError) as error:
        read(tmp_path, BAD, BLOCK % "true")
    faults = {fault.path: (fault.line, fault.finding, fault.remedy) for fault in error.value.faults}
    assert faults["forces.y"][1] == 'the model has no actuated coordinate "y"'
    assert faults["forces.z"][1] == 'unknown name "a"'
    assert faults["wrenches.foot.force[2].range"][1] == "3 is above 2"
    assert faults["wrenches.foot.moment"][1] == "the model gives the moment of this wrench"
    assert faults["wrenches.hand"][1] == 'the model has no open wrench "hand"'
    with pytest.raises(InputError, match="and fx_foot, fy_foot, fz_foot have no value"):
        read(tmp_path, "start: {pose: {z: 0}}\ncost: {inputs: 1}\n", BLOCK % "true")
    circle = "wrenches: {foot: {force: [fz_foot, 0, fx_foot]}}\nstart: {pose: {z: 0}}\ncost: {inputs: 1}\n"
    with pytest.raises(InputError, match=r"wrenches.foot.force\[0\]: expressions that read each other in a circle"):
        read(tmp_path, circle, BLOCK % "true")
    circle = circle.replace("fx_foot]", "qdd_z]")
    with pytest.raises(InputError, match=r"wrenches.foot.force\[.\]: the expression reads accelerations"):
        read(tmp_path, circle, BLOCK % "true")
