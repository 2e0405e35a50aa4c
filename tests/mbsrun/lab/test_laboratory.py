"""The laboratory: a slice of every case meets its criterion, and what does not is never hidden."""

from __future__ import annotations

import csv
import json
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from mbsrun import cli
from mbsrun.lab import chains, commands, derivatives, digits, locks, maps
from mbsrun.lab.case import Bench, Case, Finding, Loss, Trial, check, demand, judge
from mbsrun.lab.cases import CASES
from mbsrun.lab.digits import specimen
from mbsrun.lab.mechanisms import describe_spatial, draw
from mbsrun.lab.record import open_bench, run_cases, write_findings
from mbsrun.study.sheets import read_folders

Measure = Callable[[Bench], list[Finding]]

SLICE: dict[str, str | Measure] = {  # of each case a short trial, or a smaller one
    "F01": partial(chains.measure_straight, size=2),
    "F03": partial(chains.measure_heavy_tip, size=3, ratio=1e8),
    "F04": partial(chains.measure_harmless, factors=[1.0, 1e12, 1.0]),
    "F05": partial(locks.measure_lock, lock="elbow", distances=(1e-3, 1e-9, 0.0)),
    "F06": "a leaf without mass",
    "F07": "where the file allows it",
    "F08": "a mass below 1e-150",
    "F10": "1e-06 rad away",
    "F11": "3 links",
    "F13": "1e22 rad",
    "F14": "refusals",
    "F15": partial(chains.measure_single, kind="spatial", size=3),
    "F17": "midpoint rule",
    "F18": "explicit",
    "F20": "weights",
    "F25": partial(derivatives.measure_derivatives, size=2),
}
ELSEWHERE = ("F02", "F09", "F12", "F16", "F19", "F21", "F22", "F23")  # in tests/mbsgen/failures, simulation and ocp


def quiet(*_: object) -> None:
    """Tell nobody."""


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Bench:
    return open_bench(tmp_path_factory.mktemp("laboratory"))


def test_every_case_is_run_or_says_why_not() -> None:
    assert [case.id for case in CASES] == [f"F{k:02}" for k in range(1, 26)]
    assert all(case.trials or case.exemption for case in CASES)
    for case in CASES:
        assert len({trial.name for trial in case.trials}) == len(case.trials)
    assert {*SLICE, *ELSEWHERE} == {case.id for case in CASES if case.trials}


@pytest.mark.parametrize(("name", "trial"), SLICE.items(), ids=SLICE)
def test_criteria_are_met(name: str, trial: str | Measure, bench: Bench) -> None:
    if isinstance(trial, str):
        (trial,) = (x.measure for case in CASES if case.id == name for x in case.trials if x.name == trial)
    findings = trial(bench)
    assert findings
    assert [x for x in findings if not x.is_met] == []


def test_exact_accelerations_are_those_of_elimination(bench: Bench) -> None:
    """Refinement and elimination in 50 digits agree to far more than a double; so do the mass matrices of both."""
    chosen, states = specimen(bench, describe_spatial(3), "exp2"), draw(3, [3])
    (exact,) = chosen.find_exact(states)
    assert max(float(abs(a / b - 1)) for a, b in zip(exact.qdd, exact.moment.qdd, strict=True)) < 1e-22
    M = chosen._compute_mass({name: x[0] for name, x in states.items()})
    np.testing.assert_allclose(M, exact.M, rtol=0, atol=1e-14 * exact.M.max())


LOSS = Loss("Cardan", 3, 1e-9, 0, "EXP1", 1e18, 1e18, 1e-3, 0.99, 1e-16)


def test_a_wrong_number_in_silence_is_not_met() -> None:
    """And neither is a status that names another joint, nor one for what only scales the mass matrix."""
    assert not locks._check_loss(LOSS).is_met
    assert locks._check_loss(replace(LOSS, error=None, failed="q1")).is_met
    assert not locks._check_loss(replace(LOSS, error=None, failed="q2")).is_met
    assert not locks._check_loss(replace(LOSS, error=float("nan"))).is_met
    assert not chains._check_error(replace(LOSS, error=None, failed="q1"), 1e-11).is_met
    assert not digits.check_told(replace(LOSS, told=1e-15)).is_met


