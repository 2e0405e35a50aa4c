"""A controller in C in the closed loop of a puck: it repeats the loop of the solver, and refuses what does not fit."""

from __future__ import annotations

import csv
import math
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import mbsrun
from mbsgen.expressions import parse
from mbsgen.output import write_folder
from mbsrun import Controller, Mechanism, cli
from mbsrun.controllers.making import make
from mbsrun.external import load_on_demand
from mbsrun.ocp.problem.problem import Problem
from mbsrun.ocp.statement.statement import read_problem
from mbsrun.simulation.motion import Settings
from mbsrun.tracking import Kick, Noise, Plant, SolvingController, Trial, record, track
from mbsrun.tracking.compiled import CompiledController, MisfitError, Stepping
from tests.mbsrun.tracking.tasks import FOLLOW

MODELS = Path(__file__).parents[3] / "models"
Call = Callable[..., tuple[object, str]]

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
    stepping = None if steps is None else Stepping(steps)
    found = track(trial, problem.bounds, Plant(puck, trial), CompiledController(written, problem, period, stepping))
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
    with pytest.raises(
        MisfitError, match="another problem: 2, 1, 20 states, inputs and intervals, and not 2, 1, 10; w"
    ):
        CompiledController(written, replace(problem, intervals=10), 0.05)


SETTINGS = "duration: 0.3\nrate: 20\nupdates: {t0: t}\nstart: {velocity: {x: 1}}\n"
MISUSES = {
    "no folder": (SETTINGS, FOLLOW, "none", "none/manifest.json: there is no such file; write the folder with"),
    "another folder": (SETTINGS, FOLLOW, ".", "manifest.json: there is no such file; write the folder with"),
    "horizon": (
        f"{SETTINGS}horizon: {{end: 1, least: 0.5}}\n",
        FOLLOW,
        "controller",
        "task.track.yaml:5: horizon: a controller in C has plans of one length; leave horizon out",
    ),
    "rate": (
        SETTINGS.replace("rate: 20", "rate: 30"),
        FOLLOW,
        "controller",
        "task.track.yaml:2: rate: the controller's intervals of 0.05 s are no multiple of the period of 0.0333333 s",
    ),
    "intervals": (
        SETTINGS,
        FOLLOW.replace("intervals: 20", "intervals: 10"),
        "controller",
        "controller/manifest.json: follow is of another problem: 2, 1, 20 states, inputs and intervals, and not",
    ),
    "updates": (
        SETTINGS.replace("{t0: t}", "{t0: t, side: t}"),
        FOLLOW.replace("{t0: 0}", "{t0: 0, side: 0}").replace("sin(t0 + t)", "side - sin(t0 + t)"),
        "controller",
        "controller/manifest.json: follow has no constant side, which the loop updates; write the controller of this",
    ),
}


