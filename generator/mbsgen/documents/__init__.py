"""Untrusted YAML files: text -> `Document` (plain data with line numbers) -> a validated pydantic schema.

The language is YAML 1.2's core schema without anchors, aliases, tags, directives and merge keys: `1e3` is a number,
`on` and `12:30` are strings, `010` is ten. Every fault becomes a `Fault` with file, line, path, finding and remedy; all
faults of a file are raised together.
"""

from __future__ import annotations

from mbsgen.documents.kinds import expect
from mbsgen.documents.numbers import read_number
from mbsgen.documents.places import Data, Finding, Place, abbreviate, lies_under, nearest, refuse, write_path
from mbsgen.documents.reading import Document, read_bytes, read_document
from mbsgen.documents.validation import Examination, Read, Section, WrongValueError, examine, take, validate

__all__ = [
    "Data",
    "Document",
    "Examination",
    "Finding",
    "Place",
    "Read",
    "Section",
    "WrongValueError",
    "abbreviate",
    "examine",
    "expect",
    "lies_under",
    "nearest",
    "read_bytes",
    "read_document",
    "read_number",
    "refuse",
    "take",
    "validate",
    "write_path",
]
