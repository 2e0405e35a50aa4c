"""The solver for problems in stages: its recursion against dense algebra, its optima against IPOPT's."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import threading
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from mbsrun.library import find_compiler
from tests.csrc.stage_problems import assemble, far_guesses, free, nonlinear, pendulum_ode, shooting, too_weak
from tests.csrc.stage_quadratics import dense_solution, in_units, random_problem, random_sizes
from tests.csrc.stages import (
    INFINITE,
    STRICT,
    Answer,
    Array,
    Kind,
    Library,
    Problem,
    Quadratic,
    Solver,
    clashes,
    close,
    sources,
)


@pytest.fixture(params=["library", "single"], ids=["double", "float"])
def either(request: pytest.FixtureRequest) -> Library:
    """The solver in each precision."""
    found: Library = request.getfixturevalue(request.param)
    return found


Size = tuple[int, int, int, int]


@pytest.mark.parametrize("stages", [1, 2, 3, 7, 20, 100])
@pytest.mark.parametrize("first", [True, False])
def test_linear_quadratic_problems_have_the_solution_of_dense_algebra(
    library: Library, stages: int, first: bool
) -> None:
    """One step solves them: variables and multipliers agree, with equalities in stages and sizes that change."""
    rng = np.random.default_rng(stages)
    for _ in range(6 if stages < 20 else 1):
        problem = random_problem(rng, random_sizes(rng, stages, 5 if stages < 50 else 1), first=first)
        w, y, unique = dense_solution(problem)
        answer = Solver(library, problem).solve()
        assert answer.status == "solved"
        assert answer.result.iterations <= 1
        assert close(answer.w, w, 1e-10)
        if unique:
            assert close(answer.y, y, 1e-10)
        assert max(problem.residuals(*answer.point)) < 1e-9


def test_the_page_lists_the_headers() -> None:
    """`docs/solver.md` shows what a program needs that copies the solver."""
    root = Path(__file__).parents[2]
    code = "".join(path.read_text(encoding="utf-8") for path in sorted((root / "csrc" / "stages").glob("*.[ch]")))
    page = (root / "docs" / "solver.md").read_text(encoding="utf-8").split("## ", maxsplit=1)[0]
    assert set(re.findall(r"#include <(.*)>", code)) == set(re.findall(r"`(\w+\.h)`", page))


@pytest.mark.parametrize("size", [1.0, 1e6, 1e9])
def test_large_multipliers_are_no_lost_digits(library: Library, size: float) -> None:
    """They leave residuals that are large beside a small right-hand side; no step is factorised anew for that."""
    problem = random_problem(np.random.default_rng(3), [(3, 4, 2, 0)] * 12 + [(3, 2, 2, 0)])
    problem.H = [size * H for H in problem.H]
    problem.q = [0 * q for q in problem.q]
    problem.lower[:3] = problem.upper[:3] = 0.0
    answer = Solver(library, problem).solve()
    assert answer.status == "solved"
    assert answer.result.factorisations == answer.result.iterations
    assert np.abs(answer.y).max() > size


@pytest.mark.parametrize("seed", range(12))
def test_convex_quadratic_programs_have_the_optimum_of_ipopt(library: Library, seed: int) -> None:
    """Bounds of either side, inequalities and equalities; in half of them the minimum is not unique."""
    rng = np.random.default_rng(seed)
    sizes = [(a, b, min(c, 2), int(rng.integers(0, 4))) for a, b, c, _ in random_sizes(rng, int(rng.integers(1, 25)))]
    problem = random_problem(rng, sizes, bounds=0.6, width=(1.0, 0.05)[seed % 3 == 0], flat=(0.0, 0.5)[seed % 2])
    answer = Solver(library, problem).solve(tol=1e-10)
    solution, statistics = problem.ipopt(**{"ipopt.tol": 1e-10})
    assert statistics["success"]
    assert answer.status == "solved"
    assert abs(answer.result.cost - solution["f"][0]) <= 1e-8 * (1 + abs(solution["f"][0]))
    assert max(problem.residuals(*answer.point)) < 1e-8
    if seed % 2 == 0:
        assert close(answer.w, solution["x"], 1e-6)


@pytest.mark.parametrize("seed", range(4))
def test_solutions_keep_their_bounds_to_the_last_digits(library: Library, seed: int) -> None:
    """Bounds give in a solve; whole steps put the solution back where the cost rises as multipliers say."""
    problem = random_problem(np.random.default_rng(seed), [(2, 3, 1, 2)] * 8 + [(2, 1, 0, 0)], bounds=0.6, width=0.05)
    exact, loose = Solver(library, problem).solve(), Solver(library, problem).solve(bound_relax_factor=1e-2)
    sizes = np.maximum(np.minimum(np.abs(problem.lower), np.abs(problem.upper)), 1.0)
    for answer, most in ((exact, 1e-11), (loose, 1e-2)):
        assert answer.status == "solved"
        assert (np.maximum(problem.lower - answer.w, answer.w - problem.upper) <= most * sizes).all()
    assert loose.result.cost < exact.result.cost * (1 - 1e-9)


@pytest.mark.parametrize("seed", range(4))
def test_a_small_cost_is_found_to_its_own_digits_or_is_not_called_solved(library: Library, seed: int) -> None:
    """The same convex program with a cost of other units: a cost that is solved is right to 1e-4 of itself."""
    sizes = [(2, 3, 1, 2)] * 8 + [(2, 1, 0, 0)]
    problem = random_problem(np.random.default_rng(seed), sizes, bounds=0.6)
    right = Solver(library, problem).solve().result.cost
    for unit in (1e-3, 1e-5, 1e-7, 1e-9, 1e-11):
        small = replace(problem, H=[unit * part for part in problem.H], q=[unit * part for part in problem.q])
        answer = Solver(library, small).solve()
        assert answer.status == "acceptable" if unit < 1e-9 else answer.status in ("solved", "acceptable")
        assert answer.status == "solved" or unit < 1e-7
        if answer.status == "solved":
            assert answer.result.cost / unit == pytest.approx(right, rel=1e-4)


@pytest.mark.parametrize("least", [1.0, 1.0 - 1e-9])
def test_an_interior_may_be_empty(library: Library, least: float) -> None:
    """min (v - 3)^2 + (w - 3)^2 with v + w = 2, v <= 1, w <= 1, and rows for v >= `least` and v <= 1: v = w = 1."""
    problem = Quadratic(
        [(0, 2, 1, 2)],
        [np.eye(2) * 2],
        [np.full(2, -6.0)],
        [np.zeros((0, 2))],
        [np.zeros(0)],
        [np.array([[1.0, 1.0]])],
        [np.array([-2.0])],
        [np.array([[1.0, 0.0], [1.0, 0.0]])],
        np.full(2, -INFINITE),
        np.ones(2),
        np.array([least, -INFINITE]),
        np.array([INFINITE, 1.0]),
        np.zeros(2),
    )
    answer = Solver(library, problem).solve()
    assert answer.status == "solved"
    assert close(answer.w, np.ones(2), 3e-8)
    assert answer.result.iterations < 20


def test_corrected_products_save_iterations(library: Library) -> None:
    """Narrow bounds stop steps of a convex problem early. Without corrections, IPOPT takes as many iterations."""
    ours = theirs = 0
    for seed in range(4):
        problem = random_problem(
            np.random.default_rng(seed), [(4, 3, 0, 0)] * 30 + [(4, 0, 0, 0)], bounds=0.9, width=0.02
        )
        answer = Solver(library, problem).solve()
        solution, statistics = problem.ipopt()
        assert answer.status == "solved"
        assert answer.result.cost == pytest.approx(float(solution["f"][0]), rel=1e-6)
        ours, theirs = ours + answer.result.iterations, theirs + statistics["iter_count"]
    assert ours < 0.97 * theirs


@pytest.mark.parametrize("seed", range(3))
def test_patterns_give_the_iterates_of_dense_matrices(library: Library, seed: int) -> None:
    """Two thirds of all entries are zero, and each kind of stage has its pattern."""
    rng = np.random.default_rng(seed)
    problem = random_problem(rng, [(3, 4, 2, 2)] * 6 + [(2, 3, 1, 0)] * 3 + [(2, 0, 0, 1)], bounds=0.4, share=0.3)
    dense, sparse = (Solver(library, replace(problem, sparse=flag)) for flag in (False, True))
    answers = dense.solve(), sparse.solve()
    assert [a.status for a in answers] == ["solved", "solved"]
    assert answers[1].result.iterations == answers[0].result.iterations
    assert close(answers[1].w, answers[0].w, 1e-10)
    assert max(problem.residuals(*answers[1].point)) < 1e-8


def test_patterns_of_nonlinear_problems(library: Library) -> None:
    """The chain, where curvature is added; a target out of reach, which ends in restoration; no numbers."""
    for problem in (next(p for p in nonlinear() if p.name == "hanging chain"), too_weak()):
        sparse = replace(problem, kinds=[replace(kind, sparse=True) for kind in problem.kinds])
        first, other = Solver(library, problem).solve(), Solver(library, sparse).solve()
        assert (other.status, other.result.iterations) == (first.status, first.result.iterations)
        assert other.result.cost == pytest.approx(first.result.cost, rel=1e-8)
    failed = Solver(library, sparse, lambda what, _, k: (what, k) == ("hessian", 3)).solve()
    assert (failed.status, failed.result.stage) == ("callback failed", 3)


def test_a_pattern_must_be_one(library: Library) -> None:
    """Rows beyond the matrix, rows that do not increase, entries above the diagonal: no solver is made."""
    problem = random_problem(np.random.default_rng(0), [(2, 2, 1, 0)] * 3)
    solver = Solver(library, replace(problem, sparse=True))
    pattern = solver.size[0].patterns
    for matrix, place, row in (("de", 0, 1), ("dd", 1, 0), ("dd", 0, -1), ("h", 4, 0)):
        rows = library.ffi.cast("int *", getattr(pattern, matrix).row)
        kept, rows[place] = rows[place], row
        assert library.lib.mbs_stages_bytes(solver.c) == 0
        rows[place] = kept
    assert library.lib.mbs_stages_bytes(solver.c) == solver.bytes


def with_row(problem: Quadratic, k: int, row: Array, constant: float) -> Quadratic:
    """Add a row of e to a stage."""
    nx, nv, ne, ng = problem.sizes[k]
    sizes, E, e = list(problem.sizes), list(problem.E), list(problem.e)
    sizes[k], E[k], e[k] = (nx, nv, ne + 1, ng), np.vstack([E[k], row]), np.append(e[k], constant)
    return replace(problem, sizes=sizes, E=E, e=e)


def test_dependent_rows_are_counted_and_do_no_harm(library: Library) -> None:
    """Every stage repeats a combination of its rows: the variables agree with the dense solution."""
    rng = np.random.default_rng(5)
    problem = random_problem(rng, [(3, 3, 2, 0)] * 10 + [(3, 0, 2, 0)])
    for k in range(11):
        problem = with_row(problem, k, problem.E[k][0] + 2 * problem.E[k][1], problem.e[k][0] + 2 * problem.e[k][1])
    answer = Solver(library, problem).solve()
    assert (answer.status, answer.result.iterations, answer.result.dependent) == ("solved", 1, 11)
    assert close(answer.w, dense_solution(problem)[0], 1e-10)
    assert max(problem.residuals(*answer.point)) < 1e-9


def test_rows_are_dependent_across_stages(library: Library) -> None:
    """Nothing influences a state, and the first stage and the last one both prescribe it."""
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


def contradictory(k: int, difference: float) -> Quadratic:
    """Two of the same row with constants that differ, in stage k of 11."""
    rng = np.random.default_rng(k)
    problem = random_problem(rng, [(3, 2, 1, 1)] * 10 + [(3, 0, 1, 1)], bounds=0.3)
    return with_row(problem, k, problem.E[k][0], problem.e[k][0] + difference)


@pytest.mark.parametrize("k", [0, 4, 10])
def test_contradictory_equalities_are_named(library: Library, k: int) -> None:
    """The same row with two constants: their difference stays, in one of them or in both."""
    answer = Solver(library, contradictory(k, 0.5)).solve()
    assert answer.status == "infeasible"
    assert set(clashes(answer)) <= {(k, "e", 0), (k, "e", 1)}
    assert sum(c.violation for c in answer.result.clash) == pytest.approx(0.5, abs=1e-3)


def forbidden(seed: int) -> tuple[Quadratic, int]:
    """A row of g wants more than bounds of its stage allow by far: the problem, and the stage."""
    rng = np.random.default_rng(seed)
    problem = random_problem(rng, [(2, 3, 1, 2)] * 8 + [(2, 0, 0, 2)], bounds=0.5)
    k = int(rng.integers(1, 8))
    problem.lower[5 * k : 5 * k + 5], problem.upper[5 * k : 5 * k + 5] = -1.0, 1.0
    problem.least[2 * k] = 20 * np.abs(problem.G[k][0]).sum()
    problem.most[2 * k] = 1e20
    return problem, k


@pytest.mark.parametrize("seed", range(4))
def test_inequalities_that_bounds_forbid_are_named(library: Library, seed: int) -> None:
    problem, k = forbidden(seed)
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
    """Optimality is measured with CasADi's derivatives; to 1e-10, since either cost lacks the products of distances and
    multipliers.
    """
    answer = Solver(library, problem).solve(tol=1e-10)
    solution, statistics = problem.ipopt(**{"ipopt.tol": 1e-10})
    assert statistics["success"]
    assert answer.status == "solved"
    assert abs(answer.result.cost - solution["f"][0]) <= 1e-8 * (1 + abs(solution["f"][0]))
    assert max(problem.residuals(*answer.point)) < 1e-7


@pytest.mark.parametrize("most", [1e-1, 1e-6])
def test_violations_of_rows_end_below_their_tolerance_in_the_units_of_rows(library: Library, most: float) -> None:
    """Of 1e6 (x.x - 1): scaled by its derivatives, a row is smaller; a loose tolerance of that leaves it too large."""
    x = ca.SX.sym("x", 2)
    kind = Kind(x, ca.SX(0, 1), (x[0] - 2) ** 2 + x[1] ** 4, e=1e6 * (ca.sumsqr(x) - 1))
    problem = assemble("circle", [kind], [0], [(-free(2), free(2))], [], [np.array([3.0, 2.0])])
    answer = Solver(library, problem).solve(tol=1e-1, constr_viol_tol=most)
    assert answer.status == "solved"
    assert abs(1e6 * (answer.w @ answer.w - 1)) <= most


@pytest.mark.parametrize("tolerance", [1e-1, 1e-2])
def test_coarse_tolerances_end(library: Library, tolerance: float) -> None:
    """The barrier parameter falls until products of distances and multipliers are below their own tolerance."""
    for problem in nonlinear():
        answer = Solver(library, problem).solve(tol=tolerance)
        assert answer.status == "solved"
        assert answer.result.complementarity <= 1e-4
        assert answer.result.iterations <= Solver(library, problem).solve().result.iterations


def test_problems_are_solved_from_far_guesses(library: Library) -> None:
    """They take the watchdog, and steps that lower the errors alone; IPOPT needs more than 400 iterations for one.

    The comparison in stage_figures has the same guesses.
    """
    iterations = 0
    for problem in far_guesses(6)[6:12]:
        answer = Solver(library, problem).solve()
        assert (problem.name, answer.status) == ("pendulum, softly", "solved")
        assert max(problem.residuals(*answer.point)) < 1e-7
        iterations += answer.result.iterations
    assert iterations < 6 * 100


def test_the_barrier_parameter_falls_where_whole_steps_bring_rows_near(library: Library) -> None:
    """The bounds of the chain are far, and products of distances and multipliers follow the parameter.

    It falls before its problem is solved to 30 times the parameter, but only where rows are as near as its fourth root.
    """
    solver = Solver(library, next(p for p in nonlinear() if p.name == "hanging chain"))
    assert solver.solve().status == "solved"
    falls = [before for before, after in pairwise(solver.path) if after[5] < before[5]]
    assert any(max(violation, stationarity) > 30 * mu for _, _, _, violation, stationarity, mu, _, _ in falls)
    assert all(violation <= max(30 * mu, mu**0.25) for _, _, _, violation, _, mu, _, _ in falls)


def pendulum() -> Problem:
    return next(p for p in nonlinear() if p.name == "pendulum")


def cart_pole() -> Problem:
    return next(p for p in nonlinear() if p.name == "cart-pole")


def test_a_trial_without_numbers_shortens_the_step(either: Library) -> None:
    """One call of values fails in mid-solve; the optimum is the same."""
    whole = Solver(either, pendulum()).solve()
    answer = Solver(either, pendulum(), lambda what, call, k: (what, call, k) == ("values", 8, 3)).solve()
    assert answer.status == "solved"
    assert answer.result.evaluations > 8
    assert close(answer.w, whole.w, 1e-6 if either.real == "double" else 1e-3)


@pytest.mark.parametrize(("function", "first", "stage"), [("values", 8, 7), ("jacobians", 5, 30), ("hessian", 4, 0)])
def test_a_function_that_gives_no_numbers_ends_the_solve(
    either: Library, function: str, first: int, stage: int
) -> None:
    """The status says so, the result where; the last iterate is the one of a run without the fault."""
    fails = Solver(either, pendulum(), lambda what, call, k: what == function and call >= first and k == stage)
    answer = fails.solve()
    assert (answer.status, answer.result.stage) == ("callback failed", stage)
    assert answer.result.iterations > 0
    before = Solver(either, pendulum()).solve(max_iter=answer.result.iterations)
    assert before.status == "iteration limit"
    assert np.array_equal(answer.w, before.w)


def test_no_numbers_at_the_guess(either: Library) -> None:
    answer = Solver(either, pendulum(), lambda *call: call[2] == 2).solve()
    assert (answer.status, answer.result.stage, answer.result.iterations) == ("callback failed", 2, 0)
    assert np.isfinite(answer.w).all()


def test_limits_of_iterations_and_time(either: Library) -> None:
    """The clock of these tests counts its readings, one before the first iteration and one in each."""
    answer = Solver(either, pendulum()).solve(max_iter=3)
    assert (answer.status, answer.result.iterations) == ("iteration limit", 3)
    late = Solver(either, pendulum()).solve(max_wall_time=4.0)
    assert (late.status, late.result.iterations) == ("time limit", 3)
    assert np.array_equal(late.w, answer.w)


def test_bounds_that_cross_or_are_equal_without_room(library: Library) -> None:
    rng = np.random.default_rng(0)
    problem = random_problem(rng, [(2, 1, 0, 1)] * 3, first=False)
    solver = Solver(library, problem)
    for place, lower, upper in [(0, 1.0, 0.0), (1, float("nan"), 1.0), (2, 0.5, 0.5)]:
        kept = solver.lower.copy(), solver.upper.copy()
        solver.lower[3 + place], solver.upper[3 + place] = lower, upper
        answer = solver.solve()
        assert (answer.status, answer.result.stage) == ("bad problem", 1)
        solver.lower[:], solver.upper[:] = kept
    assert solver.solve().status == "solved"


SHAPES = [
    [(0, 3, 1, 1)],
    [(3, 0, 1, 1)],
    [(0, 2, 1, 1)] * 4,
    [(3, 0, 0, 1)] * 4,
    [(0, 2, 0, 0), (3, 1, 0, 0), (0, 2, 1, 0), (2, 0, 0, 0)],
    [(0, 0, 0, 0), (2, 1, 0, 1)],
    [(2, 1, 0, 0), (0, 0, 0, 0)],
]


@pytest.mark.parametrize("sizes", SHAPES, ids=str)
def test_stages_without_states_or_variables_and_rows_without_bounds(library: Library, sizes: list[Size]) -> None:
    """A row of g without bounds changes nothing: the solution has multiplier 0 for it, after as few iterations."""
    problem = random_problem(np.random.default_rng(0), sizes, first=False)
    if len(problem.least):
        problem.least[0], problem.most[0] = -1e20, 1e20
    answer = Solver(library, problem).solve()
    assert answer.status == "solved"
    assert answer.result.iterations <= 10
    assert max(problem.residuals(*answer.point)) < 1e-8
    assert answer.result.cost == pytest.approx(problem.ipopt()[0]["f"][0], rel=1e-7, abs=1e-7)


def test_a_scale_must_be_positive(library: Library) -> None:
    problem = random_problem(np.random.default_rng(0), [(2, 1, 0, 1)] * 3)
    for wrong in (0.0, -1.0, float("nan"), float("inf")):
        scale = np.ones(9)
        scale[4] = wrong
        assert Solver(library, replace(problem, scale=scale)).solve().status == "bad problem"


def test_a_workspace_that_is_too_small_is_refused(library: Library) -> None:
    solver = Solver(library, pendulum())
    assert (
        library.lib.mbs_stages_create(solver.c, solver.workspace + solver.offset, solver.bytes - 1) == library.ffi.NULL
    )
    solver.c.stages = 0
    assert library.lib.mbs_stages_bytes(solver.c) == 0


def test_multipliers_of_fixed_variables(library: Library) -> None:
    """They are the derivatives of the optimal cost by the fixed numbers, here by central differences."""
    rng = np.random.default_rng(1)
    problem = random_problem(rng, [(3, 2, 0, 1)] * 5 + [(3, 0, 0, 0)], bounds=0.4)
    answer = Solver(library, problem).solve(tol=1e-10)
    for i in range(3):
        costs = []
        for step in (-1e-4, 1e-4):
            moved = replace(problem, lower=problem.lower.copy(), upper=problem.upper.copy())
            moved.lower[i] = moved.upper[i] = problem.lower[i] + step
            costs.append(Solver(library, moved).solve(tol=1e-10).result.cost)
        assert answer.below[i] - answer.above[i] == pytest.approx((costs[1] - costs[0]) / 2e-4, rel=1e-5, abs=1e-6)


def test_a_warm_start_takes_few_iterations(either: Library) -> None:
    """From a solution: one or two; from a neighbour, in a loop that shifts: at most five, and fewer than cold."""
    problem = cart_pole()
    solver = Solver(either, problem)
    cold = solver.solve()
    again = solver.solve(warm_start_init_point=1)
    assert (again.status, again.result.iterations <= 2) == ("solved", True)
    for _ in range(3):
        start = solver.get("w")[5:9] + np.array([0.002, -0.002, 0.01, 0.01])
        either.lib.mbs_stages_shift(solver.solver)
        solver.lower[:4] = solver.upper[:4] = start
        loop = solver.solve(warm_start_init_point=1)
        assert loop.status == "solved"
        assert loop.result.iterations <= 5 < cold.result.iterations
        assert np.array_equal(loop.w[:4], solver.lower[:4])


def test_a_start_from_another_solution_knows_nothing_of_solves_before(either: Library) -> None:
    """Its bits do not depend on solves in the workspace; it ends as a solve from a guess, in fewer iterations."""
    first, found = Solver(either, cart_pole()).solve(), list[Answer]()
    for earlier in (0, 2):
        solver = Solver(either, cart_pole())
        for _ in range(earlier):
            solver.solve()
        solver.lower[:4] = solver.upper[:4] = [0.002, -0.002, 0.01, 0.01]
        solver.set(w=first.w, y=first.y, below=first.below, above=first.above)
        found.append(solver.solve(warm_start_init_point=2))
    cold = Solver(either, cart_pole())
    cold.lower[:4] = cold.upper[:4] = [0.002, -0.002, 0.01, 0.01]
    expected = cold.solve()
    for answer in found:
        assert answer.status == "solved"
        assert answer.result.iterations < expected.result.iterations
        assert answer.result.cost == pytest.approx(expected.result.cost, rel=1e-9 if either.real == "double" else 1e-3)
        assert all(own.tobytes() == x.tobytes() for own, x in zip(answer.point, found[0].point, strict=True))


def test_a_start_from_another_solution_ends_with_its_first_step_where_that_is_near(library: Library) -> None:
    """The barrier parameter begins with the tolerance's last one, 1e-8 / 11; elsewhere it falls on the way."""
    first, ends = Solver(library, cart_pole()).solve(), list[tuple[str, int]]()
    for move in (1e-6, 1e-2):
        solver = Solver(library, cart_pole())
        solver.lower[:4] = solver.upper[:4] = first.w[:4] + move
        solver.set(w=first.w, y=first.y, below=first.below, above=first.above)
        found = solver.solve(warm_start_init_point=2)
        assert found.result.barrier == pytest.approx(1e-8 / 11)
        ends.append((found.status, min(found.result.iterations, 2)))
    assert ends == [("solved", 1), ("solved", 2)]


