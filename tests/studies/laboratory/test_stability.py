"""The map of a model: digits near its worst pose, at ratios of masses, and at steps of a motion."""

from __future__ import annotations

import csv
import sys
from pathlib import Path

import numpy as np
import pytest

from mbsrun import cli
from studies.laboratory.mechanisms import LOCKS, describe_lock
from studies.laboratory.stability import (
    POSES,
    STEPS,
    Spot,
    describe_stability,
    measure_stability,
)


def test_the_worst_pose_of_a_cardan_joint_is_its_lock(tmp_path: Path) -> None:
    """At q2 = pi/2 nothing turns q1 alone: EXP1 says so from 1e-6 rad on, and EXP2 and residuals keep their digits."""
    model = tmp_path / "cardan.yaml"
    model.write_text(describe_lock(LOCKS["Cardan"]), encoding="utf-8")
    spots = measure_stability(model, tmp_path / "out", lambda *_: None, quick=True)
    at_lock = {spot.way: spot for spot in spots if spot.sweep == POSES and spot.number == 0}
    far = {spot.way: spot for spot in spots if spot.sweep == POSES and spot.number == 1}
    near = {spot.way: spot for spot in spots if spot.sweep == POSES and spot.number == 1e-6}
    assert "q1" in at_lock["EXP1"].status
    assert "q1" in near["EXP1"].status
    assert all((spot.digits or 0) >= 12 for spot in far.values())
    assert all((near[way].digits or 0) >= 12 for way in ("IMPL", "SEMI", "EXP2"))
    assert not any(spot.is_silent for spot in spots if spot.sweep != STEPS)
    assert measure_stability(model, tmp_path / "out", lambda *_: None, quick=True) == spots


def test_sentences_join_ways_that_agree() -> None:
    spots = [Spot(POSES, d, way, e) for way in ("IMPL", "SEMI") for d, e in ((1.0, 1e-15), (0.0, 1e-15))]
    spots += [Spot(POSES, 1.0, "EXP1", 1e-14), Spot(POSES, 1e-6, "EXP1", 1e-2), Spot(POSES, 0.0, "EXP1", None, "q1")]
    assert describe_stability(spots) == [
        f"{POSES}: IMPL, SEMI: 15 right digits",
        f"{POSES}: EXP1: 2 right digits or more, the fewest at 1e-6, without a status; gives up at 0",
    ]


def test_the_command_maps_a_model_and_refuses_what_is_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """RK4 errs by the fourth power of its step; the masses of the last body vary."""
    monkeypatch.chdir(tmp_path)
    model = (Path(__file__).parents[3] / "models" / "double_pendulum.yaml").read_text(encoding="utf-8")
    Path("DPC.yaml").write_text(model, encoding="utf-8")

    def run(*arguments: str) -> object:
        monkeypatch.setattr(sys, "argv", ["mbsrun", "lab", *arguments])
        with pytest.raises(SystemExit) as end:
            cli.main()
        return end.value.code

    assert run("DPC.yaml", "--quick", "-o", "out") in (0, None)
    assert "right digits" in capsys.readouterr().out
    with Path("out/stability.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    (coarse, fine) = [row for row in rows if row["sweep"] == STEPS and row["way"] == "rk4 on EXP2"]
    ratio = float(coarse["number"]) / float(fine["number"])
    order = np.log(float(coarse["error"]) / float(fine["error"])) / np.log(ratio)
    assert 3 < order < 5
    assert {"stability.png", "stability.svg", "stability_narrow.png"} <= {x.name for x in Path("out").iterdir()}
    assert run("absent.yaml") == 2
    assert run("DPC.yaml", "F07") == 2
    assert "give one model file" in capsys.readouterr().err
