"""Loops and constraints of model files become frames on bodies of the Tree, and equations over coordinates."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from sympy import Integer, Symbol, cos, sin

from mbsgen.model.changes.reduction import build_tree
from mbsgen.model.changes.releasing import with_runtime_numbers
from mbsgen.model.construction import body, constraint, end, loop, make_model, revolute, rod, runtime
from mbsgen.model.model import Model
from mbsgen.model.reader import read_model
from mbsgen.model.symbols import exact, to_double
from mbsgen.model.tree import Cut, Kind, LoopFrame, Tree, coordinate_symbol
from tests.mbsgen.model.descriptions import (
    AXES,
    CLOSE,
    Pose,
    make_fixed_description,
    place,
    pose_described,
    pose_tree,
    read,
    to_direction,
    to_floats,
)
from tests.mbsgen.model.files import LINKAGE

WITH_AXES = ("hinge", "universal", "cylindrical", "prismatic", "planar")
TYPES = ("rod", "ball", *WITH_AXES, "solid")


def draw_loops(description: dict[str, Any], seed: int) -> list[dict[str, Any]]:
    """Draw a loop of every type, between bodies that may be fixed to others."""
    rng = np.random.default_rng(seed)
    bodies = [b["name"] for b in description["bodies"]]
    moving = [b["name"] for b in description["bodies"] if b["joint"]["type"] != "fixed"]

    def draw_end(body: str) -> dict[str, Any]:
        turns = [{"axis": str(rng.choice(list("xyz"))), "angle": rng.uniform(-3, 3)} for _ in range(2)]
        return {"body": body, "position": rng.uniform(-1, 1, 3).tolist(), "orientation": turns}

    loops = []
    for kind in TYPES:
        last = str(rng.choice(moving))
        first = str(rng.choice(["base", *(name for name in bodies[: bodies.index(last)])]))
        drawn: dict[str, Any] = {"name": kind, "type": kind, "from": draw_end(first), "to": draw_end(last)}
        drawn |= {"axis": AXES[rng.integers(len(AXES))]} if kind in WITH_AXES else {}
        drawn |= {"axis2": [0.3, -0.5, 0.7]} if kind == "universal" else {}
        loops.append(drawn | ({"length": 0.7} if kind == "rod" else {}))
    return loops


@pytest.mark.parametrize("seed", range(4))
def test_frames_of_loops_are_where_the_file_places_them(seed: int, tmp_path: Path) -> None:
    """Each end has its origin, the author's axis is its z axis, and both ends are turned from the author's alike."""
    description = make_fixed_description(seed)
    description["loops"] = loops = draw_loops(description, seed)
    tree = read(description, tmp_path)
    q = dict(
        zip((b["name"] for b in description["bodies"]), np.random.default_rng(seed).uniform(-2, 2, 14), strict=True)
    )
    authored, posed = pose_described(description, q), pose_tree(tree, q)
    for given, made in zip(loops, tree.loops, strict=True):
        assert (made.name, made.cut) == (given["name"], Cut(given["type"]))
        turned = []
        for key, axis, frame in (("from", "axis", made.first), ("to", "axis2", made.second)):
            R, p = place(authored[given[key]["body"]], given[key])
            axes, origin = pose_frame(frame, posed)
            np.testing.assert_allclose(origin, p, atol=20 * CLOSE)
            direction = given.get(axis if made.cut is Cut.UNIVERSAL else "axis", "z")
            np.testing.assert_allclose(axes[:, 2], R @ to_direction(direction), atol=20 * CLOSE)
            np.testing.assert_allclose(np.cross(axes[:, 0], axes[:, 1]), axes[:, 2], atol=20 * CLOSE)
            turned.append(R.T @ axes)
        if made.cut is not Cut.UNIVERSAL:
            np.testing.assert_allclose(turned[0], turned[1], atol=20 * CLOSE)


def pose_frame(frame: LoopFrame, posed: list[Pose]) -> Pose:
    R, p = posed[frame.body]
    return R @ to_floats(frame.axes), p + R @ to_floats(frame.position)


def test_a_rod_has_its_length_and_a_universal_joint_its_angle() -> None:
    tree = build_tree(make_linkage(loops=[
        rod("strut", end("arm"), end("base"), "2*l"),
        loop("skew", "universal", end("arm"), end("base"), axis="x", axis2=(1, 1, 0)),
        loop("straight", "universal", end("arm"), end("base"), axis=(0, 0.6, 0.8)),
    ]))  # fmt: skip
    length, skew, straight = (x.value for x in tree.loops)
    assert length == 2 * Symbol("l")
    assert to_double(skew) == pytest.approx(np.sqrt(0.5), rel=1e-15)
    assert straight is Integer(0)  # structural: kernels do not compute it


def make_linkage(**parts: Any) -> Model:
    arm = body("arm", revolute("y", name="q1"), mass=1, com=(0, 0, 1))
    hand = body("hand", revolute("y", name="q2", position=(0, 0, 1)), parent="arm", mass=1, com=(0, 0, 1))
    third = body("third", revolute("z", name="q3", actuated=False), parent="hand", mass=1, com=(0, 1, 1))
    return make_model("m", [arm, hand, third], gravity=(0, 0, 0), parameters={"k": 2, "l": runtime(0.5)}, **parts)


def test_equations_are_expressions_of_coordinates() -> None:
    """Joints that follow others are replaced by the joints that lead them."""
    equations = ["q3 - k*sin(q2) + l", "q1*cos(q3)"]
    tree = build_tree(make_linkage(constraints=[constraint(f"c{i}", text) for i, text in enumerate(equations)]))
    q1, q2, q3 = map(coordinate_symbol, ("q1", "q2", "q3"))
    k, l = Symbol("k"), Symbol("l")
    assert [x.equation for x in tree.constraints] == [q3 - k * sin(q2) + l, q1 * cos(q3)]
    assert tree.symbols == {k, l}
    assert tree.is_constrained


def test_joints_beside_loops_are_numbered() -> None:
    tree = build_tree(
        make_linkage(
            loops=[rod("strut", end("third"), end("base"), 1)],
            driven=["q3"],
            independent=["q2", "q1"],
            assembly={"q3": "k*pi", "q1": "2*l"},
        )
    )
    assert (tree.driven, tree.chosen) == ((3,), (1, 2))
    assert tree.rough == ((1, 1.0), (3, 2 * np.pi))


def test_python_makes_the_same_model_as_a_file(tmp_path: Path) -> None:
    file = tmp_path / "model.yaml"
    file.write_text(LINKAGE, encoding="utf-8")
    read_one = read_model(file)
    knee = loop(
        "knee",
        "revolute",
        end("coupler", position=(0.4, 0, 0)),
        end("rocker", position=(0, 0, 0.2), orientation=[("y", 0.3)]),
        axis="y",
    )
    strut = rod("strut", end("rocker", position=(0, 0, 0.2)), end("slider"), 0.4)
    made = make_model(
        "linkage",
        read_one.bodies,
        gravity=(0, 0, -9.81),
        parameters={"a": 0.2, "m": runtime(3)},
        loops=[knee, strut],
        constraints=[constraint("cam", "q4 - a*sin(q1)")],
        driven=["q1"],
        independent=["q1"],
        assembly={"q2": 0.1, "ball.rx": "pi/2"},
    )
    assert made == read_one


def test_numbers_of_loops_and_equations_become_parameters(tmp_path: Path) -> None:
    """They have their paths in the file; at their present values, frames and equations are the file's."""
    file = tmp_path / "model.yaml"
    file.write_text(LINKAGE.replace("a*sin(q1)", "a*sin(3*q1) + 0.1"), encoding="utf-8")
    model = read_model(file)
    released, zeros = (with_runtime_numbers(model, zeros=zeros) for zeros in (False, True))
    place = {"loops.knee.from.position.x", "loops.knee.to.position.z", "loops.knee.to.orientation.1"}
    names = {"loops.strut.from.position.z", "loops.strut.length", "constraints.cam.1", "constraints.cam.2"}
    assert {p.name for p in released.parameters if p.name[:4] in ("loop", "cons")} == place | names
    assert {f"loops.strut.to.position.{axis}" for axis in "xyz"} <= {p.name for p in zeros.parameters}
    assert {p.name: p.kind for p in released.parameters}["a"] is Kind.RUNTIME
    written = build_tree(model)
    for tree in map(build_tree, (released, zeros)):
        assert list_loop_numbers(tree) == pytest.approx(list_loop_numbers(written), abs=1e-15)


