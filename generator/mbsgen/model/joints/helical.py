"""A helical joint, or screw, with the twist S = (e, p e): it turns by q about e, and slides by p q along e.

A slide along e follows a turn about e with the ratio p, the pitch in m/rad. The coordinate belongs to the turn; the
equations are exact: M = I_ee + p^2 m for a body with its centre of mass on the axis.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

from pydantic import Field

from mbsgen.documents import Place
from mbsgen.model.joints.compound import slide, turn
from mbsgen.model.joints.section import Description, JointSection
from mbsgen.model.model import HERE, Carrier, Follow, Joint
from mbsgen.model.sections import DirectionField, NumberField, SettingSection

_NAME = "helical"


class HelicalSection(JointSection, SettingSection):
    """A screw: it turns about an axis, and moves along it in proportion."""

    type: Literal["helical"] = Field(examples=["helical"])
    axis: DirectionField = Field(examples=["z"])
    pitch: NumberField = Field(examples=[0.01], description="m/rad: how far it moves for each radian; not 0")

    def make(self, body: str) -> tuple[Joint, ...]:
        """Make the turn, which has the coordinate and the settings, and the slide that follows it."""
        placed = replace(turn(self.axis, part_of=_NAME), placement=self.placement)
        turned = replace(self.apply(placed), name=body if self.name is None else self.name)
        return turned, _follow(turned, Follow(turned.name or body, self.pitch))

    @classmethod
    def describe(cls, body: str, carrier: Carrier) -> Description | None:
        """Describe a turn, and the slide that follows it."""
        match carrier:
            case (Joint(part_of="helical", name=str(name)) as turned, Joint(follows=Follow() as follow) as slid):
                if slid == _follow(turned, Follow(name, follow.ratio)) and slid.placement == HERE:
                    setting = replace(turned, name=None) if name == body else turned
                    fields = {"axis": turned.axis, "pitch": follow.ratio}
                    return Description(_NAME, fields, turned.placement, setting=setting)
        return None

    def locate(self, k: int, key: Place) -> Place:
        """Find the pitch, or a setting of the turn."""
        return ("pitch",) if k == 1 and key[:1] == ("follows",) else key


def _follow(turned: Joint, follow: Follow) -> Joint:
    return replace(slide(turned.axis, part_of=_NAME), actuated=False, follows=follow)
