"""`mbsrun continue`: a problem, a number and a value -> the solution there, by way of neighbours."""

from __future__ import annotations

import csv
import math
from dataclasses import astuple, fields
from pathlib import Path
from typing import TYPE_CHECKING

import click

from mbsrun.commands.console import NOT_SOLVED, NumberType, list_written, output_folder, say, show_status
from mbsrun.commands.failures import print_failure
from mbsrun.ocp.showing.summary import write_line

if TYPE_CHECKING:
    from mbsrun.optimal.continuation import Stop

WAY = "way.csv"

HELP = """Solve PROBLEM, and go on to another value of one of its numbers.

A problem that cannot be solved from its guess can often be reached from an easier one: solve it with a stronger motor
or a nearer target, and let this number move to its value step by step. Each solve starts from a prediction of the
solution, whose error determines the length of the next step. Every motion is integrated again:

\b
  mbsrun continue models/cart_pole_swing_up.ocp.yaml --number end.pose.cart --to 1.6

\b
The output folder gets the files of `mbsrun solve` for the last motion, and
  way.csv             every solve: value, status, cost, iterations, error of the prediction, defect

\b
Exit codes
  0   the value is reached
  1   the value is not reached, or the first solve failed; the last motion found is written
  2   the problem or an argument cannot be accepted; nothing written
"""


@click.command("continue", help=HELP)
@click.argument("file", metavar="PROBLEM", type=click.Path(path_type=Path))
@click.option(
    "--number", required=True, metavar="NUMBER", help="The number, by its place in the file, such as constants.kerb."
)
@click.option("--to", "value", required=True, type=NumberType(), help="The final value of the number.")
@click.option(
    "--guess",
    type=click.Path(path_type=Path),
    metavar="SOLUTION",
    help="A solution.json from which the first solve starts.",
)
@output_folder("continued")
@click.pass_context
def continue_command(
    context: click.Context, /, file: Path, number: str, value: float, guess: Path | None, out: Path | None
) -> None:
    """Read, follow, write, print."""
    from mbsrun.ocp.problem.phases import Plants
    from mbsrun.ocp.showing.files import write_files  # here, and late: these take long to load
    from mbsrun.ocp.solution.phases import list_solution
    from mbsrun.optimal.control import read_problem
    from mbsrun.optimal.result import Solved, Unsolved

    control = read_problem(file)
    control.check_numbers([number])
    out = out or Path(f"{control.name}.continued")
    with show_status("solving") as status:

        def show(stop: Stop) -> None:
            line = f"{number} = {stop.value:.8g}: {stop.status}"
            if stop.is_taken:
                line += f", cost {stop.cost:.8g}, {stop.iterations} iterations"
                line += "" if math.isnan(stop.error) else f", predicted to {stop.error:.1e}"
            click.echo(line if stop.is_taken else f"{line}; a shorter step follows")
            status.update("going on")

        found = control.continue_to(number, value, guess=guess, watch=show)
    if isinstance(found.solution, Unsolved):
        print_failure(found.solution.failure, file, out)
        context.exit(NOT_SOLVED)
    single = isinstance(found.solution, Solved)
    outcome = list_solution(found.solution.solution) if single else found.solution.solution
    written = write_files(outcome, Plants((found.solution.plant,)) if single else found.solution.plants, out)
    _write_way(found.stops, out / WAY)
    click.echo(write_line("status", f"{found.status}: {found.reason}", 14))
    click.echo(write_line("value", f"{found.value:.10g}", 14))
    say(f"wrote {list_written(out, (*written, WAY))}")
    shortcomings = found.solution.shortcomings
    for shortcoming in shortcomings:
        say(f"warning: {shortcoming}")
    context.exit(NOT_SOLVED if shortcomings or not found.is_reached else 0)


def _write_way(stops: tuple[Stop, ...], path: Path) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        table.writerow([part.name for part in fields(stops[0])])
        table.writerows(astuple(stop) for stop in stops)
