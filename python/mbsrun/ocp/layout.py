"""Where a motion lies among the variables of a program, and where functions of it are applied.

Interval by interval: the state x_k = (q, qd) at the mesh point; at each collocation point the state x_kj and, unless
the equations of motion are an ODE, the acceleration z_kj; the inputs u_k, constant over the interval. At the end x_N,
and the horizon T where it is free. With quaternions there are more entries of q than of qd and z.

In the integral form the states at the points are no variables: they are linear in x_k and the accelerations at the
stages of an integrator, which are those at the points unless the integrator says otherwise (see `integrators`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from mbsrun.ocp.integrators import Integrator, Reading
from mbsrun.ocp.program import Indices, Matrix

Array = NDArray[np.float64]
Scalar = TypeVar("Scalar", np.float64, np.int64)


@dataclass(frozen=True)
class Layout:
    """Where a motion lies among the variables; nq coordinates, n velocities, m inputs, N intervals, S stages each."""

    nq: int
    mesh: Indices  # (N + 1, nq + n): states at the mesh points
    points: Indices  # (N, S, nq + n): states at the stages; (N, S, 0) in the integral form
    accelerations: Indices  # (N, S, n): accelerations at the stages; (N, S, 0) for an ODE
    inputs: Indices  # (N, m)
    horizon: int | None  # T, where it is free
    size: int

    @property
    def n(self) -> int:
        """Count the velocities."""
        return int(self.mesh.shape[1]) - self.nq

    def split(self, states: NDArray[Scalar]) -> tuple[NDArray[Scalar], NDArray[Scalar]]:
        """Split states (..., nq + n), or what there is of each of their entries, into coordinates and velocities."""
        return states[..., : self.nq], states[..., self.nq :]


def lay_out(
    nq: int,
    n: int,
    m: int,
    intervals: int,
    stages: int,
    *,
    has_states: bool,
    has_accelerations: bool,
    horizon_is_free: bool,
) -> Layout:
    """Number the variables; `has_states` and `has_accelerations` tell what the stages have of their own."""
    N, S, width = intervals, stages, nq + n
    states = width * has_states
    at_stage = states + n * has_accelerations
    stride = width + S * at_stage + m
    first = np.arange(N + 1) * stride
    points = first[:N, None, None] + width + np.arange(S)[:, None] * at_stage + np.arange(at_stage)
    return Layout(
        nq=nq,
        mesh=first[:, None] + np.arange(width),
        points=points[:, :, :states],
        accelerations=points[:, :, states:],
        inputs=first[1:, None] - m + np.arange(m),
        horizon=N * stride + width if horizon_is_free else None,
        size=N * stride + width + horizon_is_free,
    )


@dataclass(frozen=True)
class Places:
    """Where functions of the motion are applied: parts of the variables as a block takes them."""

    q: Indices | Matrix  # (nq, places)
    qd: Indices | Matrix
    qdd: Indices | Matrix  # (0, places) where accelerations are no variables
    u: Indices  # (m, places)
    s: Array  # (places,): time over the horizon


def at_points(layout: Layout, integrator: Integrator, h: float) -> Places:
    """Give all points of the scheme, interval by interval; h is the length of an interval, for the integral form."""
    return _at(layout, integrator.points, h)


def at_stages(layout: Layout, integrator: Integrator, h: float) -> Places:
    """Give all stages of the integrator, likewise."""
    return _at(layout, integrator.stages, h)


def _at(layout: Layout, reading: Reading, h: float) -> Places:
    N, k = len(layout.inputs), len(reading.c)
    u = np.repeat(layout.inputs, k, axis=0).T
    s = (np.arange(N)[:, None] + reading.c).ravel() / N
    accelerations = layout.accelerations.reshape(N * layout.accelerations.shape[1], -1).T
    if layout.points.size:
        q, qd = (part.reshape(N * k, -1).T for part in layout.split(layout.points))
        return Places(q, qd, accelerations, u, s)
    motion = read_motion(layout, reading, h)
    return Places(motion.q, motion.qd, accelerations if reading.are_stages else motion.qdd, u, s)


@dataclass(frozen=True)
class Motion:
    """A motion at k places of every interval, as linear functions of the variables, each (N k n, variables)."""

    q: Matrix
    qd: Matrix
    qdd: Matrix


def read_motion(layout: Layout, reading: Reading, h: float) -> Motion:
    """Read a motion, without quaternions, off the states at the mesh points and the accelerations at the stages."""
    (N, _, n), k = layout.accelerations.shape, len(reading.c)
    row = np.arange(N * k * n).reshape(N, k, n)
    q, qd = layout.split(layout.mesh[:-1])

    def matrix(parts: Sequence[tuple[Indices, Array]], weights: Array) -> Matrix:
        """Put columns with a value for each place, and accelerations with weights, (k, S)."""
        entries = Entries()
        for col, value in parts:
            entries.put(row, col[:, None, :], value[:, None])
        entries.put(row[:, :, None, :], layout.accelerations[:, None], weights[:, :, None])
        return entries.matrix((row.size, layout.size))

    one = np.ones(k)
    return Motion(
        q=matrix([(q, one), (qd, h * reading.c)], h**2 * reading.P),
        qd=matrix([(qd, one)], h * reading.V),
        qdd=matrix([], reading.W),
    )


def at_mesh(layout: Layout, integrator: Integrator, k: Sequence[int]) -> Places:
    """Give some mesh points, with the inputs of the interval before; the first has those of the interval after.

    Accelerations there are read off the stages of that interval.
    """
    at, stages = np.array(k, dtype=np.int64), layout.accelerations
    interval, n = np.maximum(at - 1, 0), layout.n
    q, qd = (part.T for part in layout.split(layout.mesh[at]))
    s = at / len(layout.inputs)
    if not stages.size:
        return Places(q, qd, np.zeros((0, at.size), dtype=np.int64), layout.inputs[interval].T, s)
    qdd = Entries()
    weights = integrator.ends.W[(at > 0).astype(np.int64)]  # (places, S)
    qdd.put(np.arange(at.size * n).reshape(-1, 1, n), stages[interval], weights[:, :, None])
    return Places(q, qd, qdd.matrix((at.size * n, layout.size)), layout.inputs[interval].T, s)


class Entries:
    """Entries of a sparse matrix, collected; exact zeros are left out, entries of one place are summed."""

    def __init__(self) -> None:
        self.parts: list[tuple[Indices, Indices, Array]] = []

    def put(self, row: ArrayLike, col: ArrayLike, value: ArrayLike) -> None:
        """Add entries; the three are broadcast against each other."""
        row, col, values = np.broadcast_arrays(row, col, np.asarray(value, dtype=np.float64))
        kept = values.ravel() != 0.0
        self.parts.append((row.ravel()[kept], col.ravel()[kept], values.ravel()[kept]))

    def put_matrix(self, rows: Indices, matrix: sparse.csr_array) -> None:
        """Put a matrix with rows of its own."""
        coo = matrix.tocoo()
        self.put(rows[coo.coords[0]], coo.coords[1], coo.data)

    def matrix(self, shape: tuple[int, int]) -> Matrix:
        """Give the matrix."""
        row, col, value = (np.concatenate(part) for part in zip(*self.parts, strict=True))
        matrix = sparse.coo_array((value, (row, col)), shape=shape).tocsc()
        matrix.sum_duplicates()
        return matrix
