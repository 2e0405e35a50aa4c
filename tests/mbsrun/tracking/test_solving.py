"""The controller that solves at each sample, on a puck whose optimal motions have closed forms."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mbsgen.expressions import Expression, parse
from mbsrun import Mechanism
from mbsrun.external import Mechanism as Loaded
from mbsrun.external import OnDemand, load_on_demand
from mbsrun.ocp.ground.grid import Grid
from mbsrun.ocp.ground.trajectory import Trajectory, move_ahead
from mbsrun.ocp.problem.problem import Problem
from mbsrun.ocp.statement.statement import read_problem
from mbsrun.simulation.motion import Settings
from mbsrun.tracking import Horizon, Noise, Plant, SolvingController, Track, Trial, track
from mbsrun.tracking.mechanisms import load_simulated
from tests.mbsrun.tracking.tasks import FOLLOW, TO_REST

QUIET = Noise(np.zeros(1), np.zeros(1), np.zeros(1))
TRIAL = Trial("task", 0.9, 0.05, np.zeros(1), np.zeros(1), QUIET, Settings(1.0))
SHRINKING = Horizon(1.0, 0.1)


def read(text: str, folder: Path) -> tuple[Problem, Loaded | OnDemand]:
    file = folder / "task.ocp.yaml"
    file.write_text(text, encoding="utf-8")
    return read_problem(file, load_on_demand)


def run(text: str, folder: Path, plant: Mechanism, trial: Trial) -> Track:
    problem, model = read(text, folder)
    controller = SolvingController(problem, model, trial.period, trial.horizon)
    return track(trial, problem.bounds, Plant(plant, trial), controller)


def test_an_undisturbed_loop_follows_its_first_plan(puck: Mechanism, folder: Path) -> None:
    """The principle of optimality: from rest to rest x = 3 t^2 - 2 t^3, whatever has passed; inputs are steps of it."""
    found = run(TO_REST, folder, puck, replace(TRIAL, horizon=SHRINKING))
    assert found.failures == 0
    assert found.q[:, 0] == pytest.approx(3 * found.t**2 - 2 * found.t**3, abs=5e-3)


def test_the_loop_corrects_a_wrong_mass(folder: Path) -> None:
    """Under the first plan alone, a puck of 1.25 times the mass would be at 0.8 of the way."""
    heavy = load_simulated(folder / "puck.yaml", is_released=True).with_parameters(m=2.5)
    found = run(TO_REST, folder, heavy, replace(TRIAL, horizon=SHRINKING))
    assert found.q[-1, 0] == pytest.approx(3 * 0.9**2 - 2 * 0.9**3, abs=0.05)


@pytest.mark.parametrize(("updates", "largest"), [({"t0": parse("t")}, 0.01), ({}, 1.0)])
def test_a_reference_moves_with_an_updated_constant(
    puck: Mechanism, folder: Path, updates: dict[str, Expression], largest: float
) -> None:
    """Without the update, every plan follows the first second of the sine."""
    found = run(FOLLOW, folder, puck, replace(TRIAL, duration=2.0, start_qd=np.ones(1), updates=updates))
    error = float(np.abs(found.q[:, 0] - np.sin(found.t)).max())
    assert error < largest
    assert (error < 0.01) == bool(updates)


def test_a_failed_solve_keeps_the_plan(folder: Path) -> None:
    """From 5 m away no motion gets to the target under bounded inputs; the plan before gives the inputs."""
    problem, model = read(TO_REST + "bounds: {inputs: [-20, 20]}\n", folder)
    controller = SolvingController(problem, model, 0.05)
    first = controller.feedback(np.zeros(1), np.zeros(1))
    controller.prepare(0.05, {})
    lost = controller.feedback(np.array([-5.0]), np.zeros(1))
    assert (first.is_solved, lost.is_solved) == (True, False)
    assert lost.inputs == pytest.approx(controller.planned(0.05))
    assert lost.inputs[0] == pytest.approx(first.inputs[0], rel=0.2)
    assert controller.planned(30.0) == pytest.approx(controller.planned(0.95))


def test_a_plan_that_moves_ahead_by_an_interval_loses_its_first() -> None:
    """Interval k takes the numbers of k + 1; after its end the motion stands still under the last inputs."""
    rng = np.random.default_rng(0)
    t, point_t = Grid(4).times(1.0, np.array([1 / 3, 1.0]))
    plan = Trajectory(
        t, rng.normal(size=(5, 2)), rng.normal(size=(5, 2)), rng.normal(size=(4, 1)), point_t,
        *(rng.normal(size=(4, 2, 2)) for _ in range(3)),
    )  # fmt: skip
    plan.q[1:], plan.qd[1:] = plan.point_q[:, -1], plan.point_qd[:, -1]  # as at Radau points
    moved = move_ahead(plan, 0.25, t, point_t)
    for name in ("u", "point_q", "point_qd", "point_qdd"):
        assert getattr(moved, name)[:3] == pytest.approx(getattr(plan, name)[1:])
    assert moved.q[:4] == pytest.approx(plan.q[1:])
    assert moved.u[3] == pytest.approx(plan.u[3])
    assert moved.point_q[3] == pytest.approx(np.tile(plan.q[4], (2, 1)))
    assert not moved.point_qd[3].any()
    assert not moved.point_qdd[3].any()
