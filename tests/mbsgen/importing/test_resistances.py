"""Damping of joints with several freedoms, in URDF, SDF and MJCF: the forces that it adds to the equations of motion.

A damped ball resists by a moment -d omega, and a slide by a force -d v: by virtual power, T^T d T qd resists the
coordinates, where T qd are the velocities in the moving frame. The matrices are from `tests.import_peers`, and are not
the importer's.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mbsgen.importing import Choices, import_model
from mbsgen.model.changes.reduction import build_tree
from mbsgen.model.model import Model
from mbsgen.pipeline import write_families
from mbsgen.request import Request
from mbsgen.tape.interpreter import evaluate
from tests.import_peers import strip_forces, turn_rates
from tests.mbsgen.importing.urdf_files import joint, link, write

DAMPING = 4.0
STATES = np.random.default_rng(0).uniform(-1.2, 1.2, (3, 3, 6))


def find_resistance(model: Model, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> np.ndarray:
    """Return what the forces of the joints add to the residual."""
    found = []
    for one in (model, strip_forces(model)):
        families = write_families(build_tree(one), Request(functions=("impl",)))
        (tape,) = (tape for family in families for tape in family.tapes if tape.name == "impl")
        given = {"q": q, "qd": qd, "qdd": qdd, "u": np.zeros(len(q))}
        sizes = {i.name: i.sparsity.nnz for i in tape.inputs}
        values = {name: list(given[name][:size]) for name, size in sizes.items()}
        found.append(np.array(evaluate(tape, values)["Phi"], float))
    return found[0] - found[1]


def expect(kind: str, q: np.ndarray, qd: np.ndarray) -> np.ndarray:
    """Return T^T d T qd."""
    T = np.eye(len(q))
    if kind in ("spherical", "ball", "floating"):
        T[-3:, -3:] = turn_rates(*q[-3:])
    return DAMPING * T.T @ T @ qd


SIZES = {"planar": 3, "spherical": 3, "floating": 6}


@pytest.mark.parametrize("kind", SIZES)
@pytest.mark.parametrize("place", ["first", "on a moving link"])
def test_damping_of_joints_with_several_freedoms_in_urdf(kind: str, place: str, tmp_path: Path) -> None:
    """As in MuJoCo and Drake: the same along and about each axis."""
    losses = f'<axis xyz="0 1 0"/><dynamics damping="{DAMPING}"/>'
    inner = link("left-arm") + link("b") + joint("j", kind, "left-arm", "b", losses)
    if place != "first":
        inner += link("root") + joint("k", "continuous", "root", "left-arm")
    imported = import_model(write(tmp_path, inner))
    told = [notice.text for notice in imported.notices]
    assert "damping and friction of 1 joint are part of the equations; Pinocchio's recursions have none" in told
    before = 0 if place == "first" else 1
    for q, qd, qdd in STATES[..., : SIZES[kind]]:
        at = [np.concatenate([np.full(before, 0.3), values]) for values in (q, qd, qdd)]
        found = find_resistance(imported.model, *at)
        np.testing.assert_allclose(found[before:], expect(kind, q, qd), atol=1e-12)
        assert np.abs(found[:before]).max(initial=0) <= 1e-12


@pytest.mark.parametrize("kind", ["ball", "planar", "universal"])
def test_joints_of_drake_are_read_in_urdf(kind: str, tmp_path: Path) -> None:
    losses = f'<dynamics damping="{" ".join([str(DAMPING)] * (3 if kind == "planar" else 1))}"/>'
    moving = joint("j", kind, "a", "b", losses).replace("joint name", "drake:joint name").replace("</j", "</drake:j")
    imported = import_model(write(tmp_path, link("a") + link("b") + moving))
    assert not [notice for notice in imported.notices if notice.alters]
    size = 2 if kind == "universal" else 3
    for q, qd, qdd in STATES[..., :size]:
        np.testing.assert_allclose(find_resistance(imported.model, q, qd, qdd), expect(kind, q, qd), atol=1e-12)


def test_damping_of_a_ball_in_sdf(tmp_path: Path) -> None:
    path = tmp_path / "ball.sdf"
    path.write_text(
        '<sdf version="1.9"><model name="m"><link name="b"><inertial><pose>0.1 0.2 0.3 0 0 0</pose></inertial></link>'
        '<joint name="j" type="ball"><parent>world</parent><child>b</child>'
        f"<axis><dynamics><damping>{DAMPING}</damping></dynamics></axis></joint></model></sdf>",
        encoding="utf-8",
    )
    model = import_model(path).model
    for q, qd, qdd in STATES[..., :3]:
        np.testing.assert_allclose(find_resistance(model, q, qd, qdd), expect("ball", q, qd), atol=1e-12)
    (notice,) = (n.text for n in import_model(path, Choices(quaternions=True)).notices if n.alters)
    assert notice == "damping of a joint with a quaternion is left out"


@pytest.mark.parametrize(
    ("kind", "losses", "choices", "text"),
    [
        ("spherical", 'friction="2"', Choices(), "dry friction of 2 of a joint of several freedoms is left out"),
        ("floating", 'damping="2"', Choices(quaternions=True), "damping and friction of a joint with a quaternion"),
        ("planar", 'armature="2"', Choices(), "the rotor of a joint of several freedoms is left out"),
        ("revolute", 'damping="2" stiffness="3"', Choices(), "a spring, which is left out"),
    ],
)
def test_losses_that_are_left_out_are_warned_of(
    kind: str, losses: str, choices: Choices, text: str, tmp_path: Path
) -> None:
    inner = link("a") + link("b") + joint("j", kind, "a", "b", f"<dynamics {losses}/>")
    found = [n.text for n in import_model(write(tmp_path, inner), choices).notices if n.alters]
    assert any(one.startswith(text) for one in found)


def test_losses_of_zero_are_no_part_of_the_equations(tmp_path: Path) -> None:
    """Whatever way 0 is written; a fixed joint loses nothing either."""
    zero = '<dynamics damping="0.0" friction="0e-3"/>'
    inner = link("a") + link("b") + link("c") + joint("j", "continuous", "a", "b", zero)
    inner += joint("k", "fixed", "b", "c", '<dynamics damping="3"/>')
    assert not any("part of the equations" in n.text for n in import_model(write(tmp_path, inner)).notices)


@pytest.mark.parametrize("kind", ["ball", "free"])
def test_balls_and_free_bodies_of_mjcf_are_damped(kind: str, tmp_path: Path) -> None:
    """As MuJoCo's passive forces; a joint in the base of a tree, or on a body that moves."""
    inertial = '<inertial pos="0.1 0 0.2" mass="1.5" diaginertia="0.02 0.03 0.025"/>'
    own = f'<joint type="{kind}" damping="{DAMPING}"/>{inertial}'
    inner = f'<body name="b" pos="0 0.3 0" euler="10 20 30">{own}</body>'
    before = 0 if kind == "free" else 1
    if before:
        inner = f'<body name="a"><joint name="k"/>{inertial}{inner}</body>'
    path = tmp_path / "machine.xml"
    path.write_text(f"<mujoco><worldbody>{inner}</worldbody></mujoco>")
    imported = import_model(path)
    assert not [notice for notice in imported.notices if notice.alters]
    for q, qd, qdd in STATES[..., : 6 if kind == "free" else 3]:
        at = [np.concatenate([np.full(before, 0.3), values]) for values in (q, qd, qdd)]
        expected = [*[0.0] * before, *expect("floating" if kind == "free" else kind, q, qd)]
        np.testing.assert_allclose(find_resistance(imported.model, *at), expected, atol=1e-12)
    path.write_text(path.read_text().replace(f'damping="{DAMPING}"', 'damping="4 0 1"'))
    assert any("second and third order" in x.text for x in import_model(path).notices if x.alters)
    path.write_text(path.read_text().replace("<world", '<option><flag damper="disable"/></option><world', 1))
    imported = import_model(path)
    assert not [notice for notice in imported.notices if notice.alters]
    np.testing.assert_allclose(find_resistance(imported.model, *at), 0, atol=1e-14)
    quaternion = import_model(path.with_name("machine.xml"), Choices(quaternions=True))
    assert not [notice for notice in quaternion.notices if notice.alters]
