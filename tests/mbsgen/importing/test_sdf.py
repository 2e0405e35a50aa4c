"""SDF: where links are and how they move, by products of poses in the world; loops; what is refused or left out.

The program here takes each link from its place in the file: a joint moves its child, with all that the child carries,
about the joint's frame in the world. It uses nothing of the importer.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mbsgen.assembly import assemble
from mbsgen.errors import InputError
from mbsgen.expressions import Number
from mbsgen.formulations.catalogue import FUNCTIONS
from mbsgen.formulations.reductions import NONE
from mbsgen.importing import Choices, Imported, import_model, write_imported
from mbsgen.model.changes.reduction import build_tree
from mbsgen.model.model import Follow
from mbsgen.model.reader import read_model
from mbsgen.model.tree import Cut
from mbsgen.tape.interpreter import evaluate
from tests.loop_ends import open_loops, place_ends

INERTIA = (
    "<inertial><pose>0.1 -0.2 0.05 0.3 -0.2 0.5</pose><mass>1.5</mass><inertia><ixx>0.02</ixx><iyy>0.03</iyy>"
    "<izz>0.025</izz><ixy>0.001</ixy><ixz>-0.002</ixz><iyz>0.003</iyz></inertia></inertial>"
)
MASS = 1.5
TENSOR = np.array([[0.02, 0.001, -0.002], [0.001, 0.03, 0.003], [-0.002, 0.003, 0.025]])
POSES = {  # of links and joints in the model; joints are written in their children
    "a": (0.1, 0.2, 0.3, 0.4, 0.5, 0.6),
    "b": (0.5, -0.2, 0.6, -0.3, 0.2, 0.1),
    "c": (0.7, 0.3, 0.9, 0.2, -0.7, 1.1),
    "ja": (0.0, 0.1, 0.2, 0.3, 0.1, -0.2),
    "jb": (0.2, 0.1, -0.1, 1.0, 0.4, 0.3),
    "jc": (-0.1, 0.1, 0.1, 0.2, 0.9, -0.5),
}
TOP = (0.3, -0.1, 0.4, 0.1, 0.2, -0.8)
AXIS = np.array([0.6, 0.0, 0.8])

Array = np.ndarray


def pose(numbers: tuple[float, ...]) -> Array:
    """Return roll, pitch and yaw about fixed axes, and a position, as a matrix."""
    X = np.eye(4)
    X[:3, :3], X[:3, 3] = Rotation.from_euler("xyz", numbers[3:]).as_matrix(), numbers[:3]
    return X


def text(numbers: tuple[float, ...]) -> str:
    return " ".join(map(str, numbers))


def link(name: str, more: str = INERTIA) -> str:
    return f'<link name="{name}"><pose>{text(POSES[name])}</pose>{more}</link>'


def joint(name: str, kind: str, parent: str, child: str, inner: str | None = None, place: str | None = None) -> str:
    inner = "<axis><xyz>0.6 0 0.8</xyz></axis>" if inner is None else inner
    place = f"<pose>{text(POSES['j' + child])}</pose>" if place is None else place
    return f'<joint name="{name}" type="{kind}">{place}<parent>{parent}</parent><child>{child}</child>{inner}</joint>'


def save(folder: Path, inner: str, version: str = "1.9", outer: str = "") -> Path:
    path = folder / "machine.sdf"
    model = f'<model name="machine"><pose>{text(TOP)}</pose>\n{inner}\n</model>'
    gravity = "<gravity>0 1 -9</gravity>"
    path.write_text(f'<sdf version="{version}"><world name="lab">{gravity}{outer}\n{model}</world></sdf>', "utf-8")
    return path


CHAIN = "\n".join(
    [
        *map(link, "abc"),
        joint("ja", "revolute", "world", "a"),
        joint("jb", "prismatic", "a", "b"),
        joint("jc", "continuous", "b", "c"),
    ]
)


def move(kind: str, axis: Array, q: Array) -> Array:
    """Return a joint's motion in its frame."""
    X = np.eye(4)
    if kind == "screw":
        X[:3, 3] = axis * q[0] * 0.5 / (2 * np.pi)
    if kind == "prismatic":
        X[:3, 3] = axis * q[0]
    elif kind == "ball":
        X[:3, :3] = Rotation.from_euler("ZYX", q).as_matrix()
    elif kind == "universal":
        second = Rotation.from_rotvec(q[1] * np.array([0, 1.0, 0]))
        X[:3, :3] = (Rotation.from_rotvec(q[0] * axis) * second).as_matrix()
    elif kind != "fixed":
        X[:3, :3] = Rotation.from_rotvec(q[0] * axis).as_matrix()
    return X


