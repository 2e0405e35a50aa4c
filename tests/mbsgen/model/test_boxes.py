"""Contacts of spheres with boxes: distances, closed forms, laws, MuJoCo, derivatives, files, faults."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from mbsgen.errors import InputError
from mbsgen.model.changes.reduction import build_tree
from mbsgen.model.changes.releasing import with_runtime_numbers
from mbsgen.model.changes.scene import Scene, stage
from mbsgen.model.construction import body, box, contact, make_model, number, plane, prismatic
from mbsgen.model.model import Block
from mbsgen.model.tree import Kind
from mbsgen.model.writer import write_model
from tests.fuzz import mechanisms
from tests.mbsgen.model.pairs import REST, Array, call, check_fault, find_drawn, make_pair, press, read

r, k, SIZE = 0.1, 1e4, (0.4, 0.3, 0.2)
LAW: dict[str, Any] = {"stiffness": k, "width": 1e-6}
WHOLE = """\
name: shelf
gravity: [0, 0, -9.81]

parameters:
  deep: {value: 0.25, kind: runtime}

bodies:
  - name: sled
    joint: {type: prismatic, axis: x, actuated: false}
    mass: 2

  - name: mast
    parent: sled
    joint: {type: revolute, axis: y}
    mass: 1
    com: [0, 0, 0.2]

  - name: plate
    joint: {type: fixed}

contacts:
  - {name: post, body: mast, position: [0, 0, 0.4], radius: 0.1, box: {size: [0.2, deep, 0.3], position: [0.3, 0, 0.4]}, stiffness: 1000}
  - name: pair
    body: mast
    position: [0.05, 0, 0.3]
    box: {body: sled, position: [0, 0.1, 0], orientation: [{axis: z, angle: 0.5}], size: [0.2, 0.3, 0.5]}
    stiffness: 500
    exponent: 1
    dissipation: 0.4
    width: 0.05
    friction: {coefficient: 0.5, speed: 0.1}
"""  # noqa: E501


def measure(x: Array) -> float:
    """Return the signed distance of a point from a box, in its axes: the closest point is the clamped one."""
    half = np.array(SIZE) / 2
    outside = float(np.linalg.norm(x - np.clip(x, -half, half)))
    return outside if outside > 0 else float(np.max(np.abs(x) - half))


def stand(c: Array, P: Array) -> Array:
    return np.concatenate([(*c, 0, 0, 0, 1), (*P, 0, 0, 0, 1)])


# --- closed forms -----------------------------------------------------------------------------------------------------


def test_distances_are_the_distances_of_a_box() -> None:
    """Outside, in faces, edges and corners, and inside: to two widths, and to a thousandth of one away from edges."""
    tree = make_pair(contact("hit", "a", radius=r, other=box(SIZE, "b"), **LAW))
    P, half = np.array([0.3, -0.2, 0.1]), np.array(SIZE) / 2
    points = [*np.random.default_rng(4).uniform(-0.5, 0.5, (200, 3))]
    points += [half * s for s in np.random.default_rng(5).choice([-1, 0, 1], (20, 3))]
    for x in points:
        (found,) = call(tree, "distances", q=stand(P + x, P))["distance"]
        q = np.sort(np.abs(x) - half)
        apart = min(q[2] - q[1], np.abs(q).min(), np.abs(x).min())  # from planes of equal depth, and from edges
        assert found == pytest.approx(measure(x) - r, abs=2e-9 if apart > 1e-4 else 2e-6)


def test_distances_are_those_of_mujoco() -> None:
    """Of a sphere that touches or is apart: MuJoCo's own distance, of turned boxes."""
    random = np.random.default_rng(3)
    for _ in range(10):
        c, P, angle = random.normal(size=3), random.normal(size=3), float(random.uniform(-3, 3))
        half = " ".join(str(x / 2) for x in SIZE)
        text = (
            f'<mujoco><compiler angle="radian"/><worldbody><geom type="sphere" size="{r}" pos="{c[0]} {c[1]} {c[2]}"/>'
            f'<geom type="box" size="{half}" pos="{P[0]} {P[1]} {P[2]}" axisangle="0 1 0 {angle}"/>'
            "</worldbody></mujoco>"
        )
        model = mujoco.MjModel.from_xml_string(text)
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        tree = make_pair(contact("hit", "a", radius=r, other=box(SIZE, "b", orientation=[("y", angle)]), **LAW))
        expected = mujoco.mj_geomDistance(model, data, 0, 1, 10.0, None)
        assert call(tree, "distances", q=stand(c, P))["distance"] == pytest.approx([expected], abs=1e-6)


