"""New functions of a tree: an entry each, and they are generated, verified, compiled, called and differentiated."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose

from mbsgen.formulations import catalogue, ports, textbook
from mbsgen.formulations.catalogue import SENSORS, Entry, Row, project
from mbsgen.formulations.chain import joint_forces, write_chain
from mbsgen.formulations.parsimony.elimination import factorise
from mbsgen.formulations.reductions import Reductions
from mbsgen.formulations.results import poses
from mbsgen.formulations.states import declare_state
from mbsgen.model.tree import Tree
from mbsgen.output import write_folder
from mbsgen.pipeline import Options, make
from mbsgen.roles import Order, Role
from mbsgen.tape.builder import Builder
from mbsgen.tape.ports import Port
from mbsgen.tape.replay import declare_inputs, replay
from mbsgen.tape.types import Tape
from mbsgen.verification import functions
from mbsgen.verification.functions import Comparison, Results, Truth
from mbsgen.verification.geometry import dot
from mbsrun.external import load

MODEL = Path(__file__).parents[2] / "models" / "double_pendulum.yaml"
SQUARE = Port("square", Role.RESULT, unit="m2", meaning="squared distance of the first sensor from the base")


def build_exp3(tree: Tree, _: Reductions) -> Tape:
    """Write qdd = M^-1 (Q - c), with M and c by columns of the textbook's residual."""
    builder = Builder()
    state = declare_state(tree, builder, accelerations=False)
    chain = write_chain(tree, builder, state)
    zero, one, n = builder.zero, builder.number(1.0), len(tree.bodies)
    rest = textbook.residual(chain, [zero] * n, [zero] * n)
    units = [textbook.residual(chain, [zero] * n, [one if i == j else zero for i in range(n)]) for j in range(n)]
    upper = {(i + 1, j + 1): units[j][i] - rest[i] for j in range(n) for i in range(j + 1)}
    bias = textbook.residual(chain, state.qd, [zero] * n)
    net = {i: Q - c for i, (Q, c) in enumerate(zip(joint_forces(chain), bias, strict=True), 1)}
    factors = factorise(builder, upper, n)
    for i in range(1, n + 1):
        builder.guard(factors.D[i], upper[i, i], 100.0, i)
    builder.output_dense(ports.ACCELERATIONS, [[x] for _, x in sorted(factors.solve(net).items())])
    return builder.build("exp3")


def build_square(tree: Tree, _: Reductions) -> Tape:
    """Write the squared distance of the first sensor from the base."""
    tape, builder = poses.build_sensors(tree), Builder()
    values = replay(tape, builder, declare_inputs(tape, builder))
    x, y, z = (values[v] for v in tape.output(ports.POSITION.name).values[:3])
    builder.output_dense(SQUARE, [[x * x + y * y + z * z]])
    return builder.build("square")


def expect_square(truth: Truth, _: Tape, results: Results) -> Iterator[Comparison]:
    place = truth.sensor(0).p
    yield Comparison(SQUARE.name, results[SQUARE.name], [dot(place, place)])


def test_a_new_formulation_and_a_new_function_are_an_entry_each(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Values and derivatives against a formulation and a pose that are there; CasADi takes the generated ones."""
    row = Row(driven=True, longest=6)
    exp3 = Entry(project(build_exp3), "toy", (ports.ACCELERATIONS,), order=2, is_form=True, row=row, same_as="exp1")
    square = Entry(project(build_square), "toy", (SQUARE,), order=1, needs=(SENSORS,))
    monkeypatch.setitem(catalogue.FUNCTIONS, "exp3", exp3)
    monkeypatch.setitem(catalogue.FUNCTIONS, "square", square)
    monkeypatch.setitem(functions.EXPECTATIONS, SQUARE, expect_square)

    made = make(MODEL, Options(functions=("impl", "exp1", "exp3", "sensors", "square")))
    assert made.manifest.list_giving(Role.ACCELERATION) == ("exp1", "exp3")
    assert {"exp3", "lin_exp3", "jac_adj1_exp3", "square", "jac_square"} <= made.report.verification.deviations.keys()
    assert "EXP3" in made.report.formulations
    assert made.report.ways["jac_exp3"].keys() == {"implicit", "tape"}
    checked = made.files["double_pendulum_check.c"]
    assert "mbs_check_accelerations(&face_exp3, &face_impl)" in checked
    assert "mbs_check_same_accelerations(&face_exp1, &face_exp3)" in checked

    write_folder(made.files, tmp_path / "out")
    plant = load(tmp_path / "out")
    state = {"q": np.array([0.3, -0.8]), "qd": np.array([0.5, 1.1]), "u": np.ones(len(plant.manifest.actuated))}
    assert_allclose(plant("exp3", **state)["qdd"], plant("exp1", **state)["qdd"], rtol=1e-12)
    for order, more in ((Order.JACOBIAN, {}), (Order.ADJOINT_JACOBIAN, {"adj_qdd": np.array([0.7, -0.4])})):
        found, expected = (plant(plant.manifest.find(x, order).name, **state, **more) for x in ("exp3", "exp1"))
        assert found.keys() == expected.keys()
        for name, block in expected.items():
            assert_allclose(found[name], block, rtol=1e-11, atol=1e-11)
    place = plant("sensors", q=state["q"])["position"][:, 0]
    assert_allclose(plant("square", q=state["q"])["square"], [place @ place], rtol=1e-13)

    q = ca.MX.sym("q", 2)
    slope = ca.Function("slope", [q], [ca.jacobian(plant.casadi("square")(q), q)])
    assert_allclose(np.array(slope(state["q"])), plant.jac("square", q=state["q"])["jac_square_q"], rtol=1e-14)
