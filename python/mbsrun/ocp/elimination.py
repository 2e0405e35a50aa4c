"""Unknowns that groups of equations give: solved for at one place after another, with derivatives, never twice.

The groups are alike: each holds the same functions, applied to the same linear combinations y = C (z; w) of its
unknowns z and its knowns w, so what one group has as matrices all have, and all are computed at once:

    r(z, w) = A (z; w) + sum over applications of scale * F(C (z; w)) = 0
    dz/dw = -r_z^-1 r_w,    mu = -r_z^-T gradient,    the Hessian of mu' r by w = sum of Y' (that of mu' F) Y,
    with Y = C (dz/dw; 1).

What is found belongs to the knowns that it was found for, and is kept with them: asked for again at the very same
numbers, whoever asks, it is there; at any others it is computed.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from mbsrun.ocp.factors import Factors
from mbsrun.ocp.program import Block, Indices, Program

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

ITERATIONS = 30  # of Newton's method, before the equations count as having no solution
STEP = 1e-8  # relative to unknowns above 1: a step so small leaves an error of its square, with slopes of its own place
ROUNDING = 1e-13  # likewise, of what is left where steps shrink by a known rate
SLOW = 0.05  # the rate above which slopes are computed anew


@dataclass(frozen=True)
class Groups:
    """Equations that share no unknowns: G groups of as many equations as unknowns, in matching order."""

    unknowns: Indices  # (G, s): variables of the program
    equations: Indices  # (G, s): rows of it
    knowns: Indices  # (G, k): the other variables that the equations feel; none is in two groups


class Call:
    """A function mapped over places, on buffers of its own: (places, nonzeros) for each input and result."""

    def __init__(self, function: ca.Function, places: int, inputs: Sequence[int], results: Sequence[int]) -> None:
        """Bind some inputs and results, by number; other inputs are zeros, other results are not wanted."""
        mapped = function.map(places)
        self._buffer, self._run = mapped.buffer()
        self.inputs = [np.zeros((places, function.nnz_in(i))) for i in inputs]
        self.results = [np.zeros((places, function.nnz_out(j))) for j in results]
        for i, array in zip(inputs, self.inputs, strict=True):
            self._buffer.set_arg(i, array.data)  # type: ignore[call-arg]  # the size is read off it
        for j, array in zip(results, self.results, strict=True):
            if array.size:
                self._buffer.set_res(j, array.data)  # type: ignore[call-arg]

    def __call__(self, arguments: Sequence[Array]) -> list[Array]:
        """Evaluate; the results are overwritten by the next call, and not numbers where the function fails."""
        for held, given in zip(self.inputs, arguments, strict=True):
            held[:] = given
        self._run()
        if self._buffer.ret():
            for array in self.results:
                array[:] = np.nan
        return self.results


class Application:
    """A function that every one of G groups applies at P places, with its derivatives."""

    def __init__(self, block: Block, C: Array, rows: Indices, scale: Array, groups: int) -> None:
        """C is (P, size of all arguments, unknowns and knowns of a group), rows (P, results), scale (P,)."""
        self.C, self.rows, self.scale = C, rows, scale
        self._block, self._groups = block, groups
        self._function, self._n = block.function, len(block.columns)
        self._bounds = np.cumsum([0, *(self._function.size1_in(i) for i in range(self._n))])

    def take(self, places: Indices) -> Application:
        """Keep some of the P places."""
        return Application(self._block, self.C[places], self.rows[places], self.scale[places], self._groups)

    def value(self, v: Array) -> Array:
        """Give the results at (G, unknowns and knowns), scaled: (G, P, results)."""
        (found,) = self._value(self._split(v))
        return self.scale[:, None] * found.reshape(self._groups, *self.rows.shape)

    def slopes(self, v: Array) -> Array:
        """Give the derivatives of the results by their arguments, scaled: (G, P, results, size of all arguments)."""
        found = _spread(self._slopes(self._split(v)), self._slope_places, self._slope_shape)
        return self.scale[:, None, None] * found.reshape(self._groups, -1, *self._slope_shape)

    def curvature(self, v: Array, multipliers: Array) -> Array:
        """Give the Hessian of multipliers' results, scaled: (G, P, size of all arguments, the same)."""
        weights = (self.scale[:, None] * multipliers).reshape(-1, self.rows.shape[1])
        found = self._curvature([*self._split(v), weights])
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
        """Give C, its P parts below each other; few of it are not 0, and BLAS would start threads."""
        return sparse.csr_array(self.C.reshape(-1, self.C.shape[2]))

    # --- the function and its derivatives, as CasADi calls them ---

    @cached_property
    def _value(self) -> Call:
        return Call(self._function, self._places, range(self._n), [0])

    @cached_property
    def _slopes(self) -> Call:
        return Call(self._function.jacobian(), self._places, range(self._n), range(self._n))

    @cached_property
    def _curvature(self) -> Call:
        weights = self._function.n_in() + 1  # inputs: F's, its result, weights, the adjoint's results
        return Call(self._adjoint_slopes, self._places, [*range(self._n), weights], self._pairs)

    @cached_property
    def _adjoint_slopes(self) -> ca.Function:
        return self._function.reverse(1).jacobian()

    @property
    def _pairs(self) -> list[int]:
        """Number the results of `_adjoint_slopes` that are second derivatives, row by row."""
        return [i * (self._function.n_in() + 2) + j for i in range(self._n) for j in range(self._n)]

    @property
    def _places(self) -> int:
        return self._groups * len(self.rows)

    @property
    def _slope_shape(self) -> tuple[int, int]:
        return self.rows.shape[1], int(self._bounds[-1])

    @property
    def _curvature_shape(self) -> tuple[int, int]:
        return int(self._bounds[-1]), int(self._bounds[-1])

    @cached_property
    def _slope_places(self) -> list[Indices]:
        """Say where the nonzeros of each block of the slopes lie, in the flattened whole."""
        jacobian = self._function.jacobian()
        return [
            _flatten(jacobian.sparsity_out(i), 0, int(self._bounds[i]), int(self._bounds[-1])) for i in range(self._n)
        ]

    @cached_property
    def _curvature_places(self) -> list[Indices]:
        corners = [(int(a), int(b)) for a in self._bounds[:-1] for b in self._bounds[:-1]]
        patterns = [self._adjoint_slopes.sparsity_out(k) for k in self._pairs]
        width = int(self._bounds[-1])
        return [_flatten(pattern, *corner, width) for pattern, corner in zip(patterns, corners, strict=True)]


