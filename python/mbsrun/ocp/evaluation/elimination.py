"""Inner variables of the intervals, solved for at one place after another, with derivatives, never twice.

Intervals are alike: each holds the same functions, applied to the same linear combinations y = C (z; w) of its unknowns
z and its knowns w. So one interval's matrices serve all, and all intervals are computed at once:

    r(z, w) = A (z; w) + sum over applications of scale * F(C (z; w)) = 0
    dz/dw = -r_z^-1 r_w,    mu = -r_z^-T gradient,    d2/dw2 (mu' r) = sum of Y' (mu' F)'' Y,
    with Y = C (dz/dw; 1).

Only scales differ between intervals. Variables that intervals have in common are knowns of each. Where one of them
multiplies a function, the product is F.

Newton's method solves r = 0, or substitution where r is triangular. Where the last equations give the last unknowns,
whatever the others are, they are solved after every step: closed loops stay closed, and the others are computed where
mechanisms can be. The last solution is kept with the knowns that it
belongs to: asked for again at the very same numbers, it is not computed again. So constraints, Jacobian and Hessian at
one iterate share one solve.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from mbsrun.ocp.ground.factors import Factors
from mbsrun.ocp.ground.functions import Array, Evaluation, Function, Indices, Pattern
from mbsrun.ocp.ground.program import Block, Column, Program, Stages

Mask = NDArray[np.bool_]
Bind = Callable[[Function, int], Evaluation]  # a backend's: a function and a number of places -> its evaluation

ITERATIONS = 30  # of Newton's method, before the equations count as having no solution
STEP = 1e-8  # relative to unknowns above 1: with slopes at the same place, the error is the square of the step
ROUNDING = 1e-13  # relative error that remains where steps shrink by a known rate
SLOW = 0.05  # the rate above which slopes are computed anew


@dataclass(frozen=True)
class Groups:
    """Equations that share no unknowns: G groups of as many equations as unknowns."""

    unknowns: Indices  # (G, s): variables of the program
    knowns: Indices  # (G, k): the other variables that the equations read; the last ones may be common to all groups


class Application:
    """A function that every one of G groups applies at P places, with its derivatives."""

    def __init__(self, bind: Bind, function: Function, C: Array, rows: Indices, scale: Array, groups: int) -> None:
        """C is (P, size of all arguments, unknowns and knowns of a group), rows (P, results), scale (groups, P)."""
        self.C, self.rows, self.scale = C, rows, scale
        self._bind, self._function, self._groups = bind, function, groups
        self._evaluation = bind(function, groups * len(rows))
        self._bounds = np.cumsum([0, *self._evaluation.sizes])

    def take(self, places: Indices) -> Application:
        """Keep some of the P places."""
        chosen = (self.C[places], self.rows[places], self.scale[:, places])
        return Application(self._bind, self._function, *chosen, self._groups)

    def value(self, v: Array) -> Array:
        """Return the results at (G, unknowns and knowns), scaled: (G, P, results)."""
        found = self._evaluation.value(self._split(v))
        return self.scale[:, :, None] * found.reshape(self._groups, *self.rows.shape)

    def slopes(self, v: Array) -> Array:
        """Return the derivatives of the results by their arguments, scaled: (G, P, results, size of all arguments)."""
        found = _spread(self._evaluation.jacobian(self._split(v)), self._slope_places, self._slope_shape)
        return self.scale[:, :, None, None] * found.reshape(self._groups, -1, *self._slope_shape)

    def curvature(self, v: Array, multipliers: Array) -> Array:
        """Return the Hessian of multipliers' results, scaled: (G, P, size of all arguments, the same)."""
        weights = (self.scale[:, :, None] * multipliers).reshape(-1, self.rows.shape[1])
        found = self._evaluation.hessian(self._split(v), weights)
        whole = _spread(found, self._curvature_places, self._curvature_shape)
        return whole.reshape(self._groups, -1, *self._curvature_shape)

    @cached_property
    def slope_pattern(self) -> Mask:
        """(results, size of all arguments)."""
        return _mark(self._slope_places, self._slope_shape)

    @cached_property
    def curvature_pattern(self) -> Mask:
        """(size of all arguments, the same)."""
        return _mark(self._curvature_places, self._curvature_shape)

    def _split(self, v: Array) -> list[Array]:
        y = np.ascontiguousarray((self._sparse @ v.T).T).reshape(-1, int(self._bounds[-1]))
        return [y[:, a:b] for a, b in zip(self._bounds[:-1], self._bounds[1:], strict=True)]

    @cached_property
    def _sparse(self) -> sparse.csr_array:
        """Return C, its P parts below each other; most of it is 0, and BLAS would start threads."""
        return sparse.csr_array(self.C.reshape(-1, self.C.shape[2]))

    @property
    def _slope_shape(self) -> tuple[int, int]:
        return self.rows.shape[1], int(self._bounds[-1])

    @property
    def _curvature_shape(self) -> tuple[int, int]:
        return int(self._bounds[-1]), int(self._bounds[-1])

    @cached_property
    def _slope_places(self) -> list[Indices]:
        """Where the nonzeros of each block of the slopes lie, in the flattened whole."""
        width, patterns = int(self._bounds[-1]), self._evaluation.jacobian_patterns
        return [_flatten(p, 0, int(left), width) for p, left in zip(patterns, self._bounds[:-1], strict=True)]

    @cached_property
    def _curvature_places(self) -> list[Indices]:
        corners = [(int(a), int(b)) for a in self._bounds[:-1] for b in self._bounds[:-1]]
        patterns, width = self._evaluation.hessian_patterns, int(self._bounds[-1])
        return [_flatten(pattern, *corner, width) for pattern, corner in zip(patterns, corners, strict=True)]


