"""Re-simulation against closed forms, and what it says of meshes that are too coarse."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from scipy.special import ellipj

from mbsgen.manifest import Coordinate
from mbsrun.external import load_on_demand
from mbsrun.limits import Limits
from mbsrun.ocp.problem.problem import Problem
from mbsrun.ocp.showing.summary import summarise
from mbsrun.ocp.solution.solution import Solution
from mbsrun.ocp.solving.resimulation import Constant, Course, Replay, accelerations, integrate, resimulate
from mbsrun.ocp.solving.solve import solve
from mbsrun.ocp.statement.statement import read_problem
from tests.mbsrun.ocp.plants import push
from tests.mbsrun.peer import FREE, Peer, double_integrator, residual_function

REFERENCE = json.loads((Path(__file__).parents[2] / "reference" / "seed_arm_docquier.json").read_text("utf-8"))


def test_accelerations_are_those_of_the_reference(arm: Peer) -> None:
    """M qdd = tau - c, with inputs at the arm's joints only: the reference's torques, less M^-1 of the passive ones."""
    for state in REFERENCE["states"]:
        M = np.array(state["exact50"]["M"], dtype=float)
        qdd, tau = np.array(state["exact50"]["qdd_fd"], dtype=float), np.array(state["tau"])
        passive = np.linalg.solve(M, np.concatenate((np.zeros(4), tau[4:])))
        q, qd, u = np.array([state["q"]]), np.array([state["qd"]]), tau[None, :4]
        assert accelerations(arm, q, qd, u)[0] == pytest.approx(qdd - passive, rel=1e-11)


def test_a_constant_push_is_a_parabola() -> None:
    """q = q0 + v0 t + u t^2 / 2, for several motions at once."""
    states, u = np.array([[0.0, 1.0], [2.0, -1.0], [0.5, 0.0]]), np.array([[1.0], [0.0], [-3.0]])
    ends = integrate(double_integrator(), states, Constant(u), 0.7)
    assert ends is not None
    expected = np.stack((states[:, 0] + 0.7 * states[:, 1] + u[:, 0] * 0.245, states[:, 1] + 0.7 * u[:, 0]), axis=1)
    assert ends == pytest.approx(expected, abs=1e-13)


def test_a_motion_that_collocation_integrates_exactly_has_no_defect() -> None:
    """Quadratic motions under piecewise constant inputs, collocated at degree 2: rounding and IPOPT's 1e-8 remain."""
    outcome = solve(push(8), double_integrator())
    assert isinstance(outcome, Solution)
    check = resimulate(outcome, double_integrator()).resimulation
    assert check is not None
    assert check.defect is not None
    assert check.open_loop_error is not None
    assert check.defect < 1e-12
    assert check.open_loop_error < 1e-12
    assert check.is_accurate


def test_the_papers_mesh_is_accurate(arm: Peer, reached: Solution) -> None:
    """(100, 4): an independent rebuild has a largest defect of 1e-10; open loop the plant multiplies it."""
    check = resimulate(reached, arm).resimulation
    assert check is not None
    assert check.defect is not None
    assert check.open_loop_error is not None
    assert check.defect < 1e-9
    assert check.defect < check.open_loop_error < 1e-4
    assert check.is_accurate


def test_a_coarse_mesh_is_found_out(arm: Peer, reach: Problem) -> None:
    """(25, 2) solves with success and a plausible cost, and is wrong by 3.5e-2 in an interval."""
    outcome = solve(replace(reach, intervals=25, degree=2), arm)
    assert isinstance(outcome, Solution)
    assert outcome.run.status == "Solve_Succeeded"
    check = resimulate(outcome, arm).resimulation
    assert check is not None
    assert check.defect is not None
    assert 1e-3 < check.defect < 1
    assert not check.is_accurate


def test_the_defect_is_judged_by_the_accuracy_asked_for(arm: Peer, reached: Solution) -> None:
    strict = replace(reached, problem=replace(reached.problem, accuracy=1e-14))
    check = resimulate(strict, arm).resimulation
    assert check is not None
    assert not check.is_accurate


def test_a_wrong_trajectory_shows_where_it_is_wrong(arm: Peer, reached: Solution) -> None:
    """A coordinate moved by 1e-3 at one mesh point: the defect is there, in the interval before or after."""
    q = reached.trajectory.q.copy()
    q[40, 2] += 1e-3
    check = resimulate(replace(reached, trajectory=replace(reached.trajectory, q=q)), arm).resimulation
    assert check is not None
    assert check.defect_interval in (39, 40)
    assert check.defect is not None
    assert check.defect >= 0.9e-3


def test_a_plant_that_cannot_be_integrated_is_told() -> None:
    """Inputs that are not numbers: the integrator gives up, and that is not an accuracy."""
    outcome = solve(push(8), double_integrator())
    assert isinstance(outcome, Solution)
    u = np.full_like(outcome.trajectory.u, np.nan)
    broken = replace(outcome, trajectory=replace(outcome.trajectory, u=u))
    check = resimulate(broken, double_integrator()).resimulation
    assert check is not None
    assert check.defect is None
    assert check.open_loop_error is None
    assert not check.is_accurate


