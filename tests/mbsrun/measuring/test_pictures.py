"""Labels of charts: each is beside its mark, and covers neither marks nor other labels."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.text import Annotation

from mbsrun.measuring.pictures import MARK, arrange_labels

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
