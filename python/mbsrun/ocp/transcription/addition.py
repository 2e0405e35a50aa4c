"""The direct sum of programs: independent problems side by side, as one program.

    x = (x_1, x_2, ...),    g(x) = (g_1(x_1), g_2(x_2), ...),    f(x) = f_1(x_1) + f_2(x_2) + ...

Variables and rows of program k are moved behind the ones of program k - 1. The weights of all programs come first among
the parameters, then all constants. Rows and costs that link the programs are added at the end.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse

from mbsrun.ocp.ground.functions import Array
from mbsrun.ocp.ground.program import Block, Chain, Column, Matrix, Program, Solved, Stages


@dataclass(frozen=True)
class Offsets:
    """Where a program begins in the sum."""

    variables: int
    rows: int
    weights: int
    constants: int  # among all parameters
    stages: int = 0


@dataclass(frozen=True)
class Summand:
    """A program and the number of its plant."""

    program: Program
    plant: int


@dataclass(frozen=True)
class Further:
    """Variables, rows and parameters behind the ones of all programs."""

    variables: int
    constants: int
    A: Matrix  # (rows, all variables)
    blocks: tuple[Block, ...]  # in variables, rows and parameters of the sum
    weights: int = 0  # terms of the cost
    costs: tuple[Block, ...] = ()


def place_summands(programs: Sequence[Program], further: int = 0) -> tuple[Offsets, ...]:
    """Return where each program begins, and last where further parts do, which have some weights."""
    weights = sum(len(program.H) for program in programs) + further
    found = [Offsets(0, 0, 0, weights)]
    for program in programs:
        last = found[-1]
        found.append(
            Offsets(
                last.variables + program.variables,
                last.rows + program.constraints,
                last.weights + len(program.H),
                last.constants + program.constants,
                last.stages + count_stages(program),
            )
        )
    return tuple(found)


def count_stages(program: Program) -> int:
    """Count the stages of a program, its end included."""
    return 0 if program.stages is None else len(program.stages.states)


def add(summands: Sequence[Summand], further: Further, chain: Chain | None = None) -> Program:
    """Write the sum as one program, with its stages if they are known."""
    programs = [summand.program for summand in summands]
    offsets = place_summands(programs, further.weights)
    size = offsets[-1].variables + further.variables
    own = sparse.block_diag([program.A for program in programs], format="csc")
    wide = sparse.hstack([own, sparse.csc_array((own.shape[0], further.variables))])
    blocks: list[Block] = []
    costs: list[Block] = []
    for summand, offset in zip(summands, offsets, strict=False):
        program = summand.program
        for found, given, row in ((blocks, program.blocks, offset.rows), (costs, program.costs, offset.weights)):
            found += [_move(block, offset, row, len(program.H), summand.plant) for block in given]
    return Program(
        A=sparse.csc_array(sparse.vstack([wide, further.A])),
        H=tuple(
            _spread(H, offset.variables, size)
            for program, offset in zip(programs, offsets, strict=False)
            for H in program.H
        )
        + (sparse.csc_array((size, size)),) * further.weights,
        blocks=(*blocks, *further.blocks),
        costs=(*costs, *further.costs),
        constants=sum(program.constants for program in programs) + further.constants,
        chain=chain,
        solved=tuple(
            Solved(_move_stages(part.stages, offset), summand.plant)
            for summand, offset in zip(summands, offsets, strict=False)
            for part in summand.program.solved
        ),
    )


def _move_stages(stages: Stages, offset: Offsets) -> Stages:
    """Move the variables and rows of intervals behind other programs."""
    return replace(
        stages,
        states=stages.states + offset.variables,
        inputs=stages.inputs + offset.variables,
        inner=stages.inner + offset.variables,
        equations=stages.equations + offset.rows,
        continuity=stages.continuity + offset.rows,
        common=stages.common + offset.variables,
        rows=stages.rows + offset.stages,
    )


def add_parameters(
    offsets: Sequence[Offsets], parts: Sequence[Array], further: Sequence[float], weights_of_links: Sequence[float] = ()
) -> Array:
    """Put the parameters of all programs in the order of the sum."""

    def split() -> Iterator[tuple[Array, Array]]:
        for part, here, after in zip(parts, offsets, offsets[1:], strict=False):
            weights = after.weights - here.weights
            yield part[:weights], part[weights:]

    weights, constants = zip(*split(), strict=True)
    links, own = (np.asarray(numbers, dtype=np.float64) for numbers in (weights_of_links, further))
    return np.concatenate([*weights, links, *constants, own])


def _move(block: Block, offset: Offsets, row: int, weights: int, plant: int) -> Block:
    """Move a block behind others."""
    assert not block.parameters.size or block.parameters.min() >= weights, "functions read constants alone"
    return replace(
        block,
        columns=tuple(move_part(part, offset.variables) for part in block.columns),
        rows=block.rows + row,
        stages=block.stages + offset.stages,
        parameters=block.parameters + (offset.constants - weights),
        factor=None if block.factor is None else block.factor + offset.variables,
        plant=plant,
    )


def move_part(part: Column, variables: int) -> Column:
    """Move the variables of a part behind others."""
    return part + variables if isinstance(part, np.ndarray) else replace(part, variables=part.variables + variables)


def _spread(H: Matrix, first: int, size: int) -> Matrix:
    """Place a matrix on the diagonal of a larger one."""
    coo = H.tocoo()
    row, col = (np.asarray(k, dtype=np.int64) + first for k in coo.coords)
    return sparse.coo_array((coo.data, (row, col)), shape=(size, size)).tocsc()
