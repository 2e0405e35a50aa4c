"""Newton steps in real time, split into preparation and feedback: one step, many steps, and closed loops."""

from __future__ import annotations

import itertools
import os
import subprocess
from dataclasses import replace
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest

from mbsrun.library import find_compiler
from tests.csrc.stage_problems import POLE, UP, cart_pole_ode, nonlinear, pendulum_ode, shooting
from tests.csrc.stage_quadratics import dense_solution, random_problem, random_sizes
from tests.csrc.stages import STRICT, Array, Library, Problem, Quadratic, Solver, sources


def state(problem: Problem | Quadratic) -> Array:
    """The fixed first state."""
    first: Array = problem.lower[: problem.sizes[0][0]].copy()
    return first


def moved(problem: Quadratic, first: Array) -> Quadratic:
    """The same problem with another first state."""
    lower, upper = problem.lower.copy(), problem.upper.copy()
    lower[: len(first)] = upper[: len(first)] = first
    return replace(problem, lower=lower, upper=upper)


@pytest.mark.parametrize("stages", [1, 2, 3, 7, 20])
def test_a_step_solves_linear_quadratic_problems(library: Library, stages: int) -> None:
    """The preparation knows another first state than the feedback; variables and multipliers are the dense ones."""
    rng = np.random.default_rng(stages)
    for _ in range(4):
        problem = random_problem(rng, random_sizes(rng, stages, 5))
        w, y, unique = dense_solution(problem)
        first = state(problem)
        solver = Solver(library, moved(problem, first + rng.standard_normal(len(first))))
        status, figures = solver.prepare()
        assert (status, figures.factorisations, figures.curvature) == ("prepared", 1, 0.0)
        status, v, figures = solver.feedback(first)
        assert (status, figures.length) == ("stepped", 1.0)
        assert figures.deviation > 0
        assert np.allclose(solver.get("w"), w, rtol=1e-10, atol=1e-10)
        assert np.array_equal(v, solver.get("w")[len(first) : len(first) + len(v)])
        if unique:
            assert np.allclose(solver.get("y"), y, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("sparse", [False, True])
def test_a_step_with_inner_variables(library: Library, sparse: bool) -> None:
    """Unknowns within intervals are condensed; the response to a deviation recovers them."""
    rng = np.random.default_rng(3)
    plain = random_problem(rng, [(3, 6, 5, 0)] * 6 + [(3, 1, 1, 0)])
    w, y, _ = dense_solution(plain)
    first = state(plain)
    moved_one = moved(plain, first + rng.standard_normal(3))
    solver = Solver(library, replace(moved_one, inner=[4] * 6 + [1], sparse=sparse))
    assert solver.prepare()[0] == "prepared"
    assert solver.feedback(first)[0] == "stepped"
    assert np.allclose(solver.get("w"), w, rtol=1e-10, atol=1e-10)
    assert np.allclose(solver.get("y"), y, rtol=1e-9, atol=1e-9)


def test_first_states_without_equal_bounds_are_free(library: Library) -> None:
    """The measurement of such a state is not read: here it is no number."""
    problem = random_problem(np.random.default_rng(0), [(3, 2, 1, 0)] * 5 + [(3, 0, 0, 0)])
    problem.lower[1], problem.upper[1] = -1e20, 1e20
    solver = Solver(library, problem)
    solver.prepare()
    assert solver.feedback(np.array([problem.lower[0], np.nan, problem.lower[2]]))[0] == "stepped"
    assert np.allclose(solver.get("w"), dense_solution(problem)[0], atol=1e-10)


@pytest.mark.parametrize("problem", nonlinear(), ids=lambda p: p.name)
def test_steps_converge_to_the_solution_at_their_barrier_parameter(library: Library, problem: Problem) -> None:
    """Quadratically in the end, from a point nearby; slacks and multipliers stay positive."""
    answer = Solver(library, problem).solve(mu_target=1e-3, tol=1e-9)
    assert (answer.status, answer.result.barrier) == ("solved", pytest.approx(1e-3, rel=1e-12))
    solver = Solver(library, problem)
    solver.set(w=answer.w + 0.02 * np.random.default_rng(1).standard_normal(len(answer.w)))
    errors = []
    for _ in range(12):
        assert solver.prepare(mu_target=1e-3)[0] == "prepared"
        status, _, figures = solver.feedback(state(problem))
        assert status == "stepped"
        bounded = (problem.lower > -1e19) & (problem.lower < problem.upper)
        assert (solver.get("below")[bounded] > 0).all()
        assert (solver.get("w")[bounded] > problem.lower[bounded]).all()
        errors.append(np.abs(solver.get("w") - answer.w).max())
    assert min(errors) < 1e-6  # the solve ends where the conditions hold to 1e-8
    assert figures.stationarity < 1e-6
    assert figures.violation < 1e-8
    before, after = next((a, b) for a, b in itertools.pairwise(errors) if a < 1e-2)
    assert after < 30 * before**2 + 1e-7


def balance() -> list[Problem]:
    """Horizons of controllers: a pendulum and a cart-pole, to be swung up and balanced."""
    return [
        shooting("pendulum", pendulum_ode, 2, 25, 0.1, np.zeros(2), UP, 4.0, 1.0, softly=True),
        shooting("cart-pole", cart_pole_ode, 4, 30, 0.06, np.zeros(4), POLE, 12.0, 1.0, softly=True),
    ]


def follow(solver: Solver, problem: Problem, steps: int, kicks: dict[int, Array], **options: Any) -> list[Array]:
    """The states of the closed loop; inputs must keep their bounds."""
    advance = problem.kinds[0].functions[0]
    nx = problem.sizes[0][0]
    limit = problem.upper[nx]
    states = [state(problem)]
    for i in range(steps):
        assert solver.prepare(shift=i > 0, **options)[0] == "prepared"
        status, v, _ = solver.feedback(states[-1])
        assert status == "stepped"
        assert abs(v[0]) < limit
        ahead = advance(states[-1], v.astype(solver.library.dtype).astype(np.float64))[2]
        states.append(np.asarray(ahead).ravel() + kicks.get(i, 0.0))
    return states


@pytest.mark.parametrize("i", [0, 1])
def test_closed_loops_swing_up_and_balance(library: Library, i: int) -> None:
    """One step a period, with kicks on the way and at the top; torque and force stay within limits."""
    problem, target = balance()[i], (UP, POLE)[i]
    solver = Solver(library, problem)
    assert solver.solve().status == "solved"
    rng = np.random.default_rng(0)
    kicks = {k: 0.1 * rng.standard_normal(len(target)) for k in (5, 12, 40)}
    states = follow(solver, problem, 90, kicks)
    assert np.abs(states[-1] - target).max() < 0.1
    assert np.abs(states[-1] - target).max() < np.abs(states[41] - target).max() / 3


def test_a_cold_start_in_the_loop_converges(library: Library) -> None:
    """Without a solve before it: the guess of the problem, and multipliers of 0."""
    problem = balance()[0]
    states = follow(Solver(library, problem), problem, 90, {})
    assert np.abs(states[-1] - UP).max() < 1e-3


def test_the_nominal_loop_follows_the_solution(library: Library) -> None:
    """With the problem solved, shifted steps keep to the optimal path: the horizon ends at rest, wherever it ends."""
    problem = shooting("pendulum", pendulum_ode, 2, 60, 0.1, np.zeros(2), UP, 4.0, 1.0, softly=True)
    solver = Solver(library, problem)
    w = solver.solve(mu_target=1e-3).w
    states = follow(solver, problem, 40, {}, mu_target=1e-3)
    planned = [w[3 * k : 3 * k + 2] for k in range(41)]
    assert np.abs(np.array(states) - planned).max() < 1e-4


@pytest.mark.parametrize("function", ["values", "jacobians", "hessian"])
def test_a_callback_without_numbers_keeps_the_iterate(library: Library, function: str) -> None:
    """The status names the stage; feedback has the inputs of the plan, and the next period goes on."""
    broken = False
    problem = balance()[0]
    solver = Solver(library, problem, lambda what, _, k: broken and what == function and k == 7)
    assert solver.solve().status == "solved"
    follow(solver, problem, 3, {})
    kept = [solver.get(name) for name in ("w", "y", "below", "above")]
    broken = True
    status, figures = solver.prepare()
    assert (status, figures.stage) == ("callback failed", 7)
    status, v, _ = solver.feedback(state(problem))
    assert status == "not prepared"
    assert np.array_equal(v, kept[0][2:3])
    broken = False
    assert all(np.array_equal(solver.get(n), a) for n, a in zip(("w", "y", "below", "above"), kept, strict=True))
    assert solver.prepare()[0] == "prepared"
    assert solver.feedback(kept[0][:2])[0] == "stepped"


def test_feedback_needs_numbers_and_a_preparation(library: Library) -> None:
    """A measurement that is no number leaves the preparation for the next one."""
    problem = balance()[0]
    solver = Solver(library, problem)
    assert solver.feedback(np.zeros(2))[0] == "not prepared"
    solver.prepare()
    status, v, figures = solver.feedback(np.array([0.0, np.nan]))
    assert (status, figures.stage, v[0]) == ("bad problem", 0, problem.guess[2])
    assert solver.feedback(np.zeros(2))[0] == "stepped"
    assert solver.feedback(np.zeros(2))[0] == "not prepared"
    solver.upper[5] = solver.lower[5] - 1
    status, figures = solver.prepare()
    assert (status, figures.stage) == ("bad problem", 1)


def stepped(library: Library, problem: Problem, steps: int = 3, **options: Any) -> Solver:
    """A solver after a solve and some steps, with a plan that violates its equations a little."""
    solver = Solver(library, problem)
    assert solver.solve(**options).status == "solved"
    follow(solver, problem, steps, {0: np.array([0.2, -0.1])}, **options)
    return solver


def test_a_plan_that_violates_too_much_has_diverged(library: Library) -> None:
    """No step is made from it, and it stays, until there is another one; the limit is of the violation."""
    problem = balance()[0]
    solver = stepped(library, problem)
    violation = solver.prepare()[1].violation
    assert violation > 0
    assert solver.prepare(most_violation=1.001 * violation)[0] == "prepared"
    status, figures = solver.prepare(most_violation=0.999 * violation)
    assert (status, figures.violation) == ("diverged", violation)
    kept = solver.get("w")
    status, v, _ = solver.feedback(state(problem))
    assert (status, v[0]) == ("not prepared", kept[2])
    assert np.array_equal(solver.get("w"), kept)
    assert solver.prepare()[0] == "prepared"


@pytest.mark.parametrize(("factor", "status"), [(0.99, "prepared"), (1.01, "diverged")])
def test_a_plan_has_diverged_beyond_ten_times_the_first_one(library: Library, factor: float, status: str) -> None:
    """By default; the measure is the largest number of the plan that steps began with, here 5: the torque, or more."""
    problem = balance()[0]
    solver = Solver(library, problem)
    w = solver.solve().w
    follow(solver, problem, 1, {})
    broken = solver.get("w")
    broken[3 * 7 : 3 * 7 + 2] += [0.0, 10 * factor * np.abs(w).max()]  # a row of the stage before it, almost exactly
    solver.set(w=broken)
    assert solver.prepare(most_violation=1e9)[1].violation == pytest.approx(10 * factor * np.abs(w).max(), rel=2e-3)
    assert solver.prepare()[0] == status


def scaled(problem: Problem, rng: np.random.Generator) -> Problem:
    """The problem with other usual sizes of its variables."""
    return replace(problem, scale=10.0 ** rng.uniform(-1.5, 1.5, len(problem.guess)))


def test_figures_of_a_step_have_the_units_of_the_caller(library: Library) -> None:
    """Stationarity and violation of the plan before a step, by CasADi's derivatives; the deviation alone is scaled.

    Multipliers are near the central path, so that none is limited; one step on, slacks and multipliers are its own.
    """
    problem = scaled(balance()[0], np.random.default_rng(4))
    problem = replace(problem, kinds=[replace(kind, cost=1000 * kind.cost) for kind in problem.kinds])
    assert problem.scale is not None
    solver = stepped(library, problem, 2, mu_target=1.0)
    w, y, below, above = (solver.get(name) for name in ("w", "y", "below", "above"))
    _, figures = solver.prepare(mu_target=1.0)
    fixed = problem.lower == problem.upper
    nlp = problem.program["nlp"]
    rows = np.asarray(ca.Function("rows", [nlp["x"]], [nlp["g"]])(w)).ravel()  # all are equations
    free = lagrangian(problem, w, y) - below + above
    assert figures.stationarity == pytest.approx(np.abs(free[~fixed]).max(), rel=1e-6)
    assert figures.violation == pytest.approx(np.abs(rows).max(), rel=1e-6)
    bounded = ~fixed & (problem.lower > -1e19)
    products = np.abs((w - problem.lower)[bounded] * below[bounded] - 1.0)
    bounded = ~fixed & (problem.upper < 1e19)
    products = np.append(products, np.abs((problem.upper - w)[bounded] * above[bounded] - 1.0))
    assert figures.complementarity == pytest.approx(products.max(), rel=1e-6)
    first = w[:2] + np.array([0.3, -0.7])
    _, _, figures = solver.feedback(first)
    assert figures.deviation == pytest.approx(np.abs((first - w[:2]) / problem.scale[:2]).max(), rel=1e-9)
    assert np.allclose(solver.get("w")[:2], first, rtol=1e-14)


def lagrangian(problem: Problem, w: Array, y: Array) -> Array:
    """The gradient of cost and rows."""
    nlp = problem.program["nlp"]
    multipliers = ca.MX.sym("y", nlp["g"].numel())
    gradient = ca.gradient(nlp["f"] + ca.dot(multipliers, nlp["g"]), nlp["x"])
    return np.asarray(ca.Function("l", [nlp["x"], multipliers], [gradient])(w, y)).ravel()


@pytest.mark.parametrize(("given", "product"), [(1e9, 100.0), (0.0, 0.01), (50.0, 50.0), (0.02, 0.02)])
@pytest.mark.parametrize("side", ["below", "above"])
def test_multipliers_of_a_plan_are_limited(library: Library, side: str, given: float, product: float) -> None:
    """A step begins with products of distances and multipliers from a hundredth to a hundred times the barrier's."""
    problem, mu = balance()[0], 1e-3
    solver = stepped(library, problem, 1, mu_target=mu)
    w, multipliers = solver.get("w"), solver.get(side)
    distance = (w - problem.lower if side == "below" else problem.upper - w)[2]
    multipliers[2] = given * mu / distance if given < 1e9 else given
    solver.set(**{side: multipliers})
    _, figures = solver.prepare(mu_target=mu)
    assert figures.complementarity == pytest.approx(
        max(abs(product - 1) * mu, others(solver, problem, side, mu)), rel=1e-6
    )


def others(solver: Solver, problem: Problem, side: str, mu: float) -> float:
    """The largest error of the other products."""
    w, most = solver.get("w"), 0.0
    for name, distance in (("below", w - problem.lower), ("above", problem.upper - w)):
        z, kept = solver.get(name), (distance < 1e19) & (problem.lower < problem.upper)
        if name == side:
            kept[2] = False
        ratio = np.clip(distance[kept] * z[kept] / mu, 0.01, 100)
        most = max(most, float(np.abs(ratio - 1).max(initial=0)) * mu)
    return most


@pytest.mark.parametrize("side", ["lower", "upper"])
def test_a_plan_outside_of_its_bounds_is_put_on_the_central_path(library: Library, side: str) -> None:
    """Bounds may change between periods: variables come inside, and a step goes on from there."""
    problem, mu = balance()[0], 1e-3
    solver = stepped(library, problem, 1, mu_target=mu)
    at = np.flatnonzero((problem.lower > -1e19) & (problem.lower < problem.upper))
    u = solver.get("w")[at]
    bounds = solver.lower if side == "lower" else solver.upper
    bounds[at] = np.median(u)
    assert (solver.get("w")[at] < solver.lower[at]).any() or (solver.get("w")[at] > solver.upper[at]).any()
    status, figures = solver.prepare(mu_target=mu)
    assert status == "prepared"
    assert figures.complementarity <= 99.001 * mu
    assert solver.feedback(state(problem))[0] == "stepped"
    assert (solver.get("w")[at] > solver.lower[at]).all()
    assert (solver.get("w")[at] < solver.upper[at]).all()


@pytest.mark.parametrize("relax", [0.0, 1e-8, 1e-3])
def test_a_step_goes_almost_to_a_bound(library: Library, relax: float) -> None:
    """99 % of the way to the bound that gives, each variable its own; the figure is the least part that one took."""
    problem, options = balance()[0], {"mu_target": 1e-3, "bound_relax_factor": relax}
    solver = stepped(library, problem, 1, **options)
    before = solver.get("w")
    solver.prepare(**options)
    _, _, figures = solver.feedback(np.array([3.0, 6.0]))  # far away: inputs hit their bounds
    after, at = solver.get("w"), np.flatnonzero((problem.upper < 1e19) & (problem.lower < problem.upper))
    bounds = [
        bound[at] + sign * relax * np.maximum(1, abs(bound[at]))
        for sign, bound in ((-1, problem.lower), (1, problem.upper))
    ]
    parts = [(after[at] - before[at]) / (bound - before[at]) for bound in bounds]
    assert np.maximum(*parts).max() == pytest.approx(0.99, abs=1e-9)
    assert 0 < figures.length < 1


def test_a_guess_is_no_divergence(library: Library) -> None:
    """Steps may begin with a guess, whose violation is the measure of later ones; a solve begins anew."""
    problem = balance()[0]
    solver = Solver(library, problem)
    guess = 300.0 * np.ones(len(problem.guess))
    solver.set(w=guess)
    assert solver.prepare()[0] == "prepared"
    solver.feedback(state(problem))
    solver.set(w=guess)
    assert solver.prepare()[0] == "prepared"
    solver.set(w=1e12 * guess)
    assert solver.prepare()[0] == "diverged"
    solver.set(w=problem.guess)
    assert solver.solve().status == "solved"
    assert solver.prepare()[0] == "prepared"


def test_curvature_is_added_and_remembered(library: Library) -> None:
    """Concave costs: the second preparation starts from the amount of the first one, so it tries less often."""
    problem = random_problem(np.random.default_rng(0), [(2, 2, 0, 0)] * 6 + [(2, 0, 0, 0)])
    for H in problem.H[:-1]:
        H[3, 3] = -5.0
    problem.lower[:], problem.upper[:] = np.maximum(problem.lower, -9.0), np.minimum(problem.upper, 9.0)
    solver = Solver(library, problem)
    _, first = solver.prepare(mu_target=1e-2)
    assert solver.feedback(state(problem))[0] == "stepped"
    _, second = solver.prepare(mu_target=1e-2)
    assert first.curvature > 0
    assert second.curvature > 0
    assert second.factorisations < first.factorisations


def test_single_precision_in_the_loop(library: Library, single: Library) -> None:
    problem = balance()[0]
    ends = []
    for one in (library, single):
        solver = Solver(one, problem)
        solver.solve(mu_target=1e-3)
        ends.append(follow(solver, problem, 70, {}, mu_target=1e-3)[-1])
    assert np.abs(ends[1] - UP).max() < 1e-2


def test_the_example_balances(tmp_path: Path) -> None:
    """Under sanitizers; its exit status says whether the pendulum is up and all periods had a step."""
    place = sources()[0].parent
    flags = [*STRICT, "-O1", "-fsanitize=address,undefined", "-fno-sanitize-recover=all", f"-I{place}"]
    files = [str(place / "example" / "balance.c"), *map(str, sources())]
    program = tmp_path / "balance"
    command = [*find_compiler(os.environ).command, *flags, *files, "-lm", "-o", str(program)]
    subprocess.run(command, check=True)
    shown = subprocess.run([str(program)], check=True, capture_output=True, text=True).stdout
    assert "0 failures" in shown