def test_a_motion_that_leaves_the_solution_is_put_back_on_it() -> None:
    """A push of 100 N more in an interval of 1/8 s: 12.5 m/s too fast at its end, where the solution goes on."""
    outcome = solve(push(8), double_integrator())
    assert isinstance(outcome, Solution)
    u = outcome.trajectory.u.copy()
    u[3] += 100.0
    pushed = replace(outcome, trajectory=replace(outcome.trajectory, u=u))
    check = resimulate(pushed, double_integrator()).resimulation
    assert check is not None
    assert check.lost == (pushed.trajectory.t[4],)
    assert check.defect_interval == 3
    assert check.open_loop_error == pytest.approx(0, abs=1e-12)
    lines = summarise(replace(pushed, resimulation=check))
    assert lines["open loop"].endswith(f"put back on it, once at {check.lost[0]:.4g} s")
    kept = resimulate(outcome, double_integrator()).resimulation
    assert kept is not None
    assert kept.lost == ()


def test_added_states_ride_along_the_mechanism_as_in_one_system(tmp_path: Path) -> None:
    """An oscillator and the work of a pendulum's damper: closed form and SciPy's DOP853 on all equations together."""
    model = tmp_path / "rod.yaml"
    model.write_text(ROD, encoding="utf-8")
    file = tmp_path / "swing.ocp.yaml"
    file.write_text(SWING, encoding="utf-8")
    problem, plant = read_problem(file, load_on_demand)
    outcome = solve(problem, plant)
    assert isinstance(outcome, Solution), outcome
    trajectory = outcome.trajectory
    states = np.concatenate((trajectory.q, trajectory.qd, trajectory.states), axis=1)
    course = Course(outcome.problem, trajectory, plant)
    alone, together = (Replay(plant, course, None, Limits()) for _ in range(2))
    together.stepper = None
    apart, whole = alone.go_apart(states[:-1]), together.go_apart(states[:-1])
    assert alone.stepper is not None
    assert apart is not None
    assert whole is not None
    assert apart.ends == pytest.approx(whole.ends, abs=1e-11)
    k, x = np.repeat(np.arange(5), 3), np.tile([0.1, 0.5, 0.9], 5)
    assert apart.read(k, x) == pytest.approx(whole.read(k, x), abs=1e-9)  # DOP853's interpolation is of order 7
    c, s = np.cos(40 * course.lengths[0]), np.sin(40 * course.lengths[0])
    assert apart.ends[:, 2:4] == pytest.approx(states[:-1, 2:4] @ np.array([[c, -40 * s], [s / 40, c]]), abs=1e-11)


ROD = """
name: rod
gravity: [0, 0, -9.81]
bodies:
  - {name: rod, joint: {name: hinge, type: revolute, axis: y, damping: 0.2}, mass: 1, com: [0, 0, -0.5]}
"""
SWING = """
model: rod.yaml
horizon: 1
intervals: 5
degree: 3
start: {pose: {}, velocity: {}}
end: {pose: {hinge: 1}}
scheme: radau
states:
  e: {rate: a, start: 0, end: null}
  a: {rate: -1600*e, start: 1, end: null}
  work: {rate: 0.2*qd_hinge**2 + 0*qdd_hinge, start: 0, end: null}
cost: {inputs: 1}
"""


def test_a_swing_is_integrated_to_rounding() -> None:
    """A pendulum from rest at a: q(t) = 2 asin(k cd(w t, k^2)), k = sin(a / 2), by elliptic functions; no coarse step.

    Rounding, and the integrator's 1e-13 a step in some ten steps, leave 1e-11.
    """
    q, qd, qdd, u = (ca.SX.sym(name) for name in ("q", "qd", "qdd", "u"))
    functions = {"impl": residual_function(q, qd, qdd, u, qdd + 9.81 * ca.sin(q) - u)}
    hinge = Coordinate(name="hinge", motion="revolute", actuated=True, **FREE)
    plant = Peer("pendulum", functions, [hinge], [])
    angles, t, w = np.array([0.3, 1.0, 2.0, 3.0]), 0.9, np.sqrt(9.81)
    ends = integrate(plant, np.stack((angles, np.zeros(4)), axis=1), Constant(np.zeros((4, 1))), t)
    k = np.sin(angles / 2)
    _, cn, dn, _ = ellipj(w * t, k**2)
    assert ends is not None
    assert ends[:, 0] == pytest.approx(2 * np.arcsin(k * cn / dn), abs=1e-11)


def test_one_bad_interval_of_many_is_not_accurate() -> None:
    """The largest defect counts, not the mean: 1.5e-6 between two of 64 intervals, where 1e-6 is asked for."""
    outcome = solve(push(64), double_integrator())
    assert isinstance(outcome, Solution)
    q = outcome.trajectory.q.copy()
    q[30] += 1.5e-6
    moved = replace(outcome, trajectory=replace(outcome.trajectory, q=q))
    for accuracy, is_accurate in ((1e-6, False), (2e-6, True)):
        judged = replace(moved, problem=replace(moved.problem, accuracy=accuracy))
        check = resimulate(judged, double_integrator()).resimulation
        assert check is not None
        assert check.defect == pytest.approx(1.5e-6, rel=1e-3)
        assert check.is_accurate is is_accurate


@pytest.mark.parametrize(
    ("limits", "has_defect", "finding"),
    [
        (Limits(steps=0), False, "limit of 0 steps"),
        (Limits(seconds=0.0), False, "limit of 0 s of processor time"),
        (Limits(steps=8), True, "limit of 8 steps"),  # enough for all intervals at once, not for one after the other
    ],
)
def test_a_check_that_does_not_finish_is_no_accuracy(limits: Limits, has_defect: bool, finding: str) -> None:
    """Measurements before the limit stay; the solution is not called accurate."""
    outcome = solve(push(64), double_integrator())
    assert isinstance(outcome, Solution)
    check = resimulate(outcome, double_integrator(), limits).resimulation
    assert check is not None
    assert (check.defect is not None) is has_defect
    assert check.open_loop_error is None
    assert finding in check.unfinished
    assert not check.is_accurate
