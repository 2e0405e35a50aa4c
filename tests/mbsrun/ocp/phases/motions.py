"""Motions that tests split into phases, and the ways to split and join them."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np

from mbsrun.ocp.ground.schemes import Family
from mbsrun.ocp.ground.trajectory import Trajectory
from mbsrun.ocp.problem.phases import Link, Phase, PhasedProblem
from mbsrun.ocp.problem.problem import Bounds, Cost, End, Problem, Term
from tests.mbsrun.ocp.plants import FREE_RANGE

MESH = ("t", "q", "qd")
SLIDER = """
name: slider
gravity: [0, 0, 0]
bodies:
  - {name: slider, joint: {name: way, type: prismatic, axis: x}, mass: 2}
"""


def swing_up() -> Problem:
    """Swing the pole of a cart up in 2 s, while the cart moves by 1 m."""
    return Problem(
        name="swing up",
        horizon=2.0,
        intervals=20,
        family=Family.RADAU,
        degree=3,
        cost=Cost(1.0, 0.0, (Term("a*qd_cart**2", 0.5),)),
        constants=(("a", 0.4),),
        start_q=(0.0, 0.0),
        start_qd=(0.0, 0.0),
        bounds=Bounds(((-2.0, 2.0), FREE_RANGE), (FREE_RANGE, FREE_RANGE), (FREE_RANGE,)),
        end=End(coordinates=((0, 1.0), (1, np.pi)), velocity_zero=True),
    )


def free_start(problem: Problem) -> Problem:
    """Leave the whole start free."""
    return replace(problem, free_start=tuple(range(len(problem.start_q) + len(problem.start_qd))))


def split(problem: Problem) -> PhasedProblem:
    """Split a motion in the middle into two phases."""
    half = replace(problem, horizon=problem.horizon / 2, intervals=problem.intervals // 2)
    first, second = replace(half, end=End()), free_start(half)
    return PhasedProblem("split", (Phase("first", first), Phase("second", second)), (Link("first", "second"),))


def cut(whole: Trajectory) -> tuple[Trajectory, Trajectory]:
    """Cut a trajectory in the middle."""
    N = len(whole.u) // 2

    def take(part: slice, mesh: slice, start: float) -> Trajectory:
        values = {f.name: getattr(whole, f.name)[mesh if f.name in (*MESH, "states") else part] for f in fields(whole)}
        return Trajectory(**{**values, "t": values["t"] - start, "point_t": values["point_t"] - start})

    middle = float(whole.t[N])
    return take(slice(N), slice(N + 1), 0.0), take(slice(N, None), slice(N, None), middle)
