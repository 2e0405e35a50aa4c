"""One picture of a model: the fronts of all formulations, for every task, with the advised choice marked.

A panel shows one need of one task: time against error. Each formulation has its own front: the options of this
formulation that no other option of it beats in both time and error. A ring marks the choice of `advice`.
"""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from mbsgen.style import in_format
from mbsrun.measuring.advice import Advice, Option
from mbsrun.measuring.fronts import Mark, find_front
from mbsrun.measuring.pictures import COLORS, EXACT, plain, prepare, save_picture, space_ticks
from mbsrun.measuring.sections import Cell, Table, write_table

ACROSS = 3  # panels in a row
LINE = 60  # characters of a line below a panel
UNITS = {"ns": "time of a call [ns]", "s": "processor time [s]"}


@dataclass(frozen=True)
class Panel:
    """One need of one task."""

    advice: Advice
    need: str

    @property
    def options(self) -> list[Option]:
        """List the options that have a time and an error, and did not fail."""
        own = [o for o in self.advice.options if o.need == self.need]
        return [o for o in own if o.cost is not None and o.error is not None and not o.finding]

    @property
    def fronts(self) -> dict[str, list[Option]]:
        """Return the front of each formulation, from the fastest option to the most accurate."""
        series: dict[str, list[Option]] = {}
        for option in self.options:
            series.setdefault(name_series(option), []).append(option)
        return {name: _find_front(own) for name, own in series.items()}


def name_series(option: Option) -> str:
    """Return the formulation of an option; differences of all steps are one."""
    name = option.choices[0][1]
    return name.rsplit(", ", 1)[0] if "differences" in name else name


def draw_overview(surveys: Sequence[Advice], folder: Path) -> list[Path]:
    """Write fronts.png, fronts.csv and fronts.json; return their paths."""
    panels = [Panel(advice, need) for advice in surveys for need in advice.needs]
    panels = [panel for panel in panels if panel.options]
    rows = math.ceil(len(panels) / ACROSS)
    figure = Figure(figsize=(5.5 * ACROSS, 1 + 4.6 * rows), layout="constrained")
    grid = figure.subplots(rows, ACROSS, squeeze=False).ravel()
    for axes, panel in zip(grid, panels, strict=False):
        _draw_panel(axes, panel)
    for axes in grid[len(panels) :]:
        axes.set_visible(False)
    first = surveys[0]
    figure.suptitle(
        f"{plain(first.model)}: fronts of all formulations; ring: the advice for errors of {first.accuracy:g} (dashed)",
        fontsize=11,
    )
    path = in_format(folder / "fronts.png")
    save_picture(figure, path, 90)
    return [path, *write_table(tabulate_fronts(panels), folder, "fronts")]


def _draw_panel(axes: Axes, panel: Panel) -> None:
    prepare(axes)
    for k, (name, front) in enumerate(panel.fronts.items()):
        color = COLORS[k % len(COLORS)]
        own = [_place(o) for o in panel.options if name_series(o) == name]
        axes.plot(*zip(*own, strict=True), "o", color=color, markersize=3, alpha=0.25)
        x, y = zip(*map(_place, front), strict=True)
        axes.step(x, y, where="post", color=color, linewidth=1.2, marker="o", markersize=4, label=name)
    accuracy, best = panel.advice.accuracy, panel.advice.choose(panel.need)
    axes.axhline(accuracy, color="0.4", linewidth=0.8, linestyle="--")
    if best is not None:
        axes.plot(*_place(best), "o", markersize=13, markerfacecolor="none", markeredgecolor="black")
    text = "no measured option is so accurate" if best is None else f"advice: {_describe(best)}"
    unit = panel.options[0].unit
    axes.set_xlabel(f"{UNITS.get(unit, unit)}\n{textwrap.fill(text, LINE)}", fontsize=8)
    axes.set_ylabel("largest error", fontsize=8)
    space_ticks(axes)
    axes.set_title(f"{panel.advice.task}: {panel.need}", fontsize=9)
    axes.legend(fontsize=7)


def tabulate_fronts(panels: Sequence[Panel]) -> Table:
    """List the options on the fronts, and which one is advised."""
    columns = ("task", "need", "formulation", "option", "time", "unit", "error", "advised")
    note = "Options that no other option of the same formulation beats in both time and error."
    return Table("Fronts of all formulations", columns, tuple(_list_rows(panels)), note)


def _list_rows(panels: Sequence[Panel]) -> Iterator[tuple[Cell, ...]]:
    for panel in panels:
        best = panel.advice.choose(panel.need)
        for name, front in panel.fronts.items():
            shown = [*front, *([best] if best is not None and name_series(best) == name and best not in front else [])]
            for option in shown:
                numbers = (float(f"{option.price:.4g}"), option.unit, option.error)
                advised = "yes" if option is best else ""
                yield (panel.advice.task, panel.need, name, _describe(option), *numbers, advised)


def _find_front(options: Sequence[Option]) -> list[Option]:
    marks = [Mark("", str(k), option.cost, option.error) for k, option in enumerate(options)]
    return [options[int(mark.label)] for mark in find_front(marks)]


def _place(option: Option) -> tuple[float, float]:
    assert option.error is not None, "options of a panel have an error"
    return option.price, max(option.error, EXACT)


def _describe(option: Option) -> str:
    return ", ".join(f"{name} {value}" for name, value in option.choices)
