"""Contacts of MJCF: which geoms touch which planes, where, and how roughly, as MuJoCo has it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np
import pytest

from mbsgen.errors import InputError
from mbsgen.expressions import FLOATS, evaluate
from mbsgen.importing import Choices, Imported, import_model
from mbsgen.model.changes.reduction import build_tree
from mbsgen.model.writer import write_model
from mbsrun import load
from mbsrun.models import Extent
from mbsrun.simulation import Settings, simulate
from mbsrun.simulation.drive import hold
from mbsrun.simulation.solids import measure_pairs
from tests.mbsgen.model.pairs import call

CORNERS = "0 0 0  0.2 0 0  0 0.3 0  0 0 0.25  0.05 0.05 0.05"
SCENE = f"""\
<mujoco>
  <compiler angle="radian"/>
  <default><geom friction="0.6 0.01 0.001"/></default>
  <asset><mesh name="wedge" vertex="{CORNERS}"/></asset>
  <worldbody>
    <geom name="floor" type="plane" size="0 0 1" euler="0.2 0 0" pos="0 0 -0.1"/>
    <body pos="0.1 0.2 1" euler="0.3 0 0.1">
      <freejoint/>
      <frame pos="0.1 0 0" euler="0 0.4 0">GEOM</frame>
      <inertial pos="0 0 0.1" mass="2" diaginertia="0.1 0.2 0.15"/>
    </body>
  </worldbody>
</mujoco>
"""
GEOMS = {
    "sphere": '<geom name="g" size="0.1" pos="0.1 0 0"/>',
    "capsule": '<geom name="g" type="capsule" size="0.05 0.2" euler="0.5 0 0"/>',
    "capsule between points": '<geom name="g" type="capsule" size="0.05" fromto="0 0 0 0.2 0.1 0.3"/>',
    "box": '<geom name="g" type="box" size="0.1 0.2 0.3" pos="0 0.1 0" euler="0 0 1"/>',
    "mesh": '<geom name="g" type="mesh" mesh="wedge" pos="0.1 0 0.1" euler="0 1 0"/>',
}


def bring(text: str, folder: Path, contacts: float | None = 0.0) -> Imported:
    file = folder / "scene.xml"
    file.write_text(text, encoding="utf-8")
    return import_model(file, Choices(contacts=contacts, quaternions=True))


@pytest.mark.parametrize("shape", GEOMS)
def test_the_least_distance_is_that_of_mujoco(shape: str, tmp_path: Path) -> None:
    """Above and below the plane, at random poses of the body: the deepest point of each shape."""
    text = SCENE.replace("GEOM", GEOMS[shape])
    (touch,) = bring(text, tmp_path).model.contacts
    tree = build_tree(bring(text, tmp_path).model)
    assert touch.name == "g"
    model = mujoco.MjModel.from_xml_string(text)
    data, random = mujoco.MjData(model), np.random.default_rng(5)
    for _ in range(10):
        quaternion = random.normal(size=4)
        w, x, y, z = quaternion / np.linalg.norm(quaternion)
        place = [*random.uniform(-0.5, 0.5, 2), random.uniform(0, 2)]
        data.qpos[:] = [*place, w, x, y, z]
        mujoco.mj_forward(model, data)
        gaps = call(tree, "touching", q=[*place, x, y, z, w])["clearance"]
        assert min(gaps) == pytest.approx(mujoco.mj_geomDistance(model, data, 0, 1, 10.0, None), abs=2e-7)


def test_a_cylinder_touches_by_points_of_its_rims(tmp_path: Path) -> None:
    """Never less deep than the cylinder itself, and by no more than the rim's arc between two points."""
    text = SCENE.replace("GEOM", '<geom name="g" type="cylinder" size="0.1 0.3" euler="0 0.7 0"/>')
    found = bring(text, tmp_path)
    tree, model = build_tree(found.model), mujoco.MjModel.from_xml_string(text)
    assert any("16 points of each rim" in str(x) for x in found.notices)
    data, random = mujoco.MjData(model), np.random.default_rng(5)
    for _ in range(20):
        quaternion = random.normal(size=4)
        w, x, y, z = quaternion / np.linalg.norm(quaternion)
        data.qpos[:] = [0, 0, 1, w, x, y, z]
        mujoco.mj_forward(model, data)
        gaps = call(tree, "touching", q=[0, 0, 1, x, y, z, w])["clearance"]
        least = mujoco.mj_geomDistance(model, data, 0, 1, 10.0, None)
        assert -1e-7 <= min(gaps) - least <= 0.1 * (1 - np.cos(np.pi / 16)) + 1e-7


