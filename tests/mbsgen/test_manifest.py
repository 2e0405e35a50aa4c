"""The manifest: what it says of arguments and kernels without their names, and manifests of another format."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from mbsgen import manifest
from mbsgen.errors import InputError
from mbsgen.manifest import Manifest
from mbsgen.pipeline import Options, make
from mbsgen.roles import Axis, Order, Role, name_adjoint, name_derivative, name_kernel, split_kernel

PENDULUM = Path(__file__).parents[2] / "models" / "pendulum.yaml"


@pytest.fixture(scope="module")
def described() -> Manifest:
    return make(PENDULUM, Options(functions=("impl", "exp1", "sensors"), runtime=True)).manifest


def test_names_follow_from_functions_orders_and_roles(described: Manifest) -> None:
    """Nobody has to take a name apart: it follows from the manifest's entries."""
    assert {kernel.order for kernel in described.kernels} == set(Order)
    for kernel in described.kernels:
        assert kernel.name == name_kernel(kernel.base, kernel.order)
        assert split_kernel(kernel.name) == (kernel.base, kernel.order)
        for a in (*kernel.inputs, *kernel.outputs):
            names = {
                Role.DERIVATIVE: lambda a: name_derivative(a.of, a.by),
                Role.SEED: lambda a: name_adjoint(a.of),
                Role.ADJOINT: lambda a: name_adjoint(a.by),
            }
            assert a.name == names.get(a.role, lambda a: a.name)(a)
            assert (a.of is not None) == (a.role in (Role.DERIVATIVE, Role.SEED))
            assert (a.by is not None) == (a.role in (Role.DERIVATIVE, Role.ADJOINT))


def test_functions_are_found_by_what_they_take_and_give(described: Manifest) -> None:
    assert described.list_giving(Role.RESIDUAL) == ("impl",)
    assert described.list_giving(Role.ACCELERATION) == ("exp1",)
    assert described.setup is described.kernel("setup")
    impl, jac = described.find("impl"), described.find("impl", Order.JACOBIAN)
    assert impl is not None
    assert jac is not None
    assert impl.taking(Role.ACCELERATION)
    assert not impl.giving(Role.ACCELERATION)
    assert [(a.of, a.by) for a in jac.outputs] == [("Phi", x) for x in ("q", "qd", "qdd", "u")]
    assert {a.row_axis for a in jac.outputs} == {Axis.VELOCITIES}
    assert [a.col_axis for a in jac.outputs] == [Axis.COORDINATES, Axis.VELOCITIES, Axis.VELOCITIES, Axis.FORCES]
    assert described.find("semi") is None


def test_a_manifest_of_another_format_is_refused_in_one_sentence(described: Manifest, tmp_path: Path) -> None:
    file = tmp_path / manifest.FILE_NAME
    file.write_text(json.dumps({"format": manifest.FORMAT - 1, "kernels": [{}, {}]}))
    with pytest.raises(
        InputError, match=f"format {manifest.FORMAT - 1}, this mbsgen reads format {manifest.FORMAT}"
    ) as e:
        manifest.read(file)
    assert len(e.value.faults) == 1
    file.write_text(manifest.write(described))
    assert manifest.read(file) == described
