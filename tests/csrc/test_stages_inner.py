"""Inner variables of stages: the same problems with and without condensing, singular equations, restoration."""

from __future__ import annotations

import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.csrc.stage_arm import arm
from tests.csrc.stage_problems import collocated, nonlinear, steep, turning
from tests.csrc.stage_quadratics import SIZES, condensed, dense_solution, in_units, random_problem
from tests.csrc.stages import (
    INFINITE,
    Answer,
    Array,
    Library,
    Problem,
    Quadratic,
    Solver,
    clashes,
    close,
    compile_solver,
)


def meet(problem: Quadratic, k: int, w: Array) -> None:
    """Change constants so that w meets the equations of stage k."""
    at = sum(nx + nv for nx, nv, _, _ in problem.sizes[:k])
    problem.e[k] = -problem.E[k] @ w[at : at + problem.E[k].shape[1]]


def agree(a: Answer, b: Answer, tolerance: float = 1e-9) -> None:
    """The same way to the same iterate, to rounding. That may decide whether the last error is small enough.

    It may also decide by how much the barrier falls at the end, where multipliers have fewer digits without its fall.
    """
    assert a.status == b.status
    shorter, longer = sorted((a, b), key=lambda answer: len(answer.path))
    common = len(shorter.path)
    assert common > 1
    for column in (2, 6):  # costs and lengths of steps
        assert close(*(np.array([row[column] for row in way[:common]]) for way in (a.path, b.path)), 1e-8)
    if len(longer.path) > common:
        assert len(longer.path) == common + 1
        assert 0.1e-8 < max(longer.path[common - 1][3:5]) < 10e-8
        tolerance = max(tolerance, 1e-6)  # the last barrier differs
    assert close(a.w, b.w, tolerance)
    same = a.result.iterations == b.result.iterations
    assert close(a.y, b.y, tolerance if same else max(tolerance, 1e-8))


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("sparse", [False, True])
def test_condensed_problems_have_the_iterates_of_whole_ones(library: Library, seed: int, sparse: bool) -> None:
    """Bounds and inequalities of inner variables, dense matrices and patterns."""
    rng = np.random.default_rng(seed)
    problem = random_problem(rng, SIZES, bounds=0.4, share=(1.0, 0.6)[seed % 2])
    whole = Solver(library, problem).solve()
    answer = Solver(library, condensed(problem, sparse=sparse)).solve()
    assert answer.status == "solved"
    agree(answer, whole)
    assert max(problem.residuals(*answer.point)) < 1e-8


def test_lanes_are_vectors_or_loops(library: Library, tmp_path: Path) -> None:
    """Other compilers than gcc and clang get loops."""
    scalar = Library(compile_solver(tmp_path, "-DMBS_SCALAR"))
    for problem in (condensed(random_problem(np.random.default_rng(1), SIZES, bounds=0.4)), collocated(12, 0.05, 2.0)):
        agree(Solver(scalar, problem).solve(), Solver(library, problem).solve())


@pytest.mark.parametrize("unread", [3, 4, 9])
@pytest.mark.parametrize("singular", [False, True])
def test_states_that_no_inner_equation_reads(library: Library, unread: int, singular: bool) -> None:
    """The first states are left out of the elimination, in lanes of four; redundant rows widen some stages."""
    rng = np.random.default_rng(unread)
    problem = random_problem(rng, [(10, 7, 4, 2)] * 7 + [(10, 0, 0, 0)], bounds=0.3)
    w = Solver(library, problem).solve().w
    for k in range(7):
        problem.E[k][:, :unread] = 0.0
        if singular and k % 3 == 1:
            problem.E[k][:, 11] = problem.E[k][:, 10]
        meet(problem, k, w)
    answer = Solver(library, condensed(problem, [4] * 7 + [0])).solve()
    assert answer.result.singular == (2 if singular else 0)
    agree(answer, Solver(library, problem).solve(), 1e-7 if singular else 1e-9)  # the last barrier may differ


@pytest.mark.parametrize("first", [True, False])
def test_condensed_linear_quadratic_problems_have_the_solution_of_dense_algebra(library: Library, first: bool) -> None:
    """One step; some inner variables are fixed."""
    rng = np.random.default_rng(5)
    for _ in range(5):
        problem = random_problem(rng, [(a, b + 1, c, 0) for a, b, c, _ in SIZES], first=first)
        at = [3 + 10 * k + i for k in (0, 3) for i in range(2)]
        problem.lower[at] = problem.upper[at] = rng.standard_normal(4)
        w, y, unique = dense_solution(problem)
        answer = Solver(library, condensed(problem)).solve()
        assert (answer.status, unique) == ("solved", True)
        assert answer.result.iterations <= 1
        assert close(answer.w, w, 1e-10)
        assert close(answer.y, y, 1e-9)
        assert max(problem.residuals(*answer.point)) < 1e-8


