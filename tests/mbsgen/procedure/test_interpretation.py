"""Values of stages: against NumPy in float64, against closed forms and residuals in 50 digits; and their failures."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from mpmath import mp

from mbsgen.errors import TapeError
from mbsgen.procedure.newton import Newton
from mbsgen.procedure.patterns import General, Pattern, Symmetric, Tree
from mbsgen.procedure.procedure import Procedure, evaluate, interpret
from mbsgen.procedure.solve import Block, Solve
from mbsgen.procedure.wires import Wire
from mbsgen.tape.builder import Builder
from mbsgen.tape.interpreter import DECIMALS, DIGITS, FLOATS, Numbers, fifty_digits
from mbsgen.tape.ports import Function
from mbsgen.tape.types import Sparsity
from tests.mbsgen.procedure.examples import (
    CLOSED,
    EXAMPLES,
    LENGTHS,
    OPEN,
    POINT,
    SADDLE,
    SINGULAR,
    TREE,
    convert,
    four_bar,
    repeat,
    saddle_point,
    system,
)


def draw_matrix(pattern: Pattern, rng: np.random.Generator) -> np.ndarray:
    """Draw a matrix of a pattern: of a tree, a definite one; of the symmetric ones, some without a diagonal."""
    n = pattern.size
    if isinstance(pattern, Tree):
        L = np.eye(n)
        for k, row in enumerate(pattern.ancestors):
            L[k, list(row)] = rng.uniform(-1, 1, len(row))
        return np.asarray(L.T @ np.diag(rng.uniform(0.5, 2, n)) @ L)
    A = rng.uniform(-1, 1, (n, n))
    if isinstance(pattern, Symmetric):
        A += A.T
        if n > 1 and rng.integers(2):
            np.fill_diagonal(A, 0.0)
    return A


@pytest.mark.parametrize("options", [{}, {"transposed": True}, {"negated": True}], ids=str)
@pytest.mark.parametrize("kind", ["tree", "symmetric", "general"])
def test_systems_are_solved_as_numpy_does(kind: str, options: dict[str, bool]) -> None:
    """To 1e3 roundings times the condition, for systems of 1 to 8 rows; pivots of two rows are among them."""
    rng = np.random.default_rng(1)
    for n in (4,) if kind == "tree" else (1, 2, 3, 5, 8):
        pattern = TREE if kind == "tree" else Symmetric(n) if kind == "symmetric" else General(n)
        procedure = system(pattern, 3, **options)
        for _ in range(20):
            A, B = draw_matrix(pattern, rng), rng.uniform(-1, 1, (n, 3))
            given = {"A": [A[place] for place in procedure.input("A").sparsity.entries], "right": list(B.reshape(-1))}
            found = np.reshape(evaluate(procedure, given)["X"], (3, n)).T
            M = A.T if "transposed" in options else A
            expected = np.linalg.solve(M, -B if "negated" in options else B)
            np.testing.assert_allclose(
                found, expected, rtol=0, atol=1e3 * 2**-52 * np.linalg.cond(A) * abs(expected).max()
            )


@pytest.mark.parametrize("numbers", [DIGITS, DECIMALS], ids=["mpmath", "decimal"])
def test_a_saddle_point_is_solved_to_50_digits(numbers: Numbers) -> None:
    """M qdd - J^T lambda = f and J qdd = g, to 1e-45, with numbers of the size of 1."""
    with fifty_digits():
        given = convert(SADDLE, numbers)
        found = evaluate(saddle_point(), given, numbers)
        qdd, multipliers, J = found["qdd"], found["multipliers"], given["J"]
        a, b, c, d, e, f = given["M"]
        M = [[a, b, c], [b, d, e], [c, e, f]]
        for r in range(3):
            left = sum(M[r][k] * qdd[k] for k in range(3)) - sum(J[2 * r + k] * multipliers[k] for k in range(2))
            assert abs(left - given["f"][r]) < 1e-45
        for k in range(2):
            assert abs(sum(J[2 * r + k] * qdd[r] for r in range(3)) - given["g"][k]) < 1e-45


def close_four_bar(q: Any, lengths: Any) -> tuple[Any, Any]:
    """Return the angles of coupler and rocker of one assembly (Freudenstein).

    b exp(i y0) = c exp(i y1) - w with w = a exp(i q) - d; so |c exp(i y1) - w| = b, a cosine equation for y1.
    """
    a, b, c, d = (mp.mpf(x) for x in lengths)
    w = a * mp.expj(q) - d
    y1 = mp.arg(w) - mp.acos((abs(w) ** 2 + c * c - b * b) / (2 * c * abs(w)))
    return mp.arg(c * mp.expj(y1) - w), y1


@pytest.mark.parametrize("q", [0.0, 0.8, 2.5, -1.0])
def test_a_four_bar_closes_as_its_closed_form_does(q: float) -> None:
    """In 50 digits, to 1e-45; the start decides which of the two assemblies it is."""
    with mp.workdps(50):
        expected = close_four_bar(mp.mpf(q), LENGTHS)
        point = {**CLOSED, "q": [q], "start": [float(x) + 0.1 for x in expected]}
        found = evaluate(four_bar(), convert(point, DIGITS), DIGITS)["angles"]
        assert max(abs(mp.mpf(a) - b) for a, b in zip(found, expected, strict=True)) < 1e-45


def test_a_map_is_computed_for_each_index() -> None:
    """(sin(a) x2, a^2 / x2) of a = x0, x1, x0."""
    x = POINT["x"]
    expected = [(np.sin(a) * x[2], a * a / x[2]) for a in (x[0], x[1], x[0])]
    np.testing.assert_array_equal(np.reshape(evaluate(repeat(), POINT)["z"], (3, 2)), expected)


SINGULAR_MATRICES = {
    "tree": ([1.0, 1.0, 1.0, 0.0, 1.0, 1.0, 1.0, 1.0], TREE),  # the third row's pivot is 1 - 1
    "symmetric": ([1.0, 2.0, 3.0, 4.0, 6.0, 9.0], Symmetric(3)),
    "general": ([1.0, 2.0, 3.0, 2.0, 4.0, 6.0, 0.0, 1.0, 5.0], General(3)),
}


@pytest.mark.parametrize("kind", SINGULAR_MATRICES)
@pytest.mark.parametrize("fault", ["singular", "nearly", "nan"])
def test_a_pivot_that_fails_gives_the_status(kind: str, fault: str) -> None:
    """A matrix of rank n - 1, the same up to rounding, and a matrix with an entry that is not a number."""
    entries, pattern = SINGULAR_MATRICES[kind]
    if kind == "tree":
        A = draw_matrix(TREE, np.random.default_rng(2))
        A[3, 3] = A[3, [0, 2]] @ np.linalg.solve(A[np.ix_([0, 2], [0, 2])], A[[0, 2], 3])
        entries = [A[place] for place in system(TREE, 1).input("A").sparsity.entries]
    if fault == "nearly":
        entries = [x * (1 + 2**-51 * (-1) ** k) for k, x in enumerate(entries)]
    if fault == "nan":
        entries = [*entries[:-1], float("nan")]
    procedure = system(pattern, 1)
    given = {"A": entries, "right": [1.0] * pattern.size}
    assert (interpret(procedure, given).status, interpret(procedure, given).results) == (SINGULAR, {})
    with pytest.raises(TapeError, match="fails with status 7"):
        evaluate(procedure, given)


@pytest.mark.parametrize(
    ("change", "status"),
    [
        ({"lengths": [1.0, 1.0, 1.0, 9.0]}, OPEN),  # too long a base: no solution
        ({"lengths": [2.0, 2.0, 2.0, 2.0], "q": [0.0], "start": [0.3, 0.3]}, OPEN),  # flat: y0 = y1, J singular
        ({"start": [float("nan"), 1.0]}, OPEN),
        ({}, 0),
    ],
    ids=["out of reach", "singular", "nan", "closed"],
)
def test_an_iteration_that_does_not_converge_gives_the_status(change: dict[str, list[float]], status: int) -> None:
    """And no result."""
    outcome = interpret(four_bar(), {**CLOSED, **change})
    assert outcome.status == status
    assert bool(outcome.results) == (status == 0)


def test_guards_of_a_map_give_their_status() -> None:
    """Where they are tested; an evaluation without tests goes on."""
    assert interpret(repeat(), {"x": [1.0, 2.0, 0.0]}).status == 5
    assert interpret(repeat(), POINT).status == 0


def test_batches_pass_stages_without_exchanges() -> None:
    """Straight stages, maps and solutions by the factors of a tree take NumPy's arrays."""
    pattern = Tree(((), (0,)))
    factors = (Wire("lower", Sparsity.dense(1)), Wire("inverses", Sparsity.dense(2)))
    right, X = Wire("right", Sparsity.dense(1, 2)), Wire("X", Sparsity.dense(2))
    procedure = Procedure(
        Function("batch"), (*factors, right), (Solve("S", pattern, factors, right, (Block(X, 0),)),), (X,)
    )
    batch = {"lower": [np.array([0.5, 0.2])], "inverses": [np.array([1.0, 2.0])] * 2, "right": [np.ones(2)] * 2}
    found = evaluate(procedure, batch)["X"]
    for k in range(2):
        single = {name: [x[k] for x in values] for name, values in batch.items()}
        assert [x[k] for x in found] == evaluate(procedure, single)["X"]


