"""C3D -> Recording: positions of markers and forces of plates of motion capture, read by `ezc3d`.

The marker `hip` becomes the columns x[hip], y[hip] and z[hip], in m, along the axes of the file. A frame in which its
residual is negative, or a coordinate is no number, is a gap.

Plate 1 becomes the columns ground_force_1_vx to vz [N], ground_moment_1_mx to mz [N m] and ground_force_1_px to pz [m],
along the axes of the file: the force as it is recorded, and its moment about the middle of the surface, at p. A frame
has the mean of the samples from half a frame before it to half a frame after it, which shifts no time. A centre of
pressure would be a quotient of noise where the force is small; this moment is none.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from mbsgen.documents import abbreviate
from mbsgen.errors import Fault, InputError
from mbsrun.recordings.recording import AXES, UNITS, Array, Column, Recording

_MOMENTS = {"Nmm": 1e-3, "N mm": 1e-3, "N.mm": 1e-3, "Nm": 1.0, "N m": 1.0, "N.m": 1.0}  # in N m


def read_c3d(path: Path) -> Recording:
    """Read a C3D file. Raises InputError for a faulty file, and where `ezc3d` is not installed."""
    try:
        import ezc3d
    except ImportError:
        finding = "files of C3D are read by ezc3d, which is not installed"
        raise InputError([Fault(str(path), 0, "", finding, "run: pip install ezc3d")]) from None
    if not path.is_file():
        raise InputError([Fault(str(path), 0, "", "there is no such file", "check the path")])
    try:
        content = ezc3d.c3d(str(path))
    except (ValueError, RuntimeError, OSError) as error:
        finding = f"it is no C3D file that ezc3d reads: {abbreviate(str(error))}"
        raise InputError([Fault(str(path), 0, "", finding, "export it again")]) from None
    settings = content["parameters"]["POINT"]
    names = [str(name).strip() for name in settings["LABELS"]["value"]]
    unit = str((settings["UNITS"]["value"] or ["mm"])[0]).strip()
    rate = float(settings["RATE"]["value"][0])
    points = np.array(content["data"]["points"][:3], dtype=np.float64)  # (3, N, K)
    faults = []
    if UNITS.get(unit, ("", 0.0))[0] != "m":
        faults.append((f"markers are in {abbreviate(unit)}", "give m, cm or mm"))
    if not (rate > 0 and points.shape[2]):
        faults.append((f"{points.shape[2]} frames at {rate:g} Hz", "export a recording with frames and a rate"))
    if len(set(names)) < len(names):
        faults.append(("two markers have one name", "rename one"))
    if len(names) < points.shape[1]:
        faults.append((f"{points.shape[1]} markers, and {len(names)} names", "name each"))
    if faults:
        raise InputError([Fault(str(path), 0, "POINT", *told) for told in faults])
    residuals = content["data"]["meta_points"]["residuals"][0]
    points[:, residuals < 0] = np.nan
    markers = points.transpose(2, 1, 0).reshape(points.shape[2], -1) * UNITS[unit][1]
    times = (content["header"]["points"]["first_frame"] + np.arange(len(markers))) / rate
    columns = [Column(f"{axis}[{name}]", "m") for name in names[: points.shape[1]] for axis in AXES]
    forces, plates = _read_plates(path, content, len(markers))
    return Recording(str(path), times, (*columns, *forces), np.concatenate((markers, plates), axis=1))


def _read_plates(path: Path, content: Any, frames: int) -> tuple[list[Column], Array]:
    """Return the columns of all force plates, and their values (frames, columns)."""
    import ezc3d

    used = content["parameters"].get("FORCE_PLATFORM", {}).get("USED", {}).get("value", [0])
    if not len(used) or not int(used[0]):
        return [], np.zeros((frames, 0))
    try:
        plates = ezc3d.c3d(str(path), extract_forceplat_data=True)["data"]["platform"]
    except (ValueError, RuntimeError, OSError) as error:
        finding = f"force plates that ezc3d does not read: {abbreviate(str(error))}"
        raise InputError(
            [Fault(str(path), 0, "FORCE_PLATFORM", finding, "export it again, or without plates")]
        ) from None
    columns, values = [], []
    for number, plate in enumerate(plates, 1):
        units = [str(plate[f"unit_{part}"]).strip() for part in ("force", "moment", "position")]
        scales = [UNITS.get(units[0], ("", 0.0))[1], _MOMENTS.get(units[1], 0.0), UNITS.get(units[2], ("", 0.0))[1]]
        if not all(scales):
            finding = f"plate {number} has the units {', '.join(units)}"
            raise InputError([Fault(str(path), 0, "FORCE_PLATFORM", finding, "give N, N m or N mm, and m or mm")])
        middle = np.tile(np.asarray(plate["corners"]).mean(axis=1), (frames, 1))
        parts = (_average(plate["force"], frames), _average(plate["moment"], frames), middle)
        for stem, unit, part, scale in zip(_name_plate(number), ("N", "N m", "m"), parts, scales, strict=True):
            columns += [Column(f"{stem}{axis}", unit) for axis in AXES]
            values.append(part * scale)
    return columns, np.concatenate(values, axis=1)


def _name_plate(number: int) -> tuple[str, str, str]:
    return f"ground_force_{number}_v", f"ground_moment_{number}_m", f"ground_force_{number}_p"


def _average(samples: Any, frames: int) -> Array:
    """Return means (frames, 3) of samples (3, frames times some) about the first of each frame; ends count half."""
    x = np.asarray(samples, dtype=np.float64).T
    count = len(x) // frames
    half = count // 2
    kernel = np.ones(2 * half + 1)
    if count % 2 == 0:
        kernel[[0, -1]] = 0.5
    padded = np.concatenate((np.repeat(x[:1], half, axis=0), x, np.repeat(x[-1:], half, axis=0)))
    means = np.stack([np.convolve(column, kernel / kernel.sum(), mode="valid") for column in padded.T], axis=1)
    return np.asarray(means[: frames * count : count])
