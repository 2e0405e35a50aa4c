"""The functions of a program in NumPy and SciPy: no expression graph, for any method, and as an oracle of tests.

The same assembly as `casadi`'s (see `assembly`), of kernels called directly and expressions evaluated as jets. Where
inner equations are solved for, derivatives follow from the whole program's, as in `condensation`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol

import numpy as np
from scipy import sparse

from mbsrun.ocp.evaluation.backends.assembly import (
    Assembled,
    Parts,
    Scatter,
    assemble,
    prepare,
    scatter_matrix,
    scatter_weighted,
)
from mbsrun.ocp.evaluation.backends.evaluations import bind
from mbsrun.ocp.evaluation.elimination import eliminate
from mbsrun.ocp.ground.functions import Array, Evaluation
from mbsrun.ocp.ground.plant import Plant
from mbsrun.ocp.ground.program import Block, Matrix, Program
from mbsrun.ocp.ground.status import NoNumbersError


class Functions(Protocol):
    """The functions that a method needs, of the variables and rows that it sees."""

    def terms(self, x: Array, p: Array) -> Array:
        """Return c: the terms of the cost, without their weights."""

    def objective(self, x: Array, p: Array) -> float:
        """Return f."""

    def gradient(self, x: Array, p: Array) -> Array:
        """Return the gradient of f."""

    def constraint(self, x: Array, p: Array) -> Array:
        """Return g."""

    def jacobian(self, x: Array, p: Array) -> Matrix:
        """Return the Jacobian of g; entries that may be nonzero are stored."""

    def hessian(self, x: Array, p: Array, lam_f: float, lam_g: Array) -> Matrix:
        """Return the upper triangle of the Hessian of lam_f f + lam_g' g."""

    def complete(self, x: Array) -> Array:
        """Return all variables of the program. Raises NoNumbersError where inner equations have no solution."""

    def count_nonzeros(self) -> tuple[int, int]:
        """Count the entries of the Jacobian, and of the Hessian's upper triangle, that may be nonzero."""


def evaluate(function: Callable[[Array, Array], Array], x: Array, p: Array) -> Array:
    """Call one of these at a point. Raises NoNumbersError where a kernel fails, or a number is not finite."""
    found = function(x, p)
    if not np.isfinite(found).all():
        raise NoNumbersError("a row or a cost is not a finite number, or a kernel fails")
    return found


def build(program: Program, plant: Plant, others: tuple[Plant, ...] = ()) -> Functions:
    """Make the functions of a program; `others` are plants beside plant 0."""
    return NumpyCondensed(program, plant, others) if program.solved else NumpyProgram(program, plant, others)


