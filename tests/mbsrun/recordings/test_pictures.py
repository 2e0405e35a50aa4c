"""Panels of lines over time: what is drawn, and how it is named."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from mbsgen.style import PALETTE
from mbsrun.recordings import pictures
from mbsrun.recordings.pictures import Panel, plot_panels

TIMES = np.array([0.0, 0.5, 1.0])


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> list[tuple[Figure, Path]]:
    """Keep figures in place of writing them."""
    kept: list[tuple[Figure, Path]] = []
    monkeypatch.setattr(pictures, "save_plot", lambda figure, path: kept.append((figure, path)))
    return kept


def test_panels_with_lines_stand_above_each_other(drawn: list[tuple[Figure, Path]]) -> None:
    """Dots have the colour of the line of their name; the lowest panel names the time."""
    lines = {"a": TIMES, "_b$": 2 * TIMES}
    panels = [
        Panel("x [m]", lines, {"_b$": 3 * TIMES, "other": TIMES}),
        Panel("nothing", {}, {"a": TIMES}),
        Panel("y [m]", {"c": TIMES}, {}),
    ]
    plot_panels(TIMES, panels, "_a $title", Path("place.png"))
    ((figure, path),) = drawn
    assert path == Path("place.png")
    assert figure.get_size_inches().tolist() == pytest.approx([8, 0.8 + 2 * 2.6])
    upper, lower = figure.axes
    assert [axes.get_ylabel() for axes in (upper, lower)] == ["x [m]", "y [m]"]
    assert [axes.get_xlabel() for axes in (upper, lower)] == ["", "time [s]"]
    first, second, dots = upper.lines
    assert [line.get_color() for line in upper.lines] == [PALETTE[0], PALETTE[1], PALETTE[1]]
    assert np.array_equal(second.get_ydata(), 2 * TIMES)
    assert np.array_equal(dots.get_ydata(), 3 * TIMES)
    assert (dots.get_marker(), dots.get_markersize()) == (".", 2)
    assert (first.get_label(), second.get_label()) == ("a", "\u200b_b\\$")
    assert figure.get_suptitle() == "\u200b_a \\$title"
    assert upper.get_shared_x_axes().joined(upper, lower)
    legend = upper.get_legend()
    assert legend is not None
    assert not legend.get_frame_on()
    corner = upper.transAxes.inverted().transform(legend.get_bbox_to_anchor().p0)
    assert corner == pytest.approx([1.0, 1.0])  # beside the panel
    assert upper.xaxis.get_gridlines()[0].get_alpha() == 0.3


def test_legends_name_a_dozen_lines(drawn: list[tuple[Figure, Path]]) -> None:
    """More lines repeat colours, and have no legend."""
    for count in (12, 13):
        plot_panels(TIMES, [Panel("x", {str(k): k * TIMES for k in range(count)}, {})], "t", Path("p"))
    few, many = (figure.axes[0] for figure, _ in drawn)
    assert few.get_legend() is not None
    assert many.get_legend() is None
    assert many.lines[len(PALETTE)].get_color() == PALETTE[0]
