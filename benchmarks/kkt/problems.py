"""Problems of optimal control from the literature, each with its source and its optimum where one is known.

COPS: Dolan, More, Munson, "Benchmarking optimization software with COPS 3.0", ANL/MCS-TM-273 (2004).
Betts: "Practical Methods for Optimal Control and Estimation Using Nonlinear Programming" (2010), and "A collection of
optimal control test problems" (2015).
Optima in closed form are computed to ten digits.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import casadi as ca

from benchmarks.kkt.estimation import ESTIMATIONS
from benchmarks.kkt.transcription import FREE, POSITIVE, Bounds, Path, Problem

COPS, BETTS = "COPS 3.0", "Betts (2010, 2015)"


def _line(start: Sequence[float], end: Sequence[float]) -> Path:
    """Return the straight line between two points."""
    return lambda s: [(1 - s) * a + s * b for a, b in zip(start, end, strict=True)]


def _constant(*values: float) -> Path:
    return lambda _: values


def _rows(*terms: ca.SX | float) -> ca.SX:
    return ca.vertcat(*terms)


def _make_chain() -> Problem:
    """Hang a chain of length 4 between heights 1 and 3; the states are height, energy and length."""

    def rates(x: ca.SX, u: ca.SX, p: ca.SX, t: ca.SX) -> ca.SX:
        speed = ca.sqrt(1 + u[0] ** 2)
        return _rows(u[0], x[0] * speed, speed)

    return Problem(
        "hanging chain",
        COPS + "; closed form",
        rates,
        (FREE, FREE, FREE),
        (FREE,),
        (1.0, 0.0, 0.0),
        (3.0, None, 4.0),
        1.0,
        lambda s: (8 * s * (s / 2 - 0.25) + 1, 5 * s, 4 * s),
        lambda s: (8 * (s - 0.25),),
        final=lambda x, p: x[1],
        intervals=400,
        optimum=5.06848011,
    )


def _make_rocket() -> Problem:
    """Goddard's rocket in its scaled form: height, velocity, mass."""

    def rates(x: ca.SX, u: ca.SX, p: ca.SX, t: ca.SX) -> ca.SX:
        h, v, m = x[0], x[1], x[2]
        drag = 310 * v**2 * ca.exp(-500 * (h - 1))
        return _rows(v, (u[0] - drag) / m - 1 / h**2, -u[0] / 0.5)

    return Problem(
        "Goddard rocket",
        COPS,
        rates,
        ((1.0, math.inf), POSITIVE, (0.6, 1.0)),
        ((0.0, 3.5),),
        (1.0, 0.0, 1.0),
        (None, None, 0.6),
        None,
        lambda s: (1.0, s * (1 - s), 1 - 0.4 * s),
        _constant(1.75),
        p=((0.01, 10.0),),
        guess_p=(1.0,),
        final=lambda x, p: -x[0],
        intervals=400,
        optimum=-1.01283,
    )


def _make_glider() -> Problem:
    """A hang glider in a thermal upwind: x, y and their rates; the input is the lift coefficient."""

    def rates(x: ca.SX, u: ca.SX, p: ca.SX, t: ca.SX) -> ca.SX:
        place, vx, vy, lift = x[0], x[2], x[3], u[0]
        r = (place / 100 - 2.5) ** 2
        w = vy - 2.5 * (1 - r) * ca.exp(-r)
        v = ca.sqrt(vx**2 + w**2)
        push = 0.5 * 1.13 * 14.0 * v
        D, L = push * (0.034 + 0.069662 * lift**2), push * lift
        return _rows(vx, vy, (-L * w - D * vx) / 100, (L * vx - D * w) / 100 - 9.81)

    return Problem(
        "hang glider",
        COPS + "; Betts",
        rates,
        (POSITIVE, FREE, POSITIVE, FREE),
        ((0.0, 1.4),),
        (0.0, 1000.0, 13.23, -1.288),
        (None, 900.0, 13.23, -1.288),
        None,
        _line((0.0, 1000.0, 13.23, -1.288), (1300.0, 900.0, 13.23, -1.288)),
        _constant(0.7),
        p=((10.0, 200.0),),
        guess_p=(100.0,),
        final=lambda x, p: -x[0],
        intervals=400,
        optimum=-1248.031,
    )


