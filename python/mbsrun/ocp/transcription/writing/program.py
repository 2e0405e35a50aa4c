"""Programs: all rows, blocks and costs of a structure, in the order in which rows are numbered."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mbsrun.ocp.ground.functions import Indices
from mbsrun.ocp.ground.program import Block, Program, Solved, Stages
from mbsrun.ocp.problem import design
from mbsrun.ocp.problem.problem import Form
from mbsrun.ocp.transcription.layout import ExtraRows, Rows
from mbsrun.ocp.transcription.writing.closures import write_driven_start, write_start_closure
from mbsrun.ocp.transcription.writing.collocation import split_equations, write_collocation, write_inner_bounds
from mbsrun.ocp.transcription.writing.constraints import write_constraints, write_input_rates
from mbsrun.ocp.transcription.writing.cost import write_cost
from mbsrun.ocp.transcription.writing.ends import (
    find_position,
    find_velocity,
    write_accelerations,
    write_attitudes,
    write_lengths,
    write_sensors,
)
from mbsrun.ocp.transcription.writing.holding import write_contacts_at_start, write_friction
from mbsrun.ocp.transcription.writing.sheet import Sheet
from mbsrun.quaternions import find_quaternion


def write_program(sheet: Sheet) -> tuple[Rows, Program]:
    """Write all rows and costs."""
    shape, N, extras = sheet.shape, sheet.shape.intervals, sheet.layout.extras
    q, qd = sheet.layout.split(sheet.layout.mesh[-1])
    independent = sheet.list_independent()
    start = sheet.write_states(sheet.layout.mesh[0], 0)
    extra_start = sheet.write_states(extras.states[0], 0)
    lengths = write_lengths(sheet)
    start_closure = write_start_closure(sheet)
    driven_start = write_driven_start(sheet)
    inner, equations, continuity = write_collocation(sheet)
    states, dynamics, closure, rates, given, held, driving = split_equations(sheet, equations)
    extra_end = sheet.write_states(extras.states[N, list(shape.ending)], N)
    rows = Rows(
        start=start,
        lengths=lengths,
        states=states,
        dynamics=dynamics,
        closure=closure[:, :, : sheet.loop_rows],
        start_closure=start_closure,
        driven=closure[:, :, sheet.loop_rows :],
        driven_start=driven_start,
        driving=driving,
        continuity=continuity,
        extras=ExtraRows(
            extra_start, rates, given, held, write_contacts_at_start(sheet), write_friction(sheet), extra_end
        ),
        inner=write_inner_bounds(sheet),
        sensors=write_sensors(sheet, [find_position(sheet, name) for name in shape.sensors]),
        coordinates=sheet.write_states(
            q[[i for i in shape.coordinates if find_quaternion(sheet.quaternions, i) is None]], N
        ),
        attitudes=write_attitudes(sheet, q),
        velocity=sheet.write_states(qd[sheet.find_velocities(independent if shape.velocity_zero else ())], N),
        acceleration=write_accelerations(sheet, independent if shape.acceleration_zero else ()),
        velocities=sheet.write_states(qd[sheet.find_velocities(shape.velocities)], N),
        accelerations=write_accelerations(sheet, shape.accelerations),
        sensor_velocities=write_sensors(sheet, [find_velocity(sheet, name) for name in shape.sensor_velocities]),
        constraints=write_constraints(sheet),
        rates=write_input_rates(sheet),
        size=sheet.size,
    )
    H, costs = write_cost(sheet)
    implicit, balances = list_implicit(sheet, rows.constraints)
    stages = Stages(
        states=np.concatenate((sheet.layout.mesh, extras.states), axis=1),
        inputs=list_inputs(sheet, implicit),
        inner=_join(inner, implicit),
        equations=_join(equations, balances),
        continuity=continuity,
        common=list_common(sheet),
        rows=np.concatenate(sheet.stages),
        nested=sheet.layout.shifts[0].size,
        is_triangular=sheet.integrator.is_explicit and shape.form is Form.SHOOTING and not sheet.layout.shifts.size,
    )
    program = Program(
        A=sheet.A.matrix((sheet.size, sheet.layout.size)),
        H=H,
        blocks=read_design(sheet, sheet.blocks),
        costs=read_design(sheet, costs),
        constants=sheet.parameters - sheet.weights,
        stages=stages,
        solved=(Solved(stages),) if shape.form is Form.SHOOTING else (),
    )
    return rows, program


def list_implicit(sheet: Sheet, rows: Sequence[Indices]) -> tuple[Indices, Indices]:
    """List the controls (N, S, c) that constraints determine, and their rows; none in forms other than standard."""
    controls = sheet.layout.extras.point_controls
    N, S, _ = controls.shape
    is_chosen = controls.size > 0 and sheet.shape.form is Form.STANDARD
    chosen = [(i, control) for i, control in sheet.shape.implicit if is_chosen and rows[i].size == N * S]
    balances = np.array([rows[i] for i, _ in chosen], dtype=np.int64).reshape(len(chosen), N, S)
    return controls[:, :, [control for _, control in chosen]], np.moveaxis(balances, 0, 2)


def _join(own: Indices, others: Indices) -> Indices:
    """Return what each point has together; without others, forms that have a point for a whole interval stay as is."""
    return np.concatenate((own, others), axis=2) if others.size else own


def list_inputs(sheet: Sheet, implicit: Indices) -> Indices:
    """List the variables (N, ...) of each interval that no equation of the interval gives; `implicit` are given."""
    free = [i for i, text in enumerate(sheet.components) if text is None and i not in sheet.held]
    wrenches = sheet.layout.extras.wrenches[:, :, free]
    N, S, size = wrenches.shape
    inputs = sheet.layout.every_input
    inputs = inputs[~np.isin(inputs, implicit)].reshape(N, -1)
    return np.concatenate((inputs, wrenches.reshape(N, S * size)), axis=1)


def list_common(sheet: Sheet) -> Indices:
    """List the variables of the whole horizon."""
    return np.union1d(sheet.layout.horizons, np.union1d(sheet.layout.unknowns, sheet.layout.design))


def read_design(sheet: Sheet, blocks: Sequence[Block]) -> tuple[Block, ...]:
    """Return blocks whose kernels read the differentiated parameters from variables, where these are unknowns."""
    return tuple(design.read_design(block, sheet.layout.design, sheet.plant) for block in blocks)
