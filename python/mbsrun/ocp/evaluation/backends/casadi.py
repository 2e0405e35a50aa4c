"""The functions that CasADi's solvers take, of a program: objective, constraint, gradient, Jacobian, Hessian.

The Jacobian of g is A plus the nonzeros of each block's mapped Jacobian put where they belong, the Hessian of the
Lagrangian is the sum of the H_i and mapped second derivatives (see `assembly`). So CasADi does not differentiate the
whole, and does not colour. A kernel's derivatives are the generated ones; an expression's are CasADi's.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol

import casadi as ca
import numpy as np
from scipy import sparse

from mbsrun.ocp.evaluation.backends.assembly import Parts, Scatter, assemble, prepare, scatter_matrix, scatter_weighted
from mbsrun.ocp.evaluation.backends.places import Placed, place
from mbsrun.ocp.ground.functions import Array, Indices
from mbsrun.ocp.ground.plant import Plant
from mbsrun.ocp.ground.program import Block, Matrix, Program
from mbsrun.ocp.ground.status import NoNumbersError


class Differentiated(Protocol):
    """The functions that a solver of CasADi's takes, with exact derivatives, and their sizes."""

    @property
    def variables(self) -> int:
        """Count the entries of x."""

    @property
    def constraints(self) -> int:
        """Count the entries of g."""

    @property
    def parameters(self) -> int:
        """Count the entries of p."""

    @property
    def objective(self) -> ca.Function:
        """(x, p) -> f."""

    @property
    def constraint(self) -> ca.Function:
        """(x, p) -> g."""

    @property
    def gradient(self) -> ca.Function:
        """(x, p) -> f, its gradient: in the form that `nlpsol` takes as `grad_f`."""

    @property
    def jacobian(self) -> ca.Function:
        """(x, p) -> the Jacobian of g."""

    @property
    def hessian(self) -> ca.Function:
        """(x, p, lam_f, lam_g) -> upper triangle of the Hessian of lam_f f + lam_g' g, as `nlpsol` takes it."""


class Functions(Differentiated, Protocol):
    """The same, with the parts of the cost and all variables."""

    @property
    def terms(self) -> ca.Function:
        """(x, p) -> c: the terms of the cost, without their weights."""

    def complete(self, x: Array) -> Array:
        """Return all variables of the program. Raises ValueError where inner equations have no solution."""


# --- the program ---------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Values:
    """Entries of a matrix: where they belong, and their values."""

    scatter: Scatter
    values: ca.MX

    def times(self, factor: ca.MX) -> _Values:
        """Multiply the values."""
        return _Values(self.scatter, factor * self.values)

    def upper(self) -> _Values:
        """Keep the upper triangle."""
        return _Values(self.scatter.upper(), self.values)

    def transposed(self) -> _Values:
        """Swap rows and columns."""
        return _Values(self.scatter.transposed(), self.values)


def evaluate(function: ca.Function, x: Array, p: Array) -> ca.DM:
    """Call a function of these at a point. Raises NoNumbersError where a kernel fails, or a number is not finite."""
    try:
        found = function(x, p)
    except RuntimeError as error:
        raise NoNumbersError("a kernel fails") from error
    if not found.is_regular():
        raise NoNumbersError("a row or a cost is not a finite number")
    return found


