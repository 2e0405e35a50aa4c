"""A nonlinear program as a linear part and functions applied at many places; exact derivatives, assembled directly.

    minimise    f(x) = sum_i w_i c_i(x),  c_i(x) = 1/2 x' H_i x + sum over cost blocks and places of their results
    subject to  lower <= g(x) <= upper,   g(x) = A x + sum over blocks and places of their results

A block applies a function F at many places, to parts of x or to linear combinations of them; its results go to rows of
g, or of c. The Jacobian of g is A plus the nonzeros of F's Jacobian put where they belong, the Hessian of the
Lagrangian is that of f plus those of F's adjoint's Jacobian: no differentiation of the whole is needed, and its pattern
is as exact as the patterns of A, H_i and F. Parameters p are the weights w, then constants that functions may read.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Protocol

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy import sparse

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
Matrix = sparse.csc_array

_NO_PARAMETERS: Indices = np.zeros(0, dtype=np.int64)


@dataclass(frozen=True)
class Block:
    """A function with one vector of results, applied at several places: scale * x[factor] * F(parts of x, p, data).

    A part of x is told by indices, (size, places); or by a matrix, (places * size, variables): the part at place k is
    rows k * size and following of its product with x.
    """

    function: ca.Function
    columns: tuple[Indices | Matrix, ...]  # the parts of x, F's first inputs
    rows: Indices  # (size of the result, places) indices into g, or into the weights
    parameters: Indices = field(default_factory=_NO_PARAMETERS.copy)  # F's next input, if any: indices into p
    data: Array | None = None  # F's last input, if any: numbers, (size, places)
    scale: Array | float = 1.0  # (places,), or one for all
    factor: int | None = None  # the variable that all results are multiplied by, if one is

    @property
    def places(self) -> int:
        """Count the places."""
        return int(self.rows.shape[1])

    @property
    def scales(self) -> Array:
        """Give the scale of every place."""
        return np.broadcast_to(np.asarray(self.scale, dtype=np.float64), self.places)

    def restrict(self, at: Indices) -> Block | None:
        """Keep the places whose results go to rows that `at` gives a new number, which is negative for the others."""
        rows = at[self.rows]
        (chosen,) = np.nonzero((rows >= 0).all(axis=0))
        assert (np.delete(rows, chosen, axis=1) < 0).all(), "the results of a place stay together"
        if not chosen.size:
            return None
        columns = tuple(
            part[:, chosen] if isinstance(part, np.ndarray) else _take_places(part, chosen, self.places)
            for part in self.columns
        )
        data = None if self.data is None else self.data[:, chosen]
        return replace(self, columns=columns, rows=rows[:, chosen], data=data, scale=self.scales[chosen])


@dataclass(frozen=True)
class _Triplets:
    """Entries of a matrix: coefficient * values[source], at (row, col)."""

    row: Indices
    col: Indices
    coefficient: Array
    source: Indices
    values: ca.MX

    def upper(self) -> _Triplets:
        """Keep the upper triangle."""
        kept = np.flatnonzero(self.row <= self.col)
        return _Triplets(self.row[kept], self.col[kept], self.coefficient[kept], self.source[kept], self.values)

    def times(self, factor: ca.MX) -> _Triplets:
        """Multiply the values."""
        return _Triplets(self.row, self.col, self.coefficient, self.source, factor * self.values)

    def transposed(self) -> _Triplets:
        """Swap rows and columns."""
        return _Triplets(self.col, self.row, self.coefficient, self.source, self.values)


class NonlinearProgram(Protocol):
    """What a solver needs: sizes, and functions with the exact derivatives that they have in `Program`."""

    @property
    def variables(self) -> int: ...

    @property
    def constraints(self) -> int: ...

    @property
    def parameters(self) -> int: ...

    @property
    def objective(self) -> ca.Function: ...

    @property
    def constraint(self) -> ca.Function: ...

    @property
    def gradient(self) -> ca.Function: ...

    @property
    def jacobian(self) -> ca.Function: ...

    @property
    def hessian(self) -> ca.Function: ...


@dataclass(frozen=True)
class Program:
    """The program; shapes: A (constraints, variables), each H_i (variables, variables) and symmetric."""

    A: Matrix
    H: tuple[Matrix, ...]  # one for each weight
    blocks: tuple[Block, ...]
    costs: tuple[Block, ...] = ()
    constants: int = 0  # how many parameters follow the weights

    @property
    def variables(self) -> int:
        """Count the entries of x."""
        return self.A.shape[1]

    @property
    def constraints(self) -> int:
        """Count the entries of g."""
        return self.A.shape[0]

    @property
    def parameters(self) -> int:
        """Count the entries of p."""
        return len(self.H) + self.constants

    def restrict(self, rows: Indices, *, with_cost: bool = False) -> Program:
        """Keep some rows of g, in the order given, and the cost or none; variables and parameters are the same."""
        at = np.full(self.constraints, -1)
        at[rows] = np.arange(rows.size)
        blocks = tuple(kept for block in self.blocks if (kept := block.restrict(at)) is not None)
        A = sparse.csr_array(self.A)[rows].tocsc()
        if with_cost:
            return replace(self, A=A, blocks=blocks)
        return replace(self, A=A, H=tuple(sparse.csc_array(H.shape) for H in self.H), blocks=blocks, costs=())

    @cached_property
    def terms(self) -> ca.Function:
        """(x, p) -> c: the terms of the cost, without their weights."""
        x, p = self._symbols()
        return ca.Function("nlp_c", [x, p], [self._terms(x, p)], ["x", "p"], ["c"])

    @cached_property
    def objective(self) -> ca.Function:
        """(x, p) -> f."""
        x, p = self._symbols()
        return ca.Function("nlp_f", [x, p], [self._cost(x, p)], ["x", "p"], ["f"])

    @cached_property
    def constraint(self) -> ca.Function:
        """(x, p) -> g."""
        x, p = self._symbols()
        return ca.Function(
            "nlp_g", [x, p], [self._residual(x, [_results(block, x, p) for block in self.blocks])], ["x", "p"], ["g"]
        )

    @cached_property
    def gradient(self) -> ca.Function:
        """(x, p) -> f, its gradient: in the form that `nlpsol` takes as `grad_f`."""
        x, p = self._symbols()
        gradient = sum((p[i] * (to_casadi(H) @ x) for i, H in enumerate(self.H)), start=ca.MX.zeros(self.variables))
        for block in self.costs:
            for part in _derivative(block, x, p, p[_flat(block.rows)]):
                gradient += _sum_into(part.row, part.coefficient, part.source, part.values, self.variables)
        return ca.Function("nlp_grad_f", [x, p], [self._cost(x, p), gradient], ["x", "p"], ["f", "grad_f_x"])

    @cached_property
    def jacobian(self) -> ca.Function:
        """(x, p) -> g, its Jacobian: in the form that `nlpsol` takes as `jac_g`."""
        x, p = self._symbols()
        results = [_results(block, x, p) for block in self.blocks]
        parts = [_constant(self.A)]
        for block, values in zip(self.blocks, results, strict=True):
            parts += _jacobian(block, x, p, values)
        outputs = [self._residual(x, results), _assemble(self.A.shape, parts)]
        return ca.Function("nlp_jac_g", [x, p], outputs, ["x", "p"], ["g", "jac_g_x"])

    @cached_property
    def hessian(self) -> ca.Function:
        """(x, p, lam_f, lam_g) -> upper triangle of the Hessian of lam_f f + lam_g' g, as `nlpsol` takes it."""
        x, p = self._symbols()
        lam_f, lam_g = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", self.constraints)
        parts = [_weighted(self.H, lam_f * p[: len(self.H)]).upper()]
        for blocks, lam in ((self.blocks, lam_g), (self.costs, lam_f * p)):
            for block in blocks:
                parts += [part.upper() for part in _hessian(block, x, p, lam[_flat(block.rows)])]
        hessian = _assemble((self.variables, self.variables), parts)
        return ca.Function(
            "nlp_hess_l", [x, p, lam_f, lam_g], [hessian], ["x", "p", "lam_f", "lam_g"], ["hess_gamma_x_x"]
        )

    def _symbols(self) -> tuple[ca.MX, ca.MX]:
        return ca.MX.sym("x", self.variables), ca.MX.sym("p", self.parameters)

    def _cost(self, x: ca.MX, p: ca.MX) -> ca.MX:
        return ca.dot(p[: len(self.H)], self._terms(x, p))

    def _terms(self, x: ca.MX, p: ca.MX) -> ca.MX:
        squares = ca.vertcat(*(ca.dot(x, to_casadi(H) @ x) / 2 for H in self.H))
        return sum((_put(block, x, _results(block, x, p), len(self.H)) for block in self.costs), start=squares)

    def _residual(self, x: ca.MX, results: Sequence[ca.MX]) -> ca.MX:
        put = (_put(block, x, values, self.constraints) for block, values in zip(self.blocks, results, strict=True))
        return sum(put, start=to_casadi(self.A) @ x)


