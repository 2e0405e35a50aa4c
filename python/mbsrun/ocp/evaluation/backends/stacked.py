"""The functions of a program at many points at once: stacks (cases, size) -> stacks, in few calls of each kernel.

The same functions as `numpy`'s, to rounding: sums may be taken in another order.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse

from mbsrun.ocp.evaluation.backends.assembly import Assembled, Scatter, assemble, prepare, scatter_matrix
from mbsrun.ocp.evaluation.backends.evaluations import bind
from mbsrun.ocp.evaluation.backends.numpy import Placed
from mbsrun.ocp.evaluation.backends.prepared import Prepared
from mbsrun.ocp.ground.functions import Array, Indices
from mbsrun.ocp.ground.program import Block, Matrix


@dataclass(frozen=True, eq=False)
class Values:
    """The values of a program's functions at many points, (cases, size) each."""

    terms: Array  # of the cost, without their weights
    gradient: Array
    rows: Array
    slopes: Array  # the nonzeros of the Jacobian, in the order of its pattern


class StackedProgram:
    """The functions of a program without condensed variables, at a number of points."""

    def __init__(self, program: Prepared, count: int) -> None:
        """Bind the kernels of a program for `count` points."""
        self.program, self.count = program.data, count
        self._bind = [bind(plant) for plant in (program.plant, *program.others)]

    def evaluate(self, x: Array, p: Array) -> Values:
        """Evaluate all functions at points x with parameters p; numbers are not finite where a kernel fails."""
        blocks = [self._differentiate(placed, x, p) for placed in self._blocks]
        costs = [self._differentiate(placed, x, p) for placed in self._costs]
        rows = np.asarray(self.program.A @ x.T).T + self._sum_results(blocks, self._blocks, self.program.constraints)
        given = [np.broadcast_to(self._linear, (self.count, self._linear.size)), *(v for _, s in blocks for v in s)]
        slopes = self._slopes.add(given)
        terms = self._sum_results(costs, self._costs, len(self.program.H))
        gradient = np.zeros(x.shape)
        for k, H in self._squares:
            product = np.asarray(H @ x.T).T
            terms[:, k] += np.einsum("ij,ij->i", x, product) / 2
            gradient += p[:, k, None] * product
        if self._costs:
            found = self._cost_slopes.add([v for _, s in costs for v in s])
            row, to_columns = self._cost_columns
            gradient += np.asarray(to_columns @ (found * p[:, row]).T).T
        return Values(terms, gradient, rows, slopes)

    @cached_property
    def pattern(self) -> Matrix:
        """Return the Jacobian with 1 at its entries, as its nonzeros are ordered."""
        return self._slopes.pattern

    @property
    def _squares(self) -> list[tuple[int, Matrix]]:
        return [(k, H) for k, H in enumerate(self.program.H) if H.nnz]

    @cached_property
    def _blocks(self) -> list[Placed]:
        return [self._place(block) for block in self.program.blocks]

    @cached_property
    def _costs(self) -> list[Placed]:
        return [self._place(block) for block in self.program.costs]

    def _place(self, block: Block) -> Placed:
        places = block.places * self.count
        return Placed(prepare(block, self.program.variables), self._bind[block.plant](block.function, places))

    def _differentiate(self, placed: Placed, x: Array, p: Array) -> tuple[Array, list[Array]]:
        """Return the results of a block, and the values of its slopes, (cases, size) each."""
        given = self._list_arguments(placed, x, p)
        factors = np.ones(self.count) if placed.block.factor is None else x[:, placed.block.factor]
        results = self._fold(placed.evaluation.value(given))
        slopes = [factors[:, None] * self._fold(values) for values in placed.evaluation.jacobian(given)]
        return factors[:, None] * results, slopes if placed.block.factor is None else [*slopes, results]

    def _list_arguments(self, placed: Placed, x: Array, p: Array) -> list[Array]:
        """Return the parts of x, parameters and data, (cases times places, size) each."""
        block, places = placed.block, placed.block.places * self.count
        given = [
            np.ascontiguousarray(x[:, part].swapaxes(1, 2)).reshape(places, -1)
            if isinstance(part, np.ndarray)
            else np.ascontiguousarray((part @ x.T).T).reshape(places, -1)
            for part in placed.parts.columns
        ]
        if block.parameters.size:
            given.append(np.repeat(p[:, block.parameters], block.places, axis=0))
        return given if block.data is None else [*given, np.tile(block.data.T, (self.count, 1))]

    def _fold(self, values: Array) -> Array:
        return np.asarray(values).reshape(self.count, -1)

    def _sum_results(self, found: Sequence[tuple[Array, list[Array]]], blocks: Sequence[Placed], size: int) -> Array:
        total = np.zeros((self.count, size))
        for (results, _), placed in zip(found, blocks, strict=True):
            scatter = placed.result_scatter
            place = (scatter.coefficient, (scatter.row, scatter.source))
            total += np.asarray(sparse.csr_array(place, shape=(size, results.shape[1])) @ results.T).T
        return total

    @cached_property
    def _linear(self) -> Array:
        return np.asarray(self.program.A.tocoo().data)

    @cached_property
    def _slopes(self) -> _Sums:
        scatters = [scatter_matrix(self.program.A), *(s for block in self._blocks for s in block.jacobian_scatters)]
        return _Sums((self.program.constraints, self.program.variables), scatters)

    @cached_property
    def _cost_slopes(self) -> _Sums:
        scatters = [s for block in self._costs for s in block.jacobian_scatters]
        return _Sums((len(self.program.H), self.program.variables), scatters)

    @cached_property
    def _cost_columns(self) -> tuple[Indices, sparse.csr_array]:
        """Return the terms of the slopes of the cost, and what sums the slopes by variables."""
        own = self._cost_slopes.assembled
        place = (np.ones(own.col.size), (own.col, np.arange(own.col.size)))
        return own.row, sparse.csr_array(place, shape=(self.program.variables, own.col.size))


class _Sums:
    """Values of many points, of which scatters place coefficients times entries, summed into nonzeros of a matrix."""

    def __init__(self, shape: tuple[int, int], scatters: Sequence[Scatter]) -> None:
        self._shape, self._scatters = shape, scatters

    @cached_property
    def assembled(self) -> Assembled:
        """Return the places of the nonzeros, after values were added."""
        return self._assemble([])

    def _assemble(self, sizes: Sequence[int]) -> Assembled:
        found = assemble(self._shape, self._scatters, sizes)
        self.assembled = found
        return found

    def add(self, values: Sequence[Array]) -> Array:
        """Return the nonzeros, (cases, nonzeros), in the order of the pattern."""
        if "_matrix" not in self.__dict__:
            own = self._assemble([part.shape[1] for part in values])
            place, width = (own.coefficient, (own.nonzero, own.source)), sum(part.shape[1] for part in values)
            self._matrix = sparse.csr_array(place, shape=(own.row.size, width))
        joined = np.concatenate(values, axis=1)
        return np.ascontiguousarray(np.asarray(self._matrix @ joined.T).T)

    @cached_property
    def pattern(self) -> Matrix:
        """Return the matrix with 1 at its entries."""
        own = self.assembled
        begin = np.searchsorted(own.col, np.arange(self._shape[1] + 1))
        return sparse.csc_array((np.ones(own.row.size), own.row, begin), shape=self._shape)
