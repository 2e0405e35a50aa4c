"""`mbsrun sweep`: a problem file and a grid of targets -> a record of attempts, and a summary."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import click
import numpy as np
from click.core import ParameterSource
from rich import box
from rich.table import Table

from mbsgen.help import ModelCommand
from mbsgen.manifest import Manifest
from mbsrun.commands.console import (
    NOT_SOLVED,
    NumberType,
    check_conflicts,
    find_sensor,
    keep_grid,
    print_table,
    say,
    show_status,
)
from mbsrun.environment import describe_environment
from mbsrun.external import load_on_demand
from mbsrun.ocp.guessing.mirror import find_mirror
from mbsrun.ocp.guessing.starts import list_turning
from mbsrun.ocp.problem.problem import Representation
from mbsrun.ocp.searching.attempts import Summary, describe_search, list_open_tasks, summarise
from mbsrun.ocp.searching.executor import LocalExecutor
from mbsrun.ocp.searching.search import OutOfTimeError, Search
from mbsrun.ocp.searching.study import Study, Targets, describe, identify
from mbsrun.ocp.searching.trials import ProtocolName
from mbsrun.ocp.solution.record import Attempt, open_record
from mbsrun.ocp.solving.placing import name_lines
from mbsrun.ocp.statement.checks import MAX_THREADS
from mbsrun.ocp.statement.statement import name_problem, read_problem

SWEEP_HELP = """Solve PROBLEM for a grid of targets, in several representations, and sum up.

Targets are positions of the one sensor that has a target, on a cylinder about the base's z axis; the default grid is
the 21 times 11 of Docquier, Bruls, Fisette. Every attempt is stored in the file -o when it ends. So the command can be
stopped; given again, it continues, also with more targets, costs, representations, or the other protocol.

\b
  mbsrun sweep models/planar_arm_reach.ocp.yaml --radius 0.55 --azimuths 0.8 1.2 3 --heights 0 0 1

\b
Protocols
  paper    for each representation the interpolation with inputs 0, and no restart;
           failures, and minima higher than the lowest known, are counted
  robust   interpolations with the inputs of their motion; random starts: bumps and noise
           on them, other end poses, whole turns of joints without limits; then the
           solutions of neighbours, mirror images of solutions at the opposite azimuth,
           and solutions of other representations, until nothing is new

\b
With --over or --cases, the command solves for values of any keys instead of targets:
  mbsrun sweep swing.ocp.yaml --over end.pose.cart 0.5:1.5:11 --over horizon 1.5,2
solves all combinations, each from the problem's guess, and re-simulates every motion. Beside the record -o are a
table (.csv) and, over one key or two, a picture (.png). --solutions writes each solution.

A search cannot show that no lower minimum exists: the summary shows how many independent starts found the lowest
known cost. Motions with whole turns are compared among themselves, and listed separately.

\b
Exit codes
  0   all cases are solved; or the protocol is complete. After the robust protocol, every
      task has the lowest minimum that was found for its target; lower ones may exist
  1   some tasks are not solved, or have a higher minimum than one that was found;
      or the time is over
  2   the problem, its model or an argument cannot be accepted
