"""The trees of `tests/reference/*.json`: mechanisms whose dynamics are known from other codes."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path

from mbsgen.model.symbols import exact
from mbsgen.model.tree import Body, Joint, Matrix, Motion, Tree, Vector

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
