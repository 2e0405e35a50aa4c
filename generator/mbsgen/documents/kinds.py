"""The kind of a file, recognised by its keys: an error names the kind that was given and the kind that was expected."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Literal

from mbsgen.documents.places import refuse
from mbsgen.documents.reading import Document

FileKind = Literal["model", "problem", "trial", "settings", "scene"]

_KEYS: Mapping[FileKind, frozenset[str]] = MappingProxyType(  # keys that no kind above has
    {
        "model": frozenset({"bodies"}),
        "problem": frozenset({"horizon", "intervals", "phases"}),
        "trial": frozenset({"rate"}),
        "settings": frozenset({"duration"}),
        "scene": frozenset({"functions", "locked", "together", "derivatives", "sensors"}),
    }
)
_MEANT: Mapping[FileKind, str] = MappingProxyType(
    {
        "model": "`mbsgen FILE -o DIR` generates from it, `mbsrun simulate FILE` simulates it",
        "problem": "`mbsrun solve FILE` solves it, and its key `model` names its model",
        "trial": "`mbsrun track PROBLEM --settings FILE` runs it",
        "settings": "`mbsrun simulate MODEL --settings FILE` simulates with them",
        "scene": "`mbsgen MODEL --scene FILE -o DIR` generates the functions that it lists",
    }
)
_SHOWN: Mapping[FileKind, str] = MappingProxyType(
    {
        "model": "a model",
        "problem": "a problem",
        "trial": "a trial",
        "settings": "settings of a simulation",
        "scene": "a scene",
    }
)


def expect(document: Document, kind: FileKind) -> None:
    """Refuse a document that is plainly of another kind. Raises InputError."""
    keys = frozenset(document.data) if isinstance(document.data, dict) else frozenset()
    is_trial = kind == "settings" and bool(keys & _KEYS["trial"])  # a trial has a duration too
    if keys & _KEYS[kind] and not is_trial:
        return
    for other, known in _KEYS.items():
        if other != kind and keys & known:
            finding = f"this file describes {_SHOWN[other]}; expected: {_SHOWN[kind]}"
            raise refuse([document.fault((), finding, _MEANT[other])])
