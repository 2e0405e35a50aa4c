"""Studies -> rows of figures and ratios, as tables for the terminal, as JSON, and as a chart.

A row compares a kernel with the best that each author has for the same function of the mechanism: the fewest
operations, and, independently, the shortest time. Times and ratios are of the shortest round, which other work on the
machine disturbs least; medians over the rounds stand beside them.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal

import matplotlib.figure
import numpy as np
from rich.table import Table

from benchmarks.candidates import AUTHORS, OURS, Sines
from benchmarks.study import Measurement, Study

# The title of a row, our kernel, and the functions that others may compute it by: SEMI is differentiated as the
# residual M qdd + c - Q, the residual of IMPL.
ROWS: Mapping[str, tuple[str, tuple[str, ...]]] = {
    "IMPL": ("impl", ("impl",)),
    "SEMI": ("semi", ("semi",)),
    "EXP1": ("exp1", ("exp1", "exp2")),
    "EXP2": ("exp2", ("exp1", "exp2")),
    "Jacobian of IMPL": ("jac_impl", ("jac_impl", "jac_semi_res")),
    "Jacobian of SEMI": ("jac_semi_res", ("jac_impl", "jac_semi_res")),
    "Jacobian of EXP1": ("jac_exp1", ("jac_exp1", "jac_exp2")),
    "Jacobian of EXP2": ("jac_exp2", ("jac_exp1", "jac_exp2")),
    "Hessian of IMPL": ("jac_adj1_impl", ("jac_adj1_impl", "jac_adj1_semi_res")),
    "Hessian of SEMI": ("jac_adj1_semi_res", ("jac_adj1_impl", "jac_adj1_semi_res")),
    "Hessian of EXP1": ("jac_adj1_exp1", ("jac_adj1_exp1", "jac_adj1_exp2")),
    "Hessian of EXP2": ("jac_adj1_exp2", ("jac_adj1_exp1", "jac_adj1_exp2")),
}

Basis = Literal["as they come", "same header", "C library"]
# Whose sines ours has, and of which the quicker counts for a peer.
BASES: Mapping[Basis, tuple[Sines, tuple[Sines, ...]]] = {
    "same header": ("header", ("header", "libm")),
    "C library": ("libm", ("libm",)),
    "as they come": ("header", ("libm",)),
}
EXPLAINED: Mapping[Basis, str] = {
    "same header": "all have the sine and cosine of the generated kernels (csrc/mbs_sincos.h)",
    "C library": "all use the C library, ours too (-DMBS_LIBM)",
    "as they come": "ours have their own, the others use the C library",
}


@dataclass(frozen=True)
class Timed:
    """The shortest time of one author for one row with one kind of sines."""

    ns: float  # of the quickest round
    ns_median: float
    way: str


@dataclass(frozen=True)
class Cell:
    """The best of one author for one row."""

    flops: int | None  # None: not counted
    flops_by: str | None
    flops_ratio: float | None  # by ours
    guards: int
    timed: Mapping[Sines, Timed]  # nothing where it was counted only


@dataclass(frozen=True)
class Quickest:
    """The quickest peer of a row, beside ours."""

    author: str
    way: str
    sines: Sines
    ns_ours: float
    ns: float
    ratio: float  # of the quickest rounds
    ratio_median: float  # over the rounds, of times in the same round


@dataclass(frozen=True)
class Row:
    """One function of one mechanism, by every author."""

    title: str
    cells: Mapping[str, Cell]
    quickest: Mapping[Basis, Quickest]  # nothing where no peer was timed


def compare(study: Study) -> tuple[Row, ...]:
    """Compare a study's measurements, row by row; rows of kernels that were not measured are left out."""
    rows = []
    for title, (kernel, functions) in ROWS.items():
        ours = [m for m in study.measurements if m.candidate.author == OURS and m.candidate.function == kernel]
        if not ours:
            continue
        cells, peers = {OURS: _choose(ours, ours)}, []
        for author in AUTHORS:
            found = [
                m for m in study.measurements if m.candidate.author == author and m.candidate.function in functions
            ]
            if author != OURS and found:
                cells[author] = _choose(ours, found)
                peers += found
        rows.append(Row(title, cells, {basis: q for basis in BASES if (q := find_quickest(basis, ours, peers))}))
    return tuple(rows)


