"""Advice is the fastest of the accurate choices; a choice that failed is never advised."""

from __future__ import annotations

import csv
import json
import sys
from pathlib import Path

import numpy as np
import pytest

from mbsgen.errors import MbsError
from mbsrun import cli, load
from mbsrun.measuring import solves
from mbsrun.measuring.advice import Advice, Option
from mbsrun.measuring.points import Cost, SolvePoint
from mbsrun.measuring.store import Store
from mbsrun.ocp.ground.schemes import Family
from mbsrun.ocp.problem.problem import Representation
from tests.picture_kinds import find_kind

ROD = """
name: rod
gravity: [0, 0, -9.81]
bodies:
  - name: rod
    joint: {name: q1, type: revolute, axis: y, limits: [-2, 2]}
    mass: 1
    com: [0, 0, -0.5]
    inertia: [0.1, 0.1, 0]
"""


STEPS = (("2", 1.0, 1e-7), ("1", 1.05, 1e-9))


def option(name: str, time: float, error: float | None, finding: str = "") -> Option:
    return Option("motion", (("method", name), ("step", "1")), Cost(time, time, 0.1, 3), "s", error, finding)


def test_the_fastest_that_is_accurate_enough_is_chosen() -> None:
    options = (
        option("fast", 1.0, 1e-3),
        option("good", 2.0, 1e-7),
        option("alike", 2.1, 1e-9),
        option("no better", 2.15, 0.9e-9),
        option("slow", 5.0, 1e-12),
        option("broken", 0.1, 1e-12, "failed in one state of 256"),
        Option("motion", (("method", "dead"), ("step", "1")), None, "s", None, "stopped"),
    )

    def choose(accuracy: float) -> str | None:
        found = Advice("m", "simulate", accuracy, "", options, ()).choose("motion")
        return None if found is None else found.choices[0][1]

    assert choose(1e-2) == "fast"
    assert choose(1e-6) == "alike"  # a twentieth slower than "good": the same, as times go
    assert choose(1e-10) == "slow"
    assert choose(1e-13) is None
    listed = Advice("m", "simulate", 1e-6, "", options, ()).shortlist("motion")
    assert {o.choices[0][1] for o in listed} == {o.choices[0][1] for o in options}
    assert listed[0].choices[0][1] == "good"
    steps = [Option("motion", (("method", "m"), ("step", x)), Cost(t, t, 0.1, 3), "s", e, "") for x, t, e in STEPS]
    stepped = Advice("m", "simulate", 1e-6, "", tuple(steps), ())
    assert stepped.shortlist("motion") == [stepped.choose("motion")] == [steps[1]]


HELD = """
name: held
gravity: [0, 0, -9.81]
bodies:
  - {name: y, joint: {type: prismatic, axis: y}}
  - {name: z, parent: y, joint: {type: prismatic, axis: z, actuated: false}, mass: 1}
loops:
  - {name: rod, type: rod, length: 1, from: {body: base}, to: {body: z}}
assembly: {y: 0.6, z: -0.8}
independent: [y]
"""