@dataclass(frozen=True)
class Placed:
    """A block, its parts of x and its evaluation."""

    parts: Parts
    evaluation: Evaluation

    @property
    def block(self) -> Block:
        return self.parts.block

    def arguments(self, x: Array, p: Array) -> list[Array]:
        """Return the parts of x, parameters and data, (places, size) each."""
        places = self.block.places
        given = [
            x[part].T if isinstance(part, np.ndarray) else (part @ x).reshape(places, -1) for part in self.parts.columns
        ]
        if self.block.parameters.size:
            given.append(np.tile(p[self.block.parameters], (places, 1)))
        return given if self.block.data is None else [*given, self.block.data.T]

    def factor(self, x: Array) -> float:
        """Return the number that multiplies all results."""
        return 1.0 if self.block.factor is None else float(x[self.block.factor])

    def results(self, x: Array, p: Array) -> Array:
        """Return the results, place by place, before they are scaled."""
        return np.array(self.evaluation.value(self.arguments(x, p))).ravel()

    @cached_property
    def result_scatter(self) -> Scatter:
        """Where the results belong."""
        return self.parts.scatter_results()

    def by_factor(self) -> Scatter:
        """Place the results as derivatives by the factor."""
        scatter = self.parts.scatter_results()
        return replace(scatter, col=np.full(scatter.row.size, self.block.factor))

    @cached_property
    def jacobian_scatters(self) -> list[Scatter]:
        """Where the nonzeros of the Jacobian belong, by input, and the results where a factor multiplies them."""
        patterns = enumerate(self.evaluation.jacobian_patterns)
        found = [self.parts.scatter_jacobian(pattern, i) for i, pattern in patterns]
        return found if self.block.factor is None else [*found, self.by_factor()]

    def jacobian(self, x: Array, p: Array) -> list[Array]:
        """Return the values that `jacobian_scatters` place."""
        found = [self.factor(x) * values.ravel() for values in self.evaluation.jacobian(self.arguments(x, p))]
        return found if self.block.factor is None else [*found, self.results(x, p)]

    @cached_property
    def hessian_scatters(self) -> list[Scatter]:
        """Where second derivatives belong, by pair of inputs, and by an input and the factor, either way."""
        n = len(self.parts.columns)
        pairs = [(i, j) for i in range(n) for j in range(n)]
        patterns = zip(pairs, self.evaluation.hessian_patterns, strict=True)
        found = [self.parts.scatter_hessian(pattern, i, j) for (i, j), pattern in patterns]
        if self.block.factor is None:
            return found
        for i, pattern in enumerate(self.evaluation.jacobian_patterns):
            edge = self.parts.scatter_gradient(pattern.col, pattern.shape[1], i)
            edge = replace(edge, col=np.full(edge.row.size, self.block.factor))
            found += [edge, edge.transposed()]
        return found

    def hessian(self, x: Array, p: Array, lam: Array) -> list[Array]:
        """Return the values that `hessian_scatters` place; `lam` are the multipliers of all rows."""
        given, weights = self.arguments(x, p), lam[self.block.rows].T
        found = [self.factor(x) * values.ravel() for values in self.evaluation.hessian(given, weights)]
        if self.block.factor is None:
            return found
        slopes = zip(self.evaluation.jacobian(given), self.evaluation.jacobian_patterns, strict=True)
        for values, pattern in slopes:
            weighted = (values * weights[:, pattern.row]).ravel()
            found += [weighted, weighted]
        return found


class PlacedProgram:
    """A program whose variables a method sees all, with its blocks at one point or at some points at once."""

    def __init__(self, program: Program, plants: Sequence[Plant], count: int = 1) -> None:
        """Bind the kernels of a program for `count` points."""
        self.program, self.count, self._bind = program, count, [bind(kernels) for kernels in plants]

    @cached_property
    def _squares(self) -> list[tuple[int, Matrix]]:
        """The quadratic terms of the cost, with their numbers: expressions have none."""
        return [(k, H) for k, H in enumerate(self.program.H) if H.nnz]

    @cached_property
    def _blocks(self) -> list[Placed]:
        return [self._place(block) for block in self.program.blocks]

    @cached_property
    def _costs(self) -> list[Placed]:
        return [self._place(block) for block in self.program.costs]

    def _place(self, block: Block) -> Placed:
        evaluation = self._bind[block.plant](block.function, block.places * self.count)
        return Placed(prepare(block, self.program.variables), evaluation)

    @cached_property
    def _linear(self) -> Array:
        """The entries of A, as its scatter orders them."""
        return np.asarray(self.program.A.tocoo().data)

    def _list_slopes(self) -> list[Scatter]:
        return [scatter_matrix(self.program.A), *(s for block in self._blocks for s in block.jacobian_scatters)]

    def _list_cost_slopes(self) -> list[Scatter]:
        return [s for block in self._costs for s in block.jacobian_scatters]


