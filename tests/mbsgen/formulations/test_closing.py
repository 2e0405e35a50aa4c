"""Coordinates, velocities and accelerations that keep loops closed: closed forms, iterations, and where they fail."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scipy.linalg
from sympy import Integer

from mbsgen.assembly.mechanism import Mechanism
from mbsgen.families import write_families
from mbsgen.formulations.catalogue import FUNCTIONS
from mbsgen.model.symbols import exact
from mbsgen.model.tree import Tree
from mbsgen.procedure.newton import Newton
from mbsgen.procedure.procedure import Procedure, as_procedure, interpret
from mbsgen.request import Request
from mbsgen.verification.verify import verify
from tests.mbsgen.formulations.closed_mechanisms import ONE, TEXTS, build, draw, make, read, run, spread
from tests.mbsgen.procedure.compiled import Library

MODELS = Path(__file__).parents[3] / "models"
ROUNDING = 1e-13  # a closed loop of lengths up to 1 m: some tens of roundings
STRAIGHT = ("four_bar", "slider_crank", "five_bar", "spatial_rod", "geared", "summed", "driven")  # without an iteration


def call(name: str, tree: Tree, **given: object) -> tuple[int, np.ndarray]:
    """Return the status of a function and its first result, as generated code does."""
    function = as_procedure(build(name, tree))
    values = [x.value for x in tree.parameters]  # of one kind
    given = {**given, "p": values, "theta": values}
    outcome = interpret(function, {i.name: [float(x) for x in given[i.name]] for i in function.inputs})
    return outcome.status, np.array([x for values in outcome.results.values() for x in values], float)


@pytest.mark.parametrize("name", TEXTS)
@pytest.mark.parametrize("seed", range(2))
def test_close_keeps_the_independent_coordinates_and_closes_all_loops(name, seed):
    tree = make(name)
    rng, pose = np.random.default_rng(seed), np.array(tree.closure.pose)
    start = pose + 0.1 * rng.uniform(-1, 1, pose.size)
    status, q = call("close", tree, q=start)
    assert status == 0
    assert Mechanism(tree).h(q) == pytest.approx(0, abs=ROUNDING)
    kept = [k for k in tree.closure.independent if not tree.quaternions or tree.joints[k].name in tree.coordinates[7:]]
    seats = [tree.coordinates.index(tree.joints[k].name) for k in kept]
    assert (q[seats] == start[seats]).all()


@pytest.mark.parametrize("name", TEXTS)
def test_planar_loops_and_single_equations_are_closed_without_an_iteration(name):
    function = FUNCTIONS["close"].build(make(name), ONE)
    iterates = isinstance(function, Procedure) and any(isinstance(stage, Newton) for stage in function.stages)
    assert iterates == (name not in STRAIGHT)


@pytest.mark.parametrize("name", TEXTS)
def test_rates_and_accelerations_keep_the_loops_closed(name):
    """J qd = 0 and J qdd + gamma = 0, with the independent entries as given."""
    tree = make(name)
    state = draw(tree, 4)
    for function, given, result in (("close_rates", "yd", "qd"), ("close_accelerations", "ydd", "qdd")):
        found = run(function, tree, state)[result]
        assert (found[list(tree.closure.independent)] == state[given]).all()
        assert found == pytest.approx(state[result], abs=1e-10)


def test_slider_crank_follows_its_closed_form():
    """x = r cos q1 + sqrt(l2 - (y - r sin q1)2), with the crank r, the rod l, and the cylinder's offset y."""
    tree = make("slider_crank")
    r, l, y = 0.1, 0.35, 0.02
    for q1 in np.linspace(-3, 3, 13):
        rest = y - r * np.sin(q1)
        expected = [q1, np.arcsin(rest / l) - q1, r * np.cos(q1) + np.sqrt(l**2 - rest**2)]
        _, q = call("close", tree, q=[q1, -q1, 0.3])
        assert q == pytest.approx(expected, abs=ROUNDING)


@pytest.mark.parametrize("side", [1, -1])
def test_four_bar_stays_on_the_side_of_its_start(side):
    """The coupler's end is where circles about crank and rocker's pivot meet, above or below the line between them."""
    tree = make("four_bar")
    for q1 in np.linspace(-3, 3, 13):
        A, B = 0.2 * np.array([np.cos(q1), np.sin(q1)]), np.array([0.6, 0])
        d = B - A
        length = np.linalg.norm(d)
        along = (length**2 + 0.5**2 - 0.4**2) / (2 * length)
        normal = np.array([-d[1], d[0]]) / length
        K = A + along * d / length + side * np.sqrt(0.5**2 - along**2) * normal
        expected = [q1, np.arctan2(*(K - A)[::-1]) - q1, np.arctan2(*(K - B)[::-1])]
        _, q = call("close", tree, q=np.add(expected, [0, 0.2, -0.15]))
        assert np.cos(q - expected) == pytest.approx(1, abs=ROUNDING)
        assert np.abs(q - expected).max() < 2 * np.pi + 0.1


