"""Optimal control problems in stages, small ones with known behaviour: swing-ups, least time, obstacles, a chain."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import casadi as ca
import numpy as np

from tests.csrc.stages import INFINITE, Array, Kind, Problem

Ode = Callable[[ca.SX, ca.SX], ca.SX]


def assemble(
    name: str,
    kinds: list[Kind],
    order: list[int],
    bounds: list[tuple[Array, Array]],
    rows: list[tuple[Array, Array]],
    guess: list[Array],
    scale: list[Array] | None = None,
) -> Problem:
    """Put stages together: bounds of (x, v), of g, and the guess of each stage."""

    def join(parts: list[Array]) -> Array:
        return np.concatenate([np.asarray(p, dtype=float) for p in parts]) if parts else np.zeros(0)

    return Problem(
        name,
        kinds,
        order,
        join([b[0] for b in bounds]),
        join([b[1] for b in bounds]),
        join([r[0] for r in rows]),
        join([r[1] for r in rows]),
        join(guess),
        join(scale) if scale else None,
    )


def free(n: int) -> Array:
    return np.full(n, INFINITE)


def runge_kutta(ode: Ode, x: ca.SX, u: ca.SX, h: float | ca.SX) -> ca.SX:
    k1 = ode(x, u)
    k2 = ode(x + h / 2 * k1, u)
    k3 = ode(x + h / 2 * k2, u)
    k4 = ode(x + h * k3, u)
    return x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


def pendulum_ode(x: ca.SX, u: ca.SX) -> ca.SX:
    return ca.vertcat(x[1], u[0] - 9.81 * ca.sin(x[0]))


def cart_pole_accelerations(x: ca.SX, u: ca.SX) -> ca.SX:
    s, c = ca.sin(x[1]), ca.cos(x[1])
    m, length, g, cart = 0.3, 0.5, 9.81, 1.0
    d = cart + m * (1 - c**2)
    a = (length * m * s * x[3] ** 2 + u[0] + m * g * c * s) / d
    b = -(length * m * c * s * x[3] ** 2 + u[0] * c + (m + cart) * g * s) / (length * d)
    return ca.vertcat(a, b)


def cart_pole_ode(x: ca.SX, u: ca.SX) -> ca.SX:
    return ca.vertcat(x[2:4], cart_pole_accelerations(x, u))


def shooting(
    name: str,
    ode: Ode,
    nx: int,
    intervals: int,
    h: float,
    start: Array,
    end: Array,
    limit: float,
    weight: float = 0.0,
    walls: float = INFINITE,
    softly: bool = False,
) -> Problem:
    """Least effort from start to end by Runge and Kutta's method; a force limit, walls of the first state."""
    x, u = ca.SX.sym("x", nx), ca.SX.sym("u")
    middle = Kind(x, u, h * (ca.sumsqr(u) + weight * ca.sumsqr(x - end)), runge_kutta(ode, x, u, h))
    last = Kind(x, ca.SX(0, 1), 10 * ca.sumsqr(x - end) if softly else ca.SX(0), e=ca.SX(0, 1) if softly else x - end)
    inner = np.concatenate([[walls], free(nx - 1), [limit]])
    first = (np.concatenate([start, [-limit]]), np.concatenate([start, [limit]]))
    bounds = [first] + [(-inner, inner)] * (intervals - 1) + [(-inner[:-1], inner[:-1])]
    guess = [
        np.concatenate([start + (end - start) * k / intervals, [0.0] if k < intervals else []])
        for k in range(intervals + 1)
    ]
    return assemble(name, [middle, last], [0] * intervals + [1], bounds, [], guess)


