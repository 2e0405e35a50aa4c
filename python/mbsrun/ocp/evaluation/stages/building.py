"""A program as tables of stages: Program and plant -> StageProgram.

`intervals` divides a program into stages and finds the stages that are alike, `lifting` writes the functions of each
kind in its own variables, and `scripts` writes the calls and terms that compute them.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from mbsrun.ocp.evaluation.stages.calls import Signatures
from mbsrun.ocp.evaluation.stages.intervals import Intervals, Triplets, divide, stack
from mbsrun.ocp.evaluation.stages.lifting import Stage, lift
from mbsrun.ocp.evaluation.stages.scripts import Frame, Functions, list_given, write
from mbsrun.ocp.evaluation.stages.tables import StageProgram
from mbsrun.ocp.ground.functions import Indices
from mbsrun.ocp.ground.plant import Plant
from mbsrun.ocp.ground.program import Matrix, Program

Mask = NDArray[np.bool_]


def build(
    program: Program,
    plant: Plant,
    weights: Mask | None = None,
    rows: Mask | None = None,
    others: tuple[Plant, ...] = (),
) -> StageProgram:
    """Build the tables of a program; `others` are plants beside plant 0.

    `weights` marks the terms of the cost that are not 0, `rows` the rows that have a bound; all by default.
    """
    weights = np.ones(len(program.H), dtype=bool) if weights is None else weights
    rows = np.ones(program.constraints, dtype=bool) if rows is None else rows
    intervals = divide(program, weights, rows)
    stages = [lift(functions) for functions in intervals.kinds]
    signatures, functions = Signatures((plant, *others)), Functions()
    for stage in stages:
        list_given(stage.uses, signatures, functions)
    given = tuple(functions.given)
    frame = Frame(
        program.parameters, sum(part.size for part in given), intervals.numbers.shape[1], signatures, functions
    )
    kinds = tuple(write(stage, frame, stage.ne) for stage in stages)
    variables = _list_variables(intervals, stages)
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
        rows_e=_list_rows(intervals, [stage.rows_e for stage in stages]),
        rows_d=_list_rows(intervals, [stage.rows_d for stage in stages]),
        rows_g=np.concatenate([np.zeros(0, dtype=np.int64), *intervals.others]),
        fixed=np.array(fixed, dtype=np.int64).reshape(-1, 2),
        lifted=np.flatnonzero(variables < 0),
        lifted_rows=_find_lifted_rows(intervals, stages),
        combined=_find_combined(intervals, stages),
    )


def _find_combined(intervals: Intervals, stages: list[Stage]) -> Matrix:
    """Return the coefficients of the lifted variables that are combinations."""
    first, found = 0, list[Triplets]()
    for kind in intervals.kind_of_stage:
        own = stages[kind].combined
        found.append(Triplets(first + own.row, first + own.col, own.value))
        first += len(stages[kind].variables)
    every = stack(found)
    return sparse.coo_array((every.value, (every.row, every.col)), shape=(first, first)).tocsc()


def _list_variables(intervals: Intervals, stages: list[Stage]) -> Indices:
    """Return the program's variable of each variable of the tables; -1: none."""
    chain, found = intervals.chain, []
    for k, kind in enumerate(intervals.kind_of_stage):
        part, numbering = chain.parts[k], intervals.kinds[kind].numbering
        before = chain.parts[k - 1].inputs if k else np.zeros(0, dtype=np.int64)
        universe = np.concatenate(
            (
                part.states,
                chain.common,
                chain.copied,
                before if before.size == numbering.carried else np.full(numbering.carried, -1),
                part.inner,
                part.inputs,
                chain.parts[k + 1].states if numbering.following else np.zeros(0, dtype=np.int64),
                [-1],
            )
        )
        found.append(universe[stages[kind].variables])
    return np.concatenate(found)


def _list_rows(intervals: Intervals, rows: list[Indices]) -> Indices:
    """Return the program's row of each equation of the intervals, or of the dynamics; -1: none."""
    found = []
    for k, kind in enumerate(intervals.kind_of_stage):
        part = intervals.chain.parts[k]
        own = np.concatenate((part.equations, part.continuity, [-1]))
        found.append(own[rows[kind]])
    return np.concatenate(found)


def _mark_copies(variables: Indices, intervals: Intervals, stages: list[Stage]) -> Indices:
    """Return the variables, with -1 for copies: common ones after the first stage, copied states, carried inputs, and
    next states.
    """
    is_copy = []
    for k, kind in enumerate(intervals.kind_of_stage):
        local, numbering = stages[kind].variables, intervals.kinds[kind].numbering
        first = numbering.states + (intervals.chain.common.size if k == 0 else 0)
        shared = (local >= first) & (local < numbering.before)
        carried = (local >= numbering.before) & (local < numbering.inside)
        is_copy.append(shared | carried | (local >= numbering.after))
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
