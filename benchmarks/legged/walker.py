"""Kelly's walker in plain CasADi: one step, from heel strike to heel strike, at least torque squared.

M. Kelly, "An introduction to trajectory optimization", SIAM Review 59 (2017) 849-904, section 7. Two local optima of a
step of 0.4 m in 0.6 s, found by GPOPS-II, are in his program OptimTraj, demo/fiveLinkBiped: 302.25469438 (SNOPT) and
263.69884582 (IPOPT).
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from benchmarks.legged.chains import Link, Mechanism, Point, describe
from benchmarks.legged.collocation import Graph, Phase

BACK = (0.0, -1.0, 0.0)
TIBIA, FEMUR, TORSO = 0.4, 0.4, 0.625
FLIP = np.array([[1, 1, 1, 1, 1], [0, 0, 0, 0, -1], [0, 0, 0, -1, 0], [0, 0, -1, 0, 0], [0, -1, 0, 0, 0]])
START = np.array([-0.3, 1.0, -0.7, -0.5, -0.1])  # Kelly's guess, as angles between links
PUBLISHED = (302.25469438, 263.69884582)


@dataclass(frozen=True)
class Step:
    """A step: its length [m], its time [s]; whether knees may bend forward and feet scuff."""

    length: float = 0.5
    time: float = 0.7
    is_free: bool = False


def list_links(first: int = 0) -> list[Link]:
    """List the links, of which the first is carried by the base or by the link before it."""
    bodies = (
        ((0, 0, 0), 3.2, (0, 0, TIBIA - 0.128), 0.93),
        ((0, 0, TIBIA), 6.8, (0, 0, FEMUR - 0.163), 1.08),
        ((0, 0, FEMUR), 20.0, (0, 0, TORSO - 0.2), 2.22),
        ((0, 0, 0), 6.8, (0, 0, -0.163), 1.08),
        ((0, 0, -FEMUR), 3.2, (0, 0, -0.128), 0.93),
    )
    return [
        Link(first - 1 + i, BACK, place, mass, com, (0.0, inertia, 0.0, 0.0, 0.0, 0.0))
        for i, (place, mass, com, inertia) in enumerate(bodies)
    ]


def describe_stance() -> Mechanism:
    """Describe the walker on its stance foot."""
    return describe(list_links(), {"foot": Point(4, (0, 0, -TIBIA))})


def describe_free() -> Mechanism:
    """Describe the walker without a foot on the ground."""
    slides = [Link(-1, (1.0, 0.0, 0.0), turns=False), Link(0, (0.0, 0.0, 1.0), turns=False)]
    return describe([*slides, *list_links(2)], {"foot": Point(6, (0, 0, -TIBIA))})


def write(step: Step, intervals: int, degree: int) -> Graph:
    """Write the program of a step."""
    stance, free, graph = describe_stance(), describe_free(), Graph()
    sums = ca.DM(np.tril(np.ones((5, 5))))
    flipped = FLIP @ START

    def guess(s: float) -> tuple[np.ndarray, np.ndarray]:
        return START + s * (flipped - START), (flipped - START) / step.time

    def keep(q: ca.MX, qd: ca.MX) -> list[tuple[ca.MX, float, float]]:
        angles = [(sums @ q, -np.pi / 2, np.pi / 2), (sums @ qd, -10.0, 10.0)]
        return angles if step.is_free else [*angles, (q[1], 0, np.inf), (q[4], -np.inf, 0)]

    wide = [(-np.inf, np.inf)] * 5
    horizon = (step.time,) * 3
    phase = Phase(stance, (1, 2, 3, 4), intervals, degree, horizon, wide, wide, [(-100, 100)] * 4, guess, rows=keep)
    ends = graph.append(phase)
    before = ca.vertcat(0, 0, ends.qd1)
    after = graph.strike(free, ca.vertcat(0, 0, ends.q1), before, ("foot",), (0, 2))
    graph.require(ends.q0 - FLIP @ ends.q1)
    graph.require(ends.qd0 - FLIP @ after[2:])
    foot = stance.positions(ends.q1)
    graph.require(foot[0], step.length, step.length)
    graph.require(foot[2])
    if not step.is_free:
        graph.require(stance.velocities(ends.q0, ends.qd0)[2], 0, np.inf)
        graph.require(stance.velocities(ends.q1, ends.qd1)[2], -np.inf, 0)
    return graph
