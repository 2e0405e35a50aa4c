"""Where a motion lies among the variables of a program, and where functions of it are applied.

Interval by interval: the state x_k = (q, qd) at the mesh point; at each collocation point the state x_kj and, unless
the equations of motion are an ODE, the acceleration z_kj; the inputs u_k, constant over the interval. At the end x_N.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mbsrun.ocp.problem import Representation
from mbsrun.ocp.program import Indices, Matrix


@dataclass(frozen=True)
class Layout:
    """Where a motion lies among the variables; n coordinates, m inputs, N intervals with d points each."""

    mesh: Indices  # (N + 1, 2 n): states at the mesh points
    points: Indices  # (N, d, 2 n): states at the collocation points
    accelerations: Indices  # (N, d, n): accelerations at the collocation points; (N, d, 0) for an ODE
    inputs: Indices  # (N, m)
    size: int

    @property
    def n(self) -> int:
        """Count the coordinates."""
        return int(self.mesh.shape[1]) // 2


def lay_out(n: int, m: int, intervals: int, degree: int, representation: Representation) -> Layout:
    """Number the variables."""
    N, d, at_point = intervals, degree, (2 if representation.is_ode else 3) * n
    stride = 2 * n + d * at_point + m
    first = np.arange(N + 1) * stride
    points = first[:N, None, None] + 2 * n + np.arange(d)[:, None] * at_point + np.arange(at_point)
    return Layout(
        mesh=first[:, None] + np.arange(2 * n),
        points=points[:, :, : 2 * n],
        accelerations=points[:, :, 2 * n :],
        inputs=first[1:, None] - m + np.arange(m),
        size=N * stride + 2 * n,
    )


@dataclass(frozen=True)
class Places:
    """Where functions of the motion are applied: parts of the variables as a block takes them."""

    q: Indices | Matrix  # (n, places)
    qd: Indices | Matrix
    qdd: Indices | Matrix  # (0, places) where accelerations are no variables
    u: Indices  # (m, places)


def collocation_points(layout: Layout) -> Places:
    """Give all collocation points, interval by interval."""
    N, d, _ = layout.points.shape
    n = layout.n
    inputs = np.broadcast_to(layout.inputs[:, None, :], (N, d, layout.inputs.shape[1]))
    parts = (layout.points[:, :, :n], layout.points[:, :, n:], layout.accelerations, inputs)
    q, qd, qdd, u = (part.reshape(N * d, -1).T for part in parts)
    return Places(q, qd, qdd, u)


def end(layout: Layout) -> Places:
    """Give the end of the horizon, with the inputs of the last interval."""
    q, qd = layout.mesh[-1].reshape(2, -1, 1)
    return Places(q, qd, np.zeros((0, 1), dtype=np.int64), layout.inputs[-1, :, None])