@pytest.mark.parametrize("exponent", [1, 1.5, 2, 2.5, 3])
def test_an_overlap_has_its_force_along_the_shortest_way(exponent: float) -> None:
    """At a face, an edge and a corner: stiffness overlap^exponent, from the closest point; opposite on the box."""
    tree = make_pair(contact("hit", "a", radius=r, other=box(SIZE, "b"), exponent=exponent, **LAW))
    half = np.array(SIZE) / 2
    for way in ([0, 0, 1], [0, 0.6, 0.8], [2 / 3, -1 / 3, 2 / 3]):
        n = np.array(way)
        closest = half * np.sign(n) + np.array([0.03, -0.02, 0.01]) * (n == 0)
        (F, M), (G, L) = press(tree, np.array([closest + (r - 0.03) * n, (0, 0, 0)]), REST)
        assert pytest.approx(k * 0.03**exponent * n, rel=1e-6, abs=1e-9) == F
        assert pytest.approx(-F, rel=1e-14) == G
        assert pytest.approx(np.zeros(3), abs=1e-12) == M
        assert pytest.approx(np.cross(closest, G), rel=1e-6, abs=1e-9) == L
        assert np.abs(press(tree, np.array([closest + (r + 0.03) * n, (0, 0, 0)]), REST)).max() < 1e-40


def test_a_force_passes_through_a_face_without_a_bend() -> None:
    """Down to where another face is as near: stiffness times the depth, also of the centre inside the box."""
    tree = make_pair(contact("hit", "a", radius=r, other=box(SIZE, "b"), exponent=1, **LAW))
    for height in (0.15, 0.1, 0.1 + 1e-7, 0.05, 0.01):
        ((F, _), _) = press(tree, np.array([(0.02, 0.01, height), (0, 0, 0)]), REST)
        assert pytest.approx([0, 0, k * (r + 0.1 - height)], rel=1e-5, abs=1e-9) == F


def test_a_large_box_is_a_plane() -> None:
    law = {**LAW, "dissipation": 0.3, "friction": (0.6, 0.01)}
    flat = contact("hit", "a", radius=r, other=plane("b", position=(0, 0, 0.1)), **law)
    block = contact("hit", "a", radius=r, other=box((9, 8, 2), "b", position=(0, 0, -0.9)), **law)
    at, V = np.array([(0.0, 0.0, 0.17), (0.0, 0.0, 0.0)]), 0.3 * np.sin(np.arange(12))
    one, two = (press(make_pair(touch), at, V) for touch in (flat, block))
    assert np.abs(one[:, 0]).min() > 0
    assert one == pytest.approx(two, rel=1e-6, abs=1e-9)