@dataclass(frozen=True)
class CasadiProgram:
    """The functions of a program whose variables a solver sees all."""

    program: Program
    plant: Plant
    others: tuple[Plant, ...] = ()  # of blocks whose plant is not 0, from 1 on

    @property
    def variables(self) -> int:
        """Count the entries of x."""
        return self.program.variables

    @property
    def constraints(self) -> int:
        """Count the entries of g."""
        return self.program.constraints

    @property
    def parameters(self) -> int:
        """Count the entries of p."""
        return self.program.parameters

    def complete(self, x: Array) -> Array:
        """Return x: nothing is condensed."""
        return x

    @cached_property
    def blocks(self) -> tuple[_Mapped, ...]:
        """The blocks of the constraints."""
        return self._place(self.program.blocks)

    @cached_property
    def costs(self) -> tuple[_Mapped, ...]:
        """The blocks of the cost."""
        return self._place(self.program.costs)

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
        matrix, values = to_casadi(self.program.A), [x]
        for block in self.blocks:
            part = block.results(x, p)
            matrix = ca.horzcat(matrix, _gather(part, self.constraints))
            values.append(part.values)
        return ca.Function("nlp_g", [x, p], [ca.densify(matrix @ ca.vertcat(*values))], ["x", "p"], ["g"])

    @cached_property
    def gradient(self) -> ca.Function:
        """(x, p) -> f, its gradient: in the form that `nlpsol` takes as `grad_f`."""
        x, p = self._symbols()
        squares = (p[i] * (to_casadi(H) @ x) for i, H in enumerate(self.program.H))
        gradient = sum(squares, start=ca.MX.zeros(self.variables))
        for block in self.costs:
            for part in block.derivative(x, p, p[_flat(block.rows)]):
                gradient += _sum_into(part, self.variables)
        return ca.Function("nlp_grad_f", [x, p], [self._cost(x, p), gradient], ["x", "p"], ["f", "grad_f_x"])

    @cached_property
    def jacobian(self) -> ca.Function:
        """(x, p) -> the Jacobian of g."""
        x, p = self._symbols()
        parts = [_constant(self.program.A), *(part for block in self.blocks for part in block.jacobian(x, p))]
        jacobian = _assemble((self.constraints, self.variables), parts)
        return ca.Function("nlp_jac_g", [x, p], [jacobian], ["x", "p"], ["jac_g_x"])

    @cached_property
    def hessian(self) -> ca.Function:
        """(x, p, lam_f, lam_g) -> upper triangle of the Hessian of lam_f f + lam_g' g, as `nlpsol` takes it."""
        x, p = self._symbols()
        lam_f, lam_g = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", self.constraints)
        matrices = self.program.H
        parts = [_Values(scatter_weighted(matrices), lam_f * p[: len(matrices)]).upper()]
        for blocks, lam in ((self.blocks, lam_g), (self.costs, lam_f * p)):
            for block in blocks:
                parts += [part.upper() for part in block.hessian(x, p, lam[_flat(block.rows)])]
        hessian = _assemble((self.variables, self.variables), parts)
        return ca.Function(
            "nlp_hess_l", [x, p, lam_f, lam_g], [hessian], ["x", "p", "lam_f", "lam_g"], ["hess_gamma_x_x"]
        )

    def _place(self, blocks: Sequence[Block]) -> tuple[_Mapped, ...]:
        plants = (self.plant, *self.others)
        return tuple(_prepare(block, self.program.variables, plants[block.plant]) for block in blocks)

    def _symbols(self) -> tuple[ca.MX, ca.MX]:
        return ca.MX.sym("x", self.variables), ca.MX.sym("p", self.parameters)

    def _cost(self, x: ca.MX, p: ca.MX) -> ca.MX:
        return ca.dot(p[: len(self.program.H)], self._terms(x, p))

    def _terms(self, x: ca.MX, p: ca.MX) -> ca.MX:
        squares = ca.vertcat(*(ca.dot(x, to_casadi(H) @ x) / 2 for H in self.program.H))
        terms = (_sum_into(block.results(x, p), len(self.program.H)) for block in self.costs)
        return sum(terms, start=squares)


