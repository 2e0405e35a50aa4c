"""Stops and dry friction in model files: their meaning, refusals, and that they are written as they were read."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from mbsgen.drawing import describe_joint
from mbsgen.model.changes.reduction import build_tree
from mbsgen.model.changes.releasing import with_runtime_numbers
from mbsgen.model.construction import body, make_model, prismatic
from mbsgen.model.reader import read_model
from mbsgen.model.tree import COORDINATE, RATE, BearingLoad, DryFriction, Stops, Tree
from mbsgen.model.writer import write_model
from mbsgen.pipeline import generate
from mbsgen.request import OptionError, Options
from tests.mbsgen.model.files import find_faults

TEXT = """name: rig
gravity: [0, 0, -9.81]
parameters: {k: 1e4, s: {value: 0.5, kind: runtime}}
driven: [belt]
bodies:
  - name: slide
    joint: {type: prismatic, axis: x, limits: [-0.2, 0.3], stops: {restitution: 0.4}, friction: {torque: 2, static: 3}}
    mass: 1
  - name: belt
    joint: {type: prismatic, axis: y, actuated: false}
    mass: 1
  - name: nut
    parent: slide
    joint: {type: prismatic, axis: y, limits: [null, 0.1], stops: {stiffness: k, dissipation: s}}
    mass: 1
  - name: twin
    parent: nut
    joint: {type: prismatic, axis: z, follows: {joint: nut}}
    mass: 1
"""

BAD: dict[str, tuple[str, str, str, str]] = {
    "restitution above 1": ("restitution: 0.4", "restitution: 1.2", "bodies[0].joint.stops.restitution", "found 1.2"),
    "restitution below 0": ("restitution: 0.4", "restitution: -1", "bodies[0].joint.stops.restitution", "found -1"),
    "a restitution at run time": ("restitution: 0.4", "restitution: s", "bodies[0].joint.stops.restitution", "s"),
    "neither": ("{restitution: 0.4}", "{}", "bodies[0].joint.stops", "neither"),
    "both": ("restitution: 0.4", "restitution: 0.4, stiffness: 1", "bodies[0].joint.stops", "both"),
    "rigid with dissipation": (
        "restitution: 0.4",
        "restitution: 0.4, dissipation: 1",
        "bodies[0].joint.stops.dissipation",
        "rigid",
    ),
    "no limits": ("limits: [-0.2, 0.3], ", "", "bodies[0].joint.stops", "without limits"),
    "stops that cross": ("[-0.2, 0.3]", "[0.3, -0.2]", "bodies[0].joint.limits", "above the upper"),
    "no room": ("[-0.2, 0.3]", "[0.3, 0.3]", "bodies[0].joint.limits", "both stops are at 0.3"),
    "static below sliding": ("static: 3", "static: 1", "bodies[0].joint.friction.static", "1 holds"),
    "negative friction": ("torque: 2, static: 3", "torque: -2", "bodies[0].joint.friction.torque", "found -2"),
    "dry and smoothed": ("static: 3", "static: 3, speed: 0.1", "bodies[0].joint.friction", "dry too"),
    "a speed of 0": ("static: 3", "static: 3, stribeck: 0", "bodies[0].joint.friction.stribeck", "a speed of 0"),
    "stribeck alone": ("static: 3", "stribeck: 1", "bodies[0].joint.friction.stribeck", "without static"),
    "friction at run time": ("torque: 2", "torque: s", "bodies[0].joint.friction.torque", "s"),
    "no stiffness": ("stiffness: k", "stiffness: 0*k", "bodies[2].joint.stops.stiffness", "found 0"),
    "negative dissipation": ("dissipation: s", "dissipation: -s", "bodies[2].joint.stops.dissipation", "found -0.5"),
    "friction of a driven joint": (
        "axis: y, actuated: false",
        "axis: y, actuated: false, friction: {torque: 1}",
        "bodies[1].joint.friction",
        "driven",
    ),
    "stops of a driven joint": (
        "axis: y, actuated: false",
        "axis: y, actuated: false, limits: [0, 1], stops: {restitution: 0}",
        "bodies[1].joint.stops",
        "driven",
    ),
    "friction of a follower": (
        "follows: {joint: nut}",
        "follows: {joint: nut}, friction: {torque: 1}",
        "bodies[3].joint.friction",
        "follows",
    ),
}


LOADED = """name: rig
gravity: [0, 0, -9.81]
parameters: {s: {value: 0.5, kind: runtime}}
bodies:
  - name: wheel
    joint: {type: revolute, axis: y, friction: {torque: 0, load: {coefficient: 0.2, static: 0.3, radius: 0.02}}}
    mass: 1
    inertia: [0.1, 0.1, 0.1]
  - name: nut
    joint:
      type: prismatic
      axis: y
      limits: [null, 0.1]
      friction: {torque: 1, static: 2, stribeck: 0.1, load: {coefficient: 0.2, length: 0.4}}
    mass: 1
