"""Parameters of models, and a given horizon, as variables that equal bounds hold: PhasedProblem -> PhasedProblem.

Then derivatives by them are derivatives by these bounds. Where loops change with a parameter, the coordinates that they
give at the start change, too: these are free then, and the loops close them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from mbsrun.closure import find_closure
from mbsrun.ocp.ground.plant import Plant
from mbsrun.ocp.problem.phases import Phase, PhasedProblem, Plants
from mbsrun.ocp.problem.problem import Problem, Unknown


def list_parameters(problem: PhasedProblem, plants: Plants) -> dict[str, float]:
    """Return the differentiated parameters of the models that no unknown replaces, with their values.

    Parameters are left out that two models have with different values, or that move loops where nothing shows which
    coordinates the loops give at the start.
    """
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


def hold(
    problem: PhasedProblem, plants: Plants, values: Mapping[str, float], *, horizon: bool = False
) -> PhasedProblem:
    """Return the problem with parameters as unknowns that bounds hold at values; `horizon`: every given one, too."""
    held = {name: Unknown(name, (value, value), value) for name, value in values.items()}
    pairs = zip(problem.phases, plants.phases, strict=True)
    phases = tuple(Phase(x.name, _hold(x.problem, plant, held, horizon=horizon)) for x, plant in pairs)
    freed = replace(problem, phases=phases)
    known = {unknown.name for unknown in freed.every_unknown}
    return replace(freed, unknowns=(*freed.unknowns, *(x for name, x in held.items() if name not in known)))


def _hold(problem: Problem, plant: Plant, held: Mapping[str, Unknown], *, horizon: bool) -> Problem:
    names = [p.name for p in plant.manifest.design if p.name in held]
    closure = find_closure(plant)
    is_moved = closure is not None and not set(closure.parameters).isdisjoint(names)
    return replace(
        problem,
        unknowns=(*problem.unknowns, *(held[name] for name in names)),
        free_start=_list_free(problem) if is_moved else problem.free_start,
        parameters=tuple(pair for pair in problem.parameters if pair[0] not in names),
        horizon_range=(problem.horizon,) * 2 if horizon and problem.is_timed else problem.horizon_range,
    )


def _list_free(problem: Problem) -> tuple[int, ...]:
    """List the states of the start that may change with a parameter."""
    return problem.free_start or problem.following
