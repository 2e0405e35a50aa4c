"""Stops at limits of numbers of the pose: their meaning, refusals, and that they are written as they were read."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mbsgen.expressions import Number
from mbsgen.model.changes.locking import lock
from mbsgen.model.changes.reduction import build_tree
from mbsgen.model.changes.releasing import with_runtime_numbers
from mbsgen.model.changes.scene import Scene, stage
from mbsgen.model.construction import body, make_model, prismatic, stop
from mbsgen.model.model import Model
from mbsgen.model.reader import read_model
from mbsgen.model.writer import write_model
from mbsrun import load
from mbsrun.models import Extent
from tests.mbsgen.model.files import find_faults

TEXT = """name: rig
gravity: [0, 0, -9.81]
parameters: {l: {value: 1.2, kind: runtime}, k: 2e3}
bodies:
  - name: arm
    joint: {type: revolute, axis: y, actuated: false}
    mass: 1
    com: [0.5, 0, 0]
    inertia: [0.01, 0.1, 0.1]
  - name: fore
    parent: arm
    joint: {type: revolute, axis: [0, 0.6, 0.8], position: [1, 0, 0], actuated: false}
    mass: 0.5
    com: [0.3, 0, 0]
    inertia: [0.01, 0.02, 0.02]
  - {name: load, joint: {type: free}, mass: 1, inertia: [0.1, 0.2, 0.3]}
  - {name: twin, joint: {type: prismatic, axis: z, follows: {joint: arm, ratio: 0.5}}, mass: 1}
frames:
  - {name: tip, body: fore, position: [0.6, 0, 0], sensor: false}
  - {name: post, body: base, position: [0, 0, 1], sensor: false}
forces:
  - {name: rope, from: {body: fore, position: [0.6, 0, 0]}, to: {body: load, position: [0, 0.1, 0.1]}}
  - name: cord
    from: {body: base, position: [0, 0.3, 0.2]}
    via: [{body: arm, position: [0.3, 0, 0.1], shift: [0.1*q_fore, 0, 0]}]
    to: {body: load}
    wraps: [{type: cylinder, radius: 0.1, body: arm, position: [0.6, 0, -0.3], between: [1, 2]}]
    stiffness: 10
stops:
  - {name: tight, quantity: length_rope, limits: [null, l], restitution: 0.3}
  - {name: gear, quantity: q_arm - 2*q_fore**2 + q_twin, limits: [-1, 2], restitution: 0.5}
  - {name: ring, quantity: sqrt(x_tip**2 + y_tip**2 + z_tip**2), limits: [0.2, 1.5], stiffness: k, dissipation: 0.3}
  - {name: sum, quantity: length_cord - z_tip, limits: [0, 9], restitution: 0, hold: 3}
