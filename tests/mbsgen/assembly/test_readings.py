"""Loops of rounded files: which equations follow from others, and within which distance; motions as without it."""

from __future__ import annotations

from math import pi, sqrt

import numpy as np
import pytest

from mbsgen.assembly import AssemblyError, assemble, describe, list_redundant
from mbsgen.formulations.catalogue import FUNCTIONS
from mbsgen.formulations.reductions import ALL
from mbsgen.model.changes.reduction import build_tree
from mbsgen.model.construction import body, constraint, end, loop, make_model, revolute, rod
from mbsgen.model.digits import LARGEST, LEAST, find_tolerance
from mbsgen.model.model import Model
from mbsgen.model.reader import ModelWarning
from mbsgen.model.tree import Tree
from mbsgen.pipeline import read_tree
from mbsgen.procedure.procedure import straight
from mbsgen.tape.interpreter import evaluate

UNIFORM = (1e-3, 1e-3, 1e-3)


def link(name: str, parent: str, x: float, axis: object = "y", *, actuated: bool = False, along: float = 0.0) -> object:
    joint = revolute(axis, name=f"q_{name}", position=(x, along, 0), actuated=actuated)  # type: ignore[arg-type]
    return body(name, joint, parent=parent, mass=1.0, com=(0.1, 0, 0), inertia=UNIFORM)


def four_bar(cut: str, tilt: float, scale: float = 1.0, **settings: object) -> Model:
    """A planar four-bar whose first axis is off by a tilt; a solid cut has a joint more in the tree."""
    s = scale
    bodies = [
        link("crank", "base", 0.0, (tilt, 1, 0) if tilt else "y", actuated=True),
        link("coupler", "crank", 0.2 * s),
        link("rocker", "base", 0.5 * s),
    ]
    first, second, more = end("coupler", position=(0.4 * s, 0, 0)), end("rocker", position=(0.3 * s, 0, 0)), {}
    rough = {"q_crank": -1.0, "q_rocker": -1.5}
    if cut == "solid":
        bodies.append(link("tip", "coupler", 0.4 * s))
        first, second = end("tip"), end("rocker", position=(0.3 * s, 0, 0))
        rough["q_tip"] = -1.0
    if cut in ("hinge", "cylindrical"):
        more["axis"] = "y"
    made = {"loops": [loop("knee", cut, first, second, **more)], "assembly": rough} | settings
    return make_model("four-bar", bodies, gravity=(0, 0, -9.81), **made)  # type: ignore[arg-type]


def close(model: Model) -> Tree:
    return assemble(build_tree(model))


def accelerate(tree: Tree) -> np.ndarray:
    """Return the accelerations from rest at the closed pose."""
    assert tree.closure is not None
    tape = straight(FUNCTIONS["exp1"].build(tree, ALL))
    given = {"q": list(tree.closure.pose)}
    found = evaluate(tape, {i.name: given.get(i.name, [0.0] * i.sparsity.nnz) for i in tape.inputs})
    return np.array(found["qdd"], float)


@pytest.mark.parametrize("tilt", [1e-6, 3.3e-6, 1e-5, 2.3e-5])
@pytest.mark.parametrize("cut", ["hinge", "ball", "cylindrical", "solid"])
def test_a_nearly_planar_loop_moves_as_the_planar_one(cut: str, tilt: float) -> None:
    """Its accelerations differ from the planar one's by the order of the tilt, and so does its pose."""
    exact, found = close(four_bar(cut, 0.0)), close(four_bar(cut, tilt))
    assert exact.closure is not None
    assert found.closure is not None
    assert len(found.closure.independent) == len(exact.closure.independent) == 1
    assert exact.closure.distance == 0.0
    assert 0.0 < found.closure.distance <= 3 * tilt
    np.testing.assert_allclose(found.closure.pose, exact.closure.pose, atol=10 * tilt)
    np.testing.assert_allclose(accelerate(found), accelerate(exact), rtol=20 * tilt, atol=20 * tilt)


def test_what_follows_from_other_equations_is_named_with_the_distance() -> None:
    tree = close(four_bar("hinge", 1e-5))
    found = describe(tree)
    assert found is not None
    assert found.redundant == list_redundant(tree) == ("knee.y", "knee.turn_x", "knee.turn_y")
    assert found.freedoms == 1
    assert 1e-6 < found.distance < 3e-5


