"""Pictures of columns over time, one panel for each kind."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from mbsgen.style import PALETTE, save_plot, styled

Array = NDArray[np.float64]

COLORS = PALETTE
NAMED = 12  # lines that a legend still names


@dataclass(frozen=True)
class Panel:
    """Lines in one pair of axes; NaN interrupts a line."""

    label: str
    lines: Mapping[str, Array]
    dots: Mapping[str, Array]  # samples, in the colour of the line of their name


@styled
def plot_panels(times: Array, panels: Sequence[Panel], title: str, path: Path) -> None:
    """Draw panels above each other, and write the picture."""
    shown = [panel for panel in panels if panel.lines]
    figure = Figure(figsize=(8, 0.8 + 2.6 * len(shown)), layout="constrained")
    for axes, panel in zip(figure.subplots(len(shown), 1, sharex=True, squeeze=False)[:, 0], shown, strict=True):
        for i, (name, values) in enumerate(panel.lines.items()):
            color = COLORS[i % len(COLORS)]
            axes.plot(times, values, color=color, label=_plain(name))
            if name in panel.dots:
                axes.plot(times, panel.dots[name], ".", color=color, markersize=2)
        axes.set_ylabel(panel.label)
        axes.grid(alpha=0.3)
        if len(panel.lines) <= NAMED:
            axes.legend(loc="upper left", bbox_to_anchor=(1, 1), frameon=False, fontsize="small")
        axes.set_xlabel("time [s]" if panel is shown[-1] else "")
    figure.suptitle(_plain(title))
    save_plot(figure, path)


def _plain(name: str) -> str:
    """Keep a name of the user's from being read as a formula, or as an instruction to leave it out."""
    return "\u200b" + name.replace("$", r"\$") if name.startswith("_") else name.replace("$", r"\$")
