"""Figures and files of a track that is written down here: four samples of a mass on a rail.

x = t^2, v = 2 t, at t = 0, 0.05, ..., 0.4; each sample lasts 0.1 s.
"""

from __future__ import annotations

import csv
import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mbsgen.expressions import parse
from mbsrun.ocp.problem.problem import Bounds, Constraint, Control, State, Unknown
from mbsrun.simulation.motion import Halt, Settings
from mbsrun.tracking import Decision, Noise, Track, Trial, record
from mbsrun.tracking.analysis import Margin, find_margins, follow_references, measure_track, read_quantities
from mbsrun.tracking.loop import Sample
from mbsrun.tracking.record import Report, report_track, write_track
from mbsrun.tracking.trial import Measure
from tests.mbsrun.ocp.plants import FREE_RANGE, push
from tests.mbsrun.peer import double_integrator

INF = math.inf
T = np.arange(9) / 20
NOISE = Noise(np.zeros(1), np.zeros(1), np.zeros(2), seed=6)
PLANT: Any = double_integrator()
PROBLEM = replace(
    push(4), states=(State("s", "c", (0.0, 1.0)),), controls=(Control("c", (-2.0, 2.0)),),
    bounds=Bounds(((-1.0, 0.15),), (FREE_RANGE,), ((-1.0, 9.0),)), horizon=3.0,
)  # fmt: skip
TRIAL = Trial(
    "rail", 0.4, 0.1, np.zeros(1), np.zeros(1), NOISE, Settings(1.0), constants={"k": 2.0, "a": 1.0},
    updates={"a": parse("10*t")}, states=("s",), controls=("c",), delay=1,
)  # fmt: skip


def make(**changes: Any) -> Track:
    """Make a track in which sample k takes 2^k hundredths of a second, and the last one finds no plan."""
    samples = []
    for k in range(4):
        words = ("Lost", "Good", "Good", "Good")[k]
        violation = (1e-3, math.nan, 2e-3, 1e-4)[k]
        decision = Decision(np.zeros(2), words, k > 0, 3 * k, 0.02 * 2**k, violation, k == 2)
        at = np.array([0.1 * k]) ** 2
        u = np.array([k, -k], dtype=float)
        samples.append(
            Sample(0.1 * k, at, at + 1, at + 2, at + 3, at + 4, decision, 0.001 * k, u, u + 0.5, is_moved=k > 1)
        )
    k = np.maximum(np.ceil(T / 0.1 - 1e-9).astype(int) - 1, 0)
    u = np.column_stack((k, -k)).astype(float)
    usual = Track(
        TRIAL,
        samples[0].decision,
        tuple(samples),
        T,
        T[:, None] ** 2,
        2 * T[:, None],
        0.5 + T[:, None],
        u,
        1e-9,
        0,
        None,
    )
    return replace(usual, **changes)


def test_a_measure_is_taken_in_its_span_with_both_ends() -> None:
    """Of the time, constants that are updated, the state, inputs, controls and sensors."""
    spans = ((0.0, INF, 9), (0.1, 0.2, 3), (0.11, 0.19, 1), (0.4, 0.5, 1))
    measures = tuple(Measure(f"m{i}", parse("q_slide"), start, end) for i, (start, end, _) in enumerate(spans))
    found = measure_track(make(trial=replace(TRIAL, measures=measures)), PLANT)
    assert [len(x.t) for x in found] == [count for *_, count in spans]
    assert found[1].values == pytest.approx(T[2:5] ** 2)
    values = {
        "t": T, "k": np.full(9, 2.0), "a": 10 * T, "qd_slide": 2 * T, "s": 0.5 + T, "u_slide": make().u[:, 0],
        "c": make().u[:, 1], "x_place": T**2,
    }  # fmt: skip
    measures = tuple(Measure(name, parse(name), most=1.0) for name in values)
    for x in measure_track(make(trial=replace(TRIAL, measures=measures)), PLANT):
        assert (x.values, x.most) == (pytest.approx(values[x.name]), 1.0), x.name


def margins(**changes: Any) -> dict[str, Margin]:
    trial = replace(TRIAL, leeway=changes.pop("leeway", {}))
    found, left = find_margins(make(trial=trial), replace(PROBLEM, **changes), PLANT)
    assert not left
    return {x.name: x for x in found}


