"""The functions of a program at many points at once: stacks (cases, size) -> stacks, in few calls of each kernel.

The same functions as `numpy`'s, to rounding: sums may be taken in another order.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse

from mbsrun.ocp.evaluation.backends.assembly import Assembled, Scatter, assemble
from mbsrun.ocp.evaluation.backends.numpy import Placed, PlacedProgram
from mbsrun.ocp.evaluation.backends.prepared import Prepared
from mbsrun.ocp.ground.functions import Array, Indices
from mbsrun.ocp.ground.program import Matrix


@dataclass(frozen=True, eq=False)
class Values:
    """The values of a program's functions at many points, (cases, size) each."""

    terms: Array  # of the cost, without their weights
    gradient: Array
    rows: Array
    slopes: Array  # the nonzeros of the Jacobian, in the order of its pattern


class StackedProgram(PlacedProgram):
    """The functions of a program without condensed variables, at a number of points."""

    def __init__(self, program: Prepared, count: int) -> None:
        """Bind the kernels of a program for `count` points."""
        super().__init__(program.data, (program.plant, *program.others), count)

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
    def _slopes(self) -> _Sums:
        return _Sums((self.program.constraints, self.program.variables), self._list_slopes())

    @cached_property
    def _cost_slopes(self) -> _Sums:
        return _Sums((len(self.program.H), self.program.variables), self._list_cost_slopes())

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
        self._found: tuple[Assembled, sparse.csr_array] | None = None

    @property
    def assembled(self) -> Assembled:
        """Return the places of the nonzeros."""
        assert self._found is not None, "values were added before"
        return self._found[0]

    def add(self, values: Sequence[Array]) -> Array:
        """Return the nonzeros, (cases, nonzeros), in the order of the pattern."""
        joined = np.concatenate(values, axis=1)
        if self._found is None:
            own = assemble(self._shape, self._scatters, [part.shape[1] for part in values])
            place = own.coefficient, (own.nonzero, own.source)
            self._found = own, sparse.csr_array(place, shape=(own.row.size, joined.shape[1]))
        return np.ascontiguousarray(np.asarray(self._found[1] @ joined.T).T)

    @cached_property
    def pattern(self) -> Matrix:
        """Return the matrix with 1 at its entries."""
        own = self.assembled
        begin = np.searchsorted(own.col, np.arange(self._shape[1] + 1))
        return sparse.csc_array((np.ones(own.row.size), own.row, begin), shape=self._shape)
