"""Imported -> the text of a model file, which begins with the notices."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator

from mbsgen.importing.choices import Imported
from mbsgen.model.writer import write_model

WIDTH = 118


def write_imported(imported: Imported) -> str:
    """Write a model file; before it, as comments, the changes and omissions."""
    lines = [*_comment(imported)]
    return "".join(f"{line}\n" for line in lines) + ("\n" if lines else "") + write_model(imported.model)


def _comment(imported: Imported) -> Iterator[str]:
    for text in (str(notice.without_folder()) for notice in imported.notices):
        clean = text.encode("unicode_escape").decode("ascii") if not text.isprintable() else text
        yield from textwrap.wrap(clean, WIDTH, initial_indent="# ", subsequent_indent="#   ", break_long_words=False)