def test_margins_are_distances_from_the_nearer_end() -> None:
    """Of what is bounded alone: coordinates, velocities, inputs, controls and states, each by its own column."""
    found = margins()
    assert list(found) == ["coordinate slide", "input slide", "control c", "state s"]
    assert found["coordinate slide"].values == pytest.approx(np.minimum(T**2 + 1, 0.15 - T**2))
    assert found["input slide"].values == pytest.approx(make().u[:, 0] + 1)
    assert found["control c"].values == pytest.approx(2 + make().u[:, 1])
    assert found["state s"].values == pytest.approx(np.minimum(0.5 + T, 0.5 - T))
    assert all(x.is_bound for x in found.values())
    assert (found["coordinate slide"].is_kept, found["coordinate slide"].time) == (False, 0.4)
    assert found["coordinate slide"].worst == (pytest.approx(0.16), 0.15)
    assert found["control c"].least == pytest.approx(-1.0)
    one_sided = margins(bounds=Bounds(((-INF, 0.15),), ((0.0, INF),), (FREE_RANGE,)))
    assert list(one_sided) == ["coordinate slide", "velocity slide", "control c", "state s"]


def test_constraints_along_the_path_have_margins_with_the_time_of_a_plan_at_0() -> None:
    constraints = (
        Constraint("q_slide + 7*t + T", (0.0, 4.0)),
        Constraint("q_slide", (0.0, 4.0), "end"),
        Constraint("q_slide*p", (0.0, 4.0)),
        Constraint("qd_slide", (-INF, INF)),
        Constraint("a", (0.0, 9.0), name="updated"),
    )
    found = margins(constraints=constraints, unknowns=(Unknown("p"),))
    own = {name: x for name, x in found.items() if not x.is_bound}
    assert list(own) == ["q_slide + 7*t + T", "updated"]
    assert own["q_slide + 7*t + T"].values == pytest.approx(np.minimum(T**2 + 3, 1 - T**2))
    assert own["updated"].values == pytest.approx(np.minimum(10 * T, 9 - 10 * T))
    _, left = find_margins(make(), replace(PROBLEM, constraints=(Constraint("qdd_slide", (0.0, 1.0)),)), PLANT)
    assert left == ["qdd_slide"]


def test_a_leeway_allows_more_where_it_is_larger() -> None:
    """0.16 where 0.15 is the limit: 0.01 beyond."""
    for leeway, is_kept in ((0.011, True), (0.009, False), (0.0, False)):
        assert margins(leeway={"q_slide": leeway})["coordinate slide"].is_kept is is_kept
    small = margins(leeway={"q_slide": 0.0})["coordinate slide"]
    assert 0 < small.tolerated < 0.01
    assert small.tolerated == margins()["coordinate slide"].tolerated


def test_slacks_of_the_problem_have_no_margins() -> None:
    slack = Control("c", (-2.0, 2.0), softens="x")
    assert "control c" not in margins(controls=(slack,))


def test_references_and_quantities_follow_the_motion() -> None:
    trial = replace(TRIAL, references={"q_slide": parse("a + k"), "x_place": parse("3")})
    found = follow_references(make(trial=trial))
    assert found["q_slide"] == pytest.approx(10 * T + 2)
    assert found["x_place"] == pytest.approx(np.full(9, 3.0))
    v, x = read_quantities(["qd_slide", "x_place"], make(), PLANT)
    assert (v, x) == (pytest.approx(2 * T), pytest.approx(T**2))


def report(**changes: Any) -> Report:
    track: dict[str, Any] = {"trial": replace(TRIAL, measures=(Measure("x", parse("q_slide"), most=0.2),)), **changes}
    return report_track(make(**track), replace(PROBLEM, bounds=Bounds(((-1.0, 1.0),), FREE, FREE)), PLANT)


FREE = (FREE_RANGE,)


def test_a_report_counts_its_samples() -> None:
    """Late ones take longer than a period; a violation that is unknown is no violation."""
    found = report()
    assert found.statuses == (("Good", 3), ("Lost", 1))
    assert (found.late, found.moved, found.rescues, found.violation) == (1, 2, 1, 2e-3)
    assert (found.times.median, found.times.largest) == (pytest.approx(0.06), 0.16)
    assert (found.preparing.median, found.preparing.largest) == (pytest.approx(0.0015), 0.003)


