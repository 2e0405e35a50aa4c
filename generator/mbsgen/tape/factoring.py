"""Factoring: a b + a c becomes a (b + c), within each sum of a tape.

A sum is taken whole, through additions and subtractions whose result has no other use; so are the products in it. Among
the shared factors, one with constant partners goes first (the partners are added up outside the recursion), then the
factor shared by most products.
"""

from __future__ import annotations

from collections.abc import Sequence, Set

from mbsgen.roles import Role
from mbsgen.tape.builder import Builder, Scalar
from mbsgen.tape.counts import count_uses
from mbsgen.tape.replay import declare_inputs, find_constants, leaves, replay_guards
from mbsgen.tape.types import ADD, MUL, SUB, Tape
from mbsgen.tape.writer import Ref

_Term = tuple[int, int, int | None]  # in a sum: a sign, and a product or, without a second factor, a value


def factor(tape: Tape, constant: Set[Role] = frozenset()) -> Tape:
    """Take common factors out of sums; inputs of the roles `constant` count as constants."""
    return _Factoring(tape, constant).run()


class _Factoring:
    def __init__(self, tape: Tape, constant: Set[Role]) -> None:
        self.tape = tape
        self.uses = count_uses(tape)
        self.is_constant = find_constants(tape, constant)
        self.inner = self._find_inner()

    def _find_inner(self) -> set[int]:
        """Find the operations that are written only as part of the sum they belong to."""
        uses, first, is_constant = self.uses, self.tape.first_operation, self.is_constant
        may_be = {
            value
            for value, (op, _, _) in enumerate(self.tape.operations, first)
            if (op is MUL or op is ADD or op is SUB) and uses[value] == 1 and not is_constant[value]
        }
        sums = ((a, b) for op, a, b in self.tape.operations if op is ADD or op is SUB)
        return {x for operands in sums for x in operands if x in may_be}

    def run(self) -> Tape:
        builder = Builder()
        refs = [x.ref for x in leaves(self.tape, builder, declare_inputs(self.tape, builder))]
        inner, operate = self.inner, builder.operate
        for value, (op, a, b) in enumerate(self.tape.operations, self.tape.first_operation):
            if value in inner:
                refs.append(0)  # written where it is used
            elif op is ADD or op is SUB:
                refs.append(self._write_sum(builder, refs, value))
            else:
                refs.append(operate(op, refs[a], refs[b] if b >= 0 else 0))
        tested = {v for g in self.tape.guards for v in (g.value, g.scale)}
        shown = tested.union(self.tape.labels, *(o.values for o in self.tape.outputs))
        values = {v: Scalar(builder, refs[v]) for v in shown}
        labelled = [(v, text) for v, text in sorted(self.tape.labels.items()) if v not in self.inner]
        builder.label([values[v] for v, _ in labelled], [text for _, text in labelled])
        for o in self.tape.outputs:
            builder.output(o.port, o.sparsity, [values[v] for v in o.values])
        replay_guards(self.tape, builder, values)
        return builder.build(self.tape.function)

    def _terms(self, value: int, sign: int, terms: list[_Term]) -> None:
        """Add the terms of a product or sum to a list."""
        op, a, b = self.tape.operations[value - self.tape.first_operation]
        if op is MUL:
            terms.append((sign, a, b))
            return
        for operand, own in ((a, sign), (b, sign if op is ADD else -sign)):
            if operand in self.inner:
                self._terms(operand, own, terms)
            else:
                terms.append((own, operand, None))

    def _write_sum(self, builder: Builder, refs: Sequence[Ref], value: int) -> Ref:
        terms: list[_Term] = []
        self._terms(value, 1, terms)
        groups: list[tuple[int, list[_Term]]] = []
        while (shared := self._choose_factor(terms)) is not None:
            members = [t for t in terms if t[2] is not None and shared in t[1:]]
            if self._has_constant_partners(terms, shared):
                members = [t for t in members if self.is_constant[_partner(t, shared)]]
            groups.append((shared, members))
            terms = [t for t in terms if t not in members]
        add, mul, total = builder.add, builder.mul, 0
        for sign, first, second in terms:
            plain = refs[first] if second is None else mul(refs[first], refs[second])
            total = add(total, plain if sign > 0 else -plain)
        for shared, members in groups:
            partners = 0
            for t in members:
                partner = refs[_partner(t, shared)]
                partners = add(partners, partner if t[0] > 0 else -partner)
            total = add(total, mul(refs[shared], partners))
        return total

    def _choose_factor(self, terms: Sequence[_Term]) -> int | None:
        counts: dict[int, int] = {}
        for _, first, second in terms:
            if second is not None:
                counts[first] = counts.get(first, 0) + 1
                if second != first:
                    counts[second] = counts.get(second, 0) + 1
        shared = [f for f, n in counts.items() if n > 1]
        if not shared:
            return None
        return max(shared, key=lambda f: (self._has_constant_partners(terms, f), counts[f], -f))

    def _has_constant_partners(self, terms: Sequence[_Term], shared: int) -> bool:
        members = [t for t in terms if t[2] is not None and shared in t[1:]]
        return sum(self.is_constant[_partner(t, shared)] for t in members) > 1


def _partner(term: _Term, factor: int) -> int:
    _, first, second = term
    assert second is not None, "a term with a factor is a product"
    return second if factor == first else first
