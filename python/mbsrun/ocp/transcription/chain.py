"""The stages of a problem of phases, one after the other: phases and links -> Chain.

Phase after phase, each with its own stages. The end of a phase has the variables of the links that leave it as inputs,
and their rows. The states at the start of the next phase are open there: only the rows decide. Durations and unknowns
are common to all stages. A link to another phase than the next one, as of a periodic motion, reads copies of the states
at that phase's start; copies are common as well.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from mbsrun.ocp.ground.functions import Indices
from mbsrun.ocp.ground.program import Block, Chain, Matrix, Part, Program
from mbsrun.ocp.transcription.addition import Offsets

_NOTHING: Indices = np.zeros(0, dtype=np.int64)


@dataclass(frozen=True)
class Joint:
    """A link between the ends of phases: its variables and rows, and its terms of the cost."""

    source: int
    target: int
    variables: Indices
    rows: Indices
    terms: Indices


@dataclass(frozen=True)
class Joined:
    """The rows of links, and the functions that they hold; all in numbers of the sum."""

    A: Matrix  # (rows of links, all variables)
    blocks: tuple[Block, ...]
    costs: tuple[Block, ...]
    first: int  # the number of the first row


def order_stages(
    programs: Sequence[Program], offsets: Sequence[Offsets], joints: Sequence[Joint], joined: Joined
) -> Chain | Indices:
    """Return the stages; or rows that no stage can have: they read the inside of an interval, or inputs at a start.

    Terms of the cost are listed as negative rows, -1 the first one.
    """
    parts: list[Part] = []
    shared, rows = [], []
    for k, (program, offset) in enumerate(zip(programs, offsets, strict=False)):
        stages = program.stages
        assert stages is not None, "the program of a phase has stages"
        leaving = [joint for joint in joints if joint.source == k]
        *intervals, close = (_move(part, offset) for part in stages.chain.parts)
        inputs = np.concatenate([_NOTHING, *(joint.variables for joint in leaving)])
        own = np.concatenate([_NOTHING, *(joint.rows for joint in leaving)])
        terms = np.concatenate([_NOTHING, *(joint.terms for joint in leaving)])
        parts += [*intervals, Part(close.states, inputs, _NOTHING, _NOTHING, _NOTHING, own, terms)]
        shared.append(stages.common + offset.variables)
        rows.append(stages.rows + offset.stages)
    size, last = joined.A.shape[1], offsets[-1]
    taken = np.concatenate([_NOTHING, *(joint.variables for joint in joints)])
    common = np.concatenate([*shared, np.setdiff1d(np.arange(last.variables, size), taken)])
    rows.append(np.full(joined.A.shape[0], len(parts) - 1))
    reads = _list_reads(joined)
    copied, astray = _NOTHING, _NOTHING
    for joint in joints:
        end, next_start = offsets[joint.source + 1].stages - 1, offsets[joint.target].stages
        states = parts[next_start].states
        known = [common, joint.variables, parts[end].states, parts[end - 1].inputs, states]
        of_joint = np.isin(reads[0], np.concatenate((joint.rows, -1 - joint.terms)))
        row, read = (part[of_joint] for part in reads)
        astray = np.union1d(astray, row[~np.isin(read, np.concatenate(known))])
        if joint.target != joint.source + 1:
            copied = np.union1d(copied, np.intersect1d(read, np.setdiff1d(states, parts[end].states)))
    return astray if astray.size else Chain(tuple(parts), common, np.concatenate(rows), copied)


def _move(part: Part, offset: Offsets) -> Part:
    """Move a stage behind other programs."""
    first, row = offset.variables, offset.rows
    return Part(
        part.states + first, part.inputs + first, part.inner + first, part.equations + row, part.continuity + row
    )


def _list_reads(joined: Joined) -> tuple[Indices, Indices]:
    """List the pairs of a row of links, or of a term as a negative one, and a variable that it reads."""
    A = sparse.coo_array(joined.A)
    rows, variables = [A.coords[0].astype(np.int64) + joined.first], [A.coords[1].astype(np.int64)]
    every = [(block, block.rows) for block in joined.blocks] + [(block, -1 - block.rows) for block in joined.costs]
    for block, numbers in every:
        parts = [part if isinstance(part, np.ndarray) else part.variables.T for part in block.columns]
        read = np.unique(np.concatenate([part.ravel() for part in parts]))
        for row in numbers.ravel():
            rows.append(np.full(read.size, row))
            variables.append(read)
    return np.concatenate(rows), np.concatenate(variables)
