"""The energies of a motion, and the work of all forces but gravity.

    T + V = T_0 + V_0 + W,    W = integral of the power of inputs, springs, dampers, friction and wrenches

The kernel `power` gives the integrand; Gauss quadrature sums it in each step. That kernel shares no equation with those
of the accelerations: a fault in these shows as a drift of energy.

The quadrature takes the stages of an implicit method; else Gauss nodes in each step: five where the motion is the
integrator's own interpolation, of an order up to 8; three where it is the quintic through coordinates and their first
two derivatives at both ends. Velocities that are no rates of coordinates are cubic then.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from mbsrun.simulation.drive import Piece
from mbsrun.simulation.dynamics import Dynamics
from mbsrun.simulation.integration.holding import Forces
from mbsrun.simulation.integration.joints import Joints
from mbsrun.simulation.motion import Chunk, Stages

Array = NDArray[np.float64]

(NODES, WEIGHTS), MANY = (((x + 1) / 2, w / 2) for x, w in map(np.polynomial.legendre.leggauss, (3, 5)))


def add_up_work(dynamics: Dynamics, piece: Piece, chunk: Chunk) -> Array:
    """Compute the work of all forces but gravity in each step, shape (k,). Raises KernelError and SingularError."""
    stages, length = chunk.stages or _place_nodes(dynamics, piece, chunk), np.diff(chunk.t)
    k, s, _ = stages.q.shape
    q, qd = (x.reshape(k * s, -1) for x in (stages.q, stages.qd))
    v = piece.follow(stages.t.ravel(), q, qd)
    power = dynamics.call("power", q, qd, v)["power"]
    driven = list(dynamics.kernels.manifest.driven)
    if driven:
        if chunk.segment is None:
            driving = dynamics.forces(stages.t.ravel(), q, qd, v)[1]
        else:
            modes = np.tile(chunk.segment.modes, (k * s, 1))
            driving = Forces(dynamics).drive(stages.t.ravel(), q, qd, v, modes)
        power = power.reshape(-1) + (driving * qd[:, driven]).sum(axis=1)
    return np.asarray(length * (power.reshape(k, s) @ stages.weights))


def add_up_friction(joints: Joints, chunk: Chunk) -> Array:
    """Compute the energy that dry friction takes in each step, shape (k,): exact where it is constant."""
    assert chunk.segment is not None, "a chunk with a mode"
    assert chunk.dense is not None, "a chunk of an explicit method"
    (nodes, weights), length, lost = MANY, np.diff(chunk.t), np.zeros(len(chunk.t) - 1)
    sliding = [i for i, mode in enumerate(chunk.segment.modes) if abs(mode) == 1 and joints.is_dry[i]]
    for i in sliding:
        lost += joints.torque[i] * np.abs(np.diff(chunk.q[:, joints.place[i]]))
    if chunk.segment.push is not None:
        t = chunk.t[:-1, None] + length[:, None] * nodes
        state = chunk.dense(t.ravel(), np.repeat(np.arange(len(length)), nodes.size))
        power = chunk.segment.push(t.ravel(), *state)[2]
        lost += length * (power.reshape(t.shape) @ weights)
    if any(joints.stribeck[i] > 0 for i in sliding):
        t = chunk.t[:-1, None] + length[:, None] * nodes
        qd = chunk.dense(t.ravel(), np.repeat(np.arange(len(length)), nodes.size))[1]
        power = ((joints.rub(qd) - joints.torque) * np.abs(qd))[:, sliding].sum(axis=1)
        lost += length * (power.reshape(t.shape) @ weights)
    return lost


def _place_nodes(dynamics: Dynamics, piece: Piece, chunk: Chunk) -> Stages:
    """Read the motion at the nodes of Gauss's quadrature."""
    length, (nodes, weights) = np.diff(chunk.t), (NODES, WEIGHTS) if chunk.dense is None else MANY
    t = chunk.t[:-1, None] + length[:, None] * nodes
    if chunk.dense is None:
        qdd = dynamics.accelerations(chunk.q, chunk.qd, piece.follow(chunk.t, chunk.q, chunk.qd))
        first = dynamics.rates(chunk.q, chunk.qd)
        second = qdd
        if dynamics.kernels.manifest.configuration:
            by_q, by_qd = dynamics.rate_slopes(chunk.q, chunk.qd)
            second = np.einsum("kij,kj->ki", by_q, first) + np.einsum("kij,kj->ki", by_qd, qdd)
        q, qd = interpolate(length, chunk.q, first, second)
        if dynamics.kernels.manifest.configuration:
            qd = connect(length, chunk.qd, qdd)
    else:
        q, qd = chunk.dense(t.ravel(), np.repeat(np.arange(len(length)), nodes.size))
        q, qd = (x.reshape(*t.shape, -1) for x in (q, qd))
    return Stages(t, q, qd, weights)


def interpolate(length: Array, q: Array, qd: Array, qdd: Array) -> tuple[Array, Array]:
    """Evaluate the quintics at three nodes: q, qd of shape (k, 3, n)."""
    h = length[:, None, None]
    data = {
        "q": (q[:-1, None], q[1:, None]),
        "qd": (h * qd[:-1, None], h * qd[1:, None]),
        "qdd": (h**2 * qdd[:-1, None], h**2 * qdd[1:, None]),
    }
    place, rate = np.zeros((1, 1, 1)), np.zeros((1, 1, 1))
    for name, ends in data.items():
        for polynomial, end in zip(_BASIS[name], ends, strict=True):
            place = place + polynomial(NODES)[:, None] * end
            rate = rate + polynomial.deriv()(NODES)[:, None] * end / h
    return place, rate


def connect(length: Array, qd: Array, qdd: Array) -> Array:
    """Evaluate at three nodes the cubics through velocities and accelerations at both ends: (k, 3, n)."""
    s, h = NODES[:, None], length[:, None, None]
    ends = (1 - s) ** 2 * ((1 + 2 * s) * qd[:-1, None] + s * h * qdd[:-1, None])
    return np.asarray(ends + s**2 * ((3 - 2 * s) * qd[1:, None] + (s - 1) * h * qdd[1:, None]))


Polynomial = np.polynomial.Polynomial
_BASIS: Mapping[str, tuple[Polynomial, Polynomial]] = MappingProxyType(  # at the start, at the end of [0, 1]
    {
        "q": (Polynomial([1, 0, 0, -10, 15, -6]), Polynomial([0, 0, 0, 10, -15, 6])),
        "qd": (Polynomial([0, 1, 0, -6, 8, -3]), Polynomial([0, 0, 0, -4, 7, -3])),
        "qdd": (Polynomial([0, 0, 0.5, -1.5, 1.5, -0.5]), Polynomial([0, 0, 0, 0.5, -1, 0.5])),
    }
)
