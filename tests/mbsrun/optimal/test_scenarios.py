"""Scenarios that share their first inputs: the optimum of one program that CasADi has whole."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest

import mbsrun
from mbsgen.errors import InputError
from mbsrun import OptimalControl, ProblemError
from mbsrun.optimal.phases import SolvedPhases
from mbsrun.optimal.result import Solved, Unsolved

MODELS = Path(__file__).parents[3] / "models"
N, DEGREE, T, BOUND = 12, 3, 1.5, 20.0
LEANS, WEIGHTS = (0.2, 0.45, -0.1), (0.01, 0.02, 0.005)
G, CART, POLE, LENGTH = 9.81, 1.0, 0.3, 0.5  # of the model


def make_problem() -> OptimalControl:
    problem = mbsrun.read_problem(MODELS / "cart_pole_balance.ocp.yaml")
    assert isinstance(problem, OptimalControl)
    return problem.with_changes(
        horizon=T, intervals=N, degree=DEGREE, bounds={"inputs": {"cart": [-BOUND, BOUND]}}, start={"pose": {"pole": 3}}
    )


def accelerate(x: ca.SX, u: ca.SX) -> ca.SX:
    """The equations of motion as the comment of the model file has them."""
    q, qd = x[1], x[3]
    M = ca.vertcat(
        ca.horzcat(CART + POLE, POLE * LENGTH * ca.cos(q)), ca.horzcat(POLE * LENGTH * ca.cos(q), POLE * LENGTH**2)
    )
    return ca.solve(M, ca.vertcat(u + POLE * LENGTH * qd**2 * ca.sin(q), -POLE * G * LENGTH * ca.sin(q)))


def solve_whole() -> tuple[float, float]:
    """Solve all scenarios by collocation in one program of IPOPT; return the cost and the first input."""
    x, u = ca.SX.sym("x", 4), ca.SX.sym("u")
    lagrange = x[0] ** 2 + 10 * (x[1] - np.pi) ** 2 + 0.1 * (x[2] ** 2 + x[3] ** 2)
    system = ca.Function("system", [x, u], [ca.vertcat(x[2:], accelerate(x, u)), lagrange])
    C, D, B = (np.array(a) for a in ca.collocation_coeff(ca.collocation_points(DEGREE, "legendre")))
    opti, h = ca.Opti(), T / N
    first, cost = opti.variable(), ca.MX(0)
    for lean, weight in zip(LEANS, WEIGHTS, strict=True):
        mesh = ca.MX(ca.DM([0, np.pi + lean, 0, 0]))
        for k in range(N):
            points, force = opti.variable(4, DEGREE), first if k == 0 else opti.variable()
            opti.set_initial(points, np.tile([[0.0], [np.pi], [0.0], [0.0]], DEGREE))
            opti.subject_to(opti.bounded(-BOUND, force, BOUND))
            slopes, running = system(points, ca.repmat(force, 1, DEGREE))
            whole = ca.horzcat(mesh, points)
            opti.subject_to(whole @ C == h * slopes)
            cost += h * (running @ B + weight * force**2)
            mesh = whole @ D
        cost += 10 * (mesh[0] ** 2 + (mesh[1] - np.pi) ** 2)
    opti.minimize(cost)
    opti.solver("ipopt", {"ipopt.print_level": 0, "print_time": False, "ipopt.tol": 1e-10})
    solution = opti.solve()
    return float(solution.value(cost)), float(solution.value(first))


def test_scenarios_are_one_program() -> None:
    """Starts and weights differ; CasADi's program has the same cost and the same first input."""
    over = {"start.pose.pole": [np.pi + lean for lean in LEANS], "cost.inputs": list(WEIGHTS)}
    found = make_problem().with_scenarios(over).solve(check=False)
    assert isinstance(found, SolvedPhases)
    assert found.solution.run.method == "mbs"
    cost, first = solve_whole()
    assert found.cost == pytest.approx(cost, rel=1e-7)
    assert found.unknowns["first_u_cart"] == pytest.approx(first, abs=1e-5)
    for name in found.names:
        assert found[name]["u_cart"][0] == pytest.approx(first, abs=1e-5)


def test_equal_scenarios_are_the_problem_itself() -> None:
    problem = make_problem()
    alone, twice = problem.solve(check=False), problem.with_scenarios([{}, {}]).solve(check=False)
    assert isinstance(alone, Solved)
    assert isinstance(twice, SolvedPhases)
    assert twice.cost == pytest.approx(2 * alone.cost, rel=1e-7)


def test_scenarios_have_the_default_cost_or_the_price_of_an_expression() -> None:
    """The default cost is the integral of |u|^2; beside a price in CasADi, inputs cost nothing."""
    plain = mbsrun.problem(MODELS / "cart_pole.yaml", horizon=1, intervals=6, end={"pose": {"cart": 0.3}})
    symbols = plain.quantities()
    priced = plain.with_cost(symbols.q_cart**2 + symbols.u_cart**2)
    for problem in (plain, priced):
        alone, twice = problem.solve(check=False), problem.with_scenarios([{}, {}]).solve(check=False)
        assert isinstance(alone, Solved)
        assert isinstance(twice, SolvedPhases)
        assert twice.cost == pytest.approx(2 * alone.cost, rel=1e-7)


def test_a_guess_of_other_phases_is_refused() -> None:
    scenarios, wrong = make_problem().with_scenarios([{}, {}]), make_problem().with_scenarios([{}])
    given: Any
    for given, finding in (
        (make_problem().solve(check=False), "guess: found a value of type Solved; give a solution of these phases"),
        (wrong.solve(check=False), "guess: it has the phases scenario0, and none of the name scenario1"),
    ):
        with pytest.raises(ProblemError, match=finding):
            scenarios.solve(guess=given)


def test_a_file_of_the_other_kind_is_named(tmp_path: Path) -> None:
    """A motion in phases is no solution of one problem, and the other way round."""
    alone, scenarios = make_problem(), make_problem().with_scenarios([{}])
    for problem, other, finding in (
        (alone, scenarios, "it is a solution in phases; give a solution of a problem without phases"),
        (scenarios, alone, "it is a solution without phases; give a solution of a problem in phases"),
    ):
        solution = other.solve(check=False)
        assert not isinstance(solution, Unsolved)
        solution.save(tmp_path / "solution.json")
        with pytest.raises(InputError, match=finding):
            problem.load(tmp_path / "solution.json")


def test_what_scenarios_cannot_share_is_named() -> None:
    problem = make_problem()
    with pytest.raises(ProblemError, match=r"solver\.tolerance: all scenarios have it in common"):
        problem.with_scenarios({"solver.tolerance": [1e-6]})
    with pytest.raises(ProblemError, match="inputs: inputs that change within an interval; leave inputs out"):
        problem.with_changes(inputs="linear", bounds={"input_rates": [-50, 50]}).with_scenarios([{}])
    with pytest.raises(ProblemError, match="over: there is no case"):
        problem.with_scenarios([])
