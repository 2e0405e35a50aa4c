"""`mbsrun solve`: a problem file -> a solution, with tables and pictures."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from mbsgen.help import ModelCommand
from mbsrun.commands.columns import check_columns, more_columns
from mbsrun.commands.console import (
    NOT_SOLVED,
    NameType,
    NumberType,
    check_conflicts,
    choose_format,
    find_sensor,
    list_written,
    output_folder,
    say,
    show_status,
)
from mbsrun.commands.derived import ALL, differentiate, list_gaps, list_rows, read_control, write_derivatives
from mbsrun.commands.failures import print_failure
from mbsrun.external import load_on_demand
from mbsrun.ocp.ground.integrators import INTEGRATORS
from mbsrun.ocp.ground.no_mechanism import NO_MECHANISM
from mbsrun.ocp.ground.plant import Plant
from mbsrun.ocp.guessing.recorded import find_guess
from mbsrun.ocp.guessing.recorded_phases import find_phased_guess
from mbsrun.ocp.methods import METHODS as SOLVERS
from mbsrun.ocp.problem.phases import PhasedProblem, Plants, list_one
from mbsrun.ocp.problem.problem import Form, Inputs, Loops, Problem, Refinement, Representation, SolverName, cylindrical
from mbsrun.ocp.showing.phase_summary import list_phased_shortcomings, summarise_phases
from mbsrun.ocp.showing.summary import write_line
from mbsrun.ocp.solution.phases import Guess, PartialGuess, PhasedSolution, list_solution
from mbsrun.ocp.solution.solution import STARTS, Failure, Round, Solution
from mbsrun.ocp.solving.phases import resimulate_phases, solve_phases
from mbsrun.ocp.solving.placing import name_guesses, name_lines, naming_guess
from mbsrun.ocp.solving.runs import Progress
from mbsrun.ocp.statement.checks import LEAST_ACCURACY, MAX_STEPS, MAX_THREADS
from mbsrun.ocp.statement.phases import has_phases, read_phased_problem
from mbsrun.ocp.statement.statement import read_problem

if TYPE_CHECKING:
    from mbsrun.ocp.searching.multistart import Wish

MAX_STARTS = 100_000


SOLVE_HELP = """Solve the optimal control problem of the file PROBLEM.

The problem is discretised by direct collocation or multiple shooting, and solved with the exact derivatives of the
generated kernels, from the guess that the problem describes, or from another solution: by the project's own
interior-point method, or by IPOPT. Another method then integrates the motion under the inputs found, and the two are
compared.

\b
  mbsrun solve models/cart_pole_swing_up.ocp.yaml -o swing_up
  mbsrun solve models/acrobot_swing_up.ocp.yaml --starts 20


\b
The output folder gets
  solution.json       the problem, the solver's run, every number of the trajectory
  solution.csv        time, coordinates, velocities, accelerations, inputs, forces of loops and of driven
                      joints, sensors, and what --columns names; a row for each mesh and collocation point,
                      names and units on top
  trajectories.png    coordinates, velocities and inputs over time
  mechanism.png       the mechanism on its way
  animation.html      plays the motion in any browser
  mesh.png            with --refine: the defect of every interval, grid by grid
  starts.png          with --starts: the cost that each start found
  starts.sqlite       with --starts: every start, so that the command can continue later
  derivatives.json    with --by: the derivatives of cost and motion

A solver finds a local minimum near its guess. --starts 20 solves from 20 starts: the guess, and random ones (bumps and
noise on the guess, other end poses, whole turns of joints without limits). The best solution is written; the summary
shows how often its cost was found. Lower ones may exist. Ctrl-C ends the search, and the best so far is written.

For a problem with `phases` or `links`, an option applies to every phase, and --target to the one phase that has a
target; --hops and --workers are refused, and there is no starts.sqlite. Each phase has a table NAME.csv.

\b
Exit codes
  0   solved to a local minimum, and as accurate as the problem requires
  1   not solved, and nothing written; or solved, but not to the required tolerance or
      accuracy: then the solution is written, with the reasons
  2   the problem, its model or an argument cannot be accepted; nothing written
