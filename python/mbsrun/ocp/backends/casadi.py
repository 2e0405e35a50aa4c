"""The functions that CasADi's solvers take, of a program: objective, constraint, gradient, Jacobian, Hessian.

The Jacobian of g is A plus the nonzeros of each block's mapped Jacobian put where they belong, the Hessian of the
Lagrangian is the sum of the H_i and mapped second derivatives (see `assembly`). So CasADi does not differentiate the
whole, and does not colour. A kernel's derivatives are the generated ones; an expression's are CasADi's.
"""

from __future__ import annotations

import operator
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol

import casadi as ca
import numpy as np
from scipy import sparse

from mbsgen.expressions import FUNCTIONS, Algebra, evaluate
from mbsrun.ocp.backends.assembly import Parts, Scatter, assemble, prepare, scatter_matrix, scatter_weighted
from mbsrun.ocp.functions import Array, Formula, Function, Indices, KernelResult, Pattern
from mbsrun.ocp.plant import Plant
from mbsrun.ocp.program import Block, Matrix, Program


class Functions(Protocol):
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
    def terms(self) -> ca.Function:
        """(x, p) -> c: the terms of the cost, without their weights."""

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
        """(x, p) -> g, its Jacobian: in the form that `nlpsol` takes as `jac_g`."""

    @property
    def hessian(self) -> ca.Function:
        """(x, p, lam_f, lam_g) -> upper triangle of the Hessian of lam_f f + lam_g' g, as `nlpsol` takes it."""

    def complete(self, x: Array) -> Array:
        """Return all variables of the program. Raises ValueError where inner equations have no solution."""


# --- functions -----------------------------------------------------------------------------------------------------

_SYMBOLS: Algebra[ca.SX] = Algebra(
    number=ca.SX,
    constants={"pi": ca.SX(ca.pi)},
    negate=operator.neg,
    operations={"+": operator.add, "-": operator.sub, "*": operator.mul, "/": operator.truediv},
    power=operator.pow,
    functions={"abs": ca.fabs} | {name: getattr(ca, name) for name in FUNCTIONS if name != "abs"},
)


def make_function(function: Function, plant: Plant) -> ca.Function:
    """Make a CasADi function; it is differentiable by its inputs, not by parameters and data."""
    return _make_formula(function, plant) if isinstance(function, Formula) else _make_result(function, plant)


def _make_result(result: KernelResult, plant: Plant) -> ca.Function:
    kernel = plant.casadi(result.kernel)
    if result.entries is None and result.fixed is None and kernel.n_out() == 1:
        assert tuple(kernel.name_in()) == result.inputs, "a block's columns are in the order of the kernel's inputs"
        return kernel
    inputs = [ca.MX.sym(name, kernel.size1_in(name)) for name in result.inputs]
    given = list(inputs)
    if result.fixed is not None:
        varying = list(result.fixed.varying)
        inputs[0] = ca.MX.sym(result.inputs[0], len(varying))
        given[0] = ca.MX(ca.DM(result.fixed.values))
        given[0][varying] = inputs[0]
    value = ca.vec(_apply(kernel, result, given))
    chosen = value if result.entries is None else value[list(result.entries)]
    return ca.Function("result", inputs, [chosen], list(result.inputs), [result.result])


def _apply(kernel: ca.Function, result: KernelResult, given: Sequence[ca.MX]) -> ca.MX:
    return kernel(**dict(zip(result.inputs, given, strict=True)))[result.result]


def _make_formula(formula: Formula, plant: Plant) -> ca.Function:
    plain = _make_plain(formula, plant)
    if not formula.computed:
        return plain
    given = {part.kind: ca.MX.sym(part.kind, part.size) for part in formula.arguments}
    values = given | {
        kind: ca.vec(_apply(plant.casadi(result.kernel), result, [given[name] for name in result.inputs]))
        for kind, result in formula.computed
    }
    value = plain.call([values[kind] for kind in plain.name_in()])[0]
    return ca.Function("formula", list(given.values()), [value], list(given), ["value"], _options(formula, given))


