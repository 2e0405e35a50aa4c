"""Rows of problems -> a table for the terminal, and a page."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from rich.table import Table

from benchmarks.classics.peers import SETTINGS
from benchmarks.legged.measuring import LIMIT, Effort, Row

COLUMNS = (
    "problem",
    "phases",
    "freedoms",
    "variables",
    "cost",
    "plain CasADi's",
    "iterations",
    "ours, s",
    "functions, s",
    "expanded, s",
    "graph, s",
    "ratio",
    "ratio, graph",
    "of an iteration",
    "expanded by",
    "graph by",
)
CHECKS = ("problem", "momentum at impacts", "slip, m", "defect of an interval")
_TEXT = """\
# Motions in phases

`python -m benchmarks.legged` solves the problems of [models/legged](../../models/legged): by this project's own method
for [stages](../../docs/solver.md), and written in plain CasADi, with IPOPT and MUMPS, on the same mesh, from the same
guess, to the same tolerance. The equations of the plain programs are a [recursion](../legged/chains.py) that shares
nothing with the generator.
Measured on: {machine}.

Times are of the processor, of the quickest solve ({rounds} of each), without what is done once: reading, code,
derivatives, tables. "expanded" is one SX program; "graph" is MX, as `Opti` makes it. Ratios are of their times to ours,
and then of the quicker one's time of an iteration to ours. Plain programs are tried with each of {settings},
and stopped after {limit:.0f} s; the last columns name the quickest options that solve them, or else the first.

{table}
The checks use the recursion as well. The balance of momentum is M (v+ - v-) - J' L, relative to the largest impulse.
Standing feet are held by their places at mesh points, where the slip is taken, and by their velocities between. The
defect is the largest difference at the end of an interval that a tight integrator finds [rad, m, and these per s].

{checks}"""


def lay_out(rows: Sequence[Row]) -> Iterator[tuple[str, ...]]:
    """Write each row's figures."""
    for row in rows:
        ours = row.ours
        yield (
            row.name,
            str(row.phases),
            str(row.freedoms),
            str(row.variables),
            f"{ours.cost:.9g}",
            f"{row.expanded.cost:.9g}" if row.expanded.is_solved else "unsolved",
            f"{ours.iterations}, {row.expanded.iterations}, {row.graph.iterations}",
            f"{ours.seconds:.3f}",
            f"{ours.evaluating or 0.0:.3f}",
            _write_time(row.expanded),
            _write_time(row.graph),
            _write_ratio(row.expanded, ours),
            _write_ratio(row.graph, ours),
            f"{min(row.expanded.each, row.graph.each) / ours.each:.1f}",
            row.expanded.setting,
            row.graph.setting,
        )


def _write_time(effort: Effort) -> str:
    return f"{'' if effort.is_solved else '> '}{effort.seconds:.3f}"


def _write_ratio(effort: Effort, ours: Effort) -> str:
    return f"{'' if effort.is_solved else '> '}{effort.seconds / ours.seconds:.1f}"


def lay_out_checks(rows: Sequence[Row]) -> Iterator[tuple[str, ...]]:
    """Write the checks of each row."""
    for row in rows:
        momentum = "" if row.momentum is None else f"{row.momentum:.1e}"
        yield (row.name, momentum, f"{row.slip:.1e}", f"{row.defect:.1e}")


def make_tables(rows: Sequence[Row]) -> Iterator[Table]:
    """Make the tables for the terminal."""
    for columns, lines in ((COLUMNS, lay_out(rows)), (CHECKS, lay_out_checks(rows))):
        table = Table(*columns)
        for line in lines:
            table.add_row(*line)
        yield table


def write_page(rows: Sequence[Row], machine: str, rounds: int) -> str:
    """Write the page."""
    tables = [_write(*part) for part in ((COLUMNS, lay_out(rows)), (CHECKS, lay_out_checks(rows)))]
    settings = "; ".join(SETTINGS)
    return _TEXT.format(
        machine=machine, rounds=rounds, limit=LIMIT, settings=settings, table=tables[0], checks=tables[1]
    )


def _write(columns: Sequence[str], lines: Iterator[tuple[str, ...]]) -> str:
    parts = [columns, ("---", *("---:" for _ in columns[1:])), *lines]
    return "".join(f"| {' | '.join(part)} |\n" for part in parts)
