"""Integrate the true motion under the inputs of a solution, and measure the distance of the collocation from it.

    M(q) qdd = -Phi(q, qd, 0, u),    M = dPhi/dqdd,    d/dt q = rates(q, qd), which is qd except for quaternions,

by DOP853 (Hairer, Norsett, Wanner, "Solving ordinary differential equations I", section II.5) at tolerances near
rounding: from the start of every interval to its end, whose error is the defect of the discretisation; and from the
start of the horizon to its end, where an unstable plant has multiplied the defects. Steps and processor time are
limited; a check that does not finish within the limits calls no solution accurate.

Along the first of these motions, bounds and constraints are watched between the points of the grid: see `margins`.

States that a problem adds are integrated along, s' = rate(t, q, qd, qdd, u, s), under its controls; where no input
follows them, after the mechanism's motion (`riding`).

The motion from the start of the horizon may leave the solution for good: where it is LOST, or the integrator gives up,
it is put back on the solution at the next point of the grid; `lost` holds the times.

With closed loops, driven joints and contacts, accelerations and the forces of all follow together,

    M qdd - J' lam - D tau - J_c' f = -Phi(q, qd, 0, 0, u),    J qdd = -gamma,    D' qdd = a,    J_c qdd = -dJ_c/dt qd,

with the velocities J_c qd of points in contact along the axes that are held, and the unit columns D of driven joints.
Coordinates and velocities of these are the given ones at all times. With loops, each step ends with the
nearest state that keeps them closed. So they do not drift open; how far a step opens them is measured before. Points in
contact start at rest and do not accelerate; how far they creep is the slip.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from copy import copy
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from mbsgen.errors import MbsError
from mbsrun.closure import CLOSED, find_closure, has_loops
from mbsrun.limits import Allowance, LimitError, Limits
from mbsrun.ocp.evaluation.values import GivenValues, Values
from mbsrun.ocp.ground.functions import Indices
from mbsrun.ocp.ground.plant import Plant
from mbsrun.ocp.ground.trajectory import Trajectory, lagrange
from mbsrun.ocp.problem.contacts import Held, find_held, measure_slip
from mbsrun.ocp.problem.design import equip
from mbsrun.ocp.problem.driving import Guide, choose_rows, give_nothing
from mbsrun.ocp.problem.problem import Problem
from mbsrun.ocp.solution.solution import Resimulation, Solution
from mbsrun.ocp.solving.margins import Watch
from mbsrun.ocp.solving.riding import Riders, UnevenError
from mbsrun.ocp.solving.stepping import Span, Stepper
from mbsrun.quaternions import find_rates
from mbsrun.simulation.course import Course as Motions
from mbsrun.simulation.course import stand
from mbsrun.simulation.drive import Piece
from mbsrun.simulation.memory import Source
from mbsrun.simulation.motion import HaltError

if TYPE_CHECKING:
    from scipy.integrate import DenseOutput

Array = NDArray[np.float64]

TOLERANCE = 1e-13  # relative and absolute
SECONDS, FEW, EACH = 60.0, 20_000, 50  # limits of a check: time, steps, and steps of an interval on average
LOST = 1.0  # rad, m, and these per s, or of a state's range, if that is larger: a motion farther off is elsewhere


def resimulate(solution: Solution, plant: Plant, limits: Limits | None = None) -> Solution:
    """Return the solution with its re-simulation, of which `unfinished` states the limit that ended it, if one did."""
    trajectory = solution.trajectory
    limits = limits or Limits(max(FEW, EACH * len(trajectory.u)), SECONDS)
    plant = equip(plant, solution.problem, trajectory.unknowns)
    states = np.concatenate((trajectory.q, trajectory.qd, trajectory.states), axis=1)
    course, held = Course(solution.problem, trajectory, plant), find_held(solution.problem, plant.manifest)
    defects, unfinished = None, ""
    through: _Through | None = None
    (N, d), nq = trajectory.point_t.shape, trajectory.q.shape[1]
    every = np.concatenate((trajectory.q, trajectory.point_q.reshape(N * d, nq)))
    watch, margins, replay = Watch(solution.problem, plant), None, Replay(plant, course, held, limits)
    try:
        apart = replay.go_apart(states[:-1])
        margins = None if apart is None else watch.measure(Reader(plant, course, held, apart.read, watch.kinds))
        defects = None if apart is None else np.abs(apart.ends - states[1:]).max(axis=1)
        through = replay.go_through(states)
    except LimitError as error:
        unfinished = error.finding
    return replace(
        solution,
        resimulation=Resimulation(
            defect=None if defects is None else float(defects.max()),
            defect_interval=None if defects is None else int(defects.argmax()),
            open_loop_error=None if through is None else float(np.abs(through.reached[-1] - states[-1]).max()),
            is_accurate=not unfinished
            and defects is not None
            and bool(defects.max() <= solution.problem.asked_accuracy)
            and (through is None or through.gap <= CLOSED),
            unfinished=unfinished,
            defects=() if defects is None else tuple(defects.tolist()),
            margins=margins,
            closure=through.gap if through is not None and has_loops(plant.manifest) else None,
            slip=measure_slip(solution.problem, plant, every),
            slip_along=None if through is None else measure_slip(solution.problem, plant, through.reached[:, :nq]),
            lost=() if through is None else through.lost,
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
        self.problem, self.plant = problem, plant
        self.lengths = np.diff(trajectory.t)
        self.nodes = (trajectory.point_t[0] - trajectory.t[0]) / self.lengths[0]  # the same in every interval
        self.guide = Guide.of(problem, plant.manifest) if plant.manifest.driven else None
        self.rates = Values([state.rate for state in problem.every_state], problem, plant)

    def piece(self, k: int) -> Piece:
        """Return the inputs of an interval; given ones may follow the state."""
        trajectory, whole, own = self.trajectory, slice(k, k + 1), self.inputs(k)
        start, length = float(trajectory.t[k]), float(self.lengths[k])
        kinds = ((trajectory.u[whole], trajectory.point_u), (trajectory.point_w[k, :1], trajectory.point_w))
        is_constant = not (trajectory.point_u.size or trajectory.point_w.size)

        def evaluate(times: Array) -> Array:
            if is_constant:
                return np.tile(np.hstack([values for values, _ in kinds]), (len(times), 1))
            basis = lagrange(self.nodes, (times - start) / length)
            parts = [basis @ points[k] if points.size else np.tile(values, (len(times), 1)) for values, points in kinds]
            return np.hstack(parts)

        def follow(times: Array, q: Array, qd: Array) -> Array:
            parts = own.read(times[:, None] - start, q, qd, np.zeros((len(q), 0)))
            return np.hstack((parts["u"], parts["w"]))

        law = None if self.given.is_empty else follow
        return Piece(start, float(trajectory.t[k + 1]), evaluate, is_constant and law is None, law)

    @property
    def follows_states(self) -> bool:
        """Return whether an input follows a state that the problem adds."""
        return "states" in self.given.kinds

    def gather(self, intervals: Indices, time: Array, states: Array) -> dict[str, Array]:
        """Return the parts of motions of the mechanism (B, nq + n) in intervals (B,), at times (B,) in each.

        The added states in them are 0. Accelerations and forces are there if rates of added states read them.
        """
        manifest = self.plant.manifest
        q, qd = np.split(states, [len(manifest.positions)], axis=1)
        none = np.zeros((len(q), len(self.problem.every_state)))
        parts = self.inputs(*intervals.tolist()).read(time[:, None], q, qd, none)
        if not self.rates.kinds & {"qdd", "tau", "w"}:
            return parts
        qdd, forces = _balance(self.plant, parts["q"], parts["qd"], parts, None)
        return parts | {"qdd": qdd} | forces

    def motions(self) -> Motions:
        """Return the motions of driven joints."""
        guide, trajectory = self.guide, self.trajectory
        if guide is None:
            return stand(())
        return Motions(lambda t: guide.read(t, float(trajectory.t[-1]), trajectory.unknowns), False)

    def inputs(self, *intervals: int) -> Inputs:
        """Return the inputs of some intervals, or of all."""
        return _Piece(self, np.array(intervals or range(len(self.trajectory.u)), dtype=np.int64))


@dataclass(frozen=True)
class _Apart:
    """The motions of all intervals, each from its start."""

    ends: Array  # (N, size)
    read: Callable[[Indices, Array], Array]  # the states (B, size) at fractions (B,) of intervals (B,)


@dataclass(frozen=True)
class _Through:
    """The motion from the start of the horizon, put back on the solution where it was lost."""

    reached: Array  # (N + 1, size): the states at the ends of the intervals
    gap: float  # of loops, the largest that a step left
    lost: tuple[float, ...]  # the times at which it was put back


class Replay:
    """The motions under the inputs of a solution: by C where it can follow them, else with the equations as a whole.

    C factorises the mass matrix; contacts, inputs that follow added states, and a singular matrix, of links without
    mass in a loop, are left to `integrate`.
    """

    def __init__(self, plant: Plant, course: Course, held: Held | None, limits: Limits) -> None:
        self._plant, self._course, self._held, self._allowance = plant, course, held, Allowance(limits)
        self._lengths, self._places = course.lengths, len(plant.manifest.positions) + len(plant.manifest.coordinates)
        self._riders = Riders(course.gather, course.rates) if course.trajectory.states.size else None
        is_plain = held is None and plant.manifest.coordinates and not course.follows_states
        self.stepper = Stepper(plant, course.motions(), TOLERANCE) if is_plain and isinstance(plant, Source) else None

    def go_apart(self, states: Array) -> _Apart | None:
        """Integrate from the start of every interval, (N, size), to its end; None where that fails."""
        if self.stepper is not None:
            try:
                return self._go_apart_in_c(self.stepper, states)
            except (HaltError, UnevenError):
                self.stepper = None
        taken, inputs = list[Step](), self._course.inputs()
        ends = integrate(self._plant, states, inputs, self._lengths, self._allowance, held=self._held, taken=taken)
        return None if ends is None else _Apart(ends, lambda intervals, x: _read_steps(taken, intervals, x))

    def _go_apart_in_c(self, stepper: Stepper, states: Array) -> _Apart:
        """Count the steps of the interval with the most, as if all were integrated at once."""
        pieces = [self._course.piece(k) for k in range(len(states))]
        begins, spans, most = self._close(self._course.inputs(), states[:, : self._places]), list[Span](), 0
        for piece, state in zip(pieces, begins, strict=True):
            own = copy(self._allowance)
            spans.append(stepper.follow(piece, state, own))
            most = max(most, self._allowance.steps - own.steps)
        self._allowance.note(most)
        ends, find = np.array([span.end for span in spans]), stepper.gather(pieces, spans)
        ride = None if self._riders is None else self._riders.ride(range(len(spans)), spans, states[:, self._places :])

        def read(intervals: Indices, fractions: Array) -> Array:
            times = self._course.trajectory.t[intervals] + fractions * self._lengths[intervals]
            found = find(intervals, times)
            return found if ride is None else np.hstack((found, ride.read(intervals, times)))

        return _Apart(ends if ride is None else np.hstack((ends, ride.ends)), read)

    def _close(self, inputs: Inputs, states: Array) -> Array:
        """Return the nearest states (B, nq + n) with closed loops, and with driven joints where they start."""
        manifest, closure = self._plant.manifest, find_closure(self._plant)
        q, qd = inputs.place(np.zeros((len(states), 1)), *np.split(states, [len(manifest.positions)], axis=1))
        if closure is not None:
            q, qd = closure.project(q, qd, manifest.driven)
        return np.concatenate((q, qd), axis=1)

    def go_through(self, states: Array) -> _Through | None:
        """Integrate from the first of the solution's states, (N + 1, size), through all intervals.

        Returns None where that fails from a state of the solution.
        """
        N, scale = len(self._lengths), LOST * np.maximum(1.0, np.ptp(states, axis=0))
        reached, gaps, lost, own = [states[0]], [0.0], list[float](), 0  # the interval that began at the solution
        for k in range(N):
            end = self._go_on(k, reached[-1], gaps, is_closed=k != own)
            if end is None and k != own:
                own, reached[-1] = k, states[k]
                lost.append(float(self._course.trajectory.t[k]))
                end = self._go_on(k, reached[-1], gaps, is_closed=False)
            if end is None:
                return None
            reached.append(end)
            if k < N - 1 and not (np.abs(end - states[k + 1]) <= scale).all():
                own, reached[-1] = k + 1, states[k + 1]
                lost.append(float(self._course.trajectory.t[k + 1]))
        return _Through(np.array(reached), max(gaps), tuple(lost))

    def _go_on(self, k: int, state: Array, gaps: list[float], *, is_closed: bool) -> Array | None:
        """Integrate through an interval; None where that fails. The largest gap of a step is added to `gaps`.

        The end of the interval before is closed, and has driven joints where they are.
        """
        if self.stepper is not None:
            with suppress(HaltError, UnevenError):
                return self._go_on_in_c(self.stepper, k, state, gaps, is_closed=is_closed)
        inputs, length = self._course.inputs(k), float(self._lengths[k])
        end = integrate(self._plant, state[None], inputs, length, self._allowance, gaps, self._held)
        return None if end is None else end[0]

    def _go_on_in_c(self, stepper: Stepper, k: int, state: Array, gaps: list[float], *, is_closed: bool) -> Array:
        begin = state[: self._places]
        if not is_closed:
            begin = self._close(self._course.inputs(k), begin[None])[0]
        span = stepper.follow(self._course.piece(k), begin, self._allowance)
        gaps.append(span.gap)
        if self._riders is None:
            return span.end
        return np.concatenate((span.end, self._riders.ride([k], [span], state[None, self._places :]).ends[0]))


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
    from scipy.integrate import DOP853  # takes long to load, and most solutions do without

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
                if taken is not None and solver.t_old is not None and solver.t > solver.t_old:
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
    states: Callable[[Indices, Array], Array]  # (B, size), at fractions (B,) of intervals (B,)
    kinds: frozenset[str]  # that are read

    def __call__(self, intervals: Indices, fractions: Array) -> dict[str, Array]:
        """Return the parts of the motion at fractions (B,) of intervals (B,)."""
        nq, n = self.course.trajectory.q.shape[1], self.course.trajectory.qd.shape[1]
        q, qd, states = np.split(self.states(intervals, fractions), [nq, nq + n], axis=1)
        times = fractions * self.course.lengths[intervals]
        parts = self.course.inputs(*intervals.tolist()).read(times[:, None], q, qd, states)
        if not self.kinds & {"qdd", "tau", "w"}:
            return parts
        qdd, forces = _balance(self.plant, parts["q"], parts["qd"], parts, self.held)
        return parts | {"qdd": qdd} | forces


def _read_steps(steps: Sequence[Step], motions: Indices, fractions: Array) -> Array:
    """Return the states (B, size) of some motions, each at a fraction of its duration."""
    which = np.searchsorted([step.end for step in steps], fractions).clip(max=len(steps) - 1)
    found = np.zeros((len(fractions), steps[0].shape[1]))
    for i in np.unique(which).tolist():
        chosen = which == i
        found[chosen] = steps[i].read(motions[chosen], fractions[chosen])
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
        w = held.clear(w)
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
        rows, forces, bias = [*rows, J], [*forces, held.push(slopes["jac_Phi_w"])], [*bias, turning]
    if not rows:
        return np.asarray(np.linalg.solve(slopes["jac_Phi_qdd"], -c[..., None])[..., 0]), {"w": w}
    below = np.concatenate(rows, axis=1)
    none = np.zeros((B, below.shape[1], below.shape[1]))
    whole = np.block([[slopes["jac_Phi_qdd"], np.concatenate(forces, axis=2)], [below, none]])
    found = np.linalg.solve(whole, -np.concatenate((c, *bias), axis=1)[..., None])[..., 0]
    if held is not None:
        held.put(w, found[:, -len(held.components) :])
    m = 0 if closure is None else len(closure.dependent)
    return np.asarray(found[:, :n]), {"w": w, "tau": found[:, n + m : n + m + len(manifest.driven)]}