@dataclass
class _Found:
    """The solution at one place; None for parts that were not asked for."""

    key: bytes
    v: Array  # (G, s + k): unknowns, not numbers where there is no solution, then knowns
    factors: Factors | None = None  # of r_z
    slopes: Array | None = None  # (G, s, k): dz/dw


class Elimination:
    """The equations of G groups that are alike, in s unknowns and k knowns each.

    May be called from several threads; all take turns, and share what was found last.
    """

    def __init__(
        self,
        A: Array,
        applications: Sequence[Application],
        groups: Groups,
        orders: Sequence[Indices] = (),
        nested: int = 0,
    ) -> None:
        """A is (s, s + k); orders are equations of a triangular system with ones on its diagonal, one after another.

        The last `nested` equations give the last unknowns.
        """
        self.A, self.applications, self.groups = A, applications, groups
        self._count = len(groups.unknowns)
        self._sparse = sparse.csr_array(A)
        self.orders = [
            (rows, [part.take(chosen) for part in applications if (chosen := _find(part.rows, rows)).size])
            for rows in orders
        ]
        self._nested = np.arange(len(A) - nested, len(A))
        self._nested_parts = [part.take(at) for part in applications if (at := _find(part.rows, self._nested)).size]
        self._lock = threading.Lock()
        self._last: _Found | None = None

    def solve(self, w: Array) -> Array:
        """Return the unknowns, (G, s), for knowns (G, k); not numbers where there is no solution."""
        with self._turn():
            return self._find(w).v[:, : self._s].copy()

    def differentiate(self, w: Array) -> Array:
        """Return dz/dw, (G, s, k)."""
        with self._turn():
            return self._differentiate(self._find(w)).copy()

    def curve(self, w: Array, gradient: Array) -> Array:
        """Return the Hessian by w, (G, k, k), that equations add to a function with a gradient by z, (G, s)."""
        with self._turn():
            found = self._find(w)
            slopes = self._differentiate(found)
            assert found.factors is not None, "slopes are made with them"
            mu = -found.factors.solve_transposed(gradient)
            whole = np.zeros((self._count, slopes.shape[2], slopes.shape[2]))
            for part in self.applications:
                curvature = part.curvature(found.v, mu[:, part.rows])
                for p, C in enumerate(part.C):
                    Y = C[:, : self._s] @ slopes + C[:, self._s :]
                    whole += Y.transpose(0, 2, 1) @ (curvature[:, p] @ Y)
            return whole

    @cached_property
    def slope_pattern(self) -> Mask:
        """Mark the entries of dz/dw, (s, k), that may be nonzero: all of each known that the equations read."""
        read = self.A != 0
        for part in self.applications:
            for rows, C in zip(part.rows, part.C, strict=True):
                read[rows] |= _reaches(part.slope_pattern, C != 0)
        known: Mask = read[:, self._s :].any(axis=0)
        return np.broadcast_to(known, (self._s, known.size))

    @cached_property
    def curvature_pattern(self) -> Mask:
        """Mark the entries of `curve`, (k, k), that may be nonzero."""
        k = self.A.shape[1] - self._s
        pattern = np.zeros((k, k), dtype=bool)
        for part in self.applications:
            for C in part.C:
                Y = (C[:, self._s :] != 0) | _reaches(C[:, : self._s] != 0, self.slope_pattern)
                pattern |= _reaches(Y.T, _reaches(part.curvature_pattern, Y))
        return pattern

    # --- one place ---

    @contextmanager
    def _turn(self) -> Iterator[None]:
        """Hold other threads off; pass on numbers that are not finite."""
        with self._lock, np.errstate(all="ignore"):
            yield

    @property
    def _s(self) -> int:
        return len(self.A)

    def _find(self, w: Array) -> _Found:
        key = w.tobytes()
        if self._last is None or self._last.key != key:
            z = np.zeros((self._count, self._s))
            v = np.concatenate((z, w), axis=1)
            if not (self._substitute(v) if self.orders else self._iterate(v)):
                v[:, : self._s] = np.nan
            self._last = _Found(key, v)
        return self._last

    def _differentiate(self, found: _Found) -> Array:
        if found.slopes is None:
            slopes = self._slopes(found.v)
            found.factors = Factors(slopes[:, :, : self._s])
            found.slopes = -found.factors.solve(slopes[:, :, self._s :])
        return found.slopes

    def _substitute(self, v: Array) -> bool:
        """Solve order by order."""
        for rows, parts in self.orders:
            v[:, rows] -= self._residual(v, parts)[:, rows]
        return bool(np.isfinite(v).all())

    def _iterate(self, v: Array) -> bool:
        """Solve by Newton's method; return whether it ends.

        Slopes are kept as long as steps shrink quickly with them. A step that does not is not taken, so the solution is
        the one that Newton's method finds with slopes of every place.
        """
        z, last = v[:, : self._s], np.inf
        kept: Factors | None = None
        if not self._solve_nested(v):
            return False
        for _ in range(ITERATIONS):
            r = self._residual(v)
            if kept is not None:
                step = kept.solve_transposed(r)
                moved = _measure(step, z)
                if moved <= SLOW * last:
                    z -= step
                    if not self._solve_nested(v):
                        return False
                    if moved * moved <= ROUNDING * last:
                        return True
                    last = moved
                    continue
            # of the transposed: for one right-hand side that is quicker
            kept = Factors(self._slopes(v, unknowns_only=True).transpose(0, 2, 1))
            step = kept.solve_transposed(r)
            last = _measure(step, z)
            z -= step
            if not np.isfinite(last) or not self._solve_nested(v):
                return False
            if last <= STEP:
                return True
        return False

    def _solve_nested(self, v: Array) -> bool:
        """Solve the nested equations for their unknowns by Newton's method; return whether it ends."""
        own = self._nested
        if not own.size:
            return True
        for _ in range(ITERATIONS):
            r = np.ascontiguousarray(self._residual(v, self._nested_parts)[:, own])
            slopes = self._slopes(v, unknowns_only=True, parts=self._nested_parts)[:, own[:, None], own]
            step = Factors(slopes.transpose(0, 2, 1)).solve_transposed(r)
            moved = _measure(step, v[:, own])
            v[:, own] -= step
            if moved <= STEP:
                return True
            if not np.isfinite(moved):
                return False
        return False

    def _residual(self, v: Array, parts: Sequence[Application] | None = None) -> Array:
        """Return the equations' values, (G, s); with some parts, of the rows alone to which no others add."""
        r = np.ascontiguousarray((self._sparse @ v.T).T)
        for part in self.applications if parts is None else parts:
            r[:, part.rows] += part.value(v)
        return r

    def _slopes(self, v: Array, *, unknowns_only: bool = False, parts: Sequence[Application] | None = None) -> Array:
        """Return the equations' derivatives by unknowns and knowns, (G, s, s + k), or by unknowns, (G, s, s).

        With some parts, of the rows alone to which no others add.
        """
        columns = slice(self._s if unknowns_only else None)
        J = np.repeat(self.A[None, :, columns], self._count, axis=0)
        for part in self.applications if parts is None else parts:
            slopes = part.slopes(v)
            for p, rows in enumerate(part.rows):
                J[:, rows] += slopes[:, p] @ part.C[p, :, columns]
        return J