# --- a block and its derivatives -----------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Mapped:
    """A block and its function at all places."""

    parts: Parts
    function: Placed

    @property
    def block(self) -> Block:
        return self.parts.block

    @property
    def rows(self) -> Indices:
        return self.block.rows

    def results(self, x: ca.MX, p: ca.MX) -> _Values:
        """Apply the function at every place, and place its scaled results in a column."""
        factored = _Values(self.parts.scatter_results(), self._apply(x, p))
        return factored if self.block.factor is None else factored.times(x[self.block.factor])

    def jacobian(self, x: ca.MX, p: ca.MX) -> list[_Values]:
        """Return the Jacobian at every place, a part for each input."""
        nonzeros = enumerate(self.function.jacobian(self._arguments(x, p)))
        found = [_Values(self.parts.scatter_jacobian(part.pattern, i), part.values) for i, part in nonzeros]
        if self.block.factor is None:
            return found
        return [*(part.times(x[self.block.factor]) for part in found), _Values(self._by_factor(), self._apply(x, p))]

    def derivative(self, x: ca.MX, p: ca.MX, lam: ca.MX) -> list[_Values]:
        """Return the derivative of lam' F as columns, a part for each input; `lam` place by place."""
        parts = self._differentiate(x, p, lam)
        if self.block.factor is None:
            return parts
        by_factor = self._by_factor()
        column = replace(by_factor, row=by_factor.col, col=np.zeros_like(by_factor.col))
        return [*(part.times(x[self.block.factor]) for part in parts), _Values(column, ca.vec(lam) * self._apply(x, p))]

    def hessian(self, x: ca.MX, p: ca.MX, lam: ca.MX) -> list[_Values]:
        """Return the Hessian of lam' F at every place, a part for each pair of inputs; `lam` place by place."""
        factor = self.block.factor
        weights = self._shape(lam if factor is None else x[factor] * lam)
        parts = [
            _Values(self.parts.scatter_hessian(part.pattern, i, j), part.values)
            for (i, j), part in self.function.hessian(self._arguments(x, p), weights).items()
        ]
        if factor is None:
            return parts
        edge = [
            _Values(replace(part.scatter, col=np.full(part.scatter.row.size, factor)), part.values)
            for part in self._differentiate(x, p, lam)
        ]
        return [*parts, *edge, *(part.transposed() for part in edge)]

    def _apply(self, x: ca.MX, p: ca.MX) -> ca.MX:
        """Return the results place by place, before they are scaled."""
        return ca.vec(self.function.value(self._arguments(x, p)))

    def _differentiate(self, x: ca.MX, p: ca.MX, lam: ca.MX) -> list[_Values]:
        """Return the derivative of lam' F before a factor multiplies it."""
        nonzeros = self.function.gradient(self._arguments(x, p), self._shape(lam))
        return [
            _Values(self.parts.scatter_gradient(part.pattern.row, part.pattern.shape[0], i), part.values)
            for i, part in enumerate(nonzeros)
        ]

    def _shape(self, lam: ca.MX) -> ca.MX:
        return ca.reshape(lam, self.block.rows.shape[0], self.block.places)

    def _arguments(self, x: ca.MX, p: ca.MX) -> list[ca.MX]:
        block = self.block
        parts = [
            ca.reshape(x[_flat(part)] if isinstance(part, np.ndarray) else to_casadi(part) @ x, -1, block.places)
            for part in self.parts.columns
        ]
        if block.parameters.size:
            parts.append(ca.repmat(p[block.parameters.tolist()], 1, block.places))
        if block.data is not None:
            parts.append(ca.MX(ca.DM(block.data)))
        return parts

    def _by_factor(self) -> Scatter:
        """Place the results as derivatives by the factor."""
        scatter = self.parts.scatter_results()
        return replace(scatter, col=np.full(scatter.row.size, self.block.factor))


def _prepare(block: Block, variables: int, plant: Plant) -> _Mapped:
    return _Mapped(prepare(block, variables), place(block.function, plant, block.places))


# --- matrices ------------------------------------------------------------------------------------------------------


def to_casadi(matrix: Matrix) -> ca.DM:
    """Return a sparse matrix as CasADi's."""
    return ca.DM(ca.Sparsity(*matrix.shape, matrix.indptr.tolist(), matrix.indices.tolist()), matrix.data)


def _flat(indices: Indices) -> list[int]:
    """List indices place by place."""
    return [int(i) for i in indices.T.ravel()]


def _constant(matrix: Matrix) -> _Values:
    return _Values(scatter_matrix(matrix), ca.MX(ca.DM(matrix.tocoo().data)))


def _sum_into(part: _Values, size: int) -> ca.MX:
    """Return the vector of which each entry is the sum of coefficient * values[source] of its row."""
    return _gather(part, size) @ part.values


def _gather(part: _Values, size: int) -> ca.DM:
    """Return the matrix by which the values become the entries of a vector."""
    scatter = part.scatter
    entries = (scatter.coefficient, (scatter.row, scatter.source))
    return to_casadi(sparse.coo_array(entries, shape=(size, part.values.numel())).tocsc())


def _assemble(shape: tuple[int, int], parts: Sequence[_Values]) -> ca.MX:
    """Sum the parts into one sparse matrix."""
    parts = [part for part in parts if part.scatter.row.size]
    if not parts:
        return ca.MX(*shape)
    found = assemble(shape, [part.scatter for part in parts], [part.values.numel() for part in parts])
    pattern = ca.Sparsity.triplet(*shape, found.row.tolist(), found.col.tolist())
    values = ca.vertcat(*(part.values for part in parts))
    if found.is_permutation:
        return ca.MX(pattern, values[found.source[np.argsort(found.nonzero)].tolist()])
    entries = (found.coefficient, (found.nonzero, found.source))
    matrix = sparse.coo_array(entries, shape=(found.row.size, values.numel())).tocsc()
    return ca.MX(pattern, to_casadi(matrix) @ values)
