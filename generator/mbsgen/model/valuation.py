"""The values of a model's expressions in doubles, as far as they have any."""

from __future__ import annotations

import math
from collections.abc import Container, Sequence

import numpy as np
from numpy.typing import NDArray
from sympy import Expr, Symbol

from mbsgen.documents import Place, abbreviate, lies_under
from mbsgen.expressions import Expression, ExpressionError, evaluate, names
from mbsgen.model import model
from mbsgen.model.findings import Finding
from mbsgen.model.model import Parameter, Triple
from mbsgen.model.symbols import check_powers, exact, round_number, symbolic, to_double
from mbsgen.model.tree import COORDINATE, RATE, Kind

LARGEST = 1e150  # products of two numbers do not overflow
GENERIC = 0.7390851332151607  # for a run-time parameter that is 0 now, and may be anything later

Array = NDArray[np.float64]


class Valuation:
    """Values of expressions; what has none is nan, and a finding, but for what is doubtful or rests on it.

    With `generic`, a run-time parameter of value 0 counts as some other number, since its 0 is not structural.
    """

    def __init__(self, parameters: Sequence[Parameter], doubtful: Container[Place], *, generic: bool = False) -> None:
        self.findings: list[Finding] = []
        self._doubtful = doubtful
        self._algebra = symbolic({})
        self._values: dict[str, Expr] = {}
        self._broken: set[str] = set()  # parameters without a value
        self._variable: set[str] = set()
        self._later = {parameter.name for parameter in parameters}
        for parameter in parameters:
            self._define(parameter, generic)

    def number(self, place: Place, expression: Expression) -> float:
        """Give an expression its value."""
        value = self._evaluate(place, expression)
        return math.nan if value is None else to_double(value)

    def constant(self, place: Place, expression: Expression) -> float:
        """Give an expression its value, which is not to change at run time."""
        for name in sorted(names(expression) & self._variable):
            self._find(place, f"this depends on the run-time parameter {abbreviate(name)}", "use constants here")
            return math.nan
        return self.number(place, expression)

    def check_law(self, place: Place, law: Expression) -> None:
        """Find what keeps an expression over parameters, q and qd from being computed."""
        values = {name: value for name, value in self._values.items() if name not in self._variable}
        own = {name: Symbol(name) for name in self._variable} | {model.COORDINATE: COORDINATE, model.RATE: RATE}
        needed = names(law) - {model.COORDINATE, model.RATE}
        if not self._is_known(place, needed):
            return
        try:
            check_powers(evaluate(law, values | own, self._algebra))
        except ExpressionError as error:
            self._find(place, error.finding, error.remedy)

    def changes(self, expression: Expression) -> bool:
        """Tell whether an expression depends on run-time parameters."""
        return not self._variable.isdisjoint(names(expression))

    def triple(self, place: Place, triple: Triple) -> Array:
        """Give three expressions their values."""
        return np.array([self.number((*place, k), expression) for k, expression in enumerate(triple)])

    def _define(self, parameter: Parameter, generic: bool) -> None:
        place = ("parameters", parameter.name)
        changing = sorted(names(parameter.value) & self._variable)
        for name in changing:
            finding = f"its value depends on the run-time parameter {abbreviate(name)}"
            self._find(place, finding, "write the expression where it is used, or make that parameter constant")
        value = None if changing else self._evaluate(place, parameter.value)
        self._later.discard(parameter.name)
        if parameter.kind is not Kind.CONSTANT:
            self._variable.add(parameter.name)
        if value is None:
            self._broken.add(parameter.name)
        elif generic and parameter.kind is not Kind.CONSTANT and value == 0:
            self._values[parameter.name] = exact(GENERIC)
        else:
            self._values[parameter.name] = round_number(value)

    def _evaluate(self, place: Place, expression: Expression) -> Expr | None:
        needed = names(expression)
        if not self._is_known(place, needed):
            return None
        try:
            value = evaluate(expression, self._values, self._algebra)
            if needed & self._variable:  # then the expression must have a form, beside its present value
                symbols = {name: Symbol(name) for name in self._variable}
                check_powers(evaluate(expression, self._values | symbols, self._algebra))
            if abs(to_double(value)) > LARGEST:
                raise ExpressionError(f"a value of {to_double(value):g}", f"stay below {LARGEST:g}")
        except ExpressionError as error:
            self._find(place, error.finding, error.remedy)
            return None
        return value

    def _is_known(self, place: Place, needed: frozenset[str]) -> bool:
        """Tell whether something can be concluded of a place that needs these parameters."""
        if lies_under(place, self._doubtful) or needed & self._broken:
            return False
        for name in sorted(needed & self._later):
            self._find(place, f"parameter {abbreviate(name)} is used before it is given", "put it further up")
            return False
        return True

    def _find(self, place: Place, finding: str, remedy: str) -> None:
        self.findings.append(Finding(place, finding, remedy))
