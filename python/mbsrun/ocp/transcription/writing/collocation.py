"""Collocation: the equations of motion at the stages of an interval, and the rows that tie its states to each other."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mbsrun.ocp.ground import formulas
from mbsrun.ocp.ground.functions import Indices, KernelResult
from mbsrun.ocp.ground.integrators import SECOND_ORDER
from mbsrun.ocp.ground.program import Block, Column, Combination
from mbsrun.ocp.problem.problem import Form
from mbsrun.ocp.transcription.layout import Places, at_closed, at_mesh, at_stages, spread
from mbsrun.ocp.transcription.writing.closures import write_closure, write_corrections
from mbsrun.ocp.transcription.writing.holding import hold_contacts
from mbsrun.ocp.transcription.writing.sheet import Sheet, pick


def write_collocation(sheet: Sheet) -> tuple[Indices, Indices, Indices]:
    """Write the equations of motion, and the rows that tie states to each other.

    Return the inner variables of the intervals, their equations, and the rows that carry the state on.
    """
    layout, n = sheet.layout, len(sheet.motions.independent)
    N, S, width = layout.points.shape
    at_stage = len(sheet.motions.carried) if width or layout.slopes.size else 0
    at_stage += n if layout.accelerations.size else 0
    at_stage += len(sheet.shape.rates) + len(sheet.list_given()) + len(sheet.held) + len(sheet.motions.driven)
    at_stage += 0 if layout.shifts.size else sheet.found_rows
    carried, count = layout.mesh.shape[1], S * at_stage + layout.shifts[0].size
    interval = sheet.take(np.arange(N), N, count + carried + len(sheet.shape.rates))
    equations, continuity = interval[:, :count], interval[:, count:]
    equations = equations.reshape(N, 1 if layout.shifts.size else S, -1)
    states, dynamics, closure, rates, given, held, driving = split_equations(sheet, equations)
    if sheet.shape.form is Form.STANDARD:
        write_states_at_points(sheet, states, continuity[:, :carried])
    elif layout.slopes.size:
        write_slopes(sheet, states, continuity)
    else:
        write_integrals(sheet, continuity[:, :carried])
    write_shifts(sheet, continuity[:, :carried])
    write_added_states(sheet, rates, continuity[:, carried:])
    write_given(sheet, given)
    hold_contacts(sheet, held)
    write_dynamics(sheet, dynamics.reshape(N * S, n).T, driving.reshape(N * S, -1).T)
    places = at_closed(layout, sheet.integrator, sheet.h) if layout.shifts.size else sheet.points
    write_closure(sheet, places, closure.reshape(places.s.size, -1).T, places.interval)
    write_corrections(sheet, states)
    inner: tuple[Indices, ...] = (
        layout.nodes,
        layout.extras.nodes,
        layout.slopes,
        layout.accelerations,
        layout.multipliers,
        layout.corrections,
        layout.driving,
        sheet.place_given(),
        layout.extras.wrenches[:, :, list(sheet.held)],
    )
    if layout.shifts.size:
        inner = tuple(part.reshape(N, 1, -1) for part in (*inner, layout.shifts))
    return np.concatenate(inner, axis=2), equations, continuity


def split_equations(sheet: Sheet, equations: Indices) -> tuple[Indices, ...]:
    """Split the equations of stages (N, S, ...) into groups; where there are shifts, of intervals (N, 1, ...).

    They are of states, of motion, of loops and given motions, of states added, of results of expressions, of
    contacts, and of motion of driven joints.

    For an ODE, the equations of motion are the last ones of states. Equations of shifts follow all others.
    """
    N, P, found = sheet.layout.shifts.shape
    at_places = np.zeros((N, P, 0), dtype=np.int64)
    if P * found:
        every = equations.reshape(N, -1)
        equations, at_places = np.split(every, [every.shape[1] - P * found], axis=1)
        equations = equations.reshape(N, len(sheet.integrator.stages.c), -1)
        at_places = at_places.reshape(N, P, found)
    n = len(sheet.motions.independent)
    states = len(sheet.motions.carried) if sheet.layout.points.size or sheet.layout.slopes.size else 0
    end = states + (n if sheet.layout.accelerations.size else 0)
    rates = end + (0 if P * found else sheet.found_rows)
    given = rates + len(sheet.shape.rates)
    held = given + len(sheet.list_given())
    driving = held + len(sheet.held)
    return (
        equations[:, :, :states],
        equations[:, :, end - n : end],
        at_places if P * found else equations[:, :, end:rates],
        equations[:, :, rates:given],
        equations[:, :, given:held],
        equations[:, :, held:driving],
        equations[:, :, driving:],
    )


def write_states_at_points(sheet: Sheet, states: Indices, continuity: Indices) -> None:
    """Differentiate the states at the points, and read the states at the interval's end off them."""
    layout, scheme, carried = sheet.layout, sheet.scheme, sheet.motions.carried
    nodes = [layout.mesh[:-1], *layout.nodes.transpose(1, 0, 2)]  # 0 and the points, each (N, nq + n)
    # what is not carried on is read off the last point, or found from the loops where that is not the end
    read = list(range(layout.mesh.shape[1])) if scheme.ends_interval else carried
    integrated = len(carried) - len(sheet.motions.independent) if sheet.shape.integrator == SECOND_ORDER else 0
    ended = 0 if scheme.ends_interval else integrated
    sheet.A.put(continuity[:, read[ended:]], layout.mesh[1:, read[ended:]], 1.0)
    for r, node in enumerate(nodes):
        for j in range(scheme.degree):
            sheet.A.put(states[:, j, integrated:], node[:, carried[integrated:]], scheme.D[j, r])
        sheet.A.put(continuity[:, read[ended:]], node[:, read[ended:]], -scheme.end[r])
    found = np.delete(continuity, read, axis=1)
    mesh = range(1, sheet.shape.intervals + 1)
    write_closure(sheet, at_mesh(layout, sheet.integrator, mesh), found.T, np.arange(len(found)))
    rates = layout.accelerations
    if integrated:
        write_integrated(sheet, states[:, :, :integrated], continuity[:, carried[:ended]])
        states = states[:, :, integrated:]
    elif sheet.quaternions:
        rows, states = np.split(states, [len(sheet.motions.places)], axis=2)
        write_turning(sheet, rows.reshape(-1, rows.shape[2]).T, sheet.points)
    else:
        velocities = layout.split(layout.points)[1][:, :, sheet.motions.carried_velocities]
        rates = np.concatenate((velocities, rates), axis=2)
    write_rates(sheet, states[:, :, : rates.shape[2]], rates)


