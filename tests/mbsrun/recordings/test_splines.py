"""Splines of samples: exact where they can be, honest about gaps, and as smooth as the noise permits."""

from __future__ import annotations

import numpy as np
import pytest

from mbsrun.recordings import SplineError, Treatment, fit, fit_all, stack
from mbsrun.recordings.references import Reference, evaluate
from mbsrun.recordings.splines import count_gaps

T = np.linspace(0.0, 2.0, 41)


@pytest.mark.parametrize("degree", [3, 5])
def test_polynomials_are_met_with_their_derivatives(degree: int) -> None:
    """A spline of degree d through samples of a polynomial of degree d is this polynomial."""
    p = np.polynomial.Polynomial([1, -2, 0.5, 0.3, -0.1, 0.2][: degree + 1])
    track, t = fit(T, p(T), Treatment(degree)), np.linspace(0, 2, 300)
    for order in range(3):
        expected = (p.deriv(order) if order else p)(t)
        np.testing.assert_allclose(track.evaluate(t, order), expected, atol=1e-9)


def test_a_short_gap_is_bridged_and_a_long_one_stays_open() -> None:
    y = np.sin(T)
    y[[10, 20, 21, 22, 23, 24, 25]] = np.nan
    treatment = Treatment(gap=0.1)
    track = fit(T, y, treatment)
    assert track.gaps == ((T[19], T[26]),)
    assert track.list_unknown(0, 3) == ((T[19], T[26]), (2.0, 3.0))
    assert count_gaps(T, y, treatment) == (1, 1)
    t = np.array([-0.1, 0.5, 1.0, 1.1, 1.3, 2.0, 2.1])
    assert track.is_known(t).tolist() == [False, True, False, False, True, True, False]
    values = track.evaluate(t)
    np.testing.assert_array_equal(np.isfinite(values), track.is_known(t))
    assert values[1] == pytest.approx(np.sin(0.5), abs=1e-6)
    assert fit(T, y, Treatment(gap=0.36)).gaps == ()


def test_missing_rows_are_a_gap_too_and_coarse_samples_are_none() -> None:
    few = np.delete(T, np.arange(20, 30))
    assert fit(few, np.sin(few), Treatment(gap=0.1)).gaps == ((T[19], T[30]),)
    coarse = np.arange(10.0)
    assert fit(coarse, coarse, Treatment(gap=0.1)).gaps == ()


def test_lonely_samples_are_left_out() -> None:
    y = np.full(41, np.nan)
    y[[0, 20, 21, 22]] = 0.0, 0.0, 1.0, 2.0
    (piece,) = fit(T, y, Treatment()).pieces
    assert (piece.start, piece.end, piece.degree) == (T[20], T[22], 1)
    assert fit(T, np.full(41, np.nan), Treatment()).pieces == ()


@pytest.mark.parametrize("treatment", [Treatment(noise=0.02), Treatment(cutoff=2.0)], ids=["noise", "filter"])
def test_noise_is_smoothed(treatment: Treatment, rng: np.random.Generator) -> None:
    """The rest has the standard deviation of the noise, and accelerations err far less than without."""
    t = np.linspace(0, 4, 401)
    y = np.sin(t) + 0.02 * rng.standard_normal(t.size)
    track, plain = fit(t, y, treatment), fit(t, y, Treatment())
    assert np.std(y - track.evaluate(t)) == pytest.approx(0.02, rel=0.15)
    middle = t[100:-100]
    errors = [np.abs(x.evaluate(middle, 2) + np.sin(middle)).max() for x in (track, plain)]
    assert errors[0] < 0.01 * errors[1]


def test_a_filter_halves_the_power_at_its_cut_off() -> None:
    t = np.linspace(0, 20, 2001)
    track = fit(t, np.sin(2 * np.pi * 3 * t), Treatment(cutoff=3.0))
    middle = t[500:-500]
    assert np.sqrt(2) * np.std(track.evaluate(middle)) == pytest.approx(np.sqrt(0.5), rel=1e-2)


def test_what_no_filter_takes() -> None:
    for t, cutoff, word in ((T**2, 2.0, "even steps"), (T, 9.0, "cut-off of 9 Hz"), (T[:5], 2.0, "5 samples")):
        with pytest.raises(SplineError, match=word):
            fit(t, np.sin(t), Treatment(cutoff=cutoff))


def test_normalised_references_span_the_recording_from_their_start_to_their_end() -> None:
    """The parts 0, 1/2 and 1 of any horizon are 0.2, 0.3 and 0.4 s of the recording; of x = t these are its values."""
    times = np.linspace(0.0, 1.0, 21)
    walk = Reference("walk", (("x", fit(times, times, Treatment())),), 0.2, 0.4, is_normalised=True)
    found = evaluate("ref_walk_x", [walk], np.array([0.0, 0.5, 1.0]), None)
    assert found == pytest.approx([0.2, 0.3, 0.4], abs=1e-12)


@pytest.mark.parametrize("treatment", [Treatment(), Treatment(gap=0.3), Treatment(cutoff=6.0), Treatment(noise=0.01)])
@pytest.mark.parametrize("gaps", [(), (7,), (20, 21, 22, 23)])
def test_many_columns_are_fitted_as_each_one_alone(
    treatment: Treatment, gaps: tuple[int, ...], rng: np.random.Generator
) -> None:
    """Columns with and without gaps, and their values and rates side by side; unknown ones stay so."""
    values = np.sin(3 * T)[:, None] * [1.0, 2.0, 0.5] + 0.01 * rng.normal(size=(len(T), 3))
    values[list(gaps), 1] = np.nan
    together, times = fit_all(T, values, treatment), np.linspace(-0.1, 2.1, 60)
    for order in range(3):
        expected = np.stack([fit(T, column, treatment).evaluate(times, order) for column in values.T], axis=1)
        for some in ([0, 1, 2], [0, 2]):
            found = stack([together[k] for k in some], times, order)
            np.testing.assert_allclose(found, expected[:, some], rtol=1e-9, atol=1e-9)
    assert fit_all(T, values[:, :0], treatment) == []
