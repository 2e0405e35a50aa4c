"""Fixtures of the tests of optimal control: the arm made by hand, the paper's task, and its one solve."""

from __future__ import annotations

from pathlib import Path

import pytest

from mbsrun.ocp.problem.problem import Problem
from mbsrun.ocp.solution.solution import Solution
from mbsrun.ocp.solving.solve import solve
from mbsrun.ocp.statement.statement import read_problem
from tests.mbsrun.peer import Peer
from tests.mbsrun.peer_arm import peer_arm

MODELS = Path(__file__).parents[3] / "models"


@pytest.fixture(scope="session")
def arm() -> Peer:
    return peer_arm()


@pytest.fixture(scope="session")
def reach(arm: Peer) -> Problem:
    """The paper's task: phi = pi/2, r = 0.63 m, z = -0.1 m, (k1, k2) = (1, 1e5), N = 100, Radau of degree 4."""
    return read_problem(MODELS / "arm_reach.ocp.yaml", lambda _: arm)[0]


@pytest.fixture(scope="session")
def reached(arm: Peer, reach: Problem) -> Solution:
    """Its solution."""
    outcome = solve(reach, arm)
    assert isinstance(outcome, Solution)
    return outcome