def count(text: str, folder: Path) -> int:
    """Count the geoms that touch a plane."""
    return len(bring(text, folder).model.contacts)


@pytest.mark.parametrize("type_a", [0, 1, 2, 3])
@pytest.mark.parametrize("affinity_a", [0, 1, 2])
def test_masks_decide_as_in_mujoco(type_a: int, affinity_a: int, tmp_path: Path) -> None:
    """A sphere within two planes with other masks: as many contacts as MuJoCo finds."""
    ball = f'<geom name="g" size="0.5" contype="{type_a}" conaffinity="{affinity_a}"/>'
    text = SCENE.replace("GEOM", ball).replace('pos="0.1 0.2 1"', 'pos="0 0 0"')
    text = text.replace("<worldbody>", '<worldbody><geom type="plane" size="0 0 1" contype="2" conaffinity="1"/>')
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert count(text, tmp_path) == data.ncon


def test_excluded_bodies_do_not_touch(tmp_path: Path) -> None:
    text = SCENE.replace("GEOM", GEOMS["sphere"]).replace("<body pos", '<body name="b" pos')
    excluded = text.replace("</mujoco>", '<contact><exclude body1="world" body2="b"/></contact></mujoco>')
    assert [count(x, tmp_path) for x in (text, excluded)] == [1, 0]
    assert count(text.replace("<compiler", '<option><flag contact="disable"/></option><compiler'), tmp_path) == 0


@pytest.mark.parametrize(
    ("own", "plane", "expected"),
    [
        ("", "", 0.6),
        ('friction="0.9"', "", 0.9),
        ('friction="0.3"', "", 0.6),
        ('friction="0.3" priority="1"', "", 0.3),
        ('friction="0.3"', 'priority="2"', 0.6),
        ('condim="1"', 'condim="1"', None),
        ('condim="1"', "", 0.6),
        ('condim="1" priority="1"', "", None),
    ],
)
def test_friction_is_combined_as_in_mujoco(own: str, plane: str, expected: float | None, tmp_path: Path) -> None:
    text = SCENE.replace("GEOM", f'<geom name="g" size="2" {own}/>').replace('name="floor"', f'name="floor" {plane}')
    (touch,) = bring(text, tmp_path).model.contacts
    found = None if touch.friction is None else evaluate(touch.friction.coefficient, {}, FLOATS)
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert found == expected
    assert (None if data.contact.dim[0] == 1 else data.contact.friction[0][0]) == expected


def test_a_box_slides_down_as_coulomb_says(requires: Callable[[str], str], tmp_path: Path) -> None:
    """With g (sin - mu cos), from the imported scene; the written model has the same contacts."""
    requires("cc")
    text = SCENE.replace("GEOM", GEOMS["sphere"]).replace(
        '<frame pos="0.1 0 0" euler="0 0.4 0"><geom name="g" size="0.1" pos="0.1 0 0"/></frame>',
        '<geom name="g" type="box" size="0.2 0.2 0.1" friction="0.1"/>',
    )
    text = text.replace('friction="0.6 0.01 0.001"', 'friction="0.1"').replace('pos="0.1 0.2 1" euler="0.3 0 0.1"', "")
    text = text.replace('<inertial pos="0 0 0.1"', '<inertial pos="0 0 0"')
    found = bring(text, tmp_path)
    file = tmp_path / "scene.yaml"
    file.write_text(write_model(found.model), encoding="utf-8")
    slope, height, T = 0.2, 0.1, 0.4
    down, up = np.array([0, -np.cos(slope), -np.sin(slope)]), np.array([0, -np.sin(slope), np.cos(slope)])
    start = [*(height * up + [0, 0, -0.1]), np.sin(slope / 2), 0, 0, np.cos(slope / 2)]
    settings = Settings(T, method="moreau", step=1e-3, output_step=0.1)
    motion = simulate(load(file), hold([]), start, np.zeros(6), settings)
    way = 9.81 * (np.sin(slope) - 0.1 * np.cos(slope)) * T**2 / 2
    assert motion.q[-1][:3] - motion.q[0][:3] == pytest.approx(way * down, abs=1e-9)


