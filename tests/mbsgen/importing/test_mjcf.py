"""MJCF is imported as MuJoCo reads it; notices list the rest."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mbsgen.errors import InputError
from mbsgen.expressions import FLOATS, Expression, Number
from mbsgen.expressions import evaluate as evaluate_expression
from mbsgen.formulations import semi
from mbsgen.formulations.reductions import NONE
from mbsgen.importing import Choices, Imported, import_model, write_imported
from mbsgen.importing.poses import place
from mbsgen.model.changes.reduction import build_tree
from mbsgen.model.following import list_joints
from mbsgen.model.model import Body, Fixed, Friction, Joint, Law
from mbsgen.model.reader import read_model
from mbsgen.pipeline import read
from mbsgen.tape.interpreter import evaluate
from tests.import_peers import Kernels, MujocoPeer, State, largest_miss

# Sums of some hundred products of numbers near 1, and a solution with an M of condition below 1e4.
TOLERANCE = 1e-11
DEFAULT = Choices()

INERTIAL = '<inertial pos="0.1 -0.05 0.2" quat="0.9 0.1 -0.2 0.3" mass="1.5" diaginertia="0.02 0.03 0.025"/>'
FULL = '<inertial pos="0 0.1 0.2" mass="0.7" fullinertia="0.02 0.03 0.025 0.001 -0.002 0.003"/>'

TREE = f"""
<compiler angle="degree" eulerseq="zYx"/>
<option gravity="0.5 0 -9"/>
<default>
  <joint axis="0 1 0" pos="0.05 0 0.1"/>
  <geom density="700"/>
  <default class="slider"><joint type="slide" axis="1 0 2"/></default>
</default>
<worldbody>
  <body name="trunk" pos="0 0 1" euler="10 20 30"><freejoint/>{INERTIAL}
    <body name="arm" pos="0.3 0 0" axisangle="0 1 1 40">
      <joint name="pan" range="-45 90"/><joint name="tilt" axis="1 1 0" pos="0 0.1 0" ref="15"/>{FULL}
      <body name="ball" pos="0 0 0.4" xyaxes="0 1 0 -1 0 0"><joint type="ball" name="wrist"/>{INERTIAL}
        <body name="weld" pos="0.1 0 0" zaxis="1 0 1"><geom type="box" size="0.1 0.2 0.05"/></body>
      </body>
    </body>
    <body name="cart" childclass="slider" pos="0 0.2 0"><joint name="rail" ref="0.3" range="-1 1"/>
      <frame pos="0.1 0 0" quat="0.8 0.6 0 0">
        <geom type="capsule" fromto="0 0 0 0.1 0.2 0.3" size="0.05" mass="0.4"/>
        <body name="tip"><joint class="main" name="turn"/><geom type="cylinder" size="0.1 0.2" pos="0.1 0 0"/>
          <geom type="sphere" size="0.1" pos="0 0 0.3"/>
          <geom type="ellipsoid" size="0.1 0.2 0.15" euler="20 0 40"/></body>
      </frame>
    </body>
  </body>
</worldbody>"""


def write(folder: Path, inner: str, file: str = "machine.xml", root: str = "mujoco") -> Path:
    path = folder / file
    path.write_text(f'<{root} model="machine">\n{inner}\n</{root}>\n', encoding="utf-8")
    return path


def world(inner: str) -> str:
    return f"<worldbody>{inner}</worldbody>"


def pendulum(joint: str, inertial: str = INERTIAL) -> str:
    return world(f'<body name="rod">{joint}{inertial}</body>')


def body(imported: Imported, name: str) -> Body:
    return next(body for body in imported.model.bodies if body.name == name)


def only_joint(imported: Imported, name: str) -> Joint:
    found = body(imported, name).joint
    assert isinstance(found, Joint)
    return found


def value_of(number: Expression) -> float:
    return float(evaluate_expression(number, {}, FLOATS))


def warnings(imported: Imported) -> list[str]:
    return [str(notice.without_folder()).removeprefix("machine.xml:") for notice in imported.notices if notice.alters]


def faults_of(path: Path, choices: Choices = DEFAULT) -> str:
    with pytest.raises(InputError) as caught:
        import_model(path, choices)
    return str(caught.value)


def assert_mujoco_agrees(path: Path, imported: Imported) -> None:
    kernels, peer = Kernels(imported, ("impl", "semi", "exp2")), MujocoPeer(path)
    for state in kernels.draw_states():
        for name, miss in largest_miss(kernels.compute(state), peer.compute(state)).items():
            assert miss < TOLERANCE, name


def test_the_equations_are_mujocos(tmp_path: Path) -> None:
    """Every orientation, joint, shape and default; anchors off the bodies' origins; frames; references."""
    path = write(tmp_path, TREE)
    imported = import_model(path)
    assert [only_joint(imported, "tip").name, len(imported.model.bodies)] == ["turn", 6]
    assert_mujoco_agrees(path, imported)


def test_what_is_written_is_read_as_the_same_model(tmp_path: Path) -> None:
    imported = import_model(write(tmp_path, TREE), Choices(sensors=("tip",)))
    file = tmp_path / "machine.yaml"
    file.write_text(write_imported(imported), encoding="utf-8")
    assert read_model(file) == imported.model


