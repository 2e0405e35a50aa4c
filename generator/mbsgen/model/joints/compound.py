"""Joint types that are elementary joints in a row, each in the frame that those before it moved."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Annotated, ClassVar

from pydantic import Field, JsonValue

from mbsgen.documents import Finding, Place, abbreviate
from mbsgen.model.expansion import label_joints
from mbsgen.model.joints.section import Description, JointSection
from mbsgen.model.model import HERE, UNITS, Carrier, Joint, Placement, Triple
from mbsgen.model.sections import SettingSection
from mbsgen.model.tree import Motion

_LABELS: list[JsonValue] = ["x", "y", "z", "rx", "ry", "rz", "t", "r", "t2", "r2"]


def turn(axis: str | Triple, *, part_of: str = "") -> Joint:
    """Make a joint that turns about a direction."""
    return Joint(Motion.REVOLUTE, UNITS[axis] if isinstance(axis, str) else axis, part_of=part_of)


def slide(axis: str | Triple, *, part_of: str = "") -> Joint:
    """Make a joint that slides along a direction."""
    return Joint(Motion.PRISMATIC, UNITS[axis] if isinstance(axis, str) else axis, part_of=part_of)


def stand(joints: Sequence[Joint], placement: Placement, *, actuated: bool) -> tuple[Joint, ...]:
    """Place joints in a row on their parent."""
    first, *rest = (replace(joint, actuated=actuated) for joint in joints)
    return (replace(first, placement=placement), *rest)


def is_alike(carrier: Carrier, joints: Sequence[Joint]) -> bool:
    """Test whether joints are in a row and move as these do, whatever their names, limits and forces."""
    if not isinstance(carrier, tuple) or any(joint.placement != HERE for joint in carrier[1:]):
        return False
    return _list_motions(carrier) == _list_motions(joints)


def _list_motions(joints: Sequence[Joint]) -> list[tuple[Motion, Triple, bool, str]]:
    return [(joint.motion, joint.axis, joint.floats, joint.part_of) for joint in joints]


class CompoundSection(JointSection):
    """A usual sequence of joints, each in the frame that those before it moved."""

    DRIVEN: ClassVar[bool] = True  # whether its joints take inputs unless the file says otherwise

    actuated: bool | None = Field(None, examples=[True], description="whether its joints take inputs u")
    axes: dict[str, Annotated[SettingSection, Field(examples=[{}])]] = Field(
        {},
        examples=[{}],
        description="settings of its elementary joints: x slides along x, rx turns about it; t and r, any other axis",
        json_schema_extra={"propertyNames": {"enum": _LABELS}},
    )

    @abstractmethod
    def list_joints(self) -> tuple[Joint, ...]:
        """List the elementary joints, without placement and settings."""

    def make(self, body: str) -> tuple[Joint, ...]:
        """Make the elementary joints, with their settings."""
        actuated = self.DRIVEN if self.actuated is None else self.actuated
        joints = stand(self.list_joints(), self.placement, actuated=actuated)
        labelled = zip(joints, label_joints(joints), strict=True)
        return tuple(self.axes[label].apply(joint) if label in self.axes else joint for joint, label in labelled)

    @classmethod
    def write(cls, carrier: Sequence[Joint], fields: dict[str, str | Triple]) -> Description:
        """Describe joints of this type that have these fields."""
        name, *_ = cls.list_names()
        axes = dict(zip(label_joints(carrier), carrier, strict=True))
        return Description(name, fields, carrier[0].placement, axes=axes, actuated=cls.DRIVEN)

    def locate(self, k: int, key: Place) -> Place:
        """Find the settings of a joint under its label; all joints share the place of the first."""
        label = label_joints(self.list_joints())[k]
        return ("axes", label, *key) if label in self.axes and key[:1] not in (("position",), ("orientation",)) else key

    def find_faults(self) -> Iterator[Finding]:
        """Find settings of joints that the type does not have."""
        labels = label_joints(self.list_joints())
        for label in self.axes:
            if label not in labels:
                yield Finding(
                    ("axes", label), f"no axis {abbreviate(label)}", f"the axes of this joint are {', '.join(labels)}"
                )