@dataclass(frozen=True)
class Inner:
    """All inner variables of a program that are solved for, z, by the variables x that stay."""

    parts: tuple[Elimination, ...]  # each of intervals that are alike
    kept: Indices  # the variables of the program that stay

    @cached_property
    def unknowns(self) -> Indices:
        """The variables z of the program."""
        return np.concatenate([part.groups.unknowns.ravel() for part in self.parts])

    @cached_property
    def slopes(self) -> Entries:
        """The places of dz/dx, (z, x)."""
        first, found = 0, []
        for part, knowns in zip(self.parts, self._knowns, strict=True):
            row = first + np.arange(part.groups.unknowns.size).reshape(*part.groups.unknowns.shape, 1)
            found.append(_place(row, knowns[:, None, :], part.slope_pattern))
            first += part.groups.unknowns.size
        return _stack(found)

    @cached_property
    def curvature(self) -> Entries:
        """The places of the term that equations add to a Hessian, (x, x); groups may share places."""
        pairs = zip(self.parts, self._knowns, strict=True)
        return _stack([_place(known[:, :, None], known[:, None, :], part.curvature_pattern) for part, known in pairs])

    def solve(self, x: Array) -> Array:
        """Return z; not numbers where there is no solution."""
        pairs = zip(self.parts, self._knowns, strict=True)
        return np.concatenate([part.solve(x[knowns]).ravel() for part, knowns in pairs])

    def differentiate(self, x: Array) -> Array:
        """Return dz/dx at the places of `slopes`."""
        pairs = zip(self.parts, self._knowns, strict=True)
        return np.concatenate([part.differentiate(x[knowns]).ravel() for part, knowns in pairs])

    def curve(self, x: Array, gradient: Array) -> Array:
        """Return the term that equations add to a Hessian, at the places of `curvature`; the gradient is by z."""
        first, found = 0, []
        for part, knowns in zip(self.parts, self._knowns, strict=True):
            size = part.groups.unknowns.size
            by_z = gradient[first : first + size].reshape(part.groups.unknowns.shape)
            found.append(part.curve(x[knowns], by_z).ravel())
            first += size
        return np.concatenate(found)

    @cached_property
    def _knowns(self) -> tuple[Indices, ...]:
        """(G, k) of each part: where the knowns of each group are in x."""
        return tuple(np.searchsorted(self.kept, part.groups.knowns) for part in self.parts)


