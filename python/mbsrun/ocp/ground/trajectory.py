"""A motion on the grid of a collocation: states at its mesh and collocation points, accelerations, inputs."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import PlainSerializer, PlainValidator


def _read_array(value: Any) -> NDArray[np.float64]:
    try:
        array = np.array(value, dtype=np.float64)
    except (TypeError, OverflowError) as error:
        raise ValueError(str(error)) from None
    if not np.isfinite(array).all():
        raise ValueError("a number is not finite")
    return array


Array = Annotated[NDArray[np.float64], PlainValidator(_read_array), PlainSerializer(lambda array: array.tolist())]


OPTIONAL = (
    "states",
    "point_states",
    "controls",
    "point_controls",
    "point_u",
    "point_w",
    "slopes",
)  # parts of a trajectory that it may leave out
NONE: NDArray[np.float64] = np.zeros(0)  # stands for arrays of no quantities


@dataclass(frozen=True, eq=False, repr=False)
class Trajectory:
    """A motion; nq coordinates, n velocities, m inputs, N intervals with d points each. Times in s, the rest in SI.

    nq equals n, except with quaternions. A motion without further states, controls, ... may leave their arrays out.
    """

    t: Array  # (N + 1,)
    q: Array  # (N + 1, nq)
    qd: Array  # (N + 1, n)
    u: Array  # (N, m): constant from t[k] to t[k + 1], or means
    point_t: Array  # (N, d)
    point_q: Array  # (N, d, nq)
    point_qd: Array  # (N, d, n)
    point_qdd: Array  # (N, d, n)
    states: Array = field(default_factory=NONE.copy)  # (N + 1, ns): beside the mechanism's
    point_states: Array = field(default_factory=NONE.copy)  # (N, d, ns)
    controls: Array = field(default_factory=NONE.copy)  # (N, nc): beside u, constant from t[k] to t[k + 1], or means
    point_controls: Array = field(default_factory=NONE.copy)  # (N, d, nc), or (N, d, 0) where they are constant
    point_u: Array = field(default_factory=NONE.copy)  # (N, d, m), or (N, d, 0) where all inputs are constant
    point_w: Array = field(default_factory=NONE.copy)  # (N, d, nw): components of open wrenches
    slopes: Array = field(default_factory=NONE.copy)  # (N, nq + n + ns) or (N, 0): rates of states at t[:-1], if known
    unknowns: Array = field(default_factory=lambda: np.zeros(0))  # of the whole motion, as the problem orders them

    def __repr__(self) -> str:
        """Return the duration and the sizes."""
        (N, d), nq, m = self.point_t.shape, self.q.shape[1], self.u.shape[1]
        return f"Trajectory({self.t[-1]:.6g} s, {N} intervals of {d} points, {nq} coordinates, {m} inputs)"

    def __post_init__(self) -> None:
        arrays = (self.t, self.q, self.qd, self.u, self.point_t, self.point_q, self.point_qd, self.point_qdd)
        shapes: list[tuple[int, ...]] = []
        if [array.ndim for array in arrays] == [1, 2, 2, 2, 2, 3, 3, 3]:
            (N, d, n), nq, m = self.point_qd.shape, self.point_q.shape[-1], self.u.shape[1]
            shapes = [(N + 1,), (N + 1, nq), (N + 1, n), (N, m), (N, d), (N, d, nq), (N, d, n), (N, d, n)]
        if [array.shape for array in arrays] != shapes:
            raise ValueError("the arrays of a trajectory do not fit together")
        for name, leading in (
            ("states", (N + 1,)),
            ("point_states", (N, d)),
            ("controls", (N,)),
            ("point_controls", (N, d)),
            ("point_u", (N, d)),
            ("point_w", (N, d)),
            ("slopes", (N,)),
        ):
            array = getattr(self, name)
            if not array.size:
                object.__setattr__(self, name, np.zeros((*leading, 0)))
            elif array.shape[:-1] != leading:
                raise ValueError("the arrays of a trajectory do not fit together")
        if (
            self.states.shape[1] != self.point_states.shape[2]
            or self.point_u.shape[2] not in (0, m)
            or self.point_controls.shape[2] not in (0, self.controls.shape[1])
        ):
            raise ValueError("the arrays of a trajectory do not fit together")

    def spread_inputs(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return inputs and controls at the points, (N, d, ...), where they are constant too."""
        N, d = self.point_t.shape
        u, controls = (
            points if points.size else np.broadcast_to(values[:, None], (N, d, values.shape[1]))
            for values, points in ((self.u, self.point_u), (self.controls, self.point_controls))
        )
        return u, controls


