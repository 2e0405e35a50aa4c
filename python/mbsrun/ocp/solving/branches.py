"""Points of a reduced form between which the independent coordinates do not determine the motion of closed loops."""

from __future__ import annotations

from mbsrun.closure import Closure, find_closure
from mbsrun.ocp.ground.plant import Plant
from mbsrun.ocp.problem.design import equip
from mbsrun.ocp.problem.problem import Loops
from mbsrun.ocp.solution.solution import Solution


def find_jump(solution: Solution, plant: Plant) -> str:
    """Describe why the points of a reduced form lie on two branches of the loops; nothing where they do not."""
    closure = _find_closure(solution, plant)
    if closure is None or solution.problem.loops is not Loops.REDUCED or not closure.jumps(solution.trajectory.q):
        return ""
    return _name_independent(closure)


def find_singular(solution: Solution, plant: Plant) -> str:
    """Describe why the reduced form does not determine a motion; nothing where it does, or is not taken."""
    closure = _find_closure(solution, plant)
    if closure is None or solution.problem.loops is not Loops.REDUCED:
        return ""
    try:
        is_regular = closure.is_regular(solution.trajectory.q)
    except ValueError:  # there are no dependent coordinates
        is_regular = False
    return "" if is_regular else _name_independent(closure)


def _find_closure(solution: Solution, plant: Plant) -> Closure | None:
    """Return the loops of the mechanism that a solution has found."""
    return find_closure(equip(plant, solution.problem, solution.trajectory.unknowns))


def _name_independent(closure: Closure) -> str:
    named = ", ".join(closure.manifest.coordinates[i].name for i in closure.independent)
    return f"on the way, the independent joints {named} do not determine the others, as at a dead centre"