def place_links(
    kinds: tuple[str, str, str], axes: tuple[Array, Array, Array], q: Array, reversed: str = ""
) -> list[Array]:
    """Return the poses of the links of a chain in the world; `reversed` links are parents of the joints before them.

    A reversed ball has the coordinates of the parent's turn in the child.
    """
    motion, found = np.eye(4), []
    for name, kind, axis in zip("abc", kinds, axes, strict=True):
        size = {"ball": 3, "universal": 2, "fixed": 0}.get(kind, 1)
        own = pose(TOP) @ pose(POSES[name])
        home = own @ pose(POSES[f"j{name}"])
        step = move(kind, axis, q[:size] if name not in reversed else q[:size][::-1] if kind != "ball" else q[:size])
        step = np.linalg.inv(step) if name in reversed and kind != "ball" else step
        motion = motion @ home @ step @ np.linalg.inv(home)
        q = q[size:]
        found.append(motion @ own)
    return found


def measure(poses: Array, after: Array, h: float) -> float:
    """Return the kinetic energy between two sets of poses of the links, h apart."""
    total = 0.0
    inner = pose((0.1, -0.2, 0.05, 0.3, -0.2, 0.5))
    for X, Y in zip(poses @ inner, after @ inner, strict=True):
        v = (Y[:3, 3] - X[:3, 3]) / h
        om = Rotation.from_matrix(X[:3, :3].T @ Y[:3, :3]).as_rotvec() / h
        total += (MASS * v @ v + om @ TENSOR @ om) / 2
    return total


def compare(
    imported: Imported,
    kinds: tuple[str, str, str],
    axes: tuple[Array, Array, Array] = (AXIS,) * 3,
    reversed: str = "",
) -> None:
    """Compare places and kinetic energy at a random state."""
    tree = open_loops(build_tree(imported.model))
    rng, n = np.random.default_rng(1), len(tree.coordinates)
    q, qd, h = rng.uniform(-1, 1, n), rng.uniform(-1, 1, n), 1e-4
    at, before, after = (np.array(place_links(kinds, axes, x, reversed)) for x in (q, q - h / 2 * qd, q + h / 2 * qd))
    found = evaluate(FUNCTIONS["frames"].build(tree, NONE), {"q": list(q)})
    for k, X in enumerate(at, len(tree.bodies)):  # behind the bodies
        np.testing.assert_allclose(np.array(found["p"], float).reshape(-1, 3)[k], X[:3, 3], atol=1e-13)
        np.testing.assert_allclose(np.array(found["R"], float).reshape(-1, 3, 3)[k].T, X[:3, :3], atol=1e-13)
    kinetic = float(evaluate(FUNCTIONS["energy"].build(tree, NONE), {"q": list(q), "qd": list(qd)})["kinetic"][0])
    assert kinetic == pytest.approx(measure(before, after, h), rel=1e-6)  # of differences: h^2


ALL = Choices(sensors=("a", "b", "c"))


def told(imported: Imported) -> str:
    return "\n".join(str(notice.without_folder()) for notice in imported.notices)


def refuse(path: Path) -> str:
    with pytest.raises(InputError) as caught:
        import_model(path)
    return str(caught.value)


def test_links_move_as_the_poses_of_the_file_say(tmp_path: Path) -> None:
    imported = import_model(save(tmp_path, CHAIN), ALL)
    compare(imported, ("revolute", "prismatic", "continuous"))
    assert imported.model.gravity == (Number(0.0), Number(1.0), Number(-9.0))
    (tmp_path / "model.yaml").write_text(write_imported(imported), encoding="utf-8")
    assert read_model(tmp_path / "model.yaml") == imported.model


