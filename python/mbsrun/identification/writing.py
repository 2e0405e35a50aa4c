"""The files of an identification: numbers as JSON, and a model file with the identified numbers and remarks."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mbsrun.identification.result import Base, Identification
from mbsrun.identification.settings import ARMATURE, DAMPING, FRICTION, INERTIA, STRIBECK
from mbsrun.identification.unknowns import FALLS
from mbsrun.models import change_numbers

FORMAT = "mbsrun identification 1"
CHANGED = 1e-12  # of a number: less is rounding
DIGITS = 6


def write_model(found: Identification, model: Path) -> str:
    """Return a model file with the identified numbers; remarks give their uncertainty.

    Offsets of sensors and constants of motors are remarks alone, since a model has no place for them. Raises InputError
    where bodies that nobody can build were admitted, and the model's checks refuse them.
    """
    return change_numbers(model, [*_remark(found)], **_list_changes(found))


def _list_changes(found: Identification) -> dict[str, Mapping[str, Any]]:
    values = {x.name: float(v) for x, v in zip(found.unknowns, found.values, strict=True)}
    moments: dict[str, list[float]] = {}
    changed: set[str] = set()
    for x, value in zip(found.unknowns, found.values.tolist(), strict=True):
        if x.kind == INERTIA:
            moments.setdefault(x.owner, [0.0] * 10)[x.moment] = value
            if abs(value - x.value) > CHANGED * (1 + abs(x.value)):
                changed.add(x.owner)
    own = {kind: {x.owner: values[x.name] for x in found.unknowns if x.kind == kind} for kind in (DAMPING, ARMATURE)}
    return {
        "moments": {name: numbers for name, numbers in moments.items() if name in changed},
        "damping": own[DAMPING],
        "armature": own[ARMATURE],
        "friction": {
            x.owner: (values[x.name], found.speeds[x.owner])
            for x in found.unknowns
            if x.kind == FRICTION and (values[x.name] or x.value)
        },
        "force": {
            x.owner: f"-({values[x.name]!r})*exp(-(qd/{values[f'{FALLS}[{x.owner}]']!r})**2)"
            f"*tanh(qd/{found.speeds[x.owner]!r})"
            for x in found.unknowns
            if x.kind == STRIBECK
        },
        "parameters": found.parameters,
    }


def _remark(found: Identification) -> Iterator[str]:
    """List the base parameters and the open numbers, a line each."""
    yield f"Identified from {', '.join(_show(trace.name) for trace in found.traces)}."
    yield "The recordings determine these sums, with standard deviations. S and J are about the body's origin."
    for x in found.base:
        if x.is_determined:
            yield f"  {_show(x.name)} = {x.value:.{DIGITS}g} ± {x.deviation:.2g} {x.unit}".rstrip()
    if found.undetermined:
        yield "The recordings do not determine, and the model's numbers stay:"
        yield from (f"  {_show(name)}" for name in found.undetermined)
    yield "The other numbers of bodies are the nearest to the model's that have these sums."
    if found.is_moved:
        yield f"Bodies that can be built are {found.distance:.2g} standard deviations away from the estimate."


def _show(text: str) -> str:
    """Return a name from a file on one line."""
    shown = Path(text).name if "/" in text and Path(text).suffix else text
    return shown if shown.isprintable() else shown.encode("unicode_escape").decode("ascii")


def summarise(found: Identification) -> dict[str, object]:
    """Return everything but the residuals as plain data; numbers that are not known are null."""
    return {
        "format": FORMAT,
        "model": found.model,
        "recordings": [{"file": x.name, "times": len(x.t), "left_out": x.left_out} for x in found.traces],
        "base": [_describe(found, b) for b in range(len(found.base))],
        "correlations": _list_plain(found.correlations),
        "no_motion_determines": list(found.unfelt),
        "recordings_do_not_determine": list(found.undetermined),
        "numbers": {
            x.name: {"value": float(v), "before": x.value, "unit": x.unit}
            for x, v in zip(found.unknowns, found.values, strict=True)
        },
        "torques": [
            {
                "joint": x.joint,
                "unit": x.unit,
                "root_mean_square": x.size,
                "residual_before": x.before,
                "residual": x.deviation,
                "residual_of_left_out_parts": _plain(x.left_out),
                "correlation_in_time": x.correlation,
            }
            for x in found.torques
        ],
        "cross_validation": {
            group: {x.joint: _plain(v) for x, v in zip(found.torques, row.tolist(), strict=True)}
            for group, row in zip(found.groups, found.validation, strict=True)
        },
        "condition": found.condition,
        "degrees_of_freedom": found.freedom,
        "bodies_moved": found.is_moved,
        "distance_of_bodies": found.distance,
    }


def _describe(found: Identification, b: int) -> dict[str, object]:
    x: Base = found.base[b]
    terms = {own.name: float(c) for own, c in zip(found.unknowns, found.G[b], strict=True) if c}
    return {
        "name": x.name,
        "terms": terms,
        "unit": x.unit,
        "value": x.value,
        "before": x.before,
        "deviation": _plain(x.deviation),
        "interval": None if not x.is_determined else [x.low, x.high],
    }


def _plain(x: float) -> float | None:
    return None if np.isnan(x) else float(x)


def _list_plain(A: Any) -> list[list[float | None]]:
    rows: Sequence[Sequence[float]] = A.tolist()
    return [[_plain(x) for x in row] for row in rows]
