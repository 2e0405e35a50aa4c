"""Joints' own forces and external wrenches, from the file to the equations of motion."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from sympy import Expr, Symbol

from mbsgen.formulations import exp2, impl
from mbsgen.model.changes.reduction import build_tree
from mbsgen.model.reader import read_model
from mbsgen.model.symbols import exact
from mbsgen.model.tree import COORDINATE, NO_FORCE, RATE, Kind, Tree
from mbsgen.pipeline import build_parametric
from mbsgen.tape.interpreter import evaluate
from tests.mbsgen.model.descriptions import Array, make_fixed_description, pose_described, read, to_direction

WHEEL = """\
name: wheel
gravity: [0, 0, -9.81]
parameters:
  k: 4
  r: 0.3
  T: {{value: 1.5, kind: runtime}}
bodies:
  - name: wheel
    joint: {{type: revolute, axis: z, {law}}}
    mass: 1
    inertia: [1, 1, 2]
"""

LAWS: dict[str, tuple[str, Callable[[float, float], float]]] = {
    "a spring": ("stiffness: k, rest: r", lambda q, _: -4 * (q - 0.3)),
    "a slack spring": ("stiffness: 2", lambda q, _: -2 * q),
    "a damper": ("damping: 0.7", lambda _, qd: -0.7 * qd),
    "friction": ("friction: {torque: T, speed: 0.1}", lambda _, qd: -1.5 * math.tanh(qd / 0.1)),
    "a cubic": ("force: -k*q**3 + qd*abs(qd)", lambda q, qd: -4 * q**3 + qd * abs(qd)),
    "every function": (
        "force: 'sin(q) + cos(qd) + tan(q/2) + atan2(q, qd) + asin(q/9) + acos(q/9) + atan(qd) + sqrt(1 + q**2)"
        " + exp(-q) + log(2 + q**2) + tanh(T*q) + abs(qd)"
        " + max(q, qd) + min(3*q, T) + step(q, 0.2) + softplus(qd, 1/2)'",
        lambda q, qd: (
            math.sin(q)
            + math.cos(qd)
            + math.tan(q / 2)
            + math.atan2(q, qd)
            + math.asin(q / 9)
            + math.acos(q / 9)
            + math.atan(qd)
            + math.sqrt(1 + q**2)
            + math.exp(-q)
            + math.log(2 + q**2)
            + math.tanh(1.5 * q)
            + abs(qd)
            + max(q, qd)
            + min(3 * q, 1.5)
            + 1 / (1 + math.exp(-q / 0.2))
            + math.log1p(math.exp(2 * qd)) / 2
        ),
    ),
    "all together": (
        "stiffness: k, rest: -r, damping: 2*r, friction: {torque: 2, speed: r}, force: T*cos(q)",
        lambda q, qd: -4 * (q + 0.3) - 0.6 * qd - 2 * math.tanh(qd / 0.3) + 1.5 * math.cos(q),
    ),
}


def read_text(text: str, folder: Path) -> Tree:
    file = folder / "model.yaml"
    file.write_text(text, encoding="utf-8")
    return build_tree(read_model(file))


def free_text(text: str, folder: Path) -> Tree:
    read_text(text, folder)
    return build_parametric(read_model(folder / "model.yaml"))


@pytest.mark.parametrize(("law", "force"), LAWS.values(), ids=LAWS.keys())
def test_a_law_is_a_force_in_the_direction_of_q(
    law: str, force: Callable[[float, float], float], tmp_path: Path
) -> None:
    """Phi = J qdd - u - force, as IMPL has it."""
    tree = read_text(WHEEL.format(law=law), tmp_path)
    tape = impl.build(tree)
    for q, qd in ((0.4, -0.7), (-1.2, 0.03), (0.3, 2.0)):
        found = evaluate(tape, {"q": [q], "qd": [qd], "qdd": [0.5], "u": [0.25], "p": [1.5]})["Phi"][0]
        assert found == pytest.approx(2 * 0.5 - 0.25 - force(q, qd), rel=1e-14)


@pytest.mark.parametrize(
    "law", ["damping: 0", "stiffness: 0*k, rest: 1", "force: q - q", "friction: {torque: 0, speed: 1}"]
)
def test_no_force_is_structural(law: str, tmp_path: Path) -> None:
    (body,) = read_text(WHEEL.format(law=law), tmp_path).bodies
    assert body.joint.law is NO_FORCE


def test_a_law_keeps_parameters_and_its_own_variables_apart(tmp_path: Path) -> None:
    """Symbols of parameters have no assumptions; q and qd of a law are real."""
    (body,) = read_text(WHEEL.format(law="force: T*q - k*qd"), tmp_path).bodies
    assert body.joint.law.free_symbols == {Symbol("T"), Symbol("k"), COORDINATE, RATE}


def test_the_direction_of_an_axis_is_that_of_its_force(tmp_path: Path) -> None:
    """About -z a spring pulls back all the same: q counts about the author's axis."""
    turned = read_text(WHEEL.format(law="stiffness: 3").replace("axis: z", "axis: [0, -1e-3, -1]"), tmp_path)
    phi = evaluate(impl.build(turned), {"q": [0.2], "qd": [0.0], "qdd": [0.0], "u": [0.0], "p": [1.5]})["Phi"]
    assert phi == pytest.approx([0.6], rel=1e-14)


