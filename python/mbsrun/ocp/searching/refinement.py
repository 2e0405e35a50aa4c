"""Solve a problem again on finer grids, until the re-simulation confirms the accuracy that is asked for.

A scheme of degree d integrates an analytic motion over an interval of length h with a local error of about

    e = (h / R)^p,    p = order of the scheme + 1,

with a length R of the motion's own. So the defect e_k of interval k, which the re-simulation measures, gives
h_k / R_k = e_k^(1/p). With another degree and p', the interval meets an error a in (h_k / R_k) / a^(1/p') pieces.

Of several degrees, the one with the least work is taken; each interval is split into the pieces that it then needs.
Compare Liu, Hager, Rao, "Adaptive mesh refinement method for optimal control using decay rates of Legendre polynomial
coefficients", IEEE Transactions on Control Systems Technology 26 (2018).

Where bounds and constraints are violated between the points, by more than is tolerated, intervals are split too: the
violation falls with the square of their length.

Inputs are constant over an interval. All mesh points stay, so finer inputs can do whatever the former ones did. Where
constraints are violated by more than the accuracy permits, the solver's tolerance is reduced on the same grid.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from mbsrun.ocp import methods
from mbsrun.ocp.ground import schemes
from mbsrun.ocp.ground.functions import Array, Indices
from mbsrun.ocp.ground.grid import divide, split
from mbsrun.ocp.ground.integrators import INTEGRATORS, SECOND_ORDER
from mbsrun.ocp.ground.plant import Plant
from mbsrun.ocp.ground.schemes import DEGREES
from mbsrun.ocp.ground.trajectory import resample
from mbsrun.ocp.guessing.phases import Unreached, guess_phases
from mbsrun.ocp.problem.phases import Phase, PhasedProblem, Plants
from mbsrun.ocp.problem.problem import Form, Problem
from mbsrun.ocp.solution.phases import PhasedSolution, list_solution
from mbsrun.ocp.solution.solution import Failure, Resimulation, Round, Rounds, Solution
from mbsrun.ocp.solving.phases import PhasedSolver, resimulate_phases, settle_phases
from mbsrun.ocp.solving.runs import Watch
from mbsrun.ocp.statement.checks import LEAST_FRACTION, MAX_INTERVALS, MAX_STEPS

Show = Callable[[str, Round], None]  # the name of a phase, and its round

AIM = 0.3  # the defect that a new grid is made for, over the accuracy that is asked for
FURTHER = 2  # degrees that a round may add
PIECES = 8  # of an interval, at most, in a round
EFFORT = 1.5  # the work of an interval grows with this power of the degree
NOTHING = 1e-14  # a defect below rounding
TIGHT = 1e-2  # the solver's tolerance over the accuracy, where violations are too large for it
LEAST = 1e-12  # a tolerance that solvers reach


def show_nothing(_name: str, _last: Round) -> None:
    """Show no rounds."""


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
    solution: PhasedSolution, plants: Plants, show: Show = show_nothing, watch: Watch | None = None
) -> PhasedSolution:
    """Refine the grids of a re-simulated solution as its phases ask; return the last solution, with all rounds.

    In every round, each phase that is inaccurate, and asks for refinement, gets its next grid; then all are solved,
    from the solution before, and from the problem's own guess where that fails. A round that finds no solution ends the
    refinement. `show` is called after every round, with the name of the phase.
    """
    courses, made = [_Course([record_round("", phase, None)]) for phase in solution.phases], solution.search
    for name, course in zip(solution.names, courses, strict=True):
        show(name, course.rounds[-1])
    while True:
        for course, phase in zip(courses, solution.phases, strict=True):
            course.choose(phase)
        if all(course.problem is None for course in courses):
            break
        outcome = _solve(_change(solution, courses), plants, solution, watch)
        if isinstance(outcome, PhasedSolution):
            solution = resimulate_phases(outcome, plants)
        for name, course, phase in zip(solution.names, courses, solution.phases, strict=True):
            if course.problem is None:
                continue
            result = outcome if isinstance(outcome, Failure) else phase
            course.rounds.append(record_round(course.change, result, course.problem))
            if isinstance(outcome, Failure):
                course.finding = f"on the next grid, {outcome.finding}"
            show(name, course.rounds[-1])
        if isinstance(outcome, Failure):
            break
    phases = tuple(_attach(phase, course) for phase, course in zip(solution.phases, courses, strict=True))
    return replace(solution, phases=phases, search=made)


def refine(
    solution: Solution, plant: Plant, show: Callable[[Round], None] | None = None, watch: Watch | None = None
) -> Solution:
    """Refine the grid of a re-simulated solution without phases as its problem asks."""
    told = show_nothing if show is None else lambda _, last: show(last)
    return refine_phases(list_solution(solution), Plants((plant,)), told, watch).single


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
    """Solve from a solution on other grids, with its durations; where that fails, from the problem's own guess."""
    motions = []
    for phase, own in zip(problem.phases, before.phases, strict=True):
        scheme, T = schemes.build(phase.problem.family, phase.problem.degree), float(own.trajectory.t[-1])
        motions.append(resample(own.trajectory, *phase.problem.grid.times(T, scheme.points)))
    solver = PhasedSolver(problem, plants)
    near = replace(problem, solver=methods.warm(solver.choose_method(problem)))
    outcome = solver.solve(near, replace(before.guess, trajectories=tuple(motions)), watch)
    if isinstance(outcome, Failure):
        guess = guess_phases(problem, solver.plants)
        if not isinstance(guess, Unreached):
            outcome = solver.solve(settle_phases(problem, solver.plants, guess), guess, watch)
    return outcome.with_solver(problem.solver) if isinstance(outcome, PhasedSolution) else outcome


