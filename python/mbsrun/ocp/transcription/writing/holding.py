"""Holding: the rows of contacts that stand, and the friction that they have."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mbsrun.ocp.ground.functions import Indices, KernelResult
from mbsrun.ocp.ground.program import Block
from mbsrun.ocp.problem import contacts
from mbsrun.ocp.transcription.layout import Places
from mbsrun.ocp.transcription.writing.sheet import Sheet


def hold_contacts(sheet: Sheet, rows: Indices) -> None:
    """Hold contacts at the points of all intervals, rows (N, S, held axes): by velocities, and at the end by place.

    The displacement over an interval takes the place of the velocity at the first point, where there are two.
    """
    N, S, held = rows.shape
    if not held:
        return
    first = 1 if S > 1 else 0
    q, qd = (part[:, first:].reshape(-1, part.shape[2]).T for part in sheet.layout.split(sheet.layout.points))
    places, interval = replace(sheet.points, q=q, qd=qd), np.repeat(np.arange(N), S - first)
    write_contacts(sheet, places, rows[:, first:].reshape(-1, held).T, interval)
    if S > 1:
        write_displacements(sheet, rows[:, 0].T)


def write_displacements(sheet: Sheet, rows: Indices) -> None:
    """Write how far contacts move over each interval, divided by its length: rows are (held axes, N)."""
    layout, first = sheet.layout, 0
    start, end = (layout.split(part)[0].T for part in (layout.mesh[:-1], layout.points[:, -1]))
    for contact in sheet.shape.contacts:
        entries = contacts.list_entries(contact, sheet.manifest)
        function = KernelResult("sensors", ("q",), "position", entries)
        own = rows[first : first + len(entries)]
        for q, sign in ((end, 1.0), (start, -1.0)):
            sheet.blocks.append(Block(function, (q,), own, np.arange(len(sheet.h)), scale=sign / sheet.h))
        first += len(entries)


def write_contacts(sheet: Sheet, places: Places, rows: Indices, stages: Indices) -> None:
    """Hold contacts at some places: rows are (held axes, places)."""
    first = 0
    for contact in sheet.shape.contacts:
        entries = contacts.list_entries(contact, sheet.manifest)
        function = KernelResult("motion", ("q", "qd"), "v", entries)
        own = rows[first : first + len(entries)]
        sheet.blocks.append(Block(function, (places.q, places.qd), own, stages))
        first += len(entries)


def write_contacts_at_start(sheet: Sheet) -> Indices:
    """Hold contacts at a start that is free and that no link gives."""
    shape = sheet.shape
    rows = sheet.take(0, len(sheet.held) * (shape.start_is_free and shape.contacts_hold_at_start))
    if rows.size:
        write_contacts(sheet, sheet.first, rows[:, None], np.zeros(1, dtype=np.int64))
    return rows


def write_friction(sheet: Sheet) -> Indices:
    """Keep the forces of contacts within friction at the points."""
    every = (contacts.write_friction(contact, sheet.manifest) for contact in sheet.shape.contacts)
    texts, places = [text for own in every for text in own], sheet.points
    rows = sheet.take(np.tile(places.interval, (len(texts), 1)), len(texts), places.s.size)
    if texts:
        sheet.blocks.append(sheet.apply(texts, places, rows, places.interval))
    return rows
