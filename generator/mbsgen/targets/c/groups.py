"""Columns of a system in groups, for kernels that compute several states at once.

There a number is a vector, and a solution costs the same for each column. So the columns of a group have their nonzeros
in the same rows as far as possible, and only products with such rows are computed. Three rows of the system that follow
each other in a chain are computed together: a number that was read serves all three (`csrc/mbs_columns.h`).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence, Set
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

from mbsgen.procedure.patterns import Tree
from mbsgen.procedure.solve import Solve
from mbsgen.procedure.wires import Wire

WIDTH, HEIGHT = 6, 3  # columns of a group, and rows of a step: MBS_WIDTH and MBS_HEIGHT in C
END = 0


@dataclass(frozen=True)
class Column:
    """A column of the solution."""

    number: int
    result: int  # from 1; 0 is written for a place in a group that no column takes
    first: int  # the nonzero of the result that its first row is
    rows: tuple[int, ...]  # which the result has
    reached: frozenset[int]  # rows that the first substitution gives nonzeros


@dataclass(frozen=True)
class Groups:
    """The columns of a system in groups."""

    pattern: Tree
    results: tuple[Wire, ...]
    groups: tuple[tuple[Column, ...], ...]

    @property
    def numbers(self) -> int:
        """Count the numbers of the right-hand sides, with one that nothing reads."""
        return WIDTH * sum(len(_reach(group)) for group in self.groups) + 1

    @cached_property
    def places(self) -> Mapping[tuple[int, int], int]:
        """Number each entry of the right-hand sides, by row and column."""
        rows = [(row, group) for group in self.groups for row in sorted(_reach(group), reverse=True)]
        return {
            (row, column.number): WIDTH * k + c for k, (row, group) in enumerate(rows) for c, column in enumerate(group)
        }

    def place(self, row: int, column: int) -> int:
        """Number an entry of the right-hand sides; what no result needs is written to the last one."""
        return self.places.get((row, column), self.numbers - 1)

    def write(self) -> tuple[list[int], list[int]]:
        """Write the steps of both substitutions, and for each group where its steps begin and what its columns are."""
        steps: list[int] = []
        starts: dict[tuple[int, ...], int] = {}
        groups: list[int] = []

        def start(written: tuple[int, ...]) -> int:
            if written not in starts:
                starts[written] = len(steps)
                steps.extend(written)
            return starts[written]

        for group in self.groups:
            reached, rows = _reach(group), group[0].rows
            others = [row for row in rows if row not in reached]
            down = [x for step in self._down(reached) for x in step]
            up = [x for step in self._up(rows) for x in step]
            groups += [start((*down, END, len(others), *others)), start((*up, END))]
            groups += [x for column in group for x in (column.result, column.first)]
            groups += [0, 0] * (WIDTH - len(group))
        return steps, groups

    def _down(self, rows: Set[int]) -> Iterator[list[int]]:
        """Yield the steps of the first substitution, which goes from the last row up."""
        below = {k: [(i, place) for i, place in self.pattern.below[k] if i in rows] for k in rows}
        for step in _chain(sorted(rows, reverse=True), {k: [i for i, _ in below[k]] for k in rows}):
            yield _write_step(step, step, [below[k] for k in step])

    def _up(self, rows: Sequence[int]) -> Iterator[list[int]]:
        """Yield the steps of the second one."""
        starts, ranks = self.pattern.starts, {k: rank for rank, k in enumerate(rows)}
        for step in _chain(rows, {k: self.pattern.ancestors[k] for k in rows}):
            entries = [list(zip(self.pattern.ancestors[k], range(starts[k], starts[k + 1]), strict=True)) for k in step]
            yield _write_step(step, [ranks[k] for k in step], entries)


def _write_step(rows: Sequence[int], ranks: Sequence[int], entries: Sequence[Sequence[tuple[int, int]]]) -> list[int]:
    """Write its sizes and rows, the products with rows before it, and its rows' with each other."""
    shared = len(entries[0])
    written = [len(rows), shared, *rows, *ranks]
    for e in range(shared):
        written += [entries[0][e][0], *(of_row[e][1] for of_row in entries)]
    return written + [place for of_row in entries for _, place in of_row[shared:]]


def _chain(rows: Sequence[int], needs: Mapping[int, Sequence[int]]) -> list[list[int]]:
    """Split rows in steps: each row of a step needs what the one before needs, and that row."""
    steps: list[list[int]] = []
    for k in rows:
        last = steps[-1] if steps else []
        if last and len(last) < HEIGHT and list(needs[k]) == [*needs[last[-1]], last[-1]]:
            last.append(k)
        else:
            steps.append([k])
    return steps


def group_columns(stage: Solve) -> Groups:
    """Group the columns of a system with the matrix of a tree."""
    assert isinstance(stage.pattern, Tree), f"{stage.name}: columns are solved in groups for trees alone"
    pattern, n = stage.pattern, stage.pattern.size
    nonzero: dict[int, set[int]] = {}
    for c, r in stage.right.sparsity.entries:
        nonzero.setdefault(c, set()).add(r)
    results = [block for block in stage.blocks if block.result.sparsity.nnz]
    columns = []
    for number, block in enumerate(results, 1):
        found: dict[int, list[int]] = {}
        firsts: dict[int, int] = {}
        for k, (r, c) in enumerate(block.entries(n)):
            firsts.setdefault(c, k)
            found.setdefault(c, []).append(r)
        for c, rows in found.items():
            columns.append(Column(c, number, firsts[c], tuple(rows), _find_reached(pattern, nonzero.get(c, set()))))
    for column in columns:
        _check(stage, pattern, column)
    ordered = sorted(columns, key=lambda x: (x.rows, [-k for k in sorted(x.reached, reverse=True)], x.number))
    return Groups(pattern, tuple(block.result for block in results), tuple(_cut(pattern, ordered)))


def _check(stage: Solve, pattern: Tree, column: Column) -> None:
    rows = set(column.rows)
    needed = column.reached.union(*(pattern.ancestors[k] for k in rows))
    missing = sorted(needed - rows)
    assert not missing, f"{stage.name}: a result has no entries in rows {missing} of column {column.number}"


def _find_reached(pattern: Tree, rows: Set[int]) -> frozenset[int]:
    """Return the rows, and all of their ancestors."""
    return frozenset(rows).union(*(pattern.ancestors[k] for k in rows))


def _reach(group: Sequence[Column]) -> frozenset[int]:
    return frozenset[int]().union(*(column.reached for column in group))


def _cut(pattern: Tree, columns: Sequence[Column]) -> list[tuple[Column, ...]]:
    """Cut a sequence of columns in groups so that the products are the fewest."""
    best: list[tuple[int, int]] = [(0, 0)]  # the products of the columns so far, and where the last group begins
    for end in range(1, len(columns) + 1):
        choices = []
        for begin in range(max(0, end - WIDTH), end):
            group = columns[begin:end]
            if group[0].rows == group[-1].rows:
                reached = _reach(group)
                down = sum(1 for k in reached for i in pattern.ancestors[k] if i in reached)
                up = sum(1 + len(pattern.ancestors[k]) for k in group[0].rows)
                choices.append((best[begin][0] + down + up, begin))
        best.append(min(choices))
    ends = [len(columns)]
    while ends[-1]:
        ends.append(best[ends[-1]][1])
    ends.reverse()
    return [tuple(columns[begin:end]) for begin, end in pairwise(ends)]
