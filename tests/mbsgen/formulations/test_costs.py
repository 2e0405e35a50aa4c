"""The cost of the formulations: the arm's figures, the savings of reductions, and growth with size (Table 1)."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import pytest

from mbsgen.derivatives.dynamics import Dynamics
from mbsgen.formulations import ports
from mbsgen.formulations.catalogue import FUNCTIONS, list_rows, write_row
from mbsgen.formulations.planning import WORTH
from mbsgen.formulations.reductions import NONE, Reductions
from mbsgen.model.reader import read_model
from mbsgen.model.tree import Tree
from mbsgen.pipeline import build_parametric, read_tree
from mbsgen.procedure.procedure import straight
from mbsgen.roles import Role
from mbsgen.scaling import PERIOD, Growth, find_crossing, grow
from mbsgen.tape.counts import Counts, count
from mbsgen.tape.passes import hoist
from mbsgen.tape.types import Op
from tests.random_trees import random_tree

LUMPED = Reductions(lump_runtime=True)
ARM = Path(__file__).parents[3] / "models" / "arm_pendulum.yaml"


def cost(name: str, tree: Tree, reductions: Reductions) -> Counts:
    """Count a formulation with parameters at run time, setup apart."""
    tape = write_row(name, tree, reductions)
    if tape.holding(Role.PARAMETER):
        _, (tape,) = hoist([tape], ports.PARAMETERS, ports.SETUP)
    return count(tape)


@cache
def arm() -> Tree:
    return build_parametric(read_model(ARM))


@pytest.mark.parametrize(
    ("name", "published", "reached"),
    [("IMPL", 460, 221), ("SEMI", 830, 298), ("EXP1", 991, 429), ("EXP2", 1784, 397)],
)
def test_arm_takes_half_of_the_published_flops_or_less(name: str, published: int, reached: int):
    """Table 4 of the paper, by its convention, all numbers of the model at run time."""
    found = cost(name, arm(), LUMPED).paper
    assert found <= reached
    assert 2 * found <= published


@pytest.mark.parametrize(("name", "reached", "lumped"), [("impl", 964, 977), ("exp2", 1957, 1971)])
def test_jacobians_of_the_arm_take_less_than_round_numbers(name: str, reached: int, lumped: int):
    """As generated, with the numbers of the model, 1000 and 2000; and with numbers at run time.

    Differentiating the tape of `impl` takes 1486.
    """
    assert cost_of_jacobian(name, read_tree(ARM), Reductions()) <= reached
    assert cost_of_jacobian(name, arm(), LUMPED) <= lumped


def cost_of_jacobian(name: str, tree: Tree, reductions: Reductions) -> int:
    found = Dynamics(tree, reductions).differentiate(straight(FUNCTIONS[name].build(tree, reductions)))
    tape = straight(found.jac)
    if tape.holding(Role.PARAMETER):
        _, (tape,) = hoist([tape], ports.PARAMETERS, ports.SETUP)
    return count(tape).paper


@pytest.mark.parametrize(("name", "published"), [("IMPL", 114), ("SEMI", 264), ("EXP1", 328), ("EXP2", 395)])
def test_arm_takes_fewer_equations_than_published(name: str, published: int):
    assert cost(name, arm(), LUMPED).equations < published


@pytest.mark.parametrize("name", list_rows())
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_reductions_save_on_any_tree(name: str, seed: int):
    tree = random_tree(seed, 7, tidy=seed != 1)
    assert cost(name, tree, LUMPED).paper < cost(name, tree, NONE).paper


@pytest.mark.parametrize("name", list_rows())
def test_sums_that_wait_less_take_few_operations_more(name: str):
    """The order in which terms are ready may cost `WORTH`, beside sums in any order that share the most."""
    tree = build_parametric(read_model(ARM.with_name("branched.yaml")))
    shortest = cost(name, tree, replace(LUMPED, order=False)).paper
    assert cost(name, tree, LUMPED).paper <= WORTH * shortest


@pytest.mark.parametrize("name", list_rows())
def test_no_division_by_parameters_unless_it_is_allowed(name: str):
    """Without permission to divide by parameters that may be 0, setup has no division."""
    tape = write_row(name, arm(), Reductions())
    setup, _ = hoist([tape], ports.PARAMETERS, ports.SETUP)
    constant_pivot = 1 if name == "EXP1" else 0  # the pendulum's inertia about its last axis, which is never 0
    assert sum(op.name == "DIV" for op, _, _ in setup.operations) <= constant_pivot + (name == "EXP2")


@pytest.mark.parametrize(
    ("name", "flops", "equations"), [("IMPL", 1, 1), ("EXP2", 1, 1), ("SEMI", 2, 2), ("EXP1", 3, 2)]
)
def test_cost_is_a_polynomial_of_the_number_of_bodies(name: str, flops: int, equations: int):
    """Table 1: differences of the given order are constant, three bodies at a time.

    An equation of the elimination holds all that is subtracted from one entry of M: there are n2 of them. In the
    order-N form, bodies that carry enough of others keep their mass; the rest, at the tip, is the same from 15 on.
    """
    first = 18 if name == "EXP2" else 9
    growth = grow(name, range(first, first + PERIOD * (flops + 4), PERIOD))
    assert (growth.degree("flops"), growth.degree("equations")) == (flops, equations)


def test_the_order_n_form_overtakes_elimination():
    """In flops, between 8 and 16 bodies, as for other codes."""
    one, two = (grow(name, range(6, 22, PERIOD)).counts for name in ("EXP1", "EXP2"))
    crossing = find_crossing(one, two)
    assert crossing is not None
    assert 8 <= crossing <= 16


def test_the_page_on_accuracy_has_the_flops_of_a_long_chain():
    """Most inertia stays in place there, which costs flops."""
    text = ARM.parents[1].joinpath("docs", "accuracy.md").read_text("utf-8")
    assert f"a chain of 50 takes {grow('EXP2', [50]).counts[50].paper} flops" in text


def test_what_grows_without_a_rule_has_no_degree():
    assert Growth("IMPL", {n: Counts({Op.ADD: 2**n}, n) for n in range(1, 8)}).degree("flops") is None