def test_a_report_is_met_where_its_end_its_measures_and_its_ranges_are() -> None:
    control = replace(PROBLEM.controls[0], bounds=(-3.0, 3.0))
    met = replace(report(), margins=tuple(margins(controls=(control,), bounds=Bounds(FREE, FREE, FREE)).values()))
    assert met.is_met
    halted = replace(met, track=make(halt=Halt(0.4, None, "it stops", "")))
    missed = replace(met, measured=(replace(met.measured[0], most=0.1),))
    left = replace(met, margins=tuple(margins().values()))
    assert [x.is_met for x in (halted, missed, left)] == [False, False, False]


def write(found: Report, folder: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """Write the folder without its pictures; return what the page that plays the motion gets."""
    played: dict[str, Any] = {}
    for name in ("save", "draw_track", "draw_times"):
        monkeypatch.setattr(record, name, lambda *_: None)
    monkeypatch.setattr(record, "write_animation", lambda *given, **named: played.update(named, t=given[2], q=given[3]))
    write_track(found, PLANT, folder)
    return played


def test_the_summary_has_the_figures_of_the_report(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write(report(), tmp_path / "a" / "b", monkeypatch)
    text = (tmp_path / "a" / "b" / "summary.json").read_text("utf-8")
    found = json.loads(text)
    assert text.startswith('{\n "format": "mbsrun track 1",\n "complete": true,')
    assert found["end"] == {
        "t": pytest.approx(0.4), "q": [pytest.approx(0.16)], "qd": [pytest.approx(0.8)], "states": [pytest.approx(0.9)]
    }  # fmt: skip
    assert found["iterations"] == {"mean": 4.5, "largest": 9}
    assert (found["samples"], found["failures"], found["delay"], found["seed"]) == (4, 1, 1, 6)
    assert (found["statuses"], found["rescues"], found["late"]) == ({"Good": 3, "Lost": 1}, 1, 1)
    assert found["moved_into_bounds"] == 2
    assert found["measures"]["x"] == {
        "largest": pytest.approx(0.16), "rms": pytest.approx(np.sqrt(np.mean(T**4))), "most": 0.2, "met": True
    }  # fmt: skip
    assert found["margins"]["coordinate slide"]["time"] == pytest.approx(0.4)
    assert (found["halt"], found["energy_drift"], found["first_seconds"]) == (None, 1e-9, 0.02)
    assert found["parameters"] == {}
    assert found["problem"] == "rail"
    write(report(trial=replace(TRIAL, name="glissière")), tmp_path, monkeypatch)
    assert '"problem": "glissière"' in (tmp_path / "summary.json").read_text("utf-8")


def test_the_table_has_a_row_for_each_sample(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write(report(), tmp_path, monkeypatch)
    with (tmp_path / "track.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == [
        "t", "q[slide]", "qd[slide]", "measured_q[slide]", "measured_qd[slide]", "state[s]", "u[slide]", "control[c]",
        "acting[slide]", "acting_control[c]", "status", "solved", "iterations", "seconds", "preparing", "violation",
    ]  # fmt: skip
    numbers = [float(x) for name, x in rows[2].items() if name != "status"]
    x = 0.1 * 2
    expected = [x, x**2, *(x**2 + i for i in range(1, 5)), 2, -2, 2.5, -1.5, 1, 6, 0.08, 0.002, 2e-3]
    assert numbers == pytest.approx(expected)
    assert [row["solved"] for row in rows] == ["0", "1", "1", "1"]


def test_the_page_plays_the_motion_without_jumps_under_the_inputs_that_act(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A time that comes twice, after a kick, is left out; a sample's inputs act from its time on."""
    twice = np.insert(T, 4, T[4])
    found = replace(report(), track=make(t=twice, q=twice[:, None] ** 2, qd=2 * twice[:, None]))
    played = write(found, tmp_path, monkeypatch)
    assert played["t"] == pytest.approx(T)
    assert played["q"] == pytest.approx(T[:, None] ** 2)
    assert played["qd"] == pytest.approx(2 * T[:, None])
    at = np.searchsorted([0.1 * k for k in range(4)], T, side="right") - 1
    assert played["inputs"] == pytest.approx(at[:, None] + 0.5)
    assert played["title"] == "rail"
    halted = replace(report(), track=make(halt=Halt(0.4, None, "it stops", "start anew")))
    assert write(halted, tmp_path, monkeypatch)["title"].startswith("rail, incomplete: ")
