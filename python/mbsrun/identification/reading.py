"""Recordings -> samples of an identification: the motion of all joints, torques or currents, at the times of both.

Velocities and accelerations are the recorded ones where all of them are there; else they are derivatives of splines.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mbsgen.documents import abbreviate
from mbsgen.errors import Fault, InputError
from mbsgen.manifest import Manifest
from mbsrun.external import Mechanism
from mbsrun.identification.equations import Samples
from mbsrun.identification.settings import Settings
from mbsrun.recordings import Recording, Treatment, find_column, fit, read_column
from mbsrun.recordings.reading import refuse_column
from mbsrun.simulation.recorded import retrace

Array = NDArray[np.float64]

LINEAR = Treatment(degree=1)  # of torques, between samples of another recording
FEWEST = 4  # samples that a motion needs


def read_samples(
    recording: Recording, torques: Recording, mechanism: Mechanism, settings: Settings, unmeasured: tuple[int, ...]
) -> Samples:
    """Read a recording, with torques from the same or another one. Raises InputError with every fault."""
    if len(recording.times) < FEWEST:
        count = "1 sample" if len(recording.times) == 1 else f"{len(recording.times)} samples"
        finding = f"it has {count}, and a motion needs {FEWEST} at least"
        raise InputError([Fault(recording.file, 0, "", finding, "give a longer recording")])
    manifest = mechanism.manifest
    tracks = _read_torques(torques, manifest, settings, unmeasured)
    found = retrace(recording, mechanism, settings.treatment, columns=settings.columns, loads=settings.loads)
    qd, qdd = _find_rates(recording, manifest, found.t, found.qd, found.qdd)
    u, i = np.zeros((2, len(found.t), len(manifest.actuated)))
    for k, (values, is_current, motor) in tracks.items():
        own = fit(torques.times, values, LINEAR).evaluate(found.t)
        u[:, k] = motor * own if is_current else own
        i[:, k] = own if is_current else 0.0
    samples = Samples(found.t, found.q, qd, qdd, recording.file, found.w, u, i)
    known = np.isfinite(np.hstack((samples.q, qd, qdd, samples.w, u, i))).all(axis=1)
    if known.sum() < FEWEST:
        finding = "at no time are all coordinates and torques known"
        if known.any():
            finding = f"at only {known.sum()} times are all coordinates and torques known"
        raise InputError([Fault(recording.file, 0, "", finding, "bridge longer gaps, or name joints without torques")])
    return replace(samples.take(known), left_out=len(recording.times) - int(known.sum()))


def name_torque(name: str) -> tuple[str, ...]:
    """List the names that the column of a torque may have."""
    return (f"u[{name}]", f"input[{name}]", f"torque[{name}]", f"tau[{name}]")


def _read_torques(
    recording: Recording, manifest: Manifest, settings: Settings, unmeasured: tuple[int, ...]
) -> Mapping[int, tuple[Array, bool, float]]:
    """Read each measured torque or current: by the entry of u, with the torque for a unit of current."""
    found: dict[int, tuple[Array, bool, float]] = {}
    faults: list[Fault] = []
    for k, i in enumerate(manifest.actuated):
        joint = manifest.coordinates[i]
        if i in unmeasured:
            continue
        is_current = joint.name in settings.currents
        column = settings.currents.get(joint.name) or settings.torques.get(joint.name)
        column = column or find_column(recording, name_torque(joint.name))
        if column is None:
            faults.append(_miss_torque(recording, joint.name))
            continue
        try:
            values = read_column(recording, column, "" if is_current else joint.force_unit)
        except InputError as error:
            faults += error.faults
            continue
        found[k] = values, is_current, settings.motors.get(joint.name, 0.0)
    if faults:
        raise InputError(faults)
    return found


def _miss_torque(recording: Recording, joint: str) -> Fault:
    named = name_torque(joint)[0]
    (fault,) = refuse_column(recording, named).faults
    remedy = f"name its column as {joint}=COLUMN, or name the joint as one without a measured torque"
    return Fault(recording.file, 0, "", f"no torque of {abbreviate(joint)}: {fault.finding}", remedy)


def _find_rates(recording: Recording, manifest: Manifest, t: Array, qd: Array, qdd: Array) -> tuple[Array, Array]:
    """Take recorded velocities and accelerations where there are all of them."""
    names = [c.name for c in manifest.coordinates]
    wanted = [f"{kind}[{name}]" for kind in ("qd", "qdd") for name in names]
    if not set(wanted) <= set(recording.names):
        return qd, qdd
    units = {c.name: c.unit for c in manifest.coordinates}
    columns = [
        read_column(recording, f"{kind}[{name}]", f"{units[name]}/s{power}")
        for kind, power in (("qd", ""), ("qdd", "^2"))
        for name in names
    ]
    places = np.searchsorted(recording.times, t)
    both = np.array(columns)[:, places].T
    return both[:, : len(names)], both[:, len(names) :]
