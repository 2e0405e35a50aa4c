"""Loops, constraints and their ends in a model file: sections -> parts of a Model.

The axes, the length and the pitch that a type does not have stay at their defaults; `loop_checks` refuses others.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Annotated, Any, Literal

from pydantic import Field

from mbsgen.documents import Read, Section, WrongValueError, abbreviate, nearest
from mbsgen.model.model import BASE, UNITS, ZERO, Constraint, Loop, LoopEnd
from mbsgen.model.sections import DirectionField, NumberField, PlacementSection
from mbsgen.model.tree import Cut

SYNONYMS: Mapping[str, Cut] = MappingProxyType({"revolute": Cut.HINGE, "spherical": Cut.BALL, "fixed": Cut.SOLID})
WORDS: Mapping[str, Cut] = MappingProxyType({**{cut.value: cut for cut in Cut}, **SYNONYMS})

_NOTHING = "it would keep nothing together: leave the loop out"
_OTHERS: Mapping[str, str] = MappingProxyType(  # types of joints that no loop has
    {
        "floating": _NOTHING,
        "free": _NOTHING,
        "cardan": "give universal, with axis and axis2",
    }
)

Word = Literal[
    "rod",
    "ball",
    "spherical",
    "hinge",
    "revolute",
    "universal",
    "cylindrical",
    "helical",
    "prismatic",
    "planar",
    "solid",
    "fixed",
]


def read_cut(value: Any) -> Cut:
    """Read the type of a loop, or a synonym of it. Raises WrongValueError."""
    if isinstance(value, str) and value in WORDS:
        return WORDS[value]
    if isinstance(value, str) and value in _OTHERS:
        raise WrongValueError(f"no loop is closed by {abbreviate(value)}", _OTHERS[value])
    meant = nearest(value, list(WORDS)) if isinstance(value, str) else None
    remedy = f"did you mean {abbreviate(meant)}?" if meant else f"give one of {', '.join(WORDS)}"
    raise WrongValueError(f"found {abbreviate(value)}", remedy)


CutField = Annotated[Cut, Read(read_cut, Word)]


class LoopEndSection(PlacementSection):
    """One end of a loop: a frame on a body."""

    body: str = Field(examples=[BASE], description="a body, or base")

    @property
    def end(self) -> LoopEnd:
        """The same as a part of a Model."""
        return LoopEnd(self.body, self.placement)


class LoopSection(Section):
    """A joint that closes a loop of bodies, between frames on two of them: it has equations, and no coordinate."""

    name: str = Field(examples=["knee"])
    type: CutField = Field(examples=["hinge"], description="what it keeps together")
    first: LoopEndSection = Field(alias="from", examples=[{"body": BASE}])
    second: LoopEndSection = Field(alias="to", examples=[{"body": BASE}])
    axis: DirectionField = Field(
        UNITS["z"],
        examples=["z"],
        description="of hinge, cylindrical, helical, prismatic and planar (its normal), in both frames; of universal, "
        "the first",
    )
    axis2: DirectionField = Field(
        UNITS["x"], examples=["x"], description="of universal: the second axis, in the second frame"
    )
    length: NumberField = Field(ZERO, examples=[0.3], description="of a rod, m")
    pitch: NumberField = Field(ZERO, examples=[0.01], description="of helical, m/rad: how far it moves for each radian")

    def make(self) -> Loop:
        """Make the part of a Model."""
        numbers = self.length, self.pitch
        return Loop(self.name, self.type, self.first.end, self.second.end, self.axis, self.axis2, *numbers)


class ConstraintSection(Section):
    """An equation of coordinates: what vanishes."""

    name: str = Field(examples=["gear"])
    equation: NumberField = Field(examples=["q1 + 2*q2"], description="over names of joints, and parameters; it is 0")

    def make(self) -> Constraint:
        """Make the part of a Model."""
        return Constraint(self.name, self.equation)