@dataclass
class _Found:
    """What is known at one place; None for what nobody asked for."""

    key: bytes
    v: Array  # (G, s + k): unknowns, which are not numbers where there is no solution, then knowns
    factors: Factors | None = None  # of r_z
    slopes: Array | None = None  # (G, s, k): dz/dw


class Elimination:
    """The equations of G groups that are alike, in s unknowns and k knowns each.

    May be called from several threads; all take turns, and share what was found last.
    """

    def __init__(
        self, A: Array, applications: Sequence[Application], groups: int, orders: Sequence[Indices] = ()
    ) -> None:
        """A is (s, s + k); orders are equations of a triangular system with ones on its diagonal, one after another."""
        self.A, self.applications, self.groups = A, applications, groups
        self._sparse = sparse.csr_array(A)
        self.orders = [
            (rows, [part.take(chosen) for part in applications if (chosen := _find(part.rows, rows)).size])
            for rows in orders
        ]
        self._lock = threading.Lock()
        self._last: _Found | None = None

    def solve(self, w: Array) -> Array:
        """Give the unknowns, (G, s), for knowns (G, k); not numbers where there is no solution."""
        with self._turn():
            return self._find(w).v[:, : self._s].copy()

    def differentiate(self, w: Array) -> Array:
        """Give dz/dw, (G, s, k)."""
        with self._turn():
            return self._differentiate(self._find(w)).copy()

    def curve(self, w: Array, gradient: Array) -> Array:
        """Give the Hessian by w, (G, k, k), that equations add to a function with a gradient by z, (G, s)."""
        with self._turn():
            found = self._find(w)
            slopes = self._differentiate(found)
            assert found.factors is not None, "slopes are made with them"
            mu = -found.factors.solve_transposed(gradient)
            whole = np.zeros((self.groups, slopes.shape[2], slopes.shape[2]))
            for part in self.applications:
                curvature = part.curvature(found.v, mu[:, part.rows])
                for p, C in enumerate(part.C):
                    Y = C[:, : self._s] @ slopes + C[:, self._s :]
                    whole += Y.transpose(0, 2, 1) @ (curvature[:, p] @ Y)
            return whole

    @cached_property
    def slope_pattern(self) -> Mask:
        """Tell which of dz/dw, (s, k), may be nonzero: all that stands beside a known that is felt at all."""
        felt = self.A != 0
        for part in self.applications:
            for rows, C in zip(part.rows, part.C, strict=True):
                felt[rows] |= _reaches(part.slope_pattern, C != 0)
        known: Mask = felt[:, self._s :].any(axis=0)
        return np.broadcast_to(known, (self._s, known.size))

    @cached_property
    def curvature_pattern(self) -> Mask:
        """Tell which entries of `curve`, (k, k), may be nonzero."""
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
        """Let others wait; what is not a number goes on as such."""
        with self._lock, np.errstate(all="ignore"):
            yield

    @property
    def _s(self) -> int:
        return len(self.A)

    def _find(self, w: Array) -> _Found:
        key = w.tobytes()
        if self._last is None or self._last.key != key:
            z = np.zeros((self.groups, self._s))
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
        """Solve by Newton's method; tell whether it ends.

        Slopes are kept as long as steps shrink quickly with them. A step that does not is not taken, so what is found
        is what Newton's method finds with slopes of every place.
        """
        z, last = v[:, : self._s], np.inf
        kept: Factors | None = None
        for _ in range(ITERATIONS):
            r = self._residual(v)
            if kept is not None:
                step = kept.solve_transposed(r)
                moved = _measure(step, z)
                if moved <= SLOW * last:
                    z -= step
                    if moved * moved <= ROUNDING * last:
                        return True
                    last = moved
                    continue
            # of the transposed: for one right-hand side that is quicker
            kept = Factors(self._slopes(v, unknowns_only=True).transpose(0, 2, 1))
            step = kept.solve_transposed(r)
            last = _measure(step, z)
            z -= step
            if not np.isfinite(last):
                return False
            if last <= STEP:
                return True
        return False

    def _residual(self, v: Array, parts: Sequence[Application] | None = None) -> Array:
        """Give the equations' values, (G, s); with some parts, of those rows alone that no others add to."""
        r = np.ascontiguousarray((self._sparse @ v.T).T)
        for part in self.applications if parts is None else parts:
            r[:, part.rows] += part.value(v)
        return r

    def _slopes(self, v: Array, *, unknowns_only: bool = False) -> Array:
        """Give the equations' derivatives by unknowns and knowns, (G, s, s + k), or by unknowns, (G, s, s)."""
        columns = slice(self._s if unknowns_only else None)
        J = np.repeat(self.A[None, :, columns], self.groups, axis=0)
        for part in self.applications:
            slopes = part.slopes(v)
            for p, rows in enumerate(part.rows):
                J[:, rows] += slopes[:, p] @ part.C[p, :, columns]
        return J


