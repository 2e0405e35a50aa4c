"""A nonlinear program as a linear part and functions applied at many places; exact derivatives, assembled directly.

    minimise    f(x) = 1/2 sum_i p_i x' H_i x        with weights p
    subject to  lower <= g(x) <= upper,   g(x) = A x + sum over blocks and places of  E_rows F(x[columns])

A block's function F is mapped over its places. The Jacobian of g is A plus the nonzeros of F's Jacobian put where they
belong, the Hessian of the Lagrangian is that of f plus those of F's adjoint's Jacobian: no differentiation of the
whole is needed, and its pattern is as exact as the patterns of A, H_i and F.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy import sparse

Indices = NDArray[np.int64]
Matrix = sparse.csc_array


@dataclass(frozen=True)
class Block:
    """A function of parts of x, with one vector of results, applied at several places."""

    function: ca.Function
    columns: tuple[Indices, ...]  # of each input: (size, places) indices into x
    rows: Indices  # (size of the result, places) indices into g

    @property
    def places(self) -> int:
        """Count the places."""
        return int(self.rows.shape[1])


@dataclass(frozen=True)
class _Triplets:
    """Where the nonzeros of a matrix, listed place by place, belong."""

    row: Indices
    col: Indices
    values: ca.MX

    def upper(self) -> _Triplets:
        """Keep the upper triangle."""
        kept = np.flatnonzero(self.row <= self.col)
        return _Triplets(self.row[kept], self.col[kept], self.values[kept.tolist()])


@dataclass(frozen=True)
class Program:
    """The program; shapes: A (constraints, variables), each H_i (variables, variables) and symmetric."""

    A: Matrix
    H: tuple[Matrix, ...]
    blocks: tuple[Block, ...]

    @property
    def variables(self) -> int:
        """Count the entries of x."""
        return self.A.shape[1]

    @property
    def constraints(self) -> int:
        """Count the entries of g."""
        return self.A.shape[0]

    @cached_property
    def objective(self) -> ca.Function:
        """(x, p) -> f."""
        x, p = self._symbols()
        return ca.Function("nlp_f", [x, p], [ca.dot(x, self._gradient(x, p)) / 2], ["x", "p"], ["f"])

    @cached_property
    def constraint(self) -> ca.Function:
        """(x, p) -> g."""
        x, p = self._symbols()
        return ca.Function("nlp_g", [x, p], [self._residual(x)], ["x", "p"], ["g"])

    @cached_property
    def gradient(self) -> ca.Function:
        """(x, p) -> f, its gradient: in the form that `nlpsol` takes as `grad_f`."""
        x, p = self._symbols()
        gradient = self._gradient(x, p)
        return ca.Function("nlp_grad_f", [x, p], [ca.dot(x, gradient) / 2, gradient], ["x", "p"], ["f", "grad_f_x"])

    @cached_property
    def jacobian(self) -> ca.Function:
        """(x, p) -> g, its Jacobian: in the form that `nlpsol` takes as `jac_g`."""
        x, p = self._symbols()
        parts = [_constant(self.A)]
        for block in self.blocks:
            parts += _jacobian(block, x)
        jacobian = _assemble(self.A.shape, parts)
        return ca.Function("nlp_jac_g", [x, p], [self._residual(x), jacobian], ["x", "p"], ["g", "jac_g_x"])

    @cached_property
    def hessian(self) -> ca.Function:
        """(x, p, lam_f, lam_g) -> upper triangle of the Hessian of lam_f f + lam_g' g, as `nlpsol` takes it."""
        x, p = self._symbols()
        lam_f, lam_g = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", self.constraints)
        parts = [_weighted(self.H, lam_f * p).upper()]
        for block in self.blocks:
            parts += [part.upper() for part in _hessian(block, x, lam_g)]
        hessian = _assemble((self.variables, self.variables), parts)
        return ca.Function(
            "nlp_hess_l", [x, p, lam_f, lam_g], [hessian], ["x", "p", "lam_f", "lam_g"], ["hess_gamma_x_x"]
        )

    def _symbols(self) -> tuple[ca.MX, ca.MX]:
        return ca.MX.sym("x", self.variables), ca.MX.sym("p", len(self.H))

    def _gradient(self, x: ca.MX, p: ca.MX) -> ca.MX:
        return sum((p[i] * (_dm(H) @ x) for i, H in enumerate(self.H)), start=ca.MX.zeros(self.variables))

    def _residual(self, x: ca.MX) -> ca.MX:
        parts = [_dm(self.A) @ x]
        for block in self.blocks:
            values = ca.vec(block.function.map(block.places)(*_arguments(block, x)))
            put = sparse.coo_array(
                (np.ones(block.rows.size), (block.rows.T.ravel(), np.arange(block.rows.size))),
                shape=(self.constraints, block.rows.size),
            )
            parts.append(_dm(put.tocsc()) @ values)
        return sum(parts[1:], start=parts[0])


