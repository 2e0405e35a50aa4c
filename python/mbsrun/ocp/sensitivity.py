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

import numpy as np

from mbsrun.closure import find_closure
from mbsrun.ocp.design import equip
from mbsrun.ocp.methods import METHODS, Order, Start
from mbsrun.ocp.plant import Plant
from mbsrun.ocp.problem import Unknown
from mbsrun.ocp.solution import Solution
from mbsrun.ocp.solve import Solver
from mbsrun.ocp.status import SOLVED
from mbsrun.ocp.trajectory import Array

SAME = 1e-6  # the largest relative difference of the costs of both solves
METHOD = "ipopt"


def find_sensitivities(solution: Solution, plant: Plant) -> Solution:
    """Return the solution with the derivative of its cost by each differentiated parameter that is no unknown.

    It has none where the model has no such parameter, or the second solve does not end in the same optimum; and none by
    parameters of loops where nothing shows which coordinates these give at the start.
    """
    problem = solution.problem
    chosen = {unknown.name for unknown in problem.unknowns}
    plant = equip(plant, problem, solution.trajectory.unknowns)
    closure, free = find_closure(plant), problem.free_start or problem.following
    left_out = closure.parameters if closure is not None and not free else ()
    names = [p.name for p in plant.manifest.design if p.name not in chosen and p.name not in left_out]
    if not names:
        return solution
    held = tuple(Unknown(name, (plant.parameters[name],) * 2, plant.parameters[name]) for name in names)
    is_moved = closure is not None and not set(closure.parameters).isdisjoint(names)
    freed = replace(
        problem.with_solver(METHOD),
        unknowns=(*problem.unknowns, *held),
        free_start=free if is_moved else problem.free_start,
        parameters=tuple(pair for pair in problem.parameters if pair[0] not in names),
    )
    values = np.concatenate((solution.trajectory.unknowns, [unknown.guess for unknown in held]))
    solver = Solver(freed, plant)
    transcription, functions = solver.transcription, solver.program.casadi
    start = Start(
        transcription.pack(replace(solution.trajectory, unknowns=values)),
        transcription.parameters(freed),
        *transcription.variable_bounds(freed),
        *transcription.constraint_bounds(freed),
    )
    method, options = METHODS[METHOD], freed.solver
    scaling = options.objective_scaling or 1 / max(map(abs, problem.cost.weights))
    settings = dict(method.warm) | dict(options.options)
    answer = method.make(Order(solver.program, options.tolerance, options.max_iterations, scaling, settings))(start)
    cost = float(functions.objective(answer.x, start.parameters))
    is_same = abs(cost - solution.cost.total) <= SAME * max(1.0, abs(cost))
    if answer.status != SOLVED or answer.multipliers is None or not is_same:
        return solution
    gradient: Array = functions.gradient(answer.x, start.parameters)[1].full().ravel()
    gradient += functions.jacobian(answer.x, start.parameters).full().T @ answer.multipliers
    at = transcription.layout.unknowns[len(problem.unknowns) :]
    return replace(solution, sensitivities=tuple(zip(names, gradient[at].tolist(), strict=True)))