"""
GEAR = "quantity: q_arm - 2*q_fore**2 + q_twin, "

BAD: dict[str, tuple[str, str, str, str]] = {
    "restitution above 1": ("restitution: 0.5", "restitution: 1.5", "stops[1].restitution", "found 1.5"),
    "a restitution at run time": ("restitution: 0.5", "restitution: l", "stops[1].restitution", "l"),
    "both laws": ("restitution: 0.5", "restitution: 0.5, stiffness: 1", "stops[1]", "both"),
    "no law": (", restitution: 0.5", "", "stops[1]", "neither"),
    "rigid with dissipation": ("restitution: 0.5", "restitution: 0.5, dissipation: 1", "stops[1].dissipation", "rigid"),
    "no limit": ("limits: [-1, 2]", "limits: [null, null]", "stops[1].limits", "no limit"),
    "limits that cross": ("limits: [-1, 2]", "limits: [2, -1]", "stops[1].limits", "from 2 to -1"),
    "no room": ("limits: [-1, 2]", "limits: [2, 2]", "stops[1].limits", "from 2 to 2"),
    "a velocity": (GEAR, "quantity: qd_arm, ", "stops[1].quantity", "qd_arm is no number of the pose"),
    "the time": (GEAR, "quantity: q_arm + t, ", "stops[1].quantity", "t is no number of the pose"),
    "an unknown name": (GEAR, "quantity: q_harm, ", "stops[1].quantity", "q_harm"),
    "nothing that moves": (GEAR, "quantity: z_post, ", "stops[1].quantity", "z_post does not change"),
    "a name twice": ("name: gear", "name: sum", "stops[3].name", "taken"),
    "the name of a force": ("name: gear", "name: rope", "stops[1].name", "taken"),
    "no stiffness": ("stiffness: k", "stiffness: 0*k", "stops[2].stiffness", "found 0"),
    "a negative hold": ("hold: 3", "hold: -3", "stops[3].hold", "found -3"),
    "a latch that rebounds": ("restitution: 0.5", "restitution: 0.5, hold: 1", "stops[1].hold", "rebounds"),
    "a compliant latch": ("dissipation: 0.3", "dissipation: 0.3, hold: 1", "stops[2].hold", "not rigid"),
    "an idle rope": ("length_rope", "length_cord", "forces[0]", "without force"),
}


@pytest.fixture
def model(tmp_path: Path) -> Model:
    file = tmp_path / "model.yaml"
    file.write_text(TEXT, encoding="utf-8")
    return read_model(file)


@pytest.mark.parametrize("name", BAD)
def test_a_fault_has_a_place_and_a_finding(name: str, tmp_path: Path) -> None:
    old, new, path, piece = BAD[name]
    assert TEXT.count(old) == 1
    (fault,) = find_faults(TEXT.replace(old, new), tmp_path)
    assert (fault.path, piece in fault.finding) == (path, True), fault


def test_written_models_are_read_as_the_same(model: Model, tmp_path: Path) -> None:
    again = tmp_path / "again.yaml"
    again.write_text(write_model(model), encoding="utf-8")
    assert read_model(again) == model


def test_python_makes_the_same_model() -> None:
    made = make_model(
        "m",
        [body("a", prismatic("x"), mass=1), body("b", prismatic("y"), mass=1)],
        gravity=(0, 0, 0),
        stops=[stop("s", "q_a + q_b", (0, None), restitution=0.5)],
    )
    ((name, barrier),) = build_tree(made).rigid
    assert (name, barrier.restitution) == ("s.lower", 0.5)
    with pytest.raises(ValueError, match="restitution, stiffness"):
        stop("s", "q_a", (0, 1), bounce=0.5)


def test_each_limit_is_one_stop_and_compliant_ones_are_forces(model: Model) -> None:
    tree = build_tree(model)
    assert [name for name, _ in tree.rigid] == ["tight.upper", "gear.lower", "gear.upper", "sum.lower", "sum.upper"]
    assert tree.elements == ("rope", "cord")
    assert any(wrench.name == "ring" for wrench in tree.wrenches)


def test_locked_joints_are_numbers_of_the_stops(model: Model) -> None:
    """A stop at a number that no joint changes any more is left out."""
    held = lock(model, {"fore": Number(0.3)})
    assert "q_fore" not in str(held.stops[1].quantity)
    staged = stage(model, Scene(locked=(("fore", Number(0.3)), ("arm", Number(0.1)))))
    assert [x.name for x in staged.stops] == ["tight", "sum"]
    assert [name for name, _ in build_tree(staged).rigid] == ["tight.upper", "sum.lower", "sum.upper"]


def test_released_numbers_are_those_of_quantities_limits_and_compliant_stops(model: Model) -> None:
    released = with_runtime_numbers(model)
    known = {p.name for p in released.parameters}
    assert known >= {
        "stops.gear.1",
        "stops.gear.lower",
        "stops.gear.upper",
        "stops.ring.dissipation",
        "stops.sum.upper",
    }
    assert not any("restitution" in name for name in known)
    assert len(build_tree(released).rigid) == 5


def test_kernels_have_the_derivatives_of_the_numbers(tmp_path: Path) -> None:
    """By differences along the velocities, also of a rope around a cylinder, a follower and a free body."""
    file = tmp_path / "model.yaml"
    file.write_text(TEXT, encoding="utf-8")
    rig = load(file, extent=Extent(("touching", "rates", "impl"), 1))
    rng = np.random.default_rng(3)
    q = np.concatenate((rng.normal(size=2), [0.4, -0.5, -0.8], [0.1, 0.2, 0.3, 0.9]))
    q[-4:] /= np.linalg.norm(q[-4:])
    qd, h = rng.normal(size=8), 1e-5
    way = rig("rates", q=q, qd=qd)["rate"].ravel()
    near = [rig("touching", q=q + step * way)["clearance"].ravel() for step in (h, -h)]
    found = rig("touching", q=q)
    rates = found["slide"].reshape(-1, 3, 8) @ qd
    assert rates[:, 0] == pytest.approx((near[0] - near[1]) / (2 * h), abs=1e-8)
    assert not rates[:, 1:].any()
    assert found["direction"].tolist() == [[1.0] * 5, [0.0] * 5, [0.0] * 5]
