"""Rows of a program in the words of its problem: the ones that stay violated where a search finds no motion."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence

import numpy as np

from mbsgen.manifest import Manifest
from mbsrun.ocp.functions import Indices
from mbsrun.ocp.transcription import Transcription
from mbsrun.ocp.writing import find_targets
from mbsrun.quaternions import find_quaternion

SHOWN = 4  # descriptions of a failure
_AXES = "xyz"

_IN_INTERVALS: Mapping[str, str] = {  # rows by interval, and their descriptions
    "states": "the states within interval {}",
    "dynamics": "the equations of motion in interval {}",
    "closure": "the loops in interval {}",
    "continuity": "the state after interval {}",
}


def describe(rows: Sequence[int], transcription: Transcription, manifest: Manifest) -> str:
    """Describe the rows that stay violated, each group once; empty where there are none."""
    known = name_rows(transcription, manifest)
    texts = list(dict.fromkeys(known[row] for row in rows if row in known))
    return ", ".join(texts[:SHOWN]) + (", ..." if len(texts) > SHOWN else "")


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
    added = shape.added.states
    yield from _name(rows.extras.start, (f"start: {name}" for name in added))
    yield from _name(rows.extras.end, (f"end: {added[i]}" for i in shape.ending))
    for k in range(shape.intervals):
        yield rows.extras.rates[k], f"the states that the problem adds in interval {k + 1}"
        yield rows.extras.given[k], f"the forces by expressions in interval {k + 1}"
        yield rows.extras.contacts[k], f"the contacts in interval {k + 1}"
    yield rows.extras.contacts_at_start, "start: the contacts"
    yield rows.extras.friction, "friction"
    inputs = [f"the rate of the input {names[manifest.actuated[i]]}" for i in shape.rated_inputs]
    inputs += [f"the rate of {shape.added.controls[i]}" for i in shape.rated_controls]
    yield from _name(rows.rates.T, inputs)
    yield from _name(rows.constraints, (f"constraint {text}" for text, _ in shape.constraints))


def _name(rows: Sequence[Indices] | Indices, texts: Iterable[str]) -> Iterator[tuple[Indices, str]]:
    yield from ((np.atleast_1d(found), text) for found, text in zip(rows, texts, strict=True))