def resample(trajectory: Trajectory, t: NDArray[np.float64], point_t: NDArray[np.float64]) -> Trajectory:
    """Read a motion on another grid: mesh points t (N + 1,), collocation points point_t (N, d), both from time 0 on.

    States are read off the collocation's polynomials, accelerations off the polynomials through the points alone.
    Inputs are means over the new intervals. Where the horizons differ, the time of the whole motion is scaled.
    """
    pace = float(trajectory.t[-1] / t[-1])
    mesh, points = (_Reading(trajectory, np.asarray(times) * pace) for times in (t, point_t))
    return Trajectory(
        t=t,
        q=mesh.states(trajectory.q, trajectory.point_q),
        qd=mesh.states(trajectory.qd, trajectory.point_qd) * pace,
        u=average_inputs(trajectory.t, trajectory.u, t * pace),
        point_t=point_t,
        point_q=points.states(trajectory.q, trajectory.point_q),
        point_qd=points.states(trajectory.qd, trajectory.point_qd) * pace,
        point_qdd=points.accelerations(trajectory.point_qdd) * pace**2,
        states=mesh.states(trajectory.states, trajectory.point_states),
        point_states=points.states(trajectory.states, trajectory.point_states),
        controls=average_inputs(trajectory.t, trajectory.controls, t * pace),
        point_controls=points.accelerations(trajectory.point_controls),
        point_u=points.accelerations(trajectory.point_u),
        point_w=points.accelerations(trajectory.point_w),
        unknowns=trajectory.unknowns,
    )


def move_ahead(
    trajectory: Trajectory, elapsed: float, t: NDArray[np.float64], point_t: NDArray[np.float64]
) -> Trajectory:
    """Read a motion from the time `elapsed` on, on a grid that begins there: mesh points t, collocation points point_t.

    After its end the motion stands still in its last pose, under its last inputs. Nothing is scaled.
    """
    end = float(trajectory.t[-1])

    def read(times: NDArray[np.float64]) -> tuple[_Reading, NDArray[np.bool_]]:
        later = times + elapsed
        return _Reading(trajectory, np.minimum(later, end)), (later <= end * (1 + 1e-12))[..., None]

    (mesh, mesh_moves), (points, points_move) = read(t), read(point_t)
    return Trajectory(
        t=t,
        q=mesh.states(trajectory.q, trajectory.point_q),
        qd=mesh.states(trajectory.qd, trajectory.point_qd) * mesh_moves,
        u=average_inputs(trajectory.t, trajectory.u, t + elapsed),
        controls=average_inputs(trajectory.t, trajectory.controls, t + elapsed),
        point_t=point_t,
        point_q=points.states(trajectory.q, trajectory.point_q),
        point_qd=points.states(trajectory.qd, trajectory.point_qd) * points_move,
        point_qdd=points.accelerations(trajectory.point_qdd) * points_move,
        states=mesh.states(trajectory.states, trajectory.point_states),
        point_states=points.states(trajectory.states, trajectory.point_states),
        unknowns=trajectory.unknowns,
    )


def hold_numbers(trajectory: Trajectory, numbers: NDArray[np.float64]) -> Trajectory:
    """Return a motion in which some numbers (p,) are its last states, which hold still, and no number is unknown."""

    def widen(states: NDArray[np.float64], leading: tuple[int, ...]) -> NDArray[np.float64]:
        held = np.broadcast_to(numbers, (*leading, numbers.size))
        return np.concatenate((states.reshape(*leading, -1), held), axis=-1)

    return replace(
        trajectory,
        states=widen(trajectory.states, trajectory.t.shape),
        point_states=widen(trajectory.point_states, trajectory.point_t.shape),
        slopes=NONE.copy(),
        unknowns=np.zeros(0),
    )


def average_inputs(t: NDArray[np.float64], u: NDArray[np.float64], times: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return means of inputs u (N, m), which change at t (N + 1,), between times (K + 1,): shape (K, m).

    After the end, the last inputs stay.
    """
    knots = np.append(t, max(float(times[-1]), float(t[-1])) + 1.0)
    u = np.concatenate((u, u[-1:]))
    impulses = np.concatenate((np.zeros_like(u[:1]), np.cumsum(np.diff(knots)[:, None] * u, axis=0)))
    sums = np.reshape([np.interp(times, knots, column) for column in impulses.T], (u.shape[1], len(times))).T
    return np.asarray(np.diff(sums, axis=0) / np.diff(times)[:, None])


class _Reading:
    """Evaluates the polynomials of a motion at given times, each in the interval that it lies in."""

    def __init__(self, trajectory: Trajectory, times: NDArray[np.float64]) -> None:
        t = trajectory.t
        self.interval = np.clip(np.searchsorted(t, times, side="left") - 1, 0, len(t) - 2)
        place = (times - t[self.interval]) / np.diff(t)[self.interval]
        nodes = trajectory.point_t[0] / t[1]  # time begins at 0; the same in every interval
        self.first = int(nodes[0] == 0.0)  # of the points that are not the start
        self.with_start = lagrange(np.concatenate(([0.0], nodes[self.first :])), place)
        self.without = lagrange(nodes, place)

    def states(self, mesh: NDArray[np.float64], points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Read the polynomial through the values at the interval's start and at the points."""
        nodes = np.concatenate((mesh[:-1, None], points[:, self.first :]), axis=1)[self.interval]
        return np.asarray(np.einsum("...r,...rn->...n", self.with_start, nodes))

    def accelerations(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Read the polynomial through the values at the points."""
        return np.asarray(np.einsum("...r,...rn->...n", self.without, points[self.interval]))


def lagrange(nodes: NDArray[np.float64], x: NDArray[np.float64]) -> NDArray[np.float64]:
    """Evaluate the basis polynomials of the nodes at x: shape (*x.shape, nodes)."""
    gaps = nodes[:, None] - nodes
    np.fill_diagonal(gaps, 1.0)
    others = np.where(np.eye(len(nodes), dtype=bool), 1.0, x[..., None, None] - nodes)
    return np.asarray((others / gaps).prod(axis=-1))
