"""An arm with two muscles, by hand: the equations of models/muscles/arm.yaml, for CasADi.

They are Lagrange's of two rods, from kinetic and potential energies, with a tension T of a muscle of length L as the
generalised forces -T dL/dq.
"""

from __future__ import annotations

import casadi as ca

STRENGTHS, FIBRES, TENDONS = (450, 300), (0.11, 0.13), (0.06, 0.15)


def turn(q: ca.SX, x: float, z: float) -> ca.SX:
    """Turn a point (x, z) forward, by q."""
    return ca.vertcat(x * ca.cos(q) - z * ca.sin(q), x * ca.sin(q) + z * ca.cos(q))


def write_arm() -> ca.Function:
    """(q, qd, activations) -> qdd: two rods of 2 kg and 1.5 kg, with the deltoid and the brachialis."""
    q, qd, act = (ca.SX.sym(name, 2) for name in ("q", "qd", "act"))
    elbow = turn(q[0], 0, -0.3)
    both = q[0] + q[1]
    centres = (turn(q[0], 0, -0.13), elbow + turn(both, 0, -0.16))
    rates = (qd[0], qd[0] + qd[1])
    kinetic = potential = 0
    for m, inertia, centre, rate in zip((2, 1.5), (0.015, 0.012), centres, rates, strict=True):
        kinetic += m * ca.sumsqr(ca.jtimes(centre, q, qd)) / 2 + inertia * rate**2 / 2
        potential += m * 9.81 * centre[1]
    insertions = (turn(q[0], 0.02, -0.12), elbow + turn(both, 0.02, -0.05))
    origins = (ca.DM([0.06, 0.05]), turn(q[0], 0.02, -0.05))
    Q = -ca.gradient(potential, q)
    for i, (origin, insertion) in enumerate(zip(origins, insertions, strict=True)):
        length = ca.norm_2(insertion - origin)
        Q -= ca.gradient(length, q) * pull(i, length, ca.jtimes(length, q, qd), act[i])
    momentum = ca.gradient(kinetic, qd)
    M = ca.jacobian(momentum, qd)
    qdd = ca.solve(M, Q + ca.gradient(kinetic, q) - ca.jtimes(momentum, q, qd))
    return ca.Function("arm", [q, qd, act], [qdd])


def pull(i: int, length: ca.SX, rate: ca.SX, act: ca.SX) -> ca.SX:
    """Return the tension of a muscle, by the published curves."""
    x = (length - TENDONS[i]) / FIBRES[i]
    v = rate / FIBRES[i] / 10
    shapes = (
        (0.8150671134243542, 1.055033428970575, 0.162384573599574, 0.063303448465465),
        (0.433004984392647, 0.716775413397760, -0.029947116970696, 0.200356847296188),
        (0.1, 1, 8**-0.5, 0),
    )
    active = sum(a * ca.exp(-((x - b) ** 2) / (2 * (c + d * x) ** 2)) for a, b, c, d in shapes)
    by_rate = -0.3211346127989808 * ca.asinh(-8.149 * v - 0.374) + 0.8825327733249912
    passive = (ca.exp(4 * (x - 1) / 0.6) - ca.exp(4 * (0.2 - 1) / 0.6)) / (ca.exp(4) - ca.exp(4 * (0.2 - 1) / 0.6))
    return STRENGTHS[i] * (act * active * by_rate + passive)
