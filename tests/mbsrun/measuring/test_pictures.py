"""Charts: each label is beside its mark, and covers neither marks nor other labels; colours stay apart."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.text import Annotation
from PIL import Image

from mbsgen.style import PALETTE
from mbsrun.measuring.pictures import MARK, arrange_labels, save_picture

NEAREST = 40  # pixels between a mark and its label, at most


def draw(places: list[tuple[float, float]], labels: list[str]) -> tuple[Figure, Axes]:
    """Draw marks, the first ones with labels."""
    figure = Figure(figsize=(6, 4), layout="constrained")
    axes = figure.subplots()
    axes.set_xlim(0, 10)
    axes.set_ylim(0, 10)
    for x, y in places:
        axes.plot(x, y, marker="o", markersize=4, linestyle="")
    for place, label in zip(places, labels, strict=False):
        axes.annotate(label, place, (0, 0), textcoords="offset points", fontsize=6)
    return figure, axes


@pytest.mark.parametrize("seed", range(5))
def test_labels_cover_nothing(seed: int) -> None:
    """Of forty marks, two of them in corners, most labels of twelve find a place; none covers a mark or a label."""
    rng = np.random.default_rng(seed)
    places = [(0.1, 0.1), (9.9, 9.9), *((float(x), float(y)) for x, y in rng.uniform(0.1, 9.9, (38, 2)))]
    figure, axes = draw(places, [f"joint {k} locked, {3 * k}%" for k in range(12)])
    arrange_labels(figure)
    notes = [text for text in axes.texts if isinstance(text, Annotation)]
    boxes = [note.get_window_extent() for note in notes]
    marks = axes.transData.transform(places)
    half = MARK * figure.dpi / 144
    assert len(notes) > 9
    for k, (note, box) in enumerate(zip(notes, boxes, strict=True)):
        assert not any(box.overlaps(other) for other in boxes[:k])
        assert not [(x, y) for x, y in marks if box.x0 - half < x < box.x1 + half and box.y0 - half < y < box.y1 + half]
        x, y = axes.transData.transform(note.xy)
        assert max(box.x0 - x, x - box.x1, box.y0 - y, y - box.y1) < NEAREST
        assert axes.get_window_extent().count_contains(box.corners()) == 4


def test_a_label_without_a_place_is_left_out() -> None:
    """Marks everywhere leave room for no label."""
    grid = [(float(x), float(y)) for x in np.linspace(0, 10, 60) for y in np.linspace(0, 10, 60)]
    figure, axes = draw(grid, ["q1 locked"])
    arrange_labels(figure)
    assert not axes.texts


def test_colours_of_series_stay_apart_in_few_colours(tmp_path: Path) -> None:
    """A PNG has the colours of all series, to a few steps of 255, however small their marks are."""
    figure, axes = draw([(float(k % 10), float(k // 10)) for k in range(100)], [f"joint {k} locked" for k in range(40)])
    for k, color in enumerate(PALETTE):
        axes.plot(1.5 + k, 5.5, marker="o", markersize=4, color=color)
    save_picture(figure, tmp_path / "chart.png", dpi=90)
    with Image.open(tmp_path / "chart.png") as picture:
        found = np.array([color for _, color in picture.convert("RGB").getcolors(2**20) or []])
    for color in PALETTE:
        expected = [int(color[i : i + 2], 16) for i in (1, 3, 5)]
        assert np.abs(found - expected).max(axis=1).min() <= 10
