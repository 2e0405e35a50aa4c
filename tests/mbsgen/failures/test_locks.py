"""Joints that lock: a pivot vanishes. A kernel then fails at that joint, and never gives out a wrong number for one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from sympy import Float, Symbol

from mbsgen.errors import TapeError
from mbsgen.formulations.reductions import Reductions
from mbsgen.model.tree import Body, Kind, Motion, Parameter, Tree
from mbsgen.roles import Role
from mbsgen.tape.ports import Port
from mbsgen.tape.types import Output, Sparsity, Tape
from tests.mbsgen.failures.mechanisms import (
    CARDAN,
    DISTANCES,
    EXPLICIT,
    LOCKS,
    REDUCTIONS,
    RESIDUALS,
    Array,
    compute,
    compute_exactly,
    diagonal,
    draw_state,
    error_of,
    make_body,
    make_tree,
    near_lock,
    numbers,
    relative_error,
    status,
    tape_of,
)

EPSILON = 2.0**-52
SEEDS = range(5)


def weakest_pivot(tape: Tape, state: dict[str, Array]) -> float:
    """Find the smallest pivot in terms of the largest inertia that its joint can feel."""
    places = [g.value for g in tape.guards], [g.scale for g in tape.guards]
    outputs = tuple(
        Output(Port(n, Role.RESULT), Sparsity.dense(len(v)), tuple(v))
        for n, v in zip(("D", "scale"), places, strict=True)
    )
    found = compute(replace(tape, outputs=outputs, guards=()), state)
    signs = np.array([-1.0 if g.negated else 1.0 for g in tape.guards])
    return float((signs * found["D"] / found["scale"]).min())


@pytest.mark.parametrize("reductions", REDUCTIONS.values(), ids=REDUCTIONS)
@pytest.mark.parametrize("distance", DISTANCES)
def test_a_cardan_joint_near_its_lock(distance: float, reductions: Reductions):
    """Accelerations to 1e-6, or a status that names the first joint; EXP2 has them down to 1e-12."""
    for seed in SEEDS:
        state = near_lock(CARDAN, np.pi / 2, distance, seed)
        for name in EXPLICIT:
            failed = status(tape_of(name, CARDAN, reductions), state)
            assert failed in (0, 1)
            assert failed or error_of(name, CARDAN, state, reductions) <= 1e-6
        assert (status(tape_of("exp2", CARDAN, reductions), state) == 0) == (distance > 0)
        if distance > 0:
            assert error_of("exp2", CARDAN, state, reductions) <= 1e-13
        assert (status(tape_of("exp1", CARDAN, reductions), state) == 0) == (distance >= 1e-4)


@pytest.mark.parametrize("reductions", REDUCTIONS.values(), ids=REDUCTIONS)
@pytest.mark.parametrize(("tree", "lock"), LOCKS.values(), ids=LOCKS)
def test_what_a_lock_loses(tree: Tree, lock: float, reductions: Reductions):
    """Errors are at most 4 epsilon over the pivot; so EXP1 and EXP2 have 1e-6 or fail."""
    for distance in DISTANCES:
        for seed in SEEDS:
            state = near_lock(tree, lock, distance, seed)
            for name in EXPLICIT:
                tape = tape_of(name, tree, reductions)
                if status(tape, state) == 0:
                    error = error_of(name, tree, state, reductions)
                    assert error <= min(1e-6, 4 * EPSILON / weakest_pivot(tape, state))
                else:
                    assert status(tape, state) == 1
                    assert distance <= 1e-4


def test_a_rod_on_a_cardan_joint_is_no_product():
    """A rod has no inertia about itself, so nothing is left for the first joint: only rounding, which is no pivot."""
    rod = make_body(3, 0, Float(1), numbers(0, 0, 0), diagonal(Float(1), Float(0), Float(1)))
    tree = make_tree("axes", [make_body(1, 2), make_body(2, 1), rod])
    for seed in range(30):
        assert status(tape_of("exp2", tree), draw_state(3, seed)) != 0


@pytest.mark.parametrize("reductions", REDUCTIONS.values(), ids=REDUCTIONS)
@pytest.mark.parametrize(("tree", "lock"), LOCKS.values(), ids=LOCKS)
def test_residuals_do_not_notice_a_lock(tree: Tree, lock: float, reductions: Reductions):
    for distance in (*DISTANCES, 0.0):
        state = near_lock(tree, lock, distance, 1)
        for name in RESIDUALS:
            tape = tape_of(name, tree, reductions)
            assert relative_error(compute(tape, state)["Phi"], compute_exactly(tape, state)["Phi"]) <= 1e-14


MASS = Symbol("mass")
ARM = make_body(1, 2, Float(1), numbers(0.5, 0, 0))
WEIGHTLESS = {
    "a leaf without mass": make_body(2, 2, MASS, numbers(0.2, 0, 0), position=numbers(1, 0, 0)),
    "a slide without mass": make_body(2, 0, MASS, motion=Motion.PRISMATIC),
    "a rod on its axis": make_body(2, 0, Float(1), inertia=diagonal(MASS, Float(1), Float(1))),
}


def weightless(body: Body, kind: Kind) -> Tree:
    return replace(make_tree("weightless", [ARM, body]), parameters=(Parameter("mass", MASS, 0.0, kind),))


@pytest.mark.parametrize("reductions", REDUCTIONS.values(), ids=REDUCTIONS)
@pytest.mark.parametrize("body", WEIGHTLESS.values(), ids=WEIGHTLESS)
def test_a_joint_that_moves_nothing_fails(body: Body, reductions: Reductions):
    """With a run-time parameter that is 0: a status that names the joint, and finite residuals."""
    tree = weightless(body, Kind.RUNTIME)
    state = {name: np.array([0.3, 0.2]) for name in ("q", "qd", "qdd")} | {"u": np.array([1.0, 0.5]), "p": np.zeros(1)}
    for name in EXPLICIT:
        assert status(tape_of(name, tree, reductions), state) == 2
        assert status(tape_of(name, tree, reductions), {**state, "p": np.ones(1)}) == 0
    for name in RESIDUALS:
        assert np.isfinite(compute(tape_of(name, tree, reductions), state)["Phi"]).all()


@pytest.mark.parametrize("name", EXPLICIT)
@pytest.mark.parametrize("body", WEIGHTLESS.values(), ids=WEIGHTLESS)
def test_a_joint_that_can_never_move_anything_is_not_written(body: Body, name: str):
    """Models with one are refused; a tree that was made by hand is too."""
    with pytest.raises(TapeError, match="moves nothing"):
        tape_of(name, weightless(body, Kind.CONSTANT))
