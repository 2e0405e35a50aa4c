"""Two problems of a pushed mass with all that the data of a controller may have, and their tables."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np

from mbsrun.controllers.fields import Sources, find_sources
from mbsrun.controllers.making import find_rows
from mbsrun.ocp.evaluation.stages.building import build
from mbsrun.ocp.problem.problem import Bounds, Constraint, Control, Cost, Delay, End, Problem, State, Term
from mbsrun.ocp.solving.solve import Solver
from tests.mbsrun.ocp.plants import push
from tests.mbsrun.peer import double_integrator

LATE = replace(
    push(4), start_q=(0.1,), start_qd=(0.2,), constants=(("k", 4.0), ("l", 5.0)),
    states=(
        State("heat", "u_slide**2", (-1.0, 50.0), (0.25, 0.25)), State("sum", "c", (-60.0, 61.0), end=(0.75, 0.75))
    ),
    controls=(Control("c", (-2.0, 3.0)), Control("e", (-17.0, 18.0))),
    bounds=Bounds(((-5.0, 6.0),), ((-7.0, 8.0),), ((-9.0, 10.0),), ((-11.0, 12.0),)),
    cost=Cost(
        1.5, 0.5, running=(Term("(q_slide - k)**2 + c**2 + l", 2.0), Term("c", 0.0), Term("e**2", 6.0)),
        terminal=(Term("heat", 3.5),), control_rates=(("c", 0.125),),
    ),
    constraints=(Constraint("q_slide + c", (-13.0, 14.0)), Constraint("qd_slide", (-15.0, 16.0), "end")),
    end=End(coordinates=((0, 1.0),), velocities=((0, 0.3),), accelerations=((0, 0.6),)),
    delays=(Delay("input", 0, 0.5, 0.7),),
)  # fmt: skip
FREE_TIME = replace(
    push(3), horizon_range=(0.5, 2.0), cost=Cost(1.0),
    end=End(sensors=(("place", (1.0, None, 0.0)),), sensor_velocities=(("place", (0.4, None, None)),)),
)  # fmt: skip
PROBLEMS = {"late": LATE, "free time": FREE_TIME}


@dataclass(frozen=True)
class Built:
    """The tables of a problem, and the data of problems of the same structure."""

    problem: Problem
    transcription: Any
    tables: Any

    def find(self, problem: Problem) -> Sources:
        plant: Any = double_integrator()
        return find_sources(problem, self.transcription, self.tables, plant)


@cache
def make(name: str) -> Built:
    problem, plant = PROBLEMS[name], double_integrator()
    transcription = Solver(problem, plant).transcription
    rows = find_rows(transcription, problem)
    return Built(problem, transcription, build(transcription.program, plant, np.array(problem.cost.weights) != 0, rows))