def test_a_closed_loop_at_its_target_takes_few_iterations(library: Library) -> None:
    """The cost falls by eight orders of magnitude, below what the tolerance decides of it: no sample goes on."""
    start, rest = np.array([1.0, 0.0]), np.zeros(2)
    problem = shooting("pendulum", pendulum_ode, 2, 20, 0.2, start, rest, 4.0, 1.0, softly=True)
    problem.upper[2::3] = 2.0  # the barrier pushes the input at rest from 0
    solver = Solver(library, problem)
    first, costs = solver.solve().result.cost, list[float]()
    for _ in range(100):
        library.lib.mbs_stages_shift(solver.solver)
        solver.lower[:2] = solver.upper[:2] = solver.get("w")[:2]
        sample = solver.solve(warm_start_init_point=1)
        assert (sample.status, sample.result.iterations <= 3) == ("solved", True)
        assert sample.result.barrier == pytest.approx(1e-8 / 11)
        costs.append(sample.result.cost)
    assert costs[-1] < 1e-8 * first


def test_a_loose_tolerance_ends_a_solve_at_once(library: Library) -> None:
    """No further digits are found; a cost that is known to less than the tolerance's root is not called solved."""
    problem = random_problem(np.random.default_rng(0), [(2, 3, 1, 2)] * 8 + [(2, 1, 0, 0)], bounds=0.6)
    right = Solver(library, problem).solve(tol=1e-10).result.cost
    loose = Solver(library, problem).solve(tol=1e-6)
    assert (loose.status, loose.result.barrier) == ("solved", pytest.approx(1e-6 / 11))
    assert 1e-8 < abs(loose.result.cost / right - 1) < 1e-3
    small = replace(problem, H=[1e-6 * part for part in problem.H], q=[1e-6 * part for part in problem.q])
    loose = Solver(library, small).solve(tol=1e-6)
    assert (loose.status, loose.result.barrier) == ("acceptable", pytest.approx(1e-6 / 11))
    assert abs(loose.result.cost / 1e-6 / right - 1) > 1e-3


