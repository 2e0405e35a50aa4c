"""The commands of `mbsrun` that measure: `chart` of kernels, simulation, optimisation, fidelity; `advise`."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import click
from rich import box
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table
from rich.text import Text

from mbsgen.errors import Fault, InputError
from mbsrun.external import Mechanism, load
from mbsrun.measuring import fidelity, kernels, motions, optima, solves
from mbsrun.measuring.advice import Advice, Option, advise_control, advise_optimisation, advise_simulation
from mbsrun.measuring.captions import write_captions
from mbsrun.measuring.mechanisms import Subject, refuse_quaternions
from mbsrun.measuring.pictures import draw_fidelity, draw_kernels, draw_motions, draw_optima
from mbsrun.measuring.points import Cost, KernelPoint, MotionPoint, SolvePoint, Store, write_table
from mbsrun.models import find_folder
from mbsrun.ocp.problem import Representation
from mbsrun.ocp.statement import read_problem
from mbsrun.simulation.statement import read_statement

Report = Callable[[str, int, int], None]

CHART_HELP = """Measure speed against accuracy, and draw it.

What is measured is kept in the output folder as it comes: a command that was stopped goes on where it was when it is
given again, and one that is through only draws. Remove the folder to measure anew. `mbsrun study --with FOLDER` takes
pictures and tables into its report, by the captions that NAME.section.json holds.
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

OPTIMISATION_HELP = """Chart the optimal control of PROBLEM: time of a solve against error of the cost, and defect.

Numbers of intervals, degrees, Radau and Legendre points, and representations, in all combinations. Inputs are constant
over an interval, so each number of intervals is a control grid with an optimum of its own, which a degree of 9 tells;
what the grid itself costs stands in a picture of its own.

\b
The output folder gets
  optimisation.png, control_grid.png
  optimisation.csv, optimisation.json   every solve
  control_grid.csv, control_grid.json   every reference, with its accuracy
  optimisation.jsonl                    what was measured so far
"""

FIDELITY_HELP = """Chart what is saved by leaving something out of MODEL, against the error that it makes.

Without a scene, one thing after the other: each joint locked, each body without mass, no forces of joints, no gravity,
no velocities, constant parameters, one sensor alone, what a tolerance admits. With scenes, their parts, and each as a
whole.

\b
The output folder gets
  fidelity.png
  fidelity.csv, fidelity.json   flops, times, and errors: where what is supposed holds, and anywhere
  fidelity.jsonl                what was measured so far
"""

ADVISE_HELP = """Tell how to compute with MODEL, with errors of --accuracy at most, and as fast as can be.

Everything is measured here and now on MODEL itself, the measurements are printed with the advice, and what was not
measured is named. They are kept in the output folder, so that the next question about MODEL takes less time.

\b
Tasks
  simulate   formulation, method, step or tolerance; on the motion of --settings, else one from a pose that is drawn
  optimise   representation, collocation, degree, intervals; on --problem, else a small reach from rest to rest
  control    kernels and their precision, for torques, accelerations and derivatives of both

\b
Exit codes
  0   there is something for everything that is asked for
  1   there is not: nothing that was measured is so accurate
  2   the model, a file or an argument cannot be accepted
"""

NOTHING_GOOD = 1
UNCUT = 200  # characters in a line where nobody sees a terminal's width


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
    write_captions("kernels", points[0].mechanism, out)


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
    write_captions("simulation", points[0].mechanism, out)


@chart.command("optimisation", help=OPTIMISATION_HELP)
@click.argument("problem", type=click.Path(path_type=Path))
@click.option("-o", "--output", "out", type=click.Path(file_okay=False, path_type=Path), help="By default NAME.chart.")
@click.option("--intervals", type=click.IntRange(1, 10_000), multiple=True, help="By default 5 10 20 40.")
@click.option("--degree", "degrees", type=click.IntRange(1, 8), multiple=True, help="By default 1 2 3 4 5.")
@click.option(
    "--representation",
    "names",
    type=click.Choice([r.value for r in Representation], case_sensitive=False),
    multiple=True,
    help="By default all.",
)
@click.option("--quick", is_flag=True, help="Little of everything, to see how it looks.")
def chart_optimisation_command(
    problem: Path,
    out: Path | None,
    intervals: tuple[int, ...],
    degrees: tuple[int, ...],
    names: tuple[str, ...],
    quick: bool,
) -> None:
    """Measure, write, draw."""
    stated, plant = read_problem(problem, load)
    usual = optima.QUICK if quick else optima.Depth()
    depth = replace(
        usual,
        intervals=tuple(sorted(set(intervals))) or usual.intervals,
        degrees=tuple(sorted(set(degrees))) or usual.degrees,
        representations=tuple(map(Representation, dict.fromkeys(names))) or usual.representations,
    )
    out = out or Path(f"{problem.name.split('.')[0]}.chart")
    store = Store(out / "optimisation.jsonl", SolvePoint)
    with show_progress() as report:
        points, grids = optima.measure_optima(solves.Case(stated, plant), depth, store, report)
    tables = [*write_table(points, out, "optimisation"), *write_table(grids, out, "control_grid")]
    _tell_written([*tables, *draw_optima(points, grids, out)])
    write_captions("optimisation", f"{plant.manifest.model}, {stated.name}", out)


