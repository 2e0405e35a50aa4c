"""The command line `mbsrun`: a model or a problem file in; a motion or a solution, pictures and a summary out."""

from __future__ import annotations

import math
import os
import sys
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, get_args

import click
import numpy as np
from rich import box, filesize
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
from rich.progress import Progress as ProgressBar
from rich.table import Table
from rich.text import Text

from mbsgen.documents import Data
from mbsgen.errors import Fault, InputError, MbsError
from mbsgen.expressions import FLOATS, ExpressionError, evaluate, parse
from mbsgen.manifest import Manifest
from mbsrun.cache import Entry, cache_folder, list_entries, remove
from mbsrun.environment import describe_environment
from mbsrun.external import Mechanism, OnDemand, load, load_on_demand
from mbsrun.lab.commands import lab_command
from mbsrun.measuring.commands import advise_command, chart
from mbsrun.ocp.checks import MAX_STEPS
from mbsrun.ocp.integrators import IntegratorName
from mbsrun.ocp.methods import METHODS as SOLVERS
from mbsrun.ocp.multistart import describe_starts
from mbsrun.ocp.pictures import animate, draw_mechanism, plot_starts, plot_trajectories
from mbsrun.ocp.plant import Plant
from mbsrun.ocp.problem import Form, Inputs, Problem, Representation, SolverName, cylindrical, find_conflicts
from mbsrun.ocp.record import Attempt, open_record
from mbsrun.ocp.resimulation import resimulate
from mbsrun.ocp.search import (
    Alone,
    OutOfTimeError,
    ProtocolName,
    Search,
    Study,
    Summary,
    Targets,
    describe,
    describe_search,
    identify,
    list_open_tasks,
    summarise,
)
from mbsrun.ocp.solution import Failure, Resimulation, Solution, Starts, read_guess, read_solution, write_solution
from mbsrun.ocp.solve import Progress, solve
from mbsrun.ocp.starting import Wish, solve_from_many
from mbsrun.ocp.starts import describe_turns, list_turning
from mbsrun.ocp.statement import read_problem
from mbsrun.ocp.table import write_table
from mbsrun.ocp.trajectory import Trajectory
from mbsrun.simulation.drive import hold_steps, input_labels
from mbsrun.simulation.methods import METHODS, Formulation
from mbsrun.simulation.motion import Motion
from mbsrun.simulation.record import FILES as MOTION_FILES
from mbsrun.simulation.record import describe_settings, write_motion
from mbsrun.simulation.simulate import simulate
from mbsrun.simulation.statement import Recording, read_statement
from mbsrun.studies import study_command

NOT_SOLVED = 1  # exit codes; 0 is a solution as accurate as the problem asks for
BAD_INPUT = 2

SOLUTION = "solution.json"
TRAJECTORIES = "trajectories.png"
MECHANISM = "mechanism.png"
ANIMATION = "animation.html"
TABLE = "solution.csv"
FILES = (SOLUTION, TABLE, TRAJECTORIES, MECHANISM, ANIMATION)
DISTRIBUTION, STARTS = "starts.png", "starts.sqlite"  # of a search from many starts
MAX_STARTS = 100_000
SHOWN = 10  # minima that are printed

PLAIN = ("input_period", "max_steps", "max_seconds")  # of a simulation
DAY = 86400.0  # s
UNCUT = 200  # characters in a line where nobody sees a terminal's width
KINDS = {"generated": "generated", "object": "objects", "library": "libraries", "unfinished": "unfinished"}

MESSAGES = Console(stderr=True)

HELP = """Simulate multibody systems, and solve optimal control problems of theirs.

\b
  mbsrun simulate MODEL -o DIR  integrate a motion, and write it, plots and an animation to DIR
  mbsrun solve PROBLEM -o DIR   solve, and write solution and pictures to DIR
  mbsrun sweep PROBLEM -o FILE  solve for a grid of targets, by a protocol, and tell what it took
  mbsrun study PROBLEM          solve for all targets, formulations and costs of a paper, and report
  mbsrun chart kernels MODEL    draw speed against accuracy of kernels, or of simulation
  mbsrun advise MODEL           tell what is fastest for a model, at an accuracy
  mbsrun lab                    run the cases in which methods fail, and judge
  mbsrun cache                  tell what was generated and compiled, or clear it

MODEL and PROBLEM are YAML files; models/ holds examples. Summaries go to stdout, progress and messages to stderr.
"""

