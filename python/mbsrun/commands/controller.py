"""`mbsrun controller`: a problem file -> a folder of C that solves it, to a tolerance or in real time."""

from __future__ import annotations

from pathlib import Path

import click

from mbsgen.documents import read_document, refuse
from mbsrun.commands.console import NOT_SOLVED, keep_grid, output_folder, say, show_status
from mbsrun.controllers.making import Made, UnsolvedError, describe_name, make
from mbsrun.controllers.refusals import find_refusals, locate
from mbsrun.external import Mechanism, OnDemand, load_on_demand
from mbsrun.ocp.guessing.recorded import find_guess
from mbsrun.ocp.solving.placing import name_lines
from mbsrun.ocp.statement.statement import name_problem, read_problem

CONTROLLER_HELP = """Write a model predictive controller for the problem of the file PROBLEM, in C.

The folder has all that the controller needs: the kernels of its model, the problem as tables, a solver. It is C99 and
needs only the C library; it allocates no memory, and runs where there is no operating system. Start, targets,
bounds, weights, constants and masses can change while it runs. From Python, mbsrun.controller("DIR") loads it.

\b
The output folder gets
  NAME.h, NAME.c      the interface
  NAME_tables.c       the problem
  NAME_main.c         an example: solves, then controls the model for 50 periods
  NAME_check.c        solves, and compares the optimum with the one known
  CMakeLists.txt      builds, tests and installs it; NAME.pc is for pkg-config
  report.md           memory, operations of an iteration, the largest stack
  manifest.json       names, units and values of all data that can change

Before anything is written, the controller solves the problem from its guess.

\b
Exit codes
  0   written
  1   the controller does not solve its own problem; nothing written
  2   the problem, its model or an argument cannot be accepted; nothing written
"""


@click.command("controller", help=CONTROLLER_HELP)
@click.argument("file", metavar="PROBLEM", type=click.Path(path_type=Path))
@output_folder("controller")
@click.option(
    "--guess",
    "other",
    type=click.Path(path_type=Path),
    metavar="SOLUTION",
    help="A solution.json of mbsrun solve to start from, in place of the guess that the problem describes.",
)
@click.option(
    "--prefix",
    metavar="NAME",
    help="Let names in C begin with NAME; by default, the problem's name. Two controllers of one "
    "name need it to be called from one C file.",
)
@click.option(
    "--emulate",
    "emulated",
    is_flag=True,
    help="Run it in single precision on a Cortex-M7 that QEMU emulates; the report shows instructions, memory and "
    "stack. Needs arm-none-eabi-gcc and qemu-system-arm.",
)
@click.pass_context
@name_lines
def controller_command(
    context: click.Context, /, file: Path, out: Path | None, other: Path | None, *, prefix: str | None, emulated: bool
) -> None:
    """Read, make, write, print."""
    from mbsgen.output import check_folder, write_folder

    models: list[Path] = []

    def load_model(model: Path) -> Mechanism | OnDemand:
        models.append(model)
        return load_on_demand(model)

    out = out or Path(f"{name_problem(file)}.controller")
    check_folder(out)  # before minutes of work
    problem, plant = read_problem(file, load_model)
    problem = keep_grid(problem)
    refusals = find_refusals(problem, plant.manifest)
    if refusals:
        raise refuse(locate(refusals, read_document(file)))
    if other is None and problem.guess.solution is not None:
        other = file.parent / problem.guess.solution
    guess = None if other is None else find_guess(other, problem, plant)
    try:
        with show_status("making the controller"):
            made = make(problem, plant, models[-1], guess, prefix=prefix, emulated=emulated)
    except UnsolvedError as error:
        say(f"{file}: {error}")
        context.exit(NOT_SOLVED)
    write_folder(made.files, out)
    if notice := describe_name(made):
        say(f"note: {notice}")
    _print_summary(made, out)


def _print_summary(made: Made, out: Path) -> None:
    manifest, result = made.manifest, made.result
    rows = {
        "controller": f"{manifest.prefix}, of {len(manifest.states)} states and {len(manifest.inputs)} inputs, "
        f"{manifest.intervals} intervals",
        "solves": f"its problem in {result.iterations} iterations, cost {manifest.cost:.7g}",
        "memory": f"{manifest.memory.double} bytes, in single precision {manifest.memory.single}",
        "data": ", ".join(f"{field.name} ({field.size})" for field in manifest.data),
    }
    if manifest.numbers:
        rows["numbers"] = ", ".join(f"{name} = {x:.7g}" for name, x in manifest.numbers.items())
    for name, value in rows.items():
        click.echo(f"{name:<12}{value}")
    say(f"wrote {out}")
