"""Functions that are written where they are named: forces in joints, motions of sensors, springs and contacts."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from mbsgen.assembly import assemble
from mbsgen.families import write_families
from mbsgen.formulations import catalogue
from mbsgen.formulations.closure import kept_equations
from mbsgen.formulations.reductions import ALL
from mbsgen.model.changes.reduction import build_tree
from mbsgen.model.reader import read_model
from mbsgen.model.tree import Tree
from mbsgen.procedure.procedure import straight
from mbsgen.request import Request
from mbsgen.roles import ON_REQUEST
from mbsgen.tape.interpreter import evaluate
from mbsgen.verification.verify import verify
from tests.random_trees import Pinocchio, floats, random_tree

Array = NDArray[np.float64]


def read(text: str, folder: Path) -> Tree:
    path = folder / "model.yaml"
    path.write_text(text)
    return assemble(build_tree(read_model(path)))


def call(tree: Tree, name: str, **given: list[float]) -> dict[str, Array]:
    tape = straight(catalogue.FUNCTIONS[name].build(tree, ALL))
    found = evaluate(tape, {i.name: given.get(i.name, [0.0] * i.sparsity.nnz) for i in tape.inputs})
    return {o.name: np.array(found[o.name]).reshape((o.sparsity.cols, o.sparsity.rows)).T for o in tape.outputs}


@pytest.mark.parametrize(("seed", "size"), [(1, 3), (2, 6), (5, 9)])
def test_joints_carry_and_sensors_move_as_in_pinocchio(seed: int, size: int):
    import pinocchio as pin

    tree = random_tree(seed, size, tidy=seed % 2 == 0)
    rng = np.random.default_rng(seed)
    q, qd, qdd = rng.uniform(-2, 2, (3, size))
    peer = Pinocchio(tree)
    w = rng.uniform(-2, 2, tree.open_entries)
    peer.residual(q, qd, qdd, w)
    found = call(tree, "reactions", q=list(q), qd=list(qd), qdd=list(qdd), w=list(w))
    for i in range(size):
        joint = peer.order[i] + 1
        R, force = peer.data.oMi[joint].rotation, peer.data.f[joint]
        scale = 1e-13 * size * max(1, np.abs(force.vector).max())
        assert found["force"][:, i] == pytest.approx(R @ force.linear, abs=scale)
        assert found["moment"][:, i] == pytest.approx(R @ force.angular, abs=scale)
    (sensor,) = tree.sensors
    place = pin.SE3(floats(tree, sensor.orientation), floats(tree, sensor.position))
    frame = peer.model.addFrame(pin.Frame("tip", peer.order[sensor.body - 1] + 1, place, pin.FrameType.OP_FRAME))
    data = peer.model.createData()
    pin.forwardKinematics(peer.model, data, *(peer._theirs(x) for x in (q, qd, qdd)))
    pin.updateFramePlacements(peer.model, data)
    theirs = pin.getFrameClassicalAcceleration(peer.model, data, frame, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
    moved = call(tree, "accelerations", q=list(q), qd=list(qd), qdd=list(qdd))
    scale = 1e-13 * size * max(1, np.abs(theirs.vector).max())
    assert moved["acceleration"][:, 0] == pytest.approx(theirs.linear, abs=scale)
    assert moved["alpha"][:, 0] == pytest.approx(theirs.angular, abs=scale)
    assert call(tree, "attitudes", q=list(q))["attitude"] == pytest.approx(data.oMf[frame].rotation, abs=1e-14 * size)


TRUSS = """\
name: truss
gravity: [0, 0, -9.81]
bodies:
  - {name: left, joint: {type: revolute, axis: y, actuated: false}, mass: 1e-9, inertia: [1e-9, 1e-9, 1e-9]}
  - name: load
    parent: left
    joint: {type: revolute, axis: y, position: [1, 0, 0], actuated: false}
    mass: 3
    inertia: [0.1, 0.1, 0.1]
  - name: right
    joint: {type: revolute, axis: y, position: [1.6, 0, 0], actuated: false}
    mass: 1e-9
    inertia: [1e-9, 1e-9, 1e-9]
loops:
  - {name: top, type: ball, from: {body: load}, to: {body: right, position: [-1, 0, 0]}}
