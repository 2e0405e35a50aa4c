"""Choose the options of each solver, and measure the chosen ones in turn.

A solver's options are a grid, which its module lists; all of them solve the task. The quickest of the accurate ones is
chosen. Chosen solvers then solve one after the other, round by round: another load of the machine meets all of them, so
the ratio to the first solver is taken round by round, and its median is printed.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from benchmarks.mpc.problem import Answer, Array, Iterate, Runner, Task

ACCURATE = 1e-4  # the largest error of a state or an acceleration that counts as accurate, of the range of its bounds
REPEATS = 3  # of a solve in the grid


@dataclass(frozen=True)
class Start:
    """A state of the robot, a guess, and the exact solution from there."""

    state: Array
    guess: Iterate
    exact: Iterate
    shifts: bool = False  # whether the guess is a solution before, a step ahead


@dataclass(frozen=True)
class Choice:
    """The quickest options of a solver, among all that were tried."""

    runner: Runner
    tried: int
    accurate: int
    first: float  # s: the time of the first options, the solver's defaults; NaN where they are not accurate
    best: float  # s


@dataclass(frozen=True)
class Row:
    """A solver with its chosen options, over the rounds."""

    name: str
    choice: Choice
    answer: Answer
    error: float
    cost: float
    seconds: Array = field(repr=False)  # by round
    ratios: Array = field(repr=False)  # to the first solver's time in the same round


def choose(task: Task, runners: Sequence[Runner], start: Start) -> Choice:
    """Try all options of a solver. Raises RuntimeError where none is accurate."""
    times = {k: found for k, runner in enumerate(runners) for found in _try(task, runner, start)}
    if not times:
        raise RuntimeError(f"{runners[0].name}: no options find the optimum to {ACCURATE}")
    best = min(times, key=lambda k: times[k])
    return Choice(runners[best], len(runners), len(times), times.get(0, np.nan), times[best])


def _try(task: Task, runner: Runner, start: Start) -> Iterator[float]:
    """Yield the time of a solver where it is accurate."""
    runner.prepare(start.state, start.guess, shifts=start.shifts)
    answers = [runner.solve() for _ in range(REPEATS)]
    if all(x.is_solved and task.measure_error(x.iterate, start.exact) <= ACCURATE for x in answers):
        yield min(x.seconds for x in answers)


def compete(task: Task, choices: Mapping[str, Choice], starts: Start | Mapping[str, Start], rounds: int) -> list[Row]:
    """Solve by the chosen solvers in turn, each from its start; others are compared with the first one."""
    own = dict.fromkeys(choices, starts) if isinstance(starts, Start) else starts
    for name, choice in choices.items():
        choice.runner.prepare(own[name].state, own[name].guess, shifts=own[name].shifts)
    answers = [[choice.runner.solve() for choice in choices.values()] for _ in range(rounds)]
    seconds = np.array([[x.seconds for x in row] for row in answers])
    return [
        Row(
            name,
            choice,
            answers[0][k],
            task.measure_error(answers[0][k].iterate, own[name].exact),
            task.cost(answers[0][k].iterate.x, answers[0][k].iterate.a),
            seconds[:, k],
            seconds[:, k] / seconds[:, 0],
        )
        for k, (name, choice) in enumerate(choices.items())
    ]
