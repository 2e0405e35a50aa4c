"""Refined grids beside equal intervals of the same accuracy: `python -m benchmarks.ocp.refinement`.

Each problem is solved on a coarse grid, which is refined until the re-simulation confirms an accuracy. Then the same
problem is solved on equal intervals, with the degrees of the coarse grid and of the refined one: 10, 13, 17,
22, ... of them (a factor of 1.3), until the re-simulation calls a solution as accurate. Of both degrees, the one with
fewer variables counts. The refined grid takes the processor time of all its solves, equal intervals the time of the
one solve on the grid that was found, without the search.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from rich.console import Console

from benchmarks.pages import tabulate
from mbsrun.external import load_on_demand
from mbsrun.ocp.ground.plant import Plant
from mbsrun.ocp.problem.problem import Problem, Refinement
from mbsrun.ocp.searching.refinement import refine
from mbsrun.ocp.solution.solution import Solution
from mbsrun.ocp.solving.resimulation import resimulate
from mbsrun.ocp.solving.solve import solve
from mbsrun.ocp.statement.statement import read_problem

MODELS = Path(__file__).parents[2] / "models"
PROBLEMS = (
    "cart_pole_swing_up",
    "acrobot_swing_up",
    "planar_arm_reach",
    "planar_arm_fastest",
    "five_bar_reach",
    "delta_pick",
    "leg_step",
    "satellite_turn",
    "six_axis_reach",
    "arm_reach",
)
COARSE, DEGREE = 10, 3  # intervals, degree
FACTOR, MOST = 1.3, 300  # of equal intervals


@dataclass(frozen=True)
class Found:
    """A grid that is accurate enough, or the last one of a refinement that is not."""

    intervals: int
    degree: int
    variables: int
    defect: float
    cost: float
    seconds: float  # of the processor
    rounds: int
    is_accurate: bool
    longest: float  # ratio of the longest interval to the shortest


def refine_from(problem: Problem, plant: Plant) -> Found | None:
    """Refine the grid of a problem; return None where the coarse grid has no solution."""
    first = solve(problem, plant)
    if not isinstance(first, Solution):
        return None
    solution = refine(resimulate(first, plant), plant)
    assert solution.refinement is not None, "it was refined"
    rounds = solution.refinement.rounds
    return _describe(solution, sum(each.cpu_seconds for each in rounds), len(rounds) - 1)


def find_equal(problem: Problem, plant: Plant, degree: int) -> Found | None:
    """Find the least of some numbers of equal intervals that is accurate enough."""
    intervals = float(problem.intervals)
    while intervals <= MOST:
        found = solve(replace(problem, intervals=round(intervals), degree=degree), plant)
        if isinstance(found, Solution):
            checked = resimulate(found, plant)
            if checked.resimulation is not None and checked.resimulation.is_accurate:
                return _describe(checked, found.run.cpu_seconds, 0)
        intervals *= FACTOR
    return None


def _describe(solution: Solution, seconds: float, rounds: int) -> Found:
    check, lengths = solution.resimulation, np.diff(solution.trajectory.t)
    assert check is not None, "a solution is re-simulated"
    return Found(
        intervals=solution.problem.intervals,
        degree=solution.problem.degree,
        variables=solution.size.variables,
        defect=float("nan") if check.defect is None else check.defect,
        cost=solution.cost.total,
        seconds=seconds,
        rounds=rounds,
        is_accurate=check.is_accurate,
        longest=float(lengths.max() / lengths.min()),
    )


@dataclass(frozen=True)
class Row:
    """A problem at one accuracy."""

    problem: str
    accuracy: float
    refined: Found | None
    equal: Found | None


def compare(name: str, accuracy: float) -> Row:
    """Refine, and look for equal intervals as accurate."""
    given, plant = read_problem(MODELS / f"{name}.ocp.yaml", load_on_demand)
    solver = replace(given.solver, tolerance=min(given.solver.tolerance, accuracy / 100))
    coarse = replace(given, intervals=COARSE, degree=DEGREE, refine=Refinement(accuracy, 20), solver=solver)
    refined = refine_from(coarse, plant)
    if refined is None or not refined.is_accurate:
        return Row(name, accuracy, refined, None)
    every = [find_equal(coarse, plant, degree) for degree in sorted({DEGREE, refined.degree})]
    equal = min((found for found in every if found is not None), key=lambda found: found.variables, default=None)
    return Row(name, accuracy, refined, equal)


def write_page(rows: Sequence[Row]) -> str:
    """Write the table as a page."""
    about = (__doc__ or "").split("\n\n")[1].strip().replace("\n", " ")
    lines = ["# Refined grids and equal intervals", "", "`python -m benchmarks.ocp.refinement` wrote this page.", ""]
    lines += [about, ""]
    lines += [f"The coarse grid has {COARSE} intervals of degree {DEGREE}. Longest is the longest interval over the "]
    lines[-1] += "shortest one. Costs differ, since inputs are constant over an interval: the grids are not the same."
    titles = ["problem", "accuracy", "grid", "intervals", "degree", "variables", "defect", "longest", "rounds"]
    titles += ["CPU [s]", "cost"]
    cells = [
        [row.problem, f"{row.accuracy:.0e}", kind, *_list_cells(found)]
        for row in rows
        for kind, found in (("refined", row.refined), ("equal", row.equal))
    ]
    lines += ["", *tabulate(titles, cells)]
    return "\n".join(lines) + "\n"


def _list_cells(found: Found | None) -> list[str]:
    if found is None:
        return [f"none up to {MOST}", *[""] * 7]
    defect = f"{found.defect:.1e}" + ("" if found.is_accurate else ", too large")
    grid = [str(found.intervals), str(found.degree), str(found.variables), defect, f"{found.longest:.3g}"]
    return [*grid, str(found.rounds), f"{found.seconds:.2f}", f"{found.cost:.8g}"]


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure, print and write the page."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.ocp.refinement", description=__doc__)
    parser.add_argument("--problems", nargs="+", choices=PROBLEMS, default=PROBLEMS, help="all")
    parser.add_argument("--accuracies", nargs="+", type=float, default=(1e-6, 1e-9), help="1e-6 1e-9")
    parser.add_argument("--out", type=Path, default=Path("build/bench-ocp/refinement.md"), help="the page")
    given = parser.parse_args(arguments)
    console, rows = Console(), list[Row]()
    for name in given.problems:
        for accuracy in given.accuracies:
            rows.append(compare(name, accuracy))
            console.print(f"{name}, {accuracy:.0e}")
    given.out.parent.mkdir(parents=True, exist_ok=True)
    given.out.write_text(write_page(rows), encoding="utf-8")
    console.print(f"wrote {given.out}")


if __name__ == "__main__":
    main()