# --- a block and its derivatives -----------------------------------------------------------------------------------


def _results(block: Block, x: ca.MX, p: ca.MX) -> ca.MX:
    """Apply the function at every place: its results, place by place, before they are scaled."""
    return ca.vec(block.function.map(block.places)(*_arguments(block, x, p)))


def _put(block: Block, x: ca.MX, results: ca.MX, size: int) -> ca.MX:
    """Scale the results, and sum them into the rows where they belong."""
    coefficient = np.repeat(block.scales, block.rows.shape[0])
    values = _sum_into(block.rows.T.ravel(), coefficient, np.arange(block.rows.size), results, size)
    return values if block.factor is None else x[block.factor] * values


def _arguments(block: Block, x: ca.MX, p: ca.MX) -> list[ca.MX]:
    parts = [
        ca.reshape(x[_flat(part)] if isinstance(part, np.ndarray) else to_casadi(part) @ x, -1, block.places)
        for part in block.columns
    ]
    if block.parameters.size:
        parts.append(ca.repmat(p[block.parameters.tolist()], 1, block.places))
    if block.data is not None:
        parts.append(ca.MX(ca.DM(block.data)))
    return parts


def _jacobian(block: Block, x: ca.MX, p: ca.MX, results: ca.MX) -> list[_Triplets]:
    """Give the Jacobian at every place, a part for each input; `results` are those of the function."""
    function = block.function.jacobian()
    unread = ca.MX(function.size1_in(function.n_in() - 1), block.places)  # results need not be told
    parts = function.map(block.places).call([*_arguments(block, x, p), unread])
    nonzeros = [ca.vec(part.nz[:]) for part in parts[: len(block.columns)]]
    if block.factor is None:
        return [_scatter(block, function.sparsity_out(i), None, i, values) for i, values in enumerate(nonzeros)]
    scaled = [
        _scatter(block, function.sparsity_out(i), None, i, x[block.factor] * values)
        for i, values in enumerate(nonzeros)
    ]
    rows, size = block.rows.T.ravel(), block.rows.size
    by_factor = _Triplets(
        rows, np.full(size, block.factor), np.repeat(block.scales, block.rows.shape[0]), np.arange(size), results
    )
    return [*scaled, by_factor]


