"""Models as plain data, drawn at random, and the poses of their bodies in plain rotation matrices."""

from __future__ import annotations

from copy import copy
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from mbsgen.model.changes.reduction import build_tree
from mbsgen.model.reader import read_model
from mbsgen.model.tree import Motion, Tree

Array = NDArray[np.float64]
Pose = tuple[Array, Array]  # rotation, origin
NAMED: dict[str, list[float]] = {
    "x": [1, 0, 0],
    "y": [0, 1, 0],
    "z": [0, 0, 1],
    "-x": [-1, 0, 0],
    "-y": [0, -1, 0],
    "-z": [0, 0, -1],
}
STRAIGHT: list[list[float]] = [*NAMED.values(), [0, 0, 2], [0, -3, 0]]
SKEW: list[list[float]] = [[0, 0.6, 0.8], [1, -1, 0], [1, 1, 1], [-1, 2, -3], [1e-9, 0, -1]]
AXES = [*NAMED, *STRAIGHT[6:], *SKEW]  # as they are written in files
CLOSE = 1e-13  # rounding of some ten rotations and sums of lengths near 1
FIXED = 0.4  # of the bodies


def make_fixed_description(seed: int) -> dict[str, Any]:
    """Draw a branched tree with joints of any axis, of whose bodies many are fixed."""
    rng = np.random.default_rng(seed + 100)
    description = make_description(seed, [copy(AXES[i]) for i in rng.integers(len(AXES), size=14)])
    for body in description["bodies"][1:]:
        if rng.random() < FIXED:
            joint = body["joint"]
            body["joint"] = {"type": "fixed", "position": joint["position"], "orientation": joint["orientation"]}
    return description


def pose_described(description: dict[str, Any], q: dict[str, float]) -> dict[str, Pose]:
    """Pose every body in its author's frame, in plain matrices."""
    poses: dict[str, Pose] = {"base": (np.eye(3), np.zeros(3))}
    for body in description["bodies"]:
        joint = body["joint"]
        R, p = place(poses[body["parent"]], joint)
        if joint["type"] != "fixed":
            a = to_direction(joint["axis"])
            if joint["type"] == "revolute":
                R = R @ Rotation.from_rotvec(a * q[body["name"]]).as_matrix()
            else:
                p = p + R @ a * q[body["name"]]
        poses[body["name"]] = (R, p)
    return poses


def to_direction(axis: Any) -> Array:
    vector = (
        np.array(axis, float) if isinstance(axis, list) else np.eye(3)["xyz".index(axis[-1])] * (-1) ** len(axis[:-1])
    )
    return vector / np.linalg.norm(vector)


def make_description(seed: int, axes: list[Any]) -> dict[str, Any]:
    """Draw a branched tree of one body for each axis, with full inertias and sensors off the joints."""
    rng = np.random.default_rng(seed)

    def draw_placement() -> dict[str, Any]:
        turns = [{"axis": str(rng.choice(list("xyz"))), "angle": rng.uniform(-3, 3)} for _ in range(rng.integers(4))]
        return {"position": rng.uniform(-1, 1, 3).tolist(), "orientation": turns}

    def draw_inertia() -> dict[str, float]:
        points = rng.uniform(-1, 1, (4, 3))  # of a body made of four points
        tensor = sum(p @ p * np.eye(3) - np.outer(p, p) for p in points)
        return {f"{'xyz'[i]}{'xyz'[j]}": float(tensor[i, j]) for i in range(3) for j in range(i, 3)}

    bodies = [
        {
            "name": f"b{i}",
            "parent": f"b{rng.integers(i)}" if i else "base",
            "joint": {"type": str(rng.choice(["revolute", "prismatic"])), "axis": axis, **draw_placement()},
            "mass": float(rng.uniform(0.5, 2)),
            "com": rng.uniform(-1, 1, 3).tolist(),
            "inertia": draw_inertia(),
        }
        for i, axis in enumerate(axes)
    ]
    frames = [{"name": f"s{i}", "body": f"b{i}", **draw_placement()} for i in range(len(axes))]
    return {"name": "random", "gravity": [0.3, -0.2, -9.81], "bodies": bodies, "frames": frames}


def read(description: dict[str, Any], folder: Path) -> Tree:
    file = folder / "model.yaml"
    file.write_text(yaml.safe_dump(description, sort_keys=False), encoding="utf-8")
    return build_tree(read_model(file))


def place(pose: Pose, placement: dict[str, Any]) -> Pose:
    R, p = pose
    angles = [(turn["axis"], turn["angle"]) for turn in placement.get("orientation", [])]
    turned = R
    for axis, angle in angles:
        turned = turned @ Rotation.from_euler(axis, angle).as_matrix()
    return turned, p + R @ np.array(placement.get("position", [0, 0, 0]))


def to_floats(numbers: Any) -> Array:
    return np.array(numbers, dtype=float)


def pose_tree(tree: Tree, q: dict[str, float]) -> list[Pose]:
    poses: list[Pose] = [(np.eye(3), np.zeros(3))]
    for body in tree.bodies:
        R, p = poses[body.parent]
        p = p + R @ to_floats(body.position)
        R = R @ to_floats(body.orientation)
        e = np.eye(3)[body.joint.axis]
        if body.joint.motion is Motion.REVOLUTE:
            R = R @ Rotation.from_rotvec(e * q[body.name]).as_matrix()
        else:
            p = p + R @ e * q[body.name]
        poses.append((R, p))
    return poses
