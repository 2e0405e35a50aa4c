"""Functions of a program evaluated by NumPy: kernels called directly, expressions as jets.

With v = (x, y(x)) the numbers that expressions read, x inputs and y results of kernels,

    F' = F_v v',    (w' F)'' = v'T (w' F)_vv v' + sum over k of (w' F)_(y_k) y_k''.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mbsgen.expressions import Algebra, Program, evaluate
from mbsgen.manifest import Argument
from mbsgen.roles import Order, name_adjoint, name_derivative, name_kernel
from mbsrun.jets import (
    NO_HESSIAN,
    Dependence,
    Jet,
    compose,
    compose_dependences,
    depend,
    make_dependences,
    make_jets,
    vary,
)
from mbsrun.kernel import KernelError
from mbsrun.ocp.ground.functions import (
    Array,
    Evaluation,
    Formula,
    Function,
    Indices,
    Input,
    KernelResult,
    Pattern,
    SymbolicCall,
)
from mbsrun.ocp.ground.plant import Plant

Mask = NDArray[np.bool_]


def bind(plant: Plant) -> Callable[[Function, int], Evaluation]:
    """Return what evaluates functions of a plant at a number of places."""
    return lambda function, places: (
        FormulaEvaluation(function, plant, places)
        if isinstance(function, Formula)
        else KernelEvaluation(function, plant, places)
    )


@dataclass(frozen=True)
class _Taken:
    """Some nonzeros of a kernel's matrix, as nonzeros of a matrix of fewer rows or columns."""

    pattern: Pattern
    chosen: Indices


class KernelEvaluation:
    """A result of a kernel."""

    def __init__(self, result: KernelResult, plant: Plant, places: int) -> None:
        """Look the kernel up."""
        self._result, self._plant, self._places = result, plant, places
        described = plant.describe(result.kernel)
        self._inputs = [next(a for a in described.inputs if a.name == name) for name in result.inputs]
        self._results = described.outputs
        self._own = next(a for a in described.outputs if a.name == result.result)
        every = range(self._own.rows * self._own.cols)
        self._entries = np.array(every if result.entries is None else result.entries, dtype=np.int64)

    @property
    def value_size(self) -> int:
        """Size of the result."""
        return len(self._entries)

    @property
    def sizes(self) -> tuple[int, ...]:
        """Sizes of the inputs."""
        return tuple(len(self._varying(i)) for i in range(len(self._inputs)))

    @cached_property
    def jacobian_patterns(self) -> tuple[Pattern, ...]:
        """Patterns of the derivatives by each input."""
        return tuple(taken.pattern for taken in self._jacobian)

    @cached_property
    def hessian_patterns(self) -> tuple[Pattern, ...]:
        """Patterns of the second derivatives by each pair of inputs, row by row."""
        return tuple(taken.pattern for taken in self._hessian)

    def value(self, arguments: Sequence[Array]) -> Array:
        """Return the results, (places, size)."""
        found = self._call(self._result.kernel, [self._result.result], self._complete(arguments), is_sparse=False)
        return found[0][:, self._entries]

    def jacobian(self, arguments: Sequence[Array]) -> Sequence[Array]:
        """Return the nonzeros of the derivatives by each input, (places, nonzeros)."""
        names = [name_derivative(self._result.result, a.name) for a in self._inputs]
        found = self._call(name_kernel(self._result.kernel, Order.JACOBIAN), names, self._complete(arguments))
        return [values[:, taken.chosen] for values, taken in zip(found, self._jacobian, strict=True)]

    def hessian(self, arguments: Sequence[Array], weights: Array) -> Sequence[Array]:
        """Return the nonzeros of the second derivatives of weights' results, (places, nonzeros) for each pair."""
        given = self._complete(arguments) | {
            name_adjoint(a.name): self._shape_weights(a, weights) for a in self._results
        }
        names = [name_derivative(name_adjoint(a.name), b.name) for a in self._inputs for b in self._inputs]
        found = self._call(name_kernel(self._result.kernel, Order.ADJOINT_JACOBIAN), names, given)
        return [values[:, taken.chosen] for values, taken in zip(found, self._hessian, strict=True)]

    def _call(
        self, kernel: str, names: Sequence[str], given: Mapping[str, Array], *, is_sparse: bool = True
    ) -> list[Array]:
        """Call a kernel; where it fails, all results are not numbers."""
        try:
            found = self._plant(kernel, sparse=is_sparse, **given)
        except KernelError:
            sizes = {a.name: a.nnz if is_sparse else a.rows * a.cols for a in self._plant.describe(kernel).outputs}
            return [np.full((self._places, sizes[name]), np.nan) for name in names]
        return [_flatten(found[name]) for name in names]

    def _complete(self, arguments: Sequence[Array]) -> dict[str, Array]:
        """Name the inputs, and put entries that vary among the fixed ones."""
        given = dict(zip(self._result.inputs, arguments, strict=True))
        if self._result.fixed is not None:
            whole = np.tile(np.array(self._result.fixed.values), (self._places, 1))
            whole[:, list(self._result.fixed.varying)] = arguments[0]
            given[self._result.inputs[0]] = whole
        return given

    def _shape_weights(self, result: Argument, weights: Array) -> Array:
        """Return the weights of a result of the kernel: 0 except for the entries that are taken."""
        whole = np.zeros((self._places, result.rows * result.cols))
        if result.name == self._result.result:
            whole[:, self._entries] = weights
        if result.cols == 1 and not result.matrix:
            return whole
        return whole.reshape(self._places, result.cols, result.rows).swapaxes(1, 2)

    def _varying(self, i: int) -> tuple[int, ...]:
        """List the entries of an input that vary."""
        fixed = self._result.fixed
        return tuple(range(self._inputs[i].rows)) if i or fixed is None else fixed.varying

    @cached_property
    def _jacobian(self) -> list[_Taken]:
        blocks = self._describe(Order.JACOBIAN)
        return [
            _take(blocks[name_derivative(self._result.result, a.name)], self._entries, self._varying(i))
            for i, a in enumerate(self._inputs)
        ]

    @cached_property
    def _hessian(self) -> list[_Taken]:
        blocks = self._describe(Order.ADJOINT_JACOBIAN)
        return [
            _take(blocks[name_derivative(name_adjoint(a.name), b.name)], self._varying(i), self._varying(j))
            for i, a in enumerate(self._inputs)
            for j, b in enumerate(self._inputs)
        ]

    def _describe(self, order: Order) -> dict[str, Argument]:
        return {a.name: a for a in self._plant.describe(name_kernel(self._result.kernel, order)).outputs}


