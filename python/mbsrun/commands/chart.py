"""The command `mbsrun chart`: measure kernels, simulation, optimisation or fidelity; draw time against error.

The chart of fronts shows all formulations and tasks in one picture.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import click

from mbsgen.help import CommandsBySubject
from mbsrun.commands.console import Report, choose_format, keep_grid, output_folder, say, show_progress
from mbsrun.commands.robots import accept_robots
from mbsrun.external import Mechanism, load
from mbsrun.measuring import fidelity, kernels, motions, optima, solves, surveys
from mbsrun.measuring.captions import write_captions
from mbsrun.measuring.charts import draw_fidelity, draw_kernels, draw_motions, draw_optima
from mbsrun.measuring.fidelity import FidelityPoint
from mbsrun.measuring.overview import Sources, draw_overview, list_layers, title_overview, write_course
from mbsrun.measuring.points import MotionPoint, SolvePoint, write_points
from mbsrun.measuring.store import Store
from mbsrun.ocp.problem.problem import Representation
from mbsrun.ocp.statement.checks import LEAST_TOLERANCE
from mbsrun.ocp.statement.statement import read_problem

CHART_HELP = """Measure speed against accuracy, and draw it.

The output folder keeps every measurement at once: given again, an interrupted command continues, and a finished one
only draws. Remove the folder to measure anew. `mbsrun study --with FOLDER` includes pictures and tables in its report,
with the captions of NAME.section.json.
"""

KERNELS_HELP = """Chart kernels of MODEL, a model file, and of chains: time of a call against error to 50 digits.

Formulations, precisions from single to double-double, flags of the compiler; derivatives of MODEL beside finite
differences, and beside CasADi's differentiation of the same equations.

\b
The output folder gets
  kernels.png, kernels_backward.png, derivatives.png
  kernels.csv, kernels.json   every number drawn
  kernels.jsonl               all measurements
"""

SIMULATION_HELP = """Chart the simulation of MODEL: processor time against error and against drift of energy.

All methods of `mbsrun simulate`, on all formulations where that matters, with several steps and tolerances. A settings
file of `mbsrun simulate` gives the motion; without one, MODEL starts at rest from a random pose.

\b
The output folder gets
  simulation.png
  simulation.csv, simulation.json   every number drawn
  simulation.jsonl                  all measurements
"""

OPTIMISATION_HELP = """Chart the optimal control of PROBLEM: time of a solve against error of the cost, and defect.

Numbers of intervals, degrees, Radau and Legendre points, and representations, in all combinations; with the highest
degree of Radau points, other tolerances of the solver than PROBLEM's. Inputs are constant over an interval, so each
number of intervals is a control grid with its own optimum; a solve of degree 9 finds it. A second picture shows the
error of the control grid itself.

\b
The output folder gets
  optimisation.png, control_grid.png
  optimisation.csv, optimisation.json   every solve
  control_grid.csv, control_grid.json   every reference, with its accuracy
  optimisation.jsonl                    all measurements
"""

FIDELITY_HELP = """Chart the time that reductions of MODEL save, against their error.

Without a scene, one reduction after the other: each joint locked, each body without mass, no forces of joints, no
gravity, no velocities, constant parameters, one sensor alone, a tolerance. With scenes, the parts of each scene, then
the whole scene.

\b
The output folder gets
  fidelity.png
  fidelity.csv, fidelity.json   flops, times, and errors: at states that agree with the reduction, and anywhere
  fidelity.jsonl                all measurements
"""

FRONTS_HELP = """Chart speed against accuracy of all that can be chosen for MODEL, in one picture, with the advice.

A panel for each need: torques, accelerations and their derivatives in single and double precision; a motion, by all
methods of simulation; a solve, on grids; and what may be left out of MODEL. Each names the fastest methods, and a ring
marks the choice for errors of --accuracy. The solve is of --problem, else of the first problem file beside MODEL that
names it, else of a small reach from rest to rest. It takes two minutes at most for a model of some ten joints, as each
part begins nothing after half a minute; with --quick it takes one.

\b
The output folder gets
  fronts.png, fronts.svg    the picture; fronts_narrow.png is for a phone
  fronts.html               the same as a page: a dot shows its setting, and the command that repeats it
  fronts.csv, fronts.json   all settings, their times and errors
  motion.yaml               the motion that was measured, as settings of `mbsrun simulate`
  *.jsonl                   all measurements
