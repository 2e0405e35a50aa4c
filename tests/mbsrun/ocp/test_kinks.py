"""Absolute values and maxima in the cost: closed forms of optima that lie at kinks."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mbsrun.external import load_on_demand
from mbsrun.ocp.ground.no_mechanism import NO_MECHANISM
from mbsrun.ocp.problem.problem import Problem
from mbsrun.ocp.solution.solution import Solution
from mbsrun.ocp.solving.solve import solve
from mbsrun.ocp.statement.statement import read_problem

FUEL = """
horizon: 3
intervals: 30
scheme: radau
degree: 3
constants: {k: -2, absolute_0: 5}
states:
  x: {rate: v, start: 0, end: 2}
  v: {rate: u, start: 0, end: 0}
controls: {u: {range: [-1, 1]}}
cost: {running: [{expression: 'abs(u)'}]}
"""
NEAR = """
horizon: 1
intervals: 5
scheme: radau
degree: 2
states: {x: {rate: u, start: 0}}
controls: {u: {}}
cost: {running: [{expression: u**2}], terminal: [{expression: abs(x - 1), weight: WEIGHT}]}
"""


def _read(folder: Path, text: str) -> Problem:
    (folder / "kinked.ocp.yaml").write_text(text, "utf-8")
    return read_problem(folder / "kinked.ocp.yaml", load_on_demand, NO_MECHANISM)[0]


@pytest.mark.parametrize("method", ["mbs", "ipopt"])
def test_least_fuel_is_thrust_coasting_and_thrust(tmp_path: Path, method: str) -> None:
    """Thrust of 1 for b, then none, then -1 for b moves by b (T - b): b = 1 for 2 within 3 s, and the fuel is 2 b."""
    solution = solve(_read(tmp_path, FUEL).with_solver(method), NO_MECHANISM)
    assert isinstance(solution, Solution), solution.finding
    assert solution.cost.total == pytest.approx(2, rel=1e-6)
    assert solution.trajectory.controls[:, 0] == pytest.approx(np.repeat([1, 0, -1], 10), abs=1e-5)
    assert solution.problem.cost.running[0].title == "abs(u)"


@pytest.mark.parametrize(("weight", "u"), [(0.5, 0.25), (1.5, 0.75), (3.0, 1.0)])
def test_a_distance_is_left_as_far_as_its_price_allows(tmp_path: Path, weight: float, u: float) -> None:
    """A constant u costs u^2 + w |u - 1|, least at w / 2, or at the kink where w > 2."""
    solution = solve(_read(tmp_path, NEAR.replace("WEIGHT", str(weight))), NO_MECHANISM)
    assert isinstance(solution, Solution), solution.finding
    assert solution.cost.total == pytest.approx(u**2 + weight * (1 - u), rel=1e-7)


@pytest.mark.parametrize(
    ("text", "rewritten"),
    [
        ("abs(u)", "absolute_0_"),  # the name absolute_0 is taken
        ("u**2 + 2*abs(u - k)/3", "u**2 + 2*absolute_0_/3"),
        ("abs(u) + abs(u)*v", "absolute_0_ + abs(u)*v"),
        ("k*(u - abs(u))", "k*(u - absolute_0_)"),  # k is negative
        ("-max(u, 3*u)/k", "-larger_0/k"),
        ("max(abs(u), 1)", "larger_0"),
        ("-abs(u)", "-abs(u)"),  # not convex
        ("k*abs(u)", "k*abs(u)"),
        ("sqrt(abs(u))", "sqrt(abs(u))"),
        ("abs(u*v)", "abs(u*v)"),  # v is not constant over an interval
        ("u**2 + abs(k)", "u**2 + abs(k)"),  # no kink
    ],
)
def test_convex_kinks_alone_are_bounded(tmp_path: Path, text: str, rewritten: str) -> None:
    problem = _read(tmp_path, FUEL.replace("abs(u)", text))
    assert problem.cost.running[0].expression == rewritten
    assert len(problem.controls) == 1 + (rewritten != text)


def test_a_weight_below_0_makes_no_kink_convex(tmp_path: Path) -> None:
    problem = _read(tmp_path, FUEL.replace("'}", "', weight: -1}"))
    assert problem.cost.running[0].expression == "abs(u)"


@pytest.mark.parametrize("inputs", ["linear", "polynomial"])
def test_inputs_that_change_within_an_interval_keep_their_kinks(tmp_path: Path, inputs: str) -> None:
    problem = _read(tmp_path, f"{FUEL}inputs: {inputs}\n")
    assert problem.cost.running[0].expression == "abs(u)"
