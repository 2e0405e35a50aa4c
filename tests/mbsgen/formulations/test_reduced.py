"""Reduced forms agree with the forms with multipliers on closed poses; a lost rank is a status."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.mbsgen.formulations.closed_mechanisms import TEXTS, draw, make, run, spread

Array = NDArray[np.float64]
Values = Mapping[str, Sequence[float]]
ROUNDING = 1e-10  # of numbers up to 1e3, where Ju and M have conditions up to 1e3


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
