"""Derivatives of the solutions of all shipped problems against differences: `python -m benchmarks.derivatives`.

Each problem is solved to a tolerance of 1e-13, and differentiated by all of its numbers. For some numbers, drawn at
random from the ones that move the motion, the problem is solved again at four values beside its own. Each of these
optima is continued to rounding with its active set, from the solution that is differentiated, since solves end at
distances of up to 1e-6, and angles may come back with another turn; its cost has to be the solve's. Differences of
order four of all variables have a largest deviation from the derivatives, over the largest derivative. Of steps of
3e-3 down to 3e-6 of a number the best one counts, since long steps meet changes of the active set. Times are
processor time: of the solve by the project's method in C; of the optimum with its active set and factors, from the
solution on, in Python; and of the adjoint of one function, by all numbers, with these factors.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

import mbsrun
from benchmarks.compilation import describe_machine
from benchmarks.pages import tabulate
from mbsgen.errors import MbsError
from mbsrun.ocp.ground.functions import Array
from mbsrun.ocp.ground.trajectory import Trajectory
from mbsrun.ocp.optima.movement import Movement
from mbsrun.ocp.optima.point import find_optimum
from mbsrun.ocp.optima.status import SMOOTH
from mbsrun.optimal.control import OptimalControl
from mbsrun.optimal.derivatives import PARTS
from mbsrun.optimal.phases import PhasedControl, SolvedPhases
from mbsrun.optimal.result import Solved

MODELS = Path(__file__).parents[1] / "models"
TOLERANCE = 1e-13
NEAR = {"method": "mbs", "tolerance": 1e-11}  # of solves beside it
SAME = 1e-7  # of costs, over their size: they belong to one optimum
STEPS = (3e-3, 3e-4, 3e-5, 3e-6)  # of a number, over its size
CHOSEN = 3  # numbers of a problem
ROUNDS = 5  # of a time, of which the shortest counts


@dataclass(frozen=True)
class Row:
    """The figures of a problem."""

    name: str
    status: str
    variables: int
    active: int
    numbers: int  # by which there are derivatives
    errors: tuple[tuple[str, float], ...]  # by number; infinite where a solve failed
    seconds: tuple[float, float, float]  # of the solve, the optimum, an adjoint


def main() -> None:
    """Measure, and write the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--out", type=Path, default=Path("build/bench-derivatives"))
    parser.add_argument("--only", nargs="*", help="names of problems, such as leg_step or legged/walker")
    options = parser.parse_args()
    files = sorted(MODELS.glob("**/*.ocp.yaml"))
    names = [file.relative_to(MODELS).as_posix().removesuffix(".ocp.yaml") for file in files]
    rows: list[Row] = []
    options.out.mkdir(parents=True, exist_ok=True)
    for name, file in zip(names, files, strict=True):
        if not options.only or name in options.only:
            rows.append(measure(name, file))
            print(rows[-1], flush=True)
            (options.out / "derivatives.md").write_text(write_page(rows), encoding="utf-8")


def measure(name: str, file: Path) -> Row:
    """Solve a problem, and compare its derivatives with differences."""
    problem = mbsrun.read_problem(file).with_changes(solver={"tolerance": TOLERANCE}, refine=None)
    found = problem.solve(check=False)
    if not isinstance(found, Solved | SolvedPhases):
        return Row(name, found.status, 0, 0, 0, (), (np.nan,) * 3)
    derivatives = problem.derivatives(found)  # type: ignore[arg-type]
    movement = derivatives.answer.movement
    smooth = [x for x, status in derivatives.statuses.items() if status == SMOOTH]
    moving = [x for x in smooth if np.abs(_flatten(derivatives.by(x).phases)).max() > 1e-6]
    chosen = [moving[k] for k in np.random.default_rng(0).permutation(len(moving))[:CHOSEN]]
    errors = [(x, _compare(problem, found, x)) for x in chosen]
    seconds = found.solution.run.cpu_seconds, _time(lambda: _improve(movement)), _time_adjoint(movement)
    size = movement.optimum.x.size
    return Row(name, derivatives.status, size, derivatives.active, len(smooth), tuple(errors), seconds)