def write_integrated(sheet: Sheet, states: Indices, ends: Indices) -> None:
    """Integrate the velocities' polynomial from an interval's start to its points, and to its end if that has rows.

    The rows are q_kj - q_k - h sum_r B_jr qd_kr = 0.
    """
    layout, (N, d, n), motions = sheet.layout, states.shape, sheet.motions
    independent = motions.carried[:n]
    velocities = [layout.nq + i for i in motions.carried_velocities]
    nodes = np.concatenate((layout.mesh[:-1, None], layout.points), axis=1)[:, :, velocities]
    rows, q = states, layout.points[:, :, independent]
    if ends.size:
        rows = np.concatenate((rows, ends[:, None]), axis=1)
        q = np.concatenate((q, layout.mesh[1:, None, independent]), axis=1)
    B = sheet.scheme.integrate(np.append(sheet.scheme.points, 1.0)[: rows.shape[1]])
    sheet.A.put(rows, q, 1.0)
    sheet.A.put(rows, layout.mesh[:-1, None, independent], -1.0)
    if layout.horizon is None:
        for r in range(d + 1):
            sheet.A.put(rows, nodes[:, None, r], -sheet.h[:, None, None] * B[:, r, None])
        return
    interval, variables = np.repeat(np.arange(N), len(B)), nodes.reshape(N, -1)
    part = Combination(spread(B, n), np.tile(np.arange(len(B)), N), variables[interval])
    write_copies(sheet, part, rows.reshape(-1, n).T, interval)


