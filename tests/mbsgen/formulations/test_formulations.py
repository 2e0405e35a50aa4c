"""The four formulations on random trees: against Pinocchio, against each other, with every reduction on and off."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from sympy import Integer

from mbsgen.errors import TapeError
from mbsgen.formulations import condition, exp1, exp2, semi
from mbsgen.formulations.reductions import ALL, NONE, Reductions
from mbsgen.model.tree import Tree
from mbsgen.tape.interpreter import DIGITS, evaluate, find_failure
from mbsgen.tape.types import Tape
from tests.mbsgen.formulations.agreement import (
    EPS,
    FEW,
    SWITCHED,
    assert_equals_pinocchio,
    run,
    scaled_condition,
    state,
    tape_of,
)
from tests.random_trees import driven, floating, random_tree
from tests.reference_models import ARM, RANDOM_TREE, tree_from_reference

SIZES = (1, 2, 3, 5, 8, 12, 16, 20, 30)


@cache
def tree_of(seed: int, *, runtime: bool = False) -> Tree:
    n = SIZES[seed % len(SIZES)]
    return driven(random_tree(seed, n, runtime=runtime, tidy=seed % 2 == 0))


@pytest.mark.parametrize("seed", range(12))
def test_formulations_equal_pinocchio(seed: int):
    assert_equals_pinocchio(tree_of(seed), seed, FEW)


@pytest.mark.parametrize("reductions", SWITCHED.values(), ids=SWITCHED)
@pytest.mark.parametrize("seed", [3, 4, 13])
def test_every_reduction_can_be_switched_off(seed: int, reductions: Reductions):
    assert_equals_pinocchio(tree_of(seed), seed, reductions)


@pytest.mark.parametrize("reductions", SWITCHED.values(), ids=SWITCHED)
def test_reductions_hold_with_parameters_at_run_time(reductions: Reductions):
    assert_equals_pinocchio(tree_of(4, runtime=True), 4, reductions)


@pytest.mark.parametrize("path", [ARM, RANDOM_TREE], ids=lambda p: p.stem)
def test_formulations_equal_the_reference_files(path):
    """Against 50-digit values of another code, in each state of the file."""
    tree, content = tree_from_reference(path), json.loads(path.read_text())
    zero = np.zeros(len(tree.bodies))
    for given in content["states"]:
        q, qd, qdd, tau = (np.array(given[x]) for x in ("q", "qd", "qdd", "tau"))
        exact = {k: np.array(v, dtype=float) for k, v in given["exact50"].items()}
        M = exact["M"]
        found = {
            "tau_id": run(tape_of("impl", tree), tree, q=q, qd=qd, qdd=qdd, u=zero)["Phi"],
            **{k: run(tape_of("semi", tree), tree, q=q, qd=qd)[v] for k, v in (("M", "M"), ("nle", "c"))},
        }
        for name, value in found.items():
            expected = exact[name].ravel(order="F")
            np.testing.assert_allclose(value, expected, rtol=0, atol=1e-12 * np.abs(expected).max())
        for name in ("exp1", "exp2"):
            qdd_found = run(tape_of(name, tree), tree, q=q, qd=qd, u=tau)["qdd"]
            expected = exact["qdd_fd"] if "qdd_fd" in exact else exact["qdd"]
            bound = 10 * EPS * scaled_condition(M) * np.abs(expected).max()
            np.testing.assert_allclose(qdd_found, expected, rtol=0, atol=max(bound, 1e-12 * np.abs(expected).max()))


@pytest.mark.parametrize("seed", range(6))
def test_mass_matrix_is_symmetric_and_positive(seed: int):
    tree = tree_of(seed)
    n = len(tree.bodies)
    q, qd, *_ = state(seed, n)
    M = run(tape_of("semi", tree), tree, q=q, qd=qd)["M"].reshape(n, n)
    assert np.array_equal(M, M.T)
    assert np.linalg.eigvalsh(M).min() > 0


@pytest.mark.parametrize("seed", range(6))
def test_columns_of_the_mass_matrix_are_unit_acceleration_residuals(seed: int):
    """M e_i = Phi(q, 0, e_i) - Phi(q, 0, 0)."""
    tree = tree_of(seed)
    n = len(tree.bodies)
    q, *_ = state(seed, n)
    zero = np.zeros(n)
    M = run(tape_of("semi", tree), tree, q=q, qd=zero)["M"].reshape(n, n)
    at_rest = run(tape_of("impl", tree), tree, q=q, qd=zero, qdd=zero, u=zero)["Phi"]
    for i, e in enumerate(np.eye(n)):
        column = run(tape_of("impl", tree), tree, q=q, qd=zero, qdd=e, u=zero)["Phi"] - at_rest
        np.testing.assert_allclose(column, M[:, i], rtol=0, atol=1e-12 * max(np.abs(M).max(), np.abs(at_rest).max()))


@pytest.mark.parametrize("seed", range(7))
def test_explicit_forms_agree_and_solve_the_implicit_one(seed: int):
    """gamma = nu, and Phi(q, qd, gamma) = Q."""
    tree = tree_of(seed)
    n = len(tree.bodies)
    q, qd, _, u = state(seed, n)
    M = run(tape_of("semi", tree), tree, q=q, qd=qd)["M"].reshape(n, n)
    one, two = (run(tape_of(name, tree), tree, q=q, qd=qd, u=u)["qdd"] for name in ("exp1", "exp2"))
    np.testing.assert_allclose(one, two, rtol=0, atol=100 * EPS * scaled_condition(M) * np.abs(two).max())
    for qdd in (one, two):
        scale = np.abs(M) @ np.abs(qdd) + np.abs(u) + 1
        rest = run(tape_of("impl", tree), tree, q=q, qd=qd, qdd=qdd, u=u)["Phi"]
        assert (np.abs(rest) <= 1e-12 * scale.max()).all()


@pytest.mark.parametrize("name", ["impl", "semi", "exp1", "exp2"])
def test_float64_is_near_50_digits(name: str):
    """The same tape at the same inputs; the error of the accelerations grows with the condition."""
    tree = tree_of(4)
    n = len(tree.bodies)
    q, qd, qdd, u = state(7, n)
    arguments = {"q": q, "qd": qd, "qdd": qdd, "u": u}
    tape = tape_of(name, tree)
    M = run(tape_of("semi", tree), tree, q=q, qd=qd)["M"].reshape(n, n)
    given = {i.name: list(map(DIGITS.literal, arguments[i.name])) for i in tape.inputs}
    exact = evaluate(tape, given, DIGITS)
    for output, found in run(tape, tree, **arguments).items():
        expected = np.array([float(x) for x in exact[output]])
        bound = 100 * EPS * (scaled_condition(M) if name.startswith("exp") else 1) * np.abs(expected).max()
        assert np.abs(found - expected).max() <= bound


@pytest.mark.parametrize("seed", range(7))
def test_no_guard_fails_where_the_mass_matrix_is_sound(seed: int):
    tree = tree_of(seed)
    q, qd, _, u = state(seed, len(tree.bodies))
    for name in ("exp1", "exp2"):
        assert find_failure(tape_of(name, tree), {"q": list(q), "qd": list(qd), "u": list(u)}) == 0


def test_entries_between_branches_are_not_there():
    """M of a tree with two branches on the base has no operation for bodies on different ones."""
    tree = driven(random_tree(21, 6))
    bodies = tuple(replace(b, parent=(0, 1, 2, 0, 4, 5)[i]) for i, b in enumerate(tree.bodies))
    tape = semi.build(replace(tree, bodies=bodies))
    M = np.array(tape.output("M").values).reshape(6, 6)
    zero = {tape.first_literal + k for k, x in enumerate(tape.literals) if x == 0}
    assert set(M[:3, 3:].ravel()) <= zero
    assert len(zero) == 1


@pytest.mark.parametrize("name", ["exp1", "exp2"])
def test_a_floating_base_falls_freely(name: str):
    """At rest, without forces, it accelerates with gravity, and no joint moves."""
    tree = floating(driven(random_tree(6, 5)))
    n = len(tree.bodies)
    q, *_ = state(6, n)
    q[4] = 0.4  # far from the lock of the three turns
    zero = np.zeros(n)
    qdd = run(tape_of(name, tree), tree, q=q, qd=zero, u=zero)["qdd"]
    gravity = [float(g) for g in tree.gravity]
    np.testing.assert_allclose(qdd, [*gravity, *zero[3:]], rtol=0, atol=1e-12)


def test_a_floating_base_equals_pinocchio():
    assert_equals_pinocchio(floating(driven(random_tree(6, 5))), 6, FEW)


@pytest.mark.parametrize("reductions", [ALL, NONE], ids=["reduced", "plain"])
@pytest.mark.parametrize("build", [exp1.build, exp2.build, condition.build], ids=["exp1", "exp2", "condition"])
def test_a_joint_that_moves_nothing_is_named(build: Callable[..., Tape], reductions: Reductions) -> None:
    """Of a Tree that no model's checks have seen: the last body has no mass."""
    tree = random_tree(3, 3)
    nothing = (Integer(0),) * 3
    leaf = replace(tree.bodies[2], mass=Integer(0), com=nothing, inertia=(nothing,) * 3)
    with pytest.raises(TapeError, match=r"random3: joint 'q3' moves nothing.*; give a body it carries mass"):
        build(replace(tree, bodies=(*tree.bodies[:2], leaf)), reductions)
