"""The picture of a mechanism: things are where they are, names stand clear of each other, and bytes repeat."""

from __future__ import annotations

import itertools
import os
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from matplotlib.text import Annotation, Text
from sympy import Integer

from mbsgen.drawing import FORMATS, draw, pose, render
from mbsgen.model.tree import Tree
from mbsgen.pipeline import read_tree
from tests.random_trees import random_tree

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def arm() -> Tree:
    return read_tree(ROOT / "models" / "arm_pendulum.yaml")


def test_the_arm_lies_as_its_file_says(arm: Tree) -> None:
    """At q = 0 stretched along x, the pendulum upright: sums of the lengths of models/arm_pendulum.yaml."""
    scene = pose(arm, [0.0] * 6)
    assert scene.origins[:, 0] == pytest.approx([0, 0, 0.3, 0.6, 0.7, 0.7], abs=1e-15)
    assert scene.origins[:, 1:] == pytest.approx(np.zeros((6, 2)), abs=1e-15)
    assert scene.axes.tolist() == [[0, 0, 1], [0, 1, 0], [0, 1, 0], [0, 1, 0], [1, 0, 0], [0, 1, 0]]
    assert scene.masses.tolist() == [0, 2.5, 2, 0.5, 0, 1]
    assert scene.centres[[1, 2, 3, 5]] == pytest.approx(
        np.array([[0.1, 0, 0], [0.4, 0, 0], [0.7, 0, 0], [0.7, 0, 0.2]]), abs=1e-15
    )
    assert scene.sensors == pytest.approx(np.array([[0.7, 0, 0], [0.7, 0, 0.2]]), abs=1e-15)


def test_the_arm_turns_about_its_axes(arm: Tree) -> None:
    """A quarter turn of the shoulder brings the arm along y, one of the upper arm brings it down along -z."""
    quarter = np.pi / 2
    assert pose(arm, [quarter, 0, 0, 0, 0, 0]).sensors[0] == pytest.approx([0, 0.7, 0], abs=1e-15)
    scene = pose(arm, [0, quarter, 0, 0, 0, 0])
    assert scene.sensors[0] == pytest.approx([0, 0, -0.7], abs=1e-15)
    assert scene.centres[5] == pytest.approx([0.2, 0, -0.7], abs=1e-15)


def test_parameters_have_their_default_values() -> None:
    q = list(np.linspace(-1, 1, 6))
    ours, theirs = pose(random_tree(3, 6), q), pose(random_tree(3, 6, runtime=True), q)
    for name, expected in vars(ours).items():
        assert getattr(theirs, name) == pytest.approx(expected, abs=1e-14)


@pytest.mark.parametrize("size", [1, 6, 20])
def test_names_stand_clear_of_each_other(size: int, arm: Tree) -> None:
    tree = arm if size == 6 else random_tree(size, size)
    figure = draw(tree, [0.0] * size)
    figure.draw_without_rendering()
    boxes = [Text.get_window_extent(t) for t in figure.axes[0].texts if isinstance(t, Annotation)]
    assert boxes
    assert [(a, b) for a, b in itertools.combinations(boxes, 2) if a.overlaps(b)] == []


def test_nothing_of_a_tall_mechanism_with_long_names_is_cut_or_overprinted() -> None:
    """Twenty bodies that carry each other, with names of 24 characters; texts of the tree stand side by side."""
    tree = random_tree(20, 20)
    chain = tuple(
        replace(
            b, parent=i, position=(Integer(0), Integer(0), Integer(1)), name=f"body_of_the_long_arm_{i:03}",
            joint=replace(b.joint, name=f"joint_of_the_long_arm_{i:02}"),
        )
        for i, b in enumerate(tree.bodies)
    )  # fmt: skip
    figure = draw(replace(tree, bodies=chain), [0.0] * 20)
    figure.draw_without_rendering()
    width, height = figure.get_size_inches() * figure.dpi
    space, panel = figure.axes
    listed = [Text.get_window_extent(t).padded(-0.5) for t in panel.texts]  # neighbours touch
    assert [(a, b) for a, b in itertools.combinations(listed, 2) if a.overlaps(b)] == []
    labels = [axis.label.get_window_extent() for axis in (space.xaxis, space.yaxis, space.zaxis)]
    for box in [*listed, *labels, *(Text.get_window_extent(t) for t in space.texts)]:
        assert box.x0 >= 0
        assert box.y0 >= 0
        assert box.x1 <= width
        assert box.y1 <= height