@dataclass(frozen=True)
class Entries:
    """The places of a matrix's entries, and which of them may be nonzero."""

    row: Indices
    col: Indices
    mask: Mask


def _place(row: Indices, col: Indices, mask: Mask) -> Entries:
    return Entries(*(part.ravel() for part in np.broadcast_arrays(row, col, mask)))


def _stack(parts: Sequence[Entries]) -> Entries:
    return Entries(*(np.concatenate([getattr(x, name) for x in parts]) for name in ("row", "col", "mask")))


def eliminate(program: Program, bind: Callable[[int], Bind]) -> Inner:
    """Read the inner equations of a program that are solved; `bind` binds functions to the kernels of a plant."""
    parts = tuple(_eliminate_part(program, part.stages, bind(part.plant)) for part in program.solved)
    return Inner(parts, program.kept)


def _eliminate_part(program: Program, stages: Stages, bind: Bind) -> Elimination:
    """Read equations, which read no parameters, for all intervals of some stages, which are alike."""
    G, S, size = stages.inner.shape
    equations = program.restrict(stages.equations.ravel())
    common = np.broadcast_to(stages.common, (G, stages.common.size))
    groups = Groups(stages.inner.reshape(G, -1), np.concatenate((stages.states[:-1], stages.inputs, common), axis=1))
    order = np.concatenate((groups.unknowns, groups.knowns), axis=1)  # (G, s + k)
    column = np.full(program.variables, -1)  # where a variable stands in its group
    column[order] = np.arange(order.shape[1])
    parts = [_read_block(block, column, order.shape, S * size, bind) for block in equations.blocks]
    A = _localise(sparse.csr_array(equations.A), (G, S * size, order.shape[1]), column)
    orders = list(np.arange(S * size).reshape(S, size)) if stages.is_triangular else []
    return Elimination(A, parts, groups, orders, stages.nested)