def write_integrals(sheet: Sheet, continuity: Indices) -> None:
    """Read the states at the interval's end off those at its start and the accelerations."""
    layout, n, h, end = sheet.layout, len(sheet.motions.independent), sheet.h[:, None], sheet.integrator.ends
    carried = sheet.motions.carried
    continuity, mesh = continuity[:, carried], layout.mesh[:, carried]
    sheet.A.put(continuity, mesh[1:], 1.0)
    sheet.A.put(continuity, mesh[:-1], -1.0)
    sheet.A.put(continuity[:, :n], mesh[:-1, n:], -h)
    for j in range(len(sheet.integrator.stages.c)):
        sheet.A.put(continuity[:, :n], layout.accelerations[:, j], -(h**2) * end.P[1, j])
        sheet.A.put(continuity[:, n:], layout.accelerations[:, j], -h * end.V[1, j])


def write_slopes(sheet: Sheet, states: Indices, continuity: Indices) -> None:
    """Write the slopes at the stages minus h times the rates, and read the states at the interval's end off them.

    The rates of velocities are accelerations where these are variables; else the equations of motion give them.
    """
    layout, places = sheet.layout, at_stages(sheet.layout, sheet.integrator, sheet.h)
    sheet.A.put(states, layout.slopes, 1.0)
    carried = sheet.motions.carried
    continuity, mesh = continuity[:, carried], layout.mesh[:, carried]
    sheet.A.put(continuity, mesh[1:], 1.0)
    sheet.A.put(continuity, mesh[:-1], -1.0)
    for j, weight in enumerate(sheet.integrator.ends.V[1]):
        sheet.A.put(continuity, layout.slopes[:, j], -weight)
    q, qd = (rows.reshape(-1, rows.shape[2]).T for rows in layout.split_carried(states))
    if sheet.quaternions:
        write_turning(sheet, q, places)
    else:
        write_copies(sheet, places.yd, q, places.interval)
    if layout.accelerations.size:
        write_copies(sheet, places.qdd, qd, places.interval)


def write_shifts(sheet: Sheet, continuity: Indices) -> None:
    """Read the entries that loops give at the interval's end off the last place where these are closed."""
    layout, found = sheet.layout, sheet.motions.found
    if not layout.shifts.size:
        return
    rows = continuity[:, found]
    sheet.A.put(rows, layout.mesh[1:, found], 1.0)
    sheet.A.put(rows, layout.mesh[:-1, found], -1.0)
    sheet.A.put(rows, layout.shifts[:, -1], -1.0)


def write_copies(sheet: Sheet, column: Column, rows: Indices, interval: Indices) -> None:
    """Write -h times a part of the variables as a function, whose scale may differ between intervals."""
    scale, factor = -sheet.h[interval], sheet.layout.horizon
    sheet.blocks.append(Block(formulas.copy(len(rows)), (column,), rows, interval, scale=scale, factor=factor))


def write_turning(sheet: Sheet, rows: Indices, places: Places) -> None:
    """Write -h times the rates of coordinates that are no velocities."""
    carried = sheet.motions.places
    rates = KernelResult("rates", ("q", "qd"), "rate", None if len(carried) == sheet.layout.nq else carried)
    columns, interval = (places.q, places.qd), places.interval
    sheet.blocks.append(Block(rates, columns, rows, interval, scale=-sheet.h[interval], factor=sheet.layout.horizon))


def write_rates(sheet: Sheet, rows: Indices, rates: Indices) -> None:
    """Write -h times the derivatives of states, where these are variables."""
    if not rates.size:
        return
    if sheet.layout.horizon is None:
        sheet.A.put(rows, rates, -sheet.h[:, None, None])
        return
    columns, placed = (part.reshape(-1, rates.shape[2]).T for part in (rates, rows))
    write_copies(sheet, columns, placed, sheet.points.interval)


