"""An arm with Hill-type muscles against a program in CasADi's Opti; `test_moco` compares it with OpenSim."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from mbsrun import load
from mbsrun.ocp.pictures import make_trajectories
from mbsrun.ocp.solution import Solution
from mbsrun.ocp.solve import solve
from mbsrun.ocp.statement import read_problem
from tests.mbsrun.ocp.muscles import write_arm
from tests.shipped import FOLDER

LIFT = FOLDER / "muscles" / "lift.ocp.yaml"
N, D = 20, 3


@pytest.fixture(autouse=True)
def compiler(requires: Callable[[str], str]) -> None:
    requires("cc")


def test_the_lift_is_a_program_in_opti() -> None:
    """Radau's collocation on the same grid, with excitations at each point."""
    problem, plant = read_problem(LIFT, load)
    found = solve(replace(problem, refine=None, solver=replace(problem.solver, tolerance=1e-10)), plant)
    assert isinstance(found, Solution), found
    opti, arm, h = ca.Opti(), write_arm(), 0.6 / N
    tau = ca.collocation_points(D, "radau")
    C, ends, weights = ca.collocation_coeff(tau)
    mesh, motion = opti.variable(6, N + 1), found.trajectory
    opti.set_initial(mesh, np.concatenate((motion.q, motion.qd, motion.states), axis=1).T)
    cost = 0
    for k in range(N):
        points, drives = opti.variable(6, D), opti.variable(2, D)
        every = ca.horzcat(mesh[:, k], points)
        for j in range(D):
            x, e = points[:, j], drives[:, j]
            rate = ca.vertcat(x[2:4], arm(x[:2], x[2:4], x[4:]), (e - x[4:]) / 0.04)
            opti.subject_to((every @ C)[:, j] == h * rate)
            cost += h * weights[j] * ca.sumsqr(e)
        opti.subject_to(mesh[:, k + 1] == every @ ends)
        opti.subject_to(opti.bounded(0.01, ca.vec(ca.vertcat(points[4:, :], drives)), 1))
        start = np.concatenate((motion.point_q[k], motion.point_qd[k], motion.point_states[k]), axis=1)
        opti.set_initial(points, start.T)
        opti.set_initial(drives, motion.point_controls[k].T)
    opti.subject_to(mesh[:, 0] == [0.1, 0.2, 0, 0, 0.05, 0.05])
    opti.subject_to(mesh[:4, N] == [0.9, 1.2, 0, 0])
    opti.minimize(cost)
    opti.solver("ipopt", {"print_time": False, "ipopt.print_level": 0, "ipopt.tol": 1e-10})
    solution = opti.solve()
    assert found.cost.total == pytest.approx(solution.value(cost), rel=1e-7)
    titles = [axes.get_title(loc="left") for axes in make_trajectories(found, plant.manifest).axes]
    assert titles == ["Joint coordinates", "Joint velocities", "Further states", "Further controls", "Signals"]
    assert motion.q == pytest.approx(solution.value(mesh)[:2].T, abs=1e-5)
    assert motion.states == pytest.approx(solution.value(mesh)[4:].T, abs=1e-4)