def _derivative(block: Block, x: ca.MX, p: ca.MX, lam: ca.MX) -> list[_Triplets]:
    """Give the derivative of lam' F as columns, a part for each input; `lam` place by place."""
    adjoint, jacobian = block.function.reverse(1), block.function.jacobian()
    n = block.function.n_in()
    weights = ca.reshape(lam, block.rows.shape[0], block.places)
    unread = ca.MX(adjoint.size1_in(n), block.places * adjoint.size2_in(n))
    products = adjoint.map(block.places).call([*_arguments(block, x, p), unread, weights])[: len(block.columns)]
    parts = []
    for i, product in enumerate(products):
        felt = sorted(
            set(jacobian.sparsity_out(i).get_triplet()[1])
        )  # an adjoint may be dense where F's Jacobian is not
        pattern = ca.Sparsity.triplet(product.size1(), 1, felt, [0] * len(felt))
        values = ca.project(product, ca.repmat(pattern, 1, block.places))
        parts.append(_scatter(block, pattern, i, None, ca.vec(values.nz[:])))
    if block.factor is None:
        return parts
    zero = np.zeros(block.rows.size, dtype=np.int64)
    by_factor = _Triplets(
        zero + block.factor,
        zero,
        np.repeat(block.scales, block.rows.shape[0]),
        np.arange(block.rows.size),
        lam * _results(block, x, p),
    )
    return [*(part.times(x[block.factor]) for part in parts), by_factor]


def _hessian(block: Block, x: ca.MX, p: ca.MX, lam: ca.MX) -> list[_Triplets]:
    """Give the Hessian of lam' F at every place, a part for each pair of inputs; `lam` place by place."""
    n, inputs = len(block.columns), block.function.n_in()
    function = block.function.reverse(1).jacobian()  # inputs: F's, its result, lam, the adjoint's results
    factored = lam if block.factor is None else x[block.factor] * lam
    weights = ca.reshape(factored, block.rows.shape[0], block.places)
    unread = [ca.MX(function.size1_in(k), block.places * function.size2_in(k)) for k in range(function.n_in())]
    results = function.map(block.places).call(
        [*_arguments(block, x, p), unread[inputs], weights, *unread[inputs + 2 :]]
    )
    which = {(i, j): i * (inputs + 2) + j for i in range(n) for j in range(n)}
    parts = [
        _scatter(block, function.sparsity_out(k), i, j, ca.vec(results[k].nz[:]))
        for (i, j), k in which.items()
        if function.nnz_out(k)
    ]
    if block.factor is None:
        return parts
    unfactored = Block(block.function, block.columns, block.rows, block.parameters, block.data, block.scale)
    edge = [
        _Triplets(part.row, np.full(part.row.size, block.factor), part.coefficient, part.source, part.values)
        for part in _derivative(unfactored, x, p, lam)
    ]
    return [*parts, *edge, *(part.transposed() for part in edge)]


