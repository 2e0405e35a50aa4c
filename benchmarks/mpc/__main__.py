"""Measure: `python -m benchmarks.mpc`; a table to the terminal, and with `-o` a page.

Each solver starts cold, at rest, and then warm: from its own solution, shifted by a step, at the state that the first
acceleration leads to. All must find the same optimum.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from benchmarks.mpc.acados_peer import AcadosPeer, is_installed
from benchmarks.mpc.casadi_peers import MODEL, SETTINGS, CasadiPeer, load_torque
from benchmarks.mpc.own import Latency, OwnRunner
from benchmarks.mpc.page import FAR, Horizon, Row, write_page
from benchmarks.mpc.problem import JOINTS, Iterate, Runner, Task, rest

SAME = 1e-6  # relative difference of costs within which two optima are one
HORIZONS = (20, 100)


def make_runners(task: Task) -> Iterator[Runner]:
    """Make all solvers for a task; another one is another line here."""
    torque = load_torque()
    yield OwnRunner(task, MODEL)
    for name in SETTINGS:
        yield CasadiPeer(task, name, torque)
    if is_installed():
        yield AcadosPeer(task)
    else:
        print("acados is left out: python3 tests/acados.py build/acados installs it")


def shift(task: Task, iterate: Iterate) -> Iterate:
    """Move an iterate one step ahead; the last acceleration is repeated."""
    last = task.A @ iterate.x[-1] + task.B @ iterate.a[-1]
    return Iterate(np.vstack([iterate.x[1:], last]), np.vstack([iterate.a[1:], iterate.a[-1:]]))


def measure(task: Task, runner: Runner, rounds: int) -> Row:
    """Solve cold and warm, several times."""
    start = np.concatenate([task.start, np.zeros(JOINTS)])
    cold = runner.solve(start, rest(task), rounds)
    guess = shift(task, cold.iterate)
    warm = runner.solve(guess.x[0], guess, rounds)
    costs = [task.cost(answer.iterate.x, answer.iterate.a) for answer in (cold, warm)]
    return Row(runner.name, task.intervals, cold, warm, *costs)


def agree(rows: Sequence[Row]) -> bool:
    """Return whether all converged to one optimum, cold and warm."""
    first = rows[0]
    return all(
        row.cold.is_solved
        and row.warm.is_solved
        and abs(row.cost - first.cost) <= SAME * abs(first.cost)
        and abs(row.cost_warm - first.cost_warm) <= SAME * abs(first.cost_warm)
        for row in rows
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure and print; 1 where solvers disagree."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.mpc", description=__doc__)
    parser.add_argument("--horizon", action="append", type=int, default=[], help="intervals; by default 20 and 100")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--steps", type=int, default=1000, help="in real time; by default 1000")
    parser.add_argument("-o", "--output", type=Path, help="also write a page, if all agree")
    given = parser.parse_args(arguments)
    os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    is_one, horizons = True, []
    for intervals in given.horizon or HORIZONS:
        task = Task(intervals=intervals)
        rows = [measure(task, runner, given.rounds) for runner in make_runners(task)]
        is_one = is_one and agree(rows)
        for row in rows:
            cold, warm = (
                f"{answer.status} in {answer.iterations}, {1e3 * answer.seconds:.2f} ms"
                for answer in (row.cold, row.warm)
            )
            print(f"N = {intervals:3}  {row.name:8} cold {cold}; shifted {warm}; optimum {row.cost:.9g}")
        latency = OwnRunner(task, MODEL).control(given.steps)
        print(f"N = {intervals:3}  mbs      in real time: {describe(latency)}")
        horizons.append(Horizon(tuple(rows), latency))
    if given.output and is_one:
        given.output.write_text(write_page(horizons, given.rounds), "utf-8")
    return 0 if is_one else 1


def describe(found: Latency) -> str:
    """Describe times of real-time steps."""
    parts = (
        f"{name} {1e6 * np.median(times):.0f} us, 99.9th percentile {1e6 * np.quantile(times, FAR):.0f} us"
        for name, times in (("preparation", found.prepare), ("feedback", found.feedback))
    )
    return f"{', '.join(parts)}; joints end {found.gap:.2g} rad from the target"


if __name__ == "__main__":
    sys.exit(main())
