"""The solver for problems in stages: its recursion against dense algebra, its optima against IPOPT's."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.csrc.stage_problems import nonlinear, too_weak
from tests.csrc.stage_quadratics import dense_solution, random_problem, random_sizes
from tests.csrc.stages import Answer, Array, Library, Problem, Quadratic, Solver, compile_solver


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Library:
    return Library(compile_solver(tmp_path_factory.mktemp("stages")))


def close(a: np.ndarray, b: np.ndarray, tolerance: float) -> bool:
    return bool(np.abs(a - b).max(initial=0.0) <= tolerance * (1 + np.abs(b).max(initial=0.0)))


@pytest.mark.parametrize("stages", [1, 2, 3, 7, 20, 101])
@pytest.mark.parametrize("first", [True, False])
def test_linear_quadratic_problems_have_the_solution_of_dense_algebra(
    library: Library, stages: int, first: bool
) -> None:
    """One step solves them: variables and multipliers agree, with equalities in stages and sizes that change."""
    rng = np.random.default_rng(stages)
    for _ in range(6 if stages < 20 else 1):
        problem = random_problem(rng, random_sizes(rng, stages, 5 if stages < 50 else 2), first=first)
        w, y, unique = dense_solution(problem)
        answer = Solver(library, problem).solve()
        assert answer.status == "solved"
        assert answer.result.iterations <= 1
        assert close(answer.w, w, 1e-10)
        if unique:
            assert close(answer.y, y, 1e-10)
        assert max(problem.residuals(*answer.point)) < 1e-9


@pytest.mark.parametrize("seed", range(12))
def test_convex_quadratic_programs_have_the_optimum_of_ipopt(library: Library, seed: int) -> None:
    """Bounds of either side, inequalities and equalities; in half of them the minimum is not unique."""
    rng = np.random.default_rng(seed)
    sizes = [(a, b, min(c, 2), int(rng.integers(0, 4))) for a, b, c, _ in random_sizes(rng, int(rng.integers(1, 25)))]
    problem = random_problem(rng, sizes, bounds=0.6, width=(1.0, 0.05)[seed % 3 == 0], flat=(0.0, 0.5)[seed % 2])
    answer = Solver(library, problem).solve(tolerance=1e-10)
    solution, statistics = problem.ipopt(**{"ipopt.tol": 1e-10})
    assert statistics["success"]
    assert answer.status == "solved"
    assert abs(answer.result.cost - solution["f"][0]) <= 1e-8 * (1 + abs(solution["f"][0]))
    assert max(problem.residuals(*answer.point)) < 1e-8
    if seed % 2 == 0:
        assert close(answer.w, solution["x"], 1e-6)


def with_row(problem: Quadratic, k: int, row: Array, constant: float) -> Quadratic:
    """Add a row of e to a stage."""
    nx, nv, ne, ng = problem.sizes[k]
    sizes, E, e = list(problem.sizes), list(problem.E), list(problem.e)
    sizes[k], E[k], e[k] = (nx, nv, ne + 1, ng), np.vstack([E[k], row]), np.append(e[k], constant)
    return replace(problem, sizes=sizes, E=E, e=e)


def clashes(answer: Answer) -> list[tuple[int, str, int]]:
    """The rows that clash, the worst first."""
    listed = answer.result.clash[0 : min(answer.result.clashes, 8)]
    return [(c.stage, "edg"[c.kind], c.row) for c in listed]


def test_dependent_rows_are_counted_and_do_no_harm(library: Library) -> None:
    """Every stage repeats a combination of its rows: variables are those of the dense solution."""
    rng = np.random.default_rng(5)
    problem = random_problem(rng, [(3, 3, 2, 0)] * 10 + [(3, 0, 2, 0)])
    for k in range(11):
        problem = with_row(problem, k, problem.E[k][0] + 2 * problem.E[k][1], problem.e[k][0] + 2 * problem.e[k][1])
    answer = Solver(library, problem).solve()
    assert (answer.status, answer.result.iterations, answer.result.dependent) == ("solved", 1, 11)
    assert close(answer.w, dense_solution(problem)[0], 1e-10)
    assert max(problem.residuals(*answer.point)) < 1e-9


def test_rows_are_dependent_across_stages(library: Library) -> None:
    """A state without influence that is wanted twice: in the first stage and in the last."""
    rng = np.random.default_rng(6)
    problem = random_problem(rng, [(3, 2, 0, 0)] * 6 + [(3, 0, 0, 0)])
    for F, b in zip(problem.F[:-1], problem.b[:-1], strict=True):
        F[0], b[0] = [1.0, 0.0, 0.0, 0.0, 0.0], 0.0
    row = np.array([1.0, 0.0, 0.0])
    agreed = with_row(problem, 6, row, -problem.lower[0])
    answer = Solver(library, agreed).solve()
    assert (answer.status, answer.result.dependent) == ("solved", 1)
    assert close(answer.w, dense_solution(agreed)[0], 1e-10)
    refused = Solver(library, with_row(problem, 6, row, 1.0 - problem.lower[0])).solve()
    assert refused.status == "infeasible"
    assert set(clashes(refused)) <= {(k, "d", 0) for k in range(6)} | {(6, "e", 0)}
    assert sum(c.violation for c in refused.result.clash) == pytest.approx(1.0, abs=1e-3)


@pytest.mark.parametrize("k", [0, 4, 10])
def test_contradictory_equalities_are_named(library: Library, k: int) -> None:
    """The same row with two constants: their difference stays, in one of them or in both."""
    rng = np.random.default_rng(k)
    problem = random_problem(rng, [(3, 2, 1, 1)] * 10 + [(3, 0, 1, 1)], bounds=0.3)
    answer = Solver(library, with_row(problem, k, problem.E[k][0], problem.e[k][0] + 0.5)).solve()
    assert answer.status == "infeasible"
    assert set(clashes(answer)) <= {(k, "e", 0), (k, "e", 1)}
    assert sum(c.violation for c in answer.result.clash) == pytest.approx(0.5, abs=1e-3)


@pytest.mark.parametrize("seed", range(4))
def test_inequalities_that_bounds_forbid_are_named(library: Library, seed: int) -> None:
    """A row of g wants more than bounds of its stage allow by far."""
    rng = np.random.default_rng(seed)
    problem = random_problem(rng, [(2, 3, 1, 2)] * 8 + [(2, 0, 0, 2)], bounds=0.5)
    k = int(rng.integers(1, 8))
    problem.lower[5 * k : 5 * k + 5], problem.upper[5 * k : 5 * k + 5] = -1.0, 1.0
    problem.least[2 * k] = 20 * np.abs(problem.G[k][0]).sum()
    problem.most[2 * k] = 1e20
    answer = Solver(library, problem).solve()
    assert answer.status == "infeasible"
    assert clashes(answer)[0] == (k, "g", 0)


def test_a_target_out_of_reach_is_infeasible(library: Library) -> None:
    problem = too_weak()
    answer = Solver(library, problem).solve()
    assert (answer.status, problem.ipopt()[1]["return_status"]) == ("infeasible", "Infeasible_Problem_Detected")
    assert answer.result.clash[0].violation > 1.0


@pytest.mark.parametrize("problem", nonlinear(), ids=lambda p: p.name)
def test_nonlinear_problems_have_the_optimum_of_ipopt(library: Library, problem: Problem) -> None:
    """Optimality is measured with CasADi's derivatives."""
    answer = Solver(library, problem).solve()
    solution, statistics = problem.ipopt()
    assert statistics["success"]
    assert answer.status == "solved"
    assert abs(answer.result.cost - solution["f"][0]) <= 1e-8 * (1 + abs(solution["f"][0]))
    assert max(problem.residuals(*answer.point)) < 1e-7