def test_a_warm_start_far_away_begins_with_a_larger_barrier_parameter(library: Library) -> None:
    """At most 1e-7 near a solution, also where rows are violated but the step to them is long; more far from it."""
    solver = Solver(library, cart_pole())
    cold = solver.solve()
    barriers = []
    for move in (0.0, 1e-4, 0.02, 1.5):
        solver.set(w=cold.w, y=cold.y, below=cold.below, above=cold.above)
        solver.lower[:4] = solver.upper[:4] = cold.w[:4] + move
        barriers.append(solver.solve(warm_start_init_point=1, max_iter=1).result.barrier)
    assert max(barriers[:3]) <= 1e-7
    assert barriers[3] > 1e-4
    assert solver.solve(warm_start_init_point=1).status == "solved"


def test_a_warm_start_takes_the_scales_of_the_solve_before(library: Library) -> None:
    """It finds derivatives once less than another solver at the same point."""
    calls: list[int] = []

    def note(function: str, call: int, stage: int) -> bool:
        if function == "jacobians" and stage == 0:
            calls.append(call)
        return False

    solver, fresh = (Solver(library, cart_pole(), note) for _ in range(2))
    cold = solver.solve()
    fresh.set(w=cold.w, y=cold.y, below=cold.below, above=cold.above)
    counts = []
    for one in (solver, fresh):
        calls.clear()
        assert one.solve(warm_start_init_point=1).status == "solved"
        counts.append(len(calls))
    assert counts[1] == counts[0] + 1


