"""Charts: names stand beside the ends of their lines and cover nothing; colours stay apart, also on dark pages."""

from __future__ import annotations

import json
import re
from html import unescape
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.text import Annotation
from PIL import Image

from mbsgen.style import PALETTE
from mbsrun.measuring.explorer import render_explorer
from mbsrun.measuring.fronts import Dot, Panel
from mbsrun.measuring.pictures import MARK, PAGE, PHONE, choose_colors, draw_panels, lay_out, save_picture

METHODS = ("rk4", "dop853", "euler", "gauss", "radau-iia", "generalized-alpha", "variational", "lsoda", "bdf")


def draw(seed: int) -> Panel:
    """Draw eighteen methods of orders 1 to 9, and mark one setting."""
    rng, dots = np.random.default_rng(seed), []
    for order, method in enumerate(METHODS, 1):
        for formulation in ("EXP2", "IMPL"):
            start = 10 ** rng.uniform(-4, -2)
            for k in range(5):
                error = min(5.0, 10 ** rng.uniform(-1, 1) * 2.0 ** (-order * k))
                dots.append(Dot(f"{method} on {formulation}", f"step {k}", start * 2**k, error, "", f"repeat {k}"))
    choice = min((d for d in dots if d.place[1] < 1e-6), key=lambda d: d.place)
    return Panel("Which method?", tuple(dots), "time", "largest error", "s", 1e-6, choice, floor=1e-13)


@pytest.mark.parametrize("size", [PAGE, PHONE], ids=["page", "phone"])
@pytest.mark.parametrize("seed", range(4))
def test_names_cover_nothing(seed: int, size: tuple[float, int]) -> None:
    """Most of seven names find a place; no text covers a dot, another text or a leader, or leaves the picture."""
    figure = lay_out("chart", [draw(seed), draw(seed + 10)], *size)
    figure.draw_without_rendering()
    whole = figure.bbox
    texts = [text.get_window_extent() for text in figure.texts]
    for axes in figure.axes:
        names = [t for t in axes.texts if isinstance(t, Annotation) and t.get_gid() == "name"]
        assert len(names) >= 6  # of nine: seven names, the direction, and the accuracy that is asked for
        boxes = [name.get_window_extent() for name in names]
        dots = [axes.transData.transform(x.get_xydata())[0] for x in axes.lines if x.get_marker() == "o"]
        half = MARK / 2 - 0.5
        leaders = [x.arrow_patch for x in axes.texts if isinstance(x, Annotation) and x.arrow_patch is not None]
        for leader in leaders:
            path = leader.get_path().interpolated(60).vertices  # in points of the figure, as it is laid out
            hit = [box for box in boxes if ((path > box.min + 0.1) & (path < box.max - 0.1)).all(axis=1).sum() > 4]
            assert not hit
        for k, box in enumerate(boxes):
            assert not any(box.overlaps(other) for other in [*boxes[:k], *texts])
            assert whole.x0 <= box.x0 < box.x1 <= whole.x1
        for name, box in zip(names, boxes, strict=True):
            if "better" not in name.get_text() and "asked" not in name.get_text():
                hit = [(x, y) for x, y in dots if box.x0 - half < x < box.x1 + half and box.y0 < y < box.y1]
                assert not hit
    assert all(whole.x0 <= box.x0 < box.x1 <= whole.x1 and whole.y0 <= box.y0 for box in texts)
    assert not any(a.overlaps(b) for k, a in enumerate(texts) for b in texts[:k])


def test_colours_of_series_stay_apart_in_few_colours(tmp_path: Path) -> None:
    """A PNG has the colours of all series, to a few steps of 255, however small their marks are."""
    figure = Figure(figsize=(6, 4))
    axes = figure.subplots()
    for k, color in enumerate(PALETTE):
        axes.plot(1.5 + k, 5.5, marker="o", markersize=4, color=color)
    save_picture(figure, tmp_path / "chart.png", dpi=90)
    with Image.open(tmp_path / "chart.png") as picture:
        found = np.array([color for _, color in picture.convert("RGB").getcolors(2**20) or []])
    for color in PALETTE:
        expected = [int(color[i : i + 2], 16) for i in (1, 3, 5)]
        assert np.abs(found - expected).max(axis=1).min() <= 10


def test_a_picture_has_an_svg_with_dark_colours_and_a_narrow_one(tmp_path: Path) -> None:
    """Panels without any good setting are drawn, too."""
    failed = Panel("Which?", (Dot("rk4", "step 1", None, None, "it stopped"),), "time", "error", asked=1e-6)
    paths = draw_panels("chart", [draw(0), failed], tmp_path, "chart")
    assert [path.name for path in paths] == ["chart.png", "chart.svg", "chart_narrow.png"]
    svg = paths[1].read_text(encoding="utf-8")
    assert "@media (prefers-color-scheme: dark)" in svg
    again = draw_panels("chart", [draw(0), failed], tmp_path, "again")[1].read_text(encoding="utf-8")
    assert again == svg


def test_the_page_holds_every_setting_with_its_command() -> None:
    """Names of files are text there, whatever they contain."""
    panel = draw(1)
    evil = Dot("<script>alert(1)</script>", "it's", 1.0, 1e-3, "", "mbsrun simulate 'a b.yaml'")
    page = render_explorer("a <b> chart", [panel, Panel("Which?", (evil,), "time", "error")])
    assert "<script>alert" not in page
    assert not re.search(r'(src|href)="(?!#)', page)
    told = [json.loads(unescape(x)) for x in re.findall(r'data-dot="([^"]*)"', page)]
    assert len(told) == len(panel.dots) + 1
    assert told[-1] == ["<script>alert(1)</script>, it's", "1 s, error 1e-3", "mbsrun simulate 'a b.yaml'"]


def test_known_methods_have_the_same_colours_in_all_panels() -> None:
    """Also where one of them is missing; other methods have other colours."""
    known = ("IMPL", "EXP2")
    first, second = choose_colors(["EXP2", "ABA", "IMPL"], known), choose_colors(["EXP2", "RNEA"], known)
    assert first == {"IMPL": PALETTE[0], "EXP2": PALETTE[1], "ABA": PALETTE[2]}
    assert second == {"EXP2": PALETTE[1], "RNEA": PALETTE[2]}
