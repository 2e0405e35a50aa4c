"""Trees of neighbouring cases: spanning, least, and of the set of cases alone."""

from __future__ import annotations

from concurrent.futures import Future
from typing import cast

import numpy as np
import pytest
from scipy.sparse.csgraph import minimum_spanning_tree

from mbsrun.ocp.cases.neighbours import FEWEST, Origin, follow
from mbsrun.ocp.cases.tree import Edge, Place, find_trees, keep_paths
from mbsrun.ocp.solving.phases import Neighbour


def place(points: np.ndarray, kind: str = "") -> list[Place]:
    return [Place(kind, tuple(point)) for point in points.tolist()]


@pytest.mark.parametrize("seed", range(3))
def test_the_sum_of_distances_is_the_least(seed: int) -> None:
    """As SciPy's Kruskal has it, over the ranges of the numbers."""
    x = np.random.default_rng(seed).uniform(0, [1, 1000, 1e-3], (20, 3))
    unit = (x - x.min(axis=0)) / np.ptp(x, axis=0)
    distances = np.linalg.norm(unit[:, None] - unit, axis=2)
    edges = find_trees(place(x))
    assert sum(edge.distance for edge in edges) == pytest.approx(minimum_spanning_tree(distances).sum())
    seen = set[int | None]([None])
    for edge in edges:
        assert edge.parent in seen
        seen.add(edge.case)
    assert len(edges) == len(x)
    assert edges[0].case == np.argmin(np.linalg.norm(unit - 0.5, axis=1))


def test_the_order_of_cases_does_not_matter() -> None:
    """Also on a grid, where many distances are equal."""
    x = np.array([(a, b) for a in range(5) for b in range(4)], dtype=float)
    order = np.random.default_rng(0).permutation(len(x))
    first, again = find_trees(place(x)), find_trees(place(x[order]))
    back = [Edge(int(order[e.case]), None if e.parent is None else int(order[e.parent]), e.distance) for e in again]
    assert back == list(first)


def test_kinds_have_trees_of_their_own_and_equal_cases_are_neighbours() -> None:
    x = np.array([[0.0], [1.0], [1.0]])
    edges = find_trees([*place(x, "a"), *place(x[:1], "b"), Place("c", ())])
    assert {edge.case for edge in edges if edge.parent is None} == {0, 3, 4}
    assert Edge(2, 1, 0.0) in edges
    assert find_trees([]) == ()


def test_paths_lead_to_the_cases_that_are_wanted() -> None:
    edges = [Edge(0, None), Edge(1, 0), Edge(2, 1), Edge(3, 0)]
    assert keep_paths(edges, [2]) == tuple(edges[:3])
    assert keep_paths(edges, []) == ()


def test_a_solve_begins_when_its_parent_has_ended() -> None:
    edges = [Edge(0, None), Edge(1, 0), Edge(2, 1), Edge(3, None)]
    begun: list[int] = []

    def begin(edge: Edge, origin: Origin | None) -> Future[tuple[str, Origin]]:
        assert (origin is None) == (edge.parent is None)
        assert edge.parent is None or origin.iterations == edge.parent  # type: ignore[union-attr]
        begun.append(edge.case)
        future: Future[tuple[str, Origin]] = Future()
        future.set_result((f"case {edge.case}", Origin(None, edge.case)))
        return future

    assert dict(follow(edges, begin)) == {k: f"case {k}" for k in range(4)}
    assert begun.index(0) < begun.index(1) < begun.index(2)


def test_tries_are_short_and_rest_after_failures() -> None:
    """One generation after the first failure, two after the second; a success forgets them."""
    neighbour = cast("Neighbour", object())
    origin = Origin(neighbour, 20)
    assert origin.is_near(9.0)
    assert origin.most_iterations == 15
    assert Origin(neighbour, 1).most_iterations == FEWEST
    for rest in (1, 2, 4):
        origin = origin.leave(neighbour, 20, 1.0, has_tried=True)
        for _ in range(rest):
            assert not origin.is_near(0.6)
            assert origin.is_near(0.4)
            origin = origin.leave(neighbour, 20, 1.0, has_tried=False)
        assert origin.is_near(0.6)
    assert not origin.leave(None, 0, 1.0, has_tried=False).is_near(0.0)
    assert origin.lead(neighbour).leave(neighbour, 20, 1.0, has_tried=True).rest == 1
