"""Bodies fixed together whose masses are parameters: right where they are 0 too, and no dearer than one body."""

from __future__ import annotations

from itertools import product
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from mbsgen.derivatives.dynamics import Dynamics
from mbsgen.drawing import pose
from mbsgen.formulations import exp2, impl
from mbsgen.formulations.reductions import ALL, NONE
from mbsgen.model.changes.reduction import build_tree
from mbsgen.model.reader import read_model
from mbsgen.model.tree import Tree
from mbsgen.pipeline import build_parametric, write_families
from mbsgen.request import Request
from mbsgen.tape.counts import count
from mbsgen.tape.interpreter import evaluate
from mbsgen.tape.types import Tape

TEXT = """\
name: compound
gravity: [0, 0.5, -9.81]
parameters:
  a: {a}
  b: {b}
bodies:
  - {{name: arm, joint: {{type: revolute, axis: z}}, mass: 2, com: [0.1, 0.02, 0], inertia: [0.1, 0.2, 0.2]}}
  - {{name: hand, parent: arm, joint: {{type: revolute, axis: y, position: [0.5, 0, 0]}}, mass: a, com: [0.2, 0, 0.1]}}
  - name: load
    parent: hand
    joint: {{type: fixed, position: [0.3, 0, 0.1], orientation: [{{axis: x, angle: 0.3}}]}}
    mass: b
    com: [0, 0.1, 0.2]
    inertia: [0.01*b, 0.02*b, 0.02*b]
  - name: tip
    parent: hand
    joint: {{type: revolute, axis: [1, 1, 0], position: [0.5, 0.1, 0]}}
    mass: 0.4
    com: [0.1, 0.02, 0.03]
    inertia: [0.1, 0.2, 0.2]
"""
STATE = {"q": [0.3, -0.4, 0.7], "qd": [0.5, 1.5, -0.8], "qdd": [1.2, -0.3, 0.4], "u": [0.1, 0.2, 0.3]}
MASSES = [*product((0.0, 1.5), (0.0, 0.7))]

Array = NDArray[np.float64]


def read(a: object, b: object, folder: Path) -> Tree:
    file = folder / "model.yaml"
    file.write_text(TEXT.format(a=a, b=b), encoding="utf-8")
    return build_tree(read_model(file))


def free(file: Path) -> Tree:
    return build_parametric(read_model(file))


def read_kind(kind: str, folder: Path) -> Tree:
    return read(*[f"{{value: 0, kind: {kind}}}"] * 2, folder)


def run(tape: Tape, **parameters: object) -> dict[str, Array]:
    given = {name: values for name, values in {**STATE, **parameters}.items() if name in {i.name for i in tape.inputs}}
    return {name: np.array(values, float) for name, values in evaluate(tape, given).items()}


@pytest.mark.parametrize("masses", MASSES)
@pytest.mark.parametrize("reductions", [ALL, NONE], ids=["reduced", "plain"])
def test_masses_at_run_time_may_be_0(masses: tuple[float, float], reductions: object, tmp_path: Path) -> None:
    """They give what the same numbers in the file give: 1e-13 is room for the rounding of some hundred operations."""
    numbers, opened = read(*masses, tmp_path), read_kind("runtime", tmp_path)
    for build in (impl.build, exp2.build):
        (found,) = run(build(opened, reductions), p=list(masses)).values()
        (expected,) = run(build(numbers, reductions)).values()
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-13 * np.abs(expected).max())
    jacobians = [
        run(Dynamics(tree, ALL).differentiate(impl.build(tree)).jac, p=list(masses)) for tree in (opened, numbers)
    ]
    for name, expected in jacobians[1].items():
        np.testing.assert_allclose(jacobians[0][name], expected, rtol=0, atol=1e-12, err_msg=name)


@pytest.mark.parametrize("masses", MASSES)
def test_a_force_is_linear_in_the_masses_from_0_on(masses: tuple[float, float], tmp_path: Path) -> None:
    """Phi(theta) = Phi(0) + dPhi/dtheta(0) theta: so derivatives by masses that are 0 are right."""
    tape = impl.build(read_kind("differentiated", tmp_path))
    jac = Dynamics(read_kind("differentiated", tmp_path), ALL).differentiate(tape).jac
    pattern = jac.output("jac_Phi_theta").sparsity
    slope = np.zeros((pattern.rows, pattern.cols))
    for place, value in zip(pattern.entries, run(jac, theta=[0, 0])["jac_Phi_theta"], strict=True):
        slope[place] = value
    expected = run(tape, theta=[0, 0])["Phi"] + slope @ masses
    np.testing.assert_allclose(run(tape, theta=list(masses))["Phi"], expected, rtol=0, atol=1e-13)


def test_a_compound_at_run_time_costs_what_one_body_costs(tmp_path: Path) -> None:
    """Its moments are sums, which `setup` forms."""

    def count_impl(tree: Tree) -> int:
        families = write_families(tree, Request(functions=("impl",), derivatives=0))
        return next(count(family.value).paper for family in families if family.value.name == "impl")

    text = TEXT.format(a=1.5, b=0.7)
    start, end = text.index("  - name: load"), text.index("  - name: tip")
    file = tmp_path / "single.yaml"
    file.write_text(
        text[:start].replace(
            "com: [0.2, 0, 0.1]", "com: [0.2, 0.1, 0.1], inertia: {xx: 1, yy: 1, zz: 1, xy: 0.1, xz: 0.1, yz: 0.1}"
        )
        + text[end:],
        encoding="utf-8",
    )
    read(1.5, 0.7, tmp_path)
    assert count_impl(free(tmp_path / "model.yaml")) <= count_impl(free(file))


def test_numbers_of_a_compound_become_parameters_by_the_names_of_its_bodies(tmp_path: Path) -> None:
    read_kind("runtime", tmp_path)
    freed = free(tmp_path / "model.yaml")
    names = {p.name for p in freed.parameters}
    assert {"hand.com.x", "hand.com.z", "load.position.x", "load.orientation.1", "load.com.y", "load.com.z"} <= names
    assert not {"hand.mass", "load.mass", "load.inertia.xx"} & names  # expressions over parameters
    values = [p.value for p in freed.parameters]
    expected = run(impl.build(read(0, 0, tmp_path)))["Phi"]
    np.testing.assert_allclose(run(impl.build(freed), p=values)["Phi"], expected, rtol=0, atol=1e-13)


def test_a_picture_shows_the_centre_of_a_compound_where_there_is_one(tmp_path: Path) -> None:
    heavy, light = pose(read(1.5, 0.7, tmp_path), [0, 0, 0]), pose(read_kind("runtime", tmp_path), [0, 0, 0])
    sine, cosine = np.sin(0.3), np.cos(0.3)
    load = np.array([0.8, 0.1 * cosine - 0.2 * sine, 0.1 + 0.1 * sine + 0.2 * cosine])
    np.testing.assert_allclose(heavy.centres[1], (1.5 * np.array([0.7, 0, 0.1]) + 0.7 * load) / 2.2, atol=1e-15)
    assert (heavy.masses[1], light.masses[1]) == (pytest.approx(2.2), 0)
    assert light.centres[1] == pytest.approx([0.5, 0, 0])
