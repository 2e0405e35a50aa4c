"""Decisions of fits by hand: the steps of iterations, and an interior point's Newton step by one matrix."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import sparse

from mbsrun.recordings import fitting
from mbsrun.recordings.fitting import Fitter, Targets, _solve_inside, _solve_kkt, _Sums, solve_step

Array = NDArray[np.float64]


def make_fitter(
    limits: Sequence[tuple[float | None, float | None]],
    frames: int = 1,
    quaternions: tuple[int, ...] = (),
    **given: Any,
) -> Fitter:
    """Make a fitter of coordinates with limits; what evaluates them is the test's own."""
    names = tuple(f"q{k}" for k in range(len(limits)))
    found = [SimpleNamespace(name=name, lower=a, upper=b) for name, (a, b) in zip(names, limits, strict=True)]
    manifest = SimpleNamespace(
        loops=(), positions=names, coordinates=found, quaternions=quaternions, pose=given.get("pose", ())
    )
    none = np.zeros((frames, 0))
    targets = Targets(np.arange(float(frames)), (), np.zeros((frames, 0, 3)), np.zeros(0), (), none, np.zeros(0))
    kernels: Any = SimpleNamespace(manifest=manifest)
    return Fitter(kernels, targets)


def sums(cost: float, gap: Sequence[float] = (), J: Sequence[Sequence[float]] = ((1.0,),)) -> _Sums:
    """Residuals of a given half sum of squares, with gaps of constraints."""
    slopes = np.array(J)
    r = np.zeros(len(slopes))
    r[0] = np.sqrt(2 * cost)
    return _Sums(r, slopes, np.array(gap), np.ones((len(gap), slopes.shape[1])))


class Script:
    """Steps, and what is found after each; notes the programs of the steps."""

    def __init__(self, steps: Sequence[Any], multipliers: Sequence[float] = (0.0,)) -> None:
        self.steps, self.multipliers, self.programs = list(steps), np.array(multipliers), list[tuple[Any, ...]]()

    def __call__(self, *program: Any) -> tuple[Array, Array]:
        self.programs.append(program)
        return np.atleast_1d(self.steps[min(len(self.programs), len(self.steps)) - 1]), self.multipliers


def follow(
    monkeypatch: pytest.MonkeyPatch, found: Sequence[_Sums], script: Script, together: int = 0, start: float = 3.0
) -> tuple[Fitter, float, bool, list[float]]:
    """Run the iteration of a frame, or of `together` equal frames; return the pose, and all places."""
    fitter = make_fitter([(-100.0, 100.0)], max(together, 1))
    places: list[float] = []

    def evaluate(_: int, q: Array) -> _Sums:
        places.append(float(q[0]))
        return found[min(len(places), len(found)) - 1]

    def evaluate_all(q: Array) -> list[_Sums]:
        return [evaluate(0, q[0])] * together

    fitter.evaluate, fitter.evaluate_all = evaluate, evaluate_all  # type: ignore[method-assign,assignment]
    monkeypatch.setattr(fitting, "solve_step", script)
    if together:
        q, is_done = fitter.solve_all(np.full((together, 1), start), 0.0)
        return fitter, float(q[0, 0]), is_done, places
    pose, is_done = fitter.solve(0, np.array([start]))
    return fitter, float(pose[0]), is_done, places


def damp(programs: Sequence[tuple[Any, ...]]) -> list[float]:
    """Return the damping of each step, where J has length 0: it is relative to 1e-12 then."""
    return [float(program[0][0, 0]) / 1e-12 for program in programs]


FLAT = ((0.0,),)


