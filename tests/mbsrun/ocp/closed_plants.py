"""Mechanisms with closed loops, made by hand: Lagrange's equations in CasADi, with the kernels of generated models.

d/dt dT/dqd - dT/dq + dV/dq - B u - J' lam = 0,    h(q) = 0
"""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca

from mbsgen.manifest import Coordinate, Frame, Loop, Wrench
from tests.mbsrun.peer import FREE, Peer, pose_functions

G = 9.81


def pendulum_of_rods(*, is_held: bool = False) -> Peer:
    """A point of 1 kg in the plane, 1 m from the origin: q = (x, y), pushed along x; x determines y.

    Where it is held, a force on it is open, by the name of its sensor.
    """
    q, qd = ca.SX.sym("q", 2), ca.SX.sym("qd", 2)
    joints = [Coordinate(name=name, motion="prismatic", actuated=name == "x", **FREE) for name in ("x", "y")]
    return close(
        "pendulum of rods",
        (q, qd),
        ca.SX(ca.sumsqr(qd) / 2),
        G * q[1],
        ca.SX((ca.sumsqr(q) - 1) / 2),
        joints,
        ca.vertcat(q, ca.SX(0)),
        independent=(0,),
        pose=(0.0, -1.0),
        is_held=is_held,
    )


def five_bar() -> Peer:
    """Two arms of 0.3 and 0.35 m, 0.2 m apart, whose hands are one point; the motors are at the base."""
    q, qd = ca.SX.sym("q", 4), ca.SX.sym("qd", 4)  # shoulder and elbow of the left arm, then of the right one
    T, V, hands = ca.SX(0), ca.SX(0), []
    for k, x in ((0, -0.1), (2, 0.1)):
        at, angle = ca.SX([x, 0.0]), ca.SX(0)
        for i, (length, mass) in enumerate(((0.3, 1.0), (0.35, 0.6))):
            angle += q[k + i]
            along = ca.vertcat(ca.cos(angle), ca.sin(angle))
            centre = at + length / 2 * along
            at = at + length * along
            v, w = ca.jtimes(centre, q, qd), ca.jtimes(angle, q, qd)
            T += mass * ca.sumsqr(v) / 2 + mass * length**2 / 12 * w**2 / 2
            V += mass * G * centre[1]
        hands.append(at)
    names = ("left", "left_elbow", "right", "right_elbow")
    joints = [Coordinate(name=n, motion="revolute", actuated=n in ("left", "right"), **FREE) for n in names]
    return close(
        "five-bar",
        (q, qd),
        T,
        V,
        hands[0] - hands[1],
        joints,
        ca.vertcat(hands[0], ca.SX(0)),
        independent=(0, 2),
        pose=FIVE_BAR_POSE,
    )


FIVE_BAR_POSE = (2.2, -1.05, 0.9415926535897931, 1.05)  # near the closed one


def close(
    name: str,
    state: tuple[ca.SX, ca.SX],
    T: ca.SX,
    V: ca.SX,
    h: ca.SX,
    joints: Sequence[Coordinate],
    sensor: ca.SX,
    independent: tuple[int, ...],
    pose: tuple[float, ...],
    *,
    is_held: bool = False,
) -> Peer:
    """Make the mechanism of kinetic energy, potential energy and loops; it has one sensor, `hand`."""
    (q, qd), n, m = state, len(joints), h.numel()
    qdd, lam = ca.SX.sym("qdd", n), ca.SX.sym("lam", m)
    actuated = [i for i, joint in enumerate(joints) if joint.actuated]
    u = ca.SX.sym("u", len(actuated))
    B = ca.DM.zeros(n, len(actuated))
    for k, i in enumerate(actuated):
        B[i, k] = 1
    momentum, J = ca.gradient(T, qd), ca.jacobian(h, q)
    tree = ca.jtimes(momentum, qd, qdd) + ca.jtimes(momentum, q, qd) - ca.gradient(T - V, q) - B @ u
    Phi, hd = tree - J.T @ lam, J @ qd
    hdd = ca.jtimes(hd, q, qd) + J @ qdd
    M, c = ca.jacobian(momentum, qd), ca.substitute(tree, qdd, 0)
    gamma = ca.substitute(hdd, qdd, 0)
    whole = ca.solve(ca.blockcat([[M, -J.T], [J, ca.SX(m, m)]]), -ca.vertcat(c, gamma))
    dependent = tuple(i for i in range(n) if i not in independent)
    yd, ydd = (ca.SX.sym(name, len(independent)) for name in ("yd", "ydd"))
    Z = ca.SX(n, len(independent))
    Z[list(independent), :] = ca.SX.eye(len(independent))
    Z[list(dependent), :] = -ca.solve(J[:, list(dependent)], J[:, list(independent)])
    qd_of = Z @ yd
    bias = ca.SX(n, 1)
    bias[list(dependent)] = -ca.solve(J[:, list(dependent)], ca.substitute(gamma, qd, qd_of))
    reduced = Z.T @ ca.substitute(ca.substitute(tree, qdd, Z @ ydd + bias), qd, qd_of)
    solved = ca.solve(ca.jacobian(reduced, ydd), -ca.substitute(reduced, ydd, 0))
    w = ca.SX.sym("w", 3)
    held = ca.jacobian(sensor, q).T @ w

    def make(kernel: str, inputs: str, **results: ca.SX) -> ca.Function:
        symbols = {"q": q, "qd": qd, "qdd": qdd, "lam": lam, "u": u, "yd": yd, "ydd": ydd, "w": w}
        taken = inputs.split()
        arguments = [symbols[x] for x in taken]
        return ca.Function(f"peer_{kernel}", arguments, [*results.values()], taken, [*results], {"cse": True})

    explicit = {"qdd": whole[:n], "lam": whole[n:]}
    functions = [
        make("impl", "q qd qdd lam u" + " w" * is_held, Phi=Phi - held if is_held else Phi),
        make("semi_res", "q qd qdd lam u", Phi=Phi),
        *(make(kernel, "q qd u", **explicit) for kernel in ("exp1", "exp2")),
        make("loops", "q", gap=h),
        make("loop_rates", "q qd", hd=hd),
        make("loop_jacobian", "q qd", J=J, gamma=gamma),
        make("loop_forces", "q lam", Q=J.T @ lam),
        make("impl_red", "q yd ydd u", Phi=reduced),
        make("exp1_red", "q yd u", ydd=solved),
    ]
    frames = [Frame(name="body", parent=-1, sensor=False), Frame(name="hand", parent=0, sensor=True)]
    axes = ca.horzcat(ca.SX.eye(3), ca.SX.eye(3))
    poses = pose_functions(q, sensor, ca.horzcat(ca.SX.zeros(3), sensor), axes)
    loop = Loop(name="loop", cut="ball", equations=("x", "y", "z")[:m])
    return Peer(
        name,
        {function.name().removeprefix("peer_"): function for function in functions} | poses,
        joints,
        frames,
        loops=(loop,),
        wrenches=(Wrench(name="hand", frame=0, in_base=True, force=True, moment=False),) if is_held else (),
        independent=independent,
        dependent=dependent,
        pose=pose,
    )
