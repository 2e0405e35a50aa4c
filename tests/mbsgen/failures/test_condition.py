"""What `condition` tells of the digits that EXP1 and EXP2 lose, beside what they lose against 50 digits."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from sympy import Integer, Symbol

from mbsgen.formulations.reductions import Reductions
from mbsgen.model.reader import read_model
from mbsgen.model.reduction import build_tree
from mbsgen.model.tree import Kind, Parameter, Tree
from tests.mbsgen.failures.mechanisms import (
    EXPLICIT,
    NONE,
    REDUCED,
    REDUCTIONS,
    Array,
    U,
    compute,
    compute_exactly,
    draw_state,
    error_of,
    make_body,
    make_tree,
    mass_matrix,
    scaled_condition,
    spatial_chain,
    status,
    straight_chain,
    tape_of,
)
from tests.mbsgen.failures.test_chains import HARMLESS, HEAVY
from tests.mbsgen.failures.test_locks import LOCKS, near_lock
from tests.random_trees import random_tree

MODELS = [f for f in sorted((Path(__file__).parents[3] / "models").glob("*.yaml")) if not f.stem.endswith(".ocp")]
TOLD_BY = {"exp1": "elimination", "exp2": "articulated"}
ALWAYS = 1e-13  # what forces and accelerations lose beside: `condition` does not look at them
ABOVE, BELOW = 16, 50  # an error may be so many times what is told; the largest of some, so many times less


def told(tree: Tree, state: dict[str, Array], reductions: Reductions = REDUCED) -> dict[str, float]:
    """Return the errors to expect of EXP1 and EXP2."""
    found = compute(tape_of("condition", tree, reductions), state)
    return {name: float(U * found[output].max()) for name, output in TOLD_BY.items()}


def runtime_elbow(seed: int) -> Tree:
    """Make an elbow of numbers that rounding does not spare, known at run time only."""
    mass, upper, lower = np.random.default_rng(seed).uniform(0.5, 1.5, 3)
    given = {"mass": mass, "upper": upper, "lower": lower}
    symbols = {name: Symbol(name) for name in given}
    arms = [(symbols[name], Integer(0), Integer(0)) for name in ("upper", "lower")]
    hand = make_body(2, 2, symbols["mass"], arms[1], position=arms[0])
    parameters = tuple(Parameter(n, symbols[n], float(x), Kind.RUNTIME) for n, x in given.items())
    return replace(make_tree("elbow", [make_body(1, 2), hand]), parameters=parameters)


def with_parameters(tree: Tree, state: dict[str, Array]) -> dict[str, Array]:
    return {**state, "p": np.array([p.value for p in tree.parameters if p.kind is Kind.RUNTIME])}


def chain_states(tree: Tree) -> list[tuple[Tree, dict[str, Array]]]:
    return [(tree, draw_state(len(tree.bodies), seed)) for seed in range(5)]


def lock_states(name: str, distance: float) -> list[tuple[Tree, dict[str, Array]]]:
    if name == "elbow":
        trees = [runtime_elbow(seed) for seed in range(5)]
        return [(t, with_parameters(t, near_lock(t, 0.0, distance, k))) for k, t in enumerate(trees)]
    tree, lock = LOCKS[name]
    return [(tree, near_lock(tree, lock, distance, seed)) for seed in range(5)]


CASES = {f"{name} at {d:g}": lock_states(name, d) for name in LOCKS for d in (1e-1, 1e-3, 1e-5, 1e-7)}
CASES |= {f"{n} bodies": chain_states(spatial_chain(n)) for n in (5, 10, 20)}
CASES |= {f"tip of {ratio}": chain_states(spatial_chain(10, [1] * 9 + [ratio])) for ratio in (10**4, 10**8, HEAVY)}
CASES |= {name: chain_states(spatial_chain(10, factors)) for name, factors in HARMLESS.items()}


@pytest.mark.parametrize("reductions", REDUCTIONS.values(), ids=REDUCTIONS)
@pytest.mark.parametrize("states", CASES.values(), ids=CASES)
def test_errors_are_what_is_told(states: list[tuple[Tree, dict[str, Array]]], reductions: Reductions):
    """None is much larger, and not all are much smaller, unless they are small anyway."""
    for name in EXPLICIT:
        expected = [told(tree, state, reductions)[name] for tree, state in states]
        errors = [error_of(name, tree, state, reductions) for tree, state in states]
        assert all(error <= ABOVE * e + ALWAYS for error, e in zip(errors, expected, strict=True))
        assert max(e / x for e, x in zip(errors, expected, strict=True)) >= 1 / BELOW or max(expected) <= ALWAYS


@pytest.mark.parametrize("distance", [1e-1, 1e-2, 1e-3, 1e-4])
def test_an_elbow_of_numbers_is_told(distance: float):
    """Its last pivot is a number; what is left to the first is 1 - cos^2, and loses digits as the distance squared."""
    state = near_lock(LOCKS["elbow"][0], 0.0, distance, 1)
    expected = told(LOCKS["elbow"][0], state)["exp2"]
    assert error_of("exp2", LOCKS["elbow"][0], state) <= ABOVE * expected
    assert expected <= 2 * U / distance**2


@pytest.mark.parametrize("name", LOCKS)
@pytest.mark.parametrize("distance", [1e-4, 1e-5, 1e-6, 1e-7, 1e-8])
def test_no_lock_is_silent(name: str, distance: float):
    """Six digits, or a status: an elbow of numbers that are known at run time only, too."""
    for tree, state in lock_states(name, distance):
        for form in EXPLICIT:
            assert status(tape_of(form, tree), state) == 1 or error_of(form, tree, state) <= 1e-6


@pytest.mark.parametrize("size", [5, 20, 50])
def test_straight_chains(size: int):
    """EXP2 is not alarmed at any length; EXP1 loses less than is told, as it counts angles from the base."""
    tree, state = straight_chain(size), draw_state(size, size, q=np.zeros(size))
    expected = told(tree, state)
    assert expected["exp2"] <= ALWAYS
    for name in EXPLICIT:
        assert error_of(name, tree, state) <= ABOVE * expected[name] + ALWAYS


def test_locks_are_told():
    """At 1e-7: EXP1 has lost all but two digits in any; EXP2 where axes stand askew, and in the elbow."""
    expected = {name: [told(t, s) for t, s in lock_states(name, 1e-7)] for name in LOCKS}
    assert all(e["exp1"] >= 1e-3 for found in expected.values() for e in found)
    assert all(e["exp2"] >= 1e-2 for e in expected["elbow"])
    assert all(e["exp2"] >= 1e-6 for e in expected["askew"])
    assert all(e["exp2"] <= 1e-15 for name in ("Cardan", "wrist") for e in expected[name])


@pytest.mark.parametrize("name", LOCKS)
def test_a_lock_itself_is_told(name: str):
    """No digit: a number that says so, or none."""
    for tree, state in lock_states(name, 0.0):
        assert not told(tree, state)["exp1"] <= 1e-2


@pytest.mark.parametrize("file", MODELS, ids=lambda file: file.stem)
def test_models_raise_no_alarm(file: Path):
    """Eleven digits at any position."""
    tree = build_tree(read_model(file))
    for seed in range(10):
        q = np.random.default_rng(seed).uniform(-np.pi, np.pi, len(tree.coordinates))
        state = with_parameters(tree, draw_state(len(tree.bodies), seed, q=q))
        assert max(told(tree, state).values()) <= 1e-11


@pytest.mark.parametrize("reductions", [REDUCED, NONE], ids=["reduced", "textbook"])
@pytest.mark.parametrize("seed", range(6))
def test_what_elimination_is_told_by(seed: int, reductions: Reductions):
    """M_ii (M^-1)_ii; the condition of the scaled mass matrix lies between its largest and n times its sum."""
    n = 7
    tree = random_tree(seed, n, tidy=seed % 2 == 0)
    state = with_parameters(tree, draw_state(n, seed))
    M, _ = mass_matrix(tree, state)
    found = compute_exactly(tape_of("condition", tree, reductions), state)["elimination"]
    np.testing.assert_allclose(found, np.diag(M) * np.diag(np.linalg.inv(M)), rtol=1e-9)
    assert found.max() <= scaled_condition(tree, state) <= n * found.sum()
