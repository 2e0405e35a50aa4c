"""URDF is imported as Pinocchio reads it; notices list the rest."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from mbsgen.errors import InputError
from mbsgen.expressions import Number
from mbsgen.importing import Choices, Imported, Notice, import_model, write_imported
from mbsgen.importing.poses import Pose
from mbsgen.importing.solids import Solid
from mbsgen.model.changes.reduction import build_tree
from mbsgen.model.model import Body, DryFriction, Fixed, Follow, Friction, Joint, Stops
from mbsgen.model.reader import read_model
from mbsgen.pipeline import write_families
from mbsgen.request import Request
from mbsgen.tape.interpreter import evaluate
from tests.import_peers import Kernels, PinocchioPeer, largest_miss, turn_rates
from tests.mbsgen.importing.urdf_files import LIMIT, LOSSES, joint, link, write

# Sums of a few dozen products of numbers near 1; M of these trees has a condition below 1e3.
TOLERANCE = 1e-12
DEFAULT = Choices()
NAMES = ("trunk", "arm", "hand", "slider", "tool", "wheel", "foot")


TREE = "\n".join(
    [
        *(link(name, mass) for mass, name in enumerate(NAMES, 1)),
        joint("shoulder", "revolute", "trunk", "arm", f'<axis xyz="0 1 0"/>{LIMIT}{LOSSES}'),
        joint("weld", "fixed", "arm", "hand"),
        joint("slide", "prismatic", "hand", "slider", f'<axis xyz="0.6 0 -0.8"/>{LIMIT}', "1.5707963267948966 0 0"),
        joint("grip", "fixed", "slider", "tool", rpy="0 0 3.141592653589793"),
        joint("roll", "continuous", "trunk", "wheel", '<axis xyz="0 0 -2"/>'),
        joint("ankle", "revolute", "wheel", "foot", LIMIT),
    ]
)


def body(imported: Imported, name: str) -> Body:
    return next(body for body in imported.model.bodies if body.name == name)


def only_joint(imported: Imported, name: str) -> Joint:
    found = body(imported, name).joint
    assert isinstance(found, Joint)
    return found


def faults_of(path: Path, choices: Choices = DEFAULT) -> list[str]:
    with pytest.raises(InputError) as caught:
        import_model(path, choices)
    return [str(fault).removeprefix(f"{path}:") for fault in caught.value.faults]


def told(imported: Imported) -> list[str]:
    return [str(notice.without_folder()).removeprefix("machine.urdf:") for notice in imported.notices]


def altering(imported: Imported) -> list[str]:
    """Return the texts of the warnings, except of the one on ranges, which concerns most files."""
    return [x.text for x in imported.notices if x.alters and not x.text.startswith("the ranges of")]


@pytest.mark.parametrize("floating", [False, True], ids=["fixed", "floating"])
@pytest.mark.parametrize("locked", [{}, {"shoulder": 0.7}, {"slide": -0.3, "ankle": 1.1}], ids=["all", "one", "two"])
def test_the_equations_are_pinocchios(tmp_path: Path, floating: bool, locked: dict[str, float]) -> None:
    """Phi, M, c, qdd and first derivatives: fixed links, turned inertias, every axis, joints held anywhere."""
    path = write(tmp_path, TREE)
    choices = Choices(base="floating" if floating else "fixed", locked=tuple(locked.items()))
    kernels = Kernels(import_model(path, choices), ("impl", "semi", "exp2"), derivatives=0 if floating else 1)
    peer = PinocchioPeer(path, kernels.joints, floating=floating, locked=locked)
    for state in kernels.draw_states():
        for name, miss in largest_miss(kernels.compute(state), peer.compute(state)).items():
            assert miss < TOLERANCE, name


HANDS = "\n".join(
    [
        link("trunk", 0),
        link("arm", 2),
        '<link name="palm"/><link name="finger"/><link name="thumb"/>',
        joint("turn", "revolute", "trunk", "arm", f'<axis xyz="0 1 0"/>{LIMIT}'),
        joint("wrist", "revolute", "arm", "palm", f'<axis xyz="0 0 1"/>{LIMIT}'),
        joint("grip", "revolute", "palm", "finger", f'<axis xyz="1 0 0"/>{LIMIT}'),
        joint("oppose", "revolute", "palm", "thumb", f'<axis xyz="1 0 0"/>{LIMIT}<mimic joint="grip" multiplier="2"/>'),
    ]
)


def test_joints_that_move_nothing_are_held_where_the_choices_say_so(tmp_path: Path) -> None:
    """The model is the one with each of them locked at 0; joints that follow them keep their law."""
    path = write(tmp_path, HANDS)
    remedy = "(--lock JOINT=VALUE; --lock-massless: all such joints)"
    assert all(fault.endswith(remedy) for fault in faults_of(path))
    found = import_model(path, Choices(lock_massless=True))
    by_name = import_model(path, Choices(locked=(("wrist", 0.0), ("grip", 0.0))))
    assert found.model == by_name.model
    assert told(found)[0].strip() == "warning: held at 0, since they move nothing: wrist, grip"
    assert import_model(write(tmp_path, TREE), Choices(lock_massless=True)) == import_model(write(tmp_path, TREE))


def test_what_is_written_is_read_as_the_same_model(tmp_path: Path) -> None:
    imported = import_model(write(tmp_path, TREE), Choices(base="floating", sensors=("tool",)))
    file = tmp_path / "machine.yaml"
    file.write_text(write_imported(imported), encoding="utf-8")
    assert read_model(file) == imported.model


def test_a_planar_joint_is_two_slides_and_a_turn(tmp_path: Path) -> None:
    """As a chain of the three joints that it is, which Pinocchio reads: slides across the normal, a turn about it."""
    normal = np.array([2.0, -1.0, 2.0]) / 3
    path = write(tmp_path, link("a") + link("b") + joint("p", "planar", "a", "b", '<axis xyz="2 -1 2"/>'))
    kernels = Kernels(import_model(path), ("impl",))
    first, second, turned = (np.array([x.value for x in j.axis]) for j in body(import_model(path), "b").joints)  # type: ignore[union-attr]
    np.testing.assert_allclose(np.cross(first, second), normal, atol=1e-15)
    np.testing.assert_allclose(turned / 3, normal, atol=1e-15)

    def step(name: str, kind: str, parent: str, child: str, axis: np.ndarray, origin: str) -> str:
        ends = f'<parent link="{parent}"/><child link="{child}"/>'
        along = f'<axis xyz="{" ".join(map(str, axis))}"/>'
        return f'<joint name="{name}" type="{kind}">{origin}{ends}{along}{LIMIT}</joint>'

    origin = '<origin xyz="0.2 0.1 -0.3" rpy="0.1 0.7 -0.4"/>'
    chain = (
        link("a") + link("b") + '<link name="m"/><link name="n"/>'
        + step("b.t", "prismatic", "a", "m", first, origin)
        + step("b.t2", "prismatic", "m", "n", second, "")
        + step("b.r", "revolute", "n", "b", normal, "")
    )  # fmt: skip
    peer = PinocchioPeer(write(tmp_path, chain), kernels.joints, floating=False)
    for state in kernels.draw_states():
        assert largest_miss(kernels.compute(state), peer.compute(state))["Phi"] < TOLERANCE


def test_limits_forces_and_bounds_are_carried_over(tmp_path: Path) -> None:
    imported = import_model(write(tmp_path, TREE), Choices(friction_speed=0.1))
    shoulder = only_joint(imported, "arm")
    assert (shoulder.name, shoulder.lower, shoulder.upper) == ("shoulder", Number(-1.0), Number(2.0))
    assert shoulder.law.damping == Number(0.5)
    assert shoulder.law.friction == Friction(Number(0.2), Number(0.1))
    assert (only_joint(imported, "wheel").lower, only_joint(imported, "wheel").upper) == (None, None)
    assert (shoulder.max_speed, shoulder.max_force) == (Number(3.0), Number(5.0))
    none = import_model(write(tmp_path, TREE.replace('effort="5" velocity="3"', 'effort="0" velocity="0"')))
    assert (only_joint(none, "arm").max_speed, only_joint(none, "arm").max_force) == (None, None)


def test_joints_may_stick_and_stop(tmp_path: Path) -> None:
    """Friction and limits keep their numbers; only joints with both ends, or one, have stops."""
    imported = import_model(write(tmp_path, TREE), Choices(dry_friction=True, stops=0.25))
    shoulder = only_joint(imported, "arm")
    assert (shoulder.law.friction, shoulder.dry) == (None, DryFriction(Number(0.2)))
    assert shoulder.stops == Stops(Number(0.25))
    assert only_joint(imported, "wheel").stops is None
    assert any("dry friction of 0.2, which simulations alone apply" in line for line in told(imported))
    assert not any("the ranges of" in line for line in told(imported))
    plain = only_joint(import_model(write(tmp_path, TREE)), "arm")
    assert (plain.dry, plain.stops) == (None, None)


def test_each_fixed_mass_is_told_of(tmp_path: Path) -> None:
    imported = import_model(write(tmp_path, TREE))
    found = [line.partition(": ")[2] for line in told(imported) if "fixed: " in line]
    assert found == [
        "robot/link[trunk]: fixed: its mass of 1 kg stands on the base, where nothing feels it",
        "robot/link[hand]: fixed: its mass of 3 kg moves with arm",
        "robot/link[tool]: fixed: its mass of 5 kg moves with slider",
    ]
    assert isinstance(body(imported, "hand").joint, Fixed)


def test_what_has_no_meaning_for_the_dynamics_is_told_once(tmp_path: Path) -> None:
    mesh = '<geometry><mesh filename="package://x/{0}.stl"/></geometry>'
    shown = f"<visual>{mesh.format(1)}</visual><collision>{mesh.format(2)}</collision>"
    extra = f'{link("a").replace("</link>", shown + "</link>")}{link("b")}<material name="red"/><gazebo/>'
    gears = (
        '<transmission name="t"><joint name="j"/><actuator name="m"><mechanicalReduction>50</mechanicalReduction>'
        "<rotorInertia>1e-4</rotorInertia></actuator></transmission>"
    )
    lines = told(import_model(write(tmp_path, extra + joint("j", "revolute", "a", "b", LIMIT) + gears)))
    assert len([line for line in lines if "no meaning" in line]) == 1
    assert any("1 collision, 1 material, 1 visual; 2 mesh files" in line for line in lines)
    assert any('gear ratio "50"' in line for line in lines)
    assert any('with its gear, armature 0.25 of joint "j"' in line for line in lines)


def transmit(joints: str, inner: str) -> str:
    named = "".join(f'<joint name="{name}"/>' for name in joints.split())
    return f'<transmission name="t">{named}<actuator name="m">{inner}</actuator></transmission>'


def test_rotors_are_the_joints_armature(tmp_path: Path) -> None:
    """Inertia times the gear ratio squared, in the words of ROS and of Drake; what simulators add at the joint."""
    geared = transmit("shoulder", "<mechanicalReduction>-50</mechanicalReduction><rotorInertia>1e-4</rotorInertia>")
    drake = transmit("slide", '<drake:rotor_inertia value="0.02"/><drake:gear_ratio value="3"/>')
    added = '<dynamics damping="0.1" armature="0.3" rotor_inertia="0.1"/>'
    tree = TREE.replace('axis xyz="0 0 -2"/>', f'axis xyz="0 0 -2"/>{added}')
    path = write(tmp_path, tree + geared + drake)
    imported = import_model(path)
    rotors = {"shoulder": 0.25, "slide": 0.18, "roll": 0.4}
    for name, armature in rotors.items():
        carrier = {"shoulder": "arm", "slide": "slider", "roll": "wheel"}[name]
        assert only_joint(imported, carrier).armature == Number(pytest.approx(armature, rel=1e-15))
    kernels = Kernels(imported, ("impl", "semi", "exp1", "exp2"))
    peer = PinocchioPeer(path, kernels.joints, floating=False, rotors=rotors)
    for state in kernels.draw_states():
        assert max(largest_miss(kernels.compute(state), peer.compute(state)).values()) < TOLERANCE
    assert altering(imported) == []


@pytest.mark.parametrize(
    "parts",
    [
        transmit("shoulder roll", "<rotorInertia>1e-4</rotorInertia>"),
        transmit("elbow", "<rotorInertia>1e-4</rotorInertia>"),
        transmit("roll", "<rotorInertia>1e-4</rotorInertia><motorInertia>1e-4</motorInertia>"),
    ],
    ids=["two joints", "no such joint", "two rotors"],
)
def test_rotors_of_no_single_joint_are_told(parts: str, tmp_path: Path) -> None:
    imported = import_model(write(tmp_path, TREE + parts))
    warned = [line for line in told(imported) if "warning: rotor inertia" in line]
    assert len(warned) == parts.count("Inertia>") // 2
    assert all("it does not belong to exactly one gear and one joint" in line for line in warned)


def follow(tmp_path: Path, mimic: str) -> Path:
    """Write a chain of two joints, of which the second one follows another."""
    follower = joint("two", "revolute", "b", "c", LIMIT + mimic)
    return write(tmp_path, link("a") + link("b") + link("c") + joint("one", "revolute", "a", "b", LIMIT) + follower)


def test_joints_that_follow_others(tmp_path: Path) -> None:
    """None is dropped in silence: coupled, or held where the leading joint at 0 puts it, or free."""
    path = follow(tmp_path, '<mimic joint="one" multiplier="2" offset="0.25"/>')
    coupled = import_model(path)
    assert only_joint(coupled, "c").follows == Follow("one", Number(2.0), Number(0.25))
    assert not only_joint(coupled, "c").actuated
    assert build_tree(coupled.model).coordinates == ("one",)
    assert 'no coordinate: its q is 2 times the q of "one" + 0.25' in [notice.text for notice in coupled.notices]
    held = import_model(path, Choices(mimic="lock"))
    assert isinstance(body(held, "c").joint, Fixed)
    assert held.model.bodies == import_model(path, Choices(locked=(("two", 0.25),))).model.bodies
    free = import_model(path, Choices(mimic="free"))
    assert only_joint(free, "c").name == "two"
    altered = altering(free)
    assert altered == ['the joint follows "one"; here it moves on its own']


def test_followers_of_a_held_joint_are_held_where_they_are_then(tmp_path: Path) -> None:
    path = follow(tmp_path, '<mimic joint="one" multiplier="2" offset="0.25"/>')
    (notice,) = (n.text for n in import_model_notices(path, ("one", 0.5)) if n.path.endswith("joint[two]"))
    assert notice == "held at 1.25"


def import_model_notices(path: Path, lock: tuple[str, float]) -> tuple[Notice, ...]:
    """Import with a further link that moves, so that something does."""
    text = path.read_text().replace("</robot>", link("d") + joint("three", "revolute", "c", "d", LIMIT) + "</robot>")
    path.write_text(text)
    return import_model(path, Choices(locked=(lock,))).notices


@pytest.mark.parametrize(
    ("mimic", "finding"),
    [
        ('<mimic joint="on"/>', 'it follows "on", which does not move so; did you mean "one"?'),
        ('<mimic joint="two"/>', "the joint follows itself in the end"),
        ('<mimic joint="one" multiplier="x"/>', 'multiplier is "x"'),
    ],
)
def test_what_cannot_be_followed_is_an_error(mimic: str, finding: str, tmp_path: Path) -> None:
    assert finding in "\n".join(faults_of(follow(tmp_path, mimic)))


def test_coupled_joints_move_as_in_pinocchio(tmp_path: Path) -> None:
    """Pinocchio has joints that follow others too: M, c and the residual are the same to rounding."""
    path = follow(tmp_path, '<mimic joint="one" multiplier="-1.5" offset="0.25"/>')
    peer = pin.buildModelFromUrdf(str(path), mimic=True)
    assert peer.nv == 1
    tree = build_tree(import_model(path).model)
    tapes = {tape.name: tape for f in write_families(tree, Request(functions=("impl", "semi"))) for tape in f.tapes}
    data = peer.createData()
    for q, qd, qdd in np.random.default_rng(4).uniform(-1, 1, (5, 3, 1)):
        at = {"q": list(q), "qd": list(qd), "qdd": list(qdd), "u": [0.0]}
        found = evaluate(tapes["impl"], at)["Phi"] + evaluate(tapes["semi"], at)["M"] + evaluate(tapes["semi"], at)["c"]
        expected = [
            pin.rnea(peer, data, q, qd, qdd)[0],
            pin.crba(peer, data, q)[0, 0],
            pin.rnea(peer, data, q, qd, 0 * qd)[0],
        ]
        np.testing.assert_allclose(found, expected, rtol=1e-13, atol=1e-13)


def test_numbers_too_small_to_matter_are_zero(tmp_path: Path) -> None:
    """iCub's file has 5.8e-66 where 0 is meant."""
    tiny = joint("one", "revolute", "a", "b", LIMIT).replace("0.2 0.1 -0.3", "5.8e-66 0.5 -1e-300")
    path = write(tmp_path, link("a") + link("b") + tiny)
    assert only_joint(import_model(path), "b").placement.position == (Number(0.0), Number(0.5), Number(0.0))