class NumpyProgram(PlacedProgram):
    """The functions of a program at one point."""

    def __init__(self, program: Program, plant: Plant, others: tuple[Plant, ...] = ()) -> None:
        """Take a program and its kernels; `others` are plants beside plant 0."""
        super().__init__(program, (plant, *others))

    def complete(self, x: Array) -> Array:
        """Return x: nothing is condensed."""
        return x

    def count_nonzeros(self) -> tuple[int, int]:
        """Count the entries of the Jacobian, and of the Hessian's upper triangle, that may be nonzero."""
        slopes, curvatures = self.patterns
        return slopes.nnz, curvatures.nnz

    @property
    def patterns(self) -> tuple[Matrix, Matrix]:
        """Return the Jacobian and the Hessian's upper triangle with 1 where an entry may be nonzero."""
        return self._slopes.pattern, self._curvatures.pattern

    @property
    def has_curved_rows(self) -> bool:
        """Return whether rows have second derivatives, by the patterns of their functions."""
        return any(scatter.row.size > 0 for block in self._blocks for scatter in block.hessian_scatters)

    def terms(self, x: Array, p: Array) -> Array:
        """Return c: the terms of the cost, without their weights."""
        c = np.zeros(len(self.program.H))
        for k, H in self._squares:
            c[k] = x @ (H @ x) / 2
        return c + self._put(self._costs, x, p, c.size)

    def objective(self, x: Array, p: Array) -> float:
        """Return f."""
        return float(p[: len(self.program.H)] @ self.terms(x, p))

    def gradient(self, x: Array, p: Array) -> Array:
        """Return the gradient of f."""
        gradient = sum((p[k] * (H @ x) for k, H in self._squares), start=np.zeros(x.size))
        if not self._costs:
            return np.asarray(gradient + 0.0)
        weights = p[: len(self.program.H)]
        slopes = self._sum(self._cost_slopes, [v for block in self._costs for v in block.jacobian(x, p)])
        return np.asarray(gradient + weights @ slopes)

    def constraint(self, x: Array, p: Array) -> Array:
        """Return g."""
        return np.asarray(self.program.A @ x + self._put(self._blocks, x, p, self.program.constraints))

    def jacobian(self, x: Array, p: Array) -> Matrix:
        """Return the Jacobian of g."""
        values = [self._linear, *(v for block in self._blocks for v in block.jacobian(x, p))]
        return self._sum(self._slopes, values)

    def hessian(self, x: Array, p: Array, lam_f: float, lam_g: Array) -> Matrix:
        """Return the upper triangle of the Hessian of lam_f f + lam_g' g."""
        weights = lam_f * p[: len(self.program.H)]
        values = [weights]
        values += [v for block in self._blocks for v in block.hessian(x, p, lam_g)]
        values += [v for block in self._costs for v in block.hessian(x, p, weights)]
        return self._sum(self._curvatures, values)

    # --- blocks ---

    def _put(self, blocks: Sequence[Placed], x: Array, p: Array, size: int) -> Array:
        """Scale the results of blocks, and sum them into their rows."""
        found = np.zeros(size)
        for placed in blocks:
            scatter = placed.result_scatter
            values = placed.factor(x) * scatter.coefficient * placed.results(x, p)
            found += np.bincount(scatter.row, weights=values, minlength=size)
        return found

    # --- matrices ---

    @cached_property
    def _slopes(self) -> _Sum:
        return _Sum((self.program.constraints, self.program.variables), self._list_slopes())

    @cached_property
    def _cost_slopes(self) -> _Sum:
        return _Sum((len(self.program.H), self.program.variables), self._list_cost_slopes())

    @cached_property
    def _curvatures(self) -> _Sum:
        scatters = [scatter_weighted(self.program.H).upper()]
        for block in (*self._blocks, *self._costs):
            scatters += [scatter.upper() for scatter in block.hessian_scatters]
        return _Sum((self.program.variables, self.program.variables), scatters)

    def _sum(self, pattern: _Sum, values: Sequence[Array]) -> Matrix:
        return pattern.add(values)


class _Sum:
    """Values, of which scatters place coefficients times entries, summed into one sparse matrix."""

    def __init__(self, shape: tuple[int, int], scatters: Sequence[Scatter]) -> None:
        self._shape, self._scatters = shape, scatters
        self._assembled: Assembled | None = None

    @property
    def pattern(self) -> Matrix:
        """Return the matrix with 1 at its entries."""
        row, col = (np.concatenate([getattr(part, k) for part in self._scatters]) for k in ("row", "col"))
        found = sparse.coo_array((np.ones(row.size), (row, col)), shape=self._shape).tocsc()
        found.data[:] = 1.0
        return found

    def add(self, values: Sequence[Array]) -> Matrix:
        """Return the matrix."""
        if self._assembled is None:
            self._assembled = assemble(self._shape, self._scatters, [v.size for v in values])
        found = self._assembled
        entries = found.coefficient * np.concatenate([*values, np.zeros(0)])[found.source]
        data = np.bincount(found.nonzero, weights=entries, minlength=found.row.size)
        matrix = copy(self._empty)
        matrix.data = data
        return matrix

    @cached_property
    def _empty(self) -> Matrix:
        """Return the matrix with entries to be filled in: to check indices takes longer than to add values."""
        assert self._assembled is not None, "values were added before"
        row, col = self._assembled.row, self._assembled.col
        columns = np.searchsorted(col, np.arange(self._shape[1] + 1))
        return sparse.csc_array((np.zeros(row.size), row, columns), shape=self._shape)


