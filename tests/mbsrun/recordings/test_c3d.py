"""Recordings in C3D: against files that `ezc3d` writes; and what is refused."""

from __future__ import annotations

import sys
from pathlib import Path

import ezc3d
import numpy as np
import pytest
from numpy.typing import NDArray

from mbsgen.errors import InputError
from mbsrun.recordings import read_recording


def write(path: Path, points: NDArray[np.float64], *, unit: str = "mm") -> Path:
    """Write positions (3, 2, K) of a hand and an elbow at 50 Hz; NaN are missing."""
    file = ezc3d.c3d()
    settings = file["parameters"]["POINT"]
    settings["RATE"]["value"], settings["UNITS"]["value"] = [50.0], [unit]
    settings["LABELS"]["value"] = ["hand", "elbow"]
    file["data"]["points"] = np.concatenate((points, np.ones((1, *points.shape[1:]))))
    file["data"]["meta_points"]["residuals"] = np.where(np.isnan(points[:1]), -1.0, 0.0)
    file.write(str(path))
    return path


def test_markers_are_what_was_written(tmp_path: Path) -> None:
    """In m, to the single precision of the file; a hidden marker is a gap."""
    points = np.random.default_rng(1).uniform(-1000, 1000, (3, 2, 7))
    points[:, 1, 3] = np.nan
    found = read_recording(write(tmp_path / "walk.c3d", points))
    assert found.markers == ("hand", "elbow")
    np.testing.assert_allclose(found.times, np.arange(7) / 50, atol=1e-15)
    np.testing.assert_allclose(found.values, points.transpose(2, 1, 0).reshape(7, 6) / 1000, rtol=1e-6)
    assert np.isnan(found.column("x[elbow]")).sum() == 1


def test_faulty_files_are_one_clear_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write(tmp_path / "walk.c3d", np.zeros((3, 2, 3)), unit="inch")
    with pytest.raises(InputError, match=r'walk.c3d: POINT: markers are in "inch"; give m, cm or mm'):
        read_recording(path)
    (tmp_path / "text.c3d").write_text("no markers", "utf-8")
    with pytest.raises(InputError, match="it is no C3D file that ezc3d reads"):
        read_recording(tmp_path / "text.c3d")
    with pytest.raises(InputError, match="there is no such file"):
        read_recording(tmp_path / "none.c3d")
    monkeypatch.setitem(sys.modules, "ezc3d", None)
    with pytest.raises(InputError, match=r"which is not installed; run: pip install ezc3d"):
        read_recording(path)