def test_names_that_a_model_cannot_have_are_changed_and_told(tmp_path: Path) -> None:
    names = ("base", "arm/left", "ARM_LEFT", "x" * 100)
    links = "".join(map(link, names))
    pairs = enumerate(pairwise(names))
    joints = "".join(joint(f"j{i}", "revolute", a, b, LIMIT) for i, (a, b) in pairs)
    imported = import_model(write(tmp_path, links + joints, name="my/../robot"))
    assert [b.name for b in imported.model.bodies] == ["base_link", "arm_left", "ARM_LEFT_2", "x" * 56]
    assert imported.model.name == "my_.._robot"
    assert len([line for line in told(imported) if "is called" in line]) == 5


@pytest.mark.parametrize(
    ("value", "warned", "refused"),
    [
        (0.05, False, False),
        (0.05 * (1 + 5e-10), False, False),
        (0.05 * (1 + 5e-9), True, False),
        (0.06, True, False),
        (0.5, False, True),
    ],
)
def test_inertias_that_no_body_has(tmp_path: Path, value: float, warned: bool, refused: bool) -> None:
    """0.02 + 0.03 bounds the third moment: a rounded digit passes, slightly more gets a notice, far more is a fault."""
    tensor = f'<mass value="1"/><inertia ixx="0.02" iyy="0.03" izz="{value}"/>'
    inner = link("a") + f'<link name="b"><inertial>{tensor}</inertial></link>' + joint("j", "revolute", "a", "b", LIMIT)
    path = write(tmp_path, inner)
    if refused:
        (fault,) = faults_of(path)
        assert "robot/link[b]: no body has the principal moments of inertia 0.02, 0.03, 0.5" in fault
        assert import_model(path, Choices(allow_unphysical=True)).model.allow_unphysical
        return
    imported = import_model(path)
    assert imported.model.allow_unphysical == warned
    found = altering(imported)
    miss = "0.17" if value > 0.055 else "5e-09"
    assert [text for text in found if f"miss by {miss} of the largest" in text] == found
    assert len(found) == warned


