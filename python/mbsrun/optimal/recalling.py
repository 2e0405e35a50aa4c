"""A guess of arrays by name, such as a frame of pandas: numbers over time -> a recording, as of a file.

An unknown of the problem may have one number in it, which is read apart.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from mbsgen.documents import nearest
from mbsgen.manifest import Manifest
from mbsrun.ocp.problem.problem import Problem
from mbsrun.ocp.statement.checks import Line, ProblemError
from mbsrun.quantities import list_quantities
from mbsrun.recordings import Column, Recording
from mbsrun.results import list_results


def make_recording(values: Any, problem: Problem, manifest: Manifest) -> Recording:
    """Return a mapping of arrays by the names of expressions, with the times `t`, or a frame, as a recording.

    Quantities that follow from a motion, such as positions of sensors, are left out. Raises ProblemError with every
    fault.
    """
    columns = _name_columns(problem, manifest)
    unknowns = {unknown.name for unknown in problem.unknowns}
    known = [*list_quantities(manifest, problem.added), *list_results(manifest)]
    given = {str(name): values[name] for name in values}
    if "t" not in given and not isinstance(values, Mapping):
        given["t"] = values.index  # of a frame
    findings: list[Line] = []
    arrays = {}
    for name, numbers in given.items():
        if name in unknowns:
            continue
        if name not in known:
            meant = nearest(name, known)
            findings.append((f"guess.{name}", "unknown name", f"did you mean {meant}?" if meant else "leave it out"))
            continue
        try:
            arrays[name] = np.asarray(numbers, dtype=np.float64)
        except (TypeError, ValueError):
            findings.append((f"guess.{name}", "no array of numbers", "give one number for each time"))
    t = arrays.pop("t", np.zeros(0))
    if t.ndim != 1 or t.size < 2 or not np.isfinite(t).all() or not (np.diff(t) > 0).all():
        findings.append(("guess.t", "no increasing times", "give two or more"))
    findings += [
        (f"guess.{name}", f"shape {numbers.shape} at {t.size} times", "give one number for each time")
        for name, numbers in arrays.items()
        if numbers.shape != t.shape
    ]
    findings += [
        (
            f"guess.{name}",
            f"{numbers[i]} at t = {t[i]:.6g} s, number {i}",
            "give a finite number, or leave this time out",
        )
        for name, numbers in arrays.items()
        if numbers.shape == t.shape and np.isfinite(t).all()
        for i in np.flatnonzero(~np.isfinite(numbers))[:1].tolist()
    ]
    if findings:
        raise ProblemError(problem.name, findings)
    kept = [name for name in arrays if name in columns]
    named = tuple(Column(*columns[name]) for name in kept)
    numbers = np.array([arrays[name] for name in kept]).reshape(len(kept), t.size).T
    return Recording("guess", t, named, numbers)


def read_unknowns(values: Any, problem: Problem) -> dict[int, float]:
    """Return the numbers that a mapping or a frame has for unknowns, by their places. Raises ProblemError."""
    found, findings = dict[int, float](), list[Line]()
    for place, name in enumerate(unknown.name for unknown in problem.unknowns):
        if name not in values:
            continue
        try:
            numbers = np.unique(np.asarray(values[name], dtype=np.float64))
        except (TypeError, ValueError):
            numbers = np.zeros(0)
        if numbers.size == 1 and np.isfinite(numbers[0]):
            found[place] = float(numbers[0])
        else:
            text = "no finite number, or several: an unknown is one for the whole motion"
            findings.append((f"guess.{name}", text, "give one number"))
    if findings:
        raise ProblemError(problem.name, findings)
    return found


def _name_columns(problem: Problem, manifest: Manifest) -> dict[str, tuple[str, str]]:
    """Return the columns that a recording of a solution has, with their units, by the names of quantities."""
    kinds = {"q": "q", "qd": "qd", "qdd": "qdd", "u": "u", "states": "state", "controls": "control"}
    coordinates = [c.name for c in manifest.coordinates]
    entries = {
        "q": list(manifest.positions),
        "qd": coordinates,
        "qdd": coordinates,
        "u": [coordinates[i] for i in manifest.actuated],
        "states": list(problem.added.states),
        "controls": list(problem.added.controls),
    }
    units = {c.name: c.unit for c in manifest.coordinates}
    powers = {"q": "", "qd": "/s", "qdd": "/s^2"}
    found = {}
    for name, x in list_quantities(manifest, problem.added).items():
        if x.kind in kinds:
            own = entries[x.kind][x.index]
            unit = f"{units[own]}{powers[x.kind]}" if x.kind in powers and own in units else ""
            found[name] = (f"{kinds[x.kind]}[{own}]", unit)
    return found