@pytest.mark.parametrize(
    "settings",
    [
        'angle="radian" inertiafromgeom="true"',
        'settotalmass="7"',
        'inertiagrouprange="0 2"',
        'eulerseq="XYZ"',
        'autolimits="false"',
    ],
)
def test_settings_of_the_compiler(tmp_path: Path, settings: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)  # MuJoCo logs what it warns of where it runs
    geoms = '<geom type="box" size="0.1 0.2 0.3"/><geom type="sphere" size="0.2" pos="1 0 0" group="3"/>'
    hinge = '<joint axis="0 0 1" pos="0.1 0 0" ref="0.2" limited="true" range="-1 1"/>'
    outer = f'<body name="b" pos="0 1 0">{hinge}{INERTIAL}{geoms}</body>'
    inner = f'<body name="a" euler="0.4 0.5 0.6">{hinge}{geoms}{outer}</body>'
    path = write(tmp_path, f"<compiler {settings}/>{world(inner)}")
    assert_mujoco_agrees(path, import_model(path))


def test_springs_and_dampers_are_mujocos(tmp_path: Path) -> None:
    """The force of a joint's own, at rest of dry friction: stiffness (springref - q) - damping qd, as qfrc_passive."""
    import mujoco

    path = write(tmp_path, pendulum('<joint stiffness="3" springref="30" damping="0.5" ref="20" pos="0 0 0.1"/>'))
    law = only_joint(import_model(path), "rod").law
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    data.qpos[0], data.qvel[0] = 0.7, -1.3
    mujoco.mj_forward(model, data)
    stiffness, rest, damping = (x.value for x in (law.stiffness, law.rest, law.damping) if isinstance(x, Number))
    np.testing.assert_allclose(stiffness * (rest - 0.7) + damping * 1.3, data.qfrc_passive[0], rtol=1e-14)


def test_friction_and_actuators(tmp_path: Path) -> None:
    """Driven joints have an input, with the force that bounds it; where no joint is driven, all have one."""
    two = world(
        f'<body name="a"><joint name="one" frictionloss="0.3"/>{INERTIAL}'
        f'<body name="b"><joint name="two"/>{INERTIAL}</body></body>'
    )
    free = import_model(write(tmp_path, two))
    assert [only_joint(free, name).actuated for name in "ab"] == [True, True]
    assert only_joint(free, "a").law.friction is not None
    driven = '<actuator><motor name="m" joint="two" gear="20" ctrlrange="-2 1"/></actuator>'
    imported = import_model(write(tmp_path, two + driven))
    assert [only_joint(imported, name).actuated for name in "ab"] == [False, True]
    assert [only_joint(imported, name).max_force for name in "ab"] == [None, Number(40.0)]
    assert any("after the gear 20" in notice.text for notice in imported.notices)


def test_rotors_are_mujocos(tmp_path: Path) -> None:
    """Armature of joints and their default classes, and of actuators by their gears; a ball's is left out, with a
    warning.
    """
    inner = world(
        f'<body name="a"><joint name="one" axis="0 1 0"/>{INERTIAL}'
        f'<body name="b" pos="1 0 0"><joint class="geared" name="two"/>{INERTIAL}</body>'
        f'<body name="c" pos="0 1 0"><joint type="ball"/>{INERTIAL}</body></body>'
    )
    classes = '<default><joint armature="0.5"/><default class="geared"><joint armature="0.25"/></default></default>'
    motors = (
        '<actuator><motor joint="one" gear="3" armature="0.1"/><position joint="two" kp="1" armature="0.2"/>'
        '<motor joint="two" gear="-2" armature="0.1"/></actuator>'
    )
    path = write(tmp_path, classes + inner + motors)
    imported = import_model(path)
    assert only_joint(imported, "a").armature == Number(0.5 + 9 * 0.1)
    assert only_joint(imported, "b").armature == Number(0.25 + (0.2 + 4 * 0.1))
    assert any("armature of a ball is left out" in line for line in warnings(imported))
    assert_mujoco_agrees(path, imported)


def test_locked_joints_and_sensors(tmp_path: Path) -> None:
    inner = (
        f'<body name="a"><joint name="one" axis="0 0 1"/>{INERTIAL}<site name="eye" pos="1 0 0"/>'
        f'<body name="b" pos="1 0 0"><joint name="two" axis="0 1 0" pos="0 0 0.5"/>{INERTIAL}</body></body>'
    )
    imported = import_model(write(tmp_path, world(inner)), Choices(locked=(("two", 0.5),), sensors=("eye", "b")))
    assert isinstance(body(imported, "b").joint, Fixed)
    assert [frame.name for frame in imported.model.frames] == ["eye", "b"]
    assert "no joint to be held" in faults_of(write(tmp_path, world(inner)), Choices(locked=(("three", 0),)))