@pytest.mark.parametrize(("excess", "warned"), [(0.0, False), (2e-11, False), (4e-10, False), (5e-9, True)])
def test_an_inertia_that_is_just_possible_may_be_rounded(tmp_path: Path, excess: float, warned: bool) -> None:
    """A thin plate has izz = ixx + iyy, of which a file of ten digits misses 1e-9 at most."""
    tensor = f'<mass value="1"/><inertia ixx="0.2" iyy="0.3" izz="{0.5 * (1 + excess)!r}"/>'
    inner = link("a") + f'<link name="b"><inertial>{tensor}</inertial></link>' + joint("j", "revolute", "a", "b", LIMIT)
    imported = import_model(write(tmp_path, inner))
    assert bool(altering(imported)) == imported.model.allow_unphysical == warned


def test_turns_leave_no_rounding_in_an_inertia() -> None:
    """Products that are 0 stay 0, and cost nothing in the equations; small ones that a file gives are kept."""
    c, s = 6.123233995736766e-17, 1.0  # cosine and sine of pi/2 in doubles
    quarter = Pose(np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]), np.zeros(3))
    tensor = np.array([[2, 1e-13, 0], [1e-13, 3, 0], [0, 0, 4]])
    found = Solid(1.0, np.zeros(3), tensor).seen_from(quarter).inertia
    assert (found[0, 2], found[0, 1]) == (0.0, 0.0)
    np.testing.assert_allclose(found, [[4, 0, 0], [0, 3, -1e-13], [0, -1e-13, 2]], rtol=1e-9)


