"""Closures: the rows that close loops, and that move driven joints as given."""

from __future__ import annotations

import numpy as np

from mbsrun.ocp.ground import formulas
from mbsrun.ocp.ground.functions import Indices
from mbsrun.ocp.ground.program import Block
from mbsrun.ocp.problem.driving import derive
from mbsrun.ocp.transcription import closing
from mbsrun.ocp.transcription.layout import Places
from mbsrun.ocp.transcription.writing.sheet import Sheet


def write_closure(sheet: Sheet, places: Places, rows: Indices, stages: Indices) -> None:
    """Close the loops at some places, and move driven joints there: rows are (equations, places).

    Lengths of quaternions follow the loops; coordinates and velocities of driven joints are the last.
    """
    if not rows.size:
        return
    write_motions(sheet, places, rows[sheet.loop_rows :], stages)
    m, count = len(sheet.manifest.dependent), sheet.closing_rows
    sheet.blocks += closing.close(places, [rows[i : i + m] for i in range(0, count, m or 1)], stages)
    for row, first in zip(rows[count:], sheet.motions.lengths, strict=False):  # a start has other rows for these
        entries = range(first, first + 4)
        q = places.q[list(entries)] if isinstance(places.q, np.ndarray) else places.q.pick(entries)
        sheet.blocks.append(Block(formulas.fix_length(), (q,), row[None], stages))


def write_start_closure(sheet: Sheet) -> Indices:
    """Close the loops at a start that is free."""
    rows = sheet.take(0, sheet.closing_rows * sheet.shape.start_is_free)
    write_closure(sheet, sheet.first, rows[:, None], np.zeros(1, dtype=np.int64))
    return rows


def write_driven_start(sheet: Sheet) -> Indices:
    """Start driven joints as their motions do."""
    rows = sheet.take(0, len(sheet.motions.driven_states))
    write_motions(sheet, sheet.first, rows[:, None], np.zeros(1, dtype=np.int64))
    return rows


def write_motions(sheet: Sheet, places: Places, rows: Indices, stages: Indices) -> None:
    """Set coordinates and velocities of driven joints at some places: rows are (2 d, places)."""
    if not rows.size:
        return
    motions, (q, qd) = sheet.motions, (places.q, places.qd)
    assert isinstance(q, np.ndarray), "states at all places are variables"
    assert isinstance(qd, np.ndarray), "states at all places are variables"
    velocities = [motions.velocities.index(i) for i in motions.driven]
    sheet.A.put(rows, np.concatenate((q[list(motions.driven_places)], qd[velocities])), 1.0)
    orders = list(zip(*map(derive, sheet.shape.driven), strict=True))
    sheet.blocks.append(sheet.apply([*orders[0], *orders[1]], places, rows, stages, -1.0))


def write_corrections(sheet: Sheet, states: Indices) -> None:
    """Correct the derivatives of coordinates, and of velocities where the equations of motion are explicit."""
    corrections, motions, m = sheet.layout.corrections, sheet.motions, len(sheet.manifest.dependent)
    if not corrections.size:
        return
    q, interval = sheet.points.q, sheet.points.interval
    places, velocities, first, second = (
        part.reshape(interval.size, part.shape[2]).T
        for part in (*np.split(states, [len(motions.places)], axis=2), *np.split(corrections, [m], axis=2))
    )
    sheet.blocks += closing.correct_places(q, first, places, interval, sheet.manifest, motions.places)
    if second.size:
        entries = motions.independent if motions.driven else None
        sheet.blocks.append(closing.correct(q, second, velocities, interval, entries))
