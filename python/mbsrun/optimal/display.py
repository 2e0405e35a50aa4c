"""Displays of a notebook: tables in HTML, pictures as PNG, pages in a frame. Names and texts are escaped."""

from __future__ import annotations

import io
from collections.abc import Mapping
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING

from mbsgen.style import save_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

WIDTH = 14  # the least, of the names of a text's lines
DOTS = 100  # an inch, of a picture in a notebook


def write_text(title: str, rows: Mapping[str, str]) -> str:
    """Return a title and rows as lines of text."""
    width = max([WIDTH, *map(len, rows)]) + 2
    return "\n".join([title, *(f"  {name:<{width}}{value}" for name, value in rows.items())])


def write_table(title: str, rows: Mapping[str, str], notes: tuple[str, ...] = ()) -> str:
    """Return a title, rows and notes as HTML."""
    cells = "".join(
        f'<tr><th style="text-align:left">{escape(name.strip())}</th>'
        f'<td style="text-align:left">{escape(value)}</td></tr>'
        for name, value in rows.items()
    )
    below = "".join(f"<p>{escape(note)}</p>" for note in notes)
    return f"<div><strong>{escape(title)}</strong><table>{cells}</table>{below}</div>"


@dataclass(frozen=True, eq=False)
class Picture:
    """A figure of matplotlib that a notebook shows."""

    figure: Figure

    def save(self, path: str | Path) -> None:
        """Write the picture; the ending of the name gives the format."""
        save_figure(self.figure, Path(path))

    def _repr_png_(self) -> bytes:
        stream = io.BytesIO()
        self.figure.savefig(stream, format="png", dpi=DOTS, metadata={"Software": None})
        return stream.getvalue()


@dataclass(frozen=True, eq=False)
class Page:
    """A page of HTML, with a script, that a notebook shows in a frame."""

    text: str
    height: int = 520

    def __repr__(self) -> str:
        return f"Page({len(self.text)} characters)"

    def save(self, path: str | Path) -> None:
        """Write the page."""
        Path(path).write_text(self.text, encoding="utf-8")

    def _repr_html_(self) -> str:
        source = escape(self.text)
        style = f"width:100%;height:{self.height}px;border:0"
        return f'<iframe sandbox="allow-scripts" srcdoc="{source}" style="{style}"></iframe>'
