"""The rows, blocks and costs of a program, group by group: see `transcription` for the equations.

Every row and every place of a block has a stage: the interval whose variables it reads, and perhaps the next state.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set
from dataclasses import replace

import numpy as np
from scipy import sparse

from mbsgen.expressions import Expression
from mbsgen.manifest import Manifest
from mbsrun.ocp import closing, contacts, design, formulas
from mbsrun.ocp.driving import derive
from mbsrun.ocp.functions import Array, Fixed, Function, Indices, KernelResult
from mbsrun.ocp.integrators import SECOND_ORDER, Integrator
from mbsrun.ocp.layout import (
    Entries,
    ExtraRows,
    ExtraSizes,
    Layout,
    Places,
    Rows,
    at_closed,
    at_mesh,
    at_points,
    at_stages,
    lay_out,
    spread,
)
from mbsrun.ocp.plant import Plant
from mbsrun.ocp.problem import Form, list_names
from mbsrun.ocp.program import Block, Column, Combination, Matrix, Program, Solved, Stages
from mbsrun.ocp.quantities import Quantity, formulate, list_quantities
from mbsrun.ocp.schemes import Scheme
from mbsrun.ocp.structure import Structure
from mbsrun.quantities import find_component
from mbsrun.quaternions import Quaternion, find_quaternion, list_quaternions, neutral
from mbsrun.recordings import references


def find_targets(shape: Structure, quaternions: Sequence[Quaternion]) -> list[Quaternion]:
    """Find the quaternions that must have an attitude at the end; each is named whole."""
    return [quaternion for quaternion in quaternions if quaternion.first in shape.coordinates]


class Writer:
    """Writes the program of a structure; rows are numbered in the order in which they are written."""

    def __init__(self, shape: Structure, plant: Plant, scheme: Scheme, integrator: Integrator) -> None:
        """Lay out the variables."""
        self.shape, self.plant, self.manifest = shape, plant, plant.manifest
        self.quaternions = list_quaternions(plant.manifest)
        self.scheme, self.integrator, self.equations = scheme, integrator, shape.representation.equations
        self.motions = closing.list_motions(shape, plant.manifest)
        self.components = order_components(shape, plant.manifest)
        self.held = contacts.list_held(shape.contacts, plant.manifest)
        self.kernel = _read_forces(self.equations.write(shape.loops), plant)
        has_slopes = shape.takes_slopes or (shape.form is not Form.STANDARD and bool(self.quaternions))
        is_ode = shape.form is Form.STANDARD or has_slopes  # accelerations follow from the state, and are no variables
        self.layout = lay_out(
            self.motions,
            len(plant.manifest.actuated),
            shape.grid,
            len(integrator.stages.c),
            has_states=shape.form is Form.STANDARD,
            has_slopes=has_slopes,
            has_accelerations=self.equations.has_accelerations or not is_ode,
            horizon_is_free=shape.horizon is None,
            added=ExtraSizes(
                states=len(shape.rates),
                controls=len(shape.added.controls),
                given=tuple(i for i, _ in shape.forces),
                wrenches=len(self.components),
            ),
            unknowns=len(shape.added.unknowns) + design.count_fixed(shape.added.unknowns, plant.manifest),
            has_constant_inputs=shape.inputs == "constant",
            closed=0 if shape.form is Form.STANDARD else len(integrator.closed.c),
        )
        chosen, fixed = np.split(self.layout.unknowns, [len(shape.added.unknowns)])
        theta = design.order_design(shape.added.unknowns, chosen, fixed, plant.manifest)
        self.layout = replace(self.layout, unknowns=chosen, design=theta)
        self.h = shape.grid.lengths(
            1.0 if shape.horizon is None else shape.horizon
        )  # (N,); times T, where that is free
        self.points = at_points(self.layout, integrator, self.h)
        self.last = at_mesh(self.layout, integrator, [shape.intervals])
        self.A = Entries()
        self.blocks: list[Block] = []
        self.stages: list[Indices] = []  # of the rows
        self.size = 0
        self.weights = 2 + len(shape.running) + len(shape.terminal) + len(shape.priced_controls)
        self.parameters = self.weights + len(shape.constants)  # and then attitudes, where they are written

    def write(self) -> tuple[Rows, Program]:
        """Write all rows and costs."""
        shape, N, extras = self.shape, self.shape.intervals, self.layout.extras
        q, qd = self.layout.split(self.layout.mesh[-1])
        independent = self.list_independent()
        start = self.write_states(self.layout.mesh[0], 0)
        extra_start = self.write_states(extras.states[0], 0)
        lengths = self.write_lengths()
        start_closure = self.write_start_closure()
        driven_start = self.write_driven_start()
        inner, equations, continuity = self.write_collocation()
        states, dynamics, closure, rates, given, held, driving = self.split_equations(equations)
        extra_end = self.write_states(extras.states[N, list(shape.ending)], N)
        rows = Rows(
            start=start,
            lengths=lengths,
            states=states,
            dynamics=dynamics,
            closure=closure[:, :, : self.loop_rows],
            start_closure=start_closure,
            driven=closure[:, :, self.loop_rows :],
            driven_start=driven_start,
            driving=driving,
            continuity=continuity,
            extras=ExtraRows(
                extra_start, rates, given, held, self.write_contacts_at_start(), self.write_friction(), extra_end
            ),
            inner=self.write_inner_bounds(),
            sensors=self.write_sensors([self.position(name) for name in shape.sensors]),
            coordinates=self.write_states(
                q[[i for i in shape.coordinates if find_quaternion(self.quaternions, i) is None]], N
            ),
            attitudes=self.write_attitudes(q),
            velocity=self.write_states(qd[self.find_velocities(independent if shape.velocity_zero else ())], N),
            acceleration=self.write_accelerations(independent if shape.acceleration_zero else ()),
            velocities=self.write_states(qd[self.find_velocities(shape.velocities)], N),
            accelerations=self.write_accelerations(shape.accelerations),
            sensor_velocities=self.write_sensors([self.velocity(name) for name in shape.sensor_velocities]),
            constraints=self.write_constraints(),
            rates=self.write_input_rates(),
            size=self.size,
        )
        H, costs = self.write_cost()
        stages = Stages(
            states=np.concatenate((self.layout.mesh, extras.states), axis=1),
            inputs=self.list_inputs(),
            inner=inner,
            equations=equations,
            continuity=continuity,
            common=self.list_common(),
            rows=np.concatenate(self.stages),
            nested=self.layout.shifts[0].size,
            is_triangular=self.integrator.is_explicit and shape.form is Form.SHOOTING and not self.layout.shifts.size,
        )
        program = Program(
            A=self.A.matrix((self.size, self.layout.size)),
            H=H,
            blocks=self.read_design(self.blocks),
            costs=self.read_design(costs),
            constants=self.parameters - self.weights,
            stages=stages,
            solved=(Solved(stages),) if shape.form is Form.SHOOTING else (),
        )
        return rows, program

    def list_inputs(self) -> Indices:
        """List the variables (N, ...) of each interval that no equation of the interval gives."""
        free = [i for i, text in enumerate(self.components) if text is None and i not in self.held]
        wrenches = self.layout.extras.wrenches[:, :, free]
        N, S, size = wrenches.shape
        return np.concatenate((self.layout.every_input, wrenches.reshape(N, S * size)), axis=1)

    def list_common(self) -> Indices:
        """List the variables of the whole horizon."""
        horizon = [] if self.layout.horizon is None else [self.layout.horizon]
        return np.union1d(np.array(horizon, dtype=np.int64), np.union1d(self.layout.unknowns, self.layout.design))

    def read_design(self, blocks: Sequence[Block]) -> tuple[Block, ...]:
        """Return blocks whose kernels read the differentiated parameters from variables, where these are unknowns."""
        return tuple(design.read_design(block, self.layout.design, self.plant) for block in blocks)

    def take(self, stages: Indices | int, *shape: int) -> Indices:
        """Number some rows; `stages` is broadcast to their shape from the left."""
        first, self.size = self.size, self.size + int(np.prod(shape))
        given = np.asarray(stages, dtype=np.int64)
        self.stages.append(
            np.broadcast_to(given.reshape(*given.shape, *[1] * (len(shape) - given.ndim)), shape).ravel()
        )
        return np.arange(first, self.size).reshape(shape)

    # --- the motion ---

    def list_independent(self) -> tuple[int, ...]:
        """List the entries of qd that determine all others, without driven ones."""
        every = self.motions.independent if self.shape.loops is None else self.manifest.independent
        return tuple(i for i in every if i not in self.motions.driven)

    def find_velocities(self, which: Sequence[int]) -> list[int]:
        """Find entries of qd among the velocities that are variables."""
        return [self.motions.velocities.index(i) for i in which]

    def split_equations(self, equations: Indices) -> tuple[Indices, ...]:
        """Split the equations of stages (N, S, ...) into groups; where there are shifts, of intervals (N, 1, ...).

        They are of states, of motion, of loops and given motions, of states added, of results of expressions, of
        contacts, and of motion of driven joints.

        For an ODE, the equations of motion are the last ones of states. Equations of shifts follow all others.
        """
        N, P, found = self.layout.shifts.shape
        at_places = np.zeros((N, P, 0), dtype=np.int64)
        if P * found:
            every = equations.reshape(N, -1)
            equations, at_places = np.split(every, [every.shape[1] - P * found], axis=1)
            equations = equations.reshape(N, len(self.integrator.stages.c), -1)
            at_places = at_places.reshape(N, P, found)
        n = len(self.motions.independent)
        states = len(self.motions.carried) if self.layout.points.size or self.layout.slopes.size else 0
        end = states + (n if self.layout.accelerations.size else 0)
        rates = end + (0 if P * found else self.found_rows)
        given = rates + len(self.shape.rates)
        held = given + len(self.list_given())
        driving = held + len(self.held)
        return (
            equations[:, :, :states],
            equations[:, :, end - n : end],
            at_places if P * found else equations[:, :, end:rates],
            equations[:, :, rates:given],
            equations[:, :, given:held],
            equations[:, :, held:driving],
            equations[:, :, driving:],
        )

    @property
    def found_rows(self) -> int:
        """Count the rows of loops and of given motions at a point."""
        return self.loop_rows + len(self.motions.driven_states)

    @property
    def loop_rows(self) -> int:
        """Count the rows of loops at a point, with the lengths of quaternions that loops give."""
        return self.closing_rows + len(self.motions.lengths)

    @property
    def closing_rows(self) -> int:
        """Count the rows of coordinates, and of velocities where all are variables."""
        if self.shape.loops is None:
            return 0
        m = len(self.manifest.dependent)
        return 2 * m if len(self.motions.velocities) == len(self.manifest.coordinates) else m

    def write_collocation(self) -> tuple[Indices, Indices, Indices]:
        """Write the equations of motion, and the rows that tie states to each other.

        Return the inner variables of the intervals, their equations, and the rows that carry the state on.
        """
        layout, n = self.layout, len(self.motions.independent)
        N, S, width = layout.points.shape
        at_stage = len(self.motions.carried) if width or layout.slopes.size else 0
        at_stage += n if layout.accelerations.size else 0
        at_stage += len(self.shape.rates) + len(self.list_given()) + len(self.held) + len(self.motions.driven)
        at_stage += 0 if layout.shifts.size else self.found_rows
        carried, count = layout.mesh.shape[1], S * at_stage + layout.shifts[0].size
        interval = self.take(np.arange(N), N, count + carried + len(self.shape.rates))
        equations, continuity = interval[:, :count], interval[:, count:]
        equations = equations.reshape(N, 1 if layout.shifts.size else S, -1)
        states, dynamics, closure, rates, given, held, driving = self.split_equations(equations)
        if self.shape.form is Form.STANDARD:
            self.write_states_at_points(states, continuity[:, :carried])
        elif layout.slopes.size:
            self.write_slopes(states, continuity)
        else:
            self.write_integrals(continuity[:, :carried])
        self.write_shifts(continuity[:, :carried])
        self.write_added_states(rates, continuity[:, carried:])
        self.write_given(given)
        self.hold_contacts(held)
        self.write_dynamics(dynamics.reshape(N * S, n).T, driving.reshape(N * S, -1).T)
        places = at_closed(layout, self.integrator, self.h) if layout.shifts.size else self.points
        self.write_closure(places, closure.reshape(places.s.size, -1).T, places.interval)
        self.write_corrections(states)
        inner: tuple[Indices, ...] = (
            layout.points,
            layout.extras.point_states,
            layout.slopes,
            layout.accelerations,
            layout.multipliers,
            layout.corrections,
            layout.driving,
            self.place_given(),
            layout.extras.wrenches[:, :, list(self.held)],
        )
        if layout.shifts.size:
            inner = tuple(part.reshape(N, 1, -1) for part in (*inner, layout.shifts))
        return np.concatenate(inner, axis=2), equations, continuity

    def write_closure(self, places: Places, rows: Indices, stages: Indices) -> None:
        """Close the loops at some places, and move driven joints there: rows are (equations, places).

        Lengths of quaternions follow the loops; coordinates and velocities of driven joints are the last.
        """
        if not rows.size:
            return
        self.write_motions(places, rows[self.loop_rows :], stages)
        m, count = len(self.manifest.dependent), self.closing_rows
        self.blocks += closing.close(places, [rows[i : i + m] for i in range(0, count, m or 1)], stages)
        for row, first in zip(rows[count:], self.motions.lengths, strict=False):  # a start has other rows for these
            entries = range(first, first + 4)
            q = places.q[list(entries)] if isinstance(places.q, np.ndarray) else places.q.pick(entries)
            self.blocks.append(Block(formulas.fix_length(), (q,), row[None], stages))

    def write_start_closure(self) -> Indices:
        """Close the loops at a start that is free."""
        rows = self.take(0, self.closing_rows * self.shape.start_is_free)
        self.write_closure(self.first, rows[:, None], np.zeros(1, dtype=np.int64))
        return rows

    def write_driven_start(self) -> Indices:
        """Start driven joints as their motions do."""
        rows = self.take(0, len(self.motions.driven_states))
        self.write_motions(self.first, rows[:, None], np.zeros(1, dtype=np.int64))
        return rows

    def write_motions(self, places: Places, rows: Indices, stages: Indices) -> None:
        """Set coordinates and velocities of driven joints at some places: rows are (2 d, places)."""
        if not rows.size:
            return
        motions, (q, qd) = self.motions, (places.q, places.qd)
        assert isinstance(q, np.ndarray), "states at all places are variables"
        assert isinstance(qd, np.ndarray), "states at all places are variables"
        velocities = [motions.velocities.index(i) for i in motions.driven]
        self.A.put(rows, np.concatenate((q[list(motions.driven_places)], qd[velocities])), 1.0)
        orders = list(zip(*map(derive, self.shape.driven), strict=True))
        self.blocks.append(self.apply([*orders[0], *orders[1]], places, rows, stages, -1.0))

    def write_corrections(self, states: Indices) -> None:
        """Correct the derivatives of coordinates, and of velocities where the equations of motion are explicit."""
        corrections, motions, m = self.layout.corrections, self.motions, len(self.manifest.dependent)
        if not corrections.size:
            return
        q, interval = self.points.q, self.points.interval
        places, velocities, first, second = (
            part.reshape(interval.size, part.shape[2]).T
            for part in (*np.split(states, [len(motions.places)], axis=2), *np.split(corrections, [m], axis=2))
        )
        self.blocks += closing.correct_places(q, first, places, interval, self.manifest, motions.places)
        if second.size:
            entries = motions.independent if motions.driven else None
            self.blocks.append(closing.correct(q, second, velocities, interval, entries))

    def write_inner_bounds(self) -> Indices:
        """Write the states at the points that have bounds, where they are no variables and no mesh points."""
        N, d = self.shape.intervals, self.scheme.degree
        # the last Radau point is the next mesh point
        inner = d - self.scheme.ends_interval
        rows = self.take(np.arange(N), N, inner, len(self.shape.bounded))
        chosen = np.arange(N * d).reshape(N, d)[:, :inner].ravel()
        for k, i in enumerate(self.shape.bounded):
            part = self.points.q if i < self.layout.nq else self.points.qd
            assert isinstance(part, Combination), "states at points that are variables have bounds, not rows"
            entry = i if i < self.layout.nq else self.motions.velocities.index(i - self.layout.nq)
            self.A.put_part(rows[:, :, k].reshape(-1, 1), part.restrict(chosen), [entry])
        return rows

    def write_states_at_points(self, states: Indices, continuity: Indices) -> None:
        """Differentiate the states at the points, and read the states at the interval's end off them."""
        layout, scheme, carried = self.layout, self.scheme, self.motions.carried
        nodes = [layout.mesh[:-1], *layout.points.transpose(1, 0, 2)]  # 0 and the points, each (N, nq + n)
        # what is not carried on is read off the last point, or found from the loops where that is not the end
        read = list(range(layout.mesh.shape[1])) if scheme.ends_interval else carried
        integrated = len(carried) - len(self.motions.independent) if self.shape.integrator == SECOND_ORDER else 0
        ended = 0 if scheme.ends_interval else integrated
        self.A.put(continuity[:, read[ended:]], layout.mesh[1:, read[ended:]], 1.0)
        for r, node in enumerate(nodes):
            for j in range(scheme.degree):
                self.A.put(states[:, j, integrated:], node[:, carried[integrated:]], scheme.D[j, r])
            self.A.put(continuity[:, read[ended:]], node[:, read[ended:]], -scheme.end[r])
        found = np.delete(continuity, read, axis=1)
        mesh = range(1, self.shape.intervals + 1)
        self.write_closure(at_mesh(layout, self.integrator, mesh), found.T, np.arange(len(found)))
        rates = layout.accelerations
        if integrated:
            self.write_integrated(states[:, :, :integrated], continuity[:, carried[:ended]])
            states = states[:, :, integrated:]
        elif self.quaternions:
            rows, states = np.split(states, [len(self.motions.places)], axis=2)
            self.write_turning(rows.reshape(-1, rows.shape[2]).T, self.points)
        else:
            velocities = layout.split(layout.points)[1][:, :, self.motions.carried_velocities]
            rates = np.concatenate((velocities, rates), axis=2)
        self.write_rates(states[:, :, : rates.shape[2]], rates)

    def write_integrated(self, states: Indices, ends: Indices) -> None:
        """Integrate the velocities' polynomial from an interval's start to its points, and to its end if that has rows.

        The rows are q_kj - q_k - h sum_r B_jr qd_kr = 0.
        """
        layout, (N, d, n), motions = self.layout, states.shape, self.motions
        independent = motions.carried[:n]
        velocities = [layout.nq + i for i in motions.carried_velocities]
        nodes = np.concatenate((layout.mesh[:-1, None], layout.points), axis=1)[:, :, velocities]
        rows, q = states, layout.points[:, :, independent]
        if ends.size:
            rows = np.concatenate((rows, ends[:, None]), axis=1)
            q = np.concatenate((q, layout.mesh[1:, None, independent]), axis=1)
        B = self.scheme.integrate(np.append(self.scheme.points, 1.0)[: rows.shape[1]])
        self.A.put(rows, q, 1.0)
        self.A.put(rows, layout.mesh[:-1, None, independent], -1.0)
        if layout.horizon is None:
            for r in range(d + 1):
                self.A.put(rows, nodes[:, None, r], -self.h[:, None, None] * B[:, r, None])
            return
        interval, variables = np.repeat(np.arange(N), len(B)), nodes.reshape(N, -1)
        part = Combination(spread(B, n), np.tile(np.arange(len(B)), N), variables[interval])
        self.write_copies(part, rows.reshape(-1, n).T, interval)

    def write_added_states(self, rates: Indices, continuity: Indices) -> None:
        """Differentiate the states that the problem adds at the points: s' = rate, an expression of the motion."""
        if not rates.size:
            return
        extras, scheme, interval = self.layout.extras, self.scheme, self.points.interval
        self.A.put(continuity, extras.states[1:], 1.0)
        for r, node in enumerate([extras.states[:-1], *extras.point_states.transpose(1, 0, 2)]):
            for j in range(scheme.degree):
                self.A.put(rates[:, j], node, scheme.D[j, r])
            self.A.put(continuity, node, -scheme.end[r])
        rows = rates.reshape(-1, len(self.shape.rates)).T
        block = self.apply(self.shape.rates, self.points, rows, interval, -self.h[interval])
        self.blocks.append(replace(block, factor=self.layout.horizon))

    def list_components(self) -> tuple[int, ...]:
        """Return the entry of w of each component of a wrench that the problem has."""
        found = (find_component(self.manifest, name, component) for name, component, _ in self.shape.wrenches)
        return tuple(i for i in found if i is not None)

    def list_given(self) -> list[str | Expression]:
        """List the expressions that give inputs, components of wrenches, and accelerations of driven joints."""
        forces, components = (text for _, text in self.shape.forces), (x for x in self.components if x is not None)
        return [*forces, *components, *(derive(text)[2] for text in self.shape.driven)]

    def place_given(self) -> Indices:
        """Return the variables (N, S, ...) that expressions give."""
        extras = self.layout.extras
        chosen = [i for i, text in enumerate(self.components) if text is not None]
        return np.concatenate((extras.forces, extras.wrenches[:, :, chosen], self.layout.drives), axis=2)

    def hold_contacts(self, rows: Indices) -> None:
        """Hold contacts at the points of all intervals, rows (N, S, held axes): by velocities, and at the end by place.

        The displacement over an interval takes the place of the velocity at the first point, where there are two.
        """
        N, S, held = rows.shape
        if not held:
            return
        first = 1 if S > 1 else 0
        q, qd = (part[:, first:].reshape(-1, part.shape[2]).T for part in self.layout.split(self.layout.points))
        places, interval = replace(self.points, q=q, qd=qd), np.repeat(np.arange(N), S - first)
        self.write_contacts(places, rows[:, first:].reshape(-1, held).T, interval)
        if S > 1:
            self.write_displacements(rows[:, 0].T)

    def write_displacements(self, rows: Indices) -> None:
        """Write how far contacts move over each interval, divided by its length: rows are (held axes, N)."""
        layout, first = self.layout, 0
        start, end = (layout.split(part)[0].T for part in (layout.mesh[:-1], layout.points[:, -1]))
        for contact in self.shape.contacts:
            entries = contacts.list_entries(contact, self.manifest)
            function = KernelResult("sensors", ("q",), "position", entries)
            own = rows[first : first + len(entries)]
            for q, sign in ((end, 1.0), (start, -1.0)):
                self.blocks.append(Block(function, (q,), own, np.arange(len(self.h)), scale=sign / self.h))
            first += len(entries)

    def write_contacts(self, places: Places, rows: Indices, stages: Indices) -> None:
        """Hold contacts at some places: rows are (held axes, places)."""
        first = 0
        for contact in self.shape.contacts:
            entries = contacts.list_entries(contact, self.manifest)
            function = KernelResult("motion", ("q", "qd"), "v", entries)
            own = rows[first : first + len(entries)]
            self.blocks.append(Block(function, (places.q, places.qd), own, stages))
            first += len(entries)

    def write_contacts_at_start(self) -> Indices:
        """Hold contacts at a start that is free and that no link gives."""
        shape = self.shape
        rows = self.take(0, len(self.held) * (shape.start_is_free and shape.contacts_hold_at_start))
        if rows.size:
            self.write_contacts(self.first, rows[:, None], np.zeros(1, dtype=np.int64))
        return rows

    def write_friction(self) -> Indices:
        """Keep the forces of contacts within friction at the points."""
        every = (contacts.write_friction(contact, self.manifest) for contact in self.shape.contacts)
        texts, places = [text for own in every for text in own], self.points
        rows = self.take(np.tile(places.interval, (len(texts), 1)), len(texts), places.s.size)
        if texts:
            self.blocks.append(self.apply(texts, places, rows, places.interval))
        return rows

    def write_given(self, rows: Indices) -> None:
        """Set inputs and components of wrenches to the values of their expressions at the points."""
        if not rows.size:
            return
        texts = self.list_given()
        self.A.put(rows, self.place_given(), 1.0)
        placed = rows.reshape(-1, len(texts)).T
        self.blocks.append(self.apply(texts, self.points, placed, self.points.interval, -1.0))

    def write_integrals(self, continuity: Indices) -> None:
        """Read the states at the interval's end off those at its start and the accelerations."""
        layout, n, h, end = self.layout, len(self.motions.independent), self.h[:, None], self.integrator.ends
        carried = self.motions.carried
        continuity, mesh = continuity[:, carried], layout.mesh[:, carried]
        self.A.put(continuity, mesh[1:], 1.0)
        self.A.put(continuity, mesh[:-1], -1.0)
        self.A.put(continuity[:, :n], mesh[:-1, n:], -h)
        for j in range(len(self.integrator.stages.c)):
            self.A.put(continuity[:, :n], layout.accelerations[:, j], -(h**2) * end.P[1, j])
            self.A.put(continuity[:, n:], layout.accelerations[:, j], -h * end.V[1, j])

    def write_slopes(self, states: Indices, continuity: Indices) -> None:
        """Write the slopes at the stages minus h times the rates, and read the states at the interval's end off them.

        The rates of velocities are accelerations where these are variables; else the equations of motion give them.
        """
        layout, places = self.layout, at_stages(self.layout, self.integrator, self.h)
        self.A.put(states, layout.slopes, 1.0)
        carried = self.motions.carried
        continuity, mesh = continuity[:, carried], layout.mesh[:, carried]
        self.A.put(continuity, mesh[1:], 1.0)
        self.A.put(continuity, mesh[:-1], -1.0)
        for j, weight in enumerate(self.integrator.ends.V[1]):
            self.A.put(continuity, layout.slopes[:, j], -weight)
        q, qd = (rows.reshape(-1, rows.shape[2]).T for rows in layout.split_carried(states))
        if self.quaternions:
            self.write_turning(q, places)
        else:
            self.write_copies(places.yd, q, places.interval)
        if layout.accelerations.size:
            self.write_copies(places.qdd, qd, places.interval)

    def write_shifts(self, continuity: Indices) -> None:
        """Read the entries that loops give at the interval's end off the last place where these are closed."""
        layout, found = self.layout, self.motions.found
        if not layout.shifts.size:
            return
        rows = continuity[:, found]
        self.A.put(rows, layout.mesh[1:, found], 1.0)
        self.A.put(rows, layout.mesh[:-1, found], -1.0)
        self.A.put(rows, layout.shifts[:, -1], -1.0)

    def write_copies(self, column: Column, rows: Indices, interval: Indices) -> None:
        """Write -h times a part of the variables as a function, whose scale may differ between intervals."""
        scale, factor = -self.h[interval], self.layout.horizon
        self.blocks.append(Block(formulas.copy(len(rows)), (column,), rows, interval, scale=scale, factor=factor))

    def write_turning(self, rows: Indices, places: Places) -> None:
        """Write -h times the rates of coordinates that are no velocities."""
        carried = self.motions.places
        rates = KernelResult("rates", ("q", "qd"), "rate", None if len(carried) == self.layout.nq else carried)
        columns, interval = (places.q, places.qd), places.interval
        self.blocks.append(Block(rates, columns, rows, interval, scale=-self.h[interval], factor=self.layout.horizon))

    def write_rates(self, rows: Indices, rates: Indices) -> None:
        """Write -h times the derivatives of states, where these are variables."""
        if not rates.size:
            return
        if self.layout.horizon is None:
            self.A.put(rows, rates, -self.h[:, None, None])
            return
        columns, placed = (part.reshape(-1, rates.shape[2]).T for part in (rates, rows))
        self.write_copies(columns, placed, self.points.interval)

    def write_dynamics(self, rows: Indices, driving: Indices) -> None:
        """Apply the equations of motion at every stage, as the representation writes them; `driving`: of driven joints.

        Residuals have both sorts of rows; the force of a driven joint is a separate result of explicit kernels.
        """
        motions = self.motions
        if not self.equations.is_explicit and driving.size:
            at = dict(zip((*motions.independent, *motions.driven), (*rows, *driving), strict=True))
            rows = np.stack([at[i] for i in motions.moved])
        elif driving.size:
            self.write_driving(driving)
        if not rows.size:
            return
        layout, kernel = self.layout, self.choose_accelerations(motions.independent)
        places = at_stages(layout, self.integrator, self.h)
        scale, factor = np.ones(places.s.size), None
        if self.equations.is_explicit and layout.accelerations.size:
            self.A.put(rows.T.reshape(layout.accelerations.shape), layout.accelerations, 1.0)
            scale = -scale
        elif self.equations.is_explicit:
            scale, factor = -self.h[places.interval], layout.horizon
        columns = _pick(places, kernel)
        self.blocks.append(Block(kernel, columns, rows, places.interval, scale=scale, factor=factor))

    def choose_accelerations(self, which: Sequence[int]) -> KernelResult:
        """Return the kernel with the rows, or accelerations, of some entries of qd."""
        moved = self.motions.moved
        if not self.equations.is_explicit or tuple(which) == moved:
            return self.kernel
        return replace(self.kernel, entries=tuple(moved.index(i) for i in which))

    def write_driving(self, rows: Indices) -> None:
        """Set the forces of driven joints to a result of the explicit kernel at every stage."""
        places = at_stages(self.layout, self.integrator, self.h)
        kernel = replace(self.kernel, result="tau")
        self.A.put(rows, self.layout.driving.reshape(rows.T.shape).T, 1.0)
        self.blocks.append(Block(kernel, _pick(places, kernel), rows, places.interval, scale=-1.0))

    # --- start, end, constraints ---

    def write_states(self, states: Indices, stage: int) -> Indices:
        """Write some states, whose rows the bounds give a value."""
        rows = self.take(stage, states.size)
        self.A.put(rows, states, 1.0)
        return rows

    def write_attitudes(self, q: Indices) -> Indices:
        """Compare quaternions at the end with targets, which are parameters."""
        targets = find_targets(self.shape, self.quaternions)
        rows = self.take(self.shape.intervals, len(targets), 3)
        for row, quaternion in zip(rows, targets, strict=True):
            parameters = self.parameters + np.arange(4)
            self.write_end(formulas.compare_attitudes(), (q[quaternion.entries, None],), row, parameters)
            self.parameters += 4
        return rows

    def write_end(
        self, function: Function, columns: tuple[Column, ...], row: Indices, parameters: Indices | None = None
    ) -> None:
        """Apply a function of the state at the end."""
        stage = np.array([self.shape.intervals])
        block = Block(function, columns, row[:, None], stage)
        self.blocks.append(block if parameters is None else replace(block, parameters=parameters))

    def write_lengths(self) -> Indices:
        """Write the squared lengths of quaternions at the start, where that may be free."""
        chosen = self.quaternions if self.shape.start_is_free else ()
        rows = self.take(0, len(chosen))
        if chosen:
            columns = np.stack([self.layout.mesh[0, quaternion.entries] for quaternion in chosen], axis=1)
            stages = np.zeros(len(chosen), dtype=np.int64)
            self.blocks.append(Block(formulas.measure_length(), (columns,), rows[None], stages))
        return rows

    def write_sensors(self, sensors: Sequence[tuple[KernelResult, tuple[Column, ...]]]) -> Indices:
        """Write functions of the state at the end that have three results."""
        rows = self.take(self.shape.intervals, len(sensors), 3)
        for row, (function, columns) in zip(rows, sensors, strict=True):
            self.write_end(function, columns, row)
        return rows

    def position(self, name: str) -> tuple[KernelResult, tuple[Column, ...]]:
        """Return the position of a sensor at the end as a function of the coordinates that move it."""
        entries = self.find_entries(name)
        (pattern,) = (a for a in self.plant.describe("jac_sensors").outputs if a.name == "jac_position_q")
        moving = tuple(range(pattern.cols))
        if pattern.colind is not None and pattern.row is not None:
            columns = np.repeat(np.arange(pattern.cols), np.diff(pattern.colind))
            moving = tuple(int(j) for j in np.unique(columns[np.isin(pattern.row, entries)]))
        fixed = Fixed(moving, tuple(neutral(self.manifest).tolist()))
        q, _ = self.layout.split(self.layout.mesh[-1])
        return KernelResult("sensors", ("q",), "position", entries, fixed), (q[list(moving), None],)

    def velocity(self, name: str) -> tuple[KernelResult, tuple[Column, ...]]:
        """Return the velocity of a sensor at the end."""
        q, qd = self.layout.split(self.layout.mesh[-1])
        return KernelResult("motion", ("q", "qd"), "v", self.find_entries(name)), (q[:, None], qd[:, None])

    def find_entries(self, name: str) -> tuple[int, ...]:
        """Find the three entries of a sensor among the entries of all sensors."""
        first = 3 * [frame.name for frame in self.manifest.frames if frame.sensor].index(name)
        return (first, first + 1, first + 2)

    def write_accelerations(self, which: Sequence[int]) -> Indices:
        """Write some accelerations at the end, which is read off the last interval."""
        rows, end = self.take(self.shape.intervals - 1, len(which)), self.last
        if which and not self.equations.has_accelerations:
            kernel = self.choose_accelerations(which)
            self.blocks.append(Block(kernel, _pick(end, kernel), rows[:, None], end.interval))
        elif which:
            assert isinstance(end.qdd, Combination), "accelerations at mesh points are read off others"
            self.A.put_part(rows[None], end.qdd, [self.motions.moved.index(i) for i in which])
        return rows

    def write_constraints(self) -> tuple[Indices, ...]:
        """Write the constraints by expressions; those at the same places are one function."""
        N, shape = self.shape.intervals, self.shape
        kinds = list_quantities(self.manifest, shape.added)
        path_mesh = [*([0] * shape.start_is_free), *(() if self.scheme.ends_interval else range(1, N + 1))]
        on_path = [i for i, (_, at) in enumerate(shape.constraints) if at == "path"]
        of_states = [
            i for i in on_path if not _reads_jumps(list_names(shape.constraints[i][0], shape.functions), kinds)
        ]
        rows: list[list[Indices]] = [[] for _ in shape.constraints]
        for chosen, places in (
            (on_path, self.points),
            (of_states, at_mesh(self.layout, self.integrator, path_mesh)),
            ([i for i, (_, at) in enumerate(shape.constraints) if at == "start"], self.first),
            ([i for i, (_, at) in enumerate(shape.constraints) if at == "end"], self.last),
        ):
            if chosen and places.s.size:
                stages = places.stage if chosen is of_states else places.interval
                taken = self.take(np.tile(stages, len(chosen)).reshape(len(chosen), -1), len(chosen), places.s.size)
                self.blocks.append(self.apply([shape.constraints[i][0] for i in chosen], places, taken, stages))
                for i, row in zip(chosen, taken, strict=True):
                    rows[i].append(row)
        return tuple(np.concatenate(parts) for parts in rows)

    def write_input_rates(self) -> Indices:
        """Write the differences of constant inputs over time whose ranges are bounded: between midpoints."""
        layout, shape, N = self.layout, self.shape, self.shape.intervals
        inputs = layout.inputs[:, [layout.extras.free.index(i) for i in shape.rated_inputs]]
        rated = np.concatenate((inputs, layout.extras.controls[:, list(shape.rated_controls)]), axis=1)
        count, steps = rated.shape[1], _find_steps(self.h)
        rows = self.take(np.arange(N - 1), N - 1, count)
        if not rows.size:
            return rows
        before, after = rated[:-1], rated[1:]
        if layout.horizon is None:
            self.A.put(rows, after, 1 / steps[:, None])
            self.A.put(rows, before, -1 / steps[:, None])
        else:
            columns = (before.T, after.T, np.full((1, N - 1), layout.horizon))
            self.blocks.append(Block(formulas.find_rates(count), columns, rows.T, np.arange(N - 1), scale=1 / steps))
        return rows

    @property
    def first(self) -> Places:
        """Return the start."""
        return at_mesh(self.layout, self.integrator, [0])

    def apply(
        self,
        texts: Sequence[str | Expression],
        places: Places,
        rows: Indices,
        stages: Indices,
        scale: Array | float = 1.0,
    ) -> Block:
        """Apply expressions at some places."""
        shape, layout = self.shape, self.layout
        computed = {"qdd": self.kernel} if shape.representation.is_ode else {}
        read = find_references(texts, shape)
        formula = formulate(
            texts,
            shape.constants,
            self.manifest,
            self.motions,
            computed,
            shape.horizon,
            shape.added,
            read,
            shape.functions,
        )
        parts = dict(places.parts)
        if layout.horizon is not None:
            parts["T"] = np.full((1, places.s.size), layout.horizon)
        parts["unknowns"] = np.repeat(layout.unknowns[:, None], places.s.size, axis=1)
        return Block(
            function=formula,
            columns=tuple(parts[part.kind] for part in formula.inputs),
            rows=rows,
            stages=stages,
            parameters=self.weights + np.arange(0 if formula.parameters is None else formula.parameters.size),
            data=None if formula.data is None else self.tabulate(read, places.s),
            scale=scale,
        )

    def tabulate(self, names: Sequence[str], s: Array) -> Array:
        """Return the numbers that are given at places: their time over the horizon, and references."""
        shape = self.shape
        return np.stack([s, *(references.evaluate(name, shape.references, s, shape.horizon) for name in names)])

    # --- the cost ---

    def write_cost(self) -> tuple[tuple[Matrix, ...], tuple[Block, ...]]:
        """Return the quadratic terms, a matrix for each weight, and the others."""
        shape, layout = self.shape, self.layout
        running, terminal = len(shape.running), len(shape.terminal)
        weights, blocks = self.h[:, None] * self.scheme.weights, []
        if running:
            places = self.points
            rows = np.broadcast_to(2 + np.arange(running)[:, None], (running, places.s.size))
            block = self.apply(shape.running, places, rows, places.interval, weights.ravel())
            blocks.append(replace(block, factor=layout.horizon))
        if terminal:
            rows = 2 + running + np.arange(terminal)[:, None]
            blocks.append(self.apply(shape.terminal, self.last, rows, self.last.interval))
        nothing = sparse.csc_array((layout.size, layout.size))
        others = (nothing,) * (running + terminal)
        controls = [layout.extras.controls[:, [i]] for i in shape.priced_controls]
        if layout.horizon is None:
            inputs = (_input_cost(layout, self.h, weights), _rate_cost(layout.inputs, self.h, layout.size))
            rates = (_rate_cost(control, self.h, layout.size) for control in controls)
            return (*inputs, *others, *rates), tuple(blocks)
        for row, control in enumerate(controls, 2 + running + terminal):
            blocks += _rate_costs(control, layout.horizon, self.h, row)
        own = _input_costs(layout, layout.horizon, self.h, weights)
        return (nothing, nothing, *others, *(nothing for _ in controls)), (*own, *blocks)