# --- wrenches --------------------------------------------------------------------------------------------------------


def make_pulled_description(seed: int) -> dict[str, Any]:
    """Add a wrench to every body that moves, fixed ones among them: in both frames, numbers all."""
    description = make_fixed_description(seed)
    rng = np.random.default_rng(seed + 300)
    wrenches = [
        {
            "name": f"w{i}",
            "body": f"b{i}",
            "position": rng.uniform(-1, 1, 3).tolist(),
            "frame": str(rng.choice(["base", "body"])),
            "force": rng.uniform(-5, 5, 3).tolist(),
            "moment": rng.uniform(-5, 5, 3).tolist(),
        }
        for i in range(len(description["bodies"]))
    ]
    return description | {"wrenches": wrenches}


def work(description: dict[str, Any], q: dict[str, float]) -> Array:
    """Virtual work of all wrenches for each joint's motion, in plain matrices: a.m + (a x (r - p)).f, or a.f."""
    poses = pose_described(description, q)
    bodies = {body["name"]: body for body in description["bodies"]}
    moving = [name for name, body in bodies.items() if body["joint"]["type"] != "fixed"]
    Q = dict.fromkeys(moving, 0.0)
    for wrench in description["wrenches"]:
        R, p = poses[wrench["body"]]
        point = p + R @ np.array(wrench["position"])
        axes = R if wrench["frame"] == "body" else np.eye(3)
        f, m = axes @ np.array(wrench["force"]), axes @ np.array(wrench["moment"])
        name = wrench["body"]
        while name != "base":
            joint = bodies[name]["joint"]
            if joint["type"] != "fixed":
                Rj, pj = poses[name]
                a = Rj @ to_direction(joint["axis"])
                Q[name] += a @ (m + np.cross(point - pj, f)) if joint["type"] == "revolute" else a @ f
            name = bodies[name]["parent"]
    return np.array([*Q.values()])


def residual(tree: Tree, q: Array, w: list[float]) -> Array:
    n = len(q)
    given = {"q": list(q), "qd": [0.0] * n, "qdd": [0.0] * n, "u": [0.0] * n} | ({"w": w} if w else {})
    given |= {"p": [x.value for x in tree.parameters]} if tree.parameters else {}
    return np.array(evaluate(impl.build(tree), given)["Phi"])


@pytest.mark.parametrize("seed", range(6))
def test_a_wrench_does_the_work_that_its_description_says(seed: int, tmp_path: Path) -> None:
    """Given as numbers, as inputs, and as numbers at run time, whatever frames the Tree puts its bodies into."""
    description = make_pulled_description(seed)
    rng = np.random.default_rng(seed)
    names = [body["name"] for body in description["bodies"] if body["joint"]["type"] != "fixed"]
    q = rng.uniform(-3, 3, len(names))
    at = dict(zip(names, map(float, q), strict=True))
    bare = residual(read({**description, "wrenches": []}, tmp_path), q, [])
    tree, freed = read(description, tmp_path), build_parametric(read_model(tmp_path / "model.yaml"))
    expected = work(description, at)
    tolerance = {"rtol": 0, "atol": 1e-12 * (np.abs(bare).max() + np.abs(expected).max())}
    np.testing.assert_allclose(bare - residual(tree, q, []), expected, **tolerance)
    np.testing.assert_allclose(bare - residual(freed, q, []), expected, **tolerance)
    left_open = [{**wrench, "force": "input", "moment": "input"} for wrench in description["wrenches"]]
    w = [x for wrench in description["wrenches"] for x in (*wrench["force"], *wrench["moment"])]
    opened = read({**description, "wrenches": left_open}, tmp_path)
    np.testing.assert_allclose(bare - residual(opened, q, w), expected, **tolerance)


