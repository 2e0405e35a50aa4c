"""Many intervals: `python -m benchmarks.ocp.horizons`.

The task of the arm on finer and finer grids, by the project's own method and by IPOPT with the project's linear solver.
Times are of the processor, of a second solve, for an iteration, and for an iteration and an interval; memory is the
largest that the process has had so far, grid by grid.
"""

from __future__ import annotations

import argparse
import resource
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from rich.console import Console

from benchmarks.pages import tabulate
from mbsrun.external import load_on_demand
from mbsrun.ocp.ground import schemes
from mbsrun.ocp.ground.plant import Plant
from mbsrun.ocp.ground.trajectory import Trajectory
from mbsrun.ocp.guessing.guess import make_guess
from mbsrun.ocp.problem.problem import Problem, SolverName
from mbsrun.ocp.solution.solution import Solution
from mbsrun.ocp.solving.solve import Solver
from mbsrun.ocp.statement.statement import read_problem

ARM = Path(__file__).parents[2] / "models" / "arm_reach.ocp.yaml"
INTERVALS = (100, 300, 1000, 3000, 10000)
METHODS: tuple[SolverName, ...] = ("mbs", "ipopt")
MOST = 1000  # intervals that IPOPT is given


@dataclass(frozen=True)
class Row:
    """A solve."""

    intervals: int
    method: str
    status: str
    iterations: int
    seconds: float  # of the processor
    cost: float
    memory: float  # GB


def measure(problem: Problem, plant: Plant, intervals: int, method: str) -> Row:
    """Solve on a grid by a method, twice; the second solve builds nothing."""
    finer = replace(problem, intervals=intervals, solver=problem.solver.with_method(method))
    guess = make_guess(finer, plant, schemes.build(finer.family, finer.degree))
    assert isinstance(guess, Trajectory), "the target is within reach"
    solver = Solver(finer, plant)
    solver.solve(finer, guess)
    found = solver.solve(finer, guess)
    cost = found.cost.total if isinstance(found, Solution) else float("nan")
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    run = found.run
    return Row(intervals, method, run.status, run.iterations, run.cpu_seconds, cost, memory)


def write_page(rows: Sequence[Row]) -> str:
    """Write the table as a page."""
    about = (__doc__ or "").split("\n\n")[1].strip().replace("\n", " ")
    titles = ["intervals", "method", "status", "iterations", "CPU [s]", "ms an iteration", "µs an interval of it", "GB"]
    lines = ["# Many intervals", "", "`python -m benchmarks.ocp.horizons` wrote this page.", "", about, ""]
    lines += tabulate([*titles, "cost"], map(_list_cells, rows))
    return "\n".join(lines) + "\n"


def _list_cells(row: Row) -> list[str]:
    each = row.seconds / max(row.iterations, 1)
    times = [f"{row.seconds:.2f}", f"{1e3 * each:.2f}", f"{1e6 * each / row.intervals:.1f}", f"{row.memory:.2f}"]
    return [str(row.intervals), row.method, row.status, str(row.iterations), *times, f"{row.cost:.8g}"]


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure, print and write the page."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.ocp.horizons", description=__doc__)
    parser.add_argument("--intervals", nargs="+", type=int, default=INTERVALS, help="100 to 10,000")
    parser.add_argument("--out", type=Path, default=Path("build/bench-ocp/horizons.md"), help="the page")
    given = parser.parse_args(arguments)
    console, rows = Console(), list[Row]()
    problem, plant = read_problem(ARM, load_on_demand)
    for intervals in given.intervals:
        for method in METHODS if intervals <= MOST else METHODS[:1]:
            rows.append(measure(problem, plant, intervals, method))
            console.print(f"{intervals} intervals, {method}: {rows[-1].seconds:.2f} s")
    given.out.parent.mkdir(parents=True, exist_ok=True)
    given.out.write_text(write_page(rows), encoding="utf-8")
    console.print(f"wrote {given.out}")


if __name__ == "__main__":
    main()
