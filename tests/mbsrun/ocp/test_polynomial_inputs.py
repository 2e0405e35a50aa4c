"""Inputs that are polynomials over each interval: `inputs: polynomial`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from benchmarks.kkt.problems import PROBLEMS
from benchmarks.kkt.transcription import collocate, transcribe
from mbsrun import Mechanism, load
from mbsrun.ocp.ground.schemes import Family
from mbsrun.ocp.problem.problem import Form, Problem
from mbsrun.ocp.solution.solution import Solution, read_solution, write_solution
from mbsrun.ocp.solution.table import list_motion
from mbsrun.ocp.solving.resimulation import resimulate
from mbsrun.ocp.solving.solve import solve
from mbsrun.ocp.statement.checks import ProblemError
from mbsrun.ocp.statement.statement import read_problem

CART_POLE = Path(__file__).parents[3] / "models" / "classics" / "cart_pole.ocp.yaml"
QUIET = {"print_time": False, "ipopt": {"print_level": 0, "sb": "yes"}}


@pytest.fixture(scope="module")
def cart_pole() -> tuple[Problem, Mechanism]:
    problem, plant = read_problem(CART_POLE, load)
    return replace(problem, intervals=25), plant


def solve_it(problem: Problem, plant: Mechanism) -> Solution:
    found = solve(problem, plant)
    assert isinstance(found, Solution), found
    return found


@pytest.mark.parametrize(
    ("family", "degree", "method"), [("radau", 3, "ipopt"), ("legendre", 2, "ipopt"), ("radau", 2, "mbs")]
)
def test_optimum_is_the_one_of_plain_casadi(
    cart_pole: tuple[Problem, Mechanism], family: str, degree: int, method: str
) -> None:
    """The peer has its own equations, and an input at each point: both programs are one."""
    problem = replace(cart_pole[0], family=Family(family), degree=degree).with_solver(method)
    found = solve_it(problem, cart_pole[1])
    peer = next(p for p in PROBLEMS if p.name == "cart-pole")
    program = transcribe(peer, collocate(family, degree, is_constant=False), problem.intervals)
    solver = ca.nlpsol("peer", "ipopt", program.nlp, QUIET)
    answer = solver(x0=program.start, lbx=program.lower, ubx=program.upper, lbg=program.g_lower, ubg=program.g_upper)
    assert found.cost.total == pytest.approx(float(answer["f"]), rel=1e-7)
    assert found.trajectory.point_u.shape == (25, degree, 1)


def test_motion_is_the_one_under_its_inputs(cart_pole: tuple[Problem, Mechanism]) -> None:
    """The defect falls by the order of the method as intervals are halved, so the re-simulation has the inputs."""
    problem, plant = cart_pole
    defects = []
    for intervals in (25, 50):
        found = resimulate(solve_it(replace(problem, intervals=intervals), plant), plant).resimulation
        assert found is not None
        assert found.defect is not None
        defects.append(found.defect)
    assert defects[1] < defects[0] / 8
    assert defects[1] < 1e-4


def test_constant_inputs_cost_more(cart_pole: tuple[Problem, Mechanism]) -> None:
    problem, plant = cart_pole
    assert solve_it(problem, plant).cost.total < solve_it(replace(problem, inputs="constant"), plant).cost.total


def test_bounds_hold_at_every_point(cart_pole: tuple[Problem, Mechanism]) -> None:
    problem, plant = cart_pole
    found = solve_it(replace(problem, bounds=replace(problem.bounds, u=((-10.0, 10.0),))), plant)
    assert np.abs(found.trajectory.point_u).max() == pytest.approx(10.0, abs=1e-6)


def test_files_hold_the_inputs(cart_pole: tuple[Problem, Mechanism], tmp_path: Path) -> None:
    """A solution is read again, and is a guess for constant inputs: the means of the polynomials."""
    problem, plant = cart_pole
    found = solve_it(problem, plant)
    write_solution(found, tmp_path / "solution.json")
    read = read_solution(tmp_path / "solution.json").trajectory
    assert np.array_equal(read.point_u, found.trajectory.point_u)
    again = solve(problem, plant, guess=read)
    assert isinstance(again, Solution)
    assert again.run.iterations < found.run.iterations
    coarse = solve(replace(problem, inputs="constant"), plant, guess=read)
    assert isinstance(coarse, Solution)
    u = list_motion(found.trajectory)[4]
    assert u[1:3, 0] == pytest.approx(found.trajectory.point_u[0, :2, 0], rel=1e-12)


def test_what_does_not_go_together_is_refused(cart_pole: tuple[Problem, Mechanism]) -> None:
    problem, plant = cart_pole
    priced = replace(problem, cost=replace(problem.cost, input_rates=1.0))
    for wrong in (replace(problem, form=Form.INTEGRAL), priced):
        with pytest.raises(ProblemError, match="take constant ones"):
            solve(wrong, plant)
