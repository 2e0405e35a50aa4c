"""The direct sum of programs: matrices on the diagonal, and each function where its program begins."""

from __future__ import annotations

from dataclasses import replace
from typing import cast

import numpy as np
from scipy import sparse
from scipy.linalg import block_diag

from mbsrun.ocp.ground.functions import Function
from mbsrun.ocp.ground.program import Block, Chain, Combination, Part, Program, Solved, Stages
from mbsrun.ocp.transcription.addition import (
    Further,
    Offsets,
    Summand,
    add,
    add_parameters,
    count_stages,
    move_part,
    place_summands,
)

NONE = cast(Function, None)  # no law here calls a function


def make_stages(intervals: int) -> Stages:
    """Make stages of two states, one input and one inner variable; numbers are of no program."""
    N = intervals
    return Stages(
        states=np.arange(2 * (N + 1)).reshape(-1, 2),
        inputs=np.arange(N).reshape(-1, 1),
        inner=np.arange(N).reshape(-1, 1, 1) + 1,
        equations=np.arange(N).reshape(-1, 1, 1) + 2,
        continuity=np.arange(2 * N).reshape(-1, 2) + 3,
        common=np.array([4]),
        rows=np.arange(3),
    )


def draw_program(rng: np.random.Generator, rows: int, variables: int, weights: int, constants: int) -> Program:
    """Draw a program with a function of rows, and one of the cost, which read constants."""
    H = [rng.standard_normal((variables, variables)) for _ in range(weights)]
    block = Block(
        function=NONE,
        columns=(
            np.array([[0, 2]]),
            Combination(np.ones((1, 1, 2)), np.zeros(2, np.int64), np.array([[0, 1], [2, 1]])),
        ),
        rows=np.array([[0, rows - 1]]),
        stages=np.array([0, 1]),
        parameters=np.array([weights, weights + constants - 1]),
        factor=1,
    )
    cost = replace(block, rows=np.array([[0, weights - 1]]), factor=None, parameters=np.zeros(0, np.int64))
    return Program(
        A=sparse.csc_array(rng.standard_normal((rows, variables))),
        H=tuple(sparse.csc_array(h + h.T) for h in H),
        blocks=(block,),
        costs=(cost,),
        constants=constants,
        stages=make_stages(weights),
        solved=(Solved(make_stages(1)),),
    )


def test_matrices_of_a_sum_stand_on_its_diagonal(rng: np.random.Generator) -> None:
    programs = [draw_program(rng, 3, 4, 2, 2), draw_program(rng, 2, 3, 1, 1), draw_program(rng, 4, 5, 1, 3)]
    links = sparse.csc_array(rng.standard_normal((2, 14)))
    further = Further(variables=2, constants=2, A=links, blocks=(), weights=1)
    found = add([Summand(program, 10 + k) for k, program in enumerate(programs)], further)
    own = block_diag(*(program.A.toarray() for program in programs))
    assert np.array_equal(found.A.toarray(), np.vstack([np.hstack([own, np.zeros((9, 2))]), links.toarray()]))
    assert len(found.H) == 5
    assert found.constants == 8
    begins, k = (0, 4, 7), 0
    for begin, program in zip(begins, programs, strict=True):
        for H in program.H:
            wanted = np.zeros((14, 14))
            wanted[begin : begin + program.variables, begin : begin + program.variables] = H.toarray()
            assert np.array_equal(found.H[k].toarray(), wanted)
            k += 1
    assert found.H[4].shape == (14, 14)
    assert found.H[4].nnz == 0
    assert found.chain is None


def test_functions_of_a_sum_read_and_write_behind_the_programs_before(rng: np.random.Generator) -> None:
    """Weights of all programs and links come first among the parameters, then the constants of one after the other."""
    programs = [draw_program(rng, 3, 4, 2, 2), draw_program(rng, 2, 3, 1, 1)]
    extra = replace(programs[0].blocks[0], plant=7)
    further = Further(1, 0, sparse.csc_array((0, 8)), blocks=(extra,), weights=2, costs=(extra, extra))
    chain = Chain((Part(*(np.zeros(0, np.int64),) * 5),), np.zeros(0, np.int64), np.zeros(0, np.int64))
    found = add([Summand(programs[0], 3), Summand(programs[1], 5)], further, chain)
    assert found.chain is chain
    first, second, last = found.blocks
    assert last is extra
    assert found.costs[2:] == (extra, extra)
    assert (first.plant, second.plant) == (3, 5)
    assert np.array_equal(first.rows, programs[0].blocks[0].rows)
    assert np.array_equal(second.rows, programs[1].blocks[0].rows + 3)
    assert np.array_equal(second.columns[0], np.array([[4, 6]]))
    combination = second.columns[1]
    assert isinstance(combination, Combination)
    assert np.array_equal(combination.variables, np.array([[4, 5], [6, 5]]))
    assert (first.factor, second.factor) == (1, 5)
    assert np.array_equal(second.stages, np.array([3, 4]))
    assert np.array_equal(first.parameters, np.array([5, 6]))  # after 2 + 1 + 2 weights
    assert np.array_equal(second.parameters, np.array([7, 7]))
    assert np.array_equal(found.costs[1].rows, programs[1].costs[0].rows + 2)
    assert found.costs[1].factor is None
    assert found.costs[1].plant == 5
    moved = found.solved[1]
    assert moved.plant == 5
    own = programs[1].solved[0].stages
    for name, offset in {"states": 4, "inputs": 4, "inner": 4, "common": 4, "equations": 3, "continuity": 3}.items():
        assert np.array_equal(getattr(moved.stages, name), getattr(own, name) + offset), name
    assert np.array_equal(moved.stages.rows, own.rows + 3)


def test_programs_begin_where_others_end(rng: np.random.Generator) -> None:
    programs = [draw_program(rng, 3, 4, 2, 2), draw_program(rng, 2, 3, 1, 1)]
    assert place_summands(programs, 2) == (
        Offsets(0, 0, 0, 5, 0),
        Offsets(4, 3, 2, 7, 3),
        Offsets(7, 5, 3, 8, 5),
    )
    assert place_summands(programs)[0].constants == 3
    assert count_stages(programs[0]) == 3
    assert count_stages(replace(programs[0], stages=None)) == 0


def test_parameters_of_a_sum_have_its_order(rng: np.random.Generator) -> None:
    programs = [draw_program(rng, 3, 4, 2, 2), draw_program(rng, 2, 3, 1, 1)]
    offsets = place_summands(programs, 1)
    parts = [np.array([1.0, 2.0, 30.0, 40.0]), np.array([3.0, 50.0])]
    assert add_parameters(offsets, parts, [60.0], [4.0]).tolist() == [1, 2, 3, 4, 30, 40, 50, 60]


def test_a_part_moves_by_its_variables() -> None:
    assert move_part(np.array([[1, 2]]), 3).tolist() == [[4, 5]]  # type: ignore[union-attr]
    combination = Combination(np.ones((1, 1, 1)), np.array([0]), np.array([[2]]))
    moved = move_part(combination, 3)
    assert isinstance(moved, Combination)
    assert moved.variables.tolist() == [[5]]
    assert moved.which.tolist() == [0]
