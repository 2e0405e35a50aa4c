"""Laws of spheres as OpenSim has them: their formulas in numpy, derivatives, parameters, files, faults.

OpenSim's own numbers are in tests/mbsgen/importing/test_osim_contacts.py.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mbsgen.formulations import catalogue
from mbsgen.formulations.reductions import ALL
from mbsgen.model.changes.reduction import build_tree
from mbsgen.model.changes.releasing import with_runtime_numbers
from mbsgen.model.construction import contact, number, plane, sphere
from mbsgen.model.contact_laws import SphereLaw
from mbsgen.model.writer import write_model
from mbsgen.procedure.procedure import straight
from mbsgen.tape import reverse
from mbsgen.tape.interpreter import evaluate
from tests.mbsgen.model.pairs import Array, call, check_fault, make_pair, press, read

K, C, R, OTHER = 2e4, 0.6, 0.1, 0.25
MU, STATIC, VISCOUS, SPEED = 0.5, 0.9, 0.3, 0.2
LAWS = {
    "hunt_crossley": SphereLaw("hunt_crossley", number(STATIC), number(VISCOUS), share=number(0.3)),
    "smooth": SphereLaw("smooth", number(STATIC), number(VISCOUS)),
}
WHOLE = """\
name: foot
gravity: [0, 0, -9.81]
bodies:
  - {name: sled, joint: {name: s, type: prismatic, axis: x}, mass: 2}
  - {name: mast, parent: sled, joint: {name: m, type: revolute, axis: y}, mass: 1, com: [0, 0, 0.2]}
contacts:
  - name: heel
    body: mast
    position: [0.1, 0, 0.05]
    radius: 0.06
    stiffness: 20000
    dissipation: 0.6
    friction: {coefficient: 0.5, speed: 0.2}
    law: {type: smooth, static: 0.9, viscous: 0.3, share: 0.4, rounding: 1e-6, depth_slope: 200, speed_slope: 20}
  - {name: toe, body: mast, position: [0.2, 0, 0.05], radius: 0.06, stiffness: 20000, law: {type: hunt_crossley}}
  - {name: ball, body: mast, radius: 0.06, sphere: {radius: 0.1, position: [0, 0, -0.2]}, stiffness: 20000, law: {type: hunt_crossley, share: 0.3}}
