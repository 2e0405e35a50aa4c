"""Bounds of rounding errors beside values: running error analysis of a tape, as a tape.

Every computed number z of a tape comes with a bound of its error, in units of the unit roundoff u (Higham, "Accuracy
and stability of numerical algorithms", SIAM 2002, section 3.3; Wilkinson, 1986). For the exact Z, a direct number has

    |z - Z| <= u n |z| (1 + u)^t                n known at generation

and any other number a size e, computed beside z, with

    |z - Z| <= u (e - s |z|) (1 + u)^t,         s >= 0 known at generation.

So e has room for s more roundings of z. Inputs are exact. The rules follow from |z - (x op y)| <= u |z|:

    x y       n = nx + ny + 1                                        both direct
              e = |x| ey,               s = sy - nx - 1              x direct
              e = |x| ey + Y ex,        s = sx + sy - 1              else
    x + y     e = ex + ey,              s = min(sx, sy) - 1
    x / y     n = nx + ny + 1                                        both direct
              e = ex / |y|,             s = sx - ny - 1              y direct
              e = |z| ey / R,           s = sy - nx - 1              x direct
              e = (|z| ey + ex) / R,    s = sx + sy - 1              else
    sqrt(x)   e = ex / z,               s = sx - 1

with Y = |y| + u ey and R = |y| - u ey. Products of direct numbers cost nothing; a sum costs one operation. Where s is
too small, k |z| is added to e, and k to s; a direct number has e = (n + k) |z|, s = k. One pass from the last operation
to the first finds the room that later operations need, so that most numbers get it at once and for all their uses. Of
other functions, e is the effect of the argument's error and r |z|, the function's own rounding.

t counts the roundings of e and the products of errors that the rules leave out. Rounding e changes e - s |z|, which is
at least |z|, by a factor of 1 + (s + 1) u. The factor (1 + u)^t of a bound is computed at generation for the largest u
that is accepted, 2^-23. Underflow is left out. A divisor, or another argument, whose error reaches half of the distance
to a singularity is a guard: the kernel fails. A sign that is not certain has an error of 2, so values and derivatives
have a right bound on either side of a branch.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from math import ceil, frexp, log2, pi

from mpmath import mpf

from mbsgen.roles import Role
from mbsgen.tape.builder import Builder, Scalar
from mbsgen.tape.ports import Function, Port
from mbsgen.tape.replay import declare_inputs, operate, replay_guards
from mbsgen.tape.types import LITERALS, Op, Sparsity, Tape

UNIT = Port("unit", Role.ARGUMENT, meaning="unit roundoff: 2^-53 in double, 2^-24 in single precision")
PREFIX = "bounded_"
LARGEST = 2.0**-23  # unit roundoff; larger ones are refused
LEAST = 2.0**-8  # of twice the unit roundoff: a smaller one is refused, as 0 would be
SINE = 2.0  # the error of sines and cosines in units of roundoff: 0.9 ulp in mbs_sincos.h, 1 in the C library
FUNCTION = 8.0  # the same of the C library's other functions: 4 ulp
MOST = 16.0  # roundings that a bound gets room for, unless one operation needs more; fewer are tighter and slower


@dataclass(frozen=True)
class _Error:
    """The bound of the error of z in units of roundoff: n |z| for a direct number, otherwise e - s |z|."""

    roundings: float = 0.0  # n
    size: Scalar | None = None  # e; None for a direct number
    spare: float = 0.0  # s
    slack: float = 0.0  # t
    wanted: float = 0.0  # s that later operations need
    positive: bool = False  # z >= 0, whatever the inputs

    @property
    def is_direct(self) -> bool:
        """Return whether the error is a known number of roundings of the number itself."""
        return self.size is None

    @property
    def is_exact(self) -> bool:
        """Return whether there is no error."""
        return self.size is None and self.roundings == 0


Known = tuple[Scalar, _Error]
_LINEAR = frozenset({Op.ADD, Op.SUB, Op.MUL, Op.DIV, Op.SQRT, Op.NEG, Op.ABS})  # their rules use s


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
    builder.guard(builder.number(LARGEST) - unit, builder.number(LARGEST), 1.0, 1)
    analysis = _Analysis(tape, builder, unit, _plan(tape))
    values, errors = analysis.run([x for i in tape.inputs for x in given[i.name]])
    replay_guards(tape, builder, values)
    for output in tape.outputs:
        builder.output(output.port, output.sparsity, [values[v] for v in output.values])
    for output in tape.outputs:
        bounds = [unit * analysis.measure(values[v], errors[v]) for v in output.values]
        builder.output(bound_port(output.port), output.sparsity, bounds)
    return builder.build(Function(PREFIX + tape.name))


class _Analysis:
    """Replays a tape with errors."""

    def __init__(self, tape: Tape, builder: Builder, unit: Scalar, wanted: Sequence[float]) -> None:
        self.tape, self.builder, self.unit, self.wanted = tape, builder, unit, wanted
        self.one = builder.number(1.0)
        self.joints = {guard.value: guard.joint for guard in tape.guards}

    def run(self, inputs: list[Scalar]) -> tuple[list[Scalar], list[_Error]]:
        """Compute all values, and their errors."""
        literals = self.tape.literals
        values = [*inputs, *map(self.builder.number, literals)]
        errors = [_Error(wanted=w) for w in self.wanted[: len(inputs)]]
        for x in literals:
            errors.append(_Error(float(not _is_single(x)), wanted=self.wanted[len(errors)], positive=x >= 0))
        for op, a, b in self.tape.operations:
            operands = (a,) if b < 0 else (a, b)
            value = operate(self.builder, op, values[a], values[b] if b >= 0 else None)
            rule = _RULES.get(op, _Analysis._bend)
            known = [(values[v], errors[v]) for v in operands]
            joint = next((self.joints[v] for v in reversed(operands) if v in self.joints), 1)
            errors.append(self._provide(value, rule(self, value, *known, op, joint), self.wanted[len(values)]))
            values.append(value)
        return values, errors

    def measure(self, value: Scalar, error: _Error) -> Scalar:
        """Write the bound in units of roundoff, with all its factors."""
        if error.is_exact:
            return self.builder.zero
        size = self._scale(error.roundings, self._size(value)) if error.size is None else error.size
        return self._scale(_grow(error.slack), size)

    def _room(self, value: Scalar, error: _Error, need: float) -> tuple[Scalar, float]:
        """Return e and s of a number, with s at least `need`."""
        if error.size is None:
            spare = max(need, error.wanted)
            return self._scale(error.roundings + spare, self._size(value)), spare
        if error.spare >= need:
            return error.size, error.spare
        return error.size + self._scale(need - error.spare, self._size(value)), need

    def _provide(self, value: Scalar, error: _Error, wanted: float) -> _Error:
        """Make room for later roundings, once for all operations."""
        if error.is_direct or error.spare >= wanted:
            return replace(error, wanted=wanted)
        size, spare = self._room(value, error, wanted)
        return replace(error, size=size, spare=spare, slack=error.slack + _count(spare))

    # --- rules ---

    def _collect(self, value: Scalar, own: float, error: Scalar) -> _Error:
        """Bound the error by r |z| + e; `error` is e, `own` is r."""
        if error.is_zero:
            return _Error(own)
        return _Error(size=error + self._scale(own, self._size(value)), slack=_count(own))

    def _negate(self, _: Scalar, x: Known, __: Op, ___: int) -> _Error:
        return replace(x[1], positive=False)

    def _absolute(self, _: Scalar, x: Known, __: Op, ___: int) -> _Error:
        return replace(x[1], positive=True)

    def _add(self, _: Scalar, x: Known, y: Known, op: Op, __: int) -> _Error:
        e, f = x[1], y[1]
        t = max(e.slack, f.slack)
        if op is Op.ADD and e.positive and f.positive and e.is_direct and f.is_direct:
            return _Error(max(e.roundings, f.roundings) + 1, slack=t + _count(), positive=True)
        (a, r), (b, s) = self._room(*x, 1.0), self._room(*y, 1.0)
        return _Error(size=a + b, spare=min(r, s) - 1, slack=t + _count(r, s))

    def _multiply(self, _: Scalar, x: Known, y: Known, __: Op, ___: int) -> _Error:
        if y[1].is_direct:
            x, y = y, x
        (p, e), (q, f) = x, y
        rounds = not (_is_power(p) or _is_power(q))
        positive = p.ref == q.ref or (e.positive and f.positive)
        if not e.is_direct:
            (a, r), (b, s) = self._room(*x, 0.5), self._room(*y, 0.5)
            reach = self._size(q) + self._scale(2.0 ** ceil(log2(_grow(f.slack))), self.unit) * b
            t = max(e.slack, f.slack) + _count(r, s)
            return _Error(size=self._size(p) * b + reach * a, spare=r + s - 1, slack=t, positive=positive)
        t = e.slack + f.slack + _count(e.roundings)
        if not f.is_direct:
            b, s = self._room(*y, e.roundings + rounds)
            t += _count(s)
            return _Error(size=self._size(p) * b, spare=s - e.roundings - rounds, slack=t, positive=positive)
        return _Error(e.roundings + f.roundings + rounds, slack=t, positive=positive)

    def _divide(self, z: Scalar, x: Known, y: Known, _: Op, joint: int) -> _Error:
        e, (q, f) = x[1], y
        positive = e.positive and f.positive
        if f.is_direct:
            t = e.slack + f.slack + _count(f.roundings)
            if e.is_direct:
                return _Error(e.roundings + f.roundings + 1, slack=t, positive=positive)
            a, r = self._room(*x, f.roundings + 1)
            size = a * self._size(self.one / q)
            return _Error(size=size, spare=r - f.roundings - 1, slack=t + _count(r), positive=positive)
        rest = self._keep_away(self._size(q), self._size(q), self.measure(*y), joint)
        if e.is_direct:
            b, s = self._room(*y, e.roundings + 1)
            t = e.slack + f.slack + _count(e.roundings, s)
            return _Error(size=self._size(z) * b / rest, spare=s - e.roundings - 1, slack=t, positive=positive)
        (a, r), (b, s) = self._room(*x, 0.5), self._room(*y, 0.5)
        t = max(e.slack, f.slack) + _count(r, s)
        return _Error(size=(self._size(z) * b + a) / rest, spare=r + s - 1, slack=t, positive=positive)

    def _root(self, z: Scalar, x: Known, _: Op, joint: int) -> _Error:
        (p, e), t = x, x[1].slack + _count(x[1].roundings)
        if e.is_direct:
            return _Error(e.roundings / 2 + 1, slack=t, positive=True)
        self._keep_away(p, p, self.measure(*x), joint)
        a, r = self._room(*x, 1.0)
        return _Error(size=a / z, spare=r - 1, slack=t + _count(r), positive=True)

    def _turn(self, z: Scalar, x: Known, _: Op, __: int) -> _Error:
        return self._collect(z, SINE, self.measure(*x))

    def _bend(self, z: Scalar, x: Known, _: Op, __: int) -> _Error:
        """The slope is at most 1."""
        return self._collect(z, FUNCTION, self.measure(*x))

    def _sign(self, _: Scalar, x: Known, __: Op, ___: int) -> _Error:
        """A sign that is not certain errs by at most 2, which is 2/u in units of roundoff."""
        value, e = x
        if e.is_exact:
            return _Error()
        certain = self.builder.apply(Op.SIGN, self._size(value) - self.unit * self.measure(*x))
        uncertain = self.builder.apply(Op.ABS, certain) - certain  # 0, or 2
        return _Error(size=uncertain / self.unit, slack=_count())

    def _exponential(self, z: Scalar, x: Known, _: Op, joint: int) -> _Error:
        """exp(x + h) - exp(x) is at most 2 |h| exp(x) for |h| <= 1/2."""
        error = self.measure(*x)
        if not error.is_zero:
            self._keep_away(self.one, self.one, error, joint)
        return self._collect(z, FUNCTION, self._scale(2.0, z * error))

    def _logarithm(self, z: Scalar, x: Known, _: Op, joint: int) -> _Error:
        error = self.measure(*x)
        if not error.is_zero:
            error = error / self._keep_away(x[0], x[0], error, joint)
        return self._collect(z, FUNCTION, error)

    def _tangent(self, z: Scalar, x: Known, _: Op, joint: int) -> _Error:
        """tan(x + h) - tan(x) = tan(h) (1 + t^2) / (1 - t tan(h)), at most 4 |h| (1 + t^2) for 4 |h| (1 + |t|) <= 1."""
        error = self.measure(*x)
        if not error.is_zero:
            self._keep_away(self.one, self.one, self._scale(4.0, error * (self.one + self._size(z))), joint)
            error = self._scale(4.0, error * (self.one + z * z))
        return self._collect(z, FUNCTION, error)

    def _arc(self, z: Scalar, x: Known, _: Op, joint: int) -> _Error:
        """The slope of the arc sine is at most 1/sqrt(1 - |x|)."""
        error = self.measure(*x)
        if not error.is_zero:
            rest = self._keep_away(self.one - self._size(x[0]), self.one, error, joint)
            error = error / self.builder.sqrt(rest)
        return self._collect(z, FUNCTION, error)

    def _angle(self, z: Scalar, y: Known, x: Known, _: Op, joint: int) -> _Error:
        """A change d of a vector turns it by at most pi/2 d/|vector|."""
        error = self.measure(*y) + self.measure(*x)
        if not error.is_zero:
            length = self.builder.sqrt(x[0] * x[0] + y[0] * y[0])
            self._keep_away(length, length, error, joint)
            error = self._scale(pi / 2, error) / length
        return self._collect(z, FUNCTION, error)

    # --- parts ---

    def _keep_away(self, value: Scalar, scale: Scalar, error: Scalar, joint: int) -> Scalar:
        """Return value - u error, of which at least half of the value must be left."""
        reach = self.unit * error
        self.builder.guard(value - self._scale(2.0, reach), scale, 4.0, joint)
        return value - reach

    def _size(self, value: Scalar) -> Scalar:
        """Return |value|; literals need no operation."""
        literal = value.literal
        if literal is not None:
            return -value if literal < 0 else value
        return self.builder.apply(Op.ABS, value)

    def _scale(self, factor: float, value: Scalar) -> Scalar:
        return value if factor == 1 else self.builder.number(factor) * value


def _plan(tape: Tape) -> list[float]:
    """Return the s of each number that later operations need, from the last operation to the first."""
    first = tape.first_operation
    builder = Builder()
    given = declare_inputs(tape, builder)
    (unit,) = builder.input(UNIT, Sparsity.dense(1))
    analysis = _Analysis(tape, builder, unit, [0.0] * (first + len(tape.operations)))
    values, errors = analysis.run([x for i in tape.inputs for x in given[i.name]])
    wanted = [0.0] * len(values)
    for z in range(len(values) - 1, first - 1, -1):
        op, a, b = tape.operations[z - first]
        operands = (a,) if b < 0 else (a, b)
        if errors[z].is_direct or op not in _LINEAR:
            continue
        cost = _count_roundings(op, [(values[v], errors[v]) for v in operands])
        indirect = [v for v in operands if not errors[v].is_direct]
        share = 2 if op in (Op.MUL, Op.DIV) and len(indirect) == 2 else 1  # both provide it
        need = (wanted[z] + cost) / share
        for v in operands if op in (Op.ADD, Op.SUB) else indirect:
            wanted[v] = max(wanted[v], need if need <= MOST else cost / share)
    return wanted


def _count_roundings(op: Op, operands: Sequence[Known]) -> float:
    """Count the roundings of a result that the bounds of its operands need room for."""
    if op in (Op.ADD, Op.SUB, Op.SQRT):
        return 1.0
    if op in (Op.NEG, Op.ABS):
        return 0.0
    is_exact = op is Op.MUL and any(_is_power(value) for value, _ in operands)
    return sum(error.roundings for _, error in operands if error.is_direct) + (not is_exact)


def _count(*roundings: float) -> float:
    """Return what an operation adds to t: the roundings of e, and for each s or n twice its number."""
    return 2 * sum(roundings) + 10


def _grow(slack: float) -> float:
    """Return (1 + u)^t for the largest u, with some more roundings."""
    return float((1 + LARGEST) ** (slack + 8))


def _is_power(value: Scalar) -> bool:
    """Return whether a value is a power of 2 that is known at generation: products by it are exact."""
    literal = value.literal
    return literal is not None and literal != 0 and bool(abs(frexp(literal)[0]) == 0.5)


def _is_single(literal: mpf) -> bool:
    """Return whether a literal is a number of single precision, to all its digits."""
    import numpy as np  # here alone, for numbers of single precision

    return bool(literal == LITERALS.mpf(float(np.float32(float(literal)))))


Rule = Callable[..., _Error]

_RULES: Mapping[Op, Rule] = {
    Op.ADD: _Analysis._add,
    Op.SUB: _Analysis._add,
    Op.MUL: _Analysis._multiply,
    Op.DIV: _Analysis._divide,
    Op.NEG: _Analysis._negate,
    Op.ABS: _Analysis._absolute,
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