def test_the_force_is_conservative_and_the_gradient_never_longer_than_one() -> None:
    """At a wide transition, near edges and inside: -V' along the gradient of the distance, by differences."""
    width = 0.02
    tree = make_pair(contact("hit", "a", radius=r, other=box(SIZE, "b"), stiffness=k, exponent=1, width=width))
    step = 1e-5
    for x in np.random.default_rng(8).uniform(-0.3, 0.3, (30, 3)):

        def gap(at: Array) -> float:
            return float(call(tree, "distances", q=stand(at, np.zeros(3)))["distance"][0])

        slope = np.array([(gap(x + step * e) - gap(x - step * e)) / (2 * step) for e in np.eye(3)])
        N = k * width * np.logaddexp(0, -gap(x) / width)
        ((F, M), (G, L)) = press(tree, np.array([x, (0, 0, 0)]), REST)
        assert pytest.approx(N * slope, abs=1e-6 * k * width) == F
        assert np.linalg.norm(slope) <= 1 + 1e-9
        assert np.abs([M, L + np.cross(x, F), F + G]).max() <= 1e-9 * k


def test_contact_and_friction_take_energy_out() -> None:
    """At random velocities and places: power relative to the elastic force at most 0."""
    law = {**LAW, "width": 0.02, "dissipation": 0.7, "friction": (0.8, 0.01)}
    tree, random = make_pair(contact("hit", "a", radius=r, other=box(SIZE, "b"), **law)), np.random.default_rng(5)
    for V in random.normal(size=(30, 12)):
        at = np.array([random.uniform(-0.25, 0.25, 3), (0, 0, 0)])
        elastic, found = press(tree, at, REST), press(tree, at, V)
        assert (found - elastic).ravel() @ V <= 1e-9


# --- the same in every function, and elsewhere ------------------------------------------------------------------------


def find_box(folder: Path, accept: Callable[[dict[str, Any]], bool]) -> int:
    return find_drawn(folder, accept, "box")


@pytest.mark.parametrize("numbers", ["given", "runtime", "zeros"])
@pytest.mark.parametrize("on_body", [False, True], ids=["base", "body"])
def test_all_functions_agree_with_virtual_power(numbers: str, on_body: bool, tmp_path: Path) -> None:
    """Drawn mechanisms, with the numbers of the file, and with others at run time; see tests/fuzz/forces.py."""
    seed = find_box(tmp_path, lambda touch: ("body" in touch["box"]) == on_body)
    assert mechanisms.examine(replace(mechanisms.draw(seed), numbers=numbers, tolerance=0.0), seed) == ""


def test_derivatives_are_differences(tmp_path: Path) -> None:
    """First and second derivatives of all functions, in 50 digits."""
    seed = find_box(tmp_path, lambda touch: "friction" in touch)
    assert mechanisms.examine(replace(mechanisms.draw(seed), reductions="all"), seed, derivatives=True) == ""


def test_a_scene_leaves_contacts_out_whose_bodies_do_not_move(tmp_path: Path) -> None:
    """With the mast locked, it stands on the sled: only the post is touched."""
    tree = build_tree(stage(read(WHOLE, tmp_path), Scene(locked=(("mast", number(0.1)),))))
    assert [x.name for x in tree.distances] == ["post"]


# --- files ------------------------------------------------------------------------------------------------------------


def test_what_is_written_reads_as_the_same_model(tmp_path: Path) -> None:
    model = read(WHOLE, tmp_path)
    assert all(isinstance(x.other, Block) for x in model.contacts)
    assert read(write_model(model), tmp_path) == model


def test_python_makes_the_same_parts(tmp_path: Path) -> None:
    side = box((0.2, "deep", 0.3), position=(0.3, 0, 0.4))
    post = contact("post", "mast", position=(0, 0, 0.4), radius=0.1, other=side, stiffness=1000)
    pair = contact(
        "pair",
        "mast",
        position=(0.05, 0, 0.3),
        other=box((0.2, 0.3, 0.5), "sled", position=(0, 0.1, 0), orientation=[("z", 0.5)]),
        stiffness=500,
        exponent=1,
        dissipation=0.4,
        width=0.05,
        friction=(0.5, 0.1),
    )
    assert read(WHOLE, tmp_path).contacts == (post, pair)


