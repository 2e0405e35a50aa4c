"""A force that exceeds dry friction for a short time again and again, for tests."""

from __future__ import annotations

import numpy as np
from scipy.optimize import brentq

RATE, OVER = 11.0, 1.1  # rad/s; the highest force over friction


def write_pulses(limit: float) -> str:
    """Return the force OVER limit sin^2(RATE t) as an expression; a body at rest starts where it reaches the limit."""
    return f"{OVER * limit!r}*sin({RATE!r}*t)**2"


def find_slip(limit: float, mass: float) -> tuple[float, float, float]:
    """Return when the first slip begins and ends, and its way."""
    half, w, begin = OVER / 2, 2 * RATE, np.arcsin(np.sqrt(1 / OVER)) / RATE

    def speed(t: float) -> float:
        return float((half - 1) * (t - begin) - half * (np.sin(w * t) - np.sin(w * begin)) / w)

    end = brentq(speed, np.pi / w, begin + np.pi / w, xtol=1e-15)
    length = end - begin
    way = (half - 1) * length**2 / 2 + half * (np.cos(w * end) - np.cos(w * begin)) / w**2
    way += half * np.sin(w * begin) / w * length
    return float(begin), float(end), float(limit / mass * way)
