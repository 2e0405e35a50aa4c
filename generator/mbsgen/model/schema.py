"""The shape of a model file: what may stand where. What it says is judged in `checks`.

Lengths are in m, angles in rad, masses in kg, inertias in kg m2. Wherever a number is wanted, an expression over the
parameters may stand, such as `l1/2` or `-pi/2`. The examples tell users what is right, and stand in for what is wrong
while the rest of a file is examined.
"""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal

from pydantic import Discriminator, Field, PlainValidator, Tag

from mbsgen.documents import Section, WrongValueError, abbreviate
from mbsgen.expressions import Expression, ExpressionError, Number, parse
from mbsgen.model.model import BASE, Triple
from mbsgen.model.tree import Kind

ZERO = Number(0.0)
ORIGIN: Triple = (ZERO, ZERO, ZERO)
_DIRECTION = "give x, y, z, -x, -y, -z or a direction such as [0, 0.6, 0.8]"


def read_number(value: Any) -> Expression:
    """Read a number or an expression."""
    if isinstance(value, str):
        try:
            return parse(value)
        except ExpressionError as error:
            raise WrongValueError(error.finding, error.remedy) from None
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise WrongValueError(f"found {abbreviate(value)}", "give a number, or an expression such as l1/2")
    if not math.isfinite(value):
        raise WrongValueError(f"found {value}", "give a finite number")
    return Number(float(value) or 0.0)  # no -0


def read_limit(value: Any) -> Expression | None:
    """Read a number, an expression, or nothing where there is no limit."""
    if isinstance(value, float) and math.isinf(value):
        raise WrongValueError(f"found {value}", "give null where there is no limit")
    return None if value is None else read_number(value)


def read_direction(value: Any) -> Triple:
    """Read a named axis or three numbers."""
    if isinstance(value, str) and value[-1:] in ("x", "y", "z") and value[:-1] in ("", "-"):
        length = -1.0 if value.startswith("-") else 1.0
        x, y, z = (Number(length if axis == value[-1] else 0.0) for axis in "xyz")
        return x, y, z
    if isinstance(value, list) and len(value) == 3:
        a, b, c = map(read_number, value)
        return a, b, c
    raise WrongValueError(f"found {abbreviate(value)}", _DIRECTION)


def _tell_mappings(value: Any) -> str:
    return "mapping" if isinstance(value, dict) else "other"


NumberField = Annotated[Expression, PlainValidator(read_number)]
LimitField = Annotated[Expression | None, PlainValidator(read_limit)]
DirectionField = Annotated[Triple, PlainValidator(read_direction)]
TripleField = tuple[NumberField, NumberField, NumberField]


class ParameterSection(Section):
    """A parameter with its kind: constants are folded into the code, run-time parameters are an input of it."""

    value: NumberField = Field(examples=[1.0])
    kind: Kind = Field(Kind.CONSTANT, examples=["constant"])


class RotationSection(Section):
    """A rotation about one axis of the frame turned so far."""

    axis: Literal["x", "y", "z"] = Field(examples=["z"])
    angle: NumberField = Field(examples=[0.5])


class PlacementSection(Section):
    """Where a frame stands: its origin, and rotations in turn, each about the axes turned so far."""

    position: TripleField = Field(ORIGIN, examples=[[0.1, 0.0, 0.0]])
    orientation: tuple[RotationSection, ...] = Field((), examples=[[{"axis": "x", "angle": 0.5}]])


class JointSection(PlacementSection):
    """A joint: how it moves its body, and where that body's frame stands on the parent while q = 0."""

    name: str | None = Field(None, examples=["q1"])  # else the body's
    type: Literal["revolute", "prismatic"] = Field(examples=["revolute"])
    axis: DirectionField = Field(examples=["z"])
    actuated: bool = Field(True, examples=[True])
    limits: tuple[LimitField, LimitField] = Field((None, None), examples=[[-1.0, 1.0]])


class TensorSection(Section):
    """A full inertia tensor; products of inertia are the off-diagonal entries themselves, sign included."""

    xx: NumberField = Field(examples=[1.0])
    yy: NumberField = Field(examples=[1.0])
    zz: NumberField = Field(examples=[1.0])
    xy: NumberField = Field(ZERO, examples=[0.0])
    xz: NumberField = Field(ZERO, examples=[0.0])
    yz: NumberField = Field(ZERO, examples=[0.0])


class BodySection(Section):
    """A rigid body, carried by a joint; without mass and inertia it only links joints."""

    name: str = Field(examples=["upperarm"])
    parent: str = Field(BASE, examples=[BASE])
    joint: JointSection = Field(examples=[{"type": "revolute", "axis": "z"}])
    mass: NumberField = Field(ZERO, examples=[1.0])
    com: TripleField = Field(ORIGIN, examples=[[0.1, 0.0, 0.0]])
    inertia: Annotated[
        Annotated[TripleField, Tag("other")] | Annotated[TensorSection, Tag("mapping")], Discriminator(_tell_mappings)
    ] = Field(ORIGIN, examples=[[0.1, 0.1, 0.1]])


class FrameSection(PlacementSection):
    """A named frame on a body, of which the pose is wanted: a sensor."""

    name: str = Field(examples=["hand"])
    body: str = Field(examples=[BASE])


ParameterField = Annotated[
    Annotated[NumberField, Tag("other")] | Annotated[ParameterSection, Tag("mapping")], Discriminator(_tell_mappings)
]


EXAMPLE = {"name": "rod", "joint": {"type": "revolute", "axis": "z"}, "mass": 1.0, "com": [0.5, 0.0, 0.0]}


class ModelSection(Section):
    """A model file."""

    name: str = Field(examples=["arm"])
    gravity: TripleField = Field(examples=[[0.0, 0.0, -9.81]])
    parameters: dict[str, Annotated[ParameterField, Field(examples=[1.0])]] = Field({}, examples=[{"l1": 0.3}])
    bodies: tuple[Annotated[BodySection, Field(examples=[EXAMPLE])], ...] = Field(examples=[[EXAMPLE]])
    frames: tuple[FrameSection, ...] = Field((), examples=[[]])
    allow_unphysical: bool = Field(False, examples=[False])
