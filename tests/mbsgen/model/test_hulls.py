"""Contacts of hulls and cylinders with planes, and of spheres with capsules: distances, MuJoCo, laws, files, faults."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from mbsgen.model.changes.reduction import build_tree
from mbsgen.model.changes.releasing import with_runtime_numbers
from mbsgen.model.construction import body, capsule, contact, free, make_model, plane
from mbsgen.model.model import Capsule, Contact
from mbsgen.model.tree import Tree
from mbsgen.model.writer import write_model
from mbsrun import load
from mbsrun.kernel import KernelError
from mbsrun.models import Extent
from tests.fuzz import mechanisms
from tests.mbsgen.model.pairs import REST, Array, call, check_fault, find_drawn, make_pair, press, read

r, R, L, k = 0.1, 0.05, 0.4, 1e4
LAW: dict[str, Any] = {"stiffness": k, "width": 1e-6}
WHOLE = """\
name: log
gravity: [0, 0, -9.81]

parameters:
  long: {value: 0.25, kind: runtime}

bodies:
  - name: sled
    joint: {type: prismatic, axis: x, actuated: false}
    mass: 2

  - name: mast
    parent: sled
    joint: {type: revolute, axis: y}
    mass: 1
    com: [0, 0, 0.2]

contacts:
  - {name: hull, body: mast, position: [0, 0, 0.4], radius: 0.02, points: [[0, 0, long], [0.1, 0, 0], [0, 0.1, 0]], stiffness: 1000}
  - {name: log, body: mast, wheel: {radius: 0.1, axis: x, length: long}, stiffness: 500}
  - name: pair
    body: mast
    position: [0.05, 0, 0.3]
    radius: 0.03
    capsule: {body: sled, position: [0, 0.1, 0], orientation: [{axis: y, angle: 0.5}], radius: 0.05, length: 0.3}
    stiffness: 500
    exponent: 1
    width: 0.05
    friction: {coefficient: 0.5, speed: 0.1}
"""  # noqa: E501


def stand(c: Array, P: Array, turn: tuple[float, ...] = (0, 0, 0, 1)) -> Array:
    return np.concatenate([(*c, *turn), (*P, 0, 0, 0, 1)])


def measure(x: Array) -> float:
    """Return the distance of a point from the segment along z: the closest point of it is the clamped one."""
    return float(np.linalg.norm(x - [0, 0, np.clip(x[2], -L / 2, L / 2)]))


# --- closed forms, and another program --------------------------------------------------------------------------------


def test_distances_are_the_distances_of_a_segment() -> None:
    """Beside it and beyond its ends, with both radii off: to two widths, and exactly away from the ends."""
    tree = make_pair(contact("hit", "a", radius=r, other=capsule(R, L, "b"), **LAW))
    P = np.array([0.3, -0.2, 0.1])
    points = [*np.random.default_rng(4).uniform(-0.5, 0.5, (200, 3)), np.array([0.1, 0, L / 2]), np.array([0, 0.2, 0])]
    for x in points:
        (found,) = call(tree, "distances", q=stand(P + x, P))["distance"]
        is_near = abs(abs(x[2]) - L / 2) < 1e-4
        assert found == pytest.approx(measure(x) - r - R, abs=2e-6 if is_near else 1e-12)


def compare(found: Contact, own: str, other: str, places: tuple[Array, Array], turn: Array) -> None:
    """Compare the least distance of a contact with MuJoCo's, the first side turned by a quaternion x, y, z, w."""
    (c, P), (x, y, z, w) = places, turn
    text = (
        f'<mujoco><worldbody><body pos="{c[0]} {c[1]} {c[2]}" quat="{w} {x} {y} {z}"><geom {own}/></body>'
        f'<geom {other} pos="{P[0]} {P[1]} {P[2]}"/></worldbody></mujoco>'
    )
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    geoms = sorted((0, 1), key=lambda g: model.geom_bodyid[g])
    expected = mujoco.mj_geomDistance(model, data, geoms[0], geoms[1], 10.0, None)
    gaps = call(make_pair(found), "distances", q=stand(c, P, tuple(turn)))["distance"]
    assert min(gaps) == pytest.approx(expected, abs=1e-6)


def test_distances_are_those_of_mujoco() -> None:
    """Of a capsule, a box with round edges and a cylinder above a plane, and of a sphere and a capsule."""
    random, above = np.random.default_rng(3), np.array([0.0, 0.0, 1.0])
    ground = plane("b")
    ends = [(0, 0, -L / 2), (0, 0, L / 2)]
    for _ in range(8):
        turn, P = random.normal(size=4), random.normal(size=3)
        turn /= np.linalg.norm(turn)
        places = P + above + 0.1 * random.normal(size=3), P
        flat = 'type="plane" size="9 9 1"'
        half = f"{L / 2}"
        for shape, own in (
            (contact("hit", "a", points=ends, radius=R, other=ground, **LAW), f'type="capsule" size="{R} {half}"'),
            (contact("hit", "a", wheel=(R, "z", L), other=ground, **LAW), f'type="cylinder" size="{R} {half}"'),
        ):
            compare(shape, own, flat, places, turn)
        ball = contact("hit", "a", radius=r, other=capsule(R, L, "b"), **LAW)
        compare(ball, f'type="sphere" size="{r}"', f'type="capsule" size="{R} {half}"', places, turn)


