"""Arithmetic on references: operations on nodes that are folded, put in order and numbered.

A value is referred to by a signed integer: +n or -n for node n, 0 for the number 0. Where a node is stored is left to
the class that stores it.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence

from mpmath import mpf

from mbsgen.errors import TapeError
from mbsgen.tape.types import ADD, DIV, EVEN, LITERALS, MUL, NEG, ODD, SUB, Op
from mbsgen.tape.writer import Key, Numbered, Ref, sign_of

OWN = -1  # as a base: the node's own number
_ONE = LITERALS.mpf(1)


class _Forgetful(dict[tuple[Ref, Ref], Ref]):
    """Keeps nothing."""

    def __setitem__(self, pair: tuple[Ref, Ref], ref: Ref) -> None: ...


def size_of(value: mpf) -> tuple[int, int]:
    """Return the mantissa and the exponent of a number: mpmath's own hash takes long."""
    _, mantissa, exponent, _ = value._mpf_
    return mantissa, exponent


class Arithmetic(ABC):
    """Operations on references to nodes, which a class that inherits it stores by `_new`.

    fold: evaluate operations on literals, drop 0 and 1, gather literal factors. number: give equal operations one node.
    cancel: a + (b - a) is b, for sums of differences.
    """

    _nodes: Numbered[Key | mpf | None]  # None: an entry of an input
    _bases: Numbered[int]  # of each node: the node that its literal factor multiplies; of a literal: 0

    def __init__(self, *, fold: bool = True, number: bool = True, cancel: bool = False) -> None:
        self._fold, self._cancel, self._number = fold, cancel, number
        self._one = -1  # the node of the literal 1, if there is one
        self._known: dict[Key, Ref] = {}  # quotients and functions
        self.sums: dict[tuple[Ref, Ref], Ref] = {} if number else _Forgetful()  # of x > 0 and y with |x| <= |y|, and
        self.products: dict[tuple[Ref, Ref], Ref] = {} if number else _Forgetful()  # products of 0 < x <= y;
        # both also of pairs as scalars ask for them: most are asked for many times
        self._literals: dict[tuple[int, int], Ref] = {}  # by `size_of`

    @abstractmethod
    def _new(self, key: Key | mpf, base: int = OWN) -> Ref:
        """Store a node; return its number."""

    def literal(self, value: mpf) -> Ref:
        """Refer to a literal."""
        sign, mantissa, exponent, bits = value._mpf_
        if not mantissa:
            if exponent:
                raise TapeError(f"a literal of a tape must be finite, not {value}")
            return 0
        if bits > LITERALS.prec:
            return self.literal(LITERALS.mpf(value))
        size = (mantissa, exponent)
        ref = self._literals.get(size)
        if ref is None:
            ref = self._literals[size] = self._new(abs(value), 0)
            if size == (1, 0):
                self._one = ref
        return -ref if sign else ref

    def add(self, x: Ref, y: Ref) -> Ref:
        """Refer to x + y."""
        if x == 0 or y == 0:
            return x + y
        if self._cancel and x != -y and not (self._fold and self._bases[abs(x)] == self._bases[abs(y)]):
            left = self._find_left(x, y) or self._find_left(y, x)
            if left:
                return left
        sign, a, b = 1, x, y
        if a < 0:
            sign, a, b = -1, -a, -b
        if (b if b > 0 else -b) < a:  # the smaller node comes first, with a plus
            a, b, sign = (b, a, sign) if b > 0 else (-b, -a, -sign)
        ref = self.sums.get((a, b))
        if ref is None:
            ref = self.sums[a, b] = self._write_sum(a, b)
        return ref if sign > 0 else -ref

    def _write_sum(self, x: Ref, y: Ref) -> Ref:
        """Refer to x + y, of x > 0 and |x| <= |y|."""
        if x == -y:
            return 0
        bases, node = self._bases, y if y > 0 else -y
        if self._fold and (base := bases[x]) == bases[node]:
            factor = self.literal(self._factor(x) + self._factor(y))
            return self.mul(factor, base) if base else factor
        return self._new((ADD, x, y) if y > 0 else (SUB, x, node))

    def _find_left(self, x: Ref, y: Ref) -> Ref:
        """Refer to b where y is a sum -x + b, so that x + y = b; return 0 where y is no such sum."""
        key = self._nodes[abs(y)]
        if not isinstance(key, tuple) or key[0] not in (ADD, SUB):
            return 0
        a, b = (key[1], key[2] if key[0] is ADD else -key[2])
        a, b = (a, b) if y > 0 else (-a, -b)
        return b if x == -a else a if x == -b else 0

    def mul(self, x: Ref, y: Ref) -> Ref:
        """Refer to x * y."""
        if x == 0 or y == 0:
            return 0
        is_positive = True
        if x < 0:
            x, is_positive = -x, False
        if y < 0:
            y, is_positive = -y, not is_positive
        if x > y:
            x, y = y, x
        ref = self.products.get((x, y))
        if ref is None:
            ref = self.products[x, y] = self._write_product(x, y)
        return ref if is_positive else -ref

    def _write_product(self, x: Ref, y: Ref) -> Ref:
        """Refer to x * y, of 0 < x <= y."""
        bases = self._bases
        if self._fold:
            if bases[y] == 0:
                x, y = y, x  # a literal comes first
            if bases[x]:
                return self._new((MUL, x, y))
            if x == self._one:
                return y
            if y == self._one:
                return x
            base = bases[y]
            if base != y:
                factor = self.literal(self._factor(x) * self._factor(y))
                return self.mul(factor, base) if base else factor
        return self._new((MUL, x, y), OWN if bases[x] else y)

    def div(self, x: Ref, y: Ref) -> Ref:
        """Refer to x / y; for a literal y, to the product with its inverse."""
        if y == 0:
            raise TapeError("division by the structural zero")
        if x == 0:
            return 0
        sign = 1 if (x > 0) == (y > 0) else -1
        x, y = abs(x), abs(y)
        if self._fold:
            b = self._value(y)
            if b is not None:
                return sign * self.mul(x, self.literal(1 / b))
            if x == y:
                return sign * self.literal(_ONE)
        return sign * self._node(DIV, x, y)

    def operate(self, op: Op, x: Ref, y: Ref) -> Ref:
        """Refer to an operation of any kind; y is 0 for one operand."""
        if op is MUL:
            return self.mul(x, y)
        if op is ADD:
            return self.add(x, y)
        if op is SUB:
            return self.add(x, -y)
        if op is NEG:
            return -x
        return self.div(x, y) if op is DIV else self.call(op, x, y)

    def call(self, op: Op, x: Ref, y: Ref = 0) -> Ref:
        """Refer to op(x) or op(x, y); the sign of x is moved outside where the function is odd or even."""
        sign = 1
        if x < 0 and (op in ODD or op in EVEN):
            sign, x = (-1 if op in ODD else 1), -x
        operands = (x, y)[: op.arity]
        if self._fold or not any(operands):
            values = [value for operand in operands if (value := self._number_of(operand)) is not None]
            if len(values) == op.arity:
                return sign * self.literal(_call(op, values))
        return sign * self._node(op, x, y)

    def _number_of(self, ref: Ref) -> mpf | None:
        found = self._value(abs(ref)) if ref else LITERALS.mpf(0)
        return -found if found is not None and ref < 0 else found

    def value(self, ref: Ref) -> float | None:
        """Return the number that `ref` refers to, or None if it depends on an input."""
        found = self._value(abs(ref)) if ref else LITERALS.mpf(0)
        return None if found is None else float(found) * sign_of(ref)

    def _value(self, node: Ref) -> mpf | None:
        found = self._nodes[node]
        return None if found is None or isinstance(found, tuple) else found

    def _factor(self, ref: Ref) -> mpf:
        """Return the literal factor of the node in `_bases`; of a literal, the number."""
        node = abs(ref)
        base = self._bases[node]
        if base == node:
            return _ONE if ref > 0 else -_ONE
        found = self._nodes[node]
        factor = self._value(found[1]) if isinstance(found, tuple) else found
        assert factor is not None
        return factor if ref > 0 else -factor

    def _node(self, op: Op, a: Ref, b: Ref) -> Ref:
        key = (op, a, b)
        ref = self._known.get(key) if self._number else None
        if ref is None:
            ref = self._known[key] = self._new(key)
        return ref


def _call(op: Op, values: Sequence[mpf]) -> mpf:
    """Compute a function of literals. Raises TapeError where it has no value, or none within the range of doubles."""
    numbers = ", ".join(LITERALS.nstr(value, 6) for value in values)
    if op is Op.EXP and values[0] > 1000:
        raise TapeError(f"exp({numbers}) is beyond the range of a double")
    result = getattr(LITERALS, op.value[0])(*values)
    if not isinstance(result, LITERALS.mpf) or not LITERALS.isfinite(result):
        raise TapeError(f"{op.value[0]}({numbers}) has no value")
    return result
