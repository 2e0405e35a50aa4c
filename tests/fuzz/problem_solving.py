"""Optima of random problems by both methods, and in two representations.

A drawn problem is changed until its motion is feasible and its cost grows with every unknown number. A solution keeps
its limits, and meets the conditions of optimality, with multipliers that are found anew: in its own representation, and
in another one.
"""

from __future__ import annotations

import copy
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.optimize import lsq_linear

from mbsrun.ocp.ground.plant import Plant
from mbsrun.ocp.problem.problem import Problem as Stated
from mbsrun.ocp.problem.problem import Representation, find_conflicts
from mbsrun.ocp.solution.solution import Solution
from mbsrun.ocp.solving.solve import Solver, solve
from tests.fuzz.formulas import Formula
from tests.fuzz.own_motion import Motion
from tests.fuzz.own_problem import Problem
from tests.fuzz.own_sections import Sections
from tests.fuzz.problem_drawing import Data
from tests.fuzz.problem_names import spell

METHODS = ("mbs", "ipopt")
VIOLATED = 1e-5  # IPOPT scales rows
OPTIMAL = 1e-4  # relative to the gradient: the residual of the conditions of optimality
ACTIVE = 1e-4  # the root of the tolerance: of a multiplier and the distance to its limit, one may be that large
MARGIN = 0.3
ITERATIONS = 200


def ease(data: Data, problem: Problem, motion: Motion, sections: Sections) -> Data:
    """Change a problem so that a motion is feasible, and the cost bounded."""
    eased = copy.deepcopy(data)
    _widen(eased, sections)
    _meet(eased, problem, motion)
    names = [f"q_{spell(x)}" for x in problem.own.positions] + [*problem.unknowns]
    names += [*eased.get("states", {}), *eased.get("controls", {})]
    names += [name for name, part in problem.list_components().items() if isinstance(part, dict)]
    tree: Any = 0
    for name in names:
        tree = ("+", ("**", name, 2), tree)
    cost = eased["cost"]
    for key in ("running", "terminal"):
        for term in cost[key]:  # bounded, whatever it is
            term["expression"] = Formula(("sin", term["expression"].tree))
    cost["running"] = [*cost["running"], {"expression": Formula(tree), "weight": 3}]
    cost["inputs"] = 1
    eased["solver"] = {"max_iterations": ITERATIONS}
    return eased


def _widen(data: Data, sections: Sections) -> None:
    """Widen ranges, so that they hold the values along the motion."""
    places = {"path": sections.points, "start": sections.first, "end": sections.last}
    for part in (*data["constraints"], *data.get("integrals", ())):
        if part in data["constraints"]:
            values = [part["expression"].evaluate(places[part.get("at", "path")])]
            if part.get("at", "path") == "path" and not part["expression"].names & set(sections.list_jumping()):
                values.append(part["expression"].evaluate(sections.inner))
        else:
            i = data["integrals"].index(part)
            values = [sections.motion.states[f"@integral {i}"][-1:]]
        every = np.concatenate([np.atleast_1d(x) for x in values])
        part["range"] = _hold(part["range"], every)


def _hold(limits: list[Any], values: Any) -> list[Any]:
    return [
        None if limits[0] is None else round(float(values.min()) - MARGIN, 3),
        None if limits[1] is None else round(float(values.max()) + MARGIN, 3),
    ]


