"""The judge's measures of a point: regions, distances, violations and what is allowed, by hand."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import sparse

from mbsrun.ocp.solving import optimality
from mbsrun.ocp.solving.optimality import Judgement, Point, bound, judge, linearise

Array = NDArray[np.float64]
INF = np.inf


def at(x: list[float], J: list[list[float]], bounds: Any, ranges: Any, **given: Any) -> Point:
    """Linearise at x; rows are J x."""
    point, rows = np.array(x), np.array(J).reshape(len(J), len(x))
    pairs = [tuple(np.array(limits, dtype=np.float64).reshape(-1, 2).T) for limits in (bounds, ranges)]
    g = given.pop("g", rows @ point)
    c = np.array(given.pop("c", [1.0] * len(x)))
    return linearise(point, np.array(g, dtype=float), c, sparse.csc_array(rows), *pairs, **given)  # type: ignore[arg-type]


def test_regions_are_as_large_as_the_variables() -> None:
    """1 at least; distances to bounds within them, 0 of fixed variables; usual sizes scale all of it."""
    point = at([-4.0, 0.5, 2.0, 7.0], [], [(-5, 5), (0, INF), (-INF, 2.5), (7, 7)], [])
    assert point.size.tolist() == [4, 1, 2, 7]
    assert point.below.tolist() == [1, 0.5, 2, 0]
    assert point.above.tolist() == [4, 1, 0.5, 0]
    assert point.reach == 4 + 1 + 2 + 7
    scaled = at([-4.0, 0.5], [[1.0, 1.0]], [(-5, 5), (0, INF)], [(-9, 9)], scales=np.array([0.5, 10.0]), c=[3.0, -2.0])
    assert scaled.size.tolist() == [8, 1]
    assert scaled.below.tolist() == [2, 0.05]
    assert scaled.above.tolist() == [8, 1]
    assert scaled.c.tolist() == [1.5, -20]
    assert scaled.J.toarray().tolist() == [[0.5, 10]]
    assert scaled.reach == 12 + 20


def test_rows_of_one_variable_are_bounds_and_others_have_distances() -> None:
    """Within what their variables can do in the region: 2 * 3 + 1 * 1 = 7; an equation has none."""
    J = [[2.0, -1.0], [0.0, -4.0], [1.0, 1.0], [1.0, -1.0]]
    point = at([3.0, 0.5], J, [(-INF, INF)] * 2, [(-INF, 8), (-6, 10), (3.5, 3.5), (-INF, INF)])
    assert point.rows.tolist() == [0, 2, 3]
    assert point.J.toarray().tolist() == [J[0], J[2], J[3]]
    assert point.below.tolist() == [3, 1.0]
    assert point.above.tolist() == [3, 1.0]
    near = at([3.0, 0.5], J, [(-INF, INF)] * 2, [(-INF, 8), (-3, -1), (3.5, 3.5), (-INF, INF)])
    assert near.below.tolist() == [3, 0.25]
    assert near.above.tolist() == [3, 0.25]
    assert point.row_below.tolist() == [7, 0, 4]
    assert point.row_above.tolist() == [2.5, 0, 4]
    positive = at([0.5], [[2.0]], [(-INF, INF)], [(0.5, 2.0)])
    assert (positive.below.tolist(), positive.above.tolist()) == ([0.25], [0.5])


def test_violations_are_relative_to_what_the_region_changes() -> None:
    """Of a bound over its variable's size; of a row over 1, or over its change where that is larger."""
    assert at([-4.0], [], [(-3, 5)], []).violation == 0.25
    assert at([0.5], [], [(0, 0.25)], []).violation == 0.25
    assert at([3.0, 0.5], [[2.0, 2.0]], [(-INF, INF)] * 2, [(-INF, 3)]).violation == 4 / 8
    assert at([0.5, 0.5], [[0.1, 0.1]], [(-INF, INF)] * 2, [(0.4, 9)]).violation == pytest.approx(0.3)
    sized = at([0.5, 0.5], [[0.1, 0.1]], [(-INF, INF)] * 2, [(0.4, 9)], scales=np.array([2.0, 1.0]))
    assert sized.violation == pytest.approx(0.3 / (0.2 + 0.1))
    assert at([1.0], [], [(0, 5)], []).violation == 0.0


def test_sides_are_counted_by_the_part_within_the_region() -> None:
    """Two of each row with a range; a bound in the region is 1, one at twice its size 1/2; fixed variables none."""
    assert at([0.0], [], [(-0.5, 2)], []).sides == 1.5
    assert at([0.0], [], [(0, 0)], []).sides == 0
    assert at([0.0, 0.0], [[1.0, 1.0]], [(0, 0)] * 2, [(-1, 1)]).sides == 2
    assert at([0.0, 0.0], [[1.0, 1.0]], [(0, 0)] * 2, [(0, 0)]).sides == 0


def test_so_much_is_allowed() -> None:
    """1e-6 of the reach or 100 tolerances, a tolerance a limit, and the region where the gradient vanishes."""
    point = at([2.0], [], [(-INF, 2.5)], [], c=[-3.0])
    assert point.sides == 1.0
    for tolerance, weight, allowed in (
        (1e-9, 1.0, 1e-6 * 6 + 1e-9),
        (1e-7, 1.0, 1e-5 * 6 + 1e-7),
        (1e-9, 50.0, 1e-6 * 6 + 5e-8),
        (1e-3, 29.0, 0.1 * 6 + 0.029),
        (1e-3, 31.0, 0.1 * 6 + 0.031 + 0.062),
    ):
        found = judge(point, tolerance, weight)
        assert found.allowed == pytest.approx(allowed, rel=1e-12)
        assert found.allowed_violation == max(1e-6, 100 * tolerance)
        assert found.reach == 6
        assert found.decrease == pytest.approx(1.5)
        assert found.ratio == pytest.approx(0.25)
        assert found.is_optimal == (allowed >= 1.5)
    assert Judgement(0.0, 0.0, 0.0, 0.0, 0.0, True).ratio == 0.0


def test_multipliers_that_prove_enough_end_the_judgement(monkeypatch: pytest.MonkeyPatch) -> None:
    """Right ones make nothing else necessary; wrong ones, or none, are improved; linear programming is the last."""
    point = at([1.0, 1.0], [[1.0, 1.0]], [(-INF, INF)] * 2, [(2, 9)], c=[2.0, 2.0])
    assert bound(point, 1e-9, np.array([-2.0])) == (0.0, False)
    called: list[str] = []
    monkeypatch.setattr(optimality, "_improve", lambda _: called.append("improve") or iter([3.0, 0.5, 0.1]))
    monkeypatch.setattr(optimality, "_solve", lambda _: called.append("solve") or 0.25)
    assert bound(point, 1e-9, np.array([-2.0])) == (0.0, False)
    assert called == []
    assert bound(point, point.reach) == (point.reach, False)  # as much as is allowed is enough
    assert called == []
    assert bound(point, 0.5, np.array([np.nan])) == (0.5, False)
    assert called.pop() == "improve"
    assert bound(point, 0.6, np.array([np.nan])) == (0.5, False)
    assert called == ["improve"]
    assert bound(point, 1e-3) == (0.25, True)
    monkeypatch.setattr(optimality, "LARGEST", 1)
    assert bound(point, 1e-3) == (0.1, False)
    monkeypatch.setattr(optimality, "LARGEST", 2)
    monkeypatch.setattr(optimality, "_solve", lambda _: None)
    assert bound(point, 1e-3) == (0.1, False)
