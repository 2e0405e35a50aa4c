"""Functions of OpenSim -> sums over coordinates, each term linear or an expression in one coordinate.

A SimmSpline is a cubic spline; its third derivative at an end is the one of the cubic through the four points there.
Beyond its ends it is linear. A GCVSpline without error variance is the natural spline of its degree. An
expression has its cubic in the middle, and a power of max(x - knot, 0) or
max(knot - x, 0) for the jump of a derivative at each other knot, so it is the same function for all x.

Source: OpenSim's documentation of its classes of functions; Forsythe, Malcolm, Moler, Computer Methods for Mathematical
Computations (1977), section 4.4.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from mpmath import mp, mpf

from mbsgen.documents import abbreviate
from mbsgen.expressions import (
    FLOATS,
    Expression,
    ExpressionError,
    Name,
    Number,
    Operation,
    evaluate,
    names,
    parse,
    substitute,
    write,
)
from mbsgen.importing.closing import X
from mbsgen.importing.findings import MAX_DIGITS, Findings, read_number
from mbsgen.importing.markup import Element
from mbsgen.importing.poses import Array

MAX_KNOTS = 100
_DIGITS = 120  # of a system of powers, which loses many
READ = ("Constant", "LinearFunction", "MultiplierFunction", "PiecewiseLinearFunction", "PolynomialFunction")
SPLINES = ("SimmSpline", "NaturalCubicSpline", "natCubicSpline")  # the last ones are older names of the first
_FORMULA = ("sqrt", "exp", "log", "sin", "cos", "tan", "asin", "acos", "atan", "tanh", "abs", "min", "max")
_CALLS = re.compile(r"([A-Za-z_]\w*)\(")  # of OpenSim's expressions that mean the same here
GCV_SPLINE = "GCVSpline"
FUNCTIONS = (*READ, *SPLINES, GCV_SPLINE, "Sine")


@dataclass(frozen=True)
class Sum:
    """A constant and functions of one coordinate each."""

    constant: float = 0.0
    slopes: Mapping[str, float] = field(default_factory=dict)  # not 0, by coordinate
    curves: tuple[tuple[str, Expression], ...] = ()  # coordinates and expressions over X

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Return the coordinates that it depends on, each once."""
        return tuple(dict.fromkeys([*self.slopes, *(name for name, _ in self.curves)]))

    @property
    def line(self) -> tuple[str, float] | None:
        """Return the coordinate and the slope where it is linear in one coordinate."""
        [*lines] = self.slopes.items()
        return lines[0] if len(lines) == 1 and not self.curves else None

    def scaled(self, factor: float) -> Sum:
        """Return it times a number."""
        if factor == 0:
            return Sum()
        curves = tuple((name, parse_sum([(factor, f"({write(x)})")])) for name, x in self.curves)
        return Sum(factor * self.constant, {name: factor * x for name, x in self.slopes.items()}, curves)

    def hold(self, held: Mapping[str, float]) -> Sum:
        """Return it with the values of some coordinates in its constant."""
        constant = self.constant + sum(slope * held[name] for name, slope in self.slopes.items() if name in held)
        constant += sum(evaluate(x, {X: held[name]}, FLOATS) for name, x in self.curves if name in held)
        slopes = {name: slope for name, slope in self.slopes.items() if name not in held}
        return Sum(constant, slopes, tuple(curve for curve in self.curves if curve[0] not in held))

    def rescale(self, sizes: Mapping[str, float]) -> Sum:
        """Return it over other coordinates, which are a number times its own."""
        slopes = {name: slope / sizes.get(name, 1.0) for name, slope in self.slopes.items()}
        curves = tuple(
            (name, x if sizes.get(name, 1.0) == 1 else substitute(x, {X: _shrink(sizes[name])}))
            for name, x in self.curves
        )
        return replace(self, slopes=slopes, curves=curves)


def _shrink(size: float) -> Expression:
    return Operation("/", Name(X), Number(size))


def write_over(amount: Sum) -> Expression:
    """Write an amount of one coordinate over x."""
    total: Expression = Number(amount.constant)
    for slope in amount.slopes.values():
        total = Operation("+", total, Operation("*", Number(slope), Name(X)))
    for _, curve in amount.curves:
        total = Operation("+", total, curve)
    return total


