"""Pictures of solutions: costs of starts and cases, defects of intervals, and poses, each by hand."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.colors import Normalize, to_hex
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.axes3d import Axes3D

from mbsgen.style import BAD, GOOD, PALETTE
from mbsrun.ocp.showing import pictures
from mbsrun.ocp.showing.pictures import SMALLEST, TIME, WIDE

PLACE = Path("place.png")


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> list[Figure]:
    """Keep figures in place of writing them."""
    kept: list[Figure] = []
    monkeypatch.setattr(pictures, "save_plot", lambda figure, _: kept.append(figure))
    return kept


def start(kind: str, cost: float | None) -> Any:
    return SimpleNamespace(kind=kind, cost=cost)


def read(axes: Axes) -> list[tuple[list[float], list[float]]]:
    """Return the points of all lines."""
    return [(np.ravel(x.get_xdata()).tolist(), np.ravel(x.get_ydata()).tolist()) for x in axes.lines]


def test_starts_are_ranked_by_cost_and_coloured_by_kind(drawn: list[Figure]) -> None:
    results = (start("line", 3.0), start("rest", None), start("random", 2.0), start("line", 2.0), start("random", 9.0))
    found: Any = SimpleNamespace(results=results, times=2)
    pictures.plot_starts(found, PLACE)
    (axes,) = drawn[0].axes
    line, rest, random, lowest = read(axes)
    assert line == ([2, 3], [2.0, 3.0])
    assert rest == ([], [])
    assert random == ([1, 4], [2.0, 9.0])
    assert lowest[1] == [2.0, 2.0]
    assert [text.get_text() for text in axes.get_legend().get_texts()] == ["line (2)", "rest (0)", "random (2)"]  # type: ignore[union-attr]
    assert [x.get_color() for x in axes.lines[:3]] == list(PALETTE[:3])
    assert axes.get_title() == "lowest cost found 2 times in 5 starts; 1 without a solution"
    assert axes.get_yscale() == "linear"
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("start, by cost", "cost")
    assert drawn[0].get_size_inches().tolist() == [8, 4.5]


@pytest.mark.parametrize(
    ("costs", "scale"),
    [
        ((1.0, 1.01 * WIDE), "log"),
        ((1.0, WIDE), "linear"),
        ((0.0, 9.0), "linear"),
        ((-1.0, 9.0), "linear"),
        ((), "linear"),
    ],
)
def test_costs_far_apart_are_drawn_by_their_magnitudes(drawn: list[Figure], costs: Any, scale: str) -> None:
    """Costs that are not positive have none."""
    found: Any = SimpleNamespace(results=tuple(start("line", cost) for cost in costs), times=1)
    pictures.plot_starts(found, PLACE)
    assert drawn[0].axes[0].get_yscale() == scale
    assert len(drawn[0].axes[0].lines) == (2 if costs else 0)


def test_cases_over_one_key_are_a_line_of_the_solved_ones(drawn: list[Figure]) -> None:
    """In the order of the key; crosses at the lowest cost have no solution."""
    places, costs = {"mass": np.array([3.0, 1.0, 2.0, 4.0])}, np.array([30.0, 10.0, np.nan, np.inf])
    pictures.plot_cases("task", places, costs, PLACE)
    (axes,) = drawn[0].axes
    assert read(axes) == [([1, 3], [10, 30]), ([2, 4], [10, 10])]
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("mass", "cost")
    assert axes.get_title() == "task: 2 of 4 cases solved"
    assert [x.get_marker() for x in axes.lines] == ["o", "x"]
    pictures.plot_cases("task", places, np.full(4, np.nan), PLACE)
    assert read(drawn[1].axes[0]) == [([], []), ([3, 1, 2, 4], [0, 0, 0, 0])]


def test_cases_over_two_keys_are_points_in_colors_of_their_costs(drawn: list[Figure]) -> None:
    places = {"mass": np.array([3.0, 1.0, 2.0]), "length": np.array([5.0, 6.0, 7.0])}
    pictures.plot_cases("task", places, np.array([30.0, np.nan, 20.0]), PLACE)
    axes, bar = drawn[0].axes
    (points,) = axes.collections
    assert np.asarray(points.get_offsets()).tolist() == [[3, 5], [2, 7]]
    assert np.asarray(points.get_array()).tolist() == [30, 20]
    assert read(axes) == [([1], [6])]
    assert (axes.get_xlabel(), axes.get_ylabel(), bar.get_ylabel()) == ("mass", "length", "cost")
    assert axes.get_title() == "task: 2 of 3 cases solved"


def test_defects_are_bars_of_intervals_in_colors_of_their_accuracy() -> None:
    rounds = (
        SimpleNamespace(times=(0.0, 0.5, 2.0), defects=(1e-3, 1e-20), degree=3),
        SimpleNamespace(times=(0.0, 2.0), defects=(), degree=3),
        SimpleNamespace(times=(0.0, 0.25, 0.5, 2.0), defects=(1e-6, 2e-6, 1e-7), degree=4),
    )
    refinement: Any = SimpleNamespace(rounds=rounds, accuracy=1e-6)
    figure = pictures.make_mesh(refinement)
    first, last = figure.axes
    assert figure.get_size_inches().tolist() == pytest.approx([8, 1.2 + 2 * 1.3])
    bars: list[Any] = sorted(first.patches, key=lambda bar: bar.get_x())
    assert [(bar.get_x(), bar.get_width(), bar.get_height()) for bar in bars] == [(0, 0.5, 1e-3), (0.5, 1.5, SMALLEST)]
    assert [to_hex(bar.get_facecolor()) for bar in bars] == [to_hex(BAD), to_hex(GOOD)]
    bars = sorted(last.patches, key=lambda bar: bar.get_x())
    assert [to_hex(bar.get_facecolor()) for bar in bars] == [to_hex(GOOD), to_hex(BAD), to_hex(GOOD)]
    assert [axes.get_title(loc="left") for axes in (first, last)] == [
        "round 0: 2 intervals, degree 3",
        "round 1: 3 intervals, degree 4",
    ]
    assert read(last)[0] == ([0, 0.25, 0.5, 2], [SMALLEST] * 4)
    assert read(last)[1][1] == [1e-6, 1e-6]
    for axes in (first, last):
        assert axes.get_yscale() == "log"
        assert axes.get_ylim()[0] == SMALLEST
    assert (first.get_xlabel(), last.get_xlabel()) == ("", "time [s]")
    none: Any = SimpleNamespace(rounds=rounds[1:2], accuracy=1e-6)
    assert len(pictures.make_mesh(none).axes) == 1


def test_times_that_are_drawn_are_beginnings_and_points() -> None:
    trajectory: Any = SimpleNamespace(t=np.array([0.0, 1.0, 3.0]), point_t=np.array([[0.5, 1.0], [2.0, 3.0]]))
    assert pictures.read_times(trajectory).tolist() == [0, 0.5, 1, 1, 2, 3]


def test_names_have_one_color_in_all_phases() -> None:
    """Coordinates first; more names than colors repeat them."""

    def describe(positions: str, coordinates: str) -> Any:
        return SimpleNamespace(positions=tuple(positions), coordinates=[SimpleNamespace(name=x) for x in coordinates])

    found = pictures.choose_colors([describe("ab", "ac"), describe("dc", "de")])
    assert list(found) == ["a", "b", "c", "d", "e"]
    assert list(found.values()) == list(PALETTE[:5])
    many = pictures.choose_colors([describe("abcdefghijklmnopq", "")])
    assert many["abcdefghijklmnopq"[len(PALETTE)]] == PALETTE[0]


def test_an_axis_of_a_target_that_is_free_is_where_the_sensor_ends() -> None:
    assert pictures._complete((1.0, None, 0.0), np.array([7.0, 8.0, 9.0])) == (1.0, 8.0, 0.0)


def test_poses_are_spread_evenly_from_the_first_to_the_last() -> None:
    """The ends are drawn wider; bodies are lines from their parents, of any length but 0; rods are solid."""
    axes = Figure().add_subplot(projection="3d")
    assert isinstance(axes, Axes3D)
    p = np.zeros((11, 3, 3))
    p[:, 0, 0], p[:, 0, 1], p[:, 2, 1] = 1 + np.arange(11), 5.0, 2.0
    frames = [SimpleNamespace(parent=-1), SimpleNamespace(parent=0), SimpleNamespace(parent=1)]
    p[:, :, 2] = p[:, :, 1]  # the third frame is at its parent
    links = [SimpleNamespace(first=0, second=1, is_rod=True), SimpleNamespace(first=1, second=2, is_rod=False)]
    skeleton: Any = SimpleNamespace(p=p, frames=frames, links=links)
    t = np.linspace(0, 2, 11)
    pictures.draw_poses(axes, skeleton, t, Normalize(0, 2), 3)
    lines: list[Any] = list(axes.lines)
    assert len(lines) == 3 * 4  # of frame 0 from the base, of frame 1 from frame 0; two links
    assert [line.get_data_3d()[0][1] for line in lines[::4]] == [1.0, 6.0, 11.0]
    assert [line.get_linewidth() for line in lines[::4]] == [3.0, 1.2, 3.0]
    assert [line.get_markersize() for line in lines[::4]] == pytest.approx([3.6, 1.44, 3.6])
    assert [line.get_linestyle() for line in lines[2:4]] == ["-", ":"]
    assert [line.get_color() for line in lines[::4]] == [TIME(0.0), TIME(0.5), TIME(1.0)]
    assert np.asarray(lines[1].get_data_3d()).T.tolist() == [[1, 0, 0], [5, 0, 2]]
    few = Figure().add_subplot(projection="3d")
    assert isinstance(few, Axes3D)
    pictures.draw_poses(few, SimpleNamespace(p=p[:2], frames=frames, links=[]), t, Normalize(0, 2), 9)  # type: ignore[arg-type]
    assert len(few.lines) == 2 * 2


def test_all_points_and_the_base_are_shown_at_one_scale() -> None:
    axes = Figure().add_subplot(projection="3d")
    assert isinstance(axes, Axes3D)
    pictures.frame_up(axes, np.array([[1.0, 4.0, -1.0], [3.0, -2.0, 0.0]]))
    limits = axes.get_xlim(), axes.get_ylim(), axes.get_zlim()
    assert [high - low for low, high in limits] == pytest.approx([6.0] * 3)
    assert [(high + low) / 2 for low, high in limits] == pytest.approx([1.5, 1.0, -0.5])
    assert [axes.get_xlabel(), axes.get_ylabel(), axes.get_zlabel()] == ["x [m]", "y [m]", "z [m]"]
    assert (axes.elev, axes.azim) == (22, -50)
    pictures.frame_up(axes, np.zeros((1, 3)))
    assert axes.get_xlim() == pytest.approx((-1.0, 1.0))


def test_points_are_listed_time_by_time() -> None:
    p = np.arange(12.0).reshape(2, 3, 2)
    assert pictures.list_points(p).tolist() == [[0, 2, 4], [1, 3, 5], [6, 8, 10], [7, 9, 11]]


def test_curves_of_one_unit_share_a_panel() -> None:
    """A panel of one curve has its name; colors are counted in each panel."""
    t = np.array([0.0, 0.5, 2.0])
    figure = pictures.plot_curves(t, [("a", "m", t), ("b", "N", 2 * t), ("c", "m", 3 * t)])
    assert len(figure.axes) == 2
    metres, newtons = figure.axes
    assert [line.get_color() for line in metres.lines] == [PALETTE[0], PALETTE[1]]
    assert newtons.lines[0].get_color() == PALETTE[0]
    assert metres.lines[1].get_ydata().tolist() == [0, 1.5, 6]  # type: ignore[union-attr]
    assert metres.get_xlim() == pytest.approx((0.0, 2.0))
