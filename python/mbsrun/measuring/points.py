"""What a chart is made of, and the file that keeps it while it is measured.

A store is a text file with a line of JSON for each bundle of points: points that are timed in turn, round by round,
are measured and kept together. A bundle is found again by a key that tells all that it depends on, so a study that was
stopped goes on with the bundle that it was stopped in; a line that a killed process left unfinished is passed over.
"""

from __future__ import annotations

import csv
import hashlib
import json
import os
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Generic, TypeVar

from pydantic import TypeAdapter, ValidationError

if TYPE_CHECKING:
    from _typeshed import DataclassInstance


@dataclass(frozen=True)
class Cost:
    """What something takes, of several rounds."""

    shortest: float
    median: float
    spread: float  # what lies between the quarters of the rounds, by the median: how restless the machine was
    rounds: int


@dataclass(frozen=True)
class KernelPoint:
    """A way to compute a function, with what it takes and what it errs by."""

    mechanism: str
    joints: int
    task: str  # what is computed: ways of one task are comparable
    way: str  # how
    precision: str
    flags: str  # of the compiler, as far as they vary
    ns: Cost | None  # of a call [ns]; None: it failed in all states
    error: float | None  # the largest of all states: of a result, by its largest entry
    error_median: float | None
    backward: float | None  # the largest of all states: of the equations of motion, by what they are a sum of
    states: int  # that were tried
    failed: int  # of them, with a status that is not 0
    finding: str = ""  # why there is nothing to tell


@dataclass(frozen=True)
class MotionPoint:
    """A way to integrate a motion, with what it takes and what it errs by."""

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
    """A way to put a problem on a grid, with what its solve takes and what it errs by."""

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


Point = TypeVar("Point", bound="DataclassInstance")


class Store(Generic[Point]):
    """Bundles of points in a file."""

    def __init__(self, path: Path, kind: type[Point]) -> None:
        """Open a file, which need not be there yet."""
        self._path = path
        self._reader: TypeAdapter[list[Point]] = TypeAdapter(list[kind])  # type: ignore[valid-type]
        self._bundles: dict[str, list[Point]] = self._read()

    def find_or_measure(self, told: Sequence[object], measure: Callable[[], list[Point]]) -> list[Point]:
        """Give the points of a bundle; those that are not there yet are measured, and kept at once."""
        key = hashlib.sha256(repr(tuple(told)).encode()).hexdigest()[:40]
        if key not in self._bundles:
            points = measure()
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
            if text and not text.endswith("\n"):  # so that the next line begins a line
                self._path.write_text(text + "\n", encoding="utf-8")
            for line in text.splitlines():
                try:
                    entry = json.loads(line)
                    bundles[str(entry["key"])] = self._reader.validate_python(entry["points"])
                except (ValueError, TypeError, KeyError, ValidationError):
                    continue
        return bundles


def write_table(points: Sequence[DataclassInstance], folder: Path, name: str) -> tuple[Path, Path]:
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
