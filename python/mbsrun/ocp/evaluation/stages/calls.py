"""How kernels and formulas are called in CasADi's contract: places of arguments and results, and patterns.

Of a function with n inputs and m results, the contract is (inputs and results are counted from 0):

    f             n inputs, m results
    jac_f         n + m inputs, block of result o by input i at o n + i
    jac_adj1_f    n + 2 m + n inputs, weights of result o at n + m + o; block of inputs i, j at i (n + 2 m) + j
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mbsgen.manifest import Argument, Kernel
from mbsgen.roles import Order, Role, name_adjoint, name_derivative, name_kernel
from mbsrun.ocp.evaluation.stages import formulas
from mbsrun.ocp.evaluation.stages.tables import CalledFunction, Derivative, FormulaFunction, Given, KernelFunction
from mbsrun.ocp.ground.functions import Formula, Function, Indices, KernelResult
from mbsrun.ocp.ground.plant import Plant


@dataclass(frozen=True)
class Result:
    """A vector that a call writes, and the entries of a matrix that some of it are."""

    position: int
    size: int
    taken: Indices  # the numbers that are entries
    row: Indices  # of each entry; of second derivatives: an input, as all inputs are numbered
    col: Indices  # of each entry: an input


@dataclass(frozen=True)
class Filling:
    """An argument: the entries that vary, and the values of the others."""

    position: int
    varying: Indices | None  # None: all, in order
    values: tuple[float, ...]


@dataclass(frozen=True)
class Signature:
    """A function, or a derivative of it, as it is called."""

    function: CalledFunction
    arguments: int
    results: int
    inputs: tuple[Filling, ...]  # of each column
    given: tuple[tuple[int, Given], ...]
    parameters: int | None  # positions of these arguments
    data: int | None
    weights: int | None
    weight_size: int
    weighted: Indices  # the entry of the weights of each result; -1: the result is always 0
    found: tuple[Result, ...]
    is_lower: bool = False  # second derivatives are of the lower triangle alone


class Signatures:
    """The signatures of functions of some plants; each is found once."""

    def __init__(self, plants: Sequence[Plant]) -> None:
        """Take the kernels."""
        self._plants = plants
        self._kernels: dict[tuple[KernelResult, Derivative, int], Signature] = {}
        self._formulas: list[tuple[Formula, dict[Derivative, Signature]]] = []

    def find(self, function: Function, derivative: Derivative, plant: int) -> Signature:
        """Return how a function is called; a kernel is of one of the plants."""
        if isinstance(function, KernelResult):
            key = (function, derivative, plant)
            if key not in self._kernels:
                self._kernels[key] = _describe_kernel(function, derivative, self._plants[plant], plant)
            return self._kernels[key]
        known = next((found for formula, found in self._formulas if formula is function or formula == function), None)
        if known is None:
            known = _describe_formula(function)
            self._formulas.append((function, known))
        return known[derivative]


_ORDERS = {
    Derivative.VALUE: Order.VALUE,
    Derivative.JACOBIAN: Order.JACOBIAN,
    Derivative.HESSIAN: Order.ADJOINT_JACOBIAN,
}


def name_called(function: KernelFunction) -> str:
    """Name the kernel that is called."""
    return name_kernel(function.kernel, _ORDERS[function.derivative])


def _describe_kernel(function: KernelResult, derivative: Derivative, plant: Plant, number: int) -> Signature:
    plant = plant.find_family(function.kernel)
    kernel = plant.describe(function.kernel)
    called = KernelFunction(function.kernel, derivative, number)
    derived = {a.name: a for a in plant.describe(name_called(called)).outputs}
    names = [a.name for a in kernel.inputs]
    n, m = len(kernel.inputs), len(kernel.outputs)
    o = [a.name for a in kernel.outputs].index(function.result)
    value = kernel.outputs[o]
    entries = _find_entries(function, value)
    arguments = {Derivative.VALUE: n, Derivative.JACOBIAN: n + m, Derivative.HESSIAN: 2 * (n + m)}
    results = {Derivative.VALUE: m, Derivative.JACOBIAN: n * m, Derivative.HESSIAN: n * (n + 2 * m)}
    fillings = [_fill(function, kernel, names.index(name), i == 0) for i, name in enumerate(function.inputs)]
    varying = [_list_varying(filling, kernel.inputs[filling.position].rows) for filling in fillings]
    first = np.cumsum([0, *(v.size for v in varying)])
    found: list[Result] = []
    if derivative is Derivative.VALUE:
        taken = _invert(_places(value), entries, value.rows * value.cols)
        (row,) = np.nonzero(taken >= 0)
        found.append(Result(o, value.nnz, taken[row], row, np.zeros_like(row)))
    if derivative is Derivative.JACOBIAN:
        for i, name in enumerate(function.inputs):
            block = derived[name_derivative(function.result, name)]
            found.append(_take(block, o * n + names.index(name), (entries, 0), (varying[i], int(first[i]))))
    if derivative is Derivative.HESSIAN:
        for i, a in enumerate(function.inputs):
            for j, b in enumerate(function.inputs):
                block = derived[name_derivative(name_adjoint(a), b)]
                position = names.index(a) * (n + 2 * m) + names.index(b)
                found.append(_take(block, position, (varying[i], int(first[i])), (varying[j], int(first[j]))))
    return Signature(
        function=called,
        arguments=arguments[derivative],
        results=results[derivative],
        inputs=tuple(fillings),
        given=tuple(
            (i, Given(function.kernel, a.name, a.nnz, number))
            for i, a in enumerate(kernel.inputs)
            if a.role in (Role.SETUP, Role.DESIGN) and a.name not in function.inputs
        ),
        parameters=None,
        data=None,
        weights=n + m + o if derivative is Derivative.HESSIAN else None,
        weight_size=value.nnz,
        weighted=_invert(_places(value), entries, value.rows * value.cols),
        found=tuple(found),
    )


def _describe_formula(formula: Formula) -> dict[Derivative, Signature]:
    jacobian, hessian = formulas.patterns(formula)
    n = len(formula.inputs)
    has_parameters, has_data = formula.parameters is not None, formula.data is not None
    inputs = tuple(Filling(i, None, ()) for i in range(n))
    count = len(formula.expressions)
    every = np.arange(count)
    found = {
        Derivative.VALUE: Result(0, count, every, every, np.zeros(count, dtype=np.int64)),
        Derivative.JACOBIAN: Result(0, jacobian.row.size, np.arange(jacobian.row.size), jacobian.row, jacobian.col),
        Derivative.HESSIAN: Result(0, hessian.row.size, np.arange(hessian.row.size), hessian.row, hessian.col),
    }
    arguments = n + has_parameters + has_data
    return {
        derivative: Signature(
            function=FormulaFunction(formula, derivative),
            arguments=arguments + (derivative is Derivative.HESSIAN),
            results=1,
            inputs=inputs,
            given=(),
            parameters=n if has_parameters else None,
            data=n + has_parameters if has_data else None,
            weights=arguments if derivative is Derivative.HESSIAN else None,
            weight_size=count,
            weighted=every,
            found=(result,),
            is_lower=True,
        )
        for derivative, result in found.items()
    }


def _fill(function: KernelResult, kernel: Kernel, position: int, is_first: bool) -> Filling:
    argument = kernel.inputs[position]
    assert argument.row is None, "inputs of kernels are dense"
    if not is_first or function.fixed is None:
        return Filling(position, None, ())
    return Filling(position, np.array(function.fixed.varying, dtype=np.int64), function.fixed.values)


def _list_varying(filling: Filling, size: int) -> Indices:
    return np.arange(size) if filling.varying is None else filling.varying


def _find_entries(function: KernelResult, value: Argument) -> Indices:
    every = range(value.rows * value.cols)
    return np.array(every if function.entries is None else function.entries, dtype=np.int64)


def _places(argument: Argument) -> Indices:
    """Return the place of each nonzero in the matrix as a vector, column by column."""
    row, col = _coordinates(argument)
    return col * argument.rows + row


def _coordinates(argument: Argument) -> tuple[Indices, Indices]:
    if argument.row is None or argument.colind is None:
        rows, cols = np.arange(argument.rows), np.arange(argument.cols)
        return np.tile(rows, cols.size), np.repeat(cols, rows.size)
    return np.array(argument.row, dtype=np.int64), np.repeat(np.arange(argument.cols), np.diff(argument.colind))


def _invert(places: Indices, wanted: Indices, size: int) -> Indices:
    """Return the nonzero at each wanted place; -1: it is always 0."""
    at = np.full(size, -1)
    at[places] = np.arange(places.size)
    return at[wanted]


def _take(block: Argument, position: int, rows: tuple[Indices, int], cols: tuple[Indices, int]) -> Result:
    """Take some rows and columns of a block, and number them from given numbers on."""
    row, col = _coordinates(block)
    new_row, new_col = _renumber(rows, block.rows), _renumber(cols, block.cols)
    (taken,) = np.nonzero((new_row[row] >= 0) & (new_col[col] >= 0))
    return Result(position, block.nnz, taken, new_row[row[taken]], new_col[col[taken]])


def _renumber(kept: tuple[Sequence[int] | Indices, int], size: int) -> Indices:
    new = np.full(size, -1)
    new[list(kept[0])] = kept[1] + np.arange(len(kept[0]))
    return new
