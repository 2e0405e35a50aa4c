"""The face of kernels that libraries of arrays share: arrays by name in, arrays by name out, checked as by NumPy.

A library of arrays reads values, calls operators, and differentiates the calls by the kernels' derivatives.
"""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from inspect import Parameter, Signature
from pathlib import Path
from typing import Any, ClassVar, Generic, Self, TypeVar, cast

import numpy as np

from mbsgen.errors import MbsError
from mbsgen.manifest import Kernel, Manifest
from mbsgen.roles import Order, Role
from mbsrun.binding import ArgumentError, Port
from mbsrun.external import Mechanism, OnDemand, load_on_demand
from mbsrun.faces.operators import Operator
from mbsrun.smoothness import demand_smooth

A = TypeVar("A")  # an array of the library
VALUES = "p"  # the input for values of run-time parameters, in place of `h`


@dataclass(frozen=True)
class Given(Generic[A]):
    """The inputs of a call by nonzeros, in the operator's order, and the shape of its batch."""

    arrays: tuple[A, ...]
    batch: tuple[int, ...]


class Face(ABC, Generic[A]):
    """The functions of a model on arrays of a library, with exact first and second derivatives.

    `f("exp1", q=q, qd=qd, u=u)` and `f.exp1(q=q, qd=qd, u=u)` return a dictionary of results, as the functions of
    `mbsrun.load` do. Any input may have leading axes of a batch; inputs without them are the same for all states.
    Results of a state that cannot be computed are not numbers; `attempt` returns the status of each state, too.
    """

    place: ClassVar[str]  # the module to import
    kind: ClassVar[str]  # of arrays, for messages

    def __init__(self, model: str | Path | Mechanism | OnDemand, parameters: Mapping[str, float] | None = None) -> None:
        """Load a model file or a generated folder, or take what `mbsrun.load` has loaded."""
        loaded = load_on_demand(Path(model)) if isinstance(model, (str, Path)) else model
        demand_smooth(loaded.manifest, f"a program of {self.place}", stops=True)
        self.kernels = loaded.with_parameters(**parameters) if parameters else loaded
        self._operators: dict[str, Operator] = {}
        self._filled: dict[str, Mapping[str, Any]] = {}
        self._functions: dict[str, Callable[..., dict[str, A]]] = {}

    @property
    def manifest(self) -> Manifest:
        """The description of the model and its functions."""
        return self.kernels.manifest

    @property
    def parameters(self) -> Mapping[str, float]:
        """The values of run-time and differentiated parameters that calls take where they give none."""
        return self.kernels.parameters

    @property
    def p(self) -> A:
        """The present values of the run-time parameters: what an input `p` replaces."""
        return self._read(np.array([self.parameters[x.name] for x in self.manifest.parameters]))

    @property
    def theta(self) -> A:
        """The present values of the differentiated parameters: what an input `theta` replaces."""
        return self._read(np.array([self.parameters[x.name] for x in self.manifest.design]))

    def with_parameters(self, **parameters: float) -> Self:
        """Return the same functions with other values of the named parameters, which are plain numbers."""
        arrays = [name for name, x in parameters.items() if not isinstance(x, (int, float, np.floating, np.integer))]
        if arrays:
            raise ArgumentError(
                f"{', '.join(arrays)}: with_parameters takes plain numbers; give {self.kind} as the input theta or p "
                "of a call"
            )
        other = copy.copy(self)
        other.kernels = self.kernels.with_parameters(**parameters)
        other._filled, other._functions = {}, {}
        return other

    def __call__(self, name: str, /, **inputs: Any) -> dict[str, A]:
        """Call a function; return its results by name. Raises ArgumentError for inputs that do not fit."""
        return self._call(self._find(name), inputs, with_status=False)[0]

    def attempt(self, name: str, /, **inputs: Any) -> tuple[dict[str, A], A]:
        """Call a function; return its results, and for each state 0 or the number that `find_place` reads."""
        results, status = self._call(self._find(name), inputs, with_status=True)
        assert status is not None
        return results, status

    def __getattr__(self, name: str) -> Callable[..., dict[str, A]]:
        """Return a function of the model."""
        if name.startswith("_") or name in ("kernels",):
            raise AttributeError(name)
        try:
            operator = self._find(name)
        except MbsError as fault:
            raise AttributeError(f"{type(self).__name__} has no attribute {name!r}: {fault}") from None
        if name not in self._functions:
            self._functions[name] = _document(self, operator)
        return self._functions[name]

    def __dir__(self) -> list[str]:
        return [*super().__dir__(), *(k.name for k in self.manifest.kernels if k.order is Order.VALUE)]

    def __repr__(self) -> str:
        """Return the model, its coordinates and inputs, and the functions."""
        kind = type(self.kernels).__name__
        return repr(self.kernels).replace(f"{kind}(", f"{self.place}.{type(self).__name__}(", 1)

    @abstractmethod
    def _read(self, value: Any) -> A:
        """Return an array of float64. Raises ArgumentError with the finding for anything else."""

    @abstractmethod
    def _run(self, operator: Operator, given: Given[A], *, with_status: bool) -> tuple[Sequence[A], A | None]:
        """Call an operator on nonzeros: one row for each state; return nonzeros, and statuses if asked."""

    @abstractmethod
    def _take(self, array: A, numbers: Any) -> A:
        """Take entries of the last axis by numbers, whose shape replaces it; one past the end is 0."""

    @abstractmethod
    def _merge(self, first: A, second: A) -> A:
        """Return the first status where it is not 0, else the second."""

    def _find(self, name: str) -> Operator:
        if name not in self._operators:
            self._operators[name] = Operator(self.kernels.find_family(name), name)
        return self._operators[name]

    def _lay(self, name: str, inputs: Mapping[str, Any]) -> tuple[Operator, tuple[A, ...]]:
        """Return an operator, and the nonzeros of its inputs."""
        operator = self._find(name)
        _, inputs = self._set_up(operator, inputs, with_status=False)
        return operator, self._collect(operator, inputs).arrays

    def _call(
        self, operator: Operator, inputs: Mapping[str, Any], *, with_status: bool
    ) -> tuple[dict[str, A], A | None]:
        prior, inputs = self._set_up(operator, inputs, with_status=with_status)
        given = self._collect(operator, inputs)
        found, status = self._run(operator, given, with_status=with_status)
        nonzeros = iter(found)
        results = {}
        for port in operator.value.entry.outputs:
            array: Any = next(nonzeros) if port.argument.nnz else self._read(np.zeros((*given.batch, 0)))
            results[port.argument.name] = self._spread(port, array, given.batch)
        return results, status if prior is None or status is None else self._merge(prior, status)

    def _set_up(
        self, operator: Operator, inputs: Mapping[str, Any], *, with_status: bool
    ) -> tuple[A | None, Mapping[str, Any]]:
        """Replace values of run-time parameters by the results of the setup; return its status, too."""
        if VALUES not in inputs:
            return None, inputs
        hidden, setup = operator.value.entry.hidden, operator.kernels.manifest.setup
        if hidden is None or setup is None:
            return None, inputs
        if hidden in inputs:
            raise ArgumentError(f"{operator.name}: {VALUES} and {hidden} are given; {hidden} is computed from {VALUES}")
        results, status = self._call(
            Operator(operator.kernels, setup.name), {setup.inputs[0].name: inputs[VALUES]}, with_status=with_status
        )
        rest = {name: value for name, value in inputs.items() if name != VALUES}
        return status, {**rest, hidden: results[setup.outputs[0].name]}

    def _collect(self, operator: Operator, inputs: Mapping[str, Any]) -> Given[A]:
        """Pair the operator's inputs with arrays; all faults are reported together."""
        entry, filled = operator.value.entry, self._fill(operator)
        faults = [f"{name}: there is no such input" for name in inputs if name not in entry.wanted]
        arrays: dict[str, A] = {}
        batches: dict[str, tuple[int, ...]] = {}
        for name, port in entry.wanted.items():
            if name in filled and name not in inputs:
                arrays[name] = self._read(filled[name])
            elif name not in inputs:
                faults += [f"{name}: missing, shape {_text(port.shape)}"] if _is_needed(port) else []
            else:
                try:
                    array: Any = self._read(inputs[name])
                    batches[name] = _find_batch(port, tuple(array.shape))
                    arrays[name] = self._gather(port, array)
                except ArgumentError as fault:
                    faults.append(f"{name}: {fault}")
        different = dict.fromkeys(batch for batch in batches.values() if batch)
        if len(different) > 1:
            faults.append(f"the inputs have batches of shapes {', '.join(map(_text, different))}; give all the same")
        if faults:
            raise ArgumentError("\n".join(f"{operator.name}: {fault}" for fault in faults))
        ports = operator.value.given
        zeros = {p.argument.name: np.zeros(p.argument.nnz) for p in ports if p.argument.name not in arrays}
        arrays |= {name: self._read(value) for name, value in zeros.items()}
        return Given(tuple(arrays[port.argument.name] for port in ports), next(iter(different), ()))

    def _fill(self, operator: Operator) -> Mapping[str, Any]:
        """Return the inputs that come from parameters, for a function that takes them."""
        entry = operator.value.entry
        if entry.hidden is None and entry.design is None:
            return {}
        if operator.name not in self._filled:
            kernels, names = operator.kernels.with_parameters(**self.parameters), (entry.hidden, entry.design)
            self._filled[operator.name] = {name: x for name, x in kernels.filled.items() if name in names}
        return self._filled[operator.name]

    def _gather(self, port: Port, array: Any) -> Any:
        """Return the nonzeros of an array, along its last axis."""
        if port.is_vector and port.places is None:
            return array
        a, batch = port.argument, array.shape[: array.ndim - len(port.shape)]
        columns = array.reshape((*batch, a.rows, a.cols)).swapaxes(-1, -2).reshape((*batch, a.rows * a.cols))
        if port.places is None:
            return columns
        return self._take(columns, port.places[1] * a.rows + port.places[0])

    def _spread(self, port: Port, nonzeros: Any, batch: tuple[int, ...]) -> A:
        """Return the whole array of nonzeros."""
        a = port.argument
        whole: Any = nonzeros
        if port.places is not None:
            whole = self._take(nonzeros, np.where(port.spread() < 0, a.nnz, port.spread()))
            whole = whole.reshape((*batch, *port.shape))
        elif not port.is_vector:
            whole = nonzeros.reshape((*batch, a.cols, a.rows)).swapaxes(-1, -2)
        return cast("A", whole)


