"""Formulations agree with Pinocchio: the reductions that are switched, states, and the comparison."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
from numpy.typing import NDArray

from mbsgen.formulations import exp1, exp2, impl, semi
from mbsgen.formulations.reductions import ALL, NONE, Reductions
from mbsgen.model.tree import Tree
from mbsgen.tape.interpreter import evaluate
from mbsgen.tape.types import Tape
from tests.random_trees import Pinocchio, values_of

Array = NDArray[np.float64]
EPS = 2.0**-52
FEW = replace(ALL, trials=12)  # plans do not change what is computed; few are tried where cost is not the question
SWITCHED = {
    "all": FEW,
    "none": NONE,
    "no regrouping": replace(FEW, regroup=False),
    "no shared frames": replace(FEW, share_frames=False),
    "no lumps": replace(FEW, lump=False),
    "relative angles": replace(FEW, absolute=False),
    "no meeting": replace(FEW, meet=False),
    "one by one": replace(FEW, together=False),
    "no factoring": replace(FEW, factor=False),
    "no sharing": replace(FEW, share=False),
    "sums as they come": replace(FEW, order=False),
    "lumps by parameters": replace(FEW, lump_runtime=True),
}


@cache
def tape_of(name: str, tree: Tree, reductions: Reductions = FEW) -> Tape:
    build = {
        "impl": impl.build,
        "semi": semi.build,
        "semi_res": semi.build_residual,
        "exp1": exp1.build,
        "exp2": exp2.build,
    }
    return build[name](tree, reductions)


def run(tape: Tape, tree: Tree, **arguments: Array) -> dict[str, Array]:
    if values := values_of(tree):
        arguments["p"] = np.array(values)
    given = {i.name: list(arguments[i.name]) for i in tape.inputs}
    return {name: np.array(found, float) for name, found in evaluate(tape, given).items()}


def state(seed: int, n: int) -> tuple[Array, Array, Array, Array]:
    rng = np.random.default_rng(seed + 500)
    return rng.uniform(-3, 3, n), rng.uniform(-2, 2, n), rng.uniform(-3, 3, n), rng.uniform(-3, 3, n)


def scaled_condition(M: Array) -> float:
    d = 1 / np.sqrt(np.diag(M))
    return float(np.linalg.cond(M * np.outer(d, d)))


def assert_equals_pinocchio(tree: Tree, seed: int, reductions: Reductions) -> None:
    """Phi, M, c to 1e-12 of the largest entry; qdd likewise, times the condition of the scaled mass matrix."""
    n = len(tree.bodies)
    q, qd, qdd, _ = state(seed, n)
    peer = Pinocchio(tree)
    M, Phi, c = peer.mass_matrix(q), peer.residual(q, qd, qdd), peer.residual(q, qd, 0 * qdd)
    zero = np.zeros(n)
    near = {"rtol": 0.0, "atol": 1e-12 * np.abs(Phi).max()}
    for name in ("impl", "semi_res"):
        found = run(tape_of(name, tree, reductions), tree, q=q, qd=qd, qdd=qdd, u=zero)["Phi"]
        np.testing.assert_allclose(found, Phi, **near)
    terms = run(tape_of("semi", tree, reductions), tree, q=q, qd=qd)
    np.testing.assert_allclose(terms["M"].reshape(n, n), M, rtol=0, atol=1e-12 * np.abs(M).max())
    np.testing.assert_allclose(terms["c"], c, rtol=0, atol=1e-12 * max(np.abs(c).max(), 1.0))
    tolerance = 1e-13 * max(10.0, scaled_condition(M)) * np.abs(qdd).max()
    for name in ("exp1", "exp2"):
        found = run(tape_of(name, tree, reductions), tree, q=q, qd=qd, u=Phi)["qdd"]
        np.testing.assert_allclose(found, qdd, rtol=0, atol=tolerance)
