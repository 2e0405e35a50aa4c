"""A body that moves freely in a plane: slides along its directions e1 and e2, then a turn about its normal e1 x e2.

The plane is one of two coordinate axes, or has a normal of any direction. With a normal, e1 is the projection of the
coordinate axis that is farthest from it (the first one of several), and e2
is normal x e1, both of length 1.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import ClassVar, Literal

from pydantic import Field

from mbsgen.algebra.dense import Row, cross, dot, identity
from mbsgen.documents import Finding, Place, abbreviate
from mbsgen.expressions import FLOATS, ExpressionError, Number, evaluate, names
from mbsgen.model.joints.compound import CompoundSection, is_alike, slide, turn
from mbsgen.model.joints.section import Description
from mbsgen.model.model import Carrier, Joint, Triple
from mbsgen.model.sections import OptionalDirectionField

_PLANES = {"xy": "z", "xz": "y", "yz": "x"}  # with their normals
_NAME = "planar"


class PlanarSection(CompoundSection):
    """Two slides along the axes of a plane, then a turn about its normal; passive by default."""

    DRIVEN: ClassVar[bool] = False

    type: Literal["planar"] = Field(examples=["planar"])
    plane: Literal["xy", "xz", "yz"] = Field("xy", examples=["xy"])
    normal: OptionalDirectionField = Field(
        None, examples=[[0.0, 0.6, 0.8]], description="of a plane in any direction, in numbers; instead of plane"
    )

    def list_joints(self) -> tuple[Joint, ...]:
        """List the slides, then the turn."""
        return _list_joints(self.plane) if self.normal is None else _list_joints(self.normal)

    def find_faults(self) -> Iterator[Finding]:
        """Find a plane that is given twice, or at run time."""
        yield from super().find_faults()
        if self.normal is None:
            return
        if "plane" in self.model_fields_set:
            yield Finding(("normal",), "a normal beside a plane", "give one of the two")
        if used := sorted(name for component in self.normal for name in names(component)):
            remedy = "give numbers, or turn the joint by its orientation"
            yield Finding(("normal",), f"the normal depends on {abbreviate(used[0])}", remedy)

    @classmethod
    def describe(cls, body: str, carrier: Carrier) -> Description | None:
        """Describe two slides and the turn about their normal."""
        if not isinstance(carrier, tuple):
            return None
        for plane in _PLANES:
            if is_alike(carrier, _list_joints(plane)):
                return cls.write(carrier, {"plane": plane})
        normal = carrier[-1].axis
        return cls.write(carrier, {"normal": normal}) if is_alike(carrier, _list_joints(normal)) else None

    def locate(self, k: int, key: Place) -> Place:
        """Find the normal, or the settings of a joint."""
        return ("normal", *key[1:]) if key[:1] == ("axis",) else super().locate(k, key)


def _list_joints(plane: str | Triple) -> tuple[Joint, ...]:
    if isinstance(plane, str):
        return (*map(slide, plane), turn(_PLANES[plane]))
    return (*(slide(axis, part_of=_NAME) for axis in _span(plane)), turn(plane, part_of=_NAME))


def _span(normal: Triple) -> Iterator[Triple]:
    """Find two directions across a normal; any two where it has no value or no direction, which is a fault."""
    try:
        n: Row = tuple(evaluate(component, {}, FLOATS) for component in normal)
    except ExpressionError:
        n = (0.0, 0.0, 0.0)
    n = n if any(n) else (0.0, 0.0, 1.0)
    sizes = [abs(x) for x in n]
    nearest = identity(3)[sizes.index(min(sizes))]
    part = dot(nearest, n) / dot(n, n)
    first = _normalise(tuple(x - part * y for x, y in zip(nearest, n, strict=True)))
    for direction in (first, cross(_normalise(n), first)):
        x, y, z = (Number(float(x) or 0.0) for x in direction)
        yield x, y, z


def _normalise(v: Row) -> Row:
    length = math.sqrt(dot(v, v))
    return tuple(x / length for x in v)
