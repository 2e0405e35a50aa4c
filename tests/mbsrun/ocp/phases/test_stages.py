"""Phases stage by stage: the project's own method against IPOPT, where links read other phases than the next one."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from mbsrun.external import load_on_demand
from mbsrun.ocp.solution.phases import PhasedSolution
from mbsrun.ocp.solution.solution import Failure
from mbsrun.ocp.solving.phases import resimulate_phases, solve_phases
from mbsrun.ocp.statement.checks import ProblemError
from mbsrun.ocp.statement.phases import read_phased_problem
from tests.mbsrun.ocp.phases.motions import SLIDER

TURNS = """
model: slider.yaml
scheme: radau
degree: 3
intervals: 3
horizon: {guess: 0.5, range: [0.1, 2]}
cost: {inputs: 1, terminal: [{expression: T, weight: 3}]}
constants: {period: 1.2}
unknowns: {stride: {range: [0.2, 1], guess: 0.5}}
solver: {method: METHOD}
phases:
  - name: ahead
    start: {pose: {}}
    end: {pose: {}}
    constraints: [{expression: q_way, range: [0, 0], at: start}, {expression: qd_way, range: [0, null], at: start}]
  - {name: rest, constraints: [{expression: qd_way, range: [null, 0.4]}]}
  - {name: on, intervals: 2, end: {pose: {}}}
links:
  - {from: ahead, to: rest, conditions: [{expression: end_q_way - stride/4, range: [0, 0]}]}
  - {from: rest, to: on, velocities: {way: way*0.7}, conditions: [{expression: end_u_way, range: [null, -0.3]}]}
  - from: on
    to: ahead
    map: {way: way - stride}
    conditions:
      - {expression: stride - 0.3*start_qd_way - WALL, range: [0, null]}
      - {expression: end_T + start_T, range: [0.8, 0.8]}
"""


@pytest.fixture
def solve(requires: Callable[[str], str], tmp_path: Path) -> Callable[..., PhasedSolution | Failure]:
    """Solve a periodic motion of a slider in three phases."""
    requires("cc")
    (tmp_path / "slider.yaml").write_text(SLIDER)

    def do(method: str, wall: str = "0.1", quantity: str = "end_u_way") -> PhasedSolution | Failure:
        file = tmp_path / "turns.ocp.yaml"
        file.write_text(TURNS.replace("METHOD", method).replace("WALL", wall).replace("end_u_way", quantity))
        problem, plants = read_phased_problem(file, load_on_demand)
        solution = solve_phases(problem, plants)
        return resimulate_phases(solution, plants) if isinstance(solution, PhasedSolution) else solution

    return do


def test_methods_agree_on_a_periodic_motion(solve: Callable[..., PhasedSolution]) -> None:
    """A link reads the start of the first phase; phases share a stride, and two of them a duration."""
    other, own = solve("ipopt"), solve("mbs")
    assert own.cost == pytest.approx(other.cost, rel=1e-7)
    assert own.durations == pytest.approx(other.durations, rel=1e-5)
    assert own.unknown_values == pytest.approx(other.unknown_values, rel=1e-5)
    assert max(link.violation for link in own.values) < 1e-9
    for phase, same in zip(own.phases, other.phases, strict=True):
        assert phase.trajectory.q == pytest.approx(same.trajectory.q, abs=1e-5)
        assert phase.resimulation is not None
        assert phase.resimulation.defect is not None
        assert phase.resimulation.defect < 1e-9


def test_a_stride_that_is_too_long_is_named(solve: Callable[..., Failure]) -> None:
    """The stride is at most 1, and the slider does not start backwards: so it is at least 1.6."""
    failure = solve("mbs", "1.6")
    assert isinstance(failure, Failure)
    assert failure.run.status == "Infeasible_Problem_Detected"
    assert "link on to ahead: stride" in failure.finding


def test_accelerations_of_a_link_belong_to_no_stage(solve: Callable[..., object]) -> None:
    with pytest.raises(ProblemError, match=r"conditions\[0\].expression: mbs cannot read .*: end_qdd_way"):
        solve("mbs", quantity="end_qdd_way")
    assert np.isfinite(solve("ipopt", quantity="end_qdd_way").cost)  # type: ignore[attr-defined]
