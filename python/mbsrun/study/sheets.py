"""What a report is made of: tables, pictures, sections; and how those that lie in a folder are read."""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter, ValidationError

from mbsgen.errors import Fault, InputError

Cell = str | float | int | bool | None

LARGEST = 8_000_000  # bytes of a file that is taken in
LONG = 40  # rows of a table that is shown folded
KINDS = {".png": "image/png", ".svg": "image/svg+xml"}


@dataclass(frozen=True)
class Table:
    """Numbers with names; a file of it is JSON with these keys."""

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]
    note: str = ""


@dataclass(frozen=True)
class Picture:
    """A figure, and what is on it."""

    title: str
    kind: str  # of KINDS
    content: bytes
    note: str = ""


@dataclass(frozen=True)
class Section:
    """A part of a report."""

    name: str  # of files and anchors
    title: str
    text: str  # what it is about, and how it was made
    items: tuple[Table | Picture, ...]


def write_section(section: Section, folder: Path) -> None:
    """Write tables as NAME_1.csv, …, and pictures as they are."""
    folder.mkdir(parents=True, exist_ok=True)
    for number, item in enumerate(section.items, 1):
        name = f"{section.name}_{number}"
        if isinstance(item, Picture):
            suffix = next(suffix for suffix, kind in KINDS.items() if kind == item.kind)
            (folder / f"{name}{suffix}").write_bytes(item.content)
        else:
            with (folder / f"{name}.csv").open("w", encoding="utf-8", newline="") as file:
                csv.writer(file).writerows([item.columns, *item.rows])


def write_table_file(table: Table, path: Path) -> None:
    """Write a table as `read_folder` reads it."""
    path.write_text(json.dumps(asdict(table), indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


def read_folder(folder: Path) -> Section:
    """Read the tables (*.json) and pictures (*.png, *.svg) of a folder, by name.

    A table has the keys title, columns, rows and, as it may be, note; a list of objects is one as well. What is of
    another form is passed over: folders hold records beside. Raises InputError for one that cannot be read, or that
    has neither.
    """
    if not folder.is_dir():
        raise InputError([Fault(str(folder), 0, "", "it is no folder", "give one with tables and pictures")])
    items = tuple(_read_items(folder))
    if not items:
        raise InputError([Fault(str(folder), 0, "", "it has no table and no picture", "give another folder")])
    name = re.sub(r"[^A-Za-z0-9]+", "_", folder.resolve().name).strip("_") or "folder"
    return Section(name, folder.resolve().name.replace("_", " "), "", items)


def _read_items(folder: Path) -> Iterator[Table | Picture]:
    for path in sorted(folder.iterdir()):
        if not path.is_file() or path.stat().st_size > LARGEST:
            continue
        if path.suffix in KINDS:
            yield Picture(path.stem.replace("_", " "), KINDS[path.suffix], path.read_bytes())
        elif path.suffix == ".json":
            table = _read_table(path)
            if table is not None:
                yield table


def _read_table(path: Path) -> Table | None:
    try:
        found = json.loads(path.read_bytes())
        return _list_points(path.stem, found) if isinstance(found, list) else _TABLE.validate_python(found)
    except (ValueError, ValidationError, RecursionError):
        return None


def _list_points(name: str, points: Sequence[Any]) -> Table | None:
    """Lay a list of objects out as a table; what is an object in them gets a column for each entry."""
    rows = [_flatten(point) for point in points if isinstance(point, dict)]
    columns = tuple(dict.fromkeys(key for row in rows for key in row))
    if not columns:
        return None
    return Table(name.replace("_", " "), columns, tuple(tuple(row.get(key) for key in columns) for row in rows))


def _flatten(point: dict[str, Any], prefix: str = "") -> dict[str, Cell]:
    row: dict[str, Cell] = {}
    for key, value in point.items():
        if isinstance(value, dict):
            row |= _flatten(value, f"{prefix}{key} ")
        else:
            row[f"{prefix}{key}"] = value if isinstance(value, str | float | int | None) else json.dumps(value)
    return row


_TABLE: TypeAdapter[Table] = TypeAdapter(Table)