@chart.command("fidelity", help=FIDELITY_HELP)
@click.argument("model", type=click.Path(path_type=Path))
@click.option("-o", "--output", "out", type=click.Path(file_okay=False, path_type=Path), help="By default NAME.chart.")
@click.option("--scene", "scenes", type=click.Path(path_type=Path), multiple=True, help="What is to be left out.")
@click.option("--quick", is_flag=True, help="Little of everything, to see how it looks.")
def chart_fidelity_command(model: Path, out: Path | None, scenes: tuple[Path, ...], quick: bool) -> None:
    """Measure, write, draw."""
    depth = fidelity.QUICK if quick else fidelity.Depth()
    whole = fidelity.take_whole(model, depth)
    out = out or Path(f"{model.stem}.chart")
    with show_progress() as report:
        report("generating the whole model", 0, 1)
        reductions = fidelity.list_reductions(model, whole.manifest, scenes)
        points = fidelity.measure_fidelity(whole, reductions, out, depth, report)
    _tell_written([*write_table(points, out, "fidelity"), *draw_fidelity(points, out)])
    write_captions("fidelity", points[0].mechanism, out)


def read_course(model: Path, file: Path | None, duration: float | None) -> motions.Course:
    """Read what is to be simulated. Raises InputError."""
    mechanism = load(model) if model.is_dir() else Mechanism(find_folder(model, motions.EXTENT))
    if file is None:
        return motions.draw_course(mechanism, duration or 2.0)
    refuse_quaternions(mechanism.manifest)
    statement = read_statement(file, {}, mechanism.manifest)
    mechanism = mechanism.with_parameters(**statement.parameters)
    told = (file.read_text(encoding="utf-8"), tuple(statement.parameters.items()))
    settings = statement.settings
    return motions.Course(mechanism, statement.q, statement.qd, statement.drive, settings.duration, repr(told))


@click.command("advise", help=ADVISE_HELP)
@click.argument("model", type=click.Path(path_type=Path))
@click.option("--accuracy", type=click.FloatRange(0, min_open=True), default=1e-6, help="The largest error; 1e-6.")
@click.option("--task", type=click.Choice(["simulate", "optimise", "control"]), default="simulate", help="simulate.")
@click.option("-o", "--output", "out", type=click.Path(file_okay=False, path_type=Path), help="By default NAME.advice.")
@click.option("--settings", "settings", type=click.Path(path_type=Path), help="simulate: the motion to be measured on.")
@click.option("--problem", type=click.Path(path_type=Path), help="optimise: the problem to be measured on.")
@click.option("--quick", is_flag=True, help="Measure little.")
@click.pass_context
def advise_command(
    context: click.Context,
    /,
    model: Path,
    accuracy: float,
    task: str,
    out: Path | None,
    settings: Path | None,
    problem: Path | None,
    quick: bool,
) -> None:
    """Measure, choose, tell."""
    for name, value, own in (("--settings", settings, "simulate"), ("--problem", problem, "optimise")):
        if value is not None and task != own:
            raise click.UsageError(f"{name} is for --task {own}")
    out = out or Path(f"{model.stem}.advice")
    with show_progress() as report:
        if task == "simulate":
            advice = _measure_simulation(read_course(model, settings, None), out, accuracy, quick, report)
        elif task == "optimise":
            advice = _measure_optimisation(model, problem, out, accuracy, quick, report)
        else:
            advice = _measure_control(model, out, accuracy, quick, report)
    _print_advice(advice)
    context.exit(0 if advice.is_complete else NOTHING_GOOD)


