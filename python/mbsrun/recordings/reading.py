"""Files of recordings by their suffix, and the columns in them that belong to a model."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from mbsgen.documents import abbreviate, nearest
from mbsgen.errors import Fault, InputError
from mbsrun.recordings.c3d import read_c3d
from mbsrun.recordings.markers import read_markers
from mbsrun.recordings.recording import Array, Recording
from mbsrun.recordings.storage import read_storage
from mbsrun.recordings.tables import read_table

READERS: Mapping[str, Callable[[Path], Recording]] = {
    ".csv": read_table,
    ".trc": read_markers,
    ".mot": read_storage,
    ".sto": read_storage,
    ".c3d": read_c3d,
}


def read_recording(path: Path) -> Recording:
    """Read a recording. Raises InputError with every fault of its file."""
    reader = READERS.get(path.suffix.lower())
    if reader is None:
        finding = f"found {abbreviate(path.suffix) if path.suffix else 'nothing'} at the end of its name"
        raise InputError([Fault(str(path), 0, "", finding, f"give a file that ends in {', '.join(READERS)}")])
    return reader(path)


def spell(name: str) -> str:
    """Write the name of a column as an identifier: `q[knee]` is q_knee."""
    return re.sub(r"\W+", "_", name).strip("_")


def find_column(recording: Recording, names: tuple[str, ...]) -> str | None:
    """Return the first of some names that a column has."""
    return next((name for name in names if name in recording.names), None)


def name_coordinate(name: str) -> tuple[str, ...]:
    """List the names that the column of a coordinate may have."""
    return (f"q[{name}]", name, f"/jointset/{name}/{name}/value")


def refuse_column(recording: Recording, name: str, remedy: str | None = None) -> InputError:
    """Return the error of a column that is not there."""
    meant = nearest(name, recording.names)
    known = ", ".join(recording.names[:8]) + (", ..." if len(recording.names) > 8 else "")
    help_with = remedy or (f"did you mean {abbreviate(meant)}?" if meant else f"there are {known}")
    return InputError([Fault(recording.file, 0, "", f"no column is named {abbreviate(name)}", help_with)])


def read_column(recording: Recording, name: str, unit: str) -> Array:
    """Return a column, (K,), in the SI unit of its use.

    Raises InputError where it is missing, has another unit, or is an angle whose file leaves open whether it is in
    degrees.
    """
    if name not in recording.names:
        raise refuse_column(recording, name)
    column = recording.columns[recording.names.index(name)]
    values = recording.column(name)
    path = f"column {abbreviate(name)}"
    if column.unit:
        if unit and column.unit != unit:
            finding = f"it is in {abbreviate(column.unit)}, and what it is read for is in {unit}"
            raise InputError([Fault(recording.file, 0, path, finding, "name another column, or convert it")])
        return values
    if unit.startswith("rad"):
        if recording.in_degrees is None:
            finding = "the header leaves open whether angles are in degrees"
            raise InputError([Fault(recording.file, 0, path, finding, "write inDegrees=yes or inDegrees=no into it")])
        if recording.in_degrees:
            return np.asarray(np.radians(values))
    return values