def order_components(shape: Structure, manifest: Manifest) -> tuple[str | None, ...]:
    """Return the expression of each entry of w; None for one that is unknown."""
    found: dict[int, str | None] = {}
    for wrench, component, text in shape.wrenches:
        i = find_component(manifest, wrench, component)
        assert i is not None, "components are checked before"
        found[i] = text
    return tuple(found[i] for i in sorted(found))


def _read_forces(kernel: KernelResult, plant: Plant) -> KernelResult:
    """Return a kernel that reads components of open wrenches, and accelerations or forces of driven joints, if any."""
    if not plant.manifest.open_entries and not plant.manifest.driven:
        return kernel
    order = [a.name for a in plant.describe(kernel.kernel).inputs]
    inputs = {*kernel.inputs, *({"w", "a", "tau"} & set(order))}
    return replace(kernel, inputs=tuple(sorted(inputs, key=order.index)))


def find_references(texts: Sequence[str | Expression], shape: Structure) -> list[str]:
    """List the names of references that expressions read."""
    named = references.list_names(shape.references)
    read = frozenset[str]().union(*(list_names(text, shape.functions) for text in texts)) if named else frozenset()
    return sorted(name for name in read if name in named)


def _pick(places: Places, kernel: KernelResult) -> tuple[Column, ...]:
    """Pick the inputs of a kernel."""
    return tuple(places.parts[name] for name in kernel.inputs)