def _make_plain(formula: Formula, plant: Plant) -> ca.Function:
    """Make the function of the numbers that expressions read; kernels compute some of them."""
    sizes = {kind: plant.casadi(result.kernel).numel_out(result.result) for kind, result in formula.computed}
    sizes = {part.kind: part.size for part in formula.arguments} | sizes
    read = {kind for kind, _ in formula.names.values()}
    if formula.data is not None:  # also where nothing is read: a function needs an input
        read.add(formula.data.kind)
    symbols = {kind: ca.SX.sym(kind, size) for kind, size in sizes.items() if kind in read}
    values = {name: symbols[kind][index] for name, (kind, index) in formula.names.items()}
    results = ca.vertcat(*(evaluate(expression, values, _SYMBOLS) for expression in formula.expressions))
    kinds = list(symbols)
    return ca.Function("formula", list(symbols.values()), [results], kinds, ["value"], _options(formula, kinds))


def _options(formula: Formula, kinds: Sequence[str] | Mapping[str, ca.MX]) -> dict[str, list[bool]]:
    """Name the arguments that are variables: by the others nothing is differentiated."""
    others = {part.kind for part in (formula.parameters, formula.data) if part is not None}
    return {"is_diff_in": [kind not in others for kind in kinds]}


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


@dataclass(frozen=True)
class CasadiProgram:
    """The functions of a program whose variables a solver sees all."""

    program: Program
    plant: Plant

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
        return tuple(_prepare(block, self.program.variables, self.plant) for block in self.program.blocks)

    @cached_property
    def costs(self) -> tuple[_Mapped, ...]:
        """The blocks of the cost."""
        return tuple(_prepare(block, self.program.variables, self.plant) for block in self.program.costs)

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
        g = self._residual(x, [block.results(x, p) for block in self.blocks])
        return ca.Function("nlp_g", [x, p], [g], ["x", "p"], ["g"])

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
        """(x, p) -> g, its Jacobian: in the form that `nlpsol` takes as `jac_g`."""
        x, p = self._symbols()
        results = [block.results(x, p) for block in self.blocks]
        parts = [_constant(self.program.A)]
        for block, values in zip(self.blocks, results, strict=True):
            parts += block.jacobian(x, p, values)
        outputs = [self._residual(x, results), _assemble((self.constraints, self.variables), parts)]
        return ca.Function("nlp_jac_g", [x, p], outputs, ["x", "p"], ["g", "jac_g_x"])

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

    def _symbols(self) -> tuple[ca.MX, ca.MX]:
        return ca.MX.sym("x", self.variables), ca.MX.sym("p", self.parameters)

    def _cost(self, x: ca.MX, p: ca.MX) -> ca.MX:
        return ca.dot(p[: len(self.program.H)], self._terms(x, p))

    def _terms(self, x: ca.MX, p: ca.MX) -> ca.MX:
        squares = ca.vertcat(*(ca.dot(x, to_casadi(H) @ x) / 2 for H in self.program.H))
        terms = (block.put(x, block.results(x, p), len(self.program.H)) for block in self.costs)
        return sum(terms, start=squares)

    def _residual(self, x: ca.MX, results: Sequence[ca.MX]) -> ca.MX:
        put = (block.put(x, values, self.constraints) for block, values in zip(self.blocks, results, strict=True))
        return sum(put, start=to_casadi(self.program.A) @ x)


