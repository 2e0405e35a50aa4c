"""Ends: the rows of the start and of the end."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mbsrun.ocp.ground import formulas
from mbsrun.ocp.ground.functions import Fixed, Function, Indices, KernelResult
from mbsrun.ocp.ground.program import Block, Column, Combination
from mbsrun.ocp.problem.structure import Structure
from mbsrun.ocp.transcription.writing.sheet import Sheet, pick
from mbsrun.quaternions import Quaternion, neutral


def write_lengths(sheet: Sheet) -> Indices:
    """Write the squared lengths of quaternions at the start, where that may be free."""
    chosen = sheet.quaternions if sheet.shape.start_is_free else ()
    rows = sheet.take(0, len(chosen))
    if chosen:
        columns = np.stack([sheet.layout.mesh[0, quaternion.entries] for quaternion in chosen], axis=1)
        stages = np.zeros(len(chosen), dtype=np.int64)
        sheet.blocks.append(Block(formulas.measure_length(), (columns,), rows[None], stages))
    return rows


def write_attitudes(sheet: Sheet, q: Indices) -> Indices:
    """Compare quaternions at the end with targets, which are parameters."""
    targets = find_targets(sheet.shape, sheet.quaternions)
    rows = sheet.take(sheet.shape.intervals, len(targets), 3)
    for row, quaternion in zip(rows, targets, strict=True):
        parameters = sheet.parameters + np.arange(4)
        write_end(sheet, formulas.compare_attitudes(), (q[quaternion.entries, None],), row, parameters)
        sheet.parameters += 4
    return rows


def write_end(
    sheet: Sheet, function: Function, columns: tuple[Column, ...], row: Indices, parameters: Indices | None = None
) -> None:
    """Apply a function of the state at the end."""
    stage = np.array([sheet.shape.intervals])
    block = Block(function, columns, row[:, None], stage)
    sheet.blocks.append(block if parameters is None else replace(block, parameters=parameters))


def write_sensors(sheet: Sheet, sensors: Sequence[tuple[KernelResult, tuple[Column, ...]]]) -> Indices:
    """Write functions of the state at the end that have three results."""
    rows = sheet.take(sheet.shape.intervals, len(sensors), 3)
    for row, (function, columns) in zip(rows, sensors, strict=True):
        write_end(sheet, function, columns, row)
    return rows


def find_position(sheet: Sheet, name: str) -> tuple[KernelResult, tuple[Column, ...]]:
    """Return the position of a sensor at the end as a function of the coordinates that move it."""
    entries = find_entries(sheet, name)
    (pattern,) = (a for a in sheet.plant.describe("jac_sensors").outputs if a.name == "jac_position_q")
    moving = tuple(range(pattern.cols))
    if pattern.colind is not None and pattern.row is not None:
        columns = np.repeat(np.arange(pattern.cols), np.diff(pattern.colind))
        moving = tuple(int(j) for j in np.unique(columns[np.isin(pattern.row, entries)]))
    fixed = Fixed(moving, tuple(neutral(sheet.manifest).tolist()))
    q, _ = sheet.layout.split(sheet.layout.mesh[-1])
    return KernelResult("sensors", ("q",), "position", entries, fixed), (q[list(moving), None],)


def find_velocity(sheet: Sheet, name: str) -> tuple[KernelResult, tuple[Column, ...]]:
    """Return the velocity of a sensor at the end."""
    q, qd = sheet.layout.split(sheet.layout.mesh[-1])
    return KernelResult("motion", ("q", "qd"), "v", find_entries(sheet, name)), (q[:, None], qd[:, None])


def find_entries(sheet: Sheet, name: str) -> tuple[int, ...]:
    """Find the three entries of a sensor among the entries of all sensors."""
    first = 3 * [frame.name for frame in sheet.manifest.frames if frame.sensor].index(name)
    return (first, first + 1, first + 2)


def write_accelerations(sheet: Sheet, which: Sequence[int]) -> Indices:
    """Write some accelerations at the end, which is read off the last interval."""
    rows, end = sheet.take(sheet.shape.intervals - 1, len(which)), sheet.last
    if which and not sheet.equations.has_accelerations:
        kernel = sheet.choose_accelerations(which)
        sheet.blocks.append(Block(kernel, pick(end, kernel), rows[:, None], end.interval))
    elif which:
        assert isinstance(end.qdd, Combination), "accelerations at mesh points are read off others"
        sheet.A.put_part(rows[None], end.qdd, [sheet.motions.moved.index(i) for i in which])
    return rows


def find_targets(shape: Structure, quaternions: Sequence[Quaternion]) -> list[Quaternion]:
    """Find the quaternions that must have an attitude at the end; each is named whole."""
    return [quaternion for quaternion in quaternions if quaternion.first in shape.coordinates]