def _make_robot() -> Problem:
    """A robot's arm between two poses in least time: length rho, angles theta and phi, and their rates."""

    def rates(x: ca.SX, u: ca.SX, p: ca.SX, t: ca.SX) -> ca.SX:
        inertia = ((5 - x[0]) ** 3 + x[0] ** 3) / 3
        return _rows(x[3], x[4], x[5], u[0] / 5, u[1] / (inertia * ca.sin(x[2]) ** 2), u[2] / inertia)

    start, end = (4.5, 0.0, math.pi / 4, 0.0, 0.0, 0.0), (4.5, 2 * math.pi / 3, math.pi / 4, 0.0, 0.0, 0.0)
    return Problem(
        "robot arm",
        COPS,
        rates,
        ((0.0, 5.0), (-math.pi, math.pi), (0.0, math.pi), FREE, FREE, FREE),
        ((-1.0, 1.0),) * 3,
        start,
        end,
        None,
        _line(start, end),
        _constant(0.0, 0.0, 0.0),
        p=((0.1, 100.0),),
        guess_p=(1.0,),
        final=lambda x, p: p[0],
        optimum=9.14093,
    )


def _make_steering() -> Problem:
    """Steer a particle to a height and a velocity in least time; in closed form the tangent is linear in time."""
    end = (None, 5.0, 45.0, 0.0)
    return Problem(
        "particle steering",
        COPS + "; Betts",
        lambda x, u, p, t: _rows(x[2], x[3], 100 * ca.cos(u[0]), 100 * ca.sin(u[0])),
        (FREE,) * 4,
        ((-math.pi / 2, math.pi / 2),),
        (0.0,) * 4,
        end,
        None,
        _line((0.0,) * 4, (10.0, 5.0, 45.0, 0.0)),
        _constant(0.0),
        p=((0.01, 10.0),),
        guess_p=(1.0,),
        final=lambda x, p: p[0],
        intervals=400,
        optimum=0.554570879,
    )


def _make_catalyst() -> Problem:
    """Mix two catalysts along a reactor; the optimum has a singular arc."""

    def rates(x: ca.SX, u: ca.SX, p: ca.SX, t: ca.SX) -> ca.SX:
        return _rows(u[0] * (10 * x[1] - x[0]), u[0] * (x[0] - 10 * x[1]) - (1 - u[0]) * x[1])

    return Problem(
        "catalyst mixing",
        COPS,
        rates,
        (FREE, FREE),
        ((0.0, 1.0),),
        (1.0, 0.0),
        (None, None),
        1.0,
        _constant(1.0, 0.0),
        _constant(0.0),
        final=lambda x, p: x[0] + x[1] - 1,
        intervals=400,
        optimum=-0.0480556,
    )


def _make_brachistochrone() -> Problem:
    """Fall from (0, 0) to (2, 2) in least time, without friction, g = 9.81."""
    return Problem(
        "brachistochrone",
        "Bernoulli (1696); closed form",
        lambda x, u, p, t: _rows(x[2] * ca.sin(u[0]), x[2] * ca.cos(u[0]), 9.81 * ca.cos(u[0])),
        (FREE,) * 3,
        ((0.0, math.pi),),
        (0.0, 0.0, 0.0),
        (2.0, 2.0, None),
        None,
        _line((0.0, 0.0, 0.0), (2.0, 2.0, 5.0)),
        _constant(1.0),
        p=((0.1, 10.0),),
        guess_p=(1.0,),
        final=lambda x, p: p[0],
        intervals=400,
        optimum=0.8243386694,
    )


