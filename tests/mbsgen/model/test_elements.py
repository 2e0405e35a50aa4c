"""Force elements, contacts and forces that read the state: closed forms, dissipation, files, faults."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from mbsgen.assembly import assemble
from mbsgen.errors import InputError
from mbsgen.formulations import catalogue, exp2, impl
from mbsgen.formulations.reductions import ALL
from mbsgen.formulations.results import poses
from mbsgen.manifest import FIRST_LENGTH
from mbsgen.model.changes.reduction import build_tree
from mbsgen.model.changes.releasing import with_runtime_numbers
from mbsgen.model.changes.scene import Scene, stage
from mbsgen.model.construction import body, cable, contact, end, frame, make_model, plane, prismatic, spring, wrench
from mbsgen.model.tree import Kind, Tree
from mbsgen.model.writer import write_model
from mbsgen.procedure.procedure import straight
from mbsgen.tape import reverse
from mbsgen.tape.interpreter import evaluate, find_failure
from tests.fuzz import mechanisms
from tests.mbsgen.model.pairs import check_fault, read

MASS, GRAVITY = 2.0, 9.81

WHOLE = """\
name: rig
gravity: [0, 0, -9.81]

parameters:
  k: 400
  mu: {value: 0.8, kind: runtime}

bodies:
  - name: sled
    joint: {type: prismatic, axis: x, actuated: false}
    mass: 2

  - name: mast
    parent: sled
    joint: {type: revolute, axis: y, force: -3*(q - 2*q_sled)}
    mass: 1
    com: [0, 0, 0.2]

  - name: plate
    joint: {type: fixed}

frames:
  - {name: tip, body: mast, position: [0, 0, 0.4]}
  - {name: probe, body: mast, position: [0, 0, 0.3], sensor: false}

wrenches:
  - {name: drag, body: mast, position: [0, 0, 0.4], frame: base, force: [-mu*vx_tip*abs(vx_probe), 0, qd_sled]}

forces:
  - {name: strut, from: {body: sled}, to: {body: base, position: [0, 0, 1]}, stiffness: k, rest: 0.9, damping: 2}
  - {name: rope, type: cable, from: {body: mast}, to: {body: base}, stiffness: k, dissipation: 0.1, width: 0.01}
  - {name: muscle, from: {body: mast}, to: {body: base}, force: 2*length*rate - q_mast}

contacts:
  - {name: ball, body: mast, position: [0, 0, 0.4], radius: 0.1, plane: {normal: -z}, stiffness: k}
  - name: box
    body: sled
    orientation: [{axis: z, angle: pi/4}]
    size: [0.4, 0.2, 0.1]
    stiffness: 10000
    exponent: 1
    dissipation: 0.4
    width: 0.001
    friction: {coefficient: mu, speed: 0.01}
