"""Figures of the benchmarks -> the parts of the README that show them; `python -m benchmarks.readme`."""

from __future__ import annotations

import re
import textwrap
from pathlib import Path

import click

from benchmarks.headlines import write_headlines

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "benchmarks" / "results"
SUMMARY = RESULTS / "summary.md"
TABLE, HEADLINES = "summary.md", "headlines"  # the parts
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
    """Fill both parts: the sentences about single benchmarks, and the table of all."""
    headlines = "\n\n".join(map(_wrap, link(write_headlines(RESULTS)).split("\n\n")))
    return fill(fill(readme, HEADLINES, headlines), TABLE, link(SUMMARY.read_text(encoding="utf-8")))


def link(text: str) -> str:
    """Return a text of the folder of results with links that lead there from the README."""
    return re.sub(r"\]\((?![a-z]+:|#)", "](benchmarks/results/", text)


def _wrap(paragraph: str) -> str:
    return textwrap.fill(paragraph, WIDTH, break_long_words=False, break_on_hyphens=False)


@click.command()
def main() -> None:
    """Show the figures of the benchmarks in the README."""
    readme = ROOT / "README.md"
    readme.write_text(fill_all(readme.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    main()
