"""Velocities and Jacobians of sensors against Pinocchio, and against each other."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from sympy import Integer

from mbsgen.derivatives.kernels import differentiate
from mbsgen.formulations.catalogue import FUNCTIONS, LOOPS, select_functions
from mbsgen.formulations.results import poses, velocities
from mbsgen.model.tree import Quaternion, Sensor, Tree
from mbsgen.tape.interpreter import evaluate
from mbsgen.tape.types import Tape
from tests.random_trees import Pinocchio, exact_matrix, floats, random_tree

Array = NDArray[np.float64]


def sensing(seed: int, size: int) -> Tree:
    """A random tree with a sensor at its end, on its first body, on one between, and on the base."""
    tree = random_tree(seed, size, tidy=seed % 2 == 0)
    (tip,) = tree.sensors
    rest = [replace(tip, name=f"sensor{k}", body=k) for k in (1, max(1, size // 2), 0)]
    return replace(tree, sensors=(tip, *rest))


def full(tape: Tape, name: str, at: dict[str, list[float]]) -> Array:
    pattern = tape.output(name).sparsity
    matrix = np.zeros((pattern.rows, pattern.cols))
    for place, value in zip(pattern.entries, evaluate(tape, at)[name], strict=True):
        matrix[place] = value
    return matrix


def state(seed: int, size: int) -> dict[str, list[float]]:
    rng = np.random.default_rng(seed + 40)
    return {name: list(rng.uniform(-2, 2, size)) for name in ("q", "qd")}


@pytest.mark.parametrize(("seed", "size"), [(0, 1), (1, 3), (2, 6), (3, 12), (4, 20)])
def test_velocities_and_jacobians_equal_pinocchio(seed: int, size: int):
    import pinocchio as pin

    tree, at = sensing(seed, size), state(seed, size)
    peer = Pinocchio(tree)
    frames = [
        peer.model.addFrame(
            pin.Frame(
                sensor.name,
                peer.order[sensor.body - 1] + 1 if sensor.body else 0,
                pin.SE3(floats(tree, sensor.orientation), floats(tree, sensor.position)),
                pin.FrameType.OP_FRAME,
            )
        )
        for sensor in tree.sensors
    ]
    data = peer.model.createData()
    q, qd = (peer._theirs(np.array(at[x])) for x in ("q", "qd"))
    pin.computeJointJacobians(peer.model, data, q)
    pin.forwardKinematics(peer.model, data, q, qd)
    pin.updateFramePlacements(peer.model, data)
    motion = velocities.build_motion(tree)
    v, omega = full(motion, "v", at), full(motion, "omega", at)
    J = full(velocities.build_jacobian(tree), "J", {"q": at["q"]})
    aligned = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
    for k, frame in enumerate(frames):
        theirs = pin.getFrameVelocity(peer.model, data, frame, aligned)
        assert v[:, k] == pytest.approx(theirs.linear, abs=1e-13 * size)
        assert omega[:, k] == pytest.approx(theirs.angular, abs=1e-13 * size)
        expected = pin.getFrameJacobian(peer.model, data, frame, aligned).reshape(6, size)[:, peer.order]
        assert np.abs(J[6 * k : 6 * k + 6] - expected).max() <= 1e-13 * size


@pytest.mark.parametrize("seed", range(4))
def test_a_jacobian_takes_rates_to_velocities_and_differentiates_positions(seed: int):
    """v = J qd, omega = J qd, d position / dq = J, and d v / d qd = J."""
    tree, at = sensing(seed, 7), state(seed, 7)
    motion, sensors = velocities.build_motion(tree), poses.build_sensors(tree)
    J = full(velocities.build_jacobian(tree), "J", {"q": at["q"]}).reshape(4, 6, 7)
    found = np.concatenate((full(motion, "v", at), full(motion, "omega", at))).T
    assert np.abs(J @ np.array(at["qd"]) - found).max() < 1e-13
    by_q = full(differentiate(sensors, ("q",)).jac, "jac_position_q", {"q": at["q"]})
    assert np.abs(by_q - J[:, :3].reshape(12, 7)).max() < 1e-13
    by_qd = full(differentiate(motion, ("q", "qd")).jac, "jac_v_qd", at)
    assert np.abs(by_qd - J[:, :3].reshape(12, 7)).max() < 1e-13


def test_only_joints_on_the_way_to_the_base_have_entries():
    tree = sensing(3, 12)
    pattern = velocities.build_jacobian(tree).output("J").sparsity
    for k, sensor in enumerate(tree.sensors):
        path, number = set(), sensor.body
        while number:
            path.add(number - 1)
            number = tree.bodies[number - 1].parent
        assert {c for r, c in pattern.entries if r // 6 == k} == path


def test_a_tree_without_sensors_or_quaternions_has_none_of_their_functions():
    tree = replace(random_tree(0, 3), sensors=())
    of_loops = {name for name, entry in FUNCTIONS.items() if LOOPS in entry.needs}
    assert of_loops >= {"loops", "close", "exp1_red"}
    assert (
        set(FUNCTIONS) - set(select_functions(tree))
        == {"sensors", "motion", "accelerations", "attitudes", "jacobian", "rates", "distances"}
        | {"contact_forces", "lengths", "stretches", "tensions", "touching", "meetings"}
        | of_loops
    )
    zero = Integer(0)
    sensor = Sensor("base", 0, (zero, zero, zero), exact_matrix(np.eye(3)))
    some = replace(tree, sensors=(sensor,), quaternions=(Quaternion("ball", 1, is_free=False),))
    of_forces = {"distances", "contact_forces", "lengths", "stretches", "tensions", "touching", "meetings"}
    assert set(select_functions(some)) == set(FUNCTIONS) - of_loops - of_forces
