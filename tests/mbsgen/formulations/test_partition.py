"""Blocks of dependent velocities are solved for at any regular matrix, and a lost rank is a status."""

from __future__ import annotations

import numpy as np
import pytest

from mbsgen.errors import TapeError
from mbsgen.formulations.loops.partition import Joined, Many, Pair, Partition, Single, Triple, find_blocks
from mbsgen.tape.builder import Builder
from mbsgen.tape.interpreter import evaluate, find_failure
from mbsgen.tape.types import Sparsity, Tape

PATTERNS = {
    "single": ["*"],
    "pair": ["**", "**"],
    "triple": ["**.", ".**", "*.*"],
    "many": ["****", "****", "****", "****"],
    "blocks": ["*....", "***..", ".**..", "...*.", "*..**"],
    "local": [
        "**....*..",
        "***......",
        ".*....*..",
        "..****...",
        "...***.*.",
        "...*...**",
        "......*.*",
        "...*.*...",
        "*......**",
    ],
    "arms": [
        "**....*..",
        "**.....*.",
        "**......*",
        "..**..*..",
        "..**...*.",
        "..**....*",
        "....***..",
        "....**.*.",
        "....**..*",
    ],
}
KINDS = {"single": Single, "pair": Pair, "triple": Triple, "many": Many, "arms": Joined}


def write(pattern: list[str]) -> tuple[Tape, Partition]:
    """Write the solutions of J x = b and JT x = b, for a matrix with a pattern."""
    n, builder = len(pattern), Builder()
    places = [(r, c) for r in range(n) for c in range(n) if pattern[r][c] == "*"]
    sparsity = Sparsity.of(n, n, places)
    entries = dict(zip(sparsity.entries, builder.input("J", sparsity), strict=True))
    b = builder.vector("b", n)
    rows = [{c: entries[r, c] for c in range(n) if (r, c) in entries} for r in range(n)]
    partition = Partition(builder, rows, range(1, n + 1), range(n))
    found = partition.solve(b)
    builder.output_dense("x", [[found[c]] for c in range(n)])
    builder.output_dense("y", [[x] for x in partition.solve_transposed(dict(enumerate(b)))])
    return builder.build("partition"), partition


@pytest.mark.parametrize("name", PATTERNS)
@pytest.mark.parametrize("seed", range(3))
def test_solutions_are_those_of_elimination_with_pivots(name, seed):
    tape, _ = write(PATTERNS[name])
    rng, n = np.random.default_rng(seed), len(PATTERNS[name])
    J, b = np.zeros((n, n)), rng.uniform(-1, 1, n)
    places = tape.inputs[0].sparsity.entries
    J[tuple(zip(*places, strict=True))] = rng.uniform(-1, 1, len(places))
    given = {"J": [J[place] for place in places], "b": list(b)}
    found = evaluate(tape, given)
    scale = 1e-13 * np.linalg.cond(J) * np.abs(np.linalg.inv(J)).max()
    assert np.array(found["x"], float) == pytest.approx(np.linalg.solve(J, b), abs=scale)
    assert np.array(found["y"], float) == pytest.approx(np.linalg.solve(J.T, b), abs=scale)
    assert find_failure(tape, given) == 0


@pytest.mark.parametrize("name", KINDS)
def test_each_pattern_has_its_kind_of_block(name):
    (block,) = write(PATTERNS[name])[1]._blocks
    assert type(block) is KINDS[name]


@pytest.mark.parametrize("name", ["pair", "triple", "many"])
def test_a_regular_matrix_without_a_diagonal_does_not_fail(name):
    """Ones on a rotated diagonal: an elimination in a fixed order would divide by 0."""
    tape, _ = write(PATTERNS[name])
    n = len(PATTERNS[name])
    J = np.roll(np.eye(n), 1, axis=1)
    given = {"J": [J[place] for place in tape.inputs[0].sparsity.entries], "b": [1.0] * n}
    assert find_failure(tape, given) == 0
    assert np.array(evaluate(tape, given)["x"], float) == pytest.approx(np.linalg.solve(J, np.ones(n)))


@pytest.mark.filterwarnings("ignore:(divide|invalid)")
@pytest.mark.parametrize("name", PATTERNS)
def test_a_lost_rank_is_a_status(name):
    """A row of zeros, and one that is the sum of the others where the pattern is full."""
    tape, _ = write(PATTERNS[name])
    rng, n = np.random.default_rng(9), len(PATTERNS[name])
    places = tape.inputs[0].sparsity.entries
    J = rng.uniform(-1, 1, (n, n))
    J[-1] = J[:-1].sum(0) if name in ("pair", "many") else 0.0
    assert find_failure(tape, {"J": [J[place] for place in places], "b": [1.0] * n}) in range(1, n + 1)


def test_a_matrix_that_is_singular_for_all_numbers_is_refused():
    with pytest.raises(TapeError, match="row 2"):
        find_blocks([[0], [1], [0, 1]], [1, 1, 1])
