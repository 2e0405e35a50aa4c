"""Brackets: a sum that several sums have as a factor is computed once.

Both x y a + x y b and z a + z b are products with the bracket a + b. `factoring` looks at products of one sum, as they
are written; here products are taken apart down to their factors, also products that have more uses, and the brackets of
all sums are compared (kernels, in the sense of Brayton and McMullen, 1982, of two terms). A bracket is taken out where
this lowers the number of operations.
"""

from __future__ import annotations

from collections.abc import Iterator, Set
from functools import reduce
from itertools import combinations

from mbsgen.roles import Role
from mbsgen.tape.builder import Builder, Scalar
from mbsgen.tape.counts import count_uses
from mbsgen.tape.replay import count_varying, declare_inputs, find_constants, leaves, replay_guards
from mbsgen.tape.sums import SUMS, find_inner, list_terms
from mbsgen.tape.types import Op, Tape
from mbsgen.tape.writer import Ref

MOST_TERMS = 16  # of a sum that is looked at
MOST_FACTORS = 10  # of a product
TRIED = 24  # brackets for one tape

_Product = tuple[int, ...]  # factors, ascending
_Bracket = tuple[_Product, _Product, int]  # two products in order, and the product of their signs
_Place = tuple[int, int, int]  # a sum, and two of its terms


def take_brackets(tape: Tape, constant: Set[Role] = frozenset()) -> Tape:
    """Take out brackets that several sums share; inputs of the roles `constant` count as constants."""
    fewest, refused = count_varying(tape, constant), 0
    while refused < TRIED:
        found = _Brackets(tape, constant)
        for places in found.list_shared()[refused:TRIED]:
            trial = found.write(places)
            count = count_varying(trial, constant)
            if count < fewest:
                tape, fewest = trial, count
                break
            refused += 1
        else:
            return tape
    return tape


class _Brackets:
    def __init__(self, tape: Tape, constant: Set[Role]) -> None:
        self.tape, self.first, self.uses = tape, tape.first_operation, count_uses(tape)
        self.is_constant = find_constants(tape, constant)
        self.sums: dict[int, list[tuple[int, int]]] = {}  # terms and their signs, of sums that no sum continues
        self.inner = find_inner(tape, self.is_constant, SUMS)
        several = [v for v, (op, _, _) in enumerate(tape.operations, self.first) if op is Op.MUL and self.uses[v] > 1]
        taken = {self._take_apart(v): v for v in several if not self.is_constant[v]}
        self.products = sorted(taken.items(), key=lambda found: (-len(found[0]), found))  # with several uses
        for value, (op, _, _) in enumerate(tape.operations, self.first):
            if op in (Op.ADD, Op.SUB) and value not in self.inner and not self.is_constant[value]:
                terms = list_terms(tape, value, self.inner)
                if len(terms) <= MOST_TERMS:
                    self.sums[value] = terms

    def _take_apart(self, value: int) -> _Product:
        """List the factors of a product; of another value, itself."""
        factors, waiting = [], [value]
        while waiting:
            place = waiting.pop()
            op, a, b = self.tape.operations[place - self.first] if place >= self.first else (Op.ADD, 0, 0)
            if op is Op.MUL and not self.is_constant[place]:
                waiting += [a, b]
            else:
                factors.append(place)
        return tuple(sorted(factors)) if len(factors) <= MOST_FACTORS else (value,)

    def list_shared(self) -> list[list[_Place]]:
        """List the places of each bracket that has several, most places first."""
        places: dict[_Bracket, list[_Place]] = {}
        for value, terms in self.sums.items():
            products = [self._take_apart(x) for x, _ in terms]
            for i, j in combinations(range(len(terms)), 2):
                for bracket in self._find_bracket(products[i], products[j], terms[i][1] * terms[j][1]):
                    places.setdefault(bracket, []).append((value, i, j))
        shared = [found for found in places.values() if len({value for value, _, _ in found}) > 1]
        return sorted(shared, key=lambda found: (-len(found), found))

    def _find_bracket(self, one: _Product, other: _Product, sign: int) -> Iterator[_Bracket]:
        """Find the rest of two products without their common factors; at least a factor each."""
        rest, left = _subtract(one, other), _subtract(other, one)
        if rest and left and not all(self.is_constant[x] for x in (*rest, *left)):
            yield (rest, left, sign) if rest <= left else (left, rest, sign)

    def write(self, places: list[_Place]) -> Tape:
        """Write the tape with a bracket taken out of sums, once of each."""
        chosen = {value: (i, j) for value, i, j in reversed(places)}
        tape, builder = self.tape, Builder()
        refs = [x.ref for x in leaves(tape, builder, declare_inputs(tape, builder))]
        for value, (op, a, b) in enumerate(tape.operations, self.first):
            if value in chosen:
                refs.append(self._write_sum(builder, refs, value, *chosen[value]))
            else:
                refs.append(builder.operate(op, refs[a], refs[b] if b >= 0 else 0))
        values = [Scalar(builder, ref) for ref in refs]
        labelled = [(v, text) for v, text in sorted(tape.labels.items()) if v not in self.inner]
        builder.label([values[v] for v, _ in labelled], [text for _, text in labelled])
        for o in tape.outputs:
            builder.output(o.port, o.sparsity, [values[v] for v in o.values])
        replay_guards(tape, builder, values)
        return builder.build(tape.function)

    def _write_sum(self, builder: Builder, refs: list[Ref], value: int, i: int, j: int) -> Ref:
        terms = self.sums[value]
        one, other = self._take_apart(terms[i][0]), self._take_apart(terms[j][0])
        rest, left = _subtract(one, other), _subtract(other, one)
        common, signs = _subtract(one, rest), (terms[i][1], terms[j][1])
        if rest > left:
            rest, left, signs = left, rest, signs[::-1]
        first, second = (self._multiply(builder, refs, x) for x in (rest, left))
        bracket = builder.add(first, second * signs[0] * signs[1])
        whole = builder.mul(self._multiply(builder, refs, common), bracket) if common else bracket
        others = [refs[x] * s for k, (x, s) in enumerate(terms) if k not in (i, j)]
        return reduce(builder.add, [*others, whole * signs[0]])

    def _multiply(self, builder: Builder, refs: list[Ref], factors: _Product) -> Ref:
        """Multiply factors, constants first; products of some of them that have other uses are there already."""
        kept: list[int] = []
        for product, value in self.products:
            while value < len(refs) and len(product) <= len(factors) and not _subtract(product, factors):
                factors = _subtract(factors, product)
                kept.append(value)
        ordered = sorted(factors, key=lambda x: (not self.is_constant[x], x))
        return reduce(builder.mul, (refs[x] for x in (*ordered, *kept)))


def _subtract(one: _Product, other: _Product) -> _Product:
    """Leave out of one product the factors of another, each as often as it is there."""
    rest = list(one)
    for x in other:
        if x in rest:
            rest.remove(x)
    return tuple(rest)
