"""Constraints: the rows of expressions, and of the rates of inputs."""

from __future__ import annotations

from collections.abc import Mapping, Set

import numpy as np

from mbsrun.ocp.ground import formulas
from mbsrun.ocp.ground.functions import Indices
from mbsrun.ocp.ground.program import Block
from mbsrun.ocp.problem.problem import list_names
from mbsrun.ocp.problem.structure import Structure
from mbsrun.ocp.transcription.layout import Places, at_mesh
from mbsrun.ocp.transcription.quantities import Quantity, list_quantities
from mbsrun.ocp.transcription.writing.cost import find_steps
from mbsrun.ocp.transcription.writing.sheet import Sheet
from mbsrun.quantities import SENSED


def write_constraints(sheet: Sheet) -> tuple[Indices, ...]:
    """Write the constraints by expressions; those at the same places are one function."""
    N, shape = sheet.shape.intervals, sheet.shape
    kinds = list_quantities(sheet.manifest, shape.added)
    inner = [] if sheet.scheme.ends_interval else [*range(1, N + 1)]
    on_path = _choose(shape, "path")
    read = {i: list_names(shape.constraints[i][0], shape.functions) for i in on_path}
    of_states = [i for i in on_path if not _reads_jumps(read[i], kinds)]
    first = [i for i in of_states if _may_change_at_start(read[i], kinds, shape)]
    given = [i for i in of_states if i not in first]
    rows: list[list[Indices]] = [[] for _ in shape.constraints]
    mesh = [(x, at_mesh(sheet.layout, sheet.integrator, k)) for x, k in ((first, [0, *inner]), (given, inner))]
    points, later = _list_points(sheet, on_path, of_states)
    for chosen, places, stages in (
        *((x, at, at.interval) for x, at in points),
        *((x, at, at.stage) for x, at in (*later, *mesh)),
        *((_choose(shape, end), at, at.interval) for end, at in (("start", sheet.first), ("end", sheet.last))),
    ):
        if chosen and places.s.size:
            taken = sheet.take(np.tile(stages, len(chosen)).reshape(len(chosen), -1), len(chosen), places.s.size)
            sheet.blocks.append(sheet.apply([shape.constraints[i][0] for i in chosen], places, taken, stages))
            for i, row in zip(chosen, taken, strict=True):
                rows[i].append(row)
    return tuple(np.concatenate(parts) for parts in rows)


_Points = list[tuple[list[int], Places]]


def _list_points(sheet: Sheet, on_path: list[int], of_states: list[int]) -> tuple[_Points, _Points]:
    """List constraints with their points; constraints of states skip the first point of an interval, a mesh point.

    The second list has the constraints that do.
    """
    if not sheet.scheme.begins_interval:
        return [(on_path, sheet.points)], []
    N, d = sheet.shape.intervals, sheet.scheme.degree
    later = np.arange(N * d).reshape(N, d)[:, 1:].ravel()
    jumping = [i for i in on_path if i not in of_states]
    return [(jumping, sheet.points)], [(of_states, sheet.points.restrict(later))]


def _choose(shape: Structure, place: str) -> list[int]:
    """Return the constraints that hold at a place."""
    return [i for i, (_, at) in enumerate(shape.constraints) if at == place]


def write_input_rates(sheet: Sheet) -> Indices:
    """Write the differences of constant inputs over time whose ranges are bounded: between midpoints."""
    layout, shape, N = sheet.layout, sheet.shape, sheet.shape.intervals
    inputs = layout.inputs[:, [layout.extras.free.index(i) for i in shape.rated_inputs]]
    rated = np.concatenate((inputs, layout.extras.controls[:, list(shape.rated_controls)]), axis=1)
    count, steps = rated.shape[1], find_steps(sheet.h)
    rows = sheet.take(np.arange(N - 1), N - 1, count)
    if not rows.size:
        return rows
    before, after = rated[:-1], rated[1:]
    if layout.horizon is None:
        sheet.A.put(rows, after, 1 / steps[:, None])
        sheet.A.put(rows, before, -1 / steps[:, None])
    else:
        columns = (before.T, after.T, np.full((1, N - 1), layout.horizon))
        sheet.blocks.append(Block(formulas.find_rates(count), columns, rows.T, np.arange(N - 1), scale=1 / steps))
    return rows


def _reads_jumps(read: Set[str], known: Mapping[str, Quantity]) -> bool:
    """Return whether an expression reads inputs or accelerations, which jump where an interval ends."""
    return any(known[name].kind in ("u", "qdd", "w", "tau", "controls") for name in read if name in known)


def _may_change_at_start(read: Set[str], known: Mapping[str, Quantity], shape: Structure) -> bool:
    """Return whether a number of states is not given at the start: it reads what is free there."""
    if shape.start_is_free:
        return True
    own = [known[name] for name in read if name in known]
    is_free = any(x.kind in ("T", "unknowns") or (x.kind == "states" and x.index in shape.starting) for x in own)
    return is_free or (bool(shape.added.unknowns) and any(x.kind in SENSED for x in own))
