"""Samples with gaps -> splines: values and derivatives at any time, and where they are known.

Neighbouring samples are joined where they are no farther apart than the longest gap that is bridged, or than one and a
half steps of the recording; elsewhere a new piece begins. Each piece is a spline of degree 3 or 5, through the samples;
or, with the standard deviation s of their noise, the smoothest one for which

    sum_i ((y_i - f(t_i)) / s)^2 <= K,    K the number of samples (C. Reinsch, Numerische Mathematik 10, 1967),

in the form of P. Dierckx, "Curve and surface fitting with splines", 1993, which chooses the knots. A low-pass filter
may go before: Butterworth's of order 2, forward and backward, with its cut-off raised so that both passes together
halve the power there (D. Winter, "Biomechanics and motor control of human movement", section 3.4.4).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mbsgen.errors import MbsError

if TYPE_CHECKING:
    from scipy.interpolate import BSpline

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

UNEVEN = 1e-3  # of steps, relative: a filter needs even ones
STEPS = 1.5  # of the recording: neighbours that are no farther apart have no gap between them
PASSES = (2**0.5 - 1) ** 0.25  # by which two passes lower the cut-off
ROUNDED = 1e-9  # of a piece's length
LEAST = 10  # samples that a filter needs


class SplineError(MbsError):
    """Samples that no spline, or filter, can be made of."""

    def __init__(self, finding: str, remedy: str) -> None:
        self.finding, self.remedy = finding, remedy
        super().__init__(f"{finding}; {remedy}")


@dataclass(frozen=True)
class Treatment:
    """How samples become splines."""

    degree: int = 5
    noise: float | None = None  # standard deviation, in the samples' unit; None: through the samples
    gap: float = 0.1  # the longest that is bridged [s]
    cutoff: float | None = None  # of a low-pass filter [Hz]; None: no filter


@dataclass(frozen=True)
class Piece:
    """A spline from its first knot to its last one."""

    degree: int
    knots: tuple[float, ...]
    coefficients: tuple[float, ...]

    @property
    def start(self) -> float:
        """Return the first time."""
        return self.knots[0]

    @property
    def end(self) -> float:
        """Return the last time."""
        return self.knots[-1]


@dataclass(frozen=True)
class Track:
    """One quantity over time, in pieces; unknown before, between and after them."""

    pieces: tuple[Piece, ...]

    @property
    def gaps(self) -> tuple[tuple[float, float], ...]:
        """List the gaps between pieces."""
        return tuple((a.end, b.start) for a, b in zip(self.pieces, self.pieces[1:], strict=False))

    def evaluate(self, times: Array, order: int = 0) -> Array:
        """Return values, or derivatives, in the shape of `times`; NaN where they are unknown."""
        values = np.full(times.shape, np.nan)
        for piece in self.pieces:
            within = _lie_within(piece, times)
            values[within] = _make(piece)(times[within], nu=order)
        return values

    def is_known(self, times: Array) -> Mask:
        """Mark the times at which the quantity is known."""
        known = np.zeros(times.shape, dtype=bool)
        for piece in self.pieces:
            known |= _lie_within(piece, times)
        return known

    def list_unknown(self, start: float, end: float) -> tuple[tuple[float, float], ...]:
        """List the parts of a time span in which the quantity is unknown."""
        found, reached = [], start
        for piece in self.pieces:
            if piece.start > min(reached, end):
                found.append((reached, min(piece.start, end)))
            reached = max(reached, piece.end)
        if reached < end:
            found.append((reached, end))
        return tuple((a, b) for a, b in found if b > a)


def _lie_within(piece: Piece, times: Array) -> Mask:
    """Mark the times from a piece's start to its end, to rounding."""
    slack = ROUNDED * (piece.end - piece.start)
    return np.asarray((times >= piece.start - slack) & (times <= piece.end + slack))


@lru_cache(maxsize=4096)
def _make(piece: Piece) -> BSpline:
    from scipy.interpolate import BSpline  # takes long to load, and most problems have no recording

    return BSpline(np.array(piece.knots), np.array(piece.coefficients), piece.degree)


@lru_cache(maxsize=64)
def _make_many(pieces: tuple[Piece, ...]) -> BSpline:
    """Make one spline of pieces with the same knots."""
    from scipy.interpolate import BSpline

    columns = np.array([piece.coefficients for piece in pieces]).T
    return BSpline(np.array(pieces[0].knots), np.ascontiguousarray(columns), pieces[0].degree)


def fit(times: Array, values: Array, treatment: Treatment) -> Track:
    """Fit splines to samples (K,); NaN are gaps. Raises SplineError where noise or filter do not suit them.

    A sample that stands alone between two gaps is left out: it has no derivative.
    """
    known = np.isfinite(values)
    return _fit_known(times[known], values[known][:, None], times, treatment)[0]


