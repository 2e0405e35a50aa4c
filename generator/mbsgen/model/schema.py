"""The shape of a model file: what may stand where. What it says is judged in `checks`.

Lengths are in m, angles in rad, masses in kg, inertias in kg m2. Wherever a number is wanted, an expression over the
parameters may stand, such as `l1/2` or `-pi/2`. The examples tell users what is right, and stand in for what is wrong
while the rest of a file is examined.
"""

from __future__ import annotations

import json
import math
from typing import Annotated, Any, Literal

from pydantic import Discriminator, Field, PlainValidator, Tag
from pydantic.json_schema import GenerateJsonSchema

from mbsgen import documents
from mbsgen.documents import Section, WrongValueError, abbreviate
from mbsgen.expressions import Expression, Number
from mbsgen.model.compounds import UNITS
from mbsgen.model.model import BASE, ONE, ORIGIN, ZERO, Triple
from mbsgen.model.tree import Kind

_DIRECTION = "give x, y, z, -x, -y, -z or a direction such as [0, 0.6, 0.8]"


def read_number(value: Any) -> Expression:
    """Read a number or an expression."""
    return documents.read_number(value, example="l1/2")


def read_limit(value: Any) -> Expression | None:
    """Read a number, an expression, or nothing where there is no limit."""
    if isinstance(value, float) and math.isinf(value):
        raise WrongValueError(f"found {value}", "give null where there is no limit")
    return None if value is None else read_number(value)


def read_direction(value: Any) -> Triple:
    """Read a named axis or three numbers."""
    if isinstance(value, str) and value in UNITS:
        return UNITS[value]
    if isinstance(value, list) and len(value) == 3:
        a, b, c = map(read_number, value)
        return a, b, c
    raise WrongValueError(f"found {abbreviate(value)}", _DIRECTION)


def _tell_mappings(value: Any) -> str:
    return "mapping" if isinstance(value, dict) else "other"


def _tell_inputs(value: Any) -> str:
    return "input" if isinstance(value, str) else "other"


def _tell_lists(value: Any) -> str:
    return "list" if isinstance(value, list) else "other"


Written = float | str  # a number, or an expression
NumberField = Annotated[Expression, PlainValidator(read_number, json_schema_input_type=Written)]
LimitField = Annotated[Expression | None, PlainValidator(read_limit, json_schema_input_type=Written | None)]
DirectionField = Annotated[
    Triple,
    PlainValidator(
        read_direction,
        json_schema_input_type=Literal["x", "y", "z", "-x", "-y", "-z"] | tuple[Written, Written, Written],
    ),
]
TripleField = tuple[NumberField, NumberField, NumberField]


class ParameterSection(Section):
    """A parameter with its kind: constants are folded into the code, others are inputs of it."""

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


class FrictionSection(Section):
    """Dry friction, smoothed: -torque*tanh(qd/speed)."""

    torque: NumberField = Field(examples=[0.5], description="Nm; of a prismatic joint, the force in N")
    speed: NumberField = Field(examples=[0.01], description="at which 3/4 of it are reached, in rad/s or m/s")


class FollowSection(Section):
    """A joint without a coordinate of its own: it goes with another one, as by a gear or a linkage."""

    joint: str = Field(examples=["q1"], description="the joint that it follows")
    ratio: NumberField = Field(ONE, examples=[-1.0], description="of its q to that of the other joint; constant")
    offset: NumberField = Field(ZERO, examples=[0.1], description="its q where that of the other is 0; constant")


