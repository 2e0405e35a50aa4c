"""Trigonometric sums: sum of c * product of powers of variables * (1, cos(a) or sin(a)), a = sum of n_i q_i.

Products of sines and cosines become sums of them,

    2 cos a cos b = cos(a - b) + cos(a + b),   2 sin a sin b = cos(a - b) - cos(a + b),
    2 sin a cos b = sin(a + b) + sin(a - b),

so the form is unique: zeros vanish, and sin(q)^2 + cos(q)^2 is 1. Other functions, as tanh(qd) or 1/(l - x), count as
variables, which are SymPy expressions.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from contextvars import ContextVar
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from typing import Self

import sympy as sp
from mpmath import mpf

from mbsgen.errors import MbsError
from mbsgen.tape.interpreter import Numbers
from mbsgen.tape.types import LITERALS, Op

LARGEST = 20_000  # terms of one sum
MOST = ContextVar("MOST", default=LARGEST)  # the same, for one derivation
ROUNDING = mpf(10) ** -40  # relative to the largest coefficient that entered: literals have 60 digits
DOUBLES = mpf(10) ** -16  # the same where terms are printed: numbers of models are doubles
_WHOLE = mpf(10) ** -30  # the distance at which a number counts as a fraction of small numbers
_DENOMINATOR = 24

Powers = tuple[tuple[sp.Expr, int], ...]  # of variables, in the order of their names
Angle = tuple[tuple[sp.Expr, Fraction], ...]  # multiples of variables; the first one is above 0
Key = tuple[Powers, str, Angle]  # "1", "cos" or "sin"

FUNCTIONS: Mapping[Op, Callable[[sp.Expr], sp.Expr]] = {
    Op.SQRT: sp.sqrt,
    Op.SIN: sp.sin,
    Op.COS: sp.cos,
    Op.TAN: sp.tan,
    Op.ASIN: sp.asin,
    Op.ACOS: sp.acos,
    Op.ATAN: sp.atan,
    Op.EXP: sp.exp,
    Op.LOG: sp.log,
    Op.TANH: sp.tanh,
    Op.ABS: sp.Abs,
    Op.SIGN: sp.sign,
}

_ONE: Key = ((), "1", ())


class SizeError(MbsError):
    """A sum of too many terms."""


@dataclass(frozen=True)
class Sum:
    """Terms, and the largest coefficient that has entered them."""

    terms: Mapping[Key, mpf]
    scale: mpf

    @classmethod
    def of(cls, terms: Iterable[tuple[Key, mpf]], scale: mpf) -> Self:
        """Add terms up, and drop zeros, up to rounding. Raises SizeError."""
        found: dict[Key, mpf] = {}
        for key, coefficient in terms:
            found[key] = found.get(key, mpf(0)) + coefficient
        if len(found) > MOST.get():
            raise SizeError(f"an equation has more than {MOST.get()} terms")
        scale = max([scale, *map(abs, found.values())])
        return cls({key: c for key, c in found.items() if abs(c) > ROUNDING * scale}, scale)

    def __add__(self, other: Sum) -> Sum:
        return Sum.of((*self.terms.items(), *other.terms.items()), max(self.scale, other.scale))

    def __sub__(self, other: Sum) -> Sum:
        return self + -other

    def __neg__(self) -> Sum:
        return Sum({key: -c for key, c in self.terms.items()}, self.scale)

    def __mul__(self, other: Sum) -> Sum:
        with LITERALS.workdps(60):
            products = (
                (key, a * b * c)
                for one, a in self.terms.items()
                for two, b in other.terms.items()
                for key, c in _multiply(one, two)
            )
            return Sum.of(products, mpf(0))

    def __truediv__(self, other: Sum) -> Sum:
        if len(other.terms) != 1:
            return self * _name(1 / other.expression) if other.terms else _name(sp.nan)
        ((powers, kind, angle), c) = next(iter(other.terms.items()))
        if kind != "1":
            return self * _name(1 / other.expression)
        inverse = tuple((x, -n) for x, n in powers)
        return self * Sum({(inverse, "1", angle): 1 / c}, abs(1 / c))

    @property
    def number(self) -> mpf | None:
        """The number that this is, if it is one."""
        if not self.terms:
            return mpf(0)
        return self.terms.get(_ONE) if len(self.terms) == 1 else None

    @property
    def expression(self) -> sp.Expr:
        """The sum as a SymPy expression, cosines and sines last."""
        factors: dict[tuple[str, Angle], list[sp.Expr]] = {}
        for (powers, kind, angle), c in self.terms.items():
            if abs(c) <= DOUBLES * self.scale:
                continue
            product = sp.Mul(to_number(c), *(x**n for x, n in powers))
            factors.setdefault((kind, angle), []).append(product)
        return sp.Add(*(sp.Mul(_simplify(sp.Add(*f)), _turn(*key)) for key, f in factors.items()))

    def collect(self, variables: tuple[sp.Expr, ...]) -> dict[Powers, Sum]:
        """Split into the coefficients of powers of some variables."""
        found: dict[Powers, dict[Key, mpf]] = {}
        for (powers, kind, angle), c in self.terms.items():
            own = tuple(x for x in powers if x[0] in variables)
            rest = tuple(x for x in powers if x[0] not in variables)
            found.setdefault(own, {})[rest, kind, angle] = c
        return {powers: Sum(terms, self.scale) for powers, terms in found.items()}


def variable(symbol: sp.Expr) -> Sum:
    """Return a variable as a sum."""
    return Sum({(((symbol, 1),), "1", ()): mpf(1)}, mpf(1))


def constant(value: mpf) -> Sum:
    """Return a number as a sum."""
    return Sum({_ONE: value} if value else {}, abs(value))


def to_number(value: mpf) -> sp.Expr:
    """Return a coefficient as a number: a fraction where it is one of small numbers, else a decimal of 15 digits."""
    for denominator in range(1, _DENOMINATOR + 1):
        product = value * denominator
        whole = LITERALS.nint(product)
        if abs(product - whole) <= _WHOLE * max(1, abs(product)):
            return sp.Rational(int(whole), denominator)
    return sp.Float(LITERALS.nstr(value, 15), 15)


def _multiply(one: Key, two: Key) -> tuple[tuple[Key, mpf], ...]:
    """Return the terms of a product of two terms, with their coefficients."""
    (p, k, a), (r, m, b) = one, two
    powers = _merge(p, r)
    if k == "1" or m == "1":
        return (((powers, *((m, b) if k == "1" else (k, a))), mpf(1)),)
    plus, minus, half = _add(a, b, 1), _add(a, b, -1), mpf("0.5")
    if k == m == "cos":
        return _term(powers, "cos", minus, half) + _term(powers, "cos", plus, half)
    if k == m == "sin":
        return _term(powers, "cos", minus, half) + _term(powers, "cos", plus, -half)
    turned = half if k == "sin" else -half
    return _term(powers, "sin", plus, half) + _term(powers, "sin", minus, turned)


def _term(powers: Powers, kind: str, angle: Angle, c: mpf) -> tuple[tuple[Key, mpf], ...]:
    """Write a term with the first multiple of its angle above 0."""
    if not angle:
        return (((powers, "1", ()), c),) if kind == "cos" else ()
    if angle[0][1] > 0:
        return (((powers, kind, angle), c),)
    return (((powers, kind, tuple((x, -n) for x, n in angle)), c if kind == "cos" else -c),)


def _merge(one: Powers, two: Powers) -> Powers:
    found = dict(one)
    for x, n in two:
        found[x] = found.get(x, 0) + n
    return tuple(sorted(((x, n) for x, n in found.items() if n), key=_rank))


def _add(a: Angle, b: Angle, sign: int) -> Angle:
    found = dict(a)
    for x, n in b:
        found[x] = found.get(x, Fraction(0)) + sign * n
    return tuple(sorted(((x, n) for x, n in found.items() if n), key=_rank))


def _rank(item: tuple[sp.Expr, object]) -> str:
    """Return the place of a variable in the order of names."""
    return _print(item[0])


@lru_cache(maxsize=1 << 16)
def _print(x: sp.Expr) -> str:
    return str(x)


def _read_angle(x: Sum) -> tuple[Angle, mpf] | None:
    """Read multiples of variables, and a number, off an angle; None where it is no such sum."""
    phase, found = mpf(0), []
    for (powers, kind, _), c in x.terms.items():
        number = to_number(c)
        if kind != "1" or len(powers) > 1 or (powers and powers[0][1] != 1):
            return None
        if not powers:
            phase = c
        elif isinstance(number, sp.Rational):
            found.append((powers[0][0], Fraction(int(number.p), int(number.q))))
        else:
            return None
    return tuple(sorted(found, key=_rank)), phase


def _expand(op: Op, angle: Angle, phase: mpf) -> Sum:
    """Write the sine or cosine of an angle plus a number."""
    sine, cosine = LITERALS.sin(phase), LITERALS.cos(phase)
    own, other = ("sin", "cos") if op is Op.SIN else ("cos", "sin")
    sign = 1 if op is Op.SIN else -1
    return Sum.of((*_term((), own, angle, cosine), *_term((), other, angle, sign * sine)), mpf(1))


def _name(expression: sp.Expr) -> Sum:
    """Return an expression as a variable, or as a number if it is one."""
    if expression.is_number:
        return constant(LITERALS.mpf(str(sp.N(expression, 60))))
    return variable(expression)


def _turn(kind: str, angle: Angle) -> sp.Expr:
    whole = sp.Add(*(sp.Rational(n.numerator, n.denominator) * x for x, n in angle))
    return sp.Integer(1) if kind == "1" else sp.cos(whole) if kind == "cos" else sp.sin(whole)


def _simplify(factor: sp.Expr) -> sp.Expr:
    """Take common factors out of a sum of products.

    Variables are simple already, so symbols stand for them: SymPy would look for factors within each of them again.
    """
    names = {x: sp.Dummy(f"v{k:06}", real=True) for k, x in enumerate(sorted(_list_variables(factor), key=_print))}
    found = sp.factor_terms(factor.xreplace(names))
    return found.xreplace({name: x for x, name in names.items()})


def _list_variables(factor: sp.Expr) -> set[sp.Expr]:
    """List the variables of a sum of products of powers that are not symbols."""
    bases = (x.as_base_exp()[0] for term in sp.Add.make_args(factor) for x in sp.Mul.make_args(term))
    return {x for x in bases if not x.is_Atom}


def _compute(op: Op) -> Callable[[Sum], Sum]:
    """Return a function of a sum as a sum."""

    def apply(x: Sum) -> Sum:
        number = x.number
        if number is not None:
            return _name(FUNCTIONS[op](sp.Float(str(number), 60)))
        angle = _read_angle(x) if op in (Op.SIN, Op.COS) else None
        return _name(FUNCTIONS[op](x.expression)) if angle is None else _expand(op, *angle)

    return apply


def _compute_angle(y: Sum, x: Sum) -> Sum:
    return _name(sp.atan2(y.expression, x.expression))


SUMS = Numbers(
    constant,
    {op: _compute(op) for op in Op if op.arity == 1 and op is not Op.NEG} | {Op.ATAN2: _compute_angle},
    constant(mpf(0)),
)