def read_formula(
    element: Element, meanings: Mapping[str, str], findings: Findings, tag: str = "expression"
) -> Expression | None:
    """Read the <expression> of a force over some names, which stand for others; None with a warning."""
    child = element.first(tag)
    text = "0" if child is None else "".join(child.text.split())
    unknown = sorted({*_CALLS.findall(text)} - {*_FORMULA})
    try:
        if unknown:
            raise ExpressionError(f"{unknown[0][:40]}() is not read", "")
        found = parse(text.replace("^", "**"))
        strange = sorted(names(found) - {*meanings})
        if strange:
            raise ExpressionError(f"{strange[0][:40]} is none of {', '.join(meanings)}", "")
    except ExpressionError as error:
        findings.warn(element, f"its expression is not read, since {error.finding}: its force is left out")
        return None
    return substitute(found, {key: Name(x) for key, x in meanings.items()})


def find_function(parent: Element) -> Element | None:
    """Return the function of an element: of version 4 beside its other parts, before that in <function>."""
    inner = parent.first("function")
    within = parent if inner is None or inner.children == () else inner
    known = [child for child in within.children if child.tag not in ("coordinates", "axis", "function", "scale")]
    return known[0] if known else None


def read_function(element: Element, coordinates: Sequence[str], findings: Findings) -> Sum:
    """Read a function of some coordinates; a fault where it is none that is read."""
    return _Function(element, coordinates, findings).read()


@dataclass(frozen=True)
class _Function:
    """A function during reading."""

    element: Element
    coordinates: Sequence[str]
    findings: Findings

    def read(self) -> Sum:
        readers: dict[str, Callable[[], Sum]] = {
            "Constant": lambda: Sum(self._number("value", 0.0)),
            "LinearFunction": self._read_line,
            "MultiplierFunction": self._read_product,
            "PiecewiseLinearFunction": lambda: self._read_points(write_polygon),
            "PolynomialFunction": self._read_polynomial,
            "Sine": self._read_sine,
            GCV_SPLINE: self._read_natural,
            **dict.fromkeys(SPLINES, lambda: self._read_points(write_spline)),
        }
        tag = self.element.tag
        if tag not in readers:
            text = f"a function of the kind {abbreviate(tag)}, which is not read"
            self.findings.fault(self.element, text, f"give {', '.join(FUNCTIONS[:-1])} or {FUNCTIONS[-1]}")
            return Sum()
        return readers[tag]()

    def _read_line(self) -> Sum:
        values = self._list("coefficients")
        if len(values) != len(self.coordinates) + 1:
            remedy = f"give {len(self.coordinates) + 1}: a slope for each coordinate, and the value at 0"
            self.findings.fault(self.element, f"{len(values)} coefficients", remedy)
            return Sum()
        slopes = dict.fromkeys(self.coordinates, 0.0)
        for name, slope in zip(self.coordinates, values, strict=False):
            slopes[name] += slope
        return Sum(values[-1], {name: slope for name, slope in slopes.items() if slope})

    def _read_product(self) -> Sum:
        inner = find_function(self.element)
        if inner is None:
            self.findings.fault(self.element, "a MultiplierFunction of no function", "give it a function")
            return Sum()
        return read_function(inner, self.coordinates, self.findings).scaled(self._number("scale", 1.0))

    def _read_polynomial(self) -> Sum:
        """Read coefficients, of the highest power first."""
        values = self._list("coefficients")
        name = self._find_only()
        if name is None or not values:
            if not values:
                self.findings.fault(self.element, "a polynomial without coefficients", "give one at least")
            return Sum()
        *high, constant = values
        slope = high[-1] if high else 0.0
        powers = [(value, f"x**{len(high) - k}") for k, value in enumerate(high[:-1]) if value]
        if len(high) > 16:
            self.findings.fault(self.element, f"a polynomial of degree {len(high)}", "give 16 at most")
            return Sum()
        slopes = {name: slope} if slope and not powers else {}
        terms = [*powers, *([(slope, "x")] if slope else [])]
        return Sum(constant, slopes, ((name, parse_sum(terms)),) if powers else ())

    def _read_sine(self) -> Sum:
        name = self._find_only()
        amplitude, omega, phase, offset = (
            self._number(tag, value) for tag, value in (("amplitude", 1), ("omega", 1), ("phase", 0), ("offset", 0))
        )
        if name is None:
            return Sum()
        angle = write_shift(f"{write_number(omega)}*x", -phase)
        return Sum(offset, curves=((name, parse_sum([(amplitude, f"sin({angle})")])),))

    def _read_points(self, draw: Callable[[Array, Array], Expression]) -> Sum:
        before = len(self.findings.faults)
        x, y = (np.array(self._list(tag)) for tag in "xy")
        name = self._find_only()
        if len(self.findings.faults) > before:
            return Sum()
        if (finding := _find_flaw(x, y)) is not None:
            self.findings.fault(self.element, *finding)
            return Sum()
        if name is None:
            return Sum()
        if len(set(y)) == 1:
            return Sum(float(y[0]))
        steps = np.diff(y) / np.diff(x)
        if len(set(steps)) == 1:
            return Sum(float(y[0] - steps[0] * x[0]), {name: float(steps[0])})
        return Sum(curves=((name, draw(x, y)),))

    def _read_natural(self) -> Sum:
        """Read a GCVSpline through its points."""
        order, variance = self._number("half_order", 3.0), self._number("error_variance", 0.0)
        if order not in range(1, 5):
            self.findings.fault(self.element, f"half_order is {order:g}", "give 1, 2, 3 or 4")
            return Sum()
        if variance != 0:
            self.findings.fault(self.element, f"error_variance is {variance:g}", "give 0: a curve through the points")
            return Sum()
        points = len(self._list("x"))
        if points < 2 * order:
            self.findings.fault(self.element, f"{points} points", f"give {2 * order:g} at least")
            return Sum()
        return self._read_points(lambda x, y: write_natural(x, y, int(order)))

    def _find_only(self) -> str | None:
        if len(self.coordinates) == 1:
            return self.coordinates[0]
        text = f"a {self.element.tag} of {len(self.coordinates)} coordinates"
        self.findings.fault(self.element, text, "name one coordinate")
        return None

    def _number(self, tag: str, default: float) -> float:
        child = self.element.first(tag)
        return default if child is None else self.findings.number(child, tag, default, {tag: child.text})

    def _list(self, tag: str) -> list[float]:
        child = self.element.first(tag)
        words = [] if child is None else child.text.split()
        values = [read_number(word) for word in words]
        for word, value in zip(words, values, strict=True):
            if math.isnan(value):
                shown = abbreviate(word[:MAX_DIGITS])
                self.findings.fault(child or self.element, f"{tag} has {shown}", "give numbers such as 0.3 or 1e-3")
                return []
        return values