def _read_block(block: Block, column: Indices, shape: tuple[int, ...], equations: int, bind: Bind) -> Application:
    """Read what each group applies of a block; `shape` counts groups and their variables."""
    assert (block.data, block.parameters.size) == (None, 0), "equations read variables alone"
    groups, width = shape
    places = np.argsort(block.stages, kind="stable").reshape(groups, -1)  # (G, P)
    first = block.stages.min()
    assert (block.stages[places] == first + np.arange(groups)[:, None]).all(), "groups are alike"
    rows, scales = block.rows[:, places].transpose(1, 2, 0), block.scales[places]
    assert (rows // equations == np.arange(groups)[:, None, None]).all(), "a place adds to rows of its stage"
    rows = rows % equations
    assert (rows == rows[0]).all(), "groups are alike"
    assert np.unique(rows[0]).size == rows[0].size, "no two places add to a row"
    parts = [_read_part(part, places, column, width) for part in block.columns]
    if block.factor is not None:
        parts.append(_read_part(np.full((1, block.places), block.factor), places, column, width))
        bind = _multiply(bind)
    return Application(bind, block.function, np.concatenate(parts, axis=1), rows[0], scales, groups)


def _multiply(bind: Bind) -> Bind:
    """Bind the product of a function and one more argument, of size 1."""
    return lambda function, places: _Product(bind(function, places))


class _Product:
    """The evaluation of t F(arguments), by the arguments and by t."""

    def __init__(self, inner: Evaluation) -> None:
        self._inner = inner
        self._results = inner.jacobian_patterns[0].shape[0]

    @property
    def sizes(self) -> tuple[int, ...]:
        return (*self._inner.sizes, 1)

    @cached_property
    def jacobian_patterns(self) -> tuple[Pattern, ...]:
        return (*self._inner.jacobian_patterns, _fill(self._results, 1))

    @cached_property
    def hessian_patterns(self) -> tuple[Pattern, ...]:
        n, inner = len(self._inner.sizes), self._inner.hessian_patterns
        rows = [(*inner[i * n : (i + 1) * n], _fill(size, 1)) for i, size in enumerate(self._inner.sizes)]
        last = (*(_fill(1, size) for size in self._inner.sizes), _fill(1, 0))
        return tuple(pattern for row in (*rows, last) for pattern in row)

    def value(self, arguments: Sequence[Array]) -> Array:
        return arguments[-1] * self._inner.value(arguments[:-1])

    def jacobian(self, arguments: Sequence[Array]) -> Sequence[Array]:
        value = self._inner.value(arguments[:-1]).copy()
        return [*(arguments[-1] * part for part in self._inner.jacobian(arguments[:-1])), value]

    def hessian(self, arguments: Sequence[Array], weights: Array) -> Sequence[Array]:
        *given, t = arguments
        n, gradients = len(given), []
        for pattern, values in zip(self._inner.jacobian_patterns, self._inner.jacobian(given), strict=True):
            gradient = np.zeros((pattern.shape[1], len(t)))
            np.add.at(gradient, pattern.col, (values * weights[:, pattern.row]).T)
            gradients.append(gradient.T)
        inner = [t * part for part in self._inner.hessian(given, weights)]
        rows = [[*inner[i * n : (i + 1) * n], gradients[i]] for i in range(n)]
        return [part for row in (*rows, [*gradients, np.zeros((len(t), 0))]) for part in row]


def _fill(rows: int, cols: int) -> Pattern:
    """Return the pattern of a matrix that is full."""
    row, col = np.divmod(np.arange(rows * cols), max(cols, 1))
    return Pattern((rows, cols), row, col)


def _read_part(part: Column, places: Indices, column: Indices, width: int) -> Array:
    """Return the matrix, (P, size, width), of a part at the places of a group, by the variables of the group."""
    P = places.shape[1]
    if isinstance(part, np.ndarray):
        local, coefficients = column[part[:, places]].transpose(1, 2, 0), np.ones((P, len(part)))
        C, at = np.zeros((P, len(part), width)), (np.arange(P)[:, None], np.arange(len(part)), local[0])
    else:
        which, local = part.which[places], column[part.variables[places]]
        assert (which == which[0]).all(), "groups are alike"
        coefficients = part.matrices[which[0]]
        C = np.zeros((P, part.size, width))
        at = (np.arange(P)[:, None, None], np.arange(part.size)[:, None], local[0][:, None, :])
    assert (local >= 0).all(), "the equations read their knowns and unknowns alone"
    assert (local == local[0]).all(), "groups are alike"
    np.add.at(C, at, coefficients)
    return C


def _localise(matrix: sparse.csr_array, shape: tuple[int, int, int], column: Indices) -> Array:
    """Return the rows that all groups have in common, by the variables of a group; `matrix` holds all, in turn."""
    groups, size, width = shape
    matrix.sum_duplicates()
    r, c = matrix.tocoo().coords
    owner, row, col = r // size, r % size, column[c]
    assert (col >= 0).all(), "the equations read their knowns and unknowns alone"
    order = np.lexsort((col, row, owner))
    owners, rows, cols, data = (part[order].reshape(groups, -1) for part in (owner, row, col, matrix.data))
    assert (owners == np.arange(groups)[:, None]).all(), "groups are alike"
    assert all((part == part[0]).all() for part in (rows, cols, data)), "groups are alike"
    local = np.zeros((size, width))
    local[rows[0], cols[0]] = data[0]
    return local


def _find(rows: Indices, wanted: Indices) -> Indices:
    """Find the places, (P, results), whose rows are given."""
    return np.flatnonzero(np.isin(rows[:, 0], wanted))


def _measure(step: Array, z: Array) -> float:
    """Measure a step relative to the unknowns that it leads to."""
    return float(np.abs(step).max() / (1 + np.abs(z - step).max()))


def _flatten(pattern: Pattern, top: int, left: int, width: int) -> Indices:
    """Number the nonzeros of a block in a flattened matrix that has it at (top, left)."""
    return (pattern.row + top) * width + pattern.col + left


def _spread(found: Sequence[Array], places: Sequence[Indices], shape: tuple[int, int]) -> Array:
    """Put the nonzeros of blocks, (G, nonzeros) each, into dense matrices."""
    whole = np.zeros((len(found[0]), shape[0] * shape[1]))
    for values, at in zip(found, places, strict=True):
        whole[:, at] = values
    return whole.reshape(-1, *shape)


def _mark(places: Sequence[Indices], shape: tuple[int, int]) -> Mask:
    mask = np.zeros(shape, dtype=bool)
    mask.ravel()[np.concatenate(places)] = True
    return mask


def _reaches(first: Mask, second: Mask) -> Mask:
    """Return the pattern of a product."""
    return np.asarray((first.astype(np.int64) @ second.astype(np.int64)) > 0)
