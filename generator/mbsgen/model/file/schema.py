"""The shape of a model file; `checks` checks its meaning.

Lengths are in m, angles in rad, masses in kg, inertias in kg m2. Every number may be an expression over the parameters,
such as `l1/2` or `-pi/2`. The examples show users what is right, and replace wrong values while the rest of a file is
examined.
"""

from __future__ import annotations

import json
from functools import cache
from typing import Annotated, Any, Literal, Union

from pydantic import Discriminator, Field, Tag, create_model
from pydantic.json_schema import GenerateJsonSchema

from mbsgen.documents import Section
from mbsgen.expressions import Number
from mbsgen.model import joints
from mbsgen.model.file.force_sections import ContactSection, ForceSection, StopSection
from mbsgen.model.file.loops import ConstraintSection, LoopEndSection, LoopSection
from mbsgen.model.file.visual_sections import VisualField
from mbsgen.model.joints.elementary import ElementarySection
from mbsgen.model.joints.section import JointSection
from mbsgen.model.model import BASE, ORIGIN, ZERO
from mbsgen.model.sections import NumberField, PlacementSection, TripleField
from mbsgen.model.tree import Kind


def _tell_mappings(value: Any) -> str:
    return "mapping" if isinstance(value, dict) else "other"


def _tell_inputs(value: Any) -> str:
    return "input" if isinstance(value, str) else "other"


def _tell_lists(value: Any) -> str:
    return "list" if isinstance(value, list) else "other"


class ParameterSection(Section):
    """A parameter with its kind: constants are folded into the code, others are inputs of it."""

    value: NumberField = Field(examples=[1.0])
    kind: Kind = Field(Kind.CONSTANT, examples=["constant"])


_JOINT = {"type": "revolute", "axis": "z"}
SequenceField = Annotated[
    tuple[Annotated[ElementarySection, Field(examples=[_JOINT])], ...],
    Field(min_length=2, examples=[[{"type": "revolute", "axis": "x"}, {"type": "revolute", "axis": "y"}]]),
]


class TensorSection(Section):
    """A full inertia tensor; products of inertia are the off-diagonal entries themselves, sign included."""

    xx: NumberField = Field(examples=[1.0])
    yy: NumberField = Field(examples=[1.0])
    zz: NumberField = Field(examples=[1.0])
    xy: NumberField = Field(ZERO, examples=[0.0])
    xz: NumberField = Field(ZERO, examples=[0.0])
    yz: NumberField = Field(ZERO, examples=[0.0])
    about: TripleField | None = Field(
        None, examples=[[0.0, 0.0, 0.0]], description="the point that it is about, in the body's frame, m; else com"
    )


class BodySection(Section):
    """A rigid body, and what carries it; without mass and inertia it only links joints."""

    name: str = Field(examples=["upperarm"])
    parent: str = Field(BASE, examples=[BASE], description="the body that carries it, or base")
    joint: JointSection | tuple[ElementarySection, ...]  # narrowed by `model_section`
    mass: NumberField = Field(ZERO, examples=[1.0], description="kg")
    com: TripleField = Field(ORIGIN, examples=[[0.1, 0.0, 0.0]], description="centre of mass in the body's frame, m")
    inertia: Annotated[
        Annotated[TripleField, Tag("other")] | Annotated[TensorSection, Tag("mapping")], Discriminator(_tell_mappings)
    ] = Field(
        ORIGIN,
        examples=[[0.1, 0.1, 0.1]],
        description="about com, or the point `about`; in the body's axes, kg m2",
    )
    visual: VisualField = Field(
        (), examples=[[{"shape": "sphere", "radius": 0.05}]], description="what pictures show of it: a shape, or a list"
    )


class FrameSection(PlacementSection):
    """A named frame on a body; its pose is an output."""

    name: str = Field(examples=["hand"])
    body: str = Field(examples=[BASE])
    sensor: bool = Field(True, examples=[True], description="false: no output, forces alone read it")


WrenchField = Annotated[
    Annotated[Literal["input"], Tag("input")] | Annotated[TripleField, Tag("other")], Discriminator(_tell_inputs)
]