"""


SECTIONS = {
    "Targets": ("protocol", "radius", "azimuths", "heights", "every", "costs", "names", "bumped"),
    "Values of keys": ("over", "cases", "threads", "workers", "scheduler", "neighbours", "solutions"),
}


@click.command("sweep", cls=ModelCommand, help=SWEEP_HELP, sections=SECTIONS)
@click.argument("file", metavar="PROBLEM", type=click.Path(path_type=Path))
@click.option(
    "-o",
    "--output",
    "out",
    type=click.Path(dir_okay=False, path_type=Path),
    help="The file to keep the attempts in; by default NAME.sweep here, for a problem file NAME.ocp.yaml.",
)
@click.option(
    "--protocol", type=click.Choice(["paper", "robust"]), default="robust", help="See above; by default robust."
)
@click.option("--radius", type=NumberType(), default=0.63, help="The radius of the cylinder [m]; by default 0.63.")
@click.option(
    "--azimuths",
    type=(NumberType(), NumberType(), click.IntRange(1, 1000)),
    default=(-math.pi / 2, math.pi / 2, 21),
    metavar="FROM TO COUNT",
    help="The azimuths of targets [rad]; by default -pi/2 pi/2 21.",
)
@click.option(
    "--heights",
    type=(NumberType(), NumberType(), click.IntRange(1, 1000)),
    default=(-0.1, 0.1, 11),
    metavar="FROM TO COUNT",
    help="The heights of targets [m]; by default -0.1 0.1 11.",
)
@click.option(
    "--every",
    type=(click.IntRange(1), click.IntRange(1)),
    default=(1, 1),
    metavar="I J",
    help="Take every I-th azimuth and every J-th height only; by default all.",
)
@click.option(
    "--cost",
    "costs",
    type=(NumberType(), NumberType()),
    multiple=True,
    metavar="K1 K2",
    help="Weights of inputs and of their rates, in place of the problem's cost; may be given several times.",
)
@click.option(
    "--representation",
    "names",
    type=click.Choice([r.value for r in Representation], case_sensitive=False),
    multiple=True,
    help="A form of the equations of motion; by default all. The first one searches for lower minima.",
)
@click.option(
    "--bump",
    "bumped",
    metavar="NAME",
    multiple=True,
    help="A coordinate that random bumps move; by default all that are actuated.",
)
@click.option("--minutes", type=click.FloatRange(min=0), default=math.inf, help="Stop after this time.")
@click.option(
    "--over",
    type=(str, str),
    multiple=True,
    metavar="KEY VALUES",
    help="A key of the problem, such as end.pose.cart, and its values: FROM:TO:COUNT, or 1,2,pi. May be given several "
    "times, for all combinations.",
)
@click.option(
    "--cases",
    type=click.Path(path_type=Path),
    metavar="TABLE",
    help="A table in CSV with a key on top of each column, and a row for each case.",
)
@click.option(
    "--threads",
    type=click.IntRange(1, MAX_THREADS),
    default=1,
    help="With --over or --cases: the number of threads; by default 1.",
)
@click.option(
    "--workers",
    type=click.IntRange(0),
    default=0,
    help="With --over or --cases: the number of processes; by default this one alone.",
)
@click.option(
    "--scheduler", metavar="tcp://…", help="With --over or --cases: the address of a Dask cluster that solves."
)
@click.option(
    "--neighbours",
    is_flag=True,
    help="With --over or --cases: start each case from the solution of a case nearby, or from its own guess where that "
    "fails. With several minima, a case may end in another one.",
)
@click.option(
    "--solutions",
    type=click.Path(file_okay=False, path_type=Path),
    metavar="FOLDER",
    help="With --over or --cases: write each solution to this folder, as NUMBER.json.",
)
@click.pass_context
@name_lines
def sweep_command(
    context: click.Context,
    /,
    file: Path,
    out: Path | None,
    protocol: ProtocolName,
    costs: tuple[tuple[float, float], ...],
    names: tuple[str, ...],
    bumped: tuple[str, ...],
    minutes: float,
    over: tuple[tuple[str, str], ...],
    cases: Path | None,
    threads: int,
    workers: int,
    scheduler: str | None,
    neighbours: bool,
    solutions: Path | None,
    **grid: Any,
) -> None:
    """Read, search, sum up."""
    if over or cases is not None:
        _check_options(context, over, cases)
        from mbsrun.commands.cases import Wish, sweep_cases  # takes longer to load

        wish = Wish(over, cases, threads, workers, minutes, solutions, scheduler, neighbours)
        context.exit(0 if sweep_cases(file, out or Path(f"{name_problem(file)}.sweep"), wish) else NOT_SOLVED)
    if given := [f"--{name}" for name in OF_CASES if _is_given(context, name)]:
        raise click.UsageError(f"{', '.join(given)} needs --over or --cases; give one of them too")
    problem, plant = read_problem(file, load_on_demand)
    problem = keep_grid(problem)
    sensor = find_sensor(problem, "PROBLEM")
    representations = tuple(Representation(name) for name in names) or tuple(Representation)
    for representation in representations:
        check_conflicts(replace(problem, representation=representation))
    targets = Targets(
        grid["radius"],
        tuple(np.linspace(*grid["azimuths"]).tolist()),
        tuple(np.linspace(*grid["heights"]).tolist()),
        grid["every"],
    )
    study = Study(
        problem,
        sensor,
        targets,
        costs or ((problem.cost.inputs, problem.cost.input_rates),),
        representations,
        _find_bumped(bumped, plant.manifest),
        list_turning(problem, plant.manifest),
        mirror=find_mirror(problem, plant, sensor),
    )
    is_through = True
    about = (identify(study, plant.manifest), describe(study, plant.manifest))
    with open_record(out or Path(f"{problem.name}.sweep"), *about) as record:
        with show_status("making the program") as status:
            executor = LocalExecutor(plant, describe_environment())
            try:
                Search(study, executor, record, lambda attempt, _: status.update(_tell(attempt)), 60 * minutes).run(
                    protocol
                )
            except OutOfTimeError:
                is_through = False
        attempts = list(record.attempts())
    _print_summaries(summarise(attempts))
    for line in describe_search(attempts):
        click.echo(line)
    if not is_through:
        say("the time is over; repeat the command to continue")
    context.exit(0 if is_through and (protocol == "paper" or not list_open_tasks(study, attempts)) else NOT_SOLVED)


OF_CASES = ("threads", "workers", "scheduler", "neighbours", "solutions")
SHARED = ("file", "out", "minutes", "over", "cases", *OF_CASES)


def _check_options(context: click.Context, over: Sequence[object], cases: Path | None) -> None:
    """Refuse options that say nothing of cases."""
    given = [x.name for x in context.command.params if x.name and _is_given(context, x.name)]
    strange = [f"--{name}" for name in given if name not in SHARED]
    if over and cases is not None:
        raise click.UsageError("--over and --cases both list cases; give one of them")
    if "scheduler" in given and {"threads", "workers"} & set(given):
        raise click.UsageError("a cluster has its own workers; give --scheduler alone, without --threads and --workers")
    if "scheduler" in given and "neighbours" in given:
        raise click.UsageError(
            "on a cluster, no case starts from the solution of another one; leave --neighbours or --scheduler out"
        )
    if strange:
        raise click.UsageError(f"{', '.join(strange)}: for a grid of targets; leave it out with --over or --cases")


def _is_given(context: click.Context, name: str) -> bool:
    return context.get_parameter_source(name) is not ParameterSource.DEFAULT


def _find_bumped(names: Sequence[str], manifest: Manifest) -> tuple[int, ...]:
    """Find coordinates by name; all that are actuated, if there is none."""
    known = [c.name for c in manifest.coordinates]
    if names and manifest.quaternions:
        raise click.BadParameter("guesses of models with quaternions are not bumped", param_hint="--bump")
    for name in names:
        if name not in known:
            raise click.BadParameter(f"the model has no coordinate {name!r}: {', '.join(known)}", param_hint="--bump")
    return tuple(known.index(name) for name in names) or tuple(manifest.actuated)


def _tell(attempt: Attempt) -> str:
    task, cost = attempt.task, "-" if attempt.cost is None else f"{attempt.cost:.8g}"
    return f"{attempt.part}: target {task.place}, {task.representation}: {attempt.status}, cost {cost}"


def _print_summaries(summaries: Sequence[Summary]) -> None:
    table = Table(box=box.SIMPLE)
    for column in ("cost", "representation", "part"):
        table.add_column(column)
    for column in ("attempts", "solved", "higher minima", "iterations", "CPU s, median", "CPU s, all"):
        table.add_column(column, justify="right")
    for s in summaries:
        least, median, most = s.iterations
        texts = (f"({s.weights[0]:g}, {s.weights[1]:g})", s.representation, s.part)
        numbers = (str(s.attempts), str(s.solved), str(s.higher), f"{median:g} ({least:g}-{most:g})")
        table.add_row(*texts, *numbers, f"{s.cpu_median:.2f}", f"{s.cpu_seconds:.1f}")
    print_table(table)
