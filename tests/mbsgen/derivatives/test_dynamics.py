"""Derivatives of the formulations: every way of writing them gives the same, and what Pinocchio and mechanics say."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from mbsgen.derivatives import implicit, kernels, recursion
from mbsgen.derivatives.dynamics import Dynamics
from mbsgen.derivatives.kernels import Derivatives, differentiable
from mbsgen.formulations import exp1, exp2, impl, semi
from mbsgen.formulations.reductions import ALL, NONE, Reductions
from mbsgen.model.changes.reduction import build_tree
from mbsgen.model.reader import read_model
from mbsgen.model.tree import Tree
from mbsgen.roles import Order
from mbsgen.tape.counts import count
from mbsgen.tape.interpreter import evaluate
from mbsgen.tape.types import Tape
from tests.mbsgen.derivatives.evaluation import (
    EXACTLY,
    TO_ROUNDING,
    all_of,
    arguments,
    assert_pinocchios,
    assert_same,
    matrix,
)
from tests.random_trees import random_tree, with_laws, with_wrenches

MODELS = Path(__file__).parents[3] / "models"


def trees() -> Iterator[object]:
    """Yield trees of all shapes: both motions, branches, right and odd angles, wrenches and laws, run-time numbers."""
    yield pytest.param(random_tree(1, 4), TO_ROUNDING, id="odd angles")
    yield pytest.param(random_tree(4, 5, tidy=True), EXACTLY, id="right angles")
    yield pytest.param(with_laws(with_wrenches(random_tree(2, 3), 2)), TO_ROUNDING, id="driven")
    yield pytest.param(random_tree(3, 4, runtime=True), TO_ROUNDING, id="run time")
    yield from (pytest.param(model(name), EXACTLY, id=name) for name in ("branched", "double_pendulum"))


def model(name: str) -> Tree:
    return build_tree(read_model(MODELS / f"{name}.yaml"))


@pytest.mark.parametrize("reductions", [ALL, NONE], ids=["reduced", "plain"])
@pytest.mark.parametrize(("tree", "tolerance"), list(trees()))
def test_recursions_give_what_differentiated_tapes_give(tree: Tree, tolerance: float, reductions: Reductions):
    tape = impl.build(tree, reductions)
    expected = kernels.differentiate(tape, differentiable(tape))
    assert_same(recursion.expansion(tree, reductions), expected.lin, tolerance)
    assert_same(recursion.linearisation(tree, reductions), expected.lin, tolerance)
    assert_same(recursion.adjoint_jacobian(tree, reductions), expected.jac_adj1, tolerance)


@pytest.mark.parametrize("formulation", [exp1, exp2], ids=["exp1", "exp2"])
@pytest.mark.parametrize(("tree", "tolerance"), list(trees()))
def test_the_implicit_function_theorem_gives_what_differentiated_tapes_give(tree: Tree, tolerance: float, formulation):
    tape, value = formulation.build(tree), impl.build(tree)
    wrt = differentiable(tape)
    of_value, expected = kernels.differentiate(value, differentiable(value)), kernels.differentiate(tape, wrt)
    assert_same(implicit.jacobian(tape, of_value, wrt), expected.jac, tolerance)
    assert_same(implicit.linearisation(tape, of_value, wrt), expected.lin, tolerance)
    assert_same(implicit.adjoint(tape, of_value, wrt), expected.adj1, tolerance)
    assert_same(implicit.adjoint_jacobian(tape, of_value, wrt), expected.jac_adj1, tolerance)


def test_patterns_do_not_depend_on_the_way():
    tree = model("branched")
    dynamics = Dynamics(tree, ALL)
    for build in (impl.build, semi.build_residual, exp1.build, exp2.build):
        tape = build(tree)
        found, plain = dynamics.differentiate(tape), kernels.differentiate(tape, differentiable(tape))
        for a, b in zip(all_of(found), all_of(plain), strict=True):
            assert a.name == b.name
            assert a.inputs == b.inputs
            assert [(o.name, o.sparsity) for o in a.outputs] == [(o.name, o.sparsity) for o in b.outputs]


def test_pivots_of_m_have_the_guards_of_exp1_in_both_forms():
    """Where derivatives solve with M; derivatives of the tape of a form keep the guards of this form."""
    tree, value = random_tree(1, 3), impl.build(random_tree(1, 3))
    of_value = kernels.differentiate(value, differentiable(value))
    expected = [(g.joint, g.tolerance) for g in exp1.build(tree).guards]
    for build in (exp1.build, exp2.build):
        tape = build(tree)
        for write in (implicit.jacobian, implicit.linearisation, implicit.adjoint, implicit.adjoint_jacobian):
            derivative = write(tape, of_value, differentiable(tape))
            assert [(g.joint, g.tolerance) for g in derivative.guards] == expected


@pytest.mark.parametrize("seed", range(3))
def test_derivatives_of_the_accelerations_equal_pinocchios(seed: int):
    """Against computeABADerivatives, scaled by the condition of M."""
    tree = random_tree(seed, (4, 6, 9)[seed])
    found = Dynamics(tree, ALL).differentiate(exp2.build(tree)).jac
    assert_pinocchios(tree, found, seed)


def second(found: Derivatives, at: dict[str, list[float]], row: str, column: str) -> np.ndarray:
    return matrix(found.jac_adj1, f"jac_adj_{row}_{column}", evaluate(found.jac_adj1, at))


@pytest.mark.parametrize("seed", range(3))
def test_first_and_second_derivatives_obey_the_conditions_of_helmholtz(seed: int):
    """dPhi/dqd + (dPhi/dqd)T = 2 dM/dt, with the rate of M from second derivatives: lambdaT M differentiated by q."""
    tree = random_tree(seed, 6)
    found = Dynamics(tree, ALL).differentiate(impl.build(tree))
    at = arguments(found.jac_adj1, seed)
    by_qd = matrix(found.jac, "jac_Phi_qd", evaluate(found.jac, at))
    lam, qd = np.array(at["adj_Phi"]), np.array(at["qd"])
    rate = second(found, at, "q", "qdd").T @ qd
    assert (by_qd + by_qd.T) @ lam == pytest.approx(2 * rate, rel=1e-11, abs=1e-11 * np.abs(rate).max())


def test_flops_of_the_arm():
    """Below what CasADi's differentiation of a short Newton-Euler with base parameters takes: 2036, and 3342.

    Constants folded, divisions and square roots counted, unary minus, sines and cosines not.
    """
    tree = model("arm_pendulum")
    dynamics = Dynamics(tree, ALL, counted=True)
    of_impl, of_exp2 = (dynamics.differentiate(build(tree)) for build in (impl.build, exp2.build))
    assert count(of_impl.jac).arithmetic < 1100
    assert count(of_exp2.jac).arithmetic < 2150
    value, jac = count(impl.build(tree)).paper, count(of_impl.jac).paper
    assert count(of_impl.lin).paper < value + jac  # what both need is computed once
    made = [of_impl.count_ways((Order.JACOBIAN, Order.LINEARISATION)), of_exp2.count_ways((Order.JACOBIAN,))]
    assert [list(ways) for ways in made] == [["jac_impl", "lin_impl"], ["jac_impl", "jac_exp2"]]
    for name, found in (item for ways in made for item in ways.items()):
        if "recursion" in found and "tape" in found:
            assert found["recursion"] < found["tape"], name
        if "implicit" in found and "tape" in found:
            assert found["implicit"] < found["tape"], name
    plain = Dynamics(tree, ALL)  # writes what wins, and no tape's Jacobian
    for build, other in ((impl.build, of_impl), (exp2.build, of_exp2)):
        found = plain.differentiate(build(tree))
        assert found.jac == other.jac
        assert all("tape" not in ways for ways in found.count_ways((Order.JACOBIAN,)).values())


def test_adjoints_are_transposed_jacobians_applied():
    tree = random_tree(2, 4)
    tape = exp1.build(tree)
    found = Dynamics(tree, ALL).differentiate(tape)
    at = arguments(found.adj1, 1)
    J, adj = evaluate(found.jac, {k: v for k, v in at.items() if k != "adj_qdd"}), evaluate(found.adj1, at)
    for source in ("q", "qd", "u"):
        expected = matrix(found.jac, f"jac_qdd_{source}", J).T @ at["adj_qdd"]
        assert adj[f"adj_{source}"] == pytest.approx(expected, rel=1e-10, abs=1e-12)


@pytest.fixture(scope="module", params=[impl.build, exp2.build], ids=["impl", "exp2"])
def arm(request: pytest.FixtureRequest) -> tuple[Tape, Derivatives]:
    """The arm's residual, differentiated by recursion, and its accelerations, by the implicit function theorem."""
    tree = model("arm_pendulum")
    tape = request.param(tree)
    return tape, Dynamics(tree, ALL).differentiate(tape)