"""


def make_ball(**law: object) -> Tree:
    """A sphere of radius 0.1 that moves up and down, and along x, above the ground."""
    lift = body("lift", prismatic("z", actuated=False), mass=0)
    ball = body("ball", prismatic("x", actuated=False), parent="lift", mass=MASS)
    touch = contact("touch", "ball", radius=0.1, **{"stiffness": 1e4, "width": 1e-6, **law})  # type: ignore[arg-type]
    return build_tree(make_model("drop", [lift, ball], gravity=(0, 0, 0), contacts=[touch]))


def push(tree: Tree, q: Sequence[float], qd: Sequence[float]) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """Return the joint forces of all forces: minus the residual at rest, without gravity."""
    n = len(q)
    runtime = [x.value for x in tree.parameters if x.kind is Kind.RUNTIME]
    u = [0.0] * sum(joint.actuated for joint in tree.joints)
    given = {"q": list(q), "qd": list(qd), "qdd": [0.0] * n, "u": u, "p": runtime}
    tape = impl.build(tree)
    return -np.array(evaluate(tape, {i.name: given[i.name] for i in tape.inputs})["Phi"])


# --- closed forms -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("exponent", [1, 1.5, 2, 2.5, 3])
def test_a_body_at_rest_sinks_by_the_root_of_its_weight(exponent: float) -> None:
    """stiffness depth^exponent = m g, except for the width, 1e-6 m."""
    depth = (MASS * GRAVITY / 1e4) ** (1 / exponent)
    N = push(make_ball(exponent=exponent, dissipation=0.3, friction=(0.8, 0.01)), [0.1 - depth, 0.0], [0.0, 0.0])
    assert pytest.approx([MASS * GRAVITY, 0], rel=1e-6) == N


def test_a_linear_contact_lasts_half_a_period_and_returns_the_speed() -> None:
    """pi sqrt(m/k), by the classical Runge-Kutta method."""
    tape = exp2.build(make_ball(exponent=1), ALL)

    def slope(z: float, v: float) -> tuple[float, float]:
        return v, evaluate(tape, {"q": [z, 0.0], "qd": [v, 0.0], "u": []})["qdd"][0]

    period, z, v, t = math.pi * math.sqrt(MASS / 1e4), 0.1, -1.0, 0.0
    h = period / 400
    while z < 0.1 or t == 0:
        k1 = slope(z, v)
        k2 = slope(z + h / 2 * k1[0], v + h / 2 * k1[1])
        k3 = slope(z + h / 2 * k2[0], v + h / 2 * k2[1])
        k4 = slope(z + h * k3[0], v + h * k3[1])
        z += h / 6 * (k1[0] + 2 * k2[0] + 2 * k3[0] + k4[0])
        v += h / 6 * (k1[1] + 2 * k2[1] + 2 * k3[1] + k4[1])
        t += h
    assert t - (z - 0.1) / v == pytest.approx(period, rel=2e-4)
    assert v == pytest.approx(1.0, rel=2e-4)


def test_contact_and_friction_take_energy_out_and_never_pull() -> None:
    """Where the ball approaches, N is above the elastic force; where it leaves, between 0 and it; friction brakes."""
    tree = make_ball(dissipation=0.7, friction=(0.8, 0.01), width=1e-3)
    elastic = push(tree, [0.08, 0.0], [0.0, 0.0])[0]
    for rate in (-3.0, -0.2, 1e-3, 0.4, 2.0, 50.0):
        for slip in (-2.0, 0.0, 1e-3, 0.3):
            N, T = push(tree, [0.08, 0.0], [rate, slip])
            assert N >= 0
            assert (N - elastic) * rate <= 0
            assert pytest.approx(-0.8 * N * slip / math.hypot(slip, 0.01), rel=1e-12) == T
    assert push(tree, [0.08, 0.0], [-0.5, 0.0])[0] == pytest.approx(elastic * 1.35, rel=1e-5)  # Hunt and Crossley
    assert push(tree, [0.2, 0.0], [-0.5, 1.0]) == pytest.approx([0, 0], abs=1e-40)  # 100 widths away


def test_a_sphere_rolls_where_it_touches(tmp_path: Path) -> None:
    """A wheel that rolls without slip has no friction, though its centre moves; its point of contact is at rest."""
    text = """\
name: wheel
gravity: [0, 0, 0]
bodies:
  - {name: axle, joint: {type: prismatic, axis: x, position: [0, 0, 0.29], actuated: false}, mass: 1}
  - {name: wheel, parent: axle, joint: {type: revolute, axis: y, actuated: false}, mass: 1, inertia: [1, 1, 1]}