def list_loop_numbers(tree: Tree) -> list[float]:
    """List the numbers of frames, and the values of equations at some coordinates."""
    values = {p.symbol: exact(p.value) for p in tree.parameters}
    values |= {coordinate_symbol(b.joint.name): exact(0.3 * i) for i, b in enumerate(tree.bodies, 1)}
    numbers = [x.value for x in tree.loops] + [x.equation for x in tree.constraints]
    for frame in (frame for x in tree.loops for frame in (x.first, x.second)):
        numbers += [*frame.position, *(number for row in frame.axes for number in row)]
    return [float(number.xreplace(values)) for number in numbers]


def test_constraints_that_are_rules_stay_rules_where_all_numbers_are_inputs() -> None:
    """Otherwise the functions of all numbers would have other coordinates than the functions of the file."""
    model = make_linkage(constraints=[constraint("gear", "q3 - k*q2 - 0.5")])
    assert build_tree(with_runtime_numbers(model, zeros=True)).couplings == build_tree(model).couplings


def test_a_joint_with_the_name_of_a_number_is_no_number() -> None:
    arm = body("arm", revolute("y", name="q1"), mass=1, com=(0, 0, 1))
    other = body("other", revolute("y", name="constraints.c.1"), mass=1, com=(0, 0, 1))
    model = make_model("m", [arm, other], gravity=(0, 0, 0), constraints=[constraint("c", "sin(q1) - 0.5")])
    (equation,) = (x.equation for x in build_tree(with_runtime_numbers(model)).constraints)
    assert equation == sin(coordinate_symbol("q1")) - Symbol("constraints.c.1.2")


def test_constants_of_axes_of_loops_stay() -> None:
    model = make_linkage(loops=[loop("slot", "planar", end("third"), end("base"), axis=(0, "k", 1))])
    released = with_runtime_numbers(model)
    assert {p.name: p.kind for p in released.parameters}["k"] is Kind.CONSTANT
    assert build_tree(released).loops[0].first.axes == build_tree(model).loops[0].first.axes


def test_parameters_of_loops_are_kept() -> None:
    """A number that loops alone depend on is a parameter of the code; one that nothing depends on is none."""
    tree = build_tree(make_linkage(loops=[rod("strut", end("arm"), end("base"), "2*l")]))
    assert tree.symbols == {Symbol("l")}
