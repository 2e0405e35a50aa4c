"""A free body by six elementary joints: its place, and three turns."""

from __future__ import annotations

from typing import ClassVar, Literal, get_args

from pydantic import Field

from mbsgen.model.joints.compound import CompoundSection, is_alike, slide
from mbsgen.model.joints.section import Description
from mbsgen.model.joints.turns import Triad, make_turns
from mbsgen.model.model import Carrier, Joint


class FloatingSection(CompoundSection):
    """Three prismatic joints along x, y, z, then a spherical joint: a free body, passive by default."""

    DRIVEN: ClassVar[bool] = False

    type: Literal["floating"] = Field(examples=["floating"])
    order: Triad = Field("zyx", examples=["zyx"])

    def list_joints(self) -> tuple[Joint, ...]:
        """List the slides, then the turns."""
        return _make_joints(self.order)

    @classmethod
    def describe(cls, body: str, carrier: Carrier) -> Description | None:
        """Describe slides along x, y, z, then turns about each of them."""
        for order in get_args(Triad):
            if isinstance(carrier, tuple) and is_alike(carrier, _make_joints(order)):
                return cls.write(carrier, {"order": order})
        return None


def _make_joints(order: str) -> tuple[Joint, ...]:
    return (*map(slide, "xyz"), *make_turns(order))