TREE = """\
<mujoco>
  <option><flag filterparent="FLAG"/></option>
  <default><geom size="5"/></default>
  <worldbody>
    <geom name="ground"/>
    <body name="post"><geom name="post"/>
      <body name="a"><joint/><geom name="a"/><geom name="a2" contype="2" conaffinity="4"/>
        <body name="plate"><geom name="plate"/>
          <body name="b"><joint/><geom name="b"/>
            <body name="c"><joint/><joint axis="1 0 0"/><geom name="c" contype="4"/></body>
          </body>
        </body>
        <body name="d"><joint/><geom name="d"/></body>
      </body>
    </body>
    <body name="e"><freejoint/><geom name="e"/><geom name="e2" contype="0" conaffinity="0"/></body>
  </worldbody>
  <contact>
    <exclude body1="d" body2="e"/>
    <pair geom1="a" geom2="b"/>
    <pair geom1="e2" geom2="post" condim="1"/>
    <pair geom1="c" geom2="e" friction="0.4 0.4 0.1 0.1 0.1"/>
  </contact>
</mujoco>
"""


@pytest.mark.parametrize("flag", ["enable", "disable"])
def test_pairs_of_bodies_touch_as_in_mujoco(flag: str, tmp_path: Path) -> None:
    """Spheres on each other: masks, welded bodies, parents, `exclude` and `pair`; and the friction of each."""
    text = TREE.replace("FLAG", flag)
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)

    def name(geom: int) -> str:
        return str(mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_GEOM, geom))

    expected = {}
    for k in range(data.ncon):
        coefficient = None if data.contact.dim[k] == 1 else pytest.approx(data.contact.friction[k][0])
        expected[frozenset(map(name, data.contact.geom[k]))] = coefficient
    found = {
        frozenset(x.name.split(".")): None if x.friction is None else evaluate(x.friction.coefficient, {}, FLOATS)
        for x in bring(text, tmp_path).model.contacts
    }
    assert len(expected) > 15
    assert found == expected


PAIR = """\
<mujoco>
  <compiler angle="radian"/>
  <default><geom friction="0.6 0.01 0.001"/></default>
  <asset><mesh name="wedge" vertex="CORNERS"/></asset>
  <worldbody>
    <body><freejoint/>
      <frame pos="0.1 0 0" euler="0 0.4 0">FIRST</frame><inertial pos="0 0 0.1" mass="2" diaginertia="0.1 0.2 0.15"/>
    </body>
    <body><freejoint/>
      <frame pos="0 0 0.1" euler="0.7 0 0">OTHER</frame><inertial pos="0 0 0" mass="2" diaginertia="0.1 0.2 0.15"/>
    </body>
  </worldbody>
</mujoco>
"""


@pytest.mark.parametrize("shapes", ["box, box", "mesh, capsule", "sphere, mesh", "capsule, box", "mesh, mesh"])
def test_distances_of_bodies_are_those_of_mujoco(shapes: str, requires: Callable[[str], str], tmp_path: Path) -> None:
    """Of solids on two free bodies at random places."""
    requires("cc")
    first, other = (GEOMS[x].replace('name="g"', f'name="{n}"') for x, n in zip(shapes.split(", "), "gh", strict=True))
    text = PAIR.replace("FIRST", first).replace("OTHER", other).replace("CORNERS", CORNERS)
    found = bring(text, tmp_path)
    assert any("only the method moreau" in str(x) for x in found.notices)
    (tmp_path / "pair.yaml").write_text(write_model(found.model), encoding="utf-8")
    kernels = load(tmp_path / "pair.yaml", extent=Extent(("meetings",), 0))
    model = mujoco.MjModel.from_xml_string(text)
    data, random = mujoco.MjData(model), np.random.default_rng(5)
    for _ in range(10):
        turns = random.normal(size=(2, 4))
        turns /= np.linalg.norm(turns, axis=1)[:, None]
        places = np.array([random.uniform(-0.2, 0.2, 3), [1.2, 0.4, -0.3]])
        data.qpos[:] = np.hstack([places, turns]).ravel()
        mujoco.mj_forward(model, data)
        q = np.hstack([places, np.roll(turns, -1, axis=1)]).ravel()
        least = mujoco.mj_geomDistance(model, data, 0, 1, 10.0, None)
        assert least > 0.1
        assert measure_pairs(kernels, q[None])[0][0, 0] == pytest.approx(least, abs=2e-6)