@pytest.mark.parametrize("scale", [1e-7, 1e-3, 1e3, 1e6])
def test_a_reading_does_not_depend_on_the_size(scale: float) -> None:
    """Distances of places are relative to the size of the loop."""
    one, other = close(four_bar("hinge", 1e-5)).closure, close(four_bar("hinge", 1e-5, scale)).closure
    assert one is not None
    assert other is not None
    assert other.kept == one.kept
    np.testing.assert_allclose(other.pose, one.pose, atol=1e-12)
    assert other.distance == pytest.approx(one.distance, rel=0.5)


@pytest.mark.parametrize("tilt", [0.0, 1e-5])
def test_a_loop_without_any_effect_in_its_plane_leaves_all_joints_free(tilt: float) -> None:
    """Two joints about y move a plate in the plane y = 0: a joint that keeps it there says nothing new."""
    bodies = [link("crank", "base", 0.0, (tilt, 1, 0) if tilt else "y"), link("plate", "crank", 0.2)]
    table = loop("table", "planar", end("base", position=(0.1, 0, 0)), end("plate"), axis="y")
    model = make_model("plate", bodies, gravity=(0, 0, -9.81), loops=[table])  # type: ignore[arg-type]
    assert not close(model).is_constrained
    with pytest.warns(ModelWarning, match="restrict no joint, and are left out"):
        read_tree(model)


@pytest.mark.parametrize("tilt", [3.21e-4, 1e-3, 2e-3])
def test_between_two_readings_the_author_chooses(tilt: float) -> None:
    """A tilt beyond the digits of its file, or of 1 mrad, may be meant: both readings are named, with a remedy each."""
    with pytest.raises(AssemblyError, match="no joint free to move") as error:
        close(four_bar("hinge", tilt))
    (finding,) = error.value.findings
    assert finding.place == ("loops",)
    assert "knee.y, knee.turn_x, knee.turn_y follow from the others within" in finding.finding
    assert "without them there is 1 degree of freedom" in finding.finding
    tolerance = float(finding.remedy.split("loop_tolerance: ")[1].split("`")[0])
    closure = close(four_bar("hinge", tilt, loop_tolerance=tolerance)).closure
    assert closure is not None
    assert len(closure.independent) == 1
    with pytest.raises(
        AssemblyError, match="leave no joint free to move; remove a loop, or give one with fewer equations"
    ):
        close(four_bar("hinge", tilt, loop_tolerance=0))


def five_bar(tilt: float, **settings: object) -> Model:
    """A planar five-bar; exactly tilted, it keeps one degree of freedom of two."""
    bodies = [
        link("a", "base", 0.0, actuated=True),
        link("b", "a", 0.3),
        link("c", "base", 0.5, (0, 1, tilt) if tilt else "y", actuated=True),
        link("d", "c", 0.3),
    ]
    ends = end("b", position=(0.4, 0, 0)), end("d", position=(0.4, 0, 0))
    made = {"loops": [loop("tip", "ball", *ends)], "assembly": {"q_a": -1.5, "q_b": 1.0, "q_c": -1.8, "q_d": -0.9}}
    return make_model("five-bar", bodies, gravity=(0, 0, -9.81), **(made | settings))  # type: ignore[arg-type]


def test_a_five_bar_keeps_both_freedoms() -> None:
    exact, found = close(five_bar(0.0)), close(five_bar(1e-5))
    assert exact.closure is not None
    assert found.closure is not None
    assert len(found.closure.independent) == 2
    np.testing.assert_allclose(accelerate(found), accelerate(exact), rtol=1e-3, atol=1e-3)
    with pytest.raises(AssemblyError) as error:
        close(five_bar(1e-3))
    told = str(error.value)
    assert "all equations as they stand leave 1 degree of freedom" in told
    assert "without them there are 2 degrees of freedom" in told
    assert "`loop_tolerance: 0` to keep them" in told
    for tolerance, freedoms in ((0, 1), (0.005, 2)):
        closure = close(five_bar(1e-3, loop_tolerance=tolerance)).closure
        assert closure is not None
        assert len(closure.independent) == freedoms


