"""The same through C, one case of each kind: results, and the status where there are none."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from tests.mbsgen.failures.compiled import Compiled
from tests.mbsgen.failures.mechanisms import (
    APART,
    CARDAN,
    DISTANCES,
    EXPLICIT,
    RESIDUALS,
    SIDES,
    U,
    arm,
    compute,
    compute_exactly,
    draw_state,
    mass_matrix,
    near_lock,
    relative_error,
    scale_of,
    spatial_chain,
    status,
    straight_chain,
    tape_of,
)

Requires = Callable[[str], str]


def test_chains(tmp_path: Path, requires: Requires) -> None:
    for k, tree in enumerate([straight_chain(20), spatial_chain(10), spatial_chain(10, [1] * 9 + [10**4])]):
        tapes = {name: tape_of(name, tree) for name in (*EXPLICIT, *RESIDUALS)}
        kernels = Compiled(tmp_path / str(k), requires("gcc"), [*tapes.values()])
        state = draw_state(len(tree.bodies), 1)
        condition = np.linalg.cond(mass_matrix(tree, state)[0])
        for name in EXPLICIT:
            failed, found = kernels(tapes[name], state)
            assert failed == 0
            assert relative_error(found["qdd"], compute_exactly(tapes[name], state)["qdd"]) <= 10 * U * condition
        for name in RESIDUALS:
            failed, found = kernels(tapes[name], state)
            lost = np.abs(found["Phi"] - compute_exactly(tapes[name], state)["Phi"]).max()
            assert failed == 0
            assert lost <= 10 * U * scale_of(tree, state, state["qdd"]).max()


def test_a_cardan_joint(tmp_path: Path, requires: Requires) -> None:
    """Status and results are the interpreter's; a kernel that fails writes nothing."""
    tapes = {name: tape_of(name, CARDAN) for name in EXPLICIT}
    kernels = Compiled(tmp_path, requires("gcc"), [*tapes.values()])
    for distance in DISTANCES:
        state = near_lock(CARDAN, np.pi / 2, distance, 1)
        for tape in tapes.values():
            failed, found = kernels(tape, state)
            assert failed == status(tape, state)
            if failed:
                assert np.isnan(found["qdd"]).all()
            else:
                assert relative_error(found["qdd"], compute_exactly(tape, state)["qdd"]) <= 1e-6


def test_huge_angles(tmp_path: Path, requires: Requires) -> None:
    tape = tape_of("semi", arm(3, SIDES["sine"]), APART)
    kernels, state = Compiled(tmp_path, requires("gcc"), [tape]), draw_state(4, 1)
    state["q"] = state["q"] + 1e8
    _, found = kernels(tape, state)
    for name, exact in compute_exactly(tape, state).items():
        assert relative_error(found[name], exact) <= 1e-13
    assert relative_error(found["M"], compute(tape, state)["M"]) <= 1e-15
