"""Extensions of URDF that close loops: where their frames are, by Pinocchio, and what they make of joints."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from mbsgen.assembly import assemble
from mbsgen.errors import InputError
from mbsgen.expressions import Number, write
from mbsgen.importing import Choices, Imported, import_model, write_imported
from mbsgen.model.changes.reduction import build_tree
from mbsgen.model.model import Follow, Joint
from mbsgen.model.reader import read_model
from mbsgen.model.tree import Cut
from tests.loop_ends import place_ends
from tests.mbsgen.importing.urdf_files import LIMIT, joint, link
from tests.mbsgen.importing.urdf_files import write as save

# Two chains on a link, of two joints and of one, and a third.
CHAINS = "".join(
    [
        *map(link, ("trunk", "a", "b", "c", "d")),
        joint("ja", "continuous", "trunk", "a", '<axis xyz="0 1 0"/>'),
        joint("jb", "continuous", "a", "b", '<axis xyz="0 1 0"/>'),
        joint("jc", "continuous", "trunk", "c", '<axis xyz="0 1 0"/>'),
        joint("jd", "prismatic", "trunk", "d", f'<axis xyz="0 0 1"/>{LIMIT}'),
    ]
)
ENDS = (
    '<predecessor link="b"><origin xyz="0.1 0.2 0.3" rpy="0.3 0.2 0.1"/></predecessor>'
    '<successor link="c"><origin xyz="-0.1 0 0.3" rpy="0 0.5 0"/></successor>'
)
COUPLING = '<coupling name="belt"><predecessor link="{}"/><successor link="{}"/><ratio value="{}"/></coupling>'


def loop(kind: str, inner: str = ENDS, axis: str = '<axis xyz="0.6 0 0.8"/>') -> str:
    return f'<loop name="closure" type="{kind}">{inner}{axis}</loop>'


def find_joint(imported: Imported, name: str) -> Joint:
    joints = [joint for body in imported.model.bodies for joint in body.joints]
    return next(joint for joint in joints if joint.name == name)


def told(imported: Imported) -> str:
    return "\n".join(str(notice.without_folder()) for notice in imported.notices)


KINDS = {
    "revolute": Cut.HINGE,
    "continuous": Cut.HINGE,
    "prismatic": Cut.PRISMATIC,
    "planar": Cut.PLANAR,
    "fixed": Cut.SOLID,
    "spherical": Cut.BALL,
}


@pytest.mark.parametrize("kind", KINDS)
def test_loops_join_the_frames_of_the_file(kind: str, tmp_path: Path) -> None:
    """The ends of a loop are where Pinocchio puts the links, times the origins; z of both is the axis of the file."""
    path = save(tmp_path, CHAINS + loop(kind))
    (closing,) = (imported := import_model(path)).model.loops
    assert (closing.name, closing.cut) == ("closure", KINDS[kind])
    tree, model = build_tree(imported.model), pin.buildModelFromUrdf(str(path))
    data, angles = model.createData(), np.random.default_rng(0).uniform(-1, 1, 4)
    given = dict(zip(tree.coordinates, angles, strict=True))
    v = np.zeros(model.nv)
    for name, q in given.items():
        v[model.idx_vs[model.getJointId(name)]] = q
    pin.framesForwardKinematics(model, data, pin.integrate(model, pin.neutral(model), v))
    origins = (pin.SE3(pin.rpy.rpyToMatrix(0.3, 0.2, 0.1), np.array([0.1, 0.2, 0.3])),)
    origins += (pin.SE3(pin.rpy.rpyToMatrix(0.0, 0.5, 0.0), np.array([-0.1, 0.0, 0.3])),)
    axis = np.array([0, 0, 1.0]) if KINDS[kind] in (Cut.SOLID, Cut.BALL) else np.array([0.6, 0, 0.8])
    ((p1, p2, R1, R2),) = place_ends(tree, angles)
    for p, R, name, origin in ((p1, R1, "b", origins[0]), (p2, R2, "c", origins[1])):
        expected = data.oMf[model.getFrameId(name)] * origin
        np.testing.assert_allclose(p, expected.translation, atol=1e-14)
        np.testing.assert_allclose(R[:, 2], expected.rotation @ axis, atol=1e-14)


@pytest.mark.parametrize(
    "element",
    [
        '<loop_joint type="spherical"><link1 link="b" xyz="0.1 0 0.2" rpy="1 0 0"/>'
        '<link2 link="c" xyz="0 0 1"/></loop_joint>',
        '<loop_joint type="spherical"><link1 link="b" xyz="0.1 0 0.2"/><link1 link="c" xyz="0 0 1"/></loop_joint>',
        '<drake:ball_constraint name="k"><drake:ball_constraint_body_A name="b"/>'
        '<drake:ball_constraint_body_B name="c"/><drake:ball_constraint_p_AP value="0.1 0 0.2"/>'
        '<drake:ball_constraint_p_BQ value="0 0 1"/></drake:ball_constraint>',
    ],
    ids=["isaac", "isaac as its manual shows it", "drake"],
)
def test_points_of_other_simulators_are_kept_together(element: str, tmp_path: Path) -> None:
    expected = loop(
        "spherical",
        '<predecessor link="b"><origin xyz="0.1 0 0.2"/></predecessor>'
        '<successor link="c"><origin xyz="0 0 1"/></successor>',
    )
    (found,) = import_model(save(tmp_path, CHAINS + element)).model.loops
    (wanted,) = import_model(save(tmp_path, CHAINS + expected)).model.loops
    assert (found.cut, found.first, found.second) == (wanted.cut, wanted.first, wanted.second)


def test_two_coupled_joints_make_a_follower(tmp_path: Path) -> None:
    """ratio q(predecessor) = q(successor); the joint that the file calls dependent follows."""
    imported = import_model(save(tmp_path, CHAINS + COUPLING.format("a", "c", 6)))
    assert find_joint(imported, "jc").follows == Follow("ja", Number(6.0), Number(0.0))
    assert not imported.model.constraints
    dependent = CHAINS.replace('name="ja"', 'name="ja" independent="False"')
    imported = import_model(save(tmp_path, dependent + COUPLING.format("a", "c", 4)))
    assert find_joint(imported, "ja").follows == Follow("jc", Number(0.25), Number(0.0))
    held = import_model(save(tmp_path, CHAINS + COUPLING.format("a", "c", 6)), Choices(locked=(("ja", 0.5),)))
    assert [write(x.equation) for x in held.model.constraints] == ["-jc + 3"]


def test_chains_are_coupled_by_their_sums(tmp_path: Path) -> None:
    """From the last link that carries both: of b and a this is a."""
    imported = import_model(save(tmp_path, CHAINS + COUPLING.format("b", "c", -2)))
    assert [write(x.equation) for x in imported.model.constraints] == ["-(2*ja) - 2*jb - jc"]
    imported = import_model(save(tmp_path, CHAINS + COUPLING.format("b", "a", 3)))
    assert [write(x.equation) for x in imported.model.constraints] == ["3*jb"]


def test_the_independent_coordinates_of_a_file_are_kept(tmp_path: Path) -> None:
    """A parallelogram with a slide beside it: one joint of its four is independent, and only such ones have inputs."""
    plain = '<origin xyz="{} 0 {}"/><axis xyz="0 1 0"/>'
    bars = "".join(map(link, ("trunk", "left", "right", "top", "cart")))
    for name, parent, child, x, z in (
        ("jl", "trunk", "left", 0, 0),
        ("jr", "trunk", "right", 0.4, 0),
        ("jt", "left", "top", 0, 0.5),
    ):
        flag = "true" if name == "jl" else "false"
        bars += (
            f'<joint name="{name}" type="continuous" independent="{flag}"><parent link="{parent}"/>'
            f'<child link="{child}"/>{plain.format(x, z)}</joint>'
        )
    bars += joint("jx", "prismatic", "trunk", "cart")
    ends = (
        '<predecessor link="top"><origin xyz="0.4 0 0"/></predecessor>'
        '<successor link="right"><origin xyz="0 0 0.5"/></successor>'
    )
    path = save(tmp_path, bars + loop("revolute", ends, '<axis xyz="0 1 0"/>'))
    imported = import_model(path)
    assert imported.model.independent == ("jl", "jx")
    assert [find_joint(imported, name).actuated for name in ("jl", "jr", "jt", "jx")] == [True, False, False, True]
    tree = assemble(build_tree(imported.model))
    assert tree.closure is not None
    assert [tree.coordinates[i] for i in tree.closure.independent] == ["jl", "jx"]
    assert len(tree.closure.kept) == 2
    file = tmp_path / "machine.yaml"
    file.write_text(write_imported(imported), encoding="utf-8")
    assert read_model(file) == imported.model


def test_elements_that_act_on_links_and_are_not_read_are_warnings(tmp_path: Path) -> None:
    parts = (
        "<drake:linear_bushing_rpy/><joint_constraint name='old'/><gazebo><joint name='pin' type='revolute'/></gazebo>"
    )
    imported = import_model(save(tmp_path, CHAINS + parts))
    for text in (
        "robot/drake:linear_bushing_rpy: warning: drake:linear_bushing_rpy is not part of the model",
        "robot/joint_constraint[old]: warning: joint_constraint is not part of the model",
        "robot/gazebo/joint[pin]: warning: a joint of SDF is not part of the model",
    ):
        assert text in told(imported)


@pytest.mark.parametrize(
    ("inner", "text"),
    [
        (loop("screw"), 'type is "screw"; give revolute, continuous'),
        (loop("revolute", ENDS.replace('"c"', '"cc"')), 'there is no link "cc"; did you mean "c"?'),
        (loop("revolute", '<predecessor link="b"/>'), "a loop without a successor"),
        (loop("revolute", axis='<axis xyz="0 0 0"/>'), "an axis without direction"),
        (loop("revolute", ENDS.replace('"c"', '"b"')), 'a loop between "b" and itself'),
        (loop("fixed", ENDS.replace("0.1 0.2 0.3", "0.1 nan 0.3", 1)), "xyz is"),
        ('<loop_joint type="revolute"><link1 link="a"/></loop_joint>', 'type is "revolute"; give spherical'),
        ('<loop_joint type="spherical"><link1 link="a"/></loop_joint>', "a loop joint of 1 links"),
        ("<drake:ball_constraint/>", "without a drake:ball_constraint_body_A"),
        (COUPLING.format("a", "c", 0), "a ratio of 0"),
        (COUPLING.format("a", "x", 1), 'there is no link "x"'),
        (COUPLING.format("a", "a", 1), "no joint moves its links against each other"),
        (
            COUPLING.format("e", "c", 2) + joint("je", "floating", "d", "e") + link("e"),
            "a floating joint in a coupling",
        ),
    ],
)
def test_faulty_loops(inner: str, text: str, tmp_path: Path) -> None:
    path = save(tmp_path, CHAINS + inner)
    with pytest.raises(InputError) as caught:
        import_model(path)
    assert text in str(caught.value)
    assert "machine.urdf:" in str(caught.value)


def test_flags_that_are_neither_true_nor_false_are_faults(tmp_path: Path) -> None:
    text = CHAINS.replace('name="ja"', 'name="ja" independent="maybe"')
    with pytest.raises(InputError, match="independent is"):
        import_model(save(tmp_path, text + loop("revolute")))
