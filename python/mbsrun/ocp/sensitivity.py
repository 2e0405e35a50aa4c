"""The derivative of an optimal cost by parameters of the model, through the whole optimum.

With cost f(x, p), constraints g(x, p) and their multipliers lam at the optimum x(p), only the part at constant x
remains of the total derivative (Fiacco, "Introduction to sensitivity and stability analysis in nonlinear programming",
1983, section 3.2):

    d/dp f(x(p), p) = f_p + lam' g_p.

The parameters are variables of the program, held at their values by bounds; the program is solved again from its
solution, which gives the multipliers.

Where loops change with a parameter, the coordinates that they give at the start change, too: these are free then, and
the loops close them.
"""

from __future__ import annotations

from dataclasses import replace

from mbsrun.closure import find_closure
from mbsrun.ocp.methods import METHODS, Assignment, Instance
from mbsrun.ocp.phases.problem import Phase, PhasedProblem, Plants, equip_phases
from mbsrun.ocp.phases.solution import PhasedSolution, list_solution
from mbsrun.ocp.phases.solve import PhasedSolver
from mbsrun.ocp.plant import Plant
from mbsrun.ocp.problem import Problem, Unknown
from mbsrun.ocp.solution import Solution
from mbsrun.ocp.status import SOLVED
from mbsrun.ocp.trajectory import Array

SAME = 1e-6  # the largest relative difference of the costs of both solves
METHOD = "ipopt"


def find_phased_sensitivities(solution: PhasedSolution, plants: Plants) -> PhasedSolution:
    """Return the solution with the derivative of its cost by each differentiated parameter that is no unknown.

    Phases, and the models of impacts, share a parameter by its name. The solution has none where the models have no
    such parameter, or the second solve does not end in the same optimum; and none by parameters that two models have
    with different values, or by parameters of loops where nothing shows which coordinates these give at the start.
    """
    problem = _hold_unknowns(solution)
    plants = equip_phases(problem, plants)
    values = _list_parameters(problem, plants)
    if not values:
        return solution
    held = {name: Unknown(name, (value, value), value) for name, value in values.items()}
    pairs = zip(problem.phases, plants.phases, strict=True)
    freed = replace(problem, phases=tuple(Phase(x.name, _free(x.problem, plant, held)) for x, plant in pairs))
    known = {unknown.name for unknown in freed.every_unknown}
    freed = replace(freed, unknowns=(*freed.unknowns, *(x for name, x in held.items() if name not in known)))
    gradient = _differentiate(freed, plants, solution)
    if gradient is None:
        return solution
    return replace(solution, sensitivities=tuple((name, gradient[name]) for name in values))


def find_sensitivities(solution: Solution, plant: Plant) -> Solution:
    """Return a solution without phases with the derivatives of its cost."""
    found = find_phased_sensitivities(list_solution(solution), Plants((plant,)))
    return found.single if found.sensitivities else solution


def _hold_unknowns(solution: PhasedSolution) -> PhasedProblem:
    """Return the problem with the unknowns found as their guesses."""
    problem, values = solution.problem, dict(solution.guess.unknowns)

    def find(unknowns: tuple[Unknown, ...]) -> tuple[Unknown, ...]:
        return tuple(replace(unknown, guess=values[unknown.name]) for unknown in unknowns)

    problem = problem.change(lambda own: replace(own, unknowns=find(own.unknowns)))
    return replace(problem, unknowns=find(problem.unknowns))


def _list_parameters(problem: PhasedProblem, plants: Plants) -> dict[str, float]:
    """Return the parameters that cost can be differentiated by, with their values."""
    values: dict[str, float] = {}
    left_out = {unknown.name for unknown in problem.every_unknown}
    for phase, plant in zip(problem.phases, plants.phases, strict=True):
        closure = find_closure(plant)
        if closure is not None and not _list_free(phase.problem):
            left_out.update(closure.parameters)
    for plant in plants.every:
        for name in (p.name for p in plant.manifest.design):
            if values.setdefault(name, plant.parameters[name]) != plant.parameters[name]:
                left_out.add(name)
    return {name: value for name, value in values.items() if name not in left_out}


def _list_free(problem: Problem) -> tuple[int, ...]:
    """List the states of the start that may change with a parameter."""
    return problem.free_start or problem.following


def _free(problem: Problem, plant: Plant, held: dict[str, Unknown]) -> Problem:
    """Return a phase in which the parameters of its model are variables, held at their values by bounds."""
    names = [p.name for p in plant.manifest.design if p.name in held]
    closure = find_closure(plant)
    is_moved = closure is not None and not set(closure.parameters).isdisjoint(names)
    return replace(
        problem,
        unknowns=(*problem.unknowns, *(held[name] for name in names)),
        free_start=_list_free(problem) if is_moved else problem.free_start,
        parameters=tuple(pair for pair in problem.parameters if pair[0] not in names),
    )


def _differentiate(problem: PhasedProblem, plants: Plants, solution: PhasedSolution) -> dict[str, float] | None:
    """Solve again; return the derivatives of the cost by all unknowns, None where the optimum is another one.

    An unknown moves with all its copies, whose rows have any multipliers where bounds hold them all.
    """
    problem = problem.with_solver(METHOD)
    problem = problem.change(lambda own: replace(own, solver=problem.solver))
    solver = PhasedSolver(problem, plants)
    transcription, functions = solver.transcription, solver.program.casadi
    guess = {unknown.name: unknown.guess for unknown in problem.every_unknown}
    start = Instance(
        solver.fill(problem, replace(solution.guess, unknowns=tuple(guess.items()))),
        transcription.parameters(problem),
        *transcription.variable_bounds(problem),
        *transcription.constraint_bounds(problem),
    )
    method, options = METHODS[METHOD], problem.solver
    scaling = options.objective_scaling or 1 / problem.weight
    settings = dict(method.warm) | dict(options.options)
    asked = Assignment(solver.program, options.tolerance, options.max_iterations, scaling, settings)
    answer = method.make(asked)(start)
    cost = float(functions.objective(answer.x, start.parameters))
    is_same = abs(cost - solution.cost) <= SAME * max(1.0, abs(cost))
    if answer.status != SOLVED or answer.multipliers is None or not is_same:
        return None
    gradient: Array = functions.gradient(answer.x, start.parameters)[1].full().ravel()
    gradient += functions.jacobian(answer.x, start.parameters).full().T @ answer.multipliers
    places = transcription.list_unknowns(problem)
    return {name: float(gradient[transcription.see(variables)].sum()) for name, variables in places.items()}
