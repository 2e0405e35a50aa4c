"""A program whose numbers follow some numbers of a problem in straight lines: solved and differentiated at many values.

Starts, targets, weights, constants, bounds and held parameters of models enter a program as they are. So its numbers
are the ones of the problem in the middle, plus derivatives times differences; nothing is stated again. Whether that
holds is checked once, by a statement in which all numbers change together.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from mbsrun.ocp.ground.functions import Array
from mbsrun.ocp.ground.status import ACCEPTABLE, SOLVED
from mbsrun.ocp.methods import Instance
from mbsrun.ocp.optima.movement import Movement, Numbers
from mbsrun.ocp.optima.point import find_optimum
from mbsrun.ocp.optima.questions import Answer
from mbsrun.ocp.problem.phases import PhasedProblem
from mbsrun.ocp.solving.judging import Outcome
from mbsrun.ocp.statement.checks import ProblemError

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

    def solve(self, values: Array, x: Array | None = None) -> Member:
        """Solve at values of the numbers, from the solution in the middle, or from another point."""
        start = self.place(values)
        start = start if x is None else replace(start, x=np.clip(x, start.lower, start.upper))
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