contacts: [{name: tyre, body: wheel, radius: 0.3, stiffness: 1e4, friction: {coefficient: 1, speed: 1e-3}}]
"""
    tree = build_tree(read(text, tmp_path))
    assert push(tree, [0.2, 0.7], [0.6, 2.0]) == pytest.approx([0, 0], abs=1e-10)
    N = 1e4 * 0.01**1.5
    assert push(tree, [0.2, 0.7], [1.6, 2.0]) == pytest.approx([-N, 0.3 * N], rel=1e-5)


def test_springs_and_cables_have_the_tension_of_their_equations() -> None:
    """Two masses on the z axis, 0.5 and 0.8 up: each is pulled to the other by T, along the line."""
    low, high = (body(name, prismatic("z", actuated=False), mass=1) for name in ("low", "high"))
    ends = end("low"), end("high")

    def pull(q: Sequence[float], qd: Sequence[float], *elements: object) -> float:
        model = make_model("pair", [low, high], gravity=(0, 0, 0), forces=elements)  # type: ignore[arg-type]
        found = push(build_tree(model), q, qd)
        assert found[0] == pytest.approx(-found[1], rel=1e-14)
        return float(found[0])

    near, taut, slack = [0.5, 0.8], [0.5, 1.3], [0.5, 0.6]
    assert pull(near, [0, 0], spring("s", *ends, stiffness=7)) == pytest.approx(7 * 0.3)
    assert pull(near, [1, 3], spring("s", *ends, stiffness=7, rest=0.5, damping=0.2)) == pytest.approx(-1.4 + 0.4)
    assert pull(near, [1, 3], spring("s", *ends, force="length**2 - rate*q_low")) == pytest.approx(0.09 - 1)
    rope = cable("s", *ends, stiffness=100, rest=0.4, dissipation=0.2, width=1e-3)
    assert pull(taut, [0, 1], rope) == pytest.approx(40 * 1.2, rel=1e-5)
    assert 0 <= pull(taut, [0, -100], rope) < 1e-80
    assert 0 <= pull(slack, [0, 5], rope) < 1e-80


MEETING = """\
name: rig
gravity: [0, 0, -9.81]
bodies:
  - {name: sled, joint: {name: s, type: prismatic, axis: x}, mass: 2}
  - {name: mast, parent: sled, joint: {name: m, type: revolute, axis: y}, mass: 1, com: [0, 0, 0.2]}
MORE
forces:
  - {name: soft, from: {body: sled}, to: {body: base, position: [1, 0, 0]}, stiffness: 10}
  - {name: strut, from: {body: sled}, to: {body: base}, stiffness: 100, rest: 0.2, damping: 1}
  - {name: link, from: {body: mast, position: [0, 0, 0.4]}, to: {body: base, position: [0.5, 0, 0.4]}, force: 3}
"""
FOLLOWED = "  - {name: twin, joint: {name: t, type: prismatic, axis: x, follows: {joint: s, ratio: -1}}, mass: 1}"


@pytest.mark.filterwarnings("ignore::RuntimeWarning")  # values behind a guard that fails
@pytest.mark.parametrize("more", ["", FOLLOWED, "constraints:\n  - {name: cam, equation: s - 0.3*m**2}"])
def test_a_force_element_whose_points_meet_is_a_status(more: str, tmp_path: Path) -> None:
    """All functions of forces fail there, and at no other place; a spring of length 0 at rest has a limit."""
    tree = assemble(build_tree(read(MEETING.replace("MORE", more), tmp_path)))
    names = ["impl", "semi_res", "exp1", "exp2", "power"]
    tapes = [straight(catalogue.FUNCTIONS[name].build(tree, ALL)) for name in names]
    tapes += [reverse.jacobian(tape, ["q"]) for tape in tapes[:1]]
    for q, status in (([1.0, 0.3], 0), ([0.0, 0.3], FIRST_LENGTH), ([0.5, 0.0], FIRST_LENGTH + 1)):
        for tape in tapes:
            given = {i.name: [0.1] * i.sparsity.nnz for i in tape.inputs} | {"q": q}
            assert find_failure(tape, given) == status, tape.name


def test_wrenches_read_the_state(tmp_path: Path) -> None:
    model = read(WHOLE, tmp_path)
    tree = build_tree(model)
    bare = build_tree(
        read(WHOLE.replace("force: [-mu*vx_tip*abs(vx_probe), 0, qd_sled]", "force: [0, 0, mu]"), tmp_path)
    )
    q, qd = [0.05, 0.3], [0.4, -1.2]
    vx, probe = (qd[0] + r * math.cos(q[1]) * qd[1] for r in (0.4, 0.3))
    fx = -0.8 * vx * abs(probe)
    expected = [fx, 0.4 * (math.cos(q[1]) * fx - math.sin(q[1]) * (qd[0] - 0.8))]
    difference = push(tree, q, qd) - push(bare, q, qd)
    assert difference == pytest.approx(expected, abs=1e-10)


# --- the same in every function, and elsewhere ------------------------------------------------------------------------


@pytest.fixture(scope="module")
def forced(tmp_path_factory: pytest.TempPathFactory) -> int:
    """The first seed of a mechanism that is accepted and has a cable and a contact."""
    folder = tmp_path_factory.mktemp("drawn")
    for seed in range(1000, 2000):
        drawn = mechanisms.draw(seed)
        types = {force.get("type") for force in drawn.model.get("forces", ())}
        if not drawn.model.get("contacts") or "cable" not in types or drawn.numbers != "given" or drawn.scene:
            continue
        try:
            build_tree(mechanisms.read(drawn, folder))
        except InputError:
            continue
        return seed
    raise AssertionError("no such mechanism is drawn")


def test_all_functions_and_derivatives_agree_with_virtual_power(forced: int) -> None:
    """A drawn mechanism with a cable, a contact and forces of drawn kinds; see tests/fuzz/forces.py."""
    assert mechanisms.examine(mechanisms.draw(forced), forced) == ""


PULLED = """
name: pulled
gravity: [0, 0, -9.81]
signals: [pull]
bodies:
  - {name: s, joint: {type: prismatic, axis: x}, mass: 1}
  - {name: m, parent: s, joint: {type: revolute, axis: y}, mass: 2, com: [0, 0, 0.3], inertia: [0.1, 0.1, 0.1]}
  - name: wheel
    joint: {type: revolute, axis: y, follows: {joint: s, ratio: 3}}
    mass: 1
    inertia: [0.1, 0.1, 0.1]
