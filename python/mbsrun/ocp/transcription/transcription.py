"""Direct collocation and multiple shooting: Problem and plant -> a sparse nonlinear program, as data.

`layout` numbers the variables, `writing` writes the constraints, interval by interval:

    x_0 = start                                                                  nq + n rows
    sum_r D_jr q_kr - h qd_kj = 0,  sum_r D_jr qd_kr - h z_kj = 0                nq + n rows a point
    Phi(q_kj, qd_kj, z_kj) - Q(q_kj, qd_kj, u_k) = 0                             n rows a point
    x_(k+1) = sum_r e_r x_kr                                                     nq + n rows an interval
    sensors at x_N, coordinates of x_N, qd_N = 0, z(T) = 0, ...                  as the problem asks

for a residual; where the equations of motion are explicit, the third is z_kj - gamma(q_kj, qd_kj, u_k) = 0, or gamma
takes the place of z_kj in the second, and of z(T): see `representations`. (Docquier, Bruls, Fisette, eqs. 5, 15,
22-27.) In the integral form the second is solved, and states at the points are bounded by separate rows where they
have bounds. Shooting is the integral form of any Runge-Kutta method, with its third solved as well: see `condensation`.
The lengths h_k of intervals may differ: see `grid`. Where the horizon T is free, h is T times a number.

Second-order collocation replaces the first part of the second line by an integral of the velocities' polynomial,

    q_kj - q_k - h sum_r B_jr qd_kr = 0,    B_jr = integral from 0 to c_j of the basis polynomial of node r

and q_(k+1) likewise (Moreno-Martin, Ros, Celaya, arXiv 2302.09056): see `integrators`.

Where a model has quaternions, its kernel `rates` takes the place of qd_kj, and nq exceeds n. Collocation at Legendre
points keeps their lengths; Radau points nearly do. A length is set at the start alone, where that is free. Three
equations set an attitude at the end, of either sign and any length.

A constraint along the path holds at all collocation points. If it reads states alone, which are continuous, it holds
at all mesh points too: Radau points include them, and a start that is given cannot change.

Start, targets and bounds are bounds of the program; weights of the cost and constants of expressions are its
parameters: one program serves all problems that differ in those only. Closed loops: see `closing`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TypeVar

import numpy as np

from mbsrun.closure import Closure, find_closure
from mbsrun.ocp.ground import integrators, schemes
from mbsrun.ocp.ground.functions import Array, Indices
from mbsrun.ocp.ground.integrators import Integrator
from mbsrun.ocp.ground.plant import Plant
from mbsrun.ocp.ground.program import Program
from mbsrun.ocp.ground.schemes import Scheme
from mbsrun.ocp.ground.trajectory import Trajectory
from mbsrun.ocp.problem.design import list_fixed_values
from mbsrun.ocp.problem.driving import find_point_forces, varies
from mbsrun.ocp.problem.problem import Delay, Problem, count_delayed, find_conflicts
from mbsrun.ocp.problem.structure import Structure, structure
from mbsrun.ocp.transcription.layout import Layout, Rows, at_points, fill_in, read_slopes
from mbsrun.ocp.transcription.writing.ends import find_targets
from mbsrun.ocp.transcription.writing.program import write_program
from mbsrun.ocp.transcription.writing.sheet import Sheet, find_components
from mbsrun.quaternions import Quaternion, find_quaternion, list_quaternions

T = TypeVar("T")


class _Latest:
    """Bounds of the problem that was seen last: a solve reads the bounds of one problem several times."""

    def __init__(self, find: Callable[[Problem], tuple[Array, Array]]) -> None:
        self._find = find
        self._known: tuple[Problem, tuple[Array, Array]] | None = None

    def find(self, problem: Problem) -> tuple[Array, Array]:
        """Return lower and upper bounds, which cannot be written to."""
        known = self._known
        if known is None or known[0] is not problem:
            known = problem, self._find(problem)
            for bounds in known[1]:
                bounds.flags.writeable = False
            self._known = known
        return known[1]


@dataclass(frozen=True)
class Transcription:
    """A program, and how problems become its numbers and its variables trajectories.

    Vectors are of all variables and rows of the program, except where a docstring says that a solver sees them.
    """

    structure: Structure
    quaternions: tuple[Quaternion, ...]
    scheme: Scheme
    integrator: Integrator
    layout: Layout
    rows: Rows
    program: Program
    plant: Plant | None = None  # of a mechanism whose loops or driven joints take forces
    closure: Closure | None = None  # of a mechanism with closed loops
    fixed: tuple[float, ...] = ()  # values of the entries of theta that are no unknowns
    components: tuple[int, ...] = ()  # the entry of w of each component of a wrench that the problem has

    def parameters(self, problem: Problem) -> Array:
        """Return the parameters of the program: weights, constants, attitudes of the end."""
        values, end = [value for _, value in problem.constants], dict(problem.end.coordinates)
        for quaternion in find_targets(self.structure, self.quaternions):
            values += [end[i] for i in quaternion.entries]
        return np.array([*problem.cost.weights, *values])

    def variable_bounds(self, problem: Problem) -> tuple[Array, Array]:
        """Bound the variables that a solver sees: states at mesh and collocation points, inputs, and the horizon.

        The bounds of the latest problem are kept, and are not to be changed.
        """
        return self._variable_bounds.find(problem)

    @cached_property
    def _variable_bounds(self) -> _Latest:
        return _Latest(self._bound_variables)

    def _bound_variables(self, problem: Problem) -> tuple[Array, Array]:
        lower, upper = np.full(self.layout.size, -np.inf), np.full(self.layout.size, np.inf)
        states = self._bound_states(problem)
        extras, added = self.layout.extras, np.array([state.bounds for state in problem.every_state]).reshape(-1, 2)
        for index, bounds in (
            (self.layout.mesh, states),
            *([(self.layout.points, states)] if self.layout.points.size else []),
            (extras.states, added),
            (extras.point_states, added),
            *self._bound_inputs(problem),
            (
                extras.wrenches[:, :, list(self.components)],
                np.array([x.bounds for x in problem.every_component]).reshape(-1, 2),
            ),
            *([(self.layout.driving, np.array(problem.bounds.tau).reshape(-1, 2))] if problem.bounds.tau else []),
        ):
            lower[index], upper[index] = bounds.T
        given = self._list_given_states(problem)
        lower[given], upper[given] = -np.inf, np.inf
        self._limit_first_inputs(problem, lower, upper)
        lower[self.layout.horizons], upper[self.layout.horizons] = problem.horizon_limits
        lower[self._fixed] = upper[self._fixed] = self.fixed
        bounds = np.array([unknown.bounds for unknown in problem.unknowns]).reshape(-1, 2)
        lower[self.layout.unknowns], upper[self.layout.unknowns] = bounds.T
        for delay in problem.delays:
            if delay.history is not None:
                known = self._find_delayed(delay, problem)
                lower[known] = upper[known] = delay.commands or delay.history
        return lower[self.program.kept], upper[self.program.kept]

    def _bound_states(self, problem: Problem) -> Array:
        """Return the bounds (nq + n, 2) of states; a driven joint has none where nothing that is chosen moves it.

        It keeps within them then, which is checked before. A value on a bound would leave no interior to methods of
        interior points.
        """
        states, motions = np.array(problem.bounds.q + self._pick(problem.bounds.qd)).reshape(-1, 2), self.layout.motions
        fixed = [not varies(text, problem) for text in self.structure.driven]
        states[[i for i, is_known in zip(motions.driven_states, 2 * fixed, strict=True) if is_known]] = -np.inf, np.inf
        return states

    def _list_given_states(self, problem: Problem) -> Indices:
        """List the states where the problem gives their values, at the start and at the end, within their bounds.

        They need no bounds. A value on a bound would leave no interior to methods of interior points.
        """
        extras, layout = self.layout.extras, self.layout
        starts, ends = [extras.states[0]], [extras.states[-1]]
        motions = [layout.mesh[0]], [layout.mesh[-1]]
        if self.scheme.ends_interval and extras.point_states.size:
            ends.append(extras.point_states[-1, -1])  # the same state again
        if self.scheme.ends_interval and layout.points.size:
            motions[1].append(layout.points[-1, -1])
        found = [
            index[i]
            for i, state in enumerate(problem.every_state)
            for indices, (least, most) in ((starts, state.start), (ends, state.end))
            for index in indices
            if least == most
        ]
        bounds = problem.bounds.q + self._pick(problem.bounds.qd)
        for indices, values in zip(motions, (self._list_start(problem), self._list_end(problem)), strict=True):
            kept = [i for i, value in values.items() if bounds[i][0] <= value <= bounds[i][1]]
            found += [index[i] for index in indices for i in kept]
        return np.array(found, dtype=np.int64)

    def _list_start(self, problem: Problem) -> dict[int, float]:
        """Return the given values of a mechanism's first state, (q, velocities), by entry."""
        nq, velocities = self.layout.nq, self.layout.motions.velocities
        whole = {i: value for i, value in enumerate(problem.start_q) if i not in problem.free_start}
        moving = enumerate(velocities)
        return whole | {nq + k: problem.start_qd[i] for k, i in moving if nq + i not in problem.free_start}

    def _list_end(self, problem: Problem) -> dict[int, float]:
        """Return the given values of a mechanism's last state, without quaternions, by entry."""
        nq, motions, end = self.layout.nq, self.layout.motions, problem.end
        resting = [i for i in motions.independent if i not in motions.driven]
        places = {i: value for i, value in end.coordinates if find_quaternion(self.quaternions, i) is None}
        speeds = dict(end.velocities) | (dict.fromkeys(resting, 0.0) if end.velocity_zero else {})
        return places | {nq + motions.velocities.index(i): value for i, value in speeds.items()}

    def _bound_inputs(self, problem: Problem) -> list[tuple[Indices, Array]]:
        """List the inputs and controls with their bounds."""
        layout, extras = self.layout, self.layout.extras
        u, controls = (
            np.array(bounds).reshape(-1, 2)
            for bounds in (problem.bounds.u, [control.bounds for control in problem.controls])
        )
        given, free = (extras.forces, u[list(extras.given)]), u[list(extras.free)]
        if problem.inputs == "constant":
            return [given, (layout.inputs, free), (extras.controls, controls)]
        return [given, (layout.point_inputs, free), (extras.point_controls, controls)]

    def _limit_first_inputs(self, problem: Problem, lower: Array, upper: Array) -> None:
        """Narrow bounds in the first interval, of inputs and controls; where nothing is left, by the bounds of all."""
        extras = self.layout.extras
        for ranges, first, chosen in (
            (problem.first_inputs, self.layout.inputs, list(extras.free)),
            (problem.first_controls, extras.controls, slice(None)),
        ):
            if ranges:
                lower[first[0]], upper[first[0]] = np.clip(np.array(ranges)[chosen].T, lower[first[0]], upper[first[0]])

    def _find_delayed(self, delay: Delay, problem: Problem) -> Indices:
        """Return the variables of a delayed input before its first command acts."""
        layout, extras = self.layout, self.layout.extras
        count, is_constant = count_delayed(delay, problem), problem.inputs == "constant"
        if delay.kind == "control":
            controls = extras.controls if is_constant else extras.point_controls
            return np.ravel(controls[:count, ..., delay.index])
        inputs = layout.inputs if is_constant else layout.point_inputs
        return np.ravel(inputs[:count, ..., extras.free.index(delay.index)])

    def constraint_bounds(self, problem: Problem) -> tuple[Array, Array]:
        """Bound the rows that a solver sees: by start, end, ranges of constraints and bounds; all else is 0.

        The bounds of the latest problem are kept, and are not to be changed.
        """
        return self._constraint_bounds.find(problem)

    @cached_property
    def _constraint_bounds(self) -> _Latest:
        return _Latest(self._bound_rows)

    def _bound_rows(self, problem: Problem) -> tuple[Array, Array]:
        rows, end = self.rows, problem.end
        lower = np.zeros(rows.size)
        lower[rows.start] = problem.start_q + self._pick(problem.start_qd)
        for row, targets in (
            (rows.sensors, end.sensors),
            (rows.coordinates, [x for x in end.coordinates if find_quaternion(self.quaternions, x[0]) is None]),
            (rows.velocities, end.velocities),
            (rows.accelerations, end.accelerations),
            (rows.sensor_velocities, end.sensor_velocities),
        ):
            lower[row] = np.array([value for _, value in targets], dtype=float).reshape(row.shape)
        upper = lower.copy()
        free = np.isnan(lower)  # coordinates of sensors without a target
        lower[free], upper[free] = -np.inf, np.inf
        nq, velocities = self.layout.nq, self.layout.motions.velocities
        given = [i not in problem.free_start for i in (*range(nq), *(nq + i for i in velocities))]
        free = np.append(rows.start[~np.array(given, dtype=bool)], rows.start[self.layout.motions.driven_states])
        lower[free], upper[free] = -np.inf, np.inf
        # a start that is given whole is closed: its loops would be conditions too many
        for row, part in zip(self._split_start_closure(), (given[:nq], given[nq:]), strict=False):
            if all(part):
                lower[row], upper[row] = -np.inf, np.inf
        if rows.lengths.size:
            is_free = np.array([quaternion.first in problem.free_start for quaternion in self.quaternions])
            lower[rows.lengths] = np.where(is_free, 1.0, -np.inf)
            upper[rows.lengths] = np.where(is_free, 1.0, np.inf)
        states = np.array(problem.bounds.q + problem.bounds.qd)[list(self.structure.bounded)].reshape(-1, 2)
        lower[rows.inner], upper[rows.inner] = states.T
        upper[rows.extras.friction] = np.inf
        if all(given[nq:]):  # the velocities hold the contacts, or not, and then no force could
            lower[rows.extras.contacts_at_start], upper[rows.extras.contacts_at_start] = -np.inf, np.inf
        for i, state in enumerate(problem.every_state):
            lower[rows.extras.start[i]], upper[rows.extras.start[i]] = state.start
        for row, i in zip(rows.extras.end, self.structure.ending, strict=True):
            lower[row], upper[row] = problem.every_state[i].end
        for row, constraint in zip(rows.constraints, problem.constraints, strict=True):
            lower[row], upper[row] = constraint.range
        rates = [problem.bounds.rates[i] for i in self.structure.rated_inputs]
        rates += [problem.controls[i].rates for i in self.structure.rated_controls]
        lower[rows.rates], upper[rows.rates] = np.array(rates).reshape(-1, 2).T
        return lower[self.program.kept_rows], upper[self.program.kept_rows]

    def _pick(self, values: Sequence[T]) -> tuple[T, ...]:
        """Pick the velocities that are variables."""
        return tuple(values[i] for i in self.layout.motions.velocities)

    def _split_start_closure(self) -> list[Indices]:
        """Split the rows that close the loops at the start: coordinates, and velocities where all are variables."""
        m = 0 if self.closure is None else len(self.closure.dependent)
        return [self.rows.start_closure[i : i + m] for i in range(0, self.rows.start_closure.size, max(m, 1))]

    def pack(self, trajectory: Trajectory) -> Array:
        """Put a trajectory on this grid into the variables that a solver sees."""
        x, layout = np.zeros(self.layout.size), self.layout
        velocities, independent = list(layout.motions.velocities), list(layout.motions.independent)
        x[layout.mesh] = np.concatenate((trajectory.q, trajectory.qd[:, velocities]), axis=1)
        if layout.points.size:
            x[layout.points] = np.concatenate((trajectory.point_q, trajectory.point_qd[:, :, velocities]), axis=2)
        if layout.slopes.size and not self.program.solved:
            nodes = zip((trajectory.q, trajectory.qd), (trajectory.point_q, trajectory.point_qd), strict=True)
            states = [np.concatenate((mesh[:-1, None], points), axis=1) for mesh, points in nodes]
            x[layout.slopes] = (
                self.scheme.D
                @ np.concatenate((states[0], states[1][:, :, velocities]), axis=2)[:, :, layout.motions.carried]
            )
        if layout.shifts.size and not self.program.solved:
            x[layout.shifts] = self._find_shifts(x[layout.mesh], trajectory)
        self._pack_inputs(x, trajectory)
        x[layout.extras.states] = trajectory.states
        # shooting has other stages than points, and adds no states
        x[layout.extras.point_states] = trajectory.point_states.reshape(layout.extras.point_states.shape)
        if self.scheme.begins_interval:
            x[self._slopes] = self._find_slopes(trajectory)
        x[layout.horizons] = trajectory.t[-1]
        x[layout.unknowns] = trajectory.unknowns
        x[self._fixed] = self.fixed
        if layout.accelerations.size and not self.program.solved:
            x[layout.accelerations] = trajectory.point_qdd[:, :, independent]
        if layout.drives.size:
            x[layout.drives] = trajectory.point_qdd[:, :, list(layout.motions.driven)]
        if layout.multipliers.size or layout.driving.size:
            multipliers, x[layout.driving] = self._find_forces(trajectory)
            if layout.multipliers.size:
                x[layout.multipliers] = multipliers
        return np.asarray(x[self.program.kept])

    def unpack(self, x: Array) -> Trajectory:
        """Read a trajectory off all variables: a backend's `complete` returns them for a solver's variables."""
        layout, fixed = self.layout, self.structure.horizon
        horizon = float(x[layout.horizon]) if fixed is None else fixed
        t, point_t = layout.grid.times(horizon, self.scheme.points)
        mesh, h = x[layout.mesh], layout.grid.lengths(horizon)
        if layout.points.size or not layout.mesh.shape[1]:
            points = x[layout.points]
            q, qd = layout.split(points)
            qdd = self._read_accelerations(x, mesh, h)
        elif layout.slopes.size:
            motion = fill_in(read_slopes(layout, self.integrator.points), layout, self.integrator.first_point)
            q, qd = (part.evaluate(x).reshape(*point_t.shape, part.size) for part in motion)
            qdd = self.integrator.points.W @ layout.split_carried(x[layout.slopes])[1] / h[:, None, None]
        else:
            places = at_points(layout, self.integrator, h)
            q, qd, qdd = (
                (x[part].T if isinstance(part, np.ndarray) else part.evaluate(x)).reshape(*point_t.shape, -1)
                for part in (places.q, places.qd, places.qdd)
            )
        mesh_q, mesh_qd = layout.split(mesh)
        closure = self.find_loops(x[layout.unknowns])
        if closure is not None and layout.motions.is_reduced:
            mesh_qd = self._complete(closure, mesh_q, mesh_qd)
            qd = self._complete(closure, q, qd)
            qdd = closure.complete_accelerations(q, qd, closure.independent, qdd)
        u, point_u, controls = self._unpack_inputs(x)
        return Trajectory(
            t,
            mesh_q,
            mesh_qd,
            u,
            point_t,
            q,
            qd,
            qdd,
            states=x[layout.extras.states],
            point_states=x[layout.extras.point_states].reshape(*point_t.shape, layout.extras.states.shape[1]),
            controls=controls,
            unknowns=x[layout.unknowns],
            point_u=point_u,
            point_controls=x[layout.extras.point_controls],
            point_w=x[layout.extras.wrenches].reshape(*point_t.shape, layout.extras.wrenches.shape[2]),
            slopes=x[self._slopes] / h[:, None] if self.scheme.begins_interval else np.zeros(0),
        )

    @property
    def _slopes(self) -> Indices:
        """The variables (N, ...) that are slopes at the starts of intervals, times their lengths."""
        return np.concatenate((self.layout.nodes[:, 0], self.layout.extras.nodes[:, 0]), axis=1)

    def _find_slopes(self, trajectory: Trajectory) -> Array:
        """Return slopes times lengths of intervals: as the trajectory has them, or of polynomials of less degree."""
        if trajectory.slopes.size:
            return np.asarray(trajectory.slopes * np.diff(trajectory.t)[:, None])
        velocities = list(self.layout.motions.velocities)
        mesh = np.concatenate((trajectory.q, trajectory.qd[:, velocities], trajectory.states), axis=1)
        parts = (trajectory.point_q, trajectory.point_qd[:, :, velocities], trajectory.point_states)
        nodes = np.concatenate((mesh[:-1, None], np.concatenate(parts, axis=2)[:, 1:]), axis=1)
        return np.asarray(np.einsum("r,krn->kn", self.scheme.read_slope(), nodes))

    def _read_accelerations(self, x: Array, mesh: Array, h: Array) -> Array:
        """Return the accelerations (N, d, moved) at the points, or the derivatives of velocities there."""
        layout, motions = self.layout, self.layout.motions
        if layout.every_acceleration.size:
            return np.asarray(x[layout.every_acceleration])
        nodes = np.concatenate((mesh[:-1, None], x[layout.nodes]), axis=1)
        rates = layout.split(nodes)[1][:, :, motions.moved_velocities]
        qdd = self.scheme.D @ rates / h[:, None, None]
        qdd[:, :, [motions.moved.index(i) for i in motions.driven]] = x[layout.drives]
        return np.asarray(qdd)

    def _find_shifts(self, mesh: Array, trajectory: Trajectory) -> Array:
        """Return how far entries of states that loops give move from an interval's start, where loops are closed."""
        assert self.integrator.points.are_stages, "other stages are solved for"
        velocities, found = list(self.layout.motions.velocities), self.layout.motions.found
        points = np.concatenate((trajectory.point_q, trajectory.point_qd[:, :, velocities]), axis=2)
        places = points if self.scheme.ends_interval else np.concatenate((points, mesh[1:, None]), axis=1)
        return np.asarray((places - mesh[:-1, None])[:, :, found])

    def _pack_inputs(self, x: Array, trajectory: Trajectory) -> None:
        """Put inputs, controls and components of wrenches into the variables."""
        layout, extras = self.layout, self.layout.extras
        u, controls = trajectory.spread_inputs()
        if self.structure.inputs == "constant":
            x[layout.inputs], x[extras.controls] = trajectory.u[:, list(extras.free)], trajectory.controls
        else:
            x[layout.point_inputs], x[extras.point_controls] = u[:, :, list(extras.free)], controls
        if extras.given:
            x[extras.forces] = u[:, :, list(extras.given)]
        x[extras.wrenches] = trajectory.point_w.reshape(extras.wrenches.shape)

    def _unpack_inputs(self, x: Array) -> tuple[Array, Array, Array]:
        """Read inputs (N, m), or their means, their values at the points unless constant, and controls, or means."""
        layout, extras = self.layout, self.layout.extras
        N, d = layout.grid.intervals, self.scheme.degree
        is_constant = self.structure.inputs == "constant"
        controls = x[extras.controls] if is_constant else self._average(x[extras.point_controls])
        if is_constant and not extras.given:
            return x[layout.inputs], np.zeros((N, d, 0)), controls
        point_u = np.zeros((N, d, extras.m))
        point_u[:, :, list(extras.free)] = x[layout.inputs][:, None] if is_constant else x[layout.point_inputs]
        point_u[:, :, list(extras.given)] = x[extras.forces]
        u = self._average(point_u)
        if is_constant:
            u[:, list(extras.free)] = x[layout.inputs]
        return u, point_u, controls

    def _average(self, points: Array) -> Array:
        """Return means over the intervals of values (N, d, size) at the points."""
        return np.asarray(np.einsum("j,kjm->km", self.scheme.weights, points))

    @cached_property
    def _fixed(self) -> Indices:
        """The variables of theta that are no unknowns."""
        return np.setdiff1d(self.layout.design, self.layout.unknowns)

    def read_multipliers(self, x: Array, trajectory: Trajectory) -> Array | None:
        """Read the multipliers of loops, (N, d, m), off all variables, or find them where they are none."""
        if self.closure is None:
            return None
        return x[self.layout.multipliers] if self.layout.multipliers.size else self._find_forces(trajectory)[0]

    def read_driving(self, x: Array) -> Array | None:
        """Read the forces of driven joints, (N, S, d), off all variables."""
        return x[self.layout.driving] if self.layout.driving.size else None

    def find_loops(self, unknowns: Array) -> Closure | None:
        """Return the loops of the mechanism that given values of the unknowns make."""
        if self.closure is None or set(self.closure.parameters).isdisjoint(self.structure.added.unknowns):
            return self.closure
        return Closure(self._choose(unknowns))

    def _choose(self, unknowns: Array) -> Plant:
        """Return the kernels with given values of the unknowns."""
        assert self.plant is not None, "loops and driven joints belong to kernels"
        chosen = dict(zip(self.structure.added.unknowns, unknowns.tolist(), strict=True))
        design = {part.name: chosen[part.name] for part in self.plant.manifest.design if part.name in chosen}
        return self.plant.with_parameters(**design)

    def _find_forces(self, trajectory: Trajectory) -> tuple[Array, Array]:
        """Find multipliers (N, d, m) and forces of driven joints (N, d, ...) at the points of a motion."""
        return find_point_forces(self._choose(trajectory.unknowns), trajectory)

    def _complete(self, closure: Closure, q: Array, velocities: Array) -> Array:
        """Return all velocities from the ones that are variables: (..., n) both."""
        yd = velocities[..., self.layout.motions.moved_velocities]
        return closure.complete_velocities(q, closure.independent, yd)


def transcribe(problem: Problem, plant: Plant) -> Transcription:
    """Write the program of a problem; no value of start, targets, weights, constants and bounds enters it.

    Raises ValueError where parts of the problem do not go together.
    """
    for conflict in find_conflicts(problem):
        raise ValueError(f"{conflict.place[0]}: {conflict.finding}")
    for quaternion in list_quaternions(plant.manifest):
        for key, named in (("start", problem.free_start), ("end", dict(problem.end.coordinates))):
            if 0 < len([i for i in quaternion.entries if i in named]) < 4:
                raise ValueError(f"{key}: a part of the quaternion of {quaternion.joint}; name all four entries")
    shape = structure(problem)
    scheme = schemes.build(shape.family, shape.degree)
    integrator = integrators.build(shape.integrator, scheme, shape.steps)
    sheet = Sheet(shape, plant, scheme, integrator)
    rows, program = write_program(sheet)
    closure = find_closure(plant)
    return Transcription(
        shape,
        sheet.quaternions,
        scheme,
        integrator,
        sheet.layout,
        rows,
        program,
        plant,
        closure,
        list_fixed_values(shape.added.unknowns, plant),
        find_components(shape, plant.manifest),
    )
