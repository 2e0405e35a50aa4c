"""Solve many problems of one kind: `python -m benchmarks.ocp.many -o FILE`; one by one, as cases, in C, and by IPOPT.

All start from their own guesses, on one core, to the default tolerance; solutions are neither re-simulated nor refined.
Cases are also solved from neighbours.
IPOPT has the same kernels and the project's linear solver, and solves a part of the problems: each K-th.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

import mbsrun
from benchmarks.compilation import describe_machine
from mbsrun.ocp.searching.study import Targets
from mbsrun.optimal.control import OptimalControl
from mbsrun.optimal.many import change

MODELS, OWN = Path(__file__).parents[2] / "models", Path(__file__).parents[1] / "models"
PART = 8  # problems that IPOPT solves, at most
AGREED = 1e-6  # relative difference of costs within which two optima are one

Values = Mapping[str, Sequence[Any]]
T = TypeVar("T")


@dataclass(frozen=True)
class Family:
    """A problem, and the values of its keys."""

    name: str
    problem: OptimalControl
    over: Values

    @property
    def count(self) -> int:
        """Count the problems."""
        return len(next(iter(self.over.values())))


@dataclass(frozen=True)
class Measured:
    """Processor times of a problem [ms] by each way, and how they ended."""

    family: str
    count: int
    solved: int
    variables: int
    iterations: float  # mean
    alone: float
    cases: float
    threads: float  # as cases in two threads, by the clock
    solver: float  # of these, in the solver in C
    ipopt: float
    agree: str  # of IPOPT's optima, how many are the same
    beside: float  # as cases, from neighbours
    inside: float  # of these, in the solver in C
    ratio: float  # of processor time one by one and from neighbours
    minima: str  # from neighbours: the same, lower and higher ones


def swing_ups(count: int) -> Family:
    """A cart-pole swings up to places from 0.5 to 1.5 m."""
    problem = mbsrun.read_problem(MODELS / "cart_pole_swing_up.ocp.yaml")
    assert isinstance(problem, OptimalControl), "it has no phases"
    return Family("cart-pole swing-ups", problem, {"end.pose.cart": np.linspace(0.5, 1.5, count).tolist()})


def flights(count: int) -> Family:
    """A quadrotor flies to random places, from rest to rest."""
    path = "(fz_rotors - 9.81)**2 + 100*(mx_rotors**2 + my_rotors**2 + mz_rotors**2)"
    axes = [f"frame.{axis}" for axis in ("x", "y", "z", "rz", "ry", "rx")]
    moment = {"range": [-1, 1], "guess": 0}
    problem = mbsrun.problem(
        Path(__file__).with_name("quadrotor.yaml"),
        horizon=2,
        intervals=30,
        degree=3,
        cost={"running": [{"expression": path, "weight": 1}]},
        wrenches={"rotors": {"force": [0, 0, {"range": [0, 25], "guess": 9.81}], "moment": [moment] * 3}},
        end={"pose": dict.fromkeys(axes, 0), "velocity": "zero"},
    )
    places = np.random.default_rng(0).uniform(-1.5, 1.5, (count, 3)).tolist()
    return Family(
        "quadrotor flights", problem, {"end.pose": [dict(zip(axes, place, strict=False)) for place in places]}
    )


def reaches(count: int) -> Family:
    """A Panda moves from its usual pose to random ones, from rest to rest, with least torque."""
    start = [0.0, -0.785398, 0.0, -2.356194, 0.0, 1.570796, 0.785398]
    names = [f"panda_joint{k}" for k in range(1, 8)]
    problem = mbsrun.problem(
        OWN / "panda.yaml",
        horizon=1,
        intervals=40,
        degree=3,
        start={"pose": dict(zip(names, start, strict=True))},
        end={"pose": dict(zip(names, start, strict=True)), "velocity": "zero"},
    )
    ends = np.array(start) + np.random.default_rng(1).uniform(-0.7, 0.7, (count, 7))
    return Family(
        "Panda's reaches", problem, {"end.pose": [dict(zip(names, end, strict=True)) for end in ends.tolist()]}
    )


def targets(count: int) -> Family:
    """The paper's arm moves to the targets of its study, or to each k-th of them."""
    problem = mbsrun.read_problem(MODELS / "arm_reach.ocp.yaml")
    assert isinstance(problem, OptimalControl), "it has no phases"
    azimuths, heights = np.linspace(-math.pi / 2, math.pi / 2, 21), np.linspace(-0.1, 0.1, 11)
    grid = Targets(0.63, tuple(azimuths.tolist()), tuple(heights.tolist()))
    sensor = problem.value.end.sensors[0][0]
    points = [dict(zip("xyz", grid.position(place), strict=True)) for place in grid.places]
    return Family("targets of the paper's arm", problem, {f"end.sensors.{sensor}": points[:: -(-len(points) // count)]})


def measure(family: Family) -> Measured:
    """Solve a family by all ways in turn."""
    problem, over = family.problem, family.over
    keys, rows = list(over), list(zip(*over.values(), strict=True))
    named = problem.family
    copies = [named.restate(change(named.name, named.data, dict(zip(keys, row, strict=True)))) for row in rows]
    copies[0].solve(check=False)  # fills all caches
    alone, one_by_one, _ = _time(lambda: [copy.solve(check=False) for copy in copies])
    beside, from_others, _ = _time(lambda: problem.solve_many(over, check=False, neighbours=True))
    found, as_cases, _ = _time(lambda: problem.solve_many(over, check=False))
    _, _, in_threads = _time(lambda: problem.solve_many(over, check=False, threads=2))
    changes = (beside.cost - found.cost) / np.abs(found.cost)
    minima = [np.abs(changes) <= AGREED, changes < -AGREED, changes > AGREED]
    assert [one.is_solved for one in alone] == found.is_solved.tolist(), "no result depends on the others"
    step = -(-family.count // PART)
    by_ipopt = problem.with_solver("ipopt").solve_many(
        {key: values[::step] for key, values in over.items()}, check=False
    )
    costs, others = found.cost[::step], by_ipopt.cost
    same = np.abs(costs - others) <= AGREED * np.abs(others)
    solved = [one for one in found if one.is_solved]
    runs = [one.solution.run for one in solved]
    of_ipopt = [one.solution.run.cpu_seconds for one in by_ipopt if one.is_solved]
    return Measured(
        family.name,
        family.count,
        len(solved),
        solved[0].solution.size.variables,
        float(np.mean([run.iterations for run in runs])),
        1e3 * one_by_one / family.count,
        1e3 * as_cases / family.count,
        1e3 * in_threads / family.count,
        1e3 * float(np.mean([run.cpu_seconds for run in runs])),
        1e3 * float(np.mean(of_ipopt)),
        f"{int(same.sum())} of {len(others)}",
        1e3 * from_others / family.count,
        1e3 * float(beside.cpu_seconds[beside.is_solved].mean()),
        one_by_one / from_others,
        " / ".join(str(int(part.sum())) for part in minima),
    )


def _time(work: Callable[[], T]) -> tuple[T, float, float]:
    """Return what work returns, its processor time, and its time by the clock [s]."""
    begin, cpu_begin = time.perf_counter(), time.process_time()
    found = work()
    return found, time.process_time() - cpu_begin, time.perf_counter() - begin


def write(rows: Sequence[Measured], machine: str, remark: str) -> str:
    """Write the page."""
    first = ["problems", "", "solved", "variables", "iterations"]
    times = ["one by one", "cases", "two threads", "solver", "neighbours", "solver", "times", "minima"]
    columns = [*first, *times, "IPOPT", "by ours", "by neighbours", "same optimum"]
    lines = [
        "# Many problems of one kind",
        "",
        f"`python -m benchmarks.ocp.many` wrote this page: {machine}.",
        "Times are processor times in ms a problem, without a re-simulation: one by one, as cases (`solve_many`), of",
        "these in the solver, and as cases from neighbours, of these in the last solve; with two threads, by the",
        "clock. `times` is the time one by one over the time from neighbours. `minima` counts costs that are the same,",
        "lower and higher from there. IPOPT has the same kernels and the project's linear solver, and solves",
        "some of the problems. Its time is the solver's, over ours in the solver (`by ours`), and over all of a case",
        "from neighbours (`by neighbours`); its optima are compared.",
        *([remark] if remark else []),
        "",
        f"| {' | '.join(columns)} |",
        "|---" + "|---:" * (len(columns) - 1) + "|",
    ]
    for row in rows:
        numbers = (row.alone, row.cases, row.threads, row.solver, row.beside, row.inside, row.ratio)
        shown = f"{' | '.join(f'{x:.3g}' for x in numbers)} | {row.minima} | {row.ipopt:.3g}"
        counts = f"{row.count} | {row.solved} | {row.variables} | {row.iterations:.0f}"
        faster = f"{row.ipopt / row.solver:.3g} | {row.ipopt / row.beside:.3g}"
        lines.append(f"| {row.family} | {counts} | {shown} | {faster} | {row.agree} |")
    lines += [
        "",
        "Without neighbours, each case is solved anew, so cases take as long as single solves, and their statements.",
        "From neighbours, a layer of cases is solved in one call of C and judged at once, and motions are read when",
        "somebody looks at them. Few cases are stated, as they differ in numbers alone. The rest of the time is the",
        "judge's, and the solver's iterations. Starts save few of these where many limits are active, as at the arm's",
        "inputs: the limits that bind change from target to target. Cases far apart, as the Panda's reaches in seven",
        "dimensions, find no neighbours.",
        "The solver computes with vectors within a problem, over stages and columns, and not over problems.",
    ]
    return "\n".join(lines) + "\n"


def main() -> None:
    """Measure all families."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="four problems of each kind")
    parser.add_argument("-o", type=Path, dest="out", help="the page to write; by default it is printed")
    parser.add_argument("--remark", default="", help="a sentence on the machine, such as its load")
    given = parser.parse_args()
    counts = (4,) * 4 if given.quick else (256, 256, 64, 231)
    kinds = (swing_ups, flights, reaches, targets)
    rows = [measure(make(count)) for make, count in zip(kinds, counts, strict=True)]
    page = write(rows, describe_machine(), given.remark)
    if given.out is None:
        print(page, end="")
    else:
        given.out.write_text(page, encoding="utf-8")


if __name__ == "__main__":
    main()
