"""Compare NLP methods: `python -m benchmarks.ocp.methods`; the project's method by stages beside IPOPT.

The tasks are the shipped problems, and targets of the arm's task on a cylinder, each with two costs in all six
representations. Both methods start from the same guess. IPOPT does not relax bounds, as its optimum would be another
one. Each solve is written to `methods.jsonl` at once, and an interrupted run continues.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from rich.console import Console

from mbsrun.external import load_on_demand
from mbsrun.ocp.ground import schemes
from mbsrun.ocp.ground.plant import Plant
from mbsrun.ocp.ground.status import ACCEPTABLE, SOLVED
from mbsrun.ocp.ground.trajectory import Trajectory
from mbsrun.ocp.guessing.guess import make_guess
from mbsrun.ocp.problem.problem import Problem, Representation
from mbsrun.ocp.searching.study import Targets
from mbsrun.ocp.solution.solution import Solution
from mbsrun.ocp.solving.solve import Solver
from mbsrun.ocp.statement.statement import read_problem

MODELS = Path(__file__).parents[2] / "models"
ARM = MODELS / "arm_reach.ocp.yaml"
RADIUS, AZIMUTHS, HEIGHTS = 0.63, 11, 3
COSTS = ((1.0, 0.0), (1.0, 1e5))
METHODS = {"mbs": (), "ipopt": (("bound_relax_factor", 0.0),)}
SHIPPED = "shipped problems"
SAME = 1e-6  # relative difference of costs within which two optima are one; other minima are 6e-6 apart at least


@dataclass(frozen=True)
class Solve:
    """The result of one method for one task."""

    group: str
    task: str
    method: str
    status: str
    iterations: int
    cost: float

    @property
    def is_solved(self) -> bool:
        """Return whether there is a solution."""
        return self.status in (SOLVED, ACCEPTABLE)


def solve(solver: Solver, problem: Problem, plant: Plant, names: tuple[str, str, str]) -> Solve:
    """Solve a task from the guess that the problem describes."""
    guess = make_guess(problem, plant, schemes.build(problem.family, problem.degree))
    assert isinstance(guess, Trajectory), "the target is within reach"
    outcome = solver.solve(problem, guess)
    cost = outcome.cost.total if isinstance(outcome, Solution) else math.nan
    return Solve(*names, outcome.run.status, outcome.run.iterations, cost)


def choose(problem: Problem, method: str) -> Problem:
    """Return a problem with another method."""
    return replace(problem, solver=replace(problem.solver, method=method, options=METHODS[method]))


def solve_shipped(done: set[tuple[str, str, str]]) -> Iterator[Solve]:
    """Solve each shipped problem by each method."""
    for file in sorted(MODELS.glob("*.ocp.yaml")):
        todo = [(SHIPPED, file.name.removesuffix(".ocp.yaml"), method) for method in METHODS]
        if done.issuperset(todo):
            continue
        problem, plant = read_problem(file, load_on_demand)
        for names in todo:
            chosen = choose(problem, names[2])
            yield solve(Solver(chosen, plant), chosen, plant, names)


def list_targets(count: int) -> tuple[tuple[str, tuple[float, float, float]], ...]:
    """List the first `count` targets of a grid of 33, by ever finer grids."""
    half = math.pi / 2
    azimuths, heights = np.linspace(-half, half, AZIMUTHS), np.linspace(-0.1, 0.1, HEIGHTS)
    grid = Targets(RADIUS, tuple(azimuths.tolist()), tuple(heights.tolist()))
    return tuple((f"{a}-{b}", grid.position((a, b))) for a, b in grid.spread[:count])


def solve_grid(
    done: set[tuple[str, str, str]], targets: int, intervals: int, representations: Sequence[Representation]
) -> Iterator[Solve]:
    """Solve the arm's task for targets, costs and representations; each program is made once."""
    problem, plant = read_problem(ARM, load_on_demand)
    problem = replace(problem, intervals=intervals)
    for representation in representations:
        group = f"arm, {representation.value}, {intervals} intervals"
        for method in METHODS:
            chosen = choose(replace(problem, representation=representation), method)
            solver = None
            for name, position in list_targets(targets):
                for inputs, rates in COSTS:
                    names = (group, f"target {name}, cost {inputs:g} {rates:g}", method)
                    if names in done:
                        continue
                    solver = solver or Solver(chosen, plant)
                    cost = replace(chosen.cost, inputs=inputs, input_rates=rates)
                    aimed = replace(chosen, cost=cost).with_target("hand", position)
                    yield solve(solver, aimed, plant, names)


def read(file: Path) -> list[Solve]:
    """Read what an earlier run wrote; an unfinished last line is left out."""
    if not file.exists():
        return []
    return [Solve(**json.loads(line)) for line in file.read_text("utf-8").splitlines() if line.endswith("}")]


@dataclass(frozen=True)
class Summary:
    """The comparison over a group of tasks; the project's method comes before IPOPT."""

    tasks: int
    solved: tuple[int, int]
    ratio: float  # geometric mean of the ratios of iterations, where both found the same optimum
    iterations: tuple[int, int]  # there, together
    difference: float  # the largest relative one of costs there
    lower: tuple[int, int]  # how often one found a lower minimum than the other


