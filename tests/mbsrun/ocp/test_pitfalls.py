"""Where optimal control goes wrong without a word: coarse meshes, many minima, motions that double every instant."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from mbsrun.ocp.ground.schemes import Family
from mbsrun.ocp.guessing.guess import interpolate
from mbsrun.ocp.problem.problem import Cost, Term
from mbsrun.ocp.solution.solution import Failure, Solution
from mbsrun.ocp.solving.resimulation import resimulate
from mbsrun.ocp.solving.solve import Solver, solve
from studies.laboratory.optimisation import state_catch, state_swing_up
from tests.mbsrun.ocp.plants import cart_pole, unstable
from tests.mbsrun.peer import Peer


@pytest.fixture(scope="module")
def plant() -> Peer:
    return cart_pole()


def test_success_on_a_coarse_mesh_is_not_accuracy(plant: Peer) -> None:
    """Degree 3: IPOPT succeeds on each mesh; the defect shows which to believe, and falls by orders as N doubles."""
    defects = []
    for N in (4, 10, 20, 40):
        outcome = solve(state_swing_up(N, 3), plant)
        assert isinstance(outcome, Solution)
        assert outcome.run.status == "Solve_Succeeded"
        check = resimulate(outcome, plant).resimulation
        assert check is not None
        assert check.defect is not None
        assert check.open_loop_error is not None
        assert check.is_accurate == (check.defect <= 1e-6)
        assert check.open_loop_error > check.defect  # the plant amplifies it
        defects.append(check.defect)
    assert defects[0] > 1e-2
    assert (np.diff(np.log2(defects)) < -2).all()


def test_a_fine_mesh_is_accurate(plant: Peer) -> None:
    """Degree 5, 80 intervals: the force is constant on each, so the cost is above the continuous optimum, 58.81."""
    outcome = solve(state_swing_up(80, 5), plant)
    assert isinstance(outcome, Solution)
    check = resimulate(outcome, plant).resimulation
    assert check is not None
    assert check.is_accurate
    assert 58.8076 < outcome.cost.total < 1.01 * 58.8076


def test_random_starts_end_in_several_minima(plant: Peer) -> None:
    """Forty starts: the published optimum is one of several local minima, and failures have a failing status."""
    problem = state_swing_up(25, 3)
    solver, found, failed = Solver(problem, plant), Counter[float](), 0
    smooth = interpolate(problem, solver.transcription.scheme, np.array([1.0, np.pi]))
    for seed in range(40):
        rng = np.random.default_rng(seed)
        u = rng.uniform(-20, 20, smooth.u.shape)
        noise = rng.normal(0, 1, smooth.point_q.shape)
        start = replace(smooth, u=u, point_q=smooth.point_q + noise, q=smooth.q + rng.normal(0, 1, smooth.q.shape))
        outcome = solver.solve(problem, start)
        if isinstance(outcome, Failure):
            failed += 1
            assert outcome.run.status != "Solve_Succeeded"
        else:
            found[round(outcome.cost.total, 2)] += 1
    assert sum(found.values()) + failed == 40
    assert len(found) > 1
    assert min(found) < 1.05 * 58.8076


@pytest.mark.parametrize("rate", [5.0, 10.0, 20.0])
def test_collocation_solves_what_single_shooting_cannot(rate: float) -> None:
    """exp(rate T) is up to 2e17: from a guess of zeros, in at most 50 iterations; intervals bound the growth."""
    problem = state_catch(40, 4)
    plant = unstable(rate)
    solver = Solver(problem, plant)
    zeros = interpolate(replace(problem, start_q=(0.0,)), solver.transcription.scheme, np.zeros(1))
    outcome = solver.solve(problem, zeros)
    assert isinstance(outcome, Solution)
    assert outcome.run.iterations <= 50
    assert abs(outcome.trajectory.q[-1, 0]) < 1e-7


@pytest.mark.parametrize("family", [Family.RADAU, Family.LEGENDRE])
def test_a_cost_at_degree_one_is_not_halved(plant: Peer, family: Family) -> None:
    """The force squared as an expression, by the scheme's quadrature, is h |u|^2 exactly; CasADi's weight is 1/2."""
    problem = replace(state_swing_up(80, 1), family=family, cost=Cost(running=(Term("u_cart**2", 1.0),)))
    outcome = solve(problem, plant)
    assert isinstance(outcome, Solution)
    assert outcome.cost.total == pytest.approx((outcome.trajectory.u**2).sum() * 2.0 / 80, rel=1e-12)
    assert float(ca.collocation_coeff([1.0])[2]) == 0.5