# --- a block and its derivatives -----------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Mapped:
    """A block with its CasADi function, mapped over its places."""

    parts: Parts
    function: ca.Function

    @property
    def block(self) -> Block:
        return self.parts.block

    @property
    def rows(self) -> Indices:
        return self.block.rows

    def results(self, x: ca.MX, p: ca.MX) -> ca.MX:
        """Apply the function at every place: its results, place by place, before they are scaled."""
        return ca.vec(self.function.map(self.block.places)(*self._arguments(x, p)))

    def put(self, x: ca.MX, results: ca.MX, size: int) -> ca.MX:
        """Scale the results, and sum them into their rows."""
        values = _sum_into(_Values(self.parts.scatter_results(), results), size)
        return values if self.block.factor is None else x[self.block.factor] * values

    def jacobian(self, x: ca.MX, p: ca.MX, results: ca.MX) -> list[_Values]:
        """Return the Jacobian at every place, a part for each input; `results` are the function's."""
        block, function = self.block, self.function.jacobian()
        unread = ca.MX(function.size1_in(function.n_in() - 1), block.places)  # results as inputs are not read
        parts = function.map(block.places).call([*self._arguments(x, p), unread])
        found = []
        for i, part in enumerate(parts[: len(block.columns)]):
            values = ca.vec(part.nz[:])
            scatter = self.parts.scatter_jacobian(read_pattern(function.sparsity_out(i)), i)
            found.append(_Values(scatter, values if block.factor is None else x[block.factor] * values))
        return found if block.factor is None else [*found, _Values(self._by_factor(), results)]

    def derivative(self, x: ca.MX, p: ca.MX, lam: ca.MX) -> list[_Values]:
        """Return the derivative of lam' F as columns, a part for each input; `lam` place by place."""
        block = self.block
        adjoint, jacobian = self.function.reverse(1), self.function.jacobian()
        n = self.function.n_in()
        weights = ca.reshape(lam, block.rows.shape[0], block.places)
        unread = ca.MX(adjoint.size1_in(n), block.places * adjoint.size2_in(n))
        products = adjoint.map(block.places).call([*self._arguments(x, p), unread, weights])[: len(block.columns)]
        parts = []
        for i, product in enumerate(products):
            # an adjoint may be dense where F's Jacobian is not
            read = sorted(set(jacobian.sparsity_out(i).get_triplet()[1]))
            pattern = ca.Sparsity.triplet(product.size1(), 1, read, [0] * len(read))
            values = ca.project(product, ca.repmat(pattern, 1, block.places))
            scatter = self.parts.scatter_gradient(np.array(read, dtype=np.int64), product.size1(), i)
            parts.append(_Values(scatter, ca.vec(values.nz[:])))
        if block.factor is None:
            return parts
        by_factor = self._by_factor()
        column = replace(by_factor, row=by_factor.col, col=np.zeros_like(by_factor.col))
        return [
            *(part.times(x[block.factor]) for part in parts),
            _Values(column, lam * self.results(x, p)),
        ]

    def hessian(self, x: ca.MX, p: ca.MX, lam: ca.MX) -> list[_Values]:
        """Return the Hessian of lam' F at every place, a part for each pair of inputs; `lam` place by place."""
        block = self.block
        n, inputs = len(block.columns), self.function.n_in()
        function = self.function.reverse(1).jacobian()  # inputs: F's, its result, lam, the adjoint's results
        factored = lam if block.factor is None else x[block.factor] * lam
        weights = ca.reshape(factored, block.rows.shape[0], block.places)
        unread = [ca.MX(function.size1_in(k), block.places * function.size2_in(k)) for k in range(function.n_in())]
        results = function.map(block.places).call(
            [*self._arguments(x, p), unread[inputs], weights, *unread[inputs + 2 :]]
        )
        which = {(i, j): i * (inputs + 2) + j for i in range(n) for j in range(n)}
        parts = [
            _Values(self.parts.scatter_hessian(read_pattern(function.sparsity_out(k)), i, j), ca.vec(results[k].nz[:]))
            for (i, j), k in which.items()
            if function.nnz_out(k)
        ]
        if block.factor is None:
            return parts
        unfactored = replace(self, parts=replace(self.parts, block=replace(block, factor=None)))
        edge = [
            _Values(replace(part.scatter, col=np.full(part.scatter.row.size, block.factor)), part.values)
            for part in unfactored.derivative(x, p, lam)
        ]
        return [*parts, *edge, *(part.transposed() for part in edge)]

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
    return _Mapped(prepare(block, variables), make_function(block.function, plant))


# --- matrices ------------------------------------------------------------------------------------------------------


def read_pattern(sparsity: ca.Sparsity) -> Pattern:
    """Return the pattern of CasADi's."""
    row, col = (np.asarray(k, dtype=np.int64) for k in sparsity.get_triplet())
    return Pattern(sparsity.shape, row, col)


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
    scatter = part.scatter
    entries = (scatter.coefficient, (scatter.row, scatter.source))
    return to_casadi(sparse.coo_array(entries, shape=(size, part.values.numel())).tocsc()) @ part.values


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
