"""Joint types: each is written as it was read, faults are where the author made them, a new type is one entry."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
from pydantic import Field

from mbsgen.errors import InputError
from mbsgen.expressions import Number
from mbsgen.formulations.catalogue import FUNCTIONS
from mbsgen.formulations.reductions import ALL
from mbsgen.model import joints
from mbsgen.model.changes.locking import lock
from mbsgen.model.changes.reduction import build_tree
from mbsgen.model.changes.releasing import with_runtime_numbers
from mbsgen.model.construction import body, joint, make_model, revolute
from mbsgen.model.file.schema import write_schema
from mbsgen.model.following import list_joints
from mbsgen.model.joints.compound import slide, turn
from mbsgen.model.joints.section import Description, JointSection
from mbsgen.model.model import Carrier, Follow, Joint, Model
from mbsgen.model.reader import read_model
from mbsgen.model.writer import write_model
from mbsgen.pipeline import Options, make
from mbsgen.tape.interpreter import evaluate

WRITTEN = {
    "helical": "{type: helical, axis: [0, 0.6, 0.8], pitch: 0.005/(2*pi), position: [0.1, 0, 0], limits: [-1, null]}",
    "helical with a name": "{name: screw, type: helical, axis: -x, pitch: -0.1, actuated: false, armature: 0.01}",
    "universal": "{type: universal, axis: [1, 0, 0.2], axis2: y, axes: {r: {name: tilt, limits: [-1, 1]}}}",
    "universal, passive": "{type: universal, axis: [1, 0, 0.2], axis2: [0, 1, 0.2], actuated: false}",
    "cylindrical": "{type: cylindrical, axis: -z, axes: {rz: {damping: 0.1}, z: {actuated: false}}}",
    "planar": "{type: planar, normal: [0, 0.6, 0.8], orientation: [{axis: x, angle: 0.3}], axes: {t: {stiffness: 3}}}",
}


def read(text: str, folder: Path) -> Model:
    file = folder / "model.yaml"
    file.write_text(f"name: m\ngravity: [0, 0, -9.81]\nbodies:\n  - name: link\n    joint: {text}\n", encoding="utf-8")
    with file.open("a", encoding="utf-8") as stream:
        stream.write("    mass: 2\n    inertia: [0.1, 0.2, 0.2]\n")
    return read_model(file)


@pytest.mark.parametrize("text", WRITTEN.values(), ids=WRITTEN.keys())
def test_a_joint_is_written_as_its_author_wrote_it(text: str, tmp_path: Path) -> None:
    model = read(text, tmp_path)
    assert f"joint: {text}\n" in write_model(model).replace("\n      ", " ") or text.split(",")[0][1:] in write_model(
        model
    )
    file = tmp_path / "again.yaml"
    file.write_text(write_model(model), encoding="utf-8")
    assert read_model(file) == model


@pytest.mark.parametrize("key", ["helical with a name", "universal", "cylindrical", "planar"])
def test_the_rest_of_a_joint_with_a_locked_coordinate_is_written(key: str, tmp_path: Path) -> None:
    """As elementary joints, and a body that is fixed on them: with the same equations."""
    model = read(WRITTEN[key], tmp_path)
    tip = body("tip", revolute("y"), parent="link", mass=1, com=(1, 0, 0))
    first = list_joints(model)[0].name
    locked = lock(replace(model, bodies=(*model.bodies, tip)), {first: Number(0.3)})
    file = tmp_path / "locked.yaml"
    file.write_text(write_model(locked), encoding="utf-8")
    assert build_tree(read_model(file)) == build_tree(locked)


def test_numbers_at_run_time_have_the_paths_of_the_file(tmp_path: Path) -> None:
    """The place of a joint is its body's; settings belong to their own joint."""
    screw, tilted = (with_runtime_numbers(read(WRITTEN[key], tmp_path)) for key in ("helical with a name", "planar"))
    assert "screw.armature" in {p.name for p in screw.parameters}
    assert {"link.orientation.1", "link.t.stiffness"} <= {p.name for p in tilted.parameters}