def test_all_faults_of_a_file_are_told_at_once(tmp_path: Path) -> None:
    inner = "\n".join(
        [
            link("a"),
            link("b", com="0 0"),
            '<link name="c"><inertial><mass value="nan"/></inertial></link>',
            joint("one", "revolute", "a", "b", '<limit lower="2" upper="1"/>').replace("\n", ""),
            joint("two", "screw", "b", "c"),
        ]
    )
    found = "\n".join(faults_of(write(tmp_path, inner)))
    for text in (
        'robot/link[b]/inertial/origin: xyz has 2 numbers: "0 0"; give 3',
        "robot/link[c]/inertial: an inertial without <inertia>",
        "robot/joint[one]/limit: lower is 2, and upper 1; swap them",
        'robot/joint[two]: type is "screw"; give revolute',
    ):
        assert text in found
    assert len(found.splitlines()) == 4


@pytest.mark.parametrize(
    ("inner", "text"),
    [
        (link("a") + link("a"), 'link "a" is already in line'),
        (link("a") + link("b"), '2 links stand on no joint: "a", "b"'),
        (link("a") + link("b") + joint("j", "fixed", "a", "c"), 'there is no link "c"'),
        (link("a") + link("b") + joint("j", "fixed", "a", "b") + joint("k", "fixed", "a", "b"), "has a second joint"),
        (link("a") + link("b") + joint("j", "fixed", "a", "b"), "nothing moves; give it a joint that is not fixed"),
        (link("a") + link("b") + joint("j", "fixed", "a", "b") + joint("k", "fixed", "b", "a"), "no link to begin"),
        ('<xacro:include filename="x"/>', "xacro:include is xacro; run `xacro FILE > robot.urdf`"),
        (link("a", com="${x} 0 0") + link("b") + joint("j", "revolute", "a", "b"), "this is xacro: run `xacro FILE"),
        (link("a") + '<link name="b"/>' + joint("j", "revolute", "a", "b"), "moves nothing"),
        (link("a") + link("b", mass=-1) + joint("j", "revolute", "a", "b"), "a mass of -1 kg"),
        (link("a") + link("b") + joint("j", "revolute", "a", "b", '<axis xyz="0 0 0"/>'), "without direction"),
        (
            "".join(map(link, "abc"))
            + joint("j", "revolute", "b", "c", LIMIT)
            + joint("k", "revolute", "c", "b", LIMIT),
            "hangs in a loop",
        ),
    ],
)
def test_faults(tmp_path: Path, inner: str, text: str) -> None:
    assert text in "\n".join(faults_of(write(tmp_path, inner)))


