"""The JSON Schema of settings of a scaling, which helps an editor to complete and to check them."""

from __future__ import annotations

import json
from typing import Any

from pydantic.json_schema import GenerateJsonSchema

from mbsgen.documents import Section
from mbsgen.subjects.reading import SubjectSection


class _JsonSchema(GenerateJsonSchema):
    """A JSON Schema whose defaults are as a file has them."""

    def encode_default(self, dft: Any) -> Any:
        return {} if isinstance(dft, Section) else super().encode_default(dft)


def write_schema() -> str:
    """Write the JSON Schema of settings."""
    described = SubjectSection.model_json_schema(schema_generator=_JsonSchema)
    head = {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": "mbsgen subject"}
    return json.dumps(head | {k: v for k, v in described.items() if k not in head}, indent=2) + "\n"


if __name__ == "__main__":
    print(write_schema(), end="")
