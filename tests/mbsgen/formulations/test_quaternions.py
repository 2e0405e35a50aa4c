"""Joints with quaternions, against Pinocchio's: the same coordinates, velocities along the body's axes."""

from __future__ import annotations

from dataclasses import replace
from functools import cache, partial
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from numpy.typing import NDArray

from mbsgen.derivatives.dynamics import Dynamics
from mbsgen.derivatives.kernels import differentiable, differentiate
from mbsgen.formulations import condition, exp1, exp2, impl, rates, semi
from mbsgen.formulations.reductions import ALL
from mbsgen.formulations.results import energy, poses, velocities
from mbsgen.model.changes.reduction import build_tree
from mbsgen.model.construction import ball, body, fixed, frame, free, inertia, make_model, prismatic, revolute
from mbsgen.model.model import Model
from mbsgen.model.tree import Motion, Tree
from mbsgen.tape.interpreter import evaluate
from mbsgen.tape.types import Tape
from tests.mbsgen.formulations.agreement import SWITCHED
from tests.random_trees import driven as drive
from tests.random_trees import floats

Array = NDArray[np.float64]
ONE_PLAN = replace(ALL, trials=1)
TOLERANCE = 1e-12  # of the largest entry; sums of some hundred products of numbers near 1


def swimmer() -> Model:
    """A free trunk with a limb of a hinge, a ball and a slider; another ball stands on the base."""
    part = partial(body, inertia=inertia(0.4, 0.5, 0.6, 0.03, -0.02, 0.01))
    turned = [("x", 0.4), ("z", -0.7)]
    return make_model(
        "swimmer",
        [
            part("trunk", free(position=(0.1, 0.2, 0.3), orientation=turned), mass=3, com=(0.1, 0, 0.2)),
            part("arm", revolute((0.6, 0, 0.8), position=(0.3, 0, 0)), parent="trunk", mass=1, com=(0.2, 0.1, 0)),
            part("hand", ball(position=(0.4, 0, 0), orientation=turned), parent="arm", mass=0.5, com=(0, 0.1, 0.1)),
            part("spike", fixed(position=(0.1, 0, 0)), parent="hand", mass=0.1, com=(0, 0.1, 0)),
            part("rod", prismatic("x", position=(0, 0.1, 0)), parent="hand", mass=0.3, com=(0.1, 0, 0)),
            part("buoy", ball(position=(1, 1, 0)), mass=2, com=(0, 0, -0.4)),
        ],
        gravity=(0.5, 0, -9.81),
        frames=[frame("eye", "hand", position=(0.1, 0.2, 0)), frame("tip", "rod", position=(0.3, 0, 0))],
    )


class Peer:
    """The same tree in Pinocchio; it orders the joints depth first, as the swimmer, except with `order`."""

    def __init__(self, tree: Tree) -> None:
        self.tree, self.model = tree, pin.Model()
        self.model.gravity.linear = floats(tree, tree.gravity)
        self.slots: list[tuple[int, range]] = []  # a joint of theirs, and the bodies that it is, in our order
        quaternions = {x.first: x for x in tree.quaternions}
        joints, number = {0: 0}, 1
        while number <= len(tree.bodies):
            first, own = tree.bodies[number - 1], quaternions.get(number)
            place = pin.SE3(floats(tree, first.orientation), floats(tree, first.position))
            bodies = own.bodies if own else range(number, number + 1)
            joint = self.model.addJoint(joints[first.parent], self._kind(number), place, first.name)
            for i in bodies:
                body, joints[i] = tree.bodies[i - 1], joint
                for part in (body, *body.parts):
                    mass = float(floats(tree, [part.mass])[0])
                    solid = pin.Inertia(mass, floats(tree, part.com), floats(tree, part.inertia))
                    self.model.appendBodyToJoint(joint, solid, pin.SE3.Identity())
            self.slots.append((joint, bodies))
            number += len(bodies)
        self.data = self.model.createData()

    def _kind(self, number: int) -> Any:
        for x in self.tree.quaternions:
            if x.first == number:
                return pin.JointModelFreeFlyer() if x.is_free else pin.JointModelSpherical()
        joint = self.tree.bodies[number - 1].joint
        kinds = {
            Motion.REVOLUTE: (pin.JointModelRX, pin.JointModelRY, pin.JointModelRZ),
            Motion.PRISMATIC: (pin.JointModelPX, pin.JointModelPY, pin.JointModelPZ),
        }
        return kinds[joint.motion][joint.axis]()


