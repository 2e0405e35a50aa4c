"""Direct collocation and multiple shooting: Problem and plant -> sparse nonlinear program.

Variables are as `layout` says. Constraints, interval by interval:

    x_0 = start                                                                  nq + n rows
    sum_r D_jr q_kr - h qd_kj = 0,  sum_r D_jr qd_kr - h z_kj = 0                nq + n rows a point
    Phi(q_kj, qd_kj, z_kj) - Q(q_kj, qd_kj, u_k) = 0                             n rows a point
    x_(k+1) = sum_r e_r x_kr                                                     nq + n rows an interval
    sensors at x_N, coordinates of x_N, qd_N = 0, z(T) = 0, ...                  as the problem asks

for a residual; where the equations of motion are explicit, the third is z_kj - gamma(q_kj, qd_kj, u_k) = 0, or gamma
takes the place of z_kj in the second, and of z(T). (Docquier, Bruls, Fisette, eqs. 5, 15, 22-27.) In the integral form
the second is solved, and states at the points are bounded by rows of their own where they have bounds. Shooting is the
integral form of any Runge-Kutta method, with its third solved as well: see `condensation`.

Where a model has quaternions, its kernel `rates` takes the place of qd_kj, and nq exceeds n. That keeps their lengths
where the points are Legendre's, and at others nearly: nothing depends on them but the start, where they are given, or
are 1 where it is free, and the end, where three equations set an attitude, of either sign and any length.

A constraint along the path holds at all collocation points, and if it speaks of states alone, which do not jump there,
at all mesh points: with Radau points these are among them, and a start that is given is as it is.

Start, targets and bounds are bounds of the program; weights of the cost and constants of expressions are its
parameters: one program serves all problems that differ in those only.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from mbsgen.expressions import names, parse
from mbsrun.ocp import integrators, schemes
from mbsrun.ocp.condensation import Condensed, condense
from mbsrun.ocp.integrators import Integrator, IntegratorName
from mbsrun.ocp.layout import Entries, Layout, Places, at_mesh, at_points, at_stages, lay_out, read_motion
from mbsrun.ocp.plant import Plant
from mbsrun.ocp.problem import Form, Problem, Representation, find_conflicts
from mbsrun.ocp.program import Block, Indices, Matrix, Program
from mbsrun.ocp.quantities import Quantity, formulate, list_quantities
from mbsrun.ocp.schemes import Family, Scheme
from mbsrun.ocp.trajectory import Trajectory, grid
from mbsrun.quaternions import Quaternion, compare, find_quaternion, list_quaternions, neutral

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Structure:
    """What of a problem shapes its program; problems with equal structures share one."""

    horizon: float | None  # None where it is free
    intervals: int
    family: Family
    degree: int
    representation: Representation
    form: Form
    integrator: IntegratorName
    steps: int
    bounded: tuple[int, ...]  # indices into (q, qd) of states whose bounds are constraints: where points have no states
    start_is_free: bool
    running: tuple[str, ...]  # expressions
    terminal: tuple[str, ...]
    constraints: tuple[tuple[str, str], ...]  # expression, where it holds
    constants: tuple[str, ...]
    sensors: tuple[str, ...]
    coordinates: tuple[int, ...]
    velocity_zero: bool
    acceleration_zero: bool
    velocities: tuple[int, ...]
    accelerations: tuple[int, ...]
    sensor_velocities: tuple[str, ...]


@dataclass(frozen=True)
class Rows:
    """Where each constraint lies."""

    start: Indices  # (nq + n,)
    lengths: Indices  # (quaternions,) where the start is free, or empty
    states: Indices  # (N, S, nq + n); (N, S, 0) in the integral form
    dynamics: Indices  # (N, S, n): those of the states that hold the equations of motion, for an ODE
    continuity: Indices  # (N, nq + n)
    inner: Indices  # (N, points, bounded states): where points have no states
    sensors: Indices  # (targets, 3)
    coordinates: Indices  # (targets,); quaternions apart
    attitudes: Indices  # (targets, 3)
    velocity: Indices  # (n,), or empty
    acceleration: Indices  # (n,), or empty
    velocities: Indices  # (targets,)
    accelerations: Indices  # (targets,)
    sensor_velocities: Indices  # (targets, 3)
    constraints: tuple[Indices, ...]  # of each, (places,)
    size: int


@dataclass(frozen=True)
class Transcription:
    """A program, and how problems go into it and trajectories come out.

    Layout and rows are those before unknowns are condensed out of the program, where they are.
    """

    structure: Structure
    quaternions: tuple[Quaternion, ...]
    scheme: Scheme
    integrator: Integrator
    layout: Layout
    rows: Rows
    program: Program | Condensed

    def parameters(self, problem: Problem) -> Array:
        """Give the parameters of the program: weights, constants, attitudes of the end."""
        values, end = [value for _, value in problem.constants], dict(problem.end.coordinates)
        for quaternion in _find_targets(self.structure, self.quaternions):
            values += [end[i] for i in quaternion.entries]
        return np.array([*problem.cost.weights, *values])

    def variable_bounds(self, problem: Problem) -> tuple[Array, Array]:
        """Bound the states at mesh and collocation points where they are variables, the inputs, and the horizon."""
        lower, upper = np.full(self.layout.size, -np.inf), np.full(self.layout.size, np.inf)
        states = np.array(problem.bounds.q + problem.bounds.qd)
        for index, bounds in (
            (self.layout.mesh, states),
            *([(self.layout.points, states)] if self.layout.points.size else []),
            (self.layout.inputs, np.array(problem.bounds.u).reshape(-1, 2)),
        ):
            lower[index], upper[index] = bounds.T
        if problem.horizon_range is not None:
            lower[self.layout.horizon], upper[self.layout.horizon] = problem.horizon_range
        if isinstance(self.program, Condensed):
            return lower[self.program.kept], upper[self.program.kept]
        return lower, upper

    def constraint_bounds(self, problem: Problem) -> tuple[Array, Array]:
        """Bound g: by the start, by what the end asks for, by the ranges of constraints; all else is 0."""
        rows, end = self.rows, problem.end
        lower = np.zeros(rows.size)
        lower[rows.start] = problem.start_q + problem.start_qd
        for row, targets in (
            (rows.sensors, end.sensors),
            (rows.coordinates, [x for x in end.coordinates if find_quaternion(self.quaternions, x[0]) is None]),
            (rows.velocities, end.velocities),
            (rows.accelerations, end.accelerations),
            (rows.sensor_velocities, end.sensor_velocities),
        ):
            lower[row] = np.array([value for _, value in targets]).reshape(row.shape)
        upper = lower.copy()
        free = rows.start[list(problem.free_start)]
        lower[free], upper[free] = -np.inf, np.inf
        if rows.lengths.size:
            is_free = np.array([quaternion.first in problem.free_start for quaternion in self.quaternions])
            lower[rows.lengths] = np.where(is_free, 1.0, -np.inf)
            upper[rows.lengths] = np.where(is_free, 1.0, np.inf)
        states = np.array(problem.bounds.q + problem.bounds.qd)[list(self.structure.bounded)].reshape(-1, 2)
        lower[rows.inner], upper[rows.inner] = states.T
        for row, constraint in zip(rows.constraints, problem.constraints, strict=True):
            lower[row], upper[row] = constraint.range
        if isinstance(self.program, Condensed):
            return lower[self.program.kept_rows], upper[self.program.kept_rows]
        return lower, upper

    def cost_terms(self, problem: Problem, x: Array) -> tuple[tuple[str, float], ...]:
        """Compute the terms of the cost, by name, weights included."""
        terms = self.program.terms(x, self.parameters(problem)).full().ravel() * problem.cost.weights
        return tuple(zip(problem.cost.names, terms.tolist(), strict=True))

    def pack(self, trajectory: Trajectory) -> Array:
        """Put a trajectory on this grid into the variables."""
        x, layout = np.zeros(self.layout.size), self.layout
        x[layout.mesh] = np.concatenate((trajectory.q, trajectory.qd), axis=1)
        if layout.points.size:
            x[layout.points] = np.concatenate((trajectory.point_q, trajectory.point_qd), axis=2)
        x[layout.inputs] = trajectory.u
        if layout.horizon is not None:
            x[layout.horizon] = trajectory.t[-1]
        if isinstance(self.program, Condensed):
            return np.asarray(x[self.program.kept])
        if layout.accelerations.size:
            x[layout.accelerations] = trajectory.point_qdd
        return x

    def unpack(self, x: Array) -> Trajectory:
        """Read a trajectory out of the variables. Raises ValueError where condensed equations have no solution."""
        layout = self.layout
        if isinstance(self.program, Condensed):
            x = self.program.complete(x)
        fixed = self.structure.horizon
        t, point_t = grid(
            float(x[layout.horizon]) if fixed is None else fixed, self.structure.intervals, self.scheme.points
        )
        mesh, h = x[layout.mesh], t[1] - t[0]
        if layout.points.size:
            points = x[layout.points]
            nodes = np.concatenate((mesh[:-1, None], points), axis=1)
            has_accelerations = layout.accelerations.size > 0
            q, qd = layout.split(points)
            qdd = x[layout.accelerations] if has_accelerations else self.scheme.D @ layout.split(nodes)[1] / h
        else:
            motion = read_motion(layout, self.integrator.points, h)
            q, qd, qdd = ((part @ x).reshape(*point_t.shape, layout.n) for part in (motion.q, motion.qd, motion.qdd))
        return Trajectory(t, *layout.split(mesh), x[layout.inputs], point_t, q, qd, qdd)


def structure(problem: Problem) -> Structure:
    """Read off what shapes the program of a problem."""
    cost, end = problem.cost, problem.end
    states = problem.bounds.q + problem.bounds.qd
    bounded = [i for i, bounds in enumerate(states) if np.isfinite(bounds).any()]
    return Structure(
        horizon=problem.horizon if problem.horizon_range is None else None,
        intervals=problem.intervals,
        family=problem.family,
        degree=problem.degree,
        representation=problem.representation,
        form=problem.form,
        integrator=problem.integrator,
        steps=problem.steps,
        bounded=() if problem.form is Form.STANDARD else tuple(bounded),
        start_is_free=bool(problem.free_start),
        running=tuple(term.expression for term in cost.running),
        terminal=tuple(term.expression for term in cost.terminal),
        constraints=tuple((constraint.expression, constraint.at) for constraint in problem.constraints),
        constants=tuple(name for name, _ in problem.constants),
        sensors=tuple(name for name, _ in end.sensors),
        coordinates=tuple(i for i, _ in end.coordinates),
        velocity_zero=end.velocity_zero,
        acceleration_zero=end.acceleration_zero,
        velocities=tuple(i for i, _ in end.velocities),
        accelerations=tuple(i for i, _ in end.accelerations),
        sensor_velocities=tuple(name for name, _ in end.sensor_velocities),
    )


def transcribe(problem: Problem, plant: Plant) -> Transcription:
    """Build the program of a problem; of start, targets, weights, constants and bounds no value enters it.

    Raises ValueError where what is asked for does not go together.
    """
    for conflict in find_conflicts(problem):
        raise ValueError(f"{conflict.key}: {conflict.finding}")
    for quaternion in list_quaternions(plant.manifest):
        for key, named in (("start", problem.free_start), ("end", dict(problem.end.coordinates))):
            if 0 < len([i for i in quaternion.entries if i in named]) < 4:
                raise ValueError(f"{key}: a part of the quaternion of {quaternion.joint}; name all four entries")
    return _Writer(structure(problem), plant).write()


def _find_targets(shape: Structure, quaternions: Sequence[Quaternion]) -> list[Quaternion]:
    """Find the quaternions that must have an attitude at the end; each is named whole."""
    return [quaternion for quaternion in quaternions if quaternion.first in shape.coordinates]


class _Writer:
    """Writes the program of a structure, group by group of its constraints and costs."""

    def __init__(self, shape: Structure, plant: Plant) -> None:
        self.shape, self.plant, self.quaternions = shape, plant, list_quaternions(plant.manifest)
        self.scheme = schemes.build(shape.family, shape.degree)
        self.integrator = integrators.build(shape.integrator, self.scheme, shape.steps)
        self.layout = lay_out(
            len(plant.manifest.positions),
            len(plant.manifest.coordinates),
            len(plant.manifest.actuated),
            shape.intervals,
            len(self.integrator.stages.c),
            has_states=shape.form is Form.STANDARD,
            has_accelerations=shape.form is not Form.STANDARD or not shape.representation.is_ode,
            horizon_is_free=shape.horizon is None,
        )
        self.h = (1.0 if shape.horizon is None else shape.horizon) / shape.intervals  # times T, where that is free
        self.points = at_points(self.layout, self.integrator, self.h)
        self.A = Entries()
        self.blocks: list[Block] = []
        self.size = 0
        self.weights = 2 + len(shape.running) + len(shape.terminal)
        self.parameters = self.weights + len(shape.constants)  # and then attitudes, where they are written

    def write(self) -> Transcription:
        shape = self.shape
        q, qd = self.layout.split(self.layout.mesh[-1])
        every = tuple(range(qd.size))
        start = self.write_states(self.layout.mesh[0])
        lengths = self.write_lengths()
        states, dynamics, continuity = self.write_collocation()
        rows = Rows(
            start=start,
            lengths=lengths,
            states=states,
            dynamics=dynamics,
            continuity=continuity,
            inner=self.write_inner_bounds(),
            sensors=self.write_sensors([_sensor(q, self.plant, name) for name in shape.sensors]),
            coordinates=self.write_states(
                q[[i for i in shape.coordinates if find_quaternion(self.quaternions, i) is None]]
            ),
            attitudes=self.write_attitudes(q),
            velocity=self.write_states(qd[: qd.size * shape.velocity_zero]),
            acceleration=self.write_accelerations(every if shape.acceleration_zero else ()),
            velocities=self.write_states(qd[list(shape.velocities)]),
            accelerations=self.write_accelerations(shape.accelerations),
            sensor_velocities=self.write_sensors(
                [_sensor_velocity(q, qd, self.plant, name) for name in shape.sensor_velocities]
            ),
            constraints=self.write_constraints(),
            size=self.size,
        )
        H, costs = self.write_cost()
        A = self.A.matrix((self.size, self.layout.size))
        program = Program(A, H, tuple(self.blocks), costs, self.parameters - self.weights)
        chosen = self.condense(program, rows) if shape.form is Form.SHOOTING else program
        return Transcription(self.shape, self.quaternions, self.scheme, self.integrator, self.layout, rows, chosen)

    def take(self, *shape: int) -> Indices:
        """Number some rows."""
        first, self.size = self.size, self.size + int(np.prod(shape))
        return np.arange(first, self.size).reshape(shape)

    def condense(self, program: Program, rows: Rows) -> Condensed:
        """Solve the equations of motion for the accelerations, interval by interval."""
        layout = self.layout
        knowns = np.concatenate((layout.mesh[:-1], layout.inputs), axis=1)
        is_triangular = self.integrator.is_explicit
        return condense(program, layout.accelerations, rows.dynamics, knowns, is_triangular=is_triangular)

    # --- the motion ---

    def write_collocation(self) -> tuple[Indices, Indices, Indices]:
        """Write the equations of motion, and what ties states to each other; give its rows."""
        layout, n = self.layout, self.layout.n
        N, S, width = layout.points.shape
        at_stage = width + (n if layout.accelerations.size else 0)
        interval = self.take(N, S * at_stage + layout.mesh.shape[1])
        stages, continuity = interval[:, : S * at_stage].reshape(N, S, at_stage), interval[:, S * at_stage :]
        states, dynamics = stages[:, :, :width], stages[:, :, -n:]
        self.A.put(continuity, layout.mesh[1:], 1.0)
        if self.shape.form is Form.STANDARD:
            self.write_states_at_points(states, continuity)
        else:
            self.write_integrals(continuity)
        self.write_dynamics(dynamics.reshape(N * S, n).T)
        return states, dynamics, continuity

    def write_inner_bounds(self) -> Indices:
        """Write the states at the points that have bounds, where they are no variables and no mesh points."""
        N, d, n = self.shape.intervals, self.scheme.degree, self.layout.n
        inner = d - (self.shape.family is Family.RADAU)  # the last Radau point is the next mesh point
        rows = self.take(N, inner, len(self.shape.bounded))
        for k, i in enumerate(self.shape.bounded):
            states = self.points.q if i < self.layout.nq else self.points.qd
            assert not isinstance(states, np.ndarray)
            at = np.arange(N * d * n).reshape(N, d, n)[:, :inner, i % n]
            self.A.put_matrix(rows[:, :, k].ravel(), sparse.csr_array(states)[at.ravel()])
        return rows

    def write_states_at_points(self, states: Indices, continuity: Indices) -> None:
        """Differentiate the states at the points, and read the states at the interval's end off them."""
        layout, scheme = self.layout, self.scheme
        nodes = [layout.mesh[:-1], *layout.points.transpose(1, 0, 2)]  # 0 and the points, each (N, nq + n)
        for r, node in enumerate(nodes):
            for j in range(scheme.degree):
                self.A.put(states[:, j], node, scheme.D[j, r])
            self.A.put(continuity, node, -scheme.end[r])
        rates = layout.accelerations
        if self.quaternions:
            rows, states = layout.split(states)
            self.write_turning(rows.reshape(-1, layout.nq).T)
        else:
            rates = np.concatenate((layout.split(layout.points)[1], rates), axis=2)
        self.write_rates(states[:, :, : rates.shape[2]], rates)

    def write_integrals(self, continuity: Indices) -> None:
        """Read the states at the interval's end off those at its start and the accelerations."""
        layout, n, h, end = self.layout, self.layout.n, self.h, self.integrator.ends
        self.A.put(continuity, layout.mesh[:-1], -1.0)
        self.A.put(continuity[:, :n], layout.mesh[:-1, n:], -h)
        for j in range(len(self.integrator.stages.c)):
            self.A.put(continuity[:, :n], layout.accelerations[:, j], -(h**2) * end.P[1, j])
            self.A.put(continuity[:, n:], layout.accelerations[:, j], -h * end.V[1, j])

    def write_turning(self, rows: Indices) -> None:
        """Write -h times the rates of coordinates that are no velocities."""
        kernel, columns = self.plant.casadi("rates"), (self.points.q, self.points.qd)
        self.blocks.append(Block(kernel, columns, rows, scale=-self.h, factor=self.layout.horizon))

    def write_rates(self, rows: Indices, rates: Indices) -> None:
        """Write -h times what the states' derivatives are, where that is a variable."""
        if not rates.size:
            return
        if self.layout.horizon is None:
            self.A.put(rows, rates, -self.h)
            return
        v = ca.SX.sym("v", rates.shape[2])
        columns, placed = (part.reshape(-1, rates.shape[2]).T for part in (rates, rows))
        identity = ca.Function("rates", [v], [v])
        self.blocks.append(Block(identity, (columns,), placed, scale=-self.h, factor=self.layout.horizon))

    def write_dynamics(self, rows: Indices) -> None:
        """Apply the kernel at every stage."""
        representation, layout = self.shape.representation, self.layout
        places = at_stages(layout, self.integrator, self.h)
        kernel = self.plant.casadi(representation.kernel)
        explicit = (places.q, places.qd, places.u)
        if not representation.is_explicit:
            self.blocks.append(Block(kernel, (places.q, places.qd, places.qdd, places.u), rows))
        elif not layout.accelerations.size:
            self.blocks.append(Block(kernel, explicit, rows, scale=-self.h, factor=layout.horizon))
        else:
            self.A.put(rows.T.reshape(layout.accelerations.shape), layout.accelerations, 1.0)
            self.blocks.append(Block(kernel, explicit, rows, scale=-1.0))

    # --- what is asked for ---

    def write_states(self, states: Indices) -> Indices:
        """Write some states, to be given a value."""
        rows = self.take(states.size)
        self.A.put(rows, states, 1.0)
        return rows

    def write_attitudes(self, q: Indices) -> Indices:
        """Compare quaternions at the end with targets, which are parameters."""
        found, target = ca.SX.sym("found", 4), ca.SX.sym("target", 4)
        options = {"is_diff_in": [True, False]}
        comparison = ca.Function("compare", [found, target], [compare(target, found)], options)
        targets = _find_targets(self.shape, self.quaternions)
        rows = self.take(len(targets), 3)
        for row, quaternion in zip(rows, targets, strict=True):
            parameters = self.parameters + np.arange(4)
            self.blocks.append(Block(comparison, (q[quaternion.entries, None],), row[:, None], parameters))
            self.parameters += 4
        return rows

    def write_lengths(self) -> Indices:
        """Write the squared lengths of quaternions at the start, where that may be free."""
        chosen = self.quaternions if self.shape.start_is_free else ()
        rows, found = self.take(len(chosen)), ca.SX.sym("q", 4)
        if chosen:
            length = ca.Function("length", [found], [ca.sumsqr(found)])
            columns = np.stack([self.layout.mesh[0, quaternion.entries] for quaternion in chosen], axis=1)
            self.blocks.append(Block(length, (columns,), rows[None]))
        return rows

    def write_sensors(self, sensors: Sequence[tuple[ca.Function, tuple[Indices, ...]]]) -> Indices:
        """Write functions of the state at the end that have three results."""
        rows = self.take(len(sensors), 3)
        for row, (function, columns) in zip(rows, sensors, strict=True):
            self.blocks.append(Block(function, columns, row[:, None]))
        return rows

    def write_accelerations(self, which: Sequence[int]) -> Indices:
        """Write some accelerations at the end."""
        rows = self.take(len(which))
        if not which:
            return rows
        end = self.mesh_point(self.shape.intervals)
        if not self.shape.representation.is_ode:
            self.A.put_matrix(rows, sparse.csr_array(end.qdd)[list(which)])
            return rows
        kernel = self.plant.casadi(self.shape.representation.kernel)
        if len(which) < self.layout.n:
            arguments = [ca.MX.sym(kernel.name_in(i), kernel.size1_in(i)) for i in range(kernel.n_in())]
            kernel = ca.Function("some", arguments, [kernel(*arguments)[list(which)]])
        self.blocks.append(Block(kernel, (end.q, end.qd, end.u), rows[:, None]))
        return rows

    def write_constraints(self) -> tuple[Indices, ...]:
        """Write the constraints by expressions; those of one kind are one function, applied at the same places."""
        N, shape = self.shape.intervals, self.shape
        kinds = list_quantities(self.plant.manifest)
        path_mesh = [*([0] * shape.start_is_free), *(range(1, N + 1) if shape.family is Family.LEGENDRE else ())]
        on_path = [i for i, (_, at) in enumerate(shape.constraints) if at == "path"]
        of_states = [i for i in on_path if not _speaks_of_jumps(shape.constraints[i][0], kinds)]
        rows: list[list[Indices]] = [[] for _ in shape.constraints]
        for chosen, places in (
            (on_path, self.points),
            (of_states, at_mesh(self.layout, self.integrator, path_mesh)),
            ([i for i, (_, at) in enumerate(shape.constraints) if at == "start"], self.mesh_point(0)),
            ([i for i, (_, at) in enumerate(shape.constraints) if at == "end"], self.mesh_point(N)),
        ):
            if chosen and places.s.size:
                taken = self.take(len(chosen), places.s.size)
                self.blocks.append(self.apply([shape.constraints[i][0] for i in chosen], places, taken))
                for i, row in zip(chosen, taken, strict=True):
                    rows[i].append(row)
        return tuple(np.concatenate(parts) for parts in rows)

    def mesh_point(self, k: int) -> Places:
        return at_mesh(self.layout, self.integrator, [k])

    def apply(self, texts: Sequence[str], places: Places, rows: Indices, scale: Array | float = 1.0) -> Block:
        """Apply expressions at some places."""
        shape, layout = self.shape, self.layout
        formula = formulate(texts, shape.constants, self.plant, shape.representation, shape.horizon)
        parts = {"q": places.q, "qd": places.qd, "qdd": places.qdd, "u": places.u}
        if layout.horizon is not None:
            parts["T"] = np.full((1, places.s.size), layout.horizon)
        return Block(
            function=formula.function,
            columns=tuple(parts[kind] for kind in formula.inputs if kind in parts),
            rows=rows,
            parameters=self.weights + np.arange(len(shape.constants) * ("constants" in formula.inputs)),
            data=places.s[None] if "s" in formula.inputs else None,
            scale=scale,
        )

    # --- the cost ---

    def write_cost(self) -> tuple[tuple[Matrix, ...], tuple[Block, ...]]:
        """Give the quadratic terms, a matrix for each weight, and the others."""
        shape, layout = self.shape, self.layout
        running, terminal = len(shape.running), len(shape.terminal)
        blocks = []
        if running:
            places = self.points
            rows = np.broadcast_to(2 + np.arange(running)[:, None], (running, places.s.size))
            integral = self.h * np.tile(self.scheme.weights, shape.intervals)
            blocks.append(replace(self.apply(shape.running, places, rows, integral), factor=layout.horizon))
        if terminal:
            rows = 2 + running + np.arange(terminal)[:, None]
            blocks.append(self.apply(shape.terminal, self.mesh_point(shape.intervals), rows))
        nothing = sparse.csc_array((layout.size, layout.size))
        others = (nothing,) * (running + terminal)
        if layout.horizon is None:
            return (_input_cost(layout, self.h), _rate_cost(layout, self.h), *others), tuple(blocks)
        return (nothing, nothing, *others), (*_input_costs(layout, layout.horizon), *blocks)


