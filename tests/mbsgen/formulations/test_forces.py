"""Force laws of joints and external wrenches, in every formulation, textbook and reduced alike."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from sympy import Float, Integer, Rational, Symbol, exp

from mbsgen.derivatives.kernels import differentiate
from mbsgen.formulations import exp1, exp2, impl, ports, semi
from mbsgen.formulations.reductions import ALL, NONE, Reductions
from mbsgen.model.tree import COORDINATE, RATE, Kind, Parameter, Tree, Wrench
from mbsgen.tape.interpreter import DIGITS, evaluate
from mbsgen.tape.types import Tape
from tests.random_trees import Pinocchio, law_forces, random_tree, values_of, with_laws, with_wrenches
from tests.reference_models import pendulum

Array = NDArray[np.float64]
Build = Callable[[Tree, Reductions], Tape]
QUICK = replace(ALL, trials=12)
PARALLEL = replace(QUICK, regroup=False)  # frames shared, every body whole


def driven(seed: int, size: int, *, runtime: bool = False, tidy: bool = True) -> Tree:
    """A random tree with laws, and wrenches that leave 9 numbers open."""
    return with_wrenches(with_laws(random_tree(seed, size, runtime=runtime, tidy=tidy)), seed)


def state_of(tree: Tree, tape: Tape, seed: int) -> dict[str, Array]:
    rng = np.random.default_rng(seed + 70)
    given = {i.name: rng.uniform(-2, 2, i.sparsity.nnz) for i in tape.inputs}
    return given | ({ports.PARAMETERS.name: np.array(values_of(tree))} if ports.PARAMETERS.name in given else {})


def evaluated(tape: Tape, at: dict[str, Array]) -> dict[str, Array]:
    found = evaluate(tape, {name: list(at[name]) for name in (i.name for i in tape.inputs)})
    return {name: np.array(values, float) for name, values in found.items()}


def forces(tree: Tree, at: dict[str, Array]) -> Array:
    """Q: what is driven by u, and the laws."""
    Q = law_forces(tree, at["q"], at["qd"])
    Q[[i for i, b in enumerate(tree.bodies) if b.joint.actuated]] += at["u"]
    return Q


@pytest.mark.parametrize("reductions", [NONE, QUICK, PARALLEL], ids=["textbook", "reduced", "parallel"])
@pytest.mark.parametrize("build", [impl.build, semi.build_residual], ids=["impl", "semi_res"])
@pytest.mark.parametrize(
    ("seed", "size", "tidy"), [(0, 1, True), (1, 4, True), (2, 6, True), (3, 9, True), (4, 7, False)]
)
def test_residuals_equal_pinocchio(seed: int, size: int, tidy: bool, build: Build, reductions: Reductions):
    """Phi - Q against `rnea` with external forces, less u and laws."""
    tree = driven(seed, size, tidy=tidy, runtime=seed == 2)
    tape = build(tree, reductions)
    at = state_of(tree, tape, seed)
    assert len(at["w"]) == 9
    expected = Pinocchio(tree).residual(at["q"], at["qd"], at["qdd"], at["w"]) - forces(tree, at)
    assert np.abs(evaluated(tape, at)["Phi"] - expected).max() <= 1e-12 * np.abs(expected).max()


@pytest.mark.parametrize("reductions", [NONE, QUICK], ids=["textbook", "reduced"])
@pytest.mark.parametrize("seed", range(3))
def test_bias_holds_the_wrenches_and_not_the_laws(seed: int, reductions: Reductions):
    tree = driven(seed, 5)
    tape = semi.build(tree, reductions)
    at = state_of(tree, tape, seed)
    peer = Pinocchio(tree)
    expected = peer.residual(at["q"], at["qd"], 0 * at["q"], at["w"])
    found = evaluated(tape, at)
    assert np.abs(found["c"] - expected).max() <= 1e-12 * np.abs(expected).max()
    M = peer.mass_matrix(at["q"])
    assert np.abs(found["M"].reshape(M.shape) - M).max() <= 1e-12 * np.abs(M).max()


@pytest.mark.parametrize("reductions", [NONE, QUICK], ids=["plain", "reduced"])
@pytest.mark.parametrize("build", [exp1.build, exp2.build], ids=["exp1", "exp2"])
@pytest.mark.parametrize(("seed", "size"), [(0, 1), (1, 4), (2, 6), (3, 8)])
def test_accelerations_solve_the_equations_of_pinocchio(seed: int, size: int, build: Build, reductions: Reductions):
    """M qdd = Q - c, to rounding times the condition of M."""
    tree = driven(seed, size)
    tape = build(tree, reductions)
    at = state_of(tree, tape, seed)
    peer = Pinocchio(tree)
    M = peer.mass_matrix(at["q"])
    right = forces(tree, at) - peer.residual(at["q"], at["qd"], 0 * at["q"], at["w"])
    expected = np.linalg.solve(M, right)
    error = np.abs(evaluated(tape, at)["qdd"] - expected).max()
    assert error <= 200 * 2.0**-52 * np.linalg.cond(M) * np.abs(expected).max()


@pytest.mark.parametrize("build", [impl.build, exp2.build], ids=["impl", "exp2"])
def test_derivatives_know_laws_and_wrenches(build: Build):
    """Every block of the Jacobian, that by w included, against 50-digit differences."""
    tree = driven(5, 4)
    tape = build(tree, QUICK)
    wrt = [i.name for i in tape.inputs if i.port != ports.PARAMETERS]
    assert "w" in wrt
    jac = differentiate(tape, wrt).jac
    at = {name: [DIGITS.literal(x) for x in v] for name, v in state_of(tree, tape, 5).items()}
    found = evaluate(jac, at, DIGITS)
    (output,) = tape.outputs
    step = DIGITS.literal(1e-15)
    for name in wrt:
        block = jac.output(f"jac_{output.name}_{name}")
        assert block.sparsity.nnz
        J = dict(zip(block.sparsity.entries, found[block.name], strict=True))
        for k in range(len(at[name])):
            ends = []
            for sign in (1, -1):
                moved = {**at, name: [x + sign * step * (i == k) for i, x in enumerate(at[name])]}
                ends.append(evaluate(tape, moved, DIGITS)[output.name])
            for r, (a, b) in enumerate(zip(*ends, strict=True)):
                slope = (a - b) / (2 * step)
                assert abs(J.get((r, k), 0) - slope) <= 1e-20 * (1 + abs(slope))


@pytest.mark.parametrize("runtime", [False, True])
def test_a_pendulum_with_spring_and_damper(runtime: bool):
    """(I + m l2) qdd + m g l sin q + k (q - q0) + d qd."""
    k, d = Symbol("k"), Symbol("d")
    bare = pendulum()
    law = -k * (COORDINATE - Rational(3, 10)) - d * RATE
    joint = replace(bare.bodies[0].joint, law=law, actuated=False)
    kind = Kind.RUNTIME if runtime else Kind.CONSTANT
    parameters = tuple(Parameter(x.name, x, value, kind) for x, value in ((k, 4.0), (d, 0.7)))
    tree = replace(bare, bodies=(replace(bare.bodies[0], joint=joint),), parameters=parameters)
    q, qd, qdd = 0.7, 1.3, -0.4
    at = {"q": [q], "qd": [qd], "qdd": [qdd], "u": []} | ({"p": [4.0, 0.7]} if runtime else {})
    expected = (0.1 + 2 * 0.25) * qdd + 2 * 9.81 * 0.5 * math.sin(q) + 4 * (q - 0.3) + 0.7 * qd
    for reductions in (NONE, ALL):
        assert evaluate(impl.build(tree, reductions), at)["Phi"] == pytest.approx([expected], rel=1e-14)


def test_a_law_may_use_any_function():
    bare = pendulum()
    joint = replace(bare.bodies[0].joint, law=exp(-COORDINATE) * abs(RATE))
    tree = replace(bare, bodies=(replace(bare.bodies[0], joint=joint),))
    at = {"q": [0.2], "qd": [-1.5], "qdd": [0.0], "u": [0.0]}
    gravity = 2 * 9.81 * 0.5 * math.sin(0.2)
    assert evaluate(impl.build(tree), at)["Phi"] == pytest.approx([gravity - math.exp(-0.2) * 1.5], rel=1e-14)


def test_a_force_at_the_end_of_a_pendulum():
    """Pushed along the base's x at 1 m below a joint about y: the moment is -cos q, whatever leads there."""
    zero = Integer(0)
    push = Wrench("push", 1, (zero, zero, Float(-1.0)), True, (Float(3.0), zero, zero), (zero, zero, zero))
    tree = replace(pendulum(), wrenches=(push,))
    q = 0.4
    at = {"q": [q], "qd": [0.0], "qdd": [0.0], "u": [0.0]}
    expected = 2 * 9.81 * 0.5 * math.sin(q) + 3 * math.cos(q)
    for reductions in (NONE, ALL):
        tape = impl.build(tree, reductions)
        assert [i.name for i in tape.inputs] == ["q", "qd", "qdd", "u"]
        assert evaluate(tape, at)["Phi"] == pytest.approx([expected], rel=1e-14)
