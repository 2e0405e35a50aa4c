"""Print what docs/solver.md shows: iterations, optima and optimality conditions beside IPOPT's.

python -m tests.csrc.stage_figures
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np

from tests.csrc.stage_problems import nonlinear
from tests.csrc.stage_quadratics import random_problem, random_sizes
from tests.csrc.stages import Library, Problem, Quadratic, Solver, compile_solver


def quadratics() -> list[tuple[str, Quadratic]]:
    """Convex quadratic programs at random, half of them with directions without curvature."""
    problems = []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        sizes = [
            (a, b, min(c, 2), int(rng.integers(0, 4))) for a, b, c, _ in random_sizes(rng, int(rng.integers(5, 30)))
        ]
        problems.append((f"quadratic {seed}", random_problem(rng, sizes, bounds=0.6, flat=(0.0, 0.5)[seed % 2])))
    return problems


def compare(library: Library, name: str, problem: Problem | Quadratic) -> tuple[int, int]:
    """Print a line; return the iterations of both solvers."""
    answer = Solver(library, problem).solve()
    solution, statistics = problem.ipopt()
    result, cost = answer.result, float(solution["f"][0])
    worst = max(problem.residuals(*answer.point))
    print(
        f"| {name} | {len(answer.w)} | {len(answer.y)} | {answer.status} | {result.iterations} | "
        f"{statistics['iter_count']} | {result.factorisations} | {result.evaluations} | {result.cost:.9g} | "
        f"{abs(result.cost - cost):.0e} | {worst:.0e} |"
    )
    return result.iterations, statistics["iter_count"]


def main() -> None:
    with tempfile.TemporaryDirectory() as place:
        library = Library(compile_solver(Path(place)))
        print(
            "| problem | variables | rows | status | iterations | IPOPT | factorisations | evaluations | cost |", end=""
        )
        print(" difference | conditions |")
        print("|---|---|---|---|---|---|---|---|---|---|---|")
        for problems in ([(p.name, p) for p in nonlinear()], quadratics()):
            counts = [compare(library, name, problem) for name, problem in problems]
            ours, theirs = (sum(c) for c in zip(*counts, strict=True))
            print(f"| **all** | | | | {ours} | {theirs} | | | | | |")


if __name__ == "__main__":
    main()