@pytest.mark.parametrize(("coupler", "rocker"), [("chain", "crank"), ("crank", "chain")])
def test_a_slide_that_turns_is_closed_without_an_iteration(coupler, rocker):
    """A quick return: a block on the crank's pin slides along a lever; the slide is carried by the unknown turn."""
    text = """
name: quick_return
gravity: [0, -9.81, 0]
bodies:
  - {name: crank, joint: {name: q1, type: revolute, axis: z, actuated: true}, mass: 1, inertia: [1, 1, 1]}
  - {name: lever, joint: {name: q2, type: revolute, axis: z, position: [0, -0.4, 0], actuated: false}, mass: 1,
     inertia: [1, 1, 1]}
  - {name: block, parent: lever, joint: {name: s, type: prismatic, axis: x, position: [0, 0.03, 0], actuated: false},
     mass: 1, inertia: [1, 1, 1]}
loops:
  - {name: pin, type: ball, from: {body: FIRST, position: A}, to: {body: SECOND, position: B}}
assembly: {q1: 0.5, q2: 1.4, s: 0.5}
independent: [q1]
"""
    ends = {"chain": ("block", "[0, 0, 0]"), "crank": ("crank", "[0.15, 0, 0]")}
    for word, end in (("FIRST", ends[coupler]), ("SECOND", ends[rocker])):
        text = text.replace(word, end[0]).replace("A}" if word == "FIRST" else "B}", f"{end[1]}}}")
    tree = read(text)
    assert not isinstance(FUNCTIONS["close"].build(tree, ONE), Procedure)
    for q1 in np.linspace(-3, 3, 7):
        pin = 0.15 * np.array([np.cos(q1), np.sin(q1)]) + [0, 0.4]
        s = np.sqrt(pin @ pin - 0.03**2)
        expected = [q1, np.arctan2(pin[1], pin[0]) - np.arctan2(0.03, s), s]
        _, q = call("close", tree, q=[q1, 1.5, 0.4])
        assert q == pytest.approx(expected, abs=ROUNDING)


def parallelogram() -> Tree:
    """Return a four-bar whose four bars come to lie in one line."""
    tree = make("four_bar")
    (loop,) = tree.loops
    lengths = {"first": exact(0.6), "second": exact(0.2)}
    ends = {k: replace(getattr(loop, k), position=(x, Integer(0), Integer(0))) for k, x in lengths.items()}
    closure = replace(tree.closure, pose=(0.0, 0.0, 0.0))
    return replace(tree, loops=(replace(loop, **ends),), closure=closure)


@pytest.mark.filterwarnings("ignore:(divide|invalid)")
@pytest.mark.parametrize("q", [(0.0, 0.0, 0.0), (1e-9, -1e-9, 1e-9)])
def test_a_change_point_is_a_status_that_names_the_loop(q):
    """n + 1 = 4, from every function that divides by Ju, and no result."""
    tree, n = parallelogram(), 3
    given = {"q": q, "yd": [1.0], "ydd": [0.3], "u": [0.1]}
    for name in ("close", "close_rates", "close_accelerations", "impl_red", "semi_red", "exp1_red"):
        status, found = call(name, tree, **given)
        assert (status, found.size) == (n + 1, 0)
    turned = {**given, "q": (0.4, -0.4, 0.4)}
    assert call("exp1_red", tree, **turned)[0] == call("close", tree, **turned)[0] == 0


@pytest.mark.filterwarnings("ignore:invalid value")
@pytest.mark.parametrize(
    ("name", "q"), [("four_bar", (3.0, 0, 1)), ("spatial_rod", (0.4, 3.1)), ("spatial", (0, 0, 0, 2))]
)
def test_a_loop_out_of_reach_is_a_status_that_names_it(name, q):
    tree = make(name)
    (loop,) = tree.loops
    short = replace(loop.first, position=(exact(0.2), Integer(0), Integer(0)))
    loop = replace(loop, value=exact(0.25)) if name == "spatial_rod" else replace(loop, first=short)
    status, found = call("close", replace(tree, loops=(loop,)), q=q)
    assert (status, found.size) == (len(tree.joints) + 1, 0)


