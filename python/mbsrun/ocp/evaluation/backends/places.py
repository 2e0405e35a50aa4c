"""Functions at many places in CasADi: values, and nonzeros of derivatives by each input.

Kernels are called at all places, then expressions of their results. With v = (x, y(x)) the numbers that expressions
read, x inputs and y results of kernels, V = v' and L = w' F,

    F' = F_v V,    L'' = V' L_vv V + sum over k of L_(y_k) y_k''.

So each place costs a call of every kernel and of two functions of expressions, and no product of matrices in CasADi.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

import casadi as ca
import numpy as np

from mbsgen.expressions import PRIMITIVES, Algebra, evaluate
from mbsgen.roles import Role, name_adjoint, name_derivative
from mbsrun.ocp.evaluation.backends import symbolic
from mbsrun.ocp.ground.functions import Formula, Function, KernelResult, Pattern
from mbsrun.ocp.ground.plant import Plant

Symbol = Any  # ca.SX; or ca.MX, where an expression calls a function that is no formula, such as a table


def _choose_larger(a: Symbol, b: Symbol) -> Symbol:
    """Return the larger one; the derivative is half of each where they are equal, which CasADi's fmax does not say."""
    s = (1 + ca.sign(a - b)) / 2
    return s * a + (1 - s) * b


_BUILT_IN: Mapping[str, Callable[..., Symbol]] = {"abs": ca.fabs, "max": _choose_larger}


def _make_algebra(kind: type[Symbol]) -> Algebra[Symbol]:
    return Algebra(
        number=kind,
        constants={"pi": kind(ca.pi)},
        negate=operator.neg,
        operations={"+": operator.add, "-": operator.sub, "*": operator.mul, "/": operator.truediv},
        power=operator.pow,
        functions={**_BUILT_IN} | {name: getattr(ca, name) for name in PRIMITIVES if name not in _BUILT_IN},
    )


_ALGEBRAS: Mapping[type[Symbol], Algebra[Symbol]] = {kind: _make_algebra(kind) for kind in (ca.SX, ca.MX)}


@dataclass(frozen=True)
class Nonzeros:
    """Entries of one matrix at all places, place by place."""

    pattern: Pattern  # at one place
    values: ca.MX


class Placed(Protocol):
    """A function at many places; arguments are (size, places)."""

    def value(self, arguments: Sequence[ca.MX]) -> ca.MX:
        """Return the results, (size, places)."""

    def jacobian(self, arguments: Sequence[ca.MX]) -> list[Nonzeros]:
        """Return the derivatives by each input."""

    def gradient(self, arguments: Sequence[ca.MX], weights: ca.MX) -> list[Nonzeros]:
        """Return the derivatives of the weighted sum of results by each input, as columns."""

    def hessian(self, arguments: Sequence[ca.MX], weights: ca.MX) -> Mapping[tuple[int, int], Nonzeros]:
        """Return the second derivatives of the weighted sum of results by pairs of inputs."""


def place(function: Function, plant: Plant, places: int) -> Placed:
    """Apply a function at a number of places."""
    if isinstance(function, Formula) and function.computed:
        return PlacedFormula(function, plant, places)
    inputs = len(function.inputs)
    return PlacedFunction(make_function(function, plant), inputs, places)


# --- functions of one place ------------------------------------------------------------------------------------------


def make_function(function: Function, plant: Plant) -> ca.Function:
    """Make a CasADi function; it is differentiable by its inputs, not by parameters and data."""
    return _make_formula(function, plant) if isinstance(function, Formula) else _make_result(function, plant)


def _make_result(result: KernelResult, plant: Plant) -> ca.Function:
    kernel = _find_kernel(result, plant)
    is_whole = result.entries is None and result.fixed is None and kernel.n_out() == 1
    if is_whole and tuple(kernel.name_in()) == result.inputs:
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


def _find_kernel(result: KernelResult, plant: Plant) -> ca.Function:
    """Return a kernel, with theta as an input where its result is a function of it."""
    design = any(a.role is Role.DESIGN and a.name in result.inputs for a in plant.describe(result.kernel).inputs)
    return plant.casadi(result.kernel, design=design)


def _apply(kernel: ca.Function, result: KernelResult, given: Sequence[ca.MX]) -> ca.MX:
    return kernel(**dict(zip(result.inputs, given, strict=True)))[result.result]


