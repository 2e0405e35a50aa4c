"""An arm that picks up a mass and places it, in plain CasADi: three phases, of which the second one carries."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from benchmarks.legged.chains import Link, Mechanism, Point, describe
from benchmarks.legged.collocation import Graph, Phase

Array = NDArray[np.float64]

HEIGHT, UPPER, FORE, PALM = 0.3, 0.35, 0.3, 0.12
LOAD, SPEED = 2.0, 5.0
ROTORS = (0.1, 0.1, 0.05, 0.05)
HOME = np.array([0.0, 0.0, 0.4, 0.4])
PICK, PLACE = (0.45, -0.3, 0.1), (0.1, 0.5, 0.35)
TIME = (0.2, 3.0, 0.8)
INPUTS_COST, TIME_COST = 1e-3, 0.3


def describe_carrier(load: float) -> Mechanism:
    """Describe the arm with a point mass in its hand."""
    hand, com = 0.7, 0.05
    mass = hand + load
    turned = hand * load / mass * (PALM - com) ** 2
    pitch = (0.0, 1.0, 0.0)
    links = [
        Link(-1, (0.0, 0.0, 1.0), (0, 0, 0), 4.0, (0, 0, 0.2), (0.03, 0.03, 0.02, 0, 0, 0)),
        Link(0, pitch, (0, 0, HEIGHT), 3.0, (0, 0.02, 0.16), (0.04, 0.04, 0.01, 0, 0, 0)),
        Link(1, pitch, (0, 0, UPPER), 2.0, (0.13, -0.01, 0), (0.005, 0.02, 0.02, 0, 0, 0)),
        Link(
            2,
            pitch,
            (FORE, 0, 0),
            mass,
            ((hand * com + load * PALM) / mass, 0, 0),
            (8e-4, 0.0015 + turned, 0.0015 + turned, 0, 0, 0),
        ),
    ]
    links = [replace(link, armature=rotor) for link, rotor in zip(links, ROTORS, strict=True)]
    return describe(links, {"hand": Point(3, (PALM, 0, 0))})


def write(intervals: int, degree: int) -> Graph:
    """Write the program: from home to the mass, with it to its place, and home."""
    graph = Graph()
    q = [(-2.8, 2.8), (-1.8, 1.8), (-1.4, 2.4), (-2.0, 2.0)]
    qd, u = [(-SPEED, SPEED)] * 4, [(-60, 60), (-60, 60), (-40, 40), (-20, 20)]

    def stay(_s: float) -> tuple[Array, Array]:
        return HOME, np.zeros(4)

    ends = []
    for load in (0.0, LOAD, 0.0):
        mechanism = describe_carrier(load)
        phase = Phase(
            mechanism,
            range(4),
            intervals,
            degree,
            TIME,
            q,
            qd,
            u,
            stay,
            inputs_cost=INPUTS_COST,
            time_cost=TIME_COST,
        )
        ends.append((graph.append(phase), mechanism))
    first = ends[0][0]
    graph.require(first.q0 - HOME)
    graph.require(first.qd0)
    for (before, mechanism), (after, _), place in zip(ends, ends[1:], (PICK, PLACE), strict=False):
        graph.require(mechanism.positions(before.q1) - ca.DM(place))
        graph.require(mechanism.velocities(before.q1, before.qd1))
        graph.require(after.q0 - before.q1)
        graph.require(after.qd0 - before.qd1)
    last = ends[-1][0]
    graph.require(last.q1 - HOME)
    graph.require(last.qd1)
    return graph