def _find_flaw(x: Array, y: Array) -> tuple[str, str] | None:
    """Return a finding on points and its remedy."""
    if len(x) != len(y):
        return f"{len(x)} values of x, and {len(y)} of y", "give as many of each"
    if not 2 <= len(x) <= MAX_KNOTS:
        return f"{len(x)} points", f"give 2 to {MAX_KNOTS}"
    late = np.flatnonzero(np.diff(x) <= 0)
    if late.size:
        k = int(late[0]) + 1
        how = "repeats" if x[k] == x[k - 1] else "comes after"
        other = "the one before it" if x[k] == x[k - 1] else f"{x[k - 1]:g}"
        return f"x[{k}] = {x[k]:g} {how} {other}", "give values of x that increase"
    return None


# --- expressions -----------------------------------------------------------------------------------------------------


def find_cubics(x: Array, y: Array) -> tuple[Array, Array, Array]:
    """Return b, c, d of the cubics y + b h + c h**2 + d h**3 of a SimmSpline, with h = x - knot: c of each knot."""
    n, h = len(x), np.diff(x)
    slopes = np.asarray(np.diff(y) / h, np.float64)
    A, right = np.zeros((n, n)), np.zeros(n)
    for k in range(1, n - 1):
        A[k, k - 1 : k + 2] = h[k - 1], 2 * (h[k - 1] + h[k]), h[k]
        right[k] = 3 * (slopes[k] - slopes[k - 1])
    for row, (k, points) in {0: (0, slice(0, 4)), n - 1: (n - 2, slice(n - 4, n))}.items():
        A[row, k : k + 2] = -1 / (3 * h[k]), 1 / (3 * h[k])
        right[row] = _divide(x[points], y[points]) if n > 3 else 0.0
    c = np.asarray(np.linalg.solve(A, right), np.float64)
    d = np.asarray(np.diff(c) / (3 * h), np.float64)
    b = slopes - h * (2 * c[:-1] + c[1:]) / 3
    return np.asarray(b, np.float64), c, d


