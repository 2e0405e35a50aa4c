"""A search by a method, from a point: its progress, its times, its outcome."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from mbsrun.ocp import methods
from mbsrun.ocp.ground.functions import Array
from mbsrun.ocp.ground.status import SOLVED
from mbsrun.ocp.methods import Instance, Iterate
from mbsrun.ocp.solution.solution import Run
from mbsrun.ocp.solving.judging import Outcome

NUDGE = 1e-2  # relative, and absolute below 1: how far a guess is moved in which nothing could be improved


@dataclass(frozen=True)
class Progress:
    """The state of a search."""

    iteration: int
    cost: float
    violation: float  # of the constraints, the largest


Watch = Callable[[Progress], None]


def search(x: Array, call: Callable[[Array], Outcome]) -> Outcome:
    """Call a solver from x; where it finds nothing to improve there, call it again from points nearby."""
    outcome = call(x)
    if outcome.run.status == SOLVED and outcome.run.iterations == 0:
        nudge = NUDGE * np.maximum(np.abs(x), 1.0) * np.random.default_rng(0).uniform(-1.0, 1.0, x.size)
        outcome = call(x + nudge)
        if outcome.run.status == SOLVED:  # a saddle may be met again from one side, but not from the other
            outcome = call(x - nudge)
    return outcome


def call(solver: methods.Solver, start: Instance) -> Outcome:
    """Call a solver once, and measure its times, without the time to prepare it."""
    begin, cpu_begin = time.perf_counter(), time.process_time()
    answer = solver(start)
    seconds = time.perf_counter() - begin - answer.preparing
    cpu_seconds = time.process_time() - cpu_begin - answer.cpu_preparing
    run = Run(answer.status, answer.iterations, seconds, answer.evaluating, cpu_seconds, answer.cpu_evaluating)
    return Outcome(run, answer.x, answer.clash, answer.multipliers, start, answer.near)


def join(first: Run, last: Run) -> Run:
    """Return the last run, with the iterations and times of both."""
    return replace(
        last,
        iterations=first.iterations + last.iterations,
        seconds=first.seconds + last.seconds,
        seconds_evaluating=first.seconds_evaluating + last.seconds_evaluating,
        cpu_seconds=first.cpu_seconds + last.cpu_seconds,
        cpu_seconds_evaluating=first.cpu_seconds_evaluating + last.cpu_seconds_evaluating,
    )


def report(watch: Watch) -> Callable[[Iterate], None]:
    """Return a function that shows a watch every iterate."""
    return lambda iterate: watch(Progress(iterate.number, iterate.cost, iterate.violation))