def _make_van_der_pol() -> Problem:
    """Damp van der Pol's oscillator with a bound on a state."""
    return Problem(
        "van der Pol",
        BETTS,
        lambda x, u, p, t: _rows(x[1], -x[0] + (1 - x[0] ** 2) * x[1] + u[0]),
        (FREE, (-0.4, math.inf)),
        (FREE,),
        (1.0, 0.0),
        (None, None),
        5.0,
        _constant(1.0, 0.0),
        _constant(0.0),
        running=lambda x, u, p, t: x[0] ** 2 + x[1] ** 2 + u[0] ** 2,
        intervals=400,
        optimum=2.95369916,
    )


def _make_rayleigh() -> Problem:
    """Rayleigh's equation with a constraint on input and state."""
    return Problem(
        "Rayleigh",
        BETTS,
        lambda x, u, p, t: _rows(x[1], -x[0] + x[1] * (1.4 - 0.14 * x[1] ** 2) + 4 * u[0]),
        (FREE, FREE),
        (FREE,),
        (-5.0, -5.0),
        (None, None),
        4.5,
        _line((-5.0, -5.0), (0.0, 0.0)),
        _constant(0.0),
        running=lambda x, u, p, t: u[0] ** 2 + x[0] ** 2,
        path=lambda x, u, p, t: u[0] + x[0] / 6,
        path_bounds=((-math.inf, 0.0),),
        intervals=400,
        optimum=44.8044445,
    )


def _make_crane() -> Problem:
    """Swing a container as little as possible: Sakawa and Shindo (1982)."""

    def rates(x: ca.SX, u: ca.SX, p: ca.SX, t: ca.SX) -> ca.SX:
        swing = -(u[0] + 27.0756 * x[2] + 2 * x[4] * x[5]) / x[1]
        return 9 * _rows(x[3], x[4], x[5], u[0] + 17.2656 * x[2], u[1], swing)

    start, end = (0.0, 22.0, 0.0, 0.0, -1.0, 0.0), (10.0, 14.0, 0.0, 2.5, 0.0, 0.0)
    return Problem(
        "container crane",
        "Sakawa, Shindo (1982)",
        rates,
        (FREE, FREE, FREE, (-2.5, 2.5), (-1.0, 1.0), FREE),
        ((-2.83374, 2.83374), (-0.80865, 0.71265)),
        start,
        end,
        1.0,
        _line(start, end),
        _constant(0.0, 0.0),
        running=lambda x, u, p, t: 4.5 * (x[2] ** 2 + x[5] ** 2),
    )


def _make_alp_rider() -> Problem:
    """A stiff linear system that must stay above four peaks."""

    def rates(x: ca.SX, u: ca.SX, p: ca.SX, t: ca.SX) -> ca.SX:
        return _rows(
            -10 * x[0] + u[0] + u[1],
            -2 * x[1] + u[0] + 2 * u[1],
            -3 * x[2] + 5 * x[3] + u[0] - u[1],
            5 * x[2] - 3 * x[3] + u[0] + 3 * u[1],
        )

    def height(x: ca.SX, u: ca.SX, p: ca.SX, t: ca.SX) -> ca.SX:
        peaks = ((3, 3, 12), (3, 6, 10), (3, 10, 6), (8, 15, 4))
        return ca.sumsqr(x) - 0.01 - sum(a * ca.exp(-c * (t - b) ** 2) for a, b, c in peaks)

    start, end = (2.0, 1.0, 2.0, 1.0), (2.0, 3.0, 1.0, -2.0)
    return Problem(
        "alp rider",
        BETTS,
        rates,
        (FREE,) * 4,
        (FREE, FREE),
        start,
        end,
        20.0,
        _line(start, end),
        _constant(0.0, 0.0),
        running=lambda x, u, p, t: 100 * ca.sumsqr(x) + 0.01 * ca.sumsqr(u),
        path=height,
        path_bounds=(POSITIVE,),
        intervals=400,
        optimum=2030.85609,
        digits=1e-2,
    )


