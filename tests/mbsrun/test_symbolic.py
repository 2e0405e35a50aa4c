"""`Mechanism.symbolic`: SymPy's equations have the values and derivatives of the compiled kernels."""

from __future__ import annotations

import random
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import sympy as sp

from mbsgen.equations import EvaluationError, Motion
from mbsgen.roles import Role
from mbsrun import Mechanism, load
from mbsrun.binding import Array
from mbsrun.kernel import ArgumentError
from mbsrun.models import Extent
from tests.shipped import FOLDER

OPTIONAL = ("loops", "loop_jacobian", "sensors")
EXTENT = Extent(("impl", "semi"), 1, optional=OPTIONAL, values=("semi", *OPTIONAL))  # `impl` alone is differentiated
SHAPES = {  # model: what it has
    "double_pendulum": "turns",
    "cart_pole": "a slide",
    "satellite": "a quaternion",
    "four_bar": "a planar loop",
    "slider_crank": "a loop with a slide, and an open wrench",
    "delta": "loops in space",
    "compressor": "a driven joint",
    "leg": "a joint that follows another one",
    "recorded/arm": "run-time parameters",
    "design/lifting_arm": "differentiated parameters, and a spring",
}
CRATE = """\
name: crate
gravity: [0, 0, -9.81]
parameters: {m: {value: 1.3, kind: runtime}, a: 0.4, k: 2*a, r: {value: 0.7, kind: runtime}, d: 3*r}
bodies:
  - name: slide
    joint: {name: x, type: prismatic, axis: [1, 0, 0.3], damping: d, force: "-k*softplus(q, 0.2)"}
    mass: 0.3
  - {name: crate, parent: slide, joint: {type: ball}, mass: m, com: [0.1, 0, r/7], inertia: [0.1, 0.2, 0.2]}
contacts:
  - {name: box, body: crate, size: [a, a/2, a/4], stiffness: 30, width: 0.1, friction: {coefficient: 0.8, speed: 0.1}}
"""
SPEED = {Role.COORDINATE: 0.7, Role.VELOCITY: 2.0}
TOLERANCE: dict[str, Any] = {"rtol": 1e-11, "atol": 1e-11}  # coefficients are printed with 15 digits, and terms cancel


def _draw(mechanism: Mechanism, name: str, seed: int = 5) -> dict[str, Array]:
    """Draw the inputs of a kernel, but its parameters."""
    draw = random.Random(seed)
    wanted = [a for a in mechanism.describe(name).inputs if a.role.is_differentiated and a.role is not Role.DESIGN]
    return {a.name: np.array([draw.uniform(-1, 1) * SPEED.get(a.role, 1) for _ in range(a.rows)]) for a in wanted}


def _check(mechanism: Mechanism, *, numbers: bool, by: Sequence[str] = ("q", "qd", "qdd", "u")) -> Motion:
    """Compare residual, M and c, Jacobians by some inputs, loops and sensors; return the equations."""
    equations, given = mechanism.symbolic(numbers=numbers), _draw(mechanism, "impl")

    def evaluate(value: sp.Matrix) -> Array:
        found: Array = equations.evaluate(value, **given)
        return found

    forms = mechanism.semi(**{a.name: given[a.name] for a in mechanism.describe("semi").inputs if a.name in given})
    slopes = mechanism.jac("impl", **given)
    np.testing.assert_allclose(evaluate(equations.residual)[:, 0], mechanism.impl(**given)["Phi"], **TOLERANCE)
    np.testing.assert_allclose(evaluate(equations.M), forms["M"], **TOLERANCE)
    for name in by:
        jacobian = equations.jacobian(equations.residual, getattr(equations.naming, name))
        if f"jac_Phi_{name}" in slopes:
            np.testing.assert_allclose(evaluate(jacobian), slopes[f"jac_Phi_{name}"], rtol=1e-9, atol=1e-9)
    if equations.naming.design:
        jacobian = equations.jacobian(equations.residual, equations.naming.design)
        np.testing.assert_allclose(evaluate(jacobian), slopes["jac_Phi_theta"], **TOLERANCE)
    names = {kernel.name for kernel in mechanism.manifest.kernels}
    if "loops" in names:
        np.testing.assert_allclose(evaluate(equations.h)[:, 0], mechanism.loops(q=given["q"])["gap"], **TOLERANCE)
        found = mechanism.loop_jacobian(q=given["q"], qd=given["qd"])
        np.testing.assert_allclose(evaluate(equations.J), found["J"], **TOLERANCE)
    if "sensors" in names:
        position = mechanism.sensors(q=given["q"])["position"]
        np.testing.assert_allclose(evaluate(equations.position), position, **TOLERANCE)
    return equations