"""

BAD_LOADS: dict[str, tuple[str, str, str, str, str]] = {
    "no radius": (", radius: 0.02", "", "bodies[0].joint.friction.load", "without its radius", "give radius"),
    "a radius of 0": ("radius: 0.02", "radius: 0", "bodies[0].joint.friction.load.radius", "found 0", "more than 0 m"),
    "a radius of a slide": (
        "length: 0.4",
        "radius: 0.4",
        "bodies[1].joint.friction.load.radius",
        "of a joint that slides",
        "leave it out",
    ),
    "a length below 0": (
        "length: 0.4",
        "length: -1",
        "bodies[1].joint.friction.load.length",
        "found -1",
        "more than 0",
    ),
    "a negative coefficient": (
        "coefficient: 0.2, length",
        "coefficient: -0.2, length",
        "bodies[1].joint.friction.load.coefficient",
        "found -0.2",
        "give 0 or more",
    ),
    "static below sliding": (
        "static: 0.3",
        "static: 0.1",
        "bodies[0].joint.friction.load.static",
        "0.1 holds",
        "give 0.2 or more",
    ),
    "at run time": ("static: 0.3", "static: s", "bodies[0].joint.friction.load.static", "s", "constant"),
    "smoothed": (
        "torque: 1, static: 2, stribeck: 0.1",
        "torque: 1, speed: 1",
        "bodies[1].joint.friction",
        "dry too",
        "load",
    ),
    "one way": (
        "static: 2, stribeck: 0.1",
        "one_way: 1",
        "bodies[1].joint.friction.one_way",
        "a one-way clutch with friction by its load",
        "leave out",
    ),
    "with rigid stops": (
        "limits: [null, 0.1]",
        "limits: [null, 0.1]\n      stops: {restitution: 0}",
        "bodies[0].joint.friction.load",
        "in a model with rigid stops",
        "or give a stiffness",
    ),
    "with driven joints": (
        "bodies:",
        "driven: [handle]\nbodies:\n  - {name: handle, joint: {type: prismatic, axis: x, actuated: false}, mass: 1}",
        "bodies[1].joint.friction.load",
        "in a model with driven joints",
        "give a torque in place of load",
    ),
    "with a loop": (
        "bodies:",
        "loops: [{name: tie, type: ball, from: {body: wheel}, to: {body: nut}}]\nbodies:",
        "bodies[0].joint.friction.load",
        "in a model with loops",
        "give a torque in place of load",
    ),
    "with a rigid contact": (
        "bodies:",
        "contacts:\n  - {name: rim, body: wheel, radius: 0.1, restitution: 0}\nbodies:",
        "bodies[0].joint.friction.load",
        "in a model with rigid contacts",
        "or give a stiffness",
    ),
}


def read_text(text: str, folder: Path) -> Tree:
    file = folder / "model.yaml"
    file.write_text(text, encoding="utf-8")
    return build_tree(read_model(file))


@pytest.mark.parametrize("name", BAD)
def test_a_fault_has_a_place_and_a_finding(name: str, tmp_path: Path) -> None:
    old, new, path, piece = BAD[name]
    assert TEXT.count(old) == 1
    (fault,) = find_faults(TEXT.replace(old, new), tmp_path)
    assert (fault.path, piece in fault.finding) == (path, True), fault


@pytest.mark.parametrize("name", BAD_LOADS)
def test_a_fault_of_a_load_has_a_line_a_finding_and_a_remedy(name: str, tmp_path: Path) -> None:
    old, new, path, piece, remedy = BAD_LOADS[name]
    assert LOADED.count(old) == 1
    (fault,) = find_faults(LOADED.replace(old, new), tmp_path)
    assert (fault.path, piece in fault.finding, remedy in fault.remedy) == (path, True, True), fault
    assert fault.line > 1


def test_friction_by_loads_is_read_written_made_and_released_as_the_same(tmp_path: Path) -> None:
    file, again = tmp_path / "model.yaml", tmp_path / "again.yaml"
    file.write_text(LOADED, encoding="utf-8")
    model = read_model(file)
    again.write_text(write_model(model), encoding="utf-8")
    assert read_model(again) == model
    loads = [BearingLoad(0.2, 0.3, 0.02, None), BearingLoad(0.2, 0.2, 1.0, 0.4)]
    dry = [DryFriction(0.0, 0.0, None, load=loads[0]), DryFriction(1.0, 2.0, 0.1, load=loads[1])]
    for read in (model, with_runtime_numbers(model)):
        assert [b.joint.dry for b in build_tree(read).bodies] == dry
    joint = prismatic(
        "y", friction={"torque": 1, "static": 2, "stribeck": 0.1, "load": {"coefficient": 0.2, "length": 0.4}}
    )
    made = build_tree(make_model("m", [body("b", joint, mass=1)], gravity=(0, 0, 0))).bodies[0].joint
    assert made.dry == dry[1]
    assert describe_joint(build_tree(model), 2).endswith("dry friction by its load")
    with pytest.raises(ValueError, match="without a coefficient"):
        prismatic("y", friction={"torque": 1, "load": {"length": 1}})
    with pytest.raises(ValueError, match=r"found 0\.1; give"):
        prismatic("y", friction={"torque": 1, "load": 0.1})


def test_kernels_of_loads_have_reactions_another_hash_and_no_tolerance(tmp_path: Path) -> None:
    hashes = []
    for number in (0.02, 0.03):
        file = tmp_path / f"{number}.yaml"
        file.write_text(LOADED.replace("radius: 0.02", f"radius: {number}"), encoding="utf-8")
        manifest = generate(file, tmp_path / str(number), Options(derivatives=0)).manifest
        hashes.append(manifest.model_hash)
        assert manifest.loaded == ("wheel", "nut")
        assert manifest.find("reactions") is not None
    assert hashes[0] != hashes[1]
    with pytest.raises(OptionError, match="reactions are not estimated, on which friction depends in joint wheel"):
        generate(file, tmp_path / "rough", Options(tolerance=1e-3))


def test_all_faults_appear_together(tmp_path: Path) -> None:
    text = TEXT.replace("restitution: 0.4", "restitution: 2").replace("static: 3", "static: 1")
    assert len(find_faults(text, tmp_path)) == 2


def test_rigid_stops_and_dry_friction_are_no_part_of_the_law(tmp_path: Path) -> None:
    joint = read_text(TEXT, tmp_path).bodies[0].joint
    assert (joint.stops, joint.dry) == (Stops(-0.2, 0.3, 0.4), DryFriction(2.0, 3.0, None))
    assert joint.law == 0


@pytest.mark.parametrize(
    ("q", "qd", "force"),
    [
        (0.05, 1.0, 0.0),
        (0.12, 0.0, -1e4 * 0.02),
        (0.12, 1.0, -1e4 * 0.02 * (1 + 0.5)),
        (0.12, -1.0, -1e4 * 0.02 * (1 - 0.5)),
        (0.12, -3.0, 0.0),  # it never pulls
    ],
)
def test_a_compliant_stop_pushes_by_hunt_and_crossley(q: float, qd: float, force: float, tmp_path: Path) -> None:
    tree = read_text(TEXT, tmp_path)
    nut = next(b.joint for b in tree.bodies if b.joint.name == "nut")
    values = {p.symbol: p.value for p in tree.parameters}
    assert float(nut.law.subs({COORDINATE: q, RATE: qd, **values})) == pytest.approx(force, rel=1e-12, abs=1e-12)


def test_a_lower_compliant_stop_pushes_forward(tmp_path: Path) -> None:
    text = TEXT.replace("[null, 0.1]", "[-0.1, null]").replace("dissipation: s", "dissipation: 0")
    tree = read_text(text, tmp_path)
    nut = next(b.joint for b in tree.bodies if b.joint.name == "nut")
    values = {p.symbol: p.value for p in tree.parameters}
    assert float(nut.law.subs({COORDINATE: -0.12, **values})) == pytest.approx(200.0)


def test_written_models_are_read_as_the_same(tmp_path: Path) -> None:
    file, again = tmp_path / "model.yaml", tmp_path / "again.yaml"
    file.write_text(TEXT.replace("static: 3", "static: 3, stribeck: 0.1"), encoding="utf-8")
    model = read_model(file)
    again.write_text(write_model(model), encoding="utf-8")
    assert read_model(again) == model


def test_python_makes_the_same_model() -> None:
    joint = prismatic("x", limits=(-1, 1), stops={"restitution": 0.5}, friction={"torque": 2, "static": 3})
    model = make_model("m", [body("b", joint, mass=1)], gravity=(0, 0, 0))
    made = build_tree(model).bodies[0].joint
    assert (made.stops, made.dry) == (Stops(-1.0, 1.0, 0.5), DryFriction(2.0, 3.0, None))
    with pytest.raises(ValueError, match="restitution, stiffness"):
        prismatic("x", limits=(-1, 1), stops={"bounce": 0.5})
    with pytest.raises(ValueError, match="without a torque"):
        prismatic("x", friction={"static": 0.5})


def test_released_numbers_keep_friction_and_restitution(tmp_path: Path) -> None:
    file = tmp_path / "model.yaml"
    file.write_text(TEXT, encoding="utf-8")
    released = with_runtime_numbers(read_model(file))
    joints = {b.joint.name: b.joint for b in build_tree(released).bodies}
    assert joints["slide"].dry == DryFriction(2.0, 3.0, None)
    assert joints["slide"].stops == Stops(-0.2, 0.3, 0.4)
    assert {p.name for p in released.parameters} >= {"k", "s"}


def test_the_manifest_names_joints_that_switch_and_says_nothing_of_others(tmp_path: Path) -> None:
    """Without stops and friction, folders are as they were; with them, the hash of the content changes."""
    hashes = []
    for number in (0.4, 0.5):
        file = tmp_path / f"{number}.yaml"
        text = TEXT.replace("restitution: 0.4", f"restitution: {number}")
        file.write_text(text, encoding="utf-8")
        manifest = generate(file, tmp_path / str(number), Options(functions=("energy",), derivatives=0)).manifest
        hashes.append(manifest.model_hash)
        assert manifest.switching == ("slide",)
        stops = manifest.coordinates[0].stops
        assert stops is not None
        assert stops.restitution == number
        assert math.isclose(stops.lower or 0.0, -0.2)
    assert len({*hashes}) == 2
    file.write_text(
        "name: m\ngravity: [0, 0, 0]\nbodies:\n  - name: b\n    joint: {type: prismatic, axis: x}\n    mass: 1\n"
    )
    generate(file, tmp_path / "plain", Options(functions=("energy",), derivatives=0))
    text = (tmp_path / "plain" / "manifest.json").read_text()
    assert "stops" not in text
    assert "friction" not in text


def test_a_joint_is_described_with_its_stops_and_friction(tmp_path: Path) -> None:
    tree = read_text(TEXT, tmp_path)
    texts = {b.joint.name: describe_joint(tree, k) for k, b in enumerate(tree.bodies, 1)}
    assert texts["slide"] == "prismatic along x, stops of 0.4, dry friction"
    assert texts["nut"] == "prismatic along y, compliant stops"
