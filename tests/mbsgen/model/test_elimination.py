"""Linear constraints become followers, of one joint or of sums; all others stay equations."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
from sympy import Symbol, sin

from mbsgen.expressions import Name
from mbsgen.model.changes.reduction import build_tree
from mbsgen.model.changes.releasing import with_runtime_numbers
from mbsgen.model.construction import body, constraint, differentiated, make_model, revolute, runtime
from mbsgen.model.elimination import eliminate
from mbsgen.model.model import Model
from mbsgen.model.symbols import to_double
from mbsgen.model.tree import Kind, coordinate_symbol

Joints = tuple[int, ...]
PARAMETERS = {"k": 3, "zero": 0, "r": runtime(2.0), "d": differentiated(0.1), "e": "r/2"}


def make_chain(
    equations: list[str],
    *,
    count: int = 4,
    actuated: tuple[int, ...] = (1,),
    bounded: tuple[int, ...] = (),
    **parts: Any,
) -> Model:
    """Make a chain of joints q1, q2, ... with constraints."""
    limits = dict.fromkeys(bounded, (-1, 2))
    bodies = [
        body(f"b{i}", revolute("y", name=f"q{i}", actuated=i in actuated, limits=limits.get(i, (None, None))),
             parent=f"b{i - 1}" if i > 1 else "base",
             mass=1, com=(0, 0, 1))
        for i in range(1, count + 1)
    ]  # fmt: skip
    listed = [constraint(f"c{i}", text) for i, text in enumerate(equations)]
    return make_model("chain", bodies, gravity=(0, 0, -9.81), parameters=PARAMETERS, constraints=listed, **parts)


def read_rules(model: Model) -> tuple[dict[int, tuple[int, float, float]], int]:
    """Return follower: (leader, ratio, offset), and the number of equations that remain."""
    tree = build_tree(model)
    rules = {x.follower: (x.leader, to_double(x.ratio), to_double(x.offset)) for x in tree.couplings}
    return rules, len(tree.constraints)


@pytest.mark.parametrize(
    ("equation", "rule"),
    [
        ("q2 + 2*q3 - 0.3", {3: (2, -0.5, 0.15)}),
        ("q1 - q2", {2: (1, 1.0, 0.0)}),  # q1 has an input
        ("(q1 - k*(q4 + pi))/sqrt(2)", {4: (1, 1 / 3, -3.141592653589793)}),
        ("q2*cos(k)**2 + q2*sin(k)**2 - q3 + zero*q1", {3: (2, 1.0, 0.0)}),  # the weights sum to 1, one is 0
        ("-(q3 - 1)*k/2 + q2**1", {3: (2, 2 / 3, 1.0)}),
        ("q1 + q2 - 3*q2 + q3 - q3", {2: (1, 0.5, 0.0)}),
    ],
)
def test_linear_equations_of_two_joints_are_rules(equation: str, rule: dict[int, tuple[int, float, float]]) -> None:
    rules, remaining = read_rules(make_chain([equation]))
    assert rules == rule
    assert remaining == 0


@pytest.mark.parametrize(
    "equation",
    [
        "q2 - 0.3",  # of one joint
        "q1 + r*q2 + q3",  # of three
        "q2 - r*q3",  # at run time
        "q2 - q3 + d",
        "q2 - e*q3",  # follows a run-time parameter
        "q2*q3 - 1",
        "q2 - sin(q3)",
        "q2**2 - q3",
        "1/q2 - q3",
        "q2 - 1e-120*q3",
        "q1 - q4 + zero*sin(q2)",  # whatever its weight
    ],
)
def test_other_equations_stay(equation: str) -> None:
    model = make_chain([equation])
    assert eliminate(model) == model
    assert read_rules(model) == ({}, 1)


Sum = tuple[dict[int, float], float]  # the ratio of each leader, and the offset


def read_sums(model: Model) -> tuple[dict[int, Sum], int]:
    """Return follower: (ratios by leader, offset), and the number of equations that remain."""
    tree = build_tree(model)
    rules = {
        x.follower: ({leader: to_double(ratio) for leader, ratio in x.terms}, to_double(x.offset))
        for x in tree.couplings
    }
    return rules, len(tree.constraints)


@pytest.mark.parametrize(
    ("equation", "rule"),
    [
        ("q1 + q2 + q3", {3: ({1: -1.0, 2: -1.0}, 0.0)}),  # the later one
        ("q2 - q1/4 - k*q3/2 + 0.75", {3: ({1: -1 / 6, 2: 2 / 3}, 0.5)}),
        ("q1 + 2*q2 - q4 - 1", {2: ({1: -0.5, 4: 0.5}, 0.5)}),  # the largest weight
        ("8*q1 + q2 + 2*q3 + q4", {3: ({1: -4.0, 2: -0.5, 4: -0.5}, 0.0)}),  # q1 has an input
    ],
)
def test_linear_equations_of_more_joints_are_sums(equation: str, rule: dict[int, Sum]) -> None:
    rules, remaining = read_sums(make_chain([equation]))
    assert rules == rule
    assert remaining == 0


def test_a_sum_follows_where_nothing_else_determines_or_bounds_it() -> None:
    sums = "q1 + q2 + q3"
    first = {2: ({1: -1.0, 3: -1.0}, 0.0)}
    assert read_sums(make_chain([sums], actuated=(3,)))[0] == first
    assert read_sums(make_chain([sums], driven=["q3"]))[0] == first
    assert read_sums(make_chain([sums, "sin(q4)"], independent=["q3"]))[0] == first
    assert read_sums(make_chain([sums], actuated=(1, 2, 3))) == ({}, 1)
    assert read_sums(make_chain([sums], bounded=(3,)))[0] == first
    assert read_sums(make_chain([sums], bounded=(2, 3))) == ({}, 1)
    assert read_sums(make_chain([sums, "q3 - q4"], bounded=(4,)))[0] == {4: ({3: 1.0}, 0.0), **first}


def test_a_rough_coordinate_is_kept_or_not_needed() -> None:
    """It stays, unless all other coordinates of the sum are given."""
    sums = ["q1 + q2 + q3", "q1 - sin(q4)"]
    assert read_sums(make_chain(sums, assembly={"q3": 1}))[0] == {2: ({1: -1.0, 3: -1.0}, 0.0)}
    assert read_sums(make_chain(sums, assembly={"q2": 1, "q3": 1})) == ({}, 2)
    tree = build_tree(make_chain(sums, assembly={"q1": 0.1, "q2": 0.2, "q3": 0.3}))
    assert [x.follower for x in tree.couplings] == [3]
    assert tree.rough == ((1, 0.1), (2, 0.2))


def test_sums_of_sums_are_put_together() -> None:
    """Of joints that lead others, of followers, and of two joints once another one is eliminated."""
    found = read_sums(make_chain(["q1 + q2 + q3", "q3 - 2*q4"]))
    assert found == ({4: ({1: -0.5, 2: -0.5}, 0.0), 3: ({1: -1.0, 2: -1.0}, 0.0)}, 0)
    found = read_sums(make_chain(["q1 + q2 + q3 - 1", "q2 + 2*q3 + 4*q4"]))
    assert found == ({3: ({1: -1.0, 2: -1.0}, 1.0), 4: ({1: 0.5, 2: 0.25}, -0.5)}, 0)
    first = {3: ({1: -1.0, 2: -1.0}, 0.0)}
    assert read_sums(make_chain(["q1 + q2 + q3", "q1 + 2*q2 + q3"])) == (first, 1)  # q2 is 0
    assert read_sums(make_chain(["q1 + q2 + q3", "2*q1 + 2*q2 + 2*q3"])) == (first, 1)  # redundant
    left = ["q5 - q3 + q4 - 0.1", "q1 - q2 - q6", "q3 - q4 + q6 - q1 + q2"]  # q5 would follow nothing
    found = read_sums(make_chain(left, count=6))
    assert found == ({5: ({3: 1.0, 4: -1.0}, 0.1), 6: ({1: 1.0, 2: -1.0}, 0.0)}, 1)


def test_followers_by_run_time_ratios_follow_the_sum_that_leads_them() -> None:
    bodies = list(make_chain([]).bodies)
    bodies[3] = body("b4", revolute("y", name="q4", follows=("q3", "r", "d")), parent="b3", mass=1, com=(0, 0, 1))
    model = make_model(
        "m", bodies, gravity=(0, 0, 0), parameters=PARAMETERS, constraints=[constraint("a", "q1 + q2 - 2*q3 - 1")]
    )
    rules = {x.follower: (x.terms, x.offset) for x in build_tree(model).couplings}
    r, d = Symbol("r"), Symbol("d")
    (first, second), offset = rules[4]
    assert (first, second) == ((1, r / 2), (2, r / 2))
    assert (offset - (d - r / 2)).equals(0)


def test_sums_stay_sums_where_all_numbers_are_inputs() -> None:
    """Constants that they depend on stay constants; other equations, and constants, become inputs."""
    bodies = list(make_chain([]).bodies)
    bodies[1] = replace(bodies[1], mass=Name("k"))
    listed = [constraint("a", "k*q1 + q2 - 2*q3 + 1"), constraint("b", "sin(q4) - 0.25"), constraint("c", "q2 - q4")]
    model = replace(make_chain([]), bodies=tuple(bodies), constraints=tuple(listed))
    for zeros in (False, True):
        released = with_runtime_numbers(model, zeros=zeros)
        assert build_tree(released).couplings == build_tree(model).couplings
        kinds = {p.name: p.kind for p in released.parameters}
        assert kinds["k"] is Kind.CONSTANT
        assert kinds["constraints.b.1"] is Kind.RUNTIME


def test_the_follower_is_a_joint_that_nothing_else_determines() -> None:
    assert read_rules(make_chain(["q2 - 2*q3"], actuated=(3,)))[0] == {2: (3, 2.0, 0.0)}
    assert read_rules(make_chain(["q2 - 2*q3"], driven=["q3"]))[0] == {2: (3, 2.0, 0.0)}
    assert read_rules(make_chain(["q2 - 2*q3", "q1*q2"], independent=["q3"]))[0] == {2: (3, 2.0, 0.0)}
    assert read_rules(make_chain(["q2 - 2*q3", "q1*q2"], assembly={"q3": 1}))[0] == {2: (3, 2.0, 0.0)}
    assert read_rules(make_chain(["q2 - 2*q3"], actuated=(2, 3))) == ({}, 1)
    assert read_rules(make_chain(["q2 - 2*q3"], actuated=(2,), driven=["q3"])) == ({}, 1)


def test_rules_are_put_together() -> None:
    """q2 = 2 q1, q3 = q2 - 1 and q4 = 3 q3, in any order of the equations."""
    expected = {2: (1, 2.0, 0.0), 3: (1, 2.0, -1.0), 4: (1, 6.0, -3.0)}
    equations = ["q2 - 2*q1", "q3 - q2 + 1", "3*q3 - q4"]
    for order in (equations, equations[::-1], [equations[1], equations[2], equations[0]]):
        assert read_rules(make_chain(order)) == (expected, 0)


def test_an_equation_that_follows_from_others_stays() -> None:
    """It is redundant, which the assembly of loops shows: nothing is dropped in silence."""
    assert read_rules(make_chain(["q2 - 2*q3", "2*q2 - 4*q3"])) == ({3: (2, 0.5, 0.0)}, 1)


def test_rough_coordinates_of_followers_are_their_leaders() -> None:
    model = make_chain(["q2 - 2*q3 - 0.2", "q1 - sin(q4)"], assembly={"q3": 0.4, "q2": 1.0})
    assert build_tree(model).rough == ((2, 1.0),)
    model = make_chain(["q1 - 2*q3 - 0.2", "q1 - sin(q4)"], assembly={"q3": 0.4})
    assert build_tree(model).rough == ((1, 1.0),)


def test_other_equations_are_in_the_coordinates_that_are_left() -> None:
    """Followers by constraints, and by the file, at run-time ratios too."""
    bodies = list(make_chain([]).bodies)
    bodies[3] = body("b4", revolute("y", name="q4", follows=("q2", "r", "d")), parent="b3", mass=1, com=(0, 0, 1))
    listed = [constraint("a", "q2 - 2*q3 - 1"), constraint("b", "q1 + sin(q3) - q4")]
    model = make_model("m", bodies, gravity=(0, 0, 0), parameters=PARAMETERS, constraints=listed)
    (equation,) = (x.equation for x in build_tree(model).constraints)
    q1, q2 = map(coordinate_symbol, ("q1", "q2"))
    assert equation.equals(q1 + sin((q2 - 1) / 2) - Symbol("r") * q2 - Symbol("d"))


def test_a_long_chain_of_constraints_is_resolved() -> None:
    """Each joint follows the one before it; the chain is as long as the largest model."""
    model = make_chain([f"q{i} - q{i + 1}" for i in range(1, 100)], count=100)
    rules, remaining = read_rules(model)
    assert (len(rules), remaining) == (99, 0)
    assert set(rules.values()) == {(1, 1.0, 0.0)}
