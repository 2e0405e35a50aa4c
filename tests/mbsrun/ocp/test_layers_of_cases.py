"""Neighbouring cases in layers: the nearest of earlier ones, of the set of cases alone, and mixed to first order."""

from __future__ import annotations

from concurrent.futures import Future
from dataclasses import dataclass, field
from itertools import pairwise
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from mbsrun.ocp.cases import cases, neighbours
from mbsrun.ocp.cases.layers import Place, Source, Start, find_starts, keep_paths, weigh
from mbsrun.ocp.cases.neighbours import (
    BLOCK,
    ENOUGH,
    FEWEST,
    HOPED,
    SECONDS,
    Origin,
    Pace,
    Waiting,
    follow,
    gather,
    solve_neighbours,
    split,
)
from mbsrun.ocp.evaluation.stages.binding import Point
from mbsrun.ocp.methods import Near, mix
from mbsrun.ocp.solution.phases import Guess
from mbsrun.ocp.solving.phases import Neighbour


def place(points: np.ndarray, kind: str = "") -> list[Place]:
    return [Place(kind, tuple(point)) for point in points.tolist()]


@pytest.mark.parametrize("seed", range(3))
def test_sources_are_the_nearest_of_earlier_layers(seed: int) -> None:
    """Over the ranges of the numbers; the layers have 1, 1, 2, 4, 8, ... cases."""
    x = np.random.default_rng(seed).uniform(0, [1, 1000, 1e-3], (20, 3))
    unit = (x - x.min(axis=0)) / np.ptp(x, axis=0)
    starts = find_starts(place(x))
    assert sorted(start.case for start in starts) == list(range(20))
    assert starts[0] == Start(int(np.argmin(np.linalg.norm(unit - 0.5, axis=1))))
    begins = [1, 2, 4, 8, 16, 20]
    for first, end in pairwise(begins):
        earlier = [start.case for start in starts[:first]]
        for start in starts[first:end]:
            distances = np.linalg.norm(unit[earlier] - unit[start.case], axis=1)
            assert [source.distance for source in start.sources] == pytest.approx(np.sort(distances)[:16])
            for source in start.sources:
                assert unit[source.case] - unit[start.case] == pytest.approx(source.offset, abs=1e-15)


def test_cases_of_a_grid_halve_its_gaps() -> None:
    """Of nine places: the middle, the ends, and then the middles between these."""
    starts = find_starts(place(np.arange(9.0)[:, None]))
    assert starts[0].case == 4
    assert {start.case for start in starts[1:3]} == {0, 8}
    assert {start.case for start in starts[3:5]} == {2, 6}
    assert {start.distance for start in starts[5:]} == {1 / 8}


def test_the_order_of_cases_does_not_matter() -> None:
    """Also on a grid, where many distances are equal."""
    x = np.array([(a, b) for a in range(5) for b in range(4)], dtype=float)
    order = np.random.default_rng(0).permutation(len(x))
    first, again = find_starts(place(x)), find_starts(place(x[order]))
    back = [
        Start(
            int(order[s.case]),
            tuple(Source(int(order[source.case]), source.offset) for source in s.sources),
            s.is_probe,
        )
        for s in again
    ]
    assert back == list(first)


def test_kinds_have_layers_of_their_own_and_equal_cases_are_neighbours() -> None:
    x = np.array([[0.0], [1.0], [1.0]])
    starts = find_starts([*place(x, "a"), *place(x[:1], "b"), Place("c", ())])
    assert {start.case for start in starts if start.parent is None} == {0, 3, 4}
    assert (starts[2].parent, starts[2].distance) == (1, 0.0)
    assert find_starts([]) == ()