def test_a_capsule_is_pushed_along_the_shortest_way() -> None:
    """Beside the segment, and beyond an end: stiffness overlap^3/2 along the way between the nearest points."""
    tree = make_pair(contact("hit", "a", radius=r, other=capsule(R, L, "b"), **LAW))
    for foot, way in (((0, 0, 0.1), (0.6, -0.8, 0)), ((0, 0, L / 2), (0, 0.6, 0.8)), ((0, 0, -L / 2), (0, 0, -1))):
        n = np.array(way)
        (F, M), (G, T) = press(tree, np.array([np.array(foot) + (r + R - 0.03) * n, (0, 0, 0)]), REST)
        assert pytest.approx(k * 0.03**1.5 * n, rel=1e-5, abs=1e-9) == F
        assert pytest.approx(-F, rel=1e-14) == G
        assert pytest.approx(np.zeros(3), abs=1e-10) == M
        assert pytest.approx(np.cross(foot, G), rel=1e-5, abs=1e-5) == T


def test_the_force_is_conservative_and_the_gradient_never_longer_than_one() -> None:
    """At a wide transition, also near the ends: along the gradient of the distance, by differences."""
    width, step = 0.02, 1e-5
    tree = make_pair(contact("hit", "a", radius=r, other=capsule(R, L, "b"), stiffness=k, exponent=1, width=width))
    for x in np.random.default_rng(8).uniform(-0.3, 0.3, (30, 3)):

        def gap(at: Array) -> float:
            return float(call(tree, "distances", q=stand(at, np.zeros(3)))["distance"][0])

        slope = np.array([(gap(x + step * e) - gap(x - step * e)) / (2 * step) for e in np.eye(3)])
        N = k * width * np.logaddexp(0, -gap(x) / width)
        ((F, M), (G, T)) = press(tree, np.array([x, (0, 0, 0)]), REST)
        assert pytest.approx(N * slope, abs=1e-6 * k * width) == F
        assert np.linalg.norm(slope) <= 1 + 1e-9
        assert np.abs([M, T + np.cross(x, F), F + G]).max() <= 1e-9 * k


def test_corners_of_a_box_are_points_of_a_hull() -> None:
    """In the same places, with the same forces."""
    corners = [(x, y, z) for x in (-0.2, 0.2) for y in (-0.1, 0.1) for z in (-0.3, 0.3)]
    law, turned = {**LAW, "friction": (0.6, 0.01)}, [("x", 0.4)]
    box = contact("hit", "a", size=(0.4, 0.2, 0.6), orientation=turned, other=plane("b"), **law)
    hull = contact("hit", "a", points=corners, orientation=turned, other=plane("b"), **law)
    at, V = np.array([(0.0, 0.0, 0.2), (0.0, 0.0, 0.0)]), 0.3 * np.sin(np.arange(12))
    one, two = (press(make_pair(touch), at, V) for touch in (box, hull))
    assert np.abs(one[:, 0]).min() > 0
    assert one == pytest.approx(two, rel=1e-12, abs=1e-9)


# --- the same in every function, and elsewhere ------------------------------------------------------------------------


@pytest.mark.parametrize("numbers", ["given", "runtime", "zeros"])
@pytest.mark.parametrize("kind", ["capsule", "points", "wheel"])
def test_all_functions_agree_with_virtual_power(kind: str, numbers: str, tmp_path: Path) -> None:
    """Drawn mechanisms, with the numbers of the file, and with others at run time; see tests/fuzz/forces.py."""
    seed = find_drawn(tmp_path, lambda touch: "friction" in touch, kind)
    assert mechanisms.examine(replace(mechanisms.draw(seed), numbers=numbers, tolerance=0.0), seed) == ""


def test_derivatives_are_differences(tmp_path: Path) -> None:
    """First and second derivatives of all functions, in 50 digits."""
    seed = find_drawn(tmp_path, lambda touch: "friction" not in touch, "capsule")
    assert mechanisms.examine(replace(mechanisms.draw(seed), reductions="all"), seed, derivatives=True) == ""


def test_a_cylinder_that_stands_has_no_lowest_point(requires: Callable[[str], str], tmp_path: Path) -> None:
    """On its end: kernels fail with a status of a circle, as of a wheel that lies flat; leant a little, they do not."""
    requires("cc")
    log = contact("log", "a", wheel=(R, "z", L), other=plane("b"), **LAW)
    bodies = [body(name, free(), mass=2, inertia=(0.1, 0.1, 0.1)) for name in ("a", "b")]
    file = tmp_path / "log.yaml"
    file.write_text(write_model(make_model("log", bodies, gravity=(0, 0, 0), contacts=[log])), encoding="utf-8")
    plant = load(file, extent=Extent(("impl",), derivatives=0))
    lean = np.array([np.sin(1e-3), 0, 0, np.cos(1e-3)])
    assert np.isfinite(plant.impl(q=stand(np.ones(3), np.zeros(3), tuple(lean)), qd=REST, qdd=REST)["Phi"]).all()
    with pytest.raises(KernelError, match=r"log\.1"):
        plant.impl(q=stand(np.ones(3), np.zeros(3)), qd=REST, qdd=REST)