@cache
def tree_of() -> Tree:
    return build_tree(swimmer())


@cache
def peer_of() -> Peer:
    return Peer(tree_of())


def state(seed: int) -> dict[str, Array]:
    """Draw a state; Pinocchio's coordinates are in our order, since its joints are."""
    rng, n = np.random.default_rng(seed), len(tree_of().bodies)
    model = peer_of().model
    q = pin.integrate(model, pin.neutral(model), rng.uniform(-2, 2, n))
    return {"q": q, "qd": rng.uniform(-2, 2, n), "qdd": rng.uniform(-3, 3, n)}


def run(tape: Tape, **arguments: Array) -> dict[str, Array]:
    values = evaluate(tape, {i.name: list(arguments[i.name]) for i in tape.inputs})
    results = {}
    for output in tape.outputs:
        full = np.zeros((output.sparsity.rows, output.sparsity.cols))
        for place, value in zip(output.sparsity.entries, values[output.name], strict=True):
            full[place] = value
        results[output.name] = full[:, 0] if full.shape[1] == 1 else full
    return results


def driven() -> Tree:
    return drive(tree_of())


def near(expected: Array, factor: float = 1.0) -> dict[str, float]:
    return {"rtol": 0.0, "atol": factor * TOLERANCE * max(1.0, float(np.abs(expected).max()))}


@pytest.mark.parametrize("name", ["all", "none", "no shared frames", "lumps by parameters"])
def test_formulations_equal_pinocchio(name: str) -> None:
    reductions = replace(SWITCHED[name], trials=1)
    tree, peer = driven(), peer_of()
    at, n = state(1), len(tree.bodies)
    model, data = peer.model, peer.data
    upper = np.triu(pin.crba(model, data, at["q"]))
    M = upper + np.triu(upper, 1).T
    c, Phi = (np.array(pin.rnea(model, data, at["q"], at["qd"], a)) for a in (np.zeros(n), at["qdd"]))
    found = run(semi.build(tree, reductions), **at)
    np.testing.assert_allclose(found["M"], M, **near(M))
    np.testing.assert_allclose(found["c"], c, **near(c))
    for build in (impl.build, semi.build_residual):
        np.testing.assert_allclose(run(build(tree, reductions), u=np.zeros(n), **at)["Phi"], Phi, **near(Phi))
    for build in (exp1.build, exp2.build):
        np.testing.assert_allclose(run(build(tree, reductions), u=Phi, **at)["qdd"], at["qdd"], **near(at["qdd"], 100))
    held = run(condition.build(tree, reductions), **at)["elimination"]
    np.testing.assert_allclose(held, np.diag(M) * np.diag(np.linalg.inv(M)), rtol=1e-10)


def tangent(q: Array) -> Array:
    """The change of the coordinates for a unit of each velocity."""
    tape = rates.build(tree_of())
    n = len(tree_of().bodies)
    return np.array([run(tape, q=q, qd=e)["rate"] for e in np.eye(n)]).T


def test_rates_are_those_of_pinocchio() -> None:
    at, model = state(2), peer_of().model
    h = 1e-6
    ahead, behind = (pin.integrate(model, at["q"], sign * h * at["qd"]) for sign in (1, -1))
    np.testing.assert_allclose(run(rates.build(tree_of()), **at)["rate"], (ahead - behind) / (2 * h), atol=1e-9)


