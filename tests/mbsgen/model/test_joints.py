"""Fixed bodies are merged with their parents, and sequences of joints are resolved to elementary joints."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation
from sympy import Symbol

from mbsgen.model.changes.reduction import build_tree
from mbsgen.model.reader import read_model
from mbsgen.model.symbols import exact
from mbsgen.model.tree import Body, Motion, Tree
from tests.mbsgen.model.descriptions import (
    CLOSE,
    Array,
    make_fixed_description,
    place,
    pose_described,
    pose_tree,
    read,
    to_floats,
)


def tensor_of(entry: dict[str, float]) -> Array:
    xx, xy, xz, yy, yz, zz = (entry[key] for key in ("xx", "xy", "xz", "yy", "yz", "zz"))
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def find_carrier(description: dict[str, Any], name: str) -> str:
    """Name what a body is fixed to in the end: a body that moves, or the base."""
    bodies = {body["name"]: body for body in description["bodies"]}
    while name != "base" and bodies[name]["joint"]["type"] == "fixed":
        name = bodies[name]["parent"]
    return name


@pytest.mark.parametrize("seed", range(8))
def test_fixed_bodies_become_one_with_what_carries_them(seed: int, tmp_path: Path) -> None:
    """Mass, centre of mass, inertia about it and sensors in the base frame, at random q; summed in plain matrices."""
    description = make_fixed_description(seed)
    tree = read(description, tmp_path)
    rng = np.random.default_rng(seed)
    q = {body["name"]: float(rng.uniform(-3, 3)) for body in description["bodies"]}
    described, moved = pose_described(description, q), pose_tree(tree, q)
    carriers = {body["name"]: find_carrier(description, body["name"]) for body in description["bodies"]}
    assert [body.name for body in tree.bodies] == [name for name, carrier in carriers.items() if name == carrier]
    assert len(tree.bodies) < len(carriers)
    for number, body in enumerate(tree.bodies, 1):
        parts = [part for part in description["bodies"] if carriers[part["name"]] == body.name]
        masses = np.array([part["mass"] for part in parts])
        poses = [described[part["name"]] for part in parts]
        coms = np.array([p + R @ np.array(part["com"]) for part, (R, p) in zip(parts, poses, strict=True)])
        com = masses @ coms / masses.sum()
        tensor = np.zeros((3, 3))
        for part, (R, _), mass, d in zip(parts, poses, masses, coms - com, strict=True):
            tensor += R @ tensor_of(part["inertia"]) @ R.T + mass * (d @ d * np.eye(3) - np.outer(d, d))
        R, p = moved[number]
        assert float(body.mass) == pytest.approx(masses.sum(), rel=1e-15)
        np.testing.assert_allclose(p + R @ to_floats(body.com), com, rtol=0, atol=10 * CLOSE)
        np.testing.assert_allclose(R @ to_floats(body.inertia) @ R.T, tensor, rtol=0, atol=100 * CLOSE)
    for frame, sensor in zip(description["frames"], tree.sensors, strict=True):
        R, p = place(described[frame["body"]], frame)
        Rt, pt = moved[sensor.body]
        np.testing.assert_allclose(pt + Rt @ to_floats(sensor.position), p, rtol=0, atol=10 * CLOSE)
        np.testing.assert_allclose(Rt @ to_floats(sensor.orientation), R, rtol=0, atol=10 * CLOSE)


def build(text: str, folder: Path) -> Tree:
    file = folder / "model.yaml"
    file.write_text(f"name: m\ngravity: [0, 0, -9.81]\n{text}", encoding="utf-8")
    return build_tree(read_model(file))


def test_what_is_fixed_to_the_base_vanishes(tmp_path: Path) -> None:
    """With all that is fixed to it; what stands on it, and its sensors, stand on the base."""
    tree = build(
        """
bodies:
  - {name: table, joint: {type: fixed, position: [0, 0, 0.75]}, mass: 30, inertia: [1, 1, 1]}
  - {name: block, parent: table, joint: {type: fixed, position: [0.2, 0, 0]}, mass: 3}
  - {name: arm, parent: block, joint: {type: revolute, axis: z, position: [0, 0, 0.1]}, mass: 1, com: [1, 0, 0]}
frames:
  - {name: mark, body: block, position: [0, 0.5, 0]}
