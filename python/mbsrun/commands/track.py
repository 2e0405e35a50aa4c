"""`mbsrun track`: a problem file and a trial -> a closed loop, with tables and pictures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import click
from rich.progress import BarColumn, TextColumn, TimeRemainingColumn
from rich.progress import Progress as ProgressBar

from mbsgen.documents import Data, refuse
from mbsgen.errors import Fault
from mbsgen.help import ModelCommand
from mbsgen.manifest import FILE_NAME
from mbsrun.commands.console import (
    NOT_SOLVED,
    NameType,
    choose_format,
    keep_grid,
    list_written,
    open_messages,
    output_folder,
    say,
    show_status,
)
from mbsrun.controllers.loading import controller as load_controller
from mbsrun.controllers.making import hash_problem
from mbsrun.controllers.writing import BARRIER
from mbsrun.external import Mechanism, OnDemand, load_on_demand
from mbsrun.ocp.methods import METHODS as SOLVERS
from mbsrun.ocp.problem.design import equip
from mbsrun.ocp.problem.problem import Problem
from mbsrun.ocp.solution.solution import Failure
from mbsrun.ocp.solving.fixing import fix_numbers
from mbsrun.ocp.solving.placing import name_lines
from mbsrun.ocp.statement.checks import MAX_THREADS
from mbsrun.ocp.statement.statement import read_problem
from mbsrun.simulation.integration.methods import METHODS
from mbsrun.tracking.analysis import Margin
from mbsrun.tracking.compiled import CompiledController, Stepping, find_wrong_rate, list_misfits, remembers
from mbsrun.tracking.controller import Controller
from mbsrun.tracking.loop import NoPlanError, Sample, Track, track
from mbsrun.tracking.mechanisms import build_plant, load_simulated
from mbsrun.tracking.plant import Plant
from mbsrun.tracking.record import FILES, Report, report_track, write_track
from mbsrun.tracking.solving import SolvingController
from mbsrun.tracking.statement import TrialStatement
from mbsrun.tracking.trial import Fallback, Trial

TRACK_HELP = """Test predictive control of a simulated mechanism: solve PROBLEM again from every measured state.

\b
  mbsrun track models/track/cart_pole.ocp.yaml --settings models/track/cart_pole.track.yaml

At a given rate, the state is measured, the problem is solved from there, and the first inputs of this plan act until
the next sample. The simulated mechanism, the plant, may have other masses than the controller's model; its measurements
may have noise, inputs may act late, and it may be pushed. A file (--settings) describes all of this; options have
priority:

\b
  duration: 5                       # s
  rate: 20                          # samples a second
  delay: 1                          # periods from a measurement to its inputs
  plant: {scale: {mp: 1.2}}         # the true mass is 20 % larger
  noise: {coordinates: 1e-3, velocities: 1e-2, seed: 0}
  kicks:
    - {time: 3, velocity: {pole: 1}}
  measures:
    - {name: lean, expression: abs(q_pole - pi), from: 4, most: 0.02}

The simulation waits for the controller: computing times are recorded, but do not change the motion. To simulate a slow
controller, give a delay of one period or more. The page docs/track.md lists all keys.

\b
The output folder gets
  summary.json      figures: failures, computing times, measures, margins to bounds and constraints
  track.csv         a row for each sample: true and measured state, inputs, status, iterations, seconds
  plots.png         states against references, inputs within bounds, measures
  times.png         the histogram of computing times
  animation.html    plays the true motion in any browser

Ctrl-C ends the loop; the part so far is written, and marked as incomplete.

\b
Exit codes
  0   the end was reached, every measure stayed below its limit, and no range was violated
  1   the end was not reached, a measure exceeded its limit, or a range was violated: the motion so far
      is written; or the controller found no plan from the start: nothing is written
  2   a file or an argument cannot be accepted; nothing written
