"""A CasADi function at many places, called on its own buffers: an `Evaluation` for algorithms in NumPy."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import casadi as ca
import numpy as np

from mbsrun.ocp.evaluation.backends.places import read_pattern
from mbsrun.ocp.ground.functions import Array, Pattern


class Call:
    """A function mapped over places, on its own buffers: (places, nonzeros) for each input and result."""

    def __init__(self, function: ca.Function, places: int, inputs: Sequence[int], results: Sequence[int]) -> None:
        """Bind some inputs and results, by number; other inputs are zeros, other results are not computed."""
        mapped = function.map(places)
        self._buffer, self._run = mapped.buffer()
        self.inputs = [np.zeros((places, function.nnz_in(i))) for i in inputs]
        self.results = [np.zeros((places, function.nnz_out(j))) for j in results]
        for i, array in zip(inputs, self.inputs, strict=True):
            self._buffer.set_arg(i, array.data)  # type: ignore[call-arg]  # the size is read off it
        for j, array in zip(results, self.results, strict=True):
            if array.size:
                self._buffer.set_res(j, array.data)  # type: ignore[call-arg]

    def __call__(self, arguments: Sequence[Array]) -> list[Array]:
        """Evaluate; the next call overwrites the results. They are not numbers where the function fails."""
        for held, given in zip(self.inputs, arguments, strict=True):
            held[:] = given
        self._run()
        if self._buffer.ret():
            for array in self.results:
                array[:] = np.nan
        return self.results


class MappedFunction:
    """A function of some inputs, with its derivatives by all of them."""

    def __init__(self, function: ca.Function, places: int) -> None:
        """Map a function over places."""
        self._function, self._places, self._n = function, places, function.n_in()

    @property
    def sizes(self) -> tuple[int, ...]:
        """Sizes of the inputs."""
        return tuple(self._function.size1_in(i) for i in range(self._n))

    @cached_property
    def jacobian_patterns(self) -> tuple[Pattern, ...]:
        """Patterns of the derivatives by each input."""
        jacobian = self._function.jacobian()
        return tuple(read_pattern(jacobian.sparsity_out(i)) for i in range(self._n))

    @cached_property
    def hessian_patterns(self) -> tuple[Pattern, ...]:
        """Patterns of the second derivatives by each pair of inputs, row by row."""
        return tuple(read_pattern(self._adjoint_jacobian.sparsity_out(k)) for k in self._pairs)

    def value(self, arguments: Sequence[Array]) -> Array:
        """Return the results, (places, size)."""
        return self._value(arguments)[0]

    def jacobian(self, arguments: Sequence[Array]) -> Sequence[Array]:
        """Return the nonzeros of the derivatives by each input, (places, nonzeros)."""
        return self._jacobian(arguments)

    def hessian(self, arguments: Sequence[Array], weights: Array) -> Sequence[Array]:
        """Return the nonzeros of the second derivatives of weights' results, (places, nonzeros) for each pair."""
        return self._hessian([*arguments, weights])

    @cached_property
    def _value(self) -> Call:
        return Call(self._function, self._places, range(self._n), [0])

    @cached_property
    def _jacobian(self) -> Call:
        return Call(self._function.jacobian(), self._places, range(self._n), range(self._n))

    @cached_property
    def _hessian(self) -> Call:
        weights = self._n + 1  # inputs: the function's, its result, weights, the adjoint's results
        return Call(self._adjoint_jacobian, self._places, [*range(self._n), weights], self._pairs)

    @cached_property
    def _adjoint_jacobian(self) -> ca.Function:
        return self._function.reverse(1).jacobian()

    @property
    def _pairs(self) -> list[int]:
        """Number the results that are second derivatives, row by row."""
        return [i * (self._n + 2) + j for i in range(self._n) for j in range(self._n)]
