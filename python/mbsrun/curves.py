"""Curves over time in panels, one for each quantity and unit: curves -> figure."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

Array = NDArray[np.float64]

NAMED = 12  # curves of a panel that a legend still names
TALL, LOW = 3.0, 2.2  # inches: the height of a panel, of a few and of many
FEW = 4
NEAR = 1e-3  # a limit so near to a curve, relative to what it spans, is reached


@dataclass(frozen=True)
class Panel:
    """A panel: curves of one quantity in one unit share its axis."""

    title: str
    symbol: str = ""  # in the language of matplotlib's formulas
    unit: str = ""

    @property
    def label(self) -> str:
        """Return the text at the axis."""
        parts = (f"${self.symbol}$" if self.symbol else "", f"[{self.unit}]" if self.unit else "")
        return " ".join(part for part in parts if part)


@dataclass(frozen=True, eq=False)
class Curve:
    """A curve, and the function of axes and a label that draws it."""

    panel: Panel
    label: str
    draw: Callable[[Axes, str], Any]


def plot(t: Array, values: Array, **style: Any) -> Callable[[Axes, str], Any]:
    """Return a function that draws values over time as a line."""
    return lambda axes, label: axes.plot(t, values, label=plain(label), **style)


def within(draw: Callable[[Axes, str], Any], values: Array, limits: Iterable[float], color: Any) -> Callable[..., Any]:
    """Return a function that draws a curve of these values, and the limits that it reaches, dotted."""
    span = float(np.ptp(values)) if values.size else 0.0
    reached = [x for x in limits if np.isfinite(x) and np.abs(values - x).min(initial=np.inf) <= NEAR * span]

    def draw_both(axes: Axes, label: str) -> None:
        draw(axes, label)
        for limit in reached:
            axes.axhline(limit, color=color, linestyle=":", linewidth=1)

    return draw_both


def list_panels(curves: Iterable[Curve]) -> tuple[Panel, ...]:
    """List the panels of curves; the ones with the same title follow each other."""
    panels = dict.fromkeys(curve.panel for curve in curves)
    titles = list(dict.fromkeys(panel.title for panel in panels))
    return tuple(sorted(panels, key=lambda panel: titles.index(panel.title)))


def fill(axes: Sequence[Axes], panels: Sequence[Panel], curves: Iterable[Curve]) -> None:
    """Draw curves in the axes of their panels, and name these."""
    for curve in curves:
        curve.draw(axes[panels.index(curve.panel)], curve.label)
    for own, panel in zip(axes, panels, strict=True):
        own.set_title(plain(panel.title), loc="left", fontsize="medium")
        if panel.symbol:
            own.axhline(0, color="black", linewidth=0.6)
        own.set_ylabel(panel.label)
        own.grid(alpha=0.3)


def add_legends(axes: Iterable[Axes]) -> None:
    """Name the curves of each panel beside it, unless there are too many."""
    for own in axes:
        if 0 < len(own.get_legend_handles_labels()[1]) <= NAMED:
            own.legend(loc="upper left", bbox_to_anchor=(1, 1), frameon=False, fontsize="small")


def draw_curves(curves: Sequence[Curve], ends: tuple[float, float], more: int = 0) -> tuple[Figure, list[Axes]]:
    """Draw curves in panels below each other; return the figure, and the axes of `more` empty panels below."""
    panels = list_panels(curves)
    rows = len(panels) + more
    height = TALL if rows <= FEW else LOW
    figure = Figure(figsize=(8, max(height * rows, TALL)), layout="constrained")
    axes = list(figure.subplots(max(rows, 1), 1, sharex=True, squeeze=False)[:, 0])
    fill(axes[: len(panels)], panels, curves)
    add_legends(axes[: len(panels)])
    axes[-1].set_xlabel("time [s]")
    axes[-1].set_xlim(*ends)
    return figure, axes[len(panels) :]


def plain(name: str) -> str:
    """Keep a name of the user's from being read as a formula, or as an instruction to leave it out."""
    name = name.replace("$", r"\$")
    return f"\u200b{name}" if name.startswith("_") else name