def test_numbers_of_boxes_become_parameters(tmp_path: Path) -> None:
    """With their values the forces are what they were; another edge is another model."""
    model = read(WHOLE, tmp_path)
    freed = with_runtime_numbers(model)
    added = {p.name for p in freed.parameters} - {p.name for p in model.parameters}
    assert {x for x in added if ".box." in x} == {
        *(f"contacts.post.box.{x}" for x in ("position.x", "position.z", "size.x", "size.z")),
        *(f"contacts.pair.box.{x}" for x in ("position.y", "orientation.1", "size.x", "size.y", "size.z")),
    }
    at = {"q": [0.1, 0.2], "qd": [1, 2]}
    tree = build_tree(freed)
    assert call(tree, "impl", **at)["Phi"] == pytest.approx(call(build_tree(model), "impl", **at)["Phi"], rel=1e-12)
    moved = [
        0.4 if x.name == "contacts.pair.box.size.x" else x.value for x in tree.parameters if x.kind is Kind.RUNTIME
    ]
    larger = build_tree(read(WHOLE.replace("[0.2, 0.3, 0.5]", "[0.4, 0.3, 0.5]"), tmp_path))
    for name in ("impl", "distances"):
        found = call(tree, name, **at, p=moved)
        assert [*found.values()] == [pytest.approx(x, rel=1e-12) for x in call(larger, name, **at).values()]


# --- faults -----------------------------------------------------------------------------------------------------------

FAULTS = {  # old text, new text, path and piece of the finding
    "on nothing": ("{body: sled, p", "{body: sledge, p", "contacts[1].box.body", "no body"),
    "on the same body": ("{body: sled, p", "{body: mast, p", "contacts[1]", "both ends are on"),
    "on a body that stands": ("body: mast, position", "body: plate, position", "contacts[0]", "do not move relative"),
    "an edge below 0": ("[0.2, 0.3, 0.5]", "[0.2, -0.3, 0.5]", "contacts[1].box.size[1]", "found -0.3"),
    "an edge of 0": ("[0.2, 0.3, 0.5]", "[0.2, 0.3, 0]", "contacts[1].box.size[2]", "found 0"),
    "no size": (", size: [0.2, 0.3, 0.5]", "", "contacts[1].box.size", "missing"),
    "an unknown parameter": ("0.2, deep", "0.2, bog", "contacts[0].box.size[1]", 'unknown name "bog"'),
    "a size in the plane": ("[0.2, 0.3, 0.5]", "[0.2, 0.3]", "contacts[1].box.size", "list of 2"),
    "a place in the plane": ("[0.3, 0, 0.4]}", "[0.3, 0.4]}", "contacts[0].box.position", "list of 2"),
    "a tiny turn": ("angle: 0.5", "angle: 1e-200", "contacts[1].box.orientation[0].angle", "an angle of 1e-200"),
    "an unknown key": ("position: [0.3, 0, 0.4]}", "normal: z}", "contacts[0].box.normal", "unknown key"),
    "a box of corners": ("radius: 0.1", "size: [1, 1, 1]", "contacts[0].size", "corners miss a box"),
    "a sphere too": (
        "    stiffness: 500",
        "    sphere: {radius: 1}\n    stiffness: 500",
        "contacts[1].box",
        "a sphere and",
    ),
}


@pytest.mark.parametrize(("old", "new", "path", "finding"), FAULTS.values(), ids=FAULTS.keys())
def test_faults_are_found_where_they_are(old: str, new: str, path: str, finding: str, tmp_path: Path) -> None:
    check_fault(WHOLE, old, new, path, finding, tmp_path)


def test_python_refuses_what_a_file_may_not_say() -> None:
    bodies = [body("a", prismatic("z"), mass=1)]
    wrong = [contact("hit", "a", size=(1, 1, 1), other=box((1, 1, 1)), stiffness=1)]
    with pytest.raises(InputError, match="corners miss a box"):
        make_model("pair", bodies, gravity=(0, 0, 0), contacts=wrong)