def _reads_jumps(read: Set[str], known: Mapping[str, Quantity]) -> bool:
    """Return whether an expression reads inputs or accelerations, which jump where an interval ends."""
    return any(known[name].kind in ("u", "qdd", "w", "tau", "controls") for name in read if name in known)


def _input_cost(layout: Layout, h: Array, weights: Array) -> Matrix:
    """Return the Hessian of the integral of |u|^2; weights (N, S) are of values at the points."""
    H = Entries()
    H.put(layout.inputs, layout.inputs, 2 * h[:, None])
    if layout.point_inputs.size:
        H.put(layout.point_inputs, layout.point_inputs, 2 * weights[:, :, None])
    return H.matrix((layout.size, layout.size))


def _find_steps(h: Array) -> Array:
    """Return the distances, (N - 1,), of the midpoints of intervals."""
    return (h[:-1] + h[1:]) / 2


def _rate_cost(inputs: Indices, h: Array, size: int) -> Matrix:
    """Return the Hessian of the sum over the N - 1 steps of h |(u_(k+1) - u_k) / h|^2; inputs are (N, m)."""
    H, step = Entries(), _find_steps(h)[:, None]
    before, after = inputs[:-1], inputs[1:]
    for row in (before, after):
        for col in (before, after):
            H.put(row, col, 2 / step if row is col else -2 / step)
    return H.matrix((size, size))