@pytest.mark.parametrize("numbers", [False, True], ids=["names", "numbers"])
@pytest.mark.parametrize("name", SHAPES)
def test_equations_have_the_kernels_values(name: str, numbers: bool) -> None:
    _check(load(FOLDER / f"{name}.yaml", extent=EXTENT), numbers=numbers)


@pytest.mark.parametrize("name", ["double_pendulum", "satellite", "four_bar", "leg"])
def test_c_and_g_are_the_kernels_c(name: str) -> None:
    """Joints without force laws: the c of a kernel has no springs and no damping in it."""
    mechanism = load(FOLDER / f"{name}.yaml", extent=EXTENT)
    equations, given = mechanism.symbolic(), _draw(mechanism, "semi")
    found = equations.evaluate(equations.c + equations.g, **given)[:, 0]
    np.testing.assert_allclose(found, mechanism.semi(**given)["c"], **TOLERANCE)
    at_rest = mechanism.semi(**given | {"qd": np.zeros(len(given["qd"]))})
    np.testing.assert_allclose(equations.evaluate(equations.g, **given)[:, 0], at_rest["c"], **TOLERANCE)


@pytest.mark.parametrize("numbers", [False, True], ids=["names", "numbers"])
def test_contacts_springs_and_parameters_at_run_time(tmp_path: Path, numbers: bool) -> None:
    """The constant `d` follows the run-time parameter `r`, in the equations as in the kernels."""
    file = tmp_path / "crate.yaml"
    file.write_text(CRATE, encoding="utf-8")
    crate = load(file, extent=EXTENT)
    heavier = crate.with_parameters(m=2.5, r=-0.2)
    equations = _check(heavier, numbers=numbers, by=("qdd",) if numbers else ("qd", "u"))
    values = {symbol.name: number for symbol, number in equations.values.items()}
    assert values["m"] == 2.5
    assert values.get("d", -0.6) == pytest.approx(-0.6)


def test_every_number_may_be_a_symbol() -> None:
    arm = load(FOLDER / "double_pendulum.yaml", extent=Extent(("impl", "semi"), 1, runtime=True))
    changed = arm.with_parameters(**{next(iter(arm.parameters)): 0.31})
    for mechanism in (arm, changed):
        equations, given = mechanism.symbolic(numbers=True), _draw(mechanism, "impl")
        assert {symbol.name: number for symbol, number in equations.values.items()} == mechanism.parameters
        found = equations.evaluate(equations.residual, **given)[:, 0]
        np.testing.assert_allclose(found, mechanism.impl(**given)["Phi"], **TOLERANCE)


def test_what_has_no_equations_says_so(tmp_path: Path) -> None:
    file = tmp_path / "pendulum.yaml"
    shutil.copyfile(FOLDER / "pendulum.yaml", file)
    pendulum = load(file, extent=EXTENT)
    with pytest.raises(ArgumentError, match="load the file of its model"):
        load(pendulum.folder).symbolic()
    equations = pendulum.symbolic()
    with pytest.raises(EvaluationError, match="q has 1 entries; 2 are given"):
        equations.evaluate(equations.g, q=[0, 1])
    with pytest.raises(EvaluationError, match="no number for q1; give q"):
        equations.evaluate(equations.g)
    file.write_text(file.read_text(encoding="utf-8").replace("axis: y", "axis: x"), encoding="utf-8")
    with pytest.raises(ArgumentError, match="load it again"):
        pendulum.symbolic()


@pytest.mark.parametrize("numbers", [False, True], ids=["names", "numbers"])
def test_long_equations_have_intermediate_values(numbers: bool) -> None:
    mechanism = load(FOLDER / "six_axis.yaml", extent=EXTENT)
    assert _check(mechanism, numbers=numbers, by=("q", "qd")).named
