"""The robots that are compared are Pinocchio's: models, conversion, and the text that the peers read."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from benchmarks.conversion import convert, read_urdf
from benchmarks.mechanism import write_mechanism
from benchmarks.newton_euler import write_functions
from benchmarks.symbolic import jacobian
from mbsgen.formulations import exp2, impl, semi
from mbsgen.formulations.reductions import NONE
from mbsgen.model.construction import body, make_model, revolute
from mbsgen.model.reader import read_model
from mbsgen.model.writer import write_model
from mbsgen.pipeline import read_tree
from mbsgen.tape.interpreter import evaluate
from tests.random_trees import Pinocchio

ROOT = Path(__file__).parents[2]
MODELS = ROOT / "benchmarks" / "models"
CHAINS = (ROOT / "models" / "arm_pendulum.yaml", *sorted(MODELS.glob("*.yaml")))
MODELS_OF_PEERS = (*CHAINS, ROOT / "models" / "cart_pole.yaml", ROOT / "models" / "quadruped.yaml")


def read_as_peers_do(text: str) -> Any:
    """Build Pinocchio's model of a mechanism's text, as `cpp/mechanism.hpp` does."""
    first, *lines = text.splitlines()
    model = pin.Model()
    model.gravity.linear = np.array(first.split()[1:], dtype=float)
    for line in lines:
        parent, joint, _, *numbers = line.split()
        x = np.array(numbers, dtype=float)
        kind = getattr(pin, f"JointModel{joint}")()
        index = model.addJoint(int(parent), kind, pin.SE3(x[3:12].reshape(3, 3), x[:3]), f"j{model.njoints}")
        inertia = x[16:][[0, 1, 3, 1, 2, 4, 3, 4, 5]].reshape(3, 3)
        model.appendBodyToJoint(index, pin.Inertia(x[12], x[13:16], inertia), pin.SE3.Identity())
    return model


@pytest.mark.parametrize("path", MODELS_OF_PEERS, ids=lambda p: p.stem)
def test_the_peers_mechanism_is_ours(path: Path) -> None:
    """Phi, M and qdd of Pinocchio, fed with the text, agree with the textbook recursions, to 1e-12 of the largest."""
    tree = read_tree(path)
    peer = read_as_peers_do(write_mechanism(tree))
    data = peer.createData()
    driven = [i for i, body in enumerate(tree.bodies) if body.joint.actuated]
    n = len(tree.bodies)
    rng = np.random.default_rng(3)
    for _ in range(3):
        q, qd, qdd, Q = rng.uniform(-3, 3, (4, n))
        u, Q = Q[driven], np.isin(range(n), driven) * Q
        arguments = {"q": list(q), "qd": list(qd), "qdd": list(qdd), "u": list(u)}

        def compute(build: Any, given: dict[str, list[float]] = arguments) -> dict[str, Any]:
            tape = build(tree, NONE)
            return evaluate(tape, {i.name: given[i.name] for i in tape.inputs})

        upper = np.triu(pin.crba(peer, data, q))
        expected = {
            impl.build: pin.rnea(peer, data, q, qd, qdd) - Q,
            semi.build: (upper + np.triu(upper, 1).T).T.ravel(),
            exp2.build: pin.aba(peer, data, q, qd, Q),
        }
        for build, wanted in expected.items():
            found = np.array(next(iter(compute(build).values())), dtype=float)
            np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-12 * np.abs(wanted).max())


@pytest.mark.parametrize("name", ["ur5", "panda"])
def test_conversion_gives_the_model_it_came_from(name: str) -> None:
    """The committed file, as a Pinocchio model, is converted to the committed file: nothing is lost on the way."""
    path = MODELS / f"{name}.yaml"
    source = Pinocchio(read_tree(path)).model
    for j, one in enumerate(read_tree(path).bodies, 1):
        source.names[j] = one.joint.name
    assert write_model(convert(source, name)) == write_model(read_model(path))


def test_conversion_refuses_joints_it_does_not_know() -> None:
    source = pin.Model()
    source.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "free")
    with pytest.raises(ValueError, match="joint free: JointModelFreeFlyer"):
        convert(source, "floating")


URDF = """<robot name="gripper">
  <link name="base"/>
  <link name="arm"><inertial><mass value="2"/><origin xyz="0.1 0 0"/>
    <inertia ixx="0.1" iyy="0.2" izz="0.2" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="finger"><inertial><mass value="1"/><origin xyz="0 0 0"/>
    <inertia ixx="0" iyy="0" izz="0" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="lift" type="revolute"><parent link="base"/><child link="arm"/>
    <origin xyz="0 0 0.5" rpy="1.5707963 0 0"/><axis xyz="0 0 1"/>
    <limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
  <joint name="grip" type="prismatic"><parent link="arm"/><child link="finger"/>
    <origin xyz="0.4 0 0"/><axis xyz="0 1 0"/><limit lower="0" upper="1" effort="1" velocity="1"/></joint>