assembly: {left: -0.6, right: 0.6}
"""


def test_pins_of_a_truss_carry_half_of_the_load_each(tmp_path: Path):
    """Two bars of 1 m stand 1.6 m apart and hold 3 kg at a height of 0.6 m: each is pressed by m g / (2 sin a)."""
    tree = read(TRUSS, tmp_path)
    a, lift = math.acos(0.8), 3 * 9.81 / 2
    push = lift / math.tan(a)
    on_bar = {"x": push, "y": 0.0, "z": -lift}  # the load on the tip of the right bar
    lam = [on_bar[name] for _, name in kept_equations(tree)]
    q = [-a, 0.3, a]  # the load itself may turn
    assert call(tree, "impl", q=q, lam=lam)["Phi"] == pytest.approx(np.zeros((3, 1)), abs=1e-7)
    found = call(tree, "reactions", q=q, lam=lam)
    expected = [[push, 0, lift], [push, 0, lift], [-push, 0, lift]]
    assert found["force"] == pytest.approx(np.array(expected).T, abs=1e-6)
    assert found["moment"] == pytest.approx(np.zeros((3, 3)), abs=1e-6)


SPRUNG = """\
name: sprung
gravity: [0, 0, -9.81]
signals: [pull]
bodies:
  - {name: arm, joint: {name: q, type: revolute, axis: -y}, mass: 2, com: [0.2, 0, 0], inertia: [0.1, 0.1, 0.1]}
  - {name: ball, joint: {type: ball, position: [0, 0, 1]}, mass: 1, com: [0, 0, -0.1], inertia: [0.1, 0.1, 0.1]}
  - {name: drop, joint: {type: free}, mass: 1, inertia: [0.1, 0.2, 0.3]}
  - {name: twin, joint: {type: revolute, axis: y, position: [0, 1, 0], follows: {joint: q, ratio: -2}}, mass: 1,
     com: [0.1, 0, 0.05], inertia: [0.1, 0.1, 0.1]}
frames:
  - {name: tip, body: arm, position: [0.4, 0, 0]}
  - {name: pendant, body: ball, position: [0, 0, -0.3]}
forces:
  - {name: muscle, from: {body: base, position: [0, 0, 0.3]}, to: {body: arm, position: [0.4, 0, 0]}, force: 10*pull}
  - {name: rubber, from: {body: base, position: [0.5, 0, 0]}, to: {body: arm, position: [0.5, 0, 0]}, stiffness: 30}
  - {name: strap, type: cable, from: {body: arm, position: [0.1, 0, 0]}, to: {body: ball}, stiffness: 30, rest: 0.2}
contacts:
  - {name: floor, body: drop, radius: 0.1, stiffness: 1e4, exponent: 1, friction: {coefficient: 0.5, speed: 0.01}}
"""


def test_lengths_tensions_and_contact_forces_have_closed_forms(tmp_path: Path):
    tree = read(SPRUNG, tmp_path)
    assert tree.elements == ("muscle", "rubber", "strap")
    q = [0.7, 0, 0, 0, 1, 0, 0, 0.08, 0, 0, 0, 1]
    found = call(tree, "lengths", q=q) | call(tree, "tensions", q=q, w=[2.5])
    tip = 0.4 * np.array([math.cos(0.7), math.sin(0.7)])
    strap = math.hypot(0.1 * math.cos(0.7), 1 - 0.1 * math.sin(0.7))
    lengths = [math.hypot(tip[0], tip[1] - 0.3), 2 * 0.5 * math.sin(0.35), strap]
    assert found["length"][:, 0] == pytest.approx(lengths, rel=1e-13)
    assert found["tension"][:, 0] == pytest.approx([25, 30 * lengths[1], 30 * (strap - 0.2)], rel=1e-13)
    touching = call(tree, "contact_forces", q=q, w=[2.5])
    assert touching["normal"] == pytest.approx(1e4 * 0.02, rel=1e-13)
    assert touching["contact_force"][:, 0] == pytest.approx([0, 0, 200], rel=1e-13)
    q[0] = 0.0  # the ends of the rubber meet
    slack = call(tree, "lengths", q=q) | call(tree, "tensions", q=q, w=[0.0])
    assert [slack["length"][1, 0], slack["tension"][1, 0]] == pytest.approx([0, 0], abs=1e-140)


@pytest.mark.parametrize("text", [SPRUNG, TRUSS], ids=["sprung", "truss"])
def test_functions_are_verified_and_written_where_they_are_named(text: str, tmp_path: Path):
    """In 50 digits, with followers, quaternions, loops and an open spring: by differences, geometry, virtual power."""
    tree = read(text, tmp_path)
    names = [name for name in catalogue.select_functions(tree) if name in ON_REQUEST]
    families = write_families(tree, Request(functions=tuple(names)))
    found = verify(tree, families, still=False)
    assert set(names) <= found.deviations.keys()
    plain = write_families(tree, Request(derivatives=0))
    assert not {family.value.name for family in plain} & set(ON_REQUEST)
