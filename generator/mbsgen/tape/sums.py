"""Sums and products of a tape, written anew: with common parts once, and in the order in which terms are ready.

A sum is taken whole, through additions and subtractions whose result has no other use; so is a product.

*Sharing*: the pair of terms that most sums hold becomes a value, which takes the place of the pair in each of them; so
does the next pair. A pair in k sums saves k - 1 operations. Constants of a sum or product are combined first, outside
the recursion. A product with a constant that other products with constants alone use leaves its constant to them.

*Order*: a processor starts several operations per clock, but each of them takes some clocks, and a sum waits for its
terms. So the term that is ready last is added last, where this ends the sum earlier.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence, Set
from copy import copy
from dataclasses import dataclass
from functools import reduce
from heapq import heapify, heappop, heappush
from itertools import combinations
from typing import Any

from mbsgen.roles import Role
from mbsgen.tape.builder import Builder, Scalar
from mbsgen.tape.counts import count_uses
from mbsgen.tape.replay import declare_inputs, find_constants, leaves, replay_guards
from mbsgen.tape.types import ADD, DIV, MUL, SUB, Op, Tape
from mbsgen.tape.writer import Ref

LONGEST = 48  # terms; a longer sum shares nothing, since its pairs would be thousands
CLOCKS = {ADD: 4, SUB: 4, MUL: 4, DIV: 14, Op.SQRT: 18}  # until a result is ready; of today's processors
CLOCKS_OF_FUNCTION = 40

SUMS: Mapping[Op, Op] = {ADD: ADD, SUB: ADD}  # a difference is a sum
_KINDS: Mapping[Op, Op] = {**SUMS, MUL: MUL}
_Term = tuple[int, int]  # a value and its sign; of a product, always 1
_Pair = tuple[int, int, int]  # two values in order, and the product of their signs


@dataclass(frozen=True)
class Rewritten:
    """A tape with its sums and products written anew: terms as they stand, and as they are ready."""

    plain: Tape
    ordered: Tape


def rewrite(
    tape: Tape, constant: Set[Role] = frozenset(), *, share: bool = True, order: bool = True
) -> tuple[Rewritten, ...]:
    """Write sums and products anew; inputs of the roles `constant` count as constants.

    share: compute common parts once. A second tape then moves constants into products with constants before, where
    there are any. order: combine terms as they are ready, where this ends a sum or product earlier.
    """
    ways = [_Sums(tape, constant)]
    if share:
        handed_on = ways[0].hand_on_constants()
        ways += [handed_on] if handed_on else []
        for sums in ways:
            sums.share()
    return tuple(sums.write_ways(order=order) for sums in ways)


def find_inner(tape: Tape, is_constant: Sequence[bool], kinds: Mapping[Op, Op]) -> set[int]:
    """Find the operations that are written only as part of the sum or product that they belong to, by their `kinds`."""
    first, operations, uses = tape.first_operation, tape.operations, count_uses(tape)
    found = set()
    for op, a, b in operations:
        kind = kinds.get(op)
        for x in (a, b) if kind else ():
            is_single = x >= first and uses[x] == 1 and not is_constant[x]
            if is_single and kinds.get(operations[x - first][0]) is kind:
                found.add(x)
    return found


def list_terms(tape: Tape, value: int, inner: Set[int]) -> list[tuple[int, int]]:
    """List the terms of a whole sum with their signs, or the factors of a whole product, from left to right."""
    terms: list[tuple[int, int]] = []
    waiting = [(value, 1)]
    while waiting:
        place, sign = waiting.pop()
        if place != value and place not in inner:
            terms.append((place, sign))
            continue
        op, a, b = tape.operations[place - tape.first_operation]
        waiting += [(b, -sign if op is SUB else sign), (a, sign)]
    return terms


class _Sums:
    def __init__(self, tape: Tape, constant: Set[Role]) -> None:
        self.tape = tape
        self.is_constant = [*find_constants(tape, constant)]
        self.inner = find_inner(tape, self.is_constant, _KINDS)
        self.handed_on = False
        self.wholes: dict[Op, dict[int, list[_Term]]] = {ADD: {}, MUL: {}}  # sums and products, by value
        for value, (op, _, _) in enumerate(tape.operations, tape.first_operation):
            if op in _KINDS and value not in self.inner and not self.is_constant[value]:
                terms = list_terms(tape, value, self.inner)
                self.wholes[_KINDS[op]][value] = terms if op is Op.MUL else _cancel(terms)
        self.pairs: dict[int, tuple[Op, _Term, _Term]] = {}  # the values of pairs follow the values of the tape

    # -- sharing ------------------------------------------------------------------------------------------------

    def hand_on_constants(self) -> _Sums | None:
        """Return these sums with constants moved, and shared together; None where there are none such."""
        other = copy(self)
        other.handed_on = True
        other.wholes = {kind: {v: [*terms] for v, terms in wholes.items()} for kind, wholes in self.wholes.items()}
        other.is_constant, other.pairs = [*self.is_constant], {}
        has_several = any(
            sum(self.is_constant[x] for x, _ in terms) > 1
            for wholes in self.wholes.values()
            for terms in wholes.values()
        )
        return other if other._move_constants() or has_several else None

    def share(self) -> None:
        """Replace shared pairs by values."""
        for kind, wholes in self.wholes.items():
            self._pair_up(kind, {value: terms for value, terms in wholes.items() if len(terms) <= LONGEST})

    def _move_constants(self) -> bool:
        """Move the constant of a product into the products that use it, where all of these have constants too."""
        has_moved = False
        products = self.wholes[MUL]
        holders: dict[int, list[int]] = {}
        for value, factors in products.items():
            for x, _ in factors:
                holders.setdefault(x, []).append(value)
        uses = count_uses(self.tape)
        for value, factors in products.items():
            found = holders.get(value, [])
            fixed, rest = ([x for x in factors if self.is_constant[x[0]] is is_fixed] for is_fixed in (True, False))
            if not (fixed and rest and found and uses[value] == len(found)):
                continue
            if all(any(self.is_constant[x] for x, _ in products[holder]) for holder in found):
                for holder in found:
                    place = products[holder].index((value, 1))
                    products[holder][place : place + 1] = [*fixed, *(rest if len(rest) == 1 else [(value, 1)])]
                factors[:] = rest if len(rest) > 1 else factors
                has_moved = True
        return has_moved

    def _pair_up(self, kind: Op, wholes: dict[int, list[_Term]]) -> None:
        holders: dict[_Pair, set[int]] = {}
        for value, terms in wholes.items():
            if len(terms) > 2:
                for pair in self._list_pairs(terms):
                    holders.setdefault(pair, set()).add(value)
        for value, terms in wholes.items():
            if len(terms) == 2:  # equal ones are one value, so that only a longer sum can share the pair
                for pair in self._list_pairs(terms):
                    if pair in holders:
                        holders[pair].add(value)
        queue = [(-len(found), pair) for pair, found in holders.items() if len(found) > 1]
        heapify(queue)
        while queue:
            number, pair = heappop(queue)
            found = holders[pair]
            if len(found) != -number:  # some of them hold it no more
                if len(found) > 1:
                    heappush(queue, (-len(found), pair))
                continue
            shared = self._add_pair(kind, pair)
            for value in sorted(found):
                terms = wholes[value]
                for old in set(self._list_pairs(terms)):
                    if old in holders:
                        holders[old].discard(value)
                _replace(terms, pair, shared)
                for new in set(self._list_pairs(terms)):
                    now = holders.setdefault(new, set())
                    now.add(value)
                    if len(now) > 1 and shared in new[:2]:
                        heappush(queue, (-len(now), new))

    def _add_pair(self, kind: Op, pair: _Pair) -> int:
        a, b, sign = pair
        shared = len(self.is_constant)
        self.is_constant.append(False)
        self.pairs[shared] = (kind, (a, 1), (b, sign))
        return shared

    def _list_pairs(self, terms: Sequence[_Term]) -> Iterator[_Pair]:
        fixed = [x for x, _ in terms if self.is_constant[x]]
        kept = set(fixed) if len(fixed) > 1 and self.handed_on else ()  # they become one
        for (x, r), (y, s) in combinations(terms, 2):
            if x not in kept and y not in kept and not (self.is_constant[x] and self.is_constant[y]):
                yield (x, y, r * s) if x <= y else (y, x, r * s)

    # -- order --------------------------------------------------------------------------------------------------

    def _order(self) -> dict[int, list[_Term]]:
        """Sort the terms of sums and products by the clock at which they are ready, where this ends them earlier."""
        tape, found = self.tape, dict[int, list[_Term]]()
        wholes = {**self.wholes[ADD], **self.wholes[MUL]}
        ready = dict.fromkeys(range(tape.first_operation), 0)
        for value, (op, a, b) in enumerate(tape.operations, tape.first_operation):
            terms = wholes.get(value)
            if terms is None:
                began = max(ready[a], ready[b] if b >= 0 else 0)
                ready[value] = 0 if self.is_constant[value] else began + CLOCKS.get(op, CLOCKS_OF_FUNCTION)
                continue
            if len(terms) == 2:  # their order changes nothing
                (x, _), (y, _) = terms
                ready[value] = max(self._find_clock(ready, x), self._find_clock(ready, y)) + CLOCKS[op]
                continue
            clocks, step = {x: self._find_clock(ready, x) for x, _ in terms}, CLOCKS[op]
            by_time = sorted(terms, key=lambda term: clocks[term[0]])
            end, before = (_end([clocks[x] for x, _ in some], step) for some in (by_time, terms))
            if end < before:
                found[value] = by_time
            ready[value] = min(end, before)
        return found

    def _find_clock(self, ready: dict[int, int], value: int) -> int:
        """Return the clock at which a value is ready; values of pairs are added to those known."""
        known = ready.get(value)
        if known is None:
            kind, *parts = self.pairs[value]
            known = ready[value] = max(self._find_clock(ready, x) for x, _ in parts) + CLOCKS[kind]
        return known

    # -- the new tape -------------------------------------------------------------------------------------------

    def write_ways(self, *, order: bool) -> Rewritten:
        """Write the tape with terms as they stand, and, if asked for, as they are ready."""
        plain, sorted_ = self._write({}), self._order() if order else {}
        return Rewritten(plain, self._write(sorted_) if sorted_ else plain)

    def _write(self, ordered: Mapping[int, list[_Term]]) -> Tape:
        """Write the tape with its sums and products as they are now, some of them in another order."""
        tape, builder, inner = self.tape, Builder(), self.inner
        wholes = {**self.wholes[ADD], **self.wholes[MUL], **ordered}
        refs: list[Ref | None] = [x.ref for x in leaves(tape, builder, declare_inputs(tape, builder))]
        refs += [None] * (len(self.is_constant) - len(refs))
        known: list[Any] = refs  # operands are written before their users
        add, mul, operate = builder.add, builder.mul, builder.operate
        for value, (op, a, b) in enumerate(tape.operations, tape.first_operation):
            terms = wholes.get(value)
            if terms is None:
                if value not in inner:
                    refs[value] = operate(op, known[a], known[b] if b >= 0 else 0)
                continue
            if len(terms) == 2:
                (x, r), (y, s) = terms
                first, second = refs[x], refs[y]
                if first is not None and second is not None:
                    refs[value] = mul(first, second) if op is MUL else add(r * first, s * second)
                    continue
            refs[value] = self._combine(builder, refs, _KINDS[op], terms)
        tested = {v for g in tape.guards for v in (g.value, g.scale)}
        shown = tested.union(tape.labels, *(o.values for o in tape.outputs)) - self.inner
        values = {v: Scalar(builder, known[v]) for v in shown}
        labelled = [(v, text) for v, text in sorted(tape.labels.items()) if v in values]
        builder.label([values[v] for v, _ in labelled], [text for _, text in labelled])
        for o in tape.outputs:
            builder.output(o.port, o.sparsity, [values[v] for v in o.values])
        replay_guards(tape, builder, values)
        return builder.build(tape.function)

    def _combine(self, builder: Builder, refs: list[Ref | None], kind: Op, terms: Sequence[_Term]) -> Ref:
        """Write a sum or product; several constants become one, the first factor or the last term."""
        operate, is_constant = builder.add if kind is ADD else builder.mul, self.is_constant
        fixed = [self._refer(operate, refs, term) for term in terms if is_constant[term[0]]]
        if len(fixed) < 2:
            return reduce(operate, (self._refer(operate, refs, term) for term in terms))  # a pair where its turn comes
        rest, together = [term for term in terms if not is_constant[term[0]]], reduce(operate, fixed)
        varying = [self._refer(operate, refs, term) for term in rest]
        return reduce(operate, (*varying, together) if kind is ADD else (together, *varying))

    def _refer(self, operate: Callable[[Ref, Ref], Ref], refs: list[Ref | None], term: _Term) -> Ref:
        """Refer to a term; write a pair where it is first asked for."""
        value, sign = term
        known = refs[value]
        if known is None:
            known = refs[value] = reduce(operate, [self._refer(operate, refs, x) for x in self.pairs[value][1:]])
        return sign * known


def _cancel(terms: list[_Term]) -> list[_Term]:
    """Leave out of a sum what it adds and subtracts; a sum without terms is left as it is."""
    values = {x for x, _ in terms}
    if len(values) == len(terms):
        return terms
    rest: list[_Term] = []
    for x, sign in terms:
        if (x, -sign) in rest:
            rest.remove((x, -sign))
        else:
            rest.append((x, sign))
    return rest or terms


def _end(ready: Sequence[int], step: int) -> int:
    """Return the clock at which a sum is complete, by the clocks at which its terms are ready."""
    clock = ready[0]
    for other in ready[1:]:
        clock = max(clock, other) + step
    return clock


def _replace(terms: list[_Term], pair: _Pair, shared: int) -> None:
    """Put the value of a pair in its place: where its first term stands, with the sign of this term."""
    a, b, sign = pair
    first, second = next(
        (i, j)
        for i, x in enumerate(terms)
        for j, y in enumerate(terms)
        if i != j and x[0] == a and y[0] == b and x[1] * y[1] == sign
    )
    terms[first] = (shared, terms[first][1])
    del terms[second]
