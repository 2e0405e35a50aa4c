"""`mbsrun track`: its files, its exit codes, and the faults of a trial file."""

from __future__ import annotations

import csv
import json
import os
import re
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from mbsgen.errors import InputError
from mbsrun import Mechanism, cli
from mbsrun.external import load_on_demand
from mbsrun.ocp.statement.checks import ProblemError
from mbsrun.ocp.statement.statement import read_problem, state_problem
from mbsrun.recordings.references import Reference
from mbsrun.tracking import record
from mbsrun.tracking.record import FILES
from mbsrun.tracking.solving import SolvingController
from mbsrun.tracking.statement import TrialStatement
from tests.mbsrun.tracking.tasks import FOLLOW
from tests.picture_kinds import find_kind

SETTINGS = """
duration: 0.3
rate: 20
delay: 1
updates: {t0: t}
start: {velocity: {x: 1}}
plant: {scale: {m: 1.2}}
noise: {coordinates: 1e-4, velocities: {x: 1e-3}}
references: {q_x: sin(t)}
measures:
  - {name: error, expression: abs(x_middle - sin(t)), most: LIMIT}
"""
BOUNDED = FOLLOW + "bounds: {inputs: [-9, 9]}\nconstraints: [{expression: q_x - t0, range: [-1, 1]}]\n"
DRIVEN = """
name: driven
gravity: [0, 0, 0]
bodies:
  - {name: x, joint: {type: prismatic, axis: x, actuated: false}, mass: 1}
  - {name: y, parent: x, joint: {type: prismatic, axis: y}, mass: 1}
driven: [x]
"""
Run = Callable[..., tuple[object, str, str]]


