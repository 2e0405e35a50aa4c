"""The builder: scalars that write equations as they are computed, folded and numbered on the way.

A value is referred to by a signed integer: +n or -n for node n, 0 for the number 0. Node n is an operation on
references; equal operations are one node (value numbering, or hash-consing). So a change of sign costs nothing, a - b
and b - a are one node, and sin(-x) is -sin(x). Where a minus must be computed after all, `build` first looks for a
difference or a literal that can take the sign.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence, Set
from typing import Any, TypeVar

from mpmath import mpf

from mbsgen.roles import Role
from mbsgen.tape.ports import Function, Port
from mbsgen.tape.references import OWN, Arithmetic
from mbsgen.tape.types import LARGEST_THRESHOLD, LITERALS, Input, Op, Sparsity, Tape
from mbsgen.tape.writer import Key, Ref, Result, Test, Writer

T = TypeVar("T")

SINGLE_EPSILON = 2.0**-23


class Scalar:
    """A value under construction: it behaves like a number, and writes to its builder."""

    __slots__ = ("builder", "ref")

    def __init__(self, builder: Builder, ref: Ref) -> None:
        self.builder = builder
        self.ref = ref

    # zeros are frequent, so they are handled first

    def __add__(self, other: Scalar) -> Scalar:
        x = self.ref
        if not x:
            return other
        y = other.ref
        if not y:
            return self
        builder = self.builder
        known = builder.sums.get((x, y))
        if known is None:
            known = builder.sums[x, y] = builder.add(x, y)
        return Scalar(builder, known)

    def __sub__(self, other: Scalar) -> Scalar:
        y = other.ref
        if not y:
            return self
        x, y, builder = self.ref, -y, self.builder
        known = builder.sums.get((x, y))
        if known is None:
            known = builder.sums[x, y] = builder.add(x, y)
        return Scalar(builder, known)

    def __mul__(self, other: Scalar) -> Scalar:
        x = self.ref
        if not x:
            return self
        y = other.ref
        if not y:
            return other
        builder = self.builder
        known = builder.products.get((x, y))
        if known is None:
            known = builder.products[x, y] = builder.mul(x, y)
        return Scalar(builder, known)

    def __truediv__(self, other: Scalar) -> Scalar:
        return Scalar(self.builder, self.builder.div(self.ref, other.ref))

    def __neg__(self) -> Scalar:
        return Scalar(self.builder, -self.ref)

    @property
    def is_zero(self) -> bool:
        """Return whether this is the structural zero."""
        return self.ref == 0

    @property
    def is_literal(self) -> bool:
        """Return whether this is a number known at generation."""
        return self.literal is not None

    @property
    def literal(self) -> float | None:
        """Return the number, if it is known at generation."""
        return self.builder.value(self.ref)


class Builder(Arithmetic):
    """Collects operations, and builds the Tape of the operations that outputs and guards need."""

    def __init__(self, *, fold: bool = True, number: bool = True, cancel: bool = False) -> None:
        super().__init__(fold=fold, number=number, cancel=cancel)
        self._nodes: list[Key | mpf | None] = [None]  # node 0 is never used
        self._bases: list[int] = [OWN]
        self._numbers: dict[float | tuple[int, ...], Ref] = {}
        self._fixed = bytearray(1)  # of each node: whether the inputs that vary do not reach it; see `cost`
        self._inputs: list[tuple[Input, int]] = []  # with the node of the first nonzero
        self._results: list[Result] = []
        self._tests: list[Test] = []
        self._labels: dict[int, str] = {}
        self.memory: dict[tuple[object, ...], tuple[object, Any]] | None = None  # of `remember`; None: it forgets

    def remember(self, key: tuple[object, ...], parts: tuple[object, ...], write: Callable[[], T]) -> T:
        """Return what `write` gave for an equal key and the very same parts before, or call it.

        What it gives must follow from the key, the parts and this builder. Then it would write the same nodes again.
        """
        if self.memory is None:
            return write()
        place = (*key, *map(id, parts))
        known = self.memory.get(place)
        if known is None:
            known = self.memory[place] = (parts, write())  # parts stay alive, so that no other object gets their id
        found: T = known[1]
        return found

    # -- what goes in and out ---------------------------------------------------------------------------------

    def input(self, port: Port | str, sparsity: Sparsity) -> list[Scalar]:
        """Declare an input; return its nonzeros. A name alone makes a port without a meaning, here and below."""
        first = len(self._nodes)
        self._inputs.append((Input(_make_port(port, Role.ARGUMENT), sparsity), first))
        self._nodes.extend([None] * sparsity.nnz)
        self._bases.extend(range(first, first + sparsity.nnz))
        return [Scalar(self, first + k) for k in range(sparsity.nnz)]

    def vector(self, port: Port | str, size: int) -> list[Scalar]:
        """Declare a dense column as input."""
        return self.input(port, Sparsity.dense(size))

    def output(self, port: Port | str, sparsity: Sparsity, values: Sequence[Scalar]) -> None:
        """Declare an output by the values of its nonzeros."""
        self._results.append(Result(_make_port(port, Role.RESULT), sparsity, tuple(v.ref for v in values)))

    def output_dense(self, port: Port | str, rows: Sequence[Sequence[Scalar]]) -> None:
        """Declare a dense output by rows."""
        sparsity = Sparsity.dense(len(rows), len(rows[0]) if rows else 0)
        self.output(port, sparsity, [rows[r][c] for r, c in sparsity.entries])

    def output_nonzeros(self, port: Port | str, rows: int, cols: int, entries: dict[tuple[int, int], Scalar]) -> None:
        """Declare an output with the pattern of its entries that are not the structural zero."""
        nonzero = {place: value for place, value in entries.items() if not value.is_zero}
        sparsity = Sparsity.of(rows, cols, nonzero)
        self.output(port, sparsity, [nonzero[place] for place in sparsity.entries])

    def guard(self, value: Scalar, scale: Scalar, tolerance: float, joint: int, *, early: bool = False) -> None:
        """Make the kernel fail at `joint` unless value > threshold * scale, see Guard.

        A guard on literals is decided now if it holds in float32. A division by parameters is guarded once.
        """
        pivot, size = value.literal, scale.literal
        threshold = min(tolerance * SINGLE_EPSILON, LARGEST_THRESHOLD)
        if pivot is not None and size is not None and pivot > threshold * size:
            return
        test = Test(value.ref, scale.ref, tolerance, joint, early)
        if not early or test not in self._tests:
            self._tests.append(test)

    def label(self, values: Iterable[Scalar], names: Iterable[str]) -> None:
        """Name values for readers, in the field's letters. A value keeps its first name; inputs and literals keep
        theirs.
        """
        for value, name in zip(values, names, strict=True):
            if value.ref > 0 and isinstance(self._nodes[value.ref], tuple):
                self._labels.setdefault(value.ref, name)

    # -- numbers ----------------------------------------------------------------------------------------------

    @property
    def zero(self) -> Scalar:
        """The structural zero."""
        return Scalar(self, 0)

    def number(self, value: float | mpf) -> Scalar:
        """Make a literal."""
        key = value._mpf_ if isinstance(value, LITERALS.mpf) else value
        known = self._numbers.get(key)
        if known is None:
            known = self._numbers[key] = self.literal(LITERALS.mpf(value))
        return Scalar(self, known)

    def sin(self, x: Scalar) -> Scalar:
        """Sine."""
        return self.apply(Op.SIN, x)

    def cos(self, x: Scalar) -> Scalar:
        """Cosine."""
        return self.apply(Op.COS, x)

    def sqrt(self, x: Scalar) -> Scalar:
        """Square root."""
        return self.apply(Op.SQRT, x)

    def apply(self, op: Op, x: Scalar, y: Scalar | None = None) -> Scalar:
        """Apply a function: any operation except + - * / and minus. Only the arc tangent of y/x has two operands."""
        return Scalar(self, self.call(op, x.ref, y.ref if y is not None else 0))

    def larger(self, x: Scalar, y: Scalar) -> Scalar:
        """Return the larger of two numbers, s x + (1 - s) y, with s = 1 where x > y, 0 where x < y, else 1/2.

        So the larger one is differentiated, or half of each where they are equal.
        """
        if (x - y).is_zero:
            return x
        one = self.number(1.0)
        s = (one + self.apply(Op.SIGN, x - y)) * self.number(0.5)
        return s * x + (one - s) * y

    def _new(self, key: Key | mpf, base: int = OWN) -> Ref:
        ref = len(self._nodes)
        self._nodes.append(key)
        self._bases.append(ref if base == OWN else base)
        return ref

    def cost(self, values: Iterable[Scalar], constant: Set[Role] = frozenset()) -> int:
        """Count the operations that `values` need, except on literals and inputs of the roles `constant`.

        This is a quick estimate for comparing two ways to write the same: it ignores signs that must be computed.
        `constant` must be the same in every call to one builder.
        """
        nodes, done, count = self._nodes, bytearray(self._mark_fixed(constant)), 0
        stack: list[int] = []
        take, put = stack.pop, stack.append
        for value in values:
            node = abs(value.ref)
            if not done[node]:
                done[node] = 1
                put(node)
        while stack:
            key = nodes[take()]
            if key.__class__ is tuple:
                _, a, b = key
                count += 1
                if a < 0:
                    a = -a
                if not done[a]:
                    done[a] = 1
                    put(a)
                if b < 0:
                    b = -b
                if not done[b]:
                    done[b] = 1
                    put(b)
        return count

    def _mark_fixed(self, constant: Set[Role]) -> bytearray:
        fixed = self._fixed
        constants = [
            range(first, first + source.sparsity.nnz) for source, first in self._inputs if source.port.role in constant
        ]
        for node in range(len(fixed), len(self._nodes)):
            key = self._nodes[node]
            if isinstance(key, tuple):
                fixed.append(fixed[abs(key[1])] and (not key[2] or fixed[key[2]]))
            else:
                fixed.append(key is not None or any(node in places for places in constants))
        return fixed

    # -- the tape ---------------------------------------------------------------------------------------------

    def build(self, function: Function | str) -> Tape:
        """Build the tape of the declared inputs and outputs, without operations that no output needs."""
        return Writer(self._nodes, self._bases, self._inputs, self._results, self._tests, self._labels).tape(
            Function(function) if isinstance(function, str) else function
        )


def _make_port(port: Port | str, role: Role) -> Port:
    return Port(port, role) if isinstance(port, str) else port
