"""The text of a recording's file: bounded in size, line by line; numbers and gaps in its cells; all faults at once."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from mbsgen.documents import abbreviate, read_bytes, refuse
from mbsgen.errors import Fault, InputError
from mbsrun.recordings.recording import UNITS, Array, Column

MAX_BYTES = 1 << 26
MAX_COLUMNS = 2000
MAX_ROWS = 1_000_000
MAX_NAME = 200  # characters
LARGEST = 1e30  # magnitude of a number, in the file's unit; squares of its derivatives do not overflow
CLOSEST = 1e-9  # s, between two rows
MAX_CELL_FAULTS = 20  # of one file: a column of words would be a fault in each row
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d{1,4})?", re.ASCII)
_UNIT = re.compile(r"(?P<name>.*\S)\s+\[(?P<unit>[^\[\]]*)\]")

Row = tuple[int, list[str]]  # its line, from 1, and its cells


@dataclass
class Lines:
    """A file, and the faults that were found in it."""

    file: str
    text: Sequence[str]
    faults: list[Fault] = field(default_factory=list)

    def fault(self, line: int, path: str, finding: str, remedy: str) -> None:
        """Keep a fault."""
        self.faults.append(Fault(self.file, line, path, finding, remedy))

    def stop(self, line: int, finding: str, remedy: str) -> InputError:
        """Return the error of a file in which nothing more can be read."""
        self.fault(line, "", finding, remedy)
        return refuse(self.faults)

    def check(self) -> None:
        """Raise InputError if there are faults."""
        if self.faults:
            raise refuse(self.faults)


def read_lines(path: Path) -> Lines:
    """Read a text file. Raises InputError for a file that cannot be read, is too long, or is no text."""
    raw = read_bytes(path, MAX_BYTES)
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = raw[: error.start].count(b"\n") + 1
        raise refuse([Fault(str(path), line, "", "found bytes that are no UTF-8 text", "save it as UTF-8")]) from None
    if "\0" in text:
        line = text[: text.index("\0")].count("\n") + 1
        raise refuse([Fault(str(path), line, "", "found a zero byte", "give a text file")])
    return Lines(str(path), text.replace("\r\n", "\n").replace("\r", "\n").split("\n"))


def name_columns(lines: Lines, line: int, labels: Sequence[str]) -> list[Column]:
    """Read names and units of columns; a unit is in brackets behind a blank: `knee [deg]`."""
    if len(labels) > MAX_COLUMNS:
        raise lines.stop(line, f"found {len(labels)} columns", f"give at most {MAX_COLUMNS}")
    columns: list[Column] = []
    seen: dict[str, int] = {}
    for k, label in enumerate(labels):
        found = _UNIT.fullmatch(label.strip())
        name, unit = (label.strip(), "") if found is None else (found["name"], found["unit"].strip())
        if not name:
            lines.fault(line, f"column {k + 1}", "it has no name", "give each column a name")
        elif len(name) > MAX_NAME:
            lines.fault(line, f"column {k + 1}", f"its name has {len(name)} characters", f"give at most {MAX_NAME}")
        elif name in seen:
            lines.fault(line, f"column {k + 1}", f"{abbreviate(name)} names column {seen[name]} too", "rename one")
        seen.setdefault(name, k + 1)
        columns.append(Column(name, unit))
    return columns


def read_rows(lines: Lines, columns: Sequence[str], rows: Iterable[Row], first: int = 0) -> Array:
    """Read numbers, (rows, columns); an empty cell or NaN is a gap. The column `first` holds times, without gaps."""
    found: list[list[float]] = []
    places: list[int] = []
    for line, cells in rows:
        if len(found) == MAX_ROWS:
            raise lines.stop(line, f"there are more than {MAX_ROWS} rows", "cut the recording into parts")
        if len(cells) != len(columns):
            remedy = "give a cell for each column; an empty one, or nan, is a gap"
            lines.fault(line, "", f"found {len(cells)} cells, and there are {len(columns)} columns", remedy)
        else:
            found.append([_read_cell(lines, line, name, cell) for name, cell in zip(columns, cells, strict=True)])
            places.append(line)
        if len(lines.faults) > MAX_CELL_FAULTS:
            raise refuse(lines.faults)
    values = np.array(found, dtype=np.float64).reshape(len(found), len(columns))
    _check_times(lines, places, columns[first], values[:, first])
    return values


def _read_cell(lines: Lines, line: int, name: str, cell: str) -> float:
    text = cell.strip()
    if not text or text.lower() == "nan":
        return math.nan
    value = float(text) if _NUMBER.fullmatch(text) else math.inf
    if abs(value) <= LARGEST:
        return value
    if math.isfinite(value):
        remedy = f"give a number of at most {LARGEST:g}; an empty cell, or nan, is a gap"
        lines.fault(line, f"column {abbreviate(name)}", f"found {abbreviate(text)}", remedy)
        return math.nan
    remedy = "give a number with a point, such as 1.5e-3; an empty cell, or nan, is a gap"
    lines.fault(line, f"column {abbreviate(name)}", f"found {abbreviate(text)}", remedy)
    return math.nan


def _check_times(lines: Lines, places: Sequence[int], name: str, times: Array) -> None:
    """Times are numbers and increase; there are two at least."""
    path = f"column {abbreviate(name)}"
    if lines.faults:
        return  # a row or cell with a fault has no time
    for k in np.flatnonzero(np.isnan(times)):
        lines.fault(places[int(k)], path, "this row has no time", "give one in each row")
    for k in np.flatnonzero(np.diff(times) < CLOSEST):
        finding, remedy = f"the time {times[k + 1]:.9g} follows {times[k]:.9g}", "let times increase from row to row"
        if times[k + 1] > times[k]:
            remedy = f"let times be in s, and {CLOSEST:g} apart at least"
        lines.fault(places[int(k) + 1], path, finding, remedy)
    if len(times) < 2:
        finding = f"found {len(times)} rows of numbers" if len(times) != 1 else "found one row of numbers"
        lines.fault(places[-1] if places else 0, "", finding, "give two at least")


def convert(columns: Sequence[Column], values: Array) -> tuple[tuple[Column, ...], Array]:
    """Convert columns whose unit is known to SI units."""
    known = [UNITS.get(column.unit, (column.unit, 1.0)) for column in columns]
    converted = tuple(Column(column.name, unit) for column, (unit, _) in zip(columns, known, strict=True))
    return converted, np.asarray(values * [factor for _, factor in known])


def split_plainly(lines: Lines, first: int, separator: str | None) -> list[Row]:
    """Split lines from index `first` on; blank ones are left out. None separates at any blanks."""
    return [(k, text.split(separator)) for k, text in enumerate(lines.text[first:], first + 1) if text.strip()]


def trim(row: Row, size: int) -> Row:
    """Drop empty cells at the end of a row, beyond `size` of them: a separator at the end begins no cell."""
    line, cells = row
    while len(cells) > size and not cells[-1].strip():
        cells = cells[:-1]
    return line, cells
