"""Contacts of spheres on spheres: closed forms, symmetries, MuJoCo, derivatives, statuses, files, faults."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from mbsgen.assembly import assemble
from mbsgen.errors import InputError
from mbsgen.formulations import catalogue
from mbsgen.formulations.reductions import ALL
from mbsgen.manifest import FIRST_LENGTH
from mbsgen.model.changes.reduction import build_tree
from mbsgen.model.changes.releasing import with_runtime_numbers
from mbsgen.model.changes.scene import Scene, stage
from mbsgen.model.construction import body, contact, make_model, number, plane, prismatic, sphere
from mbsgen.model.tree import Kind
from mbsgen.model.writer import write_model
from mbsgen.procedure.procedure import straight
from mbsgen.tape import reverse
from mbsgen.tape.interpreter import find_failure
from tests.fuzz import mechanisms
from tests.mbsgen.model.pairs import REST, call, check_fault, find_drawn, make_pair, press, read

r, R, k = 0.1, 0.25, 1e4
LAW: dict[str, Any] = {"stiffness": k, "width": 1e-6}
WHOLE = """\
name: balls
gravity: [0, 0, -9.81]

parameters:
  big: {value: 0.25, kind: runtime}

bodies:
  - name: sled
    joint: {type: prismatic, axis: x, actuated: false}
    mass: 2

  - name: mast
    parent: sled
    joint: {type: revolute, axis: y}
    mass: 1
    com: [0, 0, 0.2]

  - name: plate
    joint: {type: fixed}

contacts:
  - {name: post, body: mast, position: [0, 0, 0.4], radius: 0.1, sphere: {radius: big, position: [0.3, 0, 0.4]}, stiffness: 1000}
  - name: pair
    body: mast
    position: [0.05, 0, 0.3]
    sphere: {body: sled, radius: 0.2, position: [0, 0.1, 0]}
    stiffness: 500
    exponent: 1
    dissipation: 0.4
    width: 0.05
    friction: {coefficient: 0.5, speed: 0.1}
