"""`mbsrun fit-motion` and `mbsrun inverse-dynamics`: what they write and print, exit codes, and what they refuse."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from mbsrun.recordings import read_recording
from tests.picture_kinds import find_kind
from tests.recordings_made import FOLDER, swing

ARM, SWING = str(FOLDER / "arm.yaml"), str(FOLDER / "swing.trc")

Run = Callable[..., tuple[object, str, str]]


def test_a_motion_is_fitted_and_its_forces_are_computed(run: Run) -> None:
    """One file is the next command's input; a hidden marker leaves cells open, and a longer gap fills them."""
    code, out, err = run("fit-motion", ARM, SWING, "-o", "fit", "--format", "svg")
    assert code == 1  # the hidden hand leaves the elbow open
    assert "121, from 0 to 1.2 s" in out
    assert "missing in 5 frames" in out
    assert "in 5 of 121 frames, the markers do not determine elbow" in err
    assert sorted(x.name for x in Path("fit").iterdir()) == [
        "animation.html",
        "motion.csv",
        "motion.json",
        "motion.mot",
        "motion.svg",
    ]
    assert find_kind(Path("fit/motion.svg")) == "svg"
    summary = json.loads(Path("fit/motion.json").read_text("utf-8"))
    assert summary["open"] == {"elbow": 5}
    assert summary["markers"]["hand"]["frames"] == 116
    table = read_recording(Path("fit/motion.csv"))
    assert np.isnan(table.column("q[elbow]")).sum() == 5
    code, out, err = run("fit-motion", ARM, SWING, "-o", "smooth", "--smooth", "1e-9", "--weight", "hand=2")
    assert (code, "warning" in err) == (0, False)
    found = read_recording(Path("smooth/motion.csv"))
    np.testing.assert_allclose(found.column("q[elbow]"), swing(found.times)[1], atol=0.03)
    code, out, err = run(
        "inverse-dynamics",
        ARM,
        "smooth/motion.csv",
        "--noise",
        "5e-3",
        "-o",
        "forces",
        "--from",
        "0.1",
        "--format",
        "pdf",
    )
    assert code == 0, err
    assert "111 of 111, from 0.1 to 1.2 s" in out
    forces = json.loads(Path("forces/forces.json").read_text("utf-8"))["forces"]
    assert list(forces) == ["u[shoulder]", "u[elbow]"]
    assert sorted(x.name for x in Path("forces").iterdir()) == ["forces.csv", "forces.json", "forces.pdf"]
    assert find_kind(Path("forces/forces.pdf")) == "pdf"
    code, out, err = run("animate", ARM, "forces", "-o", "forces.html")
    assert (code, "wrote forces.html" in err) == (0, True)
    assert Path("forces.html").read_text("utf-8").count('"kind": "moment"') == 2  # of both joints
    code, out, err = run("animate", ARM, "forces", "--parameter", "upper=1", "-o", "forces.html")
    assert (code, "for some of none" in err) == (2, True)
    code, out, err = run("inverse-dynamics", ARM, "fit/motion.csv", "--gap", "0.02", "-o", "open")
    assert (code, "116 of 121" in out, "1 left out" in out) == (0, True, True)


BAD = {
    "no file": (["fit-motion", ARM, "none.trc"], "none.trc: there is no such file"),
    "no markers": (["fit-motion", ARM, str(FOLDER / "pendulum.csv")], "no marker has the name of a sensor"),
    "marker": (["fit-motion", ARM, SWING, "--marker", "foot=hand"], "for some of biceps, elbow, hand"),
    "sensor": (["fit-motion", ARM, SWING, "--marker", "hand=foot"], "the model has no sensor 'foot'"),
    "weight": (["fit-motion", ARM, SWING, "--weight", "hand=-1"], "weights must not be negative"),
    "number": (["fit-motion", ARM, SWING, "--weight", "hand=x"], "hand: "),
    "coordinate": (["fit-motion", ARM, SWING, "--coordinate", "elbow=1"], 'no column is named "elbow"'),
    "smooth": (["fit-motion", ARM, SWING, "--smooth", "-1"], "must not be negative"),
    "times": (["fit-motion", ARM, SWING, "--from", "2"], "0 samples are left; the recording is from 0 to 1.2 s"),
    "columns": (["inverse-dynamics", ARM, SWING], 'no column is named "q[elbow]"'),
    "column": (["inverse-dynamics", ARM, SWING, "--column", "knee=x"], "for some of shoulder, elbow"),
    "unit": (["inverse-dynamics", ARM, SWING, "--column", "elbow=x[hand]", "--column", "shoulder=x[hand]"], 'in "m"'),
    "wrench": (["inverse-dynamics", ARM, SWING, "--wrench", "foot=F_"], "for some of none"),
    "noise": (["inverse-dynamics", ARM, SWING, "--noise", "0"], "must be positive"),
    "parameter": (["inverse-dynamics", ARM, SWING, "--parameter", "upper=1"], "for some of none"),
}


@pytest.mark.parametrize(("arguments", "words"), BAD.values(), ids=BAD.keys())
def test_what_cannot_be_accepted_writes_nothing(run: Run, arguments: list[str], words: str) -> None:
    code, _, err = run(*arguments, "-o", "out")
    assert code == 2
    assert words in " ".join(err.replace("│", " ").split())
    assert not Path("out").exists()
