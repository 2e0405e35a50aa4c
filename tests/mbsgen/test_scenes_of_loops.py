"""Joints locked in mechanisms with loops: what is left is the mechanism with these joints fixed, or a refusal."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mbsgen.assembly.mechanism import Mechanism
from mbsgen.errors import InputError
from mbsgen.expressions import parse
from mbsgen.formulations.reductions import Reductions
from mbsgen.model.changes.reduction import build_tree
from mbsgen.model.changes.scene import Scene, stage
from mbsgen.model.construction import body, constraint, end, loop, make_model, revolute, runtime
from mbsgen.model.model import Model
from mbsgen.model.reader import ModelWarning
from mbsgen.model.tree import Kind
from mbsgen.pipeline import Options, build_parametric, make, read_tree

CRANKS = ("q1", "q3")
OPTIONS = Options(functions=("impl",), derivatives=0, reductions=Reductions(trials=1))


def five_bar(*equations: str) -> Model:
    """Make two cranks, q1 and q3, whose links q2 and q4 meet, and two joints q5 and q6 beside them."""
    joints = [
        *(("q1", "base", 0.0), ("q2", "q1", 0.3), ("q3", "base", 0.4), ("q4", "q3", 0.3)),
        *(("q5", "base", 2.0), ("q6", "base", 3.0)),
    ]
    bodies = [
        body(name, revolute("y", position=(x, 0, 0), actuated=name in CRANKS), parent=parent, mass=1, com=(0.1, 0, 0))
        for name, parent, x in joints
    ]
    ends = end("q2", position=(0.25, 0, 0)), end("q4", position=(0.25, 0, 0))
    return make_model(
        "five-bar",
        bodies,
        gravity=(0, 0, -9.81),
        parameters={"angle": 1.2, "ratio": 2, "load": runtime(0.4)},
        loops=[loop("hand", "hinge", *ends, axis="y")],
        constraints=[constraint(f"c{i}", text) for i, text in enumerate(equations)],
        assembly={"q1": -1.2, "q2": 0.1, "q3": -1.9, "q4": -0.1},
    )


def lock(model: Model, **places: str) -> Model:
    return stage(model, Scene(locked=tuple((name, parse(text)) for name, text in places.items())))


def refuse(model: Model, **places: str) -> str:
    scene = Scene(locked=tuple((name, parse(text)) for name, text in places.items()))
    with pytest.raises(InputError) as found:
        make(model, replace(OPTIONS, scene=scene))
    return str(found.value)


def test_a_loop_of_locked_joints_is_the_loop_with_these_joints_there() -> None:
    """Its equations at the other joints' coordinates are the whole model's, with the locked joint at its place."""
    whole = build_tree(five_bar())
    tree = build_tree(lock(five_bar(), q1="-angle", q5="0.7"))
    assert [joint.name for joint in tree.joints] == ["q2", "q3", "q4", "q6"]
    q = np.array([0.8, -1.1, -0.9, 0.2])
    expected = Mechanism(whole).h(np.array([-1.2, *q[:3], 0.7, q[3]]))
    np.testing.assert_allclose(Mechanism(tree).h(q), expected, rtol=0, atol=1e-15)
    assert dict(lock(five_bar(), q1="0").assembly).keys() == {"q2", "q3", "q4"}


def test_joints_that_loops_keep_at_rest_are_told() -> None:
    """With both cranks locked, the links of the five-bar are rigid; the joints beside it go on moving."""
    scene = Scene(locked=(("q1", parse("-1.2")), ("q3", parse("-1.9"))))
    with pytest.warns(ModelWarning, match='loops keep "q2", "q4" at rest'):
        product = make(five_bar(), replace(OPTIONS, scene=scene))
    assert [c.name for c in product.manifest.coordinates] == ["q2", "q4", "q5", "q6"]


def test_a_lock_that_leaves_nothing_to_move_is_refused() -> None:
    assert "leave no joint free to move" in refuse(five_bar(), q1="-1.2", q3="-1.9", q5="0", q6="0")


def test_a_loop_of_bodies_that_are_all_fixed_is_refused() -> None:
    told = refuse(five_bar(), q1="0", q2="0", q3="0", q4="0")
    assert 'with this scene, "q2" and "q4" are both fixed to base (at loops[0].to.body)' in told


def test_a_lock_out_of_reach_is_refused() -> None:
    assert 'loop "hand" does not close' in refuse(five_bar(), q1="pi", q3="0")


@pytest.mark.parametrize(
    ("equation", "locked", "left"),
    [
        ("q6 - 2*q5 - 0.1", {"q5": "0.2"}, []),  # q6 is at 0.5
        ("q6 - ratio*q5", {"q6": "angle"}, []),  # the follower takes its leader along
        ("q6 - 2*q5", {"q5": "0.2", "q6": "0.4"}, []),
        ("q6 - sin(q5)", {"q5": "pi/2"}, ["q6 - sin(pi/2)"]),
        ("q6 - sin(q5)", {"q5": "pi/2", "q6": "1"}, []),
        ("q6 - load*q5", {"q6": "load", "q5": "1"}, []),
    ],
)
def test_equations_have_the_coordinates_of_locked_joints(
    equation: str, locked: dict[str, str], left: list[str]
) -> None:
    staged = lock(five_bar(equation), **locked)
    assert [x.equation for x in staged.constraints] == [parse(text) for text in left]
    moving = {joint.name for joint in build_tree(staged).joints}
    assert moving == {"q1", "q2", "q3", "q4"} | ({"q6"} if left else set())


@pytest.mark.parametrize("text", ["0.5", "load"])
def test_an_equation_that_locked_joints_do_not_obey_is_refused(text: str) -> None:
    told = refuse(five_bar("q6 - 2*q5"), q5="0.2", q6=text)
    assert "with this scene, the equation depends on no joint" in told


def test_a_ratio_that_a_scene_makes_an_input_is_one_in_all_functions() -> None:
    """The tree with all numbers at run time has the coordinates of the tree that is generated."""
    scene = Scene(parameters=(("ratio", Kind.RUNTIME),))
    model = five_bar("q6 - ratio*q5")
    one, other = build_tree(stage(model, scene)), build_parametric(model, scene)
    assert one.coordinates == other.coordinates
    assert one.coordinates != build_tree(model).coordinates


def test_loops_of_a_file_are_locked_by_a_scene_file(tmp_path: Path) -> None:
    (tmp_path / "scene.yaml").write_text("functions: [impl]\nderivatives: 0\nlocked: {q1: -1.2}\n", encoding="utf-8")
    product = make(five_bar(), replace(OPTIONS, functions=None, derivatives=2, scene=tmp_path / "scene.yaml"))
    assert product.manifest.loops[0].name == "hand"
    assert len(product.manifest.independent) == len(read_tree(five_bar()).joints) - 1 - 2
