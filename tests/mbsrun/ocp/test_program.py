"""The assembled derivatives of a program equal CasADi's, which differentiates the whole."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from scipy import sparse

from mbsgen.expressions import parse
from mbsrun.ocp.evaluation.backends.casadi import CasadiProgram
from mbsrun.ocp.ground.functions import Formula, Input
from mbsrun.ocp.ground.program import Block, Program
from tests.mbsrun.peer import double_integrator


def function() -> Formula:
    """A function of two vectors with zeros in its Jacobian and in its Hessian."""
    texts = ("sin(a0)*b1", "a2**2*a0 + b0", "b0*b1")
    names = {f"{kind}{i}": (kind, i) for kind, size in (("a", 3), ("b", 2)) for i in range(size)}
    return Formula(tuple(map(parse, texts)), names, (Input("a", 3), Input("b", 2)))


def program(rng: np.random.Generator, columns_a: np.ndarray, columns_b: np.ndarray, rows: np.ndarray) -> Program:
    """A program of 7 variables and 8 constraints around the function at given places."""
    A = sparse.random_array((8, 7), density=0.3, rng=rng, format="csc")
    H = tuple((S + S.T).tocsc() for S in (sparse.random_array((7, 7), density=0.2, rng=rng) for _ in range(2)))
    stages = np.zeros(rows.shape[1], dtype=np.int64)
    return Program(A, H, (Block(function(), (columns_a, columns_b), rows, stages),))


def functions_of(program: Program) -> CasadiProgram:
    """Its functions; no kernel is applied."""
    return CasadiProgram(program, double_integrator())


PLACES = {
    "apart": ([[0, 1], [2, 3], [4, 5]], [[5, 6], [6, 2]], [[0, 3], [1, 4], [2, 5]]),
    "shared variables and rows": ([[0, 1], [0, 1], [4, 5]], [[0, 5], [4, 1]], [[0, 1], [1, 2], [2, 0]]),
    "one place": ([[6], [5], [4]], [[3], [2]], [[7], [6], [5]]),
}


@pytest.fixture(params=PLACES.values(), ids=PLACES.keys())
def some_program(request: pytest.FixtureRequest, rng: np.random.Generator) -> CasadiProgram:
    return functions_of(program(rng, *(np.array(indices) for indices in request.param)))


def test_derivatives_equal_those_of_the_whole(some_program: CasadiProgram, rng: np.random.Generator) -> None:
    """Jacobian, gradient and Hessian at a random point, to a few roundings of numbers of order 1."""
    x, p = ca.MX.sym("x", 7), ca.MX.sym("p", 2)
    f, g = some_program.objective(x, p), some_program.constraint(x, p)
    lam_f, lam_g = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", 8)
    hessian, _ = ca.hessian(lam_f * f + ca.dot(lam_g, g), x)
    whole = ca.Function(
        "whole", [x, p, lam_f, lam_g], [ca.gradient(f, x), ca.jacobian(g, x), ca.densify(ca.triu(hessian))]
    )
    at = [rng.uniform(-1, 1, size) for size in (7, 2, 1, 8)]
    gradient, jacobian, upper = (m.full() for m in whole(*at))
    assert some_program.gradient(*at[:2])[1].full() == pytest.approx(gradient, abs=1e-14)
    assert some_program.jacobian(*at[:2]).full() == pytest.approx(jacobian, abs=1e-14)
    assert some_program.hessian(*at).full() == pytest.approx(upper, abs=1e-14)


def test_the_cost_comes_with_its_gradient(some_program: CasadiProgram, rng: np.random.Generator) -> None:
    """In the form that nlpsol takes."""
    at = [rng.uniform(-1, 1, size) for size in (7, 2)]
    assert float(some_program.gradient(*at)[0]) == pytest.approx(float(some_program.objective(*at)), rel=1e-14)


def test_pattern_holds_no_more_than_the_function_has(rng: np.random.Generator) -> None:
    """7 nonzeros of F's Jacobian and 5 of its Hessian's triangle, at each of 2 places that do not meet."""
    places = tuple(np.array(indices) for indices in PLACES["apart"])
    bare = functions_of(Program(sparse.csc_array((8, 7)), (sparse.csc_array((7, 7)),), program(rng, *places).blocks))
    assert bare.jacobian.nnz_out(0) == 2 * 7
    assert bare.hessian.nnz_out(0) == 2 * 5


def test_a_program_with_more_entries_than_32_bits_count() -> None:
    """Row and column of a nonzero far from the corner of a matrix of 70000 x 70000."""
    size = 70_000
    H = sparse.coo_array(([2.0], ([size - 1], [size - 1])), (size, size)).tocsc()
    A = sparse.coo_array(([1.0], ([0], [size - 2])), (1, size)).tocsc()
    large = functions_of(Program(A, (H,), ()))
    assert large.hessian.sparsity_out(0).get_triplet() == ([size - 1], [size - 1])
    assert large.jacobian.sparsity_out(0).get_triplet() == ([0], [size - 2])
