"""A program whose last interval is at rest -> the same program without limits that its end implies.

The end has no velocities and no accelerations, and inputs are constant over an interval. So the interval is at rest:
with its states replaced by the state at the end, and its accelerations by 0, its equations hold. If a limit holds a
coordinate at the end, it holds it at all nodes of the interval: rows of one meaning, whose multipliers are not unique.
Their limits are dropped, except at the end. `proof` shows that near the optimum no other motion meets the equations.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from benchmarks.proofs.proof import Indices, Nonlinear, Rest
from mbsrun.ocp.ground.program import Block, Matrix, Program
from mbsrun.ocp.problem.problem import Problem
from mbsrun.ocp.transcription.layout import Layout

Array = NDArray[np.float64]
Row = Mapping[int, Fraction]

CANCELLED = 1e-12  # a sum of this part of its largest term is 0, apart from roundings


def balance(A: Matrix, layout: Layout) -> Matrix:
    """Round the coefficients that differentiate a number of the state, so that a constant has the derivative 0.

    In doubles, they sum to 0 apart from roundings, so no motion would be at rest exactly.
    """
    entries, extras = np.full(A.shape[1], -1), layout.extras
    for states in (layout.mesh, layout.points):
        entries[states] = np.arange(states.shape[-1])
    for states in (extras.states, extras.point_states):
        entries[states] = layout.mesh.shape[-1] + np.arange(states.shape[-1])
    rows = sparse.csr_array(A, copy=True)
    for row in range(A.shape[0]):
        lot = np.arange(rows.indptr[row], rows.indptr[row + 1])
        of = entries[rows.indices[lot]]
        for places in (lot[of == entry] for entry in np.unique(of[of >= 0])):
            values = rows.data[places]
            if len(places) > 2 and abs(values.sum()) < CANCELLED * abs(values).max():
                rows.data[places] = _round(values)
    return Matrix(rows)


def _round(values: Array) -> Array:
    """Round to multiples of one number, and let the largest be less the sum of the others; both are exact."""
    unit = 2.0 ** (np.ceil(np.log2(abs(values).max())) - 50)
    rounded, largest = np.round(values / unit) * unit, abs(values).argmax()
    rounded[largest] = -np.delete(rounded, largest).sum()
    return np.asarray(rounded)


def find_rest(problem: Problem, program: Program, layout: Layout) -> Rest | None:
    """Find the numbers of the last interval that equal others at the end, and the rows that give them."""
    end, stages = problem.end, program.stages
    is_at_rest = end.velocity_zero and end.acceleration_zero and problem.inputs == "constant"
    if not (is_at_rest and stages is not None and layout.points.size and layout.accelerations.size):
        return None
    count, last, zero = layout.points.shape[2], layout.points[-1, -1], layout.accelerations[-1, -1]
    states = np.concatenate((layout.points[-2, -1:], layout.mesh[-2:-1], layout.points[-1, :-1]))
    accelerations = layout.accelerations[-1, :-1]
    equations = stages.equations[-1]
    rows = (stages.continuity[-2], equations[:, :count].ravel(), equations[:-1, count:].ravel())
    ends = (np.tile(last, len(states)), np.tile(zero, len(accelerations)))
    rest = Rest(np.append(states, accelerations), np.concatenate(ends), np.concatenate(rows))
    given = dict(zip(rows[2].tolist(), np.tile(equations[-1, count:], len(accelerations)).tolist(), strict=True))
    return rest if _holds(rest, given, program, np.append(last[layout.nq :], zero)) else None


def _holds(rest: Rest, given: Mapping[int, int], program: Program, zeros: Indices) -> bool:
    """Return whether rest meets the rows: they become rows of the end, as `given` maps them, or sums of zeros."""
    at = np.arange(program.variables)
    at[rest.variables] = rest.ends
    A, known = sparse.csr_array(program.A), set(zeros.tolist())
    for row in rest.rows.tolist():
        sums = _collapse(A, row, at)
        if row in given:
            same = given[row]
            if sums != _collapse(A, same, at) or list(_list_parts(program, row, at)) != list(
                _list_parts(program, same, at)
            ):
                return False
        elif not sums.keys() <= known or any(True for _ in _list_parts(program, row, at)):
            return False
    return True


def _collapse(A: sparse.csr_array, row: int, at: Indices) -> Row:
    """Return the coefficients of a row after the replacement, in rational numbers, without zeros."""
    sums: dict[int, Fraction] = {}
    for e in range(A.indptr[row], A.indptr[row + 1]):
        k = int(at[A.indices[e]])
        sums[k] = sums.get(k, Fraction(0)) + Fraction(float(A.data[e]))
    return {k: value for k, value in sums.items() if value}


def _list_parts(program: Program, row: int, at: Indices) -> Iterator[tuple[object, ...]]:
    """List what blocks add to a row, after the replacement."""
    for number, block in enumerate(program.blocks):
        for entry, place in np.argwhere(block.rows == row).tolist():
            yield number, entry, *_describe(block, place, at)


def _describe(block: Block, place: int, at: Indices) -> tuple[object, ...]:
    columns = []
    for part in block.columns:
        if not isinstance(part, np.ndarray):
            return (place,)  # no other place equals it
        columns += at[part[:, place]].tolist()
    data = () if block.data is None else tuple(block.data[:, place].tolist())
    return (float(block.scales[place]), block.factor, data, *columns)


def drop_limits(program: Nonlinear, rest: Rest | None) -> Nonlinear:
    """Drop the limits of numbers that equal others at the end with the same limits, or without any."""
    if rest is None:
        return program
    lower, upper = program.lower.copy(), program.upper.copy()
    lower[rest.variables], upper[rest.variables] = -np.inf, np.inf
    return replace(program, lower=lower, upper=upper, rest=rest)
