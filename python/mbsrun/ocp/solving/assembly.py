"""Assemblies of a mechanism whose closed loops change with unknowns: lengths, angles and places of joints.

The start gives some coordinates, and the loops give the others. h(q, theta) = 0 has several solutions for one theta,
and the solver may end at another one than it began with. So theta goes back from the values found to their guesses,
step by step, with the given coordinates held. This ends at the start of the guess, if the motion belongs to its
assembly.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mbsrun.closure import Array, Closure, carry_pose, find_closure
from mbsrun.ocp.ground.plant import Plant
from mbsrun.ocp.problem.conditions import SAME, list_lengths
from mbsrun.ocp.problem.design import equip
from mbsrun.ocp.solution.solution import Solution


def find_other_assembly(solution: Solution, plant: Plant) -> str:
    """Describe why the mechanism found may be assembled otherwise than the guess; nothing where it is not.

    A start that leaves more free than loops give may belong to any assembly.
    """
    problem, start = solution.problem, solution.trajectory.q[0]
    if not list_lengths(problem, find_closure(plant)):
        return ""
    plant = equip(plant, problem, solution.trajectory.unknowns)
    closure = Closure(plant)
    guesses = {unknown.name: unknown.guess for unknown in problem.unknowns}
    values = {name: guesses[name] for name in list_lengths(problem, closure)}
    held = [i for i in range(start.size) if i not in problem.free_start]
    if not _determine(held, closure, start):
        return ""
    found, named = carry_pose(plant, start, values, held), ", ".join(values)
    if found is None:
        return f"no way of closed poses was found from the values of {named} back to the guesses"
    far = float(np.abs(found - problem.start_q).max())
    return f"with the guesses of {named} it starts {far:.3g} away from the guess" if far > SAME else ""


def _determine(held: Sequence[int], closure: Closure, q: Array) -> bool:
    """Return whether some coordinates determine all others near a pose."""
    return len(closure.choose_places(q, [*held, *range(q.size)])) == len(held)
