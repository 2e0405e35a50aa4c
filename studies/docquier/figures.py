"""Draw the figures of Docquier, Brüls and Fisette, section 4.3, from the results of a run.

Box plots follow their convention: the mark is the median, the box reaches from the 25th to the 75th percentile, the
whiskers to the most extreme points that are not outliers (1.5 boxes away), and outliers are drawn one by one with +.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.axes3d import Axes3D
from numpy.typing import NDArray

from mbsgen.manifest import Manifest
from mbsgen.style import BAD, DOTS, METADATA, PALETTE, styled
from mbsrun.measuring.sections import KINDS, Picture
from mbsrun.ocp.ground.plant import Plant
from mbsrun.ocp.ground.trajectory import Trajectory
from mbsrun.ocp.searching.study import Weights
from mbsrun.ocp.solution.record import Attempt
from studies.docquier.judges import list_grids, mean_iterations
from studies.docquier.results import Results

Array = NDArray[np.float64]

COLORS = PALETTE
_FORMAT = ContextVar("format", default="svg")


@contextmanager
def drawn_as(name: str) -> Iterator[None]:
    """Draw figures as svg, png or pdf within the context."""
    token = _FORMAT.set(name)
    try:
        yield
    finally:
        _FORMAT.reset(token)


def save(figure: Figure, title: str, note: str) -> Picture:
    """Write a figure in the format of the context; as PDF, it is SVG too, which pages show."""
    wanted = _FORMAT.get()
    shown = "svg" if wanted == "pdf" else wanted
    paper = _write(figure, "pdf") if wanted == "pdf" else b""
    return Picture(title, KINDS[f".{shown}"], _write(figure, shown), note, paper)


def _write(figure: Figure, name: str) -> bytes:
    """Write a figure; the same figure gives the same bytes."""
    file = io.BytesIO()
    with rc_context({"svg.hashsalt": "mbsrun", "svg.fonttype": "path"}):
        figure.savefig(file, format=name, dpi=DOTS if name == "png" else "figure", metadata=dict(METADATA[name]))
    return file.getvalue()


def name_set(weights: Weights) -> str:
    """Name a set of tasks by its cost."""
    return f"k1 = {weights[0]:g}, k2 = {weights[1]:g}"


def list_sets(results: Results) -> list[Weights]:
    """List the sets with at least one solution by the paper's protocol."""
    return [w for w in results.study.costs if any(results.is_measured(w, name) for name in results.representations)]


# --- Fig. 5 and 6 --------------------------------------------------------------------------------------------------


def draw_targets(results: Results, plant: Plant) -> Picture:
    """Draw the mechanism at its start, and the targets: Fig. 5 and 6."""
    study, frames = results.study, plant.manifest.frames
    p = plant("frames", q=np.array(study.problem.start_q))["p"]  # (3, frames)
    figure = Figure(figsize=(7, 5.5), layout="constrained")
    axes = figure.add_subplot(projection="3d")
    assert isinstance(axes, Axes3D)
    for i, frame in enumerate(frames):
        start = p[:, frame.parent] if frame.parent >= 0 else np.zeros(3)
        axes.plot(*np.stack((start, p[:, i]), axis=1), color="0.2", linewidth=3, marker="o", markersize=4)
    places = np.array([study.targets.position(place) for place in study.targets.places])
    axes.plot(*places.T, ".", color=BAD, markersize=4, label=f"{len(places)} targets")
    points = np.concatenate((places, p.T, np.zeros((1, 3))))
    middle, half = (points.max(0) + points.min(0)) / 2, np.ptp(points, axis=0).max() / 2 or 1.0
    for limit, centre in zip((axes.set_xlim, axes.set_ylim, axes.set_zlim), middle, strict=True):
        limit(centre - half, centre + half)
    axes.set(xlabel="x [m]", ylabel="y [m]", zlabel="z [m]")
    axes.set_box_aspect((1, 1, 1))
    axes.view_init(elev=25, azim=-60)
    axes.legend(loc="upper left", frameon=False)
    note = "Frames of joints and sensors, with lines to their parents, at the start; dots: targets of the sensor."
    return save(figure, "Fig. 5 and 6: the mechanism at its start, and the targets", note)


# --- Fig. 7 --------------------------------------------------------------------------------------------------------


