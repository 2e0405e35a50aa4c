"""The arm that ships is the paper's: Docquier, Bruls, Fisette, section 4.1, Table 2 and eq. (27)."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from sympy import Expr

from mbsgen.model.changes.reduction import build_tree
from mbsgen.model.changes.releasing import with_runtime_numbers
from mbsgen.model.reader import read_model
from mbsgen.model.symbols import exact
from mbsgen.model.tree import Kind, Tree
from tests.reference_models import ARM, tree_from_reference

FILE = Path(__file__).parents[3] / "models" / "arm_pendulum.yaml"


@pytest.fixture(scope="module")
def arm() -> Tree:
    return build_tree(read_model(FILE))


def numbers(tree: Tree) -> list[Expr]:
    """List all numbers of gravity and bodies, parameters by their values."""
    values = {parameter.symbol: exact(parameter.value) for parameter in tree.parameters}
    listed = [*tree.gravity]
    for body in tree.bodies:
        tensors = [entry for row in (*body.orientation, *body.inertia) for entry in row]
        listed += [*body.position, body.mass, *body.com, *tensors]
    return [number.xreplace(values) for number in listed]


def test_it_equals_the_reference(arm: Tree) -> None:
    reference = tree_from_reference(ARM)
    assert [(b.parent, b.joint.motion, b.joint.axis) for b in arm.bodies] == [
        (b.parent, b.joint.motion, b.joint.axis) for b in reference.bodies
    ]
    assert numbers(arm) == numbers(reference)


def test_the_pendulum_is_free_and_limits_are_those_of_equation_27(arm: Tree) -> None:
    pi = math.pi
    assert [(b.joint.name, b.joint.actuated, b.joint.lower, b.joint.upper) for b in arm.bodies] == [
        ("q1", True, None, None),
        ("q2", True, -pi / 2, pi / 2),
        ("q3", True, -5 * pi / 12, 0.0),
        ("q4", True, -pi / 2, pi / 2),
        ("q5", False, -pi / 4, pi / 4),
        ("q6", False, -pi / 4, pi / 4),
    ]


def test_frames_are_the_hand_and_the_pendulum(arm: Tree) -> None:
    values = {parameter.symbol: parameter.value for parameter in arm.parameters}
    places = [(s.name, s.body, [float(x.subs(values)) for x in s.position]) for s in arm.sensors]
    assert places == [("hand", 4, [0.1, 0, 0]), ("pendulum", 6, [0, 0, 0.2])]


def test_numbers_become_parameters_of_their_own(arm: Tree) -> None:
    """Named ones stay one each, zeros stay zeros, and the values do not change."""
    released = with_runtime_numbers(read_model(FILE))
    freed = build_tree(released)
    assert numbers(freed) == numbers(arm)
    assert {p.kind for p in freed.parameters} == {Kind.RUNTIME}
    named = [p.name for p in arm.parameters]
    inertias = [
        f"{body}.inertia.{k}" for body in ("upperarm", "forearm", "hand", "pendulum") for k in ("xx", "yy", "zz")
    ]
    assert [p.name for p in freed.parameters] == [*named, "gravity.z", *inertias]
    left = [n for b in freed.bodies for n in (*b.position, b.mass, *b.com, *(e for row in b.inertia for e in row))]
    assert all(n == 0 or n.is_Symbol for n in (*freed.gravity, *left))
    assert released == with_runtime_numbers(released)
