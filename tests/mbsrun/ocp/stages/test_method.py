"""The project's own method by stages, as `solver.method: mbs`: optima, failures, limits and threads."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mbsrun.external import OnDemand, load_on_demand
from mbsrun.ocp.ground.status import SOLVED
from mbsrun.ocp.problem.problem import Problem, Representation
from mbsrun.ocp.solution.solution import Failure, Solution
from mbsrun.ocp.solving.runs import Progress
from mbsrun.ocp.solving.solve import Solver, solve
from mbsrun.ocp.statement.statement import read_problem
from tests.mbsrun.ocp.stages.shipped import read


@pytest.fixture(scope="module")
def swing() -> tuple[Problem, OnDemand]:
    return read("cart_pole_swing_up", intervals=10, degree=3)


@pytest.mark.parametrize("name", ["cart_pole_balance", "planar_arm_fastest", "five_bar_reach"])
def test_optima_are_those_of_ipopt(name: str) -> None:
    """Expressions of cost, a free horizon, closed loops; bounds are the same to the last digit."""
    problem, plant = read(name, intervals=8)
    problem = replace(problem, solver=replace(problem.solver, tolerance=1e-10))
    exact = replace(problem.solver, method="ipopt", options=(("bound_relax_factor", 0.0),))
    found, known = solve(problem, plant), solve(replace(problem, solver=exact), plant)
    assert isinstance(found, Solution)
    assert isinstance(known, Solution)
    assert found.run.status == SOLVED
    assert found.cost.total == pytest.approx(known.cost.total, rel=1e-8)
    assert found.violation.constraints < 1e-8


def test_other_numbers_need_no_other_tables(swing: tuple[Problem, OnDemand]) -> None:
    """One solver serves other bounds and targets; with a start that becomes free, it makes new memory."""
    problem, plant = swing
    solver = Solver(problem, plant)
    guess = solve(problem, plant)
    assert isinstance(guess, Solution)
    near = replace(problem, end=replace(problem.end, coordinates=((0, 0.9), (1, np.pi))))
    tight = replace(problem, bounds=replace(problem.bounds, u=((-15.0, 15.0),)))
    for changed in (near, tight, problem):
        outcome = solver.solve(changed, guess.trajectory)
        assert isinstance(outcome, Solution)
        other = solve(replace(changed, solver=replace(changed.solver, method="ipopt")), plant)
        assert isinstance(other, Solution)
        assert outcome.cost.total == pytest.approx(other.cost.total, rel=1e-6)


def test_a_search_after_restoration_takes_all_lengths() -> None:
    """Steps that lower errors alone end with it: this task goes on from restoration six times."""
    problem, plant = read("arm_reach", intervals=25, representation=Representation("EXP1-A"))
    problem = replace(problem, cost=replace(problem.cost, input_rates=0.0))
    angle = -0.4 * np.pi
    problem = problem.with_target("hand", (0.63 * np.cos(angle), 0.63 * np.sin(angle), -0.1))
    outcome = solve(problem, plant)
    assert isinstance(outcome, Solution)
    assert outcome.run.status == SOLVED


def test_an_infeasible_problem_names_rows_that_clash(swing: tuple[Problem, OnDemand]) -> None:
    problem, plant = swing
    outcome = solve(replace(problem, bounds=replace(problem.bounds, u=((-0.5, 0.5),))), plant)
    assert isinstance(outcome, Failure)
    assert outcome.run.status == "Infeasible_Problem_Detected"
    conditions, limits = outcome.finding.split("contradict each other: ")[1].split("; at their limits: ")
    assert "end: pole" in conditions
    assert "interval" not in conditions
    assert limits == "the bounds of the input cart"


def test_a_horizon_that_is_too_short_is_named_with_the_end(tmp_path: Path) -> None:
    """2 m at 3 m/s take 0.67 s, and the horizon has 0.4: both clash with the bounds of the velocity."""
    (tmp_path / "mass.yaml").write_text(
        "name: mass\ngravity: [0, 0, 0]\nbodies: [{name: a, joint: {type: prismatic, axis: x}, mass: 1}]\n", "utf-8"
    )
    (tmp_path / "task.ocp.yaml").write_text(
        "model: mass.yaml\nhorizon: {guess: 0.3, range: [0.1, 0.4]}\nintervals: 20\nscheme: radau\ndegree: 3\n"
        "cost: {inputs: 1}\nstart: {pose: {}}\nend: {pose: {a: 2}, velocity: zero}\nbounds: {velocities: [-3, 3]}\n",
        "utf-8",
    )
    problem, plant = read_problem(tmp_path / "task.ocp.yaml", load_on_demand)
    for method in ("mbs", "ipopt"):
        outcome = solve(problem.with_solver(method), plant)
        assert isinstance(outcome, Failure)
        named = outcome.finding.split("contradict each other: ")[1]
        for condition in ("end: a", "the range of the horizon", "the bounds of the velocity of a"):
            assert condition in named


def test_a_start_beyond_its_bounds_is_named(swing: tuple[Problem, OnDemand]) -> None:
    """The first state has equal bounds, so no search begins."""
    problem, plant = swing
    guess = solve(problem, plant)
    assert isinstance(guess, Solution)
    bounds = replace(problem.bounds, q=((0.1, 2.0), *problem.bounds.q[1:]))
    outcome = Solver(problem, plant).solve(replace(problem, bounds=bounds), guess.trajectory)
    assert isinstance(outcome, Failure)
    assert outcome.finding.endswith("contradict each other: start: cart")


def test_limits_end_a_search(swing: tuple[Problem, OnDemand]) -> None:
    problem, plant = swing
    for changes, status in (
        ({"max_iterations": 3}, "Maximum_Iterations_Exceeded"),
        ({"options": (("max_wall_time", 1e-6),)}, "Maximum_WallTime_Exceeded"),
    ):
        outcome = solve(replace(problem, solver=replace(problem.solver, **changes)), plant)  # type: ignore[arg-type]
        assert isinstance(outcome, Failure)
        assert outcome.run.status == status


def test_an_exception_in_a_watch_ends_the_search(swing: tuple[Problem, OnDemand]) -> None:
    problem, plant = swing
    seen: list[Progress] = []

    def stop(progress: Progress) -> None:
        seen.append(progress)
        if progress.iteration == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        solve(problem, plant, stop)
    assert [p.iteration for p in seen] == [0, 1, 2]


def test_threads_share_tables_and_nothing_else(swing: tuple[Problem, OnDemand]) -> None:
    """One solver in two threads: each solve is the one that it is alone, to the last bit."""
    problem, plant = swing
    guess = solve(problem, plant)
    assert isinstance(guess, Solution)
    targets = [replace(problem, end=replace(problem.end, coordinates=((0, x), (1, np.pi)))) for x in (0.8, 1.0, 1.2)]

    def run(solver: Solver, target: Problem) -> float:
        outcome = solver.solve(target, guess.trajectory)
        assert isinstance(outcome, Solution)
        return outcome.cost.total

    alone = [run(Solver(problem, plant), target) for target in targets]
    shared = Solver(problem, plant)
    with ThreadPoolExecutor(2) as pool:
        assert list(pool.map(lambda target: run(shared, target), targets * 2)) == alone * 2
