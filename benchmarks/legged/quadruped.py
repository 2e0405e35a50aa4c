"""A quadruped's bound in plain CasADi: hind feet, flight, front feet, flight, and again; at least torque squared."""

from __future__ import annotations

from collections.abc import Callable
from math import acos, atan2, cos, hypot, sin

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from benchmarks.legged.chains import Link, Mechanism, Point, Vector, describe
from benchmarks.legged.collocation import Ends, Graph, Phase

Array = NDArray[np.float64]

FRONT, SIDE, HIP, THIGH, SHANK = 0.19, 0.05, 0.06, 0.21, 0.19
FEET = ("fl", "fr", "hl", "hr")
STANDING: tuple[tuple[str, ...], ...] = (("hl", "hr"), (), ("fl", "fr"), ())
ROTOR, MASS = 0.02, 9.4
SPEED_COST, LOADED = 0.01, 1.6
PITCH = 0.3
STRIDE, FRICTION = 0.3, 0.7
TIMES = ((0.08, 0.2, 0.14), (0.04, 0.15, 0.08), (0.08, 0.2, 0.14), (0.04, 0.15, 0.08))
PERIOD = 0.44
HEIGHT = 0.28


def describe_quadruped() -> Mechanism:
    """Describe the quadruped: three slides, three turns, four legs of three joints."""
    slides: list[Vector] = [(1, 0, 0), (0, 1, 0), (0, 0, 1)]
    links = [Link(i - 1, axis, turns=False) for i, axis in enumerate(slides)]
    links += [Link(2, (0, 0, 1)), Link(3, (0, 1, 0))]
    links += [Link(4, (1, 0, 0), (0, 0, 0), 4.2, (0.004, 0, 0.003), (0.016, 0.046, 0.053, 0, 1.2e-3, 0))]
    for x in (FRONT, -FRONT):
        for s in (1, -1):
            hip = len(links)
            links += [
                Link(
                    5,
                    (1, 0, 0),
                    (x, s * SIDE, 0),
                    0.54,
                    (0, s * 0.036, 0),
                    (3.8e-4, 5.6e-4, 4.4e-4, s * 6e-5, 0, 0),
                    armature=ROTOR,
                ),
                Link(
                    hip,
                    (0, 1, 0),
                    (0, s * HIP, 0),
                    0.63,
                    (0, s * 0.016, -0.02),
                    (1.98e-3, 2.1e-3, 5.9e-4, 0, 0, s * 2.1e-4),
                    armature=ROTOR,
                ),
                Link(
                    hip + 1,
                    (0, 1, 0),
                    (0, 0, -THIGH),
                    0.13,
                    (0, 0, -0.12),
                    (4.5e-4, 4.5e-4, 1.6e-5, 0, 0, 0),
                    armature=ROTOR,
                ),
            ]
    return describe(links, {foot: Point(8 + 3 * k, (0, 0, -SHANK)) for k, foot in enumerate(FEET)})


def guess_leg(ahead: float) -> Array:
    """Return abduction, hip and knee of a leg whose foot is so far before its hip, on the ground."""
    leg = hypot(ahead, HEIGHT)
    knee = acos((leg**2 - THIGH**2 - SHANK**2) / (2 * THIGH * SHANK))
    return np.array([0.0, -atan2(ahead, HEIGHT) + atan2(SHANK * sin(knee), THIGH + SHANK * cos(knee)), -knee])


def guess_pose(mark: int) -> Array:
    """Return the pose at the start of a phase, or the end of the last: feet that stand stay, the others swing."""
    times = np.cumsum([0.0, *(guess for _, _, guess in TIMES)])
    done = times[mark] / times[-1]
    speed = STRIDE / times[-1]
    reach = speed * TIMES[0][2] / 2
    swing = 2 * reach / (times[-1] - TIMES[0][2])

    def place(begin: float) -> float:
        """Return how far a foot is before its hip, that stands from `begin`."""
        since = (times[mark] - begin) % times[-1]
        return float(reach - speed * since if since <= TIMES[0][2] + 1e-9 else -reach + swing * (since - TIMES[0][2]))

    front, hind = guess_leg(place(times[2])), guess_leg(place(0.0))
    return np.array([done * STRIDE, 0.0, HEIGHT, 0.0, 0.0, 0.0, *front, *front, *hind, *hind])


def write(intervals: int, degree: int) -> Graph:
    """Write the program of a stride."""
    body, graph = describe_quadruped(), Graph()
    q = [(-np.inf, np.inf)] * 3 + [(-PITCH, PITCH)] * 3 + [(-0.8, 0.8), (-2.5, 2.5), (-2.6, -0.1)] * 4
    qd, u = [(-30.0, 30.0)] * 18, [(-30.0, 30.0)] * 12

    def go(part: int) -> Callable[[float], tuple[Array, Array]]:
        first, last = guess_pose(part), guess_pose(part + 1)
        return lambda s: (first + s * (last - first), (last - first) / TIMES[part][2])

    def rise(part: int) -> Callable[[ca.MX, ca.MX], list[tuple[ca.MX, float, float]]]:
        free = [k for k, foot in enumerate(FEET) if foot not in STANDING[part]]
        return lambda q, _qd: [(body.positions(q)[2, free].T, -0.005, np.inf)]

    ends: list[Ends] = []
    for part, horizon in enumerate(TIMES):
        phase = Phase(
            body,
            range(6, 18),
            intervals,
            degree,
            horizon,
            q,
            qd,
            u,
            go(part),
            STANDING[part],
            friction=FRICTION,
            weight=9.81 * MASS * LOADED,
            rows=rise(part),
            speed_cost=SPEED_COST,
        )
        ends.append(graph.append(phase))
    hind, gathered, front, stretched = ends
    for before, after in ((hind, gathered), (front, stretched)):
        graph.require(after.q0 - before.q1)
        graph.require(after.qd0 - before.qd1)
    for before, after, standing, stride in (
        (gathered, front, STANDING[2], 0.0),
        (stretched, hind, STANDING[0], STRIDE),
    ):
        feet = [FEET.index(foot) for foot in standing]
        graph.require(body.positions(before.q1)[2, feet].T)
        struck = graph.strike(body, before.q1, before.qd1, standing, (0, 1, 2))
        graph.require(after.q0 - before.q1 + ca.DM([stride, *[0.0] * 17]))
        graph.require(after.qd0 - struck)
    graph.require(hind.q0[:2])
    graph.require(sum((end.T for end in ends), ca.MX(0)) - PERIOD)
    return graph
