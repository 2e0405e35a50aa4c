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
from dataclasses import replace

import numpy as np

from mbsrun.ocp import methods, schemes
from mbsrun.ocp.checks import LEAST_FRACTION, MAX_INTERVALS, MAX_STEPS
from mbsrun.ocp.functions import Array, Indices
from mbsrun.ocp.grid import divide, split
from mbsrun.ocp.guess import Pose, make_guess
from mbsrun.ocp.integrators import INTEGRATORS, SECOND_ORDER
from mbsrun.ocp.plant import Plant
from mbsrun.ocp.preparation import settle
from mbsrun.ocp.problem import Form, Problem
from mbsrun.ocp.resimulation import resimulate
from mbsrun.ocp.runs import Watch
from mbsrun.ocp.schemes import DEGREES
from mbsrun.ocp.solution import Failure, Resimulation, Round, Rounds, Solution
from mbsrun.ocp.solve import Solver, choose_method
from mbsrun.ocp.trajectory import Trajectory, resample

Show = Callable[[Round], None]

AIM = 0.3  # the defect that a new grid is made for, over the accuracy that is asked for
FURTHER = 2  # degrees that a round may add
PIECES = 8  # of an interval, at most, in a round
EFFORT = 1.5  # the work of an interval grows with this power of the degree
NOTHING = 1e-14  # a defect below rounding
TIGHT = 1e-2  # the solver's tolerance over the accuracy, where violations are too large for it
LEAST = 1e-12  # a tolerance that solvers reach


def refine(solution: Solution, plant: Plant, show: Show | None = None, watch: Watch | None = None) -> Solution:
    """Refine the grid of a re-simulated solution as its problem asks; return the last solution, with all rounds.

    A round begins from the solution before, and from the problem's own guess where that fails. A round that finds no
    solution ends the refinement. `show` is called after every round.
    """
    asked = solution.problem.refine
    assert asked is not None, "a problem without refinement keeps its grid"
    rounds = [record_round("", solution, None)]
    finding = ""
    while not finding:
        if show is not None:
            show(rounds[-1])
        finding = find_end(solution, len(rounds) - 1, asked.rounds)
        if finding:
            break
        chosen = choose_grid(solution)
        if chosen is None:
            finding = "no finer grid is admitted"
            break
        problem, change = chosen
        outcome = _solve(problem, plant, solution.trajectory, watch)
        if isinstance(outcome, Solution):
            solution = resimulate(outcome, plant)
        else:
            finding = f"on the next grid, {outcome.finding}"
        rounds.append(record_round(change, outcome if isinstance(outcome, Failure) else solution, problem))
    return replace(solution, refinement=Rounds(asked.accuracy, tuple(rounds), finding))


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


def _solve(problem: Problem, plant: Plant, motion: Trajectory, watch: Watch | None) -> Solution | Failure:
    """Solve from a motion on another grid, with its horizon; where that fails, from the problem's own guess."""
    scheme = schemes.build(problem.family, problem.degree)
    begin = resample(motion, *problem.grid.times(float(motion.t[-1]), scheme.points))
    solver = Solver(problem, plant)
    near = replace(problem, solver=methods.warm(choose_method(problem, plant)))
    outcome = solver.solve(near, begin, watch)
    if isinstance(outcome, Failure):
        guess = make_guess(problem, plant, scheme)
        if not isinstance(guess, Pose):
            outcome = solver.solve(settle(problem, plant, guess), guess, watch)
    if isinstance(outcome, Failure):
        return outcome
    return replace(outcome, problem=replace(outcome.problem, solver=problem.solver))


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
