"""Joints that follow sums of others, as in a differential: closed forms, and the same mechanism with a multiplier.

With a coefficient that may change at run time, the constraint remains an equation with a multiplier, in coordinates of
all joints. That model is computed by other code, and must move alike.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from mbsgen.errors import InputError
from mbsgen.formulations.catalogue import FUNCTIONS
from mbsgen.model.changes.reduction import build_tree
from mbsgen.model.construction import body, constraint, make_model, revolute
from mbsgen.model.tree import Tree
from mbsgen.pipeline import Options, make
from mbsgen.tape.counts import count
from mbsgen.tape.types import Tape
from tests.mbsgen.formulations.closed_mechanisms import ONE, read, run, spread
from tests.mbsgen.targets.compilation import Requires
from tests.mbsgen.targets.compilation import run as execute

Array = NDArray[np.float64]
CLOSE = 1e-11  # rounding of numbers up to 1e2, and solving with masses of condition 1e2
_MODEL = """
name: differential
gravity: [0, 0, -9.81]
parameters: {k: PARAMETER}
bodies:
  - {name: carrier, joint: {name: c, type: revolute, axis: y}, mass: 3, com: [0, 0, 0.05], inertia: [0.02, 0.03, 0.02]}
  - {name: left, joint: {name: l, type: revolute, axis: y, position: [0, 0.5, 0], actuated: false, damping: 0.2},
     mass: 4, com: [0.1, 0, 0], inertia: [0.1, 0.2, 0.1]}
  - {name: right, joint: {name: r, type: revolute, axis: y, position: [0, -0.5, 0], actuated: false, stiffness: 3},
     mass: 4, com: [0, 0, 0.1], inertia: [0.1, 0.2, 0.1]}
  - {name: arm, parent: right, joint: {name: a, type: revolute, axis: x, position: [0, 0, 0.4]}, mass: 2,
     com: [0, 0, 0.2], inertia: [0.1, 0.1, 0.05]}
constraints:
  - {name: bevel, equation: k*r + l - 2*c + 0.3}
independent: [c, l, a]
"""


def eliminated(k: float) -> Tree:
    """Return the differential in the coordinates c, l and a."""
    tree = read(_MODEL.replace("PARAMETER", str(k)))
    assert tree.coordinates == ("c", "l", "a")
    assert not tree.is_constrained
    return tree


def constrained() -> Tree:
    """Return the differential in the coordinates c, l, r and a, with an equation."""
    tree = read(_MODEL.replace("PARAMETER", "{value: 1, kind: runtime}"))
    assert tree.coordinates == ("c", "l", "r", "a")
    return tree


def states(k: float, seed: int) -> tuple[Array, dict[str, Array], dict[str, Array]]:
    """Return G, a state of the eliminated differential, and the same state of the constrained one."""
    rng = np.random.default_rng(seed)
    G = np.array([[1, 0, 0], [0, 1, 0], [2 / k, -1 / k, 0], [0, 0, 1]])
    y, yd, ydd, u = (rng.uniform(-2, 2, size) for size in (3, 3, 3, 2))
    own = {"q": y, "qd": yd, "qdd": ydd, "u": u}
    lam = rng.uniform(-5, 5, 1)
    whole = {"q": G @ y - [0, 0, 0.3 / k, 0], "qd": G @ yd, "qdd": G @ ydd, "u": u, "lam": lam, "p": np.array([k])}
    return G, own, whole | {"yd": yd, "ydd": ydd}


@pytest.mark.parametrize("k", [1.0, 1.3])
def test_accelerations_are_those_with_a_multiplier(k: float) -> None:
    """By elimination and by articulated bodies, and by the forms of the constrained model, the reduced one too."""
    one, other = eliminated(k), constrained()
    _, own, whole = states(k, 1)
    expected = run("exp1", other, whole)["qdd"][[0, 1, 3]]
    assert run("exp1_red", other, whole)["ydd"] == pytest.approx(expected, abs=CLOSE)
    for form in ("exp1", "exp2"):
        assert run(form, one, own)["qdd"] == pytest.approx(expected, abs=CLOSE)


@pytest.mark.parametrize("k", [1.0, 1.3])
def test_equations_are_those_with_a_multiplier_along_free_motions(k: float) -> None:
    """GT (Phi - Q - JT lam) does not depend on lam; the constraint has no acceleration without joints'."""
    one, other = eliminated(k), constrained()
    G, own, whole = states(k, 2)
    assert run("impl", one, own)["Phi"] == pytest.approx(G.T @ run("impl", other, whole)["Phi"], abs=CLOSE)
    assert run("impl_red", other, whole)["Phi"] == pytest.approx(run("impl", one, own)["Phi"], abs=CLOSE)
    M = spread("semi", one, own, "M")
    np.testing.assert_allclose(M, G.T @ spread("semi", other, whole, "M") @ G, rtol=0, atol=CLOSE)
    assert run("semi", one, own)["c"] == pytest.approx(G.T @ run("semi", other, whole)["c"], abs=CLOSE)
    for key, energy in run("energy", other, whole).items():
        assert run("energy", one, own)[key] == pytest.approx(energy, abs=CLOSE)
    assert run("loops", other, whole)["gap"] == pytest.approx(0, abs=CLOSE)
    assert run("loop_jacobian", other, whole).get("gamma", np.zeros(1)) == pytest.approx(0, abs=0)