@pytest.mark.parametrize("shapes", ["sphere, box", "box, sphere", "capsule, sphere"])
def test_spheres_come_first_so_that_all_methods_take_them(shapes: str, tmp_path: Path) -> None:
    """With the distances of MuJoCo."""
    first, other = (GEOMS[x].replace('name="g"', f'name="{n}"') for x, n in zip(shapes.split(", "), "gh", strict=True))
    text = PAIR.replace("FIRST", first).replace("OTHER", other).replace("CORNERS", CORNERS)
    found = bring(text, tmp_path)
    assert not any("only the method moreau" in str(x) for x in found.notices)
    tree, model = build_tree(found.model), mujoco.MjModel.from_xml_string(text)
    data, random = mujoco.MjData(model), np.random.default_rng(5)
    for _ in range(10):
        turns = random.normal(size=(2, 4))
        turns /= np.linalg.norm(turns, axis=1)[:, None]
        places = np.array([random.uniform(-0.2, 0.2, 3), [1.2, 0.4, -0.3]])
        data.qpos[:] = np.hstack([places, turns]).ravel()
        mujoco.mj_forward(model, data)
        (gap,) = call(tree, "touching", q=np.hstack([places, np.roll(turns, -1, axis=1)]).ravel())["clearance"]
        assert gap == pytest.approx(mujoco.mj_geomDistance(model, data, 0, 1, 10.0, None), abs=2e-6)


def test_a_box_rests_on_a_box_of_the_world(requires: Callable[[str], str], tmp_path: Path) -> None:
    """Imported without a plane; and without its contacts where planes alone are asked for."""
    requires("cc")
    text = """<mujoco><worldbody><geom type="box" size="1 1 0.1"/>
      <body pos="0 0 0.3"><freejoint/><geom type="box" size="0.1 0.1 0.2" mass="1"/></body></worldbody></mujoco>"""
    found = bring(text, tmp_path)
    (tmp_path / "box.yaml").write_text(write_model(found.model), encoding="utf-8")
    start = [0, 0, 0.3, 0, 0, 0, 1]
    motion = simulate(load(tmp_path / "box.yaml"), hold([]), start, np.zeros(6), Settings(0.1, "moreau", step=1e-3))
    assert motion.q[-1] == pytest.approx(start, abs=1e-12)
    alone = import_model(tmp_path / "scene.xml", Choices(contacts=0.0, contacts_of="planes"))
    assert alone.model.contacts == ()
    assert any("1 pairs of geoms may touch besides" in str(x) for x in alone.notices)


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ('<geom name="e"/>', '<geom name="e" type="plane" size="1 1 1"/>', "type plane moves with its body"),
        ('geom1="a"', 'geom1="z"', 'there is no geom "z"'),
    ],
)
def test_what_mujoco_refuses_is_refused(old: str, new: str, expected: str, tmp_path: Path) -> None:
    text = TREE.replace("FLAG", "enable").replace(old, new)
    with pytest.raises(ValueError, match=r"plane only allowed in static bodies|geom 'z' not found"):
        mujoco.MjModel.from_xml_string(text)
    with pytest.raises(InputError, match=expected):
        bring(text, tmp_path)


def test_what_is_left_out_is_told(tmp_path: Path) -> None:
    """Ellipsoids, pairs without motion; and, without the option, that it exists."""
    more = '<body><freejoint/><geom size="0.1" pos="3 0 3"/></body>'
    text = SCENE.replace("GEOM", '<geom type="ellipsoid" size="0.1 0.2 0.3"/>').replace(
        "</worldbody>", f"{more}</worldbody>"
    )
    told = [str(x) for x in bring(text, tmp_path).notices]
    assert sum("passes through all others: contacts of the type ellipsoid" in x for x in told) == 1
    assert any("1 contacts of geoms are rigid" in x for x in told)
    pair = text.replace("</mujoco>", '<contact><pair geom1="floor" geom2="floor"/></contact></mujoco>')
    assert any("a pair of geoms is left out" in str(x) for x in bring(pair, tmp_path).notices)
    inertial = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1"/></inertial>'
    (tmp_path / "arm.urdf").write_text(f'<robot name="arm"><link name="base">{inertial}</link></robot>')
    urdf = import_model(tmp_path / "arm.urdf", Choices(contacts=0.0, base="floating"))
    assert any("only a file of MJCF has planes" in str(x) for x in urdf.notices)
    without = [str(x) for x in bring(text, tmp_path, None).notices]
    assert any("2 of the bodies' geoms may touch others" in x and "--contacts 0" in x for x in without)
