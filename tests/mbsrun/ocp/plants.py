"""Small tasks and mechanisms of optimal control, with known solutions or known troubles."""

from __future__ import annotations

import casadi as ca
import numpy as np

from mbsgen.manifest import Coordinate, Frame
from mbsrun.ocp.ground.schemes import Family
from mbsrun.ocp.problem.problem import Bounds, Cost, End, Problem
from tests.mbsrun.peer import FREE, Peer, explicit_functions, pose_functions, residual_function

FREE_RANGE = (-np.inf, np.inf)


def push(N: int, family: Family = Family.RADAU, degree: int = 2) -> Problem:
    """Push a mass of 1 kg over 1 m in 1 s, from rest to rest."""
    return Problem(
        name="push",
        horizon=1.0,
        intervals=N,
        family=family,
        degree=degree,
        cost=Cost(1.0, 0.0),
        start_q=(0.0,),
        start_qd=(0.0,),
        bounds=Bounds((FREE_RANGE,), (FREE_RANGE,), (FREE_RANGE,)),
        end=End(coordinates=((0, 1.0),), velocity_zero=True),
    )


def pendulum() -> Peer:
    """A pendulum of length g."""
    q, qd, qdd, u = symbols = tuple(ca.SX.sym(name) for name in ("q", "qd", "qdd", "u"))
    return mechanism(("q",), qdd + ca.sin(q) - u + 0 * qd, symbols)


def cart_pole() -> Peer:
    """A cart of 1 kg and a pole with 0.3 kg at 0.5 m, hanging at 0 (M. Kelly, SIAM Review 59 (2017), section 6)."""
    q, qd, qdd, u = ca.SX.sym("q", 2), ca.SX.sym("qd", 2), ca.SX.sym("qdd", 2), ca.SX.sym("u")
    m1, m2, l, g = 1.0, 0.3, 0.5, 9.81
    s, c = ca.sin(q[1]), ca.cos(q[1])
    Phi = ca.vertcat(
        (m1 + m2) * qdd[0] + m2 * l * (c * qdd[1] - s * qd[1] ** 2) - u,
        m2 * l * (c * qdd[0] + l * qdd[1] + g * s),
    )
    p = ca.horzcat(ca.vertcat(q[0], 0, 0), ca.vertcat(q[0] + l * s, 0, -l * c))
    coordinates = [
        Coordinate(name="cart", motion="prismatic", actuated=True, **FREE),
        Coordinate(name="pole", motion="revolute", actuated=False, **FREE),
    ]
    frames = [Frame(name=name, parent=i - 1, sensor=False) for i, name in enumerate(("cart", "pole"))]
    R = ca.horzcat(ca.SX.eye(3), ca.SX.eye(3))
    functions = {"impl": residual_function(q, qd, qdd, u, Phi), **pose_functions(q, p, p, R)}
    return Peer("cart-pole", functions, coordinates, frames)


def unstable(rate: float) -> Peer:
    """x'' = rate^2 sin x + u: small motions grow by exp(rate t)."""
    q, qd, qdd, u = (ca.SX.sym(name) for name in ("q", "qd", "qdd", "u"))
    p = ca.vertcat(q, 0, 0)
    return Peer(
        "unstable",
        {
            "impl": residual_function(q, qd, qdd, u, qdd - rate**2 * ca.sin(q) - u),
            **pose_functions(q, p, p, ca.SX.eye(3)),
        },
        [Coordinate(name="x", motion="prismatic", actuated=True, **FREE)],
        [Frame(name="x", parent=-1, sensor=False)],
    )


def mechanism(names: tuple[str, ...], residual: ca.SX, symbols: tuple[ca.SX, ...]) -> Peer:
    """Make a mechanism of its equations of motion alone; all coordinates are driven."""
    function = residual_function(*symbols, residual)
    p, R = ca.SX.zeros(3), ca.SX.eye(3)
    poses = pose_functions(symbols[0], p, ca.horzcat(p, p), ca.horzcat(R, R))
    return Peer(
        "by hand",
        {"impl": function, **explicit_functions(function), **poses},
        [Coordinate(name=name, motion="prismatic", actuated=True, **FREE) for name in names],
        [Frame(name="body", parent=-1, sensor=False), Frame(name="place", parent=0, sensor=True)],
    )