def test_every_body_is_listed_with_its_joint_and_mass() -> None:
    tree = random_tree(4, 12)
    panel = draw(tree, [0.0] * 12).axes[1]
    texts = [t.get_text() for t in panel.texts]
    for body, mass in zip(tree.bodies, pose(tree, [0.0] * 12).masses, strict=True):
        assert body.name in texts
        assert any(t.strip().startswith(f"{body.joint.name}: {body.joint.motion.value}") for t in texts)
        assert f"{mass:.4g}" in texts


def test_a_large_tree_is_drawn_without_its_names() -> None:
    texts = [t.get_text() for t in draw(random_tree(1, 80), [0.0] * 80).axes[1].texts]
    assert "and 20 more bodies" in texts


def test_directions_have_one_scale(arm: Tree) -> None:
    """The sides of the box are as its limits."""
    space = draw(arm, [0.0] * 6).axes[0]
    spans = np.ptp([space.get_xlim3d(), space.get_ylim3d(), space.get_zlim3d()], axis=1)
    assert np.ptp(space._box_aspect / spans) == pytest.approx(0, abs=1e-12)


@pytest.mark.parametrize("form", FORMATS)
def test_the_same_tree_gives_the_same_bytes_under_any_hash_seed(form: str) -> None:
    script = (
        "import sys; from tests.random_trees import random_tree; from mbsgen.drawing import render; "
        f"sys.stdout.buffer.write(render(random_tree(2, 5), [0.1] * 5, {form!r}))"
    )
    pictures = {
        subprocess.run(
            [sys.executable, "-c", script],
            cwd=ROOT,
            env={**os.environ, "PYTHONHASHSEED": seed},
            capture_output=True,
            check=True,
        ).stdout
        for seed in ("0", "1")
    }
    assert pictures == {render(random_tree(2, 5), [0.1] * 5, form)}


@pytest.mark.parametrize("name", ["$x^2$", "a--b", "<script>", "&amp;", "机械臂", "%s\\frac", "_^{", "[red]", "x" * 64])
def test_names_are_text_whatever_they_hold(name: str, arm: Tree, recwarn: pytest.WarningsRecorder) -> None:
    body = arm.bodies[2]
    named = replace(body, name=name, joint=replace(body.joint, name=name))
    tree = replace(arm, name=name, bodies=(*arm.bodies[:2], named, *arm.bodies[3:]))
    root = ElementTree.fromstring(render(tree, [0.3] * 6, "svg"))
    assert root.tag.endswith("svg")
    assert [str(w.message) for w in recwarn] == []


def test_a_picture_tells_neither_place_nor_day(arm: Tree) -> None:
    text = render(arm, [0.0] * 6, "svg").decode()
    assert str(ROOT) not in text
    assert not re.search(r"20\d\d-\d\d-\d\d", text)


@pytest.fixture(scope="module")
def wishbone() -> Tree:
    return read_tree(ROOT / "models" / "wishbone.yaml")


def test_loops_are_drawn_between_their_ends(wishbone: Tree) -> None:
    """Points on the x axis through the outer ball of the lower arm, and so on, by the numbers of the file at q = 0."""
    ends = pose(wishbone, [0.0] * 10).ends
    assert ends[0] == pytest.approx(np.array([[-0.03, 0.71, 0.14]] * 2), abs=1e-15)
    assert ends[1] == pytest.approx(np.array([[-0.12, 0.4, -0.07], [-0.12, 0.72, -0.07]]), abs=1e-15)
    assert ends[2] == pytest.approx(np.array([[0, 0.65, -0.09], [0, 0.55, -0.1]]), abs=1e-15)


def test_loops_are_named_and_open_ones_have_a_dashed_line(wishbone: Tree) -> None:
    assert wishbone.closure is not None
    for q, dashed in ((wishbone.closure.pose, 0), ([0.0] * 10, 1)):
        figure = draw(wishbone, q)
        texts = [text.get_text() for text in figure.findobj(Text)]
        assert "   rod between rack and knuckle" in texts
        assert any("(upper ball)" in text for text in texts)
        lines = [
            line for line in figure.axes[0].get_lines() if line.get_linestyle() == "--" and line.get_linewidth() == 1.6
        ]
        assert len(lines) == dashed


def test_the_title_shows_the_independent_coordinates() -> None:
    tree = read_tree(ROOT / "models" / "slider_crank.yaml")
    assert tree.closure is not None
    assert draw(tree, tree.closure.pose).get_suptitle() == f"slider_crank at crank = {tree.closure.pose[0]:.3g}"