"""  # noqa: E501


# --- closed forms -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("exponent", [1, 1.5, 2, 2.5, 3])
def test_an_overlap_has_its_force_along_the_centres(exponent: float) -> None:
    """stiffness overlap^exponent, from the other centre to the first one; nothing where they are apart."""
    tree = make_pair(contact("hit", "a", radius=r, other=sphere(R, "b"), exponent=exponent, **LAW))
    n = np.array([2, -1, 2]) / 3
    (F, M), (G, L) = press(tree, np.array([(r + R - 0.03) * n, (0, 0, 0)]), REST)
    assert pytest.approx(k * 0.03**exponent * n, rel=1e-6) == F
    assert pytest.approx(-F, rel=1e-14) == G
    assert pytest.approx(np.zeros((2, 3)), abs=1e-12) == np.array([M, L])
    assert np.abs(press(tree, np.array([(r + R + 0.03) * n, (0, 0, 0)]), REST)).max() < 1e-40


def test_friction_opposes_the_slip_of_the_points_that_touch() -> None:
    """Both spheres turn and move: v_t at p = (R c + r P)/(r + R); the moments are of the force about the centres."""
    touch = contact("hit", "a", radius=r, other=sphere(R, "b"), friction=(0.6, 0.01), **LAW)
    c, P = np.array([0.2, 0.1, 0.24]), np.array([0.0, 0.05, 0.0])
    V = np.array([0.3, -0.2, 0.1, 2.0, 1.0, -3.0, -0.1, 0.4, 0.2, 0.5, -1.0, 4.0])
    (F, M), (G, L) = press(make_pair(touch), np.array([c, P]), V)
    p, d = (R * c + r * P) / (r + R), np.linalg.norm(c - P)
    n, N = (c - P) / d, k * (r + R - d) ** 1.5
    v = V[:3] + np.cross(V[3:6], p - c) - V[6:9] - np.cross(V[9:], p - P)
    slip = v - (v @ n) * n
    assert pytest.approx(N * n - 0.6 * N * slip / np.sqrt(slip @ slip + 1e-4), rel=1e-5) == F
    assert pytest.approx(-F, rel=1e-12) == G
    assert pytest.approx(np.cross(p - c, F), rel=1e-10) == M
    assert pytest.approx(np.cross(p - P, G), rel=1e-10) == L


def test_either_sphere_may_be_called_the_other_one() -> None:
    touches = [
        contact("hit", first, radius=x, other=sphere(y, second), dissipation=0.3, friction=(0.6, 0.01), **LAW)
        for first, x, second, y in (("a", r, "b", R), ("b", R, "a", r))
    ]
    at, V = np.array([(0.2, 0.1, 0.24), (0.0, 0.05, 0.0)]), np.sin(np.arange(12))
    one, two = (press(make_pair(touch), at, V) for touch in touches)
    assert np.abs(one).min() > 0
    assert one == pytest.approx(two, rel=1e-12)


def test_a_large_sphere_is_a_plane() -> None:
    """A radius of 1e7 m: the surface bends by 1e-8 m at half a metre."""
    law = {**LAW, "dissipation": 0.3, "friction": (0.6, 0.01)}
    flat = contact("hit", "a", radius=r, other=plane("b", position=(0, 0, 0.1)), **law)
    bent = contact("hit", "a", radius=r, other=sphere(1e7, "b", position=(0, 0, 0.1 - 1e7)), **law)
    at, V = np.array([(0.0, 0.0, 0.17), (0.0, 0.0, 0.0)]), 0.3 * np.sin(np.arange(12))
    V[9:] = 0  # the centre of the large sphere would move at 1e7 m/s
    one, two = (press(make_pair(touch), at, V) for touch in (flat, bent))
    assert np.abs(one[:, 0]).min() > 0
    assert one == pytest.approx(two, rel=1e-6, abs=1e-6)


def test_contact_and_friction_take_energy_out_and_never_pull() -> None:
    """At random velocities: power relative to the elastic force at most 0, and no force towards the other centre."""
    law = {**LAW, "width": 1e-3, "dissipation": 0.7, "friction": (0.8, 0.01)}
    tree = make_pair(contact("hit", "a", radius=r, other=sphere(R, "b"), **law))
    at = np.array([(0.2, 0.1, 0.24), (0.0, 0.05, 0.0)])
    n = (at[0] - at[1]) / np.linalg.norm(at[0] - at[1])
    elastic = press(tree, at, REST)
    for V in np.random.default_rng(5).normal(size=(20, 12)):
        found = press(tree, at, V)
        assert (found - elastic).ravel() @ V <= 0
        assert found[0, 0] @ n >= 0


def test_distances_are_those_of_mujoco() -> None:
    """Between spheres apart, touching and one in the other, of random sizes at random places; derivatives too."""
    random = np.random.default_rng(3)
    for _ in range(10):
        x, y, c, P = *random.uniform(0.05, 0.6, 2), *random.normal(size=(2, 3)) * 0.4
        text = (
            f'<mujoco><worldbody><geom type="sphere" size="{x}" pos="{c[0]} {c[1]} {c[2]}"/>'
            f'<geom type="sphere" size="{y}" pos="{P[0]} {P[1]} {P[2]}"/></worldbody></mujoco>'
        )
        model = mujoco.MjModel.from_xml_string(text)
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        tree = make_pair(contact("hit", "a", radius=x, other=sphere(y, "b"), **LAW))
        q = np.concatenate([(*c, 0, 0, 0, 1), (*P, 0, 0, 0, 1)])
        assert call(tree, "distances", q=q)["distance"] == pytest.approx(
            [mujoco.mj_geomDistance(model, data, 0, 1, 10.0, None)], abs=1e-14
        )


# --- the same in every function, and elsewhere ------------------------------------------------------------------------


@pytest.mark.parametrize("numbers", ["given", "runtime", "zeros"])
@pytest.mark.parametrize("on_body", [False, True], ids=["base", "body"])
def test_all_functions_agree_with_virtual_power(numbers: str, on_body: bool, tmp_path: Path) -> None:
    """Drawn mechanisms, with the numbers of the file, and with others at run time; see tests/fuzz/forces.py."""
    seed = find_drawn(tmp_path, lambda touch: ("body" in touch["sphere"]) == on_body)
    assert mechanisms.examine(replace(mechanisms.draw(seed), numbers=numbers, tolerance=0.0), seed) == ""


def test_derivatives_are_differences(tmp_path: Path) -> None:
    """First and second derivatives of all functions, in 50 digits."""
    seed = find_drawn(tmp_path, lambda touch: "friction" in touch)
    assert mechanisms.examine(replace(mechanisms.draw(seed), reductions="all"), seed, derivatives=True) == ""


def test_formulations_agree(tmp_path: Path) -> None:
    """At the accelerations of EXP1 and EXP2, the residuals of IMPL and SEMI vanish."""
    tree = build_tree(read(WHOLE, tmp_path))
    at = {"q": [0.05, 0.3], "qd": [0.4, -1.2], "u": [0.7]}
    for fast in ("exp1", "exp2"):
        qdd = call(tree, fast, **at)["qdd"]
        for residual in ("impl", "semi_res"):
            assert call(tree, residual, **at, qdd=qdd)["Phi"] == pytest.approx([0, 0], abs=1e-10)


MEETING = """\
name: rig
gravity: [0, 0, -9.81]
bodies:
  - {name: sled, joint: {name: s, type: prismatic, axis: x}, mass: 2}
  - {name: mast, parent: sled, joint: {name: m, type: revolute, axis: y}, mass: 1, com: [0, 0, 0.2]}
