"""Rows of the page of the solver's figures."""

from __future__ import annotations

import numpy as np

from tests.csrc import stage_figures
from tests.csrc.stage_problems import nonlinear
from tests.csrc.stage_quadratics import random_problem
from tests.csrc.stages import Library, Solver


def test_a_row_has_iterations_and_costs_of_both(library: Library) -> None:
    """The optimum and its conditions to the tolerance; as many cells as titles."""
    problem = nonlinear()[0]
    row = dict(zip(stage_figures.PROBLEMS, stage_figures.compare(library, problem.name, problem), strict=True))
    assert (row["problem"], row["status"]) == (problem.name, "solved")
    assert int(row["variables"]) == sum(nx + nv for nx, nv, *_ in problem.sizes)
    assert 0 < int(row["iterations"]) <= 2 * int(row["IPOPT"])
    assert max(float(row["difference"]), float(row["conditions"])) < 1e-7


def test_warm_starts_take_fewer_iterations(library: Library) -> None:
    for row in stage_figures.compare_warm(library):
        name, cold, same, near, _, shifted = row
        assert len(row) == len(stage_figures.WARM)
        assert max(int(same), int(near), int(shifted)) < int(cold) / 2, name


def test_times_belong_to_one_iteration_and_one_stage(library: Library) -> None:
    """A problem of twice the stages has nearly the same memory in each."""
    cells = []
    for stages in (50, 100):
        problem = random_problem(np.random.default_rng(3), [(4, 1, 0, 0)] * stages + [(4, 0, 4, 0)], bounds=0.3)
        result, milliseconds, memory = stage_figures.time_solve(Solver(library, problem), problem)
        assert (result.iterations > 0, float(milliseconds) > 0) == (True, True)
        cells.append(float(memory))
    assert abs(cells[0] - cells[1]) <= 1
