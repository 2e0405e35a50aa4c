"""A Tree moves as its Model says: poses and inertias against plain rotation matrices, for joints of any axis."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mpmath.libmp import dps_to_prec
from sympy import Float, Integer, Rational, Symbol

from mbsgen.drawing import pose
from mbsgen.formulations.results.poses import build_frames
from mbsgen.model.changes.reduction import align
from mbsgen.model.reader import read_model
from mbsgen.model.symbols import exact
from mbsgen.model.tree import Kind, Tree
from mbsgen.pipeline import build_parametric
from mbsgen.tape.interpreter import evaluate
from tests.mbsgen.model.descriptions import (
    AXES,
    CLOSE,
    NAMED,
    SKEW,
    STRAIGHT,
    make_description,
    place,
    pose_described,
    pose_tree,
    read,
    to_floats,
)


@pytest.mark.parametrize("seed", range(6))
def test_a_tree_moves_as_its_description_says(seed: int, tmp_path: Path) -> None:
    """Origins, centres of mass, inertias and sensors in the base frame, at random q."""
    axes = [AXES[i] for i in np.random.default_rng(seed).permutation(len(AXES))]
    description = make_description(seed, axes)
    tree = read(description, tmp_path)
    rng = np.random.default_rng(seed)
    q = {body["name"]: float(rng.uniform(-3, 3)) for body in description["bodies"]}
    described, moved = pose_described(description, q), pose_tree(tree, q)
    numbers = {body.name: number for number, body in enumerate(tree.bodies, 1)}
    for body in description["bodies"]:
        (R, p), (Rt, pt) = described[body["name"]], moved[numbers[body["name"]]]
        reduced = tree.bodies[numbers[body["name"]] - 1]
        assert reduced.inertia == tuple(zip(*reduced.inertia, strict=True))
        entry = body["inertia"]
        xx, xy, xz, yy, yz, zz = (entry[key] for key in ("xx", "xy", "xz", "yy", "yz", "zz"))
        tensor = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        np.testing.assert_allclose(pt, p, rtol=0, atol=CLOSE)
        np.testing.assert_allclose(Rt @ to_floats(reduced.axes), R, rtol=0, atol=CLOSE)
        np.testing.assert_allclose(pt + Rt @ to_floats(reduced.com), p + R @ np.array(body["com"]), rtol=0, atol=CLOSE)
        np.testing.assert_allclose(Rt @ to_floats(reduced.inertia) @ Rt.T, R @ tensor @ R.T, rtol=0, atol=CLOSE)
    for frame, sensor in zip(description["frames"], tree.sensors, strict=True):
        R, p = place(described[frame["body"]], frame)
        Rt, pt = moved[sensor.body]
        np.testing.assert_allclose(pt + Rt @ to_floats(sensor.position), p, rtol=0, atol=CLOSE)
        np.testing.assert_allclose(Rt @ to_floats(sensor.orientation), R, rtol=0, atol=CLOSE)


@pytest.mark.parametrize("seed", range(3))
def test_frames_and_pictures_show_bodies_in_the_axes_of_their_author(seed: int, tmp_path: Path) -> None:
    """And joints and masses where the description has them, whatever frames the Tree puts its bodies into."""
    axes = [AXES[i] for i in np.random.default_rng(seed).permutation(len(AXES))]
    description = make_description(seed, axes)
    tree, n = read(description, tmp_path), len(axes)
    rng = np.random.default_rng(seed)
    q = {body.name: float(rng.uniform(-3, 3)) for body in tree.bodies}
    described = pose_described(description, q)
    found = evaluate(build_frames(tree), {"q": list(q.values())})
    p, R = (np.array(found[name], float).reshape(2 * n, 3, -1) for name in ("p", "R"))
    scene = pose(tree, list(q.values()))
    bodies = {body["name"]: body for body in description["bodies"]}
    for k, name in enumerate(q):
        Rd, pd = described[name]
        np.testing.assert_allclose(p[k, :, 0], pd, rtol=0, atol=CLOSE)
        np.testing.assert_allclose(R[k].T, Rd, rtol=0, atol=CLOSE)
        np.testing.assert_allclose(scene.centres[k], pd + Rd @ bodies[name]["com"], rtol=0, atol=CLOSE)
        axis = bodies[name]["joint"]["axis"]
        a = np.array(NAMED[axis] if isinstance(axis, str) else axis, float)
        np.testing.assert_allclose(scene.axes[k], Rd @ a / np.linalg.norm(a), rtol=0, atol=CLOSE)
    for k, frame in enumerate(description["frames"], n):
        Rd, pd = place(described[frame["body"]], frame)
        np.testing.assert_allclose(p[k, :, 0], pd, rtol=0, atol=CLOSE)
        np.testing.assert_allclose(R[k].T, Rd, rtol=0, atol=CLOSE)


@pytest.mark.parametrize("direction", [*STRAIGHT, *SKEW], ids=str)
def test_alignment_turns_the_nearest_coordinate_axis_there(direction: list[float]) -> None:
    """C is a rotation to 50 digits, and C e_k is the direction."""
    k, C = align((exact(direction[0]), exact(direction[1]), exact(direction[2])))
    columns = [[C[i][j] for i in range(3)] for j in range(3)]
    for i in range(3):
        for j in range(3):
            dot = sum((a * b for a, b in zip(columns[i], columns[j], strict=True)), Integer(0))
            assert abs(dot - int(i == j)) < Rational(1, 10**50)
    assert float(np.linalg.det(to_floats(C))) == pytest.approx(1)
    a = np.array(direction)
    np.testing.assert_allclose(to_floats(columns[k]), a / np.linalg.norm(a), rtol=0, atol=2e-16)
    assert k == np.argmax(np.abs(a))


@pytest.mark.parametrize("axis", [*NAMED, *STRAIGHT[6:]], ids=str)
def test_coordinate_axes_cost_nothing(axis: Any, tmp_path: Path) -> None:
    """Their rotations are of 0, 1 and -1 only, and quarter turns are too."""
    description = {
        "name": "quarter",
        "gravity": [0, 0, -9.81],
        "parameters": {"right": "pi/2"},
        "bodies": [
            {
                "name": "b",
                "joint": {"type": "revolute", "axis": axis, "orientation": [{"axis": "x", "angle": "-pi/2"}]},
                "mass": 1,
                "com": [0.1, 0.2, 0.3],
                "inertia": [1, 1.1, 1.2],
            },
            {
                "name": "c",
                "parent": "b",
                "joint": {"type": "prismatic", "axis": "z", "orientation": [{"axis": "y", "angle": "3*right"}]},
                "mass": 1,
            },
        ],
        "frames": [{"name": "s", "body": "b", "orientation": [{"axis": "z", "angle": "2*right"}]}],
    }
    tree = read(description, tmp_path)
    whole = {Integer(-1), Integer(0), Integer(1)}
    orientations = [*(body.orientation for body in tree.bodies), *(sensor.orientation for sensor in tree.sensors)]
    entries = [e for orientation in orientations for row in orientation for e in row]
    assert all(any(entry is w for w in whole) for entry in entries)
    assert sorted(abs(float(x)) for x in tree.bodies[0].com) == [0.1, 0.2, 0.3]
    assert sum(e != 0 for row in tree.bodies[0].inertia for e in row) == 3


def test_a_round_body_stays_round(tmp_path: Path) -> None:
    """Whatever frame it gets: what cancels leaves no trace."""
    description = make_description(0, [[1, 2, 3]])
    description["bodies"][0] |= {"inertia": [0.4, 0.4, 0.4], "com": [1, 2, 3]}
    (body,) = read(description, tmp_path).bodies
    assert sum(e != 0 for row in body.inertia for e in row) == 3
    assert sum(e != 0 for e in body.com) == 1


def test_bodies_keep_their_order_or_go_depth_first(tmp_path: Path) -> None:
    def order(parents: dict[str, str]) -> list[str]:
        description = make_description(1, ["x"] * len(parents))
        for body, (name, parent) in zip(description["bodies"], parents.items(), strict=True):
            body |= {"name": name, "parent": parent}
        tree = read(description | {"frames": []}, tmp_path)
        assert [parents[b.name] for b in tree.bodies] == [("base", *parents_of(tree))[b.parent] for b in tree.bodies]
        return [body.name for body in tree.bodies]

    def parents_of(tree: Tree) -> list[str]:
        return [body.name for body in tree.bodies]

    assert order({"a": "base", "b": "base", "c": "a", "d": "b"}) == ["a", "b", "c", "d"]
    assert order({"d": "b", "a": "base", "c": "a", "b": "base", "e": "c"}) == ["a", "c", "e", "b", "d"]


def test_parameters_stay_symbols_and_structural_zeros_go(tmp_path: Path) -> None:
    description = make_description(2, ["x", "-y"]) | {
        "parameters": {
            "l": 0.3,
            "none": 0,
            "h": {"value": 0, "kind": "runtime"},
            "twice": "2*l",
            "tilt": {"value": 0.1, "kind": "runtime"},
        }
    }
    description["bodies"][0] |= {"mass": "l + twice/3", "com": ["none", "h", "l*none"]}
    description["bodies"][1] |= {"com": ["l", 0, "h"]}
    description["bodies"][1]["joint"]["orientation"] = [{"axis": "z", "angle": "tilt"}]
    tree = read(description, tmp_path)
    l, h, twice, tilt = map(Symbol, ("l", "h", "twice", "tilt"))
    assert [(p.name, p.value, p.kind) for p in tree.parameters] == [
        ("l", 0.3, Kind.CONSTANT),
        ("none", 0.0, Kind.CONSTANT),
        ("h", 0.0, Kind.RUNTIME),
        ("twice", 0.6, Kind.CONSTANT),
        ("tilt", 0.1, Kind.RUNTIME),
    ]
    assert tree.bodies[0].mass == l + twice / 3
    assert tree.bodies[0].com == (0, h, 0)
    assert tree.bodies[1].com == (l, 0, -h)  # a half turn about x
    assert tilt in tree.bodies[1].orientation[0][0].free_symbols


def test_a_tree_does_not_depend_on_the_hash_seed(tmp_path: Path) -> None:
    """Sums of several symbols are where an order could leak in."""
    description = make_description(6, [[1, 2, 3], "-z", "x"]) | {"parameters": {"a": 0.1, "b": 0.2, "c": 0.3}}
    for body in description["bodies"]:
        body |= {"com": ["a - b", "b*c + a", "c/(a + b)"], "mass": "a + b + c"}
    read(description, tmp_path)
    script = (
        "import sys, pathlib\n"
        "from mbsgen.model.reader import read_model\n"
        "from mbsgen.model.changes.reduction import build_tree\n"
        "print(build_tree(read_model(pathlib.Path(sys.argv[1]))))"
    )
    command = [sys.executable, "-c", script, str(tmp_path / "model.yaml")]
    printed = {
        subprocess.run(command, env={"PYTHONHASHSEED": seed}, capture_output=True, text=True, check=True).stdout
        for seed in "123"
    }
    assert len(printed) == 1


def test_numbers_at_run_time_keep_their_values(tmp_path: Path) -> None:
    """Rotations of symbols are rounded once more than rotations of numbers: CLOSE."""
    tree = read(make_description(3, AXES), tmp_path)
    freed = build_parametric(read_model(tmp_path / "model.yaml"))
    values = {p.symbol: exact(p.value) for p in freed.parameters}
    for before, after in zip(tree.bodies, freed.bodies, strict=True):
        assert isinstance(after.mass, Symbol)
        assert after.inertia[0][1] is after.inertia[1][0]
        for name in ("com", "inertia", "position", "orientation"):
            restored = [number.xreplace(values).evalf(20) for number in np.ravel(getattr(after, name))]
            np.testing.assert_allclose(
                to_floats(restored), np.ravel(to_floats(getattr(before, name))), rtol=0, atol=CLOSE
            )


def test_numbers_are_what_a_tape_takes_for_literals(tmp_path: Path) -> None:
    """Fractions, or Floats of 60 digits: nothing is left to evaluate."""
    tree = read(make_description(5, AXES), tmp_path)
    for body in tree.bodies:
        entries = [
            *body.position,
            body.mass,
            *body.com,
            *(e for row in (*body.orientation, *body.inertia) for e in row),
        ]
        assert all(isinstance(entry, Rational | Float) for entry in entries)
        assert {entry._prec for entry in entries if isinstance(entry, Float)} <= {dps_to_prec(60)}