@pytest.mark.parametrize("kind", ["ball", "universal", "screw", "fixed"])
def test_every_kind_of_joint_moves_as_it_should(kind: str, tmp_path: Path) -> None:
    """A screw advances by its pitch in a turn, to the right for a positive one; the older element counts -rad/m."""
    inner = "<axis><xyz>0.6 0 0.8</xyz></axis><axis2><xyz>0 1 0</xyz></axis2>"
    pitches = ("<screw_thread_pitch>0.5</screw_thread_pitch>", f"<thread_pitch>{-4 * np.pi}</thread_pitch>")
    for pitch in pitches if kind == "screw" else ("",):
        chain = CHAIN.replace(joint("jb", "prismatic", "a", "b"), joint("jb", kind, "a", "b", inner + pitch))
        compare(import_model(save(tmp_path, chain), ALL), ("revolute", kind, "continuous"))


def test_frames_and_axes_are_found_where_they_are_named(tmp_path: Path) -> None:
    """The same mechanism, with poses in other frames, joints between frames, degrees, a quaternion, and a model in it.

    Link a's pose is given from the model that it is in, c's joint by its place in b, and b's axis in the model's frame.
    """
    R = (pose(POSES["b"]) @ pose(POSES["jb"]))[:3, :3]
    in_model = f'<axis><xyz expressed_in="__model__">{text(tuple(R @ AXIS))}</xyz></axis>'
    X = np.linalg.inv(pose(POSES["b"])) @ pose(POSES["c"]) @ pose(POSES["jc"])
    quaternion = text((*X[:3, 3], *Rotation.from_matrix(X[:3, :3]).as_quat()))
    moved = f'<pose relative_to="b" rotation_format="quat_xyzw">{quaternion}</pose>'
    angles = np.degrees(POSES["a"][3:])
    inside = f'<model name="inner"><link name="a"><pose degrees="true">{text((*POSES["a"][:3], *angles))}</pose>'
    chain = "\n".join(
        [
            f"{inside}{INERTIA}</link></model>",
            *map(link, "bc"),
            '<frame name="seat" attached_to="inner::a"><pose>1 2 3 0 0 1</pose></frame>',
            joint("ja", "revolute", "world", "inner::a", place=f"<pose>{text(POSES['ja'])}</pose>"),
            joint("jb", "prismatic", "seat", "b", in_model),
            joint("jc", "continuous", "b", "c", place=moved),
        ]
    ).replace(f"<pose>{text(POSES['a'])}</pose>{INERTIA}", INERTIA)
    imported = import_model(save(tmp_path, chain), Choices(sensors=("inner::a", "b", "c")))
    compare(imported, ("revolute", "prismatic", "continuous"))


@pytest.mark.parametrize(
    ("version", "flag"), [("1.4", ""), ("1.5", "<use_parent_model_frame>1</use_parent_model_frame>")]
)
def test_older_files_have_axes_in_the_frame_of_the_model(version: str, flag: str, tmp_path: Path) -> None:
    chain = CHAIN.replace("<xyz>0.6 0 0.8</xyz>", f"<xyz>0.6 0 0.8</xyz>{flag}")
    axes = tuple((pose(POSES[x]) @ pose(POSES[f"j{x}"]))[:3, :3].T @ AXIS for x in "abc")
    imported = import_model(save(tmp_path, chain, version), ALL)
    compare(imported, ("revolute", "prismatic", "continuous"), (axes[0], axes[1], axes[2]))


KINDS = {
    "revolute": Cut.HINGE,
    "continuous": Cut.HINGE,
    "prismatic": Cut.PRISMATIC,
    "ball": Cut.BALL,
    "fixed": Cut.SOLID,
    "universal": Cut.UNIVERSAL,
    "revolute2": Cut.UNIVERSAL,
    "screw": Cut.HELICAL,
}