def test_half_a_wrench_may_be_an_input(tmp_path: Path) -> None:
    text = (
        WHEEL.format(law="damping: 1") + "wrenches:\n  - {name: pull, body: wheel, force: input, moment: [0, 0, T]}\n"
    )
    (wrench,) = read_text(text, tmp_path).wrenches
    assert (wrench.force, wrench.moment, wrench.in_base) == (None, (0, 0, Symbol("T")), True)


def test_numbers_of_wrenches_become_parameters_too(tmp_path: Path) -> None:
    text = WHEEL.format(law="damping: 1") + (
        "wrenches:\n  - {name: wheel, body: wheel, position: [1, 0, 0], force: [0, 2, k], moment: input}\n"
    )
    freed = free_text(text, tmp_path)
    inertia = ["wheel.mass", "wheel.inertia.xx", "wheel.inertia.yy", "wheel.inertia.zz"]
    names = [
        "k",
        "T",
        "gravity.z",
        "wheel.damping",
        *inertia,
        "wrenches.wheel.position.x",
        "wrenches.wheel.force.y",
    ]
    assert [p.name for p in freed.parameters] == names
    assert {p.kind for p in freed.parameters} == {Kind.RUNTIME}
    assert freed.wrenches[0].moment is None


def law_values(tree: Tree, law: Expr) -> Expr:
    return law.xreplace({p.symbol: exact(p.value) for p in tree.parameters})


@pytest.mark.parametrize(
    ("law", "numbers"),
    [
        ("stiffness: 20, rest: 0.1, damping: 0.5", {"stiffness": 20, "rest": 0.1, "damping": 0.5}),
        ("friction: {torque: 0.8, speed: 2**-6}", {"friction.torque": 0.8, "friction.speed": 1 / 64}),
        ("force: -3/2*q**3 + 0.1*qd", {"force.1": -1.5, "force.2": 0.1}),
        ("force: T*sin(2*q - 1/4)/8 + abs(qd)*tanh(3*qd)", {f"force.{k}": x for k, x in enumerate((2, 0.25, 8, 3), 1)}),
        ("stiffness: 2*k, rest: -r, damping: 0.5, force: 0*q + T", {"damping": 0.5}),  # expressions, and a zero
        ("force: pi*q + 3*qd", {"force.1": 3}),  # pi is what it is
        ("force: 3*exp(2*log(T))*qd", {"force.1": 3, "force.2": 2}),
        ("damping: 0, stiffness: 0*k, rest: 1", {}),
    ],
)
def test_numbers_of_laws_become_parameters_too(law: str, numbers: dict[str, float], tmp_path: Path) -> None:
    """Named after their place in the file; with their values the law is what it was, with others it is another."""
    tree = read_text(WHEEL.format(law=law), tmp_path)
    freed = build_parametric(read_model(tmp_path / "model.yaml"))
    (before,), (after,) = tree.bodies, freed.bodies
    own = {p.name: p.value for p in freed.parameters if p.symbol in after.joint.law.free_symbols and "." in p.name}
    assert own == {f"wheel.{name}": value for name, value in numbers.items()}
    for q, qd in ((0.4, -0.7), (-1.2, 0.03)):
        point = {COORDINATE: exact(q), RATE: exact(qd)}
        expected, found = (law_values(t, b.joint.law).xreplace(point) for t, b in ((tree, before), (freed, after)))
        assert float(found) == pytest.approx(float(expected), rel=1e-14)


def test_a_spring_at_run_time_has_the_stiffness_and_the_rest_of_its_caller(tmp_path: Path) -> None:
    tree = free_text(WHEEL.format(law="stiffness: 20, rest: 0.1, damping: 0.5"), tmp_path)
    given = {p.name: p.value for p in tree.parameters} | {"wheel.stiffness": 7.0, "wheel.rest": -0.3}
    at = {"q": [0.4], "qd": [2.0], "qdd": [0.0], "u": [0.0], "p": list(given.values())}
    assert evaluate(impl.build(tree), at)["Phi"] == pytest.approx([7 * 0.7 + 0.5 * 2], rel=1e-15)


def test_forward_dynamics_knows_them_all(tmp_path: Path) -> None:
    """EXP2 gives the acceleration for which IMPL's residual vanishes."""
    text = WHEEL.format(law="stiffness: k, damping: r") + "wrenches:\n  - {name: w, body: wheel, moment: [0, 0, 2*T]}\n"
    tree = read_text(text, tmp_path)
    at = {"q": [0.5], "qd": [1.0], "u": [0.0], "p": [1.5]}
    assert evaluate(exp2.build(tree), at)["qdd"] == pytest.approx([(-4 * 0.5 - 0.3 + 3) / 2], rel=1e-14)
