"""A program as tables of stages: Program and plant -> StageProgram.

`intervals` divides a program into stages and finds the stages that are alike, `lifting` writes the functions of each
kind in its own variables, and `scripts` writes the calls and terms that compute them.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mbsrun.ocp.functions import Indices
from mbsrun.ocp.plant import Plant
from mbsrun.ocp.program import Program
from mbsrun.ocp.stages.calls import Signatures
from mbsrun.ocp.stages.intervals import Intervals, divide
from mbsrun.ocp.stages.lifting import Stage, lift
from mbsrun.ocp.stages.scripts import Frame, Functions, list_given, write
from mbsrun.ocp.stages.tables import StageProgram

Mask = NDArray[np.bool_]


def build(program: Program, plant: Plant, weights: Mask | None = None, rows: Mask | None = None) -> StageProgram:
    """Build the tables of a program.

    `weights` marks the terms of the cost that are not 0, `rows` the rows that have a bound; all by default.
    """
    weights = np.ones(len(program.H), dtype=bool) if weights is None else weights
    rows = np.ones(program.constraints, dtype=bool) if rows is None else rows
    intervals = divide(program, weights, rows)
    stages = [lift(functions, intervals.numbering) for functions in intervals.kinds]
    signatures, functions = Signatures(plant), Functions()
    for stage in stages:
        list_given(stage.uses, signatures, functions)
    given = tuple(functions.given)
    frame = Frame(
        program.parameters, sum(part.size for part in given), intervals.numbers.shape[1], signatures, functions
    )
    kinds = tuple(write(stage, frame, stage.ne) for stage in stages)
    variables = _list_variables(program, intervals, stages)
    first = stages[intervals.kind_of_stage[0]]
    at = {int(local): i for i, local in enumerate(first.variables[: first.nx])}
    fixed = [(at[int(state)], int(row)) for state, row in intervals.fixed]
    return StageProgram(
        kinds=kinds,
        kind_of_stage=intervals.kind_of_stage,
        functions=tuple(functions.called),
        parameters=program.parameters,
        given=given,
        numbers=intervals.numbers,
        variables=variables,
        bounded=_mark_copies(variables, intervals, stages),
        rows_e=_list_rows(program, intervals, [stage.rows_e for stage in stages]),
        rows_d=_list_rows(program, intervals, [stage.rows_d for stage in stages]),
        rows_g=np.concatenate([np.zeros(0, dtype=np.int64), *intervals.others]),
        fixed=np.array(fixed, dtype=np.int64).reshape(-1, 2),
        lifted=np.flatnonzero(variables < 0),
        lifted_rows=_find_lifted_rows(intervals, stages),
    )


def _list_variables(program: Program, intervals: Intervals, stages: list[Stage]) -> Indices:
    """Return the program's variable of each variable of the tables; -1: none."""
    data = program.stages
    assert data is not None, "a program in stages"
    N, none = len(data.inputs), np.full(intervals.numbering.inputs, -1)
    found = []
    for k, kind in enumerate(intervals.kind_of_stage):
        universe = np.concatenate(
            (
                data.states[k],
                data.common,
                data.inputs[k - 1] if k else none,
                data.inner[k].ravel() if k < N else np.full(intervals.numbering.inner, -1),
                data.inputs[k] if k < N else none,
                data.states[k + 1] if k < N else np.full(intervals.numbering.states, -1),
                [-1],
            )
        )
        found.append(universe[stages[kind].variables])
    return np.concatenate(found)


def _list_rows(program: Program, intervals: Intervals, rows: list[Indices]) -> Indices:
    """Return the program's row of each equation of the intervals, or of the dynamics; -1: none."""
    data = program.stages
    assert data is not None, "a program in stages"
    found = []
    for k, kind in enumerate(intervals.kind_of_stage):
        if k < len(data.inputs):
            own = np.concatenate((data.equations[k].ravel(), data.continuity[k], [-1]))
            found.append(own[rows[kind]])
        else:
            found.append(np.full(rows[kind].size, -1))
    return np.concatenate(found)


def _mark_copies(variables: Indices, intervals: Intervals, stages: list[Stage]) -> Indices:
    """Return the variables, with -1 for copies: common ones after the first stage, carried inputs, next states."""
    numbering = intervals.numbering
    is_copy = []
    for k, kind in enumerate(intervals.kind_of_stage):
        local = stages[kind].variables
        common = (local >= numbering.states) & (local < numbering.before) & (k > 0)
        carried = (local >= numbering.before) & (local < numbering.inside)
        is_copy.append(common | carried | (local >= numbering.after))
    return np.where(np.concatenate(is_copy), -1, variables)


def _find_lifted_rows(intervals: Intervals, stages: list[Stage]) -> Indices:
    """Return the equations of lifted variables."""
    first, found = 0, [np.zeros(0, dtype=np.int64)]
    for kind in intervals.kind_of_stage:
        stage = stages[kind]
        count = int((stage.variables[stage.nx :] < 0).sum())
        found.append(first + np.arange(stage.ne - count, stage.ne))
        first += stage.ne
    return np.concatenate(found)
