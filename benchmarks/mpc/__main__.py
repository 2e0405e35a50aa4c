"""Measure: `python -m benchmarks.mpc`; a table to the terminal, and with `-o` a page.

Each solver starts cold, at rest, and then warm: from its own solution, a step ahead, at the state that the first
acceleration leads to. Its options are searched for each start. All must find the same optimum.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path

import numpy as np

from benchmarks.mpc import acados_peer, casadi_peers, own
from benchmarks.mpc.acados_peer import AcadosPeer, Session, is_installed
from benchmarks.mpc.casadi_peers import MODEL, REFERENCE, CasadiPeer, load_torque
from benchmarks.mpc.contest import Choice, Row, Start, choose, compete
from benchmarks.mpc.own import OwnRunner
from benchmarks.mpc.page import FAR, Horizon, RealTime, write_page
from benchmarks.mpc.problem import JOINTS, Iterate, Latency, Runner, Task, rest

HORIZONS = (20, 100)
NEAR = 1e-3  # the cost of a way in real time may be larger than the project's by this part
BRIEF = 100  # steps in real time, in the search for options
TURNS = 3  # rounds in real time

Runners = Mapping[str, Sequence[Runner]]


def make_runners(task: Task, session: Session | None) -> Runners:
    """Make all solvers for a task, with all of their options; another one is another entry here."""
    first, torque = OwnRunner(task, MODEL), load_torque()
    runners: dict[str, Sequence[Runner]] = {
        "mbs": [first, *(OwnRunner(task, MODEL, x, first) for x in list(own.list_settings())[1:])]
    }
    for name in ("fatrop", "ipopt"):
        runners[name] = [CasadiPeer(task, x, torque) for x in casadi_peers.list_settings(name)]
    if session is not None:
        runners["acados"] = [AcadosPeer(task, session, x) for x in acados_peer.list_settings(task.intervals)]
    return runners


def shift(task: Task, iterate: Iterate) -> Iterate:
    """Move an iterate one step ahead; the last acceleration is repeated."""
    last = task.A @ iterate.x[-1] + task.B @ iterate.a[-1]
    return Iterate(np.vstack([iterate.x[1:], last]), np.vstack([iterate.a[1:], iterate.a[-1:]]))


def solve_exactly(exact: CasadiPeer, state: np.ndarray, guess: Iterate) -> Iterate:
    """Return the optimum from a state. Raises RuntimeError where it is not found."""
    exact.prepare(state, guess, shifts=False)
    answer = exact.solve()
    if not answer.is_solved:
        raise RuntimeError(f"the reference ended with {answer.status}")
    return answer.iterate


def measure(task: Task, runners: Runners, rounds: int) -> tuple[list[Row], list[Row]]:
    """Solve cold and warm, with the best options of each solver, in turn."""
    exact = CasadiPeer(task, REFERENCE, load_torque())
    state, guess = np.concatenate([task.start, np.zeros(JOINTS)]), rest(task)
    start = Start(state, guess, solve_exactly(exact, state, guess))
    cold = compete(task, {name: choose(task, every, start) for name, every in runners.items()}, start, rounds)
    ahead = shift(task, start.exact)
    solved = solve_exactly(exact, ahead.x[0], ahead)
    choices: dict[str, Choice] = {}
    starts: dict[str, Start] = {}
    for row in cold:
        starts[row.name] = Start(ahead.x[0], shift(task, row.answer.iterate), solved, shifts=True)
        choices[row.name] = choose(task, runners[row.name], starts[row.name])
    return cold, compete(task, choices, starts, rounds)


def control(task: Task, runner: OwnRunner, session: Session | None, steps: int) -> list[RealTime]:
    """Move the robot in real time, in turn with acados by its best options."""
    makers: dict[str, tuple[str, Callable[[int], Latency]]] = {"mbs": (str(runner.settings), runner.control)}
    tried = {"mbs": 1}
    if session is not None:
        most = (1 + NEAR) * runner.control(BRIEF).cost(task)
        every = [AcadosPeer(task, session, x) for x in acados_peer.list_steps(task.intervals)]
        best = min(every, key=lambda peer: peer.try_control(BRIEF, most))
        makers["acados"] = (f"{best.settings}", best.control)
        tried["acados"] = len(every)
    ways: dict[str, list[Latency]] = {name: [] for name in makers}
    for _ in range(TURNS):
        for name, (_, move) in makers.items():
            ways[name].append(move(steps))
    return [RealTime(name, makers[name][0], tried[name], tuple(found)) for name, found in ways.items()]


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.mpc", description=__doc__)
    parser.add_argument("--horizon", action="append", type=int, default=[], help="intervals; by default 20 and 100")
    parser.add_argument("--rounds", type=int, default=11)
    parser.add_argument("--steps", type=int, default=1000, help="in real time; by default 1000")
    parser.add_argument("-o", "--output", type=Path, help="also write a page")
    given = parser.parse_args(arguments)
    os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    if not is_installed():
        print("acados is left out: python3 tests/acados.py build/acados installs it")
    horizons = []
    for intervals in given.horizon or HORIZONS:
        task = Task(intervals=intervals)
        with ExitStack() as stack:
            session = stack.enter_context(Session(task)) if is_installed() else None
            runners = make_runners(task, session)
            cold, warm = measure(task, runners, given.rounds)
            ways = control(task, OwnRunner(task, MODEL), session, given.steps)
        for row, again in zip(cold, warm, strict=True):
            print(f"N = {intervals:3}  {row.name:8} cold {describe(row)}; shifted {describe(again)}")
        for way in ways:
            parts = [
                f"{name} {1e6 * np.median(times):.0f} us, 99.9th percentile {1e6 * np.quantile(times, FAR):.0f} us"
                for name, times in (("preparation", way.prepare), ("feedback", way.feedback))
            ]
            print(f"N = {intervals:3}  {way.name:8} in real time: {', '.join(parts)}")
        horizons.append(Horizon(task, tuple(cold), tuple(warm), tuple(ways)))
    if given.output:
        given.output.write_text(write_page(horizons, given.rounds), "utf-8")
    return 0


def describe(row: Row) -> str:
    """Describe the effort of a solver."""
    effort = f"{row.answer.iterations} iterations, {1e3 * np.median(row.seconds):.2f} ms"
    return f"{effort}, {np.median(row.ratios):.2f} times, off by {row.error:.1e}"


if __name__ == "__main__":
    sys.exit(main())