def test_rods_of_rounded_lengths_share_their_equation() -> None:
    """A bar on three equal cranks, one of which is longer by 1e-6 m."""
    joints = revolute("y", name="q1"), revolute("y", name="q2", position=(0, 0, 0.5), actuated=False)
    crank = body("crank", joints[0], mass=1.0, inertia=UNIFORM)
    bar = body("bar", joints[1], parent="crank", mass=1.0, inertia=UNIFORM)
    rods = [
        rod(name, end("base", position=(x, 0, 0)), end("bar", position=(x, 0, 0)), length)
        for name, x, length in (("second", 1.0, 0.5), ("third", 0.5, 0.500001))
    ]
    model = make_model("cranks", [crank, bar], gravity=(0, 0, -9.81), loops=rods, assembly={"q1": 0.4, "q2": -0.4})
    closure = close(model).closure
    assert closure is not None
    assert len(closure.independent) == 1
    assert 1e-7 < closure.distance < 1e-5


def test_a_spatial_mechanism_that_moves_by_its_geometry_survives_rounding() -> None:
    """Bricard's six hinges along the edges of a cube, with axes off by 2e-6."""
    steps = [("y", (1, 0, 0)), ("z", (0, -1, 0)), ("x", (0, 0, 1)), ("y", (-1, 0, 0)), ("z", (0, 1, 0))]
    bodies, parent, place = [], "base", (0, 0, 0)
    for k, (axis, rod_) in enumerate(steps):
        direction = [0.0] * 3
        direction["xyz".index(axis)], direction["yzx".index(axis)] = 1.0, 2e-6
        joint = revolute(tuple(direction), name=f"q{k}", position=place, actuated=False)
        bodies.append(body(f"rod{k}", joint, parent=parent, mass=1.0, com=tuple(x / 2 for x in rod_), inertia=UNIFORM))
        parent, place = f"rod{k}", rod_
    last = loop("last", "hinge", end(parent, position=place), end("base", position=(0, 0, 1)), axis="x")
    closure = close(make_model("Bricard", bodies, gravity=(0, -9.81, 0), loops=[last])).closure
    assert closure is not None
    assert (len(closure.independent), len(closure.kept)) == (1, 4)
    assert 0 < closure.distance < 1e-5


def test_equations_of_coordinates_that_nearly_agree_are_one() -> None:
    """sin(q1) = sin(q2), and the same with a factor that is rounded."""
    bodies = [link(f"arm{k}", "base", 0.0) for k in (1, 2, 3)]
    equations = [
        constraint("sines", "sin(q_arm1) - sin(q_arm2)"),
        constraint("again", "0.333333*sin(q_arm1) - sin(q_arm2)/3"),
    ]
    closure = close(make_model("arms", bodies, gravity=(0, 0, 0), constraints=equations)).closure  # type: ignore[arg-type]
    assert closure is not None
    assert len(closure.independent) == 2
    assert 0 < closure.distance < 1e-5


@pytest.mark.parametrize("offset", [(0.0, 0.0, 0.0), (30.0, 0.0, 20.0)])
def test_a_short_lever_is_no_rounding(offset: tuple[float, float, float]) -> None:
    """A crank of 2 mm on an arm of 1 m, also far from the origin, has one degree of freedom, exactly."""
    crank = body("crank", revolute("y", name="q1", position=offset), mass=1.0, com=(0.001, 0, 0), inertia=UNIFORM)
    arm = body(
        "arm",
        revolute("y", name="q2", position=(0.002, 0, 0), actuated=False),
        parent="crank",
        mass=1.0,
        com=(0.5, 0, 0),
    )
    x, y, z = offset
    cut = rod("rod", end("base", position=(x + 1, y, z + 0.5)), end("arm", position=(1, 0, 0)), 0.5)
    closure = close(make_model("press", [crank, arm], gravity=(0, 0, -9.81), loops=[cut])).closure
    assert closure is not None
    assert closure.distance == 0.0
    assert len(closure.independent) == 1


@pytest.mark.parametrize(
    ("numbers", "tolerance"),
    [
        ([0.2, 0.5, 1e-3], LARGEST),
        ([0.236731, 1.0, pi / 2], 1e-4),
        ([0.2123456789, 3.3e-6], LEAST),
        ([0.3, 1 / 3], LEAST),
        ([0.5, sqrt(3) / 2, pi / 2, 1e-17], LARGEST),
    ],
)
def test_the_tolerance_follows_from_the_last_digits(numbers: list[float], tolerance: float) -> None:
    """100 last digits, between 1e-5 and 3e-4; numbers such as pi/2 do not count."""
    assert find_tolerance(numbers) == pytest.approx(tolerance)