@pytest.mark.parametrize("name", EXAMPLES)
def test_all_number_types_agree(name: str) -> None:
    """Floats, mpmath's and decimal's numbers; to 1e3 roundings."""
    example = EXAMPLES[name]
    with fifty_digits():
        found = [evaluate(example.procedure, convert(example.point, x), x) for x in (FLOATS, DIGITS, DECIMALS)]
    for result, values in found[0].items():
        for other in found[1:]:
            np.testing.assert_allclose([float(x) for x in other[result]], values, rtol=1e3 * 2**-52, atol=1e-14)


def test_an_iteration_that_loses_digits_gives_the_status() -> None:
    """y^2 = x has a double root at x = 0, where steps only halve: the short ones do not show where the root is."""
    builder = Builder()
    (x,), (y,) = builder.vector("x", 1), builder.vector("y", 1)
    builder.output_dense("g", [[y * y - x]])
    builder.output_dense("J", [[y + y]])
    given, start, root = (Wire(name, Sparsity.dense(1)) for name in ("x", "start", "root"))
    stage = Newton("root", builder.build("square"), "y", start, root, General(1), 1, iterations=100)
    procedure = Procedure(Function("root"), (given, start), (stage,), (root,))
    assert interpret(procedure, {"x": [2.0], "start": [1.0]}).results["root"] == [pytest.approx(2**0.5, abs=2**-52)]
    assert interpret(procedure, {"x": [0.0], "start": [1.0]}).status == 1