FAULTS = {
    "{type: helical, axis: [0, 0, 0], pitch: 1}": ("joint.axis", "no direction"),
    "{type: helical, axis: x, pitch: 0}": ("joint.pitch", "ratio of 0"),
    "{type: helical, axis: x, pitch: 1, damping: -1}": ("joint.damping", "-1"),
    "{type: cylindrical, axis: [0, 0, 0]}": ("joint.axis", "no direction"),
    "{type: cylindrical, axis: x, axes: {rx: {damping: -1}}}": ("joint.axes.rx.damping", "-1"),
    "{type: cylindrical, axis: x, axes: {y: {}}}": ("joint.axes.y", "rx, x"),
    "{type: universal, axis: x}": ("joint.axis", "axis2"),
    "{type: universal, axis: x, axis2: [0, 0, 0]}": ("joint.axis2", "no direction"),
    "{type: universal, axis: x, axis2: y, order: xy}": ("joint.axis", "order"),
    "{type: planar, normal: [0, 0, 0]}": ("joint.normal", "no direction"),
    "{type: planar, normal: [0, 0, k]}": ("joint.normal", "give numbers"),
    "{type: planar, normal: [0, 0, sqrt(-1)]}": ("joint.normal", "no value"),
    "{type: planar, normal: z, plane: xy}": ("joint.normal", "plane"),
    "{type: screw, axis: x}": ("joint.type", "'helical'"),
}


@pytest.mark.parametrize(("text", "expected"), FAULTS.items(), ids=FAULTS.keys())
def test_a_fault_is_where_its_author_made_it(text: str, expected: tuple[str, str], tmp_path: Path) -> None:
    with pytest.raises(InputError) as caught:
        read(text, tmp_path)
    fault = caught.value.faults[0]
    assert fault.path.endswith(expected[0])
    assert expected[1] in str(fault)


def test_a_type_that_there_is_not_is_refused_in_python() -> None:
    with pytest.raises(ValueError, match=r"did you mean helical\? give one of revolute, .* helical"):
        joint("helicla", axis="z")
    with pytest.raises(ValueError, match="axis: one axis alone"):
        joint("universal", axis="z")


# -- a type of the test's own ------------------------------------------------------------------------------------------

M8 = 1.25e-3 / (2 * np.pi)  # m/rad


class BoltSection(JointSection):
    """A bolt of metric size 8, along its own z axis."""

    type: Literal["bolt"] = Field(examples=["bolt"])
    left: bool = Field(False, examples=[True], description="whether its thread is left-handed")

    def make(self, body: str) -> tuple[Joint, ...]:
        """Make a turn, and a slide that follows it."""
        turned = replace(turn("z", part_of="bolt"), name=f"{body} angle", placement=self.placement)
        follow = Follow(f"{body} angle", Number(-M8 if self.left else M8))
        return turned, replace(slide("z", part_of="bolt"), actuated=False, follows=follow)

    @classmethod
    def describe(cls, body: str, carrier: Carrier) -> Description | None:  # noqa: ARG003
        """Describe a bolt."""
        match carrier:
            case (Joint(part_of="bolt") as turned, Joint(follows=Follow() as follow)):
                fields = {"left": "true"} if follow.ratio == Number(-M8) else {}
                return Description("bolt", fields, turned.placement)
        return None


def test_a_new_type_is_a_class_and_an_entry(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Read, written, described to editors, made in Python, generated and verified; M is I_zz + p^2 m."""
    with pytest.raises(InputError, match="give 'revolute'"):
        read("{type: bolt}", tmp_path)
    monkeypatch.setattr(joints, "JOINT_TYPES", (*joints.JOINT_TYPES, BoltSection))
    model = read("{type: bolt, left: true, position: [0, 0, 1]}", tmp_path)
    assert "joint: {type: bolt, left: true, position: [0, 0, 1]}" in write_model(model)
    assert "bolt" in json.loads(write_schema())["$defs"]["BoltSection"]["properties"]["type"]["const"]
    link = body("link", joint("bolt", left=True, position=(0, 0, 1)), mass=2, inertia=(0.1, 0.2, 0.2))
    assert make_model("m", [link], gravity=(0, 0, -9.81)) == model
    tree = build_tree(model)
    M, c = (evaluate(FUNCTIONS["semi"].build(tree, ALL), {"q": [0.3], "qd": [1.0]})[key] for key in ("M", "c"))
    assert pytest.approx([0.2 + 2 * M8**2], rel=1e-14) == M
    assert c == pytest.approx([-M8 * 2 * 9.81], rel=1e-14)
    made = make(model, Options(functions=("impl",)))
    assert [x.name for x in made.manifest.coordinates] == ["link angle"]
    with pytest.raises(InputError, match="'bolt'"):
        read("{type: blot}", tmp_path)
