"""The robots that are compared are Pinocchio's: models, conversion, and the text that the peers read."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.conversion import convert, read_urdf
from benchmarks.mechanism import write_mechanism
from mbsgen.formulations import exp2, impl, semi
from mbsgen.formulations.reductions import NONE
from mbsgen.model.reader import read_model
from mbsgen.model.writer import write_model
from mbsgen.pipeline import read_tree
from mbsgen.tape.interpreter import evaluate
from tests.random_trees import Pinocchio

pin = pytest.importorskip("pinocchio")
ROOT = Path(__file__).parents[2]
MODELS = ROOT / "benchmarks" / "models"
SOURCES = {
    "ur5": ("ur_description/urdf/ur5_robot.urdf", ()),
    "panda": ("panda_description/urdf/panda.urdf", ("panda_finger_joint1", "panda_finger_joint2")),
}


def read_as_peers_do(text: str) -> Any:
    """Build Pinocchio's model of a mechanism's text, as `cpp/mechanism.hpp` does."""
    first, *lines = text.splitlines()
    model = pin.Model()
    model.gravity.linear = np.array(first.split()[1:], dtype=float)
    for line in lines:
        parent, joint, _, *numbers = line.split()
        x = np.array(numbers, dtype=float)
        kind = {"RX": pin.JointModelRX, "RY": pin.JointModelRY, "RZ": pin.JointModelRZ}[joint]()
        index = model.addJoint(int(parent), kind, pin.SE3(x[3:12].reshape(3, 3), x[:3]), f"j{model.njoints}")
        inertia = x[16:][[0, 1, 3, 1, 2, 4, 3, 4, 5]].reshape(3, 3)
        model.appendBodyToJoint(index, pin.Inertia(x[12], x[13:16], inertia), pin.SE3.Identity())
    return model


@pytest.mark.parametrize(
    "path", [*sorted(MODELS.glob("*.yaml")), ROOT / "models" / "arm_pendulum.yaml"], ids=lambda p: p.stem
)
def test_the_peers_mechanism_is_ours(path: Path) -> None:
    """Phi, M and qdd of Pinocchio, fed with the text, are those of the textbook recursions, to 1e-12 of the largest."""
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


@pytest.mark.parametrize("name", SOURCES)
def test_conversion_gives_the_model_it_came_from(name: str) -> None:
    """The committed file, as a Pinocchio model, is converted to the committed file: nothing is lost on the way."""
    path = MODELS / f"{name}.yaml"
    source = Pinocchio(read_tree(path)).model
    for j, body in enumerate(read_tree(path).bodies, 1):
        source.names[j] = body.joint.name
    assert write_model(convert(source, name)) == write_model(read_model(path))


def test_conversion_refuses_joints_it_does_not_know() -> None:
    source = pin.Model()
    source.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "free")
    with pytest.raises(ValueError, match="joint free: JointModelFreeFlyer"):
        convert(source, "floating")


@pytest.mark.parametrize("name", SOURCES)
def test_committed_models_are_those_of_the_urdf_files(name: str) -> None:
    """What example-robot-data holds, converted, is the committed file."""
    urdf, held = SOURCES[name]
    robots = next(p for p in Path(pin.__file__).parents if p.name == "cmeel.prefix") / "share/example-robot-data/robots"
    if not robots.exists():
        pytest.skip("example-robot-data is not installed")
    converted = write_model(convert(read_urdf(robots / urdf, held), name))
    assert converted == write_model(read_model(MODELS / f"{name}.yaml"))


def test_what_the_peers_cannot_have_is_refused() -> None:
    with pytest.raises(ValueError, match="only chains of revolute joints"):
        write_mechanism(read_tree(ROOT / "models" / "cart_pole.yaml"))