@pytest.mark.parametrize("kind", KINDS)
def test_a_joint_beyond_the_tree_closes_a_loop(kind: str, tmp_path: Path) -> None:
    """Both ends are at the joint's place in the pose of the file, with the joint's axes."""
    place = "<pose>0.3 0.1 -0.2 0.5 0.6 0.7</pose>"
    inner = "<axis><xyz>0.6 0 0.8</xyz></axis><axis2><xyz>0 1 0</xyz></axis2>"
    imported = import_model(save(tmp_path, CHAIN + joint("pin", kind, "a", "c", inner, place)), ALL)
    (loop,) = imported.model.loops
    assert (loop.name, loop.cut) == ("pin", KINDS[kind])
    assert 'joint[pin]: "pin" closes a loop' in told(imported)
    tree = build_tree(imported.model)
    ((p1, p2, R1, R2),) = place_ends(tree, np.zeros(3))
    home = pose(TOP) @ pose(POSES["c"]) @ pose((0.3, 0.1, -0.2, 0.5, 0.6, 0.7))
    given = {Cut.BALL: np.array([0, 0, 1.0]), Cut.SOLID: np.array([0, 0, 1.0])}.get(loop.cut, AXIS)
    second = np.array([0, 1.0, 0]) if loop.cut is Cut.UNIVERSAL else given
    for p, R, axis in ((p1, R1, given), (p2, R2, second)):
        np.testing.assert_allclose(p, home[:3, 3], atol=1e-14)
        np.testing.assert_allclose(R[:, 2], home[:3, :3] @ axis, atol=1e-14)
    compare(imported, ("revolute", "prismatic", "continuous"))
    if loop.cut is Cut.HELICAL:
        assert loop.pitch == Number(1 / (2 * np.pi))
    if loop.cut is Cut.UNIVERSAL:
        assert loop.axis2 == (Number(0.0), Number(1.0), Number(0.0))


@pytest.mark.parametrize("kind", ["revolute", "prismatic", "ball", "universal", "screw", "fixed"])
def test_a_joint_carries_its_parent_where_only_its_child_is_connected(kind: str, tmp_path: Path) -> None:
    """Coordinates stay the child's in the parent, which moves the other way; no body floats, and no loop is closed."""
    inner = "<axis><xyz>0.6 0 0.8</xyz></axis><axis2><xyz>0 1 0</xyz></axis2>"
    inner += "<screw_thread_pitch>0.5</screw_thread_pitch>"
    place = f'<pose relative_to="c">{text(POSES["jc"])}</pose>'
    before = joint("jc", "continuous", "b", "c")
    imported = import_model(save(tmp_path, CHAIN.replace(before, joint("jc", kind, "c", "b", inner, place))), ALL)
    assert not imported.model.loops
    assert 'it carries its parent here, "c": its child stands nearer to the base' in told(imported)
    compare(imported, ("revolute", "prismatic", kind), reversed="c")


def test_parts_hang_where_the_fewest_joints_carry_their_parents(tmp_path: Path) -> None:
    """A chain of a and b hangs on c, which the world carries, or begins at its middle."""
    first, last = joint("ja", "revolute", "a", "b"), joint("jc", "revolute", "world", "c")
    links = "".join(map(link, "abc"))
    upside = import_model(save(tmp_path, links + first + last + joint("jb", "revolute", "c", "b")), ALL)
    assert [(body.name, body.parent) for body in upside.model.bodies] == [("c", "base"), ("b", "c"), ("a", "b")]
    assert not upside.model.loops
    middle = import_model(save(tmp_path, links + first + joint("jb", "revolute", "c", "b")), ALL)
    assert [(body.name, body.parent) for body in middle.model.bodies] == [("a", "base"), ("b", "a"), ("c", "b")]
    assert [len(body.joints) for body in middle.model.bodies] == [6, 1, 1]
    looped = joint("jb", "revolute", "c", "b", "<axis/><physics><simbody><must_be_loop_joint>1</must_be_loop_joint>"
                   "</simbody></physics>")  # fmt: skip
    assert [x.name for x in import_model(save(tmp_path, links + first + last + looped), ALL).model.loops] == ["jb"]


def test_a_joint_to_a_static_link_carries_its_parent(tmp_path: Path) -> None:
    wall = f'<model name="wall"><static>1</static>{link("a")}</model>'
    hinge = joint("ja", "revolute", "machine::b", "wall::a", place="<pose>0.1 0 0 0 0 1</pose>")
    imported = import_model(save(tmp_path, link("b"), outer=wall + hinge))
    assert [(body.name, len(body.joints)) for body in imported.model.bodies] == [("wall::a", 0), ("machine::b", 1)]
    assert not imported.model.loops