class NumpyCondensed:
    """The functions of a program whose inner variables are solved for."""

    def __init__(self, program: Program, plant: Plant, others: tuple[Plant, ...] = ()) -> None:
        """Take a program and its kernels; `others` are plants beside plant 0."""
        self.program, plants = program, (plant, *others)
        self._rest = NumpyProgram(program.restrict(program.kept_rows, with_cost=True), plant, others)
        self._inner = eliminate(program, lambda number: bind(plants[number]))

    def complete(self, x: Array) -> Array:
        """Return all variables of the program. Raises ValueError where inner equations have no solution."""
        v = self._complete(x)
        if not np.isfinite(v).all():
            raise NoNumbersError("the equations that are condensed have no solution")
        return v

    def terms(self, x: Array, p: Array) -> Array:
        """Return c: the terms of the cost, without their weights."""
        return self._rest.terms(self._complete(x), p)

    def objective(self, x: Array, p: Array) -> float:
        """Return f."""
        return self._rest.objective(self._complete(x), p)

    def gradient(self, x: Array, p: Array) -> Array:
        """Return the gradient of f."""
        return np.asarray(self._rest.gradient(self._complete(x), p) @ self._slopes(x))

    def constraint(self, x: Array, p: Array) -> Array:
        """Return g."""
        return self._rest.constraint(self._complete(x), p)

    def jacobian(self, x: Array, p: Array) -> Matrix:
        """Return the Jacobian of g."""
        return sparse.csc_array(self._rest.jacobian(self._complete(x), p) @ self._slopes(x))

    def hessian(self, x: Array, p: Array, lam_f: float, lam_g: Array) -> Matrix:
        """Return the upper triangle of the Hessian of lam_f f + lam_g' g."""
        v, slopes = self._complete(x), self._slopes(x)
        upper = self._rest.hessian(v, p, lam_f, lam_g)
        whole = upper + sparse.triu(upper, 1).T
        gradient = lam_f * self._rest.gradient(v, p) + lam_g @ self._rest.jacobian(v, p)
        curvature, places = self._inner.curve(x, gradient[self._inner.unknowns]), self._inner.curvature
        added = sparse.coo_array((curvature, (places.row, places.col)), shape=(x.size, x.size))
        return sparse.csc_array(sparse.triu(slopes.T @ whole @ slopes + added))

    def count_nonzeros(self) -> tuple[int, int]:
        """Count the entries of the Jacobian, and of the Hessian's upper triangle, that may be nonzero."""
        J, upper = self._rest.patterns
        kept, slopes, curvature = self.program.kept, self._inner.slopes, self._inner.curvature
        rows = np.concatenate((kept, self._inner.unknowns[slopes.row[slopes.mask]]))
        cols = np.concatenate((np.arange(kept.size), slopes.col[slopes.mask]))
        V = sparse.coo_array((np.ones(rows.size), (rows, cols)), shape=(self.program.variables, kept.size)).tocsc()
        places = curvature.row[curvature.mask], curvature.col[curvature.mask]
        added = sparse.coo_array((np.ones(places[0].size), places), shape=(kept.size, kept.size))
        return (J @ V).nnz, sparse.triu(V.T @ (upper + upper.T) @ V + added).nnz

    def _complete(self, x: Array) -> Array:
        v = np.empty(self.program.variables)
        v[self.program.kept] = x
        v[self._inner.unknowns] = self._inner.solve(x)
        return v

    def _slopes(self, x: Array) -> Matrix:
        """Return dv/dx."""
        kept, places = self.program.kept, self._inner.slopes
        entries = np.concatenate((np.ones(kept.size), self._inner.differentiate(x)))
        rows = np.concatenate((kept, self._inner.unknowns[places.row]))
        cols = np.concatenate((np.arange(kept.size), places.col))
        return sparse.coo_array((entries, (rows, cols)), shape=(self.program.variables, x.size)).tocsc()