def _make_bryson_denham() -> Problem:
    """A double integrator below a ceiling l = 1/9; the optimum is 4 / (9 l)."""
    return Problem(
        "Bryson-Denham",
        "Bryson, Ho (1975); closed form",
        lambda x, u, p, t: _rows(x[1], u[0]),
        ((-math.inf, 1 / 9), FREE),
        (FREE,),
        (0.0, 1.0),
        (0.0, -1.0),
        1.0,
        _line((0.0, 1.0), (0.0, -1.0)),
        _constant(0.0),
        running=lambda x, u, p, t: u[0] ** 2 / 2,
        intervals=400,
        optimum=4.0,
    )


def _make_two_links() -> Problem:
    """An arm of two links in least time: Luus (2000)."""

    def rates(x: ca.SX, u: ca.SX, p: ca.SX, t: ca.SX) -> ca.SX:
        s, c = ca.sin(x[2]), ca.cos(x[2])
        det = 31 / 36 + 9 / 4 * s**2
        first = s * (9 / 4 * c * x[0] ** 2 + 2 * x[1] ** 2) + 4 / 3 * (u[0] - u[1]) - 3 / 2 * c * u[1]
        second = -(s * (7 / 2 * x[0] ** 2 + 9 / 4 * c * x[1] ** 2) - 7 / 3 * u[1] + 3 / 2 * c * (u[0] - u[1]))
        return _rows(first / det, second / det, x[1] - x[0], x[0])

    start, end = (0.0, 0.0, 0.5, 0.0), (0.0, 0.0, 0.5, 0.522)
    return Problem(
        "two links",
        "Luus (2000)",
        rates,
        (FREE,) * 4,
        ((-1.0, 1.0),) * 2,
        start,
        end,
        None,
        _line(start, end),
        _constant(0.0, 0.0),
        p=((0.1, 10.0),),
        guess_p=(3.0,),
        final=lambda x, p: p[0],
        optimum=2.98335,
    )


def _make_flying_robot() -> Problem:
    """A free-flying robot of least fuel: Sakawa (1999)."""

    def rates(x: ca.SX, u: ca.SX, p: ca.SX, t: ca.SX) -> ca.SX:
        left, right = u[0] - u[1], u[2] - u[3]
        thrust = left + right
        return _rows(x[3:], thrust * ca.cos(x[2]), thrust * ca.sin(x[2]), 0.2 * (left - right))

    start = (-10.0, -10.0, math.pi / 2, 0.0, 0.0, 0.0)
    return Problem(
        "free-flying robot",
        BETTS,
        rates,
        (FREE,) * 6,
        ((0.0, 1.0),) * 4,
        start,
        (0.0,) * 6,
        12.0,
        _line(start, (0.0,) * 6),
        _constant(0.1, 0.1, 0.1, 0.1),
        running=lambda x, u, p, t: ca.sum1(u),
        path=lambda x, u, p, t: _rows(u[0] + u[1], u[2] + u[3]),
        path_bounds=((-math.inf, 1.0),) * 2,
        optimum=7.9101902,
    )