def find_end(solution: Solution, made: int, rounds: int) -> str:
    """Return why the refinement ends; empty: it goes on."""
    check = solution.resimulation
    assert check is not None, "a solution is re-simulated before its grid is refined"
    if check.is_accurate and not find_violated(check):
        return "the re-simulation confirms the accuracy"
    if check.unfinished:
        return f"the re-simulation did not finish, {check.unfinished}"
    if not check.defects:
        return "the re-simulation gave up, so no interval's error is known"
    if max(check.defects) <= solution.problem.asked_accuracy and not find_violated(check):
        return "the loops open along the re-simulated motion, which a finer grid does not change"
    if made < rounds:
        return ""
    return f"{rounds} rounds are over" if rounds > 1 else "1 round is over"


def find_violated(check: Resimulation) -> bool:
    """Return whether a bound or a constraint is violated between the points, by more than is tolerated."""
    return check.margins is not None and bool(check.margins.violated)


def record_round(change: str, outcome: Solution | Failure, problem: Problem | None) -> Round:
    """Describe a round; `problem` is the one of a failure."""
    run = outcome.run
    if isinstance(outcome, Failure):
        assert problem is not None, "a failure has a grid"
        times = tuple(problem.grid.mesh(problem.horizon).tolist())
        return Round(change, problem.degree, times, 0, run.status, run.iterations, run.cpu_seconds, None, ())
    check = outcome.resimulation
    return Round(
        change=change,
        degree=outcome.problem.degree,
        times=tuple(outcome.trajectory.t.tolist()),
        variables=outcome.size.variables,
        status=run.status,
        iterations=run.iterations,
        cpu_seconds=run.cpu_seconds,
        cost=outcome.cost.total,
        defects=() if check is None else check.defects,
    )


# --- the next grid --------------------------------------------------------------------------------------------------


