"""Tables of pages in Markdown."""

from __future__ import annotations

from collections.abc import Iterable, Sequence


def tabulate(titles: Sequence[str], rows: Iterable[Sequence[str]], words: int = 1) -> list[str]:
    """Return the lines of a table; its first columns hold words, the others numbers, which stand at the right."""
    rule = ["---"] * words + ["---:"] * (len(titles) - words)
    return [f"| {' | '.join(cells)} |" for cells in (titles, rule, *rows)]
