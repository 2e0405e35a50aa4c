"""`mbsgen report`: the cost of a model, in flops and equations."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Sequence
from pathlib import Path

import click

from mbsgen.commands.console import show_progress
from mbsgen.commands.importing import MODEL, importing, read_model
from mbsgen.help import ModelCommand
from mbsgen.importing import Choices
from mbsgen.pipeline import Options, make
from mbsgen.report import (
    COLUMNS,
    COMPARISON,
    DIFFERENTIATION,
    NOTE,
    WAYS,
    Report,
    Section,
    comparisons,
    note_of_scene,
    sections,
    tables_of_scene,
    ways_taken,
    write_json,
    write_markdown,
)


@click.command("report", cls=ModelCommand)
@MODEL
@click.option("--json", "form", flag_value="json", help="Print report.json.")
@click.option("--markdown", "form", flag_value="markdown", help="Print report.md.")
@click.option("--compare", is_flag=True, help="Also count without each reduction, and all derivatives.")
@importing
def report_command(model: Path, form: str | None, compare: bool, choices: Choices) -> None:
    """Count the operations of MODEL's functions."""
    source = read_model(model, choices)
    with show_progress() as tell:
        report = make(source, Options(compare=compare), tell).report
    if form is None:
        print_report(report)
    else:
        click.echo(write_json(report) if form == "json" else write_markdown(report), nl=False)


def print_report(report: Report, note: str = NOTE) -> None:
    """Print the cost of a model on stdout: tables with the same columns, and a note on them."""
    cells = [
        (name, *map(str, cost.row)) for s in sections(report) for costs in s.groups for name, cost in costs.items()
    ]
    widths = [max(map(len, column)) for column in zip(("", *COLUMNS), *cells, strict=True)]
    for section in sections(report):
        click.echo(f"{section.title}: {report.model}\n")
        click.echo("\n".join(_lay_out(section, widths)) + "\n")
    if rows := comparisons(report):
        click.echo(f"{COMPARISON}: {report.model}\n")
        first = max(map(len, rows))
        click.echo("  ".join(("".ljust(first), *(name.rjust(6) for name in report.formulations))))
        click.echo("-" * (first + 8 * len(report.formulations)))
        for title, row in rows.items():
            click.echo("  ".join((title.ljust(first), *(str(row[name]).rjust(6) for name in report.formulations))))
        click.echo("")
    _print_ways(report)
    click.echo(textwrap.fill(note, 79))


def _print_ways(report: Report) -> None:
    for title, header, table in tables_of_scene(report):
        widths = [max(len(row[k]) for row in (header, *table)) for k in range(len(header))]
        click.echo(f"{title}: {report.model}\n")
        for row in (header, *table):
            click.echo("  ".join((row[0].ljust(widths[0]), *map(str.rjust, row[1:], widths[1:]))).rstrip())
        click.echo("")
    if note := note_of_scene(report):
        click.echo(textwrap.fill(note, 79) + "\n")
    if not report.ways:
        return
    rows = ways_taken(report)
    first = max(map(len, rows))
    click.echo(f"{DIFFERENTIATION}: {report.model}\n")
    for title, cells in {"": WAYS, **rows}.items():
        click.echo("  ".join((title.ljust(first), *(cell.rjust(9) for cell in cells))).rstrip())
    click.echo("")


def _lay_out(section: Section, widths: Sequence[int]) -> Iterator[str]:
    """Arrange a table in columns; a blank line separates groups of several rows."""

    def line(*cells: str) -> str:
        return "  ".join((cells[0].ljust(widths[0]), *map(str.rjust, cells[1:], widths[1:])))

    yield line("", *COLUMNS)
    yield "-" * len(line("", *COLUMNS))
    before = 1
    for costs in section.groups:
        if max(before, len(costs)) > 1 and costs is not section.groups[0]:
            yield ""
        before = len(costs)
        yield from (line(name, *map(str, cost.row)) for name, cost in costs.items())