LEVEL = '<axis><xyz expressed_in="__model__">0 1 0</xyz></axis>'


def test_a_four_bar_is_assembled_where_the_file_draws_it(tmp_path: Path) -> None:
    """Three hinges of a graph carry links, in the order of the file, and the fourth closes the loop."""
    bars = [
        *map(link, "abc"),
        joint("ja", "revolute", "world", "a", LEVEL),
        joint("jd", "revolute", "b", "c", LEVEL, "<pose>0 0 0.5 0 0 0</pose>"),
        joint("jb", "revolute", "a", "b", LEVEL),
        joint("jc", "revolute", "world", "c", LEVEL),
    ]
    imported = import_model(save(tmp_path, "".join(bars)))
    assert [loop.name for loop in imported.model.loops] == ["jc"]
    closure = assemble(build_tree(imported.model)).closure
    assert closure is not None
    np.testing.assert_allclose(np.array(closure.pose, float), 0, atol=1e-12)
    assert (len(closure.independent), len(closure.kept)) == (1, 2)


def test_what_a_file_leaves_open_has_the_values_of_the_specification(tmp_path: Path) -> None:
    """A link without inertia has 1 kg and 1 kg m2; without a joint it moves freely, in a static model not at all."""
    inner = "<axis><limit><lower>-inf</lower><upper>1e16</upper><effort>-1</effort></limit></axis>"
    imported = import_model(save(tmp_path, link("a", "") + link("b") + joint("j", "revolute", "a", "b", inner)))
    free, carried = imported.model.bodies
    assert free.mass == Number(1.0)
    assert free.inertia.xx == Number(1.0)
    assert len(free.joints) == 6
    assert "no joint carries it: it moves freely" in told(imported)
    assert "1 kg, and 1 kg m2" in told(imported)
    (hinge,) = carried.joints
    assert (hinge.lower, hinge.upper, hinge.max_force, hinge.axis[2]) == (None, None, None, Number(1.0))
    held = save(tmp_path, f"{link('b')}{joint('j', 'revolute', 'world', 'b')}")
    fixed = f'<model name="wall"><static>true</static>{link("a")}</model>'
    held.write_text(held.read_text("utf-8").replace("<model", f"{fixed}<model", 1), encoding="utf-8")
    assert [len(body.joints) for body in import_model(held).model.bodies] == [0, 1]


def test_joints_of_a_static_model_are_left_out(tmp_path: Path) -> None:
    """Its links stand fast beside another model, whose joints move."""
    inner = link("a") + link("b") + joint("ja", "fixed", "world", "a") + joint("jb", "revolute", "a", "b")
    wall = f'<model name="wall"><static>true</static>{inner}</model>'
    imported = import_model(save(tmp_path, link("c") + joint("jc", "revolute", "world", "c"), outer=wall))
    moving = {body.name: len(body.joints) for body in imported.model.bodies}
    assert moving == {"wall::a": 0, "wall::b": 0, "machine::c": 1}
    assert "its links are static: it is left out" in told(imported)


@pytest.mark.parametrize(
    ("kind", "inner", "text"),
    [
        ("ball", "<axis><limit><lower>-1</lower></limit></axis>", "limits of a ball"),
        ("revolute", "<axis2><dynamics><damping>2</damping></dynamics></axis2>", "a second axis of a joint"),
        ("ball", "<axis2><xyz>0 1 0</xyz></axis2>", "a second axis of a joint"),
    ],
)
def test_what_a_joint_does_not_have_is_a_warning(kind: str, inner: str, text: str, tmp_path: Path) -> None:
    imported = import_model(save(tmp_path, link("a") + joint("ja", kind, "world", "a", inner)))
    assert [notice.text.startswith(text) for notice in imported.notices if notice.alters] == [True]


def test_the_flag_of_older_axes_has_no_meaning_from_version_1_7_on(tmp_path: Path) -> None:
    """As in sdformat, which knows no such element there; see the test of axes for 1.5."""
    flagged = "<axis><xyz>0 1 0</xyz><use_parent_model_frame>1</use_parent_model_frame></axis>"
    plain = flagged.replace("<use_parent_model_frame>1</use_parent_model_frame>", "")
    models = []
    for axis in (flagged, plain):
        file = save(tmp_path, link("b") + joint("jb", "revolute", "world", "b", axis), version="1.7")
        models.append(import_model(file))
    assert models[0].model == models[1].model
    assert any(notice.alters and "since version 1.7" in notice.text for notice in models[0].notices)


