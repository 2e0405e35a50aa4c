"""Charts of speed against accuracy: points in series, their front drawn and labelled, failures at the edges.

A point stands at the shortest time of its rounds, with a line to their median; left is faster, low is more accurate.
Only points on the front have labels, and labels cover neither marks nor each other; a table lists all points. One
sentence below each chart names the two ends of its front.
"""

from __future__ import annotations

import io
import textwrap
from collections.abc import Iterator, Sequence
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.text import Annotation
from matplotlib.ticker import LogFormatterSciNotation, LogLocator, MaxNLocator, NullLocator
from matplotlib.transforms import Bbox, BboxBase
from PIL import Image

from mbsgen.style import PALETTE, in_format, save_figure, styled
from mbsrun.measuring.fidelity import WHOLE, FidelityPoint
from mbsrun.measuring.fronts import Mark, describe_front, find_front
from mbsrun.measuring.kernels import DOUBLE_DOUBLE, KERNELS, SLOPES
from mbsrun.measuring.kernels import EXACT as DIGITS
from mbsrun.measuring.motions import Standard
from mbsrun.measuring.optima import GridOptimum, OptimumPoint
from mbsrun.measuring.points import KernelPoint, MotionPoint

COLORS = PALETTE
SHADES = 128  # colours of a picture
MARK = 6.0  # points that a mark covers
BESIDE = 2  # pixels around a label that are free
DISTANCES = (6.0, 9.0, 15.0)  # points between a mark and its label
SIDES = (  # of a mark: horizontal and vertical alignment of a label there, and its direction
    ("left", "bottom", 0.9, 0.9),
    ("right", "top", -0.9, -0.9),
    ("left", "top", 0.9, -0.9),
    ("right", "bottom", -0.9, 0.9),
    ("center", "bottom", 0.0, 1.0),
    ("center", "top", 0.0, -1.0),
    ("left", "center", 1.0, 0.0),
    ("right", "center", -1.0, 0.0),
)
LINE = 80  # characters of a sentence below a small chart
MARKERS = {"float64": "o", "float32": "s", DOUBLE_DOUBLE: "^", DIGITS: "D"}
SHAPES = ("o", "s", "^", "D")  # of marks of one colour
NARROW, TICKS, WIDE = 8, 4, 3e3  # spans of times with few labels, and with powers of 10
EXACT, WORST = 1e-17, 100.0  # smaller, larger and unknown errors are drawn there
LEAST = 1e-35  # the same as EXACT, where kernels in double-double are drawn
ROUNDINGS = {"float64": 2.0**-53, "float32": 2.0**-24, DOUBLE_DOUBLE: 2.0**-105}


def save_picture(figure: Figure, path: Path, dpi: int) -> None:
    """Write a figure; a PNG in few colours, with a third of the bytes. The same figure gives the same bytes."""
    figure.set_dpi(dpi)  # lengths of texts in pixels depend on it
    arrange_labels(figure)
    if path.suffix != ".png":
        save_figure(figure, path)
        return
    whole = io.BytesIO()
    figure.savefig(whole, format="png", dpi=dpi)
    with Image.open(whole) as picture:
        picture.convert("RGB").quantize(SHADES, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE).save(
            path, optimize=True
        )


@styled
def draw_kernels(points: Sequence[KernelPoint], folder: Path) -> list[Path]:
    """Draw kernels.png and kernels_backward.png, a row for each mechanism, and derivatives.png; return their paths."""
    pictures = {
        "kernels": (tuple(KERNELS), "error", "largest error, by the largest entry of a result"),
        "kernels_backward": (tuple(KERNELS), "backward", "largest backward error"),
        "derivatives": (tuple(SLOPES), "error", "largest error, by the largest entry of a block"),
    }
    paths = []
    for name, (tasks, number, axis) in pictures.items():
        shown = [p for p in points if p.task in tasks and (number == "error" or _has_backward(p, points))]
        if shown:
            paths.append(in_format(folder / f"{name}.png"))
            _draw_tasks(shown, number, axis, paths[-1])
    return paths


