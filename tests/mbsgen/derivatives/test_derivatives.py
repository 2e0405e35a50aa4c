"""Derivatives of tapes against Pinocchio's analytic ones, 50-digit differences, Taylor slopes and symmetry."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from mbsgen.derivatives.kernels import differentiate
from mbsgen.formulations import impl
from mbsgen.tape import forward, reverse
from mbsgen.tape.builder import Builder
from mbsgen.tape.interpreter import DIGITS, FLOATS, Numbers, evaluate
from mbsgen.tape.types import Sparsity, Tape
from tests.mbsgen.derivatives.evaluation import arguments, differences, matrix
from tests.random_trees import Pinocchio, random_tree

STATE = ("q", "qd", "qdd", "u")


def every_operation() -> Tape:
    """Use each operation of the tape, with shared and repeated operands."""
    b = Builder()
    x, y = b.vector("x", 3), b.vector("y", 2)
    root = b.sqrt(x[0] * x[0] + y[1] * y[1] + b.number(2.0))
    ratio = (x[1] - y[0]) / root
    f = [b.sin(ratio) * b.cos(x[2]) - root, -(ratio * ratio), x[1] + x[1] * y[0] * y[0], b.number(3.0)]
    b.output("f", Sparsity.dense(4), f)
    b.output("g", Sparsity.of(2, 2, [(0, 0), (1, 1)]), [b.sin(x[0] * y[0]), y[1]])
    return b.build("every")


@pytest.mark.parametrize("direction", [forward.jacobian, reverse.jacobian])
def test_both_directions_give_the_jacobian_of_every_operation(direction):
    tape = every_operation()
    at = arguments(tape, 0)
    jac = direction(tape, ("x", "y"))
    values = evaluate(jac, at)
    for output in ("f", "g"):
        for source in ("x", "y"):
            found = matrix(jac, f"jac_{output}_{source}", values)
            assert np.abs(found - differences(tape, at, output, source)).max() < 1e-14


def test_entries_that_are_zero_by_structure_are_not_stored():
    jac = forward.jacobian(every_operation(), ("x", "y"))
    assert (2, 0) not in jac.output("jac_f_x").sparsity.entries
    assert all(r != 3 for r, _ in jac.output("jac_f_x").sparsity.entries)


def test_adjoint_is_the_transposed_jacobian_applied():
    tape = every_operation()
    adj1, jac = reverse.adjoint(tape, ("x", "y")), forward.jacobian(tape, ("x", "y"))
    at = arguments(adj1, 1)
    J, lam = evaluate(jac, {k: at[k] for k in ("x", "y")}), at["adj_f"]
    g = np.zeros(4)
    g[[0, 3]] = at["adj_g"]
    for source in ("x", "y"):
        expected = matrix(jac, f"jac_f_{source}", J).T @ lam + matrix(jac, f"jac_g_{source}", J).T @ g
        assert evaluate(adj1, at)[f"adj_{source}"] == pytest.approx(expected, abs=1e-14)


@pytest.mark.parametrize("make", [every_operation, lambda: impl.build(random_tree(5, 4))], ids=["every", "impl"])
def test_jacobian_of_the_adjoint(make):
    """Every block against 50-digit differences of the adjoint; Hessian blocks are each other's transposes."""
    tape = make()
    wrt = [i.name for i in tape.inputs]
    made = differentiate(tape, wrt)
    at = arguments(made.adj1, 2)
    values = evaluate(made.jac_adj1, at)
    for row in wrt:
        for col in [*wrt, *(f"adj_{o.name}" for o in tape.outputs)]:
            found = matrix(made.jac_adj1, f"jac_adj_{row}_{col}", values)
            expected = differences(made.adj1, at, f"adj_{row}", col)
            assert np.abs(found - expected).max() <= 1e-13 * max(1.0, np.abs(expected).max())
            if col in wrt:
                assert np.array_equal(found, matrix(made.jac_adj1, f"jac_adj_{col}_{row}", values).T)


@pytest.mark.parametrize("seed", range(5))
def test_jacobian_equals_pinocchio(seed: int):
    n = (3, 6, 9, 12, 5)[seed]
    tree = random_tree(seed, n, tidy=seed == 4)
    jac = differentiate(impl.build(tree), STATE).jac
    at = arguments(jac, seed)
    values = evaluate(jac, at)
    q, qd, qdd = (np.array(at[x]) for x in ("q", "qd", "qdd"))
    peer = Pinocchio(tree)
    dq, dqd = peer.residual_derivatives(q, qd, qdd)
    for source, expected in (("q", dq), ("qd", dqd), ("qdd", peer.mass_matrix(q))):
        found = matrix(jac, f"jac_Phi_{source}", values)
        assert np.abs(found - expected).max() <= 1e-12 * np.abs(expected).max()


def test_taylor_remainder_is_quadratic():
    """|f(x + h v) - f(x) - h J v| falls as h2, where it stands out of the rounding (slope in 1.95 to 2.05)."""
    tree = random_tree(7, 6)
    tape = impl.build(tree)
    jac = differentiate(tape, STATE).jac
    at, along = arguments(tape, 3), arguments(tape, 4)
    values = evaluate(jac, at)
    slope = sum(matrix(jac, f"jac_Phi_{x}", values) @ np.array(along[x]) for x in STATE)

    def f(h: float) -> np.ndarray:
        moved = {x: list(np.array(at[x]) + h * np.array(along[x])) for x in STATE}
        return np.array(evaluate(tape, moved)["Phi"], float)

    steps = 3.0 * 10.0 ** -np.arange(2, 8)
    rests = np.array([np.abs(f(h) - f(0) - h * slope).max() for h in steps])
    kept = rests > 1e3 * 2.0**-53 * np.abs(f(0)).max()
    assert kept.sum() >= 4
    fitted = np.polyfit(np.log(steps[kept]), np.log(rests[kept]), 1)[0]
    assert 1.95 <= fitted <= 2.05


def test_pattern_is_the_structural_one():
    """No entry of the arm-like tree's Jacobian is zero at twenty random points together."""
    jac = differentiate(impl.build(random_tree(5, 6)), STATE).jac
    seen: dict[str, np.ndarray] = {}
    for seed in range(20):
        for name, found in evaluate(jac, arguments(jac, seed)).items():
            seen[name] = np.maximum(seen.get(name, 0), np.abs(np.array(found, float)))
    assert all((peak > 0).all() for peak in seen.values())


def evaluated(tape: Tape, at: dict[str, list[float]], numbers: Numbers) -> Sequence[float]:
    return [
        float(v)
        for values in evaluate(tape, {k: list(map(numbers.literal, v)) for k, v in at.items()}, numbers).values()
        for v in values
    ]


def test_derivatives_lose_no_digits():
    """Jacobian in float64 against the same tape in 50 digits."""
    jac = differentiate(impl.build(random_tree(1, 8)), STATE).jac
    at = arguments(jac, 9)
    rough, exact = (np.array(evaluated(jac, at, numbers)) for numbers in (FLOATS, DIGITS))
    assert np.abs(rough - exact).max() <= 300 * 2.0**-53 * np.abs(exact).max()