def test_contacts_that_a_model_leaves_out_are_a_warning(tmp_path: Path) -> None:
    """Unless the masks of a geom, its class's among them, keep it from touching anything, or it is the world's."""
    geoms = '<geom size="0.1"/><geom size="0.1" contype="0"/><geom size="0.1" contype="0" conaffinity="0"/>'
    moving = f'<body name="a"><joint name="one"/>{INERTIAL}{geoms}<geom class="ghost" size="0.1"/></body>'
    inner = world(f'<geom type="plane" size="1 1 1"/>{moving}')
    classes = '<default><default class="ghost"><geom contype="0" conaffinity="0"/></default></default>'
    (warning,) = warnings(import_model(write(tmp_path, classes + inner)))
    assert "2 of the bodies' geoms may touch others: they pass through; --contacts 0 makes contacts" in warning
    alone = f'<geom type="plane" size="1 1 1"/><body name="a"><joint name="one"/>{INERTIAL}</body>'
    assert not warnings(import_model(write(tmp_path, world(alone))))


def test_what_alters_the_motion_is_told_one_by_one(tmp_path: Path) -> None:
    inner = world(
        f'<body name="a" gravcomp="1"><joint name="one"/>{INERTIAL}'
        f'<body name="b" pos="1 0 0"><joint type="ball" stiffness="0.2"/>{INERTIAL}</body></body>'
    )
    acting = (
        '<tendon><fixed name="t"><joint joint="one" coef="1"/></fixed></tendon>'
        '<actuator><position name="p" joint="one" kp="5"/><motor name="m" tendon="t"/></actuator>'
    )
    path = write(tmp_path, f'<option density="1.2"/>{inner}{acting}')
    imported = import_model(path)
    with pytest.warns(UserWarning, match="warning: ") as caught:
        assert read(path) == imported.model
    assert len(caught) == 6
    found = "\n".join(warnings(imported))
    for text in (
        "body[a]: warning: gravcomp",
        "joint: warning: stiffness of a ball is left out",
        "tendon/fixed[t]: warning: fixed (tendon)",
        'position[p]: warning: position of joint "one": gains and dynamics are left out',
        "motor[m]: warning: motor: only actuators of joints become inputs",
        "option: warning: density: the forces of a fluid",
    ):
        assert text in found
    assert len(found.splitlines()) == 6


@pytest.mark.parametrize(
    ("inner", "text"),
    [
        ("", "there is no <worldbody>"),
        (pendulum('<joint axis="0 0 0"/>'), "an axis without direction"),
        (pendulum('<joint type="screw"/>'), 'type is "screw"; give hinge, slide, ball, free'),
        (pendulum('<joint damping="1 2 3 4"/>'), "damping has 4 numbers; give 1 to 3"),
        (pendulum('<joint limited="true"/>'), "limited without range"),
        (pendulum('<joint limited="true" range="1 -1"/>'), "range is 1 to -1; swap them"),
        ('<compiler autolimits="false"/>' + pendulum('<joint range="-1 1"/>'), "range without limited"),
        ('<compiler autolimits="false"/>' + pendulum('<joint actuatorfrcrange="-1 1"/>'), "without actuatorfrclimited"),
        (
            '<compiler autolimits="false"/>'
            + pendulum('<joint name="q"/>')
            + '<actuator><motor joint="q" ctrlrange="-1 1"/></actuator>',
            "ctrlrange without ctrllimited",
        ),
        (world(f'<frame scale="2"><body><joint/>{INERTIAL}</body></frame>'), "scale: it scales its bodies"),
        (pendulum('<joint class="x"/>'), 'there is no default class "x"'),
        (pendulum("<joint/>", '<geom type="mesh" mesh="m"/>'), 'there is no mesh "m"'),
        (pendulum("<joint/>", '<geom type="box" size="1 1"/>'), "a box of 2 sizes; give 3"),
        (pendulum("<joint/>", '<geom type="box" pos="1 0 0" size="1" fromto="0 0 0 1 0 0"/>'), "by pos and fromto"),
        (pendulum("<joint/>", '<geom size="1" fromto="0 0 0 1 0 0"/>'), "a sphere has no fromto"),
        (pendulum("<joint/>", '<geom size="0"/>'), "the size of a sphere is 0"),
        (pendulum("<joint/>", ""), "moves nothing"),
        (pendulum("<joint/>", INERTIAL.replace("0.025", "0.5")), "no body has the principal moments"),
        (pendulum("<joint/>", INERTIAL.replace("0.9 0.1 -0.2 0.3", "0 0 0 0")), "quat is 0"),
        (pendulum("<joint/>", INERTIAL + '<body euler="1 2 3" quat="1 0 0 0"/>'), "turned by quat and euler"),
        (pendulum("<joint/>", INERTIAL + f"<body><freejoint/>{INERTIAL}</body>"), "a free joint within the tree"),
        (pendulum("<joint/>", INERTIAL + '<replicate count="2"/>'), "replicate makes bodies by its own rules"),
        (pendulum("<joint/>", INERTIAL + "<bodi/>"), "no part of a body is called bodi"),
        (pendulum('<joint name="q"/>') + '<actuator><motor joint="Q"/></actuator>', 'no joint "Q"; did you mean "q"?'),
        ('<compiler coordinate="global"/>' + pendulum("<joint/>"), "global coordinates"),
        ('<compiler eulerseq="abc"/>' + pendulum("<joint/>"), "eulerseq is"),
    ],
)
def test_faults(tmp_path: Path, inner: str, text: str) -> None:
    assert text in faults_of(write(tmp_path, inner))


