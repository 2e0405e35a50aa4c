"""Tables of stages: C computes from them what NumPy computes of the program that they were made of."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mbsrun.external import load_on_demand
from mbsrun.ocp.problem import Form, Loops, Problem, Representation
from mbsrun.ocp.stages.binding import Evaluator, Tables
from mbsrun.ocp.stages.building import build
from mbsrun.ocp.statement import read_problem
from mbsrun.ocp.transcription import transcribe
from tests.mbsrun.ocp.conftest import MODELS
from tests.mbsrun.ocp.stages.stage_functions import compare

EPSILON = np.finfo(np.float64).eps

# Each has parts that the others lack: closed loops in either form, input rates, a free horizon and expressions with
# kernels' results, quaternions, and forms without states at the points.
CASES = {
    "closed loops, reduced": ("five_bar_reach", {"loops": Loops.REDUCED}),
    "closed loops, multipliers": ("five_bar_reach", {"loops": Loops.MULTIPLIERS}),
    "expressions of positions": ("planar_arm_reach", {}),
    "free horizon, input rates": ("planar_arm_fastest", {"input_rates": 1.3}),
    "explicit, free horizon": ("planar_arm_fastest", {"representation": Representation.EXP1_A}),
    "quaternions": ("satellite_turn", {}),
    "integral": ("cart_pole_swing_up", {"form": Form.INTEGRAL, "representation": Representation.IMPL}),
    "shooting": (
        "cart_pole_swing_up",
        {"form": Form.SHOOTING, "representation": Representation.IMPL, "input_rates": 0.1},
    ),
    "integral over Legendre points": ("cart_pole_balance", {"form": Form.INTEGRAL}),
}


def vary(problem: Problem, changes: dict[str, object]) -> Problem:
    """Change a problem; it has few intervals."""
    changes = {**changes}
    rates = changes.pop("input_rates", problem.cost.input_rates)
    return replace(problem, intervals=3, cost=replace(problem.cost, input_rates=rates), **changes)  # type: ignore[arg-type]


@pytest.mark.parametrize(("name", "changes"), CASES.values(), ids=CASES.keys())
def test_functions_of_stages_are_those_of_the_program(name: str, changes: dict[str, object]) -> None:
    """Values, Jacobian and Hessian at a random point, after lifted variables are eliminated."""
    problem, plant = read_problem(MODELS / f"{name}.ocp.yaml", load_on_demand)
    problem = vary(problem, changes)
    transcription = transcribe(problem, plant)
    program, rng = transcription.program, np.random.default_rng(0)
    least, most = transcription.constraint_bounds(problem)
    rows = np.ones(program.constraints, dtype=bool)
    rows[program.kept_rows] = np.isfinite(least) | np.isfinite(most)
    p = transcription.parameters(problem)
    data = build(program, plant, p[: len(program.H)] != 0, rows)
    x = rng.uniform(0.3, 1.0, program.variables)
    found = compare(Evaluator(Tables(data, plant), p), program, plant, x, p, rng)
    # sums of some hundred terms, products with the derivatives of lifted variables
    assert max(found.values, found.slopes, found.curvatures) < 1000 * EPSILON
