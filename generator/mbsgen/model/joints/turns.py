"""Two or three turns about coordinate axes through one point: Cardan angles, Euler angles."""

from __future__ import annotations

from typing import Literal, get_args

from pydantic import Field

from mbsgen.model.joints.compound import CompoundSection, is_alike, turn
from mbsgen.model.joints.section import Description
from mbsgen.model.model import Carrier, Joint

Pair = Literal["xy", "xz", "yx", "yz", "zx", "zy"]
Triad = Literal["xyz", "xzy", "yxz", "yzx", "zxy", "zyx"]


def make_turns(order: str) -> tuple[Joint, ...]:
    """Make turns about axes in turn."""
    return tuple(map(turn, order))


class CardanSection(CompoundSection):
    """Two revolute joints with axes that meet."""

    type: Literal["cardan"] = Field(examples=["cardan"])
    order: Pair = Field("xy", examples=["xy"])

    def list_joints(self) -> tuple[Joint, ...]:
        """List the two turns."""
        return make_turns(self.order)

    @classmethod
    def describe(cls, body: str, carrier: Carrier) -> Description | None:
        """Describe two turns about coordinate axes."""
        return _describe(cls, carrier, get_args(Pair))


class SphericalSection(CompoundSection):
    """Three revolute joints with axes that meet; they lock where the second is at a quarter turn."""

    type: Literal["spherical"] = Field(examples=["spherical"])
    order: Triad = Field("zyx", examples=["zyx"])

    def list_joints(self) -> tuple[Joint, ...]:
        """List the three turns."""
        return make_turns(self.order)

    @classmethod
    def describe(cls, body: str, carrier: Carrier) -> Description | None:
        """Describe three turns about coordinate axes, each about another one."""
        return _describe(cls, carrier, get_args(Triad))


def _describe(section: type[CompoundSection], carrier: Carrier, orders: tuple[str, ...]) -> Description | None:
    for order in orders:
        if isinstance(carrier, tuple) and is_alike(carrier, make_turns(order)):
            return section.write(carrier, {"order": order})
    return None
