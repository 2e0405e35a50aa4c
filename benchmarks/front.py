"""The pages in `benchmarks/results` -> three sentences and one chart, for a reader who has twenty seconds."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmarks.headlines import NONE, PageError, find_row, read_number, read_page, read_tables, write_times
from mbsgen.style import PALETTE, save_figure, styled

QUIET = "#9aa5b1"


@dataclass(frozen=True)
class Bar:
    """The ratios of a peer's time to ours for one kind of work: the least and the most that were measured."""

    work: str
    peer: str
    least: float
    most: float
    page: str

    @property
    def label(self) -> str:
        """Return the range in words."""
        least, most = write_times(self.least), write_times(self.most)
        return f"{least} times" if least == most else f"{least} to {most} times"


def _read_kernels(text: str) -> Iterator[Bar]:
    """Read ratios of kernels of trees, with the same sines on both sides, and of the arm's optimal motion."""
    rows, *_ = read_tables(text).values()
    robots = [row for row in rows if not row[""].startswith("optimal")]
    names = {"residual": "Torques of a motion", "accelerations": "Accelerations of robots"}
    names |= {"Jacobian of the residual": "Derivatives of the torques"}
    for column, work in names.items():
        ratios = sorted(read_number(row[column]) for row in robots if row[column] != NONE)
        yield Bar(work, "Pinocchio and CasADi", ratios[0], ratios[-1], "benchmarks.md")
    found = re.search(r"by stages [\d.]+ \(([\d.]+)\)", find_row(rows, "", "optimal")["Jacobian of the residual"])
    if found is None:
        raise PageError("no solve by stages")
    yield Bar(
        "Optimal motion of the paper's arm", "compiled CasADi with IPOPT", float(found[1]), float(found[1]), "ocp.md"
    )


def _read_loops(text: str) -> Iterator[Bar]:
    rows = [r for r in read_tables(text)["Kernels"] if r["function"] == "accelerations" and r["by ours, libm"] != NONE]
    ratios = sorted(read_number(row["by ours, libm"]) for row in rows)
    yield Bar("Accelerations, closed loops", "the quickest peer", ratios[0], ratios[-1], "loops.md")


def _read_ocp_loops(text: str) -> Iterator[Bar]:
    tables = read_tables(text)
    rows = [
        find_row(tables[name], "way", "CasADi, interpreted, tuned")
        for name in ("five_bar_reach.ocp.yaml", "delta_pick.ocp.yaml")
    ]
    ratios = sorted(read_number(row["ratio"]) for row in rows)
    yield Bar("Optimal motions, closed loops", "tuned CasADi with IPOPT", ratios[0], ratios[-1], "ocp_loops.md")


def _read_legged(text: str) -> Iterator[Bar]:
    """Read ratios of solves; solves that a peer did not finish give bounds from below."""
    rows, *_ = read_tables(text).values()
    ratios = sorted(read_number(row["ratio"]) for row in rows)
    yield Bar("Gaits and jumps in phases", "plain CasADi with IPOPT", ratios[0], ratios[-1], "legged.md")


def _read_control(text: str) -> Iterator[Bar]:
    solves, *_ = read_tables(text).values()
    own = [row for row in solves if row["N"] == solves[0]["N"]]
    ratios = [read_number(find_row(own, "solver", name)["by ours"]) for name in ("acados", "fatrop")]
    yield Bar("Next step of a Panda's control", "acados and fatrop", ratios[0], ratios[1], "mpc.md")


READERS: dict[str, Callable[[str], Iterator[Bar]]] = {
    "summary.md": _read_kernels,
    "loops.md": _read_loops,
    "ocp_loops.md": _read_ocp_loops,
    "legged.md": _read_legged,
    "mpc.md": _read_control,
}


def list_bars(folder: Path) -> list[Bar]:
    """List the bars of all pages, the longest first. Raises PageError with the name of the page."""
    found: list[Bar] = []
    for page, read in READERS.items():
        found += read_page(folder / page, lambda text, read=read: [*read(text)])  # type: ignore[misc]
    return sorted(found, key=lambda bar: (-bar.least, bar.work))


def write_front(bars: Sequence[Bar]) -> str:
    """Write three sentences."""
    arm, loops, control = (
        next(bar for bar in bars if bar.work.startswith(work))
        for work in ("Optimal motion of the paper", "Accelerations, closed", "Next step")
    )
    return "\n".join(
        (
            f"- **{write_times(arm.least)} times faster** than compiled, tuned CasADi with IPOPT on the arm's "
            f"motion above, the task of a published study ([figures]({arm.page})).",
            f"- **{loops.label} faster** than the quickest peer at accelerations of mechanisms with closed loops "
            f"([figures]({loops.page})).",
            f"- **{write_times(control.least)} times faster** than acados, and {write_times(control.most)} times "
            f"faster than fatrop, at each next step of a Panda's predictive control ([figures]({control.page})).",
        )
    )


@styled
def draw_front(bars: Sequence[Bar], path: Path) -> None:
    """Draw a bar for each kind of work: solid to the worst case that was measured, light to the best."""
    figure = Figure(figsize=(8.0, 0.52 * len(bars) + 1.2), layout="constrained")
    axes = figure.subplots()
    _draw_bars(axes, bars, 0.56)
    for k, bar in enumerate(reversed(bars)):
        _write(axes, f"{bar.label} faster than {bar.peer}", bar.most, k, (6, 0))
    axes.set_xlim(1, 900 * max(bar.most for bar in bars))
    axes.set_yticks(range(len(bars)), [bar.work for bar in reversed(bars)])
    axes.set_xlabel("times faster (dark: in every case measured; light: in the best one)")
    axes.set_title("Times faster than other programs, by kind of work", loc="left")
    save_figure(figure, path)


@styled
def draw_narrow(bars: Sequence[Bar], path: Path) -> None:
    """Draw the same for a phone, with the words above each bar."""
    figure = Figure(figsize=(4.0, 0.8 * len(bars) + 1.2), layout="constrained")
    axes = figure.subplots()
    _draw_bars(axes, bars, 0.26)
    for k, bar in enumerate(reversed(bars)):
        _write(axes, f"{bar.work}: {bar.label}\nfaster than {bar.peer}", 1, k, (0, 20))
    axes.set_xlim(1, 2 * max(bar.most for bar in bars))
    axes.set_ylim(-0.3, len(bars) - 0.2)
    axes.set_yticks([])
    axes.set_xlabel("times faster\n(dark: in every case measured; light: in the best)")
    save_figure(figure, path)


def _draw_bars(axes: Axes, bars: Sequence[Bar], height: float) -> None:
    for k, bar in enumerate(reversed(bars)):
        axes.barh(k, bar.least - 1, left=1, height=height, color=PALETTE[0])
        axes.barh(k, bar.most - bar.least, left=bar.least, height=height, color=PALETTE[0], alpha=0.35)
    axes.set_xscale("log")
    ticks = [1, 2, 5, 10, 20, 50, 100, 200]
    axes.set_xticks(ticks, [f"{x}" for x in ticks])
    axes.minorticks_off()
    axes.tick_params(axis="y", length=0)
    axes.spines["left"].set_color(QUIET)


def _write(axes: Axes, text: str, x: float, y: float, offset: tuple[float, float]) -> None:
    """Write at a place, and an offset from it in points."""
    axes.annotate(text, (x, y), xytext=offset, textcoords="offset points", va="center", fontsize=9)