</robot>"""


def test_a_rounded_quarter_turn_becomes_one_and_held_bodies_are_carried(tmp_path: Path) -> None:
    """2 kg at 0.1 and 1 kg at 0.4 are 3 kg at 0.2; about there, 2 * 0.1^2 + 0.2^2 = 0.06 kg m2 is added across x."""
    (tmp_path / "gripper.urdf").write_text(URDF, encoding="utf-8")
    model = convert(read_urdf(tmp_path / "gripper.urdf", ("grip",)), "gripper")
    expected = body(
        "link1",
        revolute("z", name="lift", position=(0, 0, 0.5), orientation=[("x", "pi/2")]),
        mass=3.0,
        com=(0.2, 0, 0),
        inertia=(0.1, 0.26, 0.26),
    )
    assert write_model(model) == write_model(make_model("gripper", [expected], gravity=(0, 0, -9.81)))


@pytest.mark.parametrize("path", MODELS_OF_PEERS, ids=lambda p: p.stem)
def test_the_short_recursions_are_the_textbooks(path: Path) -> None:
    """Moving inertia that a joint cannot feel changes no force: Phi and qdd of any tree, to 1e-12 of the largest."""
    tree = read_tree(path)
    functions = write_functions(tree, ("impl", "semi", "exp1", "exp2"))
    n, m = len(tree.bodies), functions["impl"].size1_in(3)
    q, qd, qdd, u = np.random.default_rng(4).uniform(-2, 2, (4, n))
    at = {"q": list(q), "qd": list(qd), "qdd": list(qdd), "u": list(u[:m])}
    built = {"Phi": impl.build(tree, NONE), "qdd": exp2.build(tree, NONE)}
    expected = {
        name: np.array(evaluate(tape, {i.name: at[i.name] for i in tape.inputs})[name], dtype=float)
        for name, tape in built.items()
    }
    M, c = functions["semi"](q, qd)
    Q = np.zeros(n)
    Q[[i for i, body in enumerate(tree.bodies) if body.joint.actuated]] = u[:m]
    found = {
        "Phi": [functions["impl"](q, qd, qdd, u[:m]), M @ qdd + c - Q],
        "qdd": [functions["exp1"](q, qd, u[:m]), functions["exp2"](q, qd, u[:m])],
    }
    for name, values in found.items():
        for value in values:
            tolerance = 1e-12 * np.abs(expected[name]).max()
            np.testing.assert_allclose(np.array(value).ravel(), expected[name], rtol=0, atol=tolerance)


def test_the_short_jacobian_of_accelerations_is_their_derivative() -> None:
    """-M^-1 d Phi and the driven columns of M^-1, against CasADi's derivative of the articulated bodies', to 1e-10."""
    functions = write_functions(read_tree(ROOT / "models" / "arm_pendulum.yaml"), ("exp2", "jac_exp"))
    expected = jacobian(functions["exp2"], "expected")
    q, qd, u = np.random.default_rng(5).uniform(-1, 1, (3, 6))
    for one, other in zip(functions["jac_exp"](q, qd, u[:4]), expected(q, qd, u[:4]), strict=True):
        np.testing.assert_allclose(one.full(), other.full(), rtol=0, atol=1e-10 * np.abs(other.full()).max())


def test_what_the_peers_cannot_have_is_refused() -> None:
    with pytest.raises(ValueError, match="without forces but the actuators'"):
        write_mechanism(read_tree(ROOT / "models" / "branched.yaml"))
    quadruped = read_tree(ROOT / "models" / "quadruped.yaml")
    legs = quadruped.bodies[6:9], quadruped.bodies[9:12]
    in_turn = (body for pair in zip(*legs, strict=True) for body in pair)
    mixed = [replace(body, parent=parent) for body, parent in zip(in_turn, (6, 6, 7, 8, 9, 10), strict=True)]
    with pytest.raises(ValueError, match="every branch's bodies together"):
        write_mechanism(replace(quadruped, bodies=(*quadruped.bodies[:6], *mixed), sensors=()))
