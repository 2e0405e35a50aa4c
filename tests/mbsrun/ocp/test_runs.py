"""Searches by a method: when a guess is moved, the times that count, and by how much values leave their bounds."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from mbsrun.ocp.ground.status import ACCEPTABLE, SOLVED
from mbsrun.ocp.solution.solution import Run
from mbsrun.ocp.solving.answers import (
    _measure_closure,
    _measure_complementarity,
    _measure_lengths,
    measure_excess,
)
from mbsrun.ocp.solving.runs import NUDGE, call, join, report, search

Array = NDArray[np.float64]
X = np.array([0.0, 50.0, -200.0, 0.5])


def follow(*runs: tuple[str, int]) -> tuple[list[Array], Any]:
    """Search with a method whose runs end in this order; return where it was called, and the outcome."""
    places: list[Array] = []

    def answer(x: Array) -> Any:
        places.append(x)
        status, iterations = runs[len(places) - 1]
        return SimpleNamespace(run=SimpleNamespace(status=status, iterations=iterations), number=len(places))

    return places, search(X, answer)


def test_a_guess_in_which_nothing_improves_is_moved_to_both_sides() -> None:
    """By up to a hundredth of each number, or of 1; the other side is tried where the first one is solved."""
    places, outcome = follow((SOLVED, 0), (SOLVED, 5), (SOLVED, 3))
    assert outcome.number == 3
    nudge = places[1] - X
    assert places[2] == pytest.approx(X - nudge)
    sizes = np.abs(nudge) / (NUDGE * np.maximum(np.abs(X), 1.0))
    assert ((sizes > 1e-3) & (sizes <= 1.0)).all()
    assert len(set(sizes)) == 4


@pytest.mark.parametrize(
    ("runs", "count"),
    [
        ([(SOLVED, 1)], 1),
        ([(ACCEPTABLE, 0)], 1),
        ([(SOLVED, 0), ("lost", 9)], 2),
        ([(SOLVED, 0), (SOLVED, 0), ("lost", 1)], 3),
    ],
)
def test_other_outcomes_end_a_search(runs: list[tuple[str, int]], count: int) -> None:
    places, outcome = follow(*runs)
    assert (len(places), outcome.number) == (count, count)


def test_times_of_a_run_are_without_preparations() -> None:
    """These are measured by the method itself; what it needs for functions is a part of the rest."""
    answer: Any = SimpleNamespace(
        status=SOLVED, iterations=4, preparing=-100.0, cpu_preparing=-50.0, evaluating=2.0, cpu_evaluating=1.0, x=X,
        clash=None, multipliers=None, near=None,
    )  # fmt: skip
    start: Any = object()
    found = call(lambda _: answer, start)
    run = found.run
    assert 100.0 <= run.seconds < 101.0
    assert 50.0 <= run.cpu_seconds < 51.0
    assert (run.status, run.iterations, run.seconds_evaluating, run.cpu_seconds_evaluating) == (SOLVED, 4, 2.0, 1.0)
    assert found.start is start


def test_joined_runs_sum_what_they_took() -> None:
    first = Run(ACCEPTABLE, 3, 1.0, 0.25, 2.0, 0.5)
    last = Run(SOLVED, 5, 10.0, 0.75, 20.0, 1.5, decrease=7.0)
    assert join(first, last) == replace(
        last, iterations=8, seconds=11.0, seconds_evaluating=1.0, cpu_seconds=22.0, cpu_seconds_evaluating=2.0
    )


def test_a_watch_sees_every_iterate() -> None:
    seen: list[Any] = []
    given: Any = SimpleNamespace(number=3, cost=1.5, violation=0.25)
    report(seen.append)(given)
    assert [(x.iteration, x.cost, x.violation) for x in seen] == [(3, 1.5, 0.25)]


def test_an_excess_is_the_largest_distance_beyond_a_bound() -> None:
    lower, upper = np.array([0.0, -np.inf, 1.0]), np.array([1.0, 2.0, np.inf])
    for values, excess in (
        ([0.5, 0.0, 1.0], 0.0),
        ([-0.25, 0.0, 1.0], 0.25),
        ([1.5, 2.75, 0.0], 1.0),
        ([1.5, 0.0, 3.0], 0.5),
    ):
        assert measure_excess(np.array(values), lower, upper) == excess
    assert measure_excess(np.zeros(0), np.zeros(0), np.zeros(0)) == 0.0


def test_violations_are_the_largest_of_all_points() -> None:
    """Of a quaternion the distance of its length from 1; of loops the gap and its rate; of contacts the product."""
    manifest: Any = SimpleNamespace(quaternions=(1,), positions=("x", "b.qx", "b.qy", "b.qz", "b.qw"))
    mesh, points = np.array([[9.0, 0.0, 0.6, 0.0, 0.8], [9.0, 0.0, 0.0, 0.0, 0.75]]), np.zeros((1, 2, 5))
    points[..., 1] = [1.5, 1.0]
    motion: Any = SimpleNamespace(q=mesh, qd=np.array([[3.0]]), point_q=points, point_qd=np.array([[[-4.0]]]))
    assert _measure_lengths(motion, manifest) == 0.5
    points[..., 1] = 1.0
    assert _measure_lengths(motion, manifest) == 0.25
    assert _measure_lengths(motion, SimpleNamespace(quaternions=())) is None  # type: ignore[arg-type]
    closure: Any = SimpleNamespace(
        measure=lambda q: float(np.abs(q).max()), measure_rates=lambda _, qd: float(np.abs(qd).max())
    )
    assert _measure_closure(motion, closure) == (9.0, 4.0)
    assert _measure_closure(motion, None) == (None, None)
    problem: Any = SimpleNamespace(constraints=[SimpleNamespace(is_relaxed=x) for x in (True, False, True)])
    rows: Any = SimpleNamespace(rows=SimpleNamespace(constraints=(np.array([0, 1]), np.array([2]), np.array([3]))))
    assert _measure_complementarity(problem, rows, np.array([1.0, 5.0, 9.0, 3.0])) == 5.0
    problem.constraints[0].is_relaxed = problem.constraints[2].is_relaxed = False
    assert _measure_complementarity(problem, rows, np.zeros(4)) is None
