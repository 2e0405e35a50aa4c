"""Pictures in the style of the project are the ones that Matplotlib draws."""

from __future__ import annotations

from pathlib import Path

import pytest

from mbsgen.style import DOTS, METADATA, save_figure, styled


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