def test_an_arm_of_collocation_points(library: Library) -> None:
    """Pivots are found in sparse equations of 72 unknowns; one order serves all intervals."""
    problem = arm(np.random.default_rng(0), 6)
    answer = Solver(library, problem).solve()
    agree(answer, Solver(library, replace(problem, inner=None, sparse=False)).solve())
    assert max(problem.residuals(*answer.point)) < 1e-8


@pytest.mark.parametrize("missing", [1, 2])
@pytest.mark.parametrize("stages", [[2], [0, 1, 2, 3, 4]])
def test_inner_rows_that_do_not_give_their_variables(library: Library, missing: int, stages: list[int]) -> None:
    """Columns of the block repeat each other, but outer variables and other rows close the system."""
    rng = np.random.default_rng(3)
    problem = random_problem(rng, SIZES, bounds=0.3)
    w = Solver(library, problem).solve().w
    for k in stages:
        problem.E[k][:4, 4 : 4 + missing] = problem.E[k][:4, 3:4]
        meet(problem, k, w)
    whole, answer = Solver(library, problem).solve(), Solver(library, condensed(problem)).solve()
    assert answer.result.singular == len(stages)
    agree(answer, whole)


def test_more_missing_variables_than_the_recursion_has_room_for(library: Library) -> None:
    """Twelve columns of the block are 0. The result counts the stage; where the status says so, there is a solution."""
    rng = np.random.default_rng(4)
    problem = random_problem(rng, [(2, 16, 14, 0)] * 3 + [(2, 0, 0, 0)])
    w = Solver(library, problem).solve().w
    problem.E[1][:, 2:14] = 0.0
    meet(problem, 1, w)
    answer = Solver(library, condensed(problem, [14, 14, 14, 0])).solve(max_iter=50)
    assert answer.result.singular == 1
    if answer.status == "solved":
        assert max(problem.residuals(*answer.point)) < 1e-7


def test_more_small_pivots_than_the_recursion_has_room_for(library: Library) -> None:
    """Twelve columns of the block are small; where the room ends, small pivots are used."""
    rng = np.random.default_rng(4)
    problem = random_problem(rng, [(2, 17, 14, 0)] * 3 + [(2, 0, 0, 0)])
    w = Solver(library, problem).solve().w
    problem.E[1][:, 2:14] *= 1e-7
    meet(problem, 1, w)
    answer = Solver(library, condensed(problem, [14, 14, 14, 0])).solve()
    assert (answer.status, answer.result.singular, answer.result.dependent) == ("solved", 1, 0)
    assert close(answer.w, Solver(library, problem).solve().w, 1e-5)


def test_redundant_inner_rows_do_no_harm(library: Library) -> None:
    """Each stage repeats an inner row, and an inner variable is in no row: the whole problem has the same optimum."""
    rng = np.random.default_rng(6)
    problem = random_problem(rng, [(3, 6, 4, 0)] * 6 + [(3, 0, 0, 0)])
    for k in range(6):
        problem.E[k][3] = problem.E[k][0]
        problem.E[k][:, 6] = 0.0
        problem.e[k][3] = problem.e[k][0]
    answer = Solver(library, condensed(problem, [4] * 6 + [0])).solve()
    assert (answer.status, answer.result.singular, answer.result.dependent) == ("solved", 6, 6)
    assert close(answer.w, Solver(library, problem).solve().w, 1e-8)
    assert max(problem.residuals(*answer.point)) < 1e-8


