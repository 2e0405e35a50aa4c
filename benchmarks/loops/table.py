"""Rows of kernels and diagrams of motions -> tables for the terminal, a page, and JSON."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace

from rich.table import Table

from benchmarks.candidates import OURS
from benchmarks.loops.kernels import TOLERANCE, Row, Timed
from benchmarks.loops.motions import EXUDYN, LEVELS, Diagram, Point
from benchmarks.loops.peers import MUJOCO, PINOCCHIO, SIMTK

TITLES = {"exp": "accelerations", "jac_exp": "accelerations and their Jacobian"}
_TEXT = """\
Times of kernels are of the shortest of {rounds} rounds, then the median: 99 · 111. Our kernels have all numbers of a
model folded in; the peers read theirs at run time. Laws of joints, rotors and wrenches are left out; forces are inputs.
A peer agrees if its results differ by at most {tolerance:.0e}, relative. Jacobians are compared along the directions in
which loops stay closed: beyond these they depend on how a program writes its equations. Peers have the sine and cosine
of the C library; "libm" is ours with that.

- Pinocchio: `constraintDynamics` in C++, and `computeConstraintDynamicsDerivatives` after it. It has no hinge for
  loops. A hinge in a plane is a 3-D point there, of which one equation is redundant; one in space is two points. Its
  direct method (mu = 0) fails on redundant equations; the proximal one takes two or three rounds. Its Jacobian
  disagrees for most loops between two moving bodies (version 4.1). On Andrews' mechanism, differences of its
  accelerations agree with our Jacobian to 1e-10; its Jacobian does not. Its time is shown all the same.
- Simbody: articulated bodies; a rank-revealing factorisation at each call. No derivatives.
- MuJoCo: its loops are soft, so it computes something else; it is never the quickest peer of a kernel.
- Exudyn has no kernels to call; it is compared by motions.

Motions: milliseconds of the processor of the quickest setting that reaches an error, shortest and median of {repeats}
runs. The error is the largest of |x - x*| / (1 + |x*|) over coordinates and velocities at the end; x* has 17 digits or
more (`python -m tests.loop_references`). Our integrators and Simbody's keep loops closed. Pinocchio has no
integrator and gets DOP853 in C++, without projection. Exudyn's methods are of second order. In the governor, the peers
have springs where we have loops through struts of 1 mg. Settings finer than the first that takes 1 s are not tried.
"""
AUTHORS = (OURS, PINOCCHIO, SIMTK, EXUDYN, MUJOCO)


@dataclass(frozen=True)
class Results:
    """Everything that was measured."""

    machine: str
    flags: str
    rounds: int
    repeats: int
    rows: tuple[Row, ...]
    diagrams: tuple[Diagram, ...]

    def add_rows(self, rows: Sequence[Row]) -> Results:
        """Return the results with further rows."""
        return replace(self, rows=(*self.rows, *rows))

    def add_diagrams(self, diagrams: Sequence[Diagram]) -> Results:
        """Return the results with further diagrams."""
        return replace(self, diagrams=(*self.diagrams, *diagrams))


@dataclass(frozen=True)
class _Layout:
    title: str
    columns: tuple[str, ...]
    lines: tuple[tuple[str, ...], ...]


def _lay_out(results: Results) -> Iterator[_Layout]:
    if results.rows:
        columns = ("joints, equations", "function", "operations", "ns", "ns, libm", "quickest peer", "ns")
        ratios = ("by ours", "by ours, libm")
        yield _Layout("kernels", (*columns, *ratios), tuple(_write_row(row) for row in results.rows))
        yield _Layout("peers: ns, difference", ("function", "peers"), tuple(_write_peers(row) for row in results.rows))
    for diagram in results.diagrams:
        levels = tuple(_write_level(diagram, level) for level in LEVELS)
        authors = (*AUTHORS, "quickest peer by ours")
        yield _Layout(f"{diagram.title}: ms of the processor for an error", authors, levels)


def _write_row(row: Row) -> tuple[str, ...]:
    own, libm, quickest = row.best(libm=False), row.best(libm=True), row.quickest
    ratios = (row.compare(libm=False), row.compare(libm=True))
    return (
        row.mechanism,
        f"{row.joints}, {row.equations}",
        TITLES[row.function],
        f"{own.way} {own.flops}",
        f"{own.ns:.0f} · {own.ns_median:.0f}",
        f"{libm.ns:.0f} · {libm.ns_median:.0f}",
        "–" if quickest is None else quickest.way + ("" if quickest.agrees else ", disagrees"),
        "–" if quickest is None else f"{quickest.ns:.0f} · {quickest.ns_median:.0f}",
        *("–" if pair is None else _write_pair(*pair) for pair in ratios),
    )


def _write_peers(row: Row) -> tuple[str, ...]:
    listed = "; ".join([*map(_write_peer, row.peers), *row.failures])
    return row.mechanism, TITLES[row.function], listed or "none"


def _write_peer(timed: Timed) -> str:
    return f"{timed.way} {timed.ns:.0f} · {timed.ns_median:.0f}, {timed.difference:.0e}"


def _write_level(diagram: Diagram, level: float) -> tuple[str, ...]:
    best = {author: diagram.find_best(author, level) for author in AUTHORS}
    own = best[OURS]
    peers = [point for author, point in best.items() if author != OURS and point is not None]
    quickest = min(peers, key=lambda x: x.seconds, default=None)
    ratio = "–"
    if own is not None and quickest is not None:
        ratio = _write_pair(quickest.seconds / own.seconds, quickest.seconds_median / own.seconds_median)
    return (f"{level:.0e}", *(_write_point(best[author]) for author in AUTHORS), ratio)


def _write_point(point: Point | None) -> str:
    if point is None:
        return "–"
    return f"{_write_pair(1e3 * point.seconds, 1e3 * point.seconds_median)} ({point.method})"


def _write_pair(*numbers: float) -> str:
    return " · ".join(f"{x:.0f}" if x >= 100 else f"{x:#.3g}" for x in numbers)


def make_tables(results: Results) -> Iterator[Table]:
    """Return the tables for a terminal."""
    for layout in _lay_out(results):
        table = Table(title=layout.title, title_justify="left")
        for column in ("", *layout.columns):
            table.add_column(column)
        for line in layout.lines:
            table.add_row(*line)
        yield table


def write_markdown(results: Results) -> str:
    """Write the tables as a page."""
    lines = [
        "# Closed loops",
        "",
        f"{results.machine}; C with `{results.flags}`. {_write_load(results)}",
        "",
        *_TEXT.format(rounds=results.rounds, repeats=results.repeats, tolerance=TOLERANCE).splitlines(),
    ]
    for layout in _lay_out(results):
        lines += ["", f"## {layout.title[0].upper()}{layout.title[1:]}", "", f"| | {' | '.join(layout.columns)} |"]
        lines += ["|---|" + "---|" * len(layout.columns)]
        lines += [f"| {' | '.join(line)} |" for line in layout.lines]
    return "\n".join(lines) + "\n"


def _write_load(results: Results) -> str:
    loads = [x for row in results.rows for x in row.load] + [x for found in results.diagrams for x in found.load]
    return f"Load of the machine meanwhile: {min(loads):.1f} to {max(loads):.1f}." if loads else ""


def write_json(results: Results) -> str:
    """Return everything that the tables show, as JSON."""
    return json.dumps(asdict(results), indent=1, ensure_ascii=False) + "\n"
