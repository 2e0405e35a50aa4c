"""The figures of predictive control as a page in Markdown."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.compilation import describe_machine
from benchmarks.mpc.own import Latency
from benchmarks.mpc.problem import Answer, Array

COLUMNS = (
    "N",
    "solver",
    "cold: iterations, ms",
    "shifted: iterations, ms",
    "by ours",
    "ms an iteration",
    "by ours, each",
    "optimum",
)
FAR = 0.999  # the quantile for late steps


@dataclass(frozen=True)
class Row:
    """The effort of a solver for a task: the quickest of several rounds."""

    name: str
    intervals: int
    cold: Answer
    warm: Answer
    cost: float
    cost_warm: float


@dataclass(frozen=True)
class Horizon:
    """All solvers on one horizon, the project's first, and its steps in real time."""

    rows: tuple[Row, ...]
    latency: Latency


def write_page(horizons: Sequence[Horizon], rounds: int) -> str:
    """Write two tables: whole solves, and steps in real time."""
    lines = [
        "# Predictive control of a Panda",
        "",
        f"`python -m benchmarks.mpc -o FILE` wrote this page: {describe_machine()}; the quickest of {rounds} rounds,",
        "on one core. [The task](../mpc/problem.py) is the same for all, and so are the kernels and the optimum. A",
        "shifted solve starts from the solution of the step before. fatrop's and IPOPT's functions run in CasADi's",
        "virtual machine, so their times are longer than they need be; CasADi gives them no multipliers to start from.",
        "An iteration is of a shifted solve, its start included.",
        "",
        f"| {' | '.join(COLUMNS)} |",
        "|---:|---|---:|---:|---:|---:|---:|---:|",
    ]
    for horizon in horizons:
        ours = horizon.rows[0].warm
        lines += [_write_row(row, ours) for row in horizon.rows]
    lines += [
        "",
        "## In real time",
        "",
        "A step has two parts: preparation before the state is measured, and feedback after it. Times are",
        "medians in µs, and beside them the 99.9th percentile by the median. A loop that does nothing for as long as",
        "feedback takes shows how late the machine itself is.",
        "",
        "| N | steps | preparation | 99.9th by median | feedback | 99.9th by median | of an empty loop | rad off |",
        "|---:|---:|---:|---:|---:|---:|---:|---:|",
    ]
    lines += [_write_latency(horizon) for horizon in horizons]
    return "\n".join([*lines, ""])


def _each(answer: Answer) -> float:
    return answer.seconds / max(answer.iterations, 1)


def _write_row(row: Row, ours: Answer) -> str:
    effort = (f"{a.iterations}, {1e3 * a.seconds:.2f}" for a in (row.cold, row.warm))
    ratios = (row.warm.seconds / ours.seconds, _each(row.warm) / _each(ours))
    each = (f"{ratios[0]:.1f}", f"{1e3 * _each(row.warm):.2f}", f"{ratios[1]:.1f}")
    cells = (str(row.intervals), row.name, *effort, *each, f"{row.cost:.9g}")
    return f"| {' | '.join(cells)} |"


def _write_latency(horizon: Horizon) -> str:
    found = horizon.latency
    parts = [cell for times in (found.prepare, found.feedback) for cell in _describe(times)]
    parts.append(_describe(found.idle)[1])
    cells = (str(horizon.rows[0].intervals), str(len(found.feedback)), *parts, f"{found.gap:.2g}")
    return f"| {' | '.join(cells)} |"


def _describe(times: Array) -> tuple[str, str]:
    middle = float(np.median(times))
    return f"{1e6 * middle:.0f}", f"{float(np.quantile(times, FAR)) / middle:.2f}"
