"""The functions that a program applies, as data: results of kernels, and expressions; no backend is known here.

    KernelResult    y = entries of result(inputs)           a kernel, by name
    Formula         y_i = expression_i(names)               of inputs, constants, and results of kernels
    SymbolicCall    value of a CasADi function              of expressions; expressions of a formula read it by name

`Evaluation` is what a backend makes of one: values, Jacobian and Hessian at many places at once, with their patterns.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from mbsgen.expressions import Expression

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


@dataclass(frozen=True)
class Fixed:
    """An input of which some entries vary, and the others keep a value."""

    varying: tuple[int, ...]
    values: tuple[float, ...]  # of all entries; entries that vary are replaced


@dataclass(frozen=True)
class KernelResult:
    """A result of a kernel as a vector, column by column, as a function of the kernel's inputs."""

    kernel: str
    inputs: tuple[str, ...]  # all of them, in the order of the block's columns
    result: str
    entries: tuple[int, ...] | None = None  # of the vector; None: all
    fixed: Fixed | None = None  # of the first input: then its column holds the entries that vary


@dataclass(frozen=True)
class Input:
    """An input of a formula: a vector that names refer to."""

    kind: str
    size: int


@dataclass(frozen=True)
class SymbolicCall:
    """A scalar function of CasADi, applied to expressions; the expressions of a formula read its value by name."""

    name: str
    code: str  # CasADi's serialisation of the function
    arguments: tuple[Expression, ...]


@dataclass(frozen=True)
class Formula:
    """Expressions as one function: a value for each.

    Inputs are the columns of a block, in order; `parameters` and `data` follow, by which nothing is differentiated.
    """

    expressions: tuple[Expression, ...]
    names: Mapping[str, tuple[str, int]]  # of each name that expressions read: kind and index
    inputs: tuple[Input, ...]
    parameters: Input | None = None
    data: Input | None = None
    computed: tuple[tuple[str, KernelResult], ...] = ()  # kinds that kernels compute of inputs
    calls: tuple[SymbolicCall, ...] = ()  # whose values expressions read by name

    @property
    def arguments(self) -> tuple[Input, ...]:
        """List inputs, parameters and data."""
        return (*self.inputs, *(part for part in (self.parameters, self.data) if part is not None))


Function = KernelResult | Formula


@dataclass(frozen=True)
class Pattern:
    """The nonzeros of a matrix, in the order in which an evaluation returns their values."""

    shape: tuple[int, int]
    row: Indices
    col: Indices


class Evaluation(Protocol):
    """A function at a fixed number of places, twice differentiable by its inputs.

    Arguments are arrays (places, size): inputs, then parameters and data, if there are any. Where a kernel fails, the
    numbers of its place, or of all places, are not numbers. Results may be overwritten by the next call.
    """

    @property
    def sizes(self) -> tuple[int, ...]:
        """Sizes of the inputs."""

    @property
    def jacobian_patterns(self) -> tuple[Pattern, ...]:
        """Patterns of the derivatives by each input: (size of the result, size of the input)."""

    @property
    def hessian_patterns(self) -> tuple[Pattern, ...]:
        """Patterns of the second derivatives by each pair of inputs, row by row."""

    def value(self, arguments: Sequence[Array]) -> Array:
        """Return the results, (places, size)."""

    def jacobian(self, arguments: Sequence[Array]) -> Sequence[Array]:
        """Return the nonzeros of the derivatives by each input, (places, nonzeros)."""

    def hessian(self, arguments: Sequence[Array], weights: Array) -> Sequence[Array]:
        """Return the nonzeros of the second derivatives of weights' results, (places, nonzeros) for each pair."""