def _compare(problem: OptimalControl | PhasedControl, found: Solved | SolvedPhases, name: str) -> float:
    """Return the least error of a derivative, over its largest entry."""
    answer = problem.derivatives(found, [name]).answer  # type: ignore[arg-type]
    movement, value = answer.movement, answer.numbers[0].value
    own, errors = movement.move(0), []
    for step in STEPS:
        h = step * (abs(value) or 1.0)
        beside = [_continue(problem, found, movement, name, value + k * h) for k in (-2, -1, 1, 2)]
        points = [point for point in beside if point is not None]
        if len(points) == len(beside):
            a, b, c, d = points
            errors.append(float(np.abs((8 * (c - b) - (d - a)) / (12 * h) - own).max() / np.abs(own).max()))
        if errors and min(errors) < 1e-7:
            break
    return min(errors, default=np.inf)


def _continue(
    problem: OptimalControl | PhasedControl, found: Solved | SolvedPhases, movement: Movement, name: str, value: float
) -> Array | None:
    """Return the variables of the optimum for another value of a number; None where there is none near."""
    changed = problem.with_changes(solver=NEAR).with_numbers({name: value})
    try:
        again = changed.solve(check=False, guess=found)  # type: ignore[arg-type]
        if not isinstance(again, Solved | SolvedPhases):
            return None
        at = changed.derivatives(again, [name]).answer.movement.optimum.instance  # type: ignore[arg-type]
    except MbsError:
        return None
    base, functions = movement.optimum, movement.prepared.numpy
    start, answer = replace(at, x=base.x), (base.x, base.multipliers / base.scale)
    optimum = find_optimum(functions, movement.prepared.data, start, base.scale, answer)
    terms = functions.terms(optimum.x, at.parameters)
    cost = float(at.parameters[: terms.size] @ terms)
    return optimum.x if optimum.status == SMOOTH and abs(cost - again.cost) <= SAME * max(1.0, abs(cost)) else None


def _flatten(motions: tuple[Trajectory, ...]) -> Array:
    return np.concatenate([getattr(motion, name).ravel() for motion in motions for name in PARTS])


def _improve(movement: Movement) -> None:
    optimum, program = movement.optimum, movement.prepared
    answer = optimum.instance.x, optimum.multipliers / optimum.scale
    find_optimum(program.numpy, program.data, optimum.instance, optimum.scale, answer)


def _time_adjoint(movement: Movement) -> float:
    if movement.status != SMOOTH:
        return np.nan
    gradient = np.random.default_rng(0).standard_normal(movement.optimum.x.size)
    movement.pull(gradient)
    return _time(lambda: movement.pull(gradient))


def _time(call: Callable[[], object]) -> float:
    times = []
    for _ in range(ROUNDS):
        begin = time.process_time()
        call()
        times.append(time.process_time() - begin)
    return min(times)


def write_page(rows: list[Row]) -> str:
    """Return the page."""
    smooth = [row for row in rows if row.errors]
    errors = [error for row in smooth for _, error in row.errors]
    shares = [row.seconds[2] / row.seconds[0] for row in smooth if row.seconds[0] > 0]
    table = [
        (
            row.name,
            row.status,
            str(row.variables),
            str(row.active),
            str(row.numbers),
            f"{max((error for _, error in row.errors), default=np.nan):.1e}" if row.errors else "–",
            *(f"{1e3 * x:.2g}" if np.isfinite(x) else "–" for x in row.seconds),
        )
        for row in rows
    ]
    titles = ("problem", "status", "variables", "active", "numbers", "largest error")
    times = ("solve [ms]", "optimum [ms]", "adjoint [ms]")
    agreeing = sum(error <= 1e-6 for error in errors)
    share = 100 * float(np.median(shares)) if shares else np.nan
    return "\n".join(
        [
            "# Derivatives of solutions",
            "",
            *(__doc__ or "").split("\n\n", 1)[1].strip().splitlines(),
            "",
            f"{len(rows)} of {len(list(MODELS.glob('**/*.ocp.yaml')))} shipped problems are listed.",
            f"Of {len(rows)} problems, {len(smooth)} have derivatives. Of {len(errors)} numbers, {agreeing} agree to",
            f"1e-6; the median is {np.median(errors or [np.nan]):.1e}.",
            f"An adjoint takes {share:.2g} % of the time of its solve in the median. On {describe_machine()}.",
            "",
            *tabulate((*titles, *times), table, words=2),
            "",
        ]
    )


if __name__ == "__main__":
    main()
