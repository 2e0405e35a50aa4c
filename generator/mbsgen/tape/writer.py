"""From signed nodes to a Tape: the sign of each stored node, the nodes that outputs need, and the numbering."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from types import MappingProxyType

from mpmath import mpf

from mbsgen.tape.ports import Function, Port
from mbsgen.tape.types import EVEN, LITERALS, ODD, Guard, Input, Op, Output, Sparsity, Tape

Ref = int  # +n or -n: node n, or its negative; 0: the number 0
Key = tuple[Op, Ref, Ref]  # an operation on references
_TURNABLE = ODD | {Op.ADD, Op.SUB, Op.MUL, Op.DIV}  # their operands may decide the sign of the result


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
        inputs: Sequence[tuple[Input, int]],
        results: Sequence[Result],
        tests: Sequence[Test],
        labels: dict[int, str],
    ) -> None:
        self._nodes, self._inputs, self._results, self._labels = nodes, inputs, results, labels
        self._tests = tests
        self._literal_nodes = bytearray(node is not None and node.__class__ is not tuple for node in nodes)
        self._uses = self._count_uses()
        self._turned = self._choose_turned()
        self._kept: dict[int, Ref] = {}  # node -> the node with its stored sign
        self._literals: dict[Ref, None] = {}  # in the order of their first use
        self._written: dict[Ref, tuple[Op, Ref, Ref]] = {}  # result -> operation on kept references

    def tape(self, function: Function) -> Tape:
        """Write the operations, then number the values."""
        for source, first in self._inputs:
            self._kept.update((node, node) for node in range(first, first + source.sparsity.nnz))
        nodes, write = self._nodes, self._write
        for node in sorted(self._uses):  # operands have smaller numbers than their users
            key = nodes[node]
            if key.__class__ is tuple:
                write(node, *key)  # type: ignore[misc]
        outputs = [[self._with_sign(ref) for ref in result.refs] for result in self._results]
        tested = [(self._as_kept(test.value), self._with_sign(test.scale)) for test in self._tests]
        order = (
            *(n for s, first in self._inputs for n in range(first, first + s.sparsity.nnz)),
            *self._literals,
        )
        place = {ref: value for value, ref in enumerate((*order, *self._written))}
        return Tape(
            function,
            tuple(source for source, _ in self._inputs),
            tuple(self._literal(ref) for ref in self._literals),
            tuple((op, place[a], place[b] if op.arity == 2 else -1) for op, a, b in self._written.values()),
            tuple(
                Output(result.port, result.sparsity, tuple(place[ref] for ref in refs))
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

    def _count_uses(self) -> dict[int, int]:
        """Count the uses of each needed node; a guard takes a value with either sign."""
        uses: dict[int, int] = {}
        self._walk(uses, [ref for result in self._results for ref in result.refs])
        tested = [ref for test in self._tests for ref in (test.value, test.scale)]
        self._walk(uses, [ref for ref in tested if abs(ref) not in uses])
        return uses

    def _walk(self, uses: dict[int, int], refs: Iterable[Ref]) -> None:
        stack = [abs(ref) for ref in refs if ref]
        nodes = self._nodes
        while stack:
            node = stack.pop()
            if node in uses:
                uses[node] += 1
                continue
            uses[node] = 1
            key = nodes[node]
            if key.__class__ is tuple:
                _, a, b = key  # type: ignore[misc]
                if a:
                    stack.append(a if a > 0 else -a)
                if b:
                    stack.append(b if b > 0 else -b)

    def _choose_turned(self) -> set[int]:
        turned: set[int] = set()
        wanted = {ref for result in self._results for ref in result.refs}
        for ref in sorted(wanted, reverse=True):
            if ref < 0 and -ref not in wanted:
                self._turn(-ref, turned)
        return turned

    def _turn(self, node: int, turned: set[int]) -> bool:
        """Try to compute `node` with the other sign at no cost, through operands without other uses."""
        key = self._nodes[node]
        if not isinstance(key, tuple) or node in turned or key[0] not in _TURNABLE:
            return False
        op, a, b = key
        free = op is Op.SUB or (op in (Op.MUL, Op.DIV) and (self._is_literal(a) or self._is_literal(b)))
        operands = (a, b)[: op.arity]
        if free or any(self._uses[x] == 1 and self._turn(x, turned) for x in operands):
            turned.add(node)
            return True
        return False

    # -- operations with their signs settled ------------------------------------------------------------------

    def _write(self, node: int, op: Op, a: Ref, b: Ref) -> None:
        turned, literals, kept = node in self._turned, self._literal_nodes, self._kept
        if op is Op.MUL or op is Op.DIV:
            x, y = a if literals[a] else kept[a], b if literals[b] else kept[b]
            if ((x > 0) is not (y > 0)) is not turned:  # else the sign is right
                if literals[a]:
                    x = -x
                elif literals[b]:
                    y = -y
            self._record(node if (x > 0) is (y > 0) else -node, op, x, y)
        elif op is Op.ADD or op is Op.SUB:
            x, y = a if literals[a] else kept[a], b if literals[b] else kept[b]
            first, second = (x > 0) is not turned, (y > 0) is not ((op is Op.SUB) is not turned)
            if not first and not second:  # both are subtracted: store the sum with the other sign
                turned, first, second = not turned, True, True
            if not first:
                x, y, second = y, x, first
            self._record(-node if turned else node, Op.ADD if second else Op.SUB, x, y)
        elif op in ODD or op in EVEN:
            x = self._keep(a)
            self._record(sign_of(x) * node if op in ODD else node, op, x, 0)
        else:
            self._record(node, op, self._with_sign(a), self._with_sign(b) if op.arity == 2 else 0)

    def _keep(self, node: int) -> Ref:
        """Refer to a node with its stored sign; a literal can have either, and starts with its own."""
        return node if self._is_literal(node) else self._kept[node]

    def _record(self, result: Ref, op: Op, a: Ref, b: Ref) -> None:
        literals = self._literal_nodes
        if literals[a if a > 0 else -a]:
            self._literals[a] = None
        if literals[b if b > 0 else -b]:  # no operand is node 0, which is no literal
            self._literals[b] = None
        # A literal is written with its sign; any other operand is written with its stored sign.
        self._written[result] = (op, a, b)
        self._kept[result if result > 0 else -result] = result

    def _with_sign(self, ref: Ref) -> Ref:
        """Refer to a value with the given sign; spend an operation on the sign where the stored sign differs."""
        if ref == 0 or self._is_literal(ref):
            self._literals[ref] = None
            return ref
        kept = self._kept[abs(ref)]
        if kept != ref and ref not in self._written:
            self._written[ref] = (Op.NEG, kept, 0)
        return ref

    def _as_kept(self, ref: Ref) -> Ref:
        """Refer to a value with its stored sign."""
        return self._with_sign(ref if ref == 0 or self._is_literal(ref) else self._kept[abs(ref)])

    def _is_literal(self, ref: Ref) -> bool:
        return bool(self._literal_nodes[abs(ref)])

    def _literal(self, ref: Ref) -> mpf:
        found = self._nodes[abs(ref)] if ref else LITERALS.mpf(0)
        assert found is not None
        assert not isinstance(found, tuple)
        return found if ref >= 0 else -found


def sign_of(ref: Ref) -> int:
    """Return the sign of a reference."""
    return 1 if ref > 0 else -1