@pytest.mark.parametrize("function", ["project", "project_plain"])
@pytest.mark.parametrize("name", TEXTS)
def test_projection_is_the_least_change_that_closes_the_loops(name, function):
    """h = 0 and J qd = 0; changes, weighted by M or 1, have no part along motions that loops allow."""
    tree, rng = make(name), np.random.default_rng(6)
    pose, n = np.array(tree.closure.pose), len(tree.joints)
    given = {"q": pose + 0.03 * rng.uniform(-1, 1, pose.size), "qd": rng.uniform(-1, 1, n)}
    status, found = call(function, tree, **given)
    q, qd = np.split(found, [pose.size])
    assert status == 0
    mechanism = Mechanism(tree)
    assert mechanism.h(q) == pytest.approx(0, abs=ROUNDING)
    assert mechanism.J(q) @ qd == pytest.approx(0, abs=ROUNDING)
    for at, change in ((q, qd - given["qd"]), (given["q"], q - given["q"]))[: 1 if tree.quaternions else 2]:
        state = {**draw(tree, 0), **given, "q": at}
        weight = np.eye(n) if function == "project_plain" else spread("semi", tree, state, "M")
        free = [k for k, joint in enumerate(tree.joints) if joint.name not in driven(tree)]
        motions = scipy.linalg.null_space(mechanism.J(at)[:, free])
        assert motions.T @ weight[np.ix_(free, free)] @ change[free] == pytest.approx(0, abs=1e-12)
        assert (np.delete(change, free) == 0).all()


def driven(tree: Tree) -> set[str]:
    return {tree.bodies[number - 1].joint.name for number in tree.driven}


@pytest.mark.parametrize("name", ["slider_crank", "platform", "wishbone"])
def test_c_closes_loops_as_the_interpreter_does(name: str, tmp_path: Path):
    """A closed form, Newton's method, and two iterations after each other, with first and second derivatives."""
    tree = make(name) if name in TEXTS else read((MODELS / f"{name}.yaml").read_text("utf-8"))
    families = write_families(tree, Request(functions=("close",)))
    library = Library(families, tmp_path)
    given = {"q": [x + 0.05 for x in tree.closure.pose], "theta": [x.value for x in tree.parameters]}
    for function in (as_procedure(f) for family in families for f in family.functions):
        own = {i.name: given.get(i.name, [0.5] * i.sparsity.nnz) for i in function.inputs}
        status, found = library.call(function, own)
        assert status == 0
        for result, values in interpret(function, own).results.items():
            if len(values):
                assert found[result] == pytest.approx(np.array(values, float), rel=1e-11, abs=1e-12)


RECTANGLE = """
name: rectangle
gravity: [0, 0, -9.81]
bodies:
  - {name: crank, joint: {type: revolute, axis: y}, mass: 1, com: [0, 0, -0.2]}
  - {name: coupler, parent: crank, joint: {type: revolute, axis: y, position: [0, 0, -0.5]}, mass: 1, com: [0.2, 0, 0]}
  - {name: rocker, joint: {type: revolute, axis: y, position: [0.4, 0, 0]}, mass: 1, com: [0, 0, -0.2]}
loops:
  - {name: cut, type: ball, from: {body: coupler, position: [0.4, 0, 0]}, to: {body: rocker, position: [0, 0, -0.5]}}
"""


SECOND = """
  - {name: third, joint: {type: revolute, axis: y, position: [0.8, 0, 0]}, mass: 1, com: [0, 0, -0.2]}
loops:
  - {name: far, type: LOOP, from: {body: coupler, position: [0.8, 0, 0]}, to: {body: third, position: [0, 0, -0.5]}}"""


@pytest.mark.parametrize(
    ("loop", "angle", "is_doubled"),
    [("ball", 0, False), ("ball", 0.4, False), ("hinge, axis: y", -1.2, False), ("ball", 0.4, True), ("ball", 0, True)],
)
def test_verification_accepts_parallelograms_at_any_pose(loop: str, angle: float, is_doubled: bool):
    """The cranks turn alike and the coupler keeps its direction; a third crank repeats what two of them do.

    At angles of 0 the closed coordinates are rounding about 0, and differ by it.
    """
    text = RECTANGLE.replace("\nloops:", SECOND) if is_doubled else RECTANGLE
    third = f", third: {angle}" if is_doubled else ""
    pose = f"{{crank: {angle}, coupler: {-angle}, rocker: {angle}{third}}}"
    text = text.replace("LOOP", loop).replace("type: ball", f"type: {loop}")
    tree = read(f"{text}independent: [crank]\nassembly: {pose}\n")
    assert tree.closure.pose == pytest.approx([angle, -angle, angle, angle][: len(tree.closure.pose)], abs=ROUNDING)
    found = verify(tree, write_families(tree, Request(functions=("close",))), still=False)
    assert {"close", "lin_close", "jac_adj1_close"} <= set(found.deviations)


def test_generation_verifies_every_function_of_independent_coordinates():
    """Each is compared with the geometry of bodies in 50 digits, and its derivatives with differences."""
    functions = ("close", "close_rates", "close_accelerations", "project", "impl_red", "semi_red", "exp1_red")
    tree = make("geared")
    found = verify(tree, write_families(tree, Request(functions=functions, reductions=ONE)), still=False)
    assert not found.unchecked
    assert {"close", "lin_close", "jac_adj1_close", "project", "jac_adj1_exp1_red", "jac_adj1_impl_red"} <= set(
        found.deviations
    )
