"""Refinement of the grid: its rules, and that it ends where the re-simulation agrees, and only there."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from matplotlib.patches import Rectangle
from scipy.integrate import solve_ivp

from mbsrun.commands.console import keep_grid
from mbsrun.ocp.ground.schemes import Family
from mbsrun.ocp.problem.problem import Bounds, Cost, End, Form, Problem, Refinement, Representation
from mbsrun.ocp.searching.refinement import choose_grid, refine
from mbsrun.ocp.showing.pictures import make_mesh
from mbsrun.ocp.showing.summary import list_shortcomings, summarise
from mbsrun.ocp.solution.solution import Resimulation, Round, Solution, read_solution, write_solution
from mbsrun.ocp.solving.resimulation import resimulate
from mbsrun.ocp.solving.solve import solve
from tests.mbsrun.ocp.plants import FREE_RANGE, cart_pole, pendulum

ACCURACY = 1e-7


def swing(intervals: int = 4, degree: int = 3) -> Problem:
    """A pendulum of length g under a given force: nothing is left to choose."""
    return Problem(
        name="swing",
        horizon=8.0,
        intervals=intervals,
        family=Family.RADAU,
        degree=degree,
        cost=Cost(1.0),
        start_q=(3.0,),
        start_qd=(0.0,),
        bounds=Bounds((FREE_RANGE,), (FREE_RANGE,), ((0.0, 0.0),)),
        end=End(),
        refine=Refinement(ACCURACY, 8),
    )


def solved(problem: Problem) -> Solution:
    solution = solve(problem, pendulum())
    assert isinstance(solution, Solution)
    return resimulate(solution, pendulum())


def given(defects: list[float]) -> Solution:
    """A solution whose intervals have these defects."""
    solution = solved(swing(len(defects)))
    assert solution.resimulation is not None
    found = replace(solution.resimulation, defect=max(defects), defects=tuple(defects), is_accurate=False)
    return replace(solution, resimulation=found)


def test_a_refined_swing_is_the_true_one() -> None:
    """Against DOP853 over the whole horizon. All mesh points stay, intervals differ, and every round is recorded."""
    told: list[Round] = []
    solution = refine(solved(swing()), pendulum(), told.append)
    assert solution.resimulation is not None
    assert solution.resimulation.is_accurate
    assert max(solution.resimulation.defects) <= ACCURACY
    assert solution.refinement is not None
    assert solution.refinement.rounds == tuple(told)
    assert "confirms" in solution.refinement.finding
    t, q = solution.trajectory.t, solution.trajectory.q
    motion = solve_ivp(
        lambda _, y: [y[1], -np.sin(y[0])], (0, 8), [3.0, 0.0], "DOP853", t_eval=t, rtol=1e-12, atol=1e-12
    )
    assert np.abs(q[:, 0] - motion.y[0]).max() < 1e3 * ACCURACY
    for before, after in pairwise(told):
        assert all(np.isclose(time, after.times, rtol=0, atol=1e-12).any() for time in before.times)
    lengths = np.diff(t)
    assert lengths.max() > 1.5 * lengths.min()
    assert told[0].defect is not None
    assert told[0].defect > 1e3 * ACCURACY


def test_few_bad_intervals_are_split() -> None:
    """The others keep their length, and the degree stays: the error of a piece is (1 / pieces)^6 of the whole."""
    chosen = choose_grid(given([1e-9, 1e-9, 10 * ACCURACY, *[1e-9] * 9]))
    assert chosen is not None
    problem, change = chosen
    assert (problem.degree, problem.intervals) == (3, 13)
    assert problem.mesh == pytest.approx([1 / 12] * 2 + [1 / 24] * 2 + [1 / 12] * 9)
    assert "1 of 12 intervals split into 2" in change


def test_a_higher_degree_is_taken_where_all_intervals_are_bad() -> None:
    chosen = choose_grid(given([10 * ACCURACY] * 6))
    assert chosen is not None
    assert (chosen[0].degree, chosen[0].intervals, chosen[0].mesh) == (4, 6, None)


def test_the_tolerance_is_reduced_where_violations_are_the_error() -> None:
    solution = given([2 * ACCURACY] * 4)
    loose = replace(solution.problem.solver, tolerance=1e-6)
    violation = replace(solution.violation, constraints=ACCURACY)
    solution = replace(solution, problem=replace(solution.problem, solver=loose), violation=violation)
    chosen = choose_grid(solution)
    assert chosen is not None
    assert chosen[0] == replace(solution.problem, solver=replace(loose, tolerance=1e-2 * ACCURACY))


def test_rk4_takes_more_steps() -> None:
    solution = given([1e-9, 1e-9, 30 * 0.3 * ACCURACY])
    explicit = Representation.EXP1_O
    shooting = replace(solution.problem, form=Form.SHOOTING, representation=explicit, integrator="rk4")
    chosen = choose_grid(replace(solution, problem=shooting))
    assert chosen is not None
    assert chosen[0] == replace(shooting, steps=2)


def test_a_refinement_that_ends_early_claims_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Rounds are over, a solve fails, a check is unfinished, or no error is known: the reason is given."""
    solution = solved(replace(swing(4, 1), refine=Refinement(1e-11, 1)))
    ended = refine(solution, pendulum())
    assert ended.refinement is not None
    assert (len(ended.refinement.rounds), ended.refinement.finding) == (2, "1 round is over")
    assert any("above the accuracy asked for, 1.0e-11" in text for text in list_shortcomings(ended))
    hurried = replace(
        solution, problem=replace(solution.problem, solver=replace(solution.problem.solver, max_iterations=1))
    )
    failed = refine(hurried, pendulum())
    assert failed.refinement is not None
    assert failed.trajectory is solution.trajectory
    assert failed.refinement.finding.startswith("on the next grid, ")
    assert failed.refinement.rounds[1].cost is None
    assert any("Maximum_Iterations_Exceeded" in line for line in summarise(failed).values())
    monkeypatch.setattr("mbsrun.ocp.searching.refinement.resimulate_phases", None)  # and nothing else is solved
    for check, finding in (
        (Resimulation(None, None, None, False, unfinished="no time"), "the re-simulation did not finish, no time"),
        (Resimulation(None, None, None, False), "gave up"),
        (Resimulation(1e-12, 0, 0.0, False, closure=1.0, defects=(1e-12,) * 4), "loops open"),
    ):
        ended = refine(replace(solution, resimulation=check), pendulum())
        assert ended.refinement is not None
        assert finding in ended.refinement.finding