def column(tape: Tape, at: dict[str, list[float]]) -> np.ndarray:
    (values,) = evaluate(tape, at).values()
    return np.array(values)


def moved(at: dict[str, list[float]], along: dict[str, list[float]], h: float) -> dict[str, list[float]]:
    return {name: list(np.array(at[name]) + h * np.array(along[name])) for name in at}


def slope_of(tape: Tape, found: Derivatives, at: dict[str, list[float]], along: dict[str, list[float]]) -> np.ndarray:
    values, (result,) = evaluate(found.jac, at), (o.name for o in tape.outputs)
    return sum(matrix(found.jac, f"jac_{result}_{x}", values) @ np.array(along[x]) for x in differentiable(tape))


def test_the_arms_derivatives_equal_differences_of_fourth_order(arm: tuple[Tape, Derivatives]):
    """The V of the error over h has its bottom below 1e-10."""
    tape, found = arm
    at, along = arguments(tape, 1), arguments(tape, 2)
    exact = slope_of(tape, found, at, along)
    errors = []
    for h in (1e-2, 3e-3, 1e-3, 3e-4):
        a, b, c, d = (column(tape, moved(at, along, k * h)) for k in (-2, -1, 1, 2))
        errors.append(np.abs((a - 8 * b + 8 * c - d) / (12 * h) - exact).max() / np.abs(exact).max())
    assert min(errors) <= 1e-10