class SettingSection(Section):
    """What an elementary joint may be given beside its axis."""

    name: str | None = Field(None, examples=["q1"], description="else the body's, or made of it and the axis")
    actuated: bool | None = Field(None, examples=[True], description="whether it takes an input u; else it is passive")
    limits: tuple[LimitField, LimitField] = Field((None, None), examples=[[-1.0, 1.0]], description="rad or m")
    max_speed: LimitField = Field(None, examples=[2.0], description="of qd either way, rad/s or m/s")
    max_force: LimitField = Field(None, examples=[50.0], description="of the input u either way, Nm or N")
    stiffness: NumberField = Field(ZERO, examples=[10.0], description="of a spring: -stiffness*(q - rest)")
    rest: NumberField = Field(ZERO, examples=[0.1], description="q where the spring is slack")
    damping: NumberField = Field(ZERO, examples=[0.1], description="of a damper: -damping*qd")
    friction: FrictionSection | None = Field(None, examples=[{"torque": 0.5, "speed": 0.01}])
    follows: FollowSection | None = Field(
        None, examples=[{"joint": "q1", "ratio": -1.0}], description="another joint; then it has no coordinate and no u"
    )
    armature: NumberField = Field(
        ZERO, examples=[0.02], description="of a rotor: its inertia times the gear ratio squared, in kg m2 or kg"
    )
    force: NumberField = Field(
        ZERO, examples=["-2*q**3"], description="Nm or N, added to all else: an expression over parameters, q and qd"
    )


class ElementarySection(PlacementSection, SettingSection):
    """One degree of freedom, and where the frame that it moves stands on what carries it while q = 0."""

    type: Literal["revolute", "prismatic"] = Field(examples=["revolute"])
    axis: DirectionField = Field(examples=["z"])


class FixedSection(PlacementSection):
    """What holds a body fast on its parent."""

    type: Literal["fixed"] = Field(examples=["fixed"])


class CompoundSection(PlacementSection):
    """A usual sequence of joints, each in the frame that those before it moved."""

    actuated: bool | None = Field(None, examples=[True], description="whether its joints take inputs u")
    axes: dict[str, Annotated[SettingSection, Field(examples=[{}])]] = Field(
        {},
        examples=[{}],
        description="settings of its elementary joints: x slides along x, rx turns about it",
        json_schema_extra={"propertyNames": {"enum": ["x", "y", "z", "rx", "ry", "rz"]}},
    )


class CardanSection(CompoundSection):
    """Two revolute joints with axes that meet."""

    type: Literal["cardan", "universal"] = Field(examples=["cardan"])
    order: Literal["xy", "xz", "yx", "yz", "zx", "zy"] = Field("xy", examples=["xy"])


class SphericalSection(CompoundSection):
    """Three revolute joints with axes that meet; they lock where the second is at a quarter turn."""

    type: Literal["spherical"] = Field(examples=["spherical"])
    order: Literal["xyz", "xzy", "yxz", "yzx", "zxy", "zyx"] = Field("zyx", examples=["zyx"])


class PlanarSection(CompoundSection):
    """Two slides along the axes of a plane, then a turn about its normal; passive unless told otherwise."""

    type: Literal["planar"] = Field(examples=["planar"])
    plane: Literal["xy", "xz", "yz"] = Field("xy", examples=["xy"])


class FloatingSection(CompoundSection):
    """Three prismatic joints along x, y, z, then a spherical joint: a free body, passive unless told otherwise."""

    type: Literal["floating"] = Field(examples=["floating"])
    order: Literal["xyz", "xzy", "yxz", "yzx", "zxy", "zyx"] = Field("zyx", examples=["zyx"])


class LooseSection(PlacementSection):
    """What turns in any direction, by a quaternion."""

    actuated: bool | None = Field(None, examples=[True], description="whether it takes inputs u, along the body's axes")


class BallSection(LooseSection):
    """A joint that turns in any direction: a unit quaternion, and the angular velocity along the body's axes."""

    type: Literal["ball"] = Field(examples=["ball"])


class FreeSection(LooseSection):
    """A body that moves freely: its place, a unit quaternion, and velocities along its axes; passive by default."""

    type: Literal["free"] = Field(examples=["free"])


_JOINT = {"type": "revolute", "axis": "z"}
NamedSection = CardanSection | SphericalSection | PlanarSection | FloatingSection
JointSection = ElementarySection | FixedSection | NamedSection | BallSection | FreeSection
OneJointField = Annotated[JointSection, Field(discriminator="type")]
SequenceField = Annotated[
    tuple[Annotated[ElementarySection, Field(examples=[_JOINT])], ...],
    Field(min_length=2, examples=[[{"type": "revolute", "axis": "x"}, {"type": "revolute", "axis": "y"}]]),
]
JointField = Annotated[
    Annotated[OneJointField, Tag("other")] | Annotated[SequenceField, Tag("list")], Discriminator(_tell_lists)
]


