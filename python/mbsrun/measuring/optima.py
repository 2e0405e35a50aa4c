"""Optimal control: time of a solve against the error of its optimum, by collocation, representation and tolerance.

Inputs are constant over an interval, so each number N of intervals is a control grid with an optimum J*(N):

    error of the cost        |J - J*(N)| / |J*(N)|      error of collocation, on the same control grid
    error of the grid        |J*(N) - J*| / |J*|        error of the control grid itself

J*(N) is the optimum with Legendre points of degree 9; its difference from Radau points of degree 9 is its accuracy.
J* is extrapolated with order 2 from the two finest grids; its difference from the extrapolation without the finest grid
is its accuracy.

All combinations are solved with the solver's tolerance that the problem states; other tolerances are tried with the
highest degree of the first family.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from mbsrun.measuring.points import Cost, SolvePoint
from mbsrun.measuring.solves import Case, measure_solve
from mbsrun.measuring.store import Store
from mbsrun.ocp.ground.schemes import Family
from mbsrun.ocp.problem.problem import Form, Problem, Representation

EXACT = 9  # degree of the reference
TIGHT = 1e-11  # its solver's tolerance


@dataclass(frozen=True)
class OptimumScope:
    """The amount of measurement."""

    intervals: tuple[int, ...] = (5, 10, 20, 40)
    degrees: tuple[int, ...] = (1, 2, 3, 4, 5)
    families: tuple[Family, ...] = (Family.RADAU, Family.LEGENDRE)
    representations: tuple[Representation, ...] = tuple(Representation)
    repeats: int = 2
    tolerances: tuple[float, ...] = (1e-2, 1e-3, 1e-4, 1e-6)  # of the solver, beside the problem's own


QUICK = OptimumScope((5, 10), (2, 4), (Family.RADAU,), (Representation.IMPL, Representation.EXP2_O), 1, (1e-2, 1e-4))


@dataclass(frozen=True)
class GridOptimum:
    """The optimum of a control grid."""

    mechanism: str
    intervals: int
    cost: float | None  # None: the reference was not solved
    accuracy: float | None  # of it, relative; None: nothing to compare with
    error: float | None  # of the grid, relative to the limit of fine grids
    error_accuracy: float | None
    finding: str = ""


@dataclass(frozen=True)
class OptimumPoint:
    """A solve and the error of its optimum."""

    mechanism: str
    representation: str
    family: str
    degree: int
    intervals: int
    tolerance: float  # of the solver
    seconds: Cost | None  # of processor time; None: not solved
    error: float | None  # of the cost, on the same control grid, relative
    total_error: float | None  # against the limit of fine grids, relative
    defect: float | None  # the largest error of an interval, by re-simulation
    cost: float | None
    iterations: int
    finding: str = ""


def measure_optima(
    case: Case, scope: OptimumScope, store: Store[SolvePoint], report: Callable[[str, int, int], None]
) -> tuple[list[OptimumPoint], list[GridOptimum]]:
    """Solve the references and all combinations; earlier solves are read from the store."""
    jobs = _list_jobs(case.problem, scope)
    total = len(jobs) + 2 * len(scope.intervals)
    pairs = []
    for done, intervals in enumerate(scope.intervals):
        report(f"reference, {intervals} intervals", 2 * done, total)
        exact = [_refine(case.problem, family, intervals) for family in (Family.LEGENDRE, Family.RADAU)]
        pairs.append([measure_solve(case, problem, 1, store) for problem in exact])
    grids = _judge_grids(case, scope.intervals, pairs)
    points = []
    for done, problem in enumerate(jobs, 2 * len(scope.intervals)):
        report(_describe(problem), done, total)
        found = measure_solve(case, problem, scope.repeats, store)
        points.append((found, problem.solver.tolerance))
    limit = _find_limit([(g.intervals, g.cost) for g in grids if g.cost is not None])
    own = {grid.intervals: grid.cost for grid in grids}
    return [_judge(point, tolerance, own[point.intervals], limit) for point, tolerance in points], grids


def _list_jobs(problem: Problem, scope: OptimumScope) -> list[Problem]:
    """List the problems to solve: first all with the problem's own tolerance."""
    own = problem.solver.tolerance
    others = [x for x in scope.tolerances if x != own]
    grids = [
        replace(problem, intervals=intervals, mesh=None, family=family, degree=degree)
        for intervals in scope.intervals
        for family in scope.families
        for degree in scope.degrees
    ]
    finest = [x for x in grids if (x.family, x.degree) == (scope.families[0], scope.degrees[-1])]
    jobs = [(grid, own) for grid in grids] + [(grid, tolerance) for grid in finest for tolerance in others]
    return [
        _represent(replace(grid, solver=replace(grid.solver, tolerance=tolerance)), representation)
        for grid, tolerance in jobs
        for representation in scope.representations
    ]


def _describe(problem: Problem) -> str:
    grid = f"{problem.intervals} intervals, {problem.family.value} {problem.degree}"
    return f"{grid}, {problem.representation.value}, tolerance {problem.solver.tolerance:g}"


def _refine(problem: Problem, family: Family, intervals: int) -> Problem:
    solver = replace(problem.solver, tolerance=TIGHT)
    exact = replace(problem, family=family, degree=EXACT, intervals=intervals, mesh=None, solver=solver)
    return _represent(exact, problem.representation)


def _represent(problem: Problem, representation: Representation) -> Problem:
    """Return a problem in collocation, in the integral form if it has that form and the representation allows it."""
    is_integral = problem.form is Form.INTEGRAL and not representation.is_ode
    form = Form.INTEGRAL if is_integral else Form.STANDARD
    return replace(problem, representation=representation, form=form, integrator="collocation", steps=1)


def _judge_grids(case: Case, intervals: Sequence[int], pairs: Sequence[Sequence[SolvePoint]]) -> list[GridOptimum]:
    name = case.mechanism.manifest.model
    solved = [(n, pair[0].cost) for n, pair in zip(intervals, pairs, strict=True) if pair[0].cost is not None]
    limit, before = _find_limit(solved), _find_limit(solved[:-1])
    grids = []
    for n, (first, second) in zip(intervals, pairs, strict=True):
        is_known = first.cost is not None and limit is not None
        grids.append(
            GridOptimum(
                mechanism=name,
                intervals=n,
                cost=first.cost,
                accuracy=_relate(second.cost, first.cost),
                error=_relate(first.cost, limit) if is_known else None,
                error_accuracy=_relate(before, limit),
                finding=first.finding,
            )
        )
    return grids


def _find_limit(costs: Sequence[tuple[int, float | None]]) -> float | None:
    """Extrapolate (N, J) with order 2 from the two finest grids."""
    known = [(n, cost) for n, cost in costs if cost is not None]
    if len(known) < 2:
        return None
    (coarse, first), (fine, second) = sorted(known)[-2:]
    square = (fine / coarse) ** 2
    return (square * second - first) / (square - 1)


def _judge(point: SolvePoint, tolerance: float, own: float | None, limit: float | None) -> OptimumPoint:
    return OptimumPoint(
        mechanism=point.mechanism,
        representation=point.representation,
        family=point.family,
        degree=point.degree,
        intervals=point.intervals,
        tolerance=tolerance,
        seconds=point.seconds,
        error=_relate(point.cost, own),
        total_error=_relate(point.cost, limit),
        defect=point.defect,
        cost=point.cost,
        iterations=point.iterations,
        finding=point.finding,
    )


def _relate(found: float | None, exact: float | None) -> float | None:
    if found is None or exact is None:
        return None
    return abs(found - exact) / (abs(exact) or 1.0)