def test_forces_of_the_constraint_have_no_power() -> None:
    G, _, whole = states(1.3, 3)
    forces = run("loop_forces", constrained(), whole)["Q"]
    assert np.abs(forces).max() > 0.1
    assert G.T @ forces == pytest.approx(0, abs=CLOSE)


@pytest.mark.parametrize("form", ["exp1", "exp2"])
def test_a_differential_shares_a_torque(form: str) -> None:
    """Three wheels with l + r = 2 c: the carrier's torque u gives the force 2 lam, with lam on both sides.

    lam = I_l l'' = I_r r'' and I_c c'' = u - 2 lam, hence lam (1/I_l + 1/I_r + 4/I_c) = 2 u/I_c.
    """
    inertia = {"c": 0.3, "l": 0.2, "r": 0.7}
    wheels = [
        body(name, revolute("z", name=name, actuated=name == "c"), mass=1, inertia=(1, 1, own))
        for name, own in inertia.items()
    ]
    tree = build_tree(make_model("d", wheels, gravity=(0, 0, -9.81), constraints=[constraint("bevel", "l + r - 2*c")]))
    lam = 2 * 5 / inertia["c"] / (1 / inertia["l"] + 1 / inertia["r"] + 4 / inertia["c"])
    found = run(form, tree, {"q": [0.1, 0.2], "qd": [3, -4], "u": [5]})["qdd"]
    by_hand = {"c": (5 - 2 * lam) / inertia["c"], "l": lam / inertia["l"], "r": lam / inertia["r"]}
    assert len(tree.coordinates) == 2
    assert found == pytest.approx([by_hand[name] for name in tree.coordinates], rel=1e-14)


def test_constant_rows_of_an_equation_cost_nothing() -> None:
    """With a run-time coefficient, J is read off, its derivatives vanish, and `close` solves without iteration."""
    tree = constrained()
    _, _, whole = states(1.3, 4)
    jacobian, closing = (FUNCTIONS[name].build(tree, ONE) for name in ("loop_jacobian", "close"))
    assert isinstance(jacobian, Tape)
    assert isinstance(closing, Tape)
    assert count(jacobian).paper == 0
    moved = run("close", tree, whole | {"q": whole["q"] + [0, 0, 3, 0]})["closed"]
    assert moved == pytest.approx(whole["q"], abs=CLOSE)


def test_a_whole_folder_agrees_with_itself(tmp_path: Path, requires: Requires) -> None:
    """All kernels with second derivatives are verified in 50 digits, and by the check program in C."""
    wheels = [
        body(name, revolute("z", name=name, actuated=name == "c"), mass=1, com=(0.1, 0, 0)) for name in ("c", "l", "r")
    ]
    model = make_model("d", wheels, gravity=(0, -9.81, 0), constraints=[constraint("bevel", "l + r - 2*c - 0.1")])
    product = make(model, Options(derivatives=2, reductions=ONE))
    for name, text in product.files.items():
        (tmp_path / name).write_text(text)
    assert [x.name for x in product.manifest.coordinates] == ["c", "l"]
    execute(requires("gcc"), "-std=c99", "-O0", *sorted(tmp_path.glob("*.c")), "-lm", "-o", tmp_path / "check")
    assert " 0 of " in f" {execute(tmp_path / 'check')}".replace("\n", "\n ")


def test_all_joints_driven_are_refused() -> None:
    text = _MODEL.replace("PARAMETER", "1").replace("independent: [c, l, a]", "driven: [c, l, r]")
    with pytest.raises(InputError, match="all joints in this equation are driven"):
        read(text.replace("name: c, type: revolute", "name: c, actuated: false, type: revolute"))
