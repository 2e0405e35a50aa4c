"""A universal joint by the author's axes: a turn about the first, then about the second, which the first one moves.

With coordinate axes it is a Cardan joint. The axes meet in the joint's origin, and need not be perpendicular.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

from pydantic import Field

from mbsgen.documents import Finding, Place
from mbsgen.model.joints.compound import CompoundSection, is_alike, turn
from mbsgen.model.joints.section import Description
from mbsgen.model.joints.turns import Pair, make_turns
from mbsgen.model.model import Carrier, Joint, Triple
from mbsgen.model.sections import OptionalDirectionField

_NAME = "universal"
_FIELDS = ("axis", "axis2")


class UniversalSection(CompoundSection):
    """Two revolute joints with axes that meet: a Cardan joint's, or any two."""

    type: Literal["universal"] = Field(examples=["universal"])
    order: Pair = Field("xy", examples=["xy"])
    axis: OptionalDirectionField = Field(None, examples=["x"], description="of the first turn; instead of order")
    axis2: OptionalDirectionField = Field(
        None, examples=[[0.0, 0.6, 0.8]], description="of the second turn, in the frame that the first has turned"
    )

    def list_joints(self) -> tuple[Joint, ...]:
        """List the two turns."""
        if self.axis is None or self.axis2 is None:
            return make_turns(self.order)
        return _make_turns(self.axis, self.axis2)

    def find_faults(self) -> Iterator[Finding]:
        """Find axes that are missing, or given twice."""
        yield from super().find_faults()
        given = [key for key, axis in zip(_FIELDS, (self.axis, self.axis2), strict=True) if axis is not None]
        if len(given) == 1:
            yield Finding((given[0],), "one axis alone", "give axis and axis2, or order")
        if given and "order" in self.model_fields_set:
            yield Finding((given[0],), "axes beside an order", "give one of the two")

    @classmethod
    def describe(cls, body: str, carrier: Carrier) -> Description | None:
        """Describe two turns that were made by this type."""
        match carrier:
            case (Joint(axis=first), Joint(axis=second)) if is_alike(carrier, _make_turns(first, second)):
                return cls.write(carrier, {"axis": first, "axis2": second})
        return None

    def locate(self, k: int, key: Place) -> Place:
        """Find one of the axes, or the settings of a joint."""
        return (_FIELDS[k], *key[1:]) if key[:1] == ("axis",) else super().locate(k, key)


def _make_turns(first: Triple, second: Triple) -> tuple[Joint, ...]:
    return turn(first, part_of=_NAME), turn(second, part_of=_NAME)