@styled
def draw_motions(points: Sequence[MotionPoint], standard: Standard, folder: Path) -> list[Path]:
    """Draw simulation.png: error of place and drift of energy against processor time; return its path."""
    figure = Figure(figsize=(14, 7.5), layout="constrained")
    left, right = figure.subplots(1, 2, sharex=True)
    for axes, number in ((left, "error"), (right, "drift")):
        marks = [
            Mark(
                f"{p.method}, {p.formulation}",
                f"{p.value:.1e}",
                p.seconds,
                getattr(p, number),
                is_failure=bool(p.finding),
            )
            for p in points
        ]
        sentence = _draw_marks(axes, marks, "s", lines=True)
        axes.set_xlabel(f"processor time [s]\n{textwrap.fill(sentence, LINE)}", fontsize=8)
    left.set_ylabel("largest error at the end [rad, m; rad/s, m/s]")
    left.axhspan(standard.accuracy / 100, standard.accuracy, color="0.9", zorder=0)
    left.set_title(f"below {standard.accuracy:.0e} (grey) the reference is no better: {standard.title}", fontsize=9)
    right.set_ylabel("largest drift of energy, by the energy that is exchanged")
    right.set_title(f"labels: step [s] or tolerance; x: failed, or beyond {WORST:g}", fontsize=9)
    figure.suptitle(f"{plain(points[0].mechanism)}, {standard.duration:g} s: simulation, speed against accuracy")
    handles, labels = left.get_legend_handles_labels()
    figure.legend(handles, labels, fontsize=7, loc="outside lower center", ncols=7)
    path = in_format(folder / "simulation.png")
    save_picture(figure, path, 150)
    return [path]


@styled
def draw_optima(points: Sequence[OptimumPoint], grids: Sequence[GridOptimum], folder: Path) -> list[Path]:
    """Draw optimisation.png, a column for each control grid, and control_grid.png; return their paths."""
    figure = Figure(figsize=(6 * len(grids), 10), layout="constrained")
    rows = figure.subplots(2, len(grids), squeeze=False)
    usual = points[0].tolerance
    for column, grid in enumerate(grids):
        own = [p for p in points if p.intervals == grid.intervals]
        for axes, number in zip(rows[:, column], ("error", "defect"), strict=True):
            sentence = _draw_marks(axes, [_mark_optimum(p, number, usual) for p in own], "s")
            axes.set_xlabel(f"processor time of a solve [s]\n{textwrap.fill(sentence, LINE)}", fontsize=8)
        axes = rows[0, column]
        if grid.accuracy:
            axes.axhspan(grid.accuracy / 100, grid.accuracy, color="0.9", zorder=0)
        if grid.error:
            axes.axhline(grid.error, color="0.4", linewidth=0.8, linestyle="--")
        error = "unknown" if grid.error is None else f"{grid.error:.0e} (dashed)"
        axes.set_title(f"{grid.intervals} intervals; the grid's own error: {error}", fontsize=9)
    rows[0, 0].set_ylabel("error of the cost, on the same control grid")
    rows[1, 0].set_ylabel("largest defect of an interval [rad, m; rad/s, m/s]")
    handles, labels = rows[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, fontsize=7, loc="outside lower center", ncols=6)
    mechanism = plain(points[0].mechanism)
    text = "circles: Radau, squares: Legendre, triangles: another tolerance of the solver"
    notes = f"labels: degree, and tolerance unless {usual:g}; grey: the reference is no better; x: failed"
    figure.suptitle(f"{mechanism}: optimal control, speed against accuracy\n{text}\n{notes}", fontsize=10)
    path = in_format(folder / "optimisation.png")
    save_picture(figure, path, 90)
    return [path, _draw_grids(points, grids, folder)]


