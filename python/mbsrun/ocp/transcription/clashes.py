"""Rows and bounds of a program in the words of its problem: the ones that clash where a search finds no motion.

A search ends in an infeasible problem at a point where no small change reduces the violation. There, conditions of the
problem stay violated, and bounds and ranges at their limits keep them so: both together clash. Equations of motion and
their discretisation are named where no condition of the problem is violated.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from mbsgen.manifest import Manifest
from mbsrun.ocp.ground.functions import Array, Indices
from mbsrun.ocp.ground.program import Program
from mbsrun.ocp.problem.structure import Structure
from mbsrun.ocp.transcription.transcription import Transcription
from mbsrun.ocp.transcription.writing.ends import find_targets
from mbsrun.quaternions import find_quaternion

SHOWN = 4  # descriptions of a failure
VIOLATED = 1e-6  # a row that is named where a search fails stays violated by more than this
ACTIVE = 1e-4  # relative, and absolute below 1: a value as near to a limit is at it, for methods of interior points
START, END = "start: ", "end: "  # in the descriptions of their conditions
_AXES = "xyz"

_IN_INTERVALS: Mapping[str, str] = {  # rows by interval, and their descriptions
    "states": "the states within interval {}",
    "dynamics": "the equations of motion in interval {}",
    "closure": "the loops in interval {}",
    "driven": "the given motions in interval {}",
    "driving": "the equations of motion in interval {}",
    "continuity": "the state after interval {}",
}


@dataclass(frozen=True)
class Found:
    """A point where a search ended: variables and rows, with their limits."""

    x: Array
    bounds: tuple[Array, Array]
    g: Array
    row_bounds: tuple[Array, Array]


@dataclass(frozen=True)
class Names:
    """The descriptions of variables and rows by their numbers, and the rows that no condition of the problem is."""

    variables: Mapping[int, str]
    rows: Mapping[int, str]
    inner: frozenset[int]


def describe_point(found: Found, names: Names) -> str:
    """Describe what is violated at a point, the worst first, and what is at its limits there.

    Where neither the start nor the end gives way, conditions of the end are described as what the violated ones stand
    against: a search may end with any of the conditions that clash kept.
    """
    own, inner = _list_violated(found, names)
    violated = own or inner
    if not violated:
        return ""
    limits = [names.variables[i] for i in _find_active(found.x, *found.bounds) if i in names.variables]
    limits += [names.rows[row] for row in _find_active(found.g, *found.row_bounds) if row in names.rows]
    ends = [
        text
        for row in np.flatnonzero(found.row_bounds[0] == found.row_bounds[1])
        if END in (text := names.rows.get(int(row), ""))
    ]
    against = [] if any(END in text or START in text for text in violated) else ends
    held = f", against {_shorten(against)}" if against else ""
    kept = [text for text in limits if text not in {*own, *against}]
    return _shorten(violated) + held + (f"; at their limits: {_shorten(kept)}" if kept else "")


def _list_violated(found: Found, names: Names) -> tuple[list[str], list[str]]:
    """Describe the conditions that are violated, and the equations of the motion that are, the worst first."""
    excess, beyond = _measure(found.g, found.row_bounds), _measure(found.x, found.bounds)
    worst = [
        (excess[i], names.rows[i], i in names.inner)
        for i in np.flatnonzero(excess > VIOLATED).tolist()
        if i in names.rows
    ]
    worst += [
        (beyond[i], names.variables[i], False) for i in np.flatnonzero(beyond > ACTIVE).tolist() if i in names.variables
    ]
    worst.sort(key=lambda part: -part[0])
    own, inner = ([text for _, text, is_inner in worst if is_inner is kind] for kind in (False, True))
    return own, inner


def _measure(values: Array, limits: tuple[Array, Array]) -> Array:
    """Return by how much values leave their limits, negative inside."""
    return np.nan_to_num(np.maximum(limits[0] - values, values - limits[1]))


def _find_active(values: Array, lower: Array, upper: Array) -> list[int]:
    """Find the values within a range that are at one of its ends; given values are no range."""
    near = ACTIVE * (1 + np.abs(values))
    is_active = (np.abs(values - lower) <= near) | (np.abs(values - upper) <= near)
    return [int(i) for i in np.flatnonzero(is_active & (lower < upper))]


def _shorten(texts: Sequence[str]) -> str:
    found = list(dict.fromkeys(texts))
    return ", ".join(found[:SHOWN]) + (", ..." if len(found) > SHOWN else "")


def name_parts(transcription: Transcription, manifest: Manifest) -> Names:
    """Describe all variables and rows of a program."""
    rows, extras = transcription.rows, transcription.rows.extras
    own = (rows.states, rows.dynamics, rows.closure, rows.driven, rows.driving, rows.continuity)
    inner = (*own, extras.rates, extras.given, extras.contacts)
    known = frozenset(int(row) for part in inner for row in np.ravel(part))
    variables = {i: text for found, text in _list_variables(transcription, manifest) for i in np.ravel(found).tolist()}
    return Names(variables, name_rows(transcription, manifest), known)


def see_solver(names: Names, program: Program) -> Names:
    """Number variables and rows as a solver sees them."""
    at = {int(i): k for k, i in enumerate(program.kept)}
    at_row = {int(i): k for k, i in enumerate(program.kept_rows)}
    return Names(
        {at[i]: text for i, text in names.variables.items() if i in at},
        {at_row[i]: text for i, text in names.rows.items() if i in at_row},
        frozenset(at_row[i] for i in names.inner if i in at_row),
    )


def _list_variables(transcription: Transcription, manifest: Manifest) -> Iterator[tuple[Indices, str]]:
    """List groups of variables with bounds, and the descriptions of these."""
    shape, layout, extras = transcription.structure, transcription.layout, transcription.layout.extras
    names = [c.name for c in manifest.coordinates]
    states = [*manifest.positions, *(f"the velocity of {names[i]}" for i in layout.motions.velocities)]
    inputs = [f"the input {names[manifest.actuated[i]]}" for i in extras.free]
    given = [f"the input {names[manifest.actuated[i]]}" for i in extras.given]
    for parts, texts in (
        ((layout.mesh, layout.points), states),
        ((layout.inputs, layout.point_inputs), inputs),
        ((extras.states, extras.point_states), _name_states(shape)),
        ((extras.controls, extras.point_controls), shape.added.controls),
        ((extras.forces,), given),
        ((layout.driving,), [f"the force of the driven joint {names[i]}" for i in manifest.driven]),
    ):
        for part in parts:
            for k, text in enumerate(texts if part.shape[-1] else ()):
                yield part[..., k], f"the bounds of {text}"
    yield layout.horizons, "the range of the horizon"
    yield from _name(layout.unknowns, (f"the range of {name}" for name in shape.added.unknowns))


def _name_states(shape: Structure) -> list[str]:
    """Name the states that a problem adds; integrals by their expressions."""
    return [
        f"the integral of {rate}" if name.startswith("@") else name
        for name, rate in zip(shape.added.states, shape.rates, strict=True)
    ]


def describe(rows: Sequence[int], names: Names) -> str:
    """Describe the rows that stay violated, each group once; empty where there are none."""
    return _shorten([names.rows[row] for row in rows if row in names.rows])


def name_rows(transcription: Transcription, manifest: Manifest) -> dict[int, str]:
    """Return the descriptions of rows."""
    return {row: text for found, text in _list(transcription, manifest) for row in np.ravel(found).tolist()}


def _list(transcription: Transcription, manifest: Manifest) -> Iterator[tuple[Indices, str]]:
    """List groups of rows and their descriptions."""
    shape, rows, velocities = transcription.structure, transcription.rows, transcription.layout.motions.velocities
    names = [c.name for c in manifest.coordinates]
    states = [*manifest.positions, *(f"the velocity of {names[i]}" for i in velocities)]
    for kind, text in _IN_INTERVALS.items():
        for k, found in enumerate(getattr(rows, kind)):
            yield found, text.format(k + 1)
    yield from _name(rows.start, (f"start: {name}" for name in states))
    yield rows.lengths, "start: the lengths of quaternions"
    yield rows.start_closure, "start: the loops"
    yield rows.driven_start, "start: the given motions"
    bounded = [*manifest.positions, *(f"the velocity of {name}" for name in names)]
    for i, state in enumerate(shape.bounded):
        yield rows.inner[:, :, i], f"the bounds of {bounded[state]}"
    for group, sensors, text in (
        (rows.sensors, shape.sensors, "end: {} of {}"),
        (rows.sensor_velocities, shape.sensor_velocities, "end: the velocity of {1} along {0}"),
    ):
        for found, sensor in zip(group, sensors, strict=True):
            yield from ((found[[i]], text.format(axis, sensor)) for i, axis in enumerate(_AXES))
    single = [i for i in shape.coordinates if find_quaternion(transcription.quaternions, i) is None]
    yield from _name(rows.coordinates, (f"end: {manifest.positions[i]}" for i in single))
    targets = find_targets(shape, transcription.quaternions)
    yield from _name(rows.attitudes, (f"end: the attitude of {target.joint}" for target in targets))
    yield rows.velocity, "end: rest"
    yield rows.acceleration, "end: no acceleration"
    yield from _name(rows.velocities, (f"end: the velocity of {names[i]}" for i in shape.velocities))
    yield from _name(rows.accelerations, (f"end: the acceleration of {names[i]}" for i in shape.accelerations))
    added = _name_states(shape)
    yield from _name(rows.extras.start, (f"start: {name}" for name in added))
    yield from _name(rows.extras.end, (f"end: {added[i]}" for i in shape.ending))
    for k in range(shape.intervals):
        yield rows.extras.rates[k], f"the states that the problem adds in interval {k + 1}"
        given = rows.extras.given[k]
        forces, motions = np.split(given, [given.shape[1] - len(shape.driven)], axis=1)
        yield forces, f"the forces by expressions in interval {k + 1}"
        yield motions, _IN_INTERVALS["driven"].format(k + 1)
        yield rows.extras.contacts[k], f"the contacts in interval {k + 1}"
    yield rows.extras.contacts_at_start, "start: the contacts"
    yield rows.extras.friction, "friction"
    inputs = [f"the rate of the input {names[manifest.actuated[i]]}" for i in shape.rated_inputs]
    inputs += [f"the rate of {shape.added.controls[i]}" for i in shape.rated_controls]
    yield from _name(rows.rates.T, inputs)
    yield from _name(rows.constraints, (f"constraint {label}" for label in shape.labels))


def _name(rows: Sequence[Indices] | Indices, texts: Iterable[str]) -> Iterator[tuple[Indices, str]]:
    yield from ((np.atleast_1d(found), text) for found, text in zip(rows, texts, strict=True))