def test_choices_that_name_nothing_are_faults(tmp_path: Path) -> None:
    found = faults_of(write(tmp_path, TREE), Choices(sensors=("tol",), locked=(("Shoulder", 0.0),)))
    assert any('no joint to be held that is called "Shoulder"; did you mean "shoulder"?' in line for line in found)
    assert any('to be a sensor that is called "tol"; did you mean "tool"?' in line for line in found)


def test_angles_near_quarter_turns(tmp_path: Path) -> None:
    """Eleven digits of pi/2 are pi/2; six are kept, with a notice, unless the user rounds them too."""

    def turned(digits: str, choices: Choices = DEFAULT) -> tuple[str, list[str]]:
        inner = link("a") + link("b") + joint("j", "revolute", "a", "b", LIMIT, rpy=f"{digits} 0 0")
        imported = import_model(write(tmp_path, inner), choices)
        return write_imported(imported), [line for line in told(imported) if "quarter turn" in line]

    assert "angle: pi/2" in turned("1.57079632679")[0]
    text, lines = turned("1.570796")
    assert "angle: 1.570796" in text
    assert len(lines) == 1
    assert "off by up to 3.3e-07 rad" in lines[0]
    text, lines = turned("1.570796", Choices(quarter_turns=1e-6))
    assert "angle: pi/2" in text
    assert lines == []


