"""Write sections of a report as a page in Markdown, with pictures beside it and all tables as CSV in one archive.

The same sections give the same bytes.
"""

from __future__ import annotations

import io
import lzma
import tarfile
from collections.abc import Sequence
from pathlib import Path

from mbsrun.measuring.sections import KINDS, Cell, Picture, Section, Table, name_items, write_section

PAGE, ARCHIVE = "README.md", "tables.tar.xz"
LONGEST = 40  # rows of a table that the page shows


def write_page(title: str, introduction: Sequence[str], sections: Sequence[Section], folder: Path) -> Path:
    """Write README.md and the pictures of the sections to a folder; return the page's path."""
    folder.mkdir(parents=True, exist_ok=True)
    lines = [f"# {title}", ""]
    for text in introduction:
        lines += [text, ""]
    for section in sections:
        lines += [f"## {section.title}", ""]
        lines += [section.text, ""] if section.text else []
        for name, item in name_items(section).items():
            lines += _write_item(item, name, folder)
    path = folder / PAGE
    path.write_text("\n".join(lines).rstrip() + "\n", encoding="utf-8")
    return path


def _write_item(item: Table | Picture, name: str, folder: Path) -> list[str]:
    lines = [f"**{item.title}.** {item.note}".rstrip(), ""]
    if isinstance(item, Picture):
        suffix = next(suffix for suffix, kind in KINDS.items() if kind == item.kind)
        (folder / f"{name}{suffix}").write_bytes(item.content)
        return [*lines, f"![{item.title}]({name}{suffix})", ""]
    if len(item.rows) > LONGEST or item.is_folded:
        return [*lines, f"The table has {len(item.rows)} rows: `{name}.csv` in [{ARCHIVE}]({ARCHIVE}).", ""]
    head = [_write_row(item.columns), "|" + "|".join(_align(item, k) for k in range(len(item.columns))) + "|"]
    return [*lines, *head, *map(_write_row, item.rows), ""]


def _align(table: Table, column: int) -> str:
    """Return the mark that aligns a column of numbers to the right."""
    is_text = any(isinstance(row[column], str) for row in table.rows)
    return "---" if is_text else "---:"


def _write_row(cells: Sequence[Cell]) -> str:
    return "| " + " | ".join(_write_cell(cell) for cell in cells) + " |"


def _write_cell(cell: Cell) -> str:
    if cell is None:
        return ""
    return f"{cell:.6g}" if isinstance(cell, float) else str(cell).replace("|", "\\|").replace("\n", " ")


def write_archive(sections: Sequence[Section], others: Sequence[Path], path: Path, scratch: Path) -> Path:
    """Write the tables of the sections, and other files, as one archive; `scratch` holds the CSV files."""
    for section in sections:
        write_section(section, scratch)
    whole = io.BytesIO()
    with tarfile.open(fileobj=whole, mode="w", format=tarfile.USTAR_FORMAT) as archive:
        for file in sorted({*scratch.glob("*.csv"), *others}, key=lambda file: file.name):
            content = file.read_bytes()
            entry = tarfile.TarInfo(file.name)
            entry.size = len(content)
            archive.addfile(entry, io.BytesIO(content))
    path.write_bytes(lzma.compress(whole.getvalue(), preset=9 | lzma.PRESET_EXTREME))
    return path