def _is_needed(port: Port) -> bool:
    return bool(port.argument.nnz) and port.argument.role is not Role.REMAINDER


def _find_batch(port: Port, shape: tuple[int, ...]) -> tuple[int, ...]:
    """Return the leading axes of an array. Raises ArgumentError where the rest is not the input's shape."""
    own = port.shape
    if len(shape) < len(own) or shape[len(shape) - len(own) :] != own:
        raise ArgumentError(f"shape {_text(shape)} given, {_text(own)} or {_text(('batch', *own))} expected")
    return shape[: len(shape) - len(own)]


def _document(face: Face[A], operator: Operator) -> Callable[..., dict[str, A]]:
    """Return a function that describes itself: its inputs and results, with shapes and units."""
    kernel = operator.value.entry.kernel

    def function(**inputs: Any) -> dict[str, A]:
        return face(kernel.name, **inputs)

    taken = [port for port in operator.value.given if not port.is_hidden and port.argument.role is not Role.DESIGN]
    function.__name__ = function.__qualname__ = kernel.name
    function.__doc__ = _describe(kernel, taken)
    parameters = [Parameter(port.argument.name, Parameter.KEYWORD_ONLY) for port in taken]
    function.__signature__ = Signature(parameters)  # type: ignore[attr-defined]
    return function


def _describe(kernel: Kernel, taken: Sequence[Port]) -> str:
    inputs = [f"    {port.argument.name} {_text(port.shape)}  {port.argument.unit}".rstrip() for port in taken]
    outputs = [f"    {a.name} {_text((a.rows, a.cols) if a.matrix else (a.rows,))}  {a.unit}" for a in kernel.outputs]
    return "\n".join([f"Compute {kernel.name}.", "", "Inputs:", *inputs, "Returns:", *(x.rstrip() for x in outputs)])


def _text(shape: tuple[object, ...]) -> str:
    return f"({', '.join(map(str, shape))}{',' if len(shape) == 1 else ''})"