def _make_shuttle() -> Problem:
    """The space shuttle's re-entry with the largest cross range; height and velocity in 1e5 ft and 1e4 ft/s."""
    degree = math.pi / 180

    def rates(x: ca.SX, u: ca.SX, p: ca.SX, t: ca.SX) -> ca.SX:
        h, theta, v, gamma, psi = 1e5 * x[0], x[2], 1e4 * x[3], x[4], x[5]
        alpha, beta = u[0] / degree, u[1]
        mass, r = 203000 / 32.174, 20902900 + h
        gravity, pressure = 0.14076539e17 / r**2, 0.5 * 0.002378 * ca.exp(-h / 23800) * v**2 * 2690
        lift = pressure * (-0.20704 + 0.029244 * alpha)
        drag = pressure * (0.07854 - 0.61592e-2 * alpha + 0.621408e-3 * alpha**2)
        return _rows(
            v * ca.sin(gamma) / 1e5,
            v / r * ca.cos(gamma) * ca.sin(psi) / ca.cos(theta),
            v / r * ca.cos(gamma) * ca.cos(psi),
            (-drag / mass - gravity * ca.sin(gamma)) / 1e4,
            lift / (mass * v) * ca.cos(beta) + ca.cos(gamma) * (v / r - gravity / v),
            lift * ca.sin(beta) / (mass * v * ca.cos(gamma))
            + v * ca.cos(gamma) * ca.sin(psi) * ca.sin(theta) / (r * ca.cos(theta)),
        )

    start = (2.6, 0.0, 0.0, 2.56, -degree, 90 * degree)
    bounds: tuple[Bounds, ...] = (
        (0.0, 3.0),
        FREE,
        (-89 * degree, 89 * degree),
        (0.1, 4.0),
        (-89 * degree, 89 * degree),
        FREE,
    )
    return Problem(
        "space shuttle",
        BETTS,
        rates,
        bounds,
        ((-90 * degree, 90 * degree), (-89 * degree, degree)),
        start,
        (0.8, None, None, 0.25, -5 * degree, None),
        None,
        _line(start, (0.8, 0.5, 0.5, 0.25, -5 * degree, 0.0)),
        _constant(17 * degree, -60 * degree),
        p=((100.0, 4000.0),),
        guess_p=(2000.0,),
        final=lambda x, p: -x[2],
        optimum=-34.1412 * degree,
    )


def _make_hypersensitive() -> Problem:
    """Rao and Mease (2000): layers at both ends of a long horizon; in closed form for an infinite one."""
    return Problem(
        "hypersensitive",
        "Rao, Mease (2000); closed form",
        lambda x, u, p, t: _rows(-(x[0] ** 3) + u[0]),
        (FREE,),
        (FREE,),
        (1.5,),
        (1.0,),
        50.0,
        _line((1.5,), (1.0,)),
        _constant(0.0),
        running=lambda x, u, p, t: (x[0] ** 2 + u[0] ** 2) / 2,
        intervals=400,
        optimum=1.330806905,
        digits=1e-2,
    )


def _make_orbit() -> Problem:
    """Transfer to the largest circular orbit in a given time: Bryson and Ho (1975), section 2.5."""

    def rates(x: ca.SX, u: ca.SX, p: ca.SX, t: ca.SX) -> ca.SX:
        push = 0.1405 / (1 - 0.0749 * t)
        return _rows(
            x[1],
            x[2] ** 2 / x[0] - 1 / x[0] ** 2 + push * ca.sin(u[0]),
            -x[1] * x[2] / x[0] + push * ca.cos(u[0]),
        )

    return Problem(
        "orbit transfer",
        "Bryson, Ho (1975)",
        rates,
        ((0.5, 5.0), FREE, FREE),
        ((-math.pi, 2 * math.pi),),
        (1.0, 0.0, 1.0),
        (None, 0.0, None),
        3.32,
        _line((1.0, 0.0, 1.0), (1.5, 0.0, 0.8)),
        _constant(1.0),
        final=lambda x, p: -x[0],
        closing=lambda x, p: x[2] ** 2 * x[0] - 1,
        intervals=400,
        optimum=-1.525,
    )


def _make_lander() -> Problem:
    """Land on the moon softly with least fuel: Meditch (1964); it falls, then brakes fully."""
    return Problem(
        "moon lander",
        "Meditch (1964); closed form",
        lambda x, u, p, t: _rows(x[1], u[0] - 1.5),
        ((0.0, 20.0), (-20.0, 20.0)),
        ((0.0, 3.0),),
        (10.0, -2.0),
        (0.0, 0.0),
        None,
        _line((10.0, -2.0), (0.0, 0.0)),
        _constant(1.5),
        p=((0.1, 20.0),),
        guess_p=(4.0,),
        running=lambda x, u, p, t: u[0],
        intervals=400,
        optimum=8.246211251,
    )


