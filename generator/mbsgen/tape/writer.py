"""From signed nodes to a Tape: the sign of each stored node, the nodes that outputs need, and the numbering."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence, Set
from dataclasses import dataclass
from types import MappingProxyType
from typing import Protocol, TypeVar

from mpmath import mpf

from mbsgen.tape.ports import Function, Port
from mbsgen.tape.types import ADD, DIV, EVEN, LITERALS, MUL, NEG, ODD, SUB, Guard, Input, Op, Output, Sparsity, Tape

Ref = int  # +n or -n: node n, or its negative; 0: the number 0
Key = tuple[Op, Ref, Ref]  # an operation on references
_TURNABLE = ODD | {ADD, SUB, MUL, DIV}  # their operands may decide the sign of the result

Entry = TypeVar("Entry", covariant=True)


class Numbered(Protocol[Entry]):
    """Entries by the number of a node."""

    def __getitem__(self, node: int, /) -> Entry:
        """Return the entry of a node."""


@dataclass(frozen=True)
class Result:
    """An output, by references."""

    port: Port
    sparsity: Sparsity
    refs: tuple[Ref, ...]


@dataclass(frozen=True)
class Test:
    """A guard, by references."""

    value: Ref
    scale: Ref
    tolerance: float
    joint: int
    early: bool


class Writer:
    """Turns signed nodes into plain operations: chooses the sign with which each node is stored."""

    def __init__(
        self,
        nodes: Sequence[Key | mpf | None],
        bases: Sequence[int],
        inputs: Sequence[tuple[Input, int]],
        results: Sequence[Result],
        tests: Sequence[Test],
        labels: dict[int, str],
        turned: Set[int] | None = None,
    ) -> None:
        """Take nodes; with `turned`, the nodes to be stored with the other sign, results or tests need all of them."""
        self._nodes, self._inputs, self._results, self._labels = nodes, inputs, results, labels
        self._tests = tests
        self._is_literal = [base == 0 for base in bases]
        self._uses = self._count_uses() if turned is None else [1] * len(nodes)
        self._turned = self._choose_turned() if turned is None else turned
        self._kept = [*range(len(nodes))]  # of each node: the node with its stored sign
        self._literals: dict[Ref, None] = {}  # in the order of their first use
        self._written: dict[Ref, tuple[Op, Ref, Ref]] = {}  # result -> operation on kept references

    def tape(self, function: Function) -> Tape:
        """Write the operations, then number the values."""
        self._write_operations()
        outputs = [[self._with_sign(ref) for ref in result.refs] for result in self._results]
        tested = [(self._as_kept(test.value), self._with_sign(test.scale)) for test in self._tests]
        order = (
            *(n for s, first in self._inputs for n in range(first, first + s.sparsity.nnz)),
            *self._literals,
        )
        place = [-1] * (2 * len(self._nodes) + 1)  # by signed node: negative ones from the end
        for value, ref in enumerate((*order, *self._written)):
            place[ref] = value
        return Tape(
            function,
            tuple(source for source, _ in self._inputs),
            tuple(self._literal(ref) for ref in self._literals),
            tuple([(op, place[a], place[b] if b or op.arity == 2 else -1) for op, a, b in self._written.values()]),
            tuple(
                Output(result.port, result.sparsity, tuple([place[ref] for ref in refs]))
                for result, refs in zip(self._results, outputs, strict=True)
            ),
            tuple(
                Guard(
                    place[value],
                    place[scale],
                    test.tolerance,
                    test.joint,
                    negated=value != test.value,
                    early=test.early,
                )
                for test, (value, scale) in zip(self._tests, tested, strict=True)
            ),
            MappingProxyType({place[node]: text for node, text in self._labels.items() if node in self._written}),
        )

    # -- which nodes are needed, and which are turned round ---------------------------------------------------

    def _choose_turned(self) -> set[int]:
        wanted = {ref for result in self._results for ref in result.refs}
        return choose_turned(wanted, self._nodes, self._uses.__getitem__, self._is_literal.__getitem__)

    def _count_uses(self) -> list[int]:
        """Count the uses of each node, 0 for one that is not needed; a guard takes a value with either sign."""
        uses = [0] * len(self._nodes)
        self._walk(uses, [*uses], [ref for result in self._results for ref in result.refs])
        tested = [ref for test in self._tests for ref in (test.value, test.scale)]
        self._walk(uses, [*uses], [ref for ref in tested if not uses[abs(ref)]])
        return uses

    def _walk(self, uses: list[int], done: Sequence[int], refs: Iterable[Ref]) -> None:
        """Add the uses by `refs`, and by the nodes that they need, except by `done` ones, whose operands are counted.

        Operands have smaller numbers than their users.
        """
        nodes, last = self._nodes, 0
        for node in map(abs, refs):
            if node:
                uses[node] += 1
                last = max(last, node)
        for node in range(last, 0, -1):
            if uses[node] and not done[node]:
                key = nodes[node]
                if key.__class__ is tuple:
                    _, a, b = key
                    uses[a if a > 0 else -a] += 1
                    uses[b if b > 0 else -b] += 1
        uses[0] = 0  # of no operand

    # -- operations with their signs settled ------------------------------------------------------------------

    def _write_operations(self) -> None:
        """Write the needed nodes in order: a literal with its sign, other operands with their stored ones."""
        nodes, turned_nodes, is_literal = self._nodes, self._turned, self._is_literal
        kept, literals, written = self._kept, self._literals, self._written
        for node, used in enumerate(self._uses):
            key = nodes[node]
            if not used or key.__class__ is not tuple:
                continue
            op, a, b = key
            turned = node in turned_nodes
            if not turned and a > 0 and kept[a] == a and (kept[b] == b if b > 0 else not b and op.arity == 1):
                if is_literal[a]:
                    literals[a] = None
                if is_literal[b]:  # node 0 is no literal
                    literals[b] = None
                written[node] = key  # the most operations: as they are
                continue
            if op is MUL or op is DIV:
                x, y = kept[a], kept[b]
                if ((x > 0) is not (y > 0)) is not turned:  # else the sign is right
                    if is_literal[a]:
                        x = -x
                    elif is_literal[b]:
                        y = -y
                turned = (x > 0) is not (y > 0)
            elif op is ADD or op is SUB:
                x, y = kept[a], kept[b]
                first, second = (x > 0) is not turned, (y > 0) is not ((op is SUB) is not turned)
                if not first and not second:  # both are subtracted: store the sum with the other sign
                    turned, first, second = not turned, True, True
                if not first:
                    x, y, second = y, x, first
                op = ADD if second else SUB
            elif op in ODD or op in EVEN:
                x, y = kept[a], 0
                turned = x < 0 and op in ODD
            else:
                x, y, turned = self._with_sign(a), self._with_sign(b) if op.arity == 2 else 0, False
            if is_literal[x if x > 0 else -x]:
                literals[x] = None
            if is_literal[y if y > 0 else -y]:  # node 0 is no literal
                literals[y] = None
            result = -node if turned else node
            written[result] = (op, x, y)
            kept[node] = result

    def _with_sign(self, ref: Ref) -> Ref:
        """Refer to a value with the given sign; spend an operation on the sign where the stored sign differs."""
        if ref == 0 or self._is_literal[abs(ref)]:
            self._literals[ref] = None
            return ref
        kept = self._kept[abs(ref)]
        if kept != ref and ref not in self._written:
            self._written[ref] = (NEG, kept, 0)
        return ref

    def _as_kept(self, ref: Ref) -> Ref:
        """Refer to a value with its stored sign."""
        return self._with_sign(ref if ref == 0 or self._is_literal[abs(ref)] else self._kept[abs(ref)])

    def _literal(self, ref: Ref) -> mpf:
        found = self._nodes[abs(ref)] if ref else LITERALS.mpf(0)
        assert found is not None
        assert not isinstance(found, tuple)
        return found if ref >= 0 else -found


def choose_turned(
    wanted: Set[Ref], nodes: Numbered[Key | mpf | None], count: Callable[[int], int], is_literal: Callable[[int], bool]
) -> set[int]:
    """Choose the nodes that are stored with the other sign, by the references that outputs want.

    count: the uses of a node.
    """
    turning = _Turning(nodes, count, is_literal, set())
    for ref in sorted((ref for ref in wanted if ref < 0), reverse=True):
        if -ref not in wanted:
            turning.turn(-ref)
    return turning.turned


@dataclass(frozen=True)
class _Turning:
    """The nodes that are turned, and what decides on others; no closure, which would keep all nodes by a cycle."""

    nodes: Numbered[Key | mpf | None]
    count: Callable[[int], int]
    is_literal: Callable[[int], bool]
    turned: set[int]

    def turn(self, node: int) -> bool:
        """Try to compute `node` with the other sign at no cost, through operands without other uses."""
        key = self.nodes[node]
        if not isinstance(key, tuple) or node in self.turned:
            return False
        op, a, b = key
        if op is MUL or op is DIV:
            is_free = self.is_literal(a) or self.is_literal(b)
        elif op is SUB:
            is_free = True
        elif op in _TURNABLE:
            is_free = False
        else:
            return False
        if is_free or self._is_turned(abs(a)) or (b and self._is_turned(abs(b))):
            self.turned.add(node)
            return True
        return False

    def _is_turned(self, operand: int) -> bool:
        return self.count(operand) == 1 and self.turn(operand)


def sign_of(ref: Ref) -> int:
    """Return the sign of a reference."""
    return 1 if ref > 0 else -1
