"""A solution as a table: Solution and plant -> CSV, a row for each mesh and collocation point, in SI units.

Columns are time, coordinates, velocities, accelerations, inputs, multipliers of closed loops, forces of driven joints,
and positions of sensors in the base frame; then states, integrals and controls of the problem, and any further numbers
that `mbsrun.results` lists. The header names each,
with its unit where that is known. Names of the model are bracketed, so that a spreadsheet reads no cell as a formula.
"""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mbsgen.manifest import Manifest
from mbsrun.metabolics import PRICED
from mbsrun.ocp.ground.plant import Plant
from mbsrun.ocp.ground.schemes import read_basis
from mbsrun.ocp.ground.trajectory import Trajectory
from mbsrun.ocp.problem.design import equip
from mbsrun.ocp.problem.problem import Problem
from mbsrun.ocp.solution.solution import Solution
from mbsrun.quantities import (
    label_forces,
    label_motion,
    label_multipliers,
    list_input_units,
    list_quantities,
    name_components,
)
from mbsrun.results import Numbers

Array = NDArray[np.float64]

SAME = 1e-12  # of an interval: points that are as near to its end are the next mesh point


def measure(solution: Solution, plant: Plant) -> Numbers:
    """Return the numbers of a solution by name, at all mesh and collocation points."""
    trajectory = solution.trajectory
    manifest, parts = plant.manifest, dict(zip(("t", "q", "qd", "qdd", "u"), list_motion(trajectory), strict=True))
    parts |= dict(zip(("states", "controls"), list_additions(trajectory), strict=True))
    forces = (("lam", solution.multipliers), ("tau", solution.driving), ("w", trajectory.point_w))
    parts |= {kind: list_forces(trajectory, x) for kind, x in forces if x is not None and x.size}
    known = list_quantities(manifest, solution.problem.added)
    known = {name: x for name, x in known.items() if x.kind != "w" or "w" in parts}
    if manifest.open_entries:
        parts.setdefault("w", np.zeros((len(parts["t"]), manifest.open_entries)))
    mark = PRICED.format("")
    rates = {x.name.removeprefix(mark): x.expression for x in solution.problem.cost.running if x.name.startswith(mark)}
    return Numbers(equip(plant, solution.problem, trajectory.unknowns), known, parts, rates=rates)


def write_table(solution: Solution, plant: Plant, path: Path, more: Sequence[str] = ()) -> None:
    """Write a solution as CSV, with every digit; `more` are further columns, by names or patterns of `measure`.

    Raises UnknownNameError.
    """
    numbers = measure(solution, plant)
    chosen = numbers.select(more)
    plant = equip(plant, solution.problem, solution.trajectory.unknowns)
    columns = list_motion(solution.trajectory)
    if solution.multipliers is not None:
        columns.append(list_forces(solution.trajectory, solution.multipliers))
    if solution.driving is not None:
        columns.append(list_forces(solution.trajectory, solution.driving))
    columns.append(_place_sensors(solution.trajectory, plant))
    columns += [*list_additions(solution.trajectory), list_wrenches(solution.trajectory)]
    columns += [numbers[name][:, None] for name in chosen]
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        header = _name_columns(plant.manifest) + _name_additions(solution.problem, plant.manifest)
        writer.writerow([*header, *map(numbers.label, chosen)])
        writer.writerows(np.concatenate(columns, axis=1).tolist())


def _name_columns(manifest: Manifest) -> list[str]:
    return [
        "t [s]",
        *label_motion(manifest, rates=2),
        *label_forces(manifest, "u", manifest.actuated),
        *label_multipliers(manifest),
        *label_forces(manifest, "tau", manifest.driven),
        *(f"{axis}[{frame.name}] [m]" for frame in manifest.frames if frame.sensor for axis in "xyz"),
    ]


