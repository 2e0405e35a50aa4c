"""The points of charts: the cost and the error of a kernel, a simulation or a solve; and their tables."""

from __future__ import annotations

import csv
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from _typeshed import DataclassInstance


@dataclass(frozen=True)
class Cost:
    """The time of several rounds."""

    shortest: float
    median: float
    spread: float  # distance of the quartiles of the rounds, by the median: the unrest of the machine
    rounds: int


@dataclass(frozen=True)
class KernelPoint:
    """A way to compute a function, its time and its error."""

    mechanism: str
    joints: int
    task: str  # the function; ways of one task are comparable
    way: str  # kernel or method
    precision: str
    flags: str  # of the compiler, where they vary
    ns: Cost | None  # of a call [ns]; None: it failed in all states
    error: float | None  # the largest of all states: of a result, by its largest entry
    error_median: float | None
    backward: float | None  # the largest over all states: residual by the sum of the absolute values of its terms
    states: int  # that were tried
    failed: int  # states with a status other than 0
    finding: str = ""  # the reason where numbers are missing


@dataclass(frozen=True)
class MotionPoint:
    """A way to integrate a motion, its time and its error."""

    mechanism: str
    method: str
    formulation: str
    setting: str  # step, or tolerance
    value: float  # of it
    seconds: Cost | None  # of processor time; None: the end was not reached
    error: float | None  # the largest difference from the reference at the end [rad, m; rad/s, m/s]
    drift: float | None  # of energy, the largest, by the energy that is exchanged
    evaluations: int
    finding: str = ""  # why the end was not reached


@dataclass(frozen=True)
class SolvePoint:
    """A way to put a problem on a grid, the time of the solve and its error."""

    mechanism: str
    representation: str
    family: str  # of collocation points
    degree: int
    intervals: int
    seconds: Cost | None  # of processor time; None: not solved
    defect: float | None  # the largest error of an interval, by re-simulation [rad, m; rad/s, m/s]
    cost: float | None  # at the optimum
    iterations: int
    finding: str = ""  # why there is no solution


def write_points(points: Sequence[DataclassInstance], folder: Path, name: str) -> tuple[Path, Path]:
    """Write points as NAME.csv, a column for each number, and as NAME.json."""
    flat = [_flatten(point) for point in points]
    table, whole = folder / f"{name}.csv", folder / f"{name}.json"
    with table.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, list(flat[0]) if flat else [])
        writer.writeheader()
        writer.writerows(flat)
    whole.write_text(json.dumps([asdict(point) for point in points], indent=1) + "\n", encoding="utf-8")
    return table, whole


def _flatten(point: DataclassInstance) -> dict[str, object]:
    row: dict[str, object] = {}
    for field in fields(point):
        value = getattr(point, field.name)
        if field.name in ("ns", "ns_whole", "seconds"):
            row |= {f"{field.name}_{x.name}": None if value is None else getattr(value, x.name) for x in fields(Cost)}
        else:
            row[field.name] = value
    return row