def choose_grid(solution: Solution) -> tuple[Problem, str] | None:
    """Return the problem on its next grid, and the change in words; None where the grid would be too fine."""
    problem, check = solution.problem, solution.resimulation
    assert check is not None, "the defects choose the grid"
    accuracy, solver = problem.asked_accuracy, problem.solver
    tolerance = max(TIGHT * accuracy, LEAST)
    if solution.violation.constraints > AIM * accuracy and tolerance < solver.tolerance:
        change = f"the solver's tolerance {tolerance:.0e}, {solver.tolerance:.0e} before"
        return replace(problem, solver=replace(solver, tolerance=tolerance)), change
    defects = np.clip(check.defects, NOTHING, 1.0)
    integrator = INTEGRATORS[problem.integrator]
    keeps_grid = problem.form is Form.SHOOTING and (integrator.is_explicit or problem.integrator == SECOND_ORDER)
    violations = np.zeros(problem.intervals) if check.margins is None else np.array(check.margins.intervals)
    if keeps_grid and not (violations > 1).any():
        return _take_steps(problem, defects)
    if keeps_grid:
        return _make_grid(problem, problem.degree, np.full(problem.intervals, 2))
    return _split(problem, defects, violations)


def _split(problem: Problem, defects: Array, violations: Array) -> tuple[Problem, str] | None:
    """Choose the degree with the least work, and split the intervals that are inaccurate or violated with it.

    `violations` are the largest of each interval over the tolerated ones.
    """
    apart = np.where(violations > 1, np.maximum(np.ceil(np.sqrt(violations / AIM)), 2), 1)
    best: tuple[float, int, Indices] | None = None
    for degree in range(problem.degree, min(problem.degree + FURTHER, DEGREES[-1]) + 1):
        wanted = np.maximum(np.ceil(_count(defects, problem, degree)), 1 if degree > problem.degree else 2)
        wanted[defects <= problem.asked_accuracy] = 1
        wanted = np.maximum(wanted, apart)
        work = float(wanted.sum()) * degree**EFFORT
        if best is None or work < best[0]:
            best = (work, degree, np.minimum(wanted, PIECES).astype(np.int64))
    assert best is not None, "the degree that it has is one of them"
    _, degree, pieces = best
    return _make_grid(problem, degree, pieces)


def _make_grid(problem: Problem, degree: int, pieces: Indices) -> tuple[Problem, str] | None:
    """Split intervals into pieces, and take a degree."""
    lengths = split(problem.grid.lengths(), pieces)
    if len(lengths) > MAX_INTERVALS or lengths.min() < LEAST_FRACTION:
        return None
    changes = []
    if degree > problem.degree:
        changes.append(f"degree {degree}, {problem.degree} before")
    if pieces.max() > 1:
        changes.append(
            f"{int((pieces > 1).sum())} of {pieces.size} intervals split into {int(pieces[pieces > 1].sum())}"
        )
    refined = replace(problem, intervals=len(lengths), mesh=divide(lengths), degree=degree)
    return refined, "; ".join(changes)


def _take_steps(problem: Problem, defects: Array) -> tuple[Problem, str] | None:
    """Take more steps in all intervals, where the method has no degree, or intervals of shooting have to be equal."""
    pieces = np.clip(_count(defects, problem, problem.degree).max(), 1.0, PIECES)
    steps = max(int(np.ceil(pieces * problem.steps)), problem.steps + 1)
    change = f"{steps} steps in each interval, {problem.steps} before"
    return (replace(problem, steps=steps), change) if steps <= MAX_STEPS else None


def _count(defects: Array, problem: Problem, degree: int) -> Array:
    """Return the number of pieces, not a whole one, into which each interval goes to be accurate with a degree."""
    now, then = (_find_order(problem, d) for d in (problem.degree, degree))
    return np.asarray(defects ** (1 / now) / (AIM * problem.asked_accuracy) ** (1 / then))


def _find_order(problem: Problem, degree: int) -> int:
    """Return the order of the local error."""
    return 1 + (4 if problem.integrator == "rk4" else schemes.build(problem.family, degree).order)