def draw_convergence(results: Results) -> Picture:
    """Draw the mean number of iterations over ever finer grids: Fig. 7."""
    sets = list_sets(results)
    figure = Figure(figsize=(9, 3.6), layout="constrained")
    for axes, weights in zip(figure.subplots(1, len(sets), squeeze=False)[0], sets, strict=True):
        grids = list_grids(results, weights)
        sizes = [len(grid) for grid in grids]
        for i, name in enumerate(results.representations):
            means = [mean_iterations(results, weights, name, grid) for grid in grids]
            axes.plot(sizes, means, marker="o", markersize=3, color=COLORS[i], label=name)
        axes.set(xlabel="tasks", ylabel="mean number of iterations", title=name_set(weights), xscale="log")
        axes.set_xticks(sizes, list(map(str, sizes)))
        axes.set_xticks([], minor=True)
        axes.set_ylim(bottom=0)
        axes.grid(alpha=0.3)
    axes.legend(fontsize="small")
    note = "Each grid has every second azimuth and height of the next one. Solved tasks only."
    return save(figure, "Fig. 7: convergence over grids", note)


# --- Fig. 8 --------------------------------------------------------------------------------------------------------


def draw_motions(results: Results, manifest: Manifest) -> Picture:
    """Draw the motions to one target for all costs side by side: Fig. 8."""
    motions = results.motions
    figure = Figure(figsize=(4.5 * len(motions), 7.5), layout="constrained")
    grid = figure.subplots(3, len(motions), sharex=True, sharey="row", squeeze=False)
    for column, (weights, motion) in enumerate(motions):
        _draw_motion(grid[:, column], motion, manifest)
        grid[0, column].set_title(name_set(weights))
    for axes, label in zip(grid[:, 0], ("q [rad, m]", "q̇ [rad/s, m/s]", "u [N m, N]"), strict=True):
        axes.set_ylabel(label)
    grid[0, -1].legend(fontsize="small", ncols=2)
    note = f"From the first representation of the study, {results.representations[0]}, by the paper's protocol."
    return save(figure, "Fig. 8: the motion to the last azimuth and the lowest height", note)


def _draw_motion(axes: NDArray[np.object_], motion: Trajectory, manifest: Manifest) -> None:
    for i, coordinate in enumerate(manifest.coordinates):
        color, style = COLORS[i % len(COLORS)], "-" if coordinate.actuated else "--"
        axes[0].plot(motion.t, motion.q[:, i], style, color=color, label=coordinate.name.replace("$", r"\$"))
        axes[1].plot(motion.t, motion.qd[:, i], style, color=color)
    for k, i in enumerate(manifest.actuated):
        axes[2].stairs(motion.u[:, k], motion.t, baseline=None, color=COLORS[i % len(COLORS)])
    axes[2].set_xlabel("time [s]")
    for each in axes:
        each.grid(alpha=0.3)


# --- Fig. 9 to 11 --------------------------------------------------------------------------------------------------


def draw_boxes(results: Results, figure_name: str, title: str, label: str) -> Picture:
    """Draw a figure of all tasks as box plots, set by set: Fig. 9, 10, 11."""
    sets = list_sets(results)
    figure = Figure(figsize=(9, 3.6), layout="constrained")
    for axes, weights in zip(figure.subplots(1, len(sets), squeeze=False)[0], sets, strict=True):
        values = [results.values(weights, name, figure_name) for name in results.representations]
        _draw_box(axes, values, results.representations)
        axes.set(title=name_set(weights), ylabel=label)
        if figure_name != "cost":
            axes.set_ylim(bottom=0)
    note = "Solved tasks of the paper's protocol. Box plots follow the paper's convention; + marks outliers."
    return save(figure, title, note)


def _draw_box(axes: Axes, values: Sequence[Array], names: Sequence[str]) -> None:
    axes.boxplot(list(values), whis=1.5, sym="+", tick_labels=list(names), medianprops={"color": BAD})
    axes.tick_params("x", labelsize="small", rotation=20)
    axes.grid(axis="y", alpha=0.3)