def test_curvature_is_added_from_the_stage_on_that_lacks_it(library: Library) -> None:
    """The path is another one, the optimum the same."""
    problem = next(p for p in nonlinear() if p.name == "cart-pole, collocated")
    alike, staged = (Solver(library, problem).solve(by_stage=flag) for flag in (0, 1))
    for answer in (alike, staged):
        assert answer.status == "solved"
        assert max(row[7] for row in answer.path) > 0
    assert staged.result.cost == pytest.approx(alike.result.cost, rel=1e-8)
    assert [row[7] for row in staged.path] != [row[7] for row in alike.path]


def test_an_adaptive_start_finds_the_same_optimum(library: Library) -> None:
    rng = np.random.default_rng(2)
    problem = random_problem(rng, [(3, 2, 1, 2)] * 12 + [(3, 0, 0, 1)], bounds=0.5)
    plain = Solver(library, problem).solve(tol=1e-10)
    adaptive = Solver(library, problem).solve(tol=1e-10, adaptive=1)
    assert plain.status == adaptive.status == "solved"
    assert adaptive.result.cost == pytest.approx(plain.result.cost, rel=1e-9)


@pytest.mark.parametrize("size", [1e-8, 1e-4, 1e4, 1e8])
def test_scales_of_variables_undo_their_units(library: Library, size: float) -> None:
    """Units from 1 to `size`, at random: with scales that undo them, it takes the iterations of the plain problem."""
    rng = np.random.default_rng(7)
    plain = random_problem(rng, [(3, 2, 1, 2)] * 10 + [(3, 0, 0, 1)], bounds=0.4)
    units = [size ** rng.random(len(q)) for q in plain.q]
    problem = in_units(plain, units)
    scaled_back = replace(problem, scale=1 / np.concatenate(units))
    first, scaled, raw = (Solver(library, p).solve() for p in (plain, scaled_back, problem))
    assert first.status == scaled.status == "solved"
    assert scaled.result.iterations == first.result.iterations
    assert scaled.result.cost == pytest.approx(first.result.cost, rel=1e-8)
    assert raw.status in ("solved", "out of digits")
    if raw.status == "solved" and size < 1:
        assert raw.result.cost == pytest.approx(first.result.cost, rel=1e-6)


