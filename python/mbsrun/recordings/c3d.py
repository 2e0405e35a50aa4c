"""C3D -> Recording: positions of markers, as systems of motion capture store them, read by `ezc3d`.

The marker `hip` becomes the columns x[hip], y[hip] and z[hip], in m, along the axes of the file. A frame in which its
residual is negative, or a coordinate is no number, is a gap.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mbsgen.documents import abbreviate
from mbsgen.errors import Fault, InputError
from mbsrun.recordings.recording import AXES, UNITS, Column, Recording


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
    values = points.transpose(2, 1, 0).reshape(points.shape[2], -1) * UNITS[unit][1]
    times = (content["header"]["points"]["first_frame"] + np.arange(len(values))) / rate
    columns = tuple(Column(f"{axis}[{name}]", "m") for name in names[: points.shape[1]] for axis in AXES)
    return Recording(str(path), times, columns, values)