def _name_additions(problem: Problem, manifest: Manifest) -> list[str]:
    """Name the states and controls that the problem adds, its integrals from the start, and open wrenches."""
    forces = zip(name_components(manifest), list_input_units(manifest)[len(manifest.actuated) :], strict=True)
    return [
        *(f"state[{state.name}]" for state in problem.states),
        *(f"integral[{i}]" for i in range(len(problem.integrals))),
        *(f"control[{control.name}]" for control in problem.controls),
        *(f"w[{name or i}]{f' [{unit}]' if unit else ''}" for i, (name, unit) in enumerate(forces)),
    ]


def list_additions(trajectory: Trajectory) -> list[Array]:
    """List states and controls that a problem adds at all points in order, (rows, size) each."""
    return [
        _join(trajectory, trajectory.states[:-1], trajectory.point_states, trajectory.states[-1]),
        _read_inputs(trajectory, trajectory.controls, trajectory.point_controls),
    ]


def list_motion(trajectory: Trajectory) -> list[Array]:
    """List time, q, qd, qdd and u at all points in order, (rows, size) each.

    Where an interval begins, accelerations and inputs are the interval's; at the end, the last interval's. There they
    are read off the polynomial through the accelerations at the interval's points.
    """
    t = trajectory.t
    return [
        _join(trajectory, t[:-1, None], trajectory.point_t[..., None], t[-1:]),
        _join(trajectory, trajectory.q[:-1], trajectory.point_q, trajectory.q[-1]),
        _join(trajectory, trajectory.qd[:-1], trajectory.point_qd, trajectory.qd[-1]),
        list_forces(trajectory, trajectory.point_qdd),
        _read_inputs(trajectory, trajectory.u, trajectory.point_u),
    ]


def _read_inputs(trajectory: Trajectory, u: Array, points: Array) -> Array:
    """Read inputs at all points in order: constant ones (N, m), at the end the last ones; or polynomials (N, d, m)."""
    if points.size:
        return list_forces(trajectory, points)
    return np.concatenate((np.repeat(u, 1 + int(_find_inner(trajectory).sum()), axis=0), u[-1:]))


def list_wrenches(trajectory: Trajectory) -> Array:
    """List the components of open wrenches at all points in order, (rows, size)."""
    return list_forces(trajectory, trajectory.point_w)


def list_forces(trajectory: Trajectory, points: Array) -> Array:
    """Read accelerations, or forces, that are known at collocation points (N, d, m), at all points in order."""
    nodes = _place_nodes(trajectory)
    first, last = (read_basis(nodes, place) for place in (0.0, 1.0))
    return _join(trajectory, np.einsum("j,kjn->kn", first, points), points, last @ points[-1])


def _join(trajectory: Trajectory, mesh: Array, points: Array, end: Array) -> Array:
    """Put values at the starts of the intervals, at their points, and at the end in order."""
    rows = np.concatenate((mesh[:, None], points[:, _find_inner(trajectory)]), axis=1)
    N, count, size = rows.shape
    return np.concatenate((rows.reshape(N * count, size), end[None]))


def _place_nodes(trajectory: Trajectory) -> Array:
    """Place the points of an interval, from 0 to 1."""
    return np.asarray((trajectory.point_t[0] - trajectory.t[0]) / (trajectory.t[1] - trajectory.t[0]))


def _find_inner(trajectory: Trajectory) -> NDArray[np.bool_]:
    """Find the points of an interval that are no mesh points."""
    nodes = _place_nodes(trajectory)
    return np.asarray((nodes > SAME) & (nodes < 1 - SAME))


def _place_sensors(trajectory: Trajectory, plant: Plant) -> Array:
    q = list_motion(trajectory)[1]
    sensors = [i for i, frame in enumerate(plant.manifest.frames) if frame.sensor]
    if not sensors:
        return np.zeros((len(q), 0))
    p = plant("frames", q=q)["p"][:, :, sensors]  # (rows, 3, sensors)
    return np.asarray(p.transpose(0, 2, 1).reshape(len(q), -1))
