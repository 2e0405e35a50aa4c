"""IMPL against Pinocchio on random trees, against closed forms, and against the laws it must obey."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mbsgen.formulations import impl
from mbsgen.model.tree import Motion, Tree
from mbsgen.tape.interpreter import DIGITS, evaluate
from tests.random_trees import Pinocchio, random_tree, values_of
from tests.reference_models import pendulum

EPS = 2.0**-52


def phi(tree: Tree, q, qd, qdd, numbers=None) -> np.ndarray:
    """Evaluate Phi with Q = 0."""
    u = [0.0] * sum(b.joint.actuated for b in tree.bodies)
    arguments = {"q": list(q), "qd": list(qd), "qdd": list(qdd), "u": u}
    if values := values_of(tree):
        arguments["p"] = values
    tape = impl.build(tree)
    found = evaluate(tape, arguments, numbers) if numbers else evaluate(tape, arguments)
    return np.array(found["Phi"], dtype=object if numbers else float)


def state(seed: int, n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed + 1000)
    return rng.uniform(-3, 3, n), rng.uniform(-2, 2, n), rng.uniform(-3, 3, n)


@pytest.mark.parametrize("runtime", [False, True], ids=["constant", "runtime"])
@pytest.mark.parametrize("seed", range(12))
def test_residual_equals_pinocchio(seed: int, runtime: bool):
    """Phi against `rnea`, for trees of up to 30 joints, relative to the largest entry."""
    n = (1, 2, 3, 5, 8, 12, 16, 20, 24, 30, 7, 4)[seed]
    tree = random_tree(seed, n, runtime=runtime, tidy=seed % 3 == 0)
    q, qd, qdd = state(seed, n)
    expected = Pinocchio(tree).residual(q, qd, qdd)
    assert np.abs(phi(tree, q, qd, qdd) - expected).max() <= 1e-12 * np.abs(expected).max()


@pytest.mark.parametrize("seed", range(3))
def test_rounding_errors_are_of_the_size_of_rounding(seed: int):
    """float64 against 50 digits on the same tape: n roundings at most of the largest term."""
    tree = random_tree(seed, 6)
    q, qd, qdd = state(seed, 6)
    exact = phi(tree, *(map(DIGITS.literal, x) for x in (q, qd, qdd)), numbers=DIGITS)
    error = np.abs(phi(tree, q, qd, qdd) - exact.astype(float)).max()
    assert error <= 200 * EPS * float(abs(exact).max())


@pytest.mark.parametrize("seed", range(4))
def test_power_balance(seed: int):
    """qd . Phi = d/dt (kinetic + potential energy): here M qdd.qd + M' terms against a difference along the motion."""
    n = 5
    tree = random_tree(seed, n)
    q, qd, qdd = state(seed, n)

    def energy(q, qd) -> float:
        M = np.column_stack([phi(tree, q, 0 * q, e) - phi(tree, q, 0 * q, 0 * q) for e in np.eye(n)])
        return 0.5 * qd @ M @ qd

    h = 1e-5
    moved = [energy(q + s * qd * h + qdd * h * h / 2, qd + s * qdd * h) for s in (1, -1)]
    kinetic = (moved[0] - moved[1]) / (2 * h)
    gravity = phi(tree, q, 0 * q, 0 * q) @ qd
    power = qd @ phi(tree, q, qd, qdd)
    assert power == pytest.approx(kinetic + gravity, rel=1e-7)


def test_pendulum_closed_form():
    """(I + m l2) qdd + m g l sin q."""
    q, qd, qdd = 0.7, 1.3, -0.4
    expected = (0.1 + 2 * 0.25) * qdd + 2 * 9.81 * 0.5 * math.sin(q)
    assert phi(pendulum(), [q], [qd], [qdd])[0] == pytest.approx(expected, rel=1e-15)


def test_slider_closed_form():
    """m qdd, along a horizontal axis."""
    assert phi(pendulum(0, Motion.PRISMATIC), [0.3], [1.0], [2.5]) == pytest.approx([5.0])


def test_motions_that_gravity_cannot_feel_vanish():
    """A joint about the vertical, carried by the base, needs no sine or cosine."""
    assert not any(op.name in ("SIN", "COS") for op, _, _ in impl.build(pendulum(axis=2)).operations)


def test_actuated_joints_take_their_force_from_u_in_joint_order():
    tree = random_tree(3, 5)
    zeros = [0.0] * 5
    actuated = [i for i, b in enumerate(tree.bodies) if b.joint.actuated]
    assert 0 < len(actuated) < 5
    u = [10.0 + k for k in range(len(actuated))]
    found = evaluate(impl.build(tree), {"q": zeros, "qd": zeros, "qdd": zeros, "u": u})["Phi"]
    expected = phi(tree, zeros, zeros, zeros)
    expected[actuated] -= u
    assert found == pytest.approx(expected)
