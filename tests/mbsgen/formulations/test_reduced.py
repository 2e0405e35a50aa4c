"""Reduced forms agree with the forms with multipliers on closed poses; a lost rank is a status."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from mbsgen.assembly.mechanism import Mechanism
from mbsgen.assembly.poses import close
from mbsgen.formulations.catalogue import FUNCTIONS
from mbsgen.model.tree import Kind, Tree
from mbsgen.tape.interpreter import evaluate
from tests.mbsgen.formulations.agreement import FEW
from tests.mbsgen.formulations.closed_mechanisms import TEXTS, make

Array = NDArray[np.float64]
Values = Mapping[str, Sequence[float]]
ROUNDING = 1e-10  # of numbers up to 1e3, where Ju and M have conditions up to 1e3


@cache
def build(name: str, tree: Tree):
    return FUNCTIONS[name].build(tree, FEW)


def run(name: str, tree: Tree, given: Values) -> dict[str, Array]:
    tape = build(name, tree)
    found = evaluate(tape, {i.name: given[i.name] for i in tape.inputs})
    return {key: np.array(values, float) for key, values in found.items()}


def spread(name: str, tree: Tree, given: Values, result: str) -> Array:
    """Return a matrix with its zeros."""
    output, values = build(name, tree).output(result), run(name, tree, given)[result]
    full = np.zeros((output.sparsity.rows, output.sparsity.cols))
    for place, value in zip(output.sparsity.entries, values, strict=True):
        full[place] = value
    return full


def draw(tree: Tree, seed: int) -> dict[str, Array]:
    """Draw a closed state near the assembled pose, with forces and independent accelerations."""
    rng, closure = np.random.default_rng(seed), tree.closure
    n, f = len(tree.joints), len(closure.independent)
    pose = np.array(closure.pose)
    state = {
        "q": close(Mechanism(tree), pose + 0.1 * rng.uniform(-1, 1, pose.size)).q,
        "qd": np.zeros(n),
        "yd": rng.uniform(-2, 2, f),
        "ydd": rng.uniform(-3, 3, f),
        "u": rng.uniform(-3, 3, sum(body.joint.actuated for body in tree.bodies)),
        "a": rng.uniform(-3, 3, len(tree.driven)),
        "tau": rng.uniform(-3, 3, len(tree.driven)),
        "p": np.array([x.value for x in tree.parameters if x.kind is Kind.RUNTIME]),
    }
    own, other = list(closure.independent), list(closure.dependent)
    J = spread("loop_jacobian", tree, state, "J")
    Z = np.zeros((n, f))
    Z[own] = np.eye(f)
    Z[other] = -np.linalg.solve(J[:, other], J[:, own])
    state |= {"J": J, "Z": Z, "qd": Z @ state["yd"]}
    state["qdd"] = Z @ state["ydd"]
    state["qdd"][other] -= np.linalg.solve(J[:, other], run("loop_jacobian", tree, state)["gamma"])
    return state


@pytest.mark.parametrize("name", TEXTS)
def test_reduced_residual_is_the_trees_residual_along_the_motions_that_loops_allow(name):
    """ZT (Phi - Q - JT lam) does not depend on lam; Z is solved for by numbers."""
    tree = make(name)
    state = draw(tree, 1)
    state["lam"] = np.random.default_rng(5).uniform(-5, 5, len(state["J"]))
    expected = state["Z"].T @ run("impl", tree, state)["Phi"]
    assert run("impl_red", tree, state)["Phi"] == pytest.approx(expected, abs=ROUNDING)


@pytest.mark.parametrize("name", TEXTS)
def test_reduced_terms_are_the_trees_along_the_motions_that_loops_allow(name):
    """M = ZT M Z, and c is the residual at ydd = 0 without forces."""
    tree = make(name)
    state = draw(tree, 2)
    own = spread("semi_red", tree, state, "M")
    assert own == pytest.approx(state["Z"].T @ spread("semi", tree, state, "M") @ state["Z"], abs=ROUNDING)
    assert (own == own.T).all()
    still = run("impl_red", tree, state)["Phi"] - own @ state["ydd"]
    free = dict(state, ydd=0 * state["ydd"])
    assert still == pytest.approx(run("impl_red", tree, free)["Phi"], abs=ROUNDING)


@pytest.mark.parametrize("name", TEXTS)
def test_reduced_accelerations_are_the_independent_ones_of_the_other_forms(name):
    tree = make(name)
    state = draw(tree, 3)
    found = run("exp1_red", tree, state)
    for form in ("exp1", "exp2"):
        full = run(form, tree, state)
        assert found["ydd"] == pytest.approx(full["qdd"][list(tree.closure.independent)], abs=ROUNDING)
        assert found.get("tau", []) == pytest.approx(full.get("tau", []), abs=ROUNDING)
    assert run("impl_red", tree, {**state, **found})["Phi"] == pytest.approx(0, abs=ROUNDING)