MORE
forces:
  - {name: strut, from: {body: sled}, to: {body: base}, stiffness: 100, rest: 0.2, damping: 1}
contacts:
  - {name: ground, body: mast, stiffness: 100}
  - {name: peg, body: mast, position: [0, 0, 0.4], radius: 0.1, sphere: {radius: 0.1, position: [0.5, 0, 0.4]}, stiffness: 100}
"""  # noqa: E501
FOLLOWED = "  - {name: twin, joint: {name: t, type: prismatic, axis: x, follows: {joint: s, ratio: -1}}, mass: 1}"


@pytest.mark.filterwarnings("ignore::RuntimeWarning")  # values behind a guard that fails
@pytest.mark.parametrize("more", ["", FOLLOWED, "constraints:\n  - {name: cam, equation: s - 0.3*m**2}"])
def test_centres_that_coincide_are_a_status(more: str, tmp_path: Path) -> None:
    """All functions of forces and `distances` fail there; of the distances, a force element is no matter."""
    tree = assemble(build_tree(read(MEETING.replace("MORE", more), tmp_path)))
    names = ["impl", "semi_res", "exp1", "exp2", "power", "distances"]
    tapes = [straight(catalogue.FUNCTIONS[name].build(tree, ALL)) for name in names]
    tapes += [reverse.jacobian(tape, ["q"]) for tape in (tapes[0], tapes[-1])]
    for q, status in (([1.0, 0.3], 0), ([0.0, 0.3], FIRST_LENGTH), ([0.5, 0.0], FIRST_LENGTH + 1)):
        for tape in tapes:
            given = {i.name: [0.1] * i.sparsity.nnz for i in tape.inputs} | {"q": q}
            expected = 0 if "distances" in tape.name and status == FIRST_LENGTH else status
            assert find_failure(tape, given) == expected, tape.name


def test_a_scene_leaves_contacts_out_whose_bodies_do_not_move(tmp_path: Path) -> None:
    """With the mast locked, it stands on the sled: only the post is touched."""
    tree = build_tree(stage(read(WHOLE, tmp_path), Scene(locked=(("mast", number(0.1)),))))
    assert [x.name for x in tree.distances] == ["post"]


# --- files ------------------------------------------------------------------------------------------------------------


def test_what_is_written_reads_as_the_same_model(tmp_path: Path) -> None:
    model = read(WHOLE, tmp_path)
    assert read(write_model(model), tmp_path) == model


def test_python_makes_the_same_parts(tmp_path: Path) -> None:
    post = contact(
        "post", "mast", position=(0, 0, 0.4), radius=0.1, other=sphere("big", position=(0.3, 0, 0.4)), stiffness=1000
    )
    pair = contact(
        "pair",
        "mast",
        position=(0.05, 0, 0.3),
        other=sphere(0.2, "sled", position=(0, 0.1, 0)),
        stiffness=500,
        exponent=1,
        dissipation=0.4,
        width=0.05,
        friction=(0.5, 0.1),
    )
    assert read(WHOLE, tmp_path).contacts == (post, pair)


def test_numbers_of_spheres_become_parameters(tmp_path: Path) -> None:
    """With their values the forces are what they were; another radius is another model."""
    model = read(WHOLE, tmp_path)
    freed = with_runtime_numbers(model)
    added = {p.name for p in freed.parameters} - {p.name for p in model.parameters}
    assert {x for x in added if ".sphere." in x} == {
        "contacts.post.sphere.position.x",
        "contacts.post.sphere.position.z",
        "contacts.pair.sphere.position.y",
        "contacts.pair.sphere.radius",
    }
    at = {"q": [0.1, 0.2], "qd": [1, 2]}
    assert call(build_tree(freed), "impl", **at)["Phi"] == pytest.approx(
        call(build_tree(model), "impl", **at)["Phi"], rel=1e-12
    )
    tree = build_tree(freed)
    moved = [
        0.3 if x.name == "contacts.pair.sphere.radius" else x.value for x in tree.parameters if x.kind is Kind.RUNTIME
    ]
    larger = build_tree(read(WHOLE.replace("radius: 0.2", "radius: 0.3"), tmp_path))
    for name in ("impl", "distances"):
        found = call(tree, name, **at, p=moved)
        assert [*found.values()] == [pytest.approx(x, rel=1e-12) for x in call(larger, name, **at).values()]


# --- faults -----------------------------------------------------------------------------------------------------------

FAULTS = {  # old text, new text, path and piece of the finding
    "on nothing": ("{body: sled, r", "{body: sledge, r", "contacts[1].sphere.body", "no body"),
    "on the same body": ("{body: sled, r", "{body: mast, r", "contacts[1]", "both ends are on"),
    "on a body that stands": ("body: mast, position", "body: plate, position", "contacts[0]", "do not move relative"),
    "a radius below 0": ("radius: 0.2", "radius: -0.2", "contacts[1].sphere.radius", "found -0.2"),
    "a radius of 0": ("radius: 0.2", "radius: 0", "contacts[1].sphere.radius", "found 0"),
    "no radius": ("radius: 0.2, ", "", "contacts[1].sphere.radius", "missing"),
    "an unknown parameter": ("radius: 0.2", "radius: bog", "contacts[1].sphere.radius", 'unknown name "bog"'),
    "a place in the plane": ("[0.3, 0, 0.4]}", "[0.3, 0.4]}", "contacts[0].sphere.position", "list of 2"),
    "an unknown radius of a hollow one": (
        "radius: 0.2",
        "inside: true, radius: bog",
        "contacts[1].sphere.radius",
        'unknown name "bog"',
    ),
    "a hollow one that is too small": (
        "radius: big",
        "inside: true, radius: 0.05",
        "contacts[0].sphere.radius",
        "where the contact's own radius is",
    ),
    "an unknown key": ("radius: 0.2", "radius: 0.2, normal: z", "contacts[1].sphere.normal", "unknown key"),
    "a box": ("radius: 0.1", "size: [1, 1, 1]", "contacts[0].size", "corners miss a sphere"),
    "a plane too": ("    stiffness: 500", "    plane: {}\n    stiffness: 500", "contacts[1].sphere", "a plane and a"),
}


@pytest.mark.parametrize(("old", "new", "path", "finding"), FAULTS.values(), ids=FAULTS.keys())
def test_faults_are_found_where_they_are(old: str, new: str, path: str, finding: str, tmp_path: Path) -> None:
    check_fault(WHOLE, old, new, path, finding, tmp_path)


def test_python_refuses_what_a_file_may_not_say() -> None:
    bodies = [body("a", prismatic("z"), mass=1)]
    wrong = [contact("hit", "a", size=(1, 1, 1), other=sphere(0), stiffness=1)]
    with pytest.raises(InputError, match=r"corners miss a sphere.*; or exchange the sides: a contact with a radius"):
        make_model("pair", bodies, gravity=(0, 0, 0), contacts=wrong)
