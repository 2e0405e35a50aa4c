"""Pictures in the style of the project are the ones that Matplotlib draws."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from mbsgen.style import DOTS, METADATA, save_figure, styled

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@pytest.mark.parametrize("layout", ["constrained", None])
def test_a_figure_that_is_laid_out_once_has_the_pixels_of_matplotlib(layout: str | None, tmp_path: Path) -> None:
    """Matplotlib lays a figure out by drawing it twice; and the figure has its layout and dots back."""
    from matplotlib.figure import Figure

    @styled
    def draw() -> Figure:
        figure = Figure(figsize=(3, 2), layout=layout)
        axes = figure.add_subplot(ylabel="a long label of values", title="title")
        figure.colorbar(axes.imshow([[1, 2], [3, 4000]]), ax=axes, label="values")
        return figure

    figure = draw()
    engine, dots = figure.get_layout_engine(), figure.dpi
    save_figure(figure, tmp_path / "once.png")
    assert (figure.get_layout_engine(), figure.dpi) == (engine, dots)
    styled(draw().savefig)(tmp_path / "twice.png", dpi=DOTS, metadata=dict(METADATA["png"]))
    assert (tmp_path / "once.png").read_bytes() == (tmp_path / "twice.png").read_bytes()


def test_a_picture_is_drawn_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from matplotlib.figure import Figure

    drawn, draw = [], Figure.draw

    def count(self: Figure, renderer: object) -> None:
        drawn.append(self)
        draw(self, renderer)

    monkeypatch.setattr(Figure, "draw", count)
    figure = Figure(figsize=(3, 2), layout="constrained")
    figure.add_subplot()
    canvas = figure.canvas
    save_figure(figure, tmp_path / "once.png")
    assert drawn == [figure]
    assert figure.canvas is canvas


DRAW = """
import sys
from pathlib import Path
from mbsgen import style
file, is_spared = Path(sys.argv[1]), len(sys.argv) > 2
for _ in range(2 * is_spared):
    style.spare_docstrings()
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from tests.mbsgen.test_style import draw_line
assert not any(isinstance(finder, style._Sparing) for finder in sys.meta_path)
assert (Line2D.set.__doc__ is None) == is_spared, Line2D.set.__doc__
assert Line2D.set.__qualname__ == "Line2D.set"
style.save_figure(draw_line(), file)
"""


def draw_line() -> Figure:
    """Draw a line whose properties `set` gives; wrong ones are refused."""
    from matplotlib.figure import Figure

    axes = (figure := Figure(figsize=(3, 2), layout="constrained")).add_subplot(ylabel="values")
    (line,) = axes.plot([1, 3, 2], label="line")
    line.set(lw=4, color="red")
    with pytest.raises(AttributeError, match="unexpected keyword argument"):
        line.set(width=4)
    axes.legend()
    return figure


def test_without_docstrings_of_setters_a_picture_is_the_same(tmp_path: Path) -> None:
    """In new processes, since this one may have imported Matplotlib."""
    for name, *more in (("plain.png",), ("spared.png", "spared")):
        subprocess.run([sys.executable, "-c", DRAW, str(tmp_path / name), *more], check=True)
    assert (tmp_path / "spared.png").read_bytes() == (tmp_path / "plain.png").read_bytes()
