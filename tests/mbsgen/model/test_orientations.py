"""Ways to write an orientation, an inertia and a joint: against each other, and published Denavit-Hartenberg tables."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from numpy.typing import NDArray

from mbsgen.documents import WrongValueError
from mbsgen.errors import InputError
from mbsgen.formulations import impl
from mbsgen.formulations.results import poses
from mbsgen.model.changes.reduction import build_tree
from mbsgen.model.construction import body, joint
from mbsgen.model.model import Model
from mbsgen.model.reader import read_model
from mbsgen.model.tree import IDENTITY
from mbsgen.model.writer import write_model
from mbsgen.tape.interpreter import evaluate

Array = NDArray[np.float64]
HALF = math.sqrt(0.5)


def read(model: dict[str, Any], folder: Path) -> Model:
    file = folder / "model.yaml"
    file.write_text(yaml.safe_dump({"name": "m", "gravity": [0, 0, -9.81], **model}, sort_keys=False), encoding="utf-8")
    return read_model(file)


def make_wheel(**more: Any) -> dict[str, Any]:
    """Make a wheel with a frame on it."""
    wheel = {"name": "wheel", "joint": {"type": "revolute", "axis": "z"}, "mass": 2, "inertia": [1, 1, 1]}
    return {"bodies": [wheel], "frames": [{"name": "tip", "body": "wheel", **more}]}


def find_pose(model: Model, q: list[float]) -> tuple[Array, Array]:
    """Return the position and the axes of the last sensor."""
    tree = build_tree(model)
    found = evaluate(poses.build_frames(tree), {"q": q})
    return np.array(found["p"][-3:]), np.array(found["R"][-9:]).reshape(3, 3).T


def turn(axis: int, angle: float) -> Array:
    """Rotate about a coordinate axis."""
    R = np.eye(3)
    j, k = (axis + 1) % 3, (axis + 2) % 3
    R[j, j] = R[k, k] = math.cos(angle)
    R[k, j], R[j, k] = math.sin(angle), -math.sin(angle)
    return R


# --- orientations -----------------------------------------------------------------------------------------------------


def test_roll_pitch_and_yaw_turn_about_fixed_axes(tmp_path: Path) -> None:
    model = read(make_wheel(orientation={"rpy": [0.3, "-0.4", "pi/5"]}), tmp_path)
    expected = turn(2, math.pi / 5) @ turn(1, -0.4) @ turn(0, 0.3)
    np.testing.assert_allclose(find_pose(model, [0.0])[1], expected, atol=1e-15)


@pytest.mark.parametrize("seed", range(3))
def test_a_matrix_and_a_quaternion_are_one_orientation(seed: int, tmp_path: Path) -> None:
    """Quaternions of any length, the scalar last: v = q v0 q*."""
    x, y, z, w = np.random.default_rng(seed).normal(size=4)
    v, skew = np.array([x, y, z]), np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    R = ((w * w - v @ v) * np.eye(3) + 2 * np.outer(v, v) + 2 * w * skew) / (w * w + v @ v)
    for given in ({"quaternion": [float(a) for a in (x, y, z, w)]}, {"matrix": R.tolist()}):
        model = read(make_wheel(orientation=given), tmp_path)
        np.testing.assert_allclose(find_pose(model, [0.0])[1], R, atol=1e-15)
        (tmp_path / "again.yaml").write_text(write_model(model), encoding="utf-8")
        assert read_model(tmp_path / "again.yaml") == model


def test_quarter_turns_are_exact(tmp_path: Path) -> None:
    """They have zeros and ones, so that they cost no operation."""
    straight = read(make_wheel(orientation=[{"axis": "x", "angle": "pi/2"}]), tmp_path)
    turned = [
        {"rpy": ["pi/2", 0, 0]},
        {"quaternion": ["sqrt(2)/2", 0, 0, HALF]},
        {"quaternion": [3, 0, 0, 3]},
        {"matrix": [[1, 0, 0], [0, 0, -1], [0, 1, 0]]},
    ]
    for orientation in turned:
        assert read(make_wheel(orientation=orientation), tmp_path) == straight
    for nothing in ({"rpy": [0, 0, 0]}, {"quaternion": [0, 0, 0, -2]}, {"matrix": np.eye(3).tolist()}):
        model = read(make_wheel(orientation=nothing), tmp_path)
        assert build_tree(model).sensors[0].orientation == IDENTITY


# --- inertia ----------------------------------------------------------------------------------------------------------


def test_an_inertia_may_be_about_any_point(tmp_path: Path) -> None:
    """I_P = I + m (d.d 1 - d dT) with d from P to the centre of mass, for numbers and for parameters."""
    own = np.array([[0.4, 0.02, 0.01], [0.02, 0.5, -0.03], [0.01, -0.03, 0.6]])
    point, com = np.array([0.2, -0.1, 0.3]), np.array([0.05, 0.4, 0.0])
    d = com - point
    about = own + 2.5 * (d @ d * np.eye(3) - np.outer(d, d))
    entries = {f"{'xyz'[r]}{'xyz'[c]}": float(about[r, c]) for r in range(3) for c in range(r, 3)}
    for mass in (2.5, "m"):
        wheel = {"name": "wheel", "joint": {"type": "ball"}, "mass": mass, "com": com.tolist()}
        wheel["inertia"] = {**entries, "about": point.tolist()}
        model = read({"parameters": {"m": {"value": 2.5, "kind": "runtime"}}, "bodies": [wheel]}, tmp_path)
        found = np.array(
            [
                [float(x.xreplace(dict.fromkeys(x.free_symbols, 2.5))) for x in row]
                for row in build_tree(model).bodies[-1].inertia
            ]
        )
        np.testing.assert_allclose(found, own, atol=1e-15)


def test_a_point_mass_may_be_given_about_another_point(tmp_path: Path) -> None:
    """Its tensor about its centre of mass is 0, and no rounding."""
    about = {"xx": 0.637, "yy": 0.65, "zz": 0.013, "xz": 0.091, "about": [0, 0, 0]}
    joint = {"type": "revolute", "axis": "y"}
    bob = {"name": "bob", "joint": joint, "mass": 1.3, "com": [0.1, 0, -0.7], "inertia": about}
    tensor = build_tree(read({"bodies": [bob]}, tmp_path)).bodies[-1].inertia
    assert all(entry == 0 for row in tensor for entry in row)
    bob["inertia"] = about | {"zz": 0.02}
    with pytest.raises(InputError, match="no body has the principal moments of inertia"):
        read({"bodies": [bob]}, tmp_path)


# --- Denavit-Hartenberg tables ----------------------------------------------------------------------------------------

PUMA = (  # standard; Corke, "Robotics, vision and control", 2011, section 7.2: theta, d, a, alpha
    (0, 0, 0, "pi/2"),
    (0, 0, 0.4318, 0),
    (0, 0.15005, 0.0203, "-pi/2"),
    (0, 0.4318, 0, "pi/2"),
    (0, 0, 0, "-pi/2"),
    (0, 0, 0, 0),
)
PANDA = (  # modified; Franka Emika's documentation of its control interface, with the flange
    (0, 0.333, 0, 0),
    (0, 0, 0, "-pi/2"),
    (0, 0.316, 0, "pi/2"),
    (0, 0, 0.0825, "pi/2"),
    (0, 0.384, -0.0825, "-pi/2"),
    (0, 0, 0, "pi/2"),
    (0, 0, 0.088, "pi/2"),
)


def make_robot(
    convention: str, rows: tuple[tuple[Any, ...], ...], slides: tuple[int, ...] = (), **more: Any
) -> dict[str, Any]:
    """Make a robot of a table, with a frame on its last body."""
    bodies = [
        {
            "name": f"link{i}",
            "parent": f"link{i - 1}" if i > 1 else "base",
            "joint": {
                **{"type": "dh", "convention": convention, "motion": "prismatic" if i in slides else "revolute"},
                **dict(zip(("theta", "d", "a", "alpha"), row, strict=True)),
            },
            "mass": 1 + 0.1 * i,
            "com": [0.02, -0.03 * i, 0.05],
            "inertia": [0.02, 0.03, 0.04],
        }
        for i, row in enumerate(rows, 1)
    ]
    return {"bodies": bodies, "frames": [{"name": "tip", "body": f"link{len(rows)}", **more}]}


@pytest.mark.parametrize(
    ("q", "position", "axes"),
    [
        ([0, 0, 0, 0, 0, 0], [0.4521, -0.1500, 0.4318], np.eye(3)),
        ([0, math.pi / 4, math.pi, 0, math.pi / 4, 0], [0.5963, -0.1501, -0.0144], [[0, 0, 1], [0, 1, 0], [-1, 0, 0]]),
    ],
)
def test_a_puma_is_where_its_book_has_it(q: list[float], position: list[float], axes: Any, tmp_path: Path) -> None:
    """The poses qz and qn, to the digits that are printed."""
    p, R = find_pose(read(make_robot("standard", PUMA), tmp_path), q)
    np.testing.assert_allclose(p, position, atol=1e-4)
    np.testing.assert_allclose(R, axes, atol=1e-15)


def test_a_panda_is_where_its_maker_has_it(tmp_path: Path) -> None:
    """With all joints at 0 the flange is 88 mm ahead, 926 mm up, and looks down."""
    p, R = find_pose(read(make_robot("modified", PANDA, position=[0, 0, 0.107]), tmp_path), [0.0] * 7)
    np.testing.assert_allclose(p, [0.088, 0, 0.926], atol=1e-15)
    np.testing.assert_allclose(R, np.diag([1.0, -1.0, -1.0]), atol=1e-15)


@pytest.mark.parametrize("convention", ["standard", "modified"])
def test_a_table_is_the_product_of_its_rows(convention: str, tmp_path: Path) -> None:
    """Also with sliding joints, and where the robot stands on a base that is displaced."""
    rng = np.random.default_rng(4)
    rows = tuple(tuple(map(float, rng.uniform(-1, 1, 4))) for _ in range(4))
    model = make_robot(convention, rows, slides=(2,))
    model["bodies"][0]["joint"] |= {"position": [0.1, 0.2, 0.3], "orientation": {"rpy": [0.5, 0, 0]}}
    q = list(map(float, rng.uniform(-2, 2, 4)))
    p, R = np.array([0.1, 0.2, 0.3]), turn(0, 0.5)
    for i, (theta, d, a, alpha) in enumerate(rows):
        theta, d = (theta, d + q[i]) if i == 1 else (theta + q[i], d)
        screw_z, screw_x = (turn(2, theta), np.array([0, 0, d])), (turn(0, alpha), np.array([a, 0, 0]))
        for turned, moved in (screw_z, screw_x) if convention == "standard" else (screw_x, screw_z):
            p, R = p + R @ moved, R @ turned
    found = find_pose(read(model, tmp_path), q)
    np.testing.assert_allclose(found[0], p, atol=1e-15)
    np.testing.assert_allclose(found[1], R, atol=1e-15)


def test_both_conventions_are_one_robot(tmp_path: Path) -> None:
    """A standard table, and the modified one whose row i has a and alpha of the row before: the same equations.

    Masses are on the last body, whose frames coincide where the last row has neither a nor alpha.
    """
    shifted = tuple((*row[:2], *before[2:]) for row, before in zip(PUMA, ((0, 0, 0, 0), *PUMA), strict=False))
    results = []
    for convention, rows in (("standard", PUMA), ("modified", shifted)):
        model = make_robot(convention, rows)
        for link in model["bodies"][:-1]:
            del link["mass"], link["com"], link["inertia"]
            link["joint"]["armature"] = 0.3
        tree = build_tree(read(model, tmp_path))
        rng = np.random.default_rng(1)
        given = {name: list(rng.uniform(-1, 1, 6)) for name in ("q", "qd", "qdd", "u")}
        results.append(evaluate(impl.build(tree), given)["Phi"])
        assert [j.name for j in tree.joints] == [f"link{i}" for i in range(1, 7)]
    np.testing.assert_allclose(results[0], results[1], atol=1e-13)


def test_a_standard_table_is_written_as_joints_and_fixed_bodies(tmp_path: Path) -> None:
    model = read(make_robot("standard", PUMA), tmp_path)
    (tmp_path / "again.yaml").write_text(write_model(model), encoding="utf-8")
    assert read_model(tmp_path / "again.yaml") == model
    assert [b.name for b in model.bodies[5:8]] == ["link6", "link1.joint", "link2.joint"]


def test_python_takes_modified_rows_alone() -> None:
    row = joint("dh", convention="modified", a=0.3, alpha="pi/2")
    assert body("arm", row, mass=1).joints[0].placement.position[0].value == 0.3  # type: ignore[union-attr]
    with pytest.raises(WrongValueError, match="beyond its joint"):
        body("arm", joint("dh", convention="standard", a=0.3), mass=1)


# --- faults -----------------------------------------------------------------------------------------------------------

FAULTS: dict[str, tuple[dict[str, Any], str, str]] = {  # keys of the frame or the joint, path, piece of the finding
    "two numbers of three": ({"orientation": {"rpy": [0, 0]}}, "frames[0].orientation.rpy", "2"),
    "two ways at once": ({"orientation": {"rpy": [0, 0, 0], "matrix": 1}}, "frames[0].orientation", ""),
    "an unknown way": ({"orientation": {"euler": [0, 0, 0]}}, "frames[0].orientation", "euler"),
    "three of four": ({"orientation": {"quaternion": [0, 0, 1]}}, "frames[0].orientation.quaternion", "found"),
    "no length": ({"orientation": {"quaternion": [0, 0, 0, 0]}}, "frames[0].orientation.quaternion", "length 0"),
    "a name": ({"orientation": {"quaternion": [0, 0, 0, "s"]}}, "frames[0].orientation.quaternion", "unknown name"),
    "two rows": ({"orientation": {"matrix": [[1, 0, 0], [0, 1, 0]]}}, "frames[0].orientation.matrix", "found"),
    "a shear": (
        {"orientation": {"matrix": [[1, 0, 0.1], [0, 1, 0], [0, 0, 1]]}},
        "frames[0].orientation.matrix",
        "0.1",
    ),
    "a mirror": (
        {"orientation": {"matrix": [[1, 0, 0], [0, 1, 0], [0, 0, -1]]}},
        "frames[0].orientation.matrix",
        "left-handed",
    ),
    "an angle like none": (
        {"orientation": [{"axis": "x", "angle": 1e-300}]},
        "frames[0].orientation[0].angle",
        "an angle of 1e-300",
    ),
    "no convention": ({"type": "dh", "a": 1}, "bodies[0].joint.convention", "missing"),
    "a third convention": ({"type": "dh", "convention": "craig"}, "bodies[0].joint.convention", "craig"),
    "an axis": ({"type": "dh", "convention": "standard", "axis": "x"}, "bodies[0].joint.axis", "axis"),
    "an unknown length": ({"type": "dh", "convention": "standard", "a": "l"}, "bodies[0].joint", "unknown name"),
    "an unknown offset": ({"type": "dh", "convention": "standard", "d": "l"}, "bodies[0].joint", "unknown name"),
    "an unknown angle": ({"type": "dh", "convention": "modified", "alpha": "l"}, "bodies[0].joint", "unknown name"),
    "a limit of the carrier": (
        {"type": "dh", "convention": "standard", "limits": [1, -1]},
        "bodies[0].joint.limits",
        "above",
    ),
}


@pytest.mark.parametrize(("keys", "path", "finding"), FAULTS.values(), ids=FAULTS.keys())
def test_faults_are_found_where_they_are(keys: dict[str, Any], path: str, finding: str, tmp_path: Path) -> None:
    model = make_wheel(**(keys if "orientation" in keys else {}))
    if "type" in keys:
        model["bodies"][0]["joint"] = keys
    with pytest.raises(InputError) as raised:
        read(model, tmp_path)
    faults = raised.value.faults
    assert all(fault.path.startswith(path) and fault.line > 1 and fault.remedy for fault in faults), str(raised.value)
    assert any(finding in f"{fault.path} {fault.finding}" for fault in faults), str(raised.value)