@pytest.fixture
def call(folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Call:
    """Run the command in the folder of the puck; return exit code and all that it prints."""
    monkeypatch.chdir(folder)

    def run(settings: str, task: str, *options: str) -> tuple[object, str]:
        Path("task.ocp.yaml").write_text(task, encoding="utf-8")
        Path("task.track.yaml").write_text(settings, encoding="utf-8")
        monkeypatch.setattr(
            sys, "argv", ["mbsrun", "track", "task.ocp.yaml", "--settings", "task.track.yaml", *options]
        )
        with pytest.raises(SystemExit) as end:
            cli.main()
        return end.value.code, "".join(capsys.readouterr())

    return run


@pytest.mark.usefixtures("written")
@pytest.mark.parametrize("misuse", MISUSES)
def test_a_controller_that_does_not_fit_is_refused_with_its_place(call: Call, misuse: str) -> None:
    settings, task, place, expected = MISUSES[misuse]
    code, told = call(settings, task, "--controller", place, "-o", "refused")
    assert (code, expected in told) == (2, True), told
    assert not Path("refused").exists()


@pytest.mark.usefixtures("written")
@pytest.mark.parametrize(
    ("options", "expected"),
    [
        (["--steps", "1"], "--steps is for a controller in C; give --controller too"),
        (["--controller", "controller", "--rescue", "1"], "--rescue is for control in real time; give --steps too"),
        (["--controller", "controller", "--barrier", "1"], "--barrier is for control in real time; give --steps too"),
        (["--controller", "controller", "--steps", "1", "--barrier", "0"], "0.0 is not in the range x>0"),
        (["--controller", "controller", "--steps", "0"], "0 is not in the range 1<=x<=100"),
        (["--controller", "controller", "--solver", "ipopt"], "--controller has its own solver; leave --solver out"),
        (["--controller", "puck.yaml"], "is a file"),
    ],
)
def test_options_that_contradict_are_refused(call: Call, options: list[str], expected: str) -> None:
    code, told = call(SETTINGS, FOLLOW, *options)
    assert (code, expected in told) == (2, True), told


@pytest.mark.usefixtures("written")
def test_the_command_makes_steps_in_real_time(call: Call, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(record, "save", lambda *_: None)  # pictures take seconds
    code, told = call(SETTINGS, FOLLOW, "--controller", "controller", "--steps", "1", "-o", "stepped")
    assert code == 0, told
    assert "6 stepped" in told
    rows = list(csv.DictReader(Path("stepped/track.csv").read_text(encoding="utf-8").splitlines()))
    assert [(row["status"], row["iterations"]) for row in rows] == [("stepped", "1")] * 6
    assert max(abs(float(row["q[x]"]) - math.sin(float(row["t"]))) for row in rows) < 0.05


def test_samples_solve_where_a_plan_violates_too_much(written: Controller, problem: Problem, puck: Mechanism) -> None:
    """The interval that a shift appends violates a plan: by less than the first limit, and more than the second."""
    for limit, expected in ((1e3, {"stepped"}), (1e-12, {"solved"})):
        written.reset()
        controller = CompiledController(written, problem, TRIAL.period, Stepping(1, rescue=limit))
        found = track(TRIAL, problem.bounds, Plant(puck, TRIAL), controller)
        assert {x.decision.status for x in found.samples[1:]} == expected
        assert np.abs(found.q[:, 0] - np.sin(found.t)).max() < 0.05


def test_a_state_that_is_no_number_keeps_the_plan(written: Controller, problem: Problem) -> None:
    written.reset()
    controller = CompiledController(written, problem, 0.05, Stepping(1))
    first = controller.feedback(np.zeros(1), np.ones(1))
    controller.prepare(0.05, {})
    lost = controller.feedback(np.array([np.nan]), np.ones(1))
    assert (first.is_solved, lost.is_solved) == (True, False)
    assert lost.inputs == pytest.approx(controller.planned(0.05))
    assert np.isfinite(lost.inputs).all()


def test_steps_end_at_the_barrier_parameter_that_is_asked_for(written: Controller, problem: Problem) -> None:
    for barrier in (1e-6, 1e-3):
        written.reset()
        controller = CompiledController(written, problem, 0.05, Stepping(1, barrier=barrier))
        controller.feedback(np.zeros(1), np.ones(1))
        manifest = written.manifest
        assert written.options.mu_target == barrier * manifest.scale * abs(manifest.cost) > 0


def test_a_plan_that_has_diverged_is_solved_for_anew(written: Controller, problem: Problem) -> None:
    """Without any limit of its violation: the sample solves, and the next one makes a step again."""
    written.reset()
    controller = CompiledController(written, problem, TRIAL.period, Stepping(1))
    controller.feedback(np.zeros(1), np.ones(1))
    controller.prepare(0.05, {})
    controller.feedback(np.array([0.05]), np.ones(1))
    written.variables[:] = 1e30
    controller.prepare(0.1, {})
    rescued = controller.feedback(np.array([0.1]), np.ones(1))
    assert (rescued.status, rescued.is_solved, rescued.is_rescue) == ("solved", True, True)
    assert rescued.violation > 1e20
    controller.prepare(0.15, {})
    decision = controller.feedback(np.array([0.15]), np.ones(1))
    assert (decision.status, decision.is_rescue) == ("stepped", False)


def test_one_step_a_sample_swings_a_pole_up(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its inputs go from bound to bound. With a small barrier parameter steps diverge, and solves recover."""
    monkeypatch.setenv("CFLAGS", "-O1")
    monkeypatch.setattr(record, "save", lambda *_: None)  # pictures take seconds
    file = MODELS / "track" / "cart_pole.ocp.yaml"
    made = make(*read_problem(file, load_on_demand), MODELS / "cart_pole.yaml")
    write_folder(made.files, tmp_path / "controller")
    settings = file.with_name("cart_pole.track.yaml")
    paths = ["--settings", settings, "--controller", tmp_path / "controller", "-o", tmp_path / "track"]
    warning = "which solved instead and took longer; give a larger --barrier or more --steps"
    for options, is_warned in ((["--seed", "0"], False), (["--seed", "1"], False), (["--barrier", "1e-6"], True)):
        monkeypatch.setattr(sys, "argv", ["mbsrun", "track", *map(str, [file, *paths]), "--steps", "1", *options])
        with pytest.raises(SystemExit) as end:
            cli.main()
        told = "".join(capsys.readouterr())
        assert (end.value.code, warning in told) == (0, is_warned), told


CAM = """\
name: cam
gravity: [0, 0, -9.81]
bodies:
  - {name: valve, joint: {name: valve, type: prismatic, axis: z, actuated: false}, mass: 0.1}
  - {name: wheel, joint: {name: wheel, type: revolute, axis: y}, mass: 1, com: [0.1, 0, 0]}
constraints: [{name: cam, equation: valve - 0.1*sin(wheel)**2}]
independent: [wheel]
"""
TURN = """\
model: cam.yaml
horizon: 0.4
intervals: 8
scheme: radau
degree: 2
cost: {inputs: 0.1, running: [{expression: (q_wheel - 1)**2, weight: 20}, {expression: qd_wheel**2}]}
start: {pose: {wheel: 0.3}}
accuracy: 1
"""


def test_a_controller_of_a_closed_loop_reads_the_independent_velocities(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The wheel is the second joint, and the only one whose speed is a state: it moves as under the solver."""
    monkeypatch.chdir(tmp_path)
    Path("cam.yaml").write_text(CAM, "utf-8")
    Path("turn.ocp.yaml").write_text(TURN, "utf-8")
    loop = ("track", "turn.ocp.yaml", "--duration", "0.5", "--rate", "20")
    for command in (
        ("controller", "turn.ocp.yaml", "-o", "written"),
        (*loop, "-o", "solved"),
        (*loop, "--controller", "written", "-o", "compiled"),
        (*loop, "--controller", "written", "--steps", "2", "-o", "stepped"),
    ):
        monkeypatch.setattr(sys, "argv", ["mbsrun", *command])
        with pytest.raises(SystemExit) as end:
            cli.main()
        assert end.value.code == 0, capsys.readouterr().err
    ways = []
    for folder in ("solved", "compiled", "stepped"):
        with Path(folder, "track.csv").open(encoding="utf-8") as file:
            ways.append([[float(row[f"q[{name}]"]) for name in ("valve", "wheel")] for row in csv.DictReader(file)])
    assert ways[0][-1][1] > 0.8
    np.testing.assert_allclose(ways[1], ways[0], rtol=0, atol=1e-6)
    np.testing.assert_allclose(ways[2], ways[0], rtol=0, atol=1e-2)  # one barrier parameter, not the least one
