"""Second derivatives agree with another program: differences of Pinocchio's analytic first derivatives.

With weights lam, the first derivatives of lam^T f are differentiated once more, centrally, with two steps (Richardson):

    D = (4 D(h/2) - D(h)) / 3,  D(h) = (g(x + h) - g(x - h)) / 2h,  off by some h^4 g^(5) / 480 and some eps |g| / h.

g is lam^T dPhi/dx of computeRNEADerivatives for IMPL, and lam^T dqdd/dx of computeABADerivatives for EXP1 and EXP2.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache
from types import ModuleType

import numpy as np
import pytest
from numpy.typing import NDArray

from mbsgen.derivatives.dynamics import Dynamics
from mbsgen.formulations import exp1, exp2, impl
from mbsgen.formulations.reductions import ALL
from mbsgen.model.tree import Tree
from mbsgen.tape.interpreter import evaluate
from tests.mbsgen.derivatives.evaluation import arguments, matrix
from tests.random_trees import Pinocchio, random_tree, with_rotors

Array = NDArray[np.float64]
Point = Mapping[str, Array]
Gradient = Callable[[Point], dict[str, Array]]
STEP = 4e-3
# Differences are off by some 1e-12 of the largest entry here; M has a condition of some tens.
CLOSE = 1e-10


@cache
def tree_of(seed: int) -> Tree:
    """Draw a tree of four bodies; every second one has rotors and axes that stand straight."""
    tree = random_tree(seed, 4, tidy=seed % 2 == 0)
    return with_rotors(tree, seed) if seed % 2 == 0 else tree


def differentiate(gradient: Gradient, at: Point, source: str) -> dict[str, Array]:
    """Differentiate each vector of a gradient by an input: (entries, inputs)."""

    def slope(k: int, step: float) -> dict[str, Array]:
        ends = []
        for sign in (1, -1):
            moved = at[source].copy()
            moved[k] += sign * step
            ends.append(gradient({**at, source: moved}))
        return {name: (ends[0][name] - ends[1][name]) / (2 * step) for name in ends[0]}

    columns = []
    for k in range(len(at[source])):
        coarse, fine = slope(k, STEP), slope(k, STEP / 2)
        columns.append({name: (4 * fine[name] - coarse[name]) / 3 for name in fine})
    return {name: np.column_stack([column[name] for column in columns]) for name in columns[0]}


@pytest.mark.parametrize("seed", [1, 2, 3, 4])
def test_of_the_residual(seed: int) -> None:
    """lam^T Phi by q, qd and qdd, twice; by qdd alone it is lam^T M."""
    tree = tree_of(seed)
    peer, tape = Pinocchio(tree), Dynamics(tree, ALL).differentiate(impl.build(tree)).jac_adj1
    given = arguments(tape, seed)
    at, lam = {name: np.array(given[name]) for name in ("q", "qd", "qdd")}, np.array(given["adj_Phi"])

    def gradient(x: Point) -> dict[str, Array]:
        by_q, by_qd = peer.residual_derivatives(x["q"], x["qd"], x["qdd"])
        return {"q": lam @ by_q, "qd": lam @ by_qd, "qdd": lam @ peer.mass_matrix(x["q"])}

    found = evaluate(tape, given)
    for column in at:
        for row, expected in differentiate(gradient, at, column).items():
            error = np.abs(matrix(tape, f"jac_adj_{row}_{column}", found) - expected).max()
            assert error <= CLOSE * max(1.0, np.abs(expected).max()), f"{row} {column}"


@pytest.mark.parametrize("formulation", [exp1, exp2], ids=["exp1", "exp2"])
@pytest.mark.parametrize("seed", [1, 2, 3, 4])
def test_of_the_accelerations(seed: int, formulation: ModuleType) -> None:
    """lam^T qdd by q, qd and the inputs, twice."""
    tree = tree_of(seed)
    peer, tape = Pinocchio(tree), Dynamics(tree, ALL).differentiate(formulation.build(tree)).jac_adj1
    given = arguments(tape, seed)
    at, lam = {name: np.array(given[name]) for name in ("q", "qd", "u")}, np.array(given["adj_qdd"])
    driven = [k for k, body in enumerate(tree.bodies) if body.joint.actuated]

    def gradient(x: Point) -> dict[str, Array]:
        forces = np.zeros(len(tree.bodies))
        forces[driven] = x["u"]
        by_q, by_qd, by_force = peer.acceleration_derivatives(x["q"], x["qd"], forces)
        return {"q": lam @ by_q, "qd": lam @ by_qd, "u": lam @ by_force[:, driven]}

    found = evaluate(tape, given)
    for column in at:
        for row, expected in differentiate(gradient, at, column).items():
            error = np.abs(matrix(tape, f"jac_adj_{row}_{column}", found) - expected).max()
            assert error <= CLOSE * max(1.0, np.abs(expected).max()), f"{row} {column}"
