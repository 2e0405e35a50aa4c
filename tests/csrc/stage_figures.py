"""Print what docs/solver.md shows: iterations, optima and optimality conditions beside IPOPT's.

python -m tests.csrc.stage_figures
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from tests.csrc.stage_arm import arm
from tests.csrc.stage_problems import POLE, UP, cart_pole_ode, far_guesses, nonlinear, pendulum_ode, shooting
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


def time_sizes(library: Library) -> None:
    """Print the time of an iteration, callbacks included, of random quadratic programs with 100 intervals."""
    print("\n| states, v, equalities | iterations | ms an iteration | bytes a stage |\n|---|---|---|---|")
    for size, last in [((4, 1, 0, 0), (4, 0, 4, 0)), ((14, 7, 0, 0), (14, 0, 0, 0)), ((12, 28, 24, 0), (12, 0, 12, 0))]:
        problem = random_problem(np.random.default_rng(3), [size] * 100 + [last], bounds=0.3)
        solver, best = Solver(library, problem), np.inf
        for _ in range(5):
            solver.set(w=problem.guess)
            start = time.process_time()
            result = solver.solve().result
            best = min(best, (time.process_time() - start) / result.iterations)
        print(f"| {size[0]}, {size[1]}, {size[2]} | {result.iterations} | {1e3 * best:.2f} | {solver.bytes // 101} |")


def horizons() -> list[Problem]:
    """Problems of 100 intervals, as a controller has them."""
    walls = shooting("cart-pole between walls", cart_pole_ode, 4, 100, 0.03, np.zeros(4), POLE, 12.0, walls=0.6)
    softly = [
        shooting("pendulum", pendulum_ode, 2, 100, 0.05, np.zeros(2), UP, 4.0, 1.0, softly=True),
        shooting("cart-pole", cart_pole_ode, 4, 100, 0.03, np.zeros(4), POLE, 12.0, 1.0, softly=True),
    ]
    return [*softly, walls]


def compare_warm(library: Library) -> None:
    """Print iterations of cold and of warm starts: from other first states, and from the next one of the plan."""
    print(
        "\n| problem | cold | same | first state 0.01 off | 0.1 off | shifted, 0.003 off |\n|---|---|---|---|---|---|"
    )
    for problem in horizons():
        nx, rng = problem.sizes[0][0], np.random.default_rng(1)
        solver = Solver(library, problem)
        first, counts = problem.lower[:nx].copy(), [solver.solve().result.iterations]
        solution = {name: solver.get(name) for name in ("w", "y", "below", "above")}
        moved = [0.0 * first, 0.01 * rng.standard_normal(nx), 0.1 * rng.standard_normal(nx)]
        for change in moved:
            solver.set(**solution)
            solver.lower[:nx] = solver.upper[:nx] = first + change
            counts.append(solver.solve(warm=1).result.iterations)
        solver.set(**solution)
        ahead = solution["w"][nx + 1 : 2 * nx + 1] + 0.003 * rng.standard_normal(nx)
        library.lib.mbs_stages_shift(solver.solver)
        solver.lower[:nx] = solver.upper[:nx] = ahead
        counts.append(solver.solve(warm=1).result.iterations)
        print(f"| {problem.name} | {' | '.join(map(str, counts))} |")


def time_condensed(library: Library) -> None:
    """Print the time of an iteration, callbacks included, of stages with the structure of an arm, 100 intervals."""
    print("\n| points, joints, inputs | inner | iterations | refinements | ms an iteration | bytes a stage |")
    print("|---|---|---|---|---|---|")
    for points, joints, inputs in [(2, 2, 1), (4, 2, 1), (4, 6, 4)]:
        problem = arm(np.random.default_rng(0), 100, joints, inputs, points)
        solver, best = Solver(library, problem), np.inf
        for _ in range(5):
            solver.set(w=problem.guess)
            start = time.process_time()
            result = solver.solve().result
            best = min(best, (time.process_time() - start) / result.iterations)
        print(
            f"| {points}, {joints}, {inputs} | {3 * points * joints} | {result.iterations} | {result.refinements} | "
            f"{1e3 * best:.2f} | {solver.bytes // 101} |"
        )


def compare_far(library: Library) -> None:
    """Print how the nonlinear problems end from guesses that are far away, six of each."""
    ours, theirs = [0, 0], [0, 0]
    ratios = []
    for problem in far_guesses(6):
        answer = Solver(library, problem).solve(iterations=400)
        _, statistics = problem.ipopt(**{"ipopt.max_iter": 400})
        solved = answer.status == "solved", statistics["success"]
        ours[0], theirs[0] = ours[0] + solved[0], theirs[0] + solved[1]
        if all(solved):
            ours[1], theirs[1] = ours[1] + answer.result.iterations, theirs[1] + statistics["iter_count"]
            ratios.append(answer.result.iterations / statistics["iter_count"])
    print(f"\n48 far guesses: {ours[0]} solved, by IPOPT {theirs[0]}; iterations where both: {ours[1]}, {theirs[1]}, ")
    print(f"geometric mean of their ratios {np.exp(np.mean(np.log(ratios))):.3f}")


def main() -> None:
    with tempfile.TemporaryDirectory() as place:
        library = Library(compile_solver(Path(place), "-O3", "-march=native"))
        print(
            "| problem | variables | rows | status | iterations | IPOPT | factorisations | evaluations | cost |", end=""
        )
        print(" difference | conditions |")
        print("|---|---|---|---|---|---|---|---|---|---|---|")
        for problems in ([(p.name, p) for p in nonlinear()], quadratics()):
            counts = [compare(library, name, problem) for name, problem in problems]
            ours, theirs = (sum(c) for c in zip(*counts, strict=True))
            print(f"| **all** | | | | {ours} | {theirs} | | | | | |")
        compare_warm(library)
        time_sizes(library)
        time_condensed(library)
        if "--far" in sys.argv:
            compare_far(library)


if __name__ == "__main__":
    main()
