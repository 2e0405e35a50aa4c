"""Figures of the benchmarks -> the README's sentences and chart, and a page of all; `python -m benchmarks.readme`."""

from __future__ import annotations

import re
import textwrap
from pathlib import Path

import click

from benchmarks.front import draw_front, draw_narrow, list_bars, write_front
from benchmarks.headlines import write_headlines

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "benchmarks" / "results"
TABLE, OVERVIEW, CHART, NARROW = "summary.md", "overview.md", "faster.png", "faster_narrow.png"
HEADLINES = "headlines"  # the part of the README
END = "<!-- end -->"
WIDTH = 120


def fill(readme: str, part: str, text: str) -> str:
    """Put a text between the marks of a part of a README."""
    begin = f"<!-- begin: benchmarks/results/{part} -->"
    before, _, rest = readme.partition(begin)
    _, mark, after = rest.partition(END)
    if not mark:
        raise ValueError(f"the README has no {begin} with an {END} after it")
    return f"{before}{begin}\n\n{text.strip()}\n\n{END}{after}"


def fill_all(readme: str) -> str:
    """Fill the sentences of the front page."""
    sentences = map(_wrap, link(write_front(list_bars(RESULTS))).split("\n"))
    return fill(readme, HEADLINES, "\n".join(sentences))


def write_overview() -> str:
    """Write the page of all figures: sentences about single benchmarks, and the table of kernels."""
    headlines = "\n\n".join(map(_wrap, write_headlines(RESULTS).split("\n\n")))
    table = (RESULTS / TABLE).read_text(encoding="utf-8").strip()
    picture = f"![Times faster than the quickest peer, by kind of work]({CHART})"
    return f"# Figures at a glance\n\n{picture}\n\n{headlines}\n\n## Kernels\n\n{table}\n"


def link(text: str) -> str:
    """Return a text of the folder of results with links that lead there from the README."""
    return re.sub(r"\]\((?![a-z]+:|#)", "](benchmarks/results/", text)


def _wrap(paragraph: str) -> str:
    indent = "  " if paragraph.startswith("- ") else ""
    return textwrap.fill(paragraph, WIDTH, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False)


@click.command()
def main() -> None:
    """Show the figures of the benchmarks in the README, and all of them on one page."""
    readme = ROOT / "README.md"
    (RESULTS / OVERVIEW).write_text(write_overview(), encoding="utf-8")
    draw_front(list_bars(RESULTS), RESULTS / CHART)
    draw_narrow(list_bars(RESULTS), RESULTS / NARROW)
    readme.write_text(fill_all(readme.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    main()
