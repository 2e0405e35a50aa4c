"""Imported robots beside Pinocchio: what differs is named, and what agrees is not blamed."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from sympy import Rational

from mbsgen import comparison
from mbsgen.closed_comparison import End, Joints
from mbsgen.comparison import TOLERANCE, compare_with_pinocchio
from mbsgen.errors import InputError
from mbsgen.importing import Choices
from mbsgen.model.tree import LoopFrame, Tree
from tests.mbsgen.importing.urdf_files import LIMIT, LOSSES, joint, link, write

ARM = (
    *(link(name) for name in "abcde"),
    joint("z", "revolute", "a", "b", f'<axis xyz="0 1 0"/>{LIMIT}'),
    joint("y", "continuous", "a", "c", '<axis xyz="0 0 1"/>'),
    joint("x", "prismatic", "b", "d", LIMIT),
    joint("w", "revolute", "c", "e", f'{LIMIT}<mimic joint="z" multiplier="-2" offset="0.3"/>'),
)


@pytest.mark.parametrize("base", ["fixed", "floating"])
def test_equal_equations_are_called_equal(base: str, tmp_path: Path) -> None:
    """Of another order, with a joint that follows, with a free base."""
    found = compare_with_pinocchio(write(tmp_path, "".join(ARM)), Choices(base=base))  # type: ignore[arg-type]
    assert found.agrees
    assert max(found.imported.values()) < TOLERANCE
    assert found.named == ("order of joints: Pinocchio's is y, w, z, x; ours is z, x, y, w",)


def test_trees_are_compared_alone_where_loops_do_not_close(tmp_path: Path) -> None:
    """Pinocchio's reader knows no loops."""
    ends = '<predecessor link="d"/><successor link="e"/>'
    coupling = '<coupling name="belt"><predecessor link="d"/><successor link="c"/></coupling>'
    path = write(tmp_path, "".join(ARM) + f'<loop name="weld" type="fixed">{ends}</loop>{coupling}')
    found = compare_with_pinocchio(path, Choices())
    assert max(found.imported.values()) < TOLERANCE
    assert found.named[0].startswith("loops and constraints weld, belt: Pinocchio's reader has none; the trees are ")
    assert "compared alone: loop " in found.named[0]
    assert not found.closed


CHAIN = (  # places on the link before, axes, turns of the next link's frame
    ("0 0 0.1", "0 1 0", "0 0 0"),
    ("0.3 0 0", "0.6 0 0.8", "0 0 1.5707963267948966"),
    ("0 0.2 0", "0 0 1", "0 0 0"),
    ("0 0.3 0.1", "1 0 0", "0 0 -1.5707963267948966"),
    ("0.1 0 0.2", "0 1 0", "0 0 0"),
    ("0.2 0.1 0", "0 -0.6 0.8", "0 0 0"),
    ("0 0 -0.1", "1 0 0", "0 0 0"),
)
PLACE = "0.1 0.1 0.3"  # on the first link, in reach of the last one


def close_chain(kind: str, place: str = PLACE, *, mass: float = 1.0) -> str:
    """Close a chain of seven turns in space by a loop between its last link and its first one."""
    text = link("l0") + "".join(link(f"l{i}", mass) for i in range(1, 8))
    for i, (at, axis, rpy) in enumerate(CHAIN):
        own = joint(f"q{i}", "revolute", f"l{i}", f"l{i + 1}", f'<axis xyz="{axis}"/>{LIMIT}{LOSSES}', rpy=rpy)
        text += own.replace("0.2 0.1 -0.3", at)
    ends = f'<predecessor link="l0"><origin xyz="{place}" rpy="0.2 0.1 0.4"/></predecessor>'
    ends += '<successor link="l7"><origin xyz="0 0 0" rpy="0.2 0.1 0.4"/></successor>'
    axis = '<axis xyz="0.6 0 0.8"/>' if kind not in ("fixed", "spherical") else ""
    return text + f'<loop name="ring" type="{kind}">{ends}{axis}</loop>'


@pytest.mark.parametrize("base", ["fixed", "floating"])
@pytest.mark.parametrize("kind", ["revolute", "prismatic", "fixed", "planar", "spherical"])
def test_loops_are_compared_at_closed_states(kind: str, base: str, tmp_path: Path) -> None:
    """Forces of loops, accelerations, and the ones of the reduced form: by velocities of the two ends."""
    found = compare_with_pinocchio(write(tmp_path, close_chain(kind)), Choices(base=base))  # type: ignore[arg-type]
    assert found.agrees
    assert set(found.closed) == {"rates", "forces", "qdd", "ydd"}
    assert max(found.closed.values()) < TOLERANCE
    assert "they are closed beside its model" in found.named[0]


