"""An independent peer of the generated arm: recursive Newton-Euler in CasADi SX, with the interface of loaded kernels.

The arm of Docquier, Bruls, Fisette, Table 2: axes z; y, y, y (arm along +x); the pendulum's x, y (along +z), z up. It
shares no code with the generator, and its derivatives are CasADi's.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from mbsgen.manifest import Coordinate, Frame
from tests.mbsrun.peer import Peer, explicit_functions, pose_functions, residual_function

GRAVITY = 9.81


@dataclass(frozen=True)
class Link:
    """A body and its joint: axis and place in the parent's frame, mass properties in its own (diagonal inertia)."""

    name: str
    axis: int
    place: tuple[float, float, float]
    mass: float
    com: tuple[float, float, float]
    inertia: tuple[float, float, float]
    actuated: bool
    limits: tuple[float | None, float | None]


O = (0.0, 0.0, 0.0)
X3, X1 = (0.3, 0.0, 0.0), (0.1, 0.0, 0.0)
LINKS = (
    Link("shoulder", 2, O, 0.0, O, O, True, (None, None)),
    Link("upperarm", 1, O, 2.5, X1, (0.06, 0.1, 0.1), True, (-np.pi / 2, np.pi / 2)),
    Link("forearm", 1, X3, 2.0, X1, (0.03, 0.05, 0.05), True, (-5 * np.pi / 12, 0.0)),
    Link("hand", 1, X3, 0.5, X1, (0.004, 0.006, 0.006), True, (-np.pi / 2, np.pi / 2)),
    Link("cardan", 0, X1, 0.0, O, O, False, (-np.pi / 4, np.pi / 4)),
    Link("pendulum", 1, O, 1.0, (0.0, 0.0, 0.2), (0.1, 0.1, 0.05), False, (-np.pi / 4, np.pi / 4)),
)
SENSORS = (("hand", 3, X1), ("pendulum", 5, (0.0, 0.0, 0.2)))  # name, link, place on it; names of frames may recur
N = len(LINKS)
M = sum(link.actuated for link in LINKS)


def _turn(axis: int, angle: ca.SX) -> ca.SX:
    c, s = ca.cos(angle), ca.sin(angle)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    R = ca.SX.eye(3)
    R[i, i], R[i, j], R[j, i], R[j, j] = c, -s, s, c
    return R


def _poses(q: ca.SX) -> tuple[list[ca.SX], list[ca.SX]]:
    """Return rotation and joint point of every link in the base frame."""
    R, p = ca.SX.eye(3), ca.SX.zeros(3)
    Rs, ps = [], []
    for i, link in enumerate(LINKS):
        p = p + R @ ca.SX(link.place)
        R = R @ _turn(link.axis, q[i])
        Rs.append(R)
        ps.append(p)
    return Rs, ps


def _residual(q: ca.SX, qd: ca.SX, qdd: ca.SX, u: ca.SX) -> ca.SX:
    """Phi(q, qd, qdd) - Q(u); vectors of a link in its own frame, so that exact zeros of the Jacobian stay zeros."""
    om, omp, a = ca.SX.zeros(3), ca.SX.zeros(3), ca.vertcat(0, 0, GRAVITY)
    turns, forces, moments = [], [], []
    for i, link in enumerate(LINKS):
        r, axis, c = ca.SX(link.place), ca.SX.eye(3)[:, link.axis], ca.SX(link.com)
        turn = _turn(link.axis, q[i]).T  # from the parent's frame to the link's
        a = turn @ (a + ca.cross(omp, r) + ca.cross(om, ca.cross(om, r)))
        om, carried = turn @ om + axis * qd[i], turn @ om
        omp = turn @ omp + axis * qdd[i] + ca.cross(carried, axis) * qd[i]
        inertia = ca.diag(ca.SX(link.inertia))
        force = link.mass * (a + ca.cross(omp, c) + ca.cross(om, ca.cross(om, c)))
        turns.append(turn)
        forces.append(force)
        moments.append(inertia @ omp + ca.cross(om, inertia @ om) + ca.cross(c, force))
    inputs = iter(range(M))
    Q = [u[next(inputs)] if link.actuated else 0 for link in LINKS]
    Phi = ca.SX.zeros(N)
    for i in reversed(range(N)):
        Phi[i] = moments[i][LINKS[i].axis] - Q[i]
        if i:
            force = turns[i].T @ forces[i]
            forces[i - 1] += force
            moments[i - 1] += turns[i].T @ moments[i] + ca.cross(ca.SX(LINKS[i].place), force)
    return Phi


def peer_arm() -> Peer:
    """Make the peer."""
    q, qd, qdd, u = ca.SX.sym("q", N), ca.SX.sym("qd", N), ca.SX.sym("qdd", N), ca.SX.sym("u", M)
    Rs, ps = _poses(q)
    sensors = [ps[link] + Rs[link] @ ca.SX(place) for _, link, place in SENSORS]
    p, R = ca.horzcat(*ps, *sensors), ca.horzcat(*Rs, *(Rs[link] for _, link, _ in SENSORS))
    joints = [
        Coordinate(name=f"q{i}", motion="revolute", actuated=link.actuated, lower=link.limits[0], upper=link.limits[1])
        for i, link in enumerate(LINKS, 1)
    ]
    bodies = [Frame(name=link.name, parent=i - 1, sensor=False) for i, link in enumerate(LINKS)]
    residual = residual_function(q, qd, qdd, u, _residual(q, qd, qdd, u))
    return Peer(
        "peer arm",
        {
            "impl": residual,
            **explicit_functions(residual),
            **pose_functions(q, ca.horzcat(*sensors), p, R),
        },
        joints,
        [*bodies, *(Frame(name=name, parent=link, sensor=True) for name, link, _ in SENSORS)],
    )
