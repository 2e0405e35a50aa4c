"""The regressor of the bodies' inertias: against Pinocchio, a pendulum's closed form, and the residual itself."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from numpy.typing import NDArray

from mbsgen.families import write_families
from mbsgen.formulations.catalogue import FUNCTIONS
from mbsgen.formulations.reductions import ALL
from mbsgen.formulations.results import regressor
from mbsgen.model.changes.reduction import build_tree
from mbsgen.model.construction import ball, body, make_model, revolute
from mbsgen.model.tree import Tree
from mbsgen.procedure.procedure import straight
from mbsgen.request import Request
from mbsgen.roles import MOMENTS
from mbsgen.tape.interpreter import evaluate
from mbsgen.verification.verify import verify
from tests.random_scenes import random_model
from tests.random_trees import Pinocchio, floats, random_tree

Array = NDArray[np.float64]
THEIRS = ("m", "Sx", "Sy", "Sz", "Jxx", "Jxy", "Jyy", "Jxz", "Jyz", "Jzz")  # Pinocchio's order


def write(tree: Tree, q: Sequence[float], qd: Sequence[float], qdd: Sequence[float]) -> Array:
    tape = straight(FUNCTIONS["regressor"].build(tree, ALL))
    given = {"q": list(q), "qd": list(qd), "qdd": list(qdd)}
    more = {i.name: [p.value for p in tree.parameters] for i in tape.inputs if i.name in ("p", "theta")}
    (output,) = tape.outputs
    values = evaluate(tape, {i.name: (given | more)[i.name] for i in tape.inputs})["Y"]
    Y = np.zeros((output.sparsity.rows, output.sparsity.cols))
    Y[tuple(zip(*output.sparsity.entries, strict=True))] = values
    return Y


@pytest.mark.parametrize(("seed", "size"), [(1, 3), (2, 6), (5, 9)])
def test_the_regressor_is_pinocchios(seed: int, size: int):
    import pinocchio as pin

    tree = random_tree(seed, size, tidy=seed % 2 == 0)
    rng = np.random.default_rng(seed)
    q, qd, qdd = rng.uniform(-2, 2, (3, size))
    peer = Pinocchio(tree)
    state = (np.array([x[i] for i in np.argsort(peer.order)]) for x in (q, qd, qdd))
    theirs = np.array(pin.computeJointTorqueRegressor(peer.model, peer.data, *state))[peer.order]
    place = [THEIRS.index(name) for name in MOMENTS]
    Y = write(tree, q, qd, qdd)
    for i, link in enumerate(tree.bodies):
        if not regressor.has_inertia(link):
            continue
        own = theirs[:, 10 * peer.order[i] : 10 * peer.order[i] + 10][:, place]
        turned = turn(floats(tree, link.axes))
        found = Y[:, 10 * i : 10 * i + 10]
        assert found == pytest.approx(own @ turned, abs=1e-13 * size * max(1, np.abs(own).max()))


def turn(R: Array) -> Array:
    """Return the map from moments along the columns of R to moments along the axes of the frame."""
    columns = []
    for k in range(10):
        unit = np.eye(10)[k]
        S, J = R @ unit[1:4], np.zeros((3, 3))
        J[np.triu_indices(3)] = unit[4:]
        J = R @ (J + np.triu(J, 1).T) @ R.T
        columns.append([unit[0], *S, *J[np.triu_indices(3)]])
    return np.array(columns).T


def test_a_pendulum_feels_its_moments_as_in_the_closed_form():
    """Phi = J_yy qdd - g (S_x cos q + S_z sin q) about y, with gravity along -z and the body along x."""
    rod = body("rod", revolute("y"), mass=1, com=(0.5, 0, 0), inertia=(0.0, 0.1, 0.1))
    tree = build_tree(make_model("pendulum", [rod], gravity=(0, 0, -9.81)))
    q, qdd = 0.4, 3.0
    Y = dict(zip(MOMENTS, write(tree, [q], [2.0], [qdd])[0], strict=True))
    expected = dict.fromkeys(MOMENTS, 0.0)
    expected |= {"Jyy": qdd, "Sx": -9.81 * np.cos(q), "Sz": -9.81 * np.sin(q)}
    assert pytest.approx(expected, abs=1e-13) == Y


def test_bodies_between_joints_have_no_columns_and_a_ball_has():
    bodies = [
        body("upper", ball(), mass=1, com=(0.1, 0, 0.2), inertia=(0.1, 0.1, 0.1)),
        body("lower", revolute("x"), parent="upper", mass=2, com=(0, 0, 0.2), inertia=(0.1, 0.1, 0.1)),
    ]
    tree = build_tree(make_model("two", bodies, gravity=(0, 0, -9.81)))
    (output,) = regressor.build(tree).outputs
    assert {c // 10 for _, c in output.sparsity.entries} == {2, 3}


@pytest.mark.parametrize("seed", [3, 4])
def test_value_and_adjoint_are_verified_and_other_derivatives_left_out(seed: int):
    tree = build_tree(random_model(seed, 4))
    families = write_families(tree, Request(functions=("regressor",)))
    names = [f.name for family in families for f in family.functions]
    assert set(names) - {"setup"} == {"regressor", "adj1_regressor"}
    assert not verify(tree, families, still=False).unchecked
