"""Solve random problems whose ends lie on their limits: `python -m benchmarks.ocp.ends`; `mbs` beside IPOPT.

`studies.laboratory.ends` draws the problems: 500, of ten kinds in turn, in all forms and representations. Both methods
start from the same guess, with their default options, and neither falls back on the other. Where their costs differ,
IPOPT starts again at the answer of `mbs`: if it finds a lower cost nearby, the answer is wrong, else it is another
minimum. Each solve is written to `ends.jsonl` at once, and an interrupted run continues. `--write 17` prints a problem.
"""

from __future__ import annotations

import argparse
import json
import math
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from rich.console import Console

from mbsrun.external import load_on_demand
from mbsrun.ocp.ground.plant import Plant
from mbsrun.ocp.ground.status import ACCEPTABLE, SOLVED
from mbsrun.ocp.problem.problem import Problem
from mbsrun.ocp.solution.solution import Failure, Solution
from mbsrun.ocp.solving.solve import solve
from mbsrun.ocp.statement.statement import read_problem
from studies.laboratory.ends import KINDS, draw

METHODS = ("mbs", "ipopt")
Options = tuple[tuple[str, float], ...]
NEAR: Options = (("mu_init", 1e-7), ("bound_push", 1e-9), ("bound_frac", 1e-9))  # IPOPT at an answer
STRICT: tuple[Options, ...] = tuple((*NEAR, ("bound_relax_factor", part)) for part in (0.0, 1e-10, 1e-9))
SAME = 1e-6  # relative difference of costs within which two answers are one
ROUNDING = 1e-9  # a cost below which differences are absolute


@dataclass(frozen=True)
class Solve:
    """The answer of one method to one problem."""

    number: int
    kind: str
    method: str
    status: str
    iterations: int
    seconds: float
    cost: float
    nearby: float | None = None  # the cost that IPOPT finds from there, where it was asked
    strict: float | None = None  # the same with the least giving bounds with which it solves

    @property
    def is_solved(self) -> bool:
        """Return whether there is a solution."""
        return self.status in (SOLVED, ACCEPTABLE)

    @property
    def is_wrong(self) -> bool:
        """Return whether a lower cost is near."""
        is_lower = self.nearby is not None and differ(self.cost, self.nearby) and self.nearby < self.cost
        return is_lower and not self.is_loose

    @property
    def is_loose(self) -> bool:
        """Return whether the cost is not determined to these digits: bounds that give by 1e-8 change it by more."""
        return self.nearby is not None and self.strict is not None and differ(self.nearby, self.strict)


def differ(a: float, b: float) -> bool:
    """Return whether two costs are not the same."""
    return abs(a - b) > max(SAME * max(abs(a), abs(b)), ROUNDING)


def choose(problem: Problem, method: str, options: Options = ()) -> Problem:
    """Return a problem for a method."""
    return replace(problem, solver=replace(problem.solver, method=method, options=options))


def solve_both(number: int, folder: Path) -> tuple[Solve, Solve]:
    """Solve a problem by both methods; where their costs differ, look near the answer of `mbs`."""
    drawn = draw(number)
    problem, plant = read_problem(drawn.write(folder), load_on_demand)
    outcomes = [solve(choose(problem, method), plant) for method in METHODS]
    ours, theirs = (
        Solve(number, drawn.kind, method, o.run.status, o.run.iterations, round(o.run.cpu_seconds, 4), _read_cost(o))
        for method, o in zip(METHODS, outcomes, strict=True)
    )
    if isinstance(outcomes[0], Solution) and (not theirs.is_solved or differ(ours.cost, theirs.cost)):
        nearby = _look_nearby(problem, plant, outcomes[0], NEAR)
        ours = replace(ours, nearby=nearby, strict=_look_strictly(problem, plant, outcomes[0]))
    return ours, theirs


def _read_cost(outcome: Solution | Failure) -> float:
    return outcome.cost.total if isinstance(outcome, Solution) else math.nan


def _look_nearby(problem: Problem, plant: Plant, found: Solution, options: Options) -> float | None:
    """Return the cost that IPOPT finds from an answer; None where it finds none."""
    outcome = solve(choose(problem, "ipopt", options), plant, guess=found.trajectory)
    return outcome.cost.total if isinstance(outcome, Solution) else None


def _look_strictly(problem: Problem, plant: Plant, found: Solution) -> float | None:
    """Return the cost that IPOPT finds from an answer, with bounds that give as little as it copes with."""
    costs = (_look_nearby(problem, plant, found, options) for options in STRICT)
    return next((cost for cost in costs if cost is not None), None)


# --- the page -------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Summary:
    """The comparison over some problems; the project's method comes before IPOPT."""

    problems: int
    solved: tuple[int, int]
    wrong: int
    loose: int  # where the cost is not determined to these digits
    others: int  # where both found an answer, and not the same one
    iterations: tuple[int, int]  # where both found the same
    ratio: float  # geometric mean there

    @property
    def cells(self) -> tuple[str, ...]:
        """Return the cells of a line."""
        solved, iterations = (f"{ours}, {theirs}" for ours, theirs in (self.solved, self.iterations))
        return (
            str(self.problems),
            solved,
            str(self.wrong),
            str(self.loose),
            str(self.others),
            iterations,
            f"{self.ratio:.2f}",
        )


