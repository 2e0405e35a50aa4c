"""Optimal motions that end on their limits (F36): `ends` draws random ones; two masses have a closed form.

A mass m that N constant inputs bring over a way d within T from rest to rest, with the least integral of the force
squared, costs 12 m^2 d^2 / T^3 / (1 - 1 / N^2). It never moves backwards nor beyond its end, so limits there change
nothing.
"""

from __future__ import annotations

import json
from dataclasses import replace

from mbsrun.external import load_on_demand
from mbsrun.ocp.ground.plant import Plant
from mbsrun.ocp.ground.schemes import Family
from mbsrun.ocp.problem.problem import (
    Bounds,
    Constraint,
    Cost,
    End,
    Form,
    Problem,
    Range,
    Representation,
    SolverOptions,
)
from mbsrun.ocp.solution.solution import Failure, Solution
from mbsrun.ocp.solving.solve import solve
from mbsrun.ocp.statement.statement import read_problem
from studies.laboratory.case import Finding, Workspace, check, demand, tell
from studies.laboratory.ends import RAILS, draw
from studies.laboratory.mechanisms import write

FREE: Range = (-float("inf"), float("inf"))
WAYS, MASSES, DURATION = (1.0, 2.0), (1.0, 2.0), 2.0
FORMS = (
    (Form.STANDARD, Representation.IMPL),
    (Form.STANDARD, Representation.EXP2_O),
    (Form.INTEGRAL, Representation.IMPL),
    (Form.SHOOTING, Representation.EXP1_O),
)
SAME = 1e-6  # of a cost
RANDOM = 20
METHODS = {
    "by default": SolverOptions(),
    "mbs alone": SolverOptions(method="mbs"),
    "IPOPT alone": SolverOptions(method="ipopt"),
}


def state_masses(intervals: int, form: Form, representation: Representation) -> Problem:
    """Move two masses to the ends of their rails, forwards alone; a row of both ends there, too."""
    rail = tuple((0.0, way) for way in WAYS)
    return Problem(
        name="rails",
        horizon=DURATION,
        intervals=intervals,
        family=Family.RADAU,
        degree=3,
        cost=Cost(1.0),
        start_q=(0.0, 0.0),
        start_qd=(0.0, 0.0),
        bounds=Bounds(rail, ((0.0, float("inf")),) * 2, (FREE,) * 2),
        end=End(coordinates=tuple(enumerate(WAYS)), velocity_zero=True),
        form=form,
        representation=representation,
        constraints=(Constraint("q_a + q_b", (-float("inf"), sum(WAYS))),),
    )


def measure_masses(workspace: Workspace, intervals: tuple[int, ...] = (8, 20, 45)) -> list[Finding]:
    """F36: the cost in closed form, in all forms; `mbs` alone is right or says that it has no answer."""
    plant = load_on_demand(write(workspace.folder, RAILS[1]))
    findings = []
    for count in intervals:
        masses = zip(MASSES, WAYS, strict=True)
        exact = sum(12 * (m * d) ** 2 for m, d in masses) / DURATION**3 / (1 - count**-2)
        for form, representation in FORMS:
            remark = f"{count} intervals, {form.value}, {representation.value}"
            for way, options in METHODS.items():
                problem = replace(state_masses(count, form, representation), solver=options)
                findings.append(_compare(way, solve(problem, plant), exact, remark))
    return findings


def _compare(way: str, outcome: Solution | Failure, exact: float, remark: str) -> Finding:
    """Compare a cost; a failure counts for the default way alone."""
    if isinstance(outcome, Solution):
        return check(way, "cost off", abs(outcome.cost.total / exact - 1), SAME, remark)
    return demand(way, "right, or no answer", way != "by default", f"{remark}: {outcome.run.status}")


def measure_random(workspace: Workspace, count: int = RANDOM) -> list[Finding]:
    """F36: random problems: every one that IPOPT solves is solved by default, and no cost is above IPOPT's nearby."""
    findings, solved = [], dict.fromkeys(METHODS, 0)
    for number in range(count):
        drawn = draw(number)
        problem, plant = read_problem(drawn.write(workspace.folder), load_on_demand)
        outcomes = {way: solve(replace(problem, solver=options), plant) for way, options in METHODS.items()}
        remark, peer = f"{number}, {drawn.kind}", outcomes["IPOPT alone"]
        for way, outcome in outcomes.items():
            solved[way] += isinstance(outcome, Solution)
        if isinstance(peer, Failure):
            continue
        for way in ("by default", "mbs alone"):
            found = outcomes[way]
            if isinstance(found, Solution):
                findings.append(_compare_near(way, found, problem, plant, remark))
            else:
                finding = demand(way, "right, or no answer", way != "by default", f"{remark}: {found.run.status}")
                findings.append(finding)
    remark = json.dumps(solved)
    return [*findings, *(tell(way, "solved", number, f"of {count}; {remark}") for way, number in solved.items())]


def _compare_near(way: str, found: Solution, problem: Problem, plant: Plant, remark: str) -> Finding:
    """Compare a cost with the one that IPOPT finds from there."""
    near = replace(problem, solver=SolverOptions(method="ipopt", options=(("mu_init", 1e-7), ("bound_push", 1e-9))))
    outcome = solve(near, plant, guess=found.trajectory)
    lower = outcome.cost.total if isinstance(outcome, Solution) else found.cost.total
    return check(way, "cost above one nearby", (found.cost.total - lower) / max(abs(lower), SAME), SAME, remark)