SOLVE_HELP = """Solve the optimal control problem of the file PROBLEM.

It is put on a grid by direct collocation or multiple shooting, and solved by IPOPT with the exact derivatives of the
generated kernels, from the guess that the problem describes, or from another solution. The motion under the inputs
found is then integrated by another method, and the two are compared.

\b
The output folder gets
  solution.json       the problem, what the solver did, every number of the trajectory
  solution.csv        time, coordinates, velocities, accelerations, inputs, sensors;
                      a row for each mesh and collocation point, names and units on top
  trajectories.png    coordinates, velocities and inputs over time
  mechanism.png       the mechanism on its way
  animation.html      plays the motion in any browser
  starts.png          with --starts: the cost that each start found
  starts.sqlite       with --starts: every start, so that the command goes on where it was

A solver finds a local minimum near its guess. --starts 20 solves from 20 starts: the guess, and random ones (bumps and
noise on the guess, other end poses, whole turns of joints without limits). The best solution is written, and how often
its cost was found; lower ones may exist. Ctrl-C ends the search, and the best so far is written.

\b
Exit codes
  0   solved, and as accurate as the problem asks for; nothing is said of lower minima
  1   not solved, and nothing written; or solved, but short of the tolerance or
      the accuracy asked for: then the solution is written, and says so
  2   the problem, its model or an argument cannot be accepted; nothing written
"""


SWEEP_HELP = """Solve PROBLEM for a grid of targets, in several representations, and sum up.

Targets are places for the one sensor that has a target, on a cylinder about the base's z axis; the usual grid is the 21
times 11 of Docquier, Bruls, Fisette. Every attempt goes into the file -o as it ends: the command can be stopped, and
given again to go on, with more targets, costs, representations, or the other protocol.

\b
Protocols
  paper    for each representation the interpolation with inputs 0, and no restart;
           what fails or ends in a higher minimum than any that is known is counted
  robust   interpolations with the inputs of their motion; random starts: bumps and noise
           on them, other end poses, whole turns of joints without limits; then the
           solutions of neighbours, and of other representations, until nothing is new

A search finds minima, and cannot show that there is no lower one: the summary says how many independent starts found
the lowest cost known. Motions with whole turns are compared among themselves, and listed on their own.

\b
Exit codes
  0   the protocol is through; if it is the robust one, every task was solved, in the
      lowest minimum that was found for its target: lower ones may exist
  1   some tasks are not solved, or are in a higher minimum than one that was found;
      or the time is over
  2   the problem, its model or an argument cannot be accepted
"""