"""


SECTIONS = {
    "The problem": ("target", "other", "guess_inputs"),
    "The grid": ("representation", "form", "loops", "integrator", "steps", "refine"),
    "The solver": ("solver", "fallback", "threads"),
    "Many starts": ("starts", "hops", "seed", "minutes", "workers"),
    "Results": ("sensitivities", "by", "columns", "format"),
}


@click.command("solve", cls=ModelCommand, help=SOLVE_HELP, sections=SECTIONS)
@click.argument("file", metavar="PROBLEM", type=click.Path(path_type=Path))
@output_folder("solution")
@click.option(
    "--target",
    type=NumberType(),
    nargs=3,
    metavar="R PHI Z",
    help="Another target for the sensor with a target: radius [m], azimuth [rad] and height [m] "
    "about the base's z axis. For example --target 0.63 pi/2 -0.1",
)
@click.option(
    "--guess",
    "other",
    type=click.Path(path_type=Path),
    metavar="SOLUTION",
    help="A solution.json to start from, or a recorded motion (.csv, .mot, .sto); for phases also a folder of tables. "
    "Grid, horizon and representation may be others.",
)
@click.option(
    "--guess-inputs",
    type=click.Choice(["zero", "static", "dynamic"]),
    help="The inputs of the guess: 0, the forces that hold its poses, or the inverse dynamics of its motion.",
)
@click.option(
    "--representation",
    type=click.Choice([r.value for r in Representation], case_sensitive=False),
    help="How the equations of motion become constraints; by default as the problem says.",
)
@click.option(
    "--form",
    type=click.Choice([form.value for form in Form]),
    help="The variables of the motion within an interval; shooting has none. By default as the problem says.",
)
@click.option(
    "--loops",
    type=click.Choice([loops.value for loops in Loops]),
    help="How closed loops become variables; by default as the problem says, or reduced where the guess permits it.",
)
@click.option(
    "--integrator",
    type=NameType(INTEGRATORS),
    help="How the motion follows from accelerations; rk4 is for shooting alone.",
)
@click.option(
    "--steps",
    type=click.IntRange(1, MAX_STEPS),
    help="With --form shooting: the number of steps in an interval; by default 1.",
)
@click.option("--solver", type=NameType(SOLVERS), help="The NLP method; by default mbs, the project's own.")
@click.option(
    "--fallback/--no-fallback",
    default=None,
    help="Whether IPOPT tries where mbs finds no solution; by default yes, unless a method is named.",
)
@click.option(
    "--threads", type=click.IntRange(1, MAX_THREADS), help="The number of threads of a solve by mbs; by default 1."
)
@click.option(
    "--refine",
    type=NumberType(),
    metavar="ACCURACY",
    help="Refine the grid until the largest defect of an interval is at most this; by default as the problem says.",
)
@click.option(
    "--starts", type=click.IntRange(1, MAX_STARTS), help="The number of starts; the best solution is written."
)
@click.option(
    "--hops",
    type=click.IntRange(0, 1000),
    help="With --starts: the number of hops, from the best motion with waves added; repeated while the cost falls.",
)
@click.option("--seed", type=click.IntRange(0), help="With --starts: the seed of random starts; by default 0.")
@click.option("--minutes", type=click.FloatRange(min=0), help="With --starts: the time after which no start begins.")
@click.option(
    "--workers", type=click.IntRange(0), help="With --starts: the number of processes; by default this one alone."
)
@click.option(
    "--sensitivities", is_flag=True, help="Print the derivative of the cost by each differentiated parameter, too."
)
@click.option(
    "--by",
    multiple=True,
    metavar="NUMBER",
    help="Differentiate cost and motion by a number of the problem, which its place in the file names, such as "
    "cost.inputs or start.pose.cart; all: by every one. May be given several times.",
)
@more_columns
@choose_format
@click.pass_context
@name_lines
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
    sensitivities: bool,
    by: tuple[str, ...],
    columns: tuple[str, ...],
    **choices: Any,
) -> None:
    """Read, solve, re-simulate, write, print."""
    if starts is None and (hops, seed, minutes, workers) != (None,) * 4:
        raise click.UsageError("--hops, --seed, --minutes and --workers belong to a search; give --starts too")
    wish = None
    if starts is not None:
        from mbsrun.ocp.searching.multistart import Wish  # here and below: what takes long to load, and few solves need

        wish = Wish(starts, seed or 0, math.inf if minutes is None else 60 * minutes, workers or 0, hops or 0)
    is_phased = has_phases(file)
    given = [name for name, value in (("hops", hops), ("workers", workers)) if value is not None]
    if is_phased and given:
        raise click.UsageError(
            f"{', '.join(f'--{name}' for name in given)}: only for problems of one phase; leave it out"
        )
    models: list[Path] = []

    def load_model(model: Path) -> Plant:
        models.append(model)
        return load_on_demand(model)

    control = read_control(file, by) if by else None
    problem, plants = read_phased_problem(file, load_model) if is_phased else _read(file, load_model)
    if target is not None:
        problem = _retarget(problem, target)
    problem = _choose(problem, **choices)
    check_columns(columns, [(own.problem, plant) for own, plant in zip(problem.phases, plants.phases, strict=True)])
    if starts is not None and (other is not None or any(own.problem.guess.solution for own in problem.phases)):
        raise click.UsageError("--starts makes its own starts; it takes no solution to start from")
    guess = _find_guess(problem, plants, file, other)
    out = out or Path(f"{problem.name}.solution")
    outcome = _solve(problem, plants, guess) if wish is None else _search(problem, plants, models, wish, out)
    if outcome is None:
        say("the time was over before the first start ended")
        context.exit(NOT_SOLVED)
    if isinstance(outcome, Failure):
        print_failure(outcome, file, out)
        context.exit(NOT_SOLVED)
    with show_status("integrating again") as status:
        outcome = resimulate_phases(outcome, plants)
        if any(own.problem.refine is not None for own in problem.phases):
            from mbsrun.ocp.searching.refinement import refine_phases

            outcome = refine_phases(outcome, plants, lambda name, last: status.update(_describe_round(name, last)))
        if sensitivities:
            from mbsrun.ocp.optima.sensitivity import find_phased_sensitivities

            status.update("differentiating the cost")
            outcome = find_phased_sensitivities(outcome, plants)
        derivatives = None
        if control is not None:
            status.update("differentiating the solution")
            derivatives = differentiate(control, outcome, plants, by)
        status.update("drawing")
        from mbsrun.ocp.showing.files import write_files

        written = write_files(outcome, plants, out, columns)
        if derivatives is not None:
            written = (*written, write_derivatives(derivatives, out))
    for name, value in summarise_phases(outcome).items():
        click.echo(write_line(name, value, 14 if problem.is_single else 24))
    for name, value in [] if derivatives is None else list_rows(derivatives):
        click.echo(write_line(name, value, 14 if problem.is_single else 24))
    if outcome.run.instead:
        say(f"note: {outcome.run.instead}")
    say(f"wrote {list_written(out, written)}")
    shortcomings = list_phased_shortcomings(outcome)
    if sensitivities and not outcome.sensitivities:
        shortcomings.append(
            "no derivative of the cost was found: the model has no differentiated parameter but unknowns, or the "
            "optimum has none; --by all shows the reason"
        )
    gaps = [] if derivatives is None else list_gaps(derivatives)
    if ALL in by:
        for gap in gaps:
            say(f"note: {gap}")
    else:
        shortcomings += gaps
    for shortcoming in shortcomings:
        say(f"warning: {shortcoming}")
    context.exit(NOT_SOLVED if shortcomings else 0)


def _read(file: Path, load_model: Callable[[Path], Plant]) -> tuple[PhasedProblem, Plants]:
    """Read a problem without phases as a list of one."""
    problem, plant = read_problem(file, load_model, NO_MECHANISM)
    return list_one(problem), Plants((plant,))


def _find_guess(problem: PhasedProblem, plants: Plants, file: Path, other: Path | None) -> Guess | PartialGuess | None:
    """Read the solution or the recording to start from, as the option or the problem gives it."""
    if not problem.is_single:
        return find_phased_guess(problem, plants, file.parent, other, name_guesses(file))
    own = problem.phases[0].problem
    is_own = other is None and own.guess.solution is not None
    if other is None and own.guess.solution is not None:
        other = file.parent / own.guess.solution
    with naming_guess(file, is_own=is_own):
        return None if other is None else Guess((find_guess(other, own, plants.phases[0]),))


def _describe_round(name: str, last: Round) -> str:
    defect = "unknown" if last.defect is None else f"{last.defect:.1e}"
    phase = f"phase {name}: " if name else ""
    return f"{phase}{len(last.times) - 1} intervals, degree {last.degree}: defect {defect}; refining"


def _check_accuracy(accuracy: float) -> None:
    if not LEAST_ACCURACY <= accuracy < math.inf:
        raise click.UsageError(f"--refine {accuracy:g}: give at least {LEAST_ACCURACY:g}")


def _retarget(problem: PhasedProblem, target: tuple[float, float, float]) -> PhasedProblem:
    """Move the target of the one phase that has one."""
    aimed = [own.problem for own in problem.phases if own.problem.end.sensors] or [problem.phases[0].problem]
    if len(aimed) > 1:
        named = ", ".join(own.name for own in problem.phases if own.problem.end.sensors)
        raise click.BadParameter(
            f"the phases {named} have targets; --target needs exactly one phase with a target", param_hint="--target"
        )
    moved = aimed[0].with_target(find_sensor(aimed[0], "--target"), cylindrical(*target))
    return problem.change(lambda own: moved if own is aimed[0] else own)


def _choose(
    problem: PhasedProblem,
    solver: SolverName | None,
    threads: int | None,
    fallback: bool | None,
    refine: float | None,
    **ways: Any,
) -> PhasedProblem:
    """Replace parts of every phase by options. Another method drops the options of the former one.

    Raises UsageError for conflicts.
    """
    problem, options = problem.change(lambda own: _choose_way(own, **ways)), problem.solver
    if solver is not None:
        options = options.with_method(solver)
    if threads is not None:
        options = replace(options, threads=threads)
    if fallback is not None:
        options = replace(options, fallback=fallback)
    if refine is not None:
        _check_accuracy(refine)
        problem = problem.change(
            lambda own: replace(own, refine=replace(own.refine or Refinement(refine), accuracy=refine))
        )
    problem = replace(problem, solver=options)
    if problem.is_single:  # phases are checked together, and named
        problem = problem.change(lambda own: replace(own, solver=options))
        check_conflicts(problem.phases[0].problem)
    return problem


def _choose_way(
    problem: Problem,
    representation: str | None,
    form: str | None,
    loops: str | None,
    integrator: str | None,
    steps: int | None,
    guess_inputs: Inputs | None,
) -> Problem:
    """Replace what options say of a phase. Another form drops its integrator and steps."""
    if representation is not None:
        problem = replace(problem, representation=Representation(representation))
    if form is not None and Form(form) is not problem.form:
        problem = replace(problem, form=Form(form), integrator=Problem.integrator, steps=Problem.steps)
    if loops is not None:
        problem = replace(problem, loops=Loops(loops))
    problem = replace(problem, integrator=integrator or problem.integrator, steps=steps or problem.steps)
    if guess_inputs is not None:
        problem = replace(problem, guess=replace(problem.guess, inputs=guess_inputs))
    return problem


def _solve(problem: PhasedProblem, plants: Plants, guess: Guess | PartialGuess | None) -> PhasedSolution | Failure:
    """Solve from one guess, and show the iterations."""
    with show_status("making the program") as status:

        def show(progress: Progress) -> None:
            status.update(
                f"iteration {progress.iteration}: cost {progress.cost:.8g}, violation {progress.violation:.1e}"
            )

        return solve_phases(problem, plants, show, guess)


def _search(
    problem: PhasedProblem, plants: Plants, models: Sequence[Path], wish: Wish, out: Path
) -> PhasedSolution | Failure | None:
    """Solve from many starts, and show how many ended and the best cost; without phases, a file keeps the starts."""
    from mbsrun.commands.searching import print_starts, show_search
    from mbsrun.ocp.searching.multistart import solve_from_many
    from mbsrun.ocp.searching.phases import solve_phases_from_many

    with show_search(wish.starts) as watch:
        if not problem.is_single:
            starts, outcome = solve_phases_from_many(problem, plants, wish, watch)
        else:
            out.mkdir(parents=True, exist_ok=True)
            own, model = problem.phases[0].problem, models[-1] if models else None
            starts, found = solve_from_many(own, plants.phases[0], model, wish, out / STARTS, watch)
            outcome = list_solution(found) if isinstance(found, Solution) else found
    print_starts(starts, "; repeat the command to continue" if problem.is_single else "")
    return outcome
