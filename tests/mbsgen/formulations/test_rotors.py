"""Rotors: the armature of a joint adds to the diagonal of M, whatever way the equations are written."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from sympy import Float, Integer, Rational

from mbsgen.derivatives.dynamics import Dynamics
from mbsgen.derivatives.kernels import Derivatives, differentiable
from mbsgen.formulations import condition, exp1, exp2, impl
from mbsgen.formulations.reductions import ALL, NONE, Reductions
from mbsgen.formulations.results import energy
from mbsgen.model.tree import Motion, Tree
from mbsgen.tape.interpreter import DIGITS, evaluate, find_failure
from tests.mbsgen.derivatives.evaluation import EXACTLY, TO_ROUNDING, all_of, assert_same
from tests.mbsgen.formulations.agreement import SWITCHED, assert_equals_pinocchio, run, state
from tests.random_trees import Pinocchio, driven, floating, random_tree, with_rotors
from tests.reference_models import pendulum


@cache
def tree_of(seed: int, size: int, *, runtime: bool = False) -> Tree:
    return with_rotors(driven(random_tree(seed, size, runtime=runtime, tidy=seed % 2 == 0)), seed)


@cache
def planar(size: int = 5) -> Tree:
    """A chain with parallel axes: one group, in absolute angles except for the joints with rotors."""
    tree = random_tree(8, size, tidy=True)
    joints = [replace(b.joint, motion=Motion.REVOLUTE, axis=1, actuated=True) for b in tree.bodies]
    bodies = [replace(b, joint=j, parent=i) for i, (b, j) in enumerate(zip(tree.bodies, joints, strict=True))]
    return with_rotors(replace(tree, bodies=tuple(bodies)), 8)


@pytest.mark.parametrize("reductions", SWITCHED.values(), ids=SWITCHED)
def test_every_reduction_holds_with_rotors(reductions: Reductions) -> None:
    """Phi, M, c and qdd against Pinocchio, whose joints have the same armature."""
    reductions = replace(reductions, trials=1)
    for tree, seed in ((tree_of(4, 6), 4), (planar(), 8), (tree_of(3, 3, runtime=True), 3)):
        assert_equals_pinocchio(tree, seed, reductions)


@pytest.mark.parametrize("tree", [planar(3), tree_of(5, 2, runtime=True)], ids=["plane", "p"])
def test_every_way_to_differentiate_agrees(tree: Tree) -> None:
    """In 50 digits: what the recursions and the implicit function theorem give, and the tape's own differentiation."""
    tolerance = TO_ROUNDING if tree.parameters else EXACTLY
    dynamics = Dynamics(tree, replace(ALL, trials=1))
    for build in (impl.build, exp1.build, exp2.build):
        tape = build(tree, NONE)
        plain = Derivatives(tape, differentiable(tape))
        for found, expected in zip(all_of(dynamics.differentiate(build(tree))), all_of(plain), strict=True):
            assert_same(found, expected, tolerance)


def test_accelerations_have_pinocchios_derivatives() -> None:
    tree, reductions = tree_of(4, 6), replace(ALL, trials=1)
    peer, (q, qd, _, u) = Pinocchio(tree), state(4, 6)
    jac = Dynamics(tree, reductions).differentiate(exp2.build(tree, reductions)).jac
    found = evaluate(jac, {"q": list(q), "qd": list(qd), "u": list(u)})
    by_q, by_qd, by_u = peer.acceleration_derivatives(q, qd, u)
    for name, expected in (("q", by_q), ("qd", by_qd), ("u", by_u)):
        output = jac.output(f"jac_qdd_{name}")
        full = np.zeros((6, 6))
        for place, value in zip(output.sparsity.entries, found[output.name], strict=True):
            full[place] = value
        np.testing.assert_allclose(full, expected, rtol=0, atol=1e-11 * np.abs(expected).max())


