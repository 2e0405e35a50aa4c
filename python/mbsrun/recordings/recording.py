"""A recording: named columns of numbers over time, in SI units; a gap is NaN."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

AXES = ("x", "y", "z")

# Each unit that files write: the SI unit, and its factor.
UNITS: Mapping[str, tuple[str, float]] = {
    "s": ("s", 1.0),
    "ms": ("s", 1e-3),
    "m": ("m", 1.0),
    "cm": ("m", 1e-2),
    "mm": ("m", 1e-3),
    "rad": ("rad", 1.0),
    "deg": ("rad", np.pi / 180),
    "°": ("rad", np.pi / 180),
    "m/s": ("m/s", 1.0),
    "mm/s": ("m/s", 1e-3),
    "rad/s": ("rad/s", 1.0),
    "deg/s": ("rad/s", np.pi / 180),
    "m/s^2": ("m/s^2", 1.0),
    "rad/s^2": ("rad/s^2", 1.0),
    "deg/s^2": ("rad/s^2", np.pi / 180),
    "N": ("N", 1.0),
    "kN": ("N", 1e3),
    "N m": ("N m", 1.0),
    "N mm": ("N m", 1e-3),
}


@dataclass(frozen=True)
class Column:
    """A column of a recording."""

    name: str
    unit: str = ""  # empty: the file states none


@dataclass(frozen=True, eq=False, repr=False)
class Recording:
    """K samples of C columns; times increase."""

    file: str
    times: Array  # (K,) [s]
    columns: tuple[Column, ...]
    values: Array  # (K, C); NaN in gaps
    in_degrees: bool | None = False  # of angles among columns without a unit; None: the file leaves it open

    def __repr__(self) -> str:
        """Return the file, the times and the number of columns."""
        times = (
            f"{len(self.times)} times from {self.times[0]:g} to {self.times[-1]:g} s" if len(self.times) else "empty"
        )
        return f"Recording({self.file}: {times}, {len(self.columns)} columns)"

    @property
    def names(self) -> tuple[str, ...]:
        """List the names of the columns."""
        return tuple(column.name for column in self.columns)

    @property
    def markers(self) -> tuple[str, ...]:
        """List the points of which there are all three coordinates."""
        known = set(self.names)
        found = (name[2:-1] for name in self.names if name.startswith("x[") and name.endswith("]"))
        return tuple(name for name in found if all(f"{axis}[{name}]" in known for axis in AXES))

    def column(self, name: str) -> Array:
        """Return a column, (K,), as the file has it, in SI units."""
        return self.values[:, self.names.index(name)]

    def cut(self, start: float, end: float) -> Recording:
        """Keep the samples from one time to another."""
        kept = (self.times >= start) & (self.times <= end)
        return Recording(self.file, self.times[kept], self.columns, self.values[kept], self.in_degrees)