def _divide(x: Array, y: Array) -> float:
    """Return the divided difference of all points."""
    for step in range(1, len(x)):
        y = np.diff(y) / (x[step:] - x[:-step])
    return float(y[0])


def write_spline(x: Array, y: Array) -> Expression:
    """Write a SimmSpline."""
    b, c, d = find_cubics(x, y)
    m = (len(x) - 1) // 2
    start, end = _before(x[0]), _beyond(x[-1])
    terms = [(y[m], ""), (b[m], _shift(x[m])), (c[m], f"{_shift(x[m])}**2"), (d[m], f"{_shift(x[m])}**3")]
    terms += [(d[k] - d[k - 1], f"{_beyond(x[k])}**3") for k in range(m + 1, len(d))]
    terms += [(-d[-1], f"{end}**3"), (-c[-1], f"{end}**2")]
    terms += [(d[k] - d[k - 1], f"{_before(x[k])}**3") for k in range(1, m + 1)]
    terms += [(d[0], f"{start}**3"), (-c[0], f"{start}**2")]
    return parse_sum(terms)


def write_natural(x: Array, y: Array, order: int) -> Expression:
    """Write a natural spline of degree 2 order - 1; beyond its ends it is a polynomial of degree order - 1."""
    n, degree, middle = len(x), 2 * order - 1, len(x) // 2
    with mp.workdps(_DIGITS):
        knots, values = ([mpf(float(v)) for v in row] for row in (x, y))
        shifted = [k - knots[middle] for k in knots]
        A, right = mp.zeros(n + order), mp.zeros(n + order, 1)
        for i, place in enumerate(shifted):  # a polynomial, and jumps of the last derivative, whose moments vanish
            right[i] = values[i]
            for k in range(order):
                A[i, k] = A[n + k, order + i] = place**k
            for k, knot in enumerate(shifted):
                A[i, order + k] = max(place - knot, 0) ** degree
        found = mp.lu_solve(A, right)
        smooth, jumps = [found[k] for k in range(order)], [found[order + k] for k in range(n)]
        powers = smooth + [mpf(0)] * (degree + 1 - order)
        for jump, knot in zip(jumps[: middle + 1], shifted, strict=False):  # (h - knot)^degree about the middle
            for k in range(degree + 1):
                powers[k] += jump * mp.binomial(degree, k) * (-knot) ** (degree - k)
        terms = [(float(powers[0]), "")]
        terms += [(float(powers[k]), f"{_shift(x[middle])}**{k}") for k in range(1, degree + 1)]
        ends = [_before(x[k]) if k <= middle else _beyond(x[k]) for k in range(n)]
        terms += [(float(jump), f"{end}**{degree}") for jump, end in zip(jumps, ends, strict=True)]
    return parse_sum(terms)


def write_polygon(x: Array, y: Array) -> Expression:
    """Write straight lines between points, which go on beyond the ends."""
    slopes = np.diff(y) / np.diff(x)
    jumps = [(slopes[k] - slopes[k - 1], _beyond(x[k])) for k in range(1, len(slopes))]
    return parse_sum([(y[0], ""), (slopes[0], _shift(x[0])), *jumps])


def parse_sum(terms: Sequence[tuple[float, str]]) -> Expression:
    """Parse a sum of coefficients times texts; an empty text is 1."""
    return parse("".join(_join(terms)) or "0")


def _join(terms: Sequence[tuple[float, str]]) -> Iterator[str]:
    is_first = True
    for coefficient, text in terms:
        if coefficient == 0:
            continue
        sign = _sign(coefficient)
        yield ("-" if sign == "-" else "") if is_first else f" {sign} "
        size = abs(float(coefficient))
        yield "*".join([*([write_number(size)] if size != 1 or not text else []), *([text] if text else [])])
        is_first = False


def write_shift(text: str, start: float) -> str:
    """Write a text less a number."""
    return f"{text} {_sign(-start)} {write_number(abs(start))}" if start else text


def _shift(knot: float) -> str:
    return f"({write_shift('x', knot)})" if knot else "x"


def _beyond(knot: float) -> str:
    return f"max({write_shift('x', knot)}, 0)"


def _before(knot: float) -> str:
    return f"max({write_number(knot)} - x, 0)" if knot else "max(-x, 0)"


def _sign(value: float) -> str:
    return "-" if value < 0 else "+"


def write_number(value: float) -> str:
    """Write a number so that it is read as the same double."""
    return repr(float(value))
