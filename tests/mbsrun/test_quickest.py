"""`exp`: the accelerations without a number are the quicker form, wherever a kernel is named."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import mbsrun
from mbsgen.pipeline import Options, generate
from mbsgen.request import OptionError
from mbsgen.roles import ACCELERATING, QUICKEST, Order
from mbsrun.external import Mechanism, OnDemand
from mbsrun.kernel import ArgumentError
from mbsrun.models import Extent

MODELS = Path(__file__).parents[2] / "models"


@pytest.fixture(scope="module", params=["double_pendulum", "arm_pendulum"])
def mechanism(request: pytest.FixtureRequest) -> Mechanism:
    return mbsrun.load(MODELS / f"{request.param}.yaml", extent=Extent((*ACCELERATING, "impl"), 1))


def test_the_quicker_form_is_taken(mechanism: Mechanism) -> None:
    """By the counts of the manifest, of which EXP2 wants a tenth fewer; derivatives are of the same form."""
    forms = {name: mechanism.describe(name).flops.paper for name in ACCELERATING}
    best = "exp2" if 10 * forms["exp2"] < 9 * forms["exp1"] else "exp1"
    assert mechanism.describe("exp").name == best
    assert mechanism.describe("jac_exp").name == f"jac_{best}"
    assert mechanism.manifest.kernel("lin_exp").base == best
    assert mechanism.manifest.find("exp", Order.ADJOINT) == mechanism.manifest.find(best, Order.ADJOINT)


def test_it_is_called_as_any_kernel(mechanism: Mechanism) -> None:
    """The accelerations solve the residual; and a batch, the Jacobian and CasADi's function are the form's own."""
    rng = np.random.default_rng(3)
    sizes = {a.name: a.rows for a in mechanism.describe("exp").inputs}
    state = {name: rng.uniform(-1, 1, size) for name, size in sizes.items()}
    own = mechanism.describe("exp").name
    found = mechanism.exp(**state)["qdd"]
    assert np.abs(mechanism.impl(**state, qdd=found)["Phi"]).max() < 1e-11
    assert np.array_equal(found, mechanism(own, **state)["qdd"])
    assert np.array_equal(mechanism.batch("exp", **state)[0]["qdd"], found)
    for name, block in mechanism.jac("exp", **state).items():
        assert np.array_equal(block, mechanism.jac(own, **state)[name])
    assert mechanism.casadi("exp").name() == mechanism.describe(own).symbol
    assert "exp" in dir(mechanism)


@pytest.mark.parametrize("name", ["double_pendulum", "arm_pendulum", "branched"])
def test_one_form_is_generated_where_it_is_asked_for_by_this_name(name: str, tmp_path: Path) -> None:
    """The form that is the quicker one where both are generated."""
    model = MODELS / f"{name}.yaml"
    both, one = (
        generate(model, tmp_path / str(k), Options(functions=functions, derivatives=0)).manifest
        for k, functions in enumerate((ACCELERATING, (QUICKEST,)))
    )
    written = [k for k in one.kernels if k.base != "setup"]
    assert [k.name for k in written] == [both.quickest[QUICKEST].name]


def test_a_scene_may_name_it(tmp_path: Path) -> None:
    scene = tmp_path / "scene.yaml"
    scene.write_text("functions: [exp, impl]\n", encoding="utf-8")
    manifest = generate(MODELS / "double_pendulum.yaml", tmp_path / "out", Options(scene=scene, derivatives=0)).manifest
    assert {kernel.base for kernel in manifest.kernels} - {*ACCELERATING} == {"impl"}
    assert len(manifest.kernels) == 2


def test_functions_on_demand_have_it() -> None:
    kernels = OnDemand(MODELS / "double_pendulum.yaml")
    assert kernels.describe("exp").base in ACCELERATING
    assert kernels.describe("jac_exp").order is Order.JACOBIAN


def test_a_folder_without_accelerations_says_so(tmp_path: Path) -> None:
    generate(MODELS / "double_pendulum.yaml", tmp_path / "out", Options(functions=("impl",), derivatives=0))
    kernels = mbsrun.load(tmp_path / "out")
    assert kernels.manifest.find("exp") is None
    with pytest.raises(ArgumentError, match="no kernel 'exp'"):
        kernels("exp", q=[0, 0], qd=[0, 0], u=[])
    with pytest.raises(OptionError, match="no function 'exq'"):
        generate(MODELS / "double_pendulum.yaml", tmp_path / "other", Options(functions=("exq",)))