def eliminate(program: Program, groups: Groups, orders: Sequence[Indices] = ()) -> Elimination:
    """Read the equations of a program, which read no parameters, as those of groups that are alike.

    orders: rows of a group's equations, (size,) each, where each order's are its unknowns minus a function of those
    of the orders before.
    """
    order = np.concatenate((groups.unknowns, groups.knowns), axis=1)  # (G, s + k)
    column = np.full(program.variables, -1)  # where a variable stands in its group
    column[order] = np.arange(order.shape[1])
    row = np.full(program.constraints, -1)
    row[groups.equations] = np.arange(groups.equations.shape[1])
    owner = np.full(program.constraints, -1)
    owner[groups.equations] = np.arange(len(groups.equations))[:, None]
    A = sparse.csr_array(program.A)[groups.equations.ravel()]
    parts = [_read_block(block, column, row, owner, len(order)) for block in program.blocks]
    shape = (len(order), groups.equations.shape[1], order.shape[1])
    return Elimination(_localise(A, shape, column), parts, len(order), orders)


def _read_block(block: Block, column: Indices, row: Indices, owner: Indices, groups: int) -> Application:
    """Say what each group applies of a block."""
    assert (block.data, block.factor, block.parameters.size) == (None, None, 0), "equations read variables alone"
    owners = owner[block.rows[0]]
    places = np.argsort(owners, kind="stable").reshape(groups, -1)  # (G, P)
    assert (owners[places] == np.arange(groups)[:, None]).all(), "groups are alike"
    P, width = places.shape[1], int(column.max()) + 1
    matrices = []
    for part in block.columns:
        if isinstance(part, np.ndarray):
            size, at = len(part), part[:, places.ravel()].T
            ones = (np.ones(at.size), at.ravel(), np.arange(at.size + 1))
            matrix = sparse.csr_array(ones, shape=(at.size, column.size))
        else:
            size = part.shape[0] // block.places
            matrix = sparse.csr_array(part)[(places.reshape(-1, 1) * size + np.arange(size)).ravel()]
        matrices.append(_localise(matrix, (groups, P * size, width), column).reshape(P, size, width))
    rows, scales = row[block.rows[:, places]].transpose(1, 2, 0), block.scales[places]
    assert (rows == rows[0]).all(), "groups are alike"
    assert (scales == scales[0]).all(), "groups are alike"
    assert np.unique(rows[0]).size == rows[0].size, "no two places add to a row"
    return Application(block, np.concatenate(matrices, axis=1), rows[0], scales[0], groups)