def test_included_files_are_read_from_the_folder_of_the_model_alone(tmp_path: Path) -> None:
    folder = tmp_path / "robot"
    (folder / "parts").mkdir(parents=True)
    write(folder / "parts", pendulum("<joint/>"), root="mujocoinclude")
    assert body(import_model(write(folder, '<include file="parts/machine.xml"/>')), "rod").mass == Number(1.5)
    write(tmp_path, pendulum("<joint/>"), file="outside.xml", root="mujocoinclude")
    (folder / "link.xml").symlink_to(tmp_path / "outside.xml")
    for name in ("../outside.xml", str(tmp_path / "outside.xml"), "link.xml"):
        path = write(folder, f'<include file="{name}"/>')
        assert "is not in the folder of the model" in faults_of(path)
        assert body(import_model(path, Choices(root=tmp_path)), "rod").mass == Number(1.5)
        assert "is not in the folder of the model" in faults_of(path, Choices(root=folder / "parts"))
    assert "includes itself" in faults_of(write(folder, '<include file="machine.xml"/>'))
    assert "there is no such file" in faults_of(write(folder, '<include file="none.xml"/>'))


def test_included_files_may_name_files_beside_them(tmp_path: Path) -> None:
    """MuJoCo looks beside the first file, then beside the one that includes; it takes each file once."""
    (tmp_path / "parts").mkdir()
    write(tmp_path / "parts", '<include file="rod.xml"/>', file="outer.xml", root="mujocoinclude")
    path = write(tmp_path, '<include file="parts/outer.xml"/>')
    assert "rod.xml: there is no such file" in faults_of(path)
    for folder, mass in ((tmp_path / "parts", "1.5"), (tmp_path, "2.5")):  # the last one is beside the first file
        write(folder, pendulum("<joint/>").replace("1.5", mass), file="rod.xml", root="mujocoinclude")
        theirs = pytest.importorskip("mujoco").MjModel.from_xml_path(str(path))
        assert body(import_model(path), "rod").mass == Number(float(mass))
        assert theirs.body_mass[1] == float(mass)
    twice = '<default><include file="parts/none.xml"/></default>' * 2
    write(tmp_path / "parts", '<geom density="1"/>', file="none.xml", root="mujocoinclude")
    assert "is already included" in faults_of(write(tmp_path, twice + pendulum("<joint/>")))
    filled = '<include file="rod.xml"><body/></include>'
    assert "an include with elements in it" in faults_of(write(tmp_path, filled))


def test_forces_without_a_spring_have_no_rest(tmp_path: Path) -> None:
    assert only_joint(import_model(write(tmp_path, pendulum('<joint springref="20"/>'))), "rod").law == Law()


def test_a_free_body_starts_where_the_file_says(tmp_path: Path) -> None:
    inner = world(f'<body name="a" pos="0 0 2" euler="0 0 90"><freejoint/>{INERTIAL}</body>')
    imported = import_model(write(tmp_path, inner))
    assert any("the file puts the body at 0, 0, 2, and turns it" in notice.text for notice in imported.notices)
    kernels = Kernels(imported, ("impl",))
    n = len(kernels.joints)
    still = State(np.zeros(n), np.zeros(n), np.array([0.0, 0.0, -9.81, 0, 0, 0]), np.zeros(n))
    np.testing.assert_allclose(kernels.compute(still)["Phi"], 0, atol=1e-14)


def test_quaternions_are_mujocos(tmp_path: Path) -> None:
    """A free body and balls: M and c, by MuJoCo's velocities, the linear ones of which are along the world's axes.

    v = T qd with T = R of the free body; T qd changes by R (w x v) besides R qdd.
    """
    import mujoco

    inner = world(
        f'<body name="trunk" pos="0 0 1" euler="10 20 30"><freejoint/>{INERTIAL}'
        f'<body name="arm" pos="0.3 0 0"><joint name="pan" axis="0 1 1" pos="0 0.1 0"/>{FULL}'
        f'<body name="hand" pos="0 0 0.4" xyaxes="0 1 0 -1 0 0"><joint type="ball" pos="0.1 0 0"/>{INERTIAL}</body>'
        f'</body></body><body name="buoy" pos="2 0 0" euler="0 40 0"><joint type="ball"/>{FULL}</body>'
    )
    path = write(tmp_path, inner)
    imported = import_model(path, Choices(quaternions=True))
    tree = build_tree(imported.model)
    assert [x.is_free for x in tree.quaternions] == [True, False, False]
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    rng = np.random.default_rng(3)
    n = model.nv
    qd = rng.uniform(-2, 2, n)
    theirs = rng.uniform(-1, 1, model.nq)
    mujoco.mj_normalizeQuat(model, theirs)
    ours = theirs.copy()
    for k in (3, 8, 12):  # MuJoCo's scalars are first
        ours[k : k + 4] = np.roll(theirs[k : k + 4], -1)
    R = np.zeros(9)
    mujoco.mju_quat2Mat(R, theirs[3:7])
    T = np.eye(n)
    T[:3, :3] = R.reshape(3, 3)
    change = np.zeros(n)
    change[:3] = T[:3, :3] @ np.cross(qd[3:6], qd[:3])
    data.qpos[:], data.qvel[:] = theirs, T @ qd
    mujoco.mj_forward(model, data)
    M, c = np.zeros((n, n)), np.zeros(n)
    mujoco.mj_rne(model, data, 0, c)
    for k, column in enumerate(np.eye(n)):
        mujoco.mj_mulM(model, data, M[k], column)
    values = evaluate(semi.build(tree, NONE), {"q": list(ours), "qd": list(qd)})
    found, bias = np.array(values["M"]).reshape(n, n), np.array(values["c"])
    np.testing.assert_allclose(found, T.T @ M @ T, rtol=0, atol=TOLERANCE * np.abs(M).max())
    np.testing.assert_allclose(bias, T.T @ (M @ change + c), rtol=0, atol=TOLERANCE * np.abs(c).max())


