"""The judge: the decrease of a cost that is still possible, to first order; and the method that is asked next."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import sparse
from scipy.optimize import linprog

from mbsrun.external import OnDemand, load_on_demand
from mbsrun.ocp import methods
from mbsrun.ocp.ground.functions import Array
from mbsrun.ocp.ground.program import Matrix
from mbsrun.ocp.ground.status import ACCEPTABLE, NOT_FEASIBLE, NOT_OPTIMAL, SOLVED, STALLED
from mbsrun.ocp.methods import METHODS, Answer, Assignment, Instance, Method
from mbsrun.ocp.problem.phases import Phase, PhasedProblem, Plants
from mbsrun.ocp.problem.problem import Bounds, Cost, End, Problem, SolverOptions, Term
from mbsrun.ocp.searching.multistart import Wish, solve_from_many
from mbsrun.ocp.showing.summary import summarise
from mbsrun.ocp.solution.phases import PhasedSolution
from mbsrun.ocp.solution.solution import Failure, Solution, read_solution, write_solution
from mbsrun.ocp.solving.optimality import Judgement, Point, bound, judge, linearise
from mbsrun.ocp.solving.phases import solve_phases
from mbsrun.ocp.solving.solve import Solver, solve
from mbsrun.ocp.statement.statement import read_problem
from mbsrun.tracking.solving import SolvingController
from studies.laboratory.ends import draw
from tests.mbsrun.ocp.plants import push

MASS = """
name: mass
gravity: [0, 0, 0]
bodies:
  - {name: slide, joint: {type: prismatic, axis: x}, mass: 1}
