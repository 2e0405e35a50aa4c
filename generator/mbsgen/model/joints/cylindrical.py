"""A cylindrical joint: a turn about an axis, and a slide along it, with a coordinate each."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from mbsgen.documents import Place
from mbsgen.model.joints.compound import CompoundSection, is_alike, slide, turn
from mbsgen.model.joints.section import Description
from mbsgen.model.model import Carrier, Joint, Triple
from mbsgen.model.sections import DirectionField

_NAME = "cylindrical"


class CylindricalSection(CompoundSection):
    """A turn about an axis, then a slide along it."""

    type: Literal["cylindrical"] = Field(examples=["cylindrical"])
    axis: DirectionField = Field(examples=["z"])

    def list_joints(self) -> tuple[Joint, ...]:
        """List the turn, then the slide."""
        return _make_joints(self.axis)

    @classmethod
    def describe(cls, body: str, carrier: Carrier) -> Description | None:
        """Describe a turn and a slide that were made by this type."""
        match carrier:
            case (Joint(axis=axis), Joint()) if is_alike(carrier, _make_joints(axis)):
                return cls.write(carrier, {"axis": axis})
        return None

    def locate(self, k: int, key: Place) -> Place:
        """Find the axis, or the settings of a joint."""
        return key if key[:1] == ("axis",) else super().locate(k, key)


def _make_joints(axis: Triple) -> tuple[Joint, ...]:
    return turn(axis, part_of=_NAME), slide(axis, part_of=_NAME)
