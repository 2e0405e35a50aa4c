"""A motion of a mass in which everything reads the horizon, given and free, in all forms."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

from mbsrun.ocp.ground.schemes import Family
from mbsrun.ocp.problem.problem import (
    Bounds,
    Constraint,
    Control,
    Cost,
    End,
    Form,
    Problem,
    Representation,
    State,
    Term,
)
from mbsrun.ocp.transcription.transcription import Transcription, transcribe
from tests.mbsrun.peer import Peer, double_integrator

MESH = (0.3, 0.2, 0.4, 0.1)  # of the horizon
LONGER = 1.7  # than the guess of 1 s


@cache
def plant() -> Peer:
    return double_integrator()


def state(family: Family, **changes: Any) -> Problem:
    """State a motion of the mass with everything that a horizon changes: steps, rates, times in expressions."""
    problem = Problem(
        name="horizons",
        horizon=LONGER,
        intervals=len(MESH),
        family=family,
        degree=2,
        cost=Cost(0.7, 0.3, (Term("q_slide**2*t + u_slide", 2.0), Term("T*qd_slide**2", 0.5))),
        start_q=(0.1,),
        start_qd=(0.2,),
        bounds=Bounds(q=((-1.0, 1.0),), qd=((-3.0, 3.0),), u=((-5.0, 5.0),), rates=((-7.0, 9.0),)),
        end=End(coordinates=((0, 0.5),), velocity_zero=True, sensors=(("place", (0.4, -0.1, 0.2)),)),
        constraints=(Constraint("q_slide + t/T", (-1.0, 2.0)), Constraint("u_slide*T", (-8.0, 8.0))),
        mesh=MESH,
    )
    return replace(problem, **changes)


ADDED = {
    "states": (State("w", "q_slide + c - w*t", (-4.0, 4.0), (0.3, 0.3)),),
    "controls": (Control("c", (-2.0, 2.0), rates=(-3.0, 3.0)),),
}
CASES: dict[str, tuple[Family, dict[str, Any]]] = {
    **{family.value: (family, {}) for family in Family},
    **{way.value: (Family.RADAU, {"representation": way}) for way in Representation},
    "integral": (Family.LEGENDRE, {"form": Form.INTEGRAL}),
    "shooting": (Family.RADAU, {"form": Form.SHOOTING, "steps": 2}),
    "rk4": (
        Family.RADAU,
        {"form": Form.SHOOTING, "integrator": "rk4", "steps": 2, "representation": Representation.EXP1_O},
    ),
    "polynomials": (Family.LEGENDRE, {"inputs": "polynomial", "cost": Cost(0.7, 0.0, ())}),
    "a state and a control": (Family.RADAU, ADDED),
}


def pair(name: str) -> tuple[Transcription, Transcription, Problem, Problem]:
    """Transcribe a case with the horizon given, and with the same horizon free; return both with their problems."""
    family, changes = CASES[name]
    given = state(family, **changes)
    if "inputs" in changes:
        given = replace(given, bounds=replace(given.bounds, rates=()))
    free = replace(given, horizon=1.0, horizon_range=(0.5, 3.0))
    return transcribe(given, plant()), transcribe(free, plant()), given, free