"""
FREE = (-np.inf, np.inf)
LEAST = 12 / (1 - 1 / 64)  # the cost of the push by 8 constant inputs


def test_products_with_slopes_have_the_bits_of_the_matrix() -> None:
    """Entries are summed column by column, in the order of their rows, as SciPy does."""
    rng = np.random.default_rng(3)
    J = Matrix(sparse.random_array((40, 30), density=0.2, rng=rng, format="csc"))
    point = linearise(np.zeros(30), np.zeros(40), np.zeros(30), J, (np.zeros(30), np.ones(30)), (-np.ones(40),) * 2)
    y = rng.normal(size=point.slopes.shape[0])
    assert point.J.shape[0] == point.slopes.shape[0] > 30
    assert np.array_equal(point.slopes.multiply(y), y @ point.J)


def at(
    x: Sequence[float],
    c: Sequence[float],
    bounds: Sequence[tuple[float, float]],
    rows: Sequence[tuple[Sequence[float], tuple[float, float]]] = (),
    scales: Sequence[float] | None = None,
) -> Point:
    """A linear program about a point; each row has its coefficients and its range."""
    J = np.array([row for row, _ in rows]).reshape(len(rows), len(x))
    lower, upper = np.array(bounds, dtype=np.float64).T
    least, most = np.array([limits for _, limits in rows], dtype=np.float64).reshape(-1, 2).T
    point, sizes = np.array(x, dtype=np.float64), np.array(scales or [1.0] * len(x))
    c, rows_of = np.array(c, dtype=np.float64), Matrix(sparse.csc_array(J))
    return linearise(point, J @ point, c, rows_of, (lower, upper), (least, most), sizes)


SMALL = {
    "at its lower bound": (at([0], [1], [(0, 9)]), 0.0),
    "at a distance from it": (at([0.25], [1], [(0, 9)]), 0.25),
    "at the wrong bound": (at([0], [-1], [(0, 9)]), 1.0),
    "as far as the region goes": (at([5], [1], [(-100, 100)]), 5.0),
    "fixed": (at([3], [7], [(3, 3)]), 0.0),
    "a row instead of a bound": (at([0.25], [1], [FREE], [([2.0], (0.0, 9.0))]), 0.25),
    "a row instead of a bound, negative": (at([0.25], [1], [FREE], [([-2.0], (-9.0, 0.0))]), 0.25),
    "the same row twice": (at([0, 0], [1, 1], [FREE] * 2, [([1.0, 1.0], (0.0, 9.0))] * 2), 0.0),
    "no interior": (
        at([0, 0], [1, 1], [FREE] * 2, [([1.0, 1.0], (0.0, np.inf)), ([1.0, 1.0], (-np.inf, 0.0))]),
        0.0,
    ),
    "an equation, and a free direction": (at([0, 0], [1, 0], [FREE] * 2, [([1.0, 1.0], (0.0, 0.0))]), 1.0),
    "an equation, and a bound on the way": (at([0, 0.5], [1, 0], [FREE, (0, 0.75)], [([1.0, 1.0], (0.5, 0.5))]), 0.25),
    "violated, which nothing has to mend": (at([-1], [-1], [(0, 9)]), 1.0),
    "violated, where the cost would go on": (at([-1], [1], [(0, 9)]), 0.0),
}


@pytest.mark.parametrize(("point", "chi"), SMALL.values(), ids=SMALL.keys())
def test_what_a_cost_can_fall_by(point: Point, chi: float) -> None:
    """By hand. The bound is chi itself where least squares or linear programming end; it is never below."""
    found, _ = bound(point, 0.0)
    assert found == pytest.approx(chi, abs=1e-9)


def random_point(rng: np.random.Generator) -> tuple[Point, float]:
    """A random linear program with degenerate bounds and rows, and its chi by another route."""
    n, m = int(rng.integers(2, 12)), int(rng.integers(1, 8))
    J = rng.standard_normal((m, n))
    J[m // 2 :] = J[: m - m // 2]  # rows twice
    x = rng.uniform(-2, 2, n)
    low = x - rng.choice([0.0, 1e-9, 0.5, np.inf], n)
    high = x + rng.choice([0.0, 1e-9, 0.5, np.inf], n)
    g = J @ x
    least = g - rng.choice([0.0, 1e-9, 0.5, np.inf], m)
    most = g + rng.choice([0.0, 1e-9, 0.5, np.inf], m)
    c = rng.standard_normal(n)
    size = np.maximum(1.0, np.abs(x))
    pairs = np.stack([np.maximum(low - x, -size), np.minimum(high - x, size)], axis=1)
    pairs[low == high] = 0.0
    room = np.concatenate([np.where(least == most, 0.0, most - g), np.where(least == most, 0.0, g - least)])
    kept = np.isfinite(room)
    exact = linprog(c, A_ub=np.vstack([J, -J])[kept], b_ub=room[kept], bounds=pairs)
    point = linearise(x, g, c, Matrix(sparse.csc_array(J)), (low, high), (least, most))
    return point, -float(exact.fun)


@pytest.mark.parametrize("seed", range(40))
def test_chi_is_the_linear_program_and_no_multipliers_go_below(seed: int) -> None:
    """Weak duality: a bound by any multipliers is not below the decrease that a step reaches."""
    rng = np.random.default_rng(seed)
    point, chi = random_point(rng)
    found, is_exact = bound(point, 0.0)
    assert found == pytest.approx(chi, abs=1e-7)
    for scale in (0.1, 1.0, 1e6):
        guessed, _ = bound(replace(point), np.inf, scale * rng.standard_normal(point.rows.size))
        assert guessed >= chi - 1e-9
    assert is_exact or chi <= 1e-9


def test_multipliers_of_a_solver_are_a_proof() -> None:
    """min x + y over x + y >= 1, x >= 0: one product is left over, and nothing else has to be solved."""
    point = at([0.5, 0.5 + 1e-9], [1, 1], [(0, 9), FREE], [([1.0, 1.0], (1.0, np.inf))])
    found, is_exact = bound(point, 1e-8, np.array([-1.0]))
    assert found == pytest.approx(1e-9, rel=1e-6)
    assert not is_exact


@pytest.mark.parametrize(
    ("gradient", "is_optimal"),
    [((1e-20, 0), True), ((2.9e-8, -2.9e-8), True), ((2e-7, -2e-7), False), ((0, 3.1e-6), False)],
)
def test_a_gradient_within_the_tolerance_lowers_nothing(gradient: tuple[float, float], is_optimal: bool) -> None:
    """A cost of weight 3: 3e-8 in each variable of size 1 is left by a tolerance of 1e-8."""
    assert judge(at([0, 0], gradient, [FREE] * 2), 1e-8, 3.0).is_optimal == is_optimal


@pytest.mark.parametrize(
    "cost", ["(sin(q_slide) - 0.3)**2", "(sin(q_slide) - 0.3)**4", "(exp(q_slide) - 2)**2 + qd_slide**2"]
)
@pytest.mark.parametrize("method", [None, "ipopt"])
def test_a_cost_of_squares_may_be_zero(cost: str, method: str | None, mass: OnDemand) -> None:
    """The gradient vanishes with the cost, and the answer is a solution, of `mbs` or of IPOPT after it."""
    asked = replace(
        push(8),
        cost=Cost(terminal=(Term(cost, 1.0),)),
        end=End(),
        solver=SolverOptions(method=method),
    )
    outcome = solve(asked, mass)
    assert isinstance(outcome, Solution), outcome.finding
    assert outcome.cost.total == pytest.approx(0.0, abs=1e-9)


def test_what_is_allowed_grows_with_the_tolerance() -> None:
    """1e-6 of the gradient's reach, and the products that methods call 0; a looser tolerance allows more."""
    point = at([2.0, 0.0], [1, 1], [(0, 9), (0, 9)])
    sides = 2 + 2 / 7 + 1 / 9  # two bounds are in the region; two are 3.5 and 9 times as far as it goes
    assert (point.reach, point.sides) == (3.0, pytest.approx(sides))
    tight, loose = judge(point, 1e-8, 5.0), judge(point, 1e-4, 5.0)
    assert tight.allowed == pytest.approx(3e-6 + 1e-8 * 5 * sides)
    assert loose.allowed == pytest.approx(3e-2 + 1e-4 * 5 * sides)
    assert (tight.decrease, tight.ratio) == (pytest.approx(2.0), pytest.approx(2 / 3))
    assert not tight.is_optimal


