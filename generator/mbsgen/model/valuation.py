"""The values of a model's expressions in doubles, as far as they have any."""

from __future__ import annotations

import math
from collections.abc import Container, Mapping, Sequence

from mpmath import mpf
from sympy import Expr, Symbol

from mbsgen.documents import Finding, Place, abbreviate, lies_under
from mbsgen.expressions import MAX_DEGREE, Expression, ExpressionError, Measure, evaluate, measure, names
from mbsgen.model.model import Parameter, Placement, Triple
from mbsgen.model.symbols import check_powers, exact, round_number, symbolic, to_digits, to_double
from mbsgen.model.tree import Kind

MAX_TERMS = 5000  # of an expression, with all that the parameters in it stand for
LARGEST = 1e150  # products of two numbers do not overflow
SMALLEST = 1e-150  # of an angle; its sine has a square that does not vanish
GENERIC = 0.7390851332151607  # for a run-time parameter that is 0 now, and may be anything later


class Valuation:
    """Values of expressions; an undefined one is nan, with a finding, unless it is doubtful or depends on a doubtful
    one.

    With `generic`, a run-time parameter of value 0 counts as some other number, since its 0 is not structural. A
    constant whose value depends on run-time parameters stands for that expression.
    """

    def __init__(self, parameters: Sequence[Parameter], doubtful: Container[Place], *, generic: bool = False) -> None:
        self.findings: list[Finding] = []
        self.is_complete = True  # every expression so far has a value
        self._doubtful = doubtful
        self._algebra = symbolic({})
        self._values: dict[str, Expr] = {}
        self._broken: set[str] = set()  # parameters without a value
        self._forms: dict[str, Expr] = {}  # of run-time quantities: a symbol, or an expression over symbols
        self._sizes: dict[str, Measure] = {}
        self._later = {parameter.name for parameter in parameters}
        for parameter in parameters:
            self._define(parameter, generic)

    @property
    def names(self) -> frozenset[str]:
        """Return the names of all parameters."""
        return frozenset((*self._values, *self._forms, *self._broken, *self._later))

    def number(self, place: Place, expression: Expression) -> float:
        """Return the value of an expression."""
        value = self._evaluate(place, expression)
        return math.nan if value is None else to_double(value)

    def digits(self, place: Place, expression: Expression) -> mpf:
        """Return the value of an expression in 60 digits; it must have one."""
        value = self._evaluate(place, expression)
        assert value is not None, "a checked model has values"
        return to_digits(value)

    def constant(self, place: Place, expression: Expression) -> float:
        """Return the value of an expression that must not depend on run-time parameters."""
        for name in sorted(names(expression) & self._forms.keys()):
            self._find(place, f"this depends on {abbreviate(name)}, which may change at run time", "use constants here")
            return math.nan
        return self.number(place, expression)

    def placement(self, place: Place, placement: Placement) -> None:
        """Find numbers of a placement that have no value."""
        self.triple((*place, "position"), placement.position)
        for k, rotation in enumerate(placement.orientation):
            angle = self.number((*place, "orientation", k, "angle"), rotation.angle)
            if 0 < abs(angle) < SMALLEST:
                self._find((*place, "orientation", k, "angle"), f"an angle of {angle:g}", "give 0, or a larger one")

    def is_doubtful(self, place: Place) -> bool:
        """Return whether a place has a finding already."""
        return lies_under(place, self._doubtful)

    def form(self, place: Place, expression: Expression, own: Mapping[str, Expr]) -> Expr | None:
        """Return an expression over parameters and other names, given their symbols, as code computes it.

        Return None, with a finding where it is not doubtful, if code cannot compute it.
        """
        if not self._is_known(place, names(expression) - own.keys()):
            return None
        try:
            return self._check_form(expression, own)
        except ExpressionError as error:
            self._find(place, error.finding, error.remedy)
            return None

    def changes(self, expression: Expression) -> bool:
        """Return whether an expression depends on run-time parameters."""
        return not self._forms.keys().isdisjoint(names(expression))

    def triple(self, place: Place, triple: Triple) -> tuple[float, float, float]:
        """Return the values of three expressions."""
        x, y, z = (self.number((*place, k), expression) for k, expression in enumerate(triple))
        return x, y, z

    def _define(self, parameter: Parameter, generic: bool) -> None:
        place = ("parameters", parameter.name)
        changing = sorted(names(parameter.value) & self._forms.keys())
        is_input = parameter.kind is not Kind.CONSTANT
        if changing and is_input:
            finding = f"the value of an input depends on {abbreviate(changing[0])}, which may change at run time"
            self._find(place, finding, f"let it be of kind {Kind.CONSTANT.value}: it follows then")
        value = None if changing and is_input else self._evaluate(place, parameter.value)
        self._later.discard(parameter.name)
        if is_input:
            self._forms[parameter.name] = Symbol(parameter.name)
        if value is None:
            self._broken.add(parameter.name)
        elif changing:
            self._values[parameter.name] = round_number(value)
            self._forms[parameter.name] = evaluate(parameter.value, self._values | self._forms, self._algebra)
            self._sizes[parameter.name] = measure(parameter.value, self._sizes)
        elif generic and is_input and value == 0:
            self._values[parameter.name] = exact(GENERIC)
        else:
            self._values[parameter.name] = round_number(value)

    def _evaluate(self, place: Place, expression: Expression) -> Expr | None:
        value = self._find_value(place, expression)
        self.is_complete &= value is not None
        return value

    def _find_value(self, place: Place, expression: Expression) -> Expr | None:
        needed = names(expression)
        if not self._is_known(place, needed):
            return None
        try:
            value = evaluate(expression, self._values, self._algebra)
            if needed & self._forms.keys():  # then the expression must have a form, beside its present value
                self._check_form(expression, {})
            if abs(to_double(value)) > LARGEST:
                raise ExpressionError(f"a value of {to_double(value):g}", f"stay below {LARGEST:g}")
        except ExpressionError as error:
            self._find(place, error.finding, error.remedy)
            return None
        return value

    def _check_form(self, expression: Expression, own: Mapping[str, Expr]) -> Expr:
        """Return an expression in its inputs, if code can compute it from these. Raises ExpressionError."""
        size = measure(expression, self._sizes)
        if size.terms > MAX_TERMS or size.degree > MAX_DEGREE:
            finding = f"an expression of {size.terms} terms and degree {size.degree}, its parameters written out"
            raise ExpressionError(finding, f"stay below {MAX_TERMS} terms and degree {MAX_DEGREE}")
        form = evaluate(expression, {**self._values, **self._forms, **own}, self._algebra)
        check_powers(form)
        return form

    def _is_known(self, place: Place, needed: frozenset[str]) -> bool:
        """Return whether anything can be concluded about a place that needs these parameters."""
        if lies_under(place, self._doubtful) or needed & self._broken:
            return False
        for name in sorted(needed & self._later):
            self._find(place, f"parameter {abbreviate(name)} is used before it is given", "put it further up")
            return False
        return True

    def _find(self, place: Place, finding: str, remedy: str) -> None:
        self.findings.append(Finding(place, finding, remedy))
