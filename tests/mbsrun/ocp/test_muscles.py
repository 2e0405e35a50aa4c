"""An arm with Hill-type muscles against a program in CasADi's Opti; `test_moco` compares it with OpenSim."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from mbsgen.errors import InputError
from mbsrun import load
from mbsrun.ocp.showing.pictures import make_trajectories
from mbsrun.ocp.solution.solution import Solution
from mbsrun.ocp.solving.solve import solve
from mbsrun.ocp.statement.statement import read_problem
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


HANGING = FOLDER / "moco" / "hanging.ocp.yaml"


def test_a_mass_hangs_on_an_elastic_tendon_as_in_moco() -> None:
    """Moco (OpenSim 4.6) has the cost 0.01071448 on the same grid, legendre-gauss-radau-3, with a tolerance of 1e-8.

    Its controls are free inside intervals there (interpolate_control_mesh_interior_points is off). By default they are
    linear, and the cost is 0.01071480; by Hermite-Simpson it is 0.0107175. On fine grids, ours is 0.0107149.
    """
    problem, plant = read_problem(HANGING, load)
    assert [x.name for x in problem.states] == ["muscle", "tendon"]
    assert [x.name for x in problem.controls] == ["muscle_excitation", "tendon_rate"]
    found = solve(problem, plant)
    assert isinstance(found, Solution), found
    assert found.cost.total == pytest.approx(0.0107149, rel=1e-4)
    assert found.cost.total == pytest.approx(0.01071448480, rel=1.5e-5)
    assert found.trajectory.point_states is not None
    tension, length = found.trajectory.point_states[..., 1], found.trajectory.point_q[..., 0]
    along = length - 0.05 * (1 + np.log((tension + 0.2) / 0.2) * 0.1 / np.log(6))
    slack = (np.exp(4 * (along / 0.1 - 1) / 0.6) - np.exp(-3.2 / 0.6)) / (np.exp(4) - np.exp(-3.2 / 0.6))
    assert (tension > slack).all()  # active fibres pull too


FAULTS = {
    "times": ("fall: 0.06", "", "one time of activation dynamics; give rise and fall, or neither"),
    "course": (
        "inputs: polynomial",
        "inputs: constant",
        "a value at each collocation point; take inputs: polynomial, or linear",
    ),
    "muscles": ("hanging.yaml", "sliding_mass.yaml", "the model has no muscles; give it some, with type: muscle"),
    "key": ("rise: 0.015", "rises: 0.015", "rises"),
    "own": (
        "fall: 0.06",
        "fall: 0.06, own: {mussle: {rise: 0.1, fall: 0.2}}",
        'there is no muscle "mussle"; did you mean "muscle"?',
    ),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_faulty_muscles_of_a_problem_are_one_clear_error(fault: str, tmp_path: Path) -> None:
    old, new, wanted = FAULTS[fault]
    text = HANGING.read_text("utf-8")
    assert old in text
    for name in ("hanging.yaml", "sliding_mass.yaml"):
        shutil.copy(HANGING.parent / name, tmp_path)
    (tmp_path / "hanging.ocp.yaml").write_text(text.replace(old, new), "utf-8")
    with pytest.raises(InputError) as caught:
        read_problem(tmp_path / "hanging.ocp.yaml", load)
    assert wanted in str(caught.value)
    assert "hanging.ocp.yaml:" in str(caught.value)
