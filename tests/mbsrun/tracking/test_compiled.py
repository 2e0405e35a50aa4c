"""A controller in C in the closed loop of a puck: it repeats the loop of the solver, and refuses what does not fit."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import mbsrun
from mbsgen.expressions import parse
from mbsgen.output import write_folder
from mbsrun import Controller, Mechanism
from mbsrun.controllers.making import make
from mbsrun.external import load_on_demand
from mbsrun.ocp.problem import Problem
from mbsrun.ocp.statement import read_problem
from mbsrun.simulation.motion import Settings
from mbsrun.tracking import Kick, Noise, Plant, SolvingController, Trial, track
from mbsrun.tracking.compiled import CompiledController, MisfitError
from tests.mbsrun.tracking.tasks import FOLLOW

QUIET = Noise(np.zeros(1), np.zeros(1), np.zeros(1))
TRIAL = Trial(
    "task", 1.0, 0.05, np.zeros(1), np.ones(1), QUIET, Settings(1.0),
    updates={"t0": parse("t")}, kicks=(Kick(0.4, ((0, 0.2),)),),
)  # fmt: skip


@pytest.fixture(scope="module")
def problem(folder: Path) -> Problem:
    (folder / "follow.ocp.yaml").write_text(FOLLOW, encoding="utf-8")
    return read_problem(folder / "follow.ocp.yaml", load_on_demand)[0]


@pytest.fixture(scope="module")
def written(problem: Problem, folder: Path) -> Controller:
    """Write the controller, and load it; compiled without optimisation, since compiling takes longer than running."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CFLAGS", "-O0")
        made = make(problem, load_on_demand(folder / "puck.yaml"), folder / "puck.yaml")
        write_folder(made.files, folder / "controller")
        return mbsrun.controller(folder / "controller")


@pytest.mark.parametrize(("steps", "period"), [(None, 0.05), (1, 0.05), (1, 0.025)])
def test_it_acts_as_the_solver_does(
    written: Controller, problem: Problem, puck: Mechanism, folder: Path, steps: int | None, period: float
) -> None:
    """The problem is quadratic, so that one step solves it; periods are intervals of the plan, or halves."""
    trial = replace(TRIAL, period=period)
    written.reset()
    found = track(trial, problem.bounds, Plant(puck, trial), CompiledController(written, problem, period, steps))
    assert found.failures == 0
    assert {x.decision.status for x in found.samples} == {"solved" if steps is None else "stepped"}
    assert np.abs(found.q[:, 0] - np.sin(found.t)).max() < 0.05
    if period == TRIAL.period:
        solver = SolvingController(problem, load_on_demand(folder / "puck.yaml"), period)
        expected = track(trial, problem.bounds, Plant(puck, trial), solver)
        assert found.q == pytest.approx(expected.q, abs=1e-6)


def test_a_rate_that_does_not_fit_is_refused(written: Controller, problem: Problem) -> None:
    with pytest.raises(MisfitError, match="give a rate of 20 Hz"):
        CompiledController(written, problem, 0.04)
    with pytest.raises(MisfitError, match="another problem"):
        CompiledController(written, replace(problem, intervals=10), 0.05)


def test_a_state_that_is_no_number_keeps_the_plan(written: Controller, problem: Problem) -> None:
    written.reset()
    controller = CompiledController(written, problem, 0.05, steps=1)
    first = controller.feedback(np.zeros(1), np.ones(1))
    controller.prepare(0.05, {})
    lost = controller.feedback(np.array([np.nan]), np.ones(1))
    assert (first.is_solved, lost.is_solved) == (True, False)
    assert lost.inputs == pytest.approx(controller.planned(0.05))
    assert np.isfinite(lost.inputs).all()
