"""Expressions in CasADi of a problem's quantities, as terms of its cost and as constraints."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from mbsrun.ocp.problem.problem import Constraint, Problem, Range, Symbolic, Term
from mbsrun.ocp.statement.checks import ProblemError
from mbsrun.optimal.quantities import make_functions

Stretch = Literal["path", "end"]


@dataclass(frozen=True)
class PricedExpression:
    """A term of the cost in CasADi."""

    function: Symbolic
    weight: float
    at: Stretch


@dataclass(frozen=True)
class LimitedExpression:
    """A constraint in CasADi."""

    function: Symbolic
    range: Range
    at: Literal["start", "path", "end"]


@dataclass(frozen=True)
class Expressions:
    """The expressions of one problem."""

    terms: tuple[PricedExpression, ...] = ()  # of the cost
    limits: tuple[LimitedExpression, ...] = ()  # constraints

    @property
    def functions(self) -> tuple[Symbolic, ...]:
        """List the expressions as functions."""
        return (*(part.function for part in self.terms), *(part.function for part in self.limits))

    @property
    def reads(self) -> frozenset[str]:
        """Return the names that the expressions read."""
        return frozenset(name for function in self.functions for name in function.reads)

    def name(self, kind: str) -> str:
        """Return a name for the next expression of a kind."""
        return f"{kind}_{1 + sum(function.name.startswith(f'{kind}_') for function in self.functions)}"

    def with_cost(self, expression: Any, weight: Any, at: Stretch, name: str, problem: str) -> Expressions:
        """Add a term of the cost. Raises ProblemError."""
        found = make_functions(name or self.name("cost"), expression, problem)
        if len(found) != 1:
            raise ProblemError(problem, [("cost", f"an expression of {len(found)} entries", "give a scalar")])
        try:
            term = PricedExpression(found[0], float(weight), at)
        except (TypeError, ValueError):
            raise ProblemError(problem, [("cost", f"the weight is {weight!r}", "give a number")]) from None
        return replace(self, terms=(*self.terms, term))

    def with_constraint(
        self, expression: Any, lower: Any, upper: Any, at: Literal["start", "path", "end"], name: str, problem: str
    ) -> Expressions:
        """Add a constraint for each entry of an expression. Raises ProblemError."""
        found = make_functions(name or self.name("constraint"), expression, problem)
        try:
            ranges = np.broadcast_arrays(np.zeros(len(found)), np.ravel(lower), np.ravel(upper))[1:]
            least, most = (np.asarray(values, dtype=np.float64).tolist() for values in ranges)
        except (TypeError, ValueError):
            finding = f"{len(found)} entries, with the limits {lower} and {upper}"
            raise ProblemError(problem, [("constraint", finding, "give a number, or one for each entry")]) from None
        parts = zip(found, zip(least, most, strict=True), strict=True)
        return replace(self, limits=(*self.limits, *(LimitedExpression(f, limits, at) for f, limits in parts)))

    def extend(self, value: Problem, *, prices_inputs: bool) -> Problem:
        """Add the expressions to a problem; beside their terms, inputs cost nothing unless a weight is given."""
        running, terminal = (
            tuple(Term(part.function.name, part.weight) for part in self.terms if part.at == at)
            for at in ("path", "end")
        )
        cost = value.cost
        if self.terms and not prices_inputs:
            cost = replace(cost, inputs=0.0)
        constraints = (Constraint(part.function.name, part.range, part.at) for part in self.limits)
        return replace(
            value,
            functions=self.functions,
            cost=replace(cost, running=cost.running + running, terminal=cost.terminal + terminal),
            constraints=(*value.constraints, *constraints),
        )


def check_stretch(at: str, problem: str) -> None:
    """Raise ProblemError for a cost that is neither along the path nor at the end."""
    if at not in ("path", "end"):
        raise ProblemError(problem, [("cost", f"at {at!r}", "give 'path' or 'end'")])