@pytest.mark.parametrize("count", [1, 2, 3, 4, 6])
def test_weights_take_linear_functions_to_a_case(count: int) -> None:
    """Where sources are enough to span the space; they have the sum 1 always, and repeat a case that is the same."""
    rng = np.random.default_rng(count)
    offsets = rng.uniform(-1, 1, (count, 2))
    weights = weigh([Source(k, tuple(offset)) for k, offset in enumerate(offsets.tolist())])
    assert weights.sum() == pytest.approx(1)
    if count > 2:
        assert weights @ offsets == pytest.approx(np.zeros(2), abs=1e-4)
    same = weigh([Source(9, (0.0, 0.0)), *(Source(k, tuple(offset)) for k, offset in enumerate(offsets.tolist()))])
    assert same.tolist() == [1.0] + count * [0.0]


def test_two_sources_beside_a_case_count_by_their_distances() -> None:
    """Linear interpolation."""
    assert weigh([Source(0, (-0.1,)), Source(1, (0.3,))]) == pytest.approx([0.75, 0.25], abs=1e-5)


def test_four_sources_on_a_line_take_cubic_functions_to_a_case() -> None:
    """Polynomial interpolation, whose weights are Lagrange's at 0."""
    places = np.array([-0.1, 0.15, -0.3, 0.4])
    apart = [np.delete(places, k) for k in range(4)]
    expected = [np.prod(others / (others - x)) for x, others in zip(places, apart, strict=True)]
    assert weigh([Source(k, (x,)) for k, x in enumerate(places.tolist())]) == pytest.approx(expected, abs=0.02)


def test_a_mixture_keeps_multipliers_of_bounds() -> None:
    """They are at least 0, also where weights are negative."""

    def end(x: float) -> Near:
        return Near(b"", Point(*(np.array([x, 2 * x]) for _ in range(4))))

    mixed = mix([end(1.0), end(4.0)], np.array([2.0, -1.0])).point
    assert [part.tolist() for part in mixed.parts] == [[-2.0, -4.0], [0.0, 0.0], [0.0, 0.0], [-2.0, -4.0]]


def test_sources_without_a_solution_or_with_other_variables_are_left_out() -> None:
    """The others are mixed to first order; nothing is mixed where no try is worth its time."""

    def origin(layout: bytes | None, x: float, share: float = 0.5) -> Origin:
        near = Near(layout or b"", Point(*(np.array([x]) for _ in range(4))))
        guess = cast("Guess", object())
        own = None if layout is None else Neighbour(guess, np.array([x]), near, None, 1.0)
        return Origin(own, 10, share, 1.0)

    start = Start(4, tuple(Source(k, (offset,)) for k, offset in enumerate((-1.0, 1.5, 2.0, 4.0))))
    origins = {0: origin(b"a", 1.0), 1: origin(None, 9.0), 2: origin(b"b", 9.0), 3: origin(b"a", 6.0)}
    found = gather(start, origins)
    assert found is not None
    assert found.neighbour is not None
    assert found.neighbour.near.point.w == pytest.approx([2.0], abs=1e-5)
    assert found.expected == 0.5
    dear = gather(start, {k: origin(b"a", 1.0, 2.0) for k in range(4)})
    assert dear is not None
    assert not dear.is_worth_a_try
    assert gather(Start(0), {}) is None


def test_paths_lead_to_the_cases_that_are_wanted() -> None:
    starts = [Start(0), Start(1, (Source(0, ()),)), Start(2, (Source(1, ()), Source(0, ()))), Start(3)]
    assert keep_paths(starts, [2]) == tuple(starts[:3])
    assert keep_paths(starts, []) == ()


def test_a_solve_begins_when_its_sources_have_ended() -> None:
    """Origins are kept until the last case that starts there."""
    starts = [Start(0), Start(1, (Source(0, (1.0,)),)), Start(2, (Source(1, (1.0,)), Source(0, (2.0,)))), Start(3)]
    begun: list[int] = []

    def begin(start: Start, origin: Origin | None) -> Future[tuple[str, Origin]]:
        assert (origin is None) == (start.parent is None)
        assert start.parent is None or origin.iterations == start.parent  # type: ignore[union-attr]
        begun.append(start.case)
        future: Future[tuple[str, Origin]] = Future()
        future.set_result((f"case {start.case}", Origin(None, start.case)))
        return future

    assert dict(follow(starts, begin)) == {k: f"case {k}" for k in range(4)}
    assert begun.index(0) < begun.index(1) < begun.index(2)
    waiting = Waiting(starts)
    assert list(waiting.end(0, Origin(None, 0))) == [starts[1]]
    waiting.gather(starts[1])
    assert list(waiting.origins) == [0]
    assert list(waiting.end(1, Origin(None, 1))) == [starts[2]]
    waiting.gather(starts[2])
    assert not waiting.origins


