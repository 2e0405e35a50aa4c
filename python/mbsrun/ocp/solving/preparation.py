"""Before a search: bounds, starts and ends that no motion can keep, and choices that a problem leaves open."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mbsgen.manifest import Manifest
from mbsrun.closure import find_closure
from mbsrun.ocp.ground.memory import Memory
from mbsrun.ocp.ground.plant import Plant
from mbsrun.ocp.ground.trajectory import Trajectory
from mbsrun.ocp.guessing.guess import Pose
from mbsrun.ocp.problem.conditions import find_open_states
from mbsrun.ocp.problem.contacts import find_stray_forces
from mbsrun.ocp.problem.problem import Loops, Problem
from mbsrun.ocp.statement.checks import Line, find_loop_conflicts
from mbsrun.ocp.statement.surplus import leave_out_surplus


def find_crossed_bounds(problem: Problem, manifest: Manifest) -> str | None:
    """Describe the first bound that no number can keep: solvers would raise an exception for it."""
    names = [c.name for c in manifest.coordinates]
    bounds = problem.bounds
    for kind, ranges, of in (
        ("coordinate", bounds.q, manifest.positions),
        ("velocity", bounds.qd, names),
        ("input", bounds.u, [names[i] for i in manifest.actuated]),
        ("force of driven joint", bounds.tau, [names[i] for i in manifest.driven][: len(bounds.tau)]),
        ("input rate", bounds.rates, [names[i] for i in manifest.actuated][: len(bounds.rates)]),
        ("control rate", [control.rates for control in problem.controls], problem.added.controls),
        ("constraint", [c.range for c in problem.constraints], [c.label for c in problem.constraints]),
        ("state", [state.bounds for state in problem.states], problem.added.states[: len(problem.states)]),
        ("control", [control.bounds for control in problem.controls], problem.added.controls),
        ("integral", [part.range for part in problem.integrals], [part.expression for part in problem.integrals]),
    ):
        for (lower, upper), name in zip(ranges, of, strict=True):
            if not (lower <= upper and lower < np.inf and upper > -np.inf):
                return f"the bounds of {kind} {name} are [{lower:g}, {upper:g}]"
    return None


def find_wrong_states(problem: Problem, plant: Plant) -> list[Line]:
    """Find a start or an end that closed loops contradict, and contacts whose forces act elsewhere or that slip."""

    def find() -> list[Line]:
        findings, closure = list(find_stray_forces(problem, plant)), find_closure(plant)
        return findings if closure is None else [*findings, *find_open_states(problem, closure)]

    return _WRONG_STATES.find(find, problem, plant)


_WRONG_STATES: Memory[list[Line]] = Memory()


def describe_unreachable(pose: Pose) -> tuple[str, str]:
    """Return finding and remedy of targets that no pose meets, or no motion reaches."""
    finding = f"no pose within the bounds meets the targets; the nearest one found is {pose.distance:.3g} m or rad away"
    remedy = "move the target or widen the bounds"
    if not pose.has_way:
        finding = "from the start to the pose found for the end, no motion was found that keeps the loops closed"
        remedy = "take guess.motion: rest, or another start, or targets that the mechanism reaches as it is assembled"
    return finding, remedy


def settle(problem: Problem, plant: Plant, guess: Trajectory | None = None) -> Problem:
    """Choose how loops become variables, where a problem leaves that open, and leave out conditions of the end.

    Loops are reduced where that is sure to work: where the independent coordinates determine the others along the
    guess, or at the start without one, and where the representation has a reduced form. Conditions that contacts imply
    are left out where a guess gives the pose. Raises ProblemError for values that contradict the contacts.
    """
    if guess is not None:
        problem = leave_out_surplus(problem, plant, guess.q[-1])
    closure = find_closure(plant)
    if closure is None or problem.loops is not None:
        return problem
    reduced = replace(problem, loops=Loops.REDUCED)
    path = np.array([problem.start_q])
    if guess is not None:
        path = np.concatenate((guess.q, guess.point_q.reshape(-1, guess.q.shape[1])))
    is_possible = not list(find_loop_conflicts(reduced, plant.manifest)) and closure.is_regular(path)
    return reduced if is_possible else replace(problem, loops=Loops.MULTIPLIERS)