class _Steps:
    """The expressions of a formula, ready to be evaluated with their derivatives by n variables, or by none."""

    def __init__(self, formula: Formula, n: int, *, is_flat: bool) -> None:
        self.n, self.is_flat, self.algebra = n, is_flat, make_jets(n, is_flat=is_flat)
        self.program = Program(formula.expressions, self.algebra)


class FormulaEvaluation:
    """Expressions of inputs, parameters, data, and results of kernels."""

    def __init__(self, formula: Formula, plant: Plant, places: int) -> None:
        """Number the variables: inputs, then results of kernels."""
        self._formula, self._places = formula, places
        self._kernels = {kind: KernelEvaluation(result, plant, places) for kind, result in formula.computed}
        computed = [Input(kind, kernel.value_size) for kind, kernel in self._kernels.items()]
        self._first, n = {}, 0
        for part in (*formula.inputs, *computed):
            self._first[part.kind] = n
            n += part.size
        self._n, self._nx = n, sum(self.sizes)

    @property
    def sizes(self) -> tuple[int, ...]:
        """Sizes of the inputs."""
        return tuple(part.size for part in self._formula.inputs)

    @cached_property
    def jacobian_patterns(self) -> tuple[Pattern, ...]:
        """Patterns of the derivatives by each input."""
        mask = _multiply(np.stack([d.g for d in self._dependences]), self._slope_mask)
        return tuple(_read(mask[:, columns]) for columns in self._columns())

    @cached_property
    def hessian_patterns(self) -> tuple[Pattern, ...]:
        """Patterns of the second derivatives by each pair of inputs, row by row."""
        slopes = self._slope_mask
        mask = _multiply(slopes.T, _multiply(np.any([d.H for d in self._dependences], axis=0), slopes))
        read = np.any([d.g for d in self._dependences], axis=0)
        for kind, kernel in self._kernels.items():
            if read[self._range(kind, kernel.value_size)].any():
                for i, j, pattern in self._pairs(kind, kernel.hessian_patterns):
                    mask[i.start + pattern.row, j.start + pattern.col] = True
        return tuple(_read(mask[i, j]) for i in self._columns() for j in self._columns())

    def value(self, arguments: Sequence[Array]) -> Array:
        """Return the results, (places, size)."""
        return np.stack([jet.f for jet in self._jets(arguments, self._plain)], axis=1)

    def jacobian(self, arguments: Sequence[Array]) -> Sequence[Array]:
        """Return the nonzeros of the derivatives by each input, (places, nonzeros)."""
        J = np.stack([jet.g for jet in self._jets(arguments, self._sloped)], axis=1) @ self._slopes(arguments)
        blocks = zip(self._columns(), self.jacobian_patterns, strict=True)
        return [J[:, :, columns][:, pattern.row, pattern.col] for columns, pattern in blocks]

    def hessian(self, arguments: Sequence[Array], weights: Array) -> Sequence[Array]:
        """Return the nonzeros of the second derivatives of weights' results, (places, nonzeros) for each pair."""
        jets, slopes = self._jets(arguments, self._bent), self._slopes(arguments)
        whole = sum((w[:, None, None] * jet.H for w, jet in zip(weights.T, jets, strict=True)), start=np.zeros(()))
        H = slopes.swapaxes(1, 2) @ whole @ slopes
        g = sum((w[:, None] * jet.g for w, jet in zip(weights.T, jets, strict=True)), start=np.zeros(()))
        for kind, kernel in self._kernels.items():
            found = kernel.hessian(self._pick(kind, arguments), g[:, self._range(kind, kernel.value_size)])
            for (i, j, pattern), values in zip(self._pairs(kind, kernel.hessian_patterns), found, strict=True):
                H[:, i.start + pattern.row, j.start + pattern.col] += values
        blocks = [(i, j) for i in self._columns() for j in self._columns()]
        return [H[:, i, j][:, p.row, p.col] for (i, j), p in zip(blocks, self.hessian_patterns, strict=True)]

    # --- expressions ---

    @cached_property
    def _bent(self) -> _Steps:
        """The expressions with their first and second derivatives by all variables."""
        return _Steps(self._formula, self._n, is_flat=False)

    @cached_property
    def _sloped(self) -> _Steps:
        """The expressions with their first derivatives by all variables."""
        return _Steps(self._formula, self._n, is_flat=True)

    @cached_property
    def _plain(self) -> _Steps:
        """The expressions without derivatives."""
        return _Steps(self._formula, 0, is_flat=True)

    def _jets(self, arguments: Sequence[Array], steps: _Steps) -> list[Jet]:
        values = self._values(arguments)
        numbers = {name: values[kind][:, i] for name, (kind, i) in self._formula.names.items()}
        n, P = steps.n, self._places
        given = {name: self._vary(kind, i, numbers[name], steps) for name, (kind, i) in self._formula.names.items()}
        with np.errstate(all="ignore"):
            for call in self._formula.calls:
                given[call.name] = self._apply(call, given, steps.algebra)
            jets = steps.program.evaluate(given)
        return [
            Jet(_spread(jet.f, P), _spread(jet.g, P, n), jet.H if steps.is_flat else _spread(jet.H, P, n, n))
            for jet in jets
        ]

    @cached_property
    def _dependences(self) -> list[Dependence]:
        from mbsrun.ocp.evaluation.backends import symbolic

        n = self._n
        nothing = Dependence(np.zeros(n, dtype=bool), np.zeros((n, n), dtype=bool))
        given = {
            name: depend(self._first[kind] + i, n) if kind in self._first else nothing
            for name, (kind, i) in self._formula.names.items()
        }
        algebra = make_dependences(n)
        for call in self._formula.calls:
            known = symbolic.differentiate(call.code)
            arguments = [evaluate(argument, given, algebra) for argument in call.arguments]
            given[call.name] = compose_dependences(known.gradient, known.hessian, arguments)
        return [evaluate(expression, given, algebra) for expression in self._formula.expressions]

    def _apply(self, call: SymbolicCall, given: Mapping[str, Jet], algebra: Algebra[Jet]) -> Jet:
        """Apply a function of CasADi to jets."""
        from mbsrun.ocp.evaluation.backends import symbolic

        arguments = [evaluate(argument, given, algebra) for argument in call.arguments]
        values = np.stack([np.broadcast_to(jet.f, self._places) for jet in arguments], axis=1)
        return compose(*symbolic.differentiate(call.code).evaluate(values), arguments)

    def _vary(self, kind: str, i: int, values: Array, steps: _Steps) -> Jet:
        n = steps.n
        if n and kind in self._first:
            return vary(values, self._first[kind] + i, n, is_flat=steps.is_flat)
        return Jet(values, np.zeros(n), NO_HESSIAN if steps.is_flat else np.zeros((n, n)))

    def _values(self, arguments: Sequence[Array]) -> dict[str, Array]:
        """Return the numbers of all kinds, (places, size) each."""
        values = {part.kind: np.asarray(x) for part, x in zip(self._formula.arguments, arguments, strict=True)}
        return values | {kind: kernel.value(self._pick(kind, arguments)) for kind, kernel in self._kernels.items()}

    # --- results of kernels ---

    def _pick(self, kind: str, arguments: Sequence[Array]) -> list[Array]:
        """Pick the inputs of the kernel that computes a kind."""
        inputs = dict(zip((part.kind for part in self._formula.inputs), arguments, strict=False))
        return [inputs[name] for name in dict(self._formula.computed)[kind].inputs]

    def _slopes(self, arguments: Sequence[Array]) -> Array:
        """Return v', (places, n, inputs)."""
        slopes = np.zeros((self._places, self._n, self._nx))
        slopes[:, : self._nx] = np.eye(self._nx)
        for kind, kernel in self._kernels.items():
            found = kernel.jacobian(self._pick(kind, arguments))
            for columns, pattern, values in zip(self._inputs_of(kind), kernel.jacobian_patterns, found, strict=True):
                slopes[:, self._first[kind] + pattern.row, columns.start + pattern.col] = values
        return slopes

    @cached_property
    def _slope_mask(self) -> Mask:
        slopes = np.zeros((self._n, self._nx), dtype=bool)
        slopes[: self._nx] = np.eye(self._nx, dtype=bool)
        for kind, kernel in self._kernels.items():
            for columns, pattern in zip(self._inputs_of(kind), kernel.jacobian_patterns, strict=True):
                slopes[self._first[kind] + pattern.row, columns.start + pattern.col] = True
        return slopes

    def _pairs(self, kind: str, patterns: Sequence[Pattern]) -> Iterator[tuple[slice, slice, Pattern]]:
        inputs = self._inputs_of(kind)
        pairs = [(i, j) for i in inputs for j in inputs]
        yield from ((i, j, pattern) for (i, j), pattern in zip(pairs, patterns, strict=True))

    def _inputs_of(self, kind: str) -> list[slice]:
        """Where the inputs of a kernel are among all inputs."""
        sizes = {part.kind: part.size for part in self._formula.inputs}
        return [self._range(name, sizes[name]) for name in dict(self._formula.computed)[kind].inputs]

    def _columns(self) -> list[slice]:
        return [self._range(part.kind, part.size) for part in self._formula.inputs]

    def _range(self, kind: str, size: int) -> slice:
        return slice(self._first[kind], self._first[kind] + size)


