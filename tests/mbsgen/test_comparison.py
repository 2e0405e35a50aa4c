"""Imported robots beside Pinocchio: what differs is named, and what agrees is not blamed."""

from __future__ import annotations

from pathlib import Path

import pytest

from mbsgen import comparison
from mbsgen.comparison import TOLERANCE, compare_with_pinocchio
from mbsgen.errors import InputError
from mbsgen.importing import Choices
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


def test_trees_are_compared_without_their_loops(tmp_path: Path) -> None:
    """Also where the loops do not close: Pinocchio's reader knows none."""
    ends = '<predecessor link="d"/><successor link="e"/>'
    coupling = '<coupling name="belt"><predecessor link="d"/><successor link="c"/></coupling>'
    path = write(tmp_path, "".join(ARM) + f'<loop name="weld" type="fixed">{ends}</loop>{coupling}')
    found = compare_with_pinocchio(path, Choices())
    assert max(found.imported.values()) < TOLERANCE
    assert found.named[0].startswith("loops and constraints weld, belt: Pinocchio's reader has none")


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
