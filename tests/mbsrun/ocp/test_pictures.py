"""Pictures are written, say what they show, and are the same for the same solution."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from matplotlib.colors import same_color
from matplotlib.figure import Figure
from matplotlib.image import imread

from mbsgen import style
from mbsgen.manifest import Manifest
from mbsrun.ocp.showing import pictures
from mbsrun.ocp.showing.pictures import draw_mechanism, plot_trajectories
from mbsrun.ocp.solution.solution import Solution
from mbsrun.ocp.solving.solve import solve
from tests.mbsrun.ocp.plants import push
from tests.mbsrun.peer import Peer, double_integrator


def plot(solution: Solution, plant: Peer, path: Path) -> None:
    plot_trajectories(solution, plant.manifest, path)


PICTURES = [plot, draw_mechanism]
Picture = Callable[[Solution, Peer, Path], None]


@pytest.fixture
def figures(monkeypatch: pytest.MonkeyPatch) -> list[Figure]:
    """The figures that are drawn, kept from being written."""
    kept: list[Figure] = []
    monkeypatch.setattr(style, "_save_pixels", lambda figure, *_: kept.append(figure))
    return kept


@pytest.mark.parametrize("picture", PICTURES)
def test_a_picture_is_drawn_and_drawn_alike(arm: Peer, reached: Solution, tmp_path: Path, picture: Picture) -> None:
    """A PNG with something on it; twice the same bytes."""
    for name in ("one.png", "two.png"):
        picture(reached, arm, tmp_path / name)
    assert np.ptp(imread(tmp_path / "one.png")) > 0.5
    assert (tmp_path / "one.png").read_bytes() == (tmp_path / "two.png").read_bytes()


def test_trajectories_have_titles_units_and_a_legend(arm: Peer, reached: Solution, figures: list[Figure]) -> None:
    plot(reached, arm, Path("unwritten.png"))
    (figure,) = figures
    titles = [axes.get_title(loc="left") for axes in figure.axes]
    units = [axes.get_ylabel().split()[-1] for axes in figure.axes]
    assert titles == ["Joint coordinates", "Joint velocities", "Inputs"]
    assert units == ["[rad]", "[rad/s]", "m]"]
    assert figure.axes[-1].get_xlabel() == "time [s]"
    every = ["q1", "q2", "q3", "q4", "q5 (passive)", "q6 (passive)"]
    for axes, names in zip(figure.axes, (every, every, every[:4]), strict=True):
        legend = axes.get_legend()
        assert legend is not None
        assert [text.get_text() for text in legend.get_texts()] == names


def test_trajectories_are_those_of_the_solution(arm: Peer, reached: Solution, figures: list[Figure]) -> None:
    """Every line runs through mesh and collocation points in order of time."""
    plot(reached, arm, Path("unwritten.png"))
    lines = [line for line in figures[0].axes[0].lines if line.get_label() == "q3"]
    t, q = lines[0].get_data()
    assert len(t) == 100 * 5
    assert np.diff(np.asarray(t)).min() > -1e-15
    assert np.array_equal(np.asarray(q)[::5], reached.trajectory.q[:-1, 2])


def test_limits_that_a_motion_reaches_are_dotted(arm: Peer, reached: Solution, figures: list[Figure]) -> None:
    """Each in the color of its curve, at its value; limits that are far away are left out."""
    most = float(reached.trajectory.u[:, 1].max())
    bounds = reached.problem.bounds
    u = (bounds.u[0], (-1e3, most), *((-1e4, 1e4) for _ in bounds.u[2:]))
    free = tuple((-np.inf, np.inf) for _ in bounds.q)
    problem = replace(reached.problem, bounds=replace(bounds, q=free, qd=free, u=((-np.inf, np.inf), *u[1:])))
    plot(replace(reached, problem=problem), arm, Path("unwritten.png"))
    dotted = [line for axes in figures[0].axes for line in axes.lines if line.get_linestyle() == ":"]
    assert [np.unique(line.get_ydata()).tolist() for line in dotted] == [[most]]
    (elbow,) = (part for part in figures[0].axes[2].patches if part.get_label() == "q2")
    assert same_color(dotted[0].get_color(), elbow.get_edgecolor())


def test_inputs_of_polynomials_are_drawn_one_by_one(arm: Peer, reached: Solution, figures: list[Figure]) -> None:
    """Each motor's values at all points, in order of time, although the array holds all motors of a point together."""
    motion = reached.trajectory
    values = np.arange(motion.point_t.size * 4.0).reshape(*motion.point_t.shape, 4)
    plot(replace(reached, trajectory=replace(motion, point_u=values)), arm, Path("unwritten.png"))
    lines = {line.get_label(): line.get_data() for line in figures[0].axes[2].lines}
    for k in range(4):
        t, u = lines[f"q{k + 1}"]
        assert np.array_equal(np.asarray(t), motion.point_t.ravel())
        assert np.array_equal(np.asarray(u), values[:, :, k].ravel())


def test_the_mechanism_shows_path_and_target(arm: Peer, reached: Solution, figures: list[Figure]) -> None:
    draw_mechanism(reached, arm, Path("unwritten.png"))
    legend = figures[0].axes[0].get_legend()
    assert legend is not None
    assert [text.get_text() for text in legend.get_texts()] == ["path of hand", "target of hand", "base"]


@pytest.mark.parametrize("picture", PICTURES)
def test_prismatic_joints_and_names_that_look_like_formulas(
    tmp_path: Path, figures: list[Figure], picture: Picture
) -> None:
    """Metres and newtons; a $ in a name is a $."""
    plant = double_integrator()
    strange = plant.manifest.coordinates[0].model_copy(update={"name": r"$\frac{"})
    plant.manifest = Manifest(**{**dict(plant.manifest), "coordinates": (strange,)})
    solution = solve(replace(push(4), name="$x_{$"), plant)
    assert isinstance(solution, Solution)
    picture(solution, plant, tmp_path / "unwritten.png")
    figures[0].canvas.draw()
    if picture is plot:
        assert [axes.get_ylabel().split(" ", 1)[1] for axes in figures[0].axes] == ["[m]", "[m/s]", "[N]"]


def test_wrenches_that_act_are_drawn_by_their_names(monkeypatch: pytest.MonkeyPatch) -> None:
    """Components apart from signals; one that is 0 is left out, and one without a name is a wrench."""
    w = np.zeros((2, 3, 4))
    w[:, :, 0], w[:, :, 2], w[0, 1, 3] = 2.0, -1.0, 0.5
    trajectory: Any = SimpleNamespace(point_t=np.arange(6.0).reshape(2, 3), point_w=w)
    monkeypatch.setattr(pictures, "name_components", lambda _: ["fx of hand", "fy of hand", "", "act"])
    monkeypatch.setattr(pictures, "find_unit", lambda quantity, _: "" if quantity.index == 3 else "N")
    solution: Any = SimpleNamespace(trajectory=trajectory)
    manifest: Any = None
    found = [(x.label, x.panel.title, x.panel.unit) for x in pictures._list_wrenches(solution, manifest)]
    assert found == [("fx of hand", "Open wrenches", "N"), ("wrench", "Open wrenches", "N"), ("act", "Signals", "")]
