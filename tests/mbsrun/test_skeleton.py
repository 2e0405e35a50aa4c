"""The skeleton of a mechanism: its frames, and an end at the centre of mass where nothing else shows a body."""

from __future__ import annotations

import json

import numpy as np
import pytest

import mbsrun
from mbsrun.animation import render_animation
from mbsrun.models import Extent, find_folder
from mbsrun.skeleton import place

GRIPPER = """\
name: gripper
gravity: [0, 0, -9.81]
bodies:
  - {name: arm, joint: {type: revolute, axis: y}, mass: 1, com: [0.2, 0, 0], inertia: [0.1, 0.1, 0.1]}
  - {name: left, parent: arm, joint: {name: grip, type: prismatic, axis: y, position: [0.5, 0, 0]}, mass: 0.1}
  - name: right
    parent: arm
    joint: {type: prismatic, axis: -y, position: [0.5, 0, 0], follows: {joint: grip, ratio: 1, offset: 0}}
    mass: 0.1
    com: [0.05, 0, 0]
  - {name: tail, parent: arm, joint: {type: revolute, axis: x}, mass: 2, com: [0, 0, -l], inertia: [1, 1, 1]}
parameters: {l: {value: 0.3, kind: runtime}}
"""


@pytest.fixture(scope="module")
def gripper(tmp_path_factory):
    return load(tmp_path_factory.mktemp("gripper"), GRIPPER)


def load(folder, text):
    """Generate poses alone."""
    path = folder / "model.yaml"
    path.write_text(text)
    return mbsrun.load(find_folder(path, Extent(("frames",), derivatives=0)))


def test_a_body_that_carries_nothing_ends_at_its_centre_of_mass(gripper):
    """At q = (0.3, 0.02, 0.7): by rotations about y and x, written out. A centre at the origin needs no end."""
    a, b = 0.3, 0.7
    found = place(gripper, [[a, 0.02, b]])
    Ry = np.array([[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]])
    Rx = np.array([[1, 0, 0], [0, np.cos(b), -np.sin(b)], [0, np.sin(b), np.cos(b)]])
    ends = {frame.name: (frame.parent, found.p[0, :, i]) for i, frame in enumerate(found.frames)}
    assert set(ends) == {"arm", "left", "right", "tail", "right, centre of mass", "tail, centre of mass"}
    parent, end = ends["tail, centre of mass"]
    assert found.frames[parent].name == "tail"
    assert end == pytest.approx(Ry @ Rx @ [0, 0, -0.3], abs=1e-15)
    assert ends["right, centre of mass"][1] == pytest.approx(Ry @ [0.55, -0.02, 0], abs=1e-15)
    assert found.R.shape == (1, 3, 3 * len(found.frames))


def test_joints_that_follow_others_are_drawn(gripper):
    """Frames belong to bodies, of which there are more than coordinates."""
    assert [frame.slides for frame in gripper.manifest.frames] == [False, True, True, False]
    assert "right, centre of mass" in render_animation(gripper, [0, 1], [[0, 0, 0], [1, 0.04, 1]])


CLOSED = """\
name: closed
gravity: [0, 0, -9.81]
bodies:
  - {name: crank, joint: {type: revolute, axis: -y}, mass: 1, com: [0.1, 0, 0.05], inertia: [0.1, 0.1, 0.1]}
  - name: slider
    joint: {type: prismatic, axis: x, position: [0.5, 0, 0.1], actuated: false}
    mass: 0.1
  - {name: flap, joint: {type: revolute, axis: -y}, mass: 1, com: [0.1, 0, 0.05], inertia: [0.1, 0.1, 0.1]}
loops:
  - {name: bar, type: rod, length: 0.3, from: {body: crank, position: [0.2, 0, 0.1]}, to: {body: slider}}
assembly: {crank: 0.5}
"""


def test_ends_of_loops_and_centres_of_mass_are_in_the_axes_of_the_file(tmp_path):
    """About -y by q: (x, z) goes to (x cos q - z sin q, x sin q + z cos q). A body at an end needs no other one."""
    closed = load(tmp_path, CLOSED)
    q = np.array(closed.manifest.pose)
    found = place(closed, q[None])
    names = [frame.name for frame in found.frames]
    assert names[3:] == ["flap, centre of mass", "bar, first end", "bar, second end"]
    (link,) = found.links
    assert (link.name, names[link.first], names[link.second]) == ("bar", *names[4:])
    assert link.is_rod
    a, x, b = (q[closed.manifest.positions.index(name)] for name in ("crank", "slider", "flap"))
    first = [0.2 * np.cos(a) - 0.1 * np.sin(a), 0, 0.2 * np.sin(a) + 0.1 * np.cos(a)]
    assert found.p[0, :, link.first] == pytest.approx(first, abs=1e-15)
    assert found.p[0, :, link.second] == pytest.approx([0.5 + x, 0, 0.1], abs=1e-15)
    assert np.linalg.norm(found.p[0, :, link.first] - found.p[0, :, link.second]) == pytest.approx(0.3, abs=1e-14)
    centre = [0.1 * np.cos(b) - 0.05 * np.sin(b), 0, 0.1 * np.sin(b) + 0.05 * np.cos(b)]
    assert found.p[0, :, 3] == pytest.approx(centre, abs=1e-15)
    ends = [{"frame": i, "at": [0.0, 0.0, 0.0]} for i in (4, 5)]
    assert json.dumps([{"kind": "rod", "ends": ends}]) in render_animation(closed, [0], q[None])
