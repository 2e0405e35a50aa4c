"""The command of the study, also `mbsrun study`: read a problem file; write a record, tables, figures and a report."""

from __future__ import annotations

import importlib.util
import math
import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import click
import numpy as np
from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from mbsgen.errors import MbsError
from mbsrun.measuring.page import render_page
from mbsrun.measuring.sections import Section, distinguish, read_folders, write_csv, write_section
from mbsrun.ocp.ground.linear import LINEAR_SOLVERS, MUMPS
from mbsrun.ocp.guessing.mirror import find_mirror
from mbsrun.ocp.guessing.starts import list_turning
from mbsrun.ocp.problem.problem import Representation, find_conflicts
from mbsrun.ocp.searching.cluster import open_workers
from mbsrun.ocp.searching.study import Study, Targets, Weights
from mbsrun.ocp.searching.trials import ProtocolName
from studies.docquier.campaign import (
    QUESTIONS,
    SETS,
    Campaign,
    Step,
    Watch,
    carry_out,
    describe_extent,
    find_sensor,
    hold,
    list_attempts,
    list_lowest,
    read_subject,
    report,
    restore,
    restrict,
)
from studies.docquier.export import ATTEMPTS, Form, export
from studies.docquier.figures import drawn_as
from studies.docquier.judgement import INSIDE, TURNS
from studies.docquier.judges import CONFIRMED, REFUTED
from studies.docquier.markdown import ARCHIVE, write_archive, write_page
from studies.docquier.optima import OPTIMA, describe_optima, tabulate_optima

NOT_THROUGH, BAD_INPUT = 1, 2  # exit codes
STYLES = {CONFIRMED: "confirmed", REFUTED: "refuted", TURNS: "open", INSIDE: "open"}  # of verdicts on the page
PAGE, DATA = "study.html", "data"
SPEED = 1800.0  # s; the pace over this time gives the remaining time

STUDY_HELP = """Carry out the study of Docquier, Bruls, Fisette on PROBLEM, and write a report.

The arm of the paper is models/arm_reach.ocp.yaml: 231 targets, 6 representations, 2 costs. Targets are places for the
one sensor that has a target, on a cylinder about the base's z axis. Every attempt is written to the output folder at
once, with versions, machine and options. So the command may be stopped or killed; given again, it continues. With
--minutes 0, or after the last attempt, it only writes the report.

\b
Parts, in this order; all, unless some are chosen
  --protocol paper        one guess, no restart; what fails or ends in a higher minimum is counted
  --question derivatives  generated sensitivities against AD of the same equations
  --question grids        Radau and Legendre points, degrees 1 to 5, N from 25 to 200
  --question systems      the problems of --system, in all representations
  --question shooting     multiple shooting beside collocation, here and for --system
  --question guess        inputs 0, and the inputs of the guessed motion
  --question repeats      the same tasks for targets that differ by rounding: the scatter of iterations
  --protocol robust       a search for lower minima from many starts, with the number of finds

\b
The output folder gets
  study.html     the report, one page: it needs no network and no other file
  data/          its tables as CSV, its pictures in the format of --format
  study.sqlite   every attempt

\b
Exit codes
  0   all requested parts are done
  1   the time is over
  2   a file or an argument cannot be accepted, or no cluster answers
"""


