"""Trees of neighbouring cases: places of cases -> the case that each of them starts from.

A place has the numbers by which cases differ. A minimum spanning tree joins the cases of one kind with the least sum of
distances, over the ranges of the numbers (Prim, "Shortest connection networks and some generalizations", Bell System
Technical Journal 36 (1957)). Its root is the case nearest to the middle of the ranges. Places are sorted first, so the
tree depends on the set of cases alone, not on their order.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Place:
    """The values that distinguish a case from others."""

    kind: Hashable  # cases of different kinds are no neighbours
    numbers: tuple[float, ...]


@dataclass(frozen=True)
class Edge:
    """A case, and the one that it starts from."""

    case: int
    parent: int | None  # None: its own guess
    distance: float = 0.0  # over the ranges of the numbers


def find_trees(places: Sequence[Place]) -> tuple[Edge, ...]:
    """Return an edge for each case, parents before children; a tree for each kind."""
    kinds: dict[Hashable, list[int]] = {}
    for k, place in enumerate(places):
        kinds.setdefault(place.kind, []).append(k)
    return tuple(edge for cases in kinds.values() for edge in _join(cases, places))


def keep_paths(edges: Sequence[Edge], wanted: Sequence[int]) -> tuple[Edge, ...]:
    """Return the edges of some cases and of all from which they come, in the same order."""
    kept, found = set[int | None](wanted), list[Edge]()
    for edge in reversed(edges):
        if edge.case in kept:
            kept.add(edge.parent)
            found.append(edge)
    return tuple(reversed(found))


def _join(cases: Sequence[int], places: Sequence[Place]) -> list[Edge]:
    """Join cases of one kind, nearest first."""
    order = sorted(cases, key=lambda k: (places[k].numbers, k))
    x = _scale(np.array([places[k].numbers for k in order], dtype=np.float64).reshape(len(order), -1))
    root = int(np.argmin(_measure(x, np.full(x.shape[1], 0.5))))
    edges, parents = [Edge(order[root], None)], np.full(len(order), root)
    distances = _measure(x, x[root])
    distances[root] = np.inf
    is_joined = np.zeros(len(order), dtype=bool)
    is_joined[root] = True
    while len(edges) < len(order):
        k = int(np.argmin(distances))
        edges.append(Edge(order[k], order[int(parents[k])], float(np.sqrt(distances[k]))))
        is_joined[k] = True
        own = _measure(x, x[k])
        nearer = ~is_joined & (own < distances)
        parents[nearer], distances[nearer] = k, own[nearer]
        distances[k] = np.inf
    return edges


def _scale(x: Array) -> Array:
    """Return numbers (cases, n) over their ranges, from 0 to 1; the ones that do not differ are left out."""
    least, most = x.min(axis=0), x.max(axis=0)
    differs = most > least
    return np.asarray((x[:, differs] - least[differs]) / (most - least)[differs])


def _measure(x: Array, place: Array) -> Array:
    """Return squared distances (cases,) from a place."""
    return np.asarray(((x - place) ** 2).sum(axis=1))
