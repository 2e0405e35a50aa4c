"""`mbsrun solve` of a problem in phases: solve all, re-simulate each, write, print."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import click

from mbsrun.commands.columns import check_columns
from mbsrun.commands.console import NOT_SOLVED, list_written, say, show_status
from mbsrun.commands.failures import print_failure
from mbsrun.commands.searching import print_starts, show_search
from mbsrun.external import load_on_demand
from mbsrun.ocp.multistart import Wish
from mbsrun.ocp.phases.files import write_files
from mbsrun.ocp.phases.multistart import solve_phases_from_many
from mbsrun.ocp.phases.placing import name_guesses
from mbsrun.ocp.phases.problem import PhasedProblem, Plants
from mbsrun.ocp.phases.recorded import find_phased_guess
from mbsrun.ocp.phases.solution import Guess, PartialGuess, PhasedSolution
from mbsrun.ocp.phases.solve import resimulate_phases, solve_phases
from mbsrun.ocp.phases.statement import read_phased_problem
from mbsrun.ocp.phases.summary import list_phased_shortcomings, summarise_phases
from mbsrun.ocp.problem import Problem, Refinement
from mbsrun.ocp.refinement import refine_phases
from mbsrun.ocp.runs import Progress
from mbsrun.ocp.solution import Failure, Round
from mbsrun.ocp.summary import write_line


def solve_file(
    file: Path,
    out: Path | None,
    other: Path | None,
    choose: Callable[[Problem], Problem],
    solver: str | None,
    threads: int | None = None,
    fallback: bool | None = None,
    accuracy: float | None = None,
    wish: Wish | None = None,
    columns: tuple[str, ...] = (),
) -> int:
    """Solve the problem of a file, write and print the solution; return the exit code.

    `choose` changes the problem of each phase. With an accuracy, the grids of all phases are refined until it holds.
    With a wish, it is solved from many starts. `columns` are further columns of the tables.
    """
    problem, plants = read_phased_problem(file, load_on_demand)
    problem = replace(problem, phases=tuple(replace(p, problem=choose(p.problem)) for p in problem.phases))
    if solver is not None:
        problem = replace(problem, solver=problem.solver.with_method(solver))
    if threads is not None:
        problem = replace(problem, solver=replace(problem.solver, threads=threads))
    if fallback is not None:
        problem = replace(problem, solver=replace(problem.solver, fallback=fallback))
    if accuracy is not None:
        problem = _ask(problem, accuracy)
    has_own = any(phase.problem.guess.solution is not None for phase in problem.phases)
    if wish is not None and (other is not None or has_own):
        raise click.UsageError("--starts makes its own starts; it takes no solution to start from")
    check_columns(columns, [(p.problem, plant) for p, plant in zip(problem.phases, plants.phases, strict=True)])
    guess = find_phased_guess(problem, plants, file.parent, other, name_guesses(file))
    out = out or Path(f"{problem.name}.solution")
    outcome = _solve(problem, plants, guess) if wish is None else _search(problem, plants, wish)
    if outcome is None:
        say("the time was over before the first start ended")
        return NOT_SOLVED
    if isinstance(outcome, Failure):
        print_failure(outcome, file, out)
        return NOT_SOLVED
    with show_status("integrating again") as status:
        outcome = resimulate_phases(outcome, plants)
        if any(phase.problem.refine is not None for phase in problem.phases):
            outcome = refine_phases(outcome, plants, lambda name, round_: status.update(_describe(name, round_)))
        status.update("drawing")
        written = write_files(outcome, plants, out, columns)
    for name, value in summarise_phases(outcome).items():
        click.echo(write_line(name, value, 24))
    if outcome.run.instead:
        say(f"note: {outcome.run.instead}")
    say(f"wrote {list_written(out, written)}")
    shortcomings = list_phased_shortcomings(outcome)
    for shortcoming in shortcomings:
        say(f"warning: {shortcoming}")
    return NOT_SOLVED if shortcomings else 0


def _ask(problem: PhasedProblem, accuracy: float) -> PhasedProblem:
    """Ask every phase for an accuracy; its number of rounds stays."""
    phases = []
    for phase in problem.phases:
        before = phase.problem.refine
        asked = Refinement(accuracy) if before is None else replace(before, accuracy=accuracy)
        phases.append(replace(phase, problem=replace(phase.problem, refine=asked)))
    return replace(problem, phases=tuple(phases))


def _describe(name: str, last: Round) -> str:
    defect = "unknown" if last.defect is None else f"{last.defect:.1e}"
    return f"phase {name}: {len(last.times) - 1} intervals, degree {last.degree}: defect {defect}; refining"


def _solve(problem: PhasedProblem, plants: Plants, guess: Guess | PartialGuess) -> PhasedSolution | Failure:
    with show_status("making the program") as status:

        def show(progress: Progress) -> None:
            status.update(
                f"iteration {progress.iteration}: cost {progress.cost:.8g}, violation {progress.violation:.1e}"
            )

        return solve_phases(problem, plants, show, guess)


def _search(problem: PhasedProblem, plants: Plants, wish: Wish) -> PhasedSolution | Failure | None:
    """Solve from many starts, and print the costs that they found."""
    with show_search(wish.starts) as watch:
        starts, outcome = solve_phases_from_many(problem, plants, wish, watch)
    print_starts(starts, "")
    return outcome