@pytest.mark.parametrize("together", [0, 1, 3])
def test_damping_grows_where_a_step_fails_and_shrinks_to_its_least(
    monkeypatch: pytest.MonkeyPatch, together: int
) -> None:
    """Ten times each; a step that fails is forgotten, one of length 0 ends the iteration."""
    costs = [2.0, 2.5, 2.5, 1.5, 1.0, 0.5, 0.5]
    script = Script([1.0, 1.0, 1.0, 1.0, 1.0, 0.0])
    fitter, q, is_done, places = follow(monkeypatch, [sums(c, J=FLAT) for c in costs], script, together)
    assert (q, is_done) == (6.0, True)
    assert places == [3.0, 4.0, 4.0, 4.0, 5.0, 6.0, 6.0]
    assert damp(script.programs) == pytest.approx([1e-9, 1e-8, 1e-7, 1e-8, 1e-9, 1e-9], rel=1e-12)
    assert [float(program[4][0]) for program in script.programs] == [-103.0] * 3 + [-104.0, -105.0, -106.0]
    assert [float(program[5][0]) for program in script.programs] == [97.0] * 3 + [96.0, 95.0, 94.0]
    assert fitter.iterations == 6 * max(together, 1)


@pytest.mark.parametrize("together", [0, 2])
@pytest.mark.parametrize(("part", "is_taken"), [(1 - 1e-9, True), (1 + 1e-9, False)])
def test_a_step_may_raise_the_sum_by_what_gaps_lose(
    monkeypatch: pytest.MonkeyPatch, together: int, part: float, is_taken: bool
) -> None:
    """Times twice the largest multiplier and the mean of A's diagonal: 2 1.5 + 1, of gaps of 0.75 in all, then 0.5."""
    first, second = sums(2.0, (0.5, -0.25)), sums(2.0 + part * 1.0, (0.25, -0.25))
    script = Script([1.0, 0.0], (0.5, -1.5))
    _, q, is_done, _ = follow(monkeypatch, [first, second], script, together)
    assert (q, is_done) == (4.0 if is_taken else 3.0, True)
    assert float(script.programs[0][2].sum()) == 2 * max(together, 1)
    assert np.abs(script.programs[0][3]).sum() == 0.75 * max(together, 1)
    assert script.programs[0][1] == pytest.approx([2.0] * max(together, 1))


@pytest.mark.parametrize("together", [0, 2])
def test_multipliers_of_0_leave_the_scale_as_the_weight_of_gaps(monkeypatch: pytest.MonkeyPatch, together: int) -> None:
    for part, q in ((1 - 1e-9, 4.0), (1 + 1e-9, 3.0)):
        found = [sums(2.0, (0.5,)), sums(2.0 + 0.5 * part, (0.0,))]
        assert follow(monkeypatch, found, Script([1.0, 0.0], (0.0,)), together)[1] == q


@pytest.mark.parametrize("together", [0, 2])
@pytest.mark.parametrize(("rise", "is_taken"), [(0.9e-12, True), (1.1e-12, False)])
def test_a_rise_of_rounding_is_none(
    monkeypatch: pytest.MonkeyPatch, together: int, rise: float, is_taken: bool
) -> None:
    found = [sums(2.0), sums(2.0 * (1 + rise))]
    assert follow(monkeypatch, found, Script([1.0, 0.0]), together)[1] == (4.0 if is_taken else 3.0)


@pytest.mark.parametrize("together", [0, 2])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_short_step_ends_the_iteration(monkeypatch: pytest.MonkeyPatch, together: int, sign: float) -> None:
    """Relative to 1 + |q|, here 4 and below 1: 1e-10, whether the sum rises or not."""
    for start, whole in ((3.0, 4.0), (-3.0, 4.0), (0.0, 1.0)):
        for part, is_short in ((0.9e-10, True), (1.1e-10, False)):
            script = Script([sign * part * whole, 0.0])
            _, q, is_done, _ = follow(monkeypatch, [sums(2.0), sums(3.0)], script, together, start)
            assert is_done
            assert (q != start) == is_short
            assert len(script.programs) == (1 if is_short else 2)


@pytest.mark.parametrize("together", [0, 2])
@pytest.mark.parametrize(("count", "is_done"), [(9, True), (10, True), (11, False)])
def test_a_short_step_by_strong_damping_is_no_result(
    monkeypatch: pytest.MonkeyPatch, together: int, count: int, is_done: bool
) -> None:
    """From mu = 1 on, after the step that ends."""
    monkeypatch.setattr(fitting, "DAMPING", 0.5e-9)
    script = Script([1.0] * count + [0.0])
    found = follow(monkeypatch, [sums(2.0)] + [sums(3.0)] * count, script, together)
    assert found[1:3] == (3.0, is_done)


