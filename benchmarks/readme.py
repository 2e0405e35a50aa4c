"""The benchmarks' summary -> the part of the README that shows it; `python -m benchmarks.readme`."""

from __future__ import annotations

import re
from pathlib import Path

import click

ROOT = Path(__file__).parents[1]
SUMMARY = ROOT / "benchmarks" / "results" / "summary.md"
BEGIN, END = "<!-- begin: benchmarks/results/summary.md -->", "<!-- end -->"


def fill(readme: str, summary: str) -> str:
    """Put a summary between the marks of a README; its links then lead from there."""
    linked = re.sub(r"\]\((?![a-z]+:|#)", "](benchmarks/results/", summary)
    before, _, rest = readme.partition(BEGIN)
    _, mark, after = rest.partition(END)
    if not mark:
        raise ValueError(f"the README has no {BEGIN} with an {END} after it")
    return f"{before}{BEGIN}\n\n{linked.strip()}\n\n{END}{after}"


@click.command()
def main() -> None:
    """Show the summary of the benchmarks in the README."""
    readme = ROOT / "README.md"
    readme.write_text(fill(readme.read_text(encoding="utf-8"), SUMMARY.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    main()