@pytest.mark.parametrize("limit", [2.0, 30.0])
def test_far_bounds_have_multipliers_too(limit: float) -> None:
    """A coordinate at 0 and a bound at b >= 1: a barrier parameter mu leaves z = mu / b there, which lowers by z."""
    mu, weight = 1e-8, 100.0
    point = at([0.0, 0.0], [-weight * mu / limit, 1e-2], [(-np.inf, limit), FREE], [([0.0, 1.0], (0.0, 0.0))])
    assert judge(point, mu, weight).is_optimal
    assert not judge(replace(point, c=point.c * [1e3, 1]), mu, weight).is_optimal


def test_violations_count_by_the_size_of_rows() -> None:
    """1e-3 of a row that changes by 2000 in the region are 5e-7; a bound counts by its variable."""
    point = at([1.0, 1.0], [0, 0], [FREE] * 2, [([1e3, 1e3], (2000.001, 3000.0))])
    assert point.violation == pytest.approx(5e-7, rel=1e-3)
    assert judge(point, 1e-8, 1.0).is_feasible
    beyond = at([4.0], [0], [(0.0, 3.0)])
    assert beyond.violation == pytest.approx(0.25)
    assert not judge(beyond, 1e-8, 1.0).is_feasible


@pytest.mark.parametrize("unit", [1e-7, 1.0, 1e7])
def test_units_decide_no_judgement(unit: float) -> None:
    """A bound and a row that are violated by a part of their size, and a cost that can fall by as much, in any unit."""
    near, far = 3e-7, 3e-5
    for part in (near, far):
        sizes, free = [unit, unit], [FREE] * 2
        bounds = at([-part * unit, 0], [0, 0], [(0, 9 * unit), FREE], [], sizes)
        row = at([unit, part * unit], [0, 0], free, [([1.0, 1.0], (-unit, unit))], sizes)
        assert judge(bounds, 1e-8, 1.0).is_feasible == judge(row, 1e-8, 1.0).is_feasible == (part == near)
    falls = at([0.5 * unit, 0], [1 / unit, 0], [(0, 9 * unit), FREE], [], [unit, unit])
    assert falls.reach == pytest.approx(1.0)
    assert judge(falls, 1e-8, 1.0).decrease == pytest.approx(0.5)


