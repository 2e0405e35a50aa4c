"""Estimation of rates of reactions and populations from measurements: four problems of COPS 3.0, with its data.

Sources: gas oil, Tjoa, Biegler (1991); marine, Rothschild et al. (1997); methanol, Maria (1989); pinene, Box et al.
(1973). The report gives the optima.
"""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np

from benchmarks.kkt.transcription import FREE, POSITIVE, Expression, Measurements, Path, Problem

SOURCE = "COPS 3.0"


def _interpolate(measured: Measurements) -> Path:
    """Return the measurements, interpolated, by t / T."""
    times, values = np.array(measured.times), np.array(measured.values)
    return lambda s: [float(np.interp(s * times[-1], times, column)) for column in values.T]


def _make(
    name: str,
    rates: Expression,
    measured: Measurements,
    start: Sequence[float | None],
    guess_p: Sequence[float],
    optimum: float,
) -> Problem:
    n = len(start)
    return Problem(
        name,
        SOURCE,
        rates,
        (FREE,) * n,
        (),
        tuple(start),
        (None,) * n,
        measured.times[-1],
        _interpolate(measured),
        p=(POSITIVE,) * len(guess_p),
        guess_p=tuple(guess_p),
        measured=measured,
        intervals=400,
        optimum=optimum,
    )


def _crack(x: ca.SX, u: ca.SX, p: ca.SX, t: ca.SX) -> ca.SX:
    return ca.vertcat(-(p[0] + p[2]) * x[0] ** 2, p[0] * x[0] ** 2 - p[1] * x[1])


def _age(x: ca.SX, u: ca.SX, p: ca.SX, t: ca.SX) -> ca.SX:
    """Stages of a population: p holds the mortality of all eight, then the growth of all but the last."""
    mortality, growth = p[:8], ca.vertcat(p[8:], 0)
    return ca.vertcat(0, growth[:7] * x[:7]) - (mortality + growth) * x


def _convert(x: ca.SX, u: ca.SX, p: ca.SX, t: ca.SX) -> ca.SX:
    a, b = x[0], x[1]
    share = p[0] * a / ((p[1] + p[4]) * a + b)
    return ca.vertcat(
        -(2 * p[1] + p[2] + p[3]) * a + share * b,
        share * (p[1] * a - b) + p[2] * a,
        share * (b + p[4] * a) + p[3] * a,
    )


def _isomerise(x: ca.SX, u: ca.SX, p: ca.SX, t: ca.SX) -> ca.SX:
    first, third, fifth = x[0], x[2], x[4]
    return ca.vertcat(
        -(p[0] + p[1]) * first,
        p[0] * first,
        p[1] * first - (p[2] + p[3]) * third + p[4] * fifth,
        p[2] * third,
        p[3] * third - p[4] * fifth,
    )


_GAS_OIL = Measurements(
    (
        0.0,
        0.025,
        0.05,
        0.075,
        0.1,
        0.125,
        0.15,
        0.175,
        0.2,
        0.225,
        0.25,
        0.3,
        0.35,
        0.4,
        0.45,
        0.5,
        0.55,
        0.65,
        0.75,
        0.85,
        0.95,
    ),
    (
        (1.0, 0.0),
        (0.8105, 0.2),
        (0.6208, 0.2886),
        (0.5258, 0.301),
        (0.4345, 0.3215),
        (0.3903, 0.3123),
        (0.3342, 0.2716),
        (0.3034, 0.2551),
        (0.2735, 0.2258),
        (0.2405, 0.1959),
        (0.2283, 0.1789),
        (0.2071, 0.1457),
        (0.1669, 0.1198),
        (0.153, 0.0909),
        (0.1339, 0.0719),
        (0.1265, 0.0561),
        (0.12, 0.046),
        (0.099, 0.028),
        (0.087, 0.019),
        (0.077, 0.014),
        (0.069, 0.01),
    ),
)