@pytest.mark.parametrize("seed", [3])
def test_derivatives_along_the_velocities_equal_pinocchio(seed: int) -> None:
    """By the raw components of q, times what these change by: Pinocchio's derivatives in the tangent space."""
    tree, peer, at = driven(), peer_of(), state(seed)
    n, T = len(tree.bodies), tangent(at["q"])
    dynamics = Dynamics(tree, ONE_PLAN)
    by_q, by_qd, by_qdd = (
        np.array(x) for x in pin.computeRNEADerivatives(peer.model, peer.data, at["q"], at["qd"], at["qdd"])
    )
    by_qdd = np.triu(by_qdd) + np.triu(by_qdd, 1).T
    jac = run(dynamics.differentiate(impl.build(tree, ONE_PLAN)).jac, u=np.zeros(n), **at)
    for found, expected in ((jac["jac_Phi_q"] @ T, by_q), (jac["jac_Phi_qd"], by_qd), (jac["jac_Phi_qdd"], by_qdd)):
        np.testing.assert_allclose(found, expected, **near(expected))
    Q = np.array(pin.rnea(peer.model, peer.data, at["q"], at["qd"], at["qdd"]))
    by_q, by_qd, _ = (np.array(x) for x in pin.computeABADerivatives(peer.model, peer.data, at["q"], at["qd"], Q))
    jac = run(dynamics.differentiate(exp2.build(tree, ONE_PLAN)).jac, u=Q, **at)
    for found, expected in ((jac["jac_qdd_q"] @ T, by_q), (jac["jac_qdd_qd"], by_qd)):
        np.testing.assert_allclose(found, expected, **near(expected, 100))


def test_the_length_of_a_quaternion_does_not_matter() -> None:
    """Nothing changes with it, so that no derivative has a part along it."""
    tree, at = driven(), state(5)
    longer = np.array(at["q"])
    places = [k for k, name in enumerate(tree.coordinates) if name.startswith("hand.q")]
    assert len(places) == 4
    longer[places] *= 1.7
    jac = Dynamics(tree, ONE_PLAN).differentiate(impl.build(tree, ONE_PLAN)).jac
    for tape, name in ((impl.build(tree, ONE_PLAN), "Phi"), (jac, "jac_Phi_qd")):
        one, other = (run(tape, u=np.zeros(len(tree.bodies)), **at | {"q": q})[name] for q in (at["q"], longer))
        np.testing.assert_allclose(one, other, **near(one))
    along = run(jac, u=np.zeros(len(tree.bodies)), **at)["jac_Phi_q"][:, places] @ at["q"][places]
    np.testing.assert_allclose(along, 0, atol=1e-11)


def test_sensors_and_energy_equal_pinocchio() -> None:
    tree, peer, at = tree_of(), peer_of(), state(6)
    model, data = peer.model, peer.data
    found = run(energy.build(tree), **at)
    assert found["kinetic"] == pytest.approx(pin.computeKineticEnergy(model, data, at["q"], at["qd"]), rel=1e-13)
    assert found["com"] == pytest.approx(pin.centerOfMass(model, data, at["q"]), abs=1e-13)
    pin.forwardKinematics(model, data, at["q"], at["qd"])
    motion, J = run(velocities.build_motion(tree), **at), run(velocities.build_jacobian(tree), **at)["J"]
    position = run(poses.build_sensors(tree), **at)["position"]
    joints = {i: joint for joint, bodies in peer.slots for i in bodies}
    for k, sensor in enumerate(tree.sensors):
        pose = data.oMi[joints[sensor.body]]
        place = floats(tree, sensor.position)
        np.testing.assert_allclose(position[:, k], pose.act(place), atol=1e-13)
        v = pin.getVelocity(model, data, joints[sensor.body], pin.LOCAL_WORLD_ALIGNED)
        moved = v.linear + np.cross(v.angular, pose.rotation @ place)
        np.testing.assert_allclose(motion["v"][:, k], moved, atol=1e-13)
        np.testing.assert_allclose(J[6 * k : 6 * k + 6] @ at["qd"], [*moved, *v.angular], atol=1e-12)
    step = differentiate(poses.build_sensors(tree), differentiable(poses.build_sensors(tree)))
    slope = run(step.jac, **at)["jac_position_q"] @ run(rates.build(tree), **at)["rate"]
    np.testing.assert_allclose(slope, motion["v"].T.ravel(), atol=1e-12)