def test_a_refined_optimum_costs_no_more_than_the_coarse_one(tmp_path: Path) -> None:
    """Inputs of the coarse grid are admitted on the fine one, whose optimum is not worse; the file keeps the rounds."""
    plant = cart_pole()
    problem = Problem(
        name="swing-up",
        horizon=2.0,
        intervals=12,
        family=Family.LEGENDRE,
        degree=4,
        cost=Cost(1.0),
        start_q=(0.0, 0.0),
        start_qd=(0.0, 0.0),
        bounds=Bounds(((-2.0, 2.0), FREE_RANGE), (FREE_RANGE,) * 2, ((-20.0, 20.0),)),
        end=End(coordinates=((0, 1.0), (1, np.pi)), velocity_zero=True),
        refine=Refinement(1e-8),
    )
    coarse = solve(problem, plant)
    assert isinstance(coarse, Solution)
    fine = refine(resimulate(coarse, plant), plant)
    assert fine.resimulation is not None
    assert fine.resimulation.is_accurate
    assert fine.cost.total < coarse.cost.total + 1e-3
    write_solution(fine, tmp_path / "solution.json")
    read = read_solution(tmp_path / "solution.json")
    assert (read.refinement, read.problem) == (fine.refinement, fine.problem)
    assert fine.refinement is not None
    lines = summarise(fine)
    assert lines["refinement"].startswith(f"{len(fine.refinement.rounds) - 1} round")
    assert lines["intervals"].startswith(f"{fine.problem.intervals}, from ")


def test_commands_that_keep_their_grid_say_so(capsys: pytest.CaptureFixture[str]) -> None:
    problem = keep_grid(swing())
    assert problem == replace(swing(), refine=None)
    assert "only `mbsrun solve` refines grids" in capsys.readouterr().err
    assert keep_grid(problem) == problem
    assert capsys.readouterr().err == ""


def test_the_picture_shows_every_round() -> None:
    refined = refine(solved(swing()), pendulum()).refinement
    assert refined is not None
    panels = make_mesh(refined).axes
    assert len(panels) == len(refined.rounds)
    for axes, each in zip(panels, refined.rounds, strict=True):
        heights = [bar.get_height() for bar in axes.patches if isinstance(bar, Rectangle)]
        assert sorted(heights) == pytest.approx(np.maximum(sorted(each.defects), 1e-15))