forces:
  - {name: own, from: {body: m, position: [0, 0, 0.5]}, to: {body: base, position: [1, 0, 0]}, force: 2*pull*length - t}
"""


@pytest.mark.parametrize("signal", [0.0, 0.7])
def test_a_law_of_a_signal_pulls_where_joints_follow_others(signal: float, tmp_path: Path) -> None:
    """At the accelerations of EXP1 and EXP2, the residuals of IMPL and SEMI vanish."""
    tree = build_tree(read(PULLED, tmp_path))
    at = {"q": [0.2, 0.4], "qd": [0.5, -0.3], "u": [1.0, 0.2], "w": [signal, 0.6]}
    for fast in ("exp1", "exp2"):
        qdd = evaluate(catalogue.FUNCTIONS[fast].build(tree, ALL), at)["qdd"]  # type: ignore[arg-type]
        for residual in ("impl", "semi_res"):
            left = evaluate(catalogue.FUNCTIONS[residual].build(tree, ALL), {**at, "qdd": qdd})["Phi"]  # type: ignore[arg-type]
            assert left == pytest.approx([0, 0], abs=1e-11)


def test_formulations_agree(tmp_path: Path) -> None:
    """At the accelerations of EXP1 and EXP2, the residuals of IMPL and SEMI vanish."""
    tree = build_tree(read(WHOLE, tmp_path))
    at = {"q": [0.05, 0.3], "qd": [0.4, -1.2], "u": [0.7], "p": [0.8]}
    for fast in ("exp1", "exp2"):
        qdd = evaluate(catalogue.FUNCTIONS[fast].build(tree, ALL), at)["qdd"]  # type: ignore[arg-type]
        for residual in ("impl", "semi_res"):
            left = evaluate(catalogue.FUNCTIONS[residual].build(tree, ALL), {**at, "qdd": qdd})["Phi"]  # type: ignore[arg-type]
            assert left == pytest.approx([0, 0], abs=1e-10)


def test_frames_that_are_no_sensors_have_no_output(tmp_path: Path) -> None:
    tree = build_tree(read(WHOLE, tmp_path))
    assert [sensor.name for sensor in tree.sensors] == ["tip"]
    assert len(evaluate(poses.build_sensors(tree), {"q": [0.0, 0.0], "p": [0.8]})["position"]) == 3


def test_a_scene_keeps_the_frames_that_forces_read(tmp_path: Path) -> None:
    model = read(WHOLE, tmp_path)
    whole, part = build_tree(model), build_tree(stage(model, Scene(sensors=())))
    assert not part.sensors
    assert push(part, [0.1, 0.2], [0.3, 0.4]) == pytest.approx(push(whole, [0.1, 0.2], [0.3, 0.4]), rel=1e-14)


def test_distances_are_of_spheres_and_corners(tmp_path: Path) -> None:
    """From a turned ground, and from below: the mast's tip is 0.4 from its joint, and the ball has a radius of 0.1."""
    tree = build_tree(read(WHOLE, tmp_path))
    gaps = evaluate(poses.build_distances(tree), {"q": [0.05, 0.3], "p": [0.8]})["distance"]
    assert [x.name for x in tree.distances] == ["ball", *(f"box.{k}" for k in range(1, 9))]
    assert gaps[0] == pytest.approx(-0.4 * math.cos(0.3) - 0.1, rel=1e-14)
    assert gaps[1:] == pytest.approx([-0.05, 0.05] * 4, rel=1e-14)