def test_classes_of_an_included_file_stand_where_it_is_included(tmp_path: Path) -> None:
    """Below <default> they are separate classes, and change nothing else."""
    heavy = '<default class="heavy"><geom density="5000"/><joint damping="3" armature="0.2"/></default>'
    write(tmp_path, heavy, file="classes.xml", root="mujocoinclude")
    geom = '<geom size="0.1" pos="0.2 0 0"/>'
    inner = f'<body name="b" childclass="heavy"><joint axis="0 1 0"/>{geom}</body>'
    path = write(
        tmp_path,
        '<default><include file="classes.xml"/></default>'
        + world(f'<body name="a"><joint axis="0 1 0"/>{geom}{inner}</body>'),
    )
    imported = import_model(path)
    assert [only_joint(imported, name).law.damping for name in "ab"] == [Number(0.0), Number(3.0)]
    assert_mujoco_agrees(path, imported)


@pytest.mark.parametrize(
    ("flags", "law", "limits"),
    [
        ("", Law(Number(20.0), Number(0.0), Number(3.0), Friction(Number(1.5), Number(0.01))), 1.0),
        ('spring="disable"', Law(damping=Number(3.0), friction=Friction(Number(1.5), Number(0.01))), 1.0),
        ('damper="disable"', Law(Number(20.0), friction=Friction(Number(1.5), Number(0.01))), 1.0),
        ('frictionloss="disable"', Law(Number(20.0), damping=Number(3.0)), 1.0),
        ('limit="disable"', Law(Number(20.0), Number(0.0), Number(3.0), Friction(Number(1.5), Number(0.01))), None),
        ('constraint="disable"', Law(Number(20.0), damping=Number(3.0)), None),
    ],
)
def test_flags_take_forces_away(tmp_path: Path, flags: str, law: Law, limits: float | None) -> None:
    """As MuJoCo's reference says of each; the flag `constraint` disables friction and limits."""
    joint = '<joint stiffness="20" damping="3" frictionloss="1.5" range="-1 1"/>'
    path = write(tmp_path, f'<compiler angle="radian"/><option><flag {flags}/></option>{pendulum(joint)}')
    imported = import_model(path)
    found = only_joint(imported, "rod")
    assert found.law == law
    assert found.upper == (None if limits is None else Number(limits))
    passing = "the ranges of 1 joint bound problems alone: a simulation passes them"
    assert any(passing in line for line in warnings(imported)) == (limits is not None)


def test_the_last_setting_of_a_flag_counts(tmp_path: Path) -> None:
    flags = '<option><flag spring="disable"/></option><option><flag spring="enable"/></option>'
    path = write(tmp_path, flags + pendulum('<joint stiffness="3"/>'))
    assert only_joint(import_model(path), "rod").law.stiffness == Number(3.0)


@pytest.mark.parametrize("flag", ["actuation", "contact"])
def test_other_flags(tmp_path: Path, flag: str) -> None:
    """Inputs act where the file disables actuators; without contacts, none is missing."""
    geoms = '<geom size="0.1"/><geom size="0.1"/>'
    path = write(tmp_path, f'<option><flag {flag}="disable"/></option>{pendulum("<joint/>", INERTIAL + geoms)}')
    found = "".join(warnings(import_model(path)))
    assert ("the inputs of the model act" in found) == (flag == "actuation")
    assert ("may touch others" in found) == (flag != "contact")


def test_ranges_of_joints_that_are_no_limits(tmp_path: Path) -> None:
    """MuJoCo's compiled `jnt_limited`: an empty range does not limit by itself."""
    for text, limited in (('range="1 1"', False), ('range="-1 1" limited="false"', False), ('range="-1 1"', True)):
        joint = only_joint(import_model(write(tmp_path, pendulum(f"<joint {text}/>"))), "rod")
        assert (joint.lower is not None) == limited


