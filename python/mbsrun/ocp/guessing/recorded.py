"""A guess from a file: an earlier solution, or a recorded motion such as a table of `mbsrun simulate` or `solve`.

Coordinates q[NAME] are needed; velocities, accelerations, inputs, states and controls are taken where all columns of
their kind are there, with numbers at both ends. Without these columns, velocities and accelerations are derivatives of
splines, and inputs are the ones of the problem's guess: 0, static or by inverse dynamics. `guess.times` is the part of
the recording that is taken. Its time is scaled to the horizon; a free horizon is guessed as its duration. A guess need
not be a motion, so gaps are bridged whatever their length; loops are closed, and quaternions have length 1.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mbsgen.documents import abbreviate
from mbsgen.errors import Fault, InputError
from mbsgen.manifest import Manifest
from mbsrun.closure import find_closure
from mbsrun.ocp.ground import schemes
from mbsrun.ocp.ground.plant import Plant
from mbsrun.ocp.ground.trajectory import NONE, Trajectory, average_inputs
from mbsrun.ocp.guessing.guess import balance
from mbsrun.ocp.problem.problem import Problem
from mbsrun.ocp.solution.solution import read_guess
from mbsrun.ocp.statement.sections import is_solution
from mbsrun.quantities import name_components
from mbsrun.quaternions import find_velocities, normalise
from mbsrun.recordings import (
    READERS,
    Recording,
    Track,
    Treatment,
    find_column,
    fit,
    name_coordinate,
    read_column,
    read_recording,
    stack,
)

Array = NDArray[np.float64]

BRIDGED = Treatment(degree=3, gap=np.inf)
ROUNDED = 1e-9  # of a recording: times that are as near to its ends are its ends
INPUTS = ("u", "input")  # as `mbsrun solve` and `mbsrun simulate` name them


def find_guess(path: Path, problem: Problem, plant: Plant) -> Trajectory:
    """Read a guess: a solution (.json), or a recording. Raises InputError for one of another mechanism."""
    if is_solution(path):
        return read_guess(path, plant.manifest)
    if path.suffix.lower() not in READERS:
        finding = f"found {abbreviate(path.suffix) if path.suffix else 'nothing'} at the end of its name"
        remedy = f"give a solution (.json) or a recording ({', '.join(READERS)})"
        raise InputError([Fault(str(path), 0, "", finding, remedy)])
    return recall(read_recording(path), problem, plant)


def recall(recording: Recording, problem: Problem, plant: Plant) -> Trajectory:
    """Read a recorded motion on the grid of a problem. Raises InputError where it lacks a coordinate or the times."""
    start, end = choose_times(recording, problem)
    problem = problem.with_duration(end - start)
    ends, pace = np.array([start, end]), (end - start) / problem.horizon
    t, point_t = problem.grid.times(problem.horizon, schemes.build(problem.family, problem.degree).points)
    mesh, points = start + t * pace, start + point_t * pace
    move = _read_motion(recording, plant, ends)
    (q, qd, _), (point_q, point_qd, point_qdd) = (move(times, pace) for times in (mesh, points))
    names = [f"state[{state.name}]" for state in problem.states]
    names += [f"integral[{i}]" for i in range(len(problem.integrals))]
    states = _fit(recording, names, ends)
    controls = _fit(recording, [f"control[{control.name}]" for control in problem.controls], ends)
    forces = _fit(recording, [f"w[{name or i}]" for i, name in enumerate(name_components(plant.manifest))], ends)
    none = np.zeros((len(t) - 1, len(problem.bounds.u)))
    motion = Trajectory(
        *(t, q, qd, none, point_t, point_q, point_qd, point_qdd),
        states=NONE if states is None else stack(states, mesh),
        point_states=NONE if states is None else stack(states, points),
        controls=NONE if controls is None else _average(recording, controls, mesh),
        point_w=stack(forces, points) if forces else NONE,
    )
    actuated = [plant.manifest.coordinates[i].name for i in plant.manifest.actuated]
    for kind in INPUTS:
        inputs = _fit(recording, [f"{kind}[{name}]" for name in actuated], ends)
        if inputs:
            lower, upper = np.array(problem.bounds.u).T
            return replace(motion, u=np.clip(_average(recording, inputs, mesh), lower, upper))
    return balance(motion, problem, plant, problem.guess.inputs)


def choose_times(recording: Recording, problem: Problem) -> tuple[float, float]:
    """Return the part of a recording that a problem takes as its guess. Raises InputError where it is not recorded."""
    first, last = (float(recording.times[i]) for i in (0, -1))
    begin, end = problem.guess.times
    start, end = first if begin is None else begin, last if end is None else end
    slack = ROUNDED * (last - first)
    if first - slack <= start < end <= last + slack:
        return max(start, first), min(end, last)
    finding = f"it is from {first:g} to {last:g} s, and guess.times ask for {start:g} to {end:g} s"
    raise InputError([Fault(recording.file, 0, "", finding, "give guess.times within the recording")])


def _read_motion(
    recording: Recording, plant: Plant, ends: Array
) -> Callable[[Array, float], tuple[Array, Array, Array]]:
    """Return the motion as a function: times of the recording, and its seconds in one of the problem -> q, qd, qdd."""
    manifest, closure = plant.manifest, find_closure(plant)
    names = [c.name for c in manifest.coordinates]
    tracks = _fit_coordinates(recording, manifest, ends)
    speeds = _fit(recording, [f"qd[{name}]" for name in names], ends)
    changes = _fit(recording, [f"qdd[{name}]" for name in names], ends)

    def move(times: Array, pace: float) -> tuple[Array, Array, Array]:
        rates = [stack(tracks, times, order) for order in range(3)]
        q = normalise(rates[0], manifest)
        qd, qdd = find_velocities(plant, q, rates[1], rates[2])
        if speeds is not None:
            qd, qdd = stack(speeds, times), stack(speeds, times, 1)
        if changes is not None:
            qdd = stack(changes, times)
        if closure is not None:
            q = closure.close(q)
            qd = closure.project_velocities(q, qd)
            qdd = closure.project_accelerations(q, qd, qdd)
        return q, qd * pace, qdd * pace**2

    return move


def _fit_coordinates(recording: Recording, manifest: Manifest, ends: Array) -> list[Track]:
    """Fit splines to the coordinates; report every one that is missing, or unknown at an end of the part."""
    units, tracks, faults = {c.name: c.unit for c in manifest.coordinates}, [], []
    for name in manifest.positions:
        column = find_column(recording, name_coordinate(name))
        if column is None:
            finding = f"no column is named {abbreviate(name_coordinate(name)[0])}"
            faults.append(Fault(recording.file, 0, "", finding, "give every coordinate of the model"))
            continue
        track = fit(recording.times, read_column(recording, column, units.get(name, "")), BRIDGED)
        if track.list_unknown(*ends.tolist()):
            path = f"column {abbreviate(column)}"
            faults.append(Fault(recording.file, 0, path, "it is empty at an end", "cut the recording to what is known"))
        tracks.append(track)
    if faults:
        raise InputError(faults)
    return tracks


def _fit(recording: Recording, columns: Sequence[str], ends: Array) -> list[Track] | None:
    """Fit splines to some columns; None where one is missing.

    Raises InputError for columns that have no number at an end of the part.
    """
    if not set(columns) <= set(recording.names):
        return None
    tracks = [fit(recording.times, recording.column(name), BRIDGED) for name in columns]
    faults = [
        Fault(recording.file, 0, f"column {abbreviate(name)}", *_find_empty(track, ends))
        for name, track in zip(columns, tracks, strict=True)
        if not track.is_known(ends).all()
    ]
    if faults:
        raise InputError(faults)
    return tracks


def _find_empty(track: Track, ends: Array) -> tuple[str, str]:
    """Return that a column has no number at an end, and what to do."""
    time = float(ends[~track.is_known(ends)][0])
    return (
        f"it has no number at t = {time:g} s",
        "give it one, cut the recording, or leave the column out",
    )


def _average(recording: Recording, tracks: Sequence[Track], mesh: Array) -> Array:
    """Return the means of inputs between mesh points: each row of a recording holds until the next one."""
    first = recording.times[0]
    return average_inputs(recording.times - first, stack(tracks, recording.times[:-1]), mesh - first)
