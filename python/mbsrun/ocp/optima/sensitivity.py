"""The derivative of an optimal cost by parameters of the models, through the whole optimum: see `optima`."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

from mbsrun.ocp.ground.plant import Plant
from mbsrun.ocp.optima.held import list_parameters
from mbsrun.ocp.optima.questions import Number, ask
from mbsrun.ocp.problem.phases import Phase, PhasedProblem, Plants, equip_phases
from mbsrun.ocp.solution.phases import PhasedSolution, list_solution
from mbsrun.ocp.solution.solution import Solution


def find_phased_sensitivities(solution: PhasedSolution, plants: Plants) -> PhasedSolution:
    """Return the solution with the derivative of its cost by each differentiated parameter that is no unknown.

    Phases, and the models of impacts, share a parameter by its name. The solution has none where the models have no
    such parameter, or the optimum has no derivative; and none by parameters that two models have with different values,
    or by parameters of loops where nothing shows which coordinates these give at the start.
    """
    problem = solution.problem
    values = list_parameters(problem, equip_phases(problem, plants))
    if not values:
        return solution
    numbers = tuple(Number(name, value, _give(problem, plants, name)) for name, value in values.items())
    answer = ask(solution, problem, plants, numbers)
    costs = answer.movement.find_costs().tolist()
    found = tuple((number.name, cost) for number, cost in zip(numbers, costs, strict=True) if math.isfinite(cost))
    return replace(solution, sensitivities=found)


def find_sensitivities(solution: Solution, plant: Plant) -> Solution:
    """Return a solution without phases with the derivatives of its cost."""
    found = find_phased_sensitivities(list_solution(solution), Plants((plant,)))
    return found.single if found.sensitivities else solution


def _give(problem: PhasedProblem, plants: Plants, name: str) -> Callable[[float], PhasedProblem]:
    """Return what gives a parameter of all models another value."""

    def give(value: float) -> PhasedProblem:
        phases = []
        for phase, plant in zip(problem.phases, plants.phases, strict=True):
            given = dict(phase.problem.parameters)
            if name in {p.name for p in plant.manifest.design}:
                given[name] = value
            phases.append(Phase(phase.name, replace(phase.problem, parameters=tuple(given.items()))))
        return replace(problem, phases=tuple(phases))

    return give
