"""Partition of the velocities: the dependent ones solved for from the equations of loops and the independent ones.

    J qd = Ju x + Jv y = 0,    x = -Ju^-1 Jv y,    qd = Z y,    Z = [-Ju^-1 Jv; 1]

(Wehage and Haug, 1982; Samin and Fisette, 2003, 4.3.) Ju is permuted to block triangular form by its structural zeros
(Duff, 1981), so independent loops separate. A block of up to three rows is solved by its determinant. Of a larger
block, unknowns that are local to few rows are eliminated first, by the normal of their columns. The remaining columns
are orthogonalised, Ju = Q R, with modified Gram-Schmidt (Bjorck, 1967). None of this chooses pivots: it fails only
where Ju loses rank, at any pose.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

from mbsgen.algebra.vectors import Matrix, Vector
from mbsgen.errors import TapeError
from mbsgen.formulations.multipliers import Row, order_by_degree
from mbsgen.tape.builder import Builder, Scalar
from mbsgen.tape.types import Op

# Coordinates close the loops up to rounding. So a sine s between columns errs by epsilon/s, and three digits of it are
# left where s2 is 1000 u = 500 epsilon. A guard compares s2 where it is known, else s; sqrt(500/epsilon) = 1.5e9.
SQUARED_TOLERANCE = 500.0
TOLERANCE = 1.5e9


@dataclass(frozen=True)
class Place:
    """The rows and the unknowns of a block of Ju, and the status of each row."""

    rows: tuple[int, ...]
    columns: tuple[int, ...]  # column k is matched with row k: it has an entry there
    statuses: tuple[int, ...]


@dataclass(frozen=True)
class Group:
    """Rows of a block, and the unknowns that appear in these rows alone."""

    rows: tuple[int, ...]
    columns: tuple[int, ...]


class Block(ABC):
    """A square block of Ju on the diagonal."""

    def __init__(self, place: Place) -> None:
        self.place = place

    @abstractmethod
    def solve(self, b: Sequence[Scalar]) -> list[Scalar]:
        """Solve A x = b."""

    @abstractmethod
    def solve_transposed(self, b: Sequence[Scalar]) -> list[Scalar]:
        """Solve AT x = b."""


class Single(Block):
    """One equation of one unknown."""

    def __init__(self, builder: Builder, place: Place, rows: Sequence[Row]) -> None:
        super().__init__(place)
        (r,), (c,) = place.rows, place.columns
        pivot = rows[r][c]
        builder.guard(
            _size(pivot), _total([_size(x) for _, x in sorted(rows[r].items())]), TOLERANCE, place.statuses[0]
        )
        self._inverse = builder.number(1.0) / pivot

    def solve(self, b: Sequence[Scalar]) -> list[Scalar]:
        return [b[0] * self._inverse]

    def solve_transposed(self, b: Sequence[Scalar]) -> list[Scalar]:
        return self.solve(b)


class Pair(Block):
    """Two equations of two unknowns, by the determinant."""

    def __init__(self, builder: Builder, place: Place, rows: Sequence[Row]) -> None:
        super().__init__(place)
        (i, j), (k, l), zero = place.rows, place.columns, builder.zero
        self._a, self._b, self._c, self._d = (rows[r].get(s, zero) for r in (i, j) for s in (k, l))
        determinant = self._a * self._d - self._b * self._c
        one, other = _size(self._a) + _size(self._c), _size(self._b) + _size(self._d)
        _guard_columns(builder, place, rows, {k: one, l: other})
        builder.guard(_size(determinant), one * other, TOLERANCE, place.statuses[0])
        self._inverse = builder.number(1.0) / determinant

    def solve(self, b: Sequence[Scalar]) -> list[Scalar]:
        x, y = b
        return [(self._d * x - self._b * y) * self._inverse, (self._a * y - self._c * x) * self._inverse]

    def solve_transposed(self, b: Sequence[Scalar]) -> list[Scalar]:
        x, y = b
        return [(self._d * x - self._c * y) * self._inverse, (self._a * y - self._b * x) * self._inverse]


class Triple(Block):
    """Three equations of three unknowns, by cross products of the columns."""

    def __init__(self, builder: Builder, place: Place, rows: Sequence[Row]) -> None:
        super().__init__(place)
        zero = builder.zero
        a, b, c = (Vector.of(rows[r].get(k, zero) for r in place.rows) for k in place.columns)
        sizes = [_total([_size(x) for x in column]) for column in (a, b, c)]
        self._normals = Matrix((b.cross(c), c.cross(a), a.cross(b)))
        determinant = a.dot(self._normals.rows[0])
        _guard_columns(builder, place, rows, dict(zip(place.columns, sizes, strict=True)))
        builder.guard(_size(determinant), sizes[0] * sizes[1] * sizes[2], TOLERANCE, place.statuses[0])
        self._inverse = builder.number(1.0) / determinant

    def solve(self, b: Sequence[Scalar]) -> list[Scalar]:
        return list(self._normals.apply(Vector.of(b)).scale(self._inverse))

    def solve_transposed(self, b: Sequence[Scalar]) -> list[Scalar]:
        return list(self._normals.transposed.apply(Vector.of(b)).scale(self._inverse))


class Many(Block):
    """More equations: A = Q R, with R of unit diagonal, and columns of Q that are orthogonal."""

    def __init__(self, builder: Builder, place: Place, rows: Sequence[Row]) -> None:
        super().__init__(place)
        self._builder, size = builder, len(place.rows)
        zero = builder.zero
        self._Q = [[rows[r].get(c, zero) for r in place.rows] for c in place.columns]
        lengths = [_dot(column, column) for column in self._Q]
        sizes = {c: _total([_size(x) for x in column]) for c, column in zip(place.columns, self._Q, strict=True)}
        _guard_columns(builder, place, rows, sizes)
        met = [(k, l) for k in range(size) for l in range(k) if _meet(self._Q[k], self._Q[l])]
        self._order = order_by_degree(size, set(met))
        self._R: dict[tuple[int, int], Scalar] = {}
        self._inverses: dict[int, Scalar] = {}
        for step, k in enumerate(self._order):
            for j in self._order[:step]:
                self._R[j, k] = entry = _dot(self._Q[j], self._Q[k]) * self._inverses[j]
                self._Q[k] = [x - entry * y for x, y in zip(self._Q[k], self._Q[j], strict=True)]
            left = _dot(self._Q[k], self._Q[k])
            builder.guard(left, lengths[k], size * SQUARED_TOLERANCE, place.statuses[k])
            self._inverses[k] = builder.number(1.0) / left

    def solve(self, b: Sequence[Scalar]) -> list[Scalar]:
        left, x = list(b), [self._builder.zero] * len(b)
        for k in self._order:
            x[k] = _dot(self._Q[k], left) * self._inverses[k]
            left = [a - c * x[k] for a, c in zip(left, self._Q[k], strict=True)]
        for step in reversed(range(len(b))):
            k = self._order[step]
            for j in self._order[:step]:
                x[j] = x[j] - self._R[j, k] * x[k]
        return x

    def solve_transposed(self, b: Sequence[Scalar]) -> list[Scalar]:
        g, x = list(b), [self._builder.zero] * len(b)
        for step, k in enumerate(self._order):
            for j in self._order[:step]:
                g[k] = g[k] - self._R[j, k] * g[j]
        for k in reversed(self._order):
            part = (g[k] - _dot(self._Q[k], x)) * self._inverses[k]
            x = [a + c * part for a, c in zip(x, self._Q[k], strict=True)]
        return x


class Joined(Block):
    """A block in which some unknowns are local to a few rows: all but one of as many as these rows.

    The normal n of their columns, a perpendicular or a cross product, leaves one equation without them; the other
    unknowns are solved for first. n vanishes only where the local columns depend on each other. With dual vectors a*
    of the local columns, a*.a = 1 and a*.b = a*.n = 0, their unknowns are a*.r, with r the rest of the rows.
    """

    def __init__(self, builder: Builder, place: Place, rows: Sequence[Row], groups: Sequence[Group]) -> None:
        super().__init__(place)
        self._builder, self._groups, self._rows = builder, groups, rows
        local = {c for group in groups for c in group.columns}
        within = {r for group in groups for r in group.rows}
        self._shared = [c for c in place.columns if c not in local]
        self._free = [r for r in place.rows if r not in within]
        status = dict(zip(place.rows, place.statuses, strict=True))
        self._normals: list[dict[int, Scalar]] = []
        self._duals: list[list[dict[int, Scalar]]] = []
        for group in groups:
            self._take_normal(group, status[group.rows[0]])
        left = [{c: x for c, x in rows[r].items() if c in self._shared} for r in self._free]
        left += [
            {c: _combine(normal, {r: rows[r].get(c, builder.zero) for r in normal}) for c in self._shared}
            for normal in self._normals
        ]
        statuses = [*(status[r] for r in self._free), *(status[group.rows[0]] for group in groups)]
        self._rest = Partition(builder, left, statuses, self._shared)

    def _take_normal(self, group: Group, status: int) -> None:
        b, rows = self._builder, group.rows
        columns = [[self._rows[r].get(c, b.zero) for r in rows] for c in group.columns]
        if len(rows) == 2:
            ((x, y),) = columns
            normal = [-y, x]
            squared = _dot(normal, normal)
            numerators = [[x, y]]
        else:
            one, other = (Vector.of(column) for column in columns)
            cross = one.cross(other)
            normal, squared = list(cross), cross.dot(cross)
            numerators = [list(other.cross(cross)), list(cross.cross(one))]
            b.guard(squared, one.dot(one) * other.dot(other), SQUARED_TOLERANCE, status)
        whole = [_size(x) for r in rows for _, x in sorted(self._rows[r].items())]
        b.guard(_total([_size(x) for column in columns for x in column]), _total(whole), SQUARED_TOLERANCE, status)
        inverse = b.number(1.0) / squared
        self._normals.append(dict(zip(rows, normal, strict=True)))
        self._duals.append([dict(zip(rows, (x * inverse for x in dual), strict=True)) for dual in numerators])

    def solve(self, b: Sequence[Scalar]) -> list[Scalar]:
        given = dict(zip(self.place.rows, b, strict=True))
        right = [given[r] for r in self._free] + [_combine(normal, given) for normal in self._normals]
        x = self._rest.solve(right)
        for group, duals in zip(self._groups, self._duals, strict=True):
            left = {
                r: _subtract(given[r], [(a, x[c]) for c, a in self._rows[r].items() if c in self._shared])
                for r in group.rows
            }
            x |= {c: _combine(dual, left) for c, dual in zip(group.columns, duals, strict=True)}
        return [x[c] for c in self.place.columns]

    def solve_transposed(self, b: Sequence[Scalar]) -> list[Scalar]:
        given, zero = dict(zip(self.place.columns, b, strict=True)), self._builder.zero
        x: dict[int, Scalar] = {}
        for group, duals in zip(self._groups, self._duals, strict=True):
            for r in group.rows:
                x[r] = _total([dual[r] * given[c] for c, dual in zip(group.columns, duals, strict=True)])
        right = {
            c: _subtract(given[c], [(self._rows[r][c], own) for r, own in sorted(x.items()) if c in self._rows[r]])
            for c in self._shared
        }
        found = self._rest.solve_transposed(right)
        x |= dict(zip(self._free, found, strict=False))
        for normal, part in zip(self._normals, found[len(self._free) :], strict=True):
            x |= {r: x.get(r, zero) + n * part for r, n in normal.items()}
        return [x[r] for r in self.place.rows]


class Partition:
    """Ju, ready to solve with. Its rows are numbered from 0, its columns by the entries of qd that depend."""

    def __init__(
        self, builder: Builder, rows: Sequence[Row], statuses: Sequence[int], dependent: Sequence[int]
    ) -> None:
        """Take the rows of J, whose entries may be structural zeros, and the status of each."""
        self.builder = builder
        self.rows = [{c: x for c, x in row.items() if not x.is_zero} for row in rows]
        places = find_blocks([[c for c in row if c in dependent] for row in self.rows], statuses)
        self._blocks = [self._make(place) for place in places]

    def _make(self, place: Place) -> Block:
        kinds: Mapping[int, Callable[[Builder, Place, Sequence[Row]], Block]] = {1: Single, 2: Pair, 3: Triple}
        if len(place.rows) in kinds:
            return kinds[len(place.rows)](self.builder, place, self.rows)
        groups = find_groups(place, self.rows)
        return Joined(self.builder, place, self.rows, groups) if groups else Many(self.builder, place, self.rows)

    def solve(self, b: Sequence[Scalar]) -> Row:
        """Solve Ju x = b."""
        x: Row = {}
        for block in self._blocks:
            right = [_subtract(b[r], [(a, x[c]) for c, a in self.rows[r].items() if c in x]) for r in block.place.rows]
            x |= dict(zip(block.place.columns, block.solve(right), strict=True))
        return x

    def solve_transposed(self, b: Mapping[int, Scalar]) -> list[Scalar]:
        """Solve JuT x = b."""
        x: dict[int, Scalar] = {}
        for block in reversed(self._blocks):
            right = [
                _subtract(b[c], [(self.rows[r][c], x[r]) for r in sorted(x) if c in self.rows[r]])
                for c in block.place.columns
            ]
            x |= dict(zip(block.place.rows, block.solve_transposed(right), strict=True))
        return [x[r] for r in range(len(self.rows))]

    def apply(self, y: Mapping[int, Scalar]) -> list[Scalar]:
        """Form the product of the columns of J that y has entries of."""
        zero = self.builder.zero
        return [_total([x * y[c] for c, x in sorted(row.items()) if c in y], zero) for row in self.rows]

    def follow(self, y: Mapping[int, Scalar], bias: Sequence[Scalar] | None = None) -> Row:
        """Return the dependent entries x of Ju x + Jv y + bias = 0."""
        right = [-x for x in self.apply(y)]
        return self.solve(right if bias is None else [a - b for a, b in zip(right, bias, strict=True)])


def find_blocks(pattern: Sequence[Sequence[int]], statuses: Sequence[int]) -> list[Place]:
    """List the diagonal blocks of the block triangular form, each after the blocks that it depends on.

    `pattern` lists the unknowns of each row. Raises TapeError for a matrix that is singular for all numbers.
    """
    matched = _match(pattern)
    owners = {c: r for r, c in matched.items()}
    reach = [{owners[c] for c in row} | {r} for r, row in enumerate(pattern)]
    for k in range(len(pattern)):
        for own in reach:
            if k in own:
                own |= reach[k]
    placed: set[int] = set()
    found = []
    for r in sorted(range(len(pattern)), key=lambda r: (len(reach[r]), r)):
        if r not in placed:
            rows = tuple(sorted(x for x in reach[r] if r in reach[x]))
            placed |= set(rows)
            found.append(Place(rows, tuple(matched[x] for x in rows), tuple(statuses[x] for x in rows)))
    return found


def find_groups(place: Place, rows: Sequence[Row]) -> list[Group]:
    """Find disjoint groups of three rows with two local unknowns, then of two rows with one."""
    touched = {c: {r for r in place.rows if c in rows[r]} for c in place.columns}
    candidates: list[tuple[tuple[int, ...], set[int]]]
    candidates = [(pair, touched[pair[0]] | touched[pair[1]]) for pair in combinations(place.columns, 2)]
    candidates += [((c,), touched[c]) for c in place.columns]
    found: list[Group] = []
    for columns, own in candidates:
        used = {x for group in found for x in (*group.rows, *(-1 - c for c in group.columns))}
        if len(own) == len(columns) + 1 and used.isdisjoint({*own, *(-1 - c for c in columns)}):
            found.append(Group(tuple(sorted(own)), columns))
    return found


def _match(pattern: Sequence[Sequence[int]]) -> dict[int, int]:
    """Match each row with a different unknown, by augmenting paths."""
    owners: dict[int, int] = {}

    def seat(row: int, tried: set[int]) -> bool:
        for c in sorted(pattern[row]):
            if c not in tried:
                tried.add(c)
                if c not in owners or seat(owners[c], tried):
                    owners[c] = row
                    return True
        return False

    for row in range(len(pattern)):
        if not seat(row, set()):
            raise TapeError(f"row {row} of the dependent velocities' Jacobian depends on others at every pose")
    return {row: c for c, row in owners.items()}


def _guard_columns(builder: Builder, place: Place, rows: Sequence[Row], sizes: Mapping[int, Scalar]) -> None:
    """Guard each column of a block: it must stand out of the rounding of the block's rows in J."""
    within = [_size(x) for r in place.rows for c, x in sorted(rows[r].items()) if c not in sizes]
    whole = _total([*sizes.values(), *within])
    for (_, size), status in zip(sizes.items(), place.statuses, strict=True):
        builder.guard(size, whole, len(sizes) * SQUARED_TOLERANCE, status)


def _size(x: Scalar) -> Scalar:
    return x if x.is_zero else x.builder.apply(Op.ABS, x)


def _total(terms: Sequence[Scalar], zero: Scalar | None = None) -> Scalar:
    return sum(terms[1:], start=terms[0]) if terms else _known(zero)


def _known(zero: Scalar | None) -> Scalar:
    assert zero is not None, "there is something to be summed up"
    return zero


def _subtract(value: Scalar, products: Sequence[tuple[Scalar, Scalar]]) -> Scalar:
    for a, b in products:
        value = value - a * b
    return value


def _combine(factors: Mapping[int, Scalar], values: Mapping[int, Scalar]) -> Scalar:
    return _total([x * values[r] for r, x in factors.items()])


def _dot(a: Sequence[Scalar], b: Sequence[Scalar]) -> Scalar:
    return _total([x * y for x, y in zip(a, b, strict=True)])


def _meet(a: Sequence[Scalar], b: Sequence[Scalar]) -> bool:
    return any(not x.is_zero and not y.is_zero for x, y in zip(a, b, strict=True))