def _scatter(block: Block, pattern: ca.Sparsity, row: int | None, col: int | None, values: ca.MX) -> _Triplets:
    """Say where the nonzeros of a mapped matrix belong; `values` holds one matrix per place.

    Its rows are of the input `row`, its columns of the input `col`; None for a row is the block's results, for a column
    the only one.
    """
    places = np.arange(block.places)[:, None]
    rows, cols = (np.asarray(k, dtype=np.int64) for k in pattern.get_triplet())
    source = np.arange(block.places * rows.size)
    coefficient = np.repeat(block.scales, rows.size)
    if row is None:
        row_at = block.rows[rows].T.ravel()
    else:
        which, row_at, factor = _makings(block, row, (places * pattern.size1() + rows).ravel())
        source, coefficient = source[which], coefficient[which] * factor
    if col is None:
        col_at = np.zeros_like(row_at)
    else:
        which, col_at, factor = _makings(block, col, (places * pattern.size2() + cols).ravel()[source])
        row_at, source, coefficient = row_at[which], source[which], coefficient[which] * factor
    return _Triplets(row_at, col_at, coefficient, source, values)


def _makings(block: Block, part: int, entries: Indices) -> tuple[Indices, Indices, Array]:
    """Say which variables make some entries of a part of x: position in `entries`, variable and coefficient."""
    columns = block.columns[part]
    if isinstance(columns, np.ndarray):
        return np.arange(entries.size), columns.T.ravel()[entries], np.ones(entries.size)
    rows = sparse.csr_array(columns)
    first = rows.indptr[entries].astype(np.int64)
    counts = rows.indptr[entries + 1] - first
    which = np.repeat(np.arange(entries.size), counts)
    at = np.arange(which.size) - np.repeat(np.cumsum(counts) - counts, counts) + first[which]
    return which, rows.indices[at].astype(np.int64), rows.data[at]


def _take_places(part: Matrix, chosen: Indices, places: int) -> Matrix:
    """Take the rows of some places."""
    size = part.shape[0] // places
    return sparse.csr_array(part)[(chosen[:, None] * size + np.arange(size)).ravel()].tocsc()


# --- matrices ------------------------------------------------------------------------------------------------------


def _flat(indices: Indices) -> list[int]:
    """List indices place by place."""
    return [int(i) for i in indices.T.ravel()]


def _constant(matrix: Matrix) -> _Triplets:
    coo = matrix.tocoo()
    row, col = (k.astype(np.int64) for k in coo.coords)
    return _Triplets(row, col, np.ones(coo.nnz), np.arange(coo.nnz), ca.MX(ca.DM(coo.data)))


def _weighted(matrices: Sequence[Matrix], weights: ca.MX) -> _Triplets:
    """Sum constant matrices with weights that are not."""
    coos = [matrix.tocoo() for matrix in matrices]
    row, col = (np.concatenate([c.coords[axis] for c in coos]).astype(np.int64) for axis in (0, 1))
    which = np.repeat(np.arange(len(coos)), [c.nnz for c in coos])
    return _Triplets(row, col, np.concatenate([c.data for c in coos]), which, weights)


def _sum_into(row: Indices, coefficient: Array, source: Indices, values: ca.MX, size: int) -> ca.MX:
    """Give the vector of which each entry is the sum of coefficient * values[source] of its row."""
    return to_casadi(sparse.coo_array((coefficient, (row, source)), shape=(size, values.numel())).tocsc()) @ values


def _assemble(shape: tuple[int, int], parts: Sequence[_Triplets]) -> ca.MX:
    """Sum the parts into one sparse matrix."""
    parts = [part for part in parts if part.row.size]
    if not parts:
        return ca.MX(*shape)
    row, col = np.concatenate([p.row for p in parts]), np.concatenate([p.col for p in parts])
    coefficient = np.concatenate([p.coefficient for p in parts])
    offsets = np.cumsum([0, *(p.values.numel() for p in parts)])
    source = np.concatenate([p.source + offset for p, offset in zip(parts, offsets[:-1], strict=True)])
    places, nonzero = np.unique(col * shape[0] + row, return_inverse=True)  # column by column: CasADi's order
    pattern = ca.Sparsity.triplet(*shape, (places % shape[0]).tolist(), (places // shape[0]).tolist())
    values = ca.vertcat(*(p.values for p in parts))
    if len(places) == len(row) and (coefficient == 1.0).all():  # no two meet: a permutation, not a sum
        return ca.MX(pattern, values[source[np.argsort(nonzero)].tolist()])
    return ca.MX(pattern, _sum_into(nonzero, coefficient, source, values, len(places)))


def to_casadi(matrix: Matrix) -> ca.DM:
    """Give a sparse matrix as CasADi's."""
    return ca.DM(ca.Sparsity(*matrix.shape, matrix.indptr.tolist(), matrix.indices.tolist()), matrix.data)