@click.command("study", help=STUDY_HELP)
@click.argument("file", metavar="PROBLEM", type=click.Path(path_type=Path))
@click.option("-o", "--output", "out", type=click.Path(file_okay=False, path_type=Path), help="By default NAME.study.")
@click.option(
    "--sample", type=click.IntRange(1), help="Solve for about this number of targets, spread over all; e.g. 33."
)
@click.option("--protocol", "protocols", type=click.Choice(["paper", "robust"]), multiple=True, help="See above.")
@click.option("--question", "asked", type=click.Choice(QUESTIONS), multiple=True, help="See above.")
@click.option(
    "--system", "systems", type=click.Path(path_type=Path), multiple=True, help="The problem file of another system."
)
@click.option(
    "--cost",
    "costs",
    type=(float, float),
    multiple=True,
    metavar="K1 K2",
    help="Weights of inputs and of their rates; by default 1 0 and 1 1e5.",
)
@click.option(
    "--representation",
    "names",
    type=click.Choice([r.value for r in Representation], case_sensitive=False),
    multiple=True,
    help="A form of the equations of motion; by default all six.",
)
@click.option("--radius", type=float, default=0.63, help="The radius of the cylinder [m]; by default 0.63.")
@click.option(
    "--azimuths",
    type=(float, float, click.IntRange(1, 1000)),
    default=(-math.pi / 2, math.pi / 2, 21),
    metavar="FROM TO COUNT",
    help="The azimuths of targets [rad]; by default 21, a quarter turn to either side.",
)
@click.option(
    "--heights",
    type=(float, float, click.IntRange(1, 1000)),
    default=(-0.1, 0.1, 11),
    metavar="FROM TO COUNT",
    help="The heights of targets [m]; by default -0.1 0.1 11.",
)
@click.option(
    "--workers",
    type=click.IntRange(0),
    help="The number of processes; by default one for each core with Dask, else this one alone, as with 0.",
)
@click.option("--scheduler", metavar="tcp://…", help="An existing Dask cluster, instead of processes on this machine.")
@click.option(
    "--linear-solver",
    "linear",
    type=click.Choice(LINEAR_SOLVERS),
    default=MUMPS,
    help="The linear solver of IPOPT, for all parts except the robust protocol; by default mumps. Solves with mbs are "
    "three times faster.",
)
@click.option(
    "--minutes",
    type=click.FloatRange(min=0),
    default=math.inf,
    help="Begin no attempt, and no certificate for --page, after this time.",
)
@click.option("--quick", is_flag=True, help="Solve a small part of the questions.")
@click.option(
    "--format",
    "drawn",
    type=click.Choice(["svg", "png", "pdf"]),
    default="svg",
    help="The format of the pictures in data/; by default svg. Pages show SVG where this is pdf.",
)
@click.option("--export", "form", type=click.Choice(["csv", "parquet"]), help="Also write all attempts as one table.")
@click.option(
    "--page",
    "place",
    type=click.Path(file_okay=False, path_type=Path),
    help="Also write the report to this folder as Markdown, and the lowest optima with certificates of optimality.",
)
@click.option(
    "--from",
    "earlier",
    type=click.Path(file_okay=False, path_type=Path),
    help="A folder that --page wrote, such as docs/study: its attempts count, and are not made again.",
)
@click.option(
    "--with",
    "folders",
    type=click.Path(path_type=Path),
    multiple=True,
    help="A folder whose tables and pictures the report includes, such as the output of `mbsrun chart`.",
)
@click.pass_context
def study_command(
    context: click.Context,
    /,
    file: Path,
    out: Path | None,
    sample: int | None,
    protocols: tuple[ProtocolName, ...],
    asked: tuple[str, ...],
    systems: tuple[Path, ...],
    costs: tuple[Weights, ...],
    names: tuple[str, ...],
    radius: float,
    azimuths: tuple[float, float, int],
    heights: tuple[float, float, int],
    workers: int | None,
    scheduler: str | None,
    linear: str,
    minutes: float,
    quick: bool,
    drawn: str,
    form: Form | None,
    place: Path | None,
    earlier: Path | None,
    folders: tuple[Path, ...],
) -> None:
    """Read the problem, solve, and write the report."""
    if workers is not None and scheduler is not None:
        raise click.UsageError("a cluster has its own workers; give --workers, or --scheduler, but not both")
    extra = read_folders(folders)
    subject = read_subject(file)
    problem = subject.problem
    grid = Targets(radius, tuple(np.linspace(*azimuths).tolist()), tuple(np.linspace(*heights).tolist()))
    representations = tuple(Representation(name) for name in names) or tuple(Representation)
    for representation in representations:
        if conflicts := find_conflicts(replace(problem, representation=representation)):
            raise click.UsageError("; ".join(f"{c.place[0]}: {c.finding}; {c.remedy}" for c in conflicts))
    bumped = tuple(subject.plant.manifest.actuated)
    turning = list_turning(problem, subject.plant.manifest)
    sensor = find_sensor(problem, file)
    mirror = find_mirror(problem, subject.plant, sensor)
    study = Study(problem, sensor, grid, costs or SETS, representations, bumped, turning, linear, mirror, method="mbs")
    chosen = bool(protocols or asked)
    campaign = Campaign(
        subject=subject,
        study=restrict(study, sample),
        protocols=protocols if chosen else ("paper", "robust"),
        questions=tuple(name for name in QUESTIONS if name in asked or not chosen),
        systems=tuple(map(read_subject, systems)),
        is_quick=quick,
    )
    out = out or Path(f"{problem.name}.study")
    is_through = True
    with hold(out):
        if earlier is not None:
            click.echo(restore(campaign, out, earlier), err=True)
        if minutes > 0:
            processes = _count_processes(scheduler) if workers is None else workers
            with open_workers(processes, scheduler) as executor_for, show_steps() as watch:
                is_through = carry_out(campaign, out, executor_for, watch, 60 * minutes)
        with drawn_as(drawn):
            sections = distinguish([*report(campaign, out), *extra])
        for section in sections:
            write_section(section, out / DATA)
        if form is not None:
            export(list_attempts(campaign, out), out / DATA / ATTEMPTS, form)
        if place is not None:
            with drawn_as(drawn):
                _write_markdown(campaign, out, sections, place, 60 * minutes)
        page = render_page(
            f"Formulations of multibody dynamics in optimal control: {problem.name}", _INTRODUCTION, sections, STYLES
        )
        (out / PAGE).write_text(page, encoding="utf-8")
    click.echo(f"wrote {out / PAGE}, {out / DATA}", err=True)
    if not is_through:
        click.echo("the time is over; repeat the command to continue", err=True)
    context.exit(0 if is_through else NOT_THROUGH)


