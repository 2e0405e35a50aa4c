"""Costs that are small beside their largest weight, for which the tolerance is."""

from __future__ import annotations

from pathlib import Path

import pytest
from click.testing import CliRunner

import mbsrun
from mbsrun.cli import cli
from mbsrun.external import load_on_demand
from mbsrun.ocp.ground.status import SOLVED
from mbsrun.ocp.solution.solution import Solution
from mbsrun.ocp.solving.solve import solve
from mbsrun.ocp.statement.statement import read_problem

MASS = """
name: mass
gravity: [0, 0, 0]
bodies:
  - {name: a, joint: {type: prismatic, axis: x, max_force: 1}, mass: 1}
"""
PROBLEM = """
model: model.yaml
horizon: {guess: 3, range: [0.5, 10]}
intervals: 20
scheme: radau
degree: 3
start: {pose: {}}
end: {pose: {a: null}, velocity: zero}
guess: {motion: line, end: {a: 1}}
cost:
  terminal:
    - {expression: T, weight: 0.001}
    - {expression: (q_a - 1)**2, weight: 1000}
"""


@pytest.mark.parametrize("tolerance", [1e-8, 1e-7])
def test_a_small_cost_is_found_to_its_own_digits(tmp_path: Path, tolerance: float) -> None:
    """A mass goes 1 - e m to rest in 2 sqrt(1 - e) s at least, by the force 1 N and then -1 N.

    The least of 2e-3 sqrt(1 - e) + 1000 e^2 has e = 5e-7, and is 2e-3 - 2.5e-10.
    """
    (tmp_path / "model.yaml").write_text(MASS, encoding="utf-8")
    (tmp_path / "one.ocp.yaml").write_text(PROBLEM + f"solver: {{tolerance: {tolerance}}}", encoding="utf-8")
    solution = solve(*read_problem(tmp_path / "one.ocp.yaml", load_on_demand))
    assert isinstance(solution, Solution)
    assert (solution.run.method, solution.run.status) == ("mbs", SOLVED)
    assert solution.cost.total == pytest.approx(2e-3 - 2.5e-10, rel=1e-6 if tolerance == 1e-8 else 1e-5)
    assert solution.problem.solver.tolerance == tolerance


def test_a_small_cost_of_a_quadratic_program_has_six_digits() -> None:
    """Two states under implicit Euler steps with limits of their sums: the optimum is Clarabel's, to 1e-11."""
    rows = (
        ("-0.9651*x", [-0.20490889893994527, None]),
        ("-0.6073*x + 0.5614*y", [0.30810904580227727, None]),
        ("-0.8332*x", [-0.1769040457950082, None]),
        ("-0.3972*x + 0.9866*v", [-1.5439806186546936, 2.9809698748144537]),
        ("-0.7944*x + 1.9732*v", [-3.087961237309387, 5.9619397496289075]),
    )
    problem = mbsrun.problem(
        None,
        horizon=2,
        intervals=20,
        scheme="radau",
        degree=1,
        states={
            "x": {"rate": "0.1406*y + 1.01943*w", "start": -0.768},
            "y": {"rate": "0.3122*x - 0.5203*y + v", "start": 0.9881, "end": 1.024946085652509},
        },
        controls={"v": {}, "w": {}},
        cost={
            "running": [{"expression": "w**2", "weight": 0.1}],
            "terminal": [{"expression": "x**2", "weight": 1.479}],
        },
        constraints=[{"expression": text, "range": limits} for text, limits in rows],
        solver={"method": "mbs"},
    )
    assert problem.solve(check=False).cost == pytest.approx(0.0020694371746, rel=1e-6)


@pytest.mark.parametrize(("weight", "digits"), [(0.001, 1e-5), (1e-7, None)])
def test_a_controller_says_where_a_small_cost_is_not_found(tmp_path: Path, weight: float, digits: float | None) -> None:
    """The least of 2 w sqrt(1 - e) + 1000 e^2 is 2 w - w^2 / 4000 to first order; a solved cost is right to 1e-4."""
    (tmp_path / "model.yaml").write_text(MASS, encoding="utf-8")
    (tmp_path / "one.ocp.yaml").write_text(PROBLEM.replace("0.001", str(weight)), encoding="utf-8")
    made = CliRunner().invoke(cli, ["controller", str(tmp_path / "one.ocp.yaml"), "-o", str(tmp_path / "out")])
    assert made.exit_code == 0, made.output
    found = mbsrun.controller(tmp_path / "out").solve()
    assert found.status == ("acceptable" if digits is None else "solved")
    assert found.cost == pytest.approx(2 * weight - weight**2 / 4000, rel=digits or 0.05)


HAND = """
name: hand
gravity: [0, 0, -9.81]
bodies:
  - {name: a, joint: {type: revolute, axis: z}, mass: 1, com: [0.1, 0, 0], inertia: [0.01, 0.02, 0.02]}
  - name: b
    parent: a
    joint: {type: revolute, axis: y, position: [0, 0, 0.3]}
    mass: 1
    com: [0.2, 0, 0]
    inertia: [0.01, 0.02, 0.02]
  - name: c
    parent: b
    joint: {type: revolute, axis: x, position: [0.4, 0, 0]}
    mass: 1
    com: [0.1, 0, 0.05]
    inertia: [0.01, 0.02, 0.02]
frames: [{name: tip, body: c, position: [0.2, 0, 0]}]
"""
POINTED = """
model: hand.yaml
horizon: 1
intervals: 15
scheme: radau
degree: 4
start: {pose: {}}
end: {velocity: zero}
cost: {inputs: 1, terminal: [{expression: (zx_tip - 1)**2 + zy_tip**2 + zz_tip**2, weight: 1000}]}
"""


def test_an_answer_that_the_judge_refuses_is_improved_with_a_smaller_tolerance(tmp_path: Path) -> None:
    """A large weight makes the tolerance loose: 2.9e-6 of the gradient's decrease were left. Both methods agree."""
    (tmp_path / "hand.yaml").write_text(HAND, "utf-8")
    (tmp_path / "pointed.ocp.yaml").write_text(POINTED, "utf-8")
    problem, plant = read_problem(tmp_path / "pointed.ocp.yaml", load_on_demand)
    costs = []
    for method in ("mbs", "ipopt"):
        solution = solve(problem.with_solver(method), plant)
        assert isinstance(solution, Solution), solution.finding
        costs.append(solution.cost.total)
    assert costs[0] == pytest.approx(costs[1], rel=1e-8)