SIMULATE_HELP = """Integrate the motion of MODEL, and write it with its energy, plots and an animation.

MODEL is a model file, or a folder that mbsgen wrote. The motion starts at time 0 where --pose and --velocity put it (0
where they do not), under the inputs of --input. What is written again and again goes into a file, which may also give
the wrenches that a model leaves open; an option wins over the file:

\b
  duration: 5
  method: rk4
  step: 1e-3
  start: {pose: {q1: pi/2}}
  inputs: {q1: 0.2*sin(3*t) - 2*qd_q1}
  wrenches: {contact: {force: [0, 0, 10*t]}}

\b
Methods
  euler, symplectic-euler, rk4             explicit, of the fixed length --step; they run in C
  dop853, rk45                             explicit, adaptive; dop853 is what you get
  lsoda, radau, bdf                        adaptive, for stiff motions too, with exact Jacobians
  generalized-alpha, radau-iia, gauss      implicit, of the fixed length --step, on the
                                           residual: no mass matrix is formed with impl

\b
Formulations
  exp2, exp1   accelerations: by articulated bodies, by elimination in the mass matrix
  semi, impl   mass matrix and bias, residual; explicit methods then solve for accelerations

\b
The output folder gets
  simulation.json   settings, effort, energies, warnings, where the motion ends
  trajectory.csv    every number kept: coordinates, velocities, inputs, energies
  plots.png         the same over time
  animation.html    plays the motion in any browser

Energies are a check: what kinetic and potential energy have become beyond the work of inputs, springs, dampers and
wrenches is the drift that the integration errs by.

\b
Exit codes
  0   the end was reached
  1   it was not: a kernel, a step or the motion failed, or a limit of steps or seconds is
      used up; the message gives time, joint and reason; what was reached is written, and
      marked as incomplete
  2   the model, a file or an argument cannot be accepted; nothing written
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
    """Simulate, and solve optimal control problems: `mbsrun`."""


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
@click.option(
    "--guess",
    "other",
    type=click.Path(path_type=Path),
    metavar="SOLUTION",
    help="A solution.json to start from; its grid, horizon and representation may be others.",
)
@click.option(
    "--guess-inputs",
    type=click.Choice(["zero", "static", "dynamic"]),
    help="The inputs of a guess that is made here: 0, what holds its poses, or what makes its motion.",
)
@click.option(
    "--representation",
    type=click.Choice([r.value for r in Representation], case_sensitive=False),
    help="How the equations of motion become constraints; by default as the problem says.",
)
@click.option(
    "--form",
    type=click.Choice([form.value for form in Form]),
    help="What of the motion within an interval is a variable; shooting: nothing. By default as the problem says.",
)
@click.option(
    "--integrator", type=click.Choice(get_args(IntegratorName)), help="Of shooting: the scheme's own method, or rk4."
)
@click.option("--steps", type=click.IntRange(1, MAX_STEPS), help="Of the integrator in an interval; by default 1.")
@click.option("--solver", type=click.Choice(list(SOLVERS)), help="What solves the program; by default ipopt.")
@click.option(
    "--starts", type=click.IntRange(1, MAX_STARTS), help="Solve from so many starts, and write the best solution."
)
@click.option(
    "--hops",
    type=click.IntRange(0, 1000),
    help="With --starts: so many more from the best, with waves on it; again while they lead to a lower cost.",
)
@click.option("--seed", type=click.IntRange(0), help="Of the random starts; by default 0.")
@click.option("--minutes", type=click.FloatRange(min=0), help="With --starts: begin no start after so much time.")
@click.option("--workers", type=click.IntRange(0), help="With --starts: so many processes; by default this one alone.")
@click.pass_context
def solve_command(
    context: click.Context,
    /,
    file: Path,
    out: Path | None,
    target: tuple[float, float, float] | None,
    other: Path | None,
    starts: int | None,
    hops: int | None,
    seed: int | None,
    minutes: float | None,
    workers: int | None,
    **choices: Any,
) -> None:
    """Read, solve, re-simulate, write, print."""
    models: list[Path] = []

    def load_model(model: Path) -> Mechanism | OnDemand:
        models.append(model)
        return load_on_demand(model)

    problem, plant = read_problem(file, load_model)
    if target is not None:
        problem = _retarget(problem, target)
    problem = _choose(problem, **choices)
    if other is None and problem.guess.solution is not None:
        other = file.parent / problem.guess.solution
    if starts is None and (hops, seed, minutes, workers) != (None,) * 4:
        raise click.UsageError("--hops, --seed, --minutes and --workers belong to a search; give --starts too")
    if starts is not None and other is not None:
        raise click.UsageError("--starts makes its own starts; it takes no solution to start from")
    guess = None if other is None else read_guess(other, plant.manifest)
    out = out or Path(f"{problem.name}.solution")
    if starts is None:
        outcome: Solution | Failure | None = _solve(problem, plant, guess)
    else:
        wish = Wish(starts, seed or 0, math.inf if minutes is None else 60 * minutes, workers or 0, hops or 0)
        outcome = _search(problem, plant, models[-1], wish, out)
    if outcome is None:
        _say("the time was over before the first start ended")
        context.exit(NOT_SOLVED)
    if isinstance(outcome, Failure):
        _tell_failure(outcome, out)
        context.exit(NOT_SOLVED)
    with MESSAGES.status("integrating again") as status:
        outcome = resimulate(outcome, plant)
        status.update("drawing")
        written = _write(outcome, plant, out)
    _print_summary(outcome)
    _say(f"wrote {', '.join(str(out / name) for name in written)}")
    shortcomings = _list_shortcomings(outcome)
    for shortcoming in shortcomings:
        _say(f"warning: {shortcoming}")
    context.exit(NOT_SOLVED if shortcomings else 0)


@cli.command("sweep", help=SWEEP_HELP)
@click.argument("file", metavar="PROBLEM", type=click.Path(path_type=Path))
@click.option(
    "-o",
    "--output",
    "out",
    type=click.Path(dir_okay=False, path_type=Path),
    help="The file to keep the attempts in; by default NAME.sweep here, for a problem file NAME.ocp.yaml.",
)
@click.option("--protocol", type=click.Choice(["paper", "robust"]), default="robust", help="By default robust.")
@click.option("--radius", type=NumberType(), default=0.63, help="Of the cylinder [m]; by default 0.63.")
@click.option(
    "--azimuths",
    type=(NumberType(), NumberType(), click.IntRange(1, 1000)),
    default=(-math.pi / 2, math.pi / 2, 21),
    metavar="FROM TO COUNT",
    help="By default -pi/2 pi/2 21.",
)
@click.option(
    "--heights",
    type=(NumberType(), NumberType(), click.IntRange(1, 1000)),
    default=(-0.1, 0.1, 11),
    metavar="FROM TO COUNT",
    help="By default -0.1 0.1 11.",
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
    help="By default all; the first given is the one that looks for better minima.",
)
@click.option(
    "--bump",
    "bumped",
    metavar="NAME",
    multiple=True,
    help="A coordinate that random bumps move; by default all that are actuated.",
)
@click.option("--minutes", type=click.FloatRange(min=0), default=math.inf, help="Stop after so much time.")
@click.pass_context
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
    **grid: Any,
) -> None:
    """Read, search, sum up."""
    problem, plant = read_problem(file, load_on_demand)
    sensor = _find_sensor(problem, "PROBLEM")
    representations = tuple(Representation(name) for name in names) or tuple(Representation)
    for representation in representations:
        _check(replace(problem, representation=representation))
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
    )
    is_through = True
    about = (identify(study, plant.manifest), describe(study, plant.manifest))
    with open_record(out or Path(f"{problem.name}.sweep"), *about) as record:
        with MESSAGES.status("making the program") as status:
            crew = Alone(plant, describe_environment())
            try:
                Search(study, crew, record, lambda attempt, _: status.update(_tell(attempt)), 60 * minutes).run(
                    protocol
                )
            except OutOfTimeError:
                is_through = False
        attempts = list(record.attempts())
    _print_summaries(summarise(attempts))
    for line in describe_search(attempts):
        click.echo(line)
    if not is_through:
        _say("the time is over; give the command again to go on")
    context.exit(0 if is_through and (protocol == "paper" or not list_open_tasks(study, attempts)) else NOT_SOLVED)


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


@cli.command("simulate", help=SIMULATE_HELP)
@click.argument("model", type=click.Path(path_type=Path))
@click.option(
    "-o",
    "--output",
    "out",
    type=click.Path(file_okay=False, path_type=Path),
    help="The folder to write to; by default NAME.simulation here, for a model NAME.",
)
@click.option("--settings", "file", type=click.Path(path_type=Path), help="A file with settings; see above.")
@click.option("--duration", metavar="T", help="How long the motion is [s].")
@click.option("--method", type=click.Choice(list(METHODS)), help="How to integrate; by default dop853.")
@click.option("--formulation", type=click.Choice([f.value for f in Formulation]), help="On what; by default exp2.")
@click.option("--step", metavar="H", help="The longest step of a method with fixed ones [s]; by default 1e-3.")
@click.option("--rtol", metavar="R", help="The relative tolerance of an adaptive method; by default 1e-9.")
@click.option("--atol", metavar="A", help="The absolute one, in rad, m, rad/s and m/s; by default 1e-9.")
@click.option("--stages", type=int, metavar="S", help="The stages of radau-iia and gauss, 1 to 9; by default 2.")
@click.option(
    "--rho",
    metavar="R",
    help="What a step of generalized-alpha leaves of the highest frequencies: 0 nothing, 1 all; by default 0.8.",
)
@click.option("--output-step", metavar="H", help="The time between states that are kept [s]; by default T/1000.")
@click.option("--max-steps", type=int, metavar="N", help="Take at most so many steps; by default 10 million.")
@click.option("--max-seconds", metavar="S", help="Take at most so much processor time; by default 60 s.")
@click.option("--pose", multiple=True, metavar="NAME=NUMBER", help="Where a coordinate starts [rad, m]: --pose q1=pi/2")
@click.option("--velocity", multiple=True, metavar="NAME=NUMBER", help="How fast it starts [rad/s, m/s].")
@click.option(
    "--input",
    "inputs",
    multiple=True,
    metavar="NAME=EXPRESSION",
    help="The input of an actuated joint [N m, N], by the time t and the state: --input 'q1=0.2*sin(3*t) - 2*qd_q1'",
)
@click.option("--input-period", metavar="H", help="Compute inputs every H seconds, and hold them in between.")
@click.option("--parameter", "parameters", multiple=True, metavar="NAME=NUMBER", help="A run-time parameter.")
@click.option(
    "--solution",
    type=click.Path(path_type=Path),
    help="A solution.json of `mbsrun solve`: its inputs, and its start unless another is given.",
)
@click.pass_context
def simulate_command(
    context: click.Context, /, model: Path, out: Path | None, file: Path | None, solution: Path | None, **given: Any
) -> None:
    """Read, integrate, write, tell."""
    mechanism = load(model)
    recording = None if solution is None else _read_recording(solution, mechanism.manifest)
    statement = read_statement(file, _collect_options(given), mechanism.manifest, recording)
    mechanism = mechanism.with_parameters(**statement.parameters)
    out = out or Path(f"{model.stem}.simulation")
    with MESSAGES.status("integrating") as status:

        def show(time: float) -> None:
            status.update(f"integrating: t = {time:.4g} of {statement.settings.duration:.4g} s")

        motion = simulate(mechanism, statement.drive, statement.q, statement.qd, statement.settings, show)
        status.update("writing")
        write_motion(motion, mechanism, out)
    _print_motion(motion, mechanism.manifest)
    _say(f"wrote {', '.join(str(out / name) for name in MOTION_FILES)}")
    for warning in motion.warnings:
        _say(f"warning: {warning}")
    if motion.halt is not None:
        _say(f"{motion.halt}; what was written is incomplete")
        context.exit(NOT_SOLVED)


cli.add_command(chart)
cli.add_command(advise_command)
cli.add_command(study_command)
cli.add_command(lab_command)


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


def _collect_options(given: Mapping[str, Any]) -> dict[str, Data]:
    """Nest options as a settings file does; NAME=VALUE is split at its last =, since names may hold one."""
    plain = ("duration", "method", "formulation", "step", "output_step", "rtol", "atol", "stages", "rho", *PLAIN)
    options: dict[str, Data] = {name: given[name] for name in plain if given[name] is not None}
    start: dict[str, Data] = {key: pairs for key in ("pose", "velocity") if (pairs := _split(key, given[key]))}
    lists = {"start": start, "inputs": _split("input", given["inputs"])}
    lists["parameters"] = _split("parameter", given["parameters"])
    return {**options, **{key: pairs for key, pairs in lists.items() if pairs}}


def _split(option: str, pairs: Sequence[str]) -> dict[str, Data]:
    values: dict[str, Data] = {}
    for pair in pairs:
        name, sign, value = pair.rpartition("=")
        if not sign or not name.strip() or name.strip() in values:
            finding = f"{name.strip()} is given twice" if sign and name.strip() else f"found {pair!r}"
            raise click.BadParameter(f"{finding}; give NAME=VALUE, each name once", param_hint=f"--{option}")
        values[name.strip()] = value
    return values


def _read_recording(path: Path, manifest: Manifest) -> Recording:
    """Take start and inputs of a solution; it must be one of this model."""
    found = read_solution(path)
    names = manifest.positions
    inputs = input_labels(manifest)
    if (found.coordinates, found.inputs) != (names, inputs):
        told = f"it is of model {found.model}, with coordinates {', '.join(found.coordinates)}"
        raise InputError([Fault(str(path), 0, "", told, f"give one of a model with {', '.join(names)}")])
    if found.model_hash != manifest.model_hash:
        _say(f"warning: {path} was made with another version of the model")
    trajectory = found.trajectory
    return Recording(hold_steps(trajectory.t, trajectory.u), trajectory.q[0], trajectory.qd[0])


def _print_motion(motion: Motion, manifest: Manifest) -> None:
    settings, effort, energy = describe_settings(motion.settings), motion.effort, motion.energy
    numbers = ", ".join(f"{key} {value}" for key, value in settings.items() if key not in ("method", "formulation"))
    rows = {
        "model": f"{manifest.model}, {len(manifest.coordinates)} coordinates",
        "method": f"{settings['method']} ({METHODS[motion.settings.method].title}), {settings['formulation']}",
        "settings": numbers,
        "reached": f"{motion.t[-1]:.6g} s" + ("" if motion.halt is None else f" of {motion.settings.duration:.6g} s"),
        "steps": f"{effort.steps}, "
        + ("rejected: not told" if effort.rejected is None else f"{effort.rejected} rejected"),
        "evaluations": f"{effort.evaluations}, {effort.jacobians} of Jacobians, {effort.iterations} Newton iterations",
        "time": f"{effort.seconds:.3g} s of processor",
    }
    if energy is None:
        rows["energy"] = "unknown: it overflows, or a kernel fails on the way"
    else:
        total, drift = energy.total, np.abs(energy.drift).max()
        rows["energy"] = f"{total[0]:.8g} J at the start, {total[-1]:.8g} J at the end, {energy.work[-1]:.4g} J of work"
        rows["energy drift"] = f"{drift:.1e} J at most"
    for name, text in rows.items():
        click.echo(f"{name:<14}{text}")


def _retarget(problem: Problem, target: tuple[float, float, float]) -> Problem:
    return problem.with_target(_find_sensor(problem, "--target"), cylindrical(*target))


def _find_sensor(problem: Problem, argument: str) -> str:
    """Name the one sensor that has a target."""
    sensors = [name for name, _ in problem.end.sensors]
    if len(sensors) != 1:
        raise click.BadParameter(
            f"the problem has targets for {', '.join(sensors) or 'no sensor'}; it must have one for one sensor",
            param_hint=argument,
        )
    return sensors[0]


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
    Console(highlight=False, width=None if sys.stdout.isatty() else UNCUT).print(table)


def _choose(
    problem: Problem,
    representation: str | None,
    form: str | None,
    integrator: IntegratorName | None,
    steps: int | None,
    solver: SolverName | None,
    guess_inputs: Inputs | None,
) -> Problem:
    """Let the options win over the problem; what another solver was to be told goes with it.

    So do integrator and steps with shooting, which has them. Raises UsageError for what does not go together.
    """
    if representation is not None:
        problem = replace(problem, representation=Representation(representation))
    if form is not None and Form(form) is not problem.form:
        problem = replace(problem, form=Form(form), integrator=Problem.integrator, steps=Problem.steps)
    problem = replace(problem, integrator=integrator or problem.integrator, steps=steps or problem.steps)
    if guess_inputs is not None:
        problem = replace(problem, guess=replace(problem.guess, inputs=guess_inputs))
    if solver is not None and solver != problem.solver.method:
        problem = replace(problem, solver=replace(problem.solver, method=solver, options=()))
    _check(problem)
    return problem


def _check(problem: Problem) -> None:
    """Refuse what does not go together."""
    if conflicts := find_conflicts(problem):
        raise click.UsageError("; ".join(f"{c.key}: {c.finding}; {c.remedy}" for c in conflicts))


def _solve(problem: Problem, plant: Plant, guess: Trajectory | None) -> Solution | Failure:
    """Solve from one guess, and show the iterations."""
    with MESSAGES.status("making the program") as status:

        def show(progress: Progress) -> None:
            status.update(
                f"iteration {progress.iteration}: cost {progress.cost:.8g}, violation {progress.violation:.1e}"
            )

        return solve(problem, plant, show, guess)


def _search(
    problem: Problem, plant: Mechanism | OnDemand, model: Path, wish: Wish, out: Path
) -> Solution | Failure | None:
    """Solve from many starts, and show how many ended and the best cost."""
    out.mkdir(parents=True, exist_ok=True)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with ProgressBar(*columns, console=MESSAGES, transient=True) as bar:
        task = bar.add_task("solving", total=wish.starts)

        def show(starts: Starts) -> None:
            best = "" if starts.best is None else f", lowest cost {starts.best.cost:.8g}, found {starts.times} times"
            bar.update(
                task,
                completed=len(starts.results) + len(starts.hops),
                total=wish.starts + len(starts.hops),
                description=f"solving{best}",
            )

        starts, outcome = solve_from_many(problem, plant, model, wish, out / STARTS, show)
    _print_starts(starts)
    return outcome


def _print_starts(starts: Starts) -> None:
    """Print the minima that were found, how often, and the starts that found none."""
    table = Table(box=box.SIMPLE)
    table.add_column("cost", justify="right")
    table.add_column("found", justify="right")
    table.add_column("whole turns")
    for minimum in starts.minima[:SHOWN]:
        table.add_row(f"{minimum.cost:.8g}", str(minimum.found), describe_turns(minimum.turns))
    if starts.minima:
        Console(highlight=False, width=None if sys.stdout.isatty() else UNCUT).print(table)
    if len(starts.minima) > SHOWN:
        click.echo(f"and {len(starts.minima) - SHOWN} higher costs")
    if starts.hops:
        least = min((hop.cost for hop in starts.hops if hop.cost is not None), default=None)
        click.echo(f"{len(starts.hops)} hops" + ("" if least is None else f", lowest cost {least:.8g}"))
    failed = Counter(start.status for start in (*starts.results, *starts.hops) if start.cost is None)
    if failed:
        click.echo("no solution: " + ", ".join(f"{count} {status}" for status, count in failed.most_common()))
    if len(starts.results) < starts.asked:
        click.echo(f"{len(starts.results)} of {starts.asked} starts were made; give the command again to go on")


def _write(solution: Solution, plant: Plant, out: Path) -> tuple[str, ...]:
    """Write the files of a solution, and return their names."""
    out.mkdir(parents=True, exist_ok=True)
    write_solution(solution, out / SOLUTION)
    write_table(solution, plant, out / TABLE)
    plot_trajectories(solution, plant.manifest, out / TRAJECTORIES)
    draw_mechanism(solution, plant, out / MECHANISM)
    animate(solution, plant, out / ANIMATION)
    if solution.starts is None:
        return FILES
    plot_starts(solution.starts, out / DISTRIBUTION)
    return (*FILES, DISTRIBUTION, STARTS)


def _print_summary(solution: Solution) -> None:
    run, size, cost, check = solution.run, solution.size, solution.cost, solution.resimulation
    violation = solution.violation
    assert check is not None, "a solution is re-simulated before it is shown"
    rows = {
        "problem": f"{solution.problem.name}, model {solution.model}",
        "status": f"{run.status}, {run.iterations} iterations",
        "time": f"{run.seconds:.2f} s",
        "  processor": f"{run.cpu_seconds:.2f} s: {run.cpu_seconds_evaluating:.2f} s for functions and derivatives, "
        f"{run.cpu_seconds_solving:.2f} s for linear algebra and the rest",
        "horizon": f"{solution.trajectory.t[-1]:.10g} s",
        "program": f"{size.variables} variables, {size.constraints} constraints",
        "nonzeros": f"{size.jacobian_nonzeros} in the Jacobian, {size.hessian_nonzeros} in the Hessian's triangle",
        "cost": f"{cost.total:.10g}",
        **({} if solution.starts is None else {"starts": describe_starts(solution.starts)}),
        **{f"  {name} ": f"{value:.10g}" for name, value in cost.terms if value != 0},
        "violation": f"{violation.constraints:.1e} of constraints, {violation.bounds:.1e} of bounds"
        + ("" if violation.lengths is None else f", {violation.lengths:.1e} of quaternions' lengths"),
        "defect": f"{_number(check.defect, check)} in an interval, at most; {solution.problem.accuracy:.1e} asked for",
        "open loop": f"{_number(check.open_loop_error, check)} off at the end, under the inputs alone",
    }
    for name, value in rows.items():
        click.echo(f"{name:<14}{value}")


def _list_shortcomings(solution: Solution) -> list[str]:
    """Say what keeps a solution from being all that was asked for."""
    check, found = solution.resimulation, []
    if solution.is_only_acceptable:
        found.append("IPOPT stopped at an acceptable level, short of the tolerance; try another guess or scaling")
    if check is not None and check.unfinished:
        found.append(
            f"the re-simulation did not finish, {check.unfinished}, so the accuracy is unknown; "
            "take a shorter horizon, or check a part of it"
        )
    elif check is not None and not check.is_accurate:
        found.append(
            f"the largest defect of an interval, {_number(check.defect, check)}, is above the accuracy asked for, "
            f"{solution.problem.accuracy:.1e}; take more intervals or a higher degree"
        )
    return found


def _tell_failure(failure: Failure, out: Path) -> None:
    _say(f"not solved ({failure.run.status}): {failure.finding}; {failure.remedy}")
    if (out / SOLUTION).exists():
        _say(f"{out / SOLUTION} is from an earlier solve")


def _number(value: float | None, check: Resimulation) -> str:
    reason = "the re-simulation did not finish" if check.unfinished else "the integrator gave up"
    return f"unknown ({reason})" if value is None else f"{value:.1e}"


def _say(message: str) -> None:
    click.echo(message, err=True)