@pytest.mark.parametrize("together", [0, 2])
def test_the_iteration_ends_where_damping_is_strongest(monkeypatch: pytest.MonkeyPatch, together: int) -> None:
    monkeypatch.setattr(fitting, "DAMPING", 3e-9)
    script = Script([1.0])
    found = follow(monkeypatch, [sums(2.0, J=FLAT), sums(3.0, J=FLAT)], script, together)
    assert found[1:3] == (3.0, False)
    assert damp(script.programs) == pytest.approx([3e-9 * 10**k for k in range(16)], rel=1e-12)


def test_iterations_have_a_most(monkeypatch: pytest.MonkeyPatch) -> None:
    for together, most in ((0, 200), (2, 60)):
        script = Script([0.25])
        _, q, is_done, _ = follow(monkeypatch, [sums(2.0)], script, together)
        assert (len(script.programs), q, is_done) == (most, 3.0 + most / 4, False)


def test_poses_stay_within_limits(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where they begin, and where a step leads."""
    for together in (0, 2):
        script = Script([-150.0, 0.0])
        _, q, _, places = follow(monkeypatch, [sums(2.0), sums(1.0)], script, together, start=200.0)
        assert (q, places[:2]) == (-50.0, [100.0, -50.0])
        script = Script([-250.0, 0.0])
        _, q, _, places = follow(monkeypatch, [sums(2.0), sums(1.0)], script, together, start=-200.0)
        assert (q, places[:2]) == (-100.0, [-100.0, -100.0])


def test_damping_is_relative_to_the_mean_of_the_diagonal(monkeypatch: pytest.MonkeyPatch) -> None:
    for together in (False, True):
        fitter = make_fitter([(None, None)] * 2, 1)
        here = sums(2.0, J=((2.0, 0.0),))
        fitter.evaluate = lambda *_, here=here: here  # type: ignore[method-assign]
        fitter.evaluate_all = lambda *_, here=here: [here]  # type: ignore[method-assign]
        script = Script([np.zeros(2)])
        monkeypatch.setattr(fitting, "solve_step", script)
        if together:
            assert fitter.solve_all(np.ones((1, 2)), 1.0)[1]
        else:
            assert fitter.solve(0, np.ones(2))[1]
        A = script.programs[0][0]
        A = A.toarray() if together else A
        assert np.diag(A) == pytest.approx([4.0 + 2e-9, 2e-9], rel=1e-12)
        assert A[0, 1] == A[1, 0] == 0
        assert script.programs[0][1] == pytest.approx([4.0, 0.0])


def note(shown: list[tuple[str, int, int]], *told: Any) -> None:
    """Note what is reported."""
    shown.append(told)


def test_roughness_has_its_part_in_the_sum_of_all_frames(monkeypatch: pytest.MonkeyPatch) -> None:
    """Half S (second difference)^2: 1/2 4 (1 - 2 2 + 5)^2 = 8 before, with slopes 4 2 (1, -2, 1); and 0 after."""
    for cost, is_taken in ((8 * (1 - 1e-9), True), (8 * (1 + 1e-9), False)):
        fitter = make_fitter([(None, None)], 3)
        found = [[sums(0.0)] * 3, [sums(cost / 3)] * 3]
        fitter.evaluate_all = lambda _, found=found: found.pop(0) if len(found) > 1 else found[0]  # type: ignore[method-assign,misc]
        script = Script([np.array([0.0, 1.0, 0.0]), np.zeros(3)])
        monkeypatch.setattr(fitting, "solve_step", script)
        shown: list[tuple[str, int, int]] = []
        q, is_done = fitter.solve_all(np.array([[1.0], [2.0], [5.0]]), 4.0, partial(note, shown))
        assert (q[:, 0].tolist(), is_done) == ([1.0, 3.0 if is_taken else 2.0, 5.0], True)
        A, g = script.programs[0][0].toarray(), script.programs[0][1]
        D = np.array([[1.0, -2.0, 1.0]])
        assert pytest.approx(np.eye(3) + 4 * D.T @ D, abs=1e-7) == A
        assert g == pytest.approx([8.0, -16.0, 8.0])
        assert shown == [("fitting all frames", 0, 60), ("fitting all frames", 1, 60)]


# --- the first frame ------------------------------------------------------------------------------------------------


def gather(
    fitter: Fitter, judge: Callable[[int], tuple[float, Sequence[float], bool]]
) -> tuple[Array, bool, list[Array]]:
    """Start, where the fit of the start with a number has a cost, gaps, and an end."""
    starts: list[Array] = []

    def solve(_: int, q: Array) -> tuple[Array, bool]:
        starts.append(q)
        return np.full(q.size, float(len(starts) - 1)), judge(len(starts) - 1)[2]

    def evaluate(_: int, q: Array) -> _Sums:
        cost, gap, _ = judge(int(q[0]))
        return sums(cost, gap)

    fitter.solve, fitter.evaluate = solve, evaluate  # type: ignore[method-assign,assignment]
    return *fitter.start(0), starts


def test_starts_are_spread_over_the_limits() -> None:
    """Thirty points of Halton's sequence, after the pose: within limits, half a turn to both sides where none is."""
    fitter = make_fitter([(None, None), (-1.0, 3.0), (None, 2.0)], pose=(0.5, 0.25, 1.0))
    _, _, starts = gather(fitter, lambda _: (1.0, (), True))
    assert len(starts) == 31
    assert starts[0].tolist() == [0.5, 0.25, 1.0]
    assert starts[1] == pytest.approx([0.5 - np.pi, -1.0, 1.0 - np.pi])
    low = 1.0 - np.pi
    assert starts[2] == pytest.approx([0.5, -1 + 4 / 3, low + (2 - low) / 5])
    assert starts[3] == pytest.approx([0.5 - np.pi / 2, -1 + 8 / 3, low + (2 - low) * 2 / 5])
    turn = make_fitter([(None, None)] * 4, quaternions=(0,))
    _, _, starts = gather(turn, lambda _: (1.0, (), True))
    assert starts[0].tolist() == [0.0, 0.0, 0.0, 1.0]
    point = 2 * np.array([1 / 2, 1 / 3, 1 / 5, 1 / 7]) - 1
    assert starts[2] == pytest.approx(point / np.linalg.norm(point))


def test_the_best_start_has_no_gaps_and_the_least_sum() -> None:
    """Gaps of 1e-8 count; sums are compared to 1e-12, and the first of equal ones is taken."""
    for gap, best in ((0.9e-8, 3.0), (1.1e-8, 5.0)):
        fitter = make_fitter([(None, None)])
        judged = {k: (2.0 + abs(k - 5), (0.0, 0.0), True) for k in range(31)} | {3: (1.0, (gap, -gap), True)}
        q, is_good, _ = gather(fitter, judged.__getitem__)
        assert (q[0], is_good) == (best, True)
    costs = {4: (0.5, (), False), 7: (1.0, (), True), 9: (1 - 1e-13, (), True), 11: (1 + 1e-11, (), True)}
    q, is_good, _ = gather(make_fitter([(None, None)]), lambda k: costs.get(k, (2.0, (), True)))
    assert (q[0], is_good) == (7.0, True)
    costs[11] = (1 - 1e-11, (), True)
    assert gather(make_fitter([(None, None)]), lambda k: costs.get(k, (2.0, (), True)))[0][0] == 11.0
    q, is_good, _ = gather(make_fitter([(None, None)]), lambda k: (float((k - 2) ** 2), (), False))
    assert (q[0], is_good) == (2.0, False)


# --- quadratic programs ---------------------------------------------------------------------------------------------


def test_softened_constraints_are_one_linear_system() -> None:
    """[[A, H^T], [H, -1e-12]], of the free variables; a row without a slope has a multiplier of -right/1e-12."""
    rng = np.random.default_rng(3)
    A, H, free = np.diag([2.0, 3.0, 4.0]) + 0.5, rng.standard_normal((2, 3)), np.array([0, 2])
    H[1] = 0
    right = np.array([1.0, 2.0, 3.0, 2e-12])
    whole = np.zeros((4, 4))
    whole[:2, :2], whole[:2, 2:], whole[2:, :2] = A[np.ix_(free, free)], H[:, free].T, H[:, free]
    whole[2, 2] = whole[3, 3] = -1e-12
    expected = np.linalg.solve(whole, right)
    assert expected[3] == pytest.approx(-2.0)
    assert _solve_kkt(A, H, free, right) == pytest.approx(expected, rel=1e-10)
    assert _solve_kkt(sparse.csc_array(A), sparse.csc_array(H), free, right) == pytest.approx(expected, rel=1e-10)


def solve_newton(
    A: Array, g: Array, H: Array, h: Array, lower: Array, upper: Array, rounds: int
) -> tuple[Array, Array, Array, Array]:
    """Take steps of an interior point method by one matrix in all unknowns: d, y, and the multipliers of each limit.

    With slacks s = d - lower and t = upper - d, each step solves A d + g + H^T y - z + w = 0, H d + h = 0,
    s z = 0.1 mu and t w = 0.1 mu, linearised, and goes 0.995 of the way to the nearest limit, at most 1. It begins a
    tenth of the distance between limits inside, at most 1, nearest to 0; with multipliers of the largest slope.
    """
    n, m = g.size, h.size
    low, high = np.flatnonzero(np.isfinite(lower)), np.flatnonzero(np.isfinite(upper))
    width = upper - lower
    room = np.array([min(1.0, 0.1 * w) if np.isfinite(w) else 0.1 for w in width])
    d = np.minimum(np.maximum(0.0, lower + room), upper - room)
    z, w = np.full(low.size, np.abs(g).max()), np.full(high.size, np.abs(g).max())
    y = np.zeros(m)
    for _ in range(rounds):
        s, t = d[low] - lower[low], upper[high] - d[high]
        aim = 0.1 * (s @ z + t @ w) / (low.size + high.size)
        Z, W = np.eye(n)[:, low], np.eye(n)[:, high]
        a, b = n + m, n + m + low.size
        M = np.zeros((b + high.size, b + high.size))
        M[:n, :n], M[:n, n:a], M[:n, a:b], M[:n, b:] = A, H.T, -Z, W
        M[n:a, :n] = H
        M[a:b, :n], M[a:b, a:b] = z[:, None] * Z.T, np.diag(s)
        M[b:, :n], M[b:, b:] = -w[:, None] * W.T, np.diag(t)
        right = -np.concatenate((A @ d + g + H.T @ y - Z @ z + W @ w, H @ d + h, s * z - aim, t * w - aim))
        step = np.linalg.solve(M, right)
        x = np.concatenate((s, t, z, w))
        dx = np.concatenate((step[:n][low], -step[:n][high], step[a:b], step[b:]))
        alpha = min([1.0, *(0.995 * -x[dx < 0] / dx[dx < 0])])
        d, y, z, w = d + alpha * step[:n], y + alpha * step[n:a], z + alpha * step[a:b], w + alpha * step[b:]
    return d, y, z, w


@pytest.mark.parametrize("rounds", [0, 1, 2, 4])
@pytest.mark.parametrize("is_thin", [False, True])
def test_interior_points_take_newtons_steps(monkeypatch: pytest.MonkeyPatch, rounds: int, is_thin: bool) -> None:
    """With limits on both sides, on one, on none, far away, and beside 0."""
    rng = np.random.default_rng(rounds)
    root = rng.standard_normal((6, 6))
    A, g, H = root @ root.T + np.eye(6), 3 * rng.standard_normal(6), rng.standard_normal((2, 6))
    lower = np.array([-0.5, -np.inf, -2.0, -np.inf, -30.0, 0.0])
    upper = np.array([0.25, 0.4, np.inf, np.inf, 0.0, 5.0])
    h = -H @ np.array([0.1, 0.1, 0.5, 0.2, -1.0, 0.5])
    monkeypatch.setattr(fitting, "ROUNDS", rounds)
    a: Any = sparse.csc_array(A) if is_thin else A
    rows: Any = sparse.csc_array(H) if is_thin else H
    step, y, low, high = _solve_inside(a, g, rows, h, lower, upper)
    d, expected, z, w = solve_newton(A, g, H, h, lower, upper, rounds)
    assert step == pytest.approx(d, rel=1e-8, abs=1e-10)
    assert y == pytest.approx(expected, rel=1e-7, abs=1e-9)
    most = np.abs(g).max()
    below, above = np.flatnonzero(np.isfinite(lower)), np.flatnonzero(np.isfinite(upper))
    assert low[below].tolist() == (z > most * (d - lower)[below]).tolist()
    assert high[above].tolist() == (w > most * (upper - d)[above]).tolist()
    assert not low[[1, 3]].any()
    assert not high[[2, 3]].any()


def test_entries_between_equal_limits_stay_there(monkeypatch: pytest.MonkeyPatch) -> None:
    """To 1e-14; they count as active, and have no part in the other entries' steps but by A."""
    A, g = np.array([[2.0, 1.0], [1.0, 3.0]]), np.array([1.0, 2.0])
    for width, is_still in ((0.9e-14, True), (1e-14, True), (1.1e-14, False)):
        lower, upper = np.array([0.0, -1.0]), np.array([width, 5.0])
        monkeypatch.setattr(fitting, "ROUNDS", 0)
        step = _solve_inside(A, g, np.zeros((0, 2)), np.zeros(0), lower, upper)[0]
        assert step == pytest.approx([0.0 if is_still else 0.1 * width, 0.0], rel=1e-12, abs=0)
        monkeypatch.undo()
    step, _ = solve_step(A, g, np.zeros((0, 2)), np.zeros(0), np.array([0.0, -0.1]), np.array([0.0, 5.0]))
    assert step.tolist() == [0.0, -0.1]


def count_rounds(
    monkeypatch: pytest.MonkeyPatch, A: Array, g: Array, H: Array, h: Array, lower: Array, upper: Array
) -> tuple[int, Array, Any, Any]:
    """Return how many linear systems an interior point takes, its step, and the limits that are active."""
    count = [0]

    def solve(*given: Any) -> Array:
        count[0] += 1
        return _solve_kkt(*given)

    with monkeypatch.context() as patch:
        patch.setattr(fitting, "_solve_kkt", solve)
        step, _, low, high = _solve_inside(A, g, H, h, lower, upper)
    return count[0], step, low, high


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
def test_interior_points_end_at_their_accuracy(monkeypatch: pytest.MonkeyPatch, scale: float) -> None:
    """Complementarity becomes 1e-11 of the slopes by a tenth a step, in some 12 to 14 steps, at each scale of costs."""
    A, g = scale * np.eye(3), -scale * np.array([1.0, 2.0, -3.0])
    none, box = np.zeros((0, 3)), np.array([0.5, 4.0, 1.0])
    count, step, low, high = count_rounds(monkeypatch, A, g, none, np.zeros(0), -box, box)
    assert 12 <= count <= 14
    assert step == pytest.approx([0.5, 2.0, -1.0], abs=1e-10)
    assert np.abs(step - [0.5, 2.0, -1.0]).max() > 1e-13
    assert (low.tolist(), high.tolist()) == ([False, False, True], [True, False, False])


def test_interior_points_stop_where_no_step_meets_all_constraints(monkeypatch: pytest.MonkeyPatch) -> None:
    """d_1 + d_2 = 3 within a box of 1: they stop at its corner, after a few steps."""
    A, g, box = np.eye(2), np.array([1.0, 2.0]), np.ones(2)
    count, step, _, high = count_rounds(monkeypatch, A, g, np.ones((1, 2)), np.array([-3.0]), -box, box)
    assert count <= 20
    assert step == pytest.approx([1.0, 1.0], abs=1e-6)
    assert high.all()
    step, _ = solve_step(A, g, np.ones((1, 2)), np.array([-3.0]), -box, box)
    assert (step <= 1).all()
    assert step == pytest.approx([1.0, 1.0], abs=1e-6)
