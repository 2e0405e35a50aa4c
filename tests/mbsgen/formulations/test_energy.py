"""Energy and momentum against Pinocchio, and against the equations of motion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from sympy import Expr, Integer, Symbol

from mbsgen.formulations import exp2, impl
from mbsgen.formulations.planning import dynamics_alone
from mbsgen.formulations.reductions import NONE
from mbsgen.formulations.results import energy
from mbsgen.model.tree import Kind, Parameter, Tree
from mbsgen.tape.interpreter import DIGITS, evaluate
from tests.random_trees import Pinocchio, random_tree, values_of, with_laws, with_wrenches
from tests.reference_models import pendulum

Array = NDArray[np.float64]


def state(seed: int, size: int) -> tuple[Array, Array]:
    rng = np.random.default_rng(seed + 90)
    return rng.uniform(-2, 2, size), rng.uniform(-2, 2, size)


def found(tree: Tree, q: Array, qd: Array) -> dict[str, Array]:
    p = {"p": values_of(tree)} if values_of(tree) else {}
    values = evaluate(energy.build(tree), {"q": list(q), "qd": list(qd)} | p)
    return {name: np.array(value, float) for name, value in values.items()}


@pytest.mark.parametrize(("seed", "size"), [(0, 1), (1, 3), (2, 6), (3, 12), (4, 20)])
def test_energy_and_momentum_equal_pinocchio(seed: int, size: int):
    """Pinocchio's moment of momentum is about the centre of mass; ours about the base's origin."""
    import pinocchio as pin

    tree = random_tree(seed, size, runtime=seed == 2, tidy=seed == 3)
    q, qd = state(seed, size)
    peer = Pinocchio(tree)
    model, data, theirs = peer.model, peer.data, (peer._theirs(q), peer._theirs(qd))
    ours = found(tree, q, qd)
    tolerance = 1e-13 * size
    assert ours["kinetic"][0] == pytest.approx(pin.computeKineticEnergy(model, data, *theirs), rel=tolerance)
    M = peer.mass_matrix(q)
    assert ours["kinetic"][0] == pytest.approx(qd @ M @ qd / 2, rel=tolerance)
    assert ours["potential"][0] == pytest.approx(pin.computePotentialEnergy(model, data, theirs[0]), rel=tolerance)
    com = pin.centerOfMass(model, data, theirs[0])
    momentum = pin.computeCentroidalMomentum(model, data, *theirs)
    assert ours["com"] == pytest.approx(com, rel=tolerance, abs=tolerance)
    scale = np.abs(momentum.vector).max()
    assert ours["momentum"] == pytest.approx(momentum.linear, abs=tolerance * scale)
    shifted = momentum.angular + np.cross(com, momentum.linear)
    assert ours["angular_momentum"] == pytest.approx(shifted, abs=tolerance * np.abs(shifted).max())


@pytest.mark.parametrize("seed", range(3))
def test_the_power_of_all_forces_is_the_change_of_energy(seed: int):
    """d (T + V) / dt = qd . Q, with laws in Q; wrenches enter by their effect on c. In 50 digits.

    The kernel `power` computes the same.
    """
    tree = with_laws(random_tree(seed, 5))
    pulled = with_wrenches(tree, seed)
    q, qd = ([DIGITS.literal(x) for x in v] for v in state(seed, 5))
    u = [DIGITS.literal(0.3 * k) for k in range(sum(b.joint.actuated for b in tree.bodies))]
    w = [DIGITS.literal(0.5 - 0.2 * k) for k in range(9)]
    tape = energy.build(tree)
    for one, arguments in ((tree, {"u": u}), (pulled, {"u": u, "w": w})):
        qdd = evaluate(exp2.build(one, NONE), {"q": q, "qd": qd} | arguments, DIGITS)["qdd"]
        ends = []
        step = DIGITS.literal(1e-15)
        for h in (step, -step):
            moved = {
                "q": [a + h * b + h * h / 2 * c for a, b, c in zip(q, qd, qdd, strict=True)],
                "qd": [b + h * c for b, c in zip(qd, qdd, strict=True)],
            }
            values = evaluate(tape, moved, DIGITS)
            ends.append(values["kinetic"][0] + values["potential"][0])
        change = (ends[0] - ends[1]) / (2 * step)
        rest = evaluate_power(one, q, qd, arguments)
        assert abs(change - rest) <= 1e-13 * (1 + abs(rest))  # the tree's rotations are rounded to doubles
        power = evaluate(energy.build_power(one), {"q": q, "qd": qd} | arguments, DIGITS)["power"][0]
        assert abs(power - rest) <= 1e-13 * (1 + abs(rest))


def evaluate_power(tree: Tree, q: list, qd: list, arguments: dict[str, list]) -> object:
    """qd . (Q - what wrenches take): what the residual gains when all forces are taken away."""
    at = {"q": q, "qd": qd, "qdd": [DIGITS.literal(0)] * len(q)}
    free = evaluate(impl.build(dynamics_alone(tree, driven=False), NONE), at | {"u": []}, DIGITS)["Phi"]
    held = evaluate(impl.build(tree, NONE), at | arguments, DIGITS)["Phi"]
    return sum(rate * (a - b) for rate, a, b in zip(qd, free, held, strict=True))


def test_a_pendulum_by_hand():
    """T = (I + m l2) qd2 / 2, V = -m g l cos q; a body of 2 kg at 0.5 m below a joint about y."""
    q, qd = 0.6, 1.7
    values = found(pendulum(), np.array([q]), np.array([qd]))
    s, c = np.sin(q), np.cos(q)
    assert values["kinetic"] == pytest.approx([(0.1 + 0.5) * qd**2 / 2], rel=1e-15)
    assert values["potential"] == pytest.approx([-2 * 9.81 * 0.5 * c], rel=1e-15)
    assert values["com"] == pytest.approx([-0.5 * s, 0, -0.5 * c], rel=1e-15)
    assert values["momentum"] == pytest.approx([-c * qd, 0, s * qd], rel=1e-15)
    assert values["angular_momentum"] == pytest.approx([0, 0.6 * qd, 0], rel=1e-15)


@pytest.mark.parametrize("mass", [Integer(0), Symbol("m"), 2 * Symbol("m")])
def test_bodies_without_mass_have_no_centre(mass: Expr):
    """The one of a mass that is 0 in the file alone would be 0/0 there."""
    bare = pendulum()
    m = Parameter("m", Symbol("m"), 0.0, Kind.RUNTIME)
    tree = replace(bare, bodies=(replace(bare.bodies[0], mass=mass),), parameters=(*bare.parameters, m))
    assert [o.name for o in energy.build(tree).outputs] == ["kinetic", "potential", "momentum", "angular_momentum"]