def _make_formula(formula: Formula, plant: Plant) -> ca.Function:
    """Make the function of all arguments, with kernels inside."""
    symbols = make_symbols(formula, plant)
    kinds = list(symbols)
    results, options = express(formula, symbols), _options(formula, kinds)
    plain = ca.Function("formula", list(symbols.values()), [results], kinds, ["value"], options)
    if not formula.computed:
        return plain
    given = {part.kind: ca.MX.sym(part.kind, part.size) for part in formula.arguments}
    values = given | {
        kind: ca.vec(_apply(_find_kernel(result, plant), result, [given[name] for name in result.inputs]))
        for kind, result in formula.computed
    }
    value = plain.call([values[kind] for kind in kinds])[0]
    return ca.Function("formula", list(given.values()), [value], list(given), ["value"], _options(formula, list(given)))


def choose_kind(formula: Formula) -> type[Symbol]:
    """Choose the symbols in which a formula can be written."""
    return ca.SX if all(symbolic.is_plain(call.code) for call in formula.calls) else ca.MX


def make_symbols(formula: Formula, plant: Plant) -> dict[str, Symbol]:
    """Make symbols of all arguments, and then of the results of kernels."""
    kind_of_symbols = choose_kind(formula)
    sizes = {part.kind: part.size for part in formula.arguments}
    sizes |= {kind: _find_kernel(result, plant).numel_out(result.result) for kind, result in formula.computed}
    return {kind: kind_of_symbols.sym(kind, size) for kind, size in sizes.items()}


def express(formula: Formula, symbols: Mapping[str, Symbol]) -> Symbol:
    """Evaluate the expressions."""
    algebra = _ALGEBRAS[choose_kind(formula)]
    values = {name: symbols[kind][index] for name, (kind, index) in formula.names.items()}
    for call in formula.calls:
        arguments = [evaluate(argument, values, algebra) for argument in call.arguments]
        values[call.name] = symbolic.load(call.code).call(arguments)[0]
    return ca.vertcat(*(evaluate(expression, values, algebra) for expression in formula.expressions))


def _options(formula: Formula, kinds: Sequence[str]) -> dict[str, list[bool]]:
    """Name the arguments that are variables: by the others nothing is differentiated."""
    others = {part.kind for part in (formula.parameters, formula.data) if part is not None}
    return {"is_diff_in": [kind not in others for kind in kinds]}


# --- at many places --------------------------------------------------------------------------------------------------


class PlacedFunction:
    """A CasADi function with one result, and its own derivatives."""

    def __init__(self, function: ca.Function, inputs: int, places: int) -> None:
        """Take a function, by some first inputs of which it is differentiated."""
        self._function, self._inputs, self._places = function, inputs, places

    def value(self, arguments: Sequence[ca.MX]) -> ca.MX:
        """Return the results, (size, places)."""
        return ca.densify(self._function.map(self._places)(*arguments))

    def jacobian(self, arguments: Sequence[ca.MX]) -> list[Nonzeros]:
        """Return the derivatives by each input."""
        function = self._function.jacobian()
        parts = self._call(function, dict(enumerate(arguments)))
        return [_read(function, i, parts[i], self._places) for i in range(self._inputs)]

    def gradient(self, arguments: Sequence[ca.MX], weights: ca.MX) -> list[Nonzeros]:
        """Return the derivatives of the weighted sum of results by each input, as columns."""
        adjoint, jacobian = self._function.reverse(1), self._function.jacobian()
        products = self._call(adjoint, {**dict(enumerate(arguments)), len(arguments) + 1: weights})
        parts = []
        for i, product in enumerate(products[: self._inputs]):
            # an adjoint may be dense where F's Jacobian is not
            read = sorted(set(jacobian.sparsity_out(i).get_triplet()[1]))
            pattern = ca.Sparsity.triplet(product.size1(), 1, read, [0] * len(read))
            parts.append(_take(pattern, product, self._places))
        return parts

    def hessian(self, arguments: Sequence[ca.MX], weights: ca.MX) -> Mapping[tuple[int, int], Nonzeros]:
        """Return the second derivatives of the weighted sum of results by pairs of inputs."""
        function = self._function.reverse(1).jacobian()  # inputs: F's, its result, weights, the adjoint's results
        n = len(arguments)
        parts = self._call(function, {**dict(enumerate(arguments)), n + 1: weights})
        which = {(i, j): i * (n + 2) + j for i in range(self._inputs) for j in range(self._inputs)}
        return {pair: _read(function, k, parts[k], self._places) for pair, k in which.items() if function.nnz_out(k)}

    def _call(self, function: ca.Function, given: Mapping[int, ca.MX]) -> Sequence[ca.MX]:
        """Call a function at all places; other inputs are not read."""
        places = self._places
        unread = [ca.MX(function.size1_in(k), places * function.size2_in(k)) for k in range(function.n_in())]
        return function.map(places).call([given.get(k, none) for k, none in enumerate(unread)])


