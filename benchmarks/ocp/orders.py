"""First-order and second-order collocation beside each other: `python -m benchmarks.ocp.orders`.

Both are solved from the same guess on the same grid, with the same number of variables. At the optimum,

    cost      the error of the cost, against a scheme of degree 8 on the same intervals, so with the same inputs
    end       the defect: the error of a state at the end of its interval, from its start
    points    the largest error of a coordinate at a collocation point, from the interval's start
    between   the largest error of a coordinate anywhere: at nine places of each interval, by the scheme's polynomials

The true motion is integrated by DOP853 at a tolerance of 1e-13. Means leave out errors below 1e-12.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from benchmarks.pages import tabulate
from mbsrun.external import load_on_demand
from mbsrun.ocp.ground import schemes
from mbsrun.ocp.ground.integrators import SECOND_ORDER
from mbsrun.ocp.ground.plant import Plant
from mbsrun.ocp.ground.schemes import Family, Scheme, read_basis
from mbsrun.ocp.ground.trajectory import Trajectory
from mbsrun.ocp.problem.problem import Problem
from mbsrun.ocp.solution.solution import Solution
from mbsrun.ocp.solving.resimulation import Constant, integrate
from mbsrun.ocp.solving.solve import solve
from mbsrun.ocp.statement.statement import read_problem

Array = NDArray[np.float64]
MODELS = Path(__file__).parents[2] / "models"
PROBLEMS = (
    "cart_pole_swing_up",
    "cart_pole_balance",
    "planar_arm_reach",
    "planar_arm_fastest",
    "five_bar_reach",
    "delta_pick",
    "leg_step",
    "six_axis_reach",
    "arm_reach",
)
DEGREES = (2, 3, 4)
FINE = 8  # the degree of the reference
FAMILIES = (Family.RADAU, Family.LEGENDRE)  # of integrators of second order
PLACES = np.linspace(0.0, 1.0, 11)[1:-1]
SAME = 0.02  # relative difference of costs within which two optima are one
ROUNDED = 1e-12
MEASURES = ("cost", "end", "points", "between")


@dataclass(frozen=True)
class Errors:
    """Errors of one solve, and its effort."""

    errors: tuple[float, ...]  # in the order of MEASURES
    iterations: int
    nonzeros: int


@dataclass(frozen=True)
class Row:
    """A problem with one scheme, in both orders."""

    problem: str
    intervals: int
    family: Family
    degree: int
    first: Errors
    second: Errors


def read_coordinates(trajectory: Trajectory, scheme: Scheme, *, is_second: bool) -> Array:
    """Return the coordinates at PLACES of each interval, (N, places, n), by the scheme's polynomials."""
    nodes = np.concatenate(([0.0], scheme.points))
    if is_second:
        velocities = np.concatenate((trajectory.qd[:-1, None], trajectory.point_qd), axis=1)
        h = np.diff(trajectory.t)[:, None, None]
        return np.asarray(trajectory.q[:-1, None] + h * (scheme.integrate(PLACES) @ velocities))
    values = np.concatenate((trajectory.q[:-1, None], trajectory.point_q), axis=1)
    return np.asarray(np.stack([read_basis(nodes, float(c)) for c in PLACES]) @ values)


def measure(solution: Solution, plant: Plant, best: float) -> Errors:
    """Measure the errors of a solution."""
    problem, trajectory = solution.problem, solution.trajectory
    scheme = schemes.build(problem.family, problem.degree)
    starts, h = np.concatenate((trajectory.q, trajectory.qd), axis=1)[:-1], np.diff(trajectory.t)

    def move(c: float) -> Array:
        found = integrate(plant, starts, Constant(trajectory.u), h * c)
        assert found is not None, "the motion goes on"
        return found

    nq = trajectory.q.shape[1]
    read = read_coordinates(trajectory, scheme, is_second=problem.integrator == SECOND_ORDER)
    ends = np.concatenate((trajectory.q, trajectory.qd), axis=1)[1:]
    points = [np.abs(move(c)[:, :nq] - trajectory.point_q[:, j]).max() for j, c in enumerate(scheme.points)]
    between = [np.abs(move(float(c))[:, :nq] - read[:, j]).max() for j, c in enumerate(PLACES)]
    errors = (abs(solution.cost.total / best - 1), np.abs(move(1.0) - ends).max(), max(points), max(between))
    return Errors(tuple(map(float, errors)), solution.run.iterations, solution.size.jacobian_nonzeros)


def solve_same(problem: Problem, plant: Plant, best: float) -> Solution | None:
    """Solve; return None where there is no solution, or another optimum."""
    outcome = solve(problem, plant)
    if isinstance(outcome, Solution) and abs(outcome.cost.total / best - 1) <= SAME:
        return outcome
    return None


