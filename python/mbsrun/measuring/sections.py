"""The parts of a report: tables, pictures, sections; write them to folders, and read them from folders."""

from __future__ import annotations

import csv
import json
import math
import re
from collections import Counter
from collections.abc import Container, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter, ValidationError

from mbsgen.errors import Fault, InputError
from mbsgen.style import in_format

Cell = str | float | int | bool | None

LARGEST = 8_000_000  # bytes of an included file
LONG = 40  # rows of a table that is shown folded
OUTLINE = ".section.json"
LAST = 100  # the place of files without an outline
NARROW = "_narrow"  # the end of the name of a picture for a phone
KINDS = {".png": "image/png", ".svg": "image/svg+xml"}


@dataclass(frozen=True)
class Table:
    """A table; its file is JSON with these keys."""

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]
    note: str = ""
    is_folded: bool = False  # shown on demand, however short it is


@dataclass(frozen=True)
class Picture:
    """A figure with its caption."""

    title: str
    kind: str  # of KINDS
    content: bytes
    note: str = ""
    paper: bytes = b""  # the same as PDF; then it is the file


@dataclass(frozen=True)
class Section:
    """A part of a report."""

    name: str  # of files and anchors
    title: str
    text: str  # subject and method
    items: tuple[Table | Picture, ...]


def name_items(section: Section) -> dict[str, Table | Picture]:
    """Return the items of a section by the names of their files: fig_7 for figure 7 of a paper, else NAME_1, …"""
    named: dict[str, Table | Picture] = {}
    for number, item in enumerate(section.items, 1):
        figure = re.match(r"Fig\. (\d+)(?: and (\d+))?", item.title)
        name = "_".join(("fig", *filter(None, figure.groups()))) if figure else f"{section.name}_{number}"
        named[f"{name}_{number}" if name in named else name] = item
    return named