# --- files ------------------------------------------------------------------------------------------------------------


def test_what_is_written_reads_as_the_same_model(tmp_path: Path) -> None:
    model = read(WHOLE, tmp_path)
    assert isinstance(model.contacts[2].other, Capsule)
    assert read(write_model(model), tmp_path) == model


def test_python_makes_the_same_parts(tmp_path: Path) -> None:
    corners = [(0, 0, "long"), (0.1, 0, 0), (0, 0.1, 0)]
    hull = contact("hull", "mast", position=(0, 0, 0.4), radius=0.02, points=corners, stiffness=1000)
    log = contact("log", "mast", wheel=(0.1, "x", "long"), stiffness=500)
    pair = contact(
        "pair",
        "mast",
        position=(0.05, 0, 0.3),
        radius=0.03,
        other=capsule(0.05, 0.3, "sled", position=(0, 0.1, 0), orientation=[("y", 0.5)]),
        stiffness=500,
        exponent=1,
        width=0.05,
        friction=(0.5, 0.1),
    )
    assert read(WHOLE, tmp_path).contacts == (hull, log, pair)


def name_points(tree: Tree) -> list[str]:
    return [x.name for x in tree.distances]


def test_numbers_become_parameters(tmp_path: Path) -> None:
    """By their paths; points are counted from 1."""
    model = read(WHOLE, tmp_path)
    freed = with_runtime_numbers(model)
    added = {p.name for p in freed.parameters} - {p.name for p in model.parameters}
    assert {x for x in added if any(key in x for key in (".points.", ".wheel.", ".capsule."))} == {
        *(f"contacts.hull.points.{x}" for x in ("2.x", "3.y")),
        "contacts.log.wheel.radius",
        *(f"contacts.pair.capsule.{x}" for x in ("position.y", "orientation.1", "radius", "length")),
    }
    assert name_points(build_tree(freed)) == ["hull.1", "hull.2", "hull.3", "log.1", "log.2", "pair"]
    at = {"q": [0.1, 0.2], "qd": [1, 2]}
    assert call(build_tree(freed), "impl", **at)["Phi"] == pytest.approx(
        call(build_tree(model), "impl", **at)["Phi"], rel=1e-12
    )


# --- faults -----------------------------------------------------------------------------------------------------------

FAULTS = {  # old text, new text, path and piece of the finding
    "no length": (", length: 0.3}", "}", "contacts[2].capsule.length", "missing"),
    "a length of 0": ("length: 0.3}", "length: 0}", "contacts[2].capsule.length", "found 0"),
    "a radius below 0": ("radius: 0.05, l", "radius: -1, l", "contacts[2].capsule.radius", "found -1"),
    "a tiny turn": ("angle: 0.5", "angle: 1e-200", "contacts[2].capsule.orientation[0].angle", "an angle of 1e-200"),
    "a cylinder of a length below 0": (
        "wheel: {radius: 0.1, axis: x, length: long}",
        "wheel: {radius: 0.1, length: -1}",
        "contacts[1].wheel.length",
        "found -1",
    ),
    "one point": (", [0.1, 0, 0], [0, 0.1, 0]]", "]", "contacts[0].points", "one point"),
    "a point in the plane": ("[0.1, 0, 0],", "[0.1, 0],", "contacts[0].points[1]", "list of 2"),
    "an unknown parameter": ("0, long]", "0, short]", "contacts[0].points[0][2]", 'unknown name "short"'),
    "points of a wheel": ("stiffness: 1000}", "stiffness: 1000, wheel: {radius: 1}}", "contacts[0].points", "a wheel"),
    "points and a capsule": (
        "stiffness: 1000}",
        "stiffness: 1000, capsule: {radius: 1, length: 1}}",
        "contacts[0].points",
        "miss a capsule",
    ),
    "a wheel on a capsule": (
        "stiffness: 500}",
        "stiffness: 500, capsule: {radius: 1, length: 1}}",
        "contacts[1].wheel",
        "a wheel and a capsule",
    ),
    "a plane too": ("    exponent: 1", "    plane: {normal: z}\n    exponent: 1", "contacts[2].capsule", "a plane and"),
    "too many points": (
        "[0.1, 0, 0], ",
        "[0.1, 0, 0], " * 101,
        "contacts[0].points",
        "103 points, where 100 are allowed",
    ),
}


@pytest.mark.parametrize(("old", "new", "path", "finding"), FAULTS.values(), ids=FAULTS.keys())
def test_faults_are_found_where_they_are(old: str, new: str, path: str, finding: str, tmp_path: Path) -> None:
    check_fault(WHOLE, old, new, path, finding, tmp_path)
