"""The command line `mbsrun`: a problem file in; a solution, its pictures and a summary out."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import click
from rich import box, filesize
from rich.console import Console
from rich.table import Table
from rich.text import Text

from mbsgen.errors import MbsError
from mbsgen.expressions import FLOATS, ExpressionError, evaluate, parse
from mbsrun.cache import Entry, cache_folder, list_entries, remove
from mbsrun.external import load
from mbsrun.ocp.pictures import draw_mechanism, plot_trajectories
from mbsrun.ocp.plant import Plant
from mbsrun.ocp.problem import Problem, cylindrical
from mbsrun.ocp.resimulation import resimulate
from mbsrun.ocp.solution import Failure, Solution, write_solution
from mbsrun.ocp.solve import Progress, solve
from mbsrun.ocp.statement import read_problem

NOT_SOLVED = 1  # exit codes; 0 is a solution as accurate as the problem asks for
BAD_INPUT = 2

SOLUTION = "solution.json"
TRAJECTORIES = "trajectories.png"
MECHANISM = "mechanism.png"
FILES = (SOLUTION, TRAJECTORIES, MECHANISM)

DAY = 86400.0  # s
UNCUT = 200  # characters in a line where nobody sees a terminal's width
KINDS = {"generated": "generated", "object": "objects", "library": "libraries", "unfinished": "unfinished"}

MESSAGES = Console(stderr=True)

HELP = """Solve optimal control problems of multibody systems.

\b
  mbsrun solve PROBLEM -o DIR   solve, and write solution and pictures to DIR
  mbsrun cache                  tell what was generated and compiled, or clear it

PROBLEM is a YAML file; models/ holds an example. Summaries go to stdout, progress and messages to stderr.
"""

SOLVE_HELP = """Solve the optimal control problem of the file PROBLEM.

It is put on a grid by direct collocation, and solved by IPOPT with the exact derivatives of the generated kernels. The
motion under the inputs found is then integrated by another method, and the two are compared.

\b
The output folder gets
  solution.json       the problem, what the solver did, every number of the trajectory
  trajectories.png    coordinates, velocities and inputs over time
  mechanism.png       the mechanism on its way

\b
Exit codes
  0   solved, and as accurate as the problem asks for
  1   not solved, and nothing written; or solved, but short of the tolerance or
      the accuracy asked for: then the solution is written, and says so
  2   the problem, its model or an argument cannot be accepted; nothing written
"""


CACHE_HELP = """Tell what was generated and compiled for `mbsrun`, or remove it.

What is removed is made again when it is needed; what another process is making now stays.
"""


class NumberType(click.ParamType[float]):
    """A number, or an expression such as pi/2."""

    name = "number"

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Read one number of an argument."""
        try:
            return value if isinstance(value, float) else evaluate(parse(str(value)), {}, FLOATS)
        except ExpressionError as error:
            self.fail(str(error), param, ctx)