class WrenchSection(PlacementSection):
    """An external force and moment on a body: numbers, expressions of the state, or inputs of the code."""

    name: str = Field(examples=["wind"])
    body: str = Field(examples=["upperarm"])
    frame: Literal["base", "body"] = Field("base", examples=["base"], description="whose axes its components are along")
    against: Annotated[
        LoopEndSection | None,
        Field(examples=[{"body": BASE}], description="a frame along whose axes it acts, with the opposite on its body"),
    ] = None
    about: Literal["axes", "turns"] = Field(
        "axes", examples=["axes"], description="its moment: the axes of `against`, or the turns x, y, z from there"
    )
    force: WrenchField = Field(
        ORIGIN, examples=[[0.0, 0.0, 1.0]], description="in N, over parameters and the state; or input"
    )
    moment: WrenchField = Field(
        ORIGIN, examples=[[0.0, 0.0, 1.0]], description="in Nm, over parameters and the state; or input"
    )


ParameterField = Annotated[
    Annotated[NumberField, Tag("other")] | Annotated[ParameterSection, Tag("mapping")], Discriminator(_tell_mappings)
]


EXAMPLE = {"name": "rod", "joint": {"type": "revolute", "axis": "z"}, "mass": 1.0, "com": [0.5, 0.0, 0.0]}


class ModelSection(Section):
    """A model file."""

    name: str = Field(examples=["arm"])
    gravity: TripleField = Field(examples=[[0.0, 0.0, -9.81]], description="in the base's frame, m/s2")
    parameters: dict[str, Annotated[ParameterField, Field(examples=[1.0])]] = Field({}, examples=[{"l1": 0.3}])
    bodies: tuple[BodySection, ...]  # narrowed by `model_section`
    frames: tuple[FrameSection, ...] = Field((), examples=[[]], description="sensors")
    wrenches: tuple[WrenchSection, ...] = Field((), examples=[[]])
    forces: tuple[ForceSection, ...] = Field((), examples=[[]], description="springs and cables between two frames")
    contacts: tuple[ContactSection, ...] = Field((), examples=[[]], description="compliant contacts")
    stops: tuple[StopSection, ...] = Field((), examples=[[]], description="at limits of numbers of the pose")
    signals: tuple[str, ...] = Field((), examples=[[]], description="numbers that forces read, as inputs of the code")
    loops: tuple[LoopSection, ...] = Field((), examples=[[]], description="joints that close loops of bodies")
    constraints: tuple[ConstraintSection, ...] = Field((), examples=[[]], description="equations of coordinates")
    driven: tuple[str, ...] = Field((), examples=[[]], description="joints whose motion is given; their force results")
    independent: tuple[str, ...] = Field(
        (), examples=[[]], description="joints whose coordinates determine all others; else they are chosen"
    )
    assembly: dict[str, NumberField] = Field(
        {}, examples=[{}], description="rough coordinates of joints near which the loops close, rad or m; else 0"
    )
    loop_tolerance: NumberField | None = Field(
        None,
        examples=[1e-4],
        description="within which equations of loops follow from others, rad or of a loop's size; else by the digits",
    )
    allow_unphysical: bool = Field(False, examples=[False], description="take inertias that no body has")


@cache
def _make_model_section(types: tuple[type[JointSection], ...]) -> type[ModelSection]:
    one = Annotated[Union[types], Field(discriminator="type")]  # type: ignore[valid-type]  # noqa: UP007
    either = Annotated[Annotated[one, Tag("other")] | Annotated[SequenceField, Tag("list")], Discriminator(_tell_lists)]
    joint = Field(examples=[_JOINT], description="what carries it: a joint, or a list of them")
    body: Any = create_model("BodySection", __base__=BodySection, __doc__=BodySection.__doc__, joint=(either, joint))
    bodies = tuple[Annotated[body, Field(examples=[EXAMPLE])], ...]
    listed: Any = (bodies, Field(examples=[[EXAMPLE]]))
    return create_model("ModelSection", __base__=ModelSection, __doc__=ModelSection.__doc__, bodies=listed)


def model_section() -> type[ModelSection]:
    """Return the schema of a model file, in which a joint is of one of JOINT_TYPES."""
    return _make_model_section(joints.JOINT_TYPES)


# --- for editors -----------------------------------------------------------------------------------------------------


class _JsonSchema(GenerateJsonSchema):
    """A JSON Schema whose defaults are as a file has them."""

    def encode_default(self, dft: Any) -> Any:
        if isinstance(dft, Number):
            return dft.value
        return [*map(self.encode_default, dft)] if isinstance(dft, tuple) else super().encode_default(dft)


def write_schema() -> str:
    """Write the JSON Schema of model files: it helps an editor to complete and to check them."""
    described = model_section().model_json_schema(schema_generator=_JsonSchema)
    head = {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": "mbsgen model"}
    return json.dumps(head | {k: v for k, v in described.items() if k not in head}, indent=2) + "\n"


if __name__ == "__main__":
    print(write_schema(), end="")