def test_stages_may_need_other_pivots(library: Library) -> None:
    """The entries that one half of the stages takes pivots from vanish in the other half, or nearly."""
    for tiny in (0.0, 1e-13, 1e-9):
        rng = np.random.default_rng(7)
        problem = random_problem(rng, [(3, 6, 4, 0)] * 12 + [(3, 0, 0, 0)], bounds=0.3)
        w = Solver(library, problem).solve().w
        strong = np.eye(4) + 0.1 * rng.standard_normal((4, 4))
        for k in range(12):
            turned = np.roll(strong * np.where(np.eye(4) > 0, 1.0, tiny), k // 6, axis=1)
            problem.E[k][:, 3:7] = turned
            meet(problem, k, w)
        answer = Solver(library, condensed(problem, [4] * 12 + [0])).solve()
        agree(answer, Solver(library, problem).solve(), 1e-8)
        assert answer.result.singular == 0


@pytest.mark.parametrize("tiny", [1e-5, 1e-6, 1e-7, 3e-8, 1e-8, 1e-9, 1e-12])
@pytest.mark.parametrize("free", [1, 3])
@pytest.mark.parametrize("repeated", [False, True])
def test_inner_rows_that_hardly_give_a_variable(library: Library, tiny: float, free: int, repeated: bool) -> None:
    """Outer variables move it millions of units, and the square of this number takes all digits from other costs."""
    rng = np.random.default_rng(8)
    problem = random_problem(rng, [(3, 4 + free, 4, 0)] * 6 + [(3, 0, 0, 0)], bounds=0.3)
    w = Solver(library, problem).solve().w
    for k in (1, 2, 4):
        E = problem.E[k]
        E[:, 6] = tiny * E[:, 6] + (E[:, 5] if repeated else 0.0)
        meet(problem, k, w)
    whole, answer = Solver(library, problem).solve(), Solver(library, condensed(problem, [4] * 6 + [0])).solve()
    assert (whole.status, answer.status) == ("solved", "solved")
    assert answer.result.iterations <= whole.result.iterations + 3
    assert close(answer.w, whole.w, 1e-7)
    assert close(answer.y, whole.y, 1e-7)
    assert max(problem.residuals(*answer.point)) < 1e-8


def test_a_lack_of_curvature_is_no_loss_of_digits(library: Library) -> None:
    """Outer variables move inner ones by 1e5, and a free one within bounds has negative curvature.

    What a factorisation lacks is larger than rounding: it gets curvature, and nothing is left to the recursion.
    """
    rng = np.random.default_rng(8)
    problem = random_problem(rng, [(3, 7, 4, 0)] * 6 + [(3, 0, 0, 0)], bounds=0.3)
    w = Solver(library, problem).solve().w
    for k in (1, 2, 4):
        problem.E[k][:, 6] *= 1e-5
        meet(problem, k, w)
        at = 10 * k + 9
        problem.H[k][9, 9] -= 100.0
        problem.lower[at], problem.upper[at] = w[at] - 0.5, w[at] + 0.5
    answer = Solver(library, condensed(problem, [4] * 6 + [0])).solve()
    assert (answer.status, answer.result.singular) == ("solved", 0)
    assert answer.result.factorisations > answer.result.iterations
    assert max(problem.residuals(*answer.point)) < 1e-7


@pytest.mark.parametrize("size", [1e-8, 1e8])
def test_units_of_inner_variables_and_rows(library: Library, size: float) -> None:
    """Scales undo units that differ by eight orders of magnitude."""
    rng = np.random.default_rng(8)
    plain = random_problem(rng, SIZES, bounds=0.4)
    units = [size ** rng.random(len(q)) for q in plain.q]
    problem = condensed(replace(in_units(plain, units), scale=1 / np.concatenate(units)))
    first, other = Solver(library, condensed(plain)).solve(), Solver(library, problem).solve()
    assert (other.status, other.result.iterations) == ("solved", first.result.iterations)
    assert other.result.cost == pytest.approx(first.result.cost, rel=1e-8)


def repeated(stages: int) -> Quadratic:
    """The same stage again and again, which the origin is feasible in."""
    one, last = random_problem(np.random.default_rng(3), [(2, 3, 2, 0)] * 2), stages - 1
    bound = np.tile([INFINITE, 1.0, 0.5, INFINITE, 1.0], stages)
    none = np.zeros(0)
    return Quadratic(
        [(2, 3, 2, 0)] * stages,
        H=[one.H[0]] * stages,
        q=[one.q[0]] * stages,
        F=[one.F[0]] * last + [np.zeros((0, 5))],
        b=[np.zeros(2)] * last + [none],
        E=[one.E[0]] * stages,
        e=[np.zeros(2)] * stages,
        G=[np.zeros((0, 5))] * stages,
        lower=-bound,
        upper=bound,
        least=none,
        most=none,
        guess=np.zeros(5 * stages),
        inner=[2] * stages,
        sparse=True,
    )


def test_ten_thousand_condensed_stages(library: Library) -> None:
    """Memory is linear in stages, and iterations hardly grow."""
    size, iterations = {}, {}
    for stages in (100, 200, 10_000):
        solver = Solver(library, repeated(stages))
        answer = solver.solve()
        assert answer.status == "solved"
        assert answer.result.factorisations == answer.result.iterations
        size[stages], iterations[stages] = solver.bytes, answer.result.iterations
    a_stage = (size[200] - size[100]) / 100
    assert size[10_000] - size[100] == pytest.approx(9900 * a_stage, rel=0.01)
    assert iterations[10_000] <= 3 * iterations[100]


def collocation(*, inner: int, sparse: bool = True) -> Problem:
    problem = next(p for p in nonlinear() if p.name == "cart-pole, collocated")
    return replace(problem, kinds=[replace(problem.kinds[0], inner=inner, sparse=sparse), problem.kinds[1]])


def test_a_condensed_nonlinear_problem_has_the_optimum_of_ipopt(library: Library) -> None:
    """Accelerations at points of Gauss are inner. Curvature is added on the way, to other variables alone."""
    problem = collocation(inner=4)
    answer, whole = Solver(library, problem).solve(), Solver(library, collocation(inner=0, sparse=False)).solve()
    assert (answer.status, whole.status) == ("solved", "solved")
    assert answer.result.iterations <= whole.result.iterations
    assert min(max(row[7] for row in one.path) for one in (answer, whole)) > 0
    assert answer.result.cost == pytest.approx(whole.result.cost, rel=1e-8)
    assert answer.result.cost == pytest.approx(problem.ipopt()[0]["f"][0], rel=1e-8)
    assert max(problem.residuals(*answer.point)) < 1e-7


def test_a_condensed_problem_that_is_infeasible(library: Library) -> None:
    """The force cannot swing the pole up in time: restoration keeps the inner rows, and names rows between stages."""
    problem = collocated(12, 0.05, 2.0)
    problem = replace(problem, kinds=[replace(problem.kinds[0], inner=4, sparse=True), problem.kinds[1]])
    answer = Solver(library, problem).solve()
    assert (answer.status, problem.ipopt()[1]["return_status"]) == ("infeasible", "Infeasible_Problem_Detected")
    assert {kind for _, kind, _ in clashes(answer)} <= {"d", "e"}
    assert answer.result.clash[0].violation > 0.1


def test_two_threads_give_the_bits_of_one_where_stages_are_condensed(library: Library) -> None:
    problems = [arm(np.random.default_rng(i), 4, 2, 1, 2) for i in (0, 1)]
    alone = [Solver(library, p).solve() for p in problems]
    solvers = [Solver(library, p) for p in problems]
    answers: list[list[Answer]] = [[], []]

    def work(i: int) -> None:
        for _ in range(5):
            solvers[i].set(w=problems[i].guess)
            answers[i].append(solvers[i].solve())

    threads = [threading.Thread(target=work, args=(i,)) for i in (0, 1)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for i in (0, 1):
        assert len(answers[i]) == 5
        for answer in answers[i]:
            assert all(np.array_equal(a, b) for a, b in zip(answer.point, alone[i].point, strict=True))


def test_condensing_in_single_precision(library: Library, single: Library) -> None:
    """Optima to three digits of seven."""
    for problem in (
        arm(np.random.default_rng(0), 5, 2, 1, 2),
        condensed(random_problem(np.random.default_rng(4), SIZES)),
    ):
        exact, answer = Solver(library, problem).solve(), Solver(single, problem).solve()
        assert answer.status in ("solved", "acceptable")
        assert close(answer.w, exact.w, 5e-3)
        assert answer.result.cost == pytest.approx(exact.result.cost, rel=1e-3)


def test_inner_variables_may_follow_the_others(library: Library) -> None:
    """Refused trials then meet the inner equations, so longer steps pass; the optimum is the same."""
    usual, followed = (Solver(library, steep()).solve(follow=follow) for follow in (0, 1))
    assert (usual.status, followed.status) == ("solved", "solved")
    assert followed.result.cost == pytest.approx(usual.result.cost, rel=1e-9)
    assert followed.path[1][6] >= 2 * usual.path[1][6]  # the first step
    assert 3 * followed.result.iterations < 2 * usual.result.iterations
    assert max(steep().residuals(*followed.point)) < 1e-8


def test_a_cold_solve_does_not_depend_on_the_solves_before_it(library: Library) -> None:
    """The order of pivots is found anew, so that all numbers are the same, to the last bit."""
    problem = turning()
    first = Solver(library, problem).solve()
    used = Solver(library, problem)
    used.set(w=np.concatenate([np.full(5, np.pi / 2)] * 6 + [np.zeros(2)]))
    assert used.solve(max_iter=1).result.factorisations > 0
    used.set(w=problem.guess)
    again = used.solve()
    assert again.path == first.path
    assert (again.w == first.w).all()
    assert (again.y == first.y).all()
