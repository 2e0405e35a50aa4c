"""The states of a motion that are kept: at times of outputs, a given distance from each other.

Steps with an interpolation are cut at multiples of the distance. Of other steps each k-th end is kept, k steps being
nearest to the distance.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mbsrun.simulation.motion import Chunk

Array = NDArray[np.float64]

SAME = 1e-9  # of the distance of outputs: an output that is as near to a step's end is there


class Outputs:
    """Chooses states, chunk by chunk of a piece of the inputs."""

    def __init__(self, distance: float) -> None:
        self.distance = distance  # s
        self._steps = 0

    def open(self) -> None:
        """Begin a piece."""
        self._steps = 0

    def choose(self, chunk: Chunk) -> tuple[Chunk, NDArray[np.intp]]:
        """Return a chunk, cut at the times of outputs where it can be, and which of its states are kept."""
        if chunk.dense is not None:
            return self._refine(chunk)
        stride = find_stride(self.distance, float(chunk.t[1] - chunk.t[0]))
        numbers = self._steps + 1 + np.arange(len(chunk.t) - 1)
        self._steps += len(numbers)
        return chunk, np.flatnonzero(numbers % stride == 0) + 1

    def _refine(self, chunk: Chunk) -> tuple[Chunk, NDArray[np.intp]]:
        """Cut steps at the times of outputs; return the finer chunk, and the indices of these outputs."""
        assert chunk.dense is not None, "only steps with an interpolation are cut"
        dense, (first, last) = chunk.dense, chunk.t[[0, -1]]
        wanted = self.distance * np.arange(np.floor(first / self.distance), np.ceil(last / self.distance) + 1)
        later = np.searchsorted(chunk.t, wanted).clip(1, len(chunk.t) - 1)
        near = np.where(wanted - chunk.t[later - 1] < chunk.t[later] - wanted, chunk.t[later - 1], chunk.t[later])
        wanted = np.where(np.abs(near - wanted) < SAME * self.distance, near, wanted)
        wanted = wanted[(wanted > first) & (wanted <= last)]
        extra = wanted[~np.isin(wanted, chunk.t)]
        if not extra.size:
            return chunk, np.searchsorted(chunk.t, wanted)
        places = np.searchsorted(chunk.t, extra)
        between = dense(extra, places - 1)
        t, q, qd = (
            np.insert(whole, places, part, axis=0)
            for whole, part in zip((chunk.t, chunk.q, chunk.qd), (extra, *between), strict=True)
        )
        rows = np.arange(len(chunk.t)) + np.searchsorted(extra, chunk.t)  # of the states that were there
        step = np.searchsorted(rows, np.arange(1, len(t))) - 1

        def dense_in_parts(times: Array, part: NDArray[np.intp]) -> tuple[Array, Array]:
            return dense(times, step[part])

        segment = chunk.segment
        if segment is not None and segment.bounces is not None:
            segment = replace(segment, bounces=replace(segment.bounces, rows=rows[segment.bounces.rows]))
        return Chunk(t, q, qd, dense_in_parts, segment=segment), np.searchsorted(t, wanted)


def list_times(distance: float, start: float, end: float) -> Array:
    """List the times of outputs of a piece, whose end is the last one."""
    wanted = distance * np.arange(np.floor(start / distance), np.ceil(end / distance) + 1)
    within = (wanted > start + SAME * distance) & (wanted < end - SAME * distance)
    return np.append(wanted[within], end)


def find_stride(distance: float, step: float) -> int:
    """Return how many steps of a length [s] lie between outputs."""
    return max(1, round(distance / step))