def test_the_largest_forces_are_those_that_act(tmp_path: Path) -> None:
    """Ranges that are switched off bound nothing; the joint's own range bounds all its actuators together."""
    actuators = (
        ("a", '<motor joint="j" gear="50"/>', 'actuatorfrcrange="-7 7"', 7.0),
        ("b", '<motor joint="j" ctrlrange="-1 1" ctrllimited="false" gear="10"/>', "", None),
        ("c", '<motor joint="j" forcerange="-3 3" forcelimited="false"/>', "", None),
        ("d", '<motor joint="j" ctrlrange="-2 1" gear="-3"/>', "", 6.0),
        ("e", '<motor joint="j" forcerange="-2 2" gear="3"/><motor joint="j" ctrlrange="-1 1"/>', "", 7.0),
        ("f", '<motor joint="j" forcerange="-2 2"/><motor joint="j"/>', "", None),
        ("g", '<motor joint="j" ctrlrange="-2 2"/>', 'actuatorfrcrange="-9 9" actuatorfrclimited="false"', 2.0),
        ("h", '<general joint="j" ctrlrange="-2 2"/>', "", 2.0),
        ("i", '<general joint="j" ctrlrange="-2 2" gainprm="5"/>', "", None),
    )
    for name, actuator, own, expected in actuators:
        path = write(tmp_path, pendulum(f'<joint name="j" {own}/>') + f"<actuator>{actuator}</actuator>")
        found = only_joint(import_model(path), "rod").max_force
        assert found == (None if expected is None else Number(expected)), name
    free = write(tmp_path, pendulum('<joint name="j" actuatorfrcrange="-4 4"/>'))
    assert only_joint(import_model(free), "rod").max_force == Number(4.0)
    flag = '<option><flag clampctrl="disable"/></option>'
    path = write(tmp_path, flag + pendulum('<joint name="j"/>') + f"<actuator>{actuators[3][1]}</actuator>")
    assert only_joint(import_model(path), "rod").max_force is None


def test_a_class_has_one_default_for_all_actuators(tmp_path: Path) -> None:
    """As MuJoCo's compiled model: a motor has the gear that the class gives to `position`."""
    import mujoco

    defaults = '<default><position gear="5" ctrlrange="-3 3" armature="0.1"/></default>'
    path = write(
        tmp_path,
        defaults + pendulum('<joint name="j"/>') + '<actuator><motor joint="j" forcerange="-2 2"/></actuator>',
    )
    model = mujoco.MjModel.from_xml_path(str(path))
    assert [model.actuator_gear[0, 0], *model.actuator_ctrlrange[0], model.actuator_armature[0]] == [5, -3, 3, 0.1]
    joint = only_joint(import_model(path), "rod")
    assert (joint.max_force, joint.armature) == (Number(10.0), Number(25 * 0.1))


def test_polynomial_springs_and_dampers_are_mujocos(tmp_path: Path) -> None:
    """Of joints and of actuators, whose damping counts gear ratio squared times."""
    import mujoco

    joint = '<joint name="j" axis="0 1 0" stiffness="20 5 1" springref="15" damping="3 1 0.5"/>'
    motor = '<actuator><motor joint="j" gear="3" damping="0.5 0.1 0.2"/></actuator>'
    path = write(tmp_path, pendulum(joint) + motor)
    law = only_joint(import_model(path), "rod").law
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    for q, qd in ((0.7, -1.3), (-0.9, 2.1)):
        data.qpos[0], data.qvel[0] = q, qd
        mujoco.mj_forward(model, data)
        found = evaluate_expression(law.total, {"q": q, "qd": qd}, FLOATS)
        np.testing.assert_allclose(found, data.qfrc_passive[0], rtol=1e-13)


@pytest.mark.parametrize("placed", ['<frame pos="1 0 0" euler="0 0 90">{}</frame>', "{}"])
def test_free_bodies_of_frames_and_of_included_files(tmp_path: Path, placed: str) -> None:
    chair = f'<body name="chair" pos="0 0 0.5"><freejoint/>{INERTIAL}</body>'
    write(tmp_path, placed.format(chair), file="chair.xml", root="mujocoinclude")
    for inner in (placed.format(chair), '<include file="chair.xml"/>'):
        path = write(tmp_path, world(inner))
        assert_mujoco_agrees(path, import_model(path))


def test_an_inertial_within_a_frame_is_placed_by_it(tmp_path: Path) -> None:
    path = write(tmp_path, pendulum("<joint/>", f'<frame pos="0.3 0.2 0.1" euler="10 20 30">{FULL}</frame>'))
    assert_mujoco_agrees(path, import_model(path))


def test_forces_of_balls_and_yielding_springs_are_warned_of(tmp_path: Path) -> None:
    ball = pendulum('<joint name="j" type="ball" springdamper="0.1 1" range="0 60"/>')
    found = "\n".join(warnings(import_model(write(tmp_path, ball + '<actuator><motor joint="j"/></actuator>'))))
    for text in ("stiffness of a ball is left out", "range of a ball is left out", "the actuator of a ball"):
        assert text in found
    path = write(tmp_path, pendulum('<joint type="ball" stiffness="0 0 2"/>'))
    assert "stiffness of a ball is left out" in "".join(warnings(import_model(path)))
    path = write(tmp_path, pendulum('<joint stiffness="3" springyield="0.1"/>'))
    assert "springyield: the spring is elastic beyond it" in "".join(warnings(import_model(path)))
    path = write(tmp_path, pendulum('<joint type="free" name="j"/>') + '<actuator><motor joint="j"/></actuator>')
    assert "the actuator of a free joint is left out" in "".join(warnings(import_model(path)))


