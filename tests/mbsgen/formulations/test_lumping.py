"""Masses lumped by run-time parameters: what divides by 0 is a status, and all else is what the others compute."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mbsgen.families import write_families
from mbsgen.formulations import ports
from mbsgen.formulations.reductions import ALL, Reductions
from mbsgen.model.reader import read_model
from mbsgen.model.tree import Tree
from mbsgen.pipeline import build_parametric
from mbsgen.request import Request
from mbsgen.tape.counts import count
from mbsgen.tape.interpreter import FLOATS, Numbers, evaluate, find_failure
from mbsgen.tape.types import Op, Tape
from tests.random_trees import values_of

MODELS = Path(__file__).parents[3] / "models"
LUMPED = Reductions(lump_runtime=True)
FORMS = ("impl", "semi", "exp1", "exp2")
HARDWARE = Numbers(np.float64, FLOATS.functions, FLOATS.epsilon)  # divides by 0 as C does
TOLERANCE = 1e-9  # of the largest result; a moved mass may be ten times the mechanism's


def read(name: str) -> Tree:
    return build_parametric(read_model(MODELS / f"{name}.yaml"))


def write(tree: Tree, reductions: Reductions, derivatives: int) -> dict[str, Tape]:
    """Write the formulations, with their setup."""
    options = Request(functions=FORMS, derivatives=derivatives, reductions=reductions)
    return {tape.name: tape for family in write_families(tree, options) for tape in family.tapes}


def attempt(
    tapes: Mapping[str, Tape], name: str, p: list[float], at: Mapping[str, Any]
) -> dict[str, list[float]] | int:
    """Compute what a kernel gives after `setup`, or the status of either."""
    with np.errstate(all="ignore"):
        given = {ports.PARAMETERS.name: [np.float64(x) for x in p]}
        if failed := find_failure(tapes["setup"], given, HARDWARE):
            return failed
        inputs = {**at, ports.SETUP.name: evaluate(tapes["setup"], given, HARDWARE)[ports.SETUP.name]}
        inputs = {i.name: inputs[i.name] for i in tapes[name].inputs}
        return find_failure(tapes[name], inputs, HARDWARE) or evaluate(tapes[name], inputs, HARDWARE)


@pytest.mark.parametrize(
    ("model", "derivatives"), [("double_pendulum", 2), ("arm_pendulum", 0)], ids=["double pendulum", "arm"]
)
def test_a_parameter_of_zero_is_a_status_or_makes_no_difference(model: str, derivatives: int) -> None:
    """Each parameter in turn, and none: where the lumped kernels give numbers, they equal the other kernels'."""
    tree = read(model)
    lumped, plain = (write(tree, reductions, derivatives) for reductions in (LUMPED, ALL))
    rng = np.random.default_rng(3)
    at = {i.name: rng.uniform(0.2, 1.2, i.sparsity.nnz) for tape in plain.values() for i in tape.inputs}
    statuses = []
    for zero in range(-1, len(values_of(tree))):
        p = [0.0 if k == zero else x for k, x in enumerate(values_of(tree))]
        for name in plain.keys() - {"setup"}:
            found, expected = attempt(lumped, name, p, at), attempt(plain, name, p, at)
            statuses.append(found)
            if isinstance(found, dict):
                assert isinstance(expected, dict)
                for result, values in expected.items():
                    largest = max(map(abs, values), default=0.0)
                    np.testing.assert_allclose(found[result], values, rtol=0, atol=TOLERANCE * max(1.0, largest))
        if zero < 0:
            assert all(isinstance(x, dict) for x in statuses)
    assert any(isinstance(x, int) for x in statuses)


def test_every_division_by_parameters_is_guarded_in_the_setup() -> None:
    """All divisors of the setup have a guard, except pivots, which kernels test themselves."""
    setup = write(read("arm_pendulum"), LUMPED, 0)["setup"]
    assert sum(op is Op.DIV for op, _, _ in setup.operations) > 1
    guarded = {guard.joint for guard in setup.guards}
    assert guarded
    assert all(guard.early for guard in setup.guards)
    assert count(setup).guards


def test_lumping_saves_flops_and_is_done_only_where_it_is_asked_for() -> None:
    tree = read("arm_pendulum")
    lumped, plain = (write(tree, reductions, 0) for reductions in (LUMPED, ALL))
    for name in FORMS:
        assert count(lumped[name]).paper < count(plain[name]).paper
    assert not plain["setup"].guards
