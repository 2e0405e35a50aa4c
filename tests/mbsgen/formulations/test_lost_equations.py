"""Loops whose equations vanish as a whole: accelerations fail there, whichever way the mechanism is turned."""

from __future__ import annotations

from math import pi

import pytest

from mbsgen.assembly import assemble
from mbsgen.derivatives.dynamics import Dynamics
from mbsgen.formulations.catalogue import FUNCTIONS
from mbsgen.formulations.reductions import Reductions
from mbsgen.model.changes.reduction import build_tree
from mbsgen.model.construction import body, end, loop, make_model, prismatic, revolute, rod
from mbsgen.model.tree import Tree
from mbsgen.procedure.procedure import straight
from mbsgen.tape.interpreter import find_failure
from mbsgen.tape.types import Tape

FEW = Reductions(trials=1)
UNIFORM = (0.1, 0.1, 0.1)


def parallelogram() -> Tree:
    """Two cranks of 1 m and a coupler of 2 m: at an angle of 0 or pi all bars lie on one line, along x."""
    bodies = [
        body("crank", revolute("z"), mass=1.0, com=(0.5, 0, 0), inertia=UNIFORM),
        body("coupler", revolute("z", position=(1, 0, 0), actuated=False), parent="crank", mass=1.0, inertia=UNIFORM),
        body("rocker", revolute("z", position=(2, 0, 0), actuated=False), mass=1.0, com=(0.5, 0, 0), inertia=UNIFORM),
    ]
    pin = loop("pin", "ball", end("coupler", position=(2, 0, 0)), end("rocker", position=(1, 0, 0)))
    pose = {"crank": 1.0, "coupler": -1.0, "rocker": 1.0}
    return assemble(build_tree(make_model("bars", bodies, gravity=(0, -9.81, 0), loops=[pin], assembly=pose)))


def slider() -> Tree:
    """A crank of 1 m and a slider along x at a height of 0.5 m, by a rod of 0.5 m: all are in line at pi/2 and 0."""
    bodies = [
        body("crank", revolute("z"), mass=1.0, com=(0.5, 0, 0), inertia=UNIFORM),
        body("slider", prismatic("x", position=(0, 0.5, 0), actuated=False), mass=1.0),
    ]
    bar = rod("bar", end("crank", position=(1, 0, 0)), end("slider"), 0.5)
    pose = {"crank": 1.3, "slider": 0.4}
    return assemble(build_tree(make_model("slider", bodies, gravity=(0, -9.81, 0), loops=[bar], assembly=pose)))


CASES = {"parallelogram": (parallelogram, [pi, -pi, pi]), "rod in line": (slider, [pi / 2, 0.0])}


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("name", ["exp1", "exp2", "exp1_red"])
def test_accelerations_fail_where_a_row_of_the_jacobian_vanishes(case: str, name: str) -> None:
    """The row is rounding there, of the size of 1e-16: compared with itself alone, it looks like any other."""
    make, q = CASES[case]
    tree = make()
    assert _find_status(straight(FUNCTIONS[name].build(tree, FEW)), q) == len(q) + 1


@pytest.mark.parametrize("case", CASES)
def test_their_derivatives_fail_there_too(case: str) -> None:
    make, q = CASES[case]
    tree = make()
    dynamics = Dynamics(tree, FEW)
    found = dynamics.differentiate(straight(FUNCTIONS["exp1"].build(tree, FEW)))
    for tape in (found.jac, found.adj1, found.jac_adj1):
        assert _find_status(straight(tape), q) == len(q) + 1


@pytest.mark.parametrize("case", CASES)
def test_they_do_not_fail_nearby(case: str) -> None:
    make, q = CASES[case]
    tree = make()
    for name in ("exp1", "exp2"):
        assert (
            _find_status(straight(FUNCTIONS[name].build(tree, FEW)), [x + 1e-5 * (k + 1) for k, x in enumerate(q)]) == 0
        )


def _find_status(tape: Tape, q: list[float]) -> int:
    given = {i.name: q if i.name == "q" else [0.3] * i.sparsity.nnz for i in tape.inputs}
    return find_failure(tape, given)