class TensorSection(Section):
    """A full inertia tensor; products of inertia are the off-diagonal entries themselves, sign included."""

    xx: NumberField = Field(examples=[1.0])
    yy: NumberField = Field(examples=[1.0])
    zz: NumberField = Field(examples=[1.0])
    xy: NumberField = Field(ZERO, examples=[0.0])
    xz: NumberField = Field(ZERO, examples=[0.0])
    yz: NumberField = Field(ZERO, examples=[0.0])


class BodySection(Section):
    """A rigid body, and what carries it; without mass and inertia it only links joints."""

    name: str = Field(examples=["upperarm"])
    parent: str = Field(BASE, examples=[BASE], description="the body that carries it, or base")
    joint: JointField = Field(examples=[_JOINT], description="what carries it: a joint, or a list of them")
    mass: NumberField = Field(ZERO, examples=[1.0], description="kg")
    com: TripleField = Field(ORIGIN, examples=[[0.1, 0.0, 0.0]], description="centre of mass in the body's frame, m")
    inertia: Annotated[
        Annotated[TripleField, Tag("other")] | Annotated[TensorSection, Tag("mapping")], Discriminator(_tell_mappings)
    ] = Field(ORIGIN, examples=[[0.1, 0.1, 0.1]], description="about the centre of mass, in the body's axes, kg m2")


class FrameSection(PlacementSection):
    """A named frame on a body, of which the pose is wanted: a sensor."""

    name: str = Field(examples=["hand"])
    body: str = Field(examples=[BASE])


WrenchField = Annotated[
    Annotated[Literal["input"], Tag("input")] | Annotated[TripleField, Tag("other")], Discriminator(_tell_inputs)
]


class WrenchSection(Section):
    """An external force and moment on a body: numbers, or inputs of the code."""

    name: str = Field(examples=["wind"])
    body: str = Field(examples=["upperarm"])
    position: TripleField = Field(ORIGIN, examples=[[0.1, 0.0, 0.0]], description="its point, in the body's frame, m")
    frame: Literal["base", "body"] = Field("base", examples=["base"], description="whose axes its components are along")
    force: WrenchField = Field(ORIGIN, examples=[[0.0, 0.0, 1.0]], description="three numbers in N, or input")
    moment: WrenchField = Field(ORIGIN, examples=[[0.0, 0.0, 1.0]], description="three numbers in Nm, or input")


ParameterField = Annotated[
    Annotated[NumberField, Tag("other")] | Annotated[ParameterSection, Tag("mapping")], Discriminator(_tell_mappings)
]


EXAMPLE = {"name": "rod", "joint": {"type": "revolute", "axis": "z"}, "mass": 1.0, "com": [0.5, 0.0, 0.0]}


class ModelSection(Section):
    """A model file."""

    name: str = Field(examples=["arm"])
    gravity: TripleField = Field(examples=[[0.0, 0.0, -9.81]], description="in the base's frame, m/s2")
    parameters: dict[str, Annotated[ParameterField, Field(examples=[1.0])]] = Field({}, examples=[{"l1": 0.3}])
    bodies: tuple[Annotated[BodySection, Field(examples=[EXAMPLE])], ...] = Field(examples=[[EXAMPLE]])
    frames: tuple[FrameSection, ...] = Field((), examples=[[]], description="sensors")
    wrenches: tuple[WrenchSection, ...] = Field((), examples=[[]])
    allow_unphysical: bool = Field(False, examples=[False], description="take inertias that no body has")


# --- for editors -----------------------------------------------------------------------------------------------------


class _JsonSchema(GenerateJsonSchema):
    """A JSON Schema whose defaults are as a file has them."""

    def encode_default(self, dft: Any) -> Any:
        if isinstance(dft, Number):
            return dft.value
        return [*map(self.encode_default, dft)] if isinstance(dft, tuple) else super().encode_default(dft)


def write_schema() -> str:
    """Write the JSON Schema of model files: it helps an editor to complete and to check them."""
    described = ModelSection.model_json_schema(schema_generator=_JsonSchema)
    head = {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": "mbsgen model"}
    return json.dumps(head | {k: v for k, v in described.items() if k not in head}, indent=2) + "\n"


if __name__ == "__main__":
    print(write_schema(), end="")
