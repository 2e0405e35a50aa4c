"""Absolute values and maxima in the cost, as controls and numbers that bound them: the solver meets no kink.

    w |g|         ->   w s  with  g - s <= 0,  g + s >= 0,    w > 0
    w max(g, h)   ->   w s  with  g - s <= 0,  h - s <= 0

At an optimum s is the value itself. In a term of the end, s is a number. In a running term it is a control, constant
over an interval; so g and h may read only what is constant there, too: inputs, controls, unknowns and constants.

Source: Boyd, Vandenberghe, "Convex optimization", 2004, section 4.1.3 (epigraph form).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

from mbsgen.expressions import (
    FLOATS,
    Call,
    Expression,
    ExpressionError,
    Name,
    Negation,
    Operation,
    evaluate,
    names,
    parse,
    write,
)
from mbsrun.ocp.problem.problem import Constraint, Control, Problem, Range, Term, Unknown

NAMES = {"abs": "absolute", "max": "larger"}  # what bounds are called
FREE: Range = (-math.inf, math.inf)
Rename = Callable[[str, str], str]  # from "controls" or "unknowns", and a usual name, to one that is free


def bound_kinks(problem: Problem, constants: Mapping[str, float], constant: Sequence[str], rename: Rename) -> Problem:
    """Bound the absolute values and maxima of the cost; names of `constant` are constant over an interval."""
    cost = problem.cost
    of_path = _Bounds("controls", constants, rename, frozenset((*constants, *constant)))
    of_end = _Bounds("unknowns", constants, rename)
    running = tuple(of_path.rewrite(term) for term in cost.running)
    terminal = tuple(of_end.rewrite(term) for term in cost.terminal)
    if not of_path.found and not of_end.found:
        return problem
    controls = (Control(name, _find_range(call), bounds_from_above=write(call)) for call, name in of_path.found.items())
    unknowns = (Unknown(name, _find_range(call)) for call, name in of_end.found.items())
    rows = [
        Constraint(text, limits, "path" if bounds is of_path else "end", name=f"the bound of {write(call)}")
        for bounds in (of_path, of_end)
        for call, name in bounds.found.items()
        for text, limits in _list_rows(call, name)
    ]
    return replace(
        problem,
        cost=replace(cost, running=running, terminal=terminal),
        controls=(*problem.controls, *controls),
        unknowns=(*problem.unknowns, *unknowns),
        constraints=(*problem.constraints, *rows),
    )


@dataclass
class _Bounds:
    """Names the bounds of absolute values and maxima, each once."""

    role: str
    constants: Mapping[str, float]
    rename: Rename
    readable: frozenset[str] | None = None  # the names that they may read; None: all
    found: dict[Call, str] = field(default_factory=dict)

    def rewrite(self, term: Term) -> Term:
        """Return a term with bounds in place of absolute values and maxima that add to it."""
        old = parse(term.expression)
        new = self._replace(old, term.weight)
        return term if new == old else replace(term, expression=write(new), name=term.title)

    def _replace(self, expression: Expression, weight: float) -> Expression:
        """Rewrite a summand that is multiplied by a number of the weight's sign."""
        match expression:
            case Negation(operand):
                return Negation(self._replace(operand, -weight))
            case Operation("+" | "-" as symbol, left, right):
                sign = 1 if symbol == "+" else -1
                return Operation(symbol, self._replace(left, weight), self._replace(right, sign * weight))
            case Operation("*", left, right) if (factor := self._compute(left)) is not None:
                return replace(expression, right=self._replace(right, factor * weight))
            case Operation("*" | "/", left, right) if (factor := self._compute(right)) is not None:
                return replace(expression, left=self._replace(left, factor * weight))
            case Call("abs" | "max") if weight > 0 and self._may_read(expression):
                return Name(self._name(expression))
        return expression

    def _compute(self, factor: Expression) -> float | None:
        """Compute a factor of constants; None for another one."""
        try:
            return evaluate(factor, self.constants, FLOATS)
        except ExpressionError:
            return None

    def _may_read(self, call: Call) -> bool:
        read = names(call)
        return not read <= self.constants.keys() and (self.readable is None or read <= self.readable)

    def _name(self, call: Call) -> str:
        if call not in self.found:
            self.found[call] = self.rename(self.role, f"{NAMES[call.function]}_{len(self.found)}")
        return self.found[call]


def _find_range(call: Call) -> Range:
    return (0.0, math.inf) if call.function == "abs" else FREE


def _list_rows(call: Call, name: str) -> list[tuple[str, Range]]:
    """List the expressions, and their ranges, by which a name bounds a call from above."""
    first, *others = [f"({write(argument)})" for argument in call.arguments]
    above = [(f"{text} - {name}", (-math.inf, 0.0)) for text in (first, *others)]
    return [*above, (f"{first} + {name}", (0.0, math.inf))] if call.function == "abs" else above
