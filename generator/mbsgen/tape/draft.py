"""A tape that is changed in place: some values are written anew, and then only the operations that follow from them.

Writing a tape again takes time in proportion to its length; a draft takes time in proportion to a change. It keeps the
nodes of the tape's builder with their uses, the sign with which each is stored, and the operation that is stored. So a
change gives the same tape as a builder that writes all of it again. A number of a value is its place in the order of
the tape, with room between neighbours for the values of a change.

A draft follows a tape that a builder writes again as it is, as the tapes of builders mostly are. Where a change would
reach further, such as to a pivot, `attempt` returns None, and the tape has to be written again.
"""

from __future__ import annotations

from bisect import bisect_left, insort
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Set
from dataclasses import dataclass, replace
from heapq import heapify, heappop, heappush
from math import inf
from typing import Any, TypeVar

from mpmath import mpf

from mbsgen.roles import Role
from mbsgen.tape.builder import Builder, Scalar
from mbsgen.tape.counts import PAPER
from mbsgen.tape.references import OWN, Arithmetic, size_of
from mbsgen.tape.replay import count_varying, find_constants, replay_guards
from mbsgen.tape.types import ADD, DIV, EVEN, FUNCTIONS, MUL, NEG, ODD, SUB, Op, Operation, Tape
from mbsgen.tape.writer import Key, Ref, Result, Test, Writer, choose_turned

ROOM = 44  # bits between the numbers of neighbours
PART = 8  # of the room that is left, a new value takes one
OPERANDS = 2  # at most

Write = Callable[[Arithmetic, Callable[[int], Ref], int], Ref]  # writes a value anew, given how values are referred to
_SUMS = frozenset({ADD, SUB})
_ASKING = frozenset(FUNCTIONS) - ODD - EVEN  # functions that need their operands' signs; others take values as stored

# what `_follow` replaces
_FOLLOWED = (
    *("operations", "users", "_roots", "_root_uses", "_counts", "_order", "_kept", "_varying", "_labels", "_asking"),
)

T = TypeVar("T")


class _FurtherError(Exception):
    """A change reaches further than a draft follows."""


@dataclass(frozen=True)
class Changes:
    """The numbers of values that a change made, removed or wrote anew, and of values whose number of uses changed."""

    written: Set[int]
    recounted: Set[int]


