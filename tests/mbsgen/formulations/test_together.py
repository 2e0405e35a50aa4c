"""Joints that EXP2 eliminates together: which they are, what this saves, and the digits that it keeps."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from mbsgen.formulations.catalogue import write_row
from mbsgen.formulations.parsimony.plan import Meeting
from mbsgen.formulations.planning import dynamics_alone, find_plans
from mbsgen.formulations.reductions import ALL, Reductions
from mbsgen.model.changes.reduction import build_tree
from mbsgen.model.reader import read_model
from mbsgen.model.tree import Tree
from mbsgen.tape.counts import count_paper
from tests.mbsgen.failures.mechanisms import (
    Array,
    U,
    compute,
    compute_exactly,
    draw_state,
    relative_error,
    spatial_chain,
    status,
    tape_of,
)

MODELS = Path(__file__).parents[3] / "models"
ONE_BY_ONE = Reductions(together=False)
ARMS = {"arm_pendulum": 3, "six_axis": 3}  # with the joints that are eliminated together


@cache
def read(name: str) -> Tree:
    return dynamics_alone(build_tree(read_model(MODELS / f"{name}.yaml")), driven=True)


def draw_states(tree: Tree, pose: str) -> list[dict[str, Array]]:
    """Draw states at random, or close to poses in which links lie in line."""
    n = len(tree.bodies)
    if pose == "random":
        return [draw_state(n, seed) for seed in range(20)]
    drawn = (np.random.default_rng(seed) for seed in range(20))
    turns = (rng.integers(0, 2, n) if pose == "folded" else np.zeros(n) for rng in drawn)
    return [draw_state(n, k, q=np.pi * x + 1e-6 * np.random.default_rng(k).normal(size=n)) for k, x in enumerate(turns)]


@pytest.mark.parametrize(("name", "depth"), ARMS.items())
def test_eliminating_together_saves(name: str, depth: int) -> None:
    tree = read(name)
    assert find_plans(tree, ALL).articulated.together == depth
    assert count_paper(write_row("EXP2", tree, ALL)) < count_paper(write_row("EXP2", tree, ONE_BY_ONE))


@pytest.mark.parametrize("pose", ["random", "stretched", "folded"])
@pytest.mark.parametrize("name", ARMS)
def test_no_digit_is_lost(name: str, pose: str) -> None:
    """By the estimate of `condition`, and in the median by at most two bits more than one by one."""
    tree, reference = read(name), tape_of("exp2", read(name), ONE_BY_ONE)
    lost: dict[bool, list[float]] = {True: [], False: []}
    for state in draw_states(tree, pose):
        exact = compute_exactly(reference, state)["qdd"]
        for together, reductions in ((True, ALL), (False, ONE_BY_ONE)):
            tape = tape_of("exp2", tree, reductions)
            assert status(tape, state) == 0
            lost[together].append(relative_error(compute(tape, state)["qdd"], exact))
        told = compute(tape_of("condition", tree, ALL), state)["articulated"].max()
        assert lost[True][-1] <= 16 * U * told
    assert np.median(lost[True]) <= 4 * np.median(lost[False])


@pytest.mark.parametrize("ratio", [10**4, 10**8])
def test_joints_that_feel_little_of_their_own_are_eliminated_one_by_one(ratio: int) -> None:
    """Before a heavy tip, M holds numbers whose difference is small; articulated bodies hold the difference."""
    tree = spatial_chain(6, [1] * 5 + [ratio])
    assert find_plans(tree, ALL).articulated.together == 0


def test_levers_of_a_group_are_carried_up_to_the_body_beyond() -> None:
    """The arm's third link is met by the levers of the first two, where it is written itself."""
    plan = find_plans(read("arm_pendulum"), ALL).elimination
    assert plan[4].meeting is Meeting.SPLIT
    assert plan[4].own_frame


@pytest.mark.parametrize(
    ("row", "switch"),
    [
        *((row, x) for row in ("SEMI", "EXP1") for x in ("meet", "share", "spin", "momentum")),
        *(("EXP2", x) for x in ("together", "momentum", "rest", "series")),
    ],
)
def test_a_reduction_that_is_switched_off_costs_operations(row: str, switch: str) -> None:
    without = Reductions(**{switch: False})  # type: ignore[arg-type]
    tree = read("arm_pendulum")
    assert count_paper(write_row(row, tree, ALL)) < count_paper(write_row(row, tree, without))
