"""CSV -> Recording: a line of names, then a row for each time; what `mbsrun simulate` and `mbsrun solve` write too.

The column `t` or `time` holds the time. Cells are separated by commas, semicolons or tabs, whichever the line of names
has. A name may be followed by its unit in brackets, `knee [deg]`; without one, a column is in SI units. Lines that
begin with # may stand before the names.
"""

from __future__ import annotations

import csv
from pathlib import Path

from mbsgen.documents import abbreviate
from mbsrun.recordings.lines import Lines, Row, convert, name_columns, read_lines, read_rows
from mbsrun.recordings.recording import UNITS, Recording

SEPARATORS = ",;\t"
TIMES = ("t", "time")  # names of the column with times, in any case


def read_table(path: Path) -> Recording:
    """Read a CSV file. Raises InputError with every fault of it."""
    lines, rows = read_cells(path)
    start, labels = rows[0]
    columns = name_columns(lines, start, labels)
    first = next((k for k, column in enumerate(columns) if column.name.lower() in TIMES), None)
    if first is None:
        found = ", ".join(abbreviate(column.name) for column in columns[:5])
        raise lines.stop(start, f"no column is named t or time; found {found}", "name the column of times so")
    unit = columns[first].unit
    if unit and UNITS.get(unit, ("", 0.0))[0] != "s":
        lines.fault(start, f"column {first + 1}", f"the time is in {abbreviate(unit)}", "give it in s or ms")
    written = [row for row in rows[1:] if any(cell.strip() for cell in row[1])]
    values = read_rows(lines, [column.name for column in columns], written, first)
    lines.check()
    known, values = convert(columns, values)
    kept = [k for k in range(len(known)) if k != first]
    return Recording(lines.file, values[:, first], tuple(known[k] for k in kept), values[:, kept])


def read_cells(path: Path) -> tuple[Lines, list[Row]]:
    """Read the lines that hold cells, names first. Raises InputError for a file that is empty, or is no such table."""
    lines = read_lines(path)
    start = next((k for k, text in enumerate(lines.text) if text.strip() and not text.startswith("#")), None)
    if start is None:
        raise lines.stop(0, "the file is empty", "give a line of names, then rows below")
    return lines, _split(lines, start, max(SEPARATORS, key=lines.text[start].count))


def _split(lines: Lines, start: int, separator: str) -> list[Row]:
    """Split lines into cells, which may be quoted."""
    reader = csv.reader((text + "\n" for text in lines.text[start:]), delimiter=separator, strict=True)
    rows: list[Row] = []
    try:
        for cells in reader:
            if len(cells) > 1 or any(cell.strip() for cell in cells):
                rows.append((start + reader.line_num, cells))
    except csv.Error as error:
        finding = f"the line cannot be split into cells: {error}"
        raise lines.stop(start + reader.line_num, finding, "mend its quotes") from None
    return rows
