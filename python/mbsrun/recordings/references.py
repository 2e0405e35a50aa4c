"""References: recorded quantities as functions of the time over a horizon, which expressions and costs read.

In seconds, the reference at the time t of a problem is the recording at start + t; with a normalised time axis it is
the recording at start + (end - start) t / T. The name ref_WALK_KNEE is the value of the column KNEE of the reference
WALK, and known_WALK_KNEE is 1 where the recording has one, 0 in its gaps and beyond its ends; there the value counts
as 0.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mbsrun.recordings.splines import Track

Array = NDArray[np.float64]

VALUE, KNOWN = "ref", "known"  # how names begin


@dataclass(frozen=True)
class Reference:
    """Some columns of a recording."""

    name: str
    columns: tuple[tuple[str, Track], ...]  # by the names of expressions
    start: float  # of the recording, at the start of the horizon [s]
    end: float  # of the recording, at the end of the horizon, where time is normalised [s]
    is_normalised: bool = False

    def place(self, s: Array, horizon: float | None) -> Array:
        """Return the times of the recording at parts s of the horizon, 0 to 1."""
        if self.is_normalised:
            return self.start + s * (self.end - self.start)
        if horizon is None:
            raise ValueError(f"reference {self.name} is in seconds, and the horizon is free")
        return self.start + s * horizon


def name_value(reference: str, column: str) -> str:
    """Return the name of a value in expressions."""
    return f"{VALUE}_{reference}_{column}"


def name_known(reference: str, column: str) -> str:
    """Return the name of 1 or 0, where a value is known or not."""
    return f"{KNOWN}_{reference}_{column}"


def list_names(references: Sequence[Reference]) -> Mapping[str, tuple[Reference, Track]]:
    """Return all names of references in expressions."""
    return {
        name(reference.name, column): (reference, track)
        for reference in references
        for column, track in reference.columns
        for name in (name_value, name_known)
    }


def evaluate(name: str, references: Sequence[Reference], s: Array, horizon: float | None) -> Array:
    """Return what a name stands for at parts s of the horizon."""
    reference, track = list_names(references)[name]
    times = reference.place(s, horizon)
    if name.startswith(f"{KNOWN}_"):
        return track.is_known(times).astype(np.float64)
    return np.nan_to_num(track.evaluate(times))


def list_unknown(reference: Reference, track: Track, horizon: float | None) -> tuple[tuple[float, float], ...]:
    """List the parts of the horizon in which a column is unknown, by times of the recording."""
    first, last = reference.place(np.array([0.0, 1.0]), horizon)
    slack = 1e-9 * (last - first)
    return tuple((a, b) for a, b in track.list_unknown(float(first), float(last)) if b - a > slack)
