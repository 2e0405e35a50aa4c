"""Expressions of a motion as functions: what they mean, and what they need."""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np
import pytest

from mbsgen.expressions import ExpressionError
from mbsrun.ocp.evaluation.backends.places import make_function
from mbsrun.ocp.ground.functions import Formula
from mbsrun.ocp.problem.problem import Representation
from mbsrun.ocp.transcription.layout import Motions
from mbsrun.ocp.transcription.quantities import formulate, list_quantities
from mbsrun.quantities import RARE
from tests.mbsrun.peer import Peer

Q, QD, QDD = np.random.default_rng(2).uniform(-1, 1, (3, 6))
U = np.random.default_rng(3).uniform(-1, 1, 4)
VALUES = {"q": Q, "qd": QD, "qdd": QDD, "u": U, "T": 2.0, "constants": [0.25, 3.0], "s": 0.75}


def formulate_of(
    texts: Sequence[str], constants: Sequence[str], arm: Peer, representation: Representation, horizon: float | None
) -> Formula:
    """Formulate expressions of a motion without loops."""
    every = tuple(range(6))
    computed = {"qdd": representation.equations.write()} if representation.is_ode else {}
    return formulate(texts, constants, arm.manifest, Motions(6, every, every, every, every), computed, horizon)


def evaluate(text: str, arm: Peer, representation: Representation, horizon: float | None) -> tuple[float, set[str]]:
    formula = formulate_of([text], ["a", "b"], arm, representation, horizon)
    inputs = [part.kind for part in formula.arguments]
    return float(make_function(formula, arm)(*(VALUES[name] for name in inputs))), set(inputs)


def test_every_quantity_is_what_its_name_says(arm: Peer) -> None:
    """Coordinates by index, inputs by actuated index, sensors by kernels."""
    position, v = arm("sensors", q=Q)["position"], arm("motion", q=Q, qd=QD)["v"]
    expected = {"t": 1.5, "T": 2.0}
    for i in range(6):
        expected |= {f"q_q{i + 1}": Q[i], f"qd_q{i + 1}": QD[i], f"qdd_q{i + 1}": QDD[i]}
    expected |= {f"u_q{i + 1}": U[i] for i in range(4)}
    for k, sensor in enumerate(("hand", "pendulum")):
        for i, axis in enumerate("xyz"):
            expected |= {f"{axis}_{sensor}": position[i, k], f"v{axis}_{sensor}": v[i, k]}
    found = list_quantities(arm.manifest)
    assert {name for name, x in found.items() if x.kind not in RARE} == set(expected)
    turns = {f"w{i}_{sensor}" for sensor in ("hand", "pendulum") for i in "xyz"}
    axes = {f"{i}{j}_{sensor}" for sensor in ("hand", "pendulum") for i in "xyz" for j in "xyz"}
    assert {name for name, x in found.items() if x.kind in RARE} == turns | axes  # test_orientations evaluates these
    for horizon in (2.0, None):
        for name, value in expected.items():
            assert evaluate(name, arm, Representation.IMPL, horizon)[0] == pytest.approx(value, rel=1e-14)


FUNCTIONS = {
    "sin(q_q1)*exp(-t) + cos(qd_q2)/b": np.sin(Q[0]) * np.exp(-1.5) + np.cos(QD[1]) / 3,
    "-(abs(q_q1) - a)**3*sqrt(T)": -((abs(Q[0]) - 0.25) ** 3) * np.sqrt(2),
    "atan2(q_q1, u_q4) + tanh(t) - log(b)**-2": np.arctan2(Q[0], U[3]) + np.tanh(1.5) - np.log(3) ** -2,
    "asin(a) + acos(a)*atan(b) - tan(pi/5)": np.arcsin(0.25) + np.arccos(0.25) * np.arctan(3) - np.tan(np.pi / 5),
    "max(q_q1, b) + min(q_q2, q_q3) + step(t, b) + softplus(-b, a)": (
        3 + min(Q[1], Q[2]) + 1 / (1 + np.exp(-0.5)) + np.log1p(np.exp(-12)) / 4
    ),
    "1": 1.0,
}


@pytest.mark.parametrize(("text", "value"), FUNCTIONS.items())
def test_functions_and_operators(arm: Peer, text: str, value: float) -> None:
    assert evaluate(text, arm, Representation.EXP1_A, None)[0] == pytest.approx(value, rel=1e-14)


def test_accelerations_of_an_ode_are_the_kernels(arm: Peer) -> None:
    """They are no variables there, so the expression needs what the kernel does."""
    qdd = arm("exp1", q=Q, qd=QD, u=U)["qdd"]
    value, inputs = evaluate("qdd_q2*a", arm, Representation.EXP1_O, 2.0)
    assert value == pytest.approx(qdd[1] * 0.25, rel=1e-12)
    assert inputs == {"q", "qd", "u", "constants"}


INPUTS = {
    "q_q1 + t": {"q", "s", "T"},
    "T": {"T"},
    "x_hand*a": {"q", "constants"},
    "vx_hand": {"q", "qd"},
    "u_q1*qdd_q1": {"u", "qdd"},
}


@pytest.mark.parametrize(("text", "inputs"), INPUTS.items())
def test_a_function_asks_for_what_it_needs(arm: Peer, text: str, inputs: set[str]) -> None:
    assert evaluate(text, arm, Representation.IMPL, None)[1] == inputs
    assert evaluate(text, arm, Representation.IMPL, 2.0)[1] - {"s"} == inputs - {"T", "s"}


def test_nothing_is_differentiated_by_constants_and_time(arm: Peer) -> None:
    formula = formulate_of(["a*q_q1**2*t"], ["a"], arm, Representation.IMPL, None)
    jacobian = make_function(formula, arm).jacobian()
    nonzeros = {part.kind: jacobian.sparsity_out(i).nnz() for i, part in enumerate(formula.arguments)}
    assert nonzeros == {"q": 1, "T": 1, "constants": 0, "s": 0}


@pytest.mark.parametrize("text", ["q_q7", "c", "u_q5", "__import__", "q_q1.real", "q_q1[0]", "exec(1)"])
def test_what_means_nothing_is_refused(arm: Peer, text: str) -> None:
    with pytest.raises(ExpressionError):
        formulate_of([text], ["a"], arm, Representation.IMPL, 1.0)


def test_a_formula_becomes_a_casadi_function(arm: Peer) -> None:
    formula = formulate_of(["x_hand", "q_q1*a"], ["a"], arm, Representation.IMPL, 1.0)
    function = make_function(formula, arm)
    assert isinstance(function, ca.Function)
    assert function.size_out(0) == (2, 1)


def test_names_are_written_as_expressions_can(arm: Peer) -> None:
    """Dots and spaces are _; what would then be another's name stays unsaid, what needs no change is itself."""
    names = ["a.b", "a b", "c.d", "c_d", "e.f", "g"]
    coordinates = tuple(c.model_copy(update={"name": n}) for c, n in zip(arm.manifest.coordinates, names, strict=True))
    known = list_quantities(arm.manifest.model_copy(update={"coordinates": coordinates}))
    assert {name: known[name].index for name in known if name.startswith("q_")} == {"q_c_d": 3, "q_e_f": 4, "q_g": 5}
