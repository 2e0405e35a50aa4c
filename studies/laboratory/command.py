"""The command `mbsrun lab`."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from pathlib import Path

import click
from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from mbsrun.commands.console import UNCUT, choose_format, show_progress
from studies.laboratory.case import Case, Finding, Verdict, judge
from studies.laboratory.cases import CASES
from studies.laboratory.maps import draw_maps, measure_maps
from studies.laboratory.runs import name_verdict, open_workspace, run_cases, write_findings
from studies.laboratory.stability import STEPS, describe_stability, measure_stability
from studies.laboratory.stability_map import draw_stability

NOT_MET = 1
MODELS = (".yaml", ".yml", ".json", ".urdf", ".xml", ".sdf", ".osim")

LAB_HELP = """Run the laboratory: CASES in which methods lose digits, diverge or mislead, each with its criterion.

\b
  mbsrun lab --list
  mbsrun lab F07 F13 --quick
  mbsrun lab models/double_pendulum.yaml --quick

Given a model file in place of CASES, it maps the stability of this model: the correct digits of each formulation near
the worst pose, for ratios of masses, and for steps of a motion, or the status that it returns.

Without CASES it runs all of them; `--list` prints them. The output folder keeps every finding at once, so an
interrupted run continues; another version of the program, or another compiler, measures anew.

\b
The output folder gets
  verdicts.csv, .json, .md      for each case and way the number closest to its bound, or furthest beyond
  findings.csv, findings.json   every number
  map_*.png, .csv, .json        lost digits: against the condition, over mass ratio and length, towards a lock
  laboratory.section.json       captions, with which `mbsrun study --with FOLDER` includes all of it
  findings.jsonl, losses.jsonl  all findings

\b
For a model file it gets
  stability.png, .svg           the map; stability_narrow.png is for a phone
  stability.csv, .json          every number
  *.jsonl                       all measurements

\b
Exit codes
  0   all criteria are met; for a model, no kernel returns fewer than three correct digits without a status
  1   some criteria are not met, a case did not end, or a kernel loses digits without a status
  2   a case does not exist, or the model cannot be accepted
"""


@click.command("lab", help=LAB_HELP)
@click.argument("names", metavar="[CASES | MODEL]...", nargs=-1)
@click.option(
    "-o",
    "--output",
    "out",
    type=click.Path(file_okay=False, path_type=Path),
    default="laboratory",
    help="The folder to write to; by default laboratory.",
)
@click.option("--list", "listed", is_flag=True, help="Print the cases and their criteria, and run nothing.")
@click.option("--quick", is_flag=True, help="Leave long trials out: chains of 20 and more, swing-ups.")
@click.option("--maps/--no-maps", default=None, help="Draw the maps; by default where all cases are run.")
@choose_format
@click.pass_context
def lab_command(
    context: click.Context, /, names: tuple[str, ...], out: Path, listed: bool, quick: bool, maps: bool | None
) -> None:
    """Run the cases, write the findings, and print the verdicts."""
    if names and _is_model(names[0]):
        context.exit(_map_stability(names, out, quick=quick))
    cases = _choose(names)
    if listed:
        _print_cases(cases)
        return
    written: list[Path] = []
    with show_progress() as report:
        findings = run_cases(cases, out, report, quick=quick)
        written += write_findings(cases, findings, out)
        if maps or (maps is None and not names):
            written += draw_maps(measure_maps(open_workspace(out), report, quick=quick), out)
    _print_verdicts(cases, findings)
    click.echo(f"wrote {', '.join(map(str, written))}", err=True)
    context.exit(0 if all(finding.is_met for finding in findings) else NOT_MET)


def _is_model(name: str) -> bool:
    return Path(name).suffix in MODELS or Path(name).exists()


def _map_stability(names: Sequence[str], out: Path, *, quick: bool) -> int:
    """Measure the stability of one model, draw the map, print the findings; return the exit code."""
    if len(names) > 1:
        raise click.UsageError(f"found {' '.join(names)}; give one model file, or names of cases")
    model = Path(names[0])
    with show_progress() as report:
        spots = measure_stability(model, out, report, quick=quick)
    written = draw_stability(model.stem, spots, out)
    for sentence in describe_stability(spots):
        click.echo(sentence)
    click.echo(f"wrote {', '.join(map(str, written))}", err=True)
    return NOT_MET if any(spot.is_silent and spot.sweep != STEPS for spot in spots) else 0


def _choose(names: Sequence[str]) -> list[Case]:
    known = {case.id: case for case in CASES}
    wanted = [name.upper() for name in names]
    strange = [name for name in wanted if name not in known]
    if strange:
        told = f"there is no case {', '.join(strange)}; there are {', '.join(known)}, or give a model file"
        raise click.UsageError(told)
    return [case for case in CASES if not wanted or case.id in wanted]


def _print_cases(cases: Sequence[Case]) -> None:
    table = Table(box=box.SIMPLE)
    for column in ("case", "what is done", "what is demanded"):
        table.add_column(column, overflow="fold")
    for case in cases:
        exempt = f" Does not apply: {case.exemption}" if case.exemption else ""
        table.add_row(case.id, Text(f"{case.title}. {case.setup}"), Text(case.criterion + exempt))
    _console().print(table)


def _print_verdicts(cases: Sequence[Case], findings: Sequence[Finding]) -> None:
    table = Table(box=box.SIMPLE)
    for column in ("case", "way", "closest to its bound"):
        table.add_column(column, overflow="fold")
    for column in ("value", "bound"):
        table.add_column(column, justify="right", overflow="fold")
    for column in ("in", "met", ""):
        table.add_column(column, overflow="fold")
    verdicts = judge(findings)
    for case in cases:
        own = [x for x in verdicts if x.case == case.id]
        for number, verdict in enumerate(own):
            table.add_row(f"{case.id} {case.title}" if number == 0 else "", *map(Text, _list_cells(verdict)))
    console = _console()
    console.print(table)
    for finding in findings:
        if not finding.is_met:
            console.print(
                f"not met: {finding.case}, {finding.trial}, {finding.way}: {finding.quantity} {_write(finding.value)} "
                f"against {_write(finding.bound)}; {finding.remark}",
                markup=False,
            )


def _list_cells(verdict: Verdict) -> tuple[str, ...]:
    return (
        verdict.way,
        verdict.quantity,
        _write(verdict.value),
        _write(verdict.bound),
        verdict.trial,
        f"{verdict.met} of {verdict.total}",
        name_verdict(verdict),
    )


def _write(value: float | None) -> str:
    return "-" if value is None else f"{value:.2g}"


def _console() -> Console:
    """Return stdout with the width of COLUMNS, else of the terminal; lines are long without both."""
    return Console(highlight=False, width=shutil.get_terminal_size((UNCUT, 24)).columns)