def test_distances_do_not_depend_on_signals(tmp_path: Path) -> None:
    """Beside a force that a signal sets: the point is 0.5 from its joint, and the ground is the plane z = 0."""
    touching = "contacts: [{name: tip, body: m, position: [0, 0, 0.5], radius: 0.1, plane: {}, stiffness: 100}]\n"
    tree = build_tree(read(PULLED + touching, tmp_path))
    distances = catalogue.FUNCTIONS["distances"].build(tree, ALL)  # type: ignore[arg-type]
    gaps = evaluate(distances, {"q": [0.2, 0.3]})["distance"]
    assert gaps == pytest.approx([0.5 * math.cos(0.3) - 0.1], rel=1e-14)


# --- files ------------------------------------------------------------------------------------------------------------


def test_what_is_written_reads_as_the_same_model(tmp_path: Path) -> None:
    model = read(WHOLE, tmp_path)
    assert read(write_model(model), tmp_path) == model


def test_python_makes_the_same_parts(tmp_path: Path) -> None:
    ball = contact("ball", "mast", position=(0, 0, 0.4), radius=0.1, other=plane(normal="-z"), stiffness="k")
    box = contact(
        "box",
        "sled",
        orientation=[("z", "pi/4")],
        size=(0.4, 0.2, 0.1),
        stiffness=10000,
        exponent=1,
        dissipation=0.4,
        width=0.001,
        friction=("mu", 0.01),
    )
    strut = spring("strut", end("sled"), end("base", position=(0, 0, 1)), stiffness="k", rest=0.9, damping=2)
    rope = cable("rope", end("mast"), end("base"), stiffness="k", dissipation=0.1, width=0.01)
    muscle = spring("muscle", end("mast"), end("base"), force="2*length*rate - q_mast")
    drag = wrench("drag", "mast", position=(0, 0, 0.4), force=("-mu*vx_tip*abs(vx_probe)", 0, "qd_sled"))
    model = read(WHOLE, tmp_path)
    assert (model.forces, model.contacts, model.wrenches) == ((strut, rope, muscle), (ball, box), (drag,))
    assert model.frames[1] == frame("probe", "mast", position=(0, 0, 0.3), sensor=False)


def test_numbers_of_forces_become_parameters(tmp_path: Path) -> None:
    """With their values the forces are what they were."""
    model = read(WHOLE, tmp_path)
    freed = with_runtime_numbers(model)
    added = {p.name for p in freed.parameters} - {p.name for p in model.parameters}
    assert {x for x in added if x.startswith(("forces.rope", "contacts.ball", "wrenches", "forces.muscle"))} == {
        "forces.rope.dissipation",
        "forces.rope.width",
        "forces.muscle.force.1",
        "contacts.ball.position.z",
        "contacts.ball.radius",
        "contacts.ball.width",
        "wrenches.drag.position.z",
    }
    for q in ([0.1, 0.2], [-0.3, 0.9]):
        assert push(build_tree(freed), q, [1, 2]) == pytest.approx(push(build_tree(model), q, [1, 2]), rel=1e-12)


# --- faults -----------------------------------------------------------------------------------------------------------

