"""Added states along a motion that is known: linear equations with closed forms, in steps of any length."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from mbsrun.ocp.solving.riding import Riders

Array = NDArray[np.float64]
STARTS = np.array([[1.0, -2.0], [0.5, 3.0]])


def span(begin: float, end: float, steps: int) -> Any:
    """Stand in for the motion x = sin 3t in some steps; intervals count time from their own start."""
    return SimpleNamespace(
        chunks=[SimpleNamespace(t=np.linspace(begin, end, steps + 1))], read=lambda t: np.sin(3 * t)[:, None]
    )


def gather(intervals: Array, times: Array, states: Array) -> dict[str, Array]:
    return {"interval": np.asarray(intervals, dtype=float)[:, None], "t": times[:, None], "x": states}


def solve(rate: float, start: Array, t: Array, begin: float) -> Array:
    """Solve s' = -rate s + sin 3t from a start at `begin`, by hand."""
    forced = (rate * np.sin(3 * t) - 3 * np.cos(3 * t)) / (rate**2 + 9)
    first = (rate * np.sin(3 * begin) - 3 * np.cos(3 * begin)) / (rate**2 + 9)
    return np.asarray(forced + np.exp(-rate * (t - begin)) * (start - first))


@pytest.mark.parametrize(("rate", "steps"), [(0.5, 1), (2.0, 7), (10.0, 20), (-3.0, 12)])
def test_states_follow_their_equations_through_intervals_of_their_own(rate: float, steps: int) -> None:
    """Ends, and states between the ends of steps; a step that is too long for fast rates is halved."""
    rates = np.array([rate, rate / 2])
    riders = Riders(gather, lambda parts: -rates * parts["states"] + parts["x"])
    ride = riders.ride([2, 5], [span(0.0, 1.0, steps), span(1.0, 1.5, 2 * steps)], STARTS)
    times = np.array([0.0, 0.13, 0.999, 1.0, 1.21, 1.5])
    intervals = np.array([2, 2, 2, 5, 5, 5])
    begins = np.array([0.0, 0.0, 0.0, 1.0, 1.0, 1.0])
    found = ride.read(intervals, times)
    for k, t in enumerate(times):
        expected = solve(rates, STARTS[int(intervals[k] == 5)], t, begins[k])
        assert found[k] == pytest.approx(expected, rel=1e-12, abs=1e-12)
    for row, (start, begin, end) in enumerate(((STARTS[0], 0.0, 1.0), (STARTS[1], 1.0, 1.5))):
        assert ride.ends[row] == pytest.approx(solve(rates, start, np.array(end), begin), rel=1e-12, abs=1e-12)
    assert ride.edges[0, 0] == 0.0
    assert ride.edges[-1, 1] == 1.5


def test_rates_know_their_interval_and_their_time_in_it() -> None:
    """s' = interval + time since its start."""
    riders = Riders(gather, lambda parts: parts["interval"] + parts["t"])
    ride = riders.ride([2, 5], [span(0.0, 1.0, 3), span(1.0, 1.5, 3)], STARTS[:, :1])
    assert ride.ends[:, 0] == pytest.approx([1 + 2 + 0.5, 0.5 + 5 * 0.5 + 0.125], rel=1e-14)


def test_few_steps_are_joined_and_only_the_long_ones_are_halved() -> None:
    """Six steps of the mechanism are one where rates are smooth; a rough interval costs the other nothing."""
    smooth = Riders(gather, lambda parts: 0 * parts["states"] + 1)
    ride = smooth.ride([0], [span(0.0, 1.0, 13)], STARTS[:1])
    assert ride.edges[:, 1] == pytest.approx([6 / 13, 12 / 13, 1.0])
    rough = Riders(gather, lambda parts: np.where(parts["interval"] == 5, -60.0, -0.1) * parts["states"])
    ride = rough.ride([2, 5], [span(0.0, 1.0, 6), span(1.0, 2.0, 6)], STARTS)
    assert (ride.owners == 0).sum() == 1
    assert (ride.owners == 1).sum() > 4
    assert ride.ends == pytest.approx(STARTS * np.exp([[-0.1], [-60.0]]), rel=1e-10, abs=1e-13)
