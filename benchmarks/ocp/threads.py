"""Measure threads of a solve: `python -m benchmarks.ocp.threads`; a table of wall times to the terminal.

The arm's task with 100 intervals is solved from one guess by the project's own method, with each number of threads in
turn. All of them must find the same bits. Processor time is the sum over threads, waiting ones included.
"""

from __future__ import annotations

import argparse
import os
import statistics
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from mbsrun.external import load_on_demand
from mbsrun.ocp.ground import schemes
from mbsrun.ocp.ground.trajectory import Trajectory
from mbsrun.ocp.guessing.guess import make_guess
from mbsrun.ocp.problem.problem import Problem, Representation
from mbsrun.ocp.solution.solution import Solution
from mbsrun.ocp.solving.solve import Solver
from mbsrun.ocp.statement.statement import read_problem

ARM = Path(__file__).parents[2] / "models" / "arm_reach.ocp.yaml"
INTERVALS = 100


@dataclass(frozen=True)
class Solved:
    """One solve."""

    iterations: int
    cost: float
    seconds: float
    cpu_seconds: float


def solve(solver: Solver, problem: Problem, guess: Trajectory) -> Solved:
    """Solve once."""
    outcome = solver.solve(problem, guess)
    assert isinstance(outcome, Solution), "the task has a solution"
    run = outcome.run
    return Solved(run.iterations, outcome.cost.total, run.seconds, run.cpu_seconds)


def describe(threads: int, solves: Sequence[Solved]) -> str:
    """Describe all solves with a number of threads, in ms an iteration."""
    wall, cpu = (
        [1e3 * time / solved.iterations for time, solved in zip(times, solves, strict=True)]
        for times in ([s.seconds for s in solves], [s.cpu_seconds for s in solves])
    )
    return (
        f"{threads:7}  {solves[0].iterations:10}  {min(wall):8.2f}  {statistics.quantiles(wall, n=4)[0]:8.2f}  "
        f"{statistics.median(wall):8.2f}  {statistics.median(cpu):9.2f}"
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure and print; 1 where results differ."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.ocp.threads", description=__doc__)
    parser.add_argument("--threads", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--rounds", type=int, default=60)
    parser.add_argument("--representation", choices=[r.value for r in Representation], default="IMPL")
    given = parser.parse_args(arguments)
    problem, plant = read_problem(ARM, load_on_demand)
    problem = replace(problem, intervals=INTERVALS, representation=Representation(given.representation))
    guess = make_guess(problem, plant, schemes.build(problem.family, problem.degree))
    assert isinstance(guess, Trajectory), "the target is within reach"
    ways = [replace(problem, solver=replace(problem.solver, method="mbs", threads=n)) for n in given.threads]
    solvers = [Solver(way, plant) for way in ways]
    solves: list[list[Solved]] = [[] for _ in ways]
    for _ in range(given.rounds + 1):
        for found, solver, way in zip(solves, solvers, ways, strict=True):
            found.append(solve(solver, way, guess))
    load = f"{os.cpu_count()} processors, wanted by {os.getloadavg()[0]:.1f} processes"
    print(f"{given.representation}, {INTERVALS} intervals, {given.rounds} rounds; {load}; ms an iteration")
    print("threads  iterations  quickest  quartile    median  processor")
    for threads, found in zip(given.threads, solves, strict=True):
        print(describe(threads, found[1:]))
    return 0 if len({(one.iterations, one.cost) for found in solves for one in found}) == 1 else 1


if __name__ == "__main__":
    sys.exit(main())