def fit_all(times: Array, values: Array, treatment: Treatment) -> list[Track]:
    """Fit splines to columns of samples (K, m) as `fit` does; the columns without gaps are fitted at once."""
    whole = np.flatnonzero(np.isfinite(values).all(axis=0)).tolist()
    fitted = _fit_known(times, values[:, whole], times, treatment) if whole else []
    tracks = dict(zip(whole, fitted, strict=True))
    return [tracks[k] if k in tracks else fit(times, values[:, k], treatment) for k in range(values.shape[1])]


def _fit_known(t: Array, values: Array, times: Array, treatment: Treatment) -> list[Track]:
    """Fit splines to columns (k, m) that have samples at the same times t, of all times of a recording."""
    longest = max(treatment.gap, STEPS * float(np.median(np.diff(times)))) * (1 + 1e-9)
    parts = np.split(np.arange(len(t)), np.flatnonzero(np.diff(t) > longest) + 1)
    fitted = [_fit_pieces(t[part], values[part], times, treatment) for part in parts if part.size > 1]
    return [Track(tuple(pieces[k] for pieces in fitted)) for k in range(values.shape[1])]


def _fit_pieces(t: Array, values: Array, times: Array, treatment: Treatment) -> list[Piece]:
    """Fit a piece to each column (k, m)."""
    from scipy.interpolate import make_interp_spline

    degree = treatment.degree
    if len(t) <= degree:
        degree = len(t) - 1 - (len(t) % 2 == 1)  # odd: 1 or 3
    if treatment.cutoff is not None:
        within = times[(times >= t[0]) & (times <= t[-1])]
        even = make_interp_spline(t, values, degree)(within) if len(within) > len(t) else values
        t, values = within, low_pass(within, even, treatment.cutoff)
    if treatment.noise is not None and len(t) > degree + 1:
        return [_smooth(t, column, degree, treatment.noise) for column in values.T]
    spline = make_interp_spline(t, values, degree)
    knots = tuple(spline.t.tolist())
    columns: Array = np.asarray(spline.c).reshape(-1, values.shape[1])
    return [Piece(degree, knots, tuple(columns[:, k].tolist())) for k in range(values.shape[1])]


def _smooth(t: Array, y: Array, degree: int, noise: float) -> Piece:
    from scipy.interpolate import splrep

    weights = np.full(len(t), 1 / noise)
    (knots, coefficients, _), _, flag, _ = splrep(t, y, weights, k=degree, s=len(t), full_output=1, quiet=1)
    if flag > 0:
        finding = f"no spline was found that smooths noise of {noise:g} from t = {t[0]:g} to {t[-1]:g} s"
        raise SplineError(finding, "give another noise; without one, the spline goes through the samples")
    return Piece(degree, tuple(knots.tolist()), tuple(coefficients[: len(knots) - degree - 1].tolist()))


def low_pass(t: Array, y: Array, cutoff: float) -> Array:
    """Filter even samples (K, ...) forward and backward, by a cut-off [Hz]. Raises SplineError for uneven ones."""
    steps = np.diff(t)
    step = float(steps.mean())
    if np.abs(steps - step).max() > UNEVEN * step:
        finding = f"a filter needs even steps of time, and they are {steps.min():.4g} to {steps.max():.4g} s"
        raise SplineError(finding, "give the noise instead, which needs none")
    corner = cutoff / PASSES
    if len(t) < LEAST or corner >= 0.5 / step:
        finding = f"a filter with a cut-off of {cutoff:g} Hz does not suit {len(t)} samples at {1 / step:.4g} Hz"
        raise SplineError(finding, f"give {LEAST} samples at least, and a cut-off below {0.5 * PASSES / step:.4g} Hz")
    from scipy.signal import butter, filtfilt  # only here, and late: few commands filter, and all would wait for it

    b, a = butter(2, corner, fs=1 / step)
    return np.asarray(filtfilt(b, a, y, axis=0))


def count_gaps(times: Array, values: Array, treatment: Treatment) -> tuple[int, int]:
    """Count the gaps of samples (K,): bridged ones, and ones that are left open."""
    t = times[np.isfinite(values)]
    step, apart = float(np.median(np.diff(times))), np.diff(t)
    open_ones = int((apart > max(treatment.gap, STEPS * step) * (1 + 1e-9)).sum())
    return int((apart > STEPS * step * (1 + 1e-9)).sum()) - open_ones, open_ones


def stack(tracks: Sequence[Track], times: Array, order: int = 0) -> Array:
    """Evaluate tracks side by side: (K, tracks); the ones in one piece with the same knots at once."""
    if not tracks:
        return np.zeros((*times.shape, 0))
    firsts = [track.pieces[0] if len(track.pieces) == 1 else None for track in tracks]
    first = firsts[0]
    if first is None or any(p is None or (p.degree, p.knots) != (first.degree, first.knots) for p in firsts[1:]):
        return np.stack([track.evaluate(times, order) for track in tracks], axis=-1)
    within = _lie_within(first, times)
    values = np.full((*times.shape, len(tracks)), np.nan)
    values[within] = _make_many(tuple(p for p in firsts if p is not None))(times[within], nu=order)
    return values
