"""Multipliers: the forces lam that keep M qdd + c = Q + JT lam on J qdd = b, given the compliance of the tree.

    A lam = b - J M^-1 (Q - c),    A = J M^-1 JT

A is symmetric, and positive definite where J has full rank. It couples only equations whose paths share a body that
moves, so it is eliminated in the order of least degree. Driven joints are rows of J with one entry, 1.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from mbsgen.formulations import closure, ports
from mbsgen.formulations.parsimony.elimination import Column, factorise
from mbsgen.model.tree import Tree
from mbsgen.tape.builder import Builder, Scalar
from mbsgen.tape.replay import replay

# An entry of lam errs by some epsilon times the ratio of A's diagonal to the pivot that remains of it; as in EXP1, an
# equation fails where about three digits remain.
PIVOT_TOLERANCE = 500.0

Row = dict[int, Scalar]  # by the entry of qd, from 0


@dataclass(frozen=True)
class Equations:
    """J qdd = b: the equations of loops and constraints, then the driven joints."""

    rows: tuple[Row, ...]
    right: tuple[Scalar, ...]  # b
    statuses: tuple[int, ...]  # of each row, what a kernel returns where it depends on others

    @property
    def size(self) -> int:
        """Count the equations."""
        return len(self.rows)


def write_equations(tree: Tree, builder: Builder, given: Mapping[str, Sequence[Scalar]]) -> Equations:
    """Write J and b of an uncoupled tree. A driven joint has its acceleration; statuses are numbered in `tree`."""
    rows: list[Row] = []
    right: list[Scalar] = []
    statuses: list[int] = []
    n = len(tree.bodies)
    if tree.loops or tree.constraints:
        tape = closure.build_jacobian(tree)
        values = replay(tape, builder, {i.name: given[i.name] for i in tape.inputs})
        rows = [{} for _ in range(tape.outputs[0].sparsity.rows)]
        for (r, c), value in closure.jacobian_entries(tape, values).items():
            rows[r][c] = value
        right = [-values[v] for v in tape.output(ports.CLOSURE_BIAS.name).values]
        statuses = [n + 1 + loop for loop, _ in closure.kept_equations(tree)]
    for number, acceleration in zip(tree.driven, given.get(ports.DRIVE.name, ()), strict=True):
        rows.append({number - 1: builder.number(1.0)})
        right.append(acceleration)
        statuses.append(number)
    return Equations(tuple(rows), tuple(right), tuple(statuses))


def solve(builder: Builder, A: Mapping[tuple[int, int], Scalar], right: Sequence[Scalar]) -> tuple[Column, Column]:
    """Solve A lam = right; return lam, and the pivot of each equation as a part of its diagonal, numbered from 0.

    A holds one triangle, by numbers from 0, the smaller one first.
    """
    size = len(right)
    order = order_by_degree(size, {place for place, value in A.items() if not value.is_zero})
    place = {k: size - step for step, k in enumerate(order)}  # the last unknown is eliminated first
    permuted = {
        (min(place[k], place[l]), max(place[k], place[l])): value for (k, l), value in A.items() if not value.is_zero
    }
    factors = factorise(builder, permuted, size)
    found = factors.solve({place[k]: value for k, value in enumerate(right)})
    return {k: found[place[k]] for k in range(size)}, {k: factors.D[place[k]] for k in range(size)}


def guard(builder: Builder, equations: Equations, A: Mapping[tuple[int, int], Scalar], pivots: Column) -> None:
    """Guard each pivot: it must stand out of the rounding of its diagonal entry."""
    for k, status in enumerate(equations.statuses):
        builder.guard(pivots[k], A[k, k], equations.size * PIVOT_TOLERANCE, status)


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