def _measure_simulation(course: motions.Course, out: Path, accuracy: float, quick: bool, report: Report) -> Advice:
    report("reference", 0, 1)
    standard = motions.find_standard(course)
    depth = motions.QUICK if quick else motions.Depth()
    store = Store(out / "simulation.jsonl", MotionPoint)
    points = motions.measure_motions(course, standard, depth, store, report)
    write_table(points, out, "simulation")
    return advise_simulation(course, standard, points, accuracy)


def _measure_optimisation(
    model: Path, problem: Path | None, out: Path, accuracy: float, quick: bool, report: Report
) -> Advice:
    mechanism = load(model)
    case = solves.state_reach(mechanism)
    told = "a reach from rest to rest in 1 s, stated for any model"
    if problem is not None:
        found, plant = read_problem(problem, load)
        if plant.manifest.model_hash != mechanism.manifest.model_hash:
            fault = f"its model is {plant.manifest.model}, which is not {model}"
            raise InputError([Fault(str(problem), 0, "model", fault, "give the problem's model")])
        case, told = solves.Case(found, mechanism), str(problem)
    depth = solves.QUICK if quick else solves.Depth()
    store = Store(out / "problem.jsonl", SolvePoint)
    points = solves.measure_solves(case, accuracy, depth, store, report)
    write_table(points, out, "problem")
    return advise_optimisation(mechanism.manifest.model, told, points, accuracy)


def _measure_control(model: Path, out: Path, accuracy: float, quick: bool, report: Report) -> Advice:
    subject = Subject(model, kernels.DERIVATIVES)
    depth = kernels.Depth((), (kernels.USUAL, kernels.SINGLE), 3 if quick else 40, 4 if quick else 16)
    store = Store(out / "control.jsonl", KernelPoint)
    points: list[KernelPoint] = []
    tasks = (*kernels.KERNELS, *kernels.SLOPES)
    for done, task in enumerate(tasks):
        report(task, done, len(tasks))
        points += kernels.measure_task(subject, task, depth, store)
    write_table(points, out, "control")
    return advise_control(subject.manifest.model, points, accuracy, depth.judged)


def _print_advice(advice: Advice) -> None:
    console = Console(highlight=False, width=None if sys.stdout.isatty() else UNCUT)
    console.print(f"{advice.model}: {advice.task}, with errors of {advice.accuracy:g} at most", markup=False)
    console.print(f"error: {advice.meaning}", markup=False)
    for need in advice.needs:
        best = advice.choose(need)
        console.print(
            f"\n{need}: " + ("nothing that was measured is so accurate" if best is None else _tell(best)), markup=False
        )
        table = Table(box=box.SIMPLE)
        options = advice.shortlist(need)
        for name in _list_columns(options):
            table.add_column(name)
        for column in ("time", "spread", "error"):
            table.add_column(column, justify="right")
        table.add_column("")
        for option in options:
            verdict = option.finding or ("" if option.meets(advice.accuracy) else "not accurate enough")
            time, spread = (_format_time(option), _format_spread(option.cost)) if option.cost else ("-", "-")
            error = "-" if option.error is None else f"{option.error:.1e}"
            marked = "taken" if option is best else verdict
            choices = dict(option.choices)
            cells = (*(choices.get(name, "") for name in _list_columns(options)), time, spread, error, marked)
            table.add_row(*map(Text, cells))
        console.print(table)
    console.print("not measured:", markup=False)
    for text in advice.unmeasured:
        console.print(f"- {text}", markup=False)


def _list_columns(options: Sequence[Option]) -> list[str]:
    return list(dict.fromkeys(name for option in options for name, _ in option.choices))


def _tell(option: Option) -> str:
    chosen = ", ".join(f"{name} {value}" for name, value in option.choices)
    return f"{chosen}; {_format_time(option)}, error {option.error:.1e}"


def _format_time(option: Option) -> str:
    """Write the shortest time, with its unit."""
    return f"{option.price:.3g} {option.unit}"


def _format_spread(cost: Cost) -> str:
    return "timed once" if cost.rounds == 1 else f"{cost.spread:.0%}"


@contextmanager
def show_progress() -> Iterator[Report]:
    """Show on stderr what is being done, and the time left."""
    columns = (TextColumn("{task.description}", markup=False), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as progress:
        task = progress.add_task("beginning", total=None)
        yield lambda text, done, total: progress.update(task, description=text, completed=done, total=total)


def _tell_written(paths: list[Path]) -> None:
    click.echo(f"wrote {', '.join(map(str, paths))}", err=True)