TIMED = """<body name="a" pos="0 0 1" euler="10 20 30"><joint name="one" axis="0 1 1" pos="0.1 0.2 0.3" ref="10"
  springdamper="0.1 1" springref="20" armature="0.1" stiffness="3 4 5" damping="1 2 3"/>
  <joint name="two" axis="1 1 1" pos="0.3 0 0.1" ref="40" springdamper="0.1 0.5"/>{}
  <frame pos="0.3 0 0.1" euler="50 0 0"><body name="b" pos="1 0 0" euler="0 30 20">
    <joint name="slide" type="slide" axis="0 1 2" ref="0.2" springdamper="0.2 0.5"/>{}
    <body name="c" pos="0.5 0 0"><joint name="ball" type="ball" pos="0.1 0 0" springdamper="0.3 2" armature="0.2"/>{}
  </body></body></frame></body>
  <body name="chair" pos="0 1 0"><joint type="free" springdamper="0.5 0.7"/>{}</body>""".format(*[INERTIAL] * 4)


@pytest.mark.parametrize("settings", ["", '<compiler settotalmass="30"/>', '<option><flag spring="disable"/></option>'])
def test_springs_by_times_are_those_that_mujoco_compiles(settings: str, tmp_path: Path) -> None:
    """By the inertia in the pose of the file, with rotors; the terms of higher order stay, and so do dampers of motors.

    Of a ball and of a free body the damping alone is read, the mean over its freedoms.
    """
    import mujoco

    drive = '<actuator><motor joint="one" armature="2" gear="3" damping="7"/></actuator>'
    path = write(tmp_path, settings + world(TIMED) + drive)
    model = mujoco.MjModel.from_xml_path(str(path))
    imported = import_model(path, Choices(locked=(("slide", 0.1),)))
    assert {
        x.text.split(" of ")[0] for x in imported.notices if x.alters and "act on a single coordinate" in x.text
    } == ({"armature"} if "spring" in settings else {"stiffness", "armature"})
    laws = {step.name: step.joint.law for step in list_joints(imported.model)}
    assert "slide" not in laws
    for name in ("one", "two"):
        joint, law = model.joint(name), laws[name]
        damping = joint.damping[0] + (9 * 7 if name == "one" else 0)
        assert value_of(law.damping) == pytest.approx(damping, rel=1e-12)
        if "spring" in settings:
            assert value_of(law.stiffness) == 0
        else:
            assert value_of(law.stiffness) == pytest.approx(joint.stiffness[0], rel=1e-12)
    assert evaluate_expression(laws["one"].force, {"q": 1.0, "qd": 0.0}, FLOATS) != 0 or "spring" in settings
    for name, at in (("c", "ball"), ("chair", model.njnt - 1)):
        for turn in body(imported, name).joints:
            assert value_of(turn.law.damping) == pytest.approx(model.joint(at).damping[0], rel=1e-12)


def test_a_spring_by_time_needs_an_inertia(tmp_path: Path) -> None:
    tip = '<body name="tip"><joint name="loose"/></body>'
    bare = world(f'<body name="rod"><joint name="j" springdamper="0.1 1"/>{INERTIAL}{tip}</body>')
    imported = import_model(write(tmp_path, bare), Choices(locked=(("loose", 0.0),)))
    assert "springdamper is left out" in "".join(warnings(imported))


GEOM = '<geom size="0.1"/>'


@pytest.mark.parametrize(
    ("inner", "text"),
    [
        (world(f'<body name="b"><joint/>{GEOM}<body name="b" pos="1 0 0">{GEOM}</body></body>'), "a second body"),
        (
            world(f'<body><joint name="j"/>{GEOM}<body pos="1 0 0"><joint name="j"/>{GEOM}</body></body>'),
            "second joint",
        ),
        (pendulum('<joint/><site name="s"/><site name="s"/>'), "a second site called"),
        ('<asset><mesh name="m" file="a.stl"/><mesh name="m" file="b.stl"/></asset>' + pendulum("<joint/>"), "mesh"),
        (pendulum("<joint/>").replace("<worldbody", '<worldbody pos="1 0 0"'), "the world has pos"),
        (world(f"{INERTIAL}<body><joint/>{INERTIAL}</body>"), "part <inertial>"),
        (world(f"<joint/><body><joint/>{INERTIAL}</body>"), "part <joint>"),
        (pendulum("<joint/>", FULL.replace("mass", 'quat="1 1 0 0" mass')), "it has fullinertia, and quat"),
        (pendulum("<joint/>", FULL.replace("mass", 'diaginertia="1 1 1" mass')), "it has fullinertia, and diaginertia"),
        (pendulum("<joint/>", '<inertial diaginertia="1 1 1"/>'), "an inertial without pos and mass"),
        (pendulum("<joint/>", '<geom size="0.1" mass="-1"/><geom size="0.1" mass="2"/>'), "a mass of -1"),
        (pendulum("<joint/>", '<geom size="0.1" density="-1"/><geom size="0.1" mass="2"/>'), "a density of -1"),
        (
            '<default><default class="a"/><default class="a"/></default>' + pendulum("<joint/>"),
            "a second default class",
        ),
        ('<default><joint damping="1"/><joint damping="2"/></default>' + pendulum("<joint/>"), "a second joint of a"),
    ],
)
def test_what_mujoco_refuses_is_refused(inner: str, text: str, tmp_path: Path) -> None:
    """Each could be read in two ways, or not at all, and would change a motion without a word."""
    import mujoco

    path = write(tmp_path, inner)
    with pytest.raises(ValueError, match=r"."):
        mujoco.MjModel.from_xml_path(str(path))
    assert text in faults_of(path)