# --- answers of methods -----------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def mass(tmp_path_factory: pytest.TempPathFactory) -> OnDemand:
    path = tmp_path_factory.mktemp("models") / "mass.yaml"
    path.write_text(MASS, encoding="utf-8")
    return OnDemand(path)


def read(number: int, folder: Path) -> tuple[Problem, OnDemand]:
    problem, plant = read_problem(draw(number).write(folder), load_on_demand)
    assert isinstance(plant, OnDemand)
    return problem, plant


@pytest.mark.parametrize("number", [0, 2, 3, 6, 9, 12])
def test_degenerate_optima_are_no_false_alarms(number: int, tmp_path: Path) -> None:
    """IPOPT's answers at ends on limits, with rows twice and without an interior; its multipliers are not needed."""
    problem, plant = read(number, tmp_path)
    problem = problem.with_solver("ipopt")
    outcome = solve(problem, plant)
    assert isinstance(outcome, Solution)
    assert outcome.run.decrease is not None
    alone = judge_alone(outcome, plant)
    assert alone.is_optimal
    assert alone.is_feasible


def judge_alone(solution: Solution, plant: OnDemand) -> Judgement:
    """Judge a motion without multipliers."""
    solver = Solver(solution.problem, plant)
    own, functions = solver.transcription, solver.program.numpy
    x, p = own.pack(solution.trajectory), own.parameters(solution.problem)
    values = functions.constraint(x, p), functions.gradient(x, p), functions.jacobian(x, p)
    point = linearise(x, *values, own.variable_bounds(solution.problem), own.constraint_bounds(solution.problem))
    return judge(point, solution.problem.solver.tolerance, max(solution.problem.cost.weights))


def test_multipliers_of_both_methods_agree(mass: OnDemand) -> None:
    """Where they are unique: rows of a push, L = f + y'g."""
    found = []
    for method in ("mbs", "ipopt"):
        problem = replace(push(8), solver=SolverOptions(method=method))
        solver = Solver(problem, mass)
        own = solver.transcription
        order = Assignment(solver.program, 1e-10, 100, 0.5, {}, 1)
        limits = (*own.variable_bounds(problem), *own.constraint_bounds(problem))
        guess = np.random.default_rng(0).standard_normal(solver.program.data.variables)
        answer = METHODS[method].make(order)(Instance(guess, own.parameters(problem), *limits))
        assert answer.multipliers is not None
        found.append(answer.multipliers)
        gradient = solver.program.numpy.gradient(answer.x, own.parameters(problem))
        rest = gradient + answer.multipliers @ solver.program.numpy.jacobian(answer.x, own.parameters(problem))
        inner = np.isinf(limits[0]) & np.isinf(limits[1])
        assert np.abs(rest[inner]).max() < 1e-6
    assert np.allclose(*found, atol=1e-6 * np.abs(found[1]).max())


def test_the_gap_of_a_convex_program_bounds_the_error(mass: OnDemand) -> None:
    """A push is a convex quadratic program with a known optimum, by any of its forms; an arm is none."""
    outcome = solve(push(8), mass)
    assert isinstance(outcome, Solution)
    assert outcome.run.gap is not None
    assert abs(outcome.cost.total - LEAST) <= outcome.run.gap + 1e-9
    assert "gap of duality" in summarise(outcome)["optimality"]


