"""Brackets: a sum that several sums have as a factor is computed once.

Both x y a + x y b and z a + z b are products with the bracket a + b. `factoring` looks at products of one sum, as they
are written; here products are taken apart down to their factors, also products that have more uses, and the brackets of
all sums are compared (kernels, in the sense of Brayton and McMullen, 1982, of two terms). A bracket is taken out where
this lowers the number of operations.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence, Set
from functools import partial, reduce
from itertools import combinations

from mbsgen.roles import Role
from mbsgen.tape.draft import Changes, Draft
from mbsgen.tape.references import Arithmetic
from mbsgen.tape.replay import count_varying
from mbsgen.tape.types import ADD, MUL, SUB, Tape
from mbsgen.tape.writer import Ref

MOST_TERMS = 16  # of a sum that is looked at
MOST_FACTORS = 10  # of a product
TRIED = 24  # brackets for one tape

_SUMS = frozenset({ADD, SUB})
_Product = tuple[int, ...]  # factors, ascending
_Bracket = tuple[_Product, _Product, int]  # two products in order, and the product of their signs
_Place = tuple[int, int, int]  # a sum, and two of its terms


def take_brackets(tape: Tape, constant: Set[Role] = frozenset()) -> Tape:
    """Take out brackets that several sums share; inputs of the roles `constant` count as constants."""
    fewest, refused = count_varying(tape, constant), 0
    found = _Brackets(tape, constant)
    while refused < TRIED:
        draft = found.draft
        for places in found.list_shared()[refused:TRIED]:
            count = found.take(places, fewest)
            if count < fewest:
                fewest = count
                break
            refused += 1
            if found.draft is not draft:  # it has other numbers
                break
        else:
            break
    return found.draft.build()


class _Brackets:
    """The brackets of a tape, and where they are."""

    def __init__(self, tape: Tape, constant: Set[Role]) -> None:
        self.constant = constant
        self._begin(Draft(tape, constant))

    def _begin(self, draft: Draft) -> None:
        self.draft = draft
        self.sums: dict[int, list[tuple[int, int]]] = {}  # terms and their signs, of sums that no sum continues
        self.places: dict[_Bracket, dict[int, list[_Place]]] = {}  # by sum
        self.shared: set[_Bracket] = set()  # brackets of several sums
        self.found: dict[int, list[_Bracket]] = {}  # by sum
        self.products: dict[int, _Product] = {}  # with several uses
        self.values: dict[_Product, set[int]] = {}  # of products with several uses
        self.holding: dict[int, set[_Product]] = {}  # such products, by their first factor
        self.factors: dict[int, _Product] = {}
        kinds = [(value, draft.operations[value][0]) for value in draft.order]
        for value, op in kinds:
            if op is MUL and draft.count_uses(value) > 1:
                self._list_product(value)
        for value, op in kinds:
            if op in _SUMS and not draft.is_inner(value):
                self._list_sum(value)

    # -- a change -------------------------------------------------------------------------------------------------

    def list_shared(self) -> list[list[_Place]]:
        """List the places of each bracket that has several, most places first."""
        places = (self.places[bracket] for bracket in self.shared)
        shared = [[place for value in sorted(found) for place in found[value]] for found in places]
        return sorted(shared, key=lambda found: (-len(found), found))

    def take(self, places: Sequence[_Place], fewest: int) -> int:
        """Take a bracket out of sums, once of each, if this leaves fewer operations; return how many these are."""
        chosen = {value: (i, j) for value, i, j in reversed(places)}
        count = self.draft.attempt(chosen, partial(self._write_chosen, chosen), fewest)
        if count is None:
            return self._take_wholly(places, fewest)
        if count < fewest:
            self._update(self.draft.accept())
        else:
            self.draft.undo()
        return count

    def _take_wholly(self, places: Sequence[_Place], fewest: int) -> int:
        """Take out a bracket by writing the whole tape again, which gives other numbers."""
        if self.draft.is_changed:
            k = self.list_shared().index([*places])
            self._begin(Draft(self.draft.build(), self.constant))
            return self.take(self.list_shared()[k], fewest)
        chosen = {value: (i, j) for value, i, j in reversed(places)}
        tape = self.draft.write(chosen, partial(self._write_chosen, chosen))
        count = count_varying(tape, self.constant)
        if count < fewest:
            self._begin(Draft(tape, self.constant))
        return count

    def _update(self, changes: Changes) -> None:
        """List what changed."""
        stale = self._find_stale(changes)
        changed = sorted(stale | changes.recounted)
        for value in changed:
            self._list_product(value)
        found = {value for value in changed if value in self.sums}
        for value in changed:
            op = self.draft.operations.get(value, (None,))[0]
            if op in _SUMS:  # it may have become a part of another one, or be one no more
                found.add(self._find_whole(value))
            if op in _SUMS or (op is MUL and value in stale):
                found.update(self._find_whole(x) for x in self.draft.users.get(value, ()))
        for value in sorted(found):
            self._list_sum(value)

    def _find_stale(self, changes: Changes) -> set[int]:
        """Find the values that changed, and the products that have factors of these: other values are one factor."""
        operations, users = self.draft.operations, self.draft.users
        stale = set(changes.written)
        waiting = [x for x in stale if x in operations and operations[x][0] is MUL]
        while waiting:
            for user in users.get(waiting.pop(), ()):
                if operations[user][0] is MUL and user not in stale:
                    stale.add(user)
                    waiting.append(user)
        for value in stale:
            self.factors.pop(value, None)
        return stale

    def _find_whole(self, value: int) -> int:
        """Find the sum that a value is a part of."""
        while self.draft.is_inner(value):
            value = next(iter(self.draft.users[value]))
        return value

    # -- lists ----------------------------------------------------------------------------------------------------

    def _list_product(self, value: int) -> None:
        """List a product if it has several uses."""
        draft = self.draft
        known = self.products.pop(value, None)
        if known is not None:
            self.values[known].remove(value)
            if not self.values[known]:
                del self.values[known]
                self.holding[known[0]].remove(known)
        kind = draft.operations.get(value, (None,))[0]
        if kind is MUL and not draft.is_constant[value] and draft.count_uses(value) > 1:
            product = self.products[value] = self._take_apart(value)
            self.values.setdefault(product, set()).add(value)
            self.holding.setdefault(product[0], set()).add(product)

    def _list_sum(self, value: int) -> None:
        """List the terms and brackets of a sum that no sum continues."""
        draft = self.draft
        self.sums.pop(value, None)
        for bracket in self.found.pop(value, ()):
            places = self.places[bracket]
            del places[value]
            if len(places) == 1:
                self.shared.remove(bracket)
            elif not places:
                del self.places[bracket]
        if draft.operations.get(value, (None,))[0] not in _SUMS or draft.is_constant[value] or draft.is_inner(value):
            return
        terms = self._list_terms(value)
        if len(terms) > MOST_TERMS:
            return
        self.sums[value] = terms
        found, everywhere = self.found.setdefault(value, []), self.places
        for bracket, i, j in self._find_brackets(terms):
            known = everywhere.get(bracket)
            if known is None:
                everywhere[bracket] = {value: [(value, i, j)]}
                found.append(bracket)
            elif value in known:
                known[value].append((value, i, j))
            else:
                known[value] = [(value, i, j)]
                found.append(bracket)
                self.shared.add(bracket)

    def _find_brackets(self, terms: Sequence[tuple[int, int]]) -> Iterator[tuple[_Bracket, int, int]]:
        """Find the rests of each two products without their common factors, at least a factor each; and the two."""
        products, is_constant = [self._take_apart(x) for x, _ in terms], self.draft.is_constant
        are_constant = [all(map(is_constant.__getitem__, product)) for product in products]
        factors = [*map(set, products)]
        for i, j in combinations(range(len(terms)), 2):
            rest, left = products[i], products[j]
            if factors[i].isdisjoint(left):
                is_fixed = are_constant[i] and are_constant[j]
            else:
                rest, left = _subtract(rest, left), _subtract(left, rest)
                is_fixed = not rest or not left or all(map(is_constant.__getitem__, (*rest, *left)))
            if not is_fixed:
                sign = terms[i][1] * terms[j][1]
                yield ((rest, left, sign) if rest <= left else (left, rest, sign)), i, j

    def _list_terms(self, value: int) -> list[tuple[int, int]]:
        """List the terms of a whole sum with their signs, from left to right."""
        draft, terms, waiting = self.draft, list[tuple[int, int]](), [(value, 1)]
        while waiting:
            place, sign = waiting.pop()
            if place == value or draft.is_inner(place):
                op, a, b = draft.operations[place]
                waiting += [(b, -sign if op is SUB else sign), (a, sign)]
            else:
                terms.append((place, sign))
        return terms

    def _take_apart(self, value: int) -> _Product:
        """List the factors of a product; of another value, itself."""
        known = self.factors.get(value)
        if known is None:
            found, factors = self.draft.operations.get(value), [value]
            if found is not None and found[0] is MUL:
                factors = self._list_factors(value)
            known = self.factors[value] = tuple(sorted(factors)) if len(factors) <= MOST_FACTORS else (value,)
        return known

    def _list_factors(self, value: int) -> list[int]:
        operations, is_constant = self.draft.operations, self.draft.is_constant
        factors, waiting = [], [value]
        while waiting:
            place = waiting.pop()
            found = operations.get(place)
            if found is not None and found[0] is MUL and not is_constant[place]:
                waiting += found[1:]
            else:
                factors.append(place)
        return factors

    # -- a sum that is written anew -------------------------------------------------------------------------------

    def _write_chosen(
        self,
        chosen: dict[int, tuple[int, int]],
        arithmetic: Arithmetic,
        refer: Callable[[int], Ref],
        value: int,
    ) -> Ref:
        """Write a sum with a bracket taken out of two of its terms."""
        (i, j), terms = chosen[value], self.sums[value]
        one, other = self._take_apart(terms[i][0]), self._take_apart(terms[j][0])
        rest, left = _subtract(one, other), _subtract(other, one)
        common, signs = _subtract(one, rest), (terms[i][1], terms[j][1])
        rank = self._rank(rest, left)
        if sorted(map(rank, rest)) > sorted(map(rank, left)):
            rest, left, signs = left, rest, signs[::-1]
        multiply = partial(self._multiply, arithmetic, refer, value)
        first, second = multiply(rest), multiply(left)
        bracket = arithmetic.add(first, second * signs[0] * signs[1])
        whole = arithmetic.mul(multiply(common), bracket) if common else bracket
        others = [refer(x) * s for k, (x, s) in enumerate(terms) if k not in (i, j)]
        return reduce(arithmetic.add, [*others, whole * signs[0]])

    def _multiply(self, arithmetic: Arithmetic, refer: Callable[[int], Ref], before: int, factors: _Product) -> Ref:
        """Multiply factors, constants first; products of some of them that have other uses are there already."""
        rank, kept = self._rank(factors), list[int]()
        for product, value in self._list_within(factors, rank):
            while value < before and len(product) <= len(factors) and not _subtract(product, factors):
                factors = _subtract(factors, product)
                kept.append(value)
        ordered = sorted(factors, key=lambda x: (not self.draft.is_constant[x], rank(x)))
        return reduce(arithmetic.mul, map(refer, (*ordered, *kept)))

    def _list_within(self, factors: _Product, rank: Callable[[int], tuple[int, int]]) -> list[tuple[_Product, int]]:
        """List the products with several uses that may be a part of another one, with most factors first."""
        found = ((product, max(self.values[product])) for x in set(factors) for product in self.holding.get(x, ()))
        return sorted(found, key=lambda pair: (-len(pair[0]), sorted(map(rank, pair[0])), pair[1]))

    def _rank(self, *products: Sequence[int]) -> Callable[[int], tuple[int, int]]:
        """Return the order of factors in the tape."""
        if len({x for product in products for x in product if self.draft.is_literal(x)}) < 2:
            return lambda x: (abs(x), 0)
        return self.draft.rank


def _subtract(one: Iterable[int], other: Iterable[int]) -> _Product:
    """Leave out of one product the factors of another, each as often as it is there."""
    rest = list(one)
    for x in other:
        if x in rest:
            rest.remove(x)
    return tuple(rest)
