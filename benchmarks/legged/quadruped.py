"""A quadruped's bound in plain CasADi: hind feet, flight, front feet, flight, and again; at least torque squared."""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from benchmarks.legged.chains import Link, Mechanism, Point, Vector, describe
from benchmarks.legged.collocation import Ends, Graph, Phase

Array = NDArray[np.float64]

FRONT, SIDE, HIP, THIGH, SHANK = 0.19, 0.05, 0.06, 0.21, 0.19
FEET = ("fl", "fr", "hl", "hr")
STANDING: tuple[tuple[str, ...], ...] = (("hl", "hr"), (), ("fl", "fr"), ())
ROTOR = 0.01
PITCH = 0.8
STRIDE, FRICTION = 0.6, 0.7
TIMES = ((0.05, 0.3, 0.12), (0.02, 0.2, 0.06), (0.05, 0.3, 0.12), (0.02, 0.2, 0.06))
LEG = (0.0, 0.8, -1.6)  # abduction, hip, knee of the guess
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


def write(intervals: int, degree: int) -> Graph:
    """Write the program of a stride."""
    body, graph = describe_quadruped(), Graph()
    q = [(-np.inf, np.inf)] * 3 + [(-PITCH, PITCH)] * 3 + [(-0.8, 0.8), (-2.5, 2.5), (-2.6, -0.1)] * 4
    qd, u = [(-30.0, 30.0)] * 18, [(-30.0, 30.0)] * 12
    period = sum(guess for _, _, guess in TIMES)
    speed = np.array([STRIDE / period, *[0.0] * 17])
    pose = np.array([0.0, 0.0, HEIGHT, 0.0, 0.0, 0.0, *LEG * 4])

    def go(part: int) -> Callable[[float], tuple[Array, Array]]:
        begin = sum(guess for _, _, guess in TIMES[:part])
        return lambda s: (pose + (begin + s * TIMES[part][2]) * speed, speed)

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
            (0, 1, 2),
            FRICTION,
            9.81 * 9.4,
            rise(part),
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
    return graph