"""


@click.group("chart", cls=CommandsBySubject, help=CHART_HELP)
def chart_command() -> None:
    """Measure and draw."""


@chart_command.command("kernels", help=KERNELS_HELP, short_help="Time of a call against lost digits.")
@click.argument("model", type=click.Path(path_type=Path))
@output_folder("chart", "a model NAME")
@click.option("--size", "sizes", type=click.IntRange(1, 50), multiple=True, help="Joints of a chain; 2 5 10 20.")
@click.option("--rounds", type=click.IntRange(1), help="Rounds of timing; 40.")
@click.option("--quick", is_flag=True, help="Measure little, as a preview.")
@choose_format
@accept_robots
def chart_kernels_command(
    model: Path, out: Path | None, sizes: tuple[int, ...], rounds: int | None, quick: bool
) -> None:
    """Measure, write, draw."""
    usual = kernels.QUICK if quick else kernels.KernelScope()
    scope = kernels.KernelScope(sizes or usual.sizes, usual.variants, rounds or usual.rounds, usual.judged)
    out = out or Path(f"{model.stem}.chart")
    with show_progress() as report:
        points = kernels.measure_kernels(model, out, scope, report)
    _print_written([*write_points(points, out, "kernels"), *draw_kernels(points, out)])
    write_captions("kernels", points[0].mechanism, out)


@chart_command.command("simulation", help=SIMULATION_HELP, short_help="Processor time of a motion against its error.")
@click.argument("model", type=click.Path(path_type=Path))
@output_folder("chart", "a model NAME")
@click.option("--settings", "file", type=click.Path(path_type=Path), help="Start, inputs and duration of the motion.")
@click.option("--duration", type=click.FloatRange(0, min_open=True), help="Without a settings file [s]; 2.")
@click.option("--quick", is_flag=True, help="Measure little, as a preview.")
@choose_format
@accept_robots
def chart_simulation_command(
    model: Path, out: Path | None, file: Path | None, duration: float | None, quick: bool
) -> None:
    """Measure, write, draw."""
    if file is not None and duration is not None:
        raise click.UsageError("the settings file contains the duration; give the file, or --duration, but not both")
    course = motions.read_course(model, file, duration)
    out = out or Path(f"{model.stem}.chart")
    store = Store(out / "simulation.jsonl", MotionPoint)
    with show_progress() as report:
        report("reference", 0, 1)
        standard = motions.find_standard(course)
        scope = motions.QUICK if quick else motions.MotionScope()
        points = motions.measure_motions(course, standard, scope, store, report)
    _print_written([*write_points(points, out, "simulation"), *draw_motions(points, standard, out)])
    write_captions("simulation", points[0].mechanism, out)


@chart_command.command(
    "optimisation", help=OPTIMISATION_HELP, short_help="Time of a solve against the error of its optimum."
)
@click.argument("problem", type=click.Path(path_type=Path))
@output_folder("chart")
@click.option(
    "--intervals", type=click.IntRange(1, 10_000), multiple=True, help="A number of intervals; by default 5 10 20 40."
)
@click.option(
    "--degree",
    "degrees",
    type=click.IntRange(1, 8),
    multiple=True,
    help="A number of points in an interval; by default 1 2 3 4 5.",
)
@click.option(
    "--representation",
    "names",
    type=click.Choice([r.value for r in Representation], case_sensitive=False),
    multiple=True,
    help="A form of the equations of motion; by default all.",
)
@click.option(
    "--tolerance",
    "tolerances",
    type=click.FloatRange(LEAST_TOLERANCE),
    multiple=True,
    help="A tolerance of the solver, in addition to PROBLEM's own; by default 1e-2 1e-3 1e-4 1e-6.",
)
@click.option("--quick", is_flag=True, help="Measure little, as a preview.")
@choose_format
def chart_optimisation_command(
    problem: Path,
    out: Path | None,
    intervals: tuple[int, ...],
    degrees: tuple[int, ...],
    names: tuple[str, ...],
    tolerances: tuple[float, ...],
    quick: bool,
) -> None:
    """Measure, write, draw."""
    stated, plant = read_problem(problem, load)
    stated = keep_grid(stated)
    usual = optima.QUICK if quick else optima.OptimumScope()
    scope = replace(
        usual,
        intervals=tuple(sorted(set(intervals))) or usual.intervals,
        degrees=tuple(sorted(set(degrees))) or usual.degrees,
        representations=tuple(map(Representation, dict.fromkeys(names))) or usual.representations,
        tolerances=tuple(sorted(set(tolerances))) or usual.tolerances,
    )
    out = out or Path(f"{problem.name.split('.')[0]}.chart")
    store = Store(out / "optimisation.jsonl", SolvePoint)
    with show_progress() as report:
        points, grids = optima.measure_optima(solves.Case(stated, plant), scope, store, report)
    tables = [*write_points(points, out, "optimisation"), *write_points(grids, out, "control_grid")]
    _print_written([*tables, *draw_optima(points, grids, out)])
    write_captions("optimisation", f"{plant.manifest.model}, {stated.name}", out)


@chart_command.command("fidelity", help=FIDELITY_HELP, short_help="Time that simpler models save, against their error.")
@click.argument("model", type=click.Path(path_type=Path))
@output_folder("chart", "a model NAME")
@click.option("--scene", "scenes", type=click.Path(path_type=Path), multiple=True, help="A scene to measure.")
@click.option("--quick", is_flag=True, help="Measure little, as a preview.")
@choose_format
@accept_robots
def chart_fidelity_command(model: Path, out: Path | None, scenes: tuple[Path, ...], quick: bool) -> None:
    """Measure, write, draw."""
    scope = fidelity.QUICK if quick else fidelity.FidelityScope()
    whole = fidelity.take_whole(model, scope)
    out = out or Path(f"{model.stem}.chart")
    with show_progress() as report:
        report("generating the whole model", 0, 1)
        reductions = fidelity.list_reductions(model, whole.manifest, scenes)
        points = fidelity.measure_fidelity(whole, reductions, out, scope, report)
    _print_written([*write_points(points, out, "fidelity"), *draw_fidelity(points, out)])
    write_captions("fidelity", points[0].mechanism, out)


@chart_command.command("fronts", help=FRONTS_HELP, short_help="All layers of a model, with the advised choices.")
@click.argument("model", type=click.Path(path_type=Path))
@output_folder("chart", "a model NAME")
@click.option("--accuracy", type=click.FloatRange(0, min_open=True), default=1e-6, help="The largest error; 1e-6.")
@click.option("--problem", type=click.Path(path_type=Path), help="The problem to be solved; by default see above.")
@click.option("--quick", is_flag=True, help="Measure little, as a preview.")
@choose_format
@accept_robots
def chart_fronts_command(model: Path, out: Path | None, accuracy: float, problem: Path | None, quick: bool) -> None:
    """Measure, write, draw."""
    out = out or Path(f"{model.stem}.chart")
    mechanism = load(model)
    problem = problem or next(iter(solves.find_problems(model)), None)
    with show_progress() as report:
        advice = [surveys.survey_control(model, out, accuracy, quick, report)]
        course = motions.read_course(model, None, None)
        scope = motions.QUICK if quick else motions.FRONTS
        advice.append(surveys.survey_simulation(course, out, accuracy, scope, report))
        case = _find_case(mechanism, problem)
        if case is not None:
            extent = solves.QUICK if quick else solves.FRONTS
            title = str(problem or "a reach from rest to rest in 1 s, stated for any model")
            advice.append(surveys.survey_optimisation(case, title, out, accuracy, extent, report))
        reductions = _measure_reductions(model, mechanism, out, report, quick=quick)
    write_course(course, out)
    sources = Sources(str(model), str(out), str(problem or ""), course.duration)
    layers = list_layers(advice, reductions, sources)
    _print_written(draw_overview(title_overview(mechanism.manifest), layers, out))
    write_captions("fronts", mechanism.manifest.model, out)


def _find_case(mechanism: Mechanism, problem: Path | None) -> solves.Case | None:
    """Return the problem to measure; None where nothing can be stated, which a note says."""
    if problem is not None:
        case = solves.read_case(mechanism, problem)
        return replace(case, problem=keep_grid(case.problem))
    if solves.can_reach(mechanism.manifest):
        return solves.state_reach(mechanism)
    say("note: no joint of one coordinate is actuated, so there is no panel of optimal control")
    return None


def _measure_reductions(
    model: Path, mechanism: Mechanism, out: Path, report: Report, *, quick: bool
) -> list[FidelityPoint]:
    """Measure reductions; none for models with quaternions and files of robots, which a note says."""
    if mechanism.manifest.configuration or model.suffix not in (".yaml", ".yml", ".json"):
        say("note: reductions are measured on model files without quaternions alone")
        return []
    scope = fidelity.QUICK if quick else fidelity.FRONTS
    whole = fidelity.take_whole(model, scope)
    reductions = fidelity.list_reductions(model, whole.manifest, ())
    return fidelity.measure_fidelity(whole, reductions, out, scope, report)


def _print_written(paths: list[Path]) -> None:
    click.echo(f"wrote {', '.join(map(str, paths))}", err=True)
