"""Direct collocation: Problem and plant -> sparse nonlinear program.

Variables are as `layout` says. Constraints, interval by interval:

    x_0 = start                                                                  2 n rows
    sum_r D_jr q_kr - h qd_kj = 0,  sum_r D_jr qd_kr - h z_kj = 0                2 n rows a point
    Phi(q_kj, qd_kj, z_kj) - Q(q_kj, qd_kj, u_k) = 0                             n rows a point
    x_(k+1) = sum_r e_r x_kr                                                     2 n rows an interval
    sensors at x_N, coordinates of x_N, qd_N = 0, z(T) = 0                       as the problem asks

for a residual; where the equations of motion are explicit, the third is z_kj - gamma(q_kj, qd_kj, u_k) = 0, or gamma
takes the place of z_kj in the second, and of z(T). (Docquier, Bruls, Fisette, eqs. 5, 15, 22-27.)

Start, targets and bounds are bounds of the program, the weights of the cost its parameters: one program serves all
problems that differ in those only.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from mbsrun.ocp import schemes
from mbsrun.ocp.layout import Layout, collocation_points, end, lay_out
from mbsrun.ocp.plant import Plant
from mbsrun.ocp.problem import Problem, Representation
from mbsrun.ocp.program import Block, Indices, Matrix, Program
from mbsrun.ocp.schemes import Family, Scheme
from mbsrun.ocp.trajectory import Trajectory, grid

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Structure:
    """What of a problem shapes its program; problems with equal structures share one."""

    horizon: float
    intervals: int
    family: Family
    degree: int
    representation: Representation
    sensors: tuple[str, ...]
    coordinates: tuple[int, ...]
    velocity_zero: bool
    acceleration_zero: bool


@dataclass(frozen=True)
class Rows:
    """Where each constraint lies."""

    start: Indices  # (2 n,)
    states: Indices  # (N, d, 2 n)
    dynamics: Indices  # (N, d, n): those of the states that hold the equations of motion, for an ODE
    continuity: Indices  # (N, 2 n)
    sensors: Indices  # (targets, 3)
    coordinates: Indices  # (targets,)
    velocity: Indices  # (n,), or empty
    acceleration: Indices  # (n,), or empty
    size: int


@dataclass(frozen=True)
class Transcription:
    """A program, and how problems go into it and trajectories come out."""

    structure: Structure
    scheme: Scheme
    layout: Layout
    rows: Rows
    program: Program

    def weights(self, problem: Problem) -> Array:
        """Give the parameters of the program."""
        return np.array([problem.cost.inputs, problem.cost.input_rates])

    def variable_bounds(self, problem: Problem) -> tuple[Array, Array]:
        """Bound the states at mesh and collocation points, and the inputs."""
        lower, upper = np.full(self.layout.size, -np.inf), np.full(self.layout.size, np.inf)
        states = np.array(problem.bounds.q + problem.bounds.qd)
        for index, bounds in (
            (self.layout.mesh, states),
            (self.layout.points, states),
            (self.layout.inputs, np.array(problem.bounds.u).reshape(-1, 2)),
        ):
            lower[index], upper[index] = bounds.T
        return lower, upper

    def constraint_values(self, problem: Problem) -> Array:
        """Give what g must equal: the start, what the end asks for, and zeros."""
        values = np.zeros(self.rows.size)
        values[self.rows.start] = problem.start_q + problem.start_qd
        values[self.rows.sensors] = np.array([p for _, p in problem.end.sensors]).reshape(-1, 3)
        values[self.rows.coordinates] = [value for _, value in problem.end.coordinates]
        return values

    def pack(self, trajectory: Trajectory) -> Array:
        """Put a trajectory on this grid into the variables."""
        x, layout = np.empty(self.layout.size), self.layout
        x[layout.mesh] = np.concatenate((trajectory.q, trajectory.qd), axis=1)
        x[layout.points] = np.concatenate((trajectory.point_q, trajectory.point_qd), axis=2)
        if layout.accelerations.size:
            x[layout.accelerations] = trajectory.point_qdd
        x[layout.inputs] = trajectory.u
        return x

    def unpack(self, x: Array) -> Trajectory:
        """Read a trajectory out of the variables."""
        layout, n = self.layout, self.layout.n
        t, point_t = grid(self.structure.horizon, self.structure.intervals, self.scheme.points)
        mesh, points = x[layout.mesh], x[layout.points]
        if layout.accelerations.size:
            accelerations = x[layout.accelerations]
        else:
            accelerations = self.scheme.D @ np.concatenate((mesh[:-1, None], points), axis=1)[:, :, n:] / (t[1] - t[0])
        return Trajectory(
            t=t,
            q=mesh[:, :n],
            qd=mesh[:, n:],
            u=x[layout.inputs],
            point_t=point_t,
            point_q=points[:, :, :n],
            point_qd=points[:, :, n:],
            point_qdd=accelerations,
        )


def structure(problem: Problem) -> Structure:
    """Read off what shapes the program of a problem."""
    return Structure(
        problem.horizon,
        problem.intervals,
        problem.family,
        problem.degree,
        problem.representation,
        tuple(name for name, _ in problem.end.sensors),
        tuple(i for i, _ in problem.end.coordinates),
        problem.end.velocity_zero,
        problem.end.acceleration_zero,
    )


def transcribe(problem: Problem, plant: Plant) -> Transcription:
    """Build the program of a problem; of start, targets, weights and bounds no value enters it."""
    shape = structure(problem)
    scheme = schemes.build(shape.family, shape.degree)
    n, m = len(plant.manifest.coordinates), len(plant.manifest.actuated)
    layout = lay_out(n, m, shape.intervals, shape.degree, shape.representation)
    rows = _number_rows(n, shape)
    h = shape.horizon / shape.intervals
    sensors = [_sensor(layout, row, plant, name) for row, name in zip(rows.sensors, shape.sensors, strict=True)]
    cost = (_input_cost(layout, h), _rate_cost(layout, h))
    blocks = (*_dynamics(layout, rows, shape, plant, h), *sensors)
    return Transcription(shape, scheme, layout, rows, Program(_linear(layout, rows, scheme, shape, h), cost, blocks))


def _number_rows(n: int, shape: Structure) -> Rows:
    N, d = shape.intervals, shape.degree
    at_point = (2 if shape.representation.is_ode else 3) * n
    stride = d * at_point + 2 * n
    first = 2 * n + np.arange(N) * stride
    points = first[:, None, None] + np.arange(d)[:, None] * at_point + np.arange(at_point)
    sizes = (
        3 * len(shape.sensors),
        len(shape.coordinates),
        n * shape.velocity_zero,
        n * shape.acceleration_zero,
    )
    ends = 2 * n + N * stride + np.cumsum((0, *sizes))
    sensors, coordinates, velocity, acceleration = (np.arange(start, stop) for start, stop in pairwise(ends))
    return Rows(
        start=np.arange(2 * n),
        states=points[:, :, : 2 * n],
        dynamics=points[:, :, -n:],
        continuity=first[:, None] + d * at_point + np.arange(2 * n),
        sensors=sensors.reshape(-1, 3),
        coordinates=coordinates,
        velocity=velocity,
        acceleration=acceleration,
        size=int(ends[-1]),
    )


def _linear(layout: Layout, rows: Rows, scheme: Scheme, shape: Structure, h: float) -> Matrix:
    """Write every constraint that is linear, and the linear parts of the others; zeros of the scheme are left out."""
    n = layout.n
    A = _Entries((rows.size, layout.size))
    A.put(rows.start, layout.mesh[0], 1.0)
    nodes = [layout.mesh[:-1], *layout.points.transpose(1, 0, 2)]  # 0 and the points, each (N, 2 n)
    rates = np.concatenate((layout.points[:, :, n:], layout.accelerations), axis=2)
    A.put(rows.states[:, :, : rates.shape[2]], rates, -h)
    for r, node in enumerate(nodes):
        for j in range(scheme.degree):
            A.put(rows.states[:, j], node, scheme.D[j, r])
        A.put(rows.continuity, node, -scheme.end[r])
    A.put(rows.continuity, layout.mesh[1:], 1.0)
    if shape.representation.is_explicit and not shape.representation.is_ode:
        A.put(rows.dynamics, layout.accelerations, 1.0)
    A.put(rows.coordinates, layout.mesh[-1, list(shape.coordinates)], 1.0)
    if shape.velocity_zero:
        A.put(rows.velocity, layout.mesh[-1, n:], 1.0)
    if shape.acceleration_zero and not shape.representation.is_ode:
        for j in range(scheme.degree):
            A.put(rows.acceleration, layout.accelerations[-1, j], scheme.end_of_points[j])
    return A.matrix()


def _dynamics(layout: Layout, rows: Rows, shape: Structure, plant: Plant, h: float) -> list[Block]:
    """Apply the kernel at every collocation point; and at the end, where accelerations are no variables."""
    kernel = plant.casadi(shape.representation.kernel)
    at = collocation_points(layout)
    placed = rows.dynamics.reshape(-1, layout.n).T
    if not shape.representation.is_explicit:
        return [Block(kernel, (at.q, at.qd, at.qdd, at.u), placed)]
    if not shape.representation.is_ode:
        return [Block(kernel, (at.q, at.qd, at.u), placed, scale=-1.0)]
    blocks = [Block(kernel, (at.q, at.qd, at.u), placed, scale=-h)]
    if shape.acceleration_zero:
        at = end(layout)
        blocks.append(Block(kernel, (at.q, at.qd, at.u), rows.acceleration[:, None]))
    return blocks


def _sensor(layout: Layout, rows: Indices, plant: Plant, name: str) -> Block:
    """Position of a sensor at the end of the horizon, as a function of the coordinates that move it only."""
    n = layout.n
    sensors = plant.casadi("sensors")
    place = [frame.name for frame in plant.manifest.frames if frame.sensor].index(name)
    felt = sensors.jacobian().sparsity_out(0).get_triplet()
    moving = sorted({j for i, j in zip(*felt, strict=True) if i // 3 == place})
    some, q = ca.MX.sym("q", len(moving)), ca.MX.zeros(n)
    q[moving] = some
    function = ca.Function("sensor", [some], [sensors(q)[:, place]], ["q"], ["position"])
    return Block(function, (layout.mesh[-1, moving, None],), rows[:, None])


def _input_cost(layout: Layout, h: float) -> Matrix:
    """Hessian of the integral of |u|^2."""
    H = _Entries((layout.size, layout.size))
    H.put(layout.inputs, layout.inputs, 2 * h)
    return H.matrix()


def _rate_cost(layout: Layout, h: float) -> Matrix:
    """Hessian of the sum over the N - 1 steps of h |(u_(k+1) - u_k) / h|^2."""
    H = _Entries((layout.size, layout.size))
    before, after = layout.inputs[:-1], layout.inputs[1:]
    for row in (before, after):
        for col in (before, after):
            H.put(row, col, 2 / h if row is col else -2 / h)
    return H.matrix()


class _Entries:
    """Entries of a sparse matrix, collected; exact zeros are left out, entries of one place are summed."""

    def __init__(self, shape: tuple[int, int]) -> None:
        self.shape = shape
        self.parts: list[tuple[Indices, Indices, Array]] = []

    def put(self, row: ArrayLike, col: ArrayLike, value: float) -> None:
        row, col = np.broadcast_arrays(row, col)
        if value != 0.0:
            self.parts.append((row.ravel(), col.ravel(), np.full(row.size, value)))

    def matrix(self) -> Matrix:
        if not self.parts:
            return sparse.csc_array(self.shape)
        row, col, value = (np.concatenate(part) for part in zip(*self.parts, strict=True))
        matrix = sparse.coo_array((value, (row, col)), shape=self.shape).tocsc()
        matrix.sum_duplicates()
        return matrix