def summarise(pairs: Sequence[tuple[Solve, Solve]]) -> Summary:
    """Compare the methods over some problems."""
    both = [(a, b) for a, b in pairs if a.is_solved and b.is_solved]
    same = [(a, b) for a, b in both if not differ(a.cost, b.cost)]
    ratios = [math.log(max(a.iterations, 1) / max(b.iterations, 1)) for a, b in same]
    return Summary(
        problems=len(pairs),
        solved=(sum(a.is_solved for a, _ in pairs), sum(b.is_solved for _, b in pairs)),
        wrong=sum(a.is_wrong for a, _ in pairs),
        loose=sum(a.is_loose for a, _ in pairs),
        others=len(both) - len(same),
        iterations=(sum(a.iterations for a, _ in same), sum(b.iterations for _, b in same)),
        ratio=math.exp(float(np.mean(ratios))) if ratios else math.nan,
    )


def pair(solves: Sequence[Solve]) -> list[tuple[Solve, Solve]]:
    """Put the answers of both methods to a problem together."""
    found = {(s.number, s.method): s for s in solves}
    numbers = sorted({s.number for s in solves})
    return [
        (found[n, METHODS[0]], found[n, METHODS[1]]) for n in numbers if all((n, method) in found for method in METHODS)
    ]


def write_page(solves: Sequence[Solve]) -> str:
    """Write the comparison as Markdown: by kind, then each problem with a wrong answer or none."""
    pairs = pair(solves)
    lines = [
        "# Ends on limits",
        "",
        "`python -m benchmarks.ocp.ends` wrote this page. Random problems end on their limits, have rows twice,",
        "fixed variables, equations that follow from others, or no interior (`studies.laboratory.ends`). Of two",
        "numbers in a cell, the first one is of `mbs`, the second one of IPOPT. An answer is wrong where IPOPT finds a",
        "lower cost",
        f"from it, by {SAME:g} of it. Where IPOPT's own two costs there, with bounds that give by 1e-8 and bounds",
        "that give by less (0, 1e-10 or 1e-9, the first that it solves), differ by more than that, the cost is",
        "undetermined. Iterations and their mean ratio are of problems to which both found the same answer.",
        "",
        "| kind | problems | solved | wrong | undetermined | other minima | iterations | mean ratio |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for kind in KINDS:
        if own := [(a, b) for a, b in pairs if a.kind == kind]:
            lines.append(f"| {kind} | {' | '.join(summarise(own).cells)} |")
    lines.append(f"| **all** | {' | '.join(summarise(pairs).cells)} |")
    if listed := [(a, b) for a, b in pairs if a.is_wrong or a.is_loose or not (a.is_solved and b.is_solved)]:
        lines += ["", "| number | kind | `mbs` | cost | IPOPT | cost |", "|---|---|---|---|---|---|"]
        lines += [
            f"| {a.number} | {a.kind} | {'wrong, ' * a.is_wrong}{'undetermined, ' * a.is_loose}"
            f"{a.status}, {a.iterations} | {a.cost:.9g} "
            f"| {b.status}, {b.iterations} | {b.cost:.9g} |"
            for a, b in listed
        ]
    return "\n".join(lines) + "\n"


def read(file: Path) -> list[Solve]:
    """Read what an earlier run wrote; an unfinished last line is left out."""
    if not file.exists():
        return []
    return [Solve(**json.loads(line)) for line in file.read_text("utf-8").splitlines() if line.endswith("}")]


def print_problem(number: int) -> None:
    """Print a problem and its model."""
    drawn = draw(number)
    print(f"# {drawn.kind}, the model\n{drawn.model}\n# the problem\n{json.dumps(drawn.problem, indent=1)}")


def read_arguments(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.ocp.ends", description=__doc__)
    parser.add_argument("--first", type=int, default=0, help="number of the first problem; 0")
    parser.add_argument("--problems", type=int, default=500, help="how many; 500")
    parser.add_argument("--out", type=Path, default=Path("build/bench-ends"), help="folder of the results")
    parser.add_argument("--again", action="store_true", help="start anew")
    parser.add_argument("--write", type=int, metavar="NUMBER", help="print this problem, and solve nothing")
    return parser.parse_args(arguments)


def solve_all(options: argparse.Namespace, done: set[int]) -> Iterator[Solve]:
    """Solve all problems that are not solved yet."""
    with tempfile.TemporaryDirectory() as folder:
        for number in range(options.first, options.first + options.problems):
            if number not in done:
                yield from solve_both(number, Path(folder))


def main(arguments: Sequence[str] | None = None) -> None:
    """Solve what is not solved yet, and write the page."""
    options, console = read_arguments(arguments), Console()
    if options.write is not None:
        print_problem(options.write)
        return
    options.out.mkdir(parents=True, exist_ok=True)
    file: Path = options.out / "ends.jsonl"
    if options.again:
        file.unlink(missing_ok=True)
    solves = [solve for both in pair(read(file)) for solve in both]
    file.write_text("".join(json.dumps(asdict(s)) + "\n" for s in solves), "utf-8")
    with file.open("a", encoding="utf-8") as out:
        for result in solve_all(options, {s.number for s in solves}):
            solves.append(result)
            out.write(json.dumps(asdict(result)) + "\n")
            out.flush()
            console.print(
                f"{result.number} {result.kind}, {result.method}: {result.status}, {result.iterations}, "
                f"{result.cost:.9g}{', wrong' * result.is_wrong}",
                highlight=False,
            )
    page = write_page(solves)
    (options.out / "ends.md").write_text(page, "utf-8")
    console.print(page, markup=False)


if __name__ == "__main__":
    main()
