"""Draw the stability of a model: a block for each sweep, a column for each formulation, and a field for each number.

A field holds the digits that are right, or the word "status". Its colour repeats this, for readers of any colour sight.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, fields
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from mbsgen.style import FORMATS, in_format, mix, styled
from mbsrun.measuring.fronts import write_error
from mbsrun.measuring.pictures import (
    EDGE,
    GAP,
    INK,
    PAGE,
    PHONE,
    QUIET,
    ROW,
    SIZE,
    plain,
    save_picture,
    wrap,
    write_svg,
)
from mbsrun.measuring.sections import NARROW, Table, write_table
from studies.laboratory.stability import Spot

TITLE = "digits that are right; “status”: the kernel, or the method, says that it gives up"
GOOD, FEW, BAD, STATUS = "#bfe3d6", "#fbe3b0", "#f3b59a", "#dfe4ea"
DARKER = {color: mix(color, "#12171d", 0.6) for color in (GOOD, FEW, BAD, STATUS)}  # of fields, on a dark page
ENOUGH, LEAST = 9, 3  # digits
LINE = 1.5 * ROW  # points, of a row of fields
LABELS = 0.75  # inches, of numbers


@styled
def draw_stability(model: str, spots: Sequence[Spot], folder: Path) -> list[Path]:
    """Write stability.png with its SVG and a narrow one, stability.csv and stability.json; return their paths."""
    columns = tuple(field.name for field in fields(Spot))
    rows = tuple((*(asdict(spot)[name] for name in columns), spot.digits) for spot in spots)
    note = "error: the largest over the states of a number; empty where a status takes its place"
    paths = write_table(Table(f"{model}: stability", (*columns, "digits"), rows, note), folder, "stability")
    path, narrow = in_format(folder / "stability.png"), folder / f"stability{NARROW}.png"
    figure = _lay_out(f"{model}: {TITLE}", spots, *PAGE)
    save_picture(figure, path, 150)
    if path.suffix != f".{FORMATS[0]}":
        return [*paths, path]
    path.with_suffix(".svg").write_text(write_svg(figure, DARKER), encoding="utf-8")
    save_picture(_lay_out(f"{model}: {TITLE}", spots, *PHONE), narrow, 200)
    return [*paths, path, path.with_suffix(".svg"), narrow]


def _lay_out(title: str, spots: Sequence[Spot], width: float, columns: int) -> Figure:
    """Place blocks side by side, `columns` in a row; all sizes are in inches."""
    sweeps = list(dict.fromkeys(spot.sweep for spot in spots))
    blocks = [[spot for spot in spots if spot.sweep == sweep] for sweep in sweeps]
    across = (width - 2 * EDGE - (columns - 1) * GAP) / columns
    lines = wrap(title, width - 2 * EDGE, "bold")
    rows = [blocks[k : k + columns] for k in range(0, len(blocks), columns)]
    heights = [max(_measure(block, across) for block in row) + GAP for row in rows]
    height = EDGE + len(lines) * ROW / 72 + GAP + sum(heights)
    figure = Figure(figsize=(width, height), facecolor="#ffffff")
    figure.set_dpi(72)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set_axis_off()
    axes.set_xlim(0, width)
    axes.set_ylim(height, 0)
    for k, line in enumerate(lines):
        _write(axes, line, EDGE, EDGE + (k + 0.5) * ROW / 72, weight="bold")
    top = EDGE + len(lines) * ROW / 72 + GAP / 2
    for row, tall in zip(rows, heights, strict=True):
        for k, block in enumerate(row):
            _draw_block(axes, block, EDGE + k * (across + GAP), top, across)
        top += tall
    return figure


def _measure(block: Sequence[Spot], across: float) -> float:
    numbers = dict.fromkeys(spot.number for spot in block)
    return (_head(block, across) + len(numbers) + 1) * LINE / 72


def _head(block: Sequence[Spot], across: float) -> int:
    """Return the lines of the longest name of a column."""
    ways = list(dict.fromkeys(spot.way for spot in block))
    return max(len(wrap(way, (across - LABELS) / len(ways))) for way in ways)


def _draw_block(axes: Axes, block: Sequence[Spot], left: float, top: float, across: float) -> None:
    ways = list(dict.fromkeys(spot.way for spot in block))
    numbers = list(dict.fromkeys(spot.number for spot in block))
    wide, tall, head = (across - LABELS) / len(ways), LINE / 72, _head(block, across)
    _write(axes, block[0].sweep, left, top + tall / 2)
    for column, way in enumerate(ways):
        for k, line in enumerate(wrap(way, wide)):
            middle = left + LABELS + (column + 0.5) * wide
            _write(axes, line, middle, top + (1.5 + k) * tall, ha="center", color=QUIET)
    for row, number in enumerate(numbers):
        y = top + (1 + head + row) * tall
        _write(axes, write_error(number), left + LABELS - 0.08, y + tall / 2, ha="right", color=QUIET)
        for spot in (x for x in block if x.number == number):
            x = left + LABELS + ways.index(spot.way) * wide
            color, text = _judge(spot)
            axes.fill_between([x + 0.02, x + wide - 0.02], y + 0.02, y + tall - 0.02, color=color, linewidth=0)
            _write(axes, text, x + wide / 2, y + tall / 2, ha="center")


def _judge(spot: Spot) -> tuple[str, str]:
    digits = spot.digits
    if digits is None:
        return STATUS, "status"
    color = GOOD if digits >= ENOUGH else FEW if digits >= LEAST else BAD
    return color, str(digits)


def _write(
    axes: Axes, text: str, x: float, y: float, ha: str = "left", color: str = INK, weight: str = "normal"
) -> None:
    style = {"ha": ha, "va": "center", "color": color, "weight": weight}
    axes.text(x, y, plain(text), fontsize=SIZE, fontdict=style)