def test_tries_that_cost_more_than_they_save_are_left_out() -> None:
    """Until cases are nearer to their sources; a success is worth what it saved."""
    neighbour = cast("Neighbour", object())
    origin = Origin(neighbour, 20)
    assert origin.is_worth_a_try
    assert origin.most_iterations == 20
    assert Origin(neighbour, 1).most_iterations == FEWEST
    assert not Origin(None, 20).is_worth_a_try
    failed = origin.leave(neighbour, 20, 1.0)
    assert failed.expect(2.0) == failed.expect(1.0) == 2.0
    assert failed.expect(0.25) == 0.5
    assert origin.lead(neighbour, 5, 1.0).expect(1.0) == 0.25
    left_out = Origin(neighbour, 20, expected=1.5).leave(neighbour, 20, 0.5)
    assert left_out.expect(0.5) == 1.5
    assert Origin(neighbour, 20).expect(3.0) == HOPED


def test_a_try_must_hope_to_save_a_quarter() -> None:
    """A share between that and 1 is no reason; the first try of all has one."""
    neighbour = cast("Neighbour", object())
    assert Origin(neighbour, 20, expected=ENOUGH).is_worth_a_try
    assert Origin(neighbour, 20, expected=HOPED).is_worth_a_try
    assert not Origin(neighbour, 20, expected=0.8).is_worth_a_try


def test_where_no_try_succeeded_yet_only_probes_try() -> None:
    """The first 32 cases, and then each second one; one source whose own try succeeded is enough for the others."""
    starts = find_starts(place(np.linspace(0, 1, 40)[:, None]))
    assert [n for n, start in enumerate(starts) if start.is_probe] == [*range(32), *range(32, 40, 2)]
    plain = Origin(Solves.end, ALONE)
    failed, led = plain.leave(Solves.end, ALONE, 1.0), plain.lead(Solves.end, 10, 1.0)
    sources = Source(0, (0.1,)), Source(1, (0.2,))
    for is_probe, second, is_tried in ((True, failed, True), (False, failed, False), (False, led, True)):
        found = gather(Start(2, sources, is_probe), {0: failed, 1: second})
        assert found is not None
        assert found.is_worth_a_try == is_tried


ALONE = 40  # iterations of a solve from a guess


@dataclass
class Solves:
    """Stand in for the solver of cases, which are numbers: a try takes a share of ALONE, or fails."""

    share: float | None
    tried: set[Any] = field(default_factory=set)
    iterations: int = 0

    end = Neighbour(cast("Guess", None), np.zeros(1), Near(b"", Point(*(np.zeros(1) for _ in range(4)))), None, 1.0)

    def solve(self, _: Any, note: Any) -> Any:
        note(self.end)
        self.iterations += ALONE
        return SimpleNamespace(run=SimpleNamespace(iterations=ALONE))

    def solve_near(self, tries: list[cases.Try], _: int) -> list[Any]:
        self.tried |= {one.case for one in tries}
        if self.share is None:
            self.iterations += sum(one.most_iterations for one in tries)
            return [None] * len(tries)
        taken = round(self.share * ALONE)
        self.iterations += taken * len(tries)
        return [cases.Near(cast("Any", SimpleNamespace(run=SimpleNamespace(iterations=taken))), self.end)] * len(tries)


def solve_all(x: np.ndarray, share: float | None, monkeypatch: pytest.MonkeyPatch, threads: int = 1) -> Solves:
    """Solve a case at each place, and return what was tried."""
    solver = Solves(share)
    monkeypatch.setattr(neighbours, "CaseSolver", lambda *_: solver)
    starts, given = find_starts(place(x)), cast("Any", [tuple(row) for row in x.tolist()])
    assert sorted(k for k, _ in solve_neighbours(given, starts, cast("Any", None), threads)) == list(range(len(x)))
    return solver


