"""Pictures of an identification: torques with their residuals over time, numbers with intervals, correlations."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from mbsgen.style import BAD, NEUTRAL, PALETTE, save_plot, styled
from mbsrun.identification.result import Identification, Trace

MOST = 12  # torques that are drawn
LONG = 34  # letters of a name
GAP = 3.0  # median steps, beyond which a line is interrupted


@styled
def plot_residuals(found: Identification, path: Path) -> None:
    """Draw measured and computed torques beside the residuals, a row each; recordings follow each other."""
    count = min(len(found.torques), MOST)
    figure = Figure(figsize=(10, 0.8 + 1.7 * count), layout="constrained")
    grid = figure.subplots(count, 2, sharex=True, squeeze=False)
    for j in range(count):
        own, rest = grid[j]
        torque, start = found.torques[j], 0.0
        for trace in found.traces:
            t, measured, computed = _interrupt(trace, j)
            t = t - trace.t[0] + start
            own.plot(t, measured, color=NEUTRAL, linewidth=0.8, label="measured" if start == 0 else None)
            own.plot(t, computed, color=PALETTE[0], linewidth=1.0, label="computed" if start == 0 else None)
            rest.plot(t, measured - computed, color=PALETTE[3], linewidth=0.6)
            start += float(trace.t[-1] - trace.t[0]) * 1.02
        for sign in (-2, 2):
            rest.axhline(sign * torque.deviation, color=NEUTRAL, linewidth=0.8, linestyle="--")
        own.set_ylabel(f"{_shorten(torque.joint)} [{torque.unit}]")
    grid[0][0].legend(loc="upper right", fontsize="small")
    grid[0][0].set_title("measured and computed torques")
    grid[0][1].set_title("residuals; dashed: two standard deviations")
    for axes in grid[-1]:
        axes.set_xlabel("time [s]")
    save_plot(figure, path)


def _interrupt(trace: Trace, j: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return a torque over time, with NaN in gaps."""
    steps = np.diff(trace.t)
    after = np.flatnonzero(steps > GAP * np.median(steps)) + 1
    return (
        np.insert(trace.t, after, np.nan),
        np.insert(trace.measured[:, j], after, np.nan),
        np.insert(trace.computed[:, j], after, np.nan),
    )


@styled
def plot_numbers(found: Identification, path: Path) -> None:
    """Draw each base parameter's change from the model in standard deviations, beside all correlations."""
    determined = [k for k, x in enumerate(found.base) if x.is_determined]
    figure = Figure(figsize=(11, 1.4 + 0.19 * max(len(determined), 10)), layout="constrained")
    left, right = figure.subplots(1, 2)
    places = np.arange(len(determined))
    sizes = np.array([found.base[k].deviation / max(abs(found.base[k].value), 1e-300) for k in determined])
    colors = [BAD if x > 0.5 else PALETTE[0] for x in sizes]
    left.barh(places, 100 * sizes, color=colors)
    left.set_xscale("log")
    left.set_yticks(places, [_shorten(found.base[k].name) for k in determined], fontsize=7)
    left.invert_yaxis()
    left.set_xlabel("standard deviation [% of the value]")
    image = right.imshow(found.correlations[np.ix_(determined, determined)], vmin=-1, vmax=1, cmap="RdBu_r")
    right.set_title("correlations, in the same order")
    right.set_xticks([])
    right.set_yticks([])
    figure.colorbar(image, ax=right, shrink=0.7)
    save_plot(figure, path)


def _shorten(name: str) -> str:
    """Shorten a name of the user's, which must not be read as a formula."""
    text = name if len(name) <= LONG else f"{name[: LONG - 1]}…"
    return text.replace("$", r"\$")