def test_verdicts_are_of_the_worst() -> None:
    """What misses its bound comes before what is closest to it; what is not a number misses."""
    found = [check("EXP1", "error", x, 1.0) for x in (0.9, 0.1)] + [check("EXP1", "other", 1e-9, 1e-10)]
    found += [demand("EXP2", "status", is_met=True, remark="")]
    first, second = judge([replace(x, case="F01") for x in found])
    assert (first.quantity, first.met, first.total, first.is_met) == ("other", 2, 3, False)
    assert second.is_met
    assert not check("EXP1", "error", float("nan"), 1.0).is_met


def break_down(_: Bench) -> list[Finding]:
    raise ZeroDivisionError("of its own")


def count(calls: list[str], name: str) -> Callable[[Bench], list[Finding]]:
    def measure(_: Bench) -> list[Finding]:
        calls.append(name)
        return [check("EXP1", "error", 0.5, 1.0, name)]

    return measure


def test_a_trial_that_breaks_hides_no_other_and_is_tried_again(tmp_path: Path) -> None:
    """What was found is kept, also when the run is cut off in the middle of a line."""
    calls: list[str] = []
    trials = (Trial("a", count(calls, "a")), Trial("broken", break_down), Trial("b", count(calls, "b")))
    cases = [Case("F01", "case", "", "", trials), Case("F02", "other", "", "", exemption="there is nothing")]
    for expected in (["a", "b"], ["a", "b"]):
        findings = run_cases(cases, tmp_path, quiet)
        assert [(x.trial, x.is_met) for x in findings] == [("a", True), ("broken", False), ("b", True)]
        assert "ZeroDivisionError: of its own" in findings[1].remark
        assert calls == expected
    kept = tmp_path / "findings.jsonl"
    kept.write_text(kept.read_text(encoding="utf-8")[:-20], encoding="utf-8")
    run_cases(cases, tmp_path, quiet)
    assert calls == ["a", "b", "b"]
    write_findings(cases, findings, tmp_path)
    with (tmp_path / "verdicts.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["verdict"] for row in rows] == ["met", "not met", "does not apply"]
    assert "| EXP1 | error | 0.5 | 1 | a | 2 of 2 | met |" in (tmp_path / "verdicts.md").read_text(encoding="utf-8")
    told = json.loads((tmp_path / "verdicts.json").read_text(encoding="utf-8"))
    assert set(told) == {"title", "columns", "rows", "note"}


def test_maps_show_errors_and_statuses(tmp_path: Path) -> None:
    """With their tables, as reports take them in; what is not known is drawn as well."""
    losses = [
        replace(LOSS, number=d, way=way, error=error, told=told, failed="" if error else "q1")
        for way in ("EXP1", "EXP2")
        for d, error, told in ((1e-3, 1e-12, 1e-12), (1e-8, None, None), (0.0, None, 2.0))
    ]
    losses += [replace(x, mechanism="heavy tip", number=10 ** (1 + k % 3)) for k, x in enumerate(losses)]
    paths = maps.draw_maps(losses, tmp_path)
    assert sum(path.suffix == ".png" for path in paths) == 3
    assert all(path.stat().st_size > 4_000 for path in paths if path.suffix == ".png")
    (section,) = read_folders([tmp_path])
    assert section.name == "laboratory"
    assert len(section.items) == 6


def run(monkeypatch: pytest.MonkeyPatch, *arguments: str) -> object:
    monkeypatch.setattr(sys, "argv", ["mbsrun", "lab", *arguments])
    with pytest.raises(SystemExit) as end:
        cli.main()
    return end.value.code


def test_the_command_tells_by_its_exit_code(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run(monkeypatch, "--list") in (0, None)
    assert "F24" in capsys.readouterr().out
    assert run(monkeypatch, "F99") == 2
    assert "there is no case F99" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
    assert run(monkeypatch, "f07", "F24", "--quick", "-o", "out") in (0, None)
    assert "does not apply" in capsys.readouterr().out
    assert {path.name for path in (tmp_path / "out").iterdir()} >= {"verdicts.json", "findings.csv", "findings.jsonl"}
    broken = Case("F07", "broken", "", "", (Trial("broken", break_down),))
    monkeypatch.setattr(commands, "CASES", (broken,))
    assert run(monkeypatch, "F07", "-o", "other") == 1
    assert "not met: F07, broken" in capsys.readouterr().out
