"""Factoring: a b + a c becomes a (b + c), within each sum of a tape.

A sum is taken whole, through additions and subtractions whose result has no other use; so are the products in it. Among
the shared factors, one with constant partners goes first (the partners are added up outside the recursion), then the
factor shared by most products.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence, Set
from dataclasses import dataclass

from mbsgen.roles import Role
from mbsgen.tape.builder import Builder, Scalar
from mbsgen.tape.replay import declare_inputs, leaves, operate, replay_guards
from mbsgen.tape.types import Op, Tape


@dataclass(frozen=True)
class _Term:
    """A signed product (or, without a second factor, a value) in a sum; by numbers of values."""

    sign: int
    first: int
    second: int | None

    def partner(self, factor: int) -> int:
        assert self.second is not None
        return self.second if factor == self.first else self.first


def factor(tape: Tape, constant: Set[Role] = frozenset()) -> Tape:
    """Take common factors out of sums; inputs of the roles `constant` count as constants."""
    return _Factoring(tape, constant).run()


class _Factoring:
    def __init__(self, tape: Tape, constant: Set[Role]) -> None:
        self.tape = tape
        self.uses = Counter(x for op, *operands in tape.operations for x in operands[: op.arity])
        self.uses.update(v for o in tape.outputs for v in o.values)
        self.uses.update(v for g in tape.guards for v in (g.value, g.scale))
        self.is_constant = self._find_constants(constant)
        self.inner = self._find_inner()

    def _find_constants(self, constant: Set[Role]) -> list[bool]:
        found = [i.port.role in constant for i in self.tape.inputs for _ in range(i.sparsity.nnz)]
        found += [True] * len(self.tape.literals)
        for op, a, b in self.tape.operations:
            found.append(found[a] and (op.arity == 1 or found[b]))
        return found

    def _operation(self, value: int) -> tuple[Op, int, int] | None:
        k = value - self.tape.first_operation
        return self.tape.operations[k] if k >= 0 else None

    def _find_inner(self) -> set[int]:
        """Find the operations that are written only as part of the sum they belong to."""
        inner: set[int] = set()
        for op, *operands in self.tape.operations:
            if op in (Op.ADD, Op.SUB):
                inner.update(
                    x
                    for x in operands
                    if self.uses[x] == 1
                    and (found := self._operation(x))
                    and found[0] in (Op.ADD, Op.SUB, Op.MUL)
                    and not self.is_constant[x]
                )
        return inner

    def run(self) -> Tape:
        builder = Builder()
        values = leaves(self.tape, builder, declare_inputs(self.tape, builder))
        for value, (op, a, b) in enumerate(self.tape.operations, self.tape.first_operation):
            if value in self.inner:
                values.append(builder.zero)  # written where it is used
            elif op in (Op.ADD, Op.SUB):
                values.append(self._write_sum(builder, values, value))
            else:
                values.append(operate(builder, op, values[a], values[b] if b >= 0 else None))
        labelled = [(v, text) for v, text in sorted(self.tape.labels.items()) if v not in self.inner]
        builder.label([values[v] for v, _ in labelled], [text for _, text in labelled])
        for o in self.tape.outputs:
            builder.output(o.port, o.sparsity, [values[v] for v in o.values])
        replay_guards(self.tape, builder, values)
        return builder.build(self.tape.function)

    def _terms(self, value: int, sign: int) -> list[_Term]:
        found = self._operation(value)
        assert found is not None
        op, a, b = found
        if op is Op.MUL:
            return [_Term(sign, a, b)]
        terms = []
        for operand, own in ((a, sign), (b, sign if op is Op.ADD else -sign)):
            terms += self._terms(operand, own) if operand in self.inner else [_Term(own, operand, None)]
        return terms

    def _write_sum(self, builder: Builder, values: Sequence[Scalar], value: int) -> Scalar:
        terms = self._terms(value, 1)
        groups: list[tuple[int, list[_Term]]] = []
        while (shared := self._choose_factor(terms)) is not None:
            members = [t for t in terms if t.second is not None and shared in (t.first, t.second)]
            if self._has_constant_partners(terms, shared):
                members = [t for t in members if self.is_constant[t.partner(shared)]]
            groups.append((shared, members))
            terms = [t for t in terms if t not in members]
        total = builder.zero
        for t in terms:
            plain = values[t.first] if t.second is None else values[t.first] * values[t.second]
            total = total + plain if t.sign > 0 else total - plain
        for shared, members in groups:
            partners = builder.zero
            for t in members:
                partner = values[t.partner(shared)]
                partners = partners + partner if t.sign > 0 else partners - partner
            total = total + values[shared] * partners
        return total

    def _choose_factor(self, terms: Sequence[_Term]) -> int | None:
        counts = Counter(f for t in terms if t.second is not None for f in {t.first, t.second})
        shared = [f for f, n in counts.items() if n > 1]
        if not shared:
            return None
        return max(shared, key=lambda f: (self._has_constant_partners(terms, f), counts[f], -f))

    def _has_constant_partners(self, terms: Sequence[_Term], shared: int) -> bool:
        members = [t for t in terms if t.second is not None and shared in (t.first, t.second)]
        return sum(self.is_constant[t.partner(shared)] for t in members) > 1