_MARINE = Measurements(
    tuple(0.5 * k for k in range(21)),
    (
        (20000.0, 17000.0, 10000.0, 15000.0, 12000.0, 9000.0, 7000.0, 3000.0),
        (12445.0, 15411.0, 13040.0, 13338.0, 13484.0, 8426.0, 6615.0, 4022.0),
        (7705.0, 13074.0, 14623.0, 11976.0, 12453.0, 9272.0, 6891.0, 5020.0),
        (4664.0, 8579.0, 12434.0, 12603.0, 11738.0, 9710.0, 6821.0, 5722.0),
        (2977.0, 7053.0, 11219.0, 11340.0, 13665.0, 8534.0, 6242.0, 5695.0),
        (1769.0, 5054.0, 10065.0, 11232.0, 12112.0, 9600.0, 6647.0, 7034.0),
        (943.0, 3907.0, 9473.0, 10334.0, 11115.0, 8826.0, 6842.0, 7348.0),
        (581.0, 2624.0, 7421.0, 10297.0, 12427.0, 8747.0, 7199.0, 7684.0),
        (355.0, 1744.0, 5369.0, 7748.0, 10057.0, 8698.0, 6542.0, 7410.0),
        (223.0, 1272.0, 4713.0, 6869.0, 9564.0, 8766.0, 6810.0, 6961.0),
        (137.0, 821.0, 3451.0, 6050.0, 8671.0, 8291.0, 6827.0, 7525.0),
        (87.0, 577.0, 2649.0, 5454.0, 8430.0, 7411.0, 6423.0, 8388.0),
        (49.0, 337.0, 2058.0, 4115.0, 7435.0, 7627.0, 6268.0, 7189.0),
        (32.0, 228.0, 1440.0, 3790.0, 6474.0, 6658.0, 5859.0, 7467.0),
        (17.0, 168.0, 1178.0, 3087.0, 6524.0, 5880.0, 5562.0, 7144.0),
        (11.0, 99.0, 919.0, 2596.0, 5360.0, 5762.0, 4480.0, 7256.0),
        (7.0, 65.0, 647.0, 1873.0, 4556.0, 5058.0, 4944.0, 7538.0),
        (4.0, 44.0, 509.0, 1571.0, 4009.0, 4527.0, 4233.0, 6649.0),
        (2.0, 27.0, 345.0, 1227.0, 3677.0, 4229.0, 3805.0, 6378.0),
        (1.0, 20.0, 231.0, 934.0, 3197.0, 3695.0, 3159.0, 6454.0),
        (1.0, 12.0, 198.0, 707.0, 2562.0, 3163.0, 3232.0, 5566.0),
    ),
)

_METHANOL = Measurements(
    (
        0.0,
        0.050,
        0.065,
        0.080,
        0.123,
        0.233,
        0.273,
        0.354,
        0.397,
        0.418,
        0.502,
        0.553,
        0.681,
        0.750,
        0.916,
        0.937,
        1.122,
    ),
    (
        (1.0, 0.0, 0.0),
        (0.7085, 0.1621, 0.0811),
        (0.5971, 0.1855, 0.0965),
        (0.5537, 0.1989, 0.1198),
        (0.3684, 0.2845, 0.1535),
        (0.1712, 0.3491, 0.2097),
        (0.1198, 0.3098, 0.2628),
        (0.0747, 0.3576, 0.2467),
        (0.0529, 0.3347, 0.2884),
        (0.0415, 0.3388, 0.2757),
        (0.0261, 0.3557, 0.3167),
        (0.0208, 0.3483, 0.2954),
        (0.0085, 0.3836, 0.295),
        (0.0053, 0.3611, 0.2937),
        (0.0019, 0.3609, 0.2831),
        (0.0018, 0.3485, 0.2846),
        (0.0006, 0.3698, 0.2899),
    ),
)

_PINENE = Measurements(
    (1230.0, 3060.0, 4920.0, 7800.0, 10680.0, 15030.0, 22620.0, 36420.0),
    (
        (88.35, 7.3, 2.3, 0.4, 1.75),
        (76.4, 15.6, 4.5, 0.7, 2.8),
        (65.1, 23.1, 5.3, 1.1, 5.8),
        (50.4, 32.9, 6.0, 1.5, 9.3),
        (37.5, 42.7, 6.0, 1.9, 12.0),
        (25.9, 49.1, 5.9, 2.2, 17.0),
        (14.0, 57.4, 5.1, 2.6, 21.0),
        (4.5, 63.1, 3.8, 2.9, 25.7),
    ),
)

ESTIMATIONS: tuple[Problem, ...] = (
    _make("gas oil", _crack, _GAS_OIL, (1.0, 0.0), (0.0,) * 3, 5.23664e-3),
    _make("marine population", _age, _MARINE, (None,) * 8, (0.0,) * 15, 1.97465e7),
    _make("methanol", _convert, _METHANOL, (1.0, 0.0, 0.0), (1.0,) * 5, 9.02229e-3),
    _make("pinene", _isomerise, _PINENE, (100.0, 0.0, 0.0, 0.0, 0.0), (0.0,) * 5, 19.8721),
)
