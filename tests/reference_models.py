"""The trees of `tests/reference/*.json`: mechanisms whose dynamics are known from other codes."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from sympy import Float, Integer

from mbsgen.model.symbols import exact
from mbsgen.model.tree import Body, Joint, Matrix, Motion, Tree, Vector
from tests.random_trees import exact_matrix

REFERENCE = Path(__file__).parent / "reference"
ARM = REFERENCE / "seed_arm_docquier.json"
RANDOM_TREE = REFERENCE / "random_tree12.json"

_MOTIONS = {"R": Motion.REVOLUTE, "P": Motion.PRISMATIC}


def tree_from_reference(path: Path) -> Tree:
    """Build the tree of a reference file: every number constant, every joint actuated and unbounded."""
    content = json.loads(path.read_text(encoding="utf-8"))
    bodies = tuple(
        Body(
            name=f"body{number}",
            parent=body["parent"] + 1,
            joint=Joint(f"q{number}", _MOTIONS[body["joint"][0]], "xyz".index(body["joint"][1]), True, None, None),
            position=_vector(body["r"]),
            orientation=_matrix(zip(*body["R_parent_to_joint"], strict=True)),  # there: from the parent's axes
            mass=exact(body["m"]),
            com=_vector(body["com"]),
            inertia=_matrix(body["I_com"]),
        )
        for number, body in enumerate(content["bodies"], 1)
    )
    return Tree(content["id"], _vector(content["gravity"]), (), bodies, ())


def _vector(values: Iterable[float]) -> Vector:
    x, y, z = map(exact, values)
    return x, y, z


def _matrix(rows: Iterable[Iterable[float]]) -> Matrix:
    a, b, c = map(_vector, rows)
    return a, b, c


def pendulum(axis: int = 1, motion: Motion = Motion.REVOLUTE) -> Tree:
    """A body of 2 kg at 0.5 m below a joint about y, inertia 0.1 about y, gravity along -z."""
    unit = exact_matrix(np.eye(3))
    inertia = exact_matrix(np.diag([0.3, 0.1, 0.2]))
    zero = Integer(0)
    body = Body("rod", 0, Joint("q1", motion, axis, True, None, None), (zero, zero, zero), unit, Float(2.0),
                (zero, zero, Float(-0.5)), inertia)  # fmt: skip
    return Tree("pendulum", (zero, zero, Float(-9.81)), (), (body,), ())


BRANCHED = """\
name: branched
gravity: [0, 0.5, -9.81]
parameters:
  length: 0.4
  mass: {value: 1.5, kind: runtime}
bodies:
  - name: trunk
    joint: {name: turn, type: revolute, axis: [1, 2, 2]}
    mass: mass
    com: [0.1, 0, length/2]
    inertia: [0.2, 0.3, 0.1]
  - name: left
    parent: trunk
    joint: {name: swing, type: revolute, axis: y, position: [0, length, 0], actuated: false}
    mass: 2*mass
    com: [0, 0, -0.2]
    inertia: [0.02, 0.03, 0.01]
  - name: right
    parent: trunk
    joint: {name: slide, type: prismatic, axis: x, position: [0, -length, 0]}
    mass: 0.7
    com: [0.1, 0.2, 0.3]
    inertia: [0.02, 0.03, 0.01]
frames:
  - {name: tip, body: left, position: [0, 0, -length]}
"""
