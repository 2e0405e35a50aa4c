"""Integrate a mechanism's motion under given inputs by csrc/mbs_explicit.h, piece by piece, at a tolerance.

The accelerations follow from the residual and its Jacobian by accelerations, which every problem has at hand; loops are
closed by the least change of coordinates and velocities after each step.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mbsrun.limits import Allowance
from mbsrun.ocp.ground.functions import Indices
from mbsrun.simulation.course import Course
from mbsrun.simulation.drive import Piece
from mbsrun.simulation.dynamics import Equations
from mbsrun.simulation.formulation import Formulation
from mbsrun.simulation.integration import explicit
from mbsrun.simulation.memory import Source
from mbsrun.simulation.motion import Chunk, Keeping, Settings

Array = NDArray[np.float64]


class Stepper:
    """A mechanism in C, with the motions of its driven joints."""

    def __init__(self, kernels: Source, course: Course, tolerance: float) -> None:
        """Take loaded kernels; the tolerance of a step is relative and absolute."""
        self._equations = Equations(kernels, Formulation.IMPL, course)
        self._settings = Settings(0.0, rtol=tolerance, atol=tolerance, loops=Keeping.PROJECTION)

    def follow(self, piece: Piece, state: Array, allowance: Allowance) -> Span:
        """Integrate a state (nq + n,), with closed loops, through a piece.

        Raises HaltError where a kernel or the integrator fails, MbsError where inputs have no value, and LimitError
        when the allowance is used up.
        """
        effort = self._equations.effort
        effort.gap = 0.0
        steps = explicit.march(explicit.DOP853, self._equations, piece, state, self._settings, allowance)
        return Span(tuple(steps), effort.gap)

    def gather(self, pieces: Sequence[Piece], spans: Sequence[Span]) -> Callable[[Indices, Array], Array]:
        """Return a function of pieces (B,) and times (B,) in them: the states (B, nq + n) of their spans.

        Inputs that are given over time are read for all at once.
        """
        if any(piece.law is not None for piece in pieces):
            return lambda which, times: _read_each(spans, which, times)
        plant: explicit.Plant = self._equations.kept["plant"]
        begins, states = zip(*(span.steps for span in spans), strict=True)
        counts = np.array([len(part) for part in begins])
        every, starts, firsts = np.concatenate(begins), np.concatenate(states), np.cumsum(counts) - counts

        def read(which: Indices, times: Array) -> Array:
            steps = np.searchsorted(every, times, side="right") - 1
            steps = steps.clip(firsts[which], firsts[which] + counts[which] - 1)
            return plant.read_pieces(pieces, which, every[steps], times - every[steps], starts[steps])

        return read


def _read_each(spans: Sequence[Span], which: Indices, times: Array) -> Array:
    found = np.empty((len(times), spans[0].end.size))
    for k in np.unique(which).tolist():
        chosen = which == k
        found[chosen] = spans[k].read(times[chosen])
    return found


@dataclass(frozen=True)
class Span:
    """A motion through one piece of its inputs."""

    chunks: Sequence[Chunk]
    gap: float  # of loops, the largest that a step left before they were closed

    @property
    def end(self) -> Array:
        """Return the last state (nq + n,)."""
        return np.concatenate((self.chunks[-1].q[-1], self.chunks[-1].qd[-1]))

    @property
    def steps(self) -> tuple[Array, Array]:
        """Return the times (S,) and states (S, nq + n) at which steps begin."""
        times = np.concatenate([chunk.t[:-1] for chunk in self.chunks])
        return times, np.concatenate([np.hstack((chunk.q[:-1], chunk.qd[:-1])) for chunk in self.chunks])

    def read(self, times: Array) -> Array:
        """Return the states (K, nq + n) at times (K,) of the piece."""
        last, size = len(self.chunks) - 1, self.end.size
        which = np.searchsorted([chunk.t[-1] for chunk in self.chunks], times).clip(max=last)
        states = np.empty((len(times), size))
        for k in np.unique(which).tolist():
            chunk, chosen = self.chunks[k], which == k
            assert chunk.dense is not None, "a method with an error estimate gives states within its steps"
            steps = np.searchsorted(chunk.t, times[chosen], side="right") - 1
            states[chosen] = np.hstack(chunk.dense(times[chosen], steps.clip(0, len(chunk.t) - 2)))
        return states
