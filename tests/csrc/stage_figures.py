"""The solver in csrc/stages beside IPOPT: `python -m tests.csrc.stage_figures` writes a page.

Iterations, optima and optimality conditions of the problems that tests of the solver hold; warm starts; times of an
iteration, callbacks included. Both solvers start from the same guess with their default options; IPOPT does not relax
bounds. Conditions are the largest of stationarity, violation and complementarity, unscaled, from CasADi's derivatives.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from benchmarks.compilation import describe_machine
from benchmarks.pages import tabulate
from tests.csrc.stage_arm import arm
from tests.csrc.stage_problems import POLE, UP, cart_pole_ode, far_guesses, nonlinear, pendulum_ode, shooting
from tests.csrc.stage_quadratics import random_problem, random_sizes
from tests.csrc.stages import Library, Problem, Quadratic, Solver, compile_solver

PROBLEMS = (
    "problem", "variables", "rows", "status", "iterations", "IPOPT", "factorisations", "evaluations", "cost",
    "difference", "conditions",
)  # fmt: skip
WARM = "problem", "cold", "same", "first state 0.01 off", "0.1 off", "shifted, 0.003 off"
DENSE = "states, v, equalities of a stage", "iterations", "ms an iteration", "kB a stage"
CONDENSED = "points, joints, inputs", "inner variables", "iterations", "refinements", "ms an iteration", "kB a stage"
SIZES = ((4, 1, 0, 0), (4, 0, 4, 0)), ((14, 7, 0, 0), (14, 0, 0, 0)), ((12, 28, 24, 0), (12, 0, 12, 0))
ARMS = (2, 2, 1), (4, 2, 1), (4, 6, 4)


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


def compare(library: Library, name: str, problem: Problem | Quadratic) -> list[str]:
    """Solve a problem by both; return the row."""
    answer = Solver(library, problem).solve()
    solution, statistics = problem.ipopt()
    result, cost = answer.result, float(solution["f"][0])
    counts = result.iterations, statistics["iter_count"], result.factorisations, result.evaluations
    sizes = str(len(answer.w)), str(len(answer.y))
    worst = max(problem.residuals(*answer.point))
    ends = f"{result.cost:.9g}", f"{abs(result.cost - cost):.0e}", f"{worst:.0e}"
    return [name, *sizes, answer.status, *map(str, counts), *ends]


def compare_all(library: Library) -> list[list[str]]:
    """Return the rows of nonlinear problems, and of all quadratic ones with their sums and worst."""
    rows = [compare(library, problem.name, problem) for problem in nonlinear()]
    convex = [compare(library, name, problem) for name, problem in quadratics()]
    sums = [str(sum(int(row[k]) for row in convex)) for k in (4, 5, 6, 7)]
    worst = [f"{max(float(row[k]) for row in convex):.0e}" for k in (9, 10)]
    statuses = ", ".join(sorted({row[3] for row in convex}))
    return [*rows, [f"{len(convex)} convex quadratic programs at random", "", "", statuses, *sums, "", *worst]]


def time_solve(solver: Solver, problem: Problem | Quadratic) -> tuple[Any, str, str]:
    """Return the result, the time of an iteration at best of five solves, and the memory of a stage."""
    best = np.inf
    for _ in range(5):
        solver.set(w=problem.guess)
        start = time.process_time()
        result = solver.solve().result
        best = min(best, (time.process_time() - start) / result.iterations)
    return result, f"{1e3 * best:.2f}", f"{solver.bytes / 1000 / len(problem.sizes):.0f}"


def time_dense(library: Library) -> list[list[str]]:
    """Return rows of random quadratic programs with 100 intervals."""
    rows = []
    for size, last in SIZES:
        problem = random_problem(np.random.default_rng(3), [size] * 100 + [last], bounds=0.3)
        result, *cells = time_solve(Solver(library, problem), problem)
        rows.append([f"{size[0]}, {size[1]}, {size[2]}", str(result.iterations), *cells])
    return rows


def horizons() -> list[Problem]:
    """Problems of 100 intervals, as a controller has them."""
    walls = shooting("cart-pole between walls", cart_pole_ode, 4, 100, 0.03, np.zeros(4), POLE, 12.0, walls=0.6)
    softly = [
        shooting("pendulum", pendulum_ode, 2, 100, 0.05, np.zeros(2), UP, 4.0, 1.0, softly=True),
        shooting("cart-pole", cart_pole_ode, 4, 100, 0.03, np.zeros(4), POLE, 12.0, 1.0, softly=True),
    ]
    return [*softly, walls]


def compare_warm(library: Library) -> list[list[str]]:
    """Return iterations of cold and of warm starts: from other first states, and from the next one of the plan."""
    rows = []
    for problem in horizons():
        nx, rng = problem.sizes[0][0], np.random.default_rng(1)
        solver = Solver(library, problem)
        first, counts = problem.lower[:nx].copy(), [solver.solve().result.iterations]
        solution = {name: solver.get(name) for name in ("w", "y", "below", "above")}
        moved = [0.0 * first, 0.01 * rng.standard_normal(nx), 0.1 * rng.standard_normal(nx)]
        for change in moved:
            solver.set(**solution)
            solver.lower[:nx] = solver.upper[:nx] = first + change
            counts.append(solver.solve(warm_start_init_point=1).result.iterations)
        solver.set(**solution)
        ahead = solution["w"][nx + 1 : 2 * nx + 1] + 0.003 * rng.standard_normal(nx)
        library.lib.mbs_stages_shift(solver.solver)
        solver.lower[:nx] = solver.upper[:nx] = ahead
        counts.append(solver.solve(warm_start_init_point=1).result.iterations)
        rows.append([problem.name, *map(str, counts)])
    return rows


def time_condensed(library: Library) -> list[list[str]]:
    """Return rows of stages with the structure of an arm, 100 intervals."""
    rows = []
    for points, joints, inputs in ARMS:
        problem = arm(np.random.default_rng(0), 100, joints, inputs, points)
        result, *cells = time_solve(Solver(library, problem), problem)
        counts = 3 * points * joints, result.iterations, result.refinements
        rows.append([f"{points}, {joints}, {inputs}", *map(str, counts), *cells])
    return rows


def compare_far(library: Library) -> str:
    """Return a sentence on the nonlinear problems from guesses that are far away, six of each."""
    ours, theirs = [0, 0], [0, 0]
    ratios = []
    problems = list(far_guesses(6))
    for problem in problems:
        answer = Solver(library, problem).solve(max_iter=400)
        _, statistics = problem.ipopt(**{"ipopt.max_iter": 400})
        solved = answer.status == "solved", statistics["success"]
        ours[0], theirs[0] = ours[0] + solved[0], theirs[0] + solved[1]
        if all(solved):
            ours[1], theirs[1] = ours[1] + answer.result.iterations, theirs[1] + statistics["iter_count"]
            ratios.append(answer.result.iterations / statistics["iter_count"])
    mean = np.exp(np.mean(np.log(ratios)))
    counts = f"{len(problems)} starts: {ours[0]} solved, by IPOPT {theirs[0]}, in at most 400 iterations."
    both = f"Where both solved, they took {ours[1]} iterations, IPOPT {theirs[1]};"
    return f"{counts} {both} the geometric mean of the ratios is {mean:.2f}."


def write_page(library: Library) -> str:
    """Measure all, and return the page."""
    about = (__doc__ or "").split("\n\n")[1].strip().replace("\n", " ")
    parts: list[tuple[str, Callable[[Library], list[list[str]]], Sequence[str], str]] = [
        ("Beside IPOPT", compare_all, PROBLEMS, "Problems of the tests, from their own guesses."),
        ("Warm starts", compare_warm, WARM, "Iterations with 100 intervals: `warm` from the solution itself, from "
         "solutions for other first states, and from the plan moved ahead by one stage."),
        ("Dense stages", time_dense, DENSE, "Random quadratic programs with 100 intervals."),
        ("Inner variables", time_condensed, CONDENSED, "Collocation points of an arm with random numbers, 100 "
         "intervals. Callbacks are dense and take a third of the time."),
    ]  # fmt: skip
    head = f"`python -m tests.csrc.stage_figures` wrote this page: {describe_machine()}, -O3 -march=native."
    lines = ["# The solver in C", "", head, "", about]
    for title, measure, titles, words in parts:
        lines += ["", f"## {title}", "", words, "", *tabulate(titles, measure(library))]
    lines += ["", "## Far guesses", "", "Six guesses for each nonlinear problem, near ones and far ones.", ""]
    return "\n".join([*lines, compare_far(library)]) + "\n"


def main(arguments: Sequence[str] | None = None) -> None:
    """Compile, measure, and write the page."""
    parser = argparse.ArgumentParser(prog="python -m tests.csrc.stage_figures", description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("build/solver.md"), help="the page")
    given = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as place, Console().status("solving"):
        page = write_page(Library(compile_solver(Path(place), "-O3", "-march=native")))
    given.out.parent.mkdir(parents=True, exist_ok=True)
    given.out.write_text(page, encoding="utf-8")
    Console().print(f"wrote {given.out}")


if __name__ == "__main__":
    main()
