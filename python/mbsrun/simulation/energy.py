"""The energies of a motion, and the work of all forces but gravity: the power qd . Q, by Gauss quadrature in each step.

States within a step are the integrator's own interpolation, or else the quintic that has its coordinates, velocities
and accelerations at both ends; with three nodes a step the work errs by O(h^6).
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from mbsrun.simulation.drive import Piece
from mbsrun.simulation.dynamics import Dynamics
from mbsrun.simulation.motion import Chunk

Array = NDArray[np.float64]

NODES = (np.polynomial.legendre.leggauss(3)[0] + 1) / 2
WEIGHTS = np.polynomial.legendre.leggauss(3)[1] / 2


def add_up_work(dynamics: Dynamics, piece: Piece, chunk: Chunk) -> Array:
    """Integrate the power over each step, shape (k,). Raises KernelError and SingularError."""
    length = np.diff(chunk.t)
    times = (chunk.t[:-1, None] + length[:, None] * NODES).ravel()
    if chunk.dense is not None:
        q, qd = chunk.dense(times, np.repeat(np.arange(len(length)), NODES.size))
    else:
        qdd = dynamics.accelerations(chunk.q, chunk.qd, piece.values(chunk.t))
        q, qd = _interpolate(length, chunk.q, chunk.qd, qdd)
    power = (dynamics.forces(q, qd, piece.values(times)) * qd).sum(axis=1)
    return np.asarray(length * (power.reshape(-1, NODES.size) @ WEIGHTS))


def _interpolate(length: Array, q: Array, qd: Array, qdd: Array) -> tuple[Array, Array]:
    """Evaluate the quintics at the nodes: q, qd of shape (k NODES, n)."""
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
    n = q.shape[1]
    return np.reshape(place, (-1, n)), np.reshape(rate, (-1, n))


Polynomial = np.polynomial.Polynomial
_BASIS: Mapping[str, tuple[Polynomial, Polynomial]] = MappingProxyType(  # at the start, at the end of [0, 1]
    {
        "q": (Polynomial([1, 0, 0, -10, 15, -6]), Polynomial([0, 0, 0, 10, -15, 6])),
        "qd": (Polynomial([0, 1, 0, -6, 8, -3]), Polynomial([0, 0, 0, -4, 7, -3])),
        "qdd": (Polynomial([0, 0, 0.5, -1.5, 1.5, -0.5]), Polynomial([0, 0, 0, 0.5, -1, 0.5])),
    }
)