class Draft(Arithmetic):
    """The values of a tape by number; a literal by the number of its size, with its sign."""

    def __init__(self, tape: Tape, constant: Set[Role]) -> None:
        super().__init__(number=False)
        self.tape = tape
        self.operations: dict[int, Operation] = {}  # as they are stored; 0 is no operand, -n is n with another sign
        self.users: dict[int, dict[int, int]] = {}  # of each value, and how often they use it
        self.is_constant: dict[int, bool] = {0: True}
        self._nodes: dict[int, Key | mpf | None] = {}
        self._bases: dict[int, int] = {}
        self._counts: dict[int, int] = {}  # of uses by operations, outputs and guards
        self._asking: dict[int, None] = {}  # functions that need their operands with their signs
        self._floor = tape.first_literal << ROOM  # literals come behind it
        self._next_literal = self._floor + 1
        self._is_settled: bool | None = None
        self._journal: list[tuple[dict[Any, Any], Any, Any]] = []  # what a change replaced
        self._numbers = [*self._number_leaves()]
        fixed = find_constants(tape, constant)
        for value, (op, a, b) in enumerate(tape.operations, tape.first_operation):
            number = (value + 1) << ROOM
            self._numbers.append(number)
            self.operations[number] = op, self._numbers[a], self._numbers[b] if b >= 0 else 0
        for number, is_fixed in zip(self._numbers, fixed, strict=True):
            self.is_constant[number] = is_fixed
            if self._bases.get(abs(number)) == 0:
                self.is_constant[abs(number)] = True
        self._order = [*self.operations]
        self._roots = {k: self._numbers[value] for k, value in enumerate(_list_roots(tape))}
        self._first_test = len(self._roots) - 2 * len(tape.guards)
        self._early = {self._first_test + 2 * k + x for k, g in enumerate(tape.guards) for x in (0, 1) if g.early}
        self._signed = {k for k in self._roots if not self._is_pivot(k)}  # these need their sign
        self._root_uses: dict[int, set[int]] = {}
        self._count_all()
        self._kept: dict[int, int] = dict.fromkeys(self._numbers, 1)  # the sign with which a node is stored
        self._ranks = {x: place for place, x in enumerate(self._numbers[tape.first_literal : tape.first_operation])}
        self._labels = {self._numbers[value]: text for value, text in tape.labels.items()}
        self._carried: list[tuple[Ref, str]] | None = None
        self.is_changed = False
        self._varying = count_varying(tape, constant)

    def _number_leaves(self) -> Iterator[int]:
        for value in range(self.tape.first_literal):
            number = (value + 1) << ROOM
            self._nodes[number], self._bases[number] = None, number
            yield number
        for x in self.tape.literals:
            if x:
                yield self.literal(x)
            else:
                yield self._new(x, 0)

    def _leave_turned(self, turned: Mapping[int, int]) -> None:
        """Count the uses of values with another sign as uses of the values."""
        self._counts, self.users = dict(self._counts), dict(self.users)
        self._root_uses = dict(self._root_uses)
        for number, value in turned.items():
            roots = self._root_uses.pop(number, set())
            self._root_uses[value] = self._root_uses.get(value, set()) | roots
            self._counts[value] += self._counts.pop(number, 0) - 1
            users = {user: n for user, n in self.users[value].items() if user != number}
            for user, n in self.users.pop(number, {}).items():
                users[user] = users.get(user, 0) + n
            self.users[value] = users

    def _is_pivot(self, k: int) -> bool:
        return k >= self._first_test and not (k - self._first_test) % 2

    def _count_all(self) -> None:
        counts, users = self._counts, self.users
        for number, (_, a, b) in self.operations.items():
            for operand in (a, b) if b else (a,):
                if x := abs(operand):
                    counts[x] = counts.get(x, 0) + 1
                    own = users.get(x)
                    if own is None:
                        users[x] = {number: 1}
                    else:
                        own[number] = own.get(number, 0) + 1
        for k, ref in self._roots.items():
            counts[abs(ref)] = counts.get(abs(ref), 0) + 1
            self._root_uses.setdefault(abs(ref), set()).add(k)

    # -- what a reader of the values asks for -------------------------------------------------------------------

    @property
    def order(self) -> Collection[int]:
        """List the values of operations in order."""
        return self._order

    def is_literal(self, number: int) -> bool:
        """Return whether a number is a literal's."""
        return self._bases.get(abs(number)) == 0

    def count_uses(self, number: int) -> int:
        """Count the uses of a stored value by operations, a change of its sign among them, outputs and guards."""
        count, turned = self._counts.get(number, 0), 0
        if count < 2:  # a change of its sign is one of them
            return count
        if self._asking and (asking := self.users.get(number, {}).keys() & self._asking.keys()):
            turned = sum(self.operations[user].count(-number) for user in asking)
        if roots := self._root_uses.get(number, ()):
            kept = number * self._kept[number]
            turned += sum(k in self._signed and self._roots[k] != kept for k in roots)
        return count - turned + bool(turned)

    def is_inner(self, number: int) -> bool:
        """Return whether a value is a sum that is written only as part of another sum."""
        found = self.operations.get(number)
        if found is None or found[0] not in _SUMS or self.is_constant[number] or self._counts.get(number) != 1:
            return False
        user = next(iter(self.users.get(number, ())), 0)
        return bool(user) and self.operations[user][0] in _SUMS

    def rank(self, number: int) -> tuple[int, int]:
        """Return a number's place in the order of the tape; literals have the order of their first uses."""
        if self._bases.get(abs(number)) != 0:
            return number, 0
        if not self.is_changed:
            return self._floor + 1, self._ranks[number]
        user = min(user for user in self.users[abs(number)] if number in self.operations[user][1:])
        return self._floor + 1, 2 * user + (number != self.operations[user][1])

    # -- a change -----------------------------------------------------------------------------------------------

    def attempt(self, chosen: Collection[int], write: Write, fewest: float = inf) -> int | None:
        """Write some values anew; return the number of operations that are not on constants alone.

        A number that is not below `fewest` is a lower bound, and `undo` has to follow; otherwise `accept` or `undo`.
        Returns None, with nothing changed, where a draft does not follow.
        """
        if self._is_settled is None:
            self._is_settled = self._settle()
        if not self._is_settled:
            return None
        if self._carried is None:
            self._carried = self._carry_labels()
        self._before = self._varying
        self._refs: dict[int, Ref] = {}  # of values whose reference changed
        self._old: dict[int, Key] = {}  # what values were that are written anew, or again
        self._made: set[int] = set()
        self._fresh: set[int] = set()  # literals
        self._born: set[int] = set()
        self._dead: set[int] = set()
        self._restored: set[int] = set()  # values whose stored operation changed
        self._touched: set[int] = set()
        try:
            self._spread(chosen, write)
            self._recount()
        except _FurtherError:
            self.undo()
            return None
        if self._varying >= fewest:  # changes of signs would be more
            return self._varying
        self._named = self._name_again(self._carried)
        self._store_signs()
        return self._varying + self._count_signs()

    def _carry_labels(self) -> list[tuple[Ref, str]]:
        """List the labels that a builder takes from this tape, by values with their signs, in the order of the tape."""
        if not self._labels:
            return []
        asked: list[tuple[tuple[float, int], Ref]] = [((inf, k), self._roots[k]) for k in self._signed]
        asked += [((number, k), ref) for number in self._asking for k, ref in enumerate(self._list_operands(number))]
        places = {ref: place for place, ref in sorted(asked, reverse=True)}  # a sign is changed before its first use
        places |= {ref: (abs(ref), OPERANDS) for ref in self._labels if ref == self._kept[abs(ref)] * abs(ref)}
        ordered = sorted(self._labels, key=places.__getitem__)
        return [(ref, self._labels[ref]) for ref in ordered if not self.is_inner(abs(ref))]

    def _name_again(self, carried: Iterable[tuple[Ref, str]]) -> dict[int, str]:
        """Label nodes by the values that a change leaves or writes anew."""
        labels: dict[int, str] = {}
        for ref, text in carried:
            number = abs(ref)
            now = self._refs.get(number)
            found = ref if now is None else now if ref == self._kept[number] * number else -now
            if found > 0:
                labels.setdefault(found, text)
        return labels

    def undo(self) -> None:
        """Take a change back."""
        for number in self._fresh:
            del self._literals[size_of(self._nodes[number])]
            self._one = OWN if number == self._one else self._one
        for kept, key, value in reversed(self._journal):
            if value is _MISSING:
                del kept[key]
            else:
                kept[key] = value
        self._journal.clear()
        self._varying = self._before

    def accept(self) -> Changes:
        """Keep a change."""
        self._journal.clear()
        dead, born = self._dead, self._born - self._dead
        wanted = self._find_asked()
        labels = {x: text for x, text in self._named.items() if x not in dead and (self._kept[x] > 0 or x in wanted)}
        self._labels, self._carried, self._turned = labels, None, self._now_turned
        for number in born:
            insort(self._order, number)
        for number in dead:
            self._forget(number)
        for number in self._made - born - dead - set(self._old):  # no value needed them
            self._forget(number)
        gone = [x for x in self._literals.values() if not self._counts.get(x)]
        for number in gone:
            del self._literals[size_of(self._nodes.pop(number))], self._bases[number]
            self._one = OWN if number == self._one else self._one
        self.is_changed = True
        return Changes(born | dead | self._restored, self._touched)

    def _forget(self, number: int) -> None:
        key = self._nodes.pop(number)
        assert isinstance(key, tuple)
        if self._places.get(key) == number:
            del self._places[key]
        for kept in (self._bases, self._counts, self._kept, self.operations, self.users, self.is_constant):
            kept.pop(number, None)
        place = bisect_left(self._order, number)
        if place < len(self._order) and self._order[place] == number:
            del self._order[place]

    def _set(self, kept: dict[Any, T], key: object, value: T) -> None:
        if self._is_settled:  # there is no way back from the beginning
            self._journal.append((kept, key, kept.get(key, _MISSING)))
        kept[key] = value

    def _delete(self, kept: dict[Any, Any], key: object) -> None:
        self._journal.append((kept, key, kept.pop(key)))

    # -- which values are written ---------------------------------------------------------------------------------

    def refer(self, number: int) -> Ref:
        """Refer to a stored value in a change."""
        ref = self._refs.get(number)
        if ref is not None:
            return ref
        return number if self._bases[abs(number)] == 0 else self._kept[number] * number

    def _refer_signed(self, operand: int) -> Ref:
        """Refer to an operand as it is stored."""
        return self.refer(operand) if operand > 0 else -self.refer(-operand) if operand else 0

    def _spread(self, chosen: Collection[int], write: Write) -> None:
        """Write the chosen values anew, and then, in order, the values whose operands became others."""
        self._waiting: list[int] = []
        for number in chosen:
            self._unlink(number)
        heapify(self._waiting)
        wanted = set(chosen)
        while self._waiting:
            number = self._here = heappop(self._waiting)
            self._made_here: list[int] = []
            if number in wanted:
                self._slot = 0
                place = bisect_left(self._order, number)
                self._low = self._order[place - 1] if place else self._floor + (1 << (ROOM - 1))
                ref = self._move_last(number, write(self, self.refer, number))
            else:
                self._slot = number
                op, a, b = self.operations[number]
                ref = self.operate(op, self._refer_signed(a), self._refer_signed(b))
            if not ref or self._bases[abs(ref)] == 0:
                raise _FurtherError
            folds = number in self._made and self._bases[number] != number  # products with it gather its literal
            if folds or ref != self._kept[number] * number:
                self._refs[number] = ref
                for user in self.users.get(number, ()):
                    self._unlink(user)

    def _unlink(self, number: int) -> None:
        """Mark a value to be written again; until then it is not found."""
        if number not in self._old:
            key = self._nodes[number]
            assert isinstance(key, tuple)
            self._old[number] = key
            if self._places.get(key) == number:
                self._delete(self._places, key)
            heappush(self._waiting, number)

    def _new(self, key: Key | mpf, base: int = OWN) -> Ref:
        """Find a node that is written already, or write it here, also one that was written later."""
        if not isinstance(key, tuple):
            number = self._next_literal
            self._next_literal += 1
            if self._is_settled:
                self._fresh.add(number)
            self._set(self._nodes, number, key)
            self._set(self._bases, number, 0)
            self._set(self.is_constant, number, True)
            self._set(self.is_constant, -number, True)
            return number
        known = self._places.get(key)
        if known is not None:
            if known <= self._here:
                return known
            self._unlink(known)
        if not self._is_settled:
            return self._store_first(key, base)
        op, a, b = key
        if self._fresh and op in _SUMS and not self._fresh.isdisjoint((abs(a), abs(b))):
            raise _FurtherError  # a tape lists its literals first, so that this sum would be in another order
        number = self._slot or self._take_room()
        if number in self._made:
            raise _FurtherError
        self._set(self._nodes, number, key)
        self._set(self._bases, number, number if base == OWN else base)
        self._set(self._places, key, number)
        self._set(self.is_constant, number, self.is_constant[abs(a)] and (not b or self.is_constant[abs(b)]))
        self._made.add(number)
        self._made_here.append(number)
        return number

    def _store_first(self, key: Key, base: int) -> int:
        """Write the node of a value of the tape."""
        number = self._slot
        if number in self._made:
            raise _FurtherError
        self._nodes[number], self._places[key] = key, number
        self._bases[number] = number if base == OWN else base
        self._made.add(number)
        return number

    def _take_room(self) -> int:
        step = (self._here - self._low) // PART
        if not step:
            raise _FurtherError
        self._low += step
        return self._low

    def _move_last(self, number: int, ref: Ref) -> Ref:
        """Number the result of a chosen value as the value, where it is a node that was written for it."""
        last = abs(ref)
        if not self._made_here or last != self._made_here[-1]:
            return ref
        key = self._nodes[last]
        assert isinstance(key, tuple)
        base = self._bases[last]
        self._set(self._nodes, number, key)
        self._set(self._bases, number, number if base == last else base)
        self._set(self._places, key, number)
        if self.is_constant[last] is not self.is_constant[number]:
            raise _FurtherError
        for kept in (self._nodes, self._bases, self.is_constant):
            self._delete(kept, last)
        self._made.remove(last)
        self._made.add(number)
        return number if ref > 0 else -number

    # -- which values are needed ------------------------------------------------------------------------------------

    def _recount(self) -> None:
        again = sorted(self._old.keys() & self._made)
        for number in again:
            key = self._nodes[number]
            assert isinstance(key, tuple)
            if (key[0] in PAPER) is not (self._old[number][0] in PAPER):
                raise _FurtherError
            self._take_operands(number, key)
        moved = []
        for number, ref in self._refs.items():
            for k in sorted(self._root_uses.get(number, ())):
                if k in self._early:
                    raise _FurtherError
                self._set(self._roots, k, ref if self._roots[k] == self._kept[number] * number else -ref)
                self._touched.add(number)
                if abs(ref) != number:
                    self._take(abs(ref), 0)
                    self._move_root(k, number, abs(ref))
                    moved.append(number)
        for number in again:
            self._leave_operands(number, self._old[number])
        for number in moved:
            self._leave(number, 0)

    def _move_root(self, k: int, number: int, other: int) -> None:
        self._set(self._root_uses, number, self._root_uses[number] - {k})
        self._set(self._root_uses, other, self._root_uses.get(other, set()) | {k})

    def _take_operands(self, number: int, key: Key) -> None:
        for x in key[1:]:
            if x:
                self._take(abs(x), number)

    def _take(self, number: int, user: int) -> None:
        """Count a use by an operation, or, with user 0, by an output."""
        count = self._counts.get(number, 0)
        self._set(self._counts, number, count + 1)
        self._touched.add(number)
        if user:
            users = self.users.get(number)
            if users is None:
                users = {}
                self._set(self.users, number, users)
            self._set(users, user, users.get(user, 0) + 1)
        key = self._nodes[number]
        if not count and isinstance(key, tuple):
            self._born.add(number)
            self._varying += key[0] in PAPER and not self.is_constant[number]
            self._take_operands(number, key)

    def _leave(self, number: int, user: int) -> None:
        count = self._counts[number] - 1
        self._set(self._counts, number, count)
        self._touched.add(number)
        if user:
            users = self.users[number]
            if users[user] > 1:
                self._set(users, user, users[user] - 1)
            else:
                self._delete(users, user)
        key = self._nodes[number]
        if not count and isinstance(key, tuple):
            self._dead.add(number)
            self._varying -= key[0] in PAPER and not self.is_constant[number]
            self._leave_operands(number, key)

    def _leave_operands(self, number: int, key: Key) -> None:
        for x in key[1:]:
            if x:
                self._leave(abs(x), number)

    # -- the signs with which they are stored -------------------------------------------------------------------------

    def _find_turned(self) -> set[int]:
        wanted = {ref for k, ref in self._roots.items() if k < self._first_test}
        return choose_turned(wanted, self._nodes, self._count_node_uses, self.is_literal)

    def _count_node_uses(self, number: int) -> int:
        """Count the uses of a node as a builder does: by guards only where no output needs it."""
        count = self._counts.get(number, 0)
        if number not in self._root_uses:
            return count
        tests = self._count_tests(number)
        return count - tests if tests and self._is_shown(number) else count

    def _count_tests(self, number: int) -> int:
        return sum(k >= self._first_test for k in self._root_uses.get(number, ()))

    def _is_shown(self, number: int) -> bool:
        """Return whether an output needs a node."""
        waiting, done = [number], {number}
        while waiting:
            place = waiting.pop()
            if len(self._root_uses.get(place, ())) > self._count_tests(place):
                return True
            more = [x for x in self.users.get(place, ()) if x not in done]
            done.update(more)
            waiting += more
        return False

    def _store_signs(self) -> None:
        self._now_turned = self._find_turned()
        first = self._born | (self._old.keys() & self._made) | (self._now_turned ^ self._turned)
        waiting = [x for x in first - self._dead if x in self._nodes]
        self._list_asking(waiting)
        heapify(waiting)
        queued = set(waiting)
        while waiting:
            number = heappop(waiting)
            operation, kept = self._choose_sign(number)
            if self.operations.get(number) != operation:
                self._set(self.operations, number, operation)
                self._restored.add(number)
            if self._kept.get(number) != kept:
                self._set(self._kept, number, kept)
                self._touched.add(number)
                for user in self.users.get(number, ()):
                    if user not in queued:
                        queued.add(user)
                        heappush(waiting, user)

    def _list_asking(self, written: Iterable[int]) -> None:
        """List the functions that need their operands with their signs, after a change that wrote some values."""
        for number in self._dead & self._asking.keys():
            self._delete(self._asking, number)
        for number in written:
            key = self._nodes[number]
            if isinstance(key, tuple) and key[0] in _ASKING and number not in self._asking:
                self._set(self._asking, number, None)

    def _choose_sign(self, number: int) -> tuple[Operation, int]:
        """Return the operation that is stored for a node, and the sign of its result; see `Writer`."""
        key = self._nodes[number]
        assert isinstance(key, tuple)
        op, a, b = key
        sign = -1 if number in self._now_turned else 1
        if op is MUL or op is DIV:
            signs = [1 if self._bases[x] == 0 else self._kept[x] for x in (a, b)]
            if self._bases[a] == 0:
                return (op, sign * signs[1] * a, b), sign
            if self._bases[b] == 0:
                return (op, a, sign * signs[0] * b), sign
            return (op, a, b), signs[0] * signs[1]
        if op in _SUMS:
            one = sign * (1 if self._bases[a] == 0 else self._kept[a])
            other = sign * (1 if self._bases[b] == 0 else self._kept[b]) * (1 if op is ADD else -1)
            if one < 0 and other < 0:
                sign, one, other = -sign, 1, 1
            if one < 0:
                return (SUB, b, a), sign
            return (ADD if other > 0 else SUB, a, b), sign
        if op in _ASKING:
            return (op, self._turn_to_stored(a), self._turn_to_stored(b)), 1
        return (op, a, b), self._kept[a] if op in ODD else 1

    def _turn_to_stored(self, ref: Ref) -> int:
        return ref if not ref or self._bases[abs(ref)] == 0 else ref * self._kept[abs(ref)]

    def _find_asked(self) -> set[Ref]:
        """Find the values that are used with their signs, by outputs, guards and functions."""
        found = {self._roots[k] for k in self._signed}
        for number in self._asking:
            found.update(self._list_operands(number))
        found.discard(0)
        return found

    def _list_operands(self, number: int) -> tuple[Ref, Ref]:
        key = self._nodes[number]
        assert isinstance(key, tuple)
        return key[1:]

    def _count_signs(self) -> int:
        """Count the operations that change a sign."""
        return sum(
            self._bases[abs(ref)] != 0
            and (ref > 0) is not (self._kept[abs(ref)] > 0)
            and not self.is_constant[abs(ref)]
            for ref in self._find_asked()
        )

    # -- the beginning and the end ------------------------------------------------------------------------------------

    def _settle(self) -> bool:
        """Find the nodes of a builder that writes the tape again; return whether it would write the same tape."""
        self._places: dict[Key, int] = {}
        self._made, self._fresh, self._old, self._refs = set(), set(), {}, {}
        refs: dict[int, Ref] = {0: 0}
        for number in self._numbers[: self.tape.first_operation]:
            refs[number] = number if self._nodes[abs(number)] != 0 else 0
        for number, (op, a, b) in self.operations.items():
            ref = self._store_plain(number, op, refs[a], refs[b])
            if not ref:
                self._slot = self._here = number
                ref = self.operate(op, refs[a], refs[b])
            refs[number] = ref
            if abs(ref) != (a if op is NEG else number):
                break
        else:
            before = {name: self.__dict__[name] for name in _FOLLOWED}
            self._follow(refs)
            is_whole = all(map(self._counts.get, self._order))
            if is_whole and self._write_whole() == replace(self.tape, labels={}) and not self._repeats_tests():
                return True
            self.__dict__.update(before)
        return False

    def _store_plain(self, number: int, op: Op, x: Ref, y: Ref) -> Ref:
        """Write the node of a sum or product as `operate` does, in fewer steps; return 0 where it may fold."""
        if not x or not y:
            return 0
        sign = 1 if x > 0 else -1
        one, other = x * sign, y if y > 0 else -y
        base, last = self._bases[one], self._bases[other]
        if op is MUL:
            if not base or not last:
                return 0
            key = (op, one, other) if one < other else (op, other, one)
            sign = sign if y > 0 else -sign
        elif op is ADD or op is SUB:
            if base == last:
                return 0
            is_sum = ((y > 0) is (sign > 0)) is (op is ADD)
            if one > other:  # the smaller node comes first, with a plus
                one, other, sign = other, one, sign if is_sum else -sign
            key = (ADD if is_sum else SUB, one, other)
        else:
            return 0
        if key in self._places:
            return 0
        self._nodes[number], self._places[key], self._bases[number] = key, number, number
        self._made.add(number)
        return sign * number

    def _follow(self, refs: Mapping[int, Ref]) -> None:
        """Take the nodes for the values."""
        tape = self.tape
        signs = [1] * self._first_test + [x for g in tape.guards for x in (-1 if g.negated else 1, 1)]
        self._roots = {k: sign * refs[self._roots[k]] for k, sign in enumerate(signs)}
        self._labels = {refs[x]: text for x, text in self._labels.items()}
        turned = {x: found[1] for x, found in self.operations.items() if found[0] is NEG}
        self.operations = {x: found for x, found in self.operations.items() if x not in turned}
        self._order = [*self.operations]
        self._kept = self._kept | {number: 1 if refs[number] > 0 else -1 for number in self.operations}
        self._leave_turned(turned)
        self._asking = {x: None for x, (op, _, _) in self.operations.items() if op in _ASKING}
        self._turned = self._now_turned = self._find_turned()
        self.operations |= {x: self._choose_sign(x)[0] for x in self._asking}
        self._varying -= self._count_signs()

    def _repeats_tests(self) -> bool:
        early = [(self._roots[k], self._roots[k + 1], g) for k, g in self._list_tests() if g.early]
        fixed = (self.is_literal(self._roots[k]) and self.is_literal(self._roots[k + 1]) for k, _ in self._list_tests())
        return len({(a, b, g.joint, g.tolerance) for a, b, g in early}) != len(early) or any(fixed)

    def _list_tests(self) -> Iterator[tuple[int, Any]]:
        return zip(range(self._first_test, len(self._roots), 2), self.tape.guards, strict=True)

    def build(self) -> Tape:
        """Build the tape as it is now."""
        if not self.is_changed:
            return self.tape
        return self._write_whole(self._labels)

    def _write_whole(self, labels: Mapping[int, str] | None = None) -> Tape:
        """Write the tape by its nodes."""
        tape = self.tape
        leaves = [*(x for x, key in self._nodes.items() if key is None), *self._literals.values()]
        nodes: list[Key | mpf | None] = [None, *map(self._nodes.__getitem__, leaves)]
        places = {0: 0} | {number: place for place, number in enumerate(leaves, 1)}
        places |= {-number: -place for number, place in places.items()}
        for place, number in enumerate(self._order, len(nodes)):
            places[number], places[-number] = place, -place
            key = self._nodes[number]
            assert isinstance(key, tuple)
            op, a, b = key
            nodes.append((op, places[a], places[b]))
        literals = len(leaves) - len(self._literals) + 1
        bases = [*range(literals), *(0 for _ in self._literals), *range(len(leaves) + 1, len(nodes))]
        bases[0] = OWN
        refs = [places[ref] for ref in self._roots.values()]
        results, first = [], 0
        for o in tape.outputs:
            results.append(Result(o.port, o.sparsity, tuple(refs[first : first + len(o.values)])))
            first += len(o.values)
        inputs, first = [], 1
        for i in tape.inputs:
            inputs.append((i, first))
            first += i.sparsity.nnz
        tests = [Test(refs[k], refs[k + 1], g.tolerance, g.joint, g.early) for k, g in self._list_tests()]
        named = {places[number]: text for number, text in sorted((labels or {}).items())}
        turned = {places[number] for number in self._turned}
        return Writer(nodes, bases, inputs, results, tests, named, turned).tape(tape.function)

    def write(self, chosen: Collection[int], write: Write) -> Tape:
        """Write the whole tape again, with some values anew."""
        tape, builder, numbers = self.build(), Builder(), self._numbers
        assert not self.is_changed
        wanted = set(chosen)
        refs: dict[int, Ref] = {0: 0}
        given = [value for i in tape.inputs for value in builder.input(i.port, i.sparsity)]
        given += [builder.number(x) for x in tape.literals]
        refs |= {number: value.ref for number, value in zip(numbers, given, strict=False)}
        for number, (op, a, b) in zip(numbers[tape.first_operation :], tape.operations, strict=True):
            if number in wanted:
                refs[number] = write(builder, refs.__getitem__, number)
            else:
                refs[number] = builder.operate(op, refs[numbers[a]], refs[numbers[b]] if b >= 0 else 0)
        values = [Scalar(builder, refs[number]) for number in numbers]
        labelled = [(v, text) for v, text in sorted(tape.labels.items()) if not self.is_inner(numbers[v])]
        builder.label([values[v] for v, _ in labelled], [text for _, text in labelled])
        for o in tape.outputs:
            builder.output(o.port, o.sparsity, [values[v] for v in o.values])
        replay_guards(tape, builder, values)
        return builder.build(tape.function)


_MISSING: Any = object()


def _list_roots(tape: Tape) -> Iterator[int]:
    """List the values that outputs and guards use, in this order."""
    yield from (v for o in tape.outputs for v in o.values)
    yield from (v for g in tape.guards for v in (g.value, g.scale))