def collocated(intervals: int, h: float, limit: float) -> Problem:
    """The cart-pole in integral form: accelerations at two points of Gauss are unknowns of an interval."""
    A = np.array([[0.25, 0.25 - np.sqrt(3) / 6], [0.25 + np.sqrt(3) / 6, 0.25]])
    b = np.array([0.5, 0.5])
    x, u, a = ca.SX.sym("x", 4), ca.SX.sym("u"), ca.SX.sym("a", 4)
    q, qd, points = x[:2], x[2:], [a[:2], a[2:]]
    AA = A @ A
    rows, cost = [], ca.SX(0)
    for i in range(2):
        rate = qd + h * sum((A[i, j] * points[j] for j in range(2)), ca.SX(2, 1))
        position = q + A[i].sum() * h * qd + h**2 * sum((AA[i, j] * points[j] for j in range(2)), ca.SX(2, 1))
        rows.append(points[i] - cart_pole_accelerations(ca.vertcat(position, rate), u))
        cost += b[i] * h * ca.sumsqr(u)
    after = ca.vertcat(
        q + h * qd + h**2 * sum(((b @ A)[j] * points[j] for j in range(2)), ca.SX(2, 1)),
        qd + h * sum((b[j] * points[j] for j in range(2)), ca.SX(2, 1)),
    )
    start, end = np.zeros(4), np.array([0.0, np.pi, 0.0, 0.0])
    middle = Kind(x, ca.vertcat(a, u), cost, after, e=ca.vertcat(*rows))
    last = Kind(x, ca.SX(0, 1), ca.SX(0), e=x - end)
    inner = np.concatenate([[2.0], free(7), [limit]])
    lower, upper = -inner.copy(), inner.copy()
    lower[:4] = upper[:4] = start
    bounds = [(lower, upper)] + [(-inner, inner)] * (intervals - 1) + [(-inner[:4], inner[:4])]
    guess = [np.concatenate([end * k / intervals, np.zeros(5 if k < intervals else 0)]) for k in range(intervals + 1)]
    return assemble("cart-pole, collocated", [middle, last], [0] * intervals + [1], bounds, [], guess)


def fastest(intervals: int) -> Problem:
    """Bring a double integrator with friction to rest in least time; the horizon is a state without change."""
    x, u = ca.SX.sym("x", 3), ca.SX.sym("u")

    def ode(z: ca.SX, force: ca.SX) -> ca.SX:
        return ca.vertcat(z[1], force[0] - 0.1 * z[1] ** 3)

    after = ca.vertcat(runge_kutta(ode, x[:2], u, x[2] / intervals), x[2])
    middle = Kind(x, u, x[2] / intervals, after)
    last = Kind(x, ca.SX(0, 1), ca.SX(0), e=x[:2] - ca.DM([1.0, 0.0]))
    lower = [np.array([-INFINITE, -INFINITE, 0.1, -1.0])] * intervals + [np.array([-INFINITE, -INFINITE, 0.1])]
    upper = [np.array([INFINITE, 0.8, 10.0, 1.0])] * intervals + [np.array([INFINITE, 0.8, 10.0])]
    lower[0], upper[0] = lower[0].copy(), upper[0].copy()
    lower[0][:2] = upper[0][:2] = 0.0
    guess = [np.array([k / intervals, 0.3, 3.0] + ([0.0] if k < intervals else [])) for k in range(intervals + 1)]
    return assemble(
        "least time", [middle, last], [0] * intervals + [1], list(zip(lower, upper, strict=True)), [], guess
    )


def around(intervals: int, h: float) -> Problem:
    """Drive a point mass around two discs."""
    x, u = ca.SX.sym("x", 4), ca.SX.sym("u", 2)
    discs = [(1.0, 0.1, 0.45), (2.1, -0.3, 0.5)]
    clear = ca.vertcat(*((x[0] - a) ** 2 + (x[1] - b) ** 2 for a, b, _ in discs))
    after = ca.vertcat(x[:2] + h * x[2:] + h**2 / 2 * u, x[2:] + h * u)
    end = np.array([3.0, 0.0, 0.0, 0.0])
    middle = Kind(x, u, h * ca.sumsqr(u), after, g=ca.vertcat(clear, ca.sumsqr(u)))
    last = Kind(x, ca.SX(0, 1), ca.SX(0), e=x - end, g=clear)
    far = np.concatenate([free(4), free(2)])
    bounds = [(-far, far)] * intervals + [(-far[:4], far[:4])]
    bounds[0] = (np.concatenate([np.zeros(4), -free(2)]), np.concatenate([np.zeros(4), free(2)]))
    least = np.array([r**2 for *_, r in discs])
    rows = [(np.append(least, -INFINITE), np.append(free(2), 9.0))] * intervals + [(least, free(2))]
    guess = [
        np.concatenate([end * k / intervals, np.zeros(2 if k < intervals else 0)]) + 0.0 for k in range(intervals + 1)
    ]
    for g in guess:
        g[1] += 0.05
    return assemble("two discs", [middle, last], [0] * intervals + [1], bounds, rows, guess)


