"""Inverse dynamics along a recording: columns -> splines -> q, qd, qdd, and the open wrenches that act meanwhile.

Coordinates are splines of their samples; quaternions are scaled to length 1, and velocities follow from their rates.
Loops are closed: the independent coordinates keep their recorded values where all of them are recorded. Where one of
them turns with a quaternion, all coordinates are recorded, and the nearest motion that closes the loops is taken. A
force F at a point P, with a free moment M, acts at the point of the wrench p, where a sensor of the wrench's name is:

    force F,    moment M + (P - p) x F

in axes of the base, turned into the body's where the wrench has components there. Times in gaps are left out.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mbsgen.documents import abbreviate
from mbsgen.errors import Fault, InputError
from mbsgen.manifest import TIME, Manifest, Wrench
from mbsrun.closure import Closure
from mbsrun.external import Mechanism
from mbsrun.quaternions import find_velocities, list_places, normalise
from mbsrun.recordings import (
    AXES,
    Recording,
    Track,
    Treatment,
    find_column,
    fit,
    fit_all,
    name_coordinate,
    read_column,
    stack,
)
from mbsrun.recordings.reading import refuse_column
from mbsrun.recordings.splines import count_gaps
from mbsrun.simulation.course import Course
from mbsrun.simulation.inverse import Forces, Report, balance, check_kernels, invert
from mbsrun.simulation.muscles import Muscles, measure_pull

Array = NDArray[np.float64]

LINEAR = Treatment(degree=1)  # of forces, which jump


@dataclass(frozen=True)
class Load:
    """The columns of a recorded force: beginnings of names, which an axis ends."""

    force: str
    point: str | None = None  # None: at the wrench's own point
    moment: str | None = None
    is_input: bool = False  # components as the model takes them; else along the axes of the base


@dataclass(frozen=True, eq=False)
class Retraced:
    """The motion along a recording, with the open wrenches that act meanwhile, and what became of its gaps."""

    t: Array  # (K,)
    q: Array  # (K, nq)
    qd: Array  # (K, n)
    qdd: Array  # (K, n)
    w: Array  # (K, ...)
    samples: int  # of the recording
    bridged: int  # gaps
    left_open: int


@dataclass(frozen=True, eq=False)
class Recalled:
    """The forces along a recording, and what became of its gaps."""

    forces: Forces
    samples: int  # of the recording
    bridged: int  # gaps
    left_open: int


def analyse(
    recording: Recording,
    kernels: Mechanism,
    treatment: Treatment,
    *,
    columns: Mapping[str, str] | None = None,
    loads: Mapping[str, Load] | None = None,
    load_recording: Recording | None = None,
    without: Muscles | None = None,
    report: Report | None = None,
) -> Recalled:
    """Compute the forces along a recording, at its own times outside gaps; `without` muscles they are theirs too.

    `columns` names the columns of coordinates that have other names. Loads come from another recording, where one is
    given. Raises InputError, SplineError, and what `invert` raises.
    """
    idle = () if without is None else without.signals
    found = retrace(
        recording, kernels, treatment, columns=columns, loads=loads, load_recording=load_recording, idle=idle
    )
    pulls = None
    if without is not None:
        pull = measure_pull(kernels, without, found.q, found.qd, found.w)
        pulls = -np.einsum("kmn,km->kn", pull.slopes, pull.passive)
    forces = balance(kernels, found.t, found.q, found.qd, found.qdd, found.w, report, taken=pulls)
    return Recalled(forces, found.samples, found.bridged, found.left_open)


def retrace(
    recording: Recording,
    kernels: Mechanism,
    treatment: Treatment,
    *,
    columns: Mapping[str, str] | None = None,
    loads: Mapping[str, Load] | None = None,
    load_recording: Recording | None = None,
    idle: Collection[str] = (),
) -> Retraced:
    """Compute the motion along a recording, at its own times outside gaps, as `analyse` does; `idle` signals are 0."""
    check_kernels(kernels)
    manifest = kernels.manifest
    tracks, bridged, left_open = _fit_coordinates(recording, manifest, treatment, columns or {})
    source = recording if load_recording is None else load_recording
    loads = _find_loads(source, manifest) if loads is None else loads
    parts = _fit_loads(source, manifest, loads, idle)
    every = [*tracks.values(), *(track for part in parts.values() for track in part.values())]
    times = recording.times[np.all([track.is_known(recording.times) for track in every], axis=0)]
    if not times.size:
        finding = "at no time are all coordinates and forces known"
        raise InputError([Fault(recording.file, 0, "", finding, "bridge longer gaps, or leave columns out")])
    q, qd, qdd = _move(kernels, tracks, times)
    w = _resolve(kernels, times, q, loads, parts)
    return Retraced(times, q, qd, qdd, w, len(recording.times), bridged, left_open)


def _fit_coordinates(
    recording: Recording, manifest: Manifest, treatment: Treatment, columns: Mapping[str, str]
) -> tuple[dict[str, Track], int, int]:
    """Fit splines to all coordinates that have a column; each must have one, unless a few determine the others."""
    is_short = bool(manifest.loops) and set(manifest.independent) <= set(_pair_alone(manifest))
    units, found, faults = {c.name: c.unit for c in manifest.coordinates}, {}, []
    for name in manifest.positions:
        column = columns.get(name) or find_column(recording, name_coordinate(name))
        if column is not None:
            found[name] = read_column(recording, column, units.get(name, ""))
        elif not is_short:
            faults.append(refuse_column(recording, name_coordinate(name)[0]).faults[0])
    if faults:
        raise InputError(faults)
    samples = np.stack([*found.values()], axis=1) if found else np.zeros((len(recording.times), 0))
    gaps = [count_gaps(recording.times, column, treatment) for column in samples.T]
    tracks = fit_all(recording.times, samples, treatment)
    return dict(zip(found, tracks, strict=True)), sum(gap[0] for gap in gaps), sum(gap[1] for gap in gaps)


def _move(kernels: Mechanism, tracks: Mapping[str, Track], times: Array) -> tuple[Array, Array, Array]:
    """Compute the motion of all joints."""
    manifest, alone = kernels.manifest, _pair_alone(kernels.manifest)
    if manifest.loops and set(manifest.independent) <= set(alone):
        recorded = [i for i, name in alone.items() if name in tracks]
        chosen = list(manifest.independent) if set(manifest.independent) <= set(recorded) else recorded
        own = [tracks[alone[i]] for i in chosen]
        course = Course(lambda t: (stack(own, t), stack(own, t, 1), stack(own, t, 2)), False)
        moved = invert(kernels, chosen, course, times)
        return moved.q, moved.qd, moved.qdd
    every = [tracks[name] for name in manifest.positions]
    rates = [stack(every, times, order) for order in range(3)]
    q, *rates = scale(rates, manifest)
    return _close(kernels, q, *find_velocities(kernels, q, *rates))


def _pair_alone(manifest: Manifest) -> dict[int, str]:
    """Name the coordinates whose rates are velocities, by the numbers of these."""
    pairs = list_places(manifest)
    return {speeds[0]: manifest.positions[places[0]] for places, speeds in pairs if len(speeds) == 1}


def _close(kernels: Mechanism, q: Array, qd: Array, qdd: Array) -> tuple[Array, Array, Array]:
    """Return the nearest motion that closes the loops. Raises OpenError."""
    if not kernels.manifest.loops:
        return q, qd, qdd
    closure = Closure(kernels)
    closed = closure.close(q)
    worst = int(np.abs(closure.gaps(closed)).max(axis=1).argmax())
    if not closure.is_closed(closed[worst]):
        raise closure.tell_open(closed[worst])
    qd = closure.project_velocities(closed, qd)
    return closed, qd, closure.project_accelerations(closed, qd, qdd)


def scale(rates: Sequence[Array], manifest: Manifest) -> list[Array]:
    """Scale quaternions to length 1, with their derivatives: q/|q| changes across q alone."""
    q, first, second = (x.copy() for x in rates)
    unit = normalise(q, manifest)
    for k in manifest.quaternions:
        x, v, a = (part[:, k : k + 4] for part in (q, first, second))
        length = np.linalg.norm(x, axis=1, keepdims=True)
        n = x / length
        speed = (n * v).sum(axis=1, keepdims=True)
        turned = (v - n * speed) / length
        pull = (turned * v + n * a).sum(axis=1, keepdims=True)
        first[:, k : k + 4] = turned
        second[:, k : k + 4] = (a - turned * speed - n * pull - turned * speed) / length
    return [unit, first, second]


# --- wrenches ---


def _find_loads(recording: Recording, manifest: Manifest) -> dict[str, Load]:
    """Find the columns of open wrenches by the names that `mbsrun simulate` writes."""
    found = {}
    for wrench in manifest.wrenches:
        for form in ("input[{}]", "{}"):
            named = [
                form.format(f"{wrench.name}.{part}.{axis}")
                for part, is_open in (("force", wrench.force), ("moment", wrench.moment))
                if is_open
                for axis in AXES
            ]
            if named and set(named) <= set(recording.names):
                begin = form.split("}")[0].replace("{", wrench.name)
                force = f"{begin}.force." if wrench.force else ""
                found[wrench.name] = Load(force, None, f"{begin}.moment." if wrench.moment else None, is_input=True)
                break
    return found


def _fit_loads(
    recording: Recording, manifest: Manifest, loads: Mapping[str, Load], idle: Collection[str]
) -> dict[str, dict[str, Track]]:
    """Fit lines to the components of loads: by wrench, then by part and axis; report every fault."""
    wrenches = {wrench.name: wrench for wrench in manifest.wrenches}
    sensors = {frame.name for frame in manifest.frames if frame.sensor}
    found: dict[str, dict[str, Track]] = {}
    faults: list[Fault] = []
    for name, load in loads.items():
        faults += [Fault(recording.file, 0, "", *told) for told in _find_faults(name, load, wrenches, sensors)]
        found[name] = {}
        for part, begin, unit in (
            ("force", load.force, "N"),
            ("point", load.point, "m"),
            ("moment", load.moment, "N m"),
        ):
            for axis in AXES if begin else ():
                column = next((x for x in (f"{begin}{axis}", f"{begin}{axis}]") if x in recording.names), None)
                if column is None:
                    faults += refuse_column(recording, f"{begin}{axis}").faults
                    continue
                try:
                    samples = read_column(recording, column, unit)
                except InputError as error:
                    faults += error.faults
                    continue
                found[name][f"{part}.{axis}"] = fit(recording.times, samples, LINEAR)
    for name in manifest.signals:
        if name == TIME or name in idle:
            continue
        column = next((x for x in (f"input[{name}]", f"w[signal_{name}]") if x in recording.names), name)
        if column not in recording.names:
            faults += refuse_column(recording, column).faults
            continue
        found[f"signal[{name}]"] = {"signal": fit(recording.times, read_column(recording, column, ""), LINEAR)}
    if faults:
        raise InputError(faults)
    return found


def _find_faults(name: str, load: Load, wrenches: Mapping[str, Wrench], sensors: set[str]) -> list[tuple[str, str]]:
    """Find what a wrench of the model lacks for a load."""
    wrench = wrenches.get(name)
    if wrench is None:
        known = ", ".join(wrenches) or "none"
        return [
            (
                f"the model leaves no wrench {abbreviate(name)} open",
                f"there are {known}; a model opens one by force: input",
            )
        ]
    faults = []
    if not wrench.force and load.force:
        faults.append((f"the force of {name} is no input of the model", "write force: input into the model's wrench"))
    if (load.moment or load.point) and not wrench.moment:
        faults.append((f"the moment of {name} is no input of the model", "write moment: input into the model's wrench"))
    if load.point and name not in sensors:
        finding = f"the point of {name} is unknown: the model has no sensor of this name"
        faults.append((finding, "give the model a frame with the wrench's name, at its position"))
    return faults


def _resolve(
    kernels: Mechanism, times: Array, q: Array, loads: Mapping[str, Load], parts: Mapping[str, Mapping[str, Track]]
) -> Array:
    """Return the inputs w (K, ...) of open wrenches."""
    manifest = kernels.manifest
    labels = manifest.inputs[len(manifest.actuated) :]
    w = np.zeros((len(times), len(labels)))
    frames = kernels("frames", q=q) if parts else {}
    sensors = {frame.name: i for i, frame in enumerate(manifest.frames) if frame.sensor}
    for name in manifest.signals:
        track = parts.get(f"signal[{name}]", {}).get("signal")
        w[:, labels.index(name)] = times if name == TIME else 0.0 if track is None else track.evaluate(times)
    for wrench in manifest.wrenches:
        own = parts.get(wrench.name)
        if own is None:
            continue
        force, point, moment = (
            np.stack([own[f"{part}.{axis}"].evaluate(times) for axis in AXES], axis=1)
            if f"{part}.x" in own
            else np.zeros((len(times), 3))
            for part in ("force", "point", "moment")
        )
        if "point.x" in own:
            moment = moment + np.cross(point - frames["p"][:, :, sensors[wrench.name]], force)
        for part, values in (("force", force), ("moment", moment)):
            if not wrench.in_base and not loads[wrench.name].is_input:
                R = frames["R"][:, :, 3 * wrench.frame : 3 * wrench.frame + 3]
                values = np.einsum("kji,kj->ki", R, values)
            for i, axis in enumerate(AXES):
                label = f"{wrench.name}.{part}.{axis}"
                if label in labels:
                    w[:, labels.index(label)] = values[:, i]
    return w