@pytest.fixture
def run(folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    """Run the command in the folder of the puck; return exit code, stdout and stderr."""
    monkeypatch.chdir(folder)

    def call(*options: str, settings: str, task: str = BOUNDED) -> tuple[object, str, str]:
        (folder / "task.ocp.yaml").write_text(task, encoding="utf-8")
        (folder / "task.track.yaml").write_text(settings, encoding="utf-8")
        monkeypatch.setattr(
            sys, "argv", ["mbsrun", "track", "task.ocp.yaml", "--settings", "task.track.yaml", *options]
        )
        with pytest.raises(SystemExit) as end:
            cli.main()
        return (end.value.code, *capsys.readouterr())

    return call


def read_table(folder: str) -> list[dict[str, str]]:
    """Read the samples, without computing times."""
    with Path(folder, "track.csv").open(encoding="utf-8") as file:
        return [
            {key: x for key, x in row.items() if key not in ("seconds", "preparing")} for row in csv.DictReader(file)
        ]


def test_a_trial_is_run_and_written(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    """Exit code 0 where measures stay below their limits, 1 where one does not; the same trial gives the same table."""
    code, stdout, stderr = run("-o", "met", "--format", "svg", settings=SETTINGS.replace("LIMIT", "0.01"))
    assert code == 0, stderr
    assert sorted(os.listdir("met")) == sorted(name.replace(".png", ".svg") for name in FILES)
    assert [find_kind(Path("met", name)) for name in ("plots.svg", "times.svg")] == ["svg", "svg"]
    for words in ("task", "6 Solve_Succeeded", "error ", "(99.9th percentile)", "input x", "q_x - t0"):
        assert words in stdout
    rows = read_table("met")
    assert len(rows) == 6
    assert rows[0]["measured_q[x]"] != rows[0]["q[x]"]
    assert {row["solved"] for row in rows} == {"1"}
    summary = json.loads(Path("met/summary.json").read_text(encoding="utf-8"))
    assert summary["complete"]
    assert summary["measures"]["error"]["largest"] < 0.01
    assert 0.6 < summary["margins"]["q_x - t0"]["least"] <= 1
    monkeypatch.setattr(record, "save", lambda *_: None)  # pictures take seconds
    code, stdout, _ = run("-o", "missed", settings=SETTINGS.replace("LIMIT", "1e-9"))
    assert code == 1
    assert "limit 1e-09, exceeded" in stdout
    assert read_table("missed") == rows


def test_a_motion_that_leaves_its_ranges_has_an_exit_code(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    """It starts at 1 m/s where plans keep 0.9; within its ranges, and a leeway, nothing is said."""
    monkeypatch.setattr(record, "save", lambda *_: None)  # pictures take seconds
    task = BOUNDED.replace("bounds: {", "bounds: {velocities: [-0.9, 0.9], ")
    settings = SETTINGS.replace("LIMIT", "10")
    told = r"the motion leaves its ranges: velocity x is 1(\.0000\d)? at 0\.\d+ s, 0\.1 above its limit 0\.9; take a"
    code, _, stderr = run("-o", "fast", settings=settings, task=task)
    assert (code, bool(re.search(told, stderr))) == (1, True), stderr
    summary = json.loads(Path("fast/summary.json").read_text(encoding="utf-8"))
    assert (summary["met"], summary["margins"]["velocity x"]["kept"]) == (False, False)
    for more, expected in (("leeway: {qd_x: 0.11}\n", 0), ("leeway: {qd_x: 0.09}\n", 1)):
        code, _, stderr = run("-o", "allowed", settings=settings + more, task=task)
        assert (code, "leaves its ranges" in stderr) == (expected, bool(expected)), stderr
    code, _, stderr = run("-o", "slow", settings=settings)
    assert (code, "leaves its ranges" in stderr) == (0, False)
    code, _, stderr = run("-o", "none", settings=f"{settings}leeway: {{qd_y: 0.1}}\n", task=task)
    assert (code, "leeway.qd_y: the problem has no bound or constraint of" in stderr) == (2, True), stderr


def test_no_plan_from_the_start_writes_nothing(run: Run) -> None:
    far = BOUNDED + "end: {pose: {x: 1000}}\n"
    code, _, stderr = run("-o", "none", settings=SETTINGS.replace("LIMIT", "1"), task=far)
    assert code == 1
    assert "finds no plan from the start (Infeasible_Problem_Detected)" in stderr
    assert not Path("none").exists()


FAULTS = """
duration: 1
rate: 20
constants: {t0: 1}
horizon: {end: 1, least: 0.01}
plant: {scale: {mm: 1.2}, parameters: {k: 3}, step: 1e-3}
noise: {velocities: {z: 1}, inputs: -1}
updates: {t1: t, t0: q_x}
start: {pose: {y: 1}}
kicks: [{time: 3, velocity: {y: 1}}]
wrenches: [{wrench: push, from: 1, until: 0.5, force: [1, q_x, 3], moment: [0, 0, 1]}]
measures: [{name: a, expression: y_middel, from: 2}]
references: {q_y: 1}
"""


def test_all_faults_of_a_trial_are_reported_with_their_places(folder: Path, pushed: Mechanism) -> None:
    (folder / "task.ocp.yaml").write_text(FOLLOW, encoding="utf-8")
    (folder / "faults.track.yaml").write_text(FAULTS, encoding="utf-8")
    problem, _ = read_problem(folder / "task.ocp.yaml", load_on_demand)
    statement = TrialStatement(folder / "faults.track.yaml", {"noise": {"seed": 3}})
    with pytest.raises(InputError) as error:
        statement.trial(problem, pushed.manifest, {"m": 2.0})
    found = [(fault.line, fault.path) for fault in error.value.faults]
    (short,) = (fault for fault in error.value.faults if fault.path == "horizon.least")
    assert (short.finding, short.remedy) == ("found 0.01", "give at least 0.05")
    assert found == sorted(
        [
            (4, "constants.t0"),
            (5, "horizon.least"),
            (6, "plant.parameters.k"),
            (6, "plant.scale.mm"),
            (6, "plant.step"),
            (7, "noise.inputs"),
            (7, "noise.velocities.z"),
            (8, "updates.t0"),
            (8, "updates.t1"),
            (9, "start.pose.y"),
            (10, "kicks[0].time"),
            (10, "kicks[0].velocity.y"),
            (11, "wrenches[0].force[1]"),
            (11, "wrenches[0].moment"),
            (11, "wrenches[0].until"),
            (12, "measures[0].expression"),
            (12, "measures[0].from"),
            (13, "references.q_y"),
        ]
    )


def test_a_recording_does_not_move_with_the_plans(folder: Path, pushed: Mechanism) -> None:
    """A plan would follow the start of the recording, whenever it begins."""
    (folder / "task.ocp.yaml").write_text(FOLLOW, encoding="utf-8")
    problem, _ = read_problem(folder / "task.ocp.yaml", load_on_demand)
    problem = replace(problem, references=(Reference("walk", (), 0.0, 1.0),))
    with pytest.raises(InputError, match="reads the recording walk, each plan from its start; follow an expression"):
        TrialStatement(None, {"duration": "1", "rate": "20"}).trial(problem, pushed.manifest, {"m": 2.0})


@pytest.mark.parametrize(
    ("duration", "rate", "is_long"), [("1", "1000000", False), ("2", "600000", True), ("1e9", "1e-3", False)]
)
def test_a_trial_has_a_million_samples_at_most(
    folder: Path, pushed: Mechanism, duration: str, rate: str, is_long: bool
) -> None:
    """They are the product of duration and rate."""
    (folder / "task.ocp.yaml").write_text(FOLLOW, encoding="utf-8")
    problem, _ = read_problem(folder / "task.ocp.yaml", load_on_demand)
    statement = TrialStatement(None, {"duration": duration, "rate": rate, "start": {"pose": {"y": "1"}}})
    with pytest.raises(InputError) as error:
        statement.trial(problem, pushed.manifest, {"m": 2.0})
    found = [fault.finding for fault in error.value.faults if fault.path == "duration"]
    assert found == (["1.2e+06 samples would be taken"] if is_long else [])


def test_driven_joints_are_refused(tmp_path: Path) -> None:
    """Each plan would drive them from the start of the problem's motion, while the plant holds them."""
    file = tmp_path / "driven.yaml"
    file.write_text(DRIVEN, encoding="utf-8")
    model = load_on_demand(file)
    task = {
        "horizon": 1, "intervals": 4, "scheme": "radau", "degree": 2, "driven": {"x": "t**2"}, "cost": {"inputs": 1},
        "start": {"pose": {}},
    }  # fmt: skip
    problem = state_problem(task, "task", model, tmp_path)
    with pytest.raises(ProblemError, match="driven: each plan would move driven joints from the start"):
        SolvingController(problem, model, 0.05)
    with pytest.raises(InputError, match=r"plant\.model: it drives x, which nothing moves here; give these joints act"):
        TrialStatement(None, {"duration": "1", "rate": "20"}).trial(problem, model.manifest, {})


def test_a_missing_rate_of_the_command_line_is_named() -> None:
    with pytest.raises(InputError, match="command line: rate: missing"):
        TrialStatement(None, {"duration": "1"})