def test_springs_losses_bounds_and_mimics_are_read(tmp_path: Path) -> None:
    inner = (
        "<axis><limit><lower>-1</lower><upper>2</upper><effort>5</effort><velocity>3</velocity></limit><dynamics>"
        "<damping>0.5</damping><friction>0.2</friction><spring_stiffness>7</spring_stiffness>"
        "<spring_reference>0.1</spring_reference></dynamics></axis>"
    )
    mimic = '<axis><mimic joint="ja"><multiplier>2</multiplier><offset>0.5</offset>'
    mimic += "<reference>0.1</reference></mimic></axis>"
    joints = joint("ja", "revolute", "world", "a", inner), joint("jb", "revolute", "a", "b", mimic)
    chain = "".join([*map(link, "abc"), *joints, joint("jc", "revolute", "b", "c")])
    one, other, _ = (body.joints[0] for body in import_model(save(tmp_path, chain)).model.bodies)
    assert (one.lower, one.upper, one.max_force, one.max_speed) == tuple(map(Number, (-1.0, 2.0, 5.0, 3.0)))
    assert (one.law.stiffness, one.law.rest, one.law.damping) == tuple(map(Number, (7.0, 0.1, 0.5)))
    assert one.law.friction is not None
    assert other.follows == Follow("ja", Number(2.0), Number(0.5 - 2 * 0.1))
    held = import_model(save(tmp_path, chain), Choices(locked=(("jb", 0.5),))).model
    assert len(held.constraints) == 1


@pytest.mark.parametrize(
    ("change", "finding"),
    [
        (("<parent>a</parent>", "<parent>arm</parent>"), 'there is no frame "arm"; '),
        (("<child>b</child>", "<child>world</child>"), "its child is the world; let the world be the parent"),
        (("<parent>b</parent>", ""), "a joint without a parent"),
        (("<parent>b</parent>", "<parent>c</parent>"), "its parent and its child are one link"),
        (('type="prismatic"', 'type="slide"'), 'type is "slide"; give revolute, '),
        (("<xyz>0.6 0 0.8</xyz>", "<xyz>0 0 0</xyz>"), "an axis without direction"),
        (("<xyz>0.6 0 0.8</xyz>", '<xyz expressed_in="x">1 0 0</xyz>'), 'there is no frame "x"'),
        (('name="b"><pose', 'name="b"><pose relative_to="jb"'), "its pose depends on itself"),
        (('name="b"><pose', 'name="b"><pose frame="a"'), "a pose with a frame"),
        (('<link name="b">', '<link name="a">'), '"a" is already in line'),
        (('<link name="b">', "<link>"), "a link without a name"),
        (('name="jb"', 'name="a::b"'), 'the name "a::b"'),
        (("<ixx>0.02</ixx>", "<ixx>two</ixx>"), 'ixx is "two"'),
        (("<inertial>", '<inertial auto="true">'), "computed from shapes"),
        (("</axis>", "<dynamics><damping>-1</damping></dynamics></axis>"), "damping is -1; give 0 or more"),
        (("</axis>", "<limit><lower>2</lower><upper>1</upper></limit></axis>"), "lower is 2, and upper 1; swap them"),
        (("</axis>", '<mimic joint="c"/></axis>'), "a mimic of joints without a coordinate each"),
        (('<model name="machine">', '<model name="machine" placement_frame="x">'), 'there is no frame "x"'),
        (("<gravity>0 1 -9</gravity>", "<include><uri>x</uri></include>"), "an included model, which is not read"),
        (("</world>", '</world><world name="other"/>'), "a second world"),
        (('version="1.9"', ""), "an <sdf> without a version"),
        (('version="1.9"', 'version="2.0"'), 'its version is "2.0"'),
    ],
)
def test_what_is_refused(change: tuple[str, str], finding: str, tmp_path: Path) -> None:
    path = save(tmp_path, CHAIN)
    wrong = path.read_text("utf-8").replace(*change)
    path.write_text(wrong, encoding="utf-8")
    message = refuse(path)
    assert finding in message
    assert "machine.sdf:" in message


