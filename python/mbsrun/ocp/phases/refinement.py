"""Solve phases again on finer grids, until the re-simulation confirms the accuracy of each; see `ocp.refinement`.

In every round, each phase that is inaccurate, and asks for refinement, gets its next grid; then all phases are solved.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from mbsrun.ocp import methods, schemes
from mbsrun.ocp.phases.guess import Unreached, guess_phases
from mbsrun.ocp.phases.problem import Phase, PhasedProblem, Plants
from mbsrun.ocp.phases.solution import PhasedSolution
from mbsrun.ocp.phases.solve import PhasedSolver, resimulate_phases
from mbsrun.ocp.problem import Problem
from mbsrun.ocp.refinement import choose_grid, find_end, record_round
from mbsrun.ocp.runs import Watch
from mbsrun.ocp.solution import Failure, Round, Rounds, Solution
from mbsrun.ocp.trajectory import resample

Show = Callable[[str, Round], None]  # the name of a phase, and its round


@dataclass
class _Course:
    """The refinement of one phase so far."""

    rounds: list[Round]
    finding: str = ""
    problem: Problem | None = None  # of the next round, where the grid changes
    change: str = ""

    def choose(self, solution: Solution) -> None:
        """Choose the next grid, or end."""
        asked = solution.problem.refine
        self.problem, self.finding = None, "" if asked else "the phase keeps its grid"
        if asked is not None:
            self.finding = find_end(solution, len(self.rounds) - 1, asked.rounds)
        if not self.finding:
            chosen = choose_grid(solution)
            if chosen is None:
                self.finding = "no finer grid is admitted"
            else:
                self.problem, self.change = chosen


def refine_phases(
    solution: PhasedSolution, plants: Plants, show: Show | None = None, watch: Watch | None = None
) -> PhasedSolution:
    """Refine the grids of a re-simulated solution as its phases ask; return the last solution, with all rounds."""
    courses, made = [_Course([record_round("", phase, None)]) for phase in solution.phases], solution.search
    while True:
        for course, phase in zip(courses, solution.phases, strict=True):
            course.choose(phase)
        changed = [course for course in courses if course.problem is not None]
        if not changed:
            break
        outcome = _solve(_change(solution, courses), plants, solution, watch)
        failed = isinstance(outcome, Failure)
        if isinstance(outcome, PhasedSolution):
            solution = resimulate_phases(outcome, plants)
        for name, course, phase in zip(solution.names, courses, solution.phases, strict=True):
            if course.problem is None:
                continue
            result = Failure(course.problem, outcome.run, "", "") if failed else phase
            course.rounds.append(record_round(course.change, result, course.problem))
            if isinstance(outcome, Failure):
                course.finding = f"on the next grid, {outcome.finding}"
            if show is not None:
                show(name, course.rounds[-1])
        if failed:
            break
    return replace(
        solution,
        phases=tuple(_attach(phase, course) for phase, course in zip(solution.phases, courses, strict=True)),
        search=made,
    )


def _attach(phase: Solution, course: _Course) -> Solution:
    """Return a phase's solution with its rounds."""
    asked = phase.problem.refine
    if asked is None:
        return phase
    return replace(phase, refinement=Rounds(asked.accuracy, tuple(course.rounds), course.finding))


def _change(solution: PhasedSolution, courses: list[_Course]) -> PhasedProblem:
    """Return the problem on its next grids, with the least tolerance that a phase requires."""
    problem = solution.problem
    own = [course.problem or phase.problem for course, phase in zip(courses, problem.phases, strict=True)]
    tolerance = min(problem.solver.tolerance, *(part.solver.tolerance for part in own))
    phases = tuple(Phase(phase.name, part) for phase, part in zip(problem.phases, own, strict=True))
    return replace(problem, phases=phases, solver=replace(problem.solver, tolerance=tolerance))


def _solve(
    problem: PhasedProblem, plants: Plants, before: PhasedSolution, watch: Watch | None
) -> PhasedSolution | Failure:
    """Solve from a solution on other grids; where that fails, from the problem's guess."""
    motions = []
    for phase, own in zip(problem.phases, before.phases, strict=True):
        scheme, T = schemes.build(phase.problem.family, phase.problem.degree), float(own.trajectory.t[-1])
        motions.append(resample(own.trajectory, *phase.problem.grid.times(T, scheme.points)))
    chosen = replace(problem.solver, method=before.run.method, fallback=problem.solver.falls_back)
    near = replace(problem, solver=methods.warm(chosen))
    outcome = PhasedSolver(near, plants).solve(near, replace(before.guess, trajectories=tuple(motions)), watch)
    if isinstance(outcome, Failure):
        guess = guess_phases(problem, plants)
        if not isinstance(guess, Unreached):
            outcome = PhasedSolver(problem, plants).solve(problem, guess, watch)
    return outcome.with_solver(problem.solver) if isinstance(outcome, PhasedSolution) else outcome
