"""Neighbouring cases in layers: places of cases -> the cases that each of them starts from.

A place has the numbers by which cases differ. The cases of one kind are put in an order in which each is the farthest
from all before it, over the ranges of the numbers (Gonzalez, "Clustering to minimize the maximum intercluster
distance", Theoretical Computer Science 38 (1985)); the first one is nearest to the middle of the ranges. Numbers of one
vector have one unit, and are taken over their largest range. The layers are 1, 1, 2, 4, 8, ... cases of this order. A
case starts from the nearest ones of earlier layers, so layers grow denser, and the cases of one layer do not wait for
each other. Places are sorted first, so the layers depend on the set of cases alone, not on their order.
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

MOST = 16  # sources of a case, which has no more than a cubic function has coefficients
SLACK = 1e-9  # the price of weights over the one of missing the place
CURVED = 1e-3  # the same, over the one of missing values of functions of higher degree
FIRST = 32  # the first cases are all probes
PROBE = 2  # of the later ones, each that many-th is one
SPAN = 2.0  # the length in which functions vary, over the distance of the farthest source


@dataclass(frozen=True)
class Place:
    """The values that distinguish a case from others."""

    kind: Hashable  # cases of different kinds are no neighbours
    numbers: tuple[float, ...]
    parts: tuple[int, ...] = ()  # numbers of one part, such as a vector, have one unit; empty: each is a part


@dataclass(frozen=True)
class Source:
    """A case from which another one starts."""

    case: int
    offset: tuple[float, ...]  # of its place from the other one's, over the ranges of the numbers

    @property
    def distance(self) -> float:
        """Return how far apart the two are."""
        return math.hypot(*self.offset)


@dataclass(frozen=True)
class Start:
    """A case, and the ones that it starts from."""

    case: int
    sources: tuple[Source, ...] = ()  # the nearest first; none: its own guess
    is_probe: bool = True  # it tries its sources even where no try succeeded yet

    @property
    def parent(self) -> int | None:
        """Return the nearest source."""
        return self.sources[0].case if self.sources else None

    @property
    def distance(self) -> float:
        """Return how far the nearest source is."""
        return self.sources[0].distance if self.sources else 0.0


def find_starts(places: Sequence[Place]) -> tuple[Start, ...]:
    """Return the start of each case, sources before the cases that start from them."""
    kinds: dict[Hashable, list[int]] = {}
    for k, place in enumerate(places):
        kinds.setdefault(place.kind, []).append(k)
    return tuple(start for cases in kinds.values() for start in _join(cases, places))


def keep_paths(starts: Sequence[Start], wanted: Sequence[int]) -> tuple[Start, ...]:
    """Return the starts of some cases and of all from which they come, in the same order."""
    kept, found = set(wanted), list[Start]()
    for start in reversed(starts):
        if start.case in kept:
            kept.update(source.case for source in start.sources)
            found.append(start)
    return tuple(reversed(found))


def weigh(sources: Sequence[Source]) -> Array:
    """Return the weights, with the sum 1, by which sources are mixed: they take each linear function to the case.

    Where sources are enough for more, the weights take functions of higher degree there too: they miss the monomials
    of the offsets by the least sum of squares, with the factors of the exponential series. Of all such weights, far
    sources have small ones. Where sources are too few, their mean place is as near as it can.
    """
    offsets = np.array([source.offset for source in sources], dtype=np.float64)
    squares = (offsets**2).sum(axis=1)
    if not squares.min() > 0:  # the same numbers
        return np.asarray((squares == 0) / np.count_nonzero(squares == 0))
    products, length = offsets @ offsets.T, SPAN**2 * squares.max()
    curved = length * np.expm1(products / length) - products
    with_all = np.diag(squares) + products / SLACK + curved / CURVED
    found = np.linalg.solve(with_all / squares.min(), np.ones(len(squares)))
    return np.asarray(found / found.sum())


def _join(cases: Sequence[int], places: Sequence[Place]) -> list[Start]:
    """Return the starts of cases of one kind, farthest first."""
    order = sorted(cases, key=lambda k: (places[k].numbers, k))
    numbers = np.array([places[k].numbers for k in order], dtype=np.float64).reshape(len(order), -1)
    x = _scale(numbers, places[order[0]].parts or range(numbers.shape[1]))
    chosen, most = _spread(x), min(MOST, math.comb(x.shape[1] + 3, 3))
    starts = [Start(order[chosen[0]])]
    for n in range(1, len(chosen)):
        k, earlier = chosen[n], chosen[: 1 << (n.bit_length() - 1)]
        distances = _measure(x[earlier], x[k])
        nearest = [earlier[i] for i in np.argsort(distances, kind="stable")[:most].tolist()]
        sources = tuple(Source(order[i], tuple((x[i] - x[k]).tolist())) for i in nearest)
        starts.append(Start(order[k], sources, n < FIRST or n % PROBE == 0))
    return starts


def _spread(x: Array) -> list[int]:
    """Return places (cases, n) in the order in which each is the farthest from all before it."""
    chosen = [int(np.argmin(_measure(x, np.full(x.shape[1], 0.5))))]
    distances = _measure(x, x[chosen[0]])
    while len(chosen) < len(x):
        distances[chosen[-1]] = -1.0
        chosen.append(int(np.argmax(distances)))
        distances = np.where(distances < 0, distances, np.minimum(distances, _measure(x, x[chosen[-1]])))
    return chosen


def _scale(x: Array, parts: Sequence[int]) -> Array:
    """Return numbers (cases, n) over the largest range of their part; the ones that do not differ are left out."""
    ranges, numbers = np.ptp(x, axis=0), np.array(parts, dtype=np.int64)
    differs = ranges > 0
    whole = np.array([ranges[numbers == part].max() for part in numbers[differs].tolist()])
    return np.asarray((x - x.min(axis=0))[:, differs] / whole)


def _measure(x: Array, place: Array) -> Array:
    """Return squared distances (cases,) from a place."""
    return np.asarray(((x - place) ** 2).sum(axis=1))
