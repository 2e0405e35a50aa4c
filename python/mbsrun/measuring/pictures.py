"""Draw panels of work against error: a line for each method with its name at its end, the front, the advised setting.

Work and error are logarithmic; downwards and left is better. The front is a quiet band. At most seven methods have a
colour and a name, and the others are grey. All text has one size. Names cover neither marks, lines nor each other, at
the width of a page and of a phone. An SVG has its own colours where a reader's page is dark.
"""

from __future__ import annotations

import io
import itertools
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.textpath import TextPath
from matplotlib.ticker import FixedFormatter, FixedLocator, NullLocator
from numpy.typing import NDArray
from PIL import Image

from mbsgen.style import FORMATS, PALETTE, in_format, mix, save_figure, styled
from mbsrun.measuring.fronts import Dot, Panel, write_error, write_work
from mbsrun.measuring.sections import NARROW

Array = NDArray[np.float64]
Covered = tuple[float, float, float, float]  # left, bottom, right, top, in points of the figure
Boxes = NDArray[np.float64]  # (N, 4)

SHADES = 255  # colours of a picture
SIZE = 9.0  # points, of all text
HINTED = 1.05  # letters are up to that wider where they are fitted to pixels
ROW = 1.32 * SIZE  # of a line of text
PAGE, PHONE = (9.0, 2), (3.9, 1)  # inches across, and panels in a row
HEIGHT, EDGE, LEFT, GAP = 2.55, 0.12, 0.5, 0.26  # inches: of axes, around everything, of labels of errors, of panels
INK, QUIET, FAINT, SHADE = "#1d2733", "#5d6b7a", "#c3ccd6", "#e9edf1"
DARK = {INK: "#e4eaf1", QUIET: "#9fadbb", FAINT: "#4a5865", SHADE: "#252f39", "#ffffff": "#12171d"}
MARK = 5.0  # points across a dot
RING = 12.0
NONE = 1e-35  # smaller errors stand there
FINEST = ((1, 1.2, 1.5, 2, 2.5, 3, 4, 5, 6, 8), (1, 1.5, 2, 3, 5, 7), (1, 2, 5), (1, 3), (1,))  # labels of a decade
RINGS = (3.0, 8.0, 14.0, 20.0, 28.0, 38.0, 50.0, 65.0, 85.0, 110.0)  # points from a line's end to its name
WAYS = tuple(np.array([math.cos(x), math.sin(x)]) for x in np.deg2rad((0, 45, -45, 90, -90, 135, -135, 180, 20, -20)))
LEADER = 12.0  # points from which on a thin line leads to a name
BESIDE = 1.5  # points around a name that are free


def save_picture(figure: Figure, path: Path, dpi: int) -> None:
    """Write a figure; a PNG in few colours, with a third of the bytes. The same figure gives the same bytes."""
    if path.suffix != ".png":
        save_figure(figure, path)
        return
    whole = io.BytesIO()
    figure.savefig(whole, format="png", dpi=dpi)
    with Image.open(whole) as picture:
        reduce_colors(picture.convert("RGB")).save(path, optimize=True)