def test_a_joint_that_follows_an_unknown_one_moves_freely_or_is_held(tmp_path: Path) -> None:
    """Neither choice needs the other joint."""
    path = follow(tmp_path, '<mimic joint="elsewhere" multiplier="2" offset="0.25"/>')
    free = import_model(path, Choices(mimic="free"))
    assert only_joint(free, "c").name == "two"
    assert altering(free) == ['the joint follows "elsewhere"; here it moves on its own']
    held = import_model(path, Choices(mimic="lock"))
    assert held.model.bodies == import_model(path, Choices(locked=(("two", 0.25),))).model.bodies
    assert "or give --mimic free or lock" in faults_of(path)[0]


def test_limits_without_an_end_are_none(tmp_path: Path) -> None:
    for lower, upper in (("-1.797e308", "1.79769e+308"), ("-inf", "inf"), ("-1e16", "1e400")):
        limit = f'<limit lower="{lower}" upper="{upper}" effort="1e308" velocity="INF"/>'
        inner = link("a") + link("b") + joint("j", "revolute", "a", "b", limit)
        moving = only_joint(import_model(write(tmp_path, inner)), "b")
        assert (moving.lower, moving.upper, moving.max_speed, moving.max_force) == (None,) * 4


@pytest.mark.parametrize("part", ["mechanicalReduction", "rotorInertia"])
def test_a_transmission_with_text_in_place_of_a_number(part: str, tmp_path: Path) -> None:
    """A ratio makes a notice only; a rotor that is not known is left out, with a warning."""
    actuator = f'<actuator name="m"><{part}>reduction</{part}></actuator>'
    gear = f'<transmission name="t"><joint name="j"/>{actuator}</transmission>'
    imported = import_model(write(tmp_path, link("a") + link("b") + joint("j", "continuous", "a", "b") + gear))
    (notice,) = (n for n in imported.notices if '"reduction"' in n.text)
    assert notice.alters == (part == "rotorInertia")


