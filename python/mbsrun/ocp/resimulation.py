"""Integrate the true motion under the inputs of a solution, and measure the distance of the collocation from it.

    M(q) qdd = -Phi(q, qd, 0, u),    M = dPhi/dqdd,    d/dt q = rates(q, qd), which is qd except for quaternions,

by DOP853 (Hairer, Norsett, Wanner, "Solving ordinary differential equations I", section II.5) at tolerances near
rounding: from the start of every interval to its end, whose error is the defect of the discretisation; and from the
start of the horizon to its end, where an unstable plant has multiplied the defects. Steps and processor time are
limited; a check that does not finish within the limits calls no solution accurate.

Along the first of these motions, bounds and constraints are watched between the points of the grid: see `margins`.

States that a problem adds are integrated along, s' = rate(t, q, qd, qdd, u, s), under its controls.

With closed loops, driven joints and contacts, accelerations and the forces of all follow together,

    M qdd - J' lam - D tau - J_c' f = -Phi(q, qd, 0, 0, u),    J qdd = -gamma,    D' qdd = a,    J_c qdd = -dJ_c/dt qd,

with the velocities J_c qd of points in contact along the axes that are held, and the unit columns D of driven joints.
Coordinates and velocities of these are the given ones at all times. With loops, each step ends with the
nearest state that keeps them closed. So they do not drift open; how far a step opens them is measured before. Points in
contact start at rest and do not accelerate; how far they creep is the slip.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import DOP853, DenseOutput

from mbsgen.errors import MbsError
from mbsrun.closure import CLOSED, find_closure, has_loops
from mbsrun.limits import Allowance, LimitError, Limits
from mbsrun.ocp.contacts import Held, find_held, measure_slip
from mbsrun.ocp.design import equip
from mbsrun.ocp.driving import Guide, choose_rows, give_nothing
from mbsrun.ocp.functions import Indices
from mbsrun.ocp.margins import Watch
from mbsrun.ocp.plant import Plant
from mbsrun.ocp.problem import Problem
from mbsrun.ocp.solution import Resimulation, Solution
from mbsrun.ocp.trajectory import Trajectory, lagrange
from mbsrun.ocp.values import GivenValues, Values
from mbsrun.quaternions import find_rates

Array = NDArray[np.float64]

TOLERANCE = 1e-13  # relative and absolute
LIMITS = Limits(steps=20_000, seconds=60.0)  # of a whole check; the paper's task takes some 600 steps, 1 s


def resimulate(solution: Solution, plant: Plant, limits: Limits = LIMITS) -> Solution:
    """Return the solution with its re-simulation, of which `unfinished` states the limit that ended it, if one did."""
    trajectory = solution.trajectory
    plant = equip(plant, solution.problem, trajectory.unknowns)
    steps = solution.problem.grid.lengths(float(trajectory.t[-1]))
    states = np.concatenate((trajectory.q, trajectory.qd, trajectory.states), axis=1)
    course, held = Course(solution.problem, trajectory, plant), find_held(solution.problem, plant.manifest)
    allowance, defects, last, unfinished = Allowance(limits), None, None, ""
    reached: Array | None = None
    (N, d), nq = trajectory.point_t.shape, trajectory.q.shape[1]
    every = np.concatenate((trajectory.q, trajectory.point_q.reshape(N * d, nq)))
    gaps: list[float] | None = [] if has_loops(plant.manifest) else None
    watch, taken, margins = Watch(solution.problem, plant), list[Step](), None
    try:
        ends = integrate(plant, states[:-1], course.inputs(), steps, allowance, held=held, taken=taken)
        margins = None if ends is None else watch.measure(Reader(plant, course, held, taken, watch.kinds))
        defects = None if ends is None else np.abs(ends - states[1:]).max(axis=1)
        reached = _integrate_all(plant, states[:1], course, steps, allowance, gaps, held)
        last = None if reached is None else reached[-1:]
    except LimitError as error:
        unfinished = error.finding
    return replace(
        solution,
        resimulation=Resimulation(
            defect=None if defects is None else float(defects.max()),
            defect_interval=None if defects is None else int(defects.argmax()),
            open_loop_error=None if last is None else float(np.abs(last[0] - states[-1]).max()),
            is_accurate=not unfinished
            and defects is not None
            and bool(defects.max() <= solution.problem.asked_accuracy)
            and max(gaps or [0.0]) <= CLOSED,
            unfinished=unfinished,
            defects=() if defects is None else tuple(defects.tolist()),
            margins=margins,
            closure=max(gaps) if gaps else None,
            slip=measure_slip(solution.problem, plant, every),
            slip_along=None if reached is None else measure_slip(solution.problem, plant, reached[:, :nq]),
        ),
    )


class Inputs(Protocol):
    """The inputs of some motions, and the rates of further states."""

    def read(self, time: Array, q: Array, qd: Array, states: Array) -> dict[str, Array]:
        """Return the parts of the motions at times (B, 1) since the start, of which u and w are the inputs.

        Driven joints are where they are then.
        """

    def place(self, time: Array, q: Array, qd: Array) -> tuple[Array, Array]:
        """Return states (B, ...) at times (B, 1) with driven joints where they are then."""

    def rates(self, parts: dict[str, Array]) -> Array:
        """Return the rates (B, ns) of the further states, by parts of the motions and qdd."""


@dataclass(frozen=True)
class Constant:
    """Inputs (B, m) that do not change; there are no further states."""

    u: Array

    def read(self, _time: Array, q: Array, qd: Array, _states: Array) -> dict[str, Array]:
        """Return the inputs, and the states: no joint is driven."""
        return {"q": q, "qd": qd, "u": self.u, "w": np.zeros((len(self.u), 0))}

    def place(self, _time: Array, q: Array, qd: Array) -> tuple[Array, Array]:
        """Return the states: no joint is driven."""
        return q, qd

    def rates(self, parts: dict[str, Array]) -> Array:
        """Return no rates."""
        return np.zeros((len(parts["u"]), 0))


@dataclass(frozen=True)
class _Piece:
    """The inputs of some intervals of a solution."""

    course: Course
    intervals: NDArray[np.int64]

    def read(self, time: Array, q: Array, qd: Array, states: Array) -> dict[str, Array]:
        """Return the parts of the motions; inputs that change are read off the polynomials through the points."""
        trajectory, k = self.course.trajectory, self.intervals
        t = trajectory.t[k, None] + time
        q, qd, a = self._drive(time, q, qd)
        parts = {
            "t": t,
            "T": np.full_like(t, trajectory.t[-1]),
            "q": q,
            "qd": qd,
            "a": a,
            "states": states,
            "controls": self._read(time, trajectory.controls, trajectory.point_controls),
            "u": self._read(time, trajectory.u, trajectory.point_u),
            "w": self._read(time, trajectory.point_w[:, 0], trajectory.point_w),
            "unknowns": np.tile(trajectory.unknowns, (len(k), 1)),
        }
        return self.course.given(parts)

    def place(self, time: Array, q: Array, qd: Array) -> tuple[Array, Array]:
        """Return the states with driven joints where they are then."""
        return self._drive(time, q, qd)[:2]

    def _drive(self, time: Array, q: Array, qd: Array) -> tuple[Array, Array, Array]:
        """Return the states with driven joints where they are then, and the accelerations (B, d) of these."""
        guide, trajectory = self.course.guide, self.course.trajectory
        if guide is None:
            return q, qd, np.zeros((len(q), 0))
        t = trajectory.t[self.intervals] + time[:, 0]
        q, qd = q.copy(), qd.copy()
        motion = guide.read(t, float(trajectory.t[-1]), trajectory.unknowns)
        q[:, guide.places], qd[:, guide.joints], a = motion
        return q, qd, a

    def _read(self, time: Array, values: Array, points: Array) -> Array:
        """Return inputs that are constant over the intervals, or polynomials through values at their points."""
        if not points.size:
            return values[self.intervals]
        basis = lagrange(self.course.nodes, time[:, 0] / self.course.lengths[self.intervals])
        return np.asarray(np.einsum("br,brm->bm", basis, points[self.intervals]))

    def rates(self, parts: dict[str, Array]) -> Array:
        """Return the rates of the states that the problem adds."""
        return self.course.rates(parts)


class Course:
    """The inputs of a solution, over time."""

    def __init__(self, problem: Problem, trajectory: Trajectory, plant: Plant) -> None:
        """Prepare the expressions of the problem."""
        self.trajectory, self.given = trajectory, GivenValues(problem, plant)
        self.lengths = np.diff(trajectory.t)
        self.nodes = (trajectory.point_t[0] - trajectory.t[0]) / self.lengths[0]  # the same in every interval
        self.guide = Guide.of(problem, plant.manifest) if plant.manifest.driven else None
        self.rates = Values([state.rate for state in problem.every_state], problem, plant)

    def inputs(self, *intervals: int) -> Inputs:
        """Return the inputs of some intervals, or of all."""
        return _Piece(self, np.array(intervals or range(len(self.trajectory.u)), dtype=np.int64))


def _integrate_all(
    plant: Plant,
    state: Array,
    course: Course,
    steps: Array,
    allowance: Allowance,
    gaps: list[float] | None,
    held: Held | None,
) -> Array | None:
    """Integrate one motion, (1, nq + n + ns), through all intervals: its states at their ends, (N + 1, nq + n + ns)."""
    reached = [state]
    for k, step in enumerate(steps):
        last = integrate(plant, reached[-1], course.inputs(k), float(step), allowance, gaps, held)
        if last is None:
            return None
        reached.append(last)
    return np.concatenate(reached)


def integrate(
    plant: Plant,
    states: Array,
    inputs: Inputs,
    duration: float | Array,
    allowance: Allowance | None = None,
    gaps: list[float] | None = None,
    held: Held | None = None,
    taken: list[Step] | None = None,
) -> Array | None:
    """Integrate several motions at once, states (B, nq + n + ns), each for its duration [s], with contacts if any.

    Returns the states at the end, or None where the integrator or a kernel fails. Raises LimitError when the
    allowance is used up. Loops are closed after every step; the largest gap that each step leaves is added to `gaps`.
    Every step is added to `taken`.
    """
    durations = np.broadcast_to(np.asarray(duration, dtype=np.float64), len(states))
    longest = float(durations.max())
    pace = (durations / longest)[:, None]  # shorter ones are integrated in slower time, so that all end together

    def rate(time: float, flat: Array) -> Array:
        q, qd, further = np.split(flat.reshape(states.shape), ends, axis=1)
        parts = inputs.read(pace * time, q, qd, further)
        q, qd = parts["q"], parts["qd"]
        qdd, forces = _balance(plant, q, qd, parts, held)
        rates = inputs.rates(parts | {"qdd": qdd} | forces)
        return (pace * np.concatenate((find_rates(plant, q, qd), qdd, rates), axis=1)).ravel()

    places, closure = len(plant.manifest.positions), find_closure(plant)
    ends = [places, places + len(plant.manifest.coordinates)]

    def close(time: float, flat: Array) -> Array:
        """Return the nearest states that keep the loops closed, with driven joints where they are then."""
        q, qd, further = np.split(flat.reshape(states.shape), ends, axis=1)
        q, qd = inputs.place(pace * time, q, qd)
        if closure is not None:
            q, qd = closure.project(q, qd, plant.manifest.driven)
        return np.concatenate((q, qd, further), axis=1).ravel()

    is_kept = closure is not None or bool(plant.manifest.driven)
    try:
        begin = close(0.0, states.ravel()) if is_kept else states.ravel()
        solver = DOP853(rate, 0.0, begin, longest, rtol=TOLERANCE, atol=TOLERANCE)
        if not np.isfinite(solver.h_abs):  # it would look for a first step without end
            return None
        with np.errstate(all="ignore"):  # a motion that diverges ends in a status
            while solver.status == "running":
                if allowance is not None:
                    allowance.spend()
                solver.step()
                if taken is not None and solver.t > solver.t_old:
                    taken.append(Step(solver.t / longest, solver.dense_output(), longest, states.shape))
                if closure is not None and gaps is not None:
                    gaps.append(closure.measure(solver.y.reshape(states.shape)[:, :places]))
                if is_kept:
                    solver.y = close(solver.t, solver.y)
                    solver.f = solver.fun(solver.t, solver.y)  # with which the next step begins
    except LimitError:
        raise
    except (MbsError, np.linalg.LinAlgError):  # a kernel that fails, a mass matrix that is singular
        return None
    return np.asarray(solver.y.reshape(states.shape)) if solver.status == "finished" else None


@dataclass(frozen=True)
class Step:
    """A step of several motions that are integrated at once."""

    end: float  # over the duration
    states: DenseOutput  # by the integrator's time
    duration: float  # by the integrator's time
    shape: tuple[int, int]  # of the states: motions, size

    def read(self, motions: Indices, fractions: Array) -> Array:
        """Return the states (B, size) of some motions, each at a fraction of its duration."""
        places, which = np.unique(fractions, return_inverse=True)
        every = self.states(places * self.duration).reshape(*self.shape, places.size)
        return np.asarray(every[motions, :, which])


@dataclass(frozen=True)
class Reader:
    """The motions of all intervals, each from its start, to be read at any time."""

    plant: Plant
    course: Course
    held: Held | None
    steps: Sequence[Step]
    kinds: frozenset[str]  # that are read

    def __call__(self, intervals: Indices, fractions: Array) -> dict[str, Array]:
        """Return the parts of the motion at fractions (B,) of intervals (B,)."""
        nq, n = self.course.trajectory.q.shape[1], self.course.trajectory.qd.shape[1]
        q, qd, states = np.split(self._read(intervals, fractions), [nq, nq + n], axis=1)
        times = fractions * self.course.lengths[intervals]
        parts = self.course.inputs(*intervals.tolist()).read(times[:, None], q, qd, states)
        if not self.kinds & {"qdd", "tau", "w"}:
            return parts
        qdd, forces = _balance(self.plant, parts["q"], parts["qd"], parts, self.held)
        return parts | {"qdd": qdd} | forces

    def _read(self, intervals: Indices, fractions: Array) -> Array:
        """Return the states (B, size)."""
        last = len(self.steps) - 1
        which = np.searchsorted([step.end for step in self.steps], fractions).clip(max=last)
        found = np.zeros((len(fractions), self.steps[0].shape[1]))
        for i in np.unique(which).tolist():
            chosen = which == i
            found[chosen] = self.steps[i].read(intervals[chosen], fractions[chosen])
        return found


def accelerations(plant: Plant, q: Array, qd: Array, u: Array, w: Array | None = None) -> Array:
    """Solve the equations of motion for qdd in several states: q (B, nq), qd (B, n), u (B, m), w (B, nw) if any."""
    return _balance(plant, q, qd, {"u": u, "w": np.zeros((len(q), 0)) if w is None else w}, None)[0]


def _balance(
    plant: Plant, q: Array, qd: Array, parts: Mapping[str, Array], held: Held | None
) -> tuple[Array, dict[str, Array]]:
    """Solve for qdd under the inputs u and w, and accelerations a of driven joints, if any.

    Return qdd, and w complete, with the components that hold contacts, and tau of driven joints.
    """
    manifest, w = plant.manifest, parts["w"]
    closure, (B, n) = find_closure(plant), qd.shape
    if not n:
        return qd, {"w": w}
    state = give_nothing(manifest, {"q": q, "qd": qd, "qdd": np.zeros_like(qd), "u": parts["u"]})
    if held is not None:
        w = w.copy()
        w[:, held.components] = 0
    if w.size:
        state["w"] = w
    slopes, c = plant("jac_impl", **state), plant("impl", **state)["Phi"]
    rows, forces, bias = [], [], []
    if closure is not None:
        J = closure.jacobian(q)
        rows, forces, bias = [J], [-J.swapaxes(1, 2)], [closure.bias(q, qd)]
    if manifest.driven:
        D = choose_rows(manifest, B)
        rows, forces, bias = [*rows, D], [*forces, -D.swapaxes(1, 2)], [*bias, -parts["a"]]
    if held is not None:
        J, turning = held.differentiate(plant, q, qd)
        rows, forces, bias = [*rows, J], [*forces, slopes["jac_Phi_w"][:, :, held.components]], [*bias, turning]
    if not rows:
        return np.asarray(np.linalg.solve(slopes["jac_Phi_qdd"], -c[..., None])[..., 0]), {"w": w}
    below = np.concatenate(rows, axis=1)
    none = np.zeros((B, below.shape[1], below.shape[1]))
    whole = np.block([[slopes["jac_Phi_qdd"], np.concatenate(forces, axis=2)], [below, none]])
    found = np.linalg.solve(whole, -np.concatenate((c, *bias), axis=1)[..., None])[..., 0]
    if held is not None:
        w[:, held.components] = found[:, -len(held.components) :]
    m = 0 if closure is None else len(closure.dependent)
    return np.asarray(found[:, :n]), {"w": w, "tau": found[:, n + m : n + m + len(manifest.driven)]}
