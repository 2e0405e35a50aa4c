"""Visuals in a model file: sections -> shapes that draw a body, in its frame; nothing is computed with them.

The file of a mesh is named relative to the model's folder, and is read only where a picture is drawn. A model file is
not trusted, so a name that leads out of its folder is refused here, and links are checked again before reading.
"""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from pathlib import PurePosixPath
from typing import Annotated, Any, Literal, Union

from pydantic import Discriminator, Field, Tag

from mbsgen.documents import Read, WrongValueError, abbreviate
from mbsgen.expressions import Expression
from mbsgen.model.model import ONE, Visual
from mbsgen.model.sections import NumberField, PlacementSection, TripleField, Written, read_number

MESHES = (".stl", ".obj", ".glb", ".gltf", ".ply")  # suffixes of files that pictures can show
LONGEST = 300  # characters of a file's name
COLOR = re.compile(r"#[0-9a-fA-F]{6}")


def read_mesh_name(value: Any) -> str:
    """Read the name of a mesh file below the model's folder. Raises WrongValueError."""
    return read_file_name(value, "meshes/arm.stl", MESHES)


def read_file_name(value: Any, example: str, suffixes: tuple[str, ...]) -> str:
    """Read the name of a file below the model's folder, of one of these suffixes. Raises WrongValueError."""
    if not isinstance(value, str) or not value or len(value) > LONGEST or not value.isprintable():
        raise WrongValueError(f"found {abbreviate(value)}", f"give the name of a file, such as {example}")
    if find_escape(value):
        raise WrongValueError(f"{abbreviate(value)} leads out of the model's folder", "name a file below that folder")
    if PurePosixPath(value).suffix.lower() not in suffixes:
        kind = "mesh" if suffixes == MESHES else "file"
        raise WrongValueError(f"{abbreviate(value)} is no {kind} that is read", f"give {', '.join(suffixes)}")
    return value


def find_escape(name: str) -> bool:
    """Return whether the name of a file may lead out of the folder that it is relative to."""
    return "\\" in name or ":" in name or name.startswith(("/", "~")) or ".." in PurePosixPath(name).parts


def read_color(value: Any) -> str:
    """Read a colour. Raises WrongValueError."""
    if not isinstance(value, str) or not COLOR.fullmatch(value):
        raise WrongValueError(f"found {abbreviate(value)}", 'give red, green and blue in hex, such as "#0072b2"')
    return value.lower()


def read_scale(value: Any) -> tuple[Expression, ...]:
    """Read one factor, or three along the axes of the mesh. Raises WrongValueError."""
    if isinstance(value, list) and len(value) == 3:
        return tuple(map(read_number, value))
    if isinstance(value, list):
        raise WrongValueError(f"found {abbreviate(value)}", "give one number, or three")
    return (read_number(value),) * 3


MeshField = Annotated[str, Read(read_mesh_name, str)]
ColorField = Annotated[str, Read(read_color, str)]
ScaleField = Annotated[
    tuple[Expression, ...],
    Read(read_scale, Written | tuple[Written, Written, Written]),
]


class _VisualSection(PlacementSection, ABC):
    """A shape in the frame of its body: its centre, and its orientation."""

    color: ColorField | None = Field(None, examples=["#0072b2"], description="else one of the palette, by body")

    @property
    @abstractmethod
    def numbers(self) -> tuple[Expression, ...]:
        """The size of the shape, as the Model has it."""

    def make(self) -> Visual:
        """Make the part of a Model."""
        shape, file = getattr(self, "shape"), getattr(self, "file", "")  # noqa: B009 - fields of subclasses
        return Visual(shape, self.numbers, self.placement, self.color or "", file)


class BoxSection(_VisualSection):
    """A box."""

    shape: Literal["box"] = Field(examples=["box"])
    size: TripleField = Field(examples=[[0.3, 0.1, 0.1]], description="its edges, m")

    @property
    def numbers(self) -> tuple[Expression, ...]:
        """The edges."""
        return self.size


class EllipsoidSection(_VisualSection):
    """An ellipsoid."""

    shape: Literal["ellipsoid"] = Field(examples=["ellipsoid"])
    size: TripleField = Field(examples=[[0.3, 0.1, 0.1]], description="its three diameters, m")

    @property
    def numbers(self) -> tuple[Expression, ...]:
        """The diameters."""
        return self.size


class SphereSection(_VisualSection):
    """A sphere."""

    shape: Literal["sphere"] = Field(examples=["sphere"])
    radius: NumberField = Field(examples=[0.05], description="m")

    @property
    def numbers(self) -> tuple[Expression, ...]:
        """The radius."""
        return (self.radius,)


class CylinderSection(_VisualSection):
    """A cylinder along its z axis."""

    shape: Literal["cylinder"] = Field(examples=["cylinder"])
    radius: NumberField = Field(examples=[0.05], description="m")
    length: NumberField = Field(examples=[0.3], description="m")

    @property
    def numbers(self) -> tuple[Expression, ...]:
        """Radius and length."""
        return self.radius, self.length


class CapsuleSection(_VisualSection):
    """A cylinder along its z axis between two halves of a sphere."""

    shape: Literal["capsule"] = Field(examples=["capsule"])
    radius: NumberField = Field(examples=[0.05], description="m")
    length: NumberField = Field(examples=[0.3], description="of the cylinder, m")

    @property
    def numbers(self) -> tuple[Expression, ...]:
        """Radius and length."""
        return self.radius, self.length


class MeshSection(_VisualSection):
    """A mesh file, in the axes of its position and orientation."""

    shape: Literal["mesh"] = Field(examples=["mesh"])
    file: MeshField = Field(examples=["meshes/arm.stl"], description="below the model's folder")
    scale: ScaleField = Field(
        (ONE,) * 3, examples=[0.001], description="m for a unit of the file; one number, or three"
    )

    @property
    def numbers(self) -> tuple[Expression, ...]:
        """The scale along each axis."""
        return self.scale


VisualSection = BoxSection | EllipsoidSection | SphereSection | CylinderSection | CapsuleSection | MeshSection
_EXAMPLE = {"shape": "box", "size": [0.3, 0.1, 0.1]}
_One = Annotated[
    Union[BoxSection, EllipsoidSection, SphereSection, CylinderSection, CapsuleSection, MeshSection],  # noqa: UP007
    Field(discriminator="shape", examples=[_EXAMPLE]),
]


def _tell_lists(value: Any) -> str:
    return "list" if isinstance(value, list | tuple) else "other"


VisualField = Annotated[
    Annotated[_One, Tag("other")] | Annotated[tuple[_One, ...], Tag("list")], Discriminator(_tell_lists)
]


def make_visuals(given: VisualSection | tuple[VisualSection, ...]) -> tuple[Visual, ...]:
    """Make the visuals of a body."""
    return tuple(each.make() for each in (given if isinstance(given, tuple) else (given,)))
