"""The joints of one degree of freedom with the twist (e, 0) or (0, e), and no joint at all."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from mbsgen.model.joints.section import Description, JointSection
from mbsgen.model.model import Carrier, Fixed, Joint
from mbsgen.model.sections import DirectionField, SettingSection
from mbsgen.model.tree import Motion


class ElementarySection(JointSection, SettingSection):
    """One degree of freedom, and the pose of its moving frame on the parent at q = 0."""

    type: Literal["revolute", "prismatic"] = Field(examples=["revolute"])
    axis: DirectionField = Field(examples=["z"])

    def make(self, body: str) -> Joint:
        """Make the joint."""
        return self.apply(Joint(Motion(self.type), self.axis, placement=self.placement))

    @classmethod
    def describe(cls, body: str, carrier: Carrier) -> Description | None:
        """Describe a single joint."""
        if not isinstance(carrier, Joint):
            return None
        return Description(carrier.motion.value, {"axis": carrier.axis}, carrier.placement, setting=carrier)


class FixedSection(JointSection):
    """A fixed connection of a body to its parent."""

    type: Literal["fixed"] = Field(examples=["fixed"])

    def make(self, body: str) -> Fixed:
        """Make the placement of a body that does not move on its parent."""
        return Fixed(self.placement)

    @classmethod
    def describe(cls, body: str, carrier: Carrier) -> Description | None:
        """Describe the placement of a fixed body."""
        return Description("fixed", {}, carrier.placement) if isinstance(carrier, Fixed) else None
