"""The project's own method by stages against IPOPT: every problem that ships, in every representation and form.

    python -m benchmarks.ocp.stages [PROBLEM ...]

Both start from the same guess; IPOPT does not relax bounds. A row for each: status, iterations, processor time, and the
relative difference of the costs. Exit code 1 if a problem that IPOPT solves is not solved, or its cost is another one.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from mbsrun.external import load_on_demand
from mbsrun.ocp.checks import ProblemError, check_problem
from mbsrun.ocp.plant import Plant
from mbsrun.ocp.problem import Form, Loops, Problem, Representation
from mbsrun.ocp.solution import Failure, Solution
from mbsrun.ocp.solve import solve
from mbsrun.ocp.statement import read_problem

MODELS = Path(__file__).parents[2] / "models"
SAME = 1e-7  # relative difference of costs at a tolerance of 1e-8


def list_variants(problem: Problem, plant: Plant) -> Iterator[Problem]:
    """List the representations and forms that a problem can have."""
    loops = tuple(Loops) if plant.manifest.dependent else (None,)
    for chosen in loops:
        for representation in Representation:
            for form in Form:
                variant = replace(problem, representation=representation, form=form, loops=chosen)
                try:
                    check_problem(variant, plant.manifest)
                except ProblemError:
                    continue
                yield variant


def run(problem: Problem, plant: Plant, method: str) -> Solution | Failure:
    """Solve by one of the two methods."""
    options = (("bound_relax_factor", 0.0),) if method == "ipopt" else ()
    return solve(replace(problem, solver=replace(problem.solver, method=method, options=options)), plant)


def compare(problem: Problem, plant: Plant) -> bool:
    """Print a row; return whether the method is as good as IPOPT."""
    known, found = run(problem, plant, "ipopt"), run(problem, plant, "mbs")
    words = [
        problem.name,
        problem.representation.value,
        problem.form.value,
        problem.loops.value if problem.loops else "",
    ]
    for outcome in (known, found):
        words += [outcome.run.status, str(outcome.run.iterations), f"{outcome.run.cpu_seconds:.2f} s"]
    if not isinstance(known, Solution):
        is_good = True
    elif not isinstance(found, Solution):
        is_good = False
    else:
        difference = abs(found.cost.total / known.cost.total - 1)
        words.append(f"{difference:.1e}")
        is_good = difference < SAME or found.cost.total < known.cost.total
    print("  ".join((*words, "" if is_good else "<<<")), flush=True)
    return is_good


def main(names: Sequence[str]) -> int:
    """Compare problems by name, or all."""
    files = [MODELS / f"{name}.ocp.yaml" for name in names] or sorted(MODELS.glob("*.ocp.yaml"))
    rows = []
    for file in files:
        problem, plant = read_problem(file, load_on_demand)
        rows += [compare(variant, plant) for variant in list_variants(problem, plant)]
    print(f"{sum(rows)} of {len(rows)} as good as IPOPT")
    return 0 if all(rows) else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