@styled
def draw_figures(results: Results, plant: Plant) -> list[Picture]:
    """Draw all figures that have numbers."""
    pictures = [draw_targets(results, plant)] if results.study.sensor is not None else []
    if list_sets(results):
        pictures.append(draw_convergence(results))
        if results.motions:
            pictures.append(draw_motions(results, plant.manifest))
        for name, title, label in (
            ("cost", "Fig. 9: cost at the optimum", "cost"),
            ("iterations", "Fig. 10: iterations", "iterations"),
            ("cpu", "Fig. 10: CPU time to convergence", "CPU time [s]"),
            ("cpu per iteration", "Fig. 11: CPU time per iteration", "CPU time per iteration [ms]"),
            ("evaluation per iteration", "Fig. 11, functions and derivatives alone", "CPU time per iteration [ms]"),
        ):
            pictures.append(draw_boxes(results, name, title, label))
    return pictures


# --- beyond the paper ----------------------------------------------------------------------------------------------


@styled
def draw_scatter(
    attempts: Sequence[Attempt],
    series: Callable[[Attempt], str],
    place: Callable[[Attempt], tuple[float | None, float | None]],
    labels: tuple[str, str, str],
    title: str,
    note: str,
) -> Picture:
    """Draw attempts on logarithmic axes; attempts without a solution or a number are crosses at the top."""
    figure = Figure(figsize=(9, 5), layout="constrained")
    axes = figure.subplots()
    axes.set(xscale="log", yscale="log", xlabel=labels[0], ylabel=labels[1])
    places = [place(a) for a in attempts]
    highest = max((y for _, y in places if y is not None and y > 0), default=1.0)
    names = list(dict.fromkeys(map(series, attempts)))
    for k, name in enumerate(names):
        own = [xy for a, xy in zip(attempts, places, strict=True) if series(a) == name]
        good = sorted((x, y) for x, y in own if x is not None and y is not None and y > 0)
        color, style = COLORS[k % len(COLORS)], ("o-", "s--")[k // len(COLORS) % 2]
        x, y = np.array(good).reshape(-1, 2).T
        axes.plot(x, y, style, color=color, markersize=3.5, linewidth=1, label=name)
        lost = [x for x, height in own if x is not None and (height is None or height <= 0)]
        axes.plot(lost, [3 * highest] * len(lost), "x", color=color)
    axes.grid(alpha=0.3)
    axes.legend(fontsize="x-small", ncols=2, title=labels[2])
    return save(figure, title, note)


def draw_ratios(rows: Mapping[str, Mapping[str, float]], ways: Sequence[str]) -> Picture:
    """Draw by representation how long functions and derivatives take, relative to the first way, on a log axis."""
    figure = Figure(figsize=(9, 1.2 + 0.55 * len(rows)), layout="constrained")
    axes = figure.subplots()
    height = 0.8 / len(ways)
    for k, way in enumerate(ways):
        places = {i + k * height: row[way] for i, row in enumerate(rows.values()) if way in row}
        bars = axes.barh([*places], [*places.values()], height, color=COLORS[k], label=way)
        axes.bar_label(bars, fmt="%.2g", padding=2, fontsize="small")
    axes.set_yticks([i + (len(ways) - 1) * height / 2 for i in range(len(rows))], list(rows))
    axes.set_xscale("log")
    axes.axvline(1, color="0.5", linewidth=0.8)
    axes.margins(x=0.12)
    axes.invert_yaxis()
    axes.set_xlabel("CPU time of functions and derivatives per iteration, relative to the generated ones")
    axes.legend(fontsize="small")
    note = "Shorter is better; 1 is the time of the generated functions with recursive sensitivities."
    return save(figure, "Recursive sensitivities against algorithmic differentiation", note)


def draw_parts(parts: Sequence[tuple[str, float, float]]) -> Picture:
    """Draw the time of an iteration as bars: functions and derivatives, and the rest [ms]."""
    figure = Figure(figsize=(9, 1.2 + 0.35 * len(parts)), layout="constrained")
    axes = figure.subplots()
    names, evaluation, rest = zip(*parts, strict=True)
    axes.barh(names, evaluation, color=COLORS[0], label="functions and derivatives")
    axes.barh(names, rest, left=evaluation, color="0.8", label="the rest: linear algebra, and the solver itself")
    axes.invert_yaxis()
    axes.set_xlabel("CPU time per iteration [ms]")
    axes.grid(axis="x", alpha=0.3)
    axes.legend(fontsize="small")
    return save(figure, "CPU time per iteration, by the source of derivatives", "The quickest of the rounds.")