@pytest.mark.parametrize(
    ("part", "notice"),
    [
        ('<plugin name="p" filename="f"/>', "warning: plugin is not part of the model"),
        ('<joint name="g" type="gearbox"><parent>a</parent><child>b</child></joint>', "warning: a gearbox is not part"),
        (joint("pin", "ball", "a", "c", "<axis/>"), '"pin" closes a loop'),
        (
            joint("pin", "revolute", "a", "c", "<axis><dynamics><damping>1</damping></dynamics></axis>"),
            "warning: damping of a joint that closes a loop is left out",
        ),
        ("<self_collide>1</self_collide>", "of no meaning for the dynamics: 1 self_collide"),
    ],
)
def test_what_is_not_read_is_reported(part: str, notice: str, tmp_path: Path) -> None:
    assert notice in told(import_model(save(tmp_path, CHAIN + part)))


def test_the_pose_of_a_model_is_that_of_its_placement_frame(tmp_path: Path) -> None:
    """In nested models, and where the frame is a link of the model inside."""
    turned, pin = (0.3, 0.2, 0.1, 0.1, -0.4, 0.2), (0.1, 0.0, 0.0, 0.1, 0.2, 0.3)
    inner = (
        f'<model name="in" placement_frame="jb"><pose relative_to="a">{text(pin)}</pose>{link("b")}{link("c")}'
        f"{joint('jb', 'revolute', 'c', 'b', place=f'<pose>{text(turned)}</pose>')}</model>"
    )
    chain = link("a") + inner + joint("ja", "revolute", "world", "a") + joint("jc", "revolute", "a", "in::c", place="")
    path = save(tmp_path, chain)
    path.write_text(path.read_text("utf-8").replace('"machine">', '"machine" placement_frame="in::c">'), "utf-8")
    imported = import_model(path, Choices(sensors=("a", "in::b", "in::c")))
    joint_in_model = pose(POSES["b"]) @ pose(turned)
    model_in_a = pose(pin) @ np.linalg.inv(joint_in_model)
    c = pose(TOP)
    a = c @ np.linalg.inv(model_in_a @ pose(POSES["c"]))
    b = a @ model_in_a @ pose(POSES["b"])
    tree = build_tree(imported.model)
    found = evaluate(FUNCTIONS["frames"].build(tree, NONE), {"q": [0.0] * len(tree.coordinates)})
    names = [frame.name for frame in imported.model.frames]
    for k, X in zip((len(tree.bodies) + names.index(x) for x in ("a", "in::b", "in::c")), (a, b, c), strict=True):
        np.testing.assert_allclose(np.array(found["p"], float).reshape(-1, 3)[k], X[:3, 3], atol=1e-13)
        np.testing.assert_allclose(np.array(found["R"], float).reshape(-1, 3, 3)[k].T, X[:3, :3], atol=1e-13)


def test_long_chains_of_frames_are_no_burden(tmp_path: Path) -> None:
    frames = "".join(f'<frame name="f{k}" attached_to="f{k + 1}"/>' for k in range(5000))
    chain = f'{CHAIN}{frames}<frame name="f5000" attached_to="a"/>'.replace("<parent>a<", "<parent>f0<")
    assert len(import_model(save(tmp_path, chain)).model.bodies) == 3


GRAVITY_OF_THE_MOON = "<physics type='ode'><gravity>0 0 -1.62</gravity></physics>"