"""

PREPARED = 0.1  # of a sample's processor time: less preparation is not printed
LISTED = 8  # margins and statuses that are printed
MAX_STEPS = 100  # of Newton's method in a sample


SECTIONS = {
    "The loop": ("duration", "rate", "delay", "predict", "fallback", "seed", "method"),
    "The controller": ("solver", "threads", "folder", "steps", "rescue", "barrier"),
}


@click.command("track", cls=ModelCommand, help=TRACK_HELP, sections=SECTIONS)
@click.argument("file", metavar="PROBLEM", type=click.Path(path_type=Path))
@output_folder("track")
@click.option("--settings", type=click.Path(path_type=Path), help="A file with settings; see above.")
@click.option("--duration", metavar="T", help="The length of the motion [s].")
@click.option("--rate", metavar="HZ", help="The number of samples a second.")
@click.option("--delay", type=int, metavar="N", help="Periods from a measurement to its inputs; by default 0.")
@click.option(
    "--predict/--no-predict", default=None, help="Plan from the state after the delay, or from the measured one."
)
@click.option(
    "--fallback",
    type=click.Choice([x.value for x in Fallback]),
    help="The inputs of a sample without a plan; by default the last plan's.",
)
@click.option("--seed", type=int, metavar="N", help="The seed of the noise; by default 0.")
@click.option("--method", type=NameType(METHODS), help="How the plant is integrated; by default dop853.")
@click.option("--solver", type=NameType(SOLVERS), help="The controller's NLP method; by default the problem's.")
@click.option(
    "--threads", type=click.IntRange(1, MAX_THREADS), help="The number of threads of a plan by mbs; by default 1."
)
@click.option(
    "--controller",
    "folder",
    type=click.Path(file_okay=False, path_type=Path),
    metavar="DIR",
    help="A folder of C that `mbsrun controller PROBLEM` wrote: it replaces the solver.",
)
@click.option(
    "--steps",
    type=click.IntRange(1, MAX_STEPS),
    metavar="N",
    help="With --controller: control in real time, by N steps of Newton's method a sample; by default it solves.",
)
@click.option(
    "--rescue",
    type=click.FloatRange(0, min_open=True),
    metavar="VIOLATION",
    help="With --steps: solve where the plan violates a constraint by more than this, as a step may go wrong. A plan "
    "that has diverged is solved for anew in any case.",
)
@click.option(
    "--barrier",
    type=click.FloatRange(0, min_open=True),
    metavar="RATIO",
    help="With --steps: their barrier parameter, over the cost of the optimum that the controller stores; by default "
    f"{BARRIER:g}. Larger ones are steadier after blows, and keep farther from bounds.",
)
@choose_format
@click.pass_context
@name_lines
def track_command(
    context: click.Context,
    /,
    file: Path,
    out: Path | None,
    settings: Path | None,
    solver: str | None,
    threads: int | None,
    folder: Path | None,
    steps: int | None,
    rescue: float | None,
    barrier: float | None,
    **given: Any,
) -> None:
    """Read, run, write, print."""
    if folder is not None and solver is not None:
        raise click.UsageError("--controller has its own solver; leave --solver out")
    if folder is not None and threads is not None:
        raise click.UsageError("--controller has its own solver; leave --threads out")
    if folder is None and steps is not None:
        raise click.UsageError("--steps is for a controller in C; give --controller too")
    stepping = _choose_stepping(steps, rescue=rescue, barrier=barrier)
    statement = TrialStatement(settings, _collect_options(given))
    models: list[Path] = []

    def load_model(model: Path) -> Mechanism | OnDemand:
        models.append(model)
        return load_on_demand(model)

    problem, model = read_problem(file, load_model)
    problem = keep_grid(problem)
    if solver is not None:
        problem = problem.with_solver(solver)
    if threads is not None:
        problem = replace(problem, solver=replace(problem.solver, threads=threads))
    with show_status("generating and compiling"):
        changes = statement.changes
        other = models[0] if changes.model is None else (settings or file).parent / changes.model
        true = load_simulated(other, is_released=changes.is_released)
        numbers = None if folder is None else load_controller(folder).manifest.numbers
        fixed = fix_numbers(problem, model, given=numbers)
        if isinstance(fixed, Failure):
            say(f"{file}: the unknown numbers of the mechanism are not found: {fixed.finding}; {fixed.remedy}")
            context.exit(NOT_SOLVED)
        asked, problem, model = problem, fixed.problem, fixed.plant
        true = build_plant(true, problem, fixed.numbers, is_other=changes.model is not None)
        trial, parameters = statement.trial(problem, true.manifest, true.parameters)
        true = true.with_parameters(**parameters)
        predicting = equip(load_simulated(models[0]), problem) if trial.delay and trial.predicts else None
        controller: Controller = SolvingController(problem, model, trial.period, trial.horizon)
        if folder is not None:
            controller = _load_controller(folder, file, asked, trial, statement, stepping)
    try:
        found = _run(trial, problem, Plant(true, trial, problem), controller, predicting)
    except NoPlanError as error:
        say(str(error))
        context.exit(NOT_SOLVED)
    out = out or Path(f"{problem.name}.track")
    with show_status("drawing"):
        report = report_track(found, problem, true)
        write_track(report, true, out)
    _print_report(report, fixed.numbers)
    say(f"wrote {list_written(out, FILES)}")
    for warning in _list_warnings(report):
        say(f"warning: {warning}")
    context.exit(0 if report.is_met else NOT_SOLVED)


def _choose_stepping(steps: int | None, **options: float | None) -> Stepping | None:
    given = {name: value for name, value in options.items() if value is not None}
    if steps is not None:
        return Stepping(steps, **given)
    for name in given:
        raise click.UsageError(f"--{name} is for control in real time; give --steps too")
    return None


def _load_controller(
    folder: Path,
    file: Path,
    problem: Problem,
    trial: Trial,
    statement: TrialStatement,
    stepping: Stepping | None,
) -> CompiledController:
    """Load a controller in C. Raises InputError with every way in which it does not fit the problem and the loop."""
    loaded = load_controller(folder)
    manifest, faults = loaded.manifest, []
    if trial.horizon is not None:
        finding = "a controller in C has plans of one length"
        faults.append(statement.fault(("horizon",), finding, "leave horizon out, or take --solver"))
    misfits = list_misfits(manifest, problem, trial.updates)
    remedy = f"write the controller of this problem by `mbsrun controller {file} -o DIR`"
    faults += [Fault(str(folder / FILE_NAME), 0, "", finding, remedy) for finding in misfits]
    wrong = find_wrong_rate(loaded.period, trial.period, remembers=remembers(manifest))
    if wrong is not None and not misfits:
        faults.append(statement.fault(("rate",), *wrong))
    if faults:
        raise refuse(faults)
    if manifest.problem_hash != hash_problem(problem):
        say(
            f"warning: {folder} was written for another version of the problem; the controller keeps its own weights, "
            "bounds and targets"
        )
    return CompiledController(loaded, problem, trial.period, stepping)


def _collect_options(given: dict[str, Any]) -> dict[str, Data]:
    """Nest options as a settings file does."""
    options: dict[str, Data] = {key: value for key, value in given.items() if value is not None}
    for key, section in (("seed", "noise"), ("method", "plant")):
        if key in options:
            options[section] = {key: options.pop(key)}
    return options


def _run(trial: Trial, problem: Problem, plant: Plant, controller: Controller, model: Mechanism | None) -> Track:
    """Run the loop, and show how far it is."""
    columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[time]}"), TimeRemainingColumn())
    with ProgressBar(*columns, console=open_messages(), transient=True) as bar:
        task = bar.add_task("planning from the start", total=trial.samples, time="")

        def show(sample: Sample) -> None:
            told = f"{sample.decision.status}, {1e3 * sample.decision.seconds:.3g} ms"
            bar.update(task, advance=1, description=told, time=f"t = {sample.time:.3f} s")

        return track(trial, problem.bounds, plant, controller, model, show)


def _print_report(report: Report, numbers: Mapping[str, float]) -> None:
    found, trial = report.track, report.track.trial
    statuses = ", ".join(f"{count} {status}" for status, count in report.statuses[:LISTED])
    iterations = [sample.decision.iterations for sample in found.samples]
    times = report.times
    rows = {
        "problem": trial.name,
        **({"numbers": _list_numbers(numbers)} if numbers else {}),
        "reached": f"{found.t[-1]:.6g} s of {trial.duration:.6g} s, {len(found.samples)} samples "
        f"of {1e3 * trial.period:.6g} ms",
        "controller": statuses,
        "failures": f"{found.failures}; {report.moved} states were put within the bounds",
        "iterations": f"{sum(iterations) / len(iterations):.3g} a sample, {max(iterations)} at most",
        "processor": f"{1e3 * times.median:.3g} ms a sample (median), {1e3 * times.tail:.3g} ms (99.9th percentile), "
        f"{1e3 * times.largest:.3g} ms at most",
        **_describe_preparation(report),
        "energy drift": "not checked: inputs follow expressions"
        if found.drift is None
        else f"{found.drift:.1e} J in a period, at most: the integration's error",
    }
    for x in report.measured:
        limit = "" if x.most is None else f"; limit {x.most:.4g}" + ("" if x.is_met else ", exceeded")
        rows[x.name] = f"{x.largest:.4g} at most, {x.rms:.4g} rms{limit}"
    width = max(map(len, rows))
    for name, text in rows.items():
        click.echo(f"{name:<{width}}  {text}")
    if report.margins:
        click.echo("least margins to bounds and constraints")
    for margin in sorted(report.margins, key=lambda margin: margin.least)[:LISTED]:
        click.echo(f"  {margin.least:>10.3g} at {margin.time:.3f} s  {margin.name}")


def _list_numbers(numbers: Mapping[str, float]) -> str:
    found = ", ".join(f"{name} = {value:.7g}" for name, value in numbers.items())
    return f"{found}: found from the start, and kept"


def _describe_margin(margin: Margin) -> str:
    """Describe where a range was left, as `mbsrun solve` does."""
    number, limit = margin.worst
    side = "below" if number < limit else "above"
    return f"{margin.name} is {number:.6g} at {margin.time:.4g} s, {-margin.least:.2g} {side} its limit {limit:.6g}"


def _describe_preparation(report: Report) -> dict[str, str]:
    """Describe the work before measurements, where a controller does a part of its work there."""
    times = report.preparing
    if times.median < PREPARED * report.times.median:
        return {}
    told = f"{1e3 * times.median:.3g} ms (median), {1e3 * times.tail:.3g} ms (99.9th percentile)"
    return {"preparation": f"{told} before a measurement; {report.violation:.1e} of violation in a plan, at most"}


def _list_warnings(report: Report) -> list[str]:
    """List what a reader must know before believing the figures."""
    found, warnings = report.track, []
    samples = len(found.samples)
    if found.halt is not None:
        warnings.append(f"{found.halt}; what was written is incomplete")
    if found.failures:
        warnings.append(f"the controller found no plan at {found.failures} of {samples} samples; see track.csv")
    if report.rescues:
        warnings.append(
            f"steps in real time went wrong at {report.rescues} of {samples} samples, which solved instead and took "
            "longer; give a larger --barrier or more --steps"
        )
    left = sorted((x for x in report.margins if not x.is_kept), key=lambda x: x.least / x.tolerated)
    if left:
        more = f"; and {len(left) - LISTED} more" if len(left) > LISTED else ""
        warnings.append(
            f"the motion leaves its ranges: {'; '.join(map(_describe_margin, left[:LISTED]))}{more}; take a shorter "
            "period or more intervals, keep a distance from the limits, or allow it by leeway in the settings"
        )
    if report.late:
        warnings.append(
            f"at {report.late} of {samples} samples the controller took longer than a period; the plant waited for it"
        )
    if found.lossy:
        warnings.append(f"the energy drifts in {found.lossy} periods; take a smaller tolerance or step of the plant")
    warnings += [f"the margin to {text} is unknown, since it reads accelerations" for text in report.unmeasured]
    return warnings