def test_a_rotor_on_a_pendulum_by_hand() -> None:
    """(I + m l2 + rotor) qdd + m g l sin q = u, and the rotor's spin has energy, but no momentum."""
    bare, q, qd, u = pendulum(), 0.6, 1.7, 0.4
    (rod,) = bare.bodies
    tree = replace(bare, bodies=(replace(rod, joint=replace(rod.joint, armature=Rational(3, 4))),))
    expected = (u - 2 * 9.81 * 0.5 * np.sin(q)) / (0.6 + 0.75)
    for build in (exp1.build, exp2.build):
        found = run(build(tree), tree, q=np.array([q]), qd=np.array([qd]), u=np.array([u]))
        assert found["qdd"] == pytest.approx([expected], rel=1e-14)
    values = run(energy.build(tree), tree, q=np.array([q]), qd=np.array([qd]))
    assert values["kinetic"] == pytest.approx([(0.6 + 0.75) * qd**2 / 2], rel=1e-15)
    assert values["angular_momentum"] == pytest.approx([0, 0.6 * qd, 0], rel=1e-15)


@pytest.mark.parametrize("seed", [3, 4])
def test_kinetic_energy_is_that_of_the_mass_matrix(seed: int) -> None:
    tree = tree_of(seed, 6)
    q, qd, *_ = state(seed, 6)
    M = Pinocchio(tree).mass_matrix(q)
    assert run(energy.build(tree), tree, q=q, qd=qd)["kinetic"] == pytest.approx([qd @ M @ qd / 2], rel=1e-13)


@pytest.mark.parametrize("reductions", [ALL, NONE], ids=["reduced", "plain"])
def test_what_a_joint_gives_way_is_the_inverse_of_the_mass_matrix(reductions: Reductions) -> None:
    """M_ii (M^-1)_ii, which `condition` finds by articulated bodies."""
    for tree in (tree_of(4, 6), planar()):
        n = len(tree.bodies)
        q, *_ = state(4, n)
        M = Pinocchio(tree).mass_matrix(q)
        found = run(condition.build(tree, reductions), tree, q=q)["elimination"]
        np.testing.assert_allclose(found, np.diag(M) * np.diag(np.linalg.inv(M)), rtol=1e-11)


def test_a_rotor_unlocks_what_would_fail() -> None:
    """Three turns whose second stands at a quarter turn: without rotors M is singular, with them it is not."""
    bare = floating(driven(random_tree(6, 1)))
    still = [0.0] * len(bare.bodies)
    at = {"q": [0.0, 0.0, 0.0, 0.3, np.pi / 2, 0.4, 0.5], "qd": still, "u": still}
    bodies = [replace(b, joint=replace(b.joint, armature=Rational(1, 50))) for b in bare.bodies]
    tree = replace(bare, bodies=tuple(bodies))
    for build in (exp1.build, exp2.build):
        with np.errstate(divide="ignore", invalid="ignore"):  # beyond the pivot that fails
            assert find_failure(build(bare, NONE), at) > 0
        assert find_failure(build(tree, NONE), at) == 0


def test_a_joint_may_move_nothing_but_its_rotor() -> None:
    """The last body has no mass: its joint is on its own, qdd = u / armature."""
    tree = tree_of(3, 3)
    nothing = (Integer(0),) * 3
    leaf = replace(tree.bodies[2], mass=Integer(0), com=nothing, inertia=(nothing,) * 3)
    tree = replace(tree, bodies=(*tree.bodies[:2], leaf))
    q, qd, _, u = state(3, 3)
    armature = float(leaf.joint.armature)
    assert armature > 0
    for build in (exp1.build, exp2.build):
        for reductions in (ALL, NONE):
            qdd = run(build(tree, reductions), tree, q=q, qd=qd, u=u)["qdd"]
            assert qdd[2] == pytest.approx(u[2] / armature, rel=1e-13)


def test_large_rotors_cost_no_digits() -> None:
    """Rotors of 1e6 times what links have: as accurate as small ones, since none is subtracted from another."""
    tree = planar()
    joints = [replace(b.joint, armature=Float(10.0 ** (6 - 2 * (i % 2)))) for i, b in enumerate(tree.bodies)]
    tree = replace(tree, bodies=tuple(replace(b, joint=j) for b, j in zip(tree.bodies, joints, strict=True)))
    q, qd, _, u = state(8, 5)
    for build in (exp1.build, exp2.build):
        tape = build(tree, replace(ALL, trials=1))
        given = {i.name: list({"q": q, "qd": qd, "u": u}[i.name]) for i in tape.inputs}
        exact = evaluate(tape, {name: [DIGITS.literal(x) for x in v] for name, v in given.items()}, DIGITS)["qdd"]
        found = evaluate(tape, given)["qdd"]
        assert all(abs(a / float(b) - 1) < 2e-13 for a, b in zip(found, exact, strict=True))