def test_couplings_are_compared_beside_loops(tmp_path: Path) -> None:
    """Two turns and their ratio, by an equation or a joint that follows."""
    coupling = '<coupling name="belt"><predecessor link="l3"/><successor link="l1"/><ratio value="2"/></coupling>'
    found = compare_with_pinocchio(write(tmp_path, close_chain("spherical") + coupling), Choices())
    assert found.agrees
    assert found.closed


@pytest.mark.parametrize("change", ["mass", "place"])
def test_a_wrong_loop_is_a_difference(change: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A link 1 % heavier, or an end that is 1 mm away from the place where Pinocchio's ends are read."""
    path = write(tmp_path, close_chain("revolute"))
    if change == "mass":
        other = tmp_path / "other"
        other.mkdir()
        heavier = write(other, close_chain("revolute", mass=1.01))
        import_model = comparison.import_model
        monkeypatch.setattr(comparison, "import_model", lambda _, choices: import_model(heavier, choices))
    else:
        read = Joints.read

        def move(joints: Joints, tree: Tree, end: LoopFrame) -> End:
            x, y, z = end.position
            return read(joints, tree, replace(end, position=(x + Rational(1, 1000), y, z)) if end.body else end)

        monkeypatch.setattr(Joints, "read", move)
    found = compare_with_pinocchio(path, Choices())
    assert not found.agrees
    assert found.closed["qdd"] > 1e-6


@pytest.mark.parametrize("base", ["fixed", "floating"])
def test_a_joint_that_follows_a_sum_is_compared(base: str, tmp_path: Path) -> None:
    """Coupled as 2 (za + zb) = -zc in URDF+, where a follower that has no bounds has no coordinate."""
    joints = {"a": ("root", ""), "b": ("a", 'independent="false"'), "c": ("root", "")}
    text = link("root") + "".join(link(name) for name in joints)
    for name, (parent, more) in joints.items():
        axis = '<axis xyz="0 1 0"/>' if name != "b" else '<axis xyz="0 0 1"/>'
        text += joint(f"z{name}", "continuous", parent, name, axis).replace("<joint ", f"<joint {more} ")
    ends = '<predecessor link="b"/><successor link="c"/><ratio value="-2"/>'
    path = write(tmp_path, f'{text}<coupling name="sum">{ends}</coupling>')
    found = compare_with_pinocchio(path, Choices(base=base))  # type: ignore[arg-type]
    assert max(found.imported.values()) < TOLERANCE
    assert not [line for line in found.named if "constraints" in line]


def test_what_differs_is_named(tmp_path: Path) -> None:
    """Damping is in Phi and qdd, a rotor in M too; without them all agrees."""
    loss = LOSSES.replace("<dynamics", '<dynamics armature="0.4"')
    path = write(tmp_path, link("a") + link("b") + joint("j", "revolute", "a", "b", LIMIT + loss))
    found = compare_with_pinocchio(path, Choices())
    assert found.agrees
    assert all(found.imported[name] > 1e-3 for name in ("Phi", "M", "qdd"))
    assert [line.partition(":")[0] for line in found.named] == ["damping and friction of j", "armature of j"]


def test_what_is_zero_is_no_difference(tmp_path: Path) -> None:
    """A door turns about the vertical: its weight is not felt, and c is 0."""
    hinge = joint("j", "revolute", "a", "b", f'<axis xyz="0 0 1"/>{LIMIT}', rpy="0 0 0.3")
    found = compare_with_pinocchio(write(tmp_path, link("a") + link("b") + hinge), Choices())
    assert max(found.imported.values()) < TOLERANCE


def test_a_held_joint_is_held_in_both(tmp_path: Path) -> None:
    path = write(tmp_path, "".join(ARM))
    found = compare_with_pinocchio(path, Choices(locked=(("z", 0.4), ("y", -0.2))))
    assert max(found.imported.values()) < TOLERANCE


def test_a_wrong_mass_is_a_difference(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A gram in a kilogram is no rounding."""
    path = write(tmp_path, link("a") + link("b") + joint("j", "revolute", "a", "b", LIMIT))
    other = tmp_path / "other"
    other.mkdir()
    heavier = write(other, link("a") + link("b", 1.001) + joint("j", "revolute", "a", "b", LIMIT))
    import_model = comparison.import_model
    monkeypatch.setattr(comparison, "import_model", lambda _, choices: import_model(heavier, choices))
    assert not compare_with_pinocchio(path, Choices()).agrees


def test_joints_that_cannot_be_compared_are_refused(tmp_path: Path) -> None:
    path = write(tmp_path, link("a") + link("b") + joint("j", "planar", "a", "b", '<axis xyz="0 0 1"/>'))
    with pytest.raises(InputError, match="Pinocchio has other joints"):
        compare_with_pinocchio(path, Choices())