@pytest.mark.parametrize("count", [64, 200])
def test_cases_far_apart_give_neighbours_up_where_tries_fail(count: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Random places in seven dimensions: failures cost at most three tenths of the solves from guesses."""
    x = np.random.default_rng(1).uniform(size=(count, 7))
    solver = solve_all(x, None, monkeypatch)
    assert 1 <= len(solver.tried) <= 3 * count // 10
    assert solver.iterations <= 1.3 * ALONE * count


def test_tries_that_save_are_kept_and_depend_on_the_set_of_cases_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """All but the first one of a line try; neither threads nor the order decide which, where some fail."""
    line = np.linspace(0, 1, 65)[:, None]
    assert len(solve_all(line, 0.25, monkeypatch).tried) == 64
    x = np.random.default_rng(2).uniform(size=(100, 2))
    first = solve_all(x, None, monkeypatch).tried
    assert 0 < len(first) < 99
    for threads in (1, 2):
        assert solve_all(x[::-1], None, monkeypatch, threads).tried == first


def test_blocks_hold_no_sources_of_theirs_and_shrink_where_cases_take_long() -> None:
    """A block is over before anybody hears of it."""
    starts = find_starts(place(np.linspace(0, 1, 200)[:, None]))
    blocks = list(split(starts, Pace(1)))
    assert [start for block in blocks for start in block] == list(starts)
    assert [len(block) for block in blocks[:5]] == [1, 1, 2, 4, 8]
    assert max(map(len, blocks)) == BLOCK
    for block in blocks:
        assert not {start.case for start in block} & {source.case for start in block for source in start.sources}
    pace, sizes = Pace(3), list[int]()
    for block in split(starts, pace):
        sizes.append(len(block))
        pace.learn(SECONDS * len(block), len(block))
    assert max(sizes) == 3
    pace.learn(SECONDS, 10)
    assert pace.most == 10
    pace.learn(9.0, 0)
    assert pace.most == 10


def test_vectors_have_one_scale_of_distance() -> None:
    """A flat range of a vector is no far one; separate keys each have their range."""
    x = [(a, b) for a in (0.0, 1.0) for b in (0.0, 0.01, 0.02)]
    apart = find_starts([Place("a", own, (0, 1)) for own in x])
    joined = find_starts([Place("a", own, (0, 0)) for own in x])
    assert {start.case for start in joined[:2]} in ({k, j} for k in range(3) for j in range(3, 6))
    assert max(start.distance for start in joined[2:]) < 0.05
    assert max(start.distance for start in apart[2:]) > 0.4


def test_a_mixture_has_the_same_bits_whatever_is_mixed_beside() -> None:
    """Sums go from the nearest source on."""
    rng, guess = np.random.default_rng(3), cast("Guess", object())
    points = rng.standard_normal((6, 4, 5)) * 10.0 ** rng.integers(-6, 6, (6, 1, 1))
    own = [Neighbour(guess, x[0], Near(b"", Point(*x)), None, 1.0) for x in points]
    origins = {k: Origin(one, 10) for k, one in enumerate(own)}
    starts = [
        Start(6 + i, tuple(Source(k, (0.1 * (i + 1) * (n + 1), 0.3 * k)) for n, k in enumerate(order)))
        for i, order in enumerate(([3, 1, 5, 0], [5, 4, 3, 2, 1, 0], [0, 3]))
    ]
    together = neighbours.gather_all(starts, origins)
    for start, one in zip(starts, together, strict=True):
        alone = gather(start, origins)
        assert one is not None
        assert alone is not None
        assert one.neighbour is not None
        assert alone.neighbour is not None
        for a, b in zip(one.neighbour.near.point.parts, alone.neighbour.near.point.parts, strict=True):
            assert np.array_equal(a, b)