def test_an_arm_is_not_convex(tmp_path: Path) -> None:
    outcome = solve(*read(3, tmp_path))
    assert isinstance(outcome, Solution)
    assert outcome.run.gap is None
    assert outcome.run.decrease is not None


Fault = str  # what the method gives: a wrong point as solved, or no answer


def spoil(monkeypatch: pytest.MonkeyPatch, change: str, method: str = "mbs") -> list[str]:
    """Make a method call a wrong point solved, or give up; return the list of its calls."""
    own, calls = METHODS[method], list[str]()

    def make(order: Assignment) -> methods.Solver:
        right = own.make(order)

        def solve_wrongly(start: Instance) -> Answer:
            calls.append(change)
            if change == "gives up":
                return Answer(start.x, STALLED, 7)
            answer = right(start)
            if change == "stalls":
                return replace(answer, status=STALLED)
            return replace(answer, x=move(answer.x, start, order, change), status=SOLVED, iterations=5)

        return solve_wrongly

    changed = {**METHODS, method: Method(own.title, own.options, make, own.warm, own.calls_casadi, own.has_threads)}
    monkeypatch.setattr("mbsrun.ocp.solving.phases.METHODS", changed)
    return calls


def move(x: Array, start: Instance, order: Assignment, change: str) -> Array:
    """Move the optimum of a linear program of rows: along them, or off them."""
    step = np.random.default_rng(0).standard_normal(x.size)
    if change == "not optimal":
        J = order.program.numpy.jacobian(x, start.parameters).toarray()
        step -= np.linalg.pinv(J) @ (J @ step)
    return np.asarray(x + 1e-2 * step)


def test_a_wrong_answer_is_no_solution(mass: OnDemand, monkeypatch: pytest.MonkeyPatch) -> None:
    """The solver's word is good; the judge refuses it, and the failure says why."""
    alone = replace(push(8), solver=SolverOptions(fallback=False))
    for change, status in (("not optimal", NOT_OPTIMAL), ("not feasible", NOT_FEASIBLE)):
        with monkeypatch.context() as patch:
            spoil(patch, change)
            outcome = solve(alone, mass)
        assert isinstance(outcome, Failure)
        assert outcome.run.status == status
        assert "called it solved after 5 iterations" in outcome.finding
    assert "lower the cost" in solve_failing(alone, mass, monkeypatch, "not optimal").finding


def solve_failing(problem: Problem, plant: OnDemand, monkeypatch: pytest.MonkeyPatch, change: str) -> Failure:
    with monkeypatch.context() as patch:
        spoil(patch, change)
        outcome = solve(problem, plant)
    assert isinstance(outcome, Failure)
    return outcome


def test_an_optimum_without_more_digits_is_acceptable(mass: OnDemand, monkeypatch: pytest.MonkeyPatch) -> None:
    """The search stalls at the optimum, and the judge says so; where it stalls elsewhere, there is no solution."""
    alone = replace(push(8), solver=SolverOptions(fallback=False))
    with monkeypatch.context() as patch:
        spoil(patch, "stalls")
        outcome = solve(alone, mass)
    assert isinstance(outcome, Solution)
    assert outcome.run.status == ACCEPTABLE
    assert outcome.cost.total == pytest.approx(LEAST, rel=1e-7)
    assert solve_failing(alone, mass, monkeypatch, "gives up").run.status == STALLED


