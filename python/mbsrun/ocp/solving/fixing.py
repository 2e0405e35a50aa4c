"""Fix the numbers of a mechanism that a problem chooses, lengths and masses: problem -> a problem with their values.

A mechanism is built once, so a loop that plans again and again cannot choose them anew. They are found by one solve,
and become parameters of the problem, and constants of its expressions. Where they change closed loops, the start is
closed with them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Generic, TypeVar

import numpy as np

from mbsgen.manifest import Manifest
from mbsrun.closure import find_closure
from mbsrun.ocp.ground.plant import Plant
from mbsrun.ocp.ground.trajectory import Trajectory
from mbsrun.ocp.problem.design import equip
from mbsrun.ocp.problem.problem import Problem
from mbsrun.ocp.solution.solution import Failure, Solution
from mbsrun.ocp.solving.solve import solve

SomePlant = TypeVar("SomePlant", bound=Plant)


@dataclass(frozen=True, eq=False)
class Fixed(Generic[SomePlant]):
    """A problem and its mechanism with their numbers, and a guess of its motion, if one is known."""

    problem: Problem
    plant: SomePlant
    guess: Trajectory | None
    numbers: Mapping[str, float] = field(default_factory=dict)  # that were unknown


def list_numbers(problem: Problem, manifest: Manifest) -> tuple[str, ...]:
    """List the unknowns of a problem that are parameters of its mechanism."""
    known = {parameter.name for parameter in manifest.design}
    return tuple(unknown.name for unknown in problem.unknowns if unknown.name in known)


def fix_numbers(
    problem: Problem, plant: SomePlant, guess: Trajectory | None = None, given: Mapping[str, float] | None = None
) -> Fixed[SomePlant] | Failure:
    """Solve for the numbers of a mechanism, if the problem has some; values that are given count instead."""
    names = list_numbers(problem, plant.manifest)
    if not names:
        return Fixed(problem, equip(plant, problem), guess)
    outcome = solve(problem, plant, guess=guess)
    if isinstance(outcome, Failure):
        return outcome
    unknowns = [unknown.name for unknown in problem.unknowns]
    found = dict(zip(unknowns, outcome.trajectory.unknowns.tolist(), strict=True)) | dict(given or {})
    numbers = {name: found[name] for name in names}
    kept = [i for i, name in enumerate(unknowns) if name not in numbers]
    motion = replace(outcome.trajectory, unknowns=outcome.trajectory.unknowns[kept])
    fixed = replace(
        problem,
        free_start=tuple(i for i in problem.free_start if i not in problem.following),
        following=(),
        unknowns=tuple(problem.unknowns[i] for i in kept),
        parameters=tuple({**dict(problem.parameters), **numbers}.items()),
        constants=(*problem.constants, *numbers.items()),
    )
    equipped = equip(plant, fixed)
    if problem.following:
        fixed = _close_start(fixed, equipped, outcome)
    return Fixed(fixed, equipped, motion, numbers)


def _close_start(problem: Problem, plant: Plant, solution: Solution) -> Problem:
    """Return the problem with the start of a solution, closed with the numbers of the mechanism."""
    closure = find_closure(plant)
    assert closure is not None, "loops give states that follow"
    (q,), (qd,) = closure.project(solution.trajectory.q[:1], solution.trajectory.qd[:1])
    return replace(problem, start_q=tuple(np.asarray(q).tolist()), start_qd=tuple(np.asarray(qd).tolist()))
