"""Multipliers: the forces lam that keep M qdd + c = Q + JT lam on J qdd = b, given the compliance of the tree.

    A lam = b - J M^-1 (Q - c),    A = J M^-1 JT

A is symmetric, and positive definite where J has full rank. It couples only equations whose paths share a body that
moves, so it is eliminated in the order of least degree. Driven joints are rows of J with one entry, 1.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from mbsgen.formulations import closure, ports
from mbsgen.formulations.parsimony.elimination import Column, Entries, Factors, factorise
from mbsgen.model.tree import Tree
from mbsgen.tape.builder import Builder, Scalar
from mbsgen.tape.replay import replay, replay_guards
from mbsgen.tape.types import Op, Tape

# An entry of lam errs by some epsilon times the ratio of A's diagonal to the pivot that remains of it; as in EXP1, an
# equation fails where about three digits remain.
PIVOT_TOLERANCE = 500.0
ROW_TOLERANCE = 1000.0  # likewise, of a row as a part of its lengths

Row = dict[int, Scalar]  # by the entry of qd, from 0


@dataclass(frozen=True)
class Equations:
    """J qdd = b: the equations of loops and constraints, then the driven joints."""

    rows: tuple[Row, ...]
    right: tuple[Scalar, ...]  # b

    @property
    def size(self) -> int:
        """Count the equations."""
        return len(self.rows)


def write_equations(tree: Tree, builder: Builder, given: Mapping[str, Sequence[Scalar]]) -> Equations:
    """Write J and b of an uncoupled tree; b holds the accelerations of driven joints."""
    rows: list[Row] = []
    right: list[Scalar] = []
    if tree.loops or tree.constraints:
        tape = closure.build_jacobian(tree)
        values = replay(tape, builder, {i.name: given[i.name] for i in tape.inputs})
        rows = [{} for _ in range(tape.outputs[0].sparsity.rows)]
        for (r, c), value in closure.jacobian_entries(tape, values).items():
            rows[r][c] = value
        right = [-values[v] for v in tape.output(ports.CLOSURE_BIAS.name).values]
    for number, acceleration in zip(tree.driven, given.get(ports.DRIVE.name, ()), strict=True):
        rows.append({number - 1: builder.number(1.0)})
        right.append(acceleration)
    return Equations(tuple(rows), tuple(right))


@dataclass(frozen=True)
class Owner:
    """The loop, constraint or driven joint of an equation."""

    status: int  # of a kernel where the equation depends on others: n + its loop's number, or its driven joint's number
    group: tuple[int, bool]  # its loop, or a number below 0, and whether it compares directions; of one unit


def list_owners(tree: Tree) -> tuple[Owner, ...]:
    """List the owners of all equations: entries of h, then driven joints."""
    joints = tree.joints
    driven = (joints.index(tree.bodies[number - 1].joint) + 1 for number in tree.driven)
    loops = (Owner(closure.find_status(tree, group[0]), group) for group in closure.group_equations(tree))
    return (*loops, *(Owner(number, (-number, False)) for number in driven))


@dataclass(frozen=True)
class Eliminated:
    """A symmetric matrix, eliminated in the order of least degree. Unknowns are numbered from 0."""

    factors: Factors
    place: Mapping[int, int]  # by unknown: its number among the factors

    @property
    def pivots(self) -> Column:
        """Return the pivot of each unknown."""
        return {k: self.factors.D[place] for k, place in self.place.items()}

    def solve(self, right: Sequence[Scalar]) -> list[Scalar]:
        """Solve for one right-hand side."""
        found = self.factors.solve({self.place[k]: value for k, value in enumerate(right)})
        return [found[self.place[k]] for k in range(len(right))]


def eliminate(builder: Builder, A: Entries, size: int) -> Eliminated:
    """Factorise A, which holds one triangle by numbers from 0, the smaller one first."""
    order = order_by_degree(size, {place for place, value in A.items() if not value.is_zero})
    place = {k: size - step for step, k in enumerate(order)}  # the last unknown is eliminated first
    permuted = {
        (min(place[k], place[l]), max(place[k], place[l])): value for (k, l), value in A.items() if not value.is_zero
    }
    return Eliminated(factorise(builder, permuted, size), place)


@dataclass(frozen=True)
class Bordered:
    """The matrix of M x - JT z = b, J x = c: by the factors of M, the system A z = c - J M^-1 b is left."""

    factors: Factors  # of M
    columns: tuple[Column, ...]  # LT^-1 JT
    A: Entries
    reduced: Eliminated

    @staticmethod
    def of(factors: Factors, rows: Sequence[Column]) -> Bordered:
        """Border M by the rows of J, which are numbered from 1."""
        columns = tuple(factors.descend(row) for row in rows)
        size = len(rows)
        A = {(k, l): _weigh(factors, columns[k], columns[l]) for l in range(size) for k in range(l + 1)}
        return Bordered(factors, columns, A, eliminate(factors.builder, A, size))

    def solve(
        self, b: Mapping[int, Scalar], c: Sequence[Scalar] = (), known: Mapping[int, Scalar] | None = None
    ) -> tuple[Column, list[Scalar]]:
        """Solve for x, numbered from 1, and z. Without c, it is 0; known entries of x are taken over."""
        free = self.factors.descend(b)
        right = list(c) or [self.factors.builder.zero] * len(self.columns)
        z = self.reduced.solve(
            [x - _weigh(self.factors, own, free) for x, own in zip(right, self.columns, strict=True)]
        )
        for own, force in zip(self.columns, z, strict=True):
            free = {i: value + own[i] * force for i, value in free.items()}
        return self.factors.rise(free, known), z

    def invert(self, numbers: Iterable[int]) -> dict[int, tuple[Column, list[Scalar]]]:
        """Solve for unit columns b; an entry of x that two columns share by symmetry is computed once."""
        found: dict[int, tuple[Column, list[Scalar]]] = {}
        for j in sorted(numbers, reverse=True):
            known = {i: x[j] for i, (x, _) in found.items()}
            found[j] = self.solve({j: self.factors.builder.number(1.0)}, known=known)
        return found


def _weigh(factors: Factors, one: Column, other: Column) -> Scalar:
    """Multiply two columns by D^-1 between them."""
    terms = [one[i] * factors.inverses[i] * other[i] for i in factors.inverses]
    return sum(terms[1:], start=terms[0])


def guard(builder: Builder, owners: Sequence[Owner], A: Entries, pivots: Column) -> None:
    """Guard each pivot: it must stand out of the rounding of the diagonal entries of its group."""
    scales: dict[tuple[int, bool], Scalar] = {}
    for k, owner in enumerate(owners):
        own = A[k, k]
        scales[owner.group] = scales[owner.group] + own if owner.group in scales else own
    for k, owner in enumerate(owners):
        builder.guard(pivots[k], scales[owner.group], len(owners) * PIVOT_TOLERANCE, owner.status)


def write_guards(tree: Tree) -> Tape:
    """Write guards of rows of J that are alone in their groups: inputs q [, p] of the uncoupled tree, no result.

    Where such a row vanishes as a whole, its entries are rounding of the lengths that they are sums of.
    """
    builder = Builder()
    lone = closure.find_lone_equations(tree)
    if not lone:
        return builder.build("loop_guards")
    jacobian, levers = closure.write_jacobian(tree.uncoupled), closure.build_levers(tree.uncoupled)
    inputs = {i.name: i for tape in (levers, jacobian) for i in tape.inputs}
    given = {name: builder.input(i.port, i.sparsity) for name, i in inputs.items()}
    values, bounds = (
        replay(tape, builder, {i.name: given[i.name] for i in tape.inputs}) for tape in (jacobian, levers)
    )
    places = {
        place: bounds[v] for place, v in zip(levers.outputs[0].sparsity.entries, levers.outputs[0].values, strict=True)
    }
    rows: dict[int, list[tuple[Scalar, Scalar]]] = {k: [] for k in lone}
    for (r, c), v in zip(jacobian.outputs[0].sparsity.entries, jacobian.outputs[0].values, strict=True):
        if r in rows:
            rows[r].append((builder.apply(Op.ABS, values[v]), places[lone.index(r), c]))
    for k, found in rows.items():
        (size, bound), *more = found
        for x, y in more:
            size, bound = size + x, bound + y
        builder.guard(size, bound, ROW_TOLERANCE, list_owners(tree)[k].status)
    return builder.build("loop_guards")


def guard_rows(tree: Tree, builder: Builder, given: Mapping[str, Sequence[Scalar]]) -> None:
    """Write these guards to a builder, for the inputs of the uncoupled tree."""
    tape = write_guards(tree)
    values = replay(tape, builder, {i.name: given[i.name] for i in tape.inputs})
    replay_guards(tape, builder, values)


def order_by_degree(size: int, entries: set[tuple[int, int]]) -> list[int]:
    """Order unknowns for elimination: the one with the fewest neighbours first, the first of several."""
    neighbours: dict[int, set[int]] = {k: set() for k in range(size)}
    for k, l in entries:
        if k != l:
            neighbours[k].add(l)
            neighbours[l].add(k)
    order: list[int] = []
    while neighbours:
        k = min(neighbours, key=lambda x: (len(neighbours[x]), x))
        own = neighbours.pop(k)
        for x in own:
            neighbours[x] |= own - {x}
            neighbours[x].discard(k)
        order.append(k)
    return order


def along(row: Row, column: Mapping[int, Scalar] | Sequence[Scalar], zero: Scalar) -> Scalar:
    """Multiply a row of J by a column."""
    terms = [x * column[i] for i, x in sorted(row.items())]
    return sum(terms[1:], start=terms[0]) if terms else zero


def output(builder: Builder, tree: Tree, found: Sequence[Scalar]) -> None:
    """Declare the results lam and tau."""
    m = len(found) - len(tree.driven)
    if m:
        builder.output_dense(ports.MULTIPLIERS, [[x] for x in found[:m]])
    if tree.driven:
        builder.output_dense(ports.DRIVING_FORCES, [[x] for x in found[m:]])