@pytest.mark.parametrize("change", ["gives up", "not optimal", "not feasible"])
def test_ipopt_solves_what_mbs_does_not(
    change: str, mass: OnDemand, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """By itself; one sentence says so in the summary and in the file, and the problem stays as it was asked."""
    spoil(monkeypatch, change)
    outcome = solve(push(8), mass)
    assert isinstance(outcome, Solution)
    assert outcome.run.method == "ipopt"
    assert outcome.run.instead.startswith("mbs had no answer (the ")
    assert outcome.run.instead.endswith("); this one is of ipopt")
    assert outcome.cost.total == pytest.approx(LEAST, rel=1e-7)
    assert outcome.problem == push(8)
    assert summarise(outcome)["  instead"] == outcome.run.instead
    write_solution(outcome, tmp_path / "solution.json")
    assert read_solution(tmp_path / "solution.json").run.instead == outcome.run.instead


OPTIONS = {
    "named": (SolverOptions(method="mbs"), False),
    "forbidden": (SolverOptions(fallback=False), False),
    "named, and permitted": (SolverOptions(method="mbs", fallback=True), True),
    "by default": (SolverOptions(), True),
}


@pytest.mark.parametrize(("options", "falls_back"), OPTIONS.values(), ids=OPTIONS.keys())
def test_options_decide_whether_ipopt_is_asked(
    options: SolverOptions, falls_back: bool, mass: OnDemand, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls = spoil(monkeypatch, "gives up")
    outcome = solve(replace(push(8), solver=options), mass)
    assert calls
    assert isinstance(outcome, Solution) == falls_back
    assert methods.settle(options).falls_back == methods.warm(options).falls_back == falls_back


def test_where_both_fail_the_first_failure_names_the_other(mass: OnDemand) -> None:
    """Infeasible for both: the status is of `mbs`."""
    weak = replace(push(8), bounds=Bounds((FREE,), (FREE,), ((-1.0, 1.0),)))
    outcome = solve(weak, mass)
    assert isinstance(outcome, Failure)
    assert outcome.run.method == "mbs"
    assert "ipopt, asked next, had no answer either (" in outcome.finding


def test_answers_of_mbs_are_not_asked_for_twice(mass: OnDemand, monkeypatch: pytest.MonkeyPatch) -> None:
    calls = spoil(monkeypatch, "gives up", "ipopt")
    outcome = solve(push(8), mass)
    assert isinstance(outcome, Solution)
    assert (outcome.run.method, outcome.run.instead, calls) == ("mbs", "", [])


def test_phases_fall_back_too(mass: OnDemand, monkeypatch: pytest.MonkeyPatch) -> None:
    """A single phase is a problem of phases as well."""
    problem = PhasedProblem("push", (Phase("only", push(8)),), ())
    plants = Plants((mass,))
    for change in ("gives up", "not optimal"):
        with monkeypatch.context() as patch:
            spoil(patch, change)
            outcome = solve_phases(problem, plants)
            assert isinstance(outcome, PhasedSolution)
            assert outcome.run.method == "ipopt"
            assert "mbs had no answer" in outcome.run.instead
            alone = replace(problem, solver=SolverOptions(fallback=False))
            assert isinstance(solve_phases(alone, plants), Failure)


def test_starts_of_a_search_do_not_fall_back_but_the_search_does(
    mass: OnDemand, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Three starts fail, and the first one is solved by IPOPT at the end."""
    spoil(monkeypatch, "gives up")
    starts, outcome = solve_from_many(push(8), mass, None, Wish(3), tmp_path / "starts.sqlite", lambda _: None)
    assert [start.status for start in starts.results] == ["Search_Direction_Becomes_Too_Small"] * 3
    assert isinstance(outcome, Solution)
    assert "mbs had no answer" in outcome.run.instead


def test_controllers_do_not_fall_back(mass: OnDemand, monkeypatch: pytest.MonkeyPatch) -> None:
    """A sample keeps its inputs where `mbs` has no answer."""
    controller = SolvingController(push(8), mass, 0.1)
    controller.prepare(0.0, {})
    spoil(monkeypatch, "gives up")
    decision = controller.feedback(np.zeros(1), np.zeros(1))
    assert decision.status == "Search_Direction_Becomes_Too_Small"
