"""Motions that polynomials follow exactly, and the mechanisms that make them: masses on sliders."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from mbsgen.manifest import Coordinate, Frame, Wrench
from mbsrun.ocp.ground import schemes
from mbsrun.ocp.ground.schemes import Family
from mbsrun.ocp.ground.trajectory import Trajectory
from mbsrun.ocp.problem.problem import (
    Bounds,
    Contact,
    Control,
    Drive,
    End,
    Force,
    Problem,
    State,
    Unknown,
    WrenchComponent,
)
from tests.mbsrun.ocp.closed_plants import close
from tests.mbsrun.ocp.plants import FREE_RANGE, push
from tests.mbsrun.peer import FREE, Peer, pose_functions

Array = NDArray[np.float64]
T, MESH = 1.6, (0.5, 0.2, 0.3)
PUSHES = np.array([0.7, -0.4, 1.1])  # the accelerations of the intervals


def follow(t: Array, edges: Array) -> tuple[Array, Array, Array]:
    """Return place, velocity and acceleration (..., 1) from 0.3 m at 0.5 m/s on; at an edge, of the interval before."""
    k = np.clip(np.searchsorted(edges, t, side="left") - 1, 0, 2)
    lengths = np.diff(edges)
    speeds = np.concatenate(([0.5], 0.5 + np.cumsum(PUSHES * lengths)))
    ways = np.concatenate(([0.3], 0.3 + np.cumsum((speeds[:-1] + speeds[1:]) / 2 * lengths)))
    s = t - edges[k]
    return (
        (ways[k] + speeds[k] * s + PUSHES[k] * s**2 / 2)[..., None],
        (speeds[k] + PUSHES[k] * s)[..., None],
        PUSHES[k][..., None],
    )


def rails() -> Peer:
    """Two sliders of 1 kg, x pushed; a loop holds y at 2 x: 5 kg along x."""
    q, qd = ca.SX.sym("q", 2), ca.SX.sym("qd", 2)
    joints = [Coordinate(name=n, motion="prismatic", actuated=n == "x", **FREE) for n in "xy"]
    h, sensor = ca.SX(q[1] - 2 * q[0]), ca.vertcat(q, ca.SX(0))
    energy = ca.SX(ca.sumsqr(qd) / 2)
    return close("rails", (q, qd), energy, ca.SX(0), h, joints, sensor, independent=(0,), pose=(0.3, 0.6))


def push_rails(problem: Problem) -> Trajectory:
    """Return the motion of the mass on both rails, by five times the force."""
    t, point_t = problem.grid.times(T, schemes.build(problem.family, 2).points)
    twice = np.array([1.0, 2.0])
    (q, qd, _), points = (
        (place * twice, rate * twice, push_ * twice) for place, rate, push_ in (follow(t, t), follow(point_t, t))
    )
    return Trajectory(t, q, qd, 5 * PUSHES[:, None], point_t, *points)


def sled() -> Peer:
    """Three sliders of 1 kg: x and y have motors, z is driven; a force acts on them, and x has a damping of 0.3."""
    q, qd, qdd, u, w, tau = (
        ca.SX.sym(n, k) for n, k in (("q", 3), ("qd", 3), ("qdd", 3), ("u", 2), ("w", 3), ("tau", 1))
    )
    Phi = qdd - ca.vertcat(u, tau) - w
    Phi[0] += 0.3 * qd[0]
    inputs = [q, qd, qdd, u, w, tau]
    sensors, R = ca.horzcat(2 * q, q), ca.horzcat(*[ca.SX.eye(3)] * 3)
    return Peer(
        "sled",
        {
            "impl": ca.Function("peer_impl", inputs, [Phi], ["q", "qd", "qdd", "u", "w", "tau"], ["Phi"]),
            **pose_functions(q, sensors, ca.horzcat(q, sensors), R),
        },
        [Coordinate(name=n, motion="prismatic", actuated=n != "z", **FREE) for n in "xyz"],
        [Frame(name=n, parent=0 if n else -1, sensor=bool(n)) for n in ("", "far", "hand")],
        wrenches=(Wrench(name="hand", frame=0, in_base=True, force=True, moment=False),),
        driven=(2,),
    )


def push_sled(
    family: Family, integrator: Literal["collocation", "second-order"] = "collocation", is_free: bool = False
) -> tuple[Problem, Trajectory]:
    """Push x, and let a given force take its damping away; y stands against a given input; z moves as given.

    A state that the problem adds is the integral of a t + c, with a = 3 and a constant c in each interval.
    """
    problem = replace(
        push(3, family, 3),
        horizon=T,
        horizon_range=(1.0, 2.0) if is_free else None,
        mesh=MESH,
        start_q=(0.3, 0.2, 0.0),
        start_qd=(0.5, 0.0, 0.1),
        bounds=Bounds((FREE_RANGE,) * 3, (FREE_RANGE,) * 3, (FREE_RANGE,) * 2, tau=(FREE_RANGE,)),
        end=End(),
        forces=(Force(1, "1 + 2*t"),),
        wrenches=(
            WrenchComponent("hand", 0, "0.3*qd_x + 0.2"),
            WrenchComponent("hand", 1),
            WrenchComponent("hand", 2),
        ),
        contacts=(Contact("hand", "hand", axes=(1,), normal=None),),
        integrator=integrator,
        driven=(Drive(2, "0.4*t**2 + 0.1*t"),),
        states=(State("s", "a*t + c", start=(0.25, 0.25)),),
        controls=(Control("c"),),
        unknowns=(Unknown("a"),),
    )
    scheme = schemes.build(family, 3)
    t, point_t = problem.grid.times(T, scheme.points)

    def move(t_: Array) -> tuple[Array, Array, Array]:
        x = follow(t_, t)
        one = np.ones((*t_.shape, 1))
        return (
            np.concatenate((x[0], 0.2 * one, (0.4 * t_**2 + 0.1 * t_)[..., None]), axis=-1),
            np.concatenate((x[1], 0 * one, (0.8 * t_ + 0.1)[..., None]), axis=-1),
            np.concatenate((x[2], 0 * one, 0.8 * one), axis=-1),
        )

    points = move(point_t)
    given = 1 + 2 * point_t
    w = np.stack((0.3 * points[1][..., 0] + 0.2, -given, 0.7 + 0 * given), axis=-1)
    u = np.stack((np.repeat((PUSHES - 0.2)[:, None], 3, axis=1), given), axis=-1)
    mean = np.einsum("j,kjm->km", scheme.weights, u)
    chosen = np.array([0.5, -1.0, 2.0])
    begun = 0.25 + np.concatenate(([0.0], np.cumsum(chosen * np.diff(t))))
    states = begun + 1.5 * t**2
    point_states = begun[:-1, None] + chosen[:, None] * (point_t - t[:-1, None]) + 1.5 * point_t**2
    motion = Trajectory(
        t, *move(t)[:2], mean, point_t, *points, states=states[:, None],
        point_states=point_states[..., None], point_u=u, point_w=w, controls=chosen[:, None], unknowns=np.array([3.0]),
    )  # fmt: skip
    return problem, motion
