"""The schema of problem files with phases: the keys of links, and of phases."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Discriminator, Field, Tag

from mbsgen.documents import Section, WrongValueError, abbreviate
from mbsgen.expressions import Number
from mbsrun.ocp.statement.sections import FormulaField, NumberField, ProblemSection, RangeField, TermSection, check_axes

MAX_PHASES = 100


def _check_count(values: tuple[Any, ...]) -> tuple[Any, ...]:
    if len(values) > MAX_PHASES:
        raise WrongValueError(f"found {len(values)}", f"give at most {MAX_PHASES}")
    return values


def _check_path(path: str) -> str:
    if not path.endswith((".yaml", ".yml")):
        raise WrongValueError(f"found {abbreviate(path)}", "give a model file (.yaml), from this file's folder")
    return path


def _form(value: Any) -> str:
    """Return the form of a contact."""
    return "mapping" if isinstance(value, dict) else "name"


MapField = dict[str, FormulaField | None]


class ContactSection(Section):
    """A contact of an impact."""

    sensor: str = Field(examples=["foot"])
    wrench: str | None = Field(default=None, examples=["foot"])  # by default of the sensor's name
    axes: Annotated[str, AfterValidator(check_axes)] | None = Field(default=None, examples=["xz"])
    normal: Literal["x", "y", "z"] | None = Field(default="z", examples=["z"])
    friction: NumberField | None = Field(default=None, examples=[0.8])


ContactField = Annotated[Annotated[str, Tag("name")] | Annotated[ContactSection, Tag("mapping")], Discriminator(_form)]


class ImpactSection(Section):
    """An impact."""

    contacts: Annotated[tuple[ContactField, ...], AfterValidator(_check_count)] = Field(examples=[["foot"]])
    restitution: NumberField = Field(default=Number(0.0), examples=[0.0])
    model: Annotated[str, AfterValidator(_check_path)] | None = Field(default=None, examples=["model.yaml"])
    map: MapField = Field(default={}, examples=[{}])


class ConditionSection(Section):
    """A condition on both sides of a link."""

    expression: FormulaField
    range: RangeField = Field(examples=[[0.0, 0.0]])


class LinkSection(Section):
    """A link; in a problem of one phase, from its end to its start."""

    source: str | None = Field(default=None, alias="from", examples=["stance"])
    target: str | None = Field(default=None, alias="to", examples=["flight"])
    map: MapField = Field(default={}, examples=[{}])
    velocities: MapField = Field(default={}, examples=[{}])
    impact: ImpactSection | None = Field(default=None, examples=[{"contacts": ["foot"]}])
    hits: dict[str, str] = Field(default={}, examples=[{"foot": "stick"}])  # of stops and contacts that rebound
    conditions: Annotated[tuple[ConditionSection, ...], AfterValidator(_check_count)] = Field(default=(), examples=[[]])
    cost: Annotated[tuple[TermSection, ...], AfterValidator(_check_count)] = Field(default=(), examples=[[]])


class PhaseSection(ProblemSection):
    """A phase: a problem with a name."""

    name: str = Field(examples=["stance"])


def _check_phases(phases: tuple[dict[str, Any], ...]) -> tuple[dict[str, Any], ...]:
    if not phases:
        raise WrongValueError("found an empty list", "give at least one phase, or leave this out")
    return _check_count(phases)


class WholeSection(Section):
    """The parts of a file that belong to no single phase."""

    phases: Annotated[tuple[dict[str, Any], ...], AfterValidator(_check_phases)] = Field(
        default=({},), examples=[[{"name": "stance"}]]
    )
    links: Annotated[tuple[LinkSection, ...], AfterValidator(_check_count)] = Field(default=(), examples=[[]])
    constants: dict[str, NumberField] = Field(default={}, examples=[{}])
