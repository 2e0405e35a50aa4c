"""Decisions of recordings by hand: means of samples, gaps, filters, cells of tables, and fits of one frame."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from mbsgen.errors import InputError
from mbsrun.recordings import Treatment, fit
from mbsrun.recordings.c3d import _MOMENTS, _average, _name_plate
from mbsrun.recordings.fitting import (
    Fitter,
    Targets,
    _is_near,
    find_undetermined,
    second_differences,
    solve_step,
)
from mbsrun.recordings.recording import UNITS
from mbsrun.recordings.splines import PASSES, SplineError, Track, count_gaps, low_pass, stack
from mbsrun.recordings.tables import read_table

Array = NDArray[np.float64]


@pytest.mark.parametrize("count", [1, 2, 3, 4])
def test_a_frame_has_the_mean_of_its_samples(count: int) -> None:
    """From half a frame before it to half a frame after; of an even number, both ends count half."""
    frames, half = 5, count // 2
    x = np.random.default_rng(count).normal(size=(3, frames * count))
    padded = np.concatenate((np.repeat(x[:, :1], half, 1), x, np.repeat(x[:, -1:], half, 1)), axis=1)
    weights = np.ones(2 * half + 1)
    if count % 2 == 0:
        weights[0] = weights[-1] = 0.5
    expected = [padded[:, k * count : k * count + 2 * half + 1] @ weights / weights.sum() for k in range(frames)]
    assert _average(x, frames) == pytest.approx(np.array(expected), abs=1e-14)
    assert _average(np.ones((3, frames * count)), frames) == pytest.approx(np.ones((frames, 3)))


def test_plates_have_names_and_units() -> None:
    assert _name_plate(2) == ("ground_force_2_v", "ground_moment_2_m", "ground_force_2_p")
    assert {unit: _MOMENTS[unit] for unit in ("Nmm", "N mm", "N.mm", "Nm", "N m", "N.m")} == _MOMENTS
    assert sorted(_MOMENTS.values()) == [1e-3] * 3 + [1.0] * 3


def test_gaps_are_bridged_up_to_their_length_and_to_one_and_a_half_steps() -> None:
    t = np.array([0.0, 0.1, 0.2, 0.35, 0.45, 0.61, 0.71, 0.81])
    for gap, pieces in ((0.05, 2), (0.159, 2), (0.16, 1)):
        assert len(fit(t, t, Treatment(gap=gap)).pieces) == pieces
        assert count_gaps(t, t, Treatment(gap=gap)) == ((0, 1) if pieces == 2 else (1, 0))
    every = np.where(np.arange(8) == 4, np.nan, t)
    assert count_gaps(t, every, Treatment(gap=0.05)) == (0, 1)
    assert count_gaps(t, every, Treatment(gap=0.5)) == (1, 0)


@pytest.mark.parametrize(("count", "degree"), [(2, 1), (3, 1), (4, 3), (5, 3), (6, 5), (7, 5)])
def test_short_pieces_have_a_lower_odd_degree(count: int, degree: int) -> None:
    t = np.linspace(0, 1, count)
    (piece,) = fit(t, t, Treatment(gap=2.0)).pieces
    assert piece.degree == degree
    (smoothed,) = fit(t, t, Treatment(gap=2.0, noise=0.1)).pieces
    assert Track((smoothed,)).evaluate(t) == pytest.approx(t, abs=0.11 * np.sqrt(count))


def test_tracks_are_known_to_a_billionth_beyond_their_ends() -> None:
    t = np.linspace(2.0, 4.0, 9)
    track = fit(t, t**2, Treatment(gap=1.0))
    times = np.array([2 - 2.1e-9, 2 - 1.9e-9, 3.0, 4 + 1.9e-9, 4 + 2.1e-9])
    assert track.is_known(times).tolist() == [False, True, True, True, False]
    assert np.isfinite(track.evaluate(times)).tolist() == [False, True, True, True, False]
    assert track.evaluate(np.array([3.0]), 2) == pytest.approx([2.0])
    assert track.list_unknown(0.0, 5.0) == ((0.0, 2.0), (4.0, 5.0))
    assert track.list_unknown(2.0, 4.0) == ()
    assert track.list_unknown(0.0, 1.0) == ((0.0, 1.0),)
    assert track.list_unknown(4.5, 5.0) == ((4.5, 5.0),)
    two = fit(np.array([0.0, 1, 2, 6, 7, 8]), np.arange(6.0), Treatment(gap=1.0))
    assert two.list_unknown(1.0, 7.0) == ((2.0, 6.0),)
    assert two.list_unknown(3.0, 5.0) == ((3.0, 5.0),)
    assert stack([track, track], np.array([3.0])) == pytest.approx(np.array([[9.0, 9.0]]))
    assert stack([], np.array([3.0, 4.0])).shape == (2, 0)


def test_filters_need_even_steps_ten_samples_and_a_cut_off_below_half_the_rate() -> None:
    """To 1e-3 of a step; both passes together halve the power at the cut-off."""
    assert pytest.approx((np.sqrt(2) - 1) ** 0.25) == PASSES
    t = np.arange(10) * 0.1
    low_pass(t, t, 0.999 * 5 * PASSES)
    for times, cutoff in ((t[:9], 1.0), (t, 5 * PASSES)):
        with pytest.raises(SplineError, match="does not suit"):
            low_pass(times, times, cutoff)
    for off, is_even in ((0.9e-4, True), (1.2e-4, False)):
        moved = t.copy()
        moved[-1] += off
        if is_even:
            low_pass(moved, moved, 1.0)
        else:
            with pytest.raises(SplineError, match="even steps"):
                low_pass(moved, moved, 1.0)


def read(text: str, folder: Path) -> Any:
    (folder / "table.csv").write_text(text, "utf-8")
    return read_table(folder / "table.csv")


def test_the_column_of_times_is_in_s_or_ms(tmp_path: Path) -> None:
    for unit, factor in (("", 1.0), (" [s]", 1.0), (" [ms]", 1e-3)):
        found = read(f"x,Time{unit}\n5,0\n6,500\n\n,\n7,1000\n", tmp_path)
        assert found.times.tolist() == pytest.approx([0.0, 500 * factor, 1000 * factor])
        assert ([c.name for c in found.columns], found.values.tolist()) == (["x"], [[5.0], [6.0], [7.0]])
    with pytest.raises(InputError, match=r'column 2: the time is in "?deg'):
        read("x,t [deg]\n5,0\n", tmp_path)
    with pytest.raises(InputError, match='found "a", "b", "c", "d", "e";'):
        read("a,b,c,d,e,f\n1,2,3,4,5,6\n", tmp_path)
    found = read("# a note\nt;x\n0;1.5\n1;2\n", tmp_path)
    assert found.values.tolist() == [[1.5], [2.0]]


def test_units_are_products_of_their_parts() -> None:
    """A prefix is a power of ten; a turn of 360 degrees is 2 pi."""
    parts = {
        **dict.fromkeys(("s", "m", "rad", "N"), 1.0),
        **{"ms": 1e-3, "mm": 1e-3, "cm": 1e-2, "kN": 1e3},
        **dict.fromkeys(("deg", "°"), 2 * np.pi / 360),
    }
    plain = {"ms": "s", "mm": "m", "cm": "m", "kN": "N", "deg": "rad", "°": "rad"}
    for unit, (name, factor) in UNITS.items():
        top, _, bottom = unit.partition("/")
        assert bottom in ("", "s", "s^2")
        assert factor == pytest.approx(np.prod([parts[x] for x in top.split()]), rel=1e-15)
        told = " ".join(plain.get(x, x) for x in top.split())
        assert name == (f"{told}/{bottom}" if bottom else told)


def test_names_have_up_to_200_characters_and_times_a_billionth_between_them(tmp_path: Path) -> None:
    assert read(f"t,{'y' * 200}\n0,1\n1,2\n", tmp_path).columns[0].name == "y" * 200
    assert read("t,y\n0,1\n1.1e-9,2\n", tmp_path).times.tolist() == [0.0, 1.1e-9]
    with pytest.raises(InputError, match="1e-09 apart at least"):
        read("t,y\n0,1\n0.9e-9,2\n", tmp_path)


# --- fits -----------------------------------------------------------------------------------------------------------


def test_second_differences_are_second_derivatives_of_parabolas() -> None:
    t = np.array([0.0, 0.3, 0.4, 1.0, 1.1])
    assert second_differences(t) @ (3 * t**2 - t + 1) == pytest.approx(np.full(3, 6.0))


def test_coordinates_that_nothing_sees_are_undetermined() -> None:
    """A direction counts up to 1e-7 of the largest one, and moves a coordinate from 1e-6 on."""
    none = np.zeros((0, 3))
    assert find_undetermined(np.array([[2.0, 0, 0]]), none).tolist() == [False, True, True]
    assert find_undetermined(np.array([[2.0, 0, 0]]), np.array([[0, 3.0, 0]])).tolist() == [False, False, True]
    assert find_undetermined(np.zeros((1, 3)), none).tolist() == [True] * 3
    for size, is_open in ((0.9e-7, True), (1.1e-7, False)):
        assert find_undetermined(np.diag([5.0, 5.0, 5 * size]), none).tolist() == [False, False, is_open]
    for lean, is_open in ((0.9e-6, False), (1.1e-6, True)):
        J = np.array([[1.0, -lean, 0], [0, 0, 1.0]])
        assert find_undetermined(J, none).tolist() == [is_open, True, False]


def test_a_limit_is_near_to_rounding() -> None:
    q, limit = np.array([2.0, 2.0, 2.0, -1.0]), np.array([2 + 2.9e-12, 2 + 3.1e-12, np.inf, -1.0])
    assert _is_near(q, limit).tolist() == [True, False, False, True]


@pytest.mark.parametrize(
    ("lower", "upper", "x"),
    [(-9.0, 9.0, (1.0, 2.0)), (-9.0, 1.5, (1.0, 1.5)), (1.25, 9.0, (1.25, 2.0)), (0.0, 0.5, (0.5, 0.5))],
)
def test_steps_are_least_within_their_limits(lower: float, upper: float, x: tuple[float, float]) -> None:
    """Minimise |d - (1, 2)|^2/2 in a box."""
    A, g, none = np.eye(2), -np.array([1.0, 2.0]), np.zeros((0, 2))
    step, _ = solve_step(A, g, none, np.zeros(0), np.full(2, lower), np.full(2, upper))
    assert step == pytest.approx(x, abs=1e-9)


def test_steps_close_constraints() -> None:
    """Of d with d_1 + d_2 = 1 nearest to (1, 2): (0, 1), with the multiplier 1; within d_1 >= 0.25: (0.25, 0.75)."""
    A, g, H, h = np.eye(2), -np.array([1.0, 2.0]), np.ones((1, 2)), np.array([-1.0])
    step, multipliers = solve_step(A, g, H, h, np.full(2, -9.0), np.full(2, 9.0))
    assert step == pytest.approx([0.0, 1.0], abs=1e-9)
    assert np.abs(multipliers) == pytest.approx([1.0], abs=1e-9)
    step, _ = solve_step(A, g, H, h, np.array([0.25, -9.0]), np.full(2, 9.0))
    assert step == pytest.approx([0.25, 0.75], abs=1e-8)


class Rail:
    """Kernels of two markers, at q and at 3 q along x and y."""

    manifest = SimpleNamespace(
        loops=(), quaternions=(), positions=("s",), pose=(), configuration=(),
        coordinates=(SimpleNamespace(name="s", lower=None, upper=None),),
    )  # fmt: skip

    def __call__(self, name: str, q: Array) -> dict[str, Array]:
        x = np.atleast_2d(q)[:, 0]
        if name == "sensors":
            p = np.zeros((len(x), 3, 2))
            p[:, 0, 0], p[:, 1, 1] = x, 3 * x
            return {"position": p if q.ndim == 2 else p[0]}
        J = np.zeros((len(x), 6, 1))
        J[:, 0], J[:, 4] = 1.0, 3.0
        return {"jac_position_q": J if q.ndim == 2 else J[0]}


def aim(markers: list[Any], values: list[float], **given: Any) -> Fitter:
    places = np.array(markers, dtype=np.float64)
    targets = Targets(np.arange(len(places), dtype=float), (0, 1), places, np.array([1.0, 4.0]), (0,),
                      np.array(values)[:, None], np.array([given.pop("weight", 0.5)]))  # fmt: skip
    kernels: Any = Rail()
    return Fitter(kernels, targets)


def test_a_frame_is_the_weighted_mean_of_its_markers_and_coordinates() -> None:
    """Minimise (s - 1)^2 + 4 (3 s - 6)^2 + (s - 3)^2/2 halved: s = (1 + 72 + 1.5)/37.5; gaps are left out."""
    seen, gap = [[1.0, 0, 0], [0, 6.0, 0]], [np.nan] * 3
    fitter = aim([seen, [seen[0], gap], [gap, seen[1]], [gap, gap]], [3.0, 3.0, np.nan, 7.0])
    found = fitter.fit()
    assert found.q[:, 0] == pytest.approx([74.5 / 37.5, 2.5 / 1.5, 2.0, 7.0], abs=1e-8)
    assert found.converged.all()
    assert found.errors[0] == pytest.approx([74.5 / 37.5 - 1, abs(3 * 74.5 / 37.5 - 6)], abs=1e-7)
    assert np.isnan(found.errors[1]).tolist() == [False, True]
    assert found.deviations[[0, 1, 3], 0] == pytest.approx([74.5 / 37.5 - 3, 2.5 / 1.5 - 3, 0.0], abs=1e-8)
    assert not found.is_undetermined.any()
    assert not found.at_limits.any()
    assert found.iterations == fitter.iterations
    sums = fitter.evaluate(0, np.array([2.0]))
    assert sums.cost == pytest.approx(0.5 * (1 + 0.5))


def test_coordinates_alone_are_fitted_without_markers() -> None:
    """No marker leaves no error of one; the pose is the recorded one, one by one and all together."""
    targets = Targets(np.arange(3.0), (), np.zeros((3, 0, 3)), np.zeros(0), (0,), np.array([[1.0], [2.0], [np.nan]]),
                      np.array([0.5]))  # fmt: skip
    kernels: Any = Rail()
    found = Fitter(kernels, targets).fit()
    assert found.q[:, 0] == pytest.approx([1.0, 2.0, 2.0], abs=1e-9)
    assert found.errors.shape == (3, 0)
    assert found.is_undetermined[:, 0].tolist() == [False, False, True]


def test_frames_are_fitted_from_the_one_that_is_known_best_to_both_sides() -> None:
    seen, gap = [[1.0, 0, 0], [0, 3.0, 0]], [np.nan] * 3
    fitter = aim([[seen[0], gap], [seen[0], gap], seen, [seen[0], gap]], [np.nan] * 4)
    order: list[int] = []
    starts: list[float] = []
    fitter.start = lambda k: (order.append(k), (np.array([10.0 + k]), True))[1]  # type: ignore[method-assign,func-returns-value,return-value]

    def solve(k: int, q: Array) -> tuple[Array, bool]:
        order.append(k)
        starts.append(float(q[0]))
        return np.array([10.0 + k]), k != 0

    fitter.solve = solve  # type: ignore[method-assign]
    shown: list[tuple[int, int]] = []
    found = fitter.fit(report=lambda _, done, count: shown.append((done, count)))
    assert (order, starts) == ([2, 3, 1, 0], [12.0, 12.0, 11.0])
    assert shown == [(2, 4), (3, 4), (4, 4)]
    assert found.converged.tolist() == [False, True, True, True]


def test_smoothness_makes_neighbours_alike() -> None:
    """Minimise the sum of (s_k - y_k)^2/2 and S |D s|^2/2: (1 + S D'D) s = y; it takes three frames at least."""
    y = [0.0, 1.0, 0.0, 2.0, 0.0]
    fitter = aim([[[np.nan] * 3] * 2] * 5, y, weight=1.0)
    found = fitter.fit(0.5)
    D = np.diff(np.eye(5), 2, axis=0)
    assert found.q[:, 0] == pytest.approx(np.linalg.solve(np.eye(5) + 0.5 * D.T @ D, y), abs=1e-7)
    two = aim([[[np.nan] * 3] * 2] * 2, y[:2], weight=1.0).fit(0.5)
    assert two.q[:, 0] == pytest.approx(y[:2], abs=1e-8)
