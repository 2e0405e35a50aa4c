"""Write sections as one page of HTML that needs no network and no other file.

Names and tables come from files, so the page only shows them: the template escapes text, pictures are images and run no
script, and the policy of the page admits only the script that sorts tables.
"""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from mbsgen import resources
from mbsrun.measuring.sections import LONG, Cell, Picture, Section, Table

SHORT = 24  # characters of a cell on one line


@dataclass(frozen=True)
class _Cell:
    style: str
    value: str  # to sort by
    text: str


@dataclass(frozen=True)
class _Sheet:
    title: str
    note: str
    columns: tuple[str, ...]
    rows: tuple[tuple[_Cell, ...], ...]
    is_folded: bool


@dataclass(frozen=True)
class _Image:
    title: str
    note: str
    kind: str
    content: str  # base64


@dataclass(frozen=True)
class _Part:
    anchor: str
    title: str
    text: str
    pictures: tuple[_Image, ...]
    tables: tuple[_Sheet, ...]


def render_page(
    title: str,
    introduction: Sequence[str],
    sections: Sequence[Section],
    styles: Mapping[str, str] = MappingProxyType({}),
) -> str:
    """Return the page; the same sections give the same text.

    `styles` gives a class of the template's style sheet for a cell's text: a verdict has its colour.
    """
    return fill_in(
        "report",
        title=title,
        introduction=introduction,
        sections=[_lay_out(section, number, styles) for number, section in enumerate(sections, 1)],
    )


def fill_in(name: str, **values: object) -> str:
    """Fill in a page of `templates/html`, which holds its own script, and names the script's hash."""
    folder = resources.folder("templates") / "html"
    environment = Environment(
        loader=FileSystemLoader(folder),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    script = (folder / f"{name}.js").read_text(encoding="utf-8")
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode("ascii")
    page = environment.get_template(f"{name}.html")
    return page.render(script=Markup(script), script_hash=f"sha256-{digest}", **values)


def _lay_out(section: Section, number: int, styles: Mapping[str, str]) -> _Part:
    pictures = tuple(
        _Image(item.title, item.note, item.kind, base64.b64encode(item.content).decode("ascii"))
        for item in section.items
        if isinstance(item, Picture)
    )
    tables = tuple(
        _Sheet(
            item.title,
            item.note,
            item.columns,
            tuple(tuple(_write(cell, styles) for cell in row) for row in item.rows),
            item.is_folded or len(item.rows) > LONG,
        )
        for item in section.items
        if isinstance(item, Table)
    )
    return _Part(f"part{number}", section.title, section.text, pictures, tables)


def _write(cell: Cell, styles: Mapping[str, str]) -> _Cell:
    if cell is None:
        return _Cell("number", "", "–")
    if isinstance(cell, bool | str):
        style = styles.get(str(cell), "short" if len(str(cell)) <= SHORT else "text")
        return _Cell(style, str(cell), str(cell))
    return _Cell("number", repr(cell), str(cell) if isinstance(cell, int) else f"{cell:.6g}")
