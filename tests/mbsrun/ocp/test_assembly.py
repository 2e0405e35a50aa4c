"""Where nonzeros belong, compared with products of dense matrices: J = F' C, H = C' F'' C, place by place."""

from __future__ import annotations

from dataclasses import replace
from typing import cast

import numpy as np
import pytest
from scipy import sparse

from mbsrun.ocp.evaluation.backends.assembly import (
    Scatter,
    assemble,
    prepare,
    scatter_matrix,
    scatter_weighted,
)
from mbsrun.ocp.ground.functions import Array, Function, Pattern
from mbsrun.ocp.ground.program import Block, Combination

VARIABLES, PLACES, ROWS = 9, 3, 7
NONE = cast(Function, None)  # no law here calls a function


def draw_block(rng: np.random.Generator) -> Block:
    """Draw a block of two results, which reads two entries of x and three combinations of entries."""
    combination = Combination(
        rng.integers(-2, 3, (2, 3, 4)) * 0.5,
        np.array([1, 0, 1]),
        np.array([[0, 1, 2, 3], [4, 8, 6, 5], [7, 7, 1, 0]]),
    )
    return Block(
        function=NONE,
        columns=(np.array([[3, 5, 7], [8, 0, 2]]), combination),
        rows=np.array([[0, 2, 4], [6, 5, 1]]),
        stages=np.arange(PLACES),
        scale=np.array([2.0, -1.0, 0.5]),
    )


def spread(block: Block) -> list[list[Array]]:
    """Return C of each part at each place, dense."""
    indices, combination = block.columns
    assert isinstance(indices, np.ndarray)
    assert isinstance(combination, Combination)
    picks = [np.eye(VARIABLES)[indices[:, p]] for p in range(PLACES)]
    matrices = []
    for p in range(PLACES):
        C = np.zeros((combination.size, VARIABLES))
        for column, variable in enumerate(combination.variables[p]):
            C[:, variable] += combination.matrices[combination.which[p]][:, column]
        matrices.append(C)
    return [picks, matrices]


def fill(found: Scatter, shape: tuple[int, int], values: Array) -> Array:
    """Add the entries of a scatter to a dense matrix."""
    matrix = np.zeros(shape)
    np.add.at(matrix, (found.row, found.col), found.coefficient * values[found.source])
    return matrix