def test_the_arms_taylor_remainder_is_quadratic(arm: tuple[Tape, Derivatives]):
    """Slope 1.95 to 2.05 for h from 3e-2 to 3e-7, fitted where the remainder stands out of rounding."""
    tape, found = arm
    at, along = arguments(tape, 3), arguments(tape, 4)
    exact, here = slope_of(tape, found, at, along), column(tape, at)
    steps = 3.0 * 10.0 ** -np.arange(2, 8)
    rests = np.array([np.abs(column(tape, moved(at, along, h)) - here - h * exact).max() for h in steps])
    kept = rests > 1e3 * 2.0**-53 * np.abs(here).max()
    assert kept.sum() >= 3
    assert 1.95 <= np.polyfit(np.log(steps[kept]), np.log(rests[kept]), 1)[0] <= 2.05


def test_the_arms_hessians_are_symmetric_and_its_patterns_structural(arm: tuple[Tape, Derivatives]):
    tape, found = arm
    wrt = differentiable(tape)
    seen: dict[str, np.ndarray] = {}
    for seed in range(20):
        at = arguments(found.jac_adj1, seed)
        values = evaluate(found.jac_adj1, at)
        for row in wrt:
            for other in wrt:
                block = matrix(found.jac_adj1, f"jac_adj_{row}_{other}", values)
                mirror = matrix(found.jac_adj1, f"jac_adj_{other}_{row}", values)
                assert np.abs(block - mirror.T).max(initial=0.0) <= 1e-13 * max(1.0, np.abs(block).max(initial=0.0))
        jac = evaluate(found.jac, {i.name: at[i.name] for i in found.jac.inputs})
        for name, entries_found in jac.items():
            seen[name] = np.maximum(seen.get(name, 0), np.abs(np.array(entries_found, float)))
    assert all((peak > 0).all() for peak in seen.values())
