"""Recordings in C3D: against files that `ezc3d` writes; and what is refused."""

from __future__ import annotations

import sys
from pathlib import Path

import ezc3d
import numpy as np
import pytest
from numpy.typing import NDArray

from mbsgen.errors import InputError
from mbsrun import cli
from mbsrun.recordings import read_recording

Array = NDArray[np.float64]
RATIO = 4  # samples of a plate in a frame
DEPTH = 40.0  # of a plate's origin below its surface [mm]
MIDDLE = np.array([300.0, 200.0, 0.0])  # of the plate's surface [mm]
TURN = np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]])  # columns: the plate's axes; z points down, as on the usual ones


def write(path: Path, points: NDArray[np.float64], *, unit: str = "mm", force: Array | None = None) -> Path:
    """Write positions (3, 2, K) of a hand and an elbow at 50 Hz, and what a plate measures (6, RATIO K).

    NaN are missing.
    """
    file = ezc3d.c3d()
    settings = file["parameters"]["POINT"]
    settings["RATE"]["value"], settings["UNITS"]["value"] = [50.0], [unit]
    settings["LABELS"]["value"] = ["hand", "elbow"]
    file["data"]["points"] = np.concatenate((points, np.ones((1, *points.shape[1:]))))
    file["data"]["meta_points"]["residuals"] = np.where(np.isnan(points[:1]), -1.0, 0.0)
    if force is not None:
        add_plate(file, force)
    file.write(str(path))
    return path


def add_plate(file: ezc3d.c3d, channels: Array) -> None:
    """Add a plate of 600 mm along y and 400 mm along x; corners in the order of the quadrants of its axes."""
    analog = file["parameters"]["ANALOG"]
    analog["RATE"]["value"] = [50.0 * RATIO]
    analog["LABELS"]["value"] = ["Fx", "Fy", "Fz", "Mx", "My", "Mz"]
    analog["UNITS"]["value"] = ["N", "N", "N", "Nmm", "Nmm", "Nmm"]
    signs = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]])
    corners = MIDDLE + (signs * [300, 200]) @ TURN.T[:2]
    for name, value in (("USED", 1), ("TYPE", 2), ("CHANNEL", 1)):
        file.add_parameter("FORCE_PLATFORM", name, value)
    plate = file["parameters"]["FORCE_PLATFORM"]
    plate["TYPE"]["value"], plate["CHANNEL"]["value"] = np.array([2]), np.arange(1, 7).reshape(6, 1)
    file.add_parameter("FORCE_PLATFORM", "CORNERS", corners.T.reshape(3, 4, 1))
    file.add_parameter("FORCE_PLATFORM", "ORIGIN", np.array([[0.0], [0.0], [-DEPTH]]))
    file["data"]["analogs"] = channels[None]


def measure(force: Array, point: Array, moment: float) -> Array:
    """Return what a plate measures, (6, K), of forces (K, 3) at points (K, 3) [mm] with moments about z [N mm]."""
    origin = MIDDLE + TURN @ [0, 0, DEPTH]
    about = np.cross(point - origin, force) + np.array([0, 0, moment])
    return np.concatenate((force @ TURN, about @ TURN), axis=1).T


def test_markers_are_what_was_written(tmp_path: Path) -> None:
    """In m, to the single precision of the file; a hidden marker is a gap."""
    points = np.random.default_rng(1).uniform(-1000, 1000, (3, 2, 7))
    points[:, 1, 3] = np.nan
    found = read_recording(write(tmp_path / "walk.c3d", points))
    assert found.markers == ("hand", "elbow")
    np.testing.assert_allclose(found.times, np.arange(7) / 50, atol=1e-15)
    np.testing.assert_allclose(found.values, points.transpose(2, 1, 0).reshape(7, 6) / 1000, rtol=1e-6)
    assert np.isnan(found.column("x[elbow]")).sum() == 1


def test_a_plate_has_the_force_and_moment_that_act_on_it(tmp_path: Path) -> None:
    """A force at a point has its moment about the middle of the surface; linear ones are their own means."""
    k = np.arange(7 * RATIO)[:, None]
    force = np.array([30.0, -20, 700]) + k * [1.0, 2, -5]
    point = np.array([350.0, 120, 0])
    path = write(tmp_path / "walk.c3d", np.zeros((3, 2, 7)), force=measure(force, point, 900.0))
    found = read_recording(path)
    within = slice(1, 6)  # at the ends, samples are missing on one side
    acting = force[::RATIO][within]
    about = np.cross(point - MIDDLE, acting) + np.array([0, 0, 900])
    for stem, expected in (("force_1_v", acting), ("moment_1_m", about / 1000), ("force_1_p", MIDDLE / 1000)):
        for i, axis in enumerate("xyz"):
            values = found.column(f"ground_{stem}{axis}")[within]
            np.testing.assert_allclose(values, np.broadcast_to(expected, (5, 3))[:, i], rtol=1e-5, atol=1e-5)


def test_a_force_between_frames_counts_for_both(tmp_path: Path) -> None:
    """One sample of 80 N in the middle of two frames is half a sample of four in each."""
    force = np.zeros((7 * RATIO, 3))
    force[2 * RATIO + RATIO // 2, 2] = 80.0
    path = write(tmp_path / "walk.c3d", np.zeros((3, 2, 7)), force=measure(force, MIDDLE, 0.0))
    assert read_recording(path).column("ground_force_1_vz") == pytest.approx([0, 0, 10, 10, 0, 0, 0], abs=1e-5)


def test_inverse_dynamics_take_plates(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A rod at rest on a pin at the origin, held by nothing but the plate: its torque is minus the force's moment."""
    (tmp_path / "rod.yaml").write_text(
        "name: rod\ngravity: [0, 0, 0]\nbodies:\n"
        "  - {name: rod, joint: {name: q, type: revolute, axis: y}, mass: 2, com: [0, 0, -1], inertia: [1, 1, 1]}\n"
        "wrenches:\n  - {name: foot, body: rod, position: [0, 0, -1], frame: base, force: input, moment: input}\n"
        "frames:\n  - {name: foot, body: rod, position: [0, 0, -1]}\n",
        "utf-8",
    )
    (tmp_path / "rest.csv").write_text("t,q\n" + "".join(f"{k / 50},0.3\n" for k in range(7)), "utf-8")
    force, point = np.array([30.0, 0, 700]), np.array([350.0, 120, 0])
    channels = measure(np.tile(force, (7 * RATIO, 1)), np.tile(point, (7 * RATIO, 1)), 0.0)
    path = write(tmp_path / "walk.c3d", np.zeros((3, 2, 7)), force=channels)
    columns = "foot=ground_force_1_v,ground_force_1_p,ground_moment_1_m"
    out = tmp_path / "forces"
    arguments = [str(tmp_path / "rod.yaml"), str(tmp_path / "rest.csv"), "--forces", str(path), "--wrench", columns]
    monkeypatch.setattr("sys.argv", ["mbsrun", "id", *arguments, "-o", str(out)])
    with pytest.raises(SystemExit) as end:
        cli.main()
    assert end.value.code == 0
    found = read_recording(out / "forces.csv")
    assert found.column("u[q]") == pytest.approx(np.full(7, -np.cross(point / 1000, force)[1]), abs=1e-3)


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