""",
        tmp_path,
    )
    (arm,) = tree.bodies
    assert (arm.name, arm.parent, arm.mass) == ("arm", 0, 1)
    assert to_floats(arm.position) == pytest.approx([0.2, 0, 0.85], abs=1e-16)
    assert tree.sensors[0].body == 0
    assert to_floats(tree.sensors[0].position) == pytest.approx([0.2, 0.5, 0.75], abs=1e-16)


def test_a_massless_body_takes_over_what_is_fixed_to_it(tmp_path: Path) -> None:
    """To the last digit and symbol; here also with a half turn."""
    tree = build(
        """
parameters: {m: 3, d: {value: 0.2, kind: runtime}}
bodies:
  - {name: hub, joint: {type: revolute, axis: z}}
  - name: disc
    parent: hub
    joint: {type: fixed, position: [d, 0, 0], orientation: [{axis: x, angle: pi}]}
    mass: m
    com: [0.1, 0.2, 0]
    inertia: {xx: 1, yy: 1, zz: 1.5, xy: 0.1}
""",
        tmp_path,
    )
    (hub,) = tree.bodies
    assert hub.name == "hub"
    assert hub.mass == Symbol("m")
    assert hub.com == (Symbol("d") + exact(0.1), -exact(0.2), 0)
    assert hub.inertia == ((1, -exact(0.1), 0), (-exact(0.1), 1, 0), (0, 0, exact(1.5)))


def test_run_time_masses_stay_symbols_when_bodies_are_merged(tmp_path: Path) -> None:
    """For all later values, the merged body equals the body of numbers."""
    text = """
parameters: {{m: {m}, c: {c}}}
bodies:
  - {{name: link, joint: {{type: revolute, axis: y}}, mass: 2, com: [0.3, 0, 0.1], inertia: [0.1, 0.2, 0.2]}}
  - name: load
    parent: link
    joint: {{type: fixed, position: [0.6, 0, 0], orientation: [{{axis: y, angle: 0.4}}]}}
    mass: m
    com: [c, 0.1, 0]
    inertia: {{xx: m/10, yy: m/12, zz: m/15, xz: 0.01}}