@styled
def draw_fidelity(points: Sequence[FidelityPoint], folder: Path) -> list[Path]:
    """Draw fidelity.png: a row for each kernel, errors as supposed and anywhere against time; return its path."""
    kernels = list(dict.fromkeys(p.kernel for p in points))
    reductions = list(dict.fromkeys(p.reduction for p in points if p.reduction != WHOLE))
    shapes = {name: SHAPES[i // len(COLORS) % len(SHAPES)] for i, name in enumerate(reductions)}
    figure = Figure(figsize=(16, 5 * len(kernels)), layout="constrained")
    rows = figure.subplots(len(kernels), 2, squeeze=False)
    for kernel, row in zip(kernels, rows, strict=True):
        own = [p for p in points if p.kernel == kernel]
        (whole,) = [p for p in own if p.reduction == WHOLE]
        for axes, (number, title) in zip(
            row, (("error", "states that agree with the reduction"), ("error_anywhere", "anywhere")), strict=True
        ):
            marks = [_mark_reduction(p, number, shapes[p.reduction]) for p in own if p.reduction != WHOLE]
            sentence = _draw_marks(axes, marks, "ns")
            if whole.ns is not None:
                axes.axvline(whole.ns.shortest, color="0.4", linewidth=0.8, linestyle="--")
            axes.set_title(f"{kernel}, {whole.flops} flops as a whole (dashed: its time): {title}", fontsize=9)
            axes.set_xlabel(f"time of a call [ns]\n{textwrap.fill(sentence, LINE)}", fontsize=8)
        row[0].set_ylabel("largest error, by the whole model's largest result")
    figure.suptitle(
        f"{plain(points[0].mechanism)}: the reduction, and the share of the flops that it saves; x: failed",
        fontsize=10,
    )
    handles, labels = rows[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, fontsize=7, loc="outside lower center", ncols=6)
    path = in_format(folder / "fidelity.png")
    save_picture(figure, path, 90)
    return [path]


def _draw_grids(points: Sequence[OptimumPoint], grids: Sequence[GridOptimum], folder: Path) -> Path:
    """Draw the errors of control grids and of collocation on them, against the number of intervals."""
    figure = Figure(figsize=(9, 6.5), layout="constrained")
    axes = figure.subplots()
    known = [(g.intervals, g.error) for g in grids if g.error]
    if known:
        axes.plot(*zip(*known, strict=True), color="black", marker="D", label="control grid alone")
    first, usual = points[0].representation, points[0].tolerance
    points = [p for p in points if p.tolerance == usual]
    for i, (family, degree) in enumerate(dict.fromkeys((p.family, p.degree) for p in points)):
        own = [p for p in points if (p.family, p.degree, p.representation) == (family, degree, first)]
        shown = [(p.intervals, max(p.error, EXACT)) for p in own if p.error is not None]
        style, marker = ("-", "o") if family == "radau" else ("--", "s")
        color, label = COLORS[i % len(COLORS)], f"collocation alone, {family} {degree}, {first}"
        if shown:
            axes.plot(*zip(*shown, strict=True), color=color, marker=marker, linestyle=style, label=label)
    accuracies = [g.error_accuracy for g in grids if g.error_accuracy]
    if accuracies:
        axes.axhspan(accuracies[0] / 100, accuracies[0], color="0.9", zorder=0)
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xticks([g.intervals for g in grids], [str(g.intervals) for g in grids])
    axes.xaxis.set_minor_locator(NullLocator())
    axes.set_xlabel("intervals, over each of which inputs are constant")
    axes.set_ylabel("relative error of the cost")
    axes.grid(color="0.9", linewidth=0.5)
    axes.legend(fontsize=7)
    text = (
        "grey: below it, the limit of fine grids is uncertain" if accuracies else "the limit depends on two grids alone"
    )
    axes.set_title(
        f"{plain(points[0].mechanism)}: errors of the control grid, and of collocation on it; {text}", fontsize=9
    )
    path = in_format(folder / "control_grid.png")
    save_picture(figure, path, 90)
    return path


def _mark_optimum(point: OptimumPoint, number: str, usual: float) -> Mark:
    marker, label = "o" if point.family == "radau" else "s", str(point.degree)
    if point.tolerance != usual:
        marker, label = "^", f"{label}, {point.tolerance:.0e}"
    return Mark(point.representation, label, point.seconds, getattr(point, number), marker, bool(point.finding))


def _mark_reduction(point: FidelityPoint, number: str, shape: str) -> Mark:
    saved = "" if point.flops is None else f", {1 - point.flops / point.flops_whole:.0%}"
    label, error = f"{point.reduction}{saved}", getattr(point, number)
    return Mark(point.reduction, label, point.ns, error, shape, bool(point.finding))


def plain(name: str) -> str:
    """Escape a name, so that it is not read as a formula."""
    return name.replace("$", r"\$")


def _has_backward(point: KernelPoint, points: Sequence[KernelPoint]) -> bool:
    """Return whether a task of a point has backward errors."""
    return any(p.backward is not None for p in points if p.task == point.task)


def _draw_tasks(points: Sequence[KernelPoint], number: str, axis: str, path: Path) -> None:
    rows = list(dict.fromkeys(p.mechanism for p in points))
    columns = list(dict.fromkeys(p.task for p in points))
    figure = Figure(figsize=(5.5 * len(columns), 1 + 4.2 * len(rows)), layout="constrained")
    grid = figure.subplots(len(rows), len(columns), squeeze=False)
    for r, mechanism in enumerate(rows):
        for c, task in enumerate(columns):
            own = [p for p in points if (p.mechanism, p.task) == (mechanism, task)]
            exact = LEAST if any(p.precision == DOUBLE_DOUBLE for p in own) else EXACT
            sentence = _draw_marks(grid[r, c], [_mark(p, number) for p in own], "ns", exact=exact)
            for precision, rounding in ROUNDINGS.items():
                if any(p.precision == precision for p in own):
                    grid[r, c].axhline(rounding, color="0.6", linewidth=0.8, linestyle=":")
            joints = own[0].joints if own else 0
            count = "1 joint" if joints == 1 else f"{joints} joints"
            grid[r, c].set_title(f"{plain(mechanism)}, {count}: {task}", fontsize=9)
            grid[r, c].set_xlabel(f"time of a call [ns]\n{textwrap.fill(sentence, LINE)}", fontsize=7)
            grid[r, c].legend(fontsize=7, loc="best")
        grid[r, 0].set_ylabel(axis, fontsize=8)
    text = (
        "grey line: the front; squares: float32, circles: float64, triangles: double-double, diamond: 50 digits, "
        "without error; "
        "dotted: half a unit in the last place; x: failed"
    )
    figure.suptitle(text, fontsize=9)
    save_picture(figure, path, 110)


def _mark(point: KernelPoint, number: str) -> Mark:
    way, label = point.way, point.flags
    if "differences" in way:
        way, label = way.rsplit(", ", 1)
    is_failure = point.failed > 0 or bool(point.finding)
    return Mark(way, label, point.ns, getattr(point, number), MARKERS[point.precision], is_failure)


def _draw_marks(axes: Axes, marks: Sequence[Mark], unit: str, *, lines: bool = False, exact: float = EXACT) -> str:
    """Draw marks by series, and their front; return the sentence that describes the front.

    A mark without a time or without an error stands at the right or the upper edge.
    """
    prepare(axes)
    last = max((m.cost.median for m in marks if m.cost), default=1.0) * 1.5
    worst = min(WORST, max(1.0, *(3 * m.error for m in marks if m.error is not None), 1.0))

    def place(mark: Mark) -> tuple[float, float]:
        height = worst if mark.error is None else min(max(mark.error, exact), WORST)
        return (mark.cost.shortest if mark.cost else last), height

    for i, series in enumerate(dict.fromkeys(m.series for m in marks)):
        own, color = [m for m in marks if m.series == series], COLORS[i % len(COLORS)]
        style = ("-", "--", ":")[i // len(COLORS) % 3]
        markers = {m.marker for m in own}
        marker = markers.pop() if len(markers) == 1 else "o"
        axes.plot([], [], color=color, marker=marker, linestyle=style if lines else "", markersize=4, label=series)
        if lines:
            whole = [place(m) for m in own if m.error is not None]
            axes.plot(*zip(*whole, strict=True), color=color, linewidth=0.8, linestyle=style) if whole else None
        for m in own:
            x, y = place(m)
            if m.cost:
                axes.plot([x, m.cost.median], [y, y], color=color, linewidth=0.8)
            is_cross = m.is_failure or y == WORST
            marker, size = ("x", 6) if is_cross else (m.marker, 4)
            axes.plot(x, y, color=color, marker=marker, markersize=size, linestyle="")
    front = find_front(marks)
    if front:
        _draw_front(axes, [place(m) for m in front], [m.label for m in front])
    space_ticks(axes)
    return describe_front(marks, unit)


def space_ticks(axes: Axes) -> None:
    """Label few times where the axis spans less than a decade, and powers of 10 where it spans many."""
    low, high = axes.get_xlim()
    if high < NARROW * low:
        axes.xaxis.set_major_locator(MaxNLocator(TICKS))
    elif high > WIDE * low:
        axes.xaxis.set_major_locator(LogLocator())
        axes.xaxis.set_major_formatter(LogFormatterSciNotation())


def prepare(axes: Axes) -> None:
    """Make both axes logarithmic, with a light grid."""
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.xaxis.set_major_formatter("{x:g}")
    axes.margins(0.12)
    axes.grid(color="0.9", linewidth=0.5)


def _draw_front(axes: Axes, places: Sequence[tuple[float, float]], labels: Sequence[str]) -> None:
    """Draw the front as steps, with labels; `arrange_labels` places them."""
    x, y = zip(*places, strict=True)
    axes.step(x, y, where="post", color="0.6", linewidth=2.5, alpha=0.6, zorder=0.5)
    for place, label in zip(places, labels, strict=True):
        note = axes.annotate(label, place, (0, 0), textcoords="offset points", fontsize=6, color="0.2")
        note.set_in_layout(False)


def arrange_labels(figure: Figure) -> None:
    """Place each label of a chart beside its mark, where it covers neither marks nor other labels, or take it away."""
    figure.draw_without_rendering()  # lays out the charts
    for axes in figure.axes:
        taken = [mark for line in axes.lines for mark in _find_marks(line)]
        for note in [text for text in axes.texts if isinstance(text, Annotation)]:
            box = next((b for b in _try_places(note, axes.get_window_extent()) if not b.count_overlaps(taken)), None)
            if box is None:
                note.remove()
            else:
                taken.append(box)


def _find_marks(line: Line2D) -> list[Bbox]:
    """Return the boxes that the marks of a line cover, in pixels."""
    if line.get_marker() in ("", "None", None):
        return []
    figure = line.get_figure(root=True)
    assert figure is not None, "a line of a chart is in a figure"
    half = MARK * figure.dpi / 144
    places = line.get_transform().transform(line.get_xydata())
    return [Bbox([place - half, place + half]) for place in places]


def _try_places(note: Annotation, limits: BboxBase) -> Iterator[Bbox]:
    """Move a label around its mark, nearest places first; yield its box for each place within the limits, in pixels."""
    for distance in DISTANCES:
        for ha, va, right, up in SIDES:
            note.set(ha=ha, va=va)
            note.set_position((right * distance, up * distance))
            box = note.get_window_extent()
            if limits.x0 < box.x0 and box.x1 < limits.x1 and limits.y0 < box.y0 and box.y1 < limits.y1:
                yield box.padded(BESIDE)
