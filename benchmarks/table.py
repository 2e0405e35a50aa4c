"""Studies -> rows of figures and ratios, as tables for the terminal, as JSON, and as a chart.

A row compares a kernel with the best that each author has for the same function of the mechanism: the fewest
operations, and, apart from that, the shortest time. Times are those of the shortest round, and so are the ratios, which
other work on the machine disturbs least; medians over the rounds are kept beside them.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import matplotlib.figure
import numpy as np
from rich.table import Table

from benchmarks.candidates import AUTHORS, OURS
from benchmarks.study import Measurement, Study

# What a row is called, our kernel, and the functions that others may compute it by; SEMI is differentiated as the
# residual M qdd + c - Q.
ROWS: Mapping[str, tuple[str, tuple[str, ...]]] = {
    "IMPL": ("impl", ("impl",)),
    "SEMI": ("semi", ("semi",)),
    "EXP1": ("exp1", ("exp1",)),
    "EXP2": ("exp2", ("exp2",)),
    "Jacobian of IMPL": ("jac_impl", ("jac_impl",)),
    "Jacobian of SEMI": ("jac_semi_res", ("jac_semi_res",)),
    "Jacobian of EXP1": ("jac_exp1", ("jac_exp1", "jac_exp2")),
    "Jacobian of EXP2": ("jac_exp2", ("jac_exp1", "jac_exp2")),
    "Hessian of IMPL": ("jac_adj1_impl", ("jac_adj1_impl",)),
    "Hessian of SEMI": ("jac_adj1_semi_res", ("jac_adj1_semi_res",)),
    "Hessian of EXP1": ("jac_adj1_exp1", ("jac_adj1_exp1", "jac_adj1_exp2")),
    "Hessian of EXP2": ("jac_adj1_exp2", ("jac_adj1_exp1", "jac_adj1_exp2")),
}


@dataclass(frozen=True)
class Cell:
    """The best of one author for one row; None where nothing was counted, or timed."""

    flops: int | None
    flops_by: str | None
    ns: float | None  # of the quickest round
    ns_median: float | None
    ns_by: str | None
    flops_ratio: float | None  # by ours
    ns_ratio: float | None
    ns_ratio_median: float | None  # over the rounds, of the author's time by ours in the same round


@dataclass(frozen=True)
class Row:
    """One function of one mechanism, by every author."""

    title: str
    cells: Mapping[str, Cell]


def compare(study: Study) -> tuple[Row, ...]:
    """Compare a study's measurements, row by row; rows of kernels that were not measured are left out."""
    kernels = {m.candidate.function: m for m in study.measurements if m.candidate.author == OURS}
    rows = []
    for title, (kernel, functions) in ROWS.items():
        if kernel not in kernels:
            continue
        ours = kernels[kernel]
        cells = {OURS: _choose(ours, [ours])}
        for author in AUTHORS:
            found = [
                m for m in study.measurements if m.candidate.author == author and m.candidate.function in functions
            ]
            if author != OURS and found:
                cells[author] = _choose(ours, found)
        rows.append(Row(title, cells))
    return tuple(rows)


def _choose(ours: Measurement, found: Sequence[Measurement]) -> Cell:
    """Choose the fewest operations and the shortest time among one author's ways."""
    counted = [(m.candidate.flops, m.candidate.way) for m in found if m.candidate.flops is not None]
    timed = [(float(m.times.min()), m) for m in found if m.times is not None]
    flops, flops_by = min(counted, default=(None, None))
    ns, quickest = min(timed, key=lambda entry: entry[0], default=(None, None))
    times = None if quickest is None else quickest.times
    own = ours.candidate.flops
    return Cell(
        flops=flops,
        flops_by=flops_by,
        ns=ns,
        ns_median=None if times is None else float(np.median(times)),
        ns_by=None if quickest is None else quickest.candidate.way,
        flops_ratio=flops / own if flops and own else None,
        ns_ratio=None if times is None or ours.times is None else float(times.min() / ours.times.min()),
        ns_ratio_median=None if times is None or ours.times is None else float(np.median(times / ours.times)),
    )


def authors_of(rows: Iterable[Row]) -> tuple[str, ...]:
    """List who has a cell in any row, in the order of AUTHORS."""
    present = {author for row in rows for author in row.cells}
    return tuple(author for author in AUTHORS if author in present)


def make_tables(model: str, rows: Sequence[Row]) -> tuple[Table, Table]:
    """Lay out flops and times, each with ratios to ours."""
    return (
        _make_table(f"{model}: operations + - * / and roots", rows, "flops", "flops_ratio"),
        _make_table(f"{model}: nanoseconds per call", rows, "ns", "ns_ratio"),
    )