"""
    symbolic = build(text.format(m="{value: 1, kind: runtime}", c="{value: 0, kind: runtime}"), tmp_path).bodies[0]
    m, c = map(Symbol, "mc")
    (load,) = symbolic.parts
    assert (symbolic.mass, load.mass, load.name) == (2, m, "load")
    assert c in load.com[0].free_symbols
    for values in ({"m": 3.5, "c": -0.2}, {"m": 0.5, "c": 4.0}, {"m": 0.0, "c": 1.0}):
        R = Rotation.from_euler("y", 0.4).as_matrix()
        mass, com = values["m"], [0.6, 0, 0] + R @ [values["c"], 0.1, 0]
        tensor = np.diag([mass / 10, mass / 12, mass / 15])
        tensor[0, 2] = tensor[2, 0] = 0.01
        own = (2.0, np.array([0.3, 0, 0.1]), np.diag([0.1, 0.2, 0.2]))
        expected = add_moments([own, (mass, com, R @ tensor @ R.T)])
        for found, sum_of_both in zip(evaluate_moments(symbolic, values), expected, strict=True):
            np.testing.assert_allclose(found, sum_of_both, rtol=1e-14, atol=1e-15)


Moments = tuple[float, Array, Array]


def evaluate_moments(body: Body, values: dict[str, float]) -> Moments:
    """Evaluate the moments of a body and its parts."""
    table = {Symbol(name): exact(value) for name, value in values.items()}

    def restore(numbers: object) -> Array:
        return np.vectorize(lambda x: float(x.subs(table)), otypes=[float])(np.array(numbers, dtype=object))

    return add_moments([(float(restore(x.mass)), restore(x.com), restore(x.inertia)) for x in (body, *body.parts)])


def add_moments(parts: list[Moments]) -> Moments:
    """Add up mass, first moment and tensor about the origin, of masses with their centres and tensors about them."""
    mass, first, second = 0.0, np.zeros(3), np.zeros((3, 3))
    for m, l, In in parts:
        mass, first, second = mass + m, first + m * l, second + In + m * (l @ l * np.eye(3) - np.outer(l, l))
    return mass, first, second


TYPES = {
    "cardan": ("{type: cardan}", ["rx", "ry"]),
    "universal": ("{type: universal, order: zx}", ["rz", "rx"]),
    "spherical": ("{type: spherical}", ["rz", "ry", "rx"]),
    "an order": ("{type: spherical, order: xzy}", ["rx", "rz", "ry"]),
    "planar": ("{type: planar}", ["x", "y", "rz"]),
    "a plane": ("{type: planar, plane: xz}", ["x", "z", "ry"]),
    "floating": ("{type: floating}", ["x", "y", "z", "rz", "ry", "rx"]),
    "a placed one": (
        "{type: cardan, position: [0.1, 0, 0.2], orientation: [{axis: z, angle: 0.3}]}",
        ["rx", "ry"],
    ),
    "a list": (
        "[{type: prismatic, axis: z}, {type: revolute, axis: -z}, {type: revolute, axis: [1, 1, 0]}]",
        ["z", "rz", "r"],
    ),
    "repeated axes": (
        "[{type: revolute, axis: z}, {type: revolute, axis: x}, {type: revolute, axis: z, position: [0, 0, 0.1]}]",
        ["rz", "rx", "rz2"],
    ),
    "other slides": ("[{type: prismatic, axis: [1, 1, 0]}, {type: prismatic, axis: [1, -1, 0]}]", ["t", "t2"]),
}
TRUNK = "mass: 2, com: [0.1, 0.2, 0.3], inertia: [1, 1.1, 1.2]"


@pytest.mark.parametrize(("joint", "labels"), TYPES.values(), ids=TYPES.keys())
def test_a_sequence_is_its_elementary_joints(joint: str, labels: list[str], tmp_path: Path) -> None:
    """The same Tree as of bodies without mass, one joint each, written out by hand."""
    data = yaml.safe_load(joint)
    if isinstance(data, dict):
        passive = {"actuated": False} if data["type"] in ("floating", "planar") else {}
        joints = [
            {"type": "revolute" if label[0] == "r" else "prismatic", "axis": label[-1], **passive} for label in labels
        ]
        joints[0] |= {key: data[key] for key in ("position", "orientation") if key in data}
    else:
        joints = data
    names = [f"trunk.{label}" for label in labels]
    chain = [
        {
            "name": name if k < len(names) - 1 else "trunk",
            "parent": names[k - 1] if k else "base",
            "joint": {"name": name, **one},
        }
        for k, (name, one) in enumerate(zip(names, joints, strict=True))
    ]
    chain[-1] |= yaml.safe_load(f"{{{TRUNK}}}")
    short = build(f"bodies:\n  - {{name: trunk, joint: {joint}, {TRUNK}}}\n", tmp_path)
    assert short == build(yaml.safe_dump({"bodies": chain}), tmp_path)
    assert [body.joint.name for body in short.bodies] == names


def test_a_floating_base_is_passive_unless_told_otherwise(tmp_path: Path) -> None:
    def actuated(setting: str) -> list[bool]:
        tree = build(f"bodies:\n  - {{name: b, joint: {{type: floating{setting}}}, {TRUNK}}}\n", tmp_path)
        return [body.joint.actuated for body in tree.bodies]

    assert actuated("") == [False] * 6
    planar = build(f"bodies:\n  - {{name: b, joint: {{type: planar}}, {TRUNK}}}\n", tmp_path)
    assert not any(body.joint.actuated for body in planar.bodies)  # nothing drives a body that moves freely in a plane
    assert actuated(", actuated: true") == [True] * 6
    assert actuated(", axes: {rz: {actuated: true}}") == [False, False, False, True, False, False]
    assert actuated(", actuated: true, axes: {z: {actuated: false}}") == [True, True, False, True, True, True]


def test_axes_of_a_joint_may_have_names_limits_and_forces(tmp_path: Path) -> None:
    setting = "axes: {rx: {limits: [-pi/4, null], damping: 2}, ry: {name: nod, stiffness: 3}}"
    rx, ry = build(f"bodies:\n  - {{name: b, joint: {{type: cardan, {setting}}}, {TRUNK}}}\n", tmp_path).bodies
    qd = Symbol("qd", real=True)
    assert (rx.joint.name, rx.joint.lower, rx.joint.upper, rx.joint.law) == ("b.rx", -np.pi / 4, None, -2 * qd)
    assert (ry.joint.name, ry.joint.lower, ry.joint.law) == ("nod", None, -3 * Symbol("q", real=True))


def test_bodies_stand_on_the_end_of_a_sequence(tmp_path: Path) -> None:
    tree = build(
        f"bodies:\n  - {{name: b, joint: {{type: planar}}, {TRUNK}}}\n"
        f"  - {{name: c, parent: b, joint: {{type: revolute, axis: x}}, {TRUNK}}}\n",
        tmp_path,
    )
    assert [(body.name, body.parent) for body in tree.bodies] == [("b.x", 0), ("b.y", 1), ("b", 2), ("c", 3)]
    assert [body.joint.motion for body in tree.bodies].count(Motion.PRISMATIC) == 2