def _localise(matrix: sparse.csr_array, shape: tuple[int, int, int], column: Indices) -> Array:
    """Give the rows that all groups have in common, by the variables of a group; `matrix` is those of all, in turn."""
    groups, size, width = shape
    matrix.sum_duplicates()
    r, c = matrix.tocoo().coords
    owner, row, col = r // size, r % size, column[c]
    assert (col >= 0).all(), "the equations feel their knowns and unknowns alone"
    order = np.lexsort((col, row, owner))
    owners, rows, cols, data = (part[order].reshape(groups, -1) for part in (owner, row, col, matrix.data))
    assert (owners == np.arange(groups)[:, None]).all(), "groups are alike"
    assert all((part == part[0]).all() for part in (rows, cols, data)), "groups are alike"
    local = np.zeros((size, width))
    local[rows[0], cols[0]] = data[0]
    return local


def _find(rows: Indices, wanted: Indices) -> Indices:
    """Find the places, (P, results), whose rows are wanted."""
    return np.flatnonzero(np.isin(rows[:, 0], wanted))


def _measure(step: Array, z: Array) -> float:
    """Tell how large a step is beside the unknowns that it leads to."""
    return float(np.abs(step).max() / (1 + np.abs(z - step).max()))


def _flatten(pattern: ca.Sparsity, top: int, left: int, width: int) -> Indices:
    """Say where the nonzeros of a block lie in a flattened matrix that has it at (top, left)."""
    rows, cols = (np.asarray(k, dtype=np.int64) for k in pattern.get_triplet())
    return (rows + top) * width + cols + left


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
    """Give the pattern of a product."""
    return np.asarray((first.astype(np.int64) @ second.astype(np.int64)) > 0)