def draw_pattern(rng: np.random.Generator, shape: tuple[int, int]) -> Pattern:
    """Draw the places of some entries, in an order of chance."""
    chosen = rng.permutation(shape[0] * shape[1])[: shape[0] * shape[1] - 1]
    return Pattern(shape, chosen // shape[1], chosen % shape[1])


def place(pattern: Pattern, values: Array) -> Array:
    """Return the dense matrix of nonzeros."""
    matrix = np.zeros(pattern.shape)
    matrix[pattern.row, pattern.col] = values
    return matrix


@pytest.mark.parametrize("part", [0, 1])
def test_a_jacobian_is_the_product_with_what_a_part_reads(part: int, rng: np.random.Generator) -> None:
    block = draw_block(rng)
    C, parts = spread(block), prepare(block, VARIABLES)
    pattern = draw_pattern(rng, (2, 2 + part))
    values = rng.standard_normal((PLACES, pattern.row.size))
    wanted = np.zeros((ROWS, VARIABLES))
    for p in range(PLACES):
        wanted[block.rows[:, p]] += block.scales[p] * place(pattern, values[p]) @ C[part][p]
    found = parts.scatter_jacobian(pattern, part)
    assert np.allclose(fill(found, wanted.shape, values.ravel()), wanted, rtol=1e-14, atol=1e-14)
    assert np.array_equal(
        fill(found.transposed(), wanted.T.shape, values.ravel()), fill(found, wanted.shape, values.ravel()).T
    )


@pytest.mark.parametrize("first", [0, 1])
@pytest.mark.parametrize("second", [0, 1])
def test_a_hessian_is_the_product_from_both_sides(first: int, second: int, rng: np.random.Generator) -> None:
    block = draw_block(rng)
    C, parts = spread(block), prepare(block, VARIABLES)
    pattern = draw_pattern(rng, (2 + first, 2 + second))
    values = rng.standard_normal((PLACES, pattern.row.size))
    wanted = np.zeros((VARIABLES, VARIABLES))
    for p in range(PLACES):
        wanted += block.scales[p] * C[first][p].T @ place(pattern, values[p]) @ C[second][p]
    found = parts.scatter_hessian(pattern, first, second)
    assert np.allclose(fill(found, wanted.shape, values.ravel()), wanted, rtol=1e-13, atol=1e-13)
    upper = fill(found.upper(), wanted.shape, values.ravel())
    assert np.allclose(upper, np.triu(wanted), rtol=1e-13, atol=1e-13)


@pytest.mark.parametrize("part", [0, 1])
def test_a_gradient_reads_some_entries_of_a_part(part: int, rng: np.random.Generator) -> None:
    block = draw_block(rng)
    C, parts = spread(block), prepare(block, VARIABLES)
    entries = np.array([1, 0]) + part
    values = rng.standard_normal((PLACES, 2))
    wanted = sum(block.scales[p] * C[part][p][entries].T @ values[p] for p in range(PLACES))
    found = fill(parts.scatter_gradient(entries, 2 + part, part), (VARIABLES, 1), values.ravel())
    assert np.allclose(found[:, 0], wanted, rtol=1e-13, atol=1e-13)


def test_results_go_to_their_rows(rng: np.random.Generator) -> None:
    block = draw_block(rng)
    values = rng.standard_normal((PLACES, 2))
    wanted = np.zeros(ROWS)
    for p in range(PLACES):
        wanted[block.rows[:, p]] += block.scales[p] * values[p]
    found = prepare(block, VARIABLES)
    assert found.places == PLACES
    assert np.array_equal(fill(found.scatter_results(), (ROWS, 1), values.ravel())[:, 0], wanted)
    plain = prepare(replace(block, scale=3.0), VARIABLES)
    assert set(plain.scatter_results().coefficient) == {3.0}


def test_constant_matrices_are_spread_with_their_weights(rng: np.random.Generator) -> None:
    matrices = [sparse.random_array((4, 5), density=0.4, rng=rng).tocsc() for _ in range(3)]
    weights = rng.standard_normal(3)
    wanted = sum(w * M.toarray() for w, M in zip(weights, matrices, strict=True))
    assert np.allclose(fill(scatter_weighted(matrices), (4, 5), weights), wanted, rtol=1e-15)
    assert np.array_equal(fill(scatter_matrix(matrices[0]), (4, 5), matrices[0].tocoo().data), matrices[0].toarray())


def test_scatters_are_summed_in_one_pattern(rng: np.random.Generator) -> None:
    """Entries that meet are one nonzero; nonzeros are ordered column by column."""
    shape, sizes = (4, 5), (6, 3)
    parts = [
        Scatter(rng.integers(0, 4, n), rng.integers(0, 5, n), rng.standard_normal(n), rng.integers(0, size, n))
        for n, size in zip((12, 7), sizes, strict=True)
    ]
    values = [rng.standard_normal(size) for size in sizes]
    wanted = sum(fill(part, shape, numbers) for part, numbers in zip(parts, values, strict=True))
    found = assemble(shape, parts, sizes)
    nonzeros = np.zeros(found.row.size)
    np.add.at(nonzeros, found.nonzero, found.coefficient * np.concatenate(values)[found.source])
    assert np.allclose(sparse.coo_array((nonzeros, (found.row, found.col)), shape=shape).toarray(), wanted, rtol=1e-14)
    order = found.col * shape[0] + found.row
    assert (np.diff(order) > 0).all()
    assert not found.is_permutation
    none = assemble(shape, [], [])
    assert [part.size for part in (none.row, none.col, none.nonzero, none.coefficient, none.source)] == [0] * 5


def test_a_sum_without_meetings_is_a_permutation() -> None:
    """It is none where two entries meet, or where a coefficient is not 1."""
    row, col, source = np.array([2, 0, 1]), np.array([0, 1, 0]), np.array([0, 1, 2])
    assert assemble((3, 2), [Scatter(row, col, np.ones(3), source)], [3]).is_permutation
    assert not assemble((3, 2), [Scatter(row, col, np.array([1.0, 1.0, 2.0]), source)], [3]).is_permutation
    assert not assemble((3, 2), [Scatter(np.array([1, 0, 1]), col, np.ones(3), source)], [3]).is_permutation