def _arguments(block: Block, x: ca.MX) -> list[ca.MX]:
    return [ca.reshape(x[c.T.ravel().tolist()], *c.shape) for c in block.columns]


def _jacobian(block: Block, x: ca.MX) -> list[_Triplets]:
    """Give the nonzeros of the Jacobian at every place, a part for each input."""
    function = block.function.jacobian()
    unread = ca.MX(function.size1_in(function.n_in() - 1), block.places)  # results need not be told
    results = function.map(block.places).call([*_arguments(block, x), unread])
    return [
        _scatter(function.sparsity_out(i), block.rows, block.columns[i], result) for i, result in enumerate(results)
    ]


def _hessian(block: Block, x: ca.MX, lam_g: ca.MX) -> list[_Triplets]:
    """Give the nonzeros of the Hessian of lam' F at every place, a part for each pair of inputs."""
    n = len(block.columns)
    function = block.function.reverse(1).jacobian()  # inputs: F's, its result, lam, the adjoint's results
    lam = ca.reshape(lam_g[block.rows.T.ravel().tolist()], *block.rows.shape)
    unread = [ca.MX(function.size1_in(k), block.places * function.size2_in(k)) for k in range(function.n_in())]
    results = function.map(block.places).call([*_arguments(block, x), unread[n], lam, *unread[n + 2 :]])
    return [
        _scatter(function.sparsity_out(i * (n + 2) + j), block.columns[i], block.columns[j], results[i * (n + 2) + j])
        for i in range(n)
        for j in range(n)
        if function.nnz_out(i * (n + 2) + j)
    ]


def _scatter(pattern: ca.Sparsity, rows: Indices, columns: Indices, results: ca.MX) -> _Triplets:
    """Say where the nonzeros of a mapped matrix belong; `results` holds one matrix per place, side by side."""
    row, col = (np.asarray(k, dtype=np.int64) for k in pattern.get_triplet())
    return _Triplets(rows[row].T.ravel(), columns[col].T.ravel(), ca.vec(results.nz[:]))


def _constant(matrix: Matrix) -> _Triplets:
    coo = matrix.tocoo()
    return _Triplets(coo.row.astype(np.int64), coo.col.astype(np.int64), ca.MX(ca.DM(coo.data)))


def _weighted(matrices: Sequence[Matrix], weights: ca.MX) -> _Triplets:
    """Sum constant matrices with weights that are not."""
    size = matrices[0].shape[0]
    coos = [matrix.tocoo() for matrix in matrices]
    row, col = (np.concatenate([c.coords[axis] for c in coos]).astype(np.int64) for axis in (0, 1))
    which = np.repeat(np.arange(len(coos)), [c.nnz for c in coos])
    places, nonzero = np.unique(col * size + row, return_inverse=True)
    values = sparse.coo_array((np.concatenate([c.data for c in coos]), (nonzero, which)), (len(places), len(coos)))
    return _Triplets(places % size, places // size, _dm(values.tocsc()) @ weights)


def _assemble(shape: tuple[int, int], parts: Sequence[_Triplets]) -> ca.MX:
    """Sum the parts into one sparse matrix."""
    parts = [part for part in parts if part.row.size]
    row, col = np.concatenate([p.row for p in parts]), np.concatenate([p.col for p in parts])
    places, nonzero = np.unique(col * shape[0] + row, return_inverse=True)  # column by column: CasADi's order
    pattern = ca.Sparsity.triplet(*shape, (places % shape[0]).tolist(), (places // shape[0]).tolist())
    values = ca.vertcat(*(p.values for p in parts))
    if len(places) == len(row):  # no two parts meet: a permutation, not a sum
        return ca.MX(pattern, values[np.argsort(nonzero).tolist()])
    gather = sparse.coo_array((np.ones(len(row)), (nonzero, np.arange(len(row)))))
    return ca.MX(pattern, _dm(gather.tocsc()) @ values)


def _dm(matrix: Matrix) -> ca.DM:
    return ca.DM(ca.Sparsity(*matrix.shape, matrix.indptr.tolist(), matrix.indices.tolist()), matrix.data)
