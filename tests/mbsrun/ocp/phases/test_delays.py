"""Delays of inputs across links: a motion in two phases is the motion in one."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from mbsrun import load
from mbsrun.external import load_on_demand
from mbsrun.ocp.phases.solution import PhasedSolution
from mbsrun.ocp.phases.solve import solve_phases
from mbsrun.ocp.phases.statement import read_phased_problem
from mbsrun.ocp.solution import Solution
from mbsrun.ocp.solve import solve
from mbsrun.ocp.statement import read_problem

MODEL = """
name: cart
gravity: [0, 0, 0]
bodies: [{name: cart, joint: {name: x, type: prismatic, axis: x}, mass: 1}]
"""
USUAL = """
model: cart.yaml
scheme: radau
degree: 3
cost: {inputs: 1}
bounds: {velocities: [-1.2, 1.2]}
solver: {tolerance: 1e-10}
"""
ONE = """
horizon: 1.2
intervals: 12
inputs: {course: COURSE, delay: 0.2, history: 2}
start: {pose: {}}
end: {pose: {x: 1}, velocity: zero}
"""
TWO = """
inputs: {course: COURSE, delay: 0.2}
phases:
  - {name: first, horizon: 0.5, intervals: 5, start: {pose: {}}, inputs: {history: 2}}
  - {name: second, horizon: 0.7, intervals: 7, end: {pose: {x: 1}, velocity: zero}, inputs: {history: link}}
links: [{from: first, to: second}]
"""


@pytest.mark.parametrize("course", ["constant", "polynomial", "linear"])
def test_commands_before_a_link_act_after_it(requires: Callable[[str], str], tmp_path: Path, course: str) -> None:
    """A push of 2 N acts at first; the commands of the last 0.2 s of the first phase act in the second one."""
    requires("cc")
    (tmp_path / "cart.yaml").write_text(MODEL)
    (tmp_path / "one.ocp.yaml").write_text((USUAL + ONE).replace("COURSE", course))
    (tmp_path / "two.ocp.yaml").write_text((USUAL + TWO).replace("COURSE", course))
    one = solve(*read_problem(tmp_path / "one.ocp.yaml", load))
    two = solve_phases(*read_phased_problem(tmp_path / "two.ocp.yaml", load_on_demand))
    assert isinstance(one, Solution)
    assert isinstance(two, PhasedSolution)
    assert two.cost == pytest.approx(one.cost.total, rel=1e-8)
    first, second = (phase.trajectory for phase in two.phases)
    assert first.u[:2] == pytest.approx(np.full((2, 1), 2.0))
    assert np.concatenate((first.u, second.u)) == pytest.approx(one.trajectory.u, abs=1e-4)