@pytest.mark.parametrize("size", [1e-8, 1e8])
def test_scales_from_bounds_undo_units_by_themselves(library: Library, size: float) -> None:
    """Where every variable has two bounds."""
    rng = np.random.default_rng(8)
    plain = random_problem(rng, [(3, 2, 1, 2)] * 10 + [(3, 0, 0, 1)], bounds=0.4, first=False)
    plain.lower, plain.upper = np.maximum(plain.lower, -20.0), np.minimum(plain.upper, 20.0)
    units = [size ** rng.random(len(q)) for q in plain.q]
    first, other = (Solver(library, p).solve(scale_by_bounds=1) for p in (plain, in_units(plain, units)))
    assert (first.status, other.status) == ("solved", "solved")
    assert other.result.iterations == first.result.iterations
    assert other.result.cost == pytest.approx(first.result.cost, rel=1e-8)


def test_ten_thousand_stages(library: Library) -> None:
    """Memory is linear in stages; the work of an iteration is one factorisation; iterations hardly grow."""
    size, iterations = {}, {}
    for stages in (100, 200, 10_000):
        rng = np.random.default_rng(3)
        problem = random_problem(rng, [(2, 1, 0, 0)] * stages, bounds=0.3)
        solver = Solver(library, problem)
        answer = solver.solve()
        assert answer.status == "solved"
        assert answer.result.factorisations == answer.result.iterations
        assert answer.result.refinements <= 2 * answer.result.iterations
        size[stages], iterations[stages] = solver.bytes, answer.result.iterations
    a_stage = (size[200] - size[100]) / 100
    assert size[10_000] - size[100] == pytest.approx(9900 * a_stage, rel=0.01)
    assert iterations[10_000] <= 3 * iterations[100]


