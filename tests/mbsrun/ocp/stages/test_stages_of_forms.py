"""Tables of stages of many small problems: C computes from them the functions of the program that they were made of.

Each problem has a part that the others lack: delays, rates, controls, polynomial inputs, integrals, unknown numbers,
a free horizon, other schemes and integrators, and phases whose links read the start of the first one.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from mbsrun.external import OnDemand, load_on_demand
from mbsrun.ocp.evaluation.stages.binding import Evaluator, Tables
from mbsrun.ocp.evaluation.stages.building import build
from mbsrun.ocp.ground.schemes import Family
from mbsrun.ocp.problem.phases import Condition, Link, Phase, PhasedProblem, Plants
from mbsrun.ocp.problem.problem import (
    Bounds,
    Constraint,
    Control,
    Cost,
    Delay,
    End,
    Force,
    Form,
    Integral,
    State,
    Term,
    Unknown,
)
from mbsrun.ocp.transcription.phases import transcribe_phases
from mbsrun.ocp.transcription.transcription import transcribe
from tests.mbsrun.ocp.phases.motions import SLIDER
from tests.mbsrun.ocp.plants import FREE_RANGE, push
from tests.mbsrun.ocp.stages.stage_functions import compare

EPSILON = np.finfo(np.float64).eps
FREE = (FREE_RANGE,)
COST = Cost(1.0, 0.5, running=(Term("(q_way - sin(t))**2", 2.0),), terminal=(Term("exp(q_way)", 3.0),))
CASES: dict[str, dict[str, Any]] = {
    "delays, rates, controls": {
        "controls": (Control("c", rates=(-3.0, 3.0)), Control("e")), "forces": (Force(0, "c*e - q_way**2"),),
        "delays": (Delay("control", 1, 1 / 3), Delay("control", 0, 2 / 3, None)), "mesh": None,
        "cost": replace(COST, control_rates=(("c", 0.3),)),
    },
    "inputs that act late": {
        "delays": (Delay("input", 0, 2 / 3, 0.7),), "bounds": Bounds(FREE, FREE, FREE, ((-2.0, 2.0),)), "cost": COST,
    },
    "states, integrals, unknown numbers, a free start, unequal intervals": {
        "states": (State("s", "sin(s)*u_way + p", start=(0.5, 0.5)),), "unknowns": (Unknown("p"), Unknown("r")),
        "integrals": (Integral("u_way**2*r", (0.0, 9.0)),), "cost": COST, "mesh": (0.5, 0.3, 0.2), "free_start": (0, 1),
        "constraints": (
            Constraint("q_way*p - r", (0.0, 1.0)), Constraint("s**2", (0.0, 2.0), "end"),
            Constraint("q_way*qd_way", (0.0, 1.0), "start"),
        ),
    },
    "polynomial inputs, Legendre points, a free horizon": {
        "inputs": "polynomial", "cost": replace(COST, input_rates=0.0), "family": Family.LEGENDRE,
        "horizon_range": (0.5, 2.0), "end": End(accelerations=((0, 0.0),), velocities=((0, 0.3),)),
        "constraints": (Constraint("qdd_way*T", (-5.0, 5.0)), Constraint("u_way + t", (-9.0, 9.0), "start")),
    },
    "second order": {
        "form": Form.INTEGRAL, "integrator": "second-order", "cost": COST,
        "constraints": (Constraint("q_way**2", (0.0, 4.0)),),
    },
}  # fmt: skip


@pytest.fixture(scope="module")
def plant(tmp_path_factory: pytest.TempPathFactory) -> OnDemand:
    """Return the kernels of a mass on a rail."""
    file = tmp_path_factory.mktemp("slider") / "slider.yaml"
    file.write_text(SLIDER, encoding="utf-8")
    return load_on_demand(file)


def check(program: Any, weights: Any, bounds: tuple[Any, Any], plant: OnDemand, p: Any) -> None:
    """Compare values, Jacobian and Hessian at a random point."""
    rng = np.random.default_rng(0)
    rows = np.ones(program.constraints, dtype=bool)
    rows[program.kept_rows] = np.isfinite(bounds[0]) | np.isfinite(bounds[1])
    data = build(program, plant, weights, rows)
    x = rng.uniform(0.3, 1.0, program.variables)
    found = compare(Evaluator(Tables(data, plant), p), program, plant, x, p, rng)
    assert max(found.values, found.slopes, found.curvatures) < 1000 * EPSILON


@pytest.mark.parametrize("name", CASES)
def test_functions_of_stages_are_those_of_the_program(name: str, plant: OnDemand) -> None:
    problem = replace(push(3), **CASES[name])
    transcription = transcribe(problem, plant)
    p = transcription.parameters(problem)
    weights = p[: len(transcription.program.H)] != 0
    check(transcription.program, weights, transcription.constraint_bounds(problem), plant, p)


def join(last: Link) -> PhasedProblem:
    """Make three phases on grids and lengths of different kinds; the last link leads from the end to the start."""
    own = replace(push(3), end=End(), unknowns=(Unknown("stride"),), free_start=(0, 1), cost=COST)
    phases = (
        replace(own, horizon_range=(0.1, 2.0), constraints=(Constraint("q_way - stride*t", (0.0, 1.0)),)),
        replace(own, intervals=2, mesh=(0.4, 0.6)),
        replace(own, horizon_range=(0.1, 2.0), degree=3, unknowns=()),
    )
    links = (
        Link("a", "b", conditions=(Condition("end_u_way + end_T", (-3.0, 3.0)),)),
        Link("b", "c", velocities=(("way", "way*0.7"),), cost=(Term("end_q_way**2*stride", 2.0),)),
        last,
    )
    return PhasedProblem("turn", tuple(map(Phase, "abc", phases)), links)


LINKS = {
    "a step further": Link("c", "a", map=(("way", "way - stride"),)),
    "numbers and prices of both sides": Link(
        "c", "a", conditions=(Condition("stride - 0.3*start_qd_way*end_q_way", (0.0, 1.0)),),
        cost=(Term("(end_q_way - start_q_way)**2", 1.0),),
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", LINKS)
def test_functions_of_stages_of_phases_are_those_of_the_program(name: str, plant: OnDemand) -> None:
    """States of the start that the last link reads are copied through all stages."""
    problem = join(LINKS[name])
    own = transcribe_phases(problem, Plants((plant,) * 3))
    assert not own.unstaged.size
    p = own.parameters(problem)
    check(own.program, p[: len(own.program.H)] != 0, own.constraint_bounds(problem), plant, p)


def test_a_start_that_is_given_is_no_equation(plant: OnDemand) -> None:
    """Bounds of variables fix it; where the start is free, the rows that would give it are no rows of a stage."""
    sizes = []
    for free in ((), (0,), (0, 1)):
        problem = replace(push(3), free_start=free)
        transcription = transcribe(problem, plant)
        data = build(transcription.program, plant)
        sizes.append(len(data.fixed))
        assert {variable for variable, _ in data.fixed} <= {0, 1}
    assert sizes[0] == 2
