"""States that a problem adds, integrated along motions of a mechanism that do not depend on them: s' = f(t, motion, s).

The motion is known by steps, of which some are joined. In each the rates are polynomials through Gauss's nodes,

    s(t) = s_0 + sum of the integrals of the steps before + integral of the rates from the step's start to t,

which Picard's iteration solves. A step in which the last coefficients of the rates, in
Legendre's polynomials, are not small is halved. Clenshaw, Norton, "The solution of nonlinear ordinary differential
equations in Chebyshev series", The Computer Journal 6 (1963).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray

from mbsrun.ocp.ground.functions import Indices
from mbsrun.ocp.solving.stepping import Span

Array = NDArray[np.float64]

NODES = 12  # of a step
JOINED = 6  # steps of the mechanism in a step here, at first
SETTLED = 1e-14  # a change of the states, relative to 1 and to them: a smaller one ends the iteration
ITERATIONS = 20
TOLERANCE = 1e-13  # of a step, relative to 1 and to the states
PASSES = 60  # in which steps are halved

_X, _WEIGHTS = legendre.leggauss(NODES)
_TO_SERIES = np.linalg.inv(legendre.legvander(_X, NODES - 1))  # coefficients of polynomials through the nodes
_TO_INTEGRALS = legendre.legint(_TO_SERIES, lbnd=-1)  # and of their integrals from -1 on, (NODES + 1, NODES)
_TO_NODES = legendre.legvander(_X, NODES) @ _TO_INTEGRALS


class UnevenError(Exception):
    """Rates that are too fast or too rough to be followed so."""


@dataclass(frozen=True, eq=False)
class Ride:
    """Added states along the motions of some intervals."""

    ends: Array  # (K, ns)
    intervals: Indices  # (K,)
    edges: Array  # (B, 2): the times of all steps
    owners: Indices  # (B,): the place of each step's interval
    bases: Array  # (B, ns): the states at the steps' starts
    rates: Array  # (B, NODES, ns)

    def read(self, intervals: Indices, times: Array) -> Array:
        """Return the states (M, ns) at times in intervals (M,)."""
        places = np.searchsorted(self.intervals, intervals)
        firsts = np.searchsorted(self.owners, places)
        lasts = np.searchsorted(self.owners, places, side="right") - 1
        found = (np.searchsorted(self.edges[:, 0], times, side="right") - 1).clip(firsts, lasts)
        start, end = self.edges[found].T
        x = 2 * (times - start) / (end - start) - 1
        series = np.einsum("ij,mjs->mis", _TO_INTEGRALS, self.rates[found])
        half = ((end - start) / 2)[:, None]
        return np.asarray(self.bases[found] + half * np.einsum("mi,mis->ms", legendre.legvander(x, NODES), series))


class Riders:
    """The states that a problem adds."""

    def __init__(
        self,
        gather: Callable[[Indices, Array, Array], dict[str, Array]],
        rates: Callable[[dict[str, Array]], Array],
    ) -> None:
        """Take `gather`: intervals (B,), times (B,) in them and states (B, nq + n) -> parts, and rates by parts."""
        self._gather, self._rates = gather, rates

    def ride(self, intervals: Sequence[int], spans: Sequence[Span], starts: Array) -> Ride:
        """Integrate from `starts` (K, ns) through some intervals in ascending order, each by its span.

        Raises UnevenError.
        """
        chosen = np.array(intervals, dtype=np.int64)
        edges = [_place(span) for span in spans]
        for _ in range(PASSES):
            found = self._go(chosen, spans, starts, edges)
            if isinstance(found, Ride):
                return found
            edges = [np.sort(np.append(x, (x[:-1] + x[1:])[cut] / 2)) for x, cut in zip(edges, found, strict=True)]
        raise UnevenError

    def _go(
        self, intervals: Indices, spans: Sequence[Span], starts: Array, edges: Sequence[Array]
    ) -> Ride | list[NDArray[np.bool_]]:
        """Integrate with given steps; or return which of them are too long, by interval."""
        counts = np.array([len(x) - 1 for x in edges])
        owners = np.repeat(np.arange(len(spans)), counts)
        begins, ends = (np.concatenate([x[side] for x in edges]) for side in (slice(None, -1), slice(1, None)))
        half, firsts = ((ends - begins) / 2)[:, None], np.cumsum(counts) - counts
        times = begins[:, None] + half * (1 + _X)
        moves = np.concatenate([span.read(times[owners == k].ravel()) for k, span in enumerate(spans)])
        since = times - begins[firsts][owners][:, None]
        parts = self._gather(np.repeat(intervals[owners], NODES), since.ravel(), moves)
        bases, rates = np.zeros((len(owners), starts.shape[1])), np.zeros((len(owners), NODES, starts.shape[1]))
        is_long, last = np.zeros(len(owners), dtype=np.bool_), starts.copy()
        for j in range(counts.max()):  # the steps of an interval one after the other, of all intervals at once
            own = np.flatnonzero(counts > j)
            rows = firsts[own] + j
            bases[rows] = last[own]
            nodes = (rows[:, None] * NODES + np.arange(NODES)).ravel()
            here = {name: part[nodes] for name, part in parts.items()}
            rates[rows], is_long[rows] = self._iterate(here, half[rows], bases[rows])
            if is_long.any():  # as are later steps of the same length, probably
                return [self._choose(is_long[owners == k], half[owners == k, 0]) for k in range(len(spans))]
            last[own] = bases[rows] + half[rows] * np.einsum("j,bjs->bs", _WEIGHTS, rates[rows])
        return Ride(last, intervals, np.stack((begins, ends), axis=1), owners, bases, rates)

    @staticmethod
    def _choose(is_long: NDArray[np.bool_], half: Array) -> NDArray[np.bool_]:
        """Return which steps of an interval are to be halved: the ones that are as long as a step that is too long."""
        return half >= half[is_long].min() if is_long.any() else is_long

    def _iterate(self, parts: dict[str, Array], half: Array, bases: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Return the rates at the nodes of steps (B, NODES, ns), and which steps are too long."""
        shape = (len(bases), NODES, bases.shape[1])
        states = np.broadcast_to(bases[:, None], shape)
        for _ in range(ITERATIONS):
            rates = self._rates(parts | {"states": states.reshape(-1, shape[2])}).reshape(shape)
            last, states = states, bases[:, None] + half[:, None] * np.einsum("ij,bjs->bis", _TO_NODES, rates)
            is_settled = (np.abs(states - last) <= SETTLED * (1 + np.abs(states))).all(axis=(1, 2))
            if is_settled.all() or not np.isfinite(states).all():
                break
        series = np.einsum("ij,bjs->bis", _TO_SERIES[-2:], rates)
        is_rough = ~(half[:, None] * np.abs(series) <= TOLERANCE * (1 + np.abs(bases))[:, None]).all(axis=(1, 2))
        return rates, ~is_settled | is_rough


def _place(span: Span) -> Array:
    """Return the ends of the first steps."""
    every = np.unique(np.concatenate([chunk.t for chunk in span.chunks]))
    return np.append(every[:-1:JOINED], every[-1])