@pytest.mark.parametrize(
    "leftover",
    [
        ('xyz="0.2 0.1 -0.3"', 'xyz="$(optenv IMU_XYZ 0.19 0 0.149)"'),
        ('xyz="0.2 0.1 -0.3"', 'xyz="0 0 ${h}"'),
        ('parent link="a"', 'parent link="${prefix}a"'),
        ('type="continuous"', 'type="$(arg kind)"'),
        ("</joint>", '</joint><link name="${prefix}c"/>'),
        ("</joint>", '</joint><xacro:wheel side="left"/>'),
        ("</joint>", '</joint><property name="h" value="2"/>'),
    ],
)
def test_leftovers_of_xacro_are_named(leftover: tuple[str, str], tmp_path: Path) -> None:
    path = write(tmp_path, link("a") + link("b") + joint("j", "continuous", "a", "b").replace(*leftover))
    assert "xacro" in faults_of(path)[0]


@pytest.mark.parametrize("part", ["mechanicalReduction", "rotorInertia"])
def test_a_transmission_with_leftovers_of_xacro_is_a_warning(part: str, tmp_path: Path) -> None:
    actuator = f'<actuator name="m"><{part}>${{ratio}}</{part}></actuator>'
    gear = f'<transmission name="t"><joint name="j"/>{actuator}</transmission>'
    imported = import_model(write(tmp_path, link("a") + link("b") + joint("j", "continuous", "a", "b") + gear))
    assert any(notice.alters and "xacro" in notice.text for notice in imported.notices)


def test_an_orientation_may_be_a_quaternion(tmp_path: Path) -> None:
    """From version 1.1 on: a quarter turn about z, as roll, pitch and yaw have it."""
    quaternion = joint("j", "continuous", "a", "b").replace('rpy="0.1 0.7 -0.4"', 'quat_xyzw="0 0 1 1"')
    turned = joint("j", "continuous", "a", "b", rpy="0 0 1.5707963267948966")
    first, second = (
        import_model(write(tmp_path, link("a") + link("b") + one)).model.bodies for one in (quaternion, turned)
    )
    assert first == second
    both = quaternion.replace("quat_xyzw", 'rpy="0 0 0" quat_xyzw')
    assert "rpy beside quat_xyzw; give one of the two" in faults_of(write(tmp_path, link("a") + link("b") + both))[0]


def test_a_ball_of_urdf_is_a_ball(tmp_path: Path) -> None:
    """As Pinocchio's ball, from zero speed: the mass matrix in the turns is T^T M T."""
    path = write(tmp_path, link("a") + link("b") + joint("j", "spherical", "a", "b"))
    kernels = Kernels(import_model(path), ("semi",))
    model = pin.Model()
    model.addJoint(0, pin.JointModelSpherical(), pin.SE3.Identity(), "j")
    solid = pin.buildModelFromUrdf(str(write(tmp_path, link("a") + link("b") + joint("j", "continuous", "a", "b"))))
    model.inertias[1] = solid.inertias[1]
    for state in kernels.draw_states():
        T = turn_rates(*state.q)
        M = pin.crba(model, model.createData(), np.array([0, 0, 0, 1.0]))
        np.testing.assert_allclose(kernels.compute(state)["M"], T.T @ M @ T, atol=1e-13)