def reduce_colors(picture: Image.Image) -> Image.Image:
    """Keep the SHADES most frequent colours of a picture; each other colour becomes the nearest one of these."""
    points = np.asarray(picture, dtype=np.int64).reshape(-1, 3)
    codes, place, counts = np.unique(points @ (65536, 256, 1), return_inverse=True, return_counts=True)
    colors = np.stack((codes // 65536, codes // 256 % 256, codes % 256), axis=1)
    kept = colors[np.lexsort((codes, -counts))[:SHADES]]
    nearest = np.array([((kept - color) ** 2).sum(axis=1).argmin() for color in colors], dtype=np.uint8)
    reduced = Image.fromarray(nearest[place].reshape(picture.height, picture.width), "P")
    reduced.putpalette(kept.astype(np.uint8).tobytes())
    return reduced


@styled
def draw_panels(title: str, panels: Sequence[Panel], folder: Path, name: str) -> list[Path]:
    """Write the panels as one picture, and return its paths.

    A PNG has an SVG beside it, and NAME_narrow.png for a phone.
    """
    path = in_format(folder / f"{name}.png")
    if path.suffix != f".{FORMATS[0]}":
        save_picture(lay_out(title, panels, *PAGE), path, 150)
        return [path]
    whole, narrow = lay_out(title, panels, *PAGE), folder / f"{name}{NARROW}.png"
    save_picture(whole, path, 150)
    path.with_suffix(".svg").write_text(write_svg(whole), encoding="utf-8")
    save_picture(lay_out(title, panels, *PHONE), narrow, 200)
    return [path, path.with_suffix(".svg"), narrow]


@styled
def draw_alone(panel: Panel, prefix: str) -> str:
    """Return a panel of a phone's width as SVG, without its sentences; dot k has the id PREFIXk."""
    return write_svg(lay_out("", [panel], *PHONE, prefix=prefix))


def write_svg(figure: Figure, more: Mapping[str, str] = MappingProxyType({})) -> str:
    """Return a figure as SVG with separate colours for a dark page; `more` gives further ones."""
    text = io.StringIO()
    save_svg(figure, text)
    return _add_dark(text.getvalue(), more)


@styled
def save_svg(figure: Figure, file: io.StringIO) -> None:
    """Write a figure as SVG; equal figures have equal bytes."""
    figure.savefig(file, format="svg", metadata={"Date": None, "Creator": None})


def _add_dark(svg: str, more: Mapping[str, str]) -> str:
    """Add rules for a dark page: each ink of the chart has its counterpart, and colours of methods are lightened."""
    pairs = {**DARK, **more} | {color: mix(color, "#ffffff", 0.25) for color in PALETTE}
    pairs |= {_darken(color): mix(color, "#ffffff", 0.45) for color in PALETTE}
    rules = [
        f'[style*="{kind}: {light}"] {{ {kind}: {dark} !important }}'
        for light, dark in pairs.items()
        for kind in ("fill", "stroke")
        if f"{kind}: {light}" in svg
    ]
    style = "<style>@media (prefers-color-scheme: dark) {\n" + "\n".join(rules) + "\n}</style>\n"
    place = svg.index("<defs>")
    return svg[:place] + style + svg[place:]


@dataclass(frozen=True)
class _Cell:
    """A panel with its sentences in lines, and the sizes that follow."""

    panel: Panel
    head: tuple[tuple[str, str, str], ...]  # text, color, weight
    foot: tuple[str, ...]

    @property
    def above(self) -> float:
        """Return the height of the lines above the axes [in]."""
        return len(self.head) * ROW / 72 + 0.06

    @property
    def below(self) -> float:
        """Return the height of the lines below the axes [in]; the first are the labels of ticks."""
        return (len(self.foot) + 1) * ROW / 72 + 0.14


def lay_out(title: str, panels: Sequence[Panel], width: float, columns: int, prefix: str = "") -> Figure:
    """Return a figure of panels, `width` inches across; without a title, panels have no sentences above them."""
    columns = min(columns, max(1, len(panels)))
    across = (width - 2 * EDGE - (columns - 1) * GAP) / columns
    cells = [_write_cell(panel, across, is_bare=not title) for panel in panels]
    rows = [cells[k : k + columns] for k in range(0, len(cells), columns)]
    heights = [max(c.above for c in row) + HEIGHT + max(c.below for c in row) + GAP for row in rows]
    titles = wrap(title, width - 2 * EDGE, "bold") if title else []
    top = EDGE + len(titles) * ROW / 72 + (0.14 if titles else 0)
    height = top + sum(heights) - GAP + EDGE
    figure = Figure(figsize=(width, height), facecolor="#ffffff")
    figure.set_dpi(72)  # so that pixels are points
    for k, line in enumerate(titles):
        _write(figure, line, EDGE, EDGE + k * ROW / 72, INK, "bold")
    for row, tall in zip(rows, heights, strict=True):
        above = max(c.above for c in row)
        for k, cell in enumerate(row):
            _draw_cell(figure, cell, (EDGE + k * (across + GAP), top + above, across), prefix)
        top += tall
    return figure


def wrap(text: str, width: float, weight: str = "normal") -> list[str]:
    """Break a text into lines of at most `width` inches; a longer word stays whole."""
    lines: list[str] = []
    for word in text.split():
        longer = f"{lines[-1]} {word}" if lines else word
        if lines and measure(longer, weight) <= 72 * width:
            lines[-1] = longer
        else:
            lines.append(word)
    return lines


@cache
def measure(text: str, weight: str = "normal") -> float:
    """Return the width of a text in points."""
    if not text.strip():
        return 0.0
    path = TextPath((0, 0), text.replace("$", r"\$"), size=SIZE, prop=FontProperties(weight=weight))
    return HINTED * float(path.get_extents().x1)


def plain(name: str) -> str:
    """Escape a name, so that it is not read as a formula."""
    return name.replace("$", r"\$")


def _write_cell(panel: Panel, across: float, *, is_bare: bool) -> _Cell:
    sentences = () if is_bare else ((panel.question, QUIET, "normal"), (panel.headline, INK, "bold"))
    if panel.advice and not is_bare:
        sentences = (*sentences, (f"◉ {panel.advice}" if panel.choice else panel.advice, INK, "normal"))
    head = [(line, color, weight) for text, color, weight in sentences for line in wrap(text, across, weight)]
    head += [(line, QUIET, "normal") for line in wrap(f"↓ {panel.error}", across)]
    foot = [line for text in (panel.across, panel.note) for line in wrap(text, across - LEFT)]
    return _Cell(panel, tuple(head), tuple(foot))


def _write(figure: Figure, text: str, left: float, top: float, color: str, weight: str = "normal") -> None:
    """Write a line of text, its corner given in inches from the left and the top."""
    width, height = figure.get_size_inches()
    place = (left / width, 1 - top / height)
    figure.text(*place, plain(text), color=color, weight=weight, fontsize=SIZE, ha="left", va="top")


def _draw_cell(figure: Figure, cell: _Cell, place: tuple[float, float, float], prefix: str) -> None:
    left, top, across = place
    width, height = figure.get_size_inches()
    for k, (line, color, weight) in enumerate(cell.head):
        _write(figure, line, left, top - cell.above + k * ROW / 72, color, weight)
    frame = (left + LEFT) / width, 1 - (top + HEIGHT) / height, (across - LEFT) / width, HEIGHT / height
    axes = figure.add_axes(frame)
    for k, line in enumerate(cell.foot):
        _write(figure, line, left + LEFT, top + HEIGHT + 0.1 + (k + 1) * ROW / 72, QUIET)
    _draw_axes(axes, cell.panel, prefix)


def _draw_axes(axes: Axes, panel: Panel, prefix: str) -> None:
    axes.set_xscale("log")
    axes.set_yscale("log")
    if not panel.good:
        axes.text(0.5, 0.5, "no measured setting ended", transform=axes.transAxes, ha="center", color=QUIET)
        axes.set_xticks([])
        axes.set_yticks([])
        return
    place = _find_places(panel)
    _set_limits(axes, panel, place)
    broken = _draw_frame(axes, panel)
    lines = {name: [place(dot) for dot in panel.join(dots)] for name, dots in panel.lines.items()}
    front = [place(dot) for dot in panel.front]
    if front:
        axes.plot(*zip(*front, strict=True), color=SHADE, linewidth=10, solid_joinstyle="round", zorder=0.5)
    taken = [*(box for name in lines for box in _cover(axes, lines[name], map(place, panel.lines[name])))]
    if panel.choice is not None:
        axes.plot(*place(panel.choice), "o", markersize=RING, markerfacecolor="none", markeredgecolor=INK, zorder=4)
        taken.append(_box(axes, place(panel.choice), RING / 2))
    quiet = _write_quiet(axes, panel, taken)
    taken += [*broken, *quiet]
    wanted = panel.choose_lines()
    colors = choose_colors([name for name in lines if name in wanted], panel.known)
    named = _place_names(axes, {name: lines[name] for name in wanted}, colors, np.array(taken), quiet)
    numbers = {id(dot): k for k, dot in enumerate(panel.dots)}
    for name, line in lines.items():
        color, order = (colors[name], 2) if name in named else (FAINT, 1)
        axes.plot(*zip(*line, strict=True), color=color, linewidth=0.7 * order, zorder=order)
        for dot in panel.lines[name]:
            size = MARK if place(dot) in line else 0.6 * MARK
            (drawn,) = axes.plot(*place(dot), "o", color=color, markersize=size, zorder=order, markeredgewidth=0)
            drawn.set_gid(f"{prefix}{numbers[id(dot)]}" if prefix else None)


def choose_colors(names: Sequence[str], known: Sequence[str]) -> dict[str, str]:
    """Return colours by name: the first ones of the known methods, whether they are there or not, then the others."""
    others = [name for name in names if name not in known]
    return {name: PALETTE[k % len(PALETTE)] for k, name in enumerate((*known, *others)) if name in names}


def _find_places(panel: Panel) -> Callable[[Dot], tuple[float, float]]:
    """Return the function that places a dot: errors of 0 stand below the others."""
    least = _find_least(panel)
    return lambda dot: (dot.place[0], min(max(dot.place[1], least), panel.worst))


def _find_least(panel: Panel) -> float:
    """Return the place of errors of 0: two decades below the others, and below what is asked."""
    known = [dot.place[1] for dot in panel.good if dot.place[1] > NONE] + ([panel.asked] if panel.asked else [])
    return min(known, default=1e-15) / 100


def _set_limits(axes: Axes, panel: Panel, place: Callable[[Dot], tuple[float, float]]) -> None:
    """Leave room for names, and show the accuracy that is asked for."""
    works, errors = (list(x) for x in zip(*map(place, panel.good), strict=True))
    works += [panel.whole] if panel.whole else []
    errors += [panel.asked] if panel.asked else []
    for low, high, room, put in (
        (min(works), max(works), (0.2, 0.35), axes.set_xlim),
        (min(errors), max(errors), (0.2, 0.2), axes.set_ylim),
    ):
        span = max(math.log(high / low), 0.5)
        put(low * math.exp(-room[0] * span), high * math.exp(room[1] * span))


def _draw_frame(axes: Axes, panel: Panel) -> list[Covered]:
    """Draw ticks, grid, the accuracy that is asked for and of the reference; return the boxes of the broken lines."""
    axes.tick_params(colors=QUIET, labelsize=SIZE, length=3)
    for side in ("left", "bottom"):
        axes.spines[side].set_color(FAINT)
    width = float(axes.bbox.width)
    _set_ticks(axes, panel, width)
    axes.grid(color=SHADE, linewidth=0.6)
    if panel.floor is not None:
        axes.axhspan(axes.get_ylim()[0] / 10, panel.floor, color=SHADE, zorder=0, alpha=0.7)
    frame, boxes = axes.bbox, []
    if panel.asked is not None:
        axes.axhline(panel.asked, color=QUIET, linewidth=0.8, linestyle=(0, (4, 3)), zorder=1)
        y = float(axes.transData.transform((1.0, panel.asked))[1])
        boxes.append((frame.x0, y - 1, frame.x1, y + 1))
    for place in ([panel.whole] if panel.whole is not None else []) + list(panel.marks):
        axes.axvline(place, color=QUIET, linewidth=0.8, linestyle=(0, (4, 3)), zorder=1)
        x = float(axes.transData.transform((place, 1.0))[0])
        boxes.append((x - 1, frame.y0, x + 1, frame.y1))
    return boxes


def _write_quiet(axes: Axes, panel: Panel, taken: Sequence[Covered]) -> list[Covered]:
    """Write the direction in which all is better, and the meaning of both broken lines; return the boxes of the texts.

    A text stands at the first place where it covers nothing, or else at its usual place.
    """
    frame = axes.bbox
    wanted = [(panel.better, [(frame.x0 + 3, frame.y0 + 2)])]
    if panel.asked is not None:
        text, y = f"asked: {write_error(panel.asked)}", float(axes.transData.transform((1.0, panel.asked))[1])
        right = frame.x1 - 3 - measure(text)
        places = [(x, z) for x in (right, frame.x0 + 3, (right + frame.x0) / 2) for z in (y + 3, y - 3 - ROW)]
        wanted.append((text, places))
    marks = {panel.whole: "whole model"} if panel.whole is not None else panel.marks
    for place, text in marks.items():
        x = float(axes.transData.transform((place, 1.0))[0])
        left = x + 4 if x + 4 + measure(text) < frame.x1 else x - 4 - measure(text)
        wanted.append((text, [(left, z) for z in (frame.y1 - 2 - ROW, frame.y0 + 2)]))
    found: list[Covered] = []
    for text, places in wanted:
        boxes = [(x, y, x + measure(text), y + ROW) for x, y in places]
        around = np.array([*taken, *found]).reshape(-1, 4)
        box = next((b for b in boxes if not _count_covered(np.array(b), around)), boxes[0])
        style: dict[str, Any] = {"color": QUIET, "fontsize": SIZE, "ha": "left", "va": "bottom"}
        axes.annotate(text, box[:2], xycoords="figure points", **style).set_gid("name")
        found.append(box)
    return found


def _set_ticks(axes: Axes, panel: Panel, width: float) -> None:
    works = _choose_ticks(*axes.get_xlim(), most=max(2, int(width / 58)))
    axes.xaxis.set_major_locator(FixedLocator(works))
    axes.xaxis.set_major_formatter(FixedFormatter([write_work(x, panel.unit) for x in works]))
    errors, least = _choose_ticks(*axes.get_ylim(), most=6), _find_least(panel)
    labels = {x: panel.write_upwards(x) for x in errors}
    if any(dot.place[1] <= NONE for dot in panel.good):
        labels = {x: label for x, label in labels.items() if x > 10 * least} | {least: "none"}
    axes.yaxis.set_major_locator(FixedLocator([*labels]))
    axes.yaxis.set_major_formatter(FixedFormatter([*labels.values()]))
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_minor_locator(NullLocator())


def _choose_ticks(low: float, high: float, most: int) -> list[float]:
    """Return round numbers within a range, at most `most`: within decades, or every second, third, … power of ten."""
    decades = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    for shares in FINEST:
        found = [s * 10.0**k for k in decades for s in shares if low <= s * 10.0**k <= high]
        if len(found) <= most:
            return found or [math.sqrt(low * high)]
    for step in range(2, len(decades) + 1):
        found = [10.0**k for k in decades if k % step == 0 and low <= 10.0**k <= high]
        if len(found) <= most:
            return found
    return [math.sqrt(low * high)]


def _box(axes: Axes, place: tuple[float, float], half: float) -> Covered:
    x, y = axes.transData.transform(place)
    return x - half, y - half, x + half, y + half


def _cover(axes: Axes, line: Sequence[tuple[float, float]], dots: Iterable[tuple[float, float]]) -> Iterator[Covered]:
    """Yield the boxes that a line and its dots cover."""
    for dot in dots:
        yield _box(axes, dot, MARK / 2)
    points = axes.transData.transform(np.array(line))
    for start, end in itertools.pairwise(points):
        for share in np.linspace(0, 1, 2 + int(np.hypot(*(end - start)) / 2)):
            x, y = start + share * (end - start)
            yield x - 1, y - 1, x + 1, y + 1


def _place_names(
    axes: Axes,
    lines: Mapping[str, list[tuple[float, float]]],
    colors: Mapping[str, str],
    taken: Boxes,
    texts: Sequence[Covered],
) -> set[str]:
    """Write the name of each line beside its end; a thin line, which crosses no text, leads to one further off.

    Return the names that found a place where they cover nothing.
    """
    named, written = set(), [np.array(text) for text in texts]
    for name, line in lines.items():
        ends = [axes.transData.transform(place) for place in dict.fromkeys((line[-1], line[0]))]
        text = "\n".join(wrap(name, axes.bbox.width / 72 / 2.2))
        size = np.array([max(map(measure, text.split("\n"))) + 1, ROW * (text.count("\n") + 1)])
        room = _find_room(ends, size, taken, written, axes)
        if room is None:
            continue
        box, end, distance = room
        taken = np.vstack((taken, [box]))
        written.append(box)
        named.add(name)
        if distance >= LEADER:
            near = np.clip(end, box[:2], box[2:])
            _draw_leader(axes, end, near, colors[name])
            taken = np.vstack((taken, [*_cover_leader(end, near)]))
        axes.annotate(
            plain(text),
            ((box[0] + box[2]) / 2, (box[1] + box[3]) / 2),
            xycoords="figure points",
            ha="center",
            va="center",
            color=_darken(colors[name]),
            fontsize=SIZE,
            linespacing=ROW / SIZE / 1.2,
        ).set_gid("name")
    return named


def _cover_leader(end: Array, near: Array) -> Iterator[Covered]:
    """Yield the boxes that a leader covers."""
    for share in np.linspace(0, 1, 2 + int(np.hypot(*(near - end)) / 2)):
        x, y = end + share * (near - end)
        yield x - 1, y - 1, x + 1, y + 1


def _draw_leader(axes: Axes, end: Array, near: Array, color: str) -> None:
    style = {"arrowstyle": "-", "color": color, "linewidth": 0.6, "shrinkA": 2, "shrinkB": 1}
    places = (float(near[0]), float(near[1])), (float(end[0]), float(end[1]))
    axes.annotate("", *places, xycoords="figure points", textcoords="figure points", arrowprops=style)


def _find_room(
    ends: Sequence[Array], size: Array, taken: Boxes, names: Sequence[Array], axes: Axes
) -> tuple[Array, Array, float] | None:
    """Return the nearest box of a size that covers nothing, the end of the line it belongs to, and its distance.

    A leader to it crosses none of the names.
    """
    frame = axes.bbox
    lower, upper = np.array([frame.x0 + 2, frame.y0 + 2]), np.array([frame.x1, frame.y1])
    for distance in RINGS:
        for end in ends[: 1 if distance < RINGS[2] else 2]:
            for way in WAYS:
                centre = end + way * (distance + MARK / 2) + np.sign(np.round(way, 3)) * size / 2
                box = np.concatenate((centre - size / 2, centre + size / 2))
                if (box[:2] < lower).any() or (box[2:] > upper).any() or _count_covered(box, taken):
                    continue
                leader = _cover_leader(end, np.clip(end, box[:2], box[2:])) if distance >= LEADER else ()
                if not any(_count_covered(np.array(part), np.array(names)) for part in leader):
                    return box, end, distance
    return None


def _count_covered(box: Array, taken: Boxes) -> int:
    if not len(taken):
        return 0
    apart = (
        (taken[:, 0] > box[2] + BESIDE)
        | (taken[:, 2] < box[0] - BESIDE)
        | (taken[:, 1] > box[3] + BESIDE)
        | (taken[:, 3] < box[1] - BESIDE)
    )
    return int((~apart).sum())


def _darken(color: str) -> str:
    """Return the colour of a name: as the line, with more contrast to a white page."""
    return mix(color, "#000000", 0.3)
