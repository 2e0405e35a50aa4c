"""The digits that `condition` estimates, beside the digits that EXP1 and EXP2 lose against 50 digits."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from sympy import Integer, Symbol

from mbsgen.formulations.reductions import Reductions
from mbsgen.model.changes.reduction import build_tree
from mbsgen.model.reader import read_model
from mbsgen.model.tree import Kind, Parameter, Tree
from tests.mbsgen.failures.mechanisms import (
    EXPLICIT,
    HARMLESS,
    HEAVY,
    LOCKS,
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
    near_lock,
    rods,
    scaled_condition,
    spatial_chain,
    status,
    straight_chain,
    tape_of,
)
from tests.random_trees import random_tree
from tests.shipped import TREES

TOLD_BY = {"exp1": "elimination", "exp2": "articulated"}
ALWAYS = 1e-13  # what forces and accelerations lose beside: `condition` does not look at them
ABOVE, BELOW = 16, 50  # factors within which errors, and the largest of several errors, agree with the estimate


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
    """EXP2 is not alarmed at any length; EXP1 loses less than the estimate, as it counts angles from the base."""
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


@pytest.mark.parametrize("file", TREES, ids=lambda file: file.stem)
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


def cross(v: Array) -> Array:
    return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])


def turn(axis: int, angle: float) -> Array:
    """Return the rotation about a coordinate axis, from the turned frame."""
    R = np.eye(3)
    j, k = (axis + 1) % 3, (axis + 2) % 3
    R[j, j] = R[k, k] = np.cos(angle)
    R[k, j], R[j, k] = np.sin(angle), -np.sin(angle)
    return R


def articulate_rods(axes: list[int], q: Array) -> list[float]:
    """Compute `articulated` of a chain of rods with 6 x 6 matrices: of (linear, angular) parts, in body frames."""
    n, half, way = len(axes), np.array([0.5, 0, 0]), np.array([1.0, 0, 0])
    J = np.diag([1 / 1200, 1 / 12, 1 / 12]) - cross(half) @ cross(half)
    own = np.block([[np.eye(3), -cross(half)], [cross(half), J]])
    shift = np.block([[np.eye(3), -cross(way)], [np.zeros((3, 3)), np.eye(3)]])
    turns = [np.kron(np.eye(2), turn(axis, angle)) for axis, angle in zip(axes, q, strict=True)]
    steps = [turns[k].T @ (shift if k else np.eye(6)) for k in range(n)]  # motions, from the parent to the body
    parts, left, pivots, loads = [[own] for _ in axes], [own] * n, [0.0] * n, [np.zeros(6)] * n
    for k in reversed(range(n)):
        whole, along = sum(parts[k]), 3 + axes[k]
        pivots[k], loads[k] = whole[along, along], whole[:, along] / whole[along, along]
        left[k] = whole - np.outer(loads[k], whole[along])
        if k:
            parts[k - 1].append(steps[k].T @ left[k] @ steps[k])
    lost, after = [], np.zeros((6, 6))
    for k in range(n):
        before, axis = steps[k] @ after @ steps[k].T, np.eye(6)[3 + axes[k]]
        freed = np.eye(6) - np.outer(axis, loads[k])
        after = freed @ before @ freed.T + np.outer(axis, axis) / pivots[k]
        felt = sum(map(np.abs, parts[k])) if k < n - 1 else np.zeros((6, 6))  # the last pivot is a number
        lost.append(1 + float((np.abs(before) * np.abs(left[k])).sum() + (np.abs(after) * felt).sum()))
    return lost


@pytest.mark.parametrize("axes", [[2, 2, 2], [2, 1, 0, 2]], ids=["planar", "spatial"])
def test_what_the_articulated_recursion_is_told_by(axes: list[int]):
    """Of rods, written in body frames, against matrices; 1e-10 is room for the rounding of doubles."""
    q = np.random.default_rng(len(axes)).uniform(-np.pi, np.pi, len(axes))
    found = compute(tape_of("condition", rods(axes), NONE), draw_state(len(axes), 0, q=q))
    assert found["articulated"].ravel() == pytest.approx(articulate_rods(axes, q), rel=1e-10)
