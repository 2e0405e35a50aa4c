"""The models with closed loops that ship: their parts, their degrees of freedom, their poses."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from mbsgen.assembly import assemble
from mbsgen.assembly.mechanism import Mechanism
from mbsgen.expressions import Number, Operation
from mbsgen.formulations import semi
from mbsgen.formulations.closure import list_equations
from mbsgen.formulations.reductions import Reductions
from mbsgen.model.changes.reduction import build_tree
from mbsgen.model.construction import joint
from mbsgen.model.expansion import list_steps
from mbsgen.model.model import Body, Loop, LoopEnd, Model, Placement
from mbsgen.model.reader import read_model
from mbsgen.model.tree import Closure, Cut, Motion, Tree
from mbsgen.pipeline import read_tree
from mbsgen.tape.interpreter import evaluate
from tests.loop_ends import open_loops, place_ends
from tests.random_trees import floats, values_of
from tests.shipped import CLOSED, FOLDER

Array = NDArray[np.float64]
NAMES = tuple(file.stem for file in CLOSED)
ROUNDING = 2e-14  # m and of directions, for lengths up to 10 m


@dataclass(frozen=True)
class Parts:
    """The parts of a model, by number."""

    joints: int
    slides: int
    inputs: int
    loops: int
    equations: int  # of all loops
    freedoms: int
    is_planar: bool  # all loops lie in planes: three of the five equations of a hinge are redundant there


PARTS = {
    "compressor": Parts(3, 1, 0, 1, 5, 1, is_planar=True),
    "delta": Parts(12, 3, 3, 3, 9, 3, is_planar=False),
    "excavator": Parts(12, 3, 4, 4, 20, 4, is_planar=True),
    "five_bar": Parts(4, 0, 2, 1, 5, 2, is_planar=True),
    "four_bar": Parts(3, 0, 1, 1, 5, 1, is_planar=True),
    "knee_leg": Parts(4, 0, 2, 1, 5, 2, is_planar=True),
    "slider_crank": Parts(3, 1, 1, 1, 5, 1, is_planar=True),
    "stewart": Parts(24, 9, 6, 6, 18, 6, is_planar=False),
    "wishbone": Parts(10, 2, 2, 3, 7, 3, is_planar=False),
}


@cache
def read(name: str) -> tuple[Tree, Closure]:
    tree = read_tree(FOLDER / f"{name}.yaml")
    assert tree.closure is not None
    return tree, tree.closure


@pytest.mark.parametrize("name", NAMES)
def test_closed_models_have_their_parts_and_degrees_of_freedom(name: str) -> None:
    """Degrees of freedom by Gruebler: joints less equations, of which a hinge in a plane has 2."""
    (tree, closure), parts = read(name), PARTS[name]
    joints = [body.joint for body in tree.bodies]
    slides = sum(own.motion is Motion.PRISMATIC for own in joints)
    inputs = sum(own.actuated for own in joints)
    equations = len(list_equations(tree))
    found = Parts(len(joints), slides, inputs, len(tree.loops), equations, len(closure.independent), parts.is_planar)
    assert found == parts
    counted = 2 * parts.loops if parts.is_planar else parts.equations
    assert parts.freedoms == parts.joints - counted == parts.joints - len(closure.kept)
    assert tree.name == name


@pytest.mark.parametrize("name", NAMES)
def test_loops_are_closed_at_the_pose_of_the_model(name: str) -> None:
    """Points of balls and hinges coincide, axes of hinges are parallel in one sense, and rods have their length."""
    tree, closure = read(name)
    for loop, (p1, p2, R1, R2) in zip(tree.loops, place_ends(tree, np.array(closure.pose)), strict=True):
        gap = float(np.linalg.norm(p2 - p1))
        if loop.cut is Cut.ROD:
            gap -= float(floats(tree, [loop.value])[0])
        assert abs(gap) < ROUNDING, loop.name
        if loop.cut is Cut.HINGE:
            np.testing.assert_allclose(R1[:, 2], R2[:, 2], atol=ROUNDING)


@pytest.mark.parametrize("name", NAMES)
def test_poses_of_the_models_are_regular_and_within_limits(name: str) -> None:
    """The independent coordinates determine the others: J of the dependent ones is far from singular."""
    tree, closure = read(name)
    J = Mechanism(tree).J(np.array(closure.pose))
    assert np.linalg.cond(J[np.ix_(closure.kept, closure.dependent)]) < 12
    for own, q in zip(tree.joints, closure.pose, strict=True):
        assert own.lower is None or own.lower < q, own.name
        assert own.upper is None or q < own.upper, own.name


def test_the_four_bar_meets_freudensteins_equation() -> None:
    """d/a cos(rocker) - d/c cos(crank) + (a^2 - b^2 + c^2 + d^2)/(2 a c) = cos(crank - rocker)."""
    crank, _, rocker = read("four_bar")[1].pose
    a, b, c, d = 0.10, 0.28, 0.24, 0.30
    left = d / a * math.cos(rocker) - d / c * math.cos(crank) + (a * a - b * b + c * c + d * d) / (2 * a * c)
    assert left == pytest.approx(math.cos(crank - rocker), abs=1e-13)


def test_the_piston_is_where_its_comment_says() -> None:
    """z = r cos(q) + sqrt(l^2 - r^2 sin(q)^2)."""
    q, _, z = read("slider_crank")[1].pose
    assert z == pytest.approx(0.045 * math.cos(q) + math.sqrt(0.14**2 - (0.045 * math.sin(q)) ** 2), abs=1e-15)


def test_one_rod_for_a_parallelogram_is_exact() -> None:
    """The Delta robot with six rods and a platform that could turn has 3 degrees of freedom and the same energy."""
    tree, closure = read("delta")
    full = assemble(build_tree(split_forearms(read_model(FOLDER / "delta.yaml"), tree, closure)))
    assert len(full.joints) - 3 == 18 == 3 * len(full.loops)
    np.testing.assert_allclose(project_mass(full), project_mass(tree), rtol=1e-10)


def split_forearms(model: Model, tree: Tree, closure: Closure) -> Model:
    """Make two rods of half the mass of each forearm, as wide apart at the platform, which may turn."""
    pose = {name: Number(q) for name, q in zip(tree.coordinates, closure.pose, strict=True)}
    bodies: list[Body] = []
    loops: list[Loop] = []
    for body in model.bodies:
        if body.name == "platform":
            bodies.append(replace(body, joint=joint("floating").make(body.name)))
        elif body.name.startswith("forearm"):
            number = body.name[-1]
            loop = next(loop for loop in model.loops if loop.second.body == body.name)
            first, second = body.joints
            for side, y in (("left", 0.06), ("right", -0.06)):
                x0, _, z0 = first.placement.position
                elbow = replace(first, placement=replace(first.placement, position=(x0, Number(y), z0)))
                bodies.append(replace(body, name=f"{side} {number}", joint=(elbow, second)))
                turn = 2 * math.pi / 3 * (int(number) - 1)
                across = (Number(-y * math.sin(turn)), Number(y * math.cos(turn)), Number(0.0))
                point = [Operation("+", a, b) for a, b in zip(loop.first.placement.position, across, strict=True)]
                one = LoopEnd("platform", Placement((point[0], point[1], point[2])))
                other = replace(loop.second, body=f"{side} {number}")
                loops.append(replace(loop, name=f"{side} {loop.name}", first=one, second=other))
                for axis in ("ry", "rz"):
                    pose[f"{side} {number}.{axis}"] = pose[f"{body.name}.{axis}"]
        else:
            bodies.append(body)
    kept = {step.name for k, body in enumerate(bodies) for step in list_steps(k, body)}
    rough = {name.replace("platform.", ""): x for name, x in pose.items()}
    rough |= {f"platform.{axis}": pose[axis] for axis in "xyz"}
    parameters = tuple(replace(p, value=Number(0.07)) if p.name == "m2" else p for p in model.parameters)
    assembly = tuple((name, x) for name, x in rough.items() if name in kept)
    return replace(model, bodies=tuple(bodies), loops=tuple(loops), parameters=parameters, assembly=assembly)


def project_mass(tree: Tree) -> Array:
    """Return the mass matrix in the independent coordinates, at the pose of the model."""
    assert tree.closure is not None
    closure, n = tree.closure, len(tree.joints)
    independent, dependent = list(closure.independent), list(closure.dependent)
    given = {"q": list(closure.pose), "qd": [0.0] * n} | ({"p": p} if (p := values_of(tree)) else {})
    M = np.array(evaluate(semi.build(open_loops(tree), Reductions(trials=1)), given)["M"], float).reshape(n, n)
    J = Mechanism(tree).J(np.array(closure.pose))[list(closure.kept)]
    Z = np.zeros((n, len(independent)))
    Z[independent] = np.eye(len(independent))
    Z[dependent] = -np.linalg.solve(J[:, dependent], J[:, independent])
    return np.asarray(Z.T @ M @ Z)
