"""Inertias of extreme size, and centres of mass far from the joint."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from sympy import Expr, Float, Rational, Symbol

from mbsgen.formulations.reductions import NONE, Reductions
from mbsgen.model.tree import Kind, Motion, Parameter, Tree
from tests.mbsgen.failures.mechanisms import (
    EXPLICIT,
    REDUCTIONS,
    RESIDUALS,
    U,
    compute,
    compute_exactly,
    diagonal,
    draw_state,
    error_of,
    make_body,
    make_tree,
    relative_error,
    spatial_chain,
    status,
    tape_of,
)

TINY, HUGE = Rational(1, 10**150), Rational(10**150)
SIZES: dict[str, list[Expr | int]] = {
    "tiny": [TINY] * 6,
    "huge": [HUGE] * 6,
    "tiny between others": [TINY, 1] * 3,
    "huge between others": [HUGE, 1] * 3,
}


@pytest.mark.parametrize("reductions", REDUCTIONS.values(), ids=REDUCTIONS)
@pytest.mark.parametrize("factors", SIZES.values(), ids=SIZES)
def test_masses_of_any_size(factors: list[Expr | int], reductions: Reductions):
    """From 1e-150 to 1e150 kg: nothing overflows, nothing underflows, and no guard mistakes light for lost."""
    tree, state = spatial_chain(6, factors), draw_state(6, 1)
    state["u"] = compute(tape_of("impl", tree, reductions), {**state, "u": np.zeros(6)})["Phi"]
    for name in EXPLICIT:
        assert status(tape_of(name, tree, reductions), state) == 0
        assert error_of(name, tree, state, reductions) <= 1e-12
    for name in RESIDUALS:
        assert np.isfinite(compute(tape_of(name, tree, reductions), state)["Phi"]).all()


def offset_body(offset: float, kind: Kind) -> Tree:
    """A body of 1 kg and 1 kg m2 that is free in a plane; its centre of mass is far from its origin."""
    c, one = Symbol("c"), Float(1)
    body = make_body(3, 2, one, (c, c / 3, c / 7), diagonal(one, one, one))
    slides = [make_body(number, axis, motion=Motion.PRISMATIC) for number, axis in ((1, 0), (2, 1))]
    return replace(make_tree("offset", [*slides, body]), parameters=(Parameter("c", c, offset, kind),))


@pytest.mark.parametrize("kind", Kind, ids=lambda kind: kind.value)
@pytest.mark.parametrize("power", [0, 1, 2, 3, 4])
def test_regrouping_loses_no_more_than_a_distant_origin_does(power: int, kind: Kind):
    """J about the origin holds m c2: the remaining digits of I are lost to 4 u (1 + m c2 / I), regrouped or not."""
    tree = offset_body(10.0**power, kind)
    allowed = 4 * U * (1 + 10.0 ** (2 * power) * (1 + 1 / 9 + 1 / 49))
    for seed in range(5):
        given = np.array([10.0**power])
        state = {**draw_state(3, seed), "p": given, "theta": given}
        for name in (*EXPLICIT, *RESIDUALS):
            exact = compute_exactly(tape_of(name, tree, NONE), state)
            for reductions in REDUCTIONS.values():
                tape = tape_of(name, tree, reductions)
                assert status(tape, state) == 0
                for output, value in compute(tape, state).items():
                    assert relative_error(value, exact[output]) <= allowed
