"""Optimal control of models with parameters that kernels can be differentiated by: the parameters hold their values."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from mbsrun.external import load, load_on_demand
from mbsrun.ocp.problem.problem import Representation
from mbsrun.ocp.solution.solution import Solution
from mbsrun.ocp.solving.solve import solve
from mbsrun.ocp.statement.statement import read_problem

MODEL = """\
name: pendulum
gravity: [0, 0, -9.81]
parameters:
  l: {LENGTH}
bodies:
  - name: rod
    joint: {{type: revolute, axis: y}}
    mass: 1
    com: [0, 0, -l]
    inertia: [0, 0.01, 0.01]
"""
TASK = """\
model: model.yaml
horizon: 1
intervals: 4
scheme: radau
degree: 3
representation: {REPRESENTATION}
cost: {{inputs: 1}}
start: {{pose: {{rod: 0.5}}}}
end: {{pose: {{rod: 2}}, velocity: zero}}
"""


@pytest.mark.parametrize("representation", Representation)
def test_differentiated_parameters_hold_their_values(tmp_path: Path, representation: Representation) -> None:
    """The same task with the length as a number: the same program, so the same optimum up to the tolerance of 1e-8."""
    costs = []
    for length in ("0.7", "{value: 0.7, kind: differentiated}"):
        (tmp_path / "model.yaml").write_text(MODEL.format(LENGTH=length), "utf-8")
        file = tmp_path / "task.ocp.yaml"
        file.write_text(TASK.format(REPRESENTATION=representation.value), "utf-8")
        problem, plant = read_problem(file, load_on_demand)
        assert bool(plant.manifest.design) == ("kind" in length)
        outcome = solve(problem, plant)
        assert isinstance(outcome, Solution)
        costs.append(outcome.cost.total)
    assert costs[1] == pytest.approx(costs[0], rel=1e-8)


@pytest.mark.parametrize("kind", ["runtime", "differentiated"])
def test_the_method_by_stages_takes_the_parameters_in_use(tmp_path: Path, kind: str) -> None:
    """A length that is not the model file's: it is an input of the kernels that tables of stages call."""
    (tmp_path / "model.yaml").write_text(MODEL.format(LENGTH=f"{{value: 0.7, kind: {kind}}}"), "utf-8")
    file = tmp_path / "task.ocp.yaml"
    file.write_text(TASK.format(REPRESENTATION="IMPL"), "utf-8")
    problem, plant = read_problem(file, lambda model: load(model, {"l": 0.9}))
    costs = []
    for method in ("ipopt", "mbs"):
        outcome = solve(replace(problem, solver=replace(problem.solver, method=method)), plant)
        assert isinstance(outcome, Solution)
        costs.append(outcome.cost.total)
    assert costs[1] == pytest.approx(costs[0], rel=1e-8)
