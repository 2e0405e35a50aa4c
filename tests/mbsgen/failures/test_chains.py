"""Long chains and extreme ratios of mass: what float64 loses against 50 digits, where the condition says how much."""

from __future__ import annotations

import numpy as np
import pytest
from sympy import Expr

from mbsgen.model.tree import Tree
from tests.mbsgen.failures.mechanisms import (
    EXPLICIT,
    HARMLESS,
    REDUCED,
    REDUCTIONS,
    RESIDUALS,
    Array,
    U,
    compute,
    compute_exactly,
    draw_state,
    error_of,
    mass_matrix,
    relative_error,
    scale_of,
    scaled_condition,
    spatial_chain,
    status,
    straight_chain,
    tape_of,
)


def straight_state(size: int) -> dict[str, Array]:
    return draw_state(size, size, q=np.zeros(size))


def assert_residuals_vanish(tree: Tree, state: dict[str, Array]) -> None:
    """|Phi(qdd*)| <= 10 u (|M| |qdd*| + |c| + |u|), at accelerations that are right to the last digit."""
    exact = compute_exactly(tape_of("exp2", tree), state)["qdd"]
    scale = scale_of(tree, state, exact).max()
    for name in RESIDUALS:
        assert np.abs(compute(tape_of(name, tree), {**state, "qdd": exact})["Phi"]).max() <= 10 * U * scale


def backward_error(tree: Tree, state: dict[str, Array], qdd: Array) -> float:
    """Compare the residual of the equations of motion with the absolute values of their terms."""
    rest = compute_exactly(tape_of("impl", tree), {**state, "qdd": qdd})["Phi"]
    return float(np.abs(rest).max() / scale_of(tree, state, qdd).max())


@pytest.mark.parametrize("size", [2, 5, 10, 20, 50])
def test_a_long_straight_chain(size: int):
    tree, state = straight_chain(size), straight_state(size)
    M, _ = mass_matrix(tree, state)
    assert error_of("exp2", tree, state) <= 1e-12
    assert error_of("exp1", tree, state) <= 10 * U * np.linalg.cond(M)
    assert [status(tape_of(name, tree), state) for name in EXPLICIT] == [0, 0]
    assert_residuals_vanish(tree, state)


@pytest.mark.parametrize("size", [100, 200])
def test_a_longer_straight_chain(size: int):
    """By EXP2 and IMPL alone. No entry of M is negative, so |M| |qdd| is M |qdd|: a residual."""
    tree, state = straight_chain(size), straight_state(size)
    tape, residual = tape_of("exp2", tree), tape_of("impl", tree)
    exact = compute_exactly(tape, state)["qdd"]
    assert relative_error(compute(tape, state)["qdd"], exact) <= 1e-12
    assert status(tape, state) == 0
    rest = compute(residual, {**state, "qdd": exact})["Phi"]
    bias = compute(residual, {**state, "qdd": 0 * exact, "u": 0 * exact})["Phi"]
    still = {**state, "qd": 0 * exact, "u": 0 * exact}
    ends = [compute(residual, {**still, "qdd": x})["Phi"] for x in (np.abs(exact), 0 * exact)]
    scale = ends[0] - ends[1] + np.abs(bias) + np.abs(state["u"])
    assert np.abs(rest).max() <= 10 * U * scale.max()


@pytest.mark.parametrize("size", [10, 20, 50])
def test_a_spatial_chain(size: int):
    tree, state = spatial_chain(size), draw_state(size, size)
    condition = np.linalg.cond(mass_matrix(tree, state)[0])
    assert error_of("exp2", tree, state) <= 100 * U * np.sqrt(condition)
    assert error_of("exp1", tree, state) <= 10 * U * condition
    assert [status(tape_of(name, tree), state) for name in EXPLICIT] == [0, 0]
    assert_residuals_vanish(tree, state)


@pytest.mark.parametrize("reductions", REDUCTIONS.values(), ids=REDUCTIONS)
@pytest.mark.parametrize("ratio", [10**4, 10**8, 10**12])
def test_a_heavy_tip(ratio: int, reductions):
    """The problem itself is ill conditioned: the error may be as large as that says, and what solves it is near."""
    tree = spatial_chain(10, [1] * 9 + [ratio])
    state = draw_state(10, 10)
    condition = scaled_condition(tree, state)
    for name in EXPLICIT:
        found = compute(tape_of(name, tree, reductions), state)["qdd"]
        assert backward_error(tree, state, found) <= 1e-14
        assert error_of(name, tree, state, reductions) <= 10 * U * condition
    for name in RESIDUALS:
        tape = tape_of(name, tree, reductions)
        lost = np.abs(compute(tape, state)["Phi"] - compute_exactly(tape, state)["Phi"])
        assert lost.max() <= 10 * U * scale_of(tree, state, state["qdd"]).max()


@pytest.mark.parametrize("ratio", [10**4, 10**6, 10**8, 10**10, 10**12])
def test_elimination_fails_at_a_heavy_tip_where_digits_are_gone(ratio: int):
    """A status comes at n u 1000 of an entry of M and no earlier: up to 1e8 five digits are left, and given out.

    Just above, one rounding loses 2.5 u / (n u 1000) = 2.5e-4 of an acceleration, and all lose some ten times as much.
    """
    tree = spatial_chain(10, [1] * 9 + [ratio])
    tape = tape_of("exp1", tree)
    for seed in range(10, 14):
        state = draw_state(10, seed)
        failed, error = status(tape, state) != 0, error_of("exp1", tree, state)
        assert failed or error <= 5e-3
        assert not failed or error >= 1e-6
        assert not failed or ratio > 10**8


@pytest.mark.parametrize("reductions", REDUCTIONS.values(), ids=REDUCTIONS)
@pytest.mark.parametrize("factors", HARMLESS.values(), ids=HARMLESS)
def test_a_ratio_that_only_scales_does_no_harm(factors: list[Expr | int], reductions):
    """Forces are such that all accelerations are of order 1; M is ill conditioned, but not when it is scaled."""
    tree, state = spatial_chain(10, factors), draw_state(10, 3)
    state["u"] = compute(tape_of("impl", tree, REDUCED), {**state, "u": np.zeros(10)})["Phi"]
    assert scaled_condition(tree, state) <= 1e5
    for name in EXPLICIT:
        assert status(tape_of(name, tree, reductions), state) == 0
        assert error_of(name, tree, state, reductions) <= 1e-11
    for name in RESIDUALS:
        tape = tape_of(name, tree, reductions)
        lost = np.abs(compute(tape, state)["Phi"] - compute_exactly(tape, state)["Phi"])
        assert lost.max() <= 1e-11 * scale_of(tree, state, state["qdd"]).max()