def write_added_states(sheet: Sheet, rates: Indices, continuity: Indices) -> None:
    """Differentiate the states that the problem adds at the points: s' = rate, an expression of the motion."""
    if not rates.size:
        return
    extras, scheme, interval = sheet.layout.extras, sheet.scheme, sheet.points.interval
    sheet.A.put(continuity, extras.states[1:], 1.0)
    for r, node in enumerate([extras.states[:-1], *extras.nodes.transpose(1, 0, 2)]):
        for j in range(scheme.degree):
            sheet.A.put(rates[:, j], node, scheme.D[j, r])
        sheet.A.put(continuity, node, -scheme.end[r])
    rows = rates.reshape(-1, len(sheet.shape.rates)).T
    block = sheet.apply(sheet.shape.rates, sheet.points, rows, interval, -sheet.h[interval])
    sheet.blocks.append(replace(block, factor=sheet.layout.horizon))


def write_given(sheet: Sheet, rows: Indices) -> None:
    """Set inputs and components of wrenches to the values of their expressions at the points."""
    if not rows.size:
        return
    texts = sheet.list_given()
    sheet.A.put(rows, sheet.place_given(), 1.0)
    placed = rows.reshape(-1, len(texts)).T
    sheet.blocks.append(sheet.apply(texts, sheet.points, placed, sheet.points.interval, -1.0))


def write_dynamics(sheet: Sheet, rows: Indices, driving: Indices) -> None:
    """Apply the equations of motion at every stage, as the representation writes them; `driving`: of driven joints.

    Residuals have both sorts of rows; the force of a driven joint is a separate result of explicit kernels.
    """
    motions = sheet.motions
    if not sheet.equations.is_explicit and driving.size:
        at = dict(zip((*motions.independent, *motions.driven), (*rows, *driving), strict=True))
        rows = np.stack([at[i] for i in motions.moved])
    elif driving.size:
        write_driving(sheet, driving)
    if not rows.size:
        return
    layout, kernel = sheet.layout, sheet.choose_accelerations(motions.independent)
    places = at_stages(layout, sheet.integrator, sheet.h)
    scale, factor = np.ones(places.s.size), None
    if sheet.equations.is_explicit and layout.accelerations.size:
        sheet.A.put(rows.T.reshape(layout.accelerations.shape), layout.accelerations, 1.0)
        scale = -scale
    elif sheet.equations.is_explicit:
        scale, factor = -sheet.h[places.interval], layout.horizon
    columns = pick(places, kernel)
    sheet.blocks.append(Block(kernel, columns, rows, places.interval, scale=scale, factor=factor))


def write_driving(sheet: Sheet, rows: Indices) -> None:
    """Set the forces of driven joints to a result of the explicit kernel at every stage."""
    places = at_stages(sheet.layout, sheet.integrator, sheet.h)
    kernel = replace(sheet.kernel, result="tau")
    sheet.A.put(rows, sheet.layout.driving.reshape(rows.T.shape).T, 1.0)
    sheet.blocks.append(Block(kernel, pick(places, kernel), rows, places.interval, scale=-1.0))


def write_inner_bounds(sheet: Sheet) -> Indices:
    """Write the states at the points that have bounds, where they are no variables and no mesh points."""
    N, d = sheet.shape.intervals, sheet.scheme.degree
    # the last Radau point is the next mesh point
    inner = d - sheet.scheme.ends_interval
    rows = sheet.take(np.arange(N), N, inner, len(sheet.shape.bounded))
    chosen = np.arange(N * d).reshape(N, d)[:, :inner].ravel()
    for k, i in enumerate(sheet.shape.bounded):
        part = sheet.points.q if i < sheet.layout.nq else sheet.points.qd
        assert isinstance(part, Combination), "states at points that are variables have bounds, not rows"
        entry = i if i < sheet.layout.nq else sheet.motions.velocities.index(i - sheet.layout.nq)
        sheet.A.put_part(rows[:, :, k].reshape(-1, 1), part.restrict(chosen), [entry])
    return rows
