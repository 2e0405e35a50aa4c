"""A biped's jump in plain CasADi: push off with both feet, flight, landing, from rest to rest."""

from __future__ import annotations

from collections.abc import Callable
from math import acos, atan2, hypot, pi

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from benchmarks.legged.chains import Link, Mechanism, Point, describe
from benchmarks.legged.collocation import Graph, Phase

Array = NDArray[np.float64]

BACK = (0.0, -1.0, 0.0)
THIGH = SHANK = 0.4
FEET = ("left", "right")
JUMP, GAP, HEIGHT = 0.4, 0.2, 0.72  # of the jump, between the feet, of the hip at rest [m]
FRICTION, MASS = 0.7, 28.0
TIMES = ((0.1, 1.0, 0.3), (0.1, 0.8, 0.3), (0.1, 1.0, 0.3))


def describe_biped() -> Mechanism:
    """Describe the biped: slides x and z, pitch, and two legs of hip and knee."""
    links = [
        Link(-1, (1.0, 0.0, 0.0), turns=False),
        Link(0, (0.0, 0.0, 1.0), turns=False),
        Link(1, BACK, (0, 0, 0), 16.0, (0.01, 0, 0.22), (0.9, 0.9, 0.2, 0, 0, 0)),
    ]
    for hip in (3, 5):
        links.append(Link(2, BACK, (0, 0, 0), 4.0, (0, 0, -0.17), (0.06, 0.06, 0.01, 0, 0, 0)))
        links.append(Link(hip, BACK, (0, 0, -THIGH), 2.0, (0, 0, -0.16), (0.03, 0.03, 0.003, 0, 0, 0)))
    return describe(links, {foot: Point(link, (0, 0, -SHANK)) for foot, link in zip(FEET, (4, 6), strict=True)})


def stand(x: float) -> Array:
    """Return the pose with the left foot at x and the right one a gap before it, the hip midway."""
    legs = []
    for ahead in (-GAP / 2, GAP / 2):
        leg = hypot(ahead, HEIGHT)
        knee = acos((THIGH**2 + SHANK**2 - leg**2) / (2 * THIGH * SHANK)) - pi
        legs += [atan2(ahead, HEIGHT) - knee / 2, knee]  # thigh and shank are as long
    return np.array([x + GAP / 2, HEIGHT, 0.0, *legs])


def write(intervals: int, degree: int) -> Graph:
    """Write the program of the jump."""
    biped, graph = describe_biped(), Graph()
    first, last = stand(0.0), stand(JUMP)
    q = [(-np.inf, np.inf)] * 2 + [(-0.8, 0.8)] + [(-1.0, 2.0), (-2.4, -0.05)] * 2
    qd, u = [(-20.0, 20.0)] * 7, [(-150.0, 150.0)] * 4

    def go(part: int) -> Callable[[float], tuple[Array, Array]]:
        return lambda s: (first + (part + s) / 3 * (last - first), (last - first) / 0.9)

    def rise(q: ca.MX, _qd: ca.MX) -> list[tuple[ca.MX, float, float]]:
        return [(biped.positions(q)[2, :].T, -0.01, np.inf)]

    ends = []
    for part, horizon in enumerate(TIMES):
        feet, rows = ((), rise) if part == 1 else (FEET, lambda _q, _qd: [])
        phase = Phase(
            biped,
            (3, 4, 5, 6),
            intervals,
            degree,
            horizon,
            q,
            qd,
            u,
            go(part),
            feet,
            (0, 2),
            friction=FRICTION,
            weight=9.81 * MASS,
            rows=rows,
        )
        ends.append(graph.append(phase))
    push, flight, landing = ends
    graph.require(push.q0 - first)
    graph.require(push.qd0)
    graph.require(flight.q0 - push.q1)
    graph.require(flight.qd0 - push.qd1)
    spots = biped.positions(flight.q1)
    graph.require(ca.vertcat(spots[0, 0] - JUMP, spots[2, 0], spots[0, 1] - JUMP - GAP, spots[2, 1]))
    after = graph.strike(biped, flight.q1, flight.qd1, FEET, (0, 2), FRICTION)
    graph.require(landing.q0 - flight.q1)
    graph.require(landing.qd0 - after)
    graph.require(landing.q1[:3] - last[:3])
    graph.require(landing.qd1[:3])
    return graph