def _choose(ours: Sequence[Measurement], found: Sequence[Measurement]) -> Cell:
    """Choose the fewest operations and the shortest time among one author's ways."""
    counted = [(m.candidate.flops, m.candidate.way) for m in found if m.candidate.flops is not None]
    flops, flops_by = min(counted, default=(None, None))
    own = ours[0].candidate.flops
    timed: dict[Sines, Timed] = {}
    for m in sorted((m for m in found if m.times is not None), key=_shortest, reverse=True):  # the last one stays
        assert m.times is not None
        timed[m.candidate.sines] = Timed(_shortest(m), float(np.median(m.times)), m.candidate.way)
    return Cell(flops, flops_by, flops / own if flops and own else None, found[0].candidate.guards, timed)


def find_quickest(basis: Basis, ours: Sequence[Measurement], peers: Sequence[Measurement]) -> Quickest | None:
    """Compare ours with the quickest peer; None where either was not timed."""
    own, allowed = BASES[basis]
    mine = [m for m in ours if m.times is not None and m.candidate.sines == own]
    theirs = [m for m in peers if m.times is not None and m.candidate.sines in allowed]
    if not mine or not theirs:
        return None
    best, peer = min(mine, key=_shortest), min(theirs, key=_shortest)
    assert best.times is not None
    assert peer.times is not None
    return Quickest(
        peer.candidate.author,
        peer.candidate.way,
        peer.candidate.sines,
        _shortest(best),
        _shortest(peer),
        _shortest(peer) / _shortest(best),
        float(np.median(peer.times / best.times)),
    )


def _shortest(measurement: Measurement) -> float:
    assert measurement.times is not None
    return float(measurement.times.min())


def authors_of(rows: Iterable[Row]) -> tuple[str, ...]:
    """List who has a cell in any row, in the order of AUTHORS."""
    present = {author for row in rows for author in row.cells}
    return tuple(author for author in AUTHORS if author in present)


@dataclass(frozen=True)
class _Layout:
    """A table as text."""

    title: str
    columns: tuple[str, ...]
    lines: tuple[tuple[str, ...], ...]


def _lay_out(model: str, rows: Sequence[Row]) -> Iterator[_Layout]:
    """Lay out operations, times, and how many times ours the quickest peer takes."""
    counted = tuple(a for a in authors_of(rows) if any((c := r.cells.get(a)) and c.flops is not None for r in rows))
    yield _Layout(
        f"{model}: operations + − × ÷ √, numbers folded, masses lumped",
        counted,
        tuple((row.title, *(_write_flops(row.cells.get(author)) for author in counted)) for row in rows),
    )
    timed: list[tuple[str, Sines]] = [
        (author, sines)
        for author in authors_of(rows)
        for sines in (("header", "libm") if author == OURS else ("libm", "header"))
        if any((cell := row.cells.get(author)) and sines in cell.timed for row in rows)
    ]
    yield _Layout(
        f"{model}: nanoseconds per call",
        tuple(f"{author}{_mark(author, sines)}" for author, sines in timed),
        tuple((row.title, *(_write_time(row.cells.get(author), sines) for author, sines in timed)) for row in rows),
    )
    if any(row.quickest for row in rows):
        yield _Layout(
            f"{model}: times of the quickest peer by ours",
            (*BASES, "quickest peer"),
            tuple(
                (row.title, *(_write_ratio(row.quickest.get(basis)) for basis in BASES), _write_names(row.quickest))
                for row in rows
            ),
        )


def _mark(author: str, sines: Sines) -> str:
    if author == OURS:
        return "" if sines == "header" else ", libm"
    return "" if sines == "libm" else ", our header"


def _write_flops(cell: Cell | None) -> str:
    if cell is None or cell.flops is None:
        return "–"
    ratio = cell.flops_ratio
    if cell.guards:
        return f"{cell.flops} + {cell.guards}"
    return f"{cell.flops}" if ratio is None or ratio == 1.0 else f"{cell.flops} ({ratio:#.3g})"


def _write_time(cell: Cell | None, sines: Sines) -> str:
    if cell is None or sines not in cell.timed:
        return "–"
    found = cell.timed[sines]
    return f"{found.ns:.0f} · {found.ns_median:.0f}"


def _write_ratio(found: Quickest | None) -> str:
    return "–" if found is None else f"{found.ratio:#.3g} · {found.ratio_median:#.3g}"


def _write_names(found: Mapping[Basis, Quickest]) -> str:
    return "; ".join(dict.fromkeys(quickest.author for quickest in found.values())) or "–"