"""  # noqa: E501


def compute_force(kind: str, gap: float, v: Array, n: Array) -> Array:
    """The formulas of Sherman and others (2011), and of Serrancoli and others (2019), written anew."""
    rate = v @ n
    if kind == "smooth":
        hertz = K * (gap**2 + 1e-5) ** 0.75 * (0.5 + 0.5 * np.tanh(-300 * gap))
        N = hertz * (1 - C * rate) * (0.5 + 0.5 * np.tanh(50 * (-rate + 1 / C)))
    else:
        N = K * max(-gap, 0) ** 1.5 * max(1 - C * rate, 0)
    across = v - rate * n
    slip = np.sqrt(across @ across + (1e-5 if kind == "smooth" else 0))
    w = slip / SPEED
    friction = min(w, 1) * (MU + 2 * (STATIC - MU) / (1 + w**2)) + VISCOUS * slip
    return np.asarray(N * n - N * friction * across / slip)


@pytest.mark.parametrize(
    ("kind", "side"), [("hunt_crossley", "plane"), ("hunt_crossley", "sphere"), ("smooth", "plane")]
)
def test_forces_are_those_of_the_formulas(kind: str, side: str) -> None:
    """Force and moment on both bodies, which move and turn, at a part of the depth; slow slips and fast ones."""
    law, share = LAWS[kind], 0.3 if kind == "hunt_crossley" else 0.5
    other = plane("b", position=(0, 0, 0.02), normal=(0, 0.6, 0.8)) if side == "plane" else sphere(OTHER, "b")
    touch = contact("hit", "a", radius=R, other=other, stiffness=K, dissipation=C, friction=(MU, SPEED), law=law)
    tree = make_pair(touch)
    n = np.array([0, 0.6, 0.8])
    for k, gap in enumerate((-0.03, -0.01, 0.004)):
        P = np.array([0.1, 0.05, -0.02])
        c = P + (gap + R) * n + ((0, 0, 0.02) if side == "plane" else OTHER * n)
        V = (1.0, 0.05, 3.0)[k] * np.sin(np.arange(12) + k)
        p = c - (R + share * gap) * n
        v = V[:3] + np.cross(V[3:6], p - c) - V[6:9] - np.cross(V[9:], p - P)
        F = compute_force(kind, gap, v, n)
        wanted = np.array([(F, np.cross(p - c, F)), (-F, np.cross(p - P, -F))])
        assert press(tree, np.array([c, P]), V) == pytest.approx(wanted, rel=1e-11, abs=1e-9)


def test_slopes_are_differences_near_and_far_from_contact(tmp_path: Path) -> None:
    """And finite where nothing touches, at rest, and where slip begins."""
    tree = build_tree(read(WHOLE, tmp_path))
    tape = straight(catalogue.FUNCTIONS["impl"].build(tree, ALL))
    slopes = reverse.jacobian(tape, ["q", "qd"])
    rest: dict[str, Any] = {i.name: [0.0] * i.sparsity.nnz for i in tape.inputs}
    h = 1e-6
    for q, qd in (([0.3, 0.02], [0.4, 0.3]), ([0.1, -0.3], [0.0, 0.0]), ([0.2, 0.1], [0.1, -0.4])):
        at = rest | {"q": q, "qd": qd}
        found = evaluate(slopes, at)
        for name in ("q", "qd"):
            for k in range(2):
                moved = [evaluate(tape, at | {name: [*np.array(at[name]) + way * h * np.eye(2)[k]]}) for way in (1, -1)]
                wanted = (np.array(moved[0]["Phi"]) - np.array(moved[1]["Phi"])) / (2 * h)
                own = np.array(found[f"jac_Phi_{name}"]).reshape(2, 2)  # dense, in columns
                assert own[k] == pytest.approx(wanted, rel=1e-5, abs=1e-4)


def test_numbers_of_a_law_become_parameters(tmp_path: Path) -> None:
    """With their values the forces are what they were."""
    model = read(WHOLE, tmp_path)
    freed = with_runtime_numbers(model)
    added = {p.name for p in freed.parameters}
    assert {"contacts.heel.law.static", "contacts.heel.law.speed_slope", "contacts.ball.law.share"} <= added
    assert "contacts.toe.law.static" not in added
    at = {"q": [0.1, 0.1], "qd": [1, 2]}
    trees = [build_tree(x) for x in (freed, model)]
    one, two = (call(tree, "impl", **at)["Phi"] for tree in trees)
    assert one == pytest.approx(two, rel=1e-12)


def test_what_is_written_reads_as_the_same_model(tmp_path: Path) -> None:
    model = read(WHOLE, tmp_path)
    assert read(write_model(model), tmp_path) == model


FAULTS = {  # old text, new text, path and piece of the finding
    "of a point": ("    radius: 0.06\n", "", "contacts[0].law", "not of a sphere on a plane or a sphere"),
    "of a box": ("sphere: {radius: 0.1,", "box: {size: [1, 1, 1],", "contacts[2].law", "not of a sphere on a plane"),
    "smooth": ("{type: hunt_crossley, share", "{type: smooth, share", "contacts[2].law", "a smooth law of two spheres"),
    "exponent": ("dissipation: 0.6", "exponent: 1", "contacts[0].exponent", "the exponent beside a law"),
    "width": ("dissipation: 0.6", "width: 1e-3", "contacts[0].width", "the width beside a law"),
    "rigid": ("stiffness: 20000, law: {type: hunt_crossley}", "restitution: 0, law: {type: hunt_crossley}",
              "contacts[1].law", "the law of a rigid contact"),
    "friction": ("    friction: {coefficient: 0.5, speed: 0.2}\n", "", "contacts[0].friction", "missing"),
    "share": ("share: 0.4", "share: 1.4", "contacts[0].law.share", "more than 1"),
    "static": ("static: 0.9", "static: -0.9", "contacts[0].law.static", "found -0.9"),
    "slope": ("depth_slope: 200", "depth_slope: 0", "contacts[0].law.depth_slope", "found 0"),
    "type": ("{type: smooth, static", "{type: smoth, static", "contacts[0].law.type", "smoth"),
}  # fmt: skip


@pytest.mark.parametrize(("old", "new", "path", "finding"), FAULTS.values(), ids=FAULTS.keys())
def test_faults_are_found_where_they_are(old: str, new: str, path: str, finding: str, tmp_path: Path) -> None:
    check_fault(WHOLE, old, new, path, finding, tmp_path)
