"""Motions to animate: folders that other commands wrote, solutions, and tables of coordinates over time."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray
from pydantic import FiniteFloat, TypeAdapter, ValidationError

from mbsgen.documents import abbreviate
from mbsgen.errors import Fault, InputError
from mbsgen.manifest import Manifest
from mbsrun.animation import Marker, Motion, Part
from mbsrun.external import Mechanism, load
from mbsrun.models import Extent
from mbsrun.ocp.ground.plant import Plant
from mbsrun.ocp.showing.files import shift_phases
from mbsrun.ocp.showing.pictures import list_targets, make_part
from mbsrun.ocp.solution.phases import FORMAT as PHASES
from mbsrun.ocp.solution.phases import read_phased_solution
from mbsrun.ocp.solution.solution import Solution, read_solution
from mbsrun.quaternions import find_rates
from mbsrun.recordings import Recording, find_column, name_coordinate, read_column, read_recording
from mbsrun.recordings.reading import refuse_column
from mbsrun.recordings.recording import Column
from mbsrun.recordings.tables import read_cells

Array = NDArray[np.float64]

# Files of the folders of solve, simulate, track, fit-motion and inverse-dynamics; the first one that is there is read.
SOLUTION, SOLUTION_TABLE, TRACK = "solution.json", "solution.csv", "track.csv"
FILES = (SOLUTION, "trajectory.csv", TRACK, "motion.csv", "forces.csv")
SUMMARIES = {
    "trajectory.csv": "simulation.json",
    TRACK: "summary.json",
    "motion.csv": "motion.json",
    "forces.csv": "forces.json",
}  # beside tables; they hold parameters
START = 200  # bytes of a file that show its format
INPUTS = ("input", "acting", "u")  # names of the columns of inputs


@dataclass(frozen=True)
class _Summary:
    parameters: Mapping[str, FiniteFloat] = field(default_factory=dict)


_SUMMARY = TypeAdapter(_Summary)


def read_motion(path: Path, plant: Plant, name: str) -> tuple[Motion, tuple[Marker, ...]]:
    """Read a motion of a model, and the targets that it has. Raises InputError with the faults of its file."""
    file = _find_file(path)
    if file.suffix.lower() == ".json":
        solutions = [*_read_solutions(file)]
        for _, solution in solutions:
            _check_model(file, solution, plant.manifest)
        parts = tuple(make_part(solution, plant, part) for part, solution in solutions)
        markers = list_targets(solutions[-1][1], plant)
        return Motion(parts, name), markers
    recording = _read_track(file) if file.name == TRACK else read_recording(file)
    return Motion((_make_part(recording, plant),), name), ()


def equip(
    mechanism: Mechanism, model: Path, extent: Extent, motion: Path, given: Mapping[str, float] = MappingProxyType({})
) -> Mechanism:
    """Return the kernels with the parameters that a motion was made with; given values go before them.

    Numbers without a name in the model are parameters by their paths, as track's plants have them: then this extent of
    the model is loaded with them. Raises InputError for parameters that the model does not have.
    """
    wanted = {name: x for name, x in read_parameters(motion, mechanism.parameters).items() if name not in given}
    if not wanted.keys() <= mechanism.parameters.keys():
        mechanism = load(model, extent=replace(extent, runtime=True)).with_parameters(**given)
    if unknown := sorted(wanted.keys() - mechanism.parameters.keys()):
        finding = (
            f"it was made with other values of {', '.join(map(abbreviate, unknown))}, which the model does not have"
        )
        raise InputError([Fault(str(motion), 0, "parameters", finding, "give the model file of this motion")])
    changed = {name: x for name, x in wanted.items() if mechanism.parameters[name] != x}
    return mechanism.with_parameters(**changed) if changed else mechanism


def read_parameters(path: Path, known: Collection[str]) -> dict[str, float]:
    """Read the parameters that a motion was made with, from the summary beside its table; {} where there is none.

    simulate, track, fit-motion and inverse-dynamics write one. A solution, and the table beside it, have the
    parameters of the problem and the numbers that were found, as far as they are `known` parameters of the model.
    Raises InputError for a summary that cannot be read.
    """
    file = _find_file(path)
    solution = file if file.suffix.lower() == ".json" else file.parent / SOLUTION
    if file in (solution, file.parent / SOLUTION_TABLE) and solution.is_file():
        phases = [phase.parameters for _, phase in _read_solutions(solution)]
        return {name: x for each in phases for name, x in each.items() if name in known}
    summary = file.parent / SUMMARIES.get(file.name, "")
    if file.name not in SUMMARIES or not summary.is_file():
        return {}
    try:
        found = _SUMMARY.validate_json(summary.read_bytes())
    except (OSError, ValidationError):
        remedy = f"make the motion again, or give {file.name} elsewhere with --parameter"
        raise InputError([Fault(str(summary), 0, "", "it is no summary of a motion", remedy)]) from None
    return dict(found.parameters)


def read_end(path: Path, manifest: Manifest) -> Array:
    """Read the coordinates at which a solution of a model ends. Raises InputError."""
    file = _find_file(path)
    *_, (_, solution) = _read_solutions(file)
    _check_model(file, solution, manifest)
    return np.asarray(solution.trajectory.q[-1])


def _find_file(path: Path) -> Path:
    if not path.exists():
        finding, remedy = (
            "there is no such file or folder",
            "give a folder that solve, simulate or track wrote, or a file",
        )
        raise InputError([Fault(str(path), 0, "", finding, remedy)])
    if not path.is_dir():
        return path
    found = next((path / name for name in FILES if (path / name).is_file()), None)
    if found is None:
        finding, remedy = "the folder holds no motion", f"give a folder with one of {', '.join(FILES)}, or a file"
        raise InputError([Fault(str(path), 0, "", finding, remedy)])
    return found


def _read_solutions(file: Path) -> Iterator[tuple[str, Solution]]:
    """Yield a solution, or its phases with their names, which follow each other in time."""
    try:
        with file.open("rb") as stream:
            is_phased = PHASES.encode() in stream.read(START)
    except OSError as error:
        raise InputError([Fault(str(file), 0, "", f"cannot be read: {error.strerror}", "check the path")]) from None
    if not is_phased:
        yield "", read_solution(file)
        return
    solution, end = read_phased_solution(file), -np.inf
    for name, phase in zip(solution.names, shift_phases(solution), strict=True):
        trajectory = phase.trajectory
        shift = max(0.0, end - float(trajectory.t[0]))  # of phases at the same time
        moved = replace(trajectory, t=trajectory.t + shift, point_t=trajectory.point_t + shift)
        end = float(moved.t[-1])
        yield name, replace(phase, trajectory=moved)


def _check_model(file: Path, solution: Solution, manifest: Manifest) -> None:
    if solution.coordinates != manifest.positions:
        finding = f"its coordinates are {', '.join(solution.coordinates)}; {manifest.model} has "
        finding += ", ".join(manifest.positions)
        raise InputError([Fault(str(file), 0, "", finding, "give the model of this solution")])


def _make_part(recording: Recording, plant: Plant) -> Part:
    """Make a part of the rows in which all coordinates are known, and times increase."""
    manifest = plant.manifest
    units = {c.name: c.unit for c in manifest.coordinates}
    columns = []
    for name in manifest.positions:
        found = find_column(recording, name_coordinate(name))
        if found is None:
            raise refuse_column(recording, f"q[{name}]", "give a motion of this model")
        columns.append(read_column(recording, found, units.get(name, "")))
    t, q = recording.times, np.stack(columns, axis=1)
    kept = np.isfinite(q).all(axis=1)
    kept &= np.concatenate(([True], t[1:] > np.maximum.accumulate(t)[:-1]))
    if not kept.any():
        finding = "no row holds all coordinates"
        raise InputError([Fault(recording.file, 0, "", finding, "fill its gaps, such as by fit-motion --smooth")])
    q, rates = q[kept], _read_rates(recording, manifest)
    rates = None if rates is None else find_rates(plant, q, rates[kept])
    u, w = _read_inputs(recording, manifest)
    return Part(plant, t[kept], q, rates, u=u[kept], w=w[kept])


def _read_rates(recording: Recording, manifest: Manifest) -> Array | None:
    names = [f"qd[{c.name}]" for c in manifest.coordinates]
    if not all(name in recording.names for name in names):
        return None
    rates = np.stack([recording.column(name) for name in names], axis=1)
    return rates if np.isfinite(rates).all() else None


def _read_inputs(recording: Recording, manifest: Manifest) -> tuple[Array, Array]:
    """Read inputs and open wrenches; 0 where the table has none."""
    found = np.zeros((len(recording.times), 0))
    columns = []
    for label in manifest.inputs:
        name = find_column(recording, tuple(f"{kind}[{label}]" for kind in INPUTS))
        columns.append(np.zeros(len(found)) if name is None else np.nan_to_num(recording.column(name)))
    values = np.stack(columns, axis=1) if columns else found
    m = len(manifest.actuated)
    return values[:, :m], values[:, m:]


def _read_track(file: Path) -> Recording:
    """Read the numbers of a track's table, which has a column of words."""
    _, ((_, header), *rows) = read_cells(file)
    wanted = [k for k, name in enumerate(header) if name == "t" or name.startswith(("q[", "qd[", "acting["))]
    values = []
    for line, row in rows:
        try:
            values.append([float(row[k]) for k in wanted])
        except (ValueError, IndexError):
            finding = f"found {abbreviate(','.join(row))}"
            raise InputError([Fault(str(file), line, "", finding, "track the problem again")]) from None
    if not values or header[:1] != ["t"]:
        raise InputError([Fault(str(file), 1, "", "it is no table of a track", "track the problem again")])
    table = np.array(values)
    return Recording(str(file), table[:, 0], tuple(Column(header[k]) for k in wanted[1:]), table[:, 1:])
