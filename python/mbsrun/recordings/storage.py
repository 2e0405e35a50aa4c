"""STO and MOT -> Recording: OpenSim's tables of coordinates, forces and other results.

    walk
    version=1
    nRows=101
    nColumns=3
    inDegrees=yes
    endheader
    time  hip  knee

Then a row for each time, separated by tabs or blanks. `inDegrees` speaks of angles alone, which the model knows; where
a file leaves it out, angles cannot be read. Headers of SIMM, `datarows 101` and `datacolumns 3`, are read too.
(OpenSim's documentation, "Storage (.sto) Files" and "Motion (.mot) Files".)
"""

from __future__ import annotations

import re
from pathlib import Path

from mbsgen.documents import abbreviate
from mbsrun.recordings.lines import Lines, convert, name_columns, read_lines, read_rows, split_plainly, trim
from mbsrun.recordings.recording import Recording

END = "endheader"
MAX_HEADER = 1000  # lines
COUNTS = {"nrows": "nRows", "datarows": "datarows", "ncolumns": "nColumns", "datacolumns": "datacolumns"}
DEGREES = {"yes": True, "no": False}
_SETTING = re.compile(r"\s*(\w+)\s*(?:=|\s)\s*(\S+)\s*")


def read_storage(path: Path) -> Recording:
    """Read a STO or MOT file. Raises InputError with every fault of it."""
    lines = read_lines(path)
    end = next((k for k, text in enumerate(lines.text[:MAX_HEADER]) if text.strip().lower() == END), None)
    if end is None:
        raise lines.stop(1, f"no line says {END}", "end the header so: it is no STO or MOT file otherwise")
    settings = {found[1].lower(): (k + 1, found[2]) for k in range(end) if (found := _SETTING.fullmatch(lines.text[k]))}
    start = next((k for k in range(end + 1, len(lines.text)) if lines.text[k].strip()), None)
    if start is None:
        raise lines.stop(end + 1, "nothing follows the header", "give a line of names, then rows of numbers")
    separator = "\t" if "\t" in lines.text[start] else None
    header, *rows = split_plainly(lines, start, separator)
    line, labels = trim(header, 1)
    rows = [trim(row, len(labels)) for row in rows]
    columns = name_columns(lines, line, labels)
    if columns[0].name.lower() != "time":
        lines.fault(line, "column 1", f"found {abbreviate(columns[0].name)}", "let the first column be time")
    _check_counts(lines, settings, len(rows), len(columns))
    values = read_rows(lines, [column.name for column in columns], rows)
    in_degrees = _read_degrees(lines, settings)
    lines.check()
    known, values = convert(columns, values)
    return Recording(lines.file, values[:, 0], known[1:], values[:, 1:], in_degrees)


def _check_counts(lines: Lines, settings: dict[str, tuple[int, str]], rows: int, columns: int) -> None:
    for key, spelled in COUNTS.items():
        if key in settings:
            line, given = settings[key]
            count, what = (rows, "rows of numbers follow") if "rows" in key else (columns, "columns are named")
            if given != str(count):
                finding = f"it is {abbreviate(given)}, and {count} {what}"
                lines.fault(line, spelled, finding, "give the right number, or the whole file")
    line, kind = settings.get("datatype", (0, "double"))
    if kind.lower() != "double":
        lines.fault(line, "DataType", f"found {abbreviate(kind)}", "give a file of DataType=double: a number in a cell")


def _read_degrees(lines: Lines, settings: dict[str, tuple[int, str]]) -> bool | None:
    if "indegrees" not in settings:
        return None
    line, given = settings["indegrees"]
    if given.lower() not in DEGREES:
        lines.fault(line, "inDegrees", f"found {abbreviate(given)}", "give yes or no")
    return DEGREES.get(given.lower())
