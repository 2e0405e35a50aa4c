"""Pictures of a track: states against references, inputs within bounds, measures, and computing times."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullLocator
from numpy.typing import NDArray

from mbsgen.manifest import Manifest
from mbsgen.style import BAD, PALETTE, save_plot, styled
from mbsrun.curves import Curve, Panel, draw_curves, plain, plot
from mbsrun.external import Mechanism
from mbsrun.ocp.problem.problem import Problem, Range
from mbsrun.quantities import Quantity, find_unit, list_quantities
from mbsrun.tracking.analysis import TAIL, Margin, Measured, Times, follow_references, read_quantities
from mbsrun.tracking.loop import Track

Array = NDArray[np.float64]

COLORS = PALETTE
BINS = 40
LONGEST = 32  # characters of a name in a legend


@styled
def draw_track(
    track: Track, problem: Problem, measured: Sequence[Measured], margins: Sequence[Margin], plant: Mechanism
) -> Figure:
    """Plot coordinates, velocities, inputs, references, margins to constraints and measures, a panel for each unit."""
    curves = [
        *_list_motion(track, problem, plant.manifest),
        *_list_controls(track, problem),
        *_list_references(track, plant),
        *_list_margins(track, margins),
        *_list_measures(measured),
    ]
    figure, _ = draw_curves(curves, (float(track.t[0]), float(track.t[-1]) or 1.0))
    for kick in track.trial.kicks:
        for each in figure.axes:
            each.axvline(kick.time, color="0.6", linewidth=0.8, linestyle=":")
    figure.suptitle(plain(_shorten(track.trial.name)) + ("" if track.halt is None else ": incomplete"))
    return figure


def _list_motion(track: Track, problem: Problem, manifest: Manifest) -> Iterator[Curve]:
    """Yield coordinates, velocities, and inputs that were asked for, in steps, with their bounds."""
    for title, kind, symbol, names, values in (
        ("coordinates", "q", "q", manifest.positions, track.q),
        ("velocities", "qd", r"\dot{q}", [c.name for c in manifest.coordinates], track.qd),
    ):
        for i, (name, column) in enumerate(zip(names, values.T, strict=True)):
            panel = Panel(title, symbol, find_unit(Quantity(kind, i), manifest))
            yield Curve(panel, _shorten(name), plot(track.t, column, color=COLORS[i % len(COLORS)], linewidth=1.2))
    following = {force.input for force in problem.forces}
    for i, (k, limits) in enumerate(zip(manifest.actuated, problem.bounds.u, strict=True)):
        joint, color = manifest.coordinates[k], COLORS[i % len(COLORS)]
        panel = Panel("inputs (bounds dashed)", "u", joint.force_unit)
        drawn = plot(track.t, track.u[:, i], color=color, linewidth=1.2)
        yield Curve(panel, _shorten(joint.name), drawn if i in following else _draw_held(track, i, limits, color))


def _list_controls(track: Track, problem: Problem) -> Iterator[Curve]:
    """Yield controls that the problem adds, except for auxiliary ones; nothing states their units."""
    for i, control in enumerate(problem.controls):
        if not control.is_auxiliary:
            drawn = _draw_held(track, len(problem.bounds.u) + i, control.bounds, COLORS[i % len(COLORS)])
            yield Curve(Panel("controls (bounds dashed)"), _shorten(control.name), drawn)


def _draw_held(track: Track, i: int, limits: Range, color: str) -> Callable[[Axes, str], None]:
    """Draw an input that is held from sample to sample."""
    edges = np.array([*(sample.time for sample in track.samples), track.t[-1]])
    if edges[-1] <= edges[-2]:  # it ended at a sample
        edges[-1] = edges[-2] + track.trial.period
    return _draw_steps(edges, np.array([sample.u[i] for sample in track.samples]), limits, color)


def _draw_steps(edges: Array, values: Array, limits: Range, color: str) -> Callable[[Axes, str], None]:
    def draw(axes: Axes, label: str) -> None:
        axes.stairs(values, edges, baseline=None, color=color, linewidth=1.2, label=plain(label))
        for limit in filter(np.isfinite, limits):
            axes.axhline(limit, color=color, linewidth=0.7, linestyle="--")

    return draw


def _list_references(track: Track, plant: Mechanism) -> Iterator[Curve]:
    """Yield quantities that follow a reference, each with it."""
    references, known = follow_references(track), list_quantities(plant.manifest)
    if not references:
        return
    for k, (name, values) in enumerate(zip(references, read_quantities(list(references), track, plant), strict=True)):
        panel = Panel("references (dashed)", unit=find_unit(known[name], plant.manifest))
        yield Curve(panel, _shorten(name), _draw_pair(track.t, values, references[name], COLORS[k % len(COLORS)]))


def _draw_pair(t: Array, values: Array, reference: Array, color: str) -> Callable[[Axes, str], None]:
    def draw(axes: Axes, label: str) -> None:
        axes.plot(t, values, color=color, label=plain(label), linewidth=1.2)
        axes.plot(t, reference, color=color, linewidth=1, linestyle="--")

    return draw


def _list_margins(track: Track, margins: Sequence[Margin]) -> Iterator[Curve]:
    """Yield the margins to constraints; nothing states their units."""
    for k, margin in enumerate(margin for margin in margins if not margin.is_bound):
        drawn = plot(track.t, margin.values, color=COLORS[k % len(COLORS)], linewidth=1.2)
        yield Curve(Panel("margins to constraints"), _shorten(margin.name), drawn)


def _list_measures(measured: Sequence[Measured]) -> Iterator[Curve]:
    for k, x in enumerate(measured):
        yield Curve(Panel("measures (limits dashed)"), _shorten(x.name), _draw_measure(x, COLORS[k % len(COLORS)]))


def _draw_measure(x: Measured, color: str) -> Callable[[Axes, str], None]:
    def draw(axes: Axes, label: str) -> None:
        axes.plot(x.t, x.values, color=color, label=plain(label), linewidth=1.2)
        if x.most is not None:
            axes.axhline(x.most, color=color, linewidth=0.7, linestyle="--")

    return draw


@styled
def draw_times(track: Track, times: Times) -> Figure:
    """Draw the histogram of computing times, from a state to inputs."""
    figure = Figure(figsize=(8, 3.6), layout="constrained")
    axes = figure.subplots()
    milliseconds = 1e3 * np.array([sample.decision.seconds for sample in track.samples])
    spread = np.geomspace(max(milliseconds.min(), 1e-4), max(milliseconds.max(), 2e-4) * 1.001, BINS + 1)
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


def _shorten(name: str) -> str:
    """Shorten a name of the user's."""
    return name if len(name) <= LONGEST else f"{name[: LONGEST - 3]}..."
