"""Motions that end where their limits are: the optimum is the one without these limits, or a published one."""

from __future__ import annotations

from pathlib import Path

import pytest

from mbsrun.external import load_on_demand
from mbsrun.ocp.ground.status import SOLVED
from mbsrun.ocp.solution.solution import Solution
from mbsrun.ocp.solving.solve import solve
from mbsrun.ocp.statement.statement import read_problem

MASSES = """
name: masses
gravity: [0, 0, 0]
bodies:
  - {name: a, joint: {type: prismatic, axis: x}, mass: 1}
  - {name: b, joint: {type: prismatic, axis: x}, mass: 1}
"""
CRANE = """
name: crane
gravity: [0, 0, -9.81]
bodies:
  - {name: trolley, joint: {type: prismatic, axis: x, max_force: 10}, mass: 1}
  - name: load
    parent: trolley
    joint: {type: revolute, axis: -y, actuated: false}
    mass: 2
    com: [0, 0, -1]
frames:
  - {name: load, body: load, position: [0, 0, -1]}
"""
REST_TO_REST = """
model: model.yaml
horizon: 2
scheme: radau
degree: 3
cost: {inputs: 1}
start: {pose: {}}
end: {pose: {a: 1, b: 2}, velocity: zero}
"""
LIMITS = {
    "velocities": "bounds: {velocities: {a: [0, null], b: [0, null]}}",
    "coordinate": "bounds: {coordinates: {b: [-2, 2]}}",
    "both ends": "bounds: {coordinates: {a: [0, 1], b: [0, 2]}}",
    "sum": "constraints: [{expression: q_a + q_b, range: [0, 3]}]",
    "twice": "constraints: [{expression: q_b, range: [null, 2]}, {expression: 2*q_b, range: [0, 4]}]",
    "one velocity": "constraints: [{expression: qd_a + qd_b, range: [0, null]}]",
}
LEAST_TIME = """
model: model.yaml
horizon: {guess: 3, range: [0.5, 10]}
scheme: radau
degree: 3
cost: {terminal: [{expression: T}]}
start: {pose: {}}
end: {pose: {trolley: 3, load: 0}, velocity: zero}
constraints: [{expression: x_load, range: [null, 3]}]
"""


def solve_text(folder: Path, model: str, text: str) -> Solution:
    (folder / "model.yaml").write_text(model, encoding="utf-8")
    (folder / "one.ocp.yaml").write_text(text, encoding="utf-8")
    solution = solve(*read_problem(folder / "one.ocp.yaml", load_on_demand))
    assert isinstance(solution, Solution)
    assert solution.run.method == "mbs"
    assert solution.run.status == SOLVED
    return solution


@pytest.mark.parametrize("form", ["standard", "integral", "shooting"])
@pytest.mark.parametrize("limits", LIMITS)
def test_limits_that_the_optimum_does_not_feel_change_nothing(tmp_path: Path, limits: str, form: str) -> None:
    """Masses go 1 m and 2 m in 2 s at least force squared; 12 (1 + 4) / 8 = 7.5 as the grid becomes fine."""
    for intervals in (7, 20):
        text = f"{REST_TO_REST}intervals: {intervals}\nform: {form}\n"
        free = solve_text(tmp_path, MASSES, text)
        limited = solve_text(tmp_path, MASSES, text + LIMITS[limits])
        assert limited.cost.total == pytest.approx(free.cost.total, rel=1e-7)
        assert limited.run.iterations < 20
        assert limited.violation.bounds < 1e-11
    assert free.cost.total == pytest.approx(7.518797, rel=1e-6)


def test_a_goal_at_a_wall_is_reached_in_least_time(tmp_path: Path) -> None:
    """A crane moves its load 3 m to rest, and no further: 1.9961372 s, by another program on the same grid."""
    solution = solve_text(tmp_path, CRANE, f"{LEAST_TIME}intervals: 60\n")
    assert solution.cost.total == pytest.approx(1.9961372, rel=1e-6)
