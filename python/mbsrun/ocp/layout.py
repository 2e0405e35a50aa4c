"""Where a motion lies among the variables of a program, and where functions of it are applied.

Interval by interval: the state x_k = (q, qd) at the mesh point; at each collocation point the state x_kj and, unless
the equations of motion are an ODE, the acceleration z_kj; the inputs u_k, constant over the interval. At the end x_N,
and the horizon T where it is free.

In the integral form the states at the points are no variables. With A the scheme's integration matrix, c its points:

    qd_kj = qd_k + h sum_l A_jl z_kl,   q_kj = q_k + h c_j qd_k + h^2 sum_l (A A)_jl z_kl
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from mbsrun.ocp.problem import Form, Representation
from mbsrun.ocp.program import Indices, Matrix
from mbsrun.ocp.schemes import Scheme

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Layout:
    """Where a motion lies among the variables; n coordinates, m inputs, N intervals with d points each."""

    mesh: Indices  # (N + 1, 2 n): states at the mesh points
    points: Indices  # (N, d, 2 n): states at the collocation points; (N, d, 0) in the integral form
    accelerations: Indices  # (N, d, n): accelerations at the collocation points; (N, d, 0) for an ODE
    inputs: Indices  # (N, m)
    horizon: int | None  # T, where it is free
    size: int

    @property
    def n(self) -> int:
        """Count the coordinates."""
        return int(self.mesh.shape[1]) // 2


def lay_out(
    n: int, m: int, intervals: int, degree: int, representation: Representation, form: Form, horizon_is_free: bool
) -> Layout:
    """Number the variables."""
    N, d, states = intervals, degree, 2 * n * (form is Form.STANDARD)
    at_point = states + n * (not representation.is_ode)
    stride = 2 * n + d * at_point + m
    first = np.arange(N + 1) * stride
    points = first[:N, None, None] + 2 * n + np.arange(d)[:, None] * at_point + np.arange(at_point)
    return Layout(
        mesh=first[:, None] + np.arange(2 * n),
        points=points[:, :, :states],
        accelerations=points[:, :, states:],
        inputs=first[1:, None] - m + np.arange(m),
        horizon=N * stride + 2 * n if horizon_is_free else None,
        size=N * stride + 2 * n + horizon_is_free,
    )


@dataclass(frozen=True)
class Places:
    """Where functions of the motion are applied: parts of the variables as a block takes them."""

    q: Indices | Matrix  # (n, places)
    qd: Indices | Matrix
    qdd: Indices | Matrix  # (0, places) where accelerations are no variables
    u: Indices  # (m, places)
    s: Array  # (places,): time over the horizon


def at_points(layout: Layout, scheme: Scheme, h: float) -> Places:
    """Give all collocation points, interval by interval; h is the length of an interval, for the integral form."""
    N, d, _ = layout.points.shape
    n = layout.n
    inputs = np.broadcast_to(layout.inputs[:, None, :], (N, d, layout.inputs.shape[1]))
    qdd, u = (part.reshape(N * d, -1).T for part in (layout.accelerations, inputs))
    s = (np.arange(N)[:, None] + scheme.points).ravel() / N
    if not layout.points.size:
        return Places(*integrals(layout, scheme, h), qdd, u, s)
    q, qd = (part.reshape(N * d, n).T for part in np.split(layout.points, 2, axis=2))
    return Places(q, qd, qdd, u, s)


def integrals(layout: Layout, scheme: Scheme, h: float) -> tuple[Matrix, Matrix]:
    """Give q and qd at the points, each (N d n, variables), as linear functions of the variables."""
    N, d, n = layout.accelerations.shape
    A = scheme.integration
    row = np.arange(N * d * n).reshape(N, d, n)
    q, qd = (np.broadcast_to(part[:, None, :], row.shape) for part in np.split(layout.mesh[:-1], 2, axis=1))
    shape = (row.size, layout.size)

    def matrix(parts: Sequence[tuple[Indices, Array]], weights: Array) -> Matrix:
        """Put columns with a value for each point, and accelerations with weights, (d, d)."""
        columns = [col.ravel() for col, _ in parts]
        values = [np.broadcast_to(value[:, None], row.shape).ravel() for _, value in parts]
        rows = [row.ravel()] * len(parts)
        for j in range(d):
            z = layout.accelerations  # (N, d, n): of all points, for the one point j
            rows.append(np.broadcast_to(row[:, None, j], z.shape).ravel())
            columns.append(z.ravel())
            values.append(np.broadcast_to(weights[j][:, None], z.shape).ravel())
        triplets = (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns)))
        return sparse.coo_array(triplets, shape).tocsc()

    one = np.ones(d)
    return matrix([(q, one), (qd, h * scheme.points)], h**2 * A @ A), matrix([(qd, one)], h * A)


def at_mesh(layout: Layout, scheme: Scheme, k: Sequence[int]) -> Places:
    """Give some mesh points, with the inputs of the interval before; the first has those of the interval after.

    Accelerations there are those of the polynomial through the points of that interval.
    """
    at, points = np.array(k, dtype=np.int64), layout.accelerations
    interval, n = np.maximum(at - 1, 0), layout.n
    q, qd = layout.mesh[at].T.reshape(2, n, at.size)
    s = at / len(layout.inputs)
    if not points.size:
        return Places(q, qd, np.zeros((0, at.size), dtype=np.int64), layout.inputs[interval].T, s)
    basis = np.where(at[:, None] == 0, scheme.start_of_points, scheme.end_of_points)  # (places, d)
    col = points[interval]  # (places, d, n)
    row = np.broadcast_to(np.arange(at.size * n).reshape(-1, 1, n), col.shape)
    value = np.broadcast_to(basis[:, :, None], col.shape)
    qdd = sparse.coo_array((value.ravel(), (row.ravel(), col.ravel())), (at.size * n, layout.size)).tocsc()
    qdd.eliminate_zeros()
    return Places(q, qd, qdd, layout.inputs[interval].T, s)