_WEIGHTS = "@weights"  # of results, beside the kinds of inputs


class PlacedFormula:
    """Expressions of inputs, parameters, data, and results of kernels."""

    def __init__(self, formula: Formula, plant: Plant, places: int) -> None:
        """Make symbols of the numbers that expressions read."""
        self._formula, self._places = formula, places
        self._kernels = {kind: (result, _find_kernel(result, plant)) for kind, result in formula.computed}
        self._kind = choose_kind(formula)
        self._symbols = make_symbols(formula, plant)
        self._F = express(formula, self._symbols)
        self._w = self._kind.sym("w", self._F.numel())

    def value(self, arguments: Sequence[ca.MX]) -> ca.MX:
        """Return the results, (size, places)."""
        (found,) = self._apply([ca.densify(self._F)], {}, self._name(arguments))
        return ca.reshape(found.values, -1, self._places)

    def jacobian(self, arguments: Sequence[ca.MX]) -> list[Nonzeros]:
        """Return the derivatives by each input."""
        slopes = ca.jacobian(self._F, self._v) @ self._V
        return self._apply(ca.horzsplit(slopes, self._offsets), self._slopes, self._differentiate(arguments))

    def gradient(self, arguments: Sequence[ca.MX], weights: ca.MX) -> list[Nonzeros]:
        """Return the derivatives of the weighted sum of results by each input, as columns."""
        slopes = (ca.jacobian(self._F, self._v) @ self._V).T @ self._w
        given = self._differentiate(arguments) | {_WEIGHTS: weights}
        return self._apply(ca.vertsplit(slopes, self._offsets), self._slopes | {_WEIGHTS: self._w}, given)

    def hessian(self, arguments: Sequence[ca.MX], weights: ca.MX) -> Mapping[tuple[int, int], Nonzeros]:
        """Return the second derivatives of the weighted sum of results by pairs of inputs."""
        weighted = ca.dot(self._w, self._F)
        given = self._differentiate(arguments) | {_WEIGHTS: weights}
        by_results = [ca.densify(ca.gradient(weighted, self._symbols[kind])) for kind in self._kernels]
        adjoints = [part.values for part in self._apply(by_results, {_WEIGHTS: self._w}, given)]
        H = self._V.T @ ca.hessian(weighted, self._v)[0] @ self._V
        curvatures = {}
        for (kind, (result, kernel)), adjoint in zip(self._kernels.items(), adjoints, strict=True):
            function = kernel.reverse(1).jacobian()
            shaped = ca.reshape(adjoint, kernel.size1_out(result.result), -1)
            found = self._call(function, given | {name_adjoint(result.result): shaped})
            for first in result.inputs:
                for second in result.inputs:
                    name = name_derivative(name_adjoint(first), second)
                    symbol = self._kind.sym(name, function.sparsity_out(name))
                    curvatures[_join(kind, name)], given[_join(kind, name)] = symbol, found[name]
                    H += self._select(first).T @ symbol @ self._select(second)
        n = len(self._formula.inputs)
        parts = [part for row in ca.blocksplit(H, self._offsets, self._offsets) for part in row]
        blocks = dict(zip(((i, j) for i in range(n) for j in range(n)), parts, strict=True))
        nonzero = {pair: part for pair, part in blocks.items() if part.nnz()}
        further = self._slopes | curvatures | {_WEIGHTS: self._w}
        return dict(zip(nonzero, self._apply(list(nonzero.values()), further, given), strict=True))

    # --- symbols: the inputs x, the results y of kernels, and the nonzeros of their derivatives ---

    @property
    def _offsets(self) -> list[int]:
        """Where inputs begin in x, and its size."""
        return [0, *np.cumsum([part.size for part in self._formula.inputs]).tolist()]

    @property
    def _v(self) -> Symbol:
        kinds = [part.kind for part in self._formula.inputs]
        return ca.vertcat(*(self._symbols[kind] for kind in (*kinds, *self._kernels)))

    @cached_property
    def _slopes(self) -> dict[str, Symbol]:
        """The derivatives of the results of kernels by their inputs."""
        return {
            _join(kind, name): self._kind.sym(
                _join(kind, name), kernel.jacobian().sparsity_out(name_derivative(result.result, name))
            )
            for kind, (result, kernel) in self._kernels.items()
            for name in result.inputs
        }

    @property
    def _V(self) -> Symbol:
        rows = [self._kind.eye(self._offsets[-1])]
        for kind, (result, _) in self._kernels.items():
            rows.append(
                sum(
                    (self._slopes[_join(kind, name)] @ self._select(name) for name in result.inputs),
                    start=self._kind(self._symbols[kind].numel(), self._offsets[-1]),
                )
            )
        return ca.vertcat(*rows)

    def _select(self, name: str) -> Symbol:
        """Return the matrix that selects an input from x."""
        i = [part.kind for part in self._formula.inputs].index(name)
        return self._kind.eye(self._offsets[-1])[self._offsets[i] : self._offsets[i + 1], :]

    # --- calls at all places ---

    def _name(self, arguments: Sequence[ca.MX]) -> dict[str, ca.MX]:
        """Name the arguments, and compute the results of kernels."""
        given = {part.kind: x for part, x in zip(self._formula.arguments, arguments, strict=True)}
        for kind, (result, kernel) in self._kernels.items():
            value = ca.densify(self._call(kernel, given)[result.result])
            given[kind] = ca.reshape(value, -1, self._places)
        return given

    def _differentiate(self, arguments: Sequence[ca.MX]) -> dict[str, ca.MX]:
        """Compute the derivatives of the results of kernels as well."""
        given = self._name(arguments)
        for kind, (result, kernel) in self._kernels.items():
            found = self._call(kernel.jacobian(), given)
            given |= {_join(kind, name): found[name_derivative(result.result, name)] for name in result.inputs}
        return given

    def _call(self, function: ca.Function, given: Mapping[str, ca.MX]) -> dict[str, ca.MX]:
        """Call a kernel; inputs without a value are zero."""
        named = {name: given[name] for name in function.name_in() if name in given}
        return function.map(self._places)(**named)

    def _apply(
        self, results: Sequence[Symbol], further: dict[str, Symbol], given: Mapping[str, ca.MX]
    ) -> list[Nonzeros]:
        """Evaluate expressions of symbols that have values."""
        if not results:
            return []
        symbols = self._symbols | further
        every = ca.vertcat(*(ca.vec(result) for result in results))
        free = _list_symbols(every)
        read = {name: x for name, x in symbols.items() if free & _list_symbols(x)}
        read = read or dict([next(iter(symbols.items()))])  # a function needs an input
        function = ca.Function("expressions", list(read.values()), list(results))
        found = function.map(self._places).call([given[name] for name in read])
        return [_read(function, i, part, self._places) for i, part in enumerate(found)]


def _list_symbols(expression: Symbol) -> set[str]:
    """List the names of the symbols in an expression, whether or not its value depends on them."""
    return {symbol.name() for symbol in ca.symvar(expression)}


def _join(kind: str, name: str) -> str:
    """Name the derivative of a kind by an input, as no kind is named."""
    return f"{kind}'{name}"


def _read(function: ca.Function, i: int, part: ca.MX, places: int) -> Nonzeros:
    """Take the nonzeros of result i of a function at all places."""
    return _take(function.sparsity_out(i), part, places)


def _take(pattern: ca.Sparsity, part: ca.MX, places: int) -> Nonzeros:
    """Take the entries of a pattern at all places; where CasADi has found that some are 0, it holds fewer."""
    values = ca.project(part, ca.repmat(pattern, 1, places))
    return Nonzeros(read_pattern(pattern), ca.vec(values.nz[:]))


def read_pattern(sparsity: ca.Sparsity) -> Pattern:
    """Return the pattern of CasADi's."""
    row, col = (np.asarray(k, dtype=np.int64) for k in sparsity.get_triplet())
    return Pattern(sparsity.shape, row, col)
