"""The project's own method by stages against IPOPT: every problem that ships, in every representation and form.

    python -m benchmarks.ocp.stages [PROBLEM ...]

Both start from the same guess, to a tolerance of 1e-8 whatever the file asks for; IPOPT does not relax bounds. A row
for each: status, iterations, processor time, and the relative difference of the costs. Each row is written to
`stages.jsonl` at once, and an interrupted run continues; at the end, a page is written. Exit code 1 if a problem that
IPOPT solves is not solved, or its cost is higher.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from mbsgen.errors import MbsError
from mbsrun.external import load_on_demand
from mbsrun.ocp.ground.plant import Plant
from mbsrun.ocp.ground.status import ACCEPTABLE, SOLVED
from mbsrun.ocp.problem.problem import Form, Loops, Problem, Representation
from mbsrun.ocp.solution.solution import Failure, Solution
from mbsrun.ocp.solving.solve import solve
from mbsrun.ocp.statement.checks import ProblemError, check_problem
from mbsrun.ocp.statement.statement import read_problem

MODELS = Path(__file__).parents[2] / "models"
TOLERANCE = 1e-8
SAME = 1e-7  # relative difference of costs at this tolerance
ENDING = ".ocp.yaml"


@dataclass(frozen=True)
class Run:
    """How a method ended."""

    status: str
    iterations: int
    seconds: float  # of the processor
    cost: float

    @property
    def is_solved(self) -> bool:
        """Return whether there is a solution."""
        return self.status in (SOLVED, ACCEPTABLE)


@dataclass(frozen=True)
class Row:
    """Both methods for a problem in one representation and form."""

    problem: str
    variant: str
    ipopt: Run
    mbs: Run

    @property
    def gap(self) -> float:
        """Return the relative difference of the costs, negative where the project's method found less."""
        return (self.mbs.cost - self.ipopt.cost) / max(abs(self.ipopt.cost), 1e-9)

    @property
    def has_same_optimum(self) -> bool:
        """Return whether both found the same cost."""
        return self.ipopt.is_solved and self.mbs.is_solved and abs(self.gap) < SAME

    @property
    def is_good(self) -> bool:
        """Return whether the project's method is as good as IPOPT."""
        return not self.ipopt.is_solved or (self.mbs.is_solved and self.gap < SAME)

    @property
    def words(self) -> tuple[str, ...]:
        """Return the cells of a table."""
        runs = (f"{r.status}, {r.iterations}, {r.seconds:.2f} s" for r in (self.mbs, self.ipopt))
        gap = f"{self.gap:.0e}" if math.isfinite(self.gap) else ""
        return (self.problem, self.variant, *runs, gap, "" if self.is_good else "worse")


def list_variants(problem: Problem, plant: Plant) -> Iterator[Problem]:
    """List the representations and forms that a problem can have; without a mechanism, its own."""
    loops = tuple(Loops) if plant.manifest.dependent else (None,)
    bare = not plant.manifest.coordinates
    for chosen in loops:
        for representation in (problem.representation,) if bare else Representation:
            for form in (problem.form,) if bare else Form:
                variant = replace(problem, representation=representation, form=form, loops=chosen)
                variant = (
                    variant
                    if form is problem.form
                    else replace(variant, integrator=Problem.integrator, steps=Problem.steps)
                )
                try:
                    check_problem(variant, plant.manifest)
                except ProblemError:
                    continue
                yield variant


def name_variant(problem: Problem) -> str:
    """Name representation, form and treatment of loops."""
    words = (problem.representation.value, problem.form.value, problem.loops.value if problem.loops else "")
    return " ".join(words).strip()


def run(problem: Problem, plant: Plant, method: str) -> Run:
    """Solve by one of the two methods."""
    options = (("bound_relax_factor", 0.0),) if method == "ipopt" else ()
    solver = replace(problem.solver, method=method, options=options, tolerance=TOLERANCE)
    outcome = solve(replace(problem, solver=solver), plant)
    cost = outcome.cost.total if isinstance(outcome, Solution) else math.nan
    assert isinstance(outcome, Solution | Failure)
    return Run(outcome.run.status, outcome.run.iterations, outcome.run.cpu_seconds, cost)


