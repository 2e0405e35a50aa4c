"""Pictures of a track: states against references, inputs within bounds, measures, and computing times."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullLocator
from numpy.typing import NDArray

from mbsgen.style import BAD, PALETTE, save_plot, styled
from mbsrun.external import Mechanism
from mbsrun.ocp.problem import Problem, Range
from mbsrun.tracking.analysis import TAIL, Margin, Measured, Times, follow_references, read_quantities
from mbsrun.tracking.loop import Track

Array = NDArray[np.float64]

COLORS = PALETTE
NAMED = 12  # lines that a legend still names
BINS = 40
LONGEST = 32  # characters of a name in a legend


@styled
def draw_track(
    track: Track, problem: Problem, measured: Sequence[Measured], margins: Sequence[Margin], plant: Mechanism
) -> Figure:
    """Plot coordinates, velocities, inputs, references, margins to constraints and measures over time."""
    constrained = [margin for margin in margins if not margin.is_bound]
    manifest, references = plant.manifest, follow_references(track)
    rows = 3 + bool(references) + bool(constrained) + bool(measured)
    figure = Figure(figsize=(8, 2.6 * rows), layout="constrained")
    axes = list(figure.subplots(rows, 1, sharex=True))
    velocities = [c.name for c in manifest.coordinates]
    _plot(axes[0], track.t, track.q, manifest.positions, "$q$")
    _plot(axes[1], track.t, track.qd, velocities, r"$\dot{q}$")
    _plot_inputs(axes[2], track, problem.bounds.u, [velocities[i] for i in manifest.actuated])
    if references:
        values = np.stack(read_quantities(list(references), track, plant), axis=1)
        _plot(axes[3], track.t, values, list(references), "reference (dashed)")
        for k, reference in enumerate(references.values()):
            axes[3].plot(track.t, reference, "--", color=COLORS[k % len(COLORS)], linewidth=1)
    if constrained:
        lines = np.stack([margin.values for margin in constrained], axis=1)
        below = axes[3 + bool(references)]
        _plot(below, track.t, lines, [margin.name for margin in constrained], "margin to constraints")
        below.axhline(0, color="black", linewidth=0.7, linestyle="--")
    if measured:
        _plot_measures(axes[-1], measured)
    for kick in track.trial.kicks:
        for each in axes:
            each.axvline(kick.time, color="0.6", linewidth=0.8, linestyle=":")
    axes[-1].set_xlabel("time [s]")
    axes[-1].set_xlim(track.t[0], track.t[-1] or 1.0)
    figure.suptitle(_plain(track.trial.name) + ("" if track.halt is None else ": incomplete"))
    return figure


@styled
def draw_times(track: Track, times: Times) -> Figure:
    """Draw the histogram of computing times, from a state to inputs."""
    figure = Figure(figsize=(8, 3.6), layout="constrained")
    axes = figure.subplots()
    milliseconds = 1e3 * np.array([sample.decision.seconds for sample in track.samples])
    spread = np.geomspace(max(milliseconds.min(), 1e-4), max(milliseconds.max(), 2e-4) * 1.001, BINS)
    axes.hist(milliseconds.tolist(), spread.tolist(), color=COLORS[0])
    axes.set_xscale("log")
    axes.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.xaxis.set_major_formatter("{x:g}")
    for name, value, line in (("median", times.median, "-"), (f"{TAIL} %", times.tail, "--")):
        axes.axvline(1e3 * value, color="black", linestyle=line, linewidth=1, label=f"{name}: {1e3 * value:.3g} ms")
    axes.axvline(1e3 * track.trial.period, color=BAD, linewidth=1, label="sampling period")
    axes.set_xlabel("processor time of a sample [ms]")
    axes.set_ylabel("samples")
    axes.legend(frameon=False)
    return figure


def save(figure: Figure, path: Path) -> None:
    """Write a picture."""
    save_plot(figure, path)


def _plot(axes: Axes, t: Array, values: Array, names: Sequence[str], label: str) -> None:
    for i, (name, column) in enumerate(zip(names, values.T, strict=True)):
        axes.plot(t, column, color=COLORS[i % len(COLORS)], label=_plain(name), linewidth=1.2)
    _finish(axes, label, len(names))


def _plot_inputs(axes: Axes, track: Track, bounds: Sequence[Range], names: Sequence[str]) -> None:
    """Plot the inputs that were asked for, in steps, and their bounds."""
    edges = np.array([*(sample.time for sample in track.samples), track.t[-1]])
    if edges[-1] <= edges[-2]:  # it ended at a sample
        edges[-1] = edges[-2] + track.trial.period
    for i, (name, limits) in enumerate(zip(names, bounds, strict=True)):
        color = COLORS[i % len(COLORS)]
        values = [sample.u[i] for sample in track.samples]
        axes.stairs(values, edges, baseline=None, color=color, linewidth=1.2, label=_plain(name))
        for limit in filter(np.isfinite, limits):
            axes.axhline(limit, color=color, linewidth=0.7, linestyle="--")
    _finish(axes, "inputs (bounds dashed)", len(names))


def _plot_measures(axes: Axes, measured: Sequence[Measured]) -> None:
    for i, x in enumerate(measured):
        color = COLORS[i % len(COLORS)]
        axes.plot(x.t, x.values, color=color, label=_plain(x.name), linewidth=1.2)
        if x.most is not None:
            axes.axhline(x.most, color=color, linewidth=0.7, linestyle="--")
    _finish(axes, "measures (limits dashed)", len(measured))


def _finish(axes: Axes, label: str, lines: int) -> None:
    axes.set_ylabel(label)
    axes.grid(alpha=0.3)
    if lines <= NAMED:
        axes.legend(loc="upper left", bbox_to_anchor=(1, 1), frameon=False, fontsize="small")


def _plain(name: str) -> str:
    """Shorten a name of the user's; keep it from being read as a formula, or as an instruction to leave it out."""
    name = name if len(name) <= LONGEST else f"{name[: LONGEST - 3]}..."
    return "\u200b" + name.replace("$", r"\$") if name.startswith("_") else name.replace("$", r"\$")
