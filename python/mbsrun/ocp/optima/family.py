"""A program whose numbers follow some numbers of a problem in straight lines: solved and differentiated at many values.

Starts, targets, weights, constants, bounds and held parameters of models enter a program as they are. So its numbers
are the ones of the problem in the middle, plus derivatives times differences; nothing is stated again. Whether that
holds is checked once, by a statement in which all numbers change together.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from mbsrun.ocp.ground.functions import Array
from mbsrun.ocp.ground.status import ACCEPTABLE, INVALID, SOLVED
from mbsrun.ocp.methods import METHODS, Instance, Near, choose
from mbsrun.ocp.optima.movement import Movement, Numbers
from mbsrun.ocp.optima.point import find_optimum
from mbsrun.ocp.optima.questions import Answer
from mbsrun.ocp.problem.phases import PhasedProblem
from mbsrun.ocp.solution.solution import Run
from mbsrun.ocp.solving.judging import Outcome
from mbsrun.ocp.statement.checks import ProblemError

FEWEST = 20  # iterations of a start with multipliers, at least, before the motion alone is tried
STRAIGHT = 1e-9  # of a number of the program, over its size


@dataclass(frozen=True, eq=False)
class Member:
    """A solve at values of the numbers."""

    outcome: Outcome
    instance: Instance

    @property
    def is_solved(self) -> bool:
        """Return whether the method calls it solved, and all numbers are finite."""
        return self.outcome.run.status in (SOLVED, ACCEPTABLE) and bool(np.isfinite(self.outcome.x).all())


@dataclass(frozen=True, eq=False)
class Family:
    """Problems that differ in some numbers; `answer` is of the one in the middle."""

    answer: Answer

    @property
    def values(self) -> Array:
        """Return the values of the numbers in the middle."""
        return np.array([number.value for number in self.answer.numbers])

    def place(self, values: Array) -> Instance:
        """Return the numbers of the program, and the solution in the middle as the point to start from."""
        middle, changes = self.answer.movement.optimum.instance, self.answer.movement.changes
        parts: list[Array] = [middle.parameters, middle.lower, middle.upper, middle.g_lower, middle.g_upper]
        for change, difference in zip(changes, values - self.values, strict=True):
            if change is not None and difference != 0:
                parts = [part + difference * slope for part, slope in zip(parts, change.parts, strict=True)]
        parameters, lower, upper, least, most = parts
        x = np.clip(self.answer.movement.optimum.x, lower, upper)
        return replace(middle, x=x, parameters=parameters, lower=lower, upper=upper, g_lower=least, g_upper=most)

    def solve(self, values: Array) -> Member:
        """Solve at values of the numbers, from the solution in the middle; values that are not finite have no solve.

        With all multipliers, the first step of Newton's method is the tangential prediction; where that has no
        solution soon, the motion alone is the start. The result depends on the values alone.
        """
        if not np.isfinite(values).all():
            nowhere = self.place(self.values)
            return Member(Outcome(Run(INVALID, 0, 0.0, 0.0), nowhere.x, (), None, nowhere), nowhere)
        start = self.place(values)
        if self._near is not None:
            known = replace(start, near=self._near, most_iterations=self._most_iterations)
            member = Member(self.answer.solver.run(self.answer.problem, known), start)
            if member.is_solved:
                return member
        return Member(self.answer.solver.run(self.answer.problem, start), start)

    def solve_all(self, rows: Sequence[Array], threads: int) -> list[Member]:
        """Solve at several vectors of values, on several threads where the method calls no Python."""
        solver, problem = self.answer.solver, self.answer.problem
        if threads == 1 or METHODS[choose(solver.choose_method(problem))].calls_casadi:
            return [self.solve(row) for row in rows]
        _ = self._near  # found before threads ask for it
        with ThreadPoolExecutor(threads) as pool:
            return list(pool.map(self.solve, rows))

    @property
    def _near(self) -> Near | None:
        return self._middle.outcome.near if self._middle.is_solved else None

    @property
    def _most_iterations(self) -> int:
        return max(FEWEST, self._middle.outcome.run.iterations)

    @cached_property
    def _middle(self) -> Member:
        """The solve in the middle again, whose end solves nearby start from."""
        start = self.place(self.values)
        return Member(self.answer.solver.run(self.answer.problem, start), start)

    def differentiate(self, member: Member) -> Movement:
        """Return how the solution of a member moves with the numbers."""
        before, outcome = self.answer.movement, member.outcome
        program, scale = self.answer.solver.program, before.optimum.scale
        lam = outcome.multipliers
        assert lam is not None, "all methods return multipliers"
        start = replace(member.instance, x=outcome.x)
        optimum = find_optimum(program.numpy, program.data, start, scale, (outcome.x, lam))
        return replace(before, optimum=optimum)


def make_family(answer: Answer, state: Callable[[Sequence[float]], PhasedProblem]) -> Family:
    """Make a family; `state` states the problem with values of all numbers.

    Raises ProblemError where the numbers of the program do not follow them in straight lines.
    """
    family, name = Family(answer), answer.problem.name
    for number, change in zip(answer.numbers, answer.movement.changes, strict=True):
        if change is None:
            remedy = "move both limits by one constant"
            raise ProblemError(name, [(number.name, "it moves one limit of an equality", remedy)])
    values = [number.value + number.step * (2 + k % 3) for k, number in enumerate(answer.numbers)]
    stated, placed = answer.count(state(values)), family.place(np.array(values))
    own = Numbers(placed.parameters, placed.lower, placed.upper, placed.g_lower, placed.g_upper)
    for one, other in zip(own.parts, stated.parts, strict=True):
        if not np.allclose(one, other, rtol=STRAIGHT, atol=STRAIGHT):
            names = ", ".join(number.name for number in answer.numbers)
            finding = "the numbers of the program do not follow them in straight lines"
            raise ProblemError(name, [(names, finding, "leave out angles of targets, and products of constants")])
    return family