def write_section(section: Section, folder: Path) -> None:
    """Write tables as NAME_1.csv, …, and pictures in their format."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, item in name_items(section).items():
        if isinstance(item, Picture):
            suffix = ".pdf" if item.paper else next(suffix for suffix, kind in KINDS.items() if kind == item.kind)
            (folder / f"{name}{suffix}").write_bytes(item.paper or item.content)
        else:
            write_csv(item, folder / f"{name}.csv")


def distinguish(sections: Sequence[Section]) -> list[Section]:
    """Return sections with different names: a number follows a name that occurs again."""
    seen: Counter[str] = Counter()
    named = []
    for section in sections:
        seen[section.name] += 1
        number = seen[section.name]
        named.append(section if number == 1 else replace(section, name=f"{section.name}_{number}"))
    return named


def write_table(table: Table, folder: Path, name: str) -> list[Path]:
    """Write a table as NAME.csv, and as NAME.json for `read_folders`; return the paths."""
    folder.mkdir(parents=True, exist_ok=True)
    plain, whole = folder / f"{name}.csv", folder / f"{name}.json"
    write_csv(table, plain)
    facts = {"title": table.title, "columns": table.columns, "note": table.note}
    head = "".join(f" {json.dumps(key)}: {json.dumps(value, ensure_ascii=False)},\n" for key, value in facts.items())
    rows = ",\n".join(f"  {json.dumps([*map(_drop_infinite, row)], ensure_ascii=False)}" for row in table.rows)
    whole.write_text(f'{{\n{head} "rows": [\n{rows}\n ]\n}}\n', encoding="utf-8")
    return [plain, whole]


def write_csv(table: Table, path: Path) -> None:
    """Write the columns and rows of a table."""
    with path.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file).writerows([table.columns, *table.rows])


def _drop_infinite(cell: Cell) -> Cell:
    """Replace the numbers that JSON does not have."""
    return None if isinstance(cell, float) and not math.isfinite(cell) else cell


@dataclass(frozen=True)
class Caption:
    """The caption of a file; where it is empty, the file has its own."""

    file: str  # its name: a picture, or a table's JSON
    title: str = ""
    note: str = ""


@dataclass(frozen=True)
class Outline:
    """The outline of a section: some files of a folder with captions, for a report that includes the folder."""

    name: str
    place: int  # among the sections of all folders
    title: str
    text: str  # subject and method
    items: tuple[Caption, ...]


def write_outline(outline: Outline, folder: Path) -> Path:
    """Write an outline as NAME.section.json; return the path."""
    path = folder / f"{_spell(outline.name)}{OUTLINE}"
    items = tuple(replace(item, file=in_format(Path(item.file)).name) for item in outline.items)
    path.write_text(
        json.dumps(asdict(replace(outline, items=items)), indent=1, ensure_ascii=False) + "\n", encoding="utf-8"
    )
    return path


def read_folders(folders: Sequence[Path]) -> list[Section]:
    """Read the tables (*.json) and pictures (*.png, *.svg) of folders.

    An outline lists the files of a section in their order. All other tables and pictures of a folder are one more
    section, except for NAME.svg and NAME_narrow.png beside NAME.png. A table has the keys title, columns, rows and
    optionally note; a list of objects is a table, too. Files of another form are ignored, since folders also hold
    records. Raises InputError for an unreadable folder, and for a folder without tables and pictures.
    """
    placed: list[tuple[int, Section]] = []
    for folder in folders:
        if not folder.is_dir():
            raise InputError([Fault(str(folder), 0, "", "it is not a folder", "give one with tables and pictures")])
        found = _read_sections(folder)
        if not found:
            raise InputError(
                [Fault(str(folder), 0, "", "it contains neither a table nor a picture", "give another folder")]
            )
        placed += found
    return [section for _, section in sorted(placed, key=lambda x: x[0])]


def _read_sections(folder: Path) -> list[tuple[int, Section]]:
    files = {path.name: path for path in sorted(folder.iterdir()) if _is_taken(path)}
    files = {name: path for name, path in files.items() if not _is_variant(path, files)}
    sections: list[tuple[int, Section]] = []
    for outline in _read_outlines(files):
        held = [(files.pop(caption.file), caption) for caption in outline.items if caption.file in files]
        items = tuple(_explain(item, caption) for path, caption in held if (item := _read_item(path)) is not None)
        if items:
            sections.append((outline.place, Section(_spell(outline.name), outline.title, outline.text, items)))
    rest = tuple(item for path in files.values() if (item := _read_item(path)) is not None)
    if rest:
        name = folder.resolve().name
        sections.append((LAST, Section(_spell(name), name.replace("_", " "), "", rest)))
    return sections


def _is_taken(path: Path) -> bool:
    return path.suffix in (*KINDS, ".json") and path.is_file() and path.stat().st_size <= LARGEST


def _is_variant(path: Path, names: Container[str]) -> bool:
    """Return whether a picture is NAME.svg or NAME_narrow.png beside NAME.png, which shows the same."""
    if path.suffix == ".svg":
        return f"{path.stem}.png" in names
    return path.stem.endswith(NARROW) and f"{path.stem.removesuffix(NARROW)}.png" in names


def _read_outlines(files: dict[str, Path]) -> list[Outline]:
    """Remove the outlines from the files of a folder, and return them."""
    outlines = []
    for name in [name for name in files if name.endswith(OUTLINE)]:
        with suppress(ValueError, ValidationError, RecursionError):
            outlines.append(_OUTLINE.validate_json(files[name].read_bytes()))
        del files[name]
    return outlines


def _read_item(path: Path) -> Table | Picture | None:
    if path.suffix in KINDS:
        return Picture(path.stem.replace("_", " "), KINDS[path.suffix], path.read_bytes())
    return _read_table(path)


def _explain(item: Table | Picture, caption: Caption) -> Table | Picture:
    return replace(item, title=caption.title or item.title, note=caption.note or item.note)


def _spell(name: str) -> str:
    """Return a name that is valid for files and anchors."""
    return re.sub(r"[^A-Za-z0-9]+", "_", name).strip("_") or "folder"


def _read_table(path: Path) -> Table | None:
    try:
        found = json.loads(path.read_bytes())
        return _list_points(path.stem, found) if isinstance(found, list) else _TABLE.validate_python(found)
    except (ValueError, ValidationError, RecursionError):
        return None


def _list_points(name: str, points: Sequence[Any]) -> Table | None:
    """Return a list of objects as a table; a nested object gets a column for each entry."""
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
_OUTLINE: TypeAdapter[Outline] = TypeAdapter(Outline)
