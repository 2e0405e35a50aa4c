"""A file that keeps measured points, so that an interrupted measurement continues.

A store is a text file with a line of JSON for each bundle of points. Points that are measured together, such as
functions that are timed in turn, are a bundle. The key of a bundle is a hash of everything that it depends on: model,
settings, compiler, version. A killed process may leave an unfinished line; a store ignores it.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, fields, is_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Generic, TypeVar

import numpy as np
from pydantic import TypeAdapter, ValidationError

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

Point = TypeVar("Point", bound="DataclassInstance")


class Store(Generic[Point]):
    """Bundles of points of one type in a file."""

    def __init__(self, path: Path, kind: type[Point], *, is_renewed: bool = False) -> None:
        """Open a file, which need not exist yet; with `is_renewed`, ignore its bundles and measure them again."""
        self._path = path
        self._reader: TypeAdapter[list[Point]] = TypeAdapter(list[kind])  # type: ignore[valid-type]
        self._bundles: dict[str, list[Point]] = {} if is_renewed else self._read()

    def find_or_measure(self, facts: Sequence[object], measure: Callable[[], Sequence[Point]]) -> list[Point]:
        """Return the points of the bundle that depends on `facts`; measure and keep a bundle that is missing."""
        key = hashlib.sha256(_spell(tuple(facts)).encode()).hexdigest()[:40]
        if key not in self._bundles:
            points = list(measure())
            self._path.parent.mkdir(parents=True, exist_ok=True)
            line = json.dumps({"key": key, "points": [asdict(point) for point in points]})
            with self._path.open("a", encoding="utf-8") as file:
                file.write(line + "\n")
                file.flush()
                os.fsync(file.fileno())
            self._bundles[key] = points
        return self._bundles[key]

    def _read(self) -> dict[str, list[Point]]:
        bundles: dict[str, list[Point]] = {}
        if self._path.exists():
            text = self._path.read_text(encoding="utf-8")
            if text and not text.endswith("\n"):  # the next bundle must begin a line
                self._path.write_text(text + "\n", encoding="utf-8")
            for line in text.splitlines():
                try:
                    entry = json.loads(line)
                    bundles[str(entry["key"])] = self._reader.validate_python(entry["points"])
                except (ValueError, TypeError, KeyError, ValidationError):
                    continue
        return bundles


def _spell(fact: object) -> str:
    """Write a fact in full; the text of an object for readers may leave parts out."""
    if is_dataclass(fact) and not isinstance(fact, type):
        parts = (f"{part.name}={_spell(getattr(fact, part.name))}" for part in fields(fact))
        return f"{type(fact).__name__}({', '.join(parts)})"
    if isinstance(fact, tuple | list):
        return f"({', '.join(map(_spell, fact))})"
    if isinstance(fact, Mapping):
        return f"{{{', '.join(f'{_spell(key)}: {_spell(value)}' for key, value in fact.items())}}}"
    return f"{fact.dtype}{fact.shape}{fact.tolist()}" if isinstance(fact, np.ndarray) else repr(fact)
