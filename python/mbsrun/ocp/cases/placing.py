"""Cases that differ in numbers alone: numbers of a case -> numbers of its program, without its statement.

Starts, targets and constants enter a program as they are. Where they do, is read off from stated cases of the same
kind: the ones at both ends of each number's range, and some between. Each number of the program that differs among
these has to be a number of the case in all of them. All checks of a statement that read such a number ask for a range
of it, so what holds at both ends holds between. Numbers for which there is more to it are not placed: 0, limits of
joints, parts of quaternions, and numbers of loops, of driven joints and of contacts.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mbsrun.ocp.ground.functions import Array, Indices
from mbsrun.ocp.methods import Instance
from mbsrun.ocp.problem.phases import PhasedProblem, Plants
from mbsrun.ocp.solution.solution import Failure
from mbsrun.ocp.solving.nearby import can_stack
from mbsrun.ocp.solving.phases import Make, Neighbour, PhasedSolver, prepare_near

KEYS = ("constants", "end", "start")  # of a problem, whose numbers may be placed
STRIDE = 16  # of the cases between, each that many-th is stated

Parts = tuple[Array, Array, Array, Array, Array]  # parameters, bounds of variables, ranges of rows


def choose_stated(numbers: Array) -> list[int]:
    """Return which cases of a kind are stated, by their numbers (cases, n): at the ends of each range, and between."""
    ends = [int(find(column)) for column in numbers.T for find in (np.argmin, np.argmax)]
    return sorted({*ends, *range(STRIDE // 2, len(numbers), STRIDE)})


def find_special(numbers: Array, limits: frozenset[float]) -> list[int]:
    """Return the cases with numbers that may be treated apart: limits of joints, and 0."""
    return np.flatnonzero(np.isin(numbers, [0.0, *sorted(limits)]).any(axis=1)).tolist()


def list_limits(problem: PhasedProblem) -> frozenset[float]:
    """Return the limits of coordinates and velocities."""
    found = {
        x for phase in problem.phases for limits in (phase.problem.bounds.q, phase.problem.bounds.qd) for x in limits
    }
    return frozenset(float(x) for limits in found for x in limits if math.isfinite(x))


def is_plain(problem: PhasedProblem) -> bool:
    """Return whether all numbers of starts and ends stand alone."""
    own = [phase.problem for phase in problem.phases]
    is_open = not any(x.contacts or x.touching or x.modes or x.driven or x.has_quaternions for x in own)
    return is_open and len(own) == 1 and not problem.links


@dataclass(frozen=True, eq=False)
class Placing:
    """Where the numbers of cases are in a program."""

    solver: PhasedSolver
    problem: PhasedProblem  # one of the stated cases
    parts: Parts  # the numbers of its program
    places: tuple[tuple[Indices, Indices], ...]  # in each part: entries, and the numbers of cases that they are

    def place(self, numbers: Array, own: Sequence[Neighbour], most_iterations: Sequence[int]) -> list[Instance]:
        """Return the numbers of solves near solutions, for numbers of cases (cases, n)."""
        parts = [np.repeat(part[None], len(numbers), axis=0) for part in self.parts]
        for part, (entries, given) in zip(parts, self.places, strict=True):
            part[:, entries] = numbers[:, given]
        rows = zip(own, *parts, most_iterations, strict=True)
        return [
            Instance(x.x, p, lower, upper, least, largest, None, x.scales, x.cost_scale, None, most)
            for x, p, lower, upper, least, largest, most in rows
        ]


def find_placing(
    problems: Sequence[PhasedProblem], numbers: Array, own: Neighbour, plants: Plants, make: Make = PhasedSolver
) -> Placing | None:
    """Find where the numbers of stated cases (cases, n) are; None where they are not as they are in their program.

    Raises ProblemError.
    """
    solver: PhasedSolver | None = None
    rows: list[Parts] = []
    first = problems[0]
    for problem in problems:
        ready = prepare_near(problem, plants, own, make)
        if isinstance(ready, Failure) or not can_stack(ready.solver) or solver not in (None, ready.solver):
            return None
        found = ready.solver.number_near(ready.problem, own, 0)
        if found is None or ready.solver.choose_method(found[0]) != ready.solver.choose_method(first):
            return None
        solver, instance = ready.solver, found[1]
        first = found[0] if not rows else first
        rows.append((instance.parameters, instance.lower, instance.upper, instance.g_lower, instance.g_upper))
    assert solver is not None, "there is a case"
    parts = [np.stack(part) for part in zip(*rows, strict=True)]
    places = [_match(part, numbers) for part in parts]
    known = [place for place in places if place is not None]
    return Placing(solver, first, rows[0], tuple(known)) if len(known) == len(places) else None


def _match(part: Array, numbers: Array) -> tuple[Indices, Indices] | None:
    """Return the entries of a part (cases, size) that differ, and the numbers that they are; None: one is no number."""
    entries = np.flatnonzero((part != part[0]).any(axis=0))
    same = (part[:, entries, None] == numbers[:, None, :]).all(axis=0)
    return (entries, same.argmax(axis=1)) if bool(same.any(axis=1).all()) else None


def crosses(instance: Instance) -> bool:
    """Return whether bounds cross."""
    return bool((instance.lower > instance.upper).any() or (instance.g_lower > instance.g_upper).any())
