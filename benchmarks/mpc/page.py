"""The figures of predictive control as a page in Markdown."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.compilation import describe_machine
from benchmarks.mpc.contest import ACCURATE, Row
from benchmarks.mpc.problem import Array, Latency, Task

COLUMNS = (
    "N",
    "solver",
    "cold: iterations, ms",
    "by ours, cold",
    "shifted: iterations, ms",
    "by ours",
    "ms an iteration",
    "error",
)
FAR = 0.999  # the quantile for late steps


@dataclass(frozen=True)
class RealTime:
    """A solver's steps in real time, in several rounds."""

    name: str
    settings: str
    tried: int
    rounds: tuple[Latency, ...]

    @property
    def prepare(self) -> Array:
        """Return the times of preparation, of all rounds."""
        return np.concatenate([x.prepare for x in self.rounds])

    @property
    def feedback(self) -> Array:
        """Return the times of feedback, of all rounds."""
        return np.concatenate([x.feedback for x in self.rounds])


@dataclass(frozen=True)
class Horizon:
    """All solvers on one horizon, the project's first."""

    task: Task
    cold: tuple[Row, ...]
    warm: tuple[Row, ...]
    ways: tuple[RealTime, ...]


TIMES = """\
`python -m benchmarks.mpc -o FILE` wrote this page: {machine}, one core. [The task](../mpc/problem.py) is the same for
all, and so are the kernels. The options of every solver are searched ([below](#options)). The quickest ones whose error
is at most {accurate:g} are taken: the largest error of a state or acceleration, as a part of the range of its bounds. A
shifted solve starts from the solver's own solution of the step before. Times are medians of processor time over
{rounds} rounds, in which all solve in turn; ratios are medians over the rounds.
"""
UNEQUAL = """\
Not equal: fatrop's and IPOPT's functions run in CasADi's virtual machine, so their times are longer than they need be,
and CasADi gives fatrop no multipliers to start from. acados takes the Hessian of Gauss and Newton, without curvature of
the torques, and full steps; the project's solver has exact derivatives, and a search along each step. acados is a
wheel, with BLASFEO compiled for Haswell; the project's C is compiled for the machine that measures.
"""
STEPS = """\
A step has two parts: preparation before the state is measured, and feedback after it. Times are medians in µs, and
beside them the 99.9th percentile by the median. A loop that does nothing for as long as feedback takes shows how late
the machine itself is. The project's step is one step of Newton's method for a barrier parameter that stays. acados
solves a quadratic program to the end in its feedback (its real-time iteration); its plan is moved ahead, its phase is
set and its state is given outside of these times. So the way's cost is printed, too.
"""
OPTIONS = """\
For each solver and start: how many options were tried, how many of them were accurate, the time of the solver's
defaults where they are, and the options that were taken.
"""
PARTS = ("preparation", "99.9th by median", "feedback", "99.9th of feedback by median", "of an empty loop")


def write_page(horizons: Sequence[Horizon], rounds: int) -> str:
    """Write three tables: whole solves, steps in real time, options."""
    lines = [
        "# Predictive control of a Panda",
        "",
        TIMES.format(machine=describe_machine(), accurate=ACCURATE, rounds=rounds),
        *_table(COLUMNS, (cells for horizon in horizons for cells in _write_rows(horizon))),
        "",
        UNEQUAL,
        "## In real time",
        "",
        STEPS,
        *_table(
            ("N", "solver", "steps", *PARTS, "both", "rad off", "cost of the way"),
            (cells for horizon in horizons for cells in _write_ways(horizon)),
        ),
        "",
        "## Options",
        "",
        OPTIONS,
        *_table(
            ("N", "solver", "start", "tried", "accurate", "defaults, ms", "best, ms", "options"),
            (cells for horizon in horizons for cells in _write_options(horizon)),
        ),
        "",
    ]
    return "\n".join(lines)


def _table(columns: Sequence[str], rows: Iterator[Sequence[str]]) -> list[str]:
    words = ("solver", "start", "options")
    rules = ["---" if name in words else "---:" for name in columns]
    return [f"| {' | '.join(columns)} |", f"|{'|'.join(rules)}|", *(f"| {' | '.join(cells)} |" for cells in rows)]


def _write_rows(horizon: Horizon) -> Iterator[list[str]]:
    for cold, warm in zip(horizon.cold, horizon.warm, strict=True):
        middle = float(np.median(warm.seconds))
        yield [
            str(horizon.task.intervals),
            cold.name,
            f"{cold.answer.iterations}, {1e3 * np.median(cold.seconds):.2f}",
            f"{np.median(cold.ratios):.1f}",
            f"{warm.answer.iterations}, {1e3 * middle:.2f}",
            f"{np.median(warm.ratios):.1f}",
            f"{1e3 * middle / max(warm.answer.iterations, 1):.2f}",
            f"{max(cold.error, warm.error):.0e}",
        ]


def _write_ways(horizon: Horizon) -> Iterator[list[str]]:
    for way in horizon.ways:
        both = float(np.median(way.prepare)) + float(np.median(way.feedback))
        idle = np.concatenate([x.idle for x in way.rounds])
        last = way.rounds[-1]
        yield [
            str(horizon.task.intervals),
            way.name,
            str(len(way.feedback)),
            *_describe(way.prepare),
            *_describe(way.feedback),
            _describe(idle)[1],
            f"{1e6 * both:.0f}",
            f"{last.gap(horizon.task):.2g}",
            f"{last.cost(horizon.task):.6g}",
        ]


def _write_options(horizon: Horizon) -> Iterator[list[str]]:
    for name, rows in (("cold", horizon.cold), ("shifted", horizon.warm)):
        for row in rows:
            found = row.choice
            first = "–" if np.isnan(found.first) else f"{1e3 * found.first:.2f}"
            counts = (str(found.tried), str(found.accurate), first, f"{1e3 * found.best:.2f}")
            yield [str(horizon.task.intervals), row.name, name, *counts, str(found.runner.settings)]
    for way in horizon.ways:
        yield [str(horizon.task.intervals), way.name, "in real time", str(way.tried), "–", "–", "–", way.settings]


def _describe(times: Array) -> tuple[str, str]:
    middle = float(np.median(times))
    return f"{1e6 * middle:.0f}", f"{float(np.quantile(times, FAR)) / middle:.2f}"