def make_tables(model: str, rows: Sequence[Row]) -> Iterator[Table]:
    """Lay out operations, times and ratios for a terminal."""
    for layout in _lay_out(model, rows):
        table = Table(title=layout.title, title_justify="left")
        table.add_column("", no_wrap=True)
        for column in layout.columns:
            table.add_column(column, justify="right")
        for line in layout.lines:
            table.add_row(*line)
        yield table


@dataclass(frozen=True)
class Run:
    """The results of a run, and its machine."""

    machine: str
    flags: str
    rounds: int
    comparisons: Mapping[str, Sequence[Row]]


def write_markdown(run: Run) -> str:
    """Write the tables for a page."""
    lines = [
        "# Kernels: what was measured",
        "",
        f"{run.machine}; C with `{run.flags}`; {run.rounds} rounds.",
        "",
        "Times are of the shortest round, then the median over the rounds: 39 · 41. Operations in brackets are",
        "relative to ours; 436 + 6 are 436 operations, and 6 of guards: tests that pivots stand out of rounding, which",
        "others do not have. The [page of the benchmarks](../README.md) describes who is compared, and how.",
        "",
        "All numbers of the models are folded into the code, for everybody. So operations are of folded kernels,",
        "with masses lumped; kernels with parameters at run time take more of them.",
        "",
        "One thing differs: the other authors' C calls the C library for each sine and cosine, ours computes all of a",
        "kernel together in vectors. So the ratios to the quickest peer stand there three times:",
        "",
        *(f"- {basis}: {text}" for basis, text in EXPLAINED.items()),
        "",
        "With the same header, a peer's angles are computed together, too, and its quicker time counts, be it with the",
        "header or with the C library. Pinocchio in C++ asks for one angle at a time. CasADi's functions of more than",
        "5,000 operations have the C library's alone: there sines take less than 2 % of the time.",
    ]
    for model, rows in run.comparisons.items():
        for layout in _lay_out(model, rows):
            lines += ["", f"## {layout.title}", "", f"| | {' | '.join(layout.columns)} |"]
            lines += ["|---|" + "---:|" * len(layout.columns)]
            lines += [f"| {' | '.join(line)} |" for line in layout.lines]
    return "\n".join(lines) + "\n"


def write_json(run: Run) -> str:
    """Return everything that the tables show, as JSON."""
    content = {
        "machine": run.machine,
        "flags": run.flags,
        "rounds": run.rounds,
        "authors": dict(AUTHORS),
        "models": {
            model: {row.title: {key: value for key, value in asdict(row).items() if key != "title"} for row in rows}
            for model, rows in run.comparisons.items()
        },
    }
    return json.dumps(content, indent=1, ensure_ascii=False) + "\n"


def draw_chart(comparisons: Mapping[str, Sequence[Row]], path: Path) -> None:
    """Draw how many times longer than ours others take at their best with the same sines, a panel for each model."""
    figure = matplotlib.figure.Figure(figsize=(11, 0.8 + 3.4 * len(comparisons)), layout="constrained")
    axes = figure.subplots(len(comparisons), 1, squeeze=False)[:, 0]
    for ax, (model, rows) in zip(axes, comparisons.items(), strict=True):
        others = [author for author in authors_of(rows) if author != OURS]
        width = 0.8 / max(1, len(others))
        for k, author in enumerate(others):
            bars = [(i, ratio) for i, row in enumerate(rows) if (ratio := _compare_author(row, author)) is not None]
            if bars:
                places = [i - 0.4 + (k + 0.5) * width for i, _ in bars]
                ax.bar(places, [ratio for _, ratio in bars], width, label=author)
        ax.axhline(1, color="black", linewidth=0.8)
        ax.set_yscale("log")
        ax.yaxis.set_major_formatter("{x:g}")
        ax.yaxis.set_minor_formatter("")
        ax.set_xlim(-0.6, len(rows) - 0.4)
        ax.set_xticks(range(len(rows)), [row.title.replace(" of ", "\nof ") for row in rows], fontsize=7)
        ax.set_ylabel("time by mbsgen's, same sine and cosine")
        ax.set_title(model)
        ax.legend(fontsize=8)
    figure.savefig(path, dpi=150)


def _compare_author(row: Row, author: str) -> float | None:
    """Return how many times ours an author takes at its best; None where it was not timed."""
    ours, theirs = row.cells[OURS].timed.get("header"), row.cells.get(author)
    if ours is None or theirs is None or not theirs.timed:
        return None
    return min(found.ns for found in theirs.timed.values()) / ours.ns
