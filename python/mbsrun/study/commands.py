"""The commands of `mbsrun` that measure: `chart kernels`, `chart simulation`."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import click
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from mbsrun.external import Mechanism, load
from mbsrun.models import find_folder
from mbsrun.simulation.statement import read_statement
from mbsrun.study import kernels, motions
from mbsrun.study.pictures import draw_kernels, draw_motions
from mbsrun.study.points import MotionPoint, Store, write_table

Report = Callable[[str, int, int], None]

CHART_HELP = """Measure speed against accuracy, and draw it.

What is measured is kept in the output folder as it comes: a command that was stopped goes on where it was when it is
given again, and one that is through only draws. Remove the folder to measure anew.
"""

KERNELS_HELP = """Chart kernels of MODEL, a model file, and of chains: time of a call against error to 50 digits.

Formulations, single and double precision, flags of the compiler; derivatives of MODEL beside finite differences, and
beside CasADi's differentiation of the same equations.

\b
The output folder gets
  kernels.png, kernels_backward.png, derivatives.png
  kernels.csv, kernels.json   every number drawn
  kernels.jsonl               what was measured so far
"""

SIMULATION_HELP = """Chart the simulation of MODEL: processor time against error and against drift of energy.

All methods of `mbsrun simulate`, on all formulations where that matters, with several steps and tolerances. The motion
is that of a settings file of `mbsrun simulate`; without one, MODEL is let go from a pose that is drawn.

\b
The output folder gets
  simulation.png
  simulation.csv, simulation.json   every number drawn
  simulation.jsonl                  what was measured so far
"""


@click.group("chart", help=CHART_HELP)
def chart() -> None:
    """Measure and draw."""


@chart.command("kernels", help=KERNELS_HELP)
@click.argument("model", type=click.Path(path_type=Path))
@click.option("-o", "--output", "out", type=click.Path(file_okay=False, path_type=Path), help="By default NAME.chart.")
@click.option("--size", "sizes", type=click.IntRange(1, 50), multiple=True, help="Joints of a chain; 2 5 10 20.")
@click.option("--rounds", type=click.IntRange(1), help="In which all are timed; 40.")
@click.option("--quick", is_flag=True, help="Little of everything, to see how it looks.")
def chart_kernels_command(
    model: Path, out: Path | None, sizes: tuple[int, ...], rounds: int | None, quick: bool
) -> None:
    """Measure, write, draw."""
    usual = kernels.QUICK if quick else kernels.Depth()
    depth = kernels.Depth(sizes or usual.sizes, usual.variants, rounds or usual.rounds, usual.judged)
    out = out or Path(f"{model.stem}.chart")
    with show_progress() as report:
        points = kernels.measure_kernels(model, out, depth, report)
    _tell_written([*write_table(points, out, "kernels"), *draw_kernels(points, out)])


@chart.command("simulation", help=SIMULATION_HELP)
@click.argument("model", type=click.Path(path_type=Path))
@click.option("-o", "--output", "out", type=click.Path(file_okay=False, path_type=Path), help="By default NAME.chart.")
@click.option("--settings", "file", type=click.Path(path_type=Path), help="Start, inputs and duration of the motion.")
@click.option("--duration", type=click.FloatRange(0, min_open=True), help="Without a settings file [s]; 2.")
@click.option("--quick", is_flag=True, help="Little of everything, to see how it looks.")
def chart_simulation_command(
    model: Path, out: Path | None, file: Path | None, duration: float | None, quick: bool
) -> None:
    """Measure, write, draw."""
    if file is not None and duration is not None:
        raise click.UsageError("the settings file tells the duration; give it, or --duration, but not both")
    course = read_course(model, file, duration)
    out = out or Path(f"{model.stem}.chart")
    store = Store(out / "simulation.jsonl", MotionPoint)
    with show_progress() as report:
        report("reference", 0, 1)
        standard = motions.find_standard(course)
        depth = motions.QUICK if quick else motions.Depth()
        points = motions.measure_motions(course, standard, depth, store, report)
    _tell_written([*write_table(points, out, "simulation"), *draw_motions(points, standard, out)])


def read_course(model: Path, file: Path | None, duration: float | None) -> motions.Course:
    """Read what is to be simulated. Raises InputError."""
    mechanism = load(model) if model.is_dir() else Mechanism(find_folder(model, motions.EXTENT))
    if file is None:
        return motions.draw_course(mechanism, duration or 2.0)
    statement = read_statement(file, {}, mechanism.manifest)
    mechanism = mechanism.with_parameters(**statement.parameters)
    told = (file.read_text(encoding="utf-8"), tuple(statement.parameters.items()))
    settings = statement.settings
    return motions.Course(mechanism, statement.q, statement.qd, statement.drive, settings.duration, repr(told))


@contextmanager
def show_progress() -> Iterator[Report]:
    """Show on stderr what is being done, and the time left."""
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as progress:
        task = progress.add_task("beginning", total=None)
        yield lambda text, done, total: progress.update(task, description=text, completed=done, total=total)


def _tell_written(paths: list[Path]) -> None:
    click.echo(f"wrote {', '.join(map(str, paths))}", err=True)
