"""Angles that add up on parallel axes, and large angles: written as one sine of the sum, or by addition theorems."""

from __future__ import annotations

import numpy as np
import pytest

from mbsgen.formulations.reductions import Reductions
from mbsgen.model.tree import Tree, Vector
from mbsgen.tape.builder import Builder
from tests.mbsgen.failures.mechanisms import (
    APART,
    FLOATS64,
    REDUCED,
    SIDES,
    Array,
    U,
    arm,
    compute,
    compute_exactly,
    draw_state,
    evaluate,
    tape_of,
)

WRITTEN = {"one sine of the sum": REDUCED, "addition theorems": APART}


def lost_of_sum(tree: Tree, reductions: Reductions, q: Array) -> float:
    """Find the error of the last joint's torque at rest: the cosine, or the sine, of the sum of the angles."""
    tape, zero = tape_of("impl", tree, reductions), np.zeros(len(tree.bodies))
    at = {"q": np.append(0.3, q), "qd": zero, "qdd": zero, "u": zero}
    return abs(float(compute(tape, at)["Phi"][-1] - compute_exactly(tape, at)["Phi"][-1]))


def draw_angles(parallel: int, size: float) -> list[Array]:
    """Draw angles, and angles of which the first two fold the arm."""
    rng = np.random.default_rng(parallel)
    open_ = [rng.uniform(-size, size, parallel) for _ in range(25)]
    return open_ + [np.array([x[0], 1e-6 - x[0], *x[2:]]) for x in open_]


@pytest.mark.parametrize("parallel", [2, 3])
@pytest.mark.parametrize("reductions", WRITTEN.values(), ids=WRITTEN)
@pytest.mark.parametrize("com", SIDES.values(), ids=SIDES)
def test_sums_of_angles(parallel: int, reductions: Reductions, com: Vector):
    """To 4 u (1 + |q2| + |q3| + ...) up to 1e12; within a turn, to 10 u with two angles and 20 u with three."""
    tree = arm(parallel, com)
    names = set(tape_of("impl", tree, reductions).labels.values())
    assert ({"S2p3", "C2p3"} <= names) == reductions.share_frames
    for size in (1e2, 1e4, 1e6, 1e8, 1e10, 1e12):
        for q in draw_angles(parallel, size):
            assert lost_of_sum(tree, reductions, q) <= 4 * U * (1 + np.abs(q).sum())
    for q in draw_angles(parallel, 2 * np.pi):
        assert lost_of_sum(tree, reductions, q) <= (10 if parallel == 2 else 20) * U


@pytest.mark.parametrize("reductions", WRITTEN.values(), ids=WRITTEN)
def test_huge_angles(reductions: Reductions):
    """M and c at q + 1e8: without sums of angles as right as at q, with them to what a sum has lost."""
    tree = arm(3, SIDES["cosine"])
    tape = tape_of("semi", tree, reductions)
    for seed in range(10):
        state = draw_state(4, seed)
        q = state["q"] = state["q"] + 2 * np.pi * np.round(1e8 / (2 * np.pi))
        found, exact = compute(tape, state), compute_exactly(tape, state)
        allowed = 4 * U * (1 + np.abs(q).sum()) if reductions.share_frames else 1e-13
        for name in ("M", "c"):
            assert np.abs(found[name] - exact[name]).max() <= allowed * np.abs(exact[name]).max()


def test_the_sine_of_a_huge_number():
    """The argument is reduced by all digits of pi (Ng, 1992)."""
    builder = Builder()
    (x,) = builder.vector("x", 1)
    builder.output_dense("y", [[builder.sin(x)]])
    assert evaluate(builder.build("f"), {"x": [np.float64(1e22)]}, FLOATS64)["y"] == [-0.8522008497671888]