def _rate_costs(inputs: Indices, horizon: int, h: Array, row: int) -> list[Block]:
    """Return the same sum as a function of the inputs and the horizon, as the term `row` of the cost."""
    N, m = inputs.shape
    if N == 1 or not m:
        return []
    columns = (inputs[:-1].T, inputs[1:].T, np.full((1, N - 1), horizon))
    rows, scale = np.full((1, N - 1), row), (1 / N) / _find_steps(h)
    return [Block(formulas.square_rates(m, N), columns, rows, np.arange(N - 1), scale=scale)]


def _input_costs(layout: Layout, horizon: int, h: Array, weights: Array) -> list[Block]:
    """Return the same two terms as functions of the inputs and the horizon, of which h and the weights are parts."""
    (N, S, polynomials), m = layout.point_inputs.shape, layout.inputs.shape[1]
    if polynomials:
        rows, interval = np.zeros((1, N * S), dtype=np.int64), np.repeat(np.arange(N), S)
        columns = (layout.point_inputs.reshape(N * S, polynomials).T,)
        function = formulas.square_inputs(polynomials)
        return [Block(function, columns, rows, interval, scale=weights.ravel(), factor=horizon)]
    if not m:
        return []
    rows, interval = np.zeros((1, N), dtype=np.int64), np.arange(N)
    inputs = Block(formulas.square_inputs(m), (layout.inputs.T,), rows, interval, scale=h, factor=horizon)
    return [inputs, *_rate_costs(layout.inputs, horizon, h, 1)]
