"""JSON Schemas for editors: of problem files, of settings of simulations, and of trials.

They are generated from the schemas that the readers use, and check the shape of a file: keys, types and defaults. The
readers check its meaning. A problem with phases has the keys of a problem twice: as defaults, and in each phase; so
no key is required in either, and a mapping of a phase may have a part of its keys.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

from pydantic.json_schema import GenerateJsonSchema

from mbsgen.documents import Section
from mbsgen.expressions import Number
from mbsrun.ocp.statement.phase_sections import PhaseSection, WholeSection
from mbsrun.ocp.statement.phases import SHARED
from mbsrun.ocp.statement.sections import ProblemSection
from mbsrun.simulation.statement import SettingsSection
from mbsrun.tracking.statement import TrialSection

DRAFT = "https://json-schema.org/draft/2020-12/schema"
DEFINITIONS = "#/$defs/"
PART = "Part"  # behind the name of a definition: the same without required keys

Schema = dict[str, Any]


class _JsonSchema(GenerateJsonSchema):
    """A JSON Schema whose defaults are as a file has them."""

    def encode_default(self, dft: Any) -> Any:
        if isinstance(dft, Section):
            return {name: self.encode_default(getattr(dft, name)) for name in dft.model_fields_set}
        if isinstance(dft, Number):
            return dft.value
        return [*map(self.encode_default, dft)] if isinstance(dft, tuple) else super().encode_default(dft)


def _describe(section: type[Section]) -> Schema:
    """Return the schema of a section; where several forms fit a value, one of them is enough."""
    schema: Schema = _loosen(section.model_json_schema(schema_generator=_JsonSchema))
    return schema


def _loosen(schema: Any) -> Any:
    if isinstance(schema, list):
        return [*map(_loosen, schema)]
    if not isinstance(schema, dict):
        return schema
    return {"anyOf" if key == "oneOf" else key: _loosen(part) for key, part in schema.items()}


def describe_problem() -> Schema:
    """Return the schema of problem files: of one phase, of one phase with links, or of several."""
    one, whole, phase = _describe(ProblemSection), _describe(WholeSection), _describe(PhaseSection)
    definitions: Schema = {**one["$defs"], **whole["$defs"], **phase["$defs"]}
    links, constants = whole["properties"]["links"], whole["properties"]["constants"]
    parts = _Parts(definitions)
    own = {key: part for key, part in phase["properties"].items() if key not in SHARED}
    inner = {key: parts.relax(part) for key, part in own.items()}
    named = {"type": "object", "properties": inner, "required": ["name"], "additionalProperties": False}
    phases = {"type": "array", "items": named, "minItems": 1, "description": "Phases; each replaces defaults."}
    defaults = {key: parts.relax(part) for key, part in one["properties"].items()} | {"constants": constants}
    single = {**one["properties"], "links": links}
    several = {**defaults, "phases": phases, "links": links}
    # links give what a start leaves out, and a phase without a cost costs nothing
    linked = [key for key in one["required"] if key != "cost"]
    return {
        "description": "A problem file.",
        "type": "object",
        "if": {"required": ["phases"]},
        "then": {"properties": several, "required": ["phases"], "additionalProperties": False},
        "else": {
            "properties": single,
            "required": linked,
            "additionalProperties": False,
            "anyOf": [{"required": ["cost"]}, {"required": ["links"]}],
        },
        "$defs": definitions | parts.made,
    }


class _Parts:
    """Makes definitions of mappings without required keys."""

    def __init__(self, definitions: Schema) -> None:
        self.definitions = definitions
        self.made: Schema = {}

    def relax(self, schema: Schema) -> Schema:
        """Return a schema in which mappings require no keys; lists stay, as a phase replaces them whole."""
        if "$ref" in schema:
            name = schema["$ref"].removeprefix(DEFINITIONS)
            if "properties" not in self.definitions[name]:
                return schema
            if name + PART not in self.made:
                self.made[name + PART] = {}  # stands in while the definition reads itself
                self.made[name + PART] = self.relax(self.definitions[name])
            return {**schema, "$ref": DEFINITIONS + name + PART}
        changed = {key: part for key, part in schema.items() if key != "required"}
        for key in ("anyOf", "allOf"):
            if key in changed:
                changed[key] = [self.relax(part) for part in changed[key]]
        if "properties" in changed:
            changed["properties"] = {key: self.relax(part) for key, part in changed["properties"].items()}
        if isinstance(changed.get("additionalProperties"), dict):
            changed["additionalProperties"] = self.relax(changed["additionalProperties"])
        return changed


KINDS: Mapping[str, Callable[[], Schema]] = MappingProxyType(
    {
        "problem": describe_problem,
        "simulation": lambda: _describe(SettingsSection),
        "trial": lambda: _describe(TrialSection),
    }
)


def write_schema(kind: str) -> str:
    """Write a JSON Schema: it helps an editor to complete files of this kind, and to check them."""
    head = {"$schema": DRAFT, "title": f"mbsrun {kind}"}
    return json.dumps(head | {k: v for k, v in KINDS[kind]().items() if k not in head}, indent=2) + "\n"


if __name__ == "__main__":
    if sys.argv[1:] not in [[kind] for kind in KINDS]:
        sys.exit(f"usage: python -m mbsrun.schemas {'|'.join(KINDS)}")
    print(write_schema(sys.argv[1]), end="")
