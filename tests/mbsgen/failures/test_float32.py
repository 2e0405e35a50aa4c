"""Chains in single precision: EXP2 keeps its digits, and EXP1 fails where it has none left."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from mbsgen.formulations.reductions import Reductions
from mbsgen.model.tree import Tree
from tests.mbsgen.failures.compiled import Compiled
from tests.mbsgen.failures.mechanisms import (
    EXPLICIT,
    FLOATS32,
    NONE,
    REDUCED,
    REDUCTIONS,
    Array,
    compute,
    draw_state,
    mass_matrix,
    relative_error,
    spatial_chain,
    status,
    straight_chain,
    tape_of,
)

U32 = 2.0**-24
SEEDS = range(6)


def single_state(tree: Tree, seed: int) -> dict[str, Array]:
    """Draw a state that single precision holds; straight chains are straight."""
    size = len(tree.bodies)
    is_straight = {body.joint.axis for body in tree.bodies} == {2}
    state = draw_state(size, seed, q=np.zeros(size) if is_straight else None)
    return {name: x.astype(np.float32).astype(float) for name, x in state.items()}


def single_error(name: str, tree: Tree, seed: int, reductions: Reductions = REDUCED) -> float:
    """Compare single precision with double."""
    tape, state = tape_of(name, tree, reductions), single_state(tree, seed)
    return relative_error(compute(tape, state, FLOATS32)["qdd"], compute(tape, state)["qdd"])


CHAINS = {"straight": straight_chain, "spatial": spatial_chain}


@pytest.mark.parametrize("reductions", REDUCTIONS.values(), ids=REDUCTIONS)
@pytest.mark.parametrize("size", [6, 10, 20, 50])
@pytest.mark.parametrize("chain", CHAINS.values(), ids=CHAINS)
def test_order_n_keeps_its_digits(chain: Callable[[int], Tree], size: int, reductions: Reductions):
    """1e-5; and as in double precision, 100 u sqrt(cond M). There is no status."""
    tree = chain(size)
    for seed in SEEDS:
        state, error = single_state(tree, seed), single_error("exp2", tree, seed, reductions)
        assert status(tape_of("exp2", tree, reductions), state, FLOATS32) == 0
        assert error <= min(1e-5, 100 * U32 * np.sqrt(np.linalg.cond(mass_matrix(tree, state)[0])))


def test_order_n_where_it_loses_most():
    """Of 200 states of the chain of 50 bodies, the two in which it errs by more than 1e-5: by no more than 2e-5."""
    tree = spatial_chain(50)
    for seed in (96, 178):
        assert single_error("exp2", tree, seed) <= 2e-5


@pytest.mark.parametrize("reductions", REDUCTIONS.values(), ids=REDUCTIONS)
@pytest.mark.parametrize(
    "tree", [straight_chain(6), straight_chain(20), straight_chain(50), spatial_chain(20), spatial_chain(50)],
    ids=["straight6", "straight20", "straight50", "spatial20", "spatial50"],
)  # fmt: skip
def test_elimination_fails_where_digits_are_gone(tree: Tree, reductions: Reductions):
    """Two digits, or a status; and no status where three are left."""
    tape = tape_of("exp1", tree, reductions)
    failed = [status(tape, single_state(tree, seed), FLOATS32) != 0 for seed in SEEDS]
    for seed in SEEDS:
        error = single_error("exp1", tree, seed, reductions)
        assert error >= 1e-3 if failed[seed] else error <= 1e-2
    if reductions == NONE and tree == straight_chain(50):  # relative angles lose all digits there, absolute ones none
        assert all(failed)


def test_single_precision_in_c(tmp_path: Path, requires: Callable[[str], str]) -> None:
    """The status, and the digits, that the interpreter finds."""
    for size, reductions, expected in ((10, REDUCED, False), (50, NONE, True)):
        tree = straight_chain(size)
        tapes = {name: tape_of(name, tree, reductions) for name in EXPLICIT}
        kernels = Compiled(tmp_path / str(size), requires("gcc"), [*tapes.values()], real="float")
        state = single_state(tree, 0)
        failed, found = kernels(tapes["exp2"], state)
        assert failed == 0
        assert relative_error(found["qdd"], compute(tapes["exp2"], state)["qdd"]) <= 1e-5
        failed, found = kernels(tapes["exp1"], state)
        assert (failed != 0) == expected == (status(tapes["exp1"], state, FLOATS32) != 0)
        if not expected:
            assert relative_error(found["qdd"], compute(tapes["exp1"], state)["qdd"]) <= 1e-4