def _meet(data: Data, problem: Problem, motion: Motion) -> None:
    """Move starts, ends and histories to where the motion is."""
    own = problem.own
    q, qd = (dict(zip(names, values.T.tolist(), strict=True)) for names, values in
             ((own.positions, motion.q), (own.velocities, motion.qd)))  # fmt: skip
    start, end = data["start"], data.get("end", {})
    pose = {x: None if start["pose"].get(x, 0) is None else q[x][0] for x in own.positions}
    speeds = start.get("velocity", {})
    start |= {"pose": pose, "velocity": {x: None if speeds.get(x, 0) is None else qd[x][0] for x in own.velocities}}
    end.pop("acceleration", None)
    end.pop("sensor_velocities", None)
    last = problem.at_end(motion, 1)
    for name in end.get("sensors", {}):
        end["sensors"][name] = {"x": float(last[f"x_{spell(name)}"][0])}
    if "pose" in end:
        end["pose"] = {x: q[x][-1] for x in end["pose"]}
    if "velocity" in end:
        end["velocity"] = {x: qd[x][-1] for x in (own.velocities if end["velocity"] == "zero" else end["velocity"])}
    for name, part in data.get("states", {}).items():
        first, last_one = (float(motion.states[name][i]) for i in (0, -1))
        part["start"] = first if isinstance(part["start"], float) else None
        part["end"] = last_one if isinstance(part["end"], float) else None
    bounds = data.get("bounds", {})
    bounds.pop("input_rates", None)
    for part in data.get("controls", {}).values():
        part.pop("rate", None) if problem.course == "constant" else None
        if "delay" in part:
            part["history"] = "free"
    if isinstance(data.get("inputs"), dict) and "delay" in data["inputs"]:
        data["inputs"]["history"] = "free"


def measure_optimality(solution: Solution, solver: Solver) -> float:
    """Return the least residual of the first-order conditions over all multipliers of the right signs."""
    stated, own, functions = solution.problem, solver.transcription, solver.program.casadi
    x, p = own.pack(solution.trajectory), own.parameters(solution.problem)
    gradient = functions.gradient(x, p)[1].full().ravel() / max(map(abs, stated.cost.weights))
    J, g = functions.jacobian(x, p).full(), functions.constraint(x, p).full().ravel()
    columns, least, most = [], [], []
    for values, rows, (lower, upper) in (
        (g, J, own.constraint_bounds(stated)),
        (x, np.eye(x.size), own.variable_bounds(stated)),
    ):
        low, high = values - lower <= ACTIVE * (1 + abs(values)), upper - values <= ACTIVE * (1 + abs(values))
        chosen = low | high
        columns.append(rows[chosen])
        least.append(np.where(low[chosen], -np.inf, 0.0))
        most.append(np.where(high[chosen], np.inf, 0.0))
    A = np.concatenate(columns).T
    found = lsq_linear(A, -gradient, (np.concatenate(least), np.concatenate(most)), tol=1e-14)
    return float(abs(A @ found.x + gradient).max() / (1 + abs(gradient).max()))


def find_wrong_solutions(stated: Stated, plant: Plant) -> list[str]:
    """Solve by both methods; return the faults of solutions. Where a method finds none, it says so."""
    found, costs = [], {}
    for name in METHODS:
        solution = solve(stated.with_solver(name), plant)
        if not isinstance(solution, Solution):
            continue
        costs[name] = solution.cost.total
        violation = max(solution.violation.constraints, solution.violation.bounds)
        if not violation <= VIOLATED:
            found.append(f"{name}: constraints and bounds are violated by {violation:.1e}")
        residual = measure_optimality(solution, Solver(stated, plant))
        if not residual <= OPTIMAL:
            found.append(f"{name}: the conditions of optimality are left by {residual:.1e}")
        found += _find_other_optima(solution, plant)
    return found


def _find_other_optima(solution: Solution, plant: Plant) -> Iterator[str]:
    """Solve in another representation, from the solution: its first-order conditions hold there, too.

    At the ends of intervals that are no points, representations read accelerations in different ways.
    """
    stated = solution.problem
    texts = [x.expression for x in stated.cost.terminal] + [x.expression for x in stated.constraints]
    if stated.integrator == "rk4" or any("qdd" in text for text in texts):
        return
    name = Representation.EXP1_O if stated.representation is Representation.IMPL else Representation.IMPL
    changed = replace(stated, representation=name)
    if list(find_conflicts(changed)):
        return
    residual = measure_optimality(replace(solution, problem=changed), Solver(changed, plant))
    if not residual <= OPTIMAL:
        yield f"{name.value}: the solution of {stated.representation.value} is not optimal, by {residual:.1e}"
