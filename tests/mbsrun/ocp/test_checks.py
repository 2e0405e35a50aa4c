"""Problems made in Python: every fault at once, in words; none reaches CasADi."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pytest

from mbsrun.ocp.problem.problem import (
    Bounds,
    Constraint,
    Cost,
    End,
    GuessOptions,
    Refinement,
    Representation,
    SolverOptions,
    Term,
)
from mbsrun.ocp.solving.solve import Solver, solve
from mbsrun.ocp.statement.checks import ProblemError, check_problem
from tests.mbsrun.ocp.plants import FREE_RANGE, push
from tests.mbsrun.peer import double_integrator

FREE = (FREE_RANGE,)
WRONG: dict[str, tuple[dict[str, Any], str, str]] = {  # what is changed: the part that is named, what is found
    "no interval": ({"intervals": 0}, "intervals", "found 0; give a whole number from 1 to 10000"),
    "half an interval": ({"intervals": 2.5}, "intervals", "2.5"),
    "an accuracy below rounding": (
        {"refine": Refinement(1e-16)},
        "refine.accuracy",
        "found 1e-16; give at least 1e-12, which the re-simulation can confirm",
    ),
    "no rounds": ({"refine": Refinement(1e-6, 0)}, "refine.rounds", "found 0; give a whole number from 1 to 100"),
    "too few fractions": (
        {"mesh": (0.5, 0.5)},
        "mesh",
        "found 2 fractions for 4 intervals; give one fraction for each",
    ),
    "a negative fraction": ({"mesh": (-0.5, 0.5, 0.5, 0.5)}, "mesh", "the fractions are from -0.5 to 0.5; give pos"),
    "a fraction that is none": ({"mesh": (float("nan"), 0.5, 0.25, 0.25)}, "mesh", "the fractions are from nan"),
    "half a horizon": ({"mesh": (0.125,) * 4}, "mesh", "the fractions sum to 0.5; divide them by their sum"),
    "degree": ({"degree": 10}, "degree", "found 10"),
    "horizon": ({"horizon": -1.0}, "horizon", "found -1; give a positive number"),
    "no number": ({"horizon": np.nan}, "horizon", "found nan"),
    "accuracy": ({"accuracy": 0.0}, "accuracy", "positive"),
    "expression of CasADi": (
        {"cost": Cost(running=(Term(ca.SX.sym("x") ** 2, 1.0),))},  # type: ignore[arg-type]
        "cost.running[0].expression",
        "(SX)",
    ),
    "weights": ({"cost": Cost()}, "cost", "every weight is 0"),
    "negative weight": ({"cost": Cost(-1.0)}, "cost", "not negative"),
    "unknown name": ({"cost": Cost(running=(Term("q_slid", 1.0),))}, "cost.running[0].expression", '"q_slid"'),
    "no expression": ({"constraints": (Constraint("q_slide +", (0, 1)),)}, "constraints[0].expression", ";"),
    "where": ({"constraints": (Constraint("q_slide", (0, 1), "middle"),)}, "constraints[0].at", "middle"),  # type: ignore[arg-type]
    "start": ({"start_q": (0.0, 0.0)}, "start_q", "found 2 entries; give 1"),
    "start that is no number": ({"start_qd": (np.inf,)}, "start_qd", "inf"),
    "bounds": ({"bounds": Bounds(FREE, FREE, FREE * 2)}, "bounds.u", "found 2 entries"),
    "coordinate": ({"end": End(coordinates=((1, 0.0),))}, "end.coordinates", "found index 1"),
    "sensor": ({"end": End(sensors=(("foot", (0, 0, 0)),))}, "end.sensors", '"foot"; there are place'),
    "frame": ({"guess": GuessOptions(upright=("head",))}, "guess.upright", '"head"'),
    "option": ({"solver": SolverOptions(options=(("output_file", "x"),))}, "solver.options", '"output_file"'),
    "representation": ({"representation": "IMPL "}, "representation", "IMPL "),
    "conflict": ({"steps": 2}, "steps", "with 2 steps is for shooting"),
}


@pytest.mark.parametrize(("changes", "place", "finding"), WRONG.values(), ids=WRONG.keys())
def test_a_wrong_problem_is_refused_in_words(changes: dict[str, Any], place: str, finding: str) -> None:
    """By `solve` and by `Solver`, before a guess is made; the part that is wrong is named."""
    plant, problem = double_integrator(), replace(push(4), **changes)
    for call in (solve, Solver):
        with pytest.raises(ProblemError) as refusal:
            call(problem, plant)
        assert [found[0] for found in refusal.value.findings] == [place]
        assert finding in str(refusal.value)


def test_all_faults_come_together() -> None:
    wrong = replace(push(4), intervals=0, degree=0, start_q=(), accuracy=-1.0)
    with pytest.raises(ProblemError) as refusal:
        check_problem(wrong, double_integrator().manifest)
    assert {place for place, _, _ in refusal.value.findings} == {"intervals", "degree", "start_q", "accuracy"}


@pytest.mark.parametrize("rounds", [1, 100])
def test_the_limits_of_a_range_are_in_it(rounds: int) -> None:
    check_problem(replace(push(4), refine=Refinement(1e-6, rounds)), double_integrator().manifest)


def test_an_end_that_is_not_described_is_free() -> None:
    assert not any((End().velocity_zero, End().acceleration_zero, End().coordinates, End().velocities))


def test_numbers_of_numpy_are_numbers() -> None:
    """Such as grids and arrays give: a problem need not convert them."""
    numbers = {"horizon": np.float64(1.0), "start_q": tuple(np.zeros(1)), "representation": Representation.EXP1_A}
    check_problem(replace(push(4), **numbers), double_integrator().manifest)  # type: ignore[arg-type]


def test_a_problem_of_a_solver_is_checked_as_well() -> None:
    """Values that belong to a solve, not to the program."""
    solver = Solver(push(4), double_integrator())
    with pytest.raises(ProblemError, match="every weight is 0"):
        solver.solve(replace(push(4), cost=Cost()), None)  # type: ignore[arg-type]