def _count_processes(scheduler: str | None) -> int:
    """Return one process per core, or none besides this one where Dask is missing, which a note says."""
    if scheduler is None and importlib.util.find_spec("distributed") is None:
        click.echo("note: one process does the work; with Dask (pip install distributed) each core has one", err=True)
        return 0
    return len(os.sched_getaffinity(0))


def _write_markdown(campaign: Campaign, out: Path, sections: Sequence[Section], place: Path, seconds: float) -> None:
    """Write README.md with pictures, tables.tar.xz with all tables and attempts, and optima.csv."""
    optima = list_lowest(campaign, out, seconds)
    place.mkdir(parents=True, exist_ok=True)
    write_csv(tabulate_optima(campaign.study, optima), place / OPTIMA)
    shown = [*sections, describe_optima(campaign.study, optima, OPTIMA)]
    attempts = export(list_attempts(campaign, out), out / DATA / ATTEMPTS, "csv")
    write_archive(shown, [attempts], place / ARCHIVE, out / DATA)
    extent = (" ".join(describe_extent(campaign, out)), _ABOUT)
    write_page("The study of formulations: results", (*_INTRODUCTION[:1], *extent), shown, place)
    click.echo(f"wrote {place}", err=True)


_ABOUT = (
    "`mbsrun study models/arm_reach.ocp.yaml --page DIR` wrote this page from its record; [the study of formulations]"
    f"(../reproduction.md) describes its parts. All tables are in [{ARCHIVE}]({ARCHIVE}) as CSV, with a row for each "
    f"solve in `{ATTEMPTS}.csv`. The lowest optimum of every target is in [{OPTIMA}]({OPTIMA}). Iterations and optima "
    "do not depend on the load of the machine. CPU times do: other programs on the machine lengthen them, for all "
    "representations alike, because these take turns."
)
_INTRODUCTION = (
    "Q. Docquier, O. Brüls and P. Fisette compare four formulations of the equations of motion of a multibody system, "
    "in six representations, by solving optimal control problems (“Comparison and Analysis of Multibody Dynamics "
    "Formalisms for Solving Optimal Control Problem”). This page repeats their section 4.3, and "
    "continues with open questions.",
    "A click on the name of a column sorts a table; a click on a picture shows it in its full size. Each table is "
    "also a CSV file beside this page.",
)


@contextmanager
def show_steps() -> Iterator[Watch]:
    """Show the current task and the remaining time on stderr; without a terminal, print a line for each list."""
    console = Console(stderr=True)
    columns = (TextColumn("{task.description}", markup=False), BarColumn(), MofNCompleteColumn())
    times = (TimeElapsedColumn(), TimeRemainingColumn())
    seen: set[str] = set()
    with Progress(*columns, *times, console=console, transient=True, speed_estimate_period=SPEED) as progress:
        bar = progress.add_task("beginning", total=None)

        def show(step: Step) -> None:
            if step.last is None:
                progress.reset(bar, total=step.trials, completed=step.done, description=step.title)
                if not sys.stderr.isatty() and step.title not in seen:
                    seen.add(step.title)
                    click.echo(f"{step.title}: {step.done} of {step.trials} attempts are there", err=True)
                return
            last = step.last
            text = f"{step.title}: {last.task.place}, {last.task.representation}, {last.status}"
            progress.update(bar, completed=step.done, total=step.trials, description=text)

        yield show


def main() -> None:
    """Run the command; print errors of the user without a traceback."""
    try:
        study_command(prog_name="python -m studies.docquier")
    except (MbsError, OSError) as error:
        click.echo(str(error), err=True)
        sys.exit(BAD_INPUT)