def summarise(pairs: Sequence[tuple[Solve, Solve]]) -> Summary:
    """Compare the methods over tasks."""
    both = [(a, b) for a, b in pairs if a.is_solved and b.is_solved]
    gaps = [(a.cost - b.cost) / max(abs(b.cost), 1e-12) for a, b in both]
    same = [(a, b) for (a, b), gap in zip(both, gaps, strict=True) if abs(gap) <= SAME]
    ratios = [math.log(max(a.iterations, 1) / max(b.iterations, 1)) for a, b in same]
    return Summary(
        tasks=len(pairs),
        solved=(sum(a.is_solved for a, _ in pairs), sum(b.is_solved for _, b in pairs)),
        ratio=math.exp(float(np.mean(ratios))) if ratios else math.nan,
        iterations=(sum(a.iterations for a, _ in same), sum(b.iterations for _, b in same)),
        difference=max((abs(gap) for gap in gaps if abs(gap) <= SAME), default=math.nan),
        lower=(sum(gap < -SAME for gap in gaps), sum(gap > SAME for gap in gaps)),
    )


def pair(solves: Sequence[Solve]) -> dict[str, list[tuple[Solve, Solve]]]:
    """Put the solves of a task by both methods together, by group."""
    found = {(s.group, s.task, s.method): s for s in solves}
    groups: dict[str, list[tuple[Solve, Solve]]] = {}
    for (group, task, method), ours in found.items():
        theirs = found.get((group, task, "ipopt"))
        if method == "mbs" and theirs is not None:
            groups.setdefault(group, []).append((ours, theirs))
    return groups


def write_page(solves: Sequence[Solve]) -> str:
    """Write the comparison as Markdown: groups, then each shipped problem, then what was not solved alike."""
    groups = pair(solves)
    lines = [
        "# The method by stages beside IPOPT",
        "",
        "`python -m benchmarks.ocp.methods` wrote this page. Both methods start from the same guess; IPOPT does not",
        "relax bounds. Of two numbers in a cell, the first one is of `mbs`, the second one of IPOPT. Iterations and",
        "their ratio, a geometric mean, are of tasks in which both found the same optimum. Lower minima are those",
        "that are lower than the other method's.",
        "",
        "| group | tasks | solved | iterations | mean ratio | largest difference of costs | lower minima |",
        "|---|---|---|---|---|---|---|",
    ]
    everything = [p for pairs in groups.values() for p in pairs]
    for name, pairs in [*groups.items(), ("**all**", everything)]:
        s = summarise(pairs)
        cells = (
            name,
            str(s.tasks),
            f"{s.solved[0]}, {s.solved[1]}",
            f"{s.iterations[0]}, {s.iterations[1]}",
            f"{s.ratio:.2f}",
            f"{s.difference:.0e}",
            f"{s.lower[0]}, {s.lower[1]}",
        )
        lines.append(f"| {' | '.join(cells)} |")
    lines += ["", "| shipped problem | iterations | cost of `mbs` | relative difference |", "|---|---|---|---|"]
    for a, b in groups.get(SHIPPED, []):
        lines.append(
            f"| {a.task} | {a.iterations}, {b.iterations} | {a.cost:.10g} | {(a.cost - b.cost) / b.cost:.0e} |"
        )
    failed = [(a, b) for a, b in everything if not (a.is_solved and b.is_solved)]
    if failed:
        lines += ["", "| not solved by both | `mbs` | IPOPT |", "|---|---|---|"]
        lines += [
            f"| {a.group}, {a.task} | {a.status}, {a.iterations} | {b.status}, {b.iterations} |" for a, b in failed
        ]
    return "\n".join(lines) + "\n"


def read_arguments(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.ocp.methods", description=__doc__)
    parser.add_argument("--targets", type=int, default=3, help="of the grid of 33; 3")
    parser.add_argument("--intervals", type=int, default=25, help="of the arm's task; 25, the paper has 100")
    names = [representation.value for representation in Representation]
    parser.add_argument("--representations", nargs="+", choices=names, default=names, help="all")
    parser.add_argument("--no-shipped", dest="shipped", action="store_false", help="leave out the shipped problems")
    parser.add_argument("--out", type=Path, default=Path("build/bench-methods"), help="folder of the results")
    parser.add_argument("--again", action="store_true", help="start anew")
    return parser.parse_args(arguments)


def solve_all(options: argparse.Namespace, done: set[tuple[str, str, str]]) -> Iterator[Solve]:
    """Solve all tasks that the command line asks for and that are not done."""
    if options.shipped:
        yield from solve_shipped(done)
    representations = [Representation(name) for name in options.representations]
    yield from solve_grid(done, options.targets, options.intervals, representations)


def main(arguments: Sequence[str] | None = None) -> None:
    """Solve what is not solved yet, and write the page."""
    options, console = read_arguments(arguments), Console()
    options.out.mkdir(parents=True, exist_ok=True)
    file: Path = options.out / "methods.jsonl"
    if options.again:
        file.unlink(missing_ok=True)
    solves = read(file)
    file.write_text("".join(json.dumps(asdict(s)) + "\n" for s in solves), "utf-8")
    done = {(s.group, s.task, s.method) for s in solves}
    with file.open("a", encoding="utf-8") as out:
        for result in solve_all(options, done):
            solves.append(result)
            out.write(json.dumps(asdict(result)) + "\n")
            out.flush()
            console.print(f"{result.group}, {result.task}, {result.method}: {result.status}, {result.iterations}")
    page = write_page(solves)
    (options.out / "methods.md").write_text(page, "utf-8")
    console.print(page, markup=False)


if __name__ == "__main__":
    main()