FAULTS = {  # old text, new text, path and piece of the finding
    "a name that nothing has": ("vx_tip*", "vx_top*", "wrenches[0].force[0]", 'unknown name "vx_top"'),
    "a joint that nothing has": ("q_sled)", "q_sledge)", "bodies[1].joint.force", 'unknown name "q_sledge"'),
    "a name of two things": ("  k: 400", "  k: 400\n  qd_sled: 1", "wrenches[0].force[2]", "too"),
    "a length that is a parameter": ("  k: 400", "  k: 400\n  length: 1", "forces[2].force", "too"),
    "a length in a wrench": ("0, qd_sled]", "0, length]", "wrenches[0].force[2]", 'unknown name "length"'),
    "a root of a root": ("0, qd_sled]", "0, exp(log(qd_sled)/3)*2]", "wrenches[0].force[2]", "power"),
    "a body that is not there": ("from: {body: sled}", "from: {body: slide}", "forces[0].from.body", "no body"),
    "a plane on nothing": ("{normal: -z}", "{body: floor, normal: -z}", "contacts[0].plane.body", "no body"),
    "a contact on nothing": (
        "body: mast, position: [0, 0, 0.4], radius",
        "body: m, radius",
        "contacts[0].body",
        "no body",
    ),
    "a contact of nothing": ("body: mast, position: [0, 0, 0.4], radius", "radius", "contacts[0].body", "missing"),
    "two alike": ("name: rope", "name: strut", "forces[1].name", "is taken"),
    "a contact with the name of a force": ("name: ball", "name: rope", "contacts[0].name", "is taken"),
    "both ends on one body": ("to: {body: base, position: [0, 0, 1]}", "to: {body: sled}", "forces[0]", "both ends"),
    "ends that do not move": ("from: {body: sled}", "from: {body: plate}", "forces[0]", "do not move relative"),
    "a plane on the same body": ("{normal: -z}", "{body: mast, normal: -z}", "contacts[0]", "mast"),
    "a spring that pushes itself": ("stiffness: k, rest", "stiffness: -k, rest", "forces[0].stiffness", "found -400"),
    "a length below 0": ("rest: 0.9", "rest: -0.9", "forces[0].rest", "found -0.9"),
    "a damper that drives": ("damping: 2", "damping: -2", "forces[0].damping", "found -2"),
    "a rest without a spring": ("stiffness: k, rest", "rest", "forces[0].rest", "without a spring"),
    "a cable without stiffness": (
        "to: {body: base}, stiffness: k, dis",
        "to: {body: base}, dis",
        "forces[1].type",
        "cable",
    ),
    "a cable with damping": ("dissipation: 0.1,", "damping: 0.1,", "forces[1].damping", "damping of a cable"),
    "no width": ("width: 0.01}", "width: 0}", "forces[1].width", "found 0"),
    "an unknown type": ("type: cable", "type: rope", "forces[1].type", "rope"),
    "nothing at all": (", force: 2*length*rate - q_mast", "", "forces[2]", "without force"),
    "another end missing": (", to: {body: base}, force", ", force", "forces[2].to", "missing"),
    "a soft wall": ("stiffness: k}\n  - name: box", "stiffness: 0}\n  - name: box", "contacts[0].stiffness", "found 0"),
    "no stiffness": (", stiffness: k}\n  - name: box", "}\n  - name: box", "contacts[0].stiffness", "missing"),
    "a normal without direction": ("normal: -z", "normal: [0, 0, 0]", "contacts[0].plane.normal", "no direction"),
    "a radius below 0": ("radius: 0.1", "radius: -0.1", "contacts[0].radius", "found -0.1"),
    "a box with a radius": ("    size: [", "    radius: 1\n    size: [", "contacts[1].radius", "box with a radius"),
    "a flat box": ("size: [0.4, 0.2, 0.1]", "size: [0.4, 0, 0.1]", "contacts[1].size[1]", "found 0"),
    "an odd exponent": ("exponent: 1\n", "exponent: 1.2\n", "contacts[1].exponent", "found 1.2"),
    "an exponent at run time": ("exponent: 1\n", "exponent: mu\n", "contacts[1].exponent", "change at run time"),
    "friction that drives": ("coefficient: mu", "coefficient: -1", "contacts[1].friction.coefficient", "found -1"),
    "friction without speed": ("speed: 0.01", "speed: 0", "contacts[1].friction.speed", "found 0"),
    "a sensor of two minds": ("sensor: false", "sensor: 0", "frames[1].sensor", "found 0"),
}


@pytest.mark.parametrize(("old", "new", "path", "finding"), FAULTS.values(), ids=FAULTS.keys())
def test_faults_are_found_where_they_are(old: str, new: str, path: str, finding: str, tmp_path: Path) -> None:
    check_fault(WHOLE, old, new, path, finding, tmp_path)