def _make_heat() -> Problem:
    """Heat a rod through one end, by lines at ten places: Heinkenschloss (1996); two algebraic equations a point."""
    n = 10
    step = 1 / (n - 1)

    def rates(x: ca.SX, u: ca.SX, p: ca.SX, t: ca.SX) -> ca.SX:
        y = ca.vertcat(u[1], x, u[2])
        rows = []
        for i in range(n):
            c = math.cos(math.pi * i * step)
            decay = ca.exp(-t)
            q = (-2 + 2 * math.pi**2) * decay * c + math.pi**2 * decay**2 - (2 * math.pi**2 + 1) * decay**2 * c**2
            curvature = (y[i + 2] - 2 * y[i + 1] + y[i]) / step**2
            slope = (y[i + 2] - y[i]) / (2 * step)
            rows.append((q + (4 - y[i + 1]) * curvature - slope**2) / (4 + y[i + 1]))
        return _rows(*rows)

    def ends(x: ca.SX, u: ca.SX, p: ca.SX, t: ca.SX) -> ca.SX:
        first = x[0] - u[0] - (4 - x[0]) * (x[1] - u[1]) / (2 * step)
        return _rows(first, (4 - x[n - 1]) * (u[2] - x[n - 2]) / (2 * step))

    start = [2 + math.cos(math.pi * i * step) for i in range(n)]
    return Problem(
        "heated rod",
        BETTS,
        rates,
        ((0.0, 3.0),) * n,
        ((0.0, 0.1), (0.0, 3.0), (0.0, 3.0)),
        tuple(start),
        (None,) * n,
        0.5,
        lambda s: start,
        _constant(0.1, 3.0, 1.0),
        running=lambda x, u, p, t: 0.5 * ((x[n - 1] - 2 + ca.exp(-t)) ** 2 + 1e-3 * u[0] ** 2),
        path=ends,
        path_bounds=((0.0, 0.0),) * 2,
    )


def _make_tumour() -> Problem:
    """Shrink a tumour by a bounded amount of a drug: Ledzewicz, Schaettler (2008); volumes in 1e4."""
    carrying = ((5.85 - 0.02) / 0.00873) ** 1.5 / 1e4

    def rates(x: ca.SX, u: ca.SX, p: ca.SX, t: ca.SX) -> ca.SX:
        volume, room = x[0], x[1]
        growth = 5.85 - 0.02 - 0.00873 * (1e4 * volume) ** (2 / 3) - 0.15 * u[0]
        return _rows(-0.084 * volume * ca.log(volume / room), room * growth, u[0])

    start = (carrying / 2, carrying / 4, 0.0)
    return Problem(
        "tumour",
        BETTS,
        rates,
        ((0.01, carrying), (0.01, carrying), (0.0, 15.0)),
        ((0.0, 75.0),),
        start,
        (None, None, None),
        None,
        _line(start, (start[0], start[1], 15.0)),
        _constant(10.0),
        p=((0.1, 5.0),),
        guess_p=(1.0,),
        final=lambda x, p: x[0],
        intervals=400,
        optimum=0.757167158,
    )


def _make_fishing() -> Problem:
    """Lotka's and Volterra's fish, relaxed: Sager (2012)."""
    return Problem(
        "fishing",
        "Sager (2012)",
        lambda x, u, p, t: _rows(x[0] * (1 - x[1] - 0.4 * u[0]), x[1] * (x[0] - 1 - 0.2 * u[0])),
        (FREE, FREE),
        ((0.0, 1.0),),
        (0.5, 0.7),
        (None, None),
        12.0,
        _constant(1.0, 1.0),
        _constant(0.2),
        running=lambda x, u, p, t: (x[0] - 1) ** 2 + (x[1] - 1) ** 2,
        intervals=400,
        optimum=1.34408,
    )