@pytest.mark.parametrize(
    ("version", "parts", "expected", "warned"),
    [
        ("1.5", GRAVITY_OF_THE_MOON, -1.62, ""),
        (
            "1.2",
            f"<physics/>{GRAVITY_OF_THE_MOON.replace('physics ', 'physics default=' + chr(39) + '1' + chr(39) + ' ')}",
            -1.62,
            "",
        ),
        ("1.4", f"<gravity>0 0 -3</gravity>{GRAVITY_OF_THE_MOON}", -3.0, "gravity is already given"),
        ("1.6", GRAVITY_OF_THE_MOON, -9.8, "no part of its physics since version 1.6"),
        ("1.12", f"<gravity>0 0 -3</gravity>{GRAVITY_OF_THE_MOON}", -3.0, "no part of its physics since version 1.6"),
    ],
)
def test_gravity_is_under_physics_up_to_version_1_5(
    version: str, parts: str, expected: float, warned: str, tmp_path: Path
) -> None:
    path = tmp_path / "machine.sdf"
    model = '<model name="m"><link name="b"><inertial><mass>2</mass></inertial></link></model>'
    path.write_text(f'<sdf version="{version}"><world name="w">{parts}{model}</world></sdf>', encoding="utf-8")
    imported = import_model(path)
    assert imported.model.gravity == (Number(0.0), Number(0.0), Number(expected))
    warnings = [notice.text for notice in imported.notices if notice.alters]
    assert len(warnings) == bool(warned)
    assert all(warned in text for text in warnings)


def test_files_of_version_1_0_are_refused(tmp_path: Path) -> None:
    assert "convert it to a version of SDFormat from 1.2 on" in refuse(save(tmp_path, CHAIN, "1.0"))


def test_limits_without_an_end_are_none(tmp_path: Path) -> None:
    for size in ("1.79769e+308", "inf", "1e16"):
        limit = f"<limit><lower>-{size}</lower><upper>{size}</upper><effort>{size}</effort></limit>"
        chain = CHAIN.replace("<xyz>0.6 0 0.8</xyz>", f"<xyz>0.6 0 0.8</xyz>{limit}", 1)
        body = import_model(save(tmp_path, chain)).model.bodies[0]
        assert (body.joints[0].lower, body.joints[0].upper, body.joints[0].max_force) == (None,) * 3


def test_names_of_flattened_models_are_names_up_to_version_1_7(tmp_path: Path) -> None:
    """Gazebo saved included models so; from version 1.8 on, :: leads into a model."""
    flat = CHAIN.replace('name="b"', 'name="arm::b"').replace(">b<", ">arm::b<").replace('name="jb"', 'name="arm::jb"')
    imported = import_model(save(tmp_path, flat, "1.7"), Choices(sensors=("a", "arm::b", "c")))
    compare(imported, ("revolute", "prismatic", "continuous"))
    assert "which versions up to 1.7 may have" in refuse(save(tmp_path, flat, "1.8"))


def test_the_frame_of_a_model_in_the_model_is_named_by_its_path(tmp_path: Path) -> None:
    """A joint that carries M1::__model__ carries the first link of that model, at the model's pose."""
    inner = f'<model name="M1">{link("b")}</model>'
    start = link("a") + inner + joint("ja", "revolute", "world", "a")
    chains = [start + joint("jb", "prismatic", "a", child, place="") for child in ("M1::__model__", "M1")]
    first, second = (import_model(save(tmp_path, chain)).model for chain in chains)
    assert first == second
    assert first.bodies[1].parent == "a"
    assert "no frame" in refuse(save(tmp_path, chains[0].replace("M1::__model__", "M1::b::__model__")))


def test_a_model_is_attached_to_its_own_first_link(tmp_path: Path) -> None:
    """A link of a model in it comes after, wherever it stands in the file: as sdformat chooses, by Drake."""
    inner = f'<model name="deep">{link("c")}</model>'
    chain = f'{link("a")}<model name="M1">{inner}{link("b")}</model>' + joint("jb", "fixed", "a", "M1", place="")
    bodies = {body.name: body.parent for body in import_model(save(tmp_path, chain)).model.bodies}
    assert (bodies["M1::b"], bodies["M1::deep::c"]) == ("a", "base")


def test_ranges_and_contacts_that_nothing_keeps_are_warned_of(tmp_path: Path) -> None:
    limit = "<limit><lower>-1</lower></limit>"
    chain = CHAIN.replace("<xyz>0.6 0 0.8</xyz>", f"<xyz>0.6 0 0.8</xyz>{limit}", 1)
    imported = import_model(save(tmp_path, f"{chain}<self_collide>true</self_collide>"))
    assert "warning: the ranges of 1 joint bound problems alone: a simulation passes them" in told(imported)
    assert "warning: contacts of links are not part of the model" in told(imported)