@click.group(help=HELP, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.version_option(package_name="mbsgen", prog_name="mbsrun")
def cli() -> None:
    """Solve optimal control problems: `mbsrun`."""


@cli.command("solve", help=SOLVE_HELP)
@click.argument("file", metavar="PROBLEM", type=click.Path(path_type=Path))
@click.option(
    "-o",
    "--output",
    "out",
    type=click.Path(file_okay=False, path_type=Path),
    help="The folder to write to; by default NAME.solution here, for a problem file NAME.ocp.yaml.",
)
@click.option(
    "--target",
    type=NumberType(),
    nargs=3,
    metavar="R PHI Z",
    help="Another target for the sensor that the problem has a target for: radius [m], azimuth [rad] and height [m] "
    "about the base's z axis. Expressions will do: --target 0.63 pi/2 -0.1",
)
@click.pass_context
def solve_command(
    context: click.Context, file: Path, out: Path | None, target: tuple[float, float, float] | None
) -> None:
    """Read, solve, re-simulate, write, tell."""
    problem, plant = read_problem(file, load)
    if target is not None:
        problem = _retarget(problem, target)
    out = out or Path(f"{problem.name}.solution")
    with MESSAGES.status("making the program") as status:

        def show(progress: Progress) -> None:
            status.update(
                f"iteration {progress.iteration}: cost {progress.cost:.8g}, violation {progress.violation:.1e}"
            )

        outcome = solve(problem, plant, show)
        if isinstance(outcome, Solution):
            status.update("integrating again")
            outcome = resimulate(outcome, plant)
            status.update("drawing")
            _write(outcome, plant, out)
    if isinstance(outcome, Failure):
        _tell_failure(outcome, out)
        context.exit(NOT_SOLVED)
    _print_summary(outcome)
    _say(f"wrote {', '.join(str(out / name) for name in FILES)}")
    shortcomings = _list_shortcomings(outcome)
    for shortcoming in shortcomings:
        _say(f"warning: {shortcoming}")
    context.exit(NOT_SOLVED if shortcomings else 0)


@cli.command("cache", help=CACHE_HELP)
@click.option("--clear", is_flag=True, help="Remove all of it.")
@click.option(
    "--older-than",
    "days",
    metavar="DAYS",
    type=click.FloatRange(min=0),
    help="Remove what was not used for so many days.",
)
def cache_command(clear: bool, days: float | None) -> None:
    """List the cache by model; remove entries."""
    if clear and days is not None:
        raise click.UsageError("--clear removes everything; give it, or --older-than, but not both")
    place = cache_folder(os.environ)
    entries = list_entries(place)
    if not clear and days is None:
        _print_cache(place, entries)
        return
    now = time.time()
    chosen = [e for e in entries if (clear or now - e.used > DAY * (days or 0.0)) and not e.is_being_made(now)]
    remove(chosen)
    click.echo(f"removed {len(chosen)} of {_count(entries)}, {filesize.decimal(sum(e.size for e in chosen))}")


def main() -> None:
    """Run the command line; a user's errors are told without a traceback."""
    try:
        cli()
    except MbsError as error:
        _say(str(error))
        sys.exit(BAD_INPUT)
    except OSError as error:
        _say(f"{error.filename}: {error.strerror}" if error.filename else str(error))
        sys.exit(BAD_INPUT)


def _print_cache(place: Path, entries: Sequence[Entry]) -> None:
    """Print a line for each model, and one for what is no model's."""
    table = Table(box=box.SIMPLE)
    table.add_column("model")
    for column in (*KINDS.values(), "size", "last used"):
        table.add_column(column, justify="right")
    for model in sorted({entry.model for entry in entries}):
        own = [entry for entry in entries if entry.model == model]
        counts = (sum(entry.kind == kind for entry in own) for kind in KINDS)
        last = time.strftime("%Y-%m-%d %H:%M", time.localtime(max(entry.used for entry in own)))
        table.add_row(Text(model or "-"), *map(str, counts), filesize.decimal(sum(e.size for e in own)), last)
    out = Console(highlight=False, width=None if sys.stdout.isatty() else UNCUT)
    if entries:
        out.print(table)
    out.print(Text(f"{_count(entries)}, {filesize.decimal(sum(e.size for e in entries))}, in {place}"), soft_wrap=True)


def _count(entries: Sequence[Entry]) -> str:
    return f"{len(entries)} {'entry' if len(entries) == 1 else 'entries'}"


def _retarget(problem: Problem, target: tuple[float, float, float]) -> Problem:
    sensors = [name for name, _ in problem.end.sensors]
    if len(sensors) != 1:
        raise click.BadParameter(
            f"the problem has targets for {', '.join(sensors) or 'no sensor'}; it must have one for one sensor",
            param_hint="--target",
        )
    return problem.with_target(sensors[0], cylindrical(*target))


def _write(solution: Solution, plant: Plant, out: Path) -> None:
    out.mkdir(parents=True, exist_ok=True)
    write_solution(solution, out / SOLUTION)
    plot_trajectories(solution, plant.manifest, out / TRAJECTORIES)
    draw_mechanism(solution, plant, out / MECHANISM)


def _print_summary(solution: Solution) -> None:
    run, size, cost, check = solution.run, solution.size, solution.cost, solution.resimulation
    assert check is not None, "a solution is re-simulated before it is shown"
    rows = {
        "problem": f"{solution.problem.name}, model {solution.model}",
        "status": f"{run.status}, {run.iterations} iterations",
        "time": f"{run.seconds:.2f} s, of which {run.seconds_evaluating:.2f} s evaluating functions and derivatives",
        "program": f"{size.variables} variables, {size.constraints} constraints",
        "nonzeros": f"{size.jacobian_nonzeros} in the Jacobian, {size.hessian_nonzeros} in the Hessian's triangle",
        "cost": f"{cost.total:.10g}",
        "  inputs": f"{cost.inputs:.10g}",
        "  input rates": f"{cost.input_rates:.10g}",
        "violation": f"{solution.violation.constraints:.1e} of constraints, {solution.violation.bounds:.1e} of bounds",
        "defect": f"{_number(check.defect)} in an interval, at most; {solution.problem.accuracy:.1e} asked for",
        "open loop": f"{_number(check.open_loop_error)} off at the end, under the inputs alone",
    }
    for name, value in rows.items():
        click.echo(f"{name:<14}{value}")


def _list_shortcomings(solution: Solution) -> list[str]:
    """Say what keeps a solution from being all that was asked for."""
    check, found = solution.resimulation, []
    if solution.is_only_acceptable:
        found.append("IPOPT stopped at an acceptable level, short of the tolerance; try another guess or scaling")
    if check is not None and not check.is_accurate:
        found.append(
            f"the largest defect of an interval, {_number(check.defect)}, is above the accuracy asked for, "
            f"{solution.problem.accuracy:.1e}; take more intervals or a higher degree"
        )
    return found


def _tell_failure(failure: Failure, out: Path) -> None:
    _say(f"not solved ({failure.run.status}): {failure.finding}; {failure.remedy}")
    if (out / SOLUTION).exists():
        _say(f"{out / SOLUTION} is from an earlier solve")


def _number(value: float | None) -> str:
    return "unknown (the integrator gave up)" if value is None else f"{value:.1e}"


def _say(message: str) -> None:
    click.echo(message, err=True)
