"""Differentiated parameters: derivatives by them, first and second, of every function that they enter."""

from __future__ import annotations

import pytest

from mbsgen.derivatives.dynamics import Dynamics
from mbsgen.derivatives.kernels import differentiable, differentiate
from mbsgen.formulations.catalogue import FUNCTIONS
from mbsgen.formulations.reductions import ALL
from mbsgen.model.changes.reduction import build_tree
from mbsgen.model.construction import body, differentiated, frame, make_model, revolute, runtime
from mbsgen.model.model import Model
from mbsgen.tape.interpreter import evaluate
from mbsgen.tape.types import Tape
from tests.mbsgen.derivatives.evaluation import all_of, differences, matrix

AT = {
    "q": [0.3, 0.4],
    "qd": [1.0, -0.5],
    "qdd": [0.2, 0.7],
    "u": [0.2],
    "theta": [1.0, 0.8],
    "p": [1.5],
    "adj_Phi": [0.6, -1.1],
    "adj_qdd": [0.6, -1.1],
    "adj_position": [0.1, 0.2, 0.3],
}


def rods() -> Model:
    """Two rods on crossed axes: a length and a mass are differentiated, another mass is left to the run time."""
    upper = body(
        "upper",
        joint=revolute("y"),
        mass="m1",
        com=(0, 0, "-l1/2"),
        inertia=("m1*l1**2/12", "m1*l1**2/12", 0),
    )
    lower = body(
        "lower",
        parent="upper",
        joint=revolute("x", position=(0, 0, "-l1"), actuated=False, armature="m2*l1/20"),
        mass="m2",
        com=(0, 0.1, -0.35),
        inertia=("m2/20", "m2/20", 0.01),
    )
    return make_model(
        "rods",
        [upper, lower],
        gravity=(0, 0, -9.81),
        parameters={"l1": differentiated(1.0), "m2": differentiated(0.8), "m1": runtime(1.5)},
        frames=[frame("tip", body="lower", position=(0, 0, -0.7))],
    )


@pytest.mark.parametrize("name", ["impl", "semi_res", "exp1", "exp2", "sensors"])
def test_derivatives_by_parameters_equal_differences(name: str):
    tree = build_tree(rods())
    tape = FUNCTIONS[name].build(tree, ALL)
    is_form = FUNCTIONS[name].is_form
    found = Dynamics(tree, ALL).differentiate(tape) if is_form else differentiate(tape, differentiable(tape))
    (result,) = (o.name for o in tape.outputs)
    jac, adj1, second = found.jac, found.adj1, found.jac_adj1
    values, at = evaluate_at(jac), {i.name: AT[i.name] for i in tape.inputs}
    expected = differences(tape, at, result, "theta")
    assert matrix(jac, f"jac_{result}_theta", values) == pytest.approx(expected, rel=1e-12, abs=1e-12)
    at |= {f"adj_{result}": AT[f"adj_{result}"]}
    for row in differentiable(tape):
        block = matrix(second, f"jac_adj_{row}_theta", evaluate_at(second))
        assert block == pytest.approx(differences(adj1, at, f"adj_{row}", "theta"), rel=1e-11, abs=1e-11)
    assert all(tape.input("theta") in derivative.inputs for derivative in all_of(found))


def evaluate_at(tape: Tape) -> dict[str, list]:
    return evaluate(tape, {i.name: AT[i.name] for i in tape.inputs})


def test_they_are_no_columns_of_other_models():
    tree = build_tree(rods())
    plain = differentiable(FUNCTIONS["impl"].build(tree, ALL))
    assert plain == ["q", "qd", "qdd", "u", "theta"]  # and not p, which is left to the run time


def test_expressions_of_parameters_are_differentiated_through():
    """Moments grow with the square of a length: the residual at rest is a polynomial of it."""
    tree = build_tree(rods())
    jac = Dynamics(tree, ALL).differentiate(FUNCTIONS["impl"].build(tree, ALL)).jac
    at = {i.name: AT[i.name] for i in jac.inputs} | {"q": [0.0, 0.0], "qd": [0.0, 0.0], "qdd": [1.0, 0.0]}
    slope = matrix(jac, "jac_Phi_theta", evaluate(jac, at))[0, 0]
    m1, m2, length, com = 1.5, 0.8, 1.0, 0.35
    assert slope == pytest.approx(2 * m1 * length / 3 + m2 * 2 * (length + com), rel=1e-13)