def _spread(values: Array, *shape: int) -> Array:
    """Return values of a shape; most have it, and need no view."""
    return values if values.shape == shape else np.broadcast_to(values, shape)


def _take(argument: Argument, rows: Sequence[int] | Indices, cols: Sequence[int]) -> _Taken:
    """Take some rows and columns of a kernel's matrix."""
    if argument.row is None or argument.colind is None:
        row, col = np.tile(np.arange(argument.rows), argument.cols), np.repeat(np.arange(argument.cols), argument.rows)
    else:
        row = np.array(argument.row, dtype=np.int64)
        col = np.repeat(np.arange(argument.cols), np.diff(argument.colind))
    new_row, new_col = np.full(argument.rows, -1), np.full(argument.cols, -1)
    new_row[list(rows)], new_col[list(cols)] = np.arange(len(rows)), np.arange(len(cols))
    chosen = np.flatnonzero((new_row[row] >= 0) & (new_col[col] >= 0))
    pattern = Pattern((len(rows), len(cols)), new_row[row[chosen]], new_col[col[chosen]])
    return _Taken(pattern, chosen)


def _flatten(values: Array) -> Array:
    """Flatten the matrix of each place column by column."""
    return values if values.ndim == 2 else values.swapaxes(1, 2).reshape(len(values), -1)


def _multiply(first: Mask, second: Mask) -> Mask:
    """Return the pattern of a product."""
    return np.asarray((first.astype(np.int64) @ second.astype(np.int64)) > 0)


def _read(mask: Mask) -> Pattern:
    col, row = np.nonzero(mask.T)
    shape = (int(mask.shape[0]), int(mask.shape[1]))
    return Pattern(shape, row.astype(np.int64), col.astype(np.int64))