def compare(name: str, degrees: Iterable[int], parts: Iterable[int]) -> Iterator[Row]:
    """Compare both orders on a problem, on its intervals divided by `parts`."""
    problem, plant = read_problem(MODELS / f"{name}.ocp.yaml", load_on_demand)
    problem = replace(problem, solver=replace(problem.solver, tolerance=1e-10))
    for part in parts:
        coarse = replace(problem, intervals=problem.intervals // part)
        fine = solve(replace(coarse, family=Family.LEGENDRE, degree=FINE), plant)
        if not isinstance(fine, Solution):
            continue
        best = fine.cost.total
        for family in FAMILIES:
            for degree in degrees:
                found = []
                for integrator in ("collocation", SECOND_ORDER):
                    own = replace(coarse, family=family, degree=degree, integrator=integrator)
                    solution = solve_same(own, plant, best)
                    found += [] if solution is None else [measure(solution, plant, best)]
                if len(found) == len(("first", "second")):
                    yield Row(name, coarse.intervals, family, degree, *found)


def write_page(rows: Sequence[Row]) -> str:
    """Write the tables as a page."""
    lines = ["# First-order and second-order collocation", ""]
    lines += ["`python -m benchmarks.ocp.orders` wrote this page.", "", *_describe(), ""]
    lines += ["## Ratios", "", "Errors of second-order collocation over errors of first-order collocation, geometric "]
    lines[-1] += "means; in brackets, in how many rows the second order errs less."
    titles = ["scheme", "degree", "rows", *MEASURES, "iterations", "nonzeros"]
    schemes = [(family, degree) for family in FAMILIES for degree in sorted({row.degree for row in rows})]
    summaries = [_summarise([row for row in rows if (row.family, row.degree) == each], *each) for each in schemes]
    lines += ["", *tabulate(titles, summaries)]
    lines += ["", "## Errors", "", "Of two numbers, the first one is of first-order collocation.", ""]
    titles = ["problem", "intervals", "scheme", "degree", *MEASURES, "iterations"]
    lines += tabulate(titles, map(_list_cells, rows))
    return "\n".join(lines) + "\n"


def _list_cells(row: Row) -> list[str]:
    errors = [f"{a:.1e}, {b:.1e}" for a, b in zip(row.first.errors, row.second.errors, strict=True)]
    effort = f"{row.first.iterations}, {row.second.iterations}"
    return [row.problem, str(row.intervals), row.family.value, str(row.degree), *errors, effort]


def _describe() -> list[str]:
    text = (__doc__ or "").split("\n\n")
    return [text[1].replace("\n", " "), "", "```", text[2], "```", "", text[3].strip().replace("\n", " ")]


def _summarise(rows: Sequence[Row], family: Family, degree: int) -> list[str]:
    cells = [family.value, str(degree), str(len(rows))]
    for i in range(len(MEASURES)):
        pairs = [
            (r.first.errors[i], r.second.errors[i])
            for r in rows
            if min(r.first.errors[i], r.second.errors[i]) > ROUNDED
        ]
        ratios = np.array([b / a for a, b in pairs])
        less = f"{int((ratios < 1).sum())} of {ratios.size}"
        cells.append(f"{np.exp(np.log(ratios).mean()):.2g} ({less})" if ratios.size else "rounding")
    for part in ("iterations", "nonzeros"):
        ratios = np.array([getattr(r.second, part) / getattr(r.first, part) for r in rows])
        cells.append(f"{np.exp(np.log(ratios).mean()):.2f}" if ratios.size else "")
    return cells


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure, print and write the page."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.ocp.orders", description=__doc__)
    parser.add_argument("--problems", nargs="+", choices=PROBLEMS, default=PROBLEMS, help="all")
    parser.add_argument("--degrees", nargs="+", type=int, default=DEGREES, help="2 3 4")
    parser.add_argument("--parts", nargs="+", type=int, default=(1, 2), help="divisors of the intervals; 1 2")
    parser.add_argument("--out", type=Path, default=Path("build/bench-ocp/orders.md"), help="the page")
    given = parser.parse_args(arguments)
    console, rows = Console(), list[Row]()
    for name in given.problems:
        for row in compare(name, given.degrees, given.parts):
            rows.append(row)
            console.print(f"{row.problem}, {row.intervals} intervals, {row.family.value} {row.degree}")
    given.out.parent.mkdir(parents=True, exist_ok=True)
    given.out.write_text(write_page(rows), encoding="utf-8")
    console.print(f"wrote {given.out}")


if __name__ == "__main__":
    main()
