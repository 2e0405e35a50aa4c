"""Bounds of rounding errors beside values: running error analysis of a tape, as a tape.

Every computed number z of a tape, x op y, comes with a bound of its error in units of the unit roundoff u,

    |z - exact| <= u (r |z| + a),

r a number that is known at generation, a computed beside z (Higham, "Accuracy and stability of numerical algorithms",
SIAM 2002, section 3.3; Wilkinson, 1986). Inputs are exact. As rounding gives |z - (x op y)| <= u |z|,

    x + y     r = 1,              a = rx |x| + ry |y| + ax + ay
    x y       r = rx + ry + 1,    a = |x| ay + |y| ax + u ax ay
    x / y     r = rx + ry + 1,    a = ax / |y|                                              where y has no a,
              r = 1,              a = (|z| (ay + ry |y|) + rx |x| + ax) / (|y| - u ay)      elsewhere
    sqrt(x)   r = rx/2 + 1,       a = ax / z
    sin(x)    r = 2,              a = rx |x| + ax, and likewise for functions of slope at most 1

So products cost nothing before there was a sum. The last bound is made larger by the sixteenth part, which covers
products of r and u, and the rounding of the bounds: up to 1e5 operations in single precision. Underflow is left out. A
divisor, or another argument, whose error reaches a singularity is a guard: the kernel fails.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from math import pi

import numpy as np
from mpmath import mpf

from mbsgen.roles import Role
from mbsgen.tape.builder import Builder, Scalar
from mbsgen.tape.ports import Function, Port
from mbsgen.tape.replay import declare_inputs, operate, replay_guards
from mbsgen.tape.types import LITERALS, Op, Sparsity, Tape

UNIT = Port("unit", Role.ARGUMENT, meaning="unit roundoff: 2^-53 in double, 2^-24 in single precision")
PREFIX = "bounded_"
MARGIN = 1 + 1 / 16
LEAST = 2.0**-8  # of twice the unit roundoff: a smaller one is refused, as 0 would be
SINE = 2.0  # the error of sines and cosines, in units of roundoff of the result: 0.83 ulp, see mbs_sincos.h
FUNCTION = 8.0  # the same of the C library's other functions


@dataclass(frozen=True)
class _Error:
    """A bound r |z| + a, in units of roundoff."""

    r: float
    a: Scalar

    @property
    def is_exact(self) -> bool:
        """Return whether there is no error."""
        return self.r == 0 and self.a.is_zero


def name_bound(result: str) -> str:
    """Name the bound of a result, as in `bound_Phi`."""
    return f"bound_{result}"


def bound_port(of: Port) -> Port:
    """Make the port of the bound of a result."""
    meaning = f"largest rounding error of {of.name}"
    return Port(name_bound(of.name), Role.RESULT, of.rows, of.cols, unit=of.unit, meaning=meaning)


def add_bounds(tape: Tape) -> Tape:
    """Return the tape with a bound beside every result, as `bounded_impl`; another input is the unit roundoff."""
    builder = Builder()
    given = declare_inputs(tape, builder)
    (unit,) = builder.input(UNIT, Sparsity.dense(1))
    builder.guard(unit, builder.number(LEAST), 1.0, 1)
    analysis = _Analysis(tape, builder, unit)
    values, errors = analysis.run([x for i in tape.inputs for x in given[i.name]])
    replay_guards(tape, builder, values)
    for output in tape.outputs:
        builder.output(output.port, output.sparsity, [values[v] for v in output.values])
    factor = builder.number(MARGIN) * unit
    for output in tape.outputs:
        bounds = [factor * analysis.measure(values[v], errors[v]) for v in output.values]
        builder.output(bound_port(output.port), output.sparsity, bounds)
    return builder.build(Function(PREFIX + tape.name))


class _Analysis:
    """Replays a tape with errors."""

    def __init__(self, tape: Tape, builder: Builder, unit: Scalar) -> None:
        self.tape, self.builder, self.unit = tape, builder, unit
        self.joints = {guard.value: guard.joint for guard in tape.guards}

    def run(self, inputs: list[Scalar]) -> tuple[list[Scalar], list[_Error]]:
        """Compute all values, and their errors."""
        exact, literals = _Error(0.0, self.builder.zero), self.tape.literals
        values = [*inputs, *map(self.builder.number, literals)]
        errors = [exact] * len(inputs) + [replace(exact, r=float(not _is_single(x))) for x in literals]
        for op, a, b in self.tape.operations:
            operands = (a,) if b < 0 else (a, b)
            value = operate(self.builder, op, values[a], values[b] if b >= 0 else None)
            rule = _RULES.get(op, _Analysis._bend)
            known = [(values[v], errors[v]) for v in operands]
            joint = next((self.joints[v] for v in reversed(operands) if v in self.joints), 1)
            errors.append(rule(self, value, *known, op, joint))
            values.append(value)
        return values, errors

    def measure(self, value: Scalar, error: _Error) -> Scalar:
        """Write r |z| + a."""
        return self._scale(error.r, self._size(value)) + error.a if error.r else error.a

    # --- rules ---

    def _negate(self, _: Scalar, x: tuple[Scalar, _Error], __: Op, ___: int) -> _Error:
        return x[1]

    def _add(self, _: Scalar, x: tuple[Scalar, _Error], y: tuple[Scalar, _Error], __: Op, ___: int) -> _Error:
        return _Error(1.0, self.measure(*x) + self.measure(*y))

    def _multiply(self, _: Scalar, x: tuple[Scalar, _Error], y: tuple[Scalar, _Error], __: Op, ___: int) -> _Error:
        (p, e), (q, f) = x, y
        rounds = not (self._is_power(p) or self._is_power(q))
        mixed = self.unit * e.a * f.a if not (e.a.is_zero or f.a.is_zero) else self.builder.zero
        return _Error(e.r + f.r + rounds, self._size(p) * f.a + self._size(q) * e.a + mixed)

    def _divide(self, z: Scalar, x: tuple[Scalar, _Error], y: tuple[Scalar, _Error], _: Op, joint: int) -> _Error:
        (p, e), (q, f) = x, y
        if f.a.is_zero:
            return _Error(e.r + f.r + 1, e.a / self._size(q) if not e.a.is_zero else e.a)
        rest = self._keep_away(self._size(q), self._size(q), f.a, joint)
        return _Error(1.0, (self._size(z) * self.measure(q, f) + self.measure(p, e)) / rest)

    def _root(self, z: Scalar, x: tuple[Scalar, _Error], _: Op, joint: int) -> _Error:
        error = x[1]
        if not error.a.is_zero:
            self._keep_away(x[0], x[0], self.measure(*x), joint)
        return _Error(error.r / 2 + 1, error.a / z if not error.a.is_zero else error.a)

    def _turn(self, _: Scalar, x: tuple[Scalar, _Error], __: Op, ___: int) -> _Error:
        return _Error(SINE, self.measure(*x))

    def _bend(self, _: Scalar, x: tuple[Scalar, _Error], __: Op, ___: int) -> _Error:
        return _Error(FUNCTION, self.measure(*x))

    def _sign(self, _: Scalar, x: tuple[Scalar, _Error], __: Op, joint: int) -> _Error:
        if not x[1].is_exact:
            self._keep_away(self._size(x[0]), self._size(x[0]), self.measure(*x), joint)
        return _Error(0.0, self.builder.zero)

    def _exponential(self, z: Scalar, x: tuple[Scalar, _Error], _: Op, joint: int) -> _Error:
        """exp(x + h) - exp(x) is at most 2 |h| exp(x) for |h| <= 1."""
        error = self.measure(*x)
        if not error.is_zero:
            self._keep_away(self._one, self._one, error, joint)
        return _Error(FUNCTION, self._scale(2.0, z * error))

    def _logarithm(self, _: Scalar, x: tuple[Scalar, _Error], __: Op, joint: int) -> _Error:
        error = self.measure(*x)
        if error.is_zero:
            return _Error(FUNCTION, error)
        return _Error(FUNCTION, error / self._keep_away(x[0], x[0], error, joint))

    def _tangent(self, z: Scalar, x: tuple[Scalar, _Error], _: Op, joint: int) -> _Error:
        """tan(x + h) - tan(x) = tan(h) (1 + t^2) / (1 - t tan(h)), at most 4 |h| (1 + t^2) for 4 |h| (1 + |t|) <= 1."""
        error = self.measure(*x)
        if error.is_zero:
            return _Error(FUNCTION, error)
        self._keep_away(self._one, self._one, self._scale(4.0, error * (self._one + self._size(z))), joint)
        return _Error(FUNCTION, self._scale(4.0, error * (self._one + z * z)))

    def _arc(self, _: Scalar, x: tuple[Scalar, _Error], __: Op, joint: int) -> _Error:
        """The slope of the arc sine is at most 1/sqrt(1 - |x|)."""
        error = self.measure(*x)
        if error.is_zero:
            return _Error(FUNCTION, error)
        rest = self._keep_away(self._one - self._size(x[0]), self._one, error, joint)
        return _Error(FUNCTION, error / self.builder.sqrt(rest))

    def _angle(self, _: Scalar, y: tuple[Scalar, _Error], x: tuple[Scalar, _Error], __: Op, joint: int) -> _Error:
        """A change d of a vector turns it by at most pi/2 d/|vector|."""
        error = self.measure(*y) + self.measure(*x)
        if error.is_zero:
            return _Error(FUNCTION, error)
        length = self.builder.sqrt(x[0] * x[0] + y[0] * y[0])
        self._keep_away(length, length, error, joint)
        return _Error(FUNCTION, self._scale(pi / 2, error) / length)

    # --- parts ---

    @property
    def _one(self) -> Scalar:
        return self.builder.number(1.0)

    def _keep_away(self, value: Scalar, scale: Scalar, error: Scalar, joint: int) -> Scalar:
        """Return value - u error, which must stay positive."""
        rest = value - self._scale(MARGIN, self.unit * error)
        self.builder.guard(rest, scale, 1.0, joint)
        return rest

    def _size(self, value: Scalar) -> Scalar:
        """Return |value|; squares and literals need no operation."""
        literal = value.literal
        if literal is not None:
            return self.builder.number(abs(literal)) if literal < 0 else value
        return self.builder.apply(Op.ABS, value)

    def _scale(self, factor: float, value: Scalar) -> Scalar:
        return value if factor == 1 else self.builder.number(factor) * value

    def _is_power(self, value: Scalar) -> bool:
        """Return whether a value is a power of 2 that is known at generation: products by it are exact."""
        literal = value.literal
        return literal is not None and literal != 0 and abs(np.frexp(literal)[0]) == 0.5


def _is_single(literal: mpf) -> bool:
    """Return whether a literal is a number of single precision, to all its digits."""
    return bool(literal == LITERALS.mpf(float(np.float32(float(literal)))))


Rule = Callable[..., _Error]

_RULES: Mapping[Op, Rule] = {
    Op.ADD: _Analysis._add,
    Op.SUB: _Analysis._add,
    Op.MUL: _Analysis._multiply,
    Op.DIV: _Analysis._divide,
    Op.NEG: _Analysis._negate,
    Op.ABS: _Analysis._negate,
    Op.SQRT: _Analysis._root,
    Op.SIN: _Analysis._turn,
    Op.COS: _Analysis._turn,
    Op.TAN: _Analysis._tangent,
    Op.ASIN: _Analysis._arc,
    Op.ACOS: _Analysis._arc,
    Op.ATAN2: _Analysis._angle,
    Op.EXP: _Analysis._exponential,
    Op.LOG: _Analysis._logarithm,
    Op.SIGN: _Analysis._sign,
}
