"""TRC -> Recording: positions of markers, as systems of motion capture write them.

    PathFileType  4  (X/Y/Z)  walk.trc
    DataRate  CameraRate  NumFrames  NumMarkers  Units  OrigDataRate  OrigDataStartFrame  OrigNumFrames
    100       100         250        2           mm     100           1                   250
    Frame#  Time  hip           knee
                  X1  Y1  Z1    X2  Y2  Z2

Cells are separated by tabs; a blank line may follow; then there is a row for each frame. The marker `hip` becomes the
columns x[hip], y[hip] and z[hip], in m. (OpenSim's documentation, "Marker (.trc) Files".)
"""

from __future__ import annotations

from pathlib import Path

from mbsgen.documents import abbreviate
from mbsrun.recordings.lines import Lines, name_columns, read_lines, read_rows, split_plainly, trim
from mbsrun.recordings.recording import AXES, UNITS, Column, Recording

HEADER = 5  # lines
NEEDED = ("NumFrames", "NumMarkers", "Units")


def read_markers(path: Path) -> Recording:
    """Read a TRC file. Raises InputError with every fault of it."""
    lines = read_lines(path)
    if not lines.text[0].startswith("PathFileType"):
        found = abbreviate(lines.text[0])
        raise lines.stop(1, f"found {found}", "begin the file with PathFileType: it is no TRC file otherwise")
    if len(lines.text) < HEADER:
        raise lines.stop(len(lines.text), "the header ends here", f"give its {HEADER} lines, then rows of numbers")
    settings = _read_settings(lines)
    labels = lines.text[3].rstrip().split("\t")
    if [label.strip().lower() for label in labels[:2]] != ["frame#", "time"]:
        raise lines.stop(4, f"found {abbreviate(lines.text[3])}", "begin the line with Frame#, a tab, and Time")
    names = [column.name for column in name_columns(lines, 4, [x for x in labels[2:] if x.strip()])]
    places = [k for k, label in enumerate(labels) if k > 1 and label.strip()]
    if places != list(range(2, 2 + 3 * len(places), 3)):
        lines.fault(4, "", "names of markers are not three cells apart", "put each name above its X, with two tabs on")
    _check_count(lines, settings, "NumMarkers", len(names), "markers are named in line 4")
    unit = settings.get("Units", "m")
    if UNITS.get(unit, ("", 0.0))[0] != "m":
        lines.fault(3, "Units", f"found {abbreviate(unit)}", "give m, cm or mm")
    columns = [f"{axis}[{name}]" for name in names for axis in AXES]
    rows = [trim(row, 2 + len(columns)) for row in split_plainly(lines, HEADER, "\t")]
    _check_count(lines, settings, "NumFrames", len(rows), "rows of numbers follow")
    values = read_rows(lines, ["Frame#", "Time", *columns], rows, first=1)
    lines.check()
    factor = UNITS[unit][1]
    return Recording(lines.file, values[:, 1], tuple(Column(name, "m") for name in columns), values[:, 2:] * factor)


def _read_settings(lines: Lines) -> dict[str, str]:
    """Read the keys in line 2 and their values in line 3."""
    keys, values = (lines.text[k].rstrip().split("\t") for k in (1, 2))
    if len(keys) != len(values):
        lines.fault(3, "", f"found {len(values)} values for {len(keys)} keys in line 2", "give one for each")
    settings = {key.strip(): value.strip() for key, value in zip(keys, values, strict=False)}
    for key in NEEDED:
        if key not in settings:
            lines.fault(2, key, "it is missing", "give it, and its value in the line below")
    return settings


def _check_count(lines: Lines, settings: dict[str, str], key: str, count: int, what: str) -> None:
    if key in settings and settings[key] != str(count):
        given = abbreviate(settings[key])
        lines.fault(3, key, f"it is {given}, and {count} {what}", "give the right number, or the whole file")
