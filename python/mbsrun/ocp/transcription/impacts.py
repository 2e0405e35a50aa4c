"""Impacts: contacts change the velocities in an instant, by impulses L at points that touch the ground.

    M(q) (qd+ - qd-) = J_c(q)' L + J_h(q)' Lam
    v_c(q, qd+) = -e v_c(q, qd-)         along a contact's normal, e the restitution; 0 along its other axes

    qd+ = -e qd-                         of a joint at a rigid stop

with the impulses Lam of closed loops, whose rates vanish after the impact (Featherstone, "Rigid body dynamics
algorithms", 2008, section 11.7). Of the residual Phi(q, qd, qdd, w) of a model that leaves the contacts' forces open,

    M dv - J_c' L - J_h' Lam = Phi(q, 0, dv, w = L, lam = Lam, u = 0) - Phi(q, 0, 0, 0, 0, 0)

since Phi is linear in qdd, w and lam; gravity and springs cancel. So the kernels of the residual serve. L, dv = qd+ -
qd- and qd+ are variables. An impulse along a normal does not pull; friction, if it is given, limits the others.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from mbsgen.expressions import Expression, Name, Number, Operation, Power
from mbsgen.manifest import Manifest
from mbsgen.roles import Role
from mbsrun.ocp.ground.functions import Formula, Indices, Input, KernelResult
from mbsrun.ocp.ground.plant import Plant
from mbsrun.ocp.ground.program import Column, Combination
from mbsrun.ocp.problem.phases import Blow, Impact
from mbsrun.ocp.problem.problem import Contact
from mbsrun.ocp.transcription.linking import Defined, Rows, write_transfer
from mbsrun.ocp.transcription.sides import State
from mbsrun.quantities import SIGNAL, find_component

AXES = "xyz"
Entry = tuple[int, int, float]  # a variable, an entry of w to which it adds, and its factor there


@dataclass(frozen=True)
class ImpactRows:
    """The variables of an impact."""

    before: State
    after: State
    changes: Indices  # of the velocities
    impulses: tuple[Indices, ...]  # of each contact, along its axes
    multipliers: Indices  # the impulses of closed loops
    blows: Indices  # the impulses of stops, in the directions of their joints


def find_wrench(manifest: Manifest, name: str) -> int | None:
    """Return where the force of an open wrench begins in the input w; None where there is none in axes of the base."""
    first = 0
    for wrench in manifest.wrenches:
        if wrench.name == name and wrench.force and wrench.in_base:
            return first
        first += 3 * wrench.force + 3 * wrench.moment
    return None


def find_axes(plant: Plant, sensor: str) -> tuple[int, ...]:
    """Return the axes of the base along which a sensor can move."""
    first = 3 * [frame.name for frame in plant.manifest.frames if frame.sensor].index(sensor)
    (pattern,) = (a for a in plant.describe("jac_sensors").outputs if a.name == "jac_position_q")
    moving = range(pattern.rows) if pattern.row is None else pattern.row
    return tuple(k for k in range(3) if first + k in moving)


def write_impact(rows: Rows, text: str, impact: Impact, source: State, plant: Plant, number: int) -> ImpactRows:
    """Write an impact at the end of a phase."""
    before = _translate(rows, text, impact, source, plant, number)
    n = len(plant.manifest.coordinates)
    changes, speeds = rows.add_variables(n), rows.add_variables(n)
    impulses = [_bound_impulse(rows, contact) for contact in impact.contacts]
    blows = np.concatenate([np.zeros(0, np.int64), *(_bound_blow(rows, blow) for blow in impact.blows)])
    multipliers = rows.add_variables(len(plant.manifest.dependent))
    after = State(plant.manifest, number, before.q, speeds, before.velocities, source.added)
    first = rows.rows
    found = rows.add_rows(n, f"{text}: the velocities at the impact")
    rows.A.put(found, speeds, 1.0)
    rows.A.put(found, before.qd, -1.0)
    rows.A.put(found, changes, -1.0)
    entries = [*_list_entries(impact, plant.manifest, impulses), *_list_pushes(impact, plant.manifest, blows)]
    _write_balance(rows, text, plant, after, changes, entries, multipliers)
    for contact in impact.contacts:
        _write_contact(rows, text, contact, impact.restitution, before, after)
    for blow in impact.blows:
        row = rows.add_rows(1, f"{text}: {blow.joint} after the impact")
        rows.A.put(row, [after.qd[blow.index]], 1.0)
        rows.A.put(row, [before.qd[blow.index]], blow.restitution)
    if multipliers.size:
        found = rows.add_rows(multipliers.size, f"{text}: the loops after the impact")
        columns = (after.q[:, None], after.qd[:, None])
        rows.apply(KernelResult("loop_rates", ("q", "qd"), "hd"), columns, found, plant=number)
    unknowns = np.concatenate([changes, speeds, *impulses, blows, multipliers])
    rows.defined.append(Defined(unknowns, np.arange(first, rows.rows)))
    for contact, impulse in zip(impact.contacts, impulses, strict=True):
        _write_friction(rows, text, contact, impulse)
    return ImpactRows(before, after, changes, tuple(impulses), multipliers, blows)


def _translate(rows: Rows, text: str, impact: Impact, source: State, plant: Plant, number: int) -> State:
    """Return the state before the impact in the coordinates of its model."""
    if number == source.plant and not impact.map:
        return source
    manifest = plant.manifest
    q, qd = (rows.add_variables(len(names)) for names in (manifest.positions, manifest.coordinates))
    state = State(manifest, number, q, qd, tuple(range(qd.size)))
    first = rows.rows
    write_transfer(rows, f"{text}, before the impact", source, state, impact.map, ())
    rows.defined.append(Defined(np.concatenate((q, qd)), np.arange(first, rows.rows)))
    return state


def _bound_impulse(rows: Rows, contact: Contact) -> Indices:
    """Number the impulses of a contact along its axes; along its normal it pushes."""
    parts = [rows.add_variables(1, 0.0 if axis == contact.normal else -np.inf, np.inf) for axis in contact.axes]
    return np.concatenate(parts)


def _bound_blow(rows: Rows, blow: Blow) -> Indices:
    """Number the impulse of a stop, which pushes away from its limit."""
    return rows.add_variables(1, *((0.0, np.inf) if blow.is_lower else (-np.inf, 0.0)))


def _list_entries(impact: Impact, manifest: Manifest, impulses: list[Indices]) -> Iterator[Entry]:
    """List the impulses of contacts, with the friction of sliding ones."""
    for contact, impulse in zip(impact.contacts, impulses, strict=True):
        first = find_wrench(manifest, contact.wrench)
        for variable, axis in zip(impulse.tolist(), contact.axes, strict=True):
            if first is not None:
                yield variable, first + axis, 1.0
            if first is not None and contact.drag is not None and axis == contact.normal:
                yield variable, first + contact.drag[0], contact.drag[1]


def _list_pushes(impact: Impact, manifest: Manifest, blows: Indices) -> Iterator[Entry]:
    """List the impulses of stops."""
    for blow, variable in zip(impact.blows, blows.tolist(), strict=True):
        entry = find_component(manifest, blow.signal, SIGNAL)
        assert entry is not None, "stops are opened with their signals"
        yield variable, entry, 1.0


def _write_balance(
    rows: Rows,
    text: str,
    plant: Plant,
    state: State,
    changes: Indices,
    entries: list[Entry],
    multipliers: Indices,
) -> None:
    """Write that impulses change the momentum."""
    inputs = [a for a in plant.describe("impl").inputs if a.role not in (Role.SETUP, Role.DESIGN)]
    given: dict[Role, Column] = {Role.COORDINATE: state.q[:, None]}
    moved: dict[Role, Column] = {Role.ACCELERATION: changes[:, None], Role.MULTIPLIER: multipliers[:, None]}
    found = rows.add_rows(changes.size, f"{text}: the momentum at the impact")
    names = tuple(a.name for a in inputs)
    for parts, scale in ((given | moved, 1.0), (given, -1.0)):
        columns = [
            _select(entries, a.rows, changes)
            if a.role is Role.WRENCH and scale > 0
            else parts.get(a.role, _select([], a.rows, changes))
            for a in inputs
        ]
        rows.apply(KernelResult("impl", names, "Phi"), columns, found, scale=scale, plant=state.plant)


def _select(entries: list[Entry], size: int, known: Indices) -> Combination:
    """Return a part of which some entries are multiples of variables, and all others are 0.

    A part of zeros alone is 0 times the first one of the `known` variables.
    """
    matrix, variables = np.zeros((1, size, max(len(entries), 1))), np.full((1, max(len(entries), 1)), known[0])
    for k, (variable, entry, factor) in enumerate(entries):
        matrix[0, entry, k], variables[0, k] = factor, variable
    return Combination(matrix, np.zeros(1, dtype=np.int64), variables)


def _write_contact(rows: Rows, text: str, contact: Contact, restitution: float, before: State, after: State) -> None:
    """Write the velocity of a contact after the impact."""
    sensors = [frame.name for frame in after.manifest.frames if frame.sensor]
    first = 3 * sensors.index(contact.sensor)
    for axis in contact.axes:
        row = rows.add_rows(1, f"{text}: {contact.sensor} along {AXES[axis]} after the impact")
        velocity = KernelResult("motion", ("q", "qd"), "v", (first + axis,))
        rows.apply(velocity, (after.q[:, None], after.qd[:, None]), row, plant=after.plant)
        if axis == contact.normal and restitution:
            columns = (before.q[:, None], before.qd[:, None])
            rows.apply(velocity, columns, row, scale=restitution, plant=before.plant)


def _write_friction(rows: Rows, text: str, contact: Contact, impulse: Indices) -> None:
    """Limit the impulse across the normal: |L_t| <= mu L_n, squared where there are two axes across."""
    across = [k for k, axis in enumerate(contact.axes) if axis != contact.normal]
    if contact.friction is None or contact.normal not in contact.axes or not across:
        return
    normal, mu = contact.axes.index(contact.normal), contact.friction
    own = f"{text}: friction at {contact.sensor}"
    if len(across) == 1:
        for sign in (1.0, -1.0):
            row = rows.add_rows(1, own, 0.0, np.inf)
            rows.A.put(row, [impulse[normal]], mu)
            rows.A.put(row, [impulse[across[0]]], sign)
        return
    square: Expression = Operation("*", Number(mu**2), Power(Name(f"L{normal}"), 2))
    for k in across:
        square = Operation("-", square, Power(Name(f"L{k}"), 2))
    names = {f"L{k}": ("L", k) for k in range(impulse.size)}
    formula = Formula((square,), names, (Input("L", impulse.size),))
    rows.apply(formula, (impulse[:, None],), rows.add_rows(1, own, 0.0, np.inf))