def chain(intervals: int) -> Problem:
    """The hanging chain: least potential energy of a curve of given length (COPS 3.0, problem 4)."""
    length, h = 4.0, 1.0 / intervals
    x, u = ca.SX.sym("x", 2), ca.SX.sym("u")  # height, length so far; slope
    root = ca.sqrt(1 + u**2)
    middle = Kind(x, u, h * x[0] * root, ca.vertcat(x[0] + h * u, x[1] + h * root))
    last = Kind(x, ca.SX(0, 1), ca.SX(0), e=x - ca.DM([3.0, length]))
    far = free(3)
    bounds = [(-far, far)] * intervals + [(-far[:2], far[:2])]
    bounds[0] = (np.array([1.0, 0.0, -INFINITE]), np.array([1.0, 0.0, INFINITE]))
    guess = []
    for k in range(intervals + 1):
        t = k * h
        low = 4 * abs(3.0 - 1.0) * (0.5 * t**2 - 0.25 * t) + 1.0
        slope = 4 * abs(3.0 - 1.0) * (t - 0.25)
        guess.append(np.array([low, length * t] + ([slope] if k < intervals else [])))
    return assemble("hanging chain", [middle, last], [0] * intervals + [1], bounds, [], guess)


UP = np.array([np.pi, 0.0])
POLE = np.array([0.0, np.pi, 0.0, 0.0])


def too_weak() -> Problem:
    """A pendulum that cannot be held up in time."""
    return shooting("pendulum, too weak", pendulum_ode, 2, 20, 0.05, np.zeros(2), UP, 1.0)


def nonlinear() -> list[Problem]:
    """All that the solver is compared with IPOPT on."""
    return [
        shooting("pendulum", pendulum_ode, 2, 30, 0.1, np.zeros(2), UP, 5.0),
        shooting("pendulum, softly", pendulum_ode, 2, 25, 0.15, np.zeros(2), UP, 4.0, 0.1, softly=True),
        shooting("cart-pole", cart_pole_ode, 4, 25, 0.08, np.zeros(4), POLE, 20.0, walls=2.0),
        shooting("cart-pole, narrow", cart_pole_ode, 4, 30, 0.08, np.zeros(4), POLE, 12.0, walls=0.6),
        collocated(20, 0.1, 20.0),
        fastest(30),
        around(25, 0.16),
        chain(30),
    ]


def far_guesses(count: int) -> list[Problem]:
    """All of these from guesses at random: for each of them `count`, near and far in turn."""
    rng = np.random.default_rng(7)
    return [
        replace(problem, guess=problem.guess + (0.3, 1.0)[i % 2] * rng.standard_normal(len(problem.guess)))
        for problem in nonlinear()
        for i in range(count)
    ]


def steep() -> Problem:
    """Reach a far point with the force y = sinh(u), which a step along its tangent misses by orders of magnitude."""
    x, v = ca.SX.sym("x"), ca.SX.sym("v", 2)
    stage = Kind(x, v, v[1] ** 2, x + 0.1 * v[0], e=v[0] - ca.sinh(v[1]), inner=1, sparse=True)
    last = Kind(x, ca.SX(0, 1), ca.SX(0), e=x - 10)
    first = np.concatenate([[0.0], -free(2)]), np.concatenate([[0.0], free(2)])
    bounds = [first, (-free(3), free(3)), (-free(3), free(3)), (-free(1), free(1))]
    return assemble("steep", [stage, last], [0] * 3 + [1], bounds, [], [np.zeros(3)] * 3 + [np.zeros(1)])


def turning() -> Problem:
    """Two forces y in axes that a state turns: other pivots are large at other angles."""
    x, v = ca.SX.sym("x", 2), ca.SX.sym("v", 3)
    c, s = ca.cos(x[0]), ca.sin(x[0])
    rows = ca.vertcat(c * v[0] + s * v[1] - x[1], c * v[1] - s * v[0] - v[2] * x[1] - 0.3)
    after = x + 0.2 * ca.vertcat(x[1], v[0] + v[2])
    stage = Kind(x, v, ca.sumsqr(v) + ca.sumsqr(x - 1), after, e=rows, inner=2, sparse=True)
    last = Kind(x, ca.SX(0, 1), ca.sumsqr(x))
    bounds = [(-free(5), free(5))] * 6 + [(-free(2), free(2))]
    guess = [np.full(5, 0.1)] * 6 + [np.zeros(2)]
    return assemble("turning", [stage, last], [0] * 6 + [1], bounds, [], guess)
