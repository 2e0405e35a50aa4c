"""A car at its limits: the first 200 m of the lap, with its first chicane."""

from __future__ import annotations

from pathlib import Path

import pytest

from mbsrun.external import load_on_demand
from mbsrun.ocp.solution.solution import Solution
from mbsrun.ocp.solving.solve import solve
from mbsrun.ocp.statement.statement import read_problem

VEHICLES = Path(__file__).parents[3] / "models" / "vehicles"
SHORTER = {
    "model: single_track.yaml": f"model: {VEHICLES / 'single_track.yaml'}",
    "{guess: 44.1163, range: [4, 120]}": "{guess: 8.4654, range: [1, 30]}",
    "intervals: 2000": "intervals: 200",
    "accuracy: 0.2 ": "accuracy: 10 ",
    "{solution: lap.csv}": f"{{solution: {VEHICLES / 'lap.csv'}, times: [0, 8.4654]}}",
    "{expression: s/10, range: [100, 100], at: end}": "{expression: s/10, range: [20, 20], at: end}",
    "solver: {method: mbs,": "solver: {method: mbs, fallback: false,",
}


def test_a_part_of_the_lap_takes_the_time_of_ipopt(tmp_path: Path) -> None:
    """`mbs` solves it alone, in some 160 iterations; both find the same time, and torques with a small price."""
    text = (VEHICLES / "lap.ocp.yaml").read_text("utf-8")
    for found, put in SHORTER.items():
        assert text.count(found) == 1
        text = text.replace(found, put)
    (tmp_path / "part.ocp.yaml").write_text(text, "utf-8")
    problem, plant = read_problem(tmp_path / "part.ocp.yaml", load_on_demand)
    solution, other = solve(problem, plant), solve(problem.with_solver("ipopt"), plant)
    assert isinstance(solution, Solution), solution.finding
    assert isinstance(other, Solution), other.finding
    assert (solution.run.method, other.run.method) == ("mbs", "ipopt")
    assert solution.run.iterations < 220
    assert solution.cost.total == pytest.approx(other.cost.total, rel=1e-6)
