"""Values of Python as plain data, as a YAML file holds them: numbers, texts, lists and mappings."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np

from mbsgen.documents import Data, Place, write_path
from mbsrun.binding import MASKED
from mbsrun.ocp.statement.checks import Line, ProblemError
from mbsrun.reading import overlay


def make_plain(name: str, values: Mapping[str, Any]) -> dict[str, Data]:
    """Turn the values of keys into plain data. Raises ProblemError with every value that a file could not hold.

    Arrays and tuples become lists. In a range, an infinite bound becomes no bound.
    """
    findings: list[Line] = []
    data = {key: _convert(value, (key,), findings) for key, value in values.items()}
    if findings:
        raise ProblemError(name, findings)
    return data


def merge(data: Mapping[str, Data], changes: Mapping[str, Data]) -> dict[str, Data]:
    """Return data with changes: mappings are merged, lists and numbers replaced; null drops a key of the top."""
    merged = dict(data)
    for key, change in changes.items():
        if change is None:
            merged.pop(key, None)
        else:
            merged[key] = overlay(merged.get(key), change)
    return merged


def _convert(value: Any, place: Place, findings: list[Line]) -> Data:
    match value:
        case Enum():
            return _convert(value.value, place, findings)
        case np.ma.MaskedArray() if np.ma.is_masked(value):
            findings.append((write_path(place), MASKED, "fill them, or leave them out"))
            return None
        case np.generic() | np.ndarray():
            return _convert(value.tolist(), place, findings)
        case None | bool() | int() | float() | str():
            return value
        case Path():
            return str(value)
        case Mapping():
            for key in value:
                if not isinstance(key, str):
                    findings.append((write_path(place), f"a key is {key!r}", "give names as keys"))
            return {str(key): _convert(x, (*place, str(key)), findings) for key, x in value.items()}
        case Sequence():
            items = [_convert(x, (*place, i), findings) for i, x in enumerate(value)]
            return _drop_infinite(items)
    kind = type(value).__name__
    findings.append((write_path(place), f"found a value of type {kind}", "give numbers, texts, lists or mappings"))
    return None


def _drop_infinite(items: list[Data]) -> list[Data]:
    """Write the infinite bounds of a range as a file does: null."""
    if len(items) != 2:
        return items
    lower, upper = items
    return [None if lower == -math.inf else lower, None if upper == math.inf else upper]
