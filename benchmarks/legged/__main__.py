"""Measure: `python -m benchmarks.legged`; tables to the terminal, a page to build/bench-legged."""

from __future__ import annotations

import sys
from pathlib import Path

import click
from rich.console import Console

from benchmarks.compilation import describe_machine
from benchmarks.legged.cases import CASES
from benchmarks.legged.measuring import UnsolvedError, measure_case
from benchmarks.legged.table import make_tables, write_page
from mbsgen.errors import MbsError

SAME = 1e-6  # relative difference of costs within which two optima are one


@click.command()
@click.argument("names", nargs=-1, type=click.Choice(list(CASES)))
@click.option("-o", "--out", default=Path("build/bench-legged"), type=click.Path(file_okay=False, path_type=Path))
@click.option("--rounds", default=3, show_default=True, type=click.IntRange(min=1))
def main(names: tuple[str, ...], out: Path, rounds: int) -> None:
    """Compare problems in phases with plain CasADi; by default all."""
    console = Console(width=None if sys.stdout.isatty() else 200)
    rows = []
    try:
        for name in names or CASES:
            with console.status(name):
                rows.append(measure_case(name, CASES[name], rounds))
    except (MbsError, UnsolvedError) as error:
        raise click.ClickException(str(error)) from None
    for table in make_tables(rows):
        console.print(table)
    out.mkdir(parents=True, exist_ok=True)
    (out / "legged.md").write_text(write_page(rows, describe_machine(), rounds), encoding="utf-8")
    console.print(f"{out / 'legged.md'} holds the tables.")
    for row in rows:
        if row.expanded.is_solved and row.ours.cost - row.expanded.cost > SAME * abs(row.expanded.cost):
            raise click.ClickException(f"{row.name}: plain CasADi finds a better optimum")


if __name__ == "__main__":
    main()
