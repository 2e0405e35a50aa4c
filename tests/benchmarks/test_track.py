"""The comparison of controllers in closed loops: its page, on one trial."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from benchmarks import track


def test_trials_are_compared_by_controller(tmp_path: Path, requires: Callable[[str], str]) -> None:
    """Both controllers meet the trial's measures; in real time, the one in C makes one iteration at each sample."""
    requires("cc")
    track.main(["--trials", "satellite_point", "--ways", "mbs", "C, one step", "--out", str(tmp_path)])
    lines = (tmp_path / "track.md").read_text("utf-8").splitlines()
    rows = [line.strip("| ").split(" | ") for line in lines if line.startswith("| satellite_point")]
    assert [row[:4] for row in rows] == [["satellite_point", way, "120", "0"] for way in ("mbs", "C, one step")]
    assert all(float(cell) > 0 for row in rows for cell in row[4:8])
    assert [float(row[8]) for row in rows] == [pytest.approx(6, abs=3), 1.0]
    assert not any("fails" in row[-1] for row in rows)