def compare(name: str, done: set[tuple[str, str]]) -> Iterator[Row]:
    """Solve what is not solved yet of a problem."""
    try:
        problem, plant = read_problem(MODELS / f"{name}{ENDING}", load_on_demand)
    except MbsError as error:  # problems of phases have another statement
        print(f"{name}: left out, {str(error).splitlines()[0]}", flush=True)
        return
    for variant in list_variants(problem, plant):
        if (name, name_variant(variant)) not in done:
            try:
                runs = [run(variant, plant, method) for method in ("ipopt", "mbs")]
            except ProblemError as error:
                print(f"{name}, {name_variant(variant)}: left out, {str(error).splitlines()[0]}", flush=True)
                continue
            yield Row(name, name_variant(variant), *runs)


def read(file: Path) -> list[Row]:
    """Read what an earlier run wrote; an unfinished last line is left out."""
    if not file.exists():
        return []
    found = [json.loads(line) for line in file.read_text("utf-8").splitlines() if line.endswith("}}")]
    return [Row(r["problem"], r["variant"], Run(**r["ipopt"]), Run(**r["mbs"])) for r in found]


def average(ratios: Sequence[float]) -> float:
    """Return the geometric mean."""
    return float(np.exp(np.mean(np.log(ratios)))) if ratios else math.nan


def write_page(rows: Sequence[Row]) -> str:
    """Write the comparison as Markdown: a line for each problem, then each row that differs."""
    lines = [
        "# The method by stages beside IPOPT: all problems that ship",
        "",
        "`python -m benchmarks.ocp.stages` wrote this page. Problems of one phase are solved in all representations",
        "and forms that they take, from the same guess, to a tolerance of 1e-8. IPOPT does not relax bounds.",
        "Of two numbers in a cell, the first one is of `mbs`, the second one of IPOPT. Ratios are geometric means of",
        "`mbs` over IPOPT, where both found the same cost to 1e-7. Times are of the processor, functions included.",
        "",
        "| problem | variants | solved | same cost | ratio of iterations | ratio of times | lower, higher cost |",
        "|---|---:|---:|---:|---:|---:|---:|",
    ]
    names = sorted({row.problem for row in rows})
    for name, part in [*((n, [r for r in rows if r.problem == n]) for n in names), ("**all**", list(rows))]:
        same = [row for row in part if row.has_same_optimum]
        both = [row for row in part if row.ipopt.is_solved and row.mbs.is_solved]
        lower, higher = sum(row.gap <= -SAME for row in both), sum(row.gap >= SAME for row in both)
        iterations = average([max(r.mbs.iterations, 1) / max(r.ipopt.iterations, 1) for r in same])
        seconds = average([r.mbs.seconds / r.ipopt.seconds for r in same])
        solved = f"{sum(r.mbs.is_solved for r in part)}, {sum(r.ipopt.is_solved for r in part)}"
        ratios = f"{iterations:.2f} | {seconds:.2f}" if same else "|"
        lines.append(f"| {name} | {len(part)} | {solved} | {len(same)} | {ratios} | {lower}, {higher} |")
    other = [row for row in rows if not row.has_same_optimum]
    lines += ["", "| not the same | | `mbs` | IPOPT | relative difference | |", "|---|---|---|---|---|---|"]
    lines += [f"| {' | '.join(row.words)} |" for row in other]
    return "\n".join(lines) + "\n"


def read_arguments(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.ocp.stages", description=__doc__)
    parser.add_argument("problems", nargs="*", metavar="PROBLEM", help="such as arm_reach or classics/car; all")
    parser.add_argument("--out", type=Path, default=Path("build/bench-stages"), help="folder of the results")
    return parser.parse_args(arguments)


def main(arguments: Sequence[str] | None = None) -> int:
    """Compare problems by name, or all."""
    options = read_arguments(arguments)
    options.out.mkdir(parents=True, exist_ok=True)
    file: Path = options.out / "stages.jsonl"
    rows = read(file)
    done = {(row.problem, row.variant) for row in rows}
    shipped = sorted(p.relative_to(MODELS).as_posix().removesuffix(ENDING) for p in MODELS.rglob(f"*{ENDING}"))
    with file.open("a", encoding="utf-8") as out:
        for name in options.problems or shipped:
            for row in compare(name, done):
                rows.append(row)
                out.write(json.dumps(asdict(row)) + "\n")
                out.flush()
                print("  ".join(row.words), flush=True)
    (options.out / "stages.md").write_text(write_page(rows), "utf-8")
    good = sum(row.is_good for row in rows)
    print(f"{good} of {len(rows)} as good as IPOPT")
    return 0 if good == len(rows) else 1


if __name__ == "__main__":
    sys.exit(main())