def _make_cart_pole() -> Problem:
    """Swing a pole up with least force squared: Kelly (2017)."""

    def rates(x: ca.SX, u: ca.SX, p: ca.SX, t: ca.SX) -> ca.SX:
        s, c, w = ca.sin(x[1]), ca.cos(x[1]), x[3]
        det = 1 + 0.3 * (1 - c**2)
        cart = (0.5 * 0.3 * s * w**2 + u[0] + 0.3 * 9.81 * c * s) / det
        pole = -(0.5 * 0.3 * c * s * w**2 + u[0] * c + 1.3 * 9.81 * s) / (0.5 * det)
        return _rows(x[2], x[3], cart, pole)

    end = (1.0, math.pi, 0.0, 0.0)
    return Problem(
        "cart-pole",
        "Kelly (2017)",
        rates,
        ((-2.0, 2.0), FREE, FREE, FREE),
        ((-20.0, 20.0),),
        (0.0,) * 4,
        end,
        2.0,
        _line((0.0,) * 4, end),
        _constant(0.0),
        running=lambda x, u, p, t: u[0] ** 2,
        optimum=58.8,
        digits=5e-3,
    )


def _make_masses() -> Problem:
    """Bring a chain of balls and springs to rest by one end: Wirsching, Bock, Diehl (2006); 33 states."""
    balls, anchor, end = 5, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0)
    n = 6 * balls + 3

    def rates(x: ca.SX, u: ca.SX, p: ca.SX, t: ca.SX) -> ca.SX:
        places = [ca.SX(ca.DM(anchor)), *(x[3 * i : 3 * i + 3] for i in range(balls + 1))]
        links = [b - a for a, b in pairwise(places)]
        rest, stiffness, mass = 0.55 / (balls + 1), 1.0 * (balls + 1), 0.45 / (balls + 1)
        forces = [stiffness * (1 - rest / ca.norm_2(d)) * d for d in links]
        gravity = ca.DM([0.0, 0.0, -9.81])
        bends = [(b - a) / mass + gravity for a, b in pairwise(forces)]
        return _rows(x[3 * (balls + 1) :], u, *bends)

    line = [c for i in range(1, balls + 2) for c in (i / (balls + 1), 0.0, 0.0)]
    start = [c for i in range(1, balls + 2) for c in (0.7 * i / (balls + 1), 0.5 * i / (balls + 1), 0.0)]

    def cost(x: ca.SX, u: ca.SX, p: ca.SX, t: ca.SX) -> ca.SX:
        gap = x[3 * balls : 3 * balls + 3] - ca.DM(end)
        return 25 * ca.sumsqr(gap) + ca.sumsqr(x[3 * balls + 3 :]) + 0.01 * ca.sumsqr(u)

    return Problem(
        "chain of balls",
        "Wirsching, Bock, Diehl (2006)",
        rates,
        (FREE,) * n,
        ((-1.0, 1.0),) * 3,
        (*start, *(0.0,) * (3 * balls)),
        (None,) * n,
        8.0,
        _line((*start, *(0.0,) * (3 * balls)), (*line, *(0.0,) * (3 * balls))),
        _constant(0.0, 0.0, 0.0),
        running=cost,
        intervals=60,
    )


PROBLEMS: tuple[Problem, ...] = (
    _make_chain(),
    _make_rocket(),
    _make_glider(),
    _make_robot(),
    _make_steering(),
    _make_catalyst(),
    *ESTIMATIONS,
    _make_brachistochrone(),
    _make_van_der_pol(),
    _make_rayleigh(),
    _make_crane(),
    _make_alp_rider(),
    _make_bryson_denham(),
    _make_two_links(),
    _make_flying_robot(),
    _make_shuttle(),
    _make_hypersensitive(),
    _make_orbit(),
    _make_lander(),
    _make_heat(),
    _make_tumour(),
    _make_fishing(),
    _make_cart_pole(),
    _make_masses(),
)
