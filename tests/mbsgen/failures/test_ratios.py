"""EXP2 and its derivatives at random ratios of mass, and before bodies that are nearly rods: digits, or a status."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
from sympy import Expr, Float, Symbol

from mbsgen.derivatives.dynamics import Dynamics
from mbsgen.formulations.reductions import NONE
from mbsgen.model.tree import Kind, Motion, Parameter, Tree
from mbsgen.procedure.procedure import straight
from tests.mbsgen.failures.mechanisms import (
    CARDAN,
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
    spatial_chain,
    status,
    tape_of,
)

THREE_DIGITS, SIX_DIGITS = 1e-3, 1e-6


def draw_chain(rng: np.random.Generator) -> Tree:
    """Draw a chain of bodies of which some are up to 1e17 times as heavy as others, most often the last."""
    size = int(rng.integers(3, 9))
    bodies = []
    for number in range(1, size + 1):
        is_heavy = rng.random() < (0.7 if number == size else 0.2)
        mass = 10.0 ** rng.uniform(8, 17) if is_heavy else 1.0
        sides = rng.uniform(0.01, 0.1, 3)
        turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        inertia = mass * turn @ np.diag(sides.sum() - sides) @ turn.T
        rows = tuple(tuple(Float(x) for x in row) for row in (inertia + inertia.T) / 2)
        place = numbers(*rng.uniform(-1, 1, 3)) if number > 1 else numbers(0, 0, 0)
        motion = Motion.PRISMATIC if rng.random() < 0.1 else Motion.REVOLUTE
        com = numbers(*rng.uniform(-0.5, 0.5, 3))
        bodies.append(make_body(number, int(rng.integers(3)), Float(mass), com, rows, position=place, motion=motion))
    return make_tree("chain", bodies)


def test_no_ratio_of_masses_is_silent():
    """Three digits or a status, and a status only where six digits are lost."""
    failed = 0
    for seed in range(10):
        tree = draw_chain(np.random.default_rng(seed))
        state = draw_state(len(tree.bodies), seed)
        error = error_of("exp2", tree, state)
        is_refused = status(tape_of("exp2", tree), state) != 0
        assert (error >= SIX_DIGITS) if is_refused else (error <= THREE_DIGITS)
        failed += is_refused
    assert failed >= 1


def test_a_heavy_tip_that_leaves_no_digit_has_a_status():
    """Ratios of 1e10 keep six digits; from 1e13 on fewer than four remain, in every state."""
    for power, fails in ((10, 0), (13, 6), (17, 6)):
        tape = tape_of("exp2", spatial_chain(10, [1] * 9 + [10**power]), NONE)
        assert sum(status(tape, draw_state(10, seed)) != 0 for seed in range(6)) == fails


THIN = Symbol("thin")


def rod_on_a_cardan_joint(thin: float, *, kind: Kind, tilt: float = 0.0) -> Tree:
    """Hold a rod by two massless joints, its moment about itself `thin` of the others."""
    along: Expr = THIN if kind is Kind.RUNTIME else Float(thin)
    rod = make_body(3, 0, Float(1), numbers(tilt, 0, 0), diagonal(Float(1), along, Float(1)))
    tree = make_tree("axes", [make_body(1, 2), make_body(2, 1), rod])
    return replace(tree, parameters=(Parameter("thin", THIN, thin, kind),)) if kind is Kind.RUNTIME else tree


def states_of(tree: Tree) -> list[Mapping[str, Array]]:
    values = np.array([p.value for p in tree.parameters])
    return [{**draw_state(3, seed), "p": values} for seed in range(8)]


@pytest.mark.parametrize("kind", [Kind.CONSTANT, Kind.RUNTIME])
@pytest.mark.parametrize("thin", [1e-4, 1e-8, 1e-12, 1e-14, 3e-15, 1e-15, 3e-16])
def test_a_body_that_is_nearly_a_rod_is_not_silent(thin: float, kind: Kind):
    tree = rod_on_a_cardan_joint(thin, kind=kind)
    tape = tape_of("exp2", tree)
    for state in states_of(tree):
        failed = status(tape, state) != 0
        assert (
            failed or relative_error(compute(tape, state)["qdd"], compute_exactly(tape, state)["qdd"]) <= THREE_DIGITS
        )
        assert not failed or thin <= 1e-11


def test_a_run_time_number_far_from_its_value_at_generation_is_not_silent():
    """A chain of ordinary links, whose last one becomes 1e16 times as heavy at run time."""
    mass = Symbol("mass")
    tree = spatial_chain(8, [1] * 7 + [mass])
    tree = replace(tree, parameters=(Parameter("mass", mass, 1.0, Kind.RUNTIME),))
    tape = tape_of("exp2", tree)
    for power in (0, 4, 8, 12, 16):
        state = {**draw_state(8, power), "p": np.array([10.0**power])}
        failed = status(tape, state) != 0
        assert failed or relative_error(compute(tape, state)["qdd"], compute_exactly(tape, state)["qdd"]) <= SIX_DIGITS
        assert failed == (power > 8)


@pytest.mark.parametrize("distance", [1e-3, 1e-5, 1e-7, 1e-8, 1e-10])
def test_derivatives_near_a_lock_have_digits_or_a_status(distance: float):
    """EXP2 keeps its digits at a Cardan joint's lock; its derivatives eliminate in M, which loses them."""
    tape = straight(Dynamics(CARDAN, NONE).differentiate(tape_of("exp2", CARDAN, NONE)).jac)
    for seed in range(3):
        state = near_lock(CARDAN, np.pi / 2, distance, seed)
        assert status(tape_of("exp2", CARDAN, NONE), state) == 0
        exact, found = compute_exactly(tape, state), compute(tape, state)
        assert status(tape, state) or max(relative_error(found[name], exact[name]) for name in exact) <= 1e-5
        assert (status(tape, state) == 0) == (distance >= 1e-4)