def _make_table(title: str, rows: Sequence[Row], figure: str, ratio: str) -> Table:
    authors = [a for a in authors_of(rows) if any(getattr(r.cells.get(a), figure, None) is not None for r in rows)]
    table = Table(title=title, title_justify="left")
    table.add_column("", no_wrap=True)
    for author in authors:
        table.add_column(author, justify="right")
    for row in rows:
        found = [row.cells.get(author) for author in authors]
        table.add_row(row.title, *(_write_cell(getattr(c, figure, None), getattr(c, ratio, None)) for c in found))
    return table


def _write_cell(value: float | None, ratio: float | None) -> str:
    """Write a figure over how many times ours it is; ours stands alone."""
    if value is None:
        return "–"
    if ratio is None or ratio == 1.0:
        return f"{value:.0f}"
    return f"{value:.0f} [{'green' if ratio > 1 else 'red'}]{ratio:#.3g}"


def write_markdown(comparisons: Mapping[str, Sequence[Row]], machine: str, rounds: int) -> str:
    """Write the tables for a page: each figure with how many times ours it is."""
    lines = [
        "# What was measured",
        "",
        f"{machine}; the shortest of {rounds} rounds. A figure in brackets tells how many times ours it is. Who is",
        "compared, and how, tells the [page of the benchmarks](../README.md).",
    ]
    for model, rows in comparisons.items():
        lines += [
            *_lay_out(f"{model}: operations + − × ÷ √", rows, "flops", "flops_ratio"),
            *_lay_out(f"{model}: nanoseconds per call", rows, "ns", "ns_ratio"),
        ]
    return "\n".join(lines) + "\n"


def _lay_out(title: str, rows: Sequence[Row], figure: str, ratio: str) -> list[str]:
    authors = [a for a in authors_of(rows) if any(getattr(r.cells.get(a), figure, None) is not None for r in rows)]

    def cell(found: Cell | None) -> str:
        value, times = getattr(found, figure, None), getattr(found, ratio, None)
        if value is None:
            return "–"
        return f"{value:.0f}" if times is None or times == 1.0 else f"{value:.0f} ({times:#.3g})"

    body = [f"| {row.title} | {' | '.join(cell(row.cells.get(a)) for a in authors)} |" for row in rows]
    return ["", f"## {title}", "", f"| | {' | '.join(authors)} |", "|---|" + "---:|" * len(authors), *body]


def write_json(comparisons: Mapping[str, Sequence[Row]], machine: str, rounds: int) -> str:
    """Write everything that the tables show, and the medians."""
    content = {
        "machine": machine,
        "rounds": rounds,
        "authors": dict(AUTHORS),
        "models": {
            model: {row.title: {author: asdict(cell) for author, cell in row.cells.items()} for row in rows}
            for model, rows in comparisons.items()
        },
    }
    return json.dumps(content, indent=2, ensure_ascii=False) + "\n"


def draw_chart(comparisons: Mapping[str, Sequence[Row]], path: Path) -> None:
    """Draw how many times longer than ours others take, a panel for each model."""
    figure = matplotlib.figure.Figure(figsize=(11, 0.8 + 3.4 * len(comparisons)), layout="constrained")
    axes = figure.subplots(len(comparisons), 1, squeeze=False)[:, 0]
    for ax, (model, rows) in zip(axes, comparisons.items(), strict=True):
        others = [author for author in authors_of(rows) if author != OURS]
        width = 0.8 / max(1, len(others))
        for k, author in enumerate(others):
            found = [(i, row.cells[author].ns_ratio) for i, row in enumerate(rows) if author in row.cells]
            bars = [(i, ratio) for i, ratio in found if ratio is not None]
            if not bars:
                continue
            ax.bar([i - 0.4 + (k + 0.5) * width for i, _ in bars], [r for _, r in bars], width, label=author)
        ax.axhline(1, color="black", linewidth=0.8)
        ax.set_yscale("log")
        ax.yaxis.set_major_formatter("{x:g}")
        ax.yaxis.set_minor_formatter("")
        ax.set_xlim(-0.6, len(rows) - 0.4)
        ax.set_xticks(range(len(rows)), [row.title.replace(" of ", "\nof ") for row in rows], fontsize=7)
        ax.set_ylabel("time by mbsgen's")
        ax.set_title(model)
        ax.legend(fontsize=8)
    figure.savefig(path, dpi=150)