def test_negative_springs_and_dampers_are_mujocos(tmp_path: Path) -> None:
    """A joint's law has none: they are part of its force."""
    import mujoco

    path = write(tmp_path, pendulum('<joint stiffness="-3 2" damping="-1 0.5" springref="20"/>'))
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    law = only_joint(import_model(path), "rod").law
    assert value_of(law.stiffness) == value_of(law.damping) == 0
    data.qpos[0], data.qvel[0] = 0.7, -1.3
    mujoco.mj_forward(model, data)
    found = evaluate_expression(law.total, {"q": 0.7, "qd": -1.3}, FLOATS)
    np.testing.assert_allclose(found, data.qfrc_passive[0], rtol=1e-13)


def test_the_range_of_a_ball_begins_at_0(tmp_path: Path) -> None:
    import mujoco

    path = write(tmp_path, pendulum('<joint type="ball" range="-10 60"/>'))
    with pytest.raises(ValueError, match="ball joint"):
        mujoco.MjModel.from_xml_path(str(path))
    assert "the range of a ball begins at -10" in faults_of(path)


def test_a_shorter_row_keeps_the_end_of_the_inherited_one(tmp_path: Path) -> None:
    """As MuJoCo's compiled model, for springs, dampers, gears and sizes; classes inherit from outer ones so."""
    import mujoco

    classes = (
        '<default><joint stiffness="1 2 3" damping="4 5 6"/><geom type="box" size="0.1 0.2 0.3"/>'
        '<default class="inner"><joint stiffness="7"/><geom size="0.4"/></default></default>'
    )
    inner = (
        '<body name="rod" childclass="inner"><joint name="j" damping="8 9"/><geom pos="1 0 0" size="0.5 0.6"/></body>'
    )
    path = write(tmp_path, classes + world(inner))
    model = mujoco.MjModel.from_xml_path(str(path))
    assert [*model.geom_size[0], *model.jnt_stiffnesspoly[0], *model.dof_dampingpoly[0]] == [0.5, 0.6, 0.3, 2, 3, 9, 6]
    imported = import_model(path)
    law = only_joint(imported, "rod").law
    assert (law.stiffness, law.damping) == (Number(7.0), Number(8.0))
    found = evaluate_expression(law.force, {"q": 2.0, "qd": -1.0}, FLOATS)
    assert found == -(2 * 2.0**2 + 3 * 2.0**3) + 9 * 1.0 + 6 * 1.0
    np.testing.assert_allclose(value_of(body(imported, "rod").mass), 8 * 0.5 * 0.6 * 0.3 * 1000, rtol=1e-14)


def test_a_general_actuator_may_inherit_a_gain(tmp_path: Path) -> None:
    """From the default of `position` in its class, even an empty one; a default of `motor` takes it away."""
    moving = pendulum('<joint name="j"/>')
    for defaults, is_servo in (("<position/>", True), ('<general gainprm="3"/>', True), ("<position/><motor/>", False)):
        path = write(
            tmp_path,
            f"<default>{defaults}</default>{moving}<actuator><general joint='j'/></actuator>",
        )
        assert any("gains and dynamics" in line for line in warnings(import_model(path))) == is_servo


def test_aligned_free_bodies_keep_the_frame_of_the_file(tmp_path: Path) -> None:
    """MuJoCo turns the body's frame then; the notice says whose coordinates there are."""
    for settings, joint, told in (
        ('<compiler alignfree="true"/>', "<freejoint/>", True),
        ('<compiler alignfree="true"/>', '<freejoint align="false"/>', False),
        ("", '<freejoint align="true"/>', True),
    ):
        imported = import_model(write(tmp_path, settings + pendulum(joint)))
        assert any("align: coordinates are of the body's frame" in notice.text for notice in imported.notices) == told


def test_two_points_place_a_site_as_in_mujoco(tmp_path: Path) -> None:
    """Its z axis points to the first one."""
    import mujoco

    site = '<site name="eye" type="capsule" size="0.1" fromto="0.1 0.2 0.3 -0.4 0.9 0.5"/>'
    path = write(tmp_path, pendulum("<joint/>", INERTIAL + site))
    model = mujoco.MjModel.from_xml_path(str(path))
    R = np.zeros(9)
    mujoco.mju_quat2Mat(R, model.site_quat[0])
    (frame,) = import_model(path, Choices(sensors=("eye",))).model.frames
    turns = [(turn.axis, value_of(turn.angle)) for turn in frame.placement.orientation]
    found = place([value_of(x) for x in frame.placement.position], turns)
    np.testing.assert_allclose(found.rotation, R.reshape(3, 3), atol=1e-14)
    np.testing.assert_allclose(found.position, model.site_pos[0], atol=1e-15)