@pytest.fixture
def rod(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "rod.yaml"
    path.write_text(ROD, encoding="utf-8")
    return path


def run(monkeypatch: pytest.MonkeyPatch, *arguments: str) -> object:
    monkeypatch.setattr(sys, "argv", ["mbsrun", *arguments])
    with pytest.raises(SystemExit) as end:
        cli.main()
    return end.value.code


def test_solves_are_refined_until_they_are_accurate(rod: Path, tmp_path: Path) -> None:
    """A defect that is too large asks for a finer grid; all representations have one optimum, on the same grid."""
    case = solves.state_reach(load(rod))
    assert case.problem.end.coordinates == ((0, 0.5),)
    both = (Representation.IMPL, Representation.EXP2_O)
    scope = solves.SolveScope((Family.RADAU,), (3,), (2, 5, 10, 20), both, 1)
    store = Store(tmp_path / "problem.jsonl", SolvePoint)
    points = solves.measure_solves(case, 1e-6, scope, store, lambda *_: None)
    defects = [p.defect or 0.0 for p in points if p.representation == "IMPL"]
    assert (np.diff(defects) < 0).all()
    assert defects[-1] <= 1e-6 < defects[-2]
    last = [p for p in points if p.intervals == points[-1].intervals]
    assert {p.representation for p in last} == {r.value for r in both}
    assert last[0].cost == pytest.approx(last[1].cost, rel=1e-6)


def test_a_reach_with_loops_goes_as_far_as_they_allow(tmp_path: Path) -> None:
    """A rod of 1 m holds a slide at y = 0.6: from there it can go to 1. SEMI has no reduced form, for other points."""
    path = tmp_path / "held.yaml"
    path.write_text(HELD, encoding="utf-8")
    case = solves.state_reach(load(path))
    assert case.problem.start_q == pytest.approx((0.6, -0.8), abs=1e-6)
    ((i, goal),) = case.problem.end.coordinates
    assert i == 0
    assert goal == pytest.approx(0.6 + solves.REACH / 5)
    scope = solves.SolveScope((Family.LEGENDRE,), (3,), (4,), (Representation.IMPL, Representation.SEMI), 1)
    points = solves.measure_solves(case, 1e-2, scope, Store(tmp_path / "p.jsonl", SolvePoint), lambda *_: None)
    assert [p.representation for p in points if p.seconds] == ["IMPL"]
    assert "where loops would be open" in points[-1].finding


def test_nothing_actuated_leaves_nothing_to_optimise(tmp_path: Path) -> None:
    path = tmp_path / "loose.yaml"
    path.write_text(ROD.replace("limits: [-2, 2]", "actuated: false"), encoding="utf-8")
    with pytest.raises(MbsError, match="no joint of one coordinate is actuated"):
        solves.state_reach(load(path))


def test_the_command_tells_choice_measurements_and_what_it_left_out(
    rod: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(monkeypatch, "advise", str(rod), "--accuracy", "1e-5", "--quick") == 0
    told = capsys.readouterr().out
    assert "motion: formulation" in told
    assert "taken" in told
    assert "not measured:" in told
    assert run(monkeypatch, "advise", str(rod), "--accuracy", "1e-15", "--quick") == 1
    assert "no measured option is so accurate" in capsys.readouterr().out
    assert run(monkeypatch, "advise", str(rod), "--problem", "p.yaml") == 2
    assert "--task optimise" in capsys.readouterr().err


def test_charts_are_written_with_their_numbers(rod: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert run(monkeypatch, "chart", "simulation", str(rod), "--quick", "-o", "chart", "--format", "pdf") in (0, None)
    names = {path.name for path in Path("chart").iterdir()}
    assert names == {f"simulation.{kind}" for kind in ("pdf", "csv", "json", "jsonl", "section.json")}
    assert find_kind(Path("chart/simulation.pdf")) == "pdf"


def test_the_chart_of_fronts_fills_all_layers_of_any_model(rod: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Kernels, a motion, a solve and reductions are measured; a command repeats a dot of the motion."""

    def kernel(name: str, time: float, error: float, finding: str = "") -> Option:
        choices = (("kernel", name), ("precision", "float64"), ("flags", ""))
        return Option("torques for a motion", choices, Cost(time, time, 0.1, 3), "ns", error, finding)

    options = (
        *(kernel(f"impl, central differences, {step}", time, error) for step, time, error in STEPS),
        kernel("impl", 3.0, 1e-12),
        kernel("impl", 4.0, 1e-3),  # slower and less accurate
        kernel("exp1", 0.5, 1e-12, "failed in one state of 256"),
    )
    control = Advice("rod", "control", 1e-6, "", options, ())
    monkeypatch.setattr("mbsrun.measuring.surveys.survey_control", lambda *_: control)
    assert run(monkeypatch, "chart", "fronts", str(rod), "--quick", "-o", "chart") in (0, None)
    with Path("chart/fronts.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    shown = [(row["method"], row["front"], row["advised"]) for row in rows if row["task"] == "control"]
    assert shown == [
        ("central differences of IMPL", "yes", ""),
        ("central differences of IMPL", "yes", "yes"),
        ("IMPL", "yes", ""),
        ("IMPL", "", ""),
        ("EXP1", "", ""),
    ]
    assert {row["task"] for row in rows} == {"control", "simulate", "optimise", "reduce"}
    assert all(row["command"] for row in rows)
    page = Path("chart/fronts.html").read_text(encoding="utf-8")
    assert page.count("<section>") == len({(row["task"], row["need"]) for row in rows})
    told = next(row for row in rows if row["task"] == "simulate")
    assert "chart/motion.yaml" in told["command"]
    assert run(monkeypatch, *told["command"].split()[1:], "-o", "again") in (0, None)
    settings = json.loads(Path("again/simulation.json").read_text(encoding="utf-8"))["settings"]
    assert settings["method"] == told["method"].split()[0]