def test_two_threads_give_the_bits_of_one(library: Library) -> None:
    problems = [random_problem(np.random.default_rng(i), [(4, 3, 1, 2)] * 60, bounds=0.5) for i in (0, 1)]
    alone = [Solver(library, p).solve() for p in problems]
    solvers = [Solver(library, p) for p in problems]
    answers: dict[int, list[Answer]] = {0: [], 1: []}

    def work(i: int) -> None:
        for _ in range(3):
            solvers[i].set(w=problems[i].guess)
            answers[i].append(solvers[i].solve())

    threads = [threading.Thread(target=work, args=(i,)) for i in (0, 1)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for i in (0, 1):
        assert len(answers[i]) == 3
        for answer in answers[i]:
            assert all(np.array_equal(a, b) for a, b in zip(answer.point, alone[i].point, strict=True))


@pytest.mark.parametrize("problem", nonlinear(), ids=lambda p: p.name)
def test_single_precision_finds_the_same_optima(library: Library, single: Library, problem: Problem) -> None:
    """To its tolerances of 1e-4, in seven digits; the cost differs by the last barrier parameter for each bound."""
    exact, answer = Solver(library, problem).solve(), Solver(single, problem).solve()
    assert answer.status == "solved"
    assert close(answer.w, exact.w, 2e-3)
    assert answer.result.cost == pytest.approx(exact.result.cost, rel=5e-4, abs=5e-4)
    stationarity, violation, complementarity = problem.residuals(*answer.point)
    assert max(stationarity, complementarity) < 1e-3
    assert violation < 1e-4


def test_single_precision_knows_a_target_out_of_reach(library: Library, single: Library) -> None:
    """Variables come within the last digit of their bounds on the way."""
    exact, answer = Solver(library, too_weak()).solve(), Solver(single, too_weak()).solve()
    assert (exact.status, answer.status) == ("infeasible", "infeasible")
    assert clashes(answer) == clashes(exact)
    assert answer.result.clash[0].violation == pytest.approx(exact.result.clash[0].violation, rel=1e-3)


@pytest.mark.parametrize("k", [0, 4, 10])
@pytest.mark.parametrize("difference", [0.5, 0.02])
def test_single_precision_names_contradictory_equalities(single: Library, k: int, difference: float) -> None:
    """Multipliers of restoration are as large as its penalty, so their rounding is not small beside the tolerance."""
    answer = Solver(single, contradictory(k, difference)).solve()
    assert answer.status == "infeasible"
    assert set(clashes(answer)) <= {(k, "e", 0), (k, "e", 1)}
    assert sum(c.violation for c in answer.result.clash) == pytest.approx(difference, abs=2e-3)
    assert answer.result.iterations < 30


@pytest.mark.parametrize("seed", range(8))
def test_single_precision_names_inequalities_that_bounds_forbid(single: Library, seed: int) -> None:
    problem, k = forbidden(seed)
    answer = Solver(single, problem).solve()
    assert answer.status == "infeasible"
    assert clashes(answer)[0] == (k, "g", 0)


def test_objects_hold_no_state_and_need_the_mathematical_library_alone(compiled: Path) -> None:
    """No allocation, no input or output, no writable data."""
    if not shutil.which("nm"):
        pytest.skip("needs nm of binutils")
    objects = [compiled.parent / f"{path.stem}.o" for path in sources()]
    lines = subprocess.run(["nm", "-A", *map(str, objects)], check=True, capture_output=True, text=True).stdout
    symbols = [line.split()[-2:] for line in lines.splitlines()]
    assert {kind for kind, _ in symbols} <= set("TtRrUN")
    own = {name for kind, name in symbols if kind == "T"}
    assert all(name.startswith("mbs_stages_") for name in own)
    needed = {name for kind, name in symbols if kind == "U"} - own - {"_GLOBAL_OFFSET_TABLE_", "__stack_chk_fail"}
    assert needed <= {"log", "log10", "pow", "sqrt", "memcpy", "memmove", "memset"}


def test_another_compiler_warns_of_nothing(tmp_path: Path) -> None:
    """Clang here; the compiler of the other tests has warned of nothing either, in both precisions."""
    if not shutil.which("clang"):
        pytest.skip("needs clang")
    subprocess.run(["clang", *STRICT, "-fsyntax-only", *map(str, sources())], check=True, cwd=tmp_path)


def test_sanitizers_find_nothing(tmp_path: Path) -> None:
    """A separate program, with a workspace of exactly the bytes asked for, with and without inner variables.

    Nobody may touch what lies between two arrays of the workspace: each array has its full length.
    """
    place, program, layout = sources()[0].parent, tmp_path / "program.c", tmp_path / "layout.c"
    program.write_text(PROGRAM, "utf-8")
    text = (place / layout.name).read_text("utf-8")
    assert text.count(PADDED) == 1
    layout.write_text(f"#include <sanitizer/asan_interface.h>\n{text.replace(PADDED, APART)}", "utf-8")
    compiler = find_compiler(os.environ).command
    flags = [*STRICT, "-O0", "-fsanitize=address,undefined", "-fno-sanitize-recover=all", f"-I{place}"]
    files = [str(program), str(layout), *(str(path) for path in sources() if path.name != layout.name)]
    subprocess.run([*compiler, *flags, *files, "-lm", "-o", str(tmp_path / "program")], check=True)
    subprocess.run([str(tmp_path / "program")], check=True)


PADDED = "    a->used += (count * bytes + ALIGNMENT - 1) / ALIGNMENT * ALIGNMENT;\n"
APART = f"""{PADDED}    a->used += 8 * ALIGNMENT;
    if (a->base)
        ASAN_POISON_MEMORY_REGION((char *)p + count * bytes, (size_t)(a->base + a->used - (char *)p) - count * bytes);
"""
PROGRAM = r"""
#include "mbs_stages.h"
#include <stdlib.h>
#include <math.h>
/* x1' = x2, x2' = u - sin x1 by Euler's method; least u u, |u| <= limit, up at the end; x2 x2 + u <= 9 */
typedef mbs_stages_real real;
enum { N = 20 };
typedef struct { real limit; int calls, spoiled; } facts;
static int values(void *context, int k, const real *x, const real *v, real *f, real *e, real *d, real *g)
{
    facts *p = context;
    if (++p->calls == p->spoiled)
        return 1;
    if (k == N) {
        e[0] = x[0] - 3;
        e[1] = x[1];
        return 0;
    }
    *f = v[0] * v[0];
    d[0] = x[0] + x[1] / 5;
    d[1] = x[1] + (v[0] - sin(x[0])) / 5;
    g[0] = x[1] * x[1] + v[0];
    return 0;
}
static int jacobians(void *context, int k, const real *x, const real *v, real *f, real *e, real *d, real *g)
{
    (void)context;
    if (k == N) {
        e[0] = e[3] = 1;
        return 0;
    }
    f[2] = 2 * v[0];
    d[0] = d[3] = 1;
    d[2] = d[5] = (real)0.2;
    d[1] = -cos(x[0]) / 5;
    g[1] = 2 * x[1];
    g[2] = 1;
    return 0;
}
static int hessian(void *context, int k, const real *x, const real *v, real factor, const real *ye, const real *yd,
                   const real *yg, real *h)
{
    (void)context, (void)ye, (void)v;
    if (k == N)
        return 0;
    h[0] = yd[1] * sin(x[0]) / 5;
    h[4] = 2 * yg[0];
    h[8] = 2 * factor;
    return 0;
}
/* The same by implicit Euler: inner y1, y2 are the next state. */
static int inner_values(void *context, int k, const real *x, const real *v, real *f, real *e, real *d, real *g)
{
    if (k == N)
        return values(context, k, x, v, f, e, d, g);
    *f = v[2] * v[2];
    e[0] = v[0] - x[0] - v[1] / 5;
    e[1] = v[1] - x[1] - (v[2] - sin(v[0])) / 5;
    d[0] = v[0];
    d[1] = v[1];
    return 0;
}
static int inner_jacobians(void *context, int k, const real *x, const real *v, real *f, real *e, real *d, real *g)
{
    (void)context, (void)x, (void)g;
    if (k == N) {
        e[0] = e[1] = 1;
        return 0;
    }
    f[4] = 2 * v[2];
    e[0] = e[1] = -1;
    e[2] = e[5] = d[0] = d[1] = 1;
    e[3] = cos(v[0]) / 5;
    e[4] = e[6] = -(real)0.2;
    return 0;
}
static int inner_hessian(void *context, int k, const real *x, const real *v, real factor, const real *ye,
                         const real *yd, const real *yg, real *h)
{
    (void)context, (void)x, (void)yd, (void)yg;
    if (k == N)
        return 0;
    h[0] = -ye[1] * sin(v[0]) / 5;
    h[1] = 2 * factor;
    return 0;
}
static int solve_inner(real limit, mbs_stages_status expected)
{
    static const int de[] = {0, 1, 2, 4, 6, 7}, de_row[] = {0, 1, 0, 1, 0, 1, 1}, dd[] = {0, 0, 0, 1, 2, 2},
                     dd_row[] = {0, 1}, none[] = {0, 0, 0, 0, 0, 0}, h[] = {0, 0, 0, 1, 1, 2}, h_row[] = {2, 4},
                     last[] = {0, 1, 2};
    const mbs_stages_patterns middle = {{de, de_row}, {dd, dd_row}, {none, NULL}, {h, h_row}},
                              end = {{last, dd_row}, {none, NULL}, {none, NULL}, {none, NULL}};
    mbs_stages_size size[N + 1];
    real lower[5 * N + 2], upper[5 * N + 2];
    facts about = {0, 0, 0};
    mbs_stages_problem problem = {0};
    mbs_stages_status status;
    mbs_stages_point point;
    mbs_stages *solver;
    void *workspace;
    size_t bytes;
    int k, i;
    for (k = 0; k <= N; ++k) {
        const mbs_stages_size inner = {2, 3, 2, 0, 2, NULL}, final = {2, 0, 2, 0, 0, NULL};
        size[k] = k < N ? inner : final;
        size[k].patterns = k < N ? &middle : &end;
    }
    for (i = 0; i < 5 * N + 2; ++i) {
        lower[i] = i < 2 ? 0 : i % 5 == 4 ? -limit : -INFINITY;
        upper[i] = -lower[i];
    }
    problem.stages = N + 1;
    problem.size = size;
    problem.context = &about;
    problem.values = inner_values;
    problem.jacobians = inner_jacobians;
    problem.hessian = inner_hessian;
    problem.lower = lower, problem.upper = upper;
    bytes = mbs_stages_bytes(&problem);
    workspace = malloc(bytes);
    solver = mbs_stages_create(&problem, workspace, bytes);
    if (solver == NULL)
        return 1;
    point = mbs_stages_iterate(solver);
    for (i = 0; i < point.variables; ++i)
        point.w[i] = (real)0.1;
    status = mbs_stages_solve(solver, NULL).status;
    mbs_stages_shift(solver);
    free(workspace);
    return status != expected;
}
int main(void)
{
    mbs_stages_size size[N + 1];
    real lower[3 * N + 2], upper[3 * N + 2], least[N], most[N];
    facts about = {0, 0, 0};
    mbs_stages_problem problem = {0};
    mbs_stages_result result;
    int k, run;
    for (k = 0; k <= N; ++k) {
        const mbs_stages_size inner = {2, 1, 0, 1, 0, NULL}, last = {2, 0, 2, 0, 0, NULL};
        size[k] = k < N ? inner : last;
    }
    problem.stages = N + 1;
    problem.size = size;
    problem.context = &about;
    problem.values = values;
    problem.jacobians = jacobians;
    problem.hessian = hessian;
    problem.lower = lower, problem.upper = upper, problem.least = least, problem.most = most;
    for (run = 0; run < 4; ++run) {
        static const mbs_stages_status expected[] = {MBS_STAGES_SOLVED, MBS_STAGES_INFEASIBLE,
                                                     MBS_STAGES_CALLBACK_FAILED, MBS_STAGES_SOLVED};
        size_t bytes;
        void *workspace;
        mbs_stages *solver;
        about.limit = run == 1 ? (real)0.01 : 4;
        about.calls = 0;
        about.spoiled = run == 2 ? 1 : run == 3 ? 5 * (N + 1) + 3 : 0;
        for (k = 0; k < 3 * N + 2; ++k) {
            lower[k] = k < 2 ? 0 : k % 3 == 2 && k < 3 * N ? -about.limit : -INFINITY;
            upper[k] = k < 2 ? 0 : k % 3 == 2 && k < 3 * N ? about.limit : INFINITY;
        }
        for (k = 0; k < N; ++k) {
            least[k] = -INFINITY;
            most[k] = 9;
        }
        bytes = mbs_stages_bytes(&problem);
        workspace = malloc(bytes);
        solver = mbs_stages_create(&problem, workspace, bytes);
        if (solver == NULL)
            return 10;
        result = mbs_stages_solve(solver, NULL);
        mbs_stages_shift(solver);
        free(workspace);
        if (result.status != expected[run])
            return 1 + run;
    }
    if (solve_inner(4, MBS_STAGES_SOLVED))
        return 20;
    return solve_inner((real)0.01, MBS_STAGES_INFEASIBLE) ? 21 : 0;
}
"""
