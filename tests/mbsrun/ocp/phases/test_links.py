"""Phases that are linked: their optimum is that of the whole motion, whatever is written as a phase."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mbsrun.ocp.phases.problem import Condition, Link, Phase, PhasedProblem, Plants
from mbsrun.ocp.phases.solution import Guess, PhasedSolution
from mbsrun.ocp.phases.solve import resimulate_phases, solve_phases
from mbsrun.ocp.problem import Cost, End, Problem, Term
from mbsrun.ocp.solution import Solution
from mbsrun.ocp.solve import solve
from mbsrun.ocp.trajectory import Trajectory
from tests.mbsrun.ocp.plants import cart_pole
from tests.mbsrun.peer import Peer

FREE = (-np.inf, np.inf)


def swing_up() -> Problem:
    """Swing the pole up in 2 s, while the cart moves by 1 m."""
    whole = Problem.__dataclass_fields__
    assert "states" in whole
    from mbsrun.ocp.problem import Bounds
    from mbsrun.ocp.schemes import Family

    return Problem(
        name="swing up",
        horizon=2.0,
        intervals=20,
        family=Family.RADAU,
        degree=3,
        cost=Cost(1.0, 0.0),
        start_q=(0.0, 0.0),
        start_qd=(0.0, 0.0),
        bounds=Bounds(((-2.0, 2.0), FREE), (FREE, FREE), (FREE,)),
        end=End(coordinates=((0, 1.0), (1, np.pi)), velocity_zero=True),
    )