def _speaks_of_jumps(text: str, known: Mapping[str, Quantity]) -> bool:
    """Tell whether an expression needs what jumps where an interval ends: inputs or accelerations."""
    return any(known[name].kind in ("u", "qdd") for name in names(parse(text)) if name in known)


def _sensor(last: Indices, plant: Plant, name: str) -> tuple[ca.Function, tuple[Indices, ...]]:
    """Position of a sensor at the end of the horizon, as a function of the coordinates that move it only."""
    sensors, place = plant.casadi("sensors"), _find_sensor(plant, name)
    felt = sensors.jacobian().sparsity_out(0).get_triplet()
    moving = sorted({j for i, j in zip(*felt, strict=True) if i // 3 == place})
    some, q = ca.MX.sym("q", len(moving)), ca.MX(ca.DM(neutral(plant.manifest)))
    q[moving] = some
    function = ca.Function("sensor", [some], [sensors(q)[:, place]], ["q"], ["position"])
    return function, (last[moving, None],)


def _sensor_velocity(
    last_q: Indices, last_qd: Indices, plant: Plant, name: str
) -> tuple[ca.Function, tuple[Indices, ...]]:
    """Velocity of a sensor at the end of the horizon."""
    q, qd = ca.MX.sym("q", last_q.size), ca.MX.sym("qd", last_qd.size)
    v = plant.casadi("motion")(q=q, qd=qd)["v"][:, _find_sensor(plant, name)]
    return ca.Function("sensor_velocity", [q, qd], [v]), (last_q[:, None], last_qd[:, None])


def _find_sensor(plant: Plant, name: str) -> int:
    return [frame.name for frame in plant.manifest.frames if frame.sensor].index(name)


def _input_cost(layout: Layout, h: float) -> Matrix:
    """Hessian of the integral of |u|^2."""
    H = Entries()
    H.put(layout.inputs, layout.inputs, 2 * h)
    return H.matrix((layout.size, layout.size))


def _rate_cost(layout: Layout, h: float) -> Matrix:
    """Hessian of the sum over the N - 1 steps of h |(u_(k+1) - u_k) / h|^2."""
    H = Entries()
    before, after = layout.inputs[:-1], layout.inputs[1:]
    for row in (before, after):
        for col in (before, after):
            H.put(row, col, 2 / h if row is col else -2 / h)
    return H.matrix((layout.size, layout.size))


def _input_costs(layout: Layout, horizon: int) -> list[Block]:
    """Give the same two terms as functions of the inputs and the horizon."""
    N, m = layout.inputs.shape
    u, before, T = ca.SX.sym("u", m), ca.SX.sym("before", m), ca.SX.sym("T")
    rate = N * ca.sumsqr(u - before) / T
    inputs = Block(
        ca.Function("inputs", [u], [ca.sumsqr(u)]),
        (layout.inputs.T,),
        np.zeros((1, N), dtype=np.int64),
        scale=1 / N,
        factor=horizon,
    )
    if N == 1:
        return [inputs]
    columns = (layout.inputs[:-1].T, layout.inputs[1:].T, np.full((1, N - 1), horizon))
    rates = Block(ca.Function("rates", [before, u, T], [rate]), columns, np.ones((1, N - 1), dtype=np.int64))
    return [inputs, rates]
