"""A generated function with its derivatives, as operators on arrays of any library.

An operator y = f(x) acts on nonzeros: each argument is an array of shape (nnz,), or (*batch, nnz), a row for each
state. Its derivatives are the kernels that are generated beside it:

    jacobian            dy/dx, block by block
    adjoint             (dy/dx)T lambda
    adjoint_jacobian    d((dy/dx)T lambda)/dx, the second derivatives of lambdaT y
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Container, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray

from mbsgen.manifest import Kernel
from mbsgen.roles import Order, Role, name_adjoint
from mbsrun.binding import ArgumentError, Entry, Port
from mbsrun.external import INTEGER, Mechanism
from mbsrun.many import LAID, Loop, Rows, Several, lay_rows

Places = NDArray[np.intp]


@dataclass(frozen=True)
class Call:
    """A kernel, and the arguments that arrays are passed for: all that have entries."""

    entry: Entry
    choose_loop: Callable[[int], tuple[Loop, Several | None]]  # by the number of states
    given: tuple[Port, ...]
    wanted: tuple[Port, ...]
    key: int  # by the content of its library
    laid: dict[object, list[Rows]] = field(default_factory=dict, compare=False)  # layouts that nobody uses

    @cached_property
    def sizes(self) -> tuple[int, ...]:
        """Return the number of nonzeros of each result."""
        return tuple(port.argument.nnz for port in self.wanted)

    def take_rows(self, states: int, strides: tuple[tuple[int, int], ...]) -> Rows:
        """Take a layout for the nonzeros of the given inputs, by their strides; see `many.lay_rows`.

        Nobody else has it until it is put back.
        """
        try:
            return self.laid[states, strides].pop()
        except LookupError:
            loop, several = self.choose_loop(states)
            inputs = list(zip(self.given, strides, strict=True))
            return lay_rows(loop, self.entry, several, inputs, self.wanted, states)

    def put_rows_back(self, states: int, strides: tuple[tuple[int, int], ...], rows: Rows) -> None:
        """Keep a layout for later calls."""
        if len(self.laid) > LAID:
            self.laid.clear()
        self.laid.setdefault((states, strides), []).append(rows)


@dataclass(frozen=True)
class Block:
    """A block of derivatives: its number among the results of its call, and the arguments it is of, by their numbers.

    Entry k of its nonzeros is at rows[k], among the nonzeros of `of`, and at cols[k], among the nonzeros of `by`.
    """

    number: int
    of: int
    by: int
    rows: Places
    cols: Places
    shape: tuple[int, int]

    @cached_property
    def spread(self) -> Places | None:
        """Return, for each entry, row by row, the index of its nonzero; past the end: it is 0; None: as they are."""
        numbers = np.full(self.shape, self.rows.size, dtype=np.intp)
        numbers[self.rows, self.cols] = np.arange(self.rows.size)
        return None if np.array_equal(numbers.ravel(), np.arange(self.rows.size)) else numbers


@dataclass(frozen=True)
class Derivatives:
    """A call that computes derivatives, and where they are in its results."""

    call: Call
    blocks: tuple[Block, ...]


@dataclass(frozen=True)
class Adjoint:
    """The call that computes an adjoint: its results belong to inputs of the value, by their numbers."""

    call: Call
    inputs: tuple[int, ...]


class Operator:
    """A function of the manifest with its derivatives; kernels are compiled when they are first needed."""

    def __init__(self, kernels: Mechanism, name: str) -> None:
        """Bind the function's own kernel. Raises ArgumentError for a derivative's, and for kernels of acados."""
        self.kernels, self.name = kernels, name
        kernel = kernels.describe(name)
        if kernel.order is not Order.VALUE:
            raise ArgumentError(f"{name} is a derivative; call {kernel.base}, and let the library differentiate it")
        if kernel.integer != INTEGER:
            raise ArgumentError(f"{name} is written for acados, whose integers are not of the other kernels' kind")
        self.value = self._bind(kernel)

    def __hash__(self) -> int:
        return hash(self.value.key)

    def __eq__(self, other: object) -> bool:
        """Return whether both call the same code, whichever object loaded it."""
        return isinstance(other, Operator) and self.value.key == other.value.key

    def __repr__(self) -> str:
        return self.name

    def call(self, order: Order) -> Call:
        """Return the call of an order. Raises ArgumentError for derivatives that are not generated."""
        match order:
            case Order.VALUE:
                return self.value
            case Order.JACOBIAN:
                return self.jacobian.call
            case Order.ADJOINT:
                return self.adjoint.call
            case Order.ADJOINT_JACOBIAN:
                return self.curvature.call
        raise ArgumentError(f"{self.name}: {order.value} is no call of an operator")

    def check_moving(self, moving: Sequence[int]) -> None:
        """Refuse derivatives by inputs that have none."""
        fixed = [self.fixed[i] for i in moving if i in self.fixed]
        if fixed:
            raise ArgumentError(
                f"{self.name} has no derivatives by run-time parameters ({', '.join(fixed)}); "
                "declare the parameter `kind: differentiated` in the model, and differentiate by theta"
            )
        if moving and not self.has_jacobian:
            self.find(Order.JACOBIAN)

    @cached_property
    def fixed(self) -> dict[int, str]:
        """The names of the given inputs without derivatives, by their numbers."""
        arguments = (port.argument for port in self.value.given)
        return {i: a.name for i, a in enumerate(arguments) if not a.role.is_differentiated}

    @cached_property
    def has_jacobian(self) -> bool:
        """Whether first derivatives are generated."""
        return self.kernels.manifest.find(self.name, Order.JACOBIAN) is not None

    def find(self, order: Order) -> Kernel:
        """Describe the kernel of a derivative. Raises ArgumentError where it is not generated."""
        found = self.kernels.manifest.find(self.name, order)
        if found is None:
            has = self.kernels.manifest.find(self.name, Order.JACOBIAN) is not None
            kind = "second derivatives" if has else "derivatives"
            raise ArgumentError(f"{self.kernels.manifest.model}: {self.name} has no generated {kind}")
        return found

    @cached_property
    def jacobian(self) -> Derivatives:
        """Return the Jacobian: blocks of results by inputs."""
        call = self._bind(self.find(Order.JACOBIAN))
        of, by = _index(self.value.wanted), _index(self.value.given)
        return Derivatives(call, self._find_blocks(call, of, by, self.value.wanted))

    @cached_property
    def adjoint(self) -> Adjoint:
        """Return the adjoint; its inputs are the value's and then a weight for each result."""
        call = self._bind(self.find(Order.ADJOINT))
        places = _index(self.value.given)
        return Adjoint(call, tuple(places[str(port.argument.by)] for port in call.wanted))

    @cached_property
    def curvature(self) -> Derivatives:
        """Return the second derivatives of the weighted sum of results: blocks of inputs by inputs."""
        kernel, places = self.find(Order.ADJOINT_JACOBIAN), _index(self.value.given)
        call = self._bind(kernel, by=places)
        adjoints = {name_adjoint(name): number for name, number in places.items()}
        return Derivatives(call, self._find_blocks(call, adjoints, places, self.value.given))

    @cached_property
    def length(self) -> int:
        """Return the number of nonzeros of all results."""
        return sum(self.value.sizes)

    def list_units(self) -> list[NDArray[np.float64]]:
        """Return weights of the results that choose one nonzero each: matrices with a row for each choice."""
        ends = np.cumsum(self.value.sizes)[:-1]
        return np.split(np.eye(self.length), ends, axis=1)

    def _bind(self, kernel: Kernel, by: Container[str] | None = None) -> Call:
        library = self.kernels.compile(kernel.name)
        entry = self.kernels.bind(kernel.name)
        given = sorted((port for port in entry.inputs if port.argument.nnz), key=_find_turn)  # h follows weights there
        wanted = tuple(port for port in entry.outputs if port.argument.nnz and (by is None or port.argument.by in by))
        names = ",".join(port.argument.name for port in wanted)
        digest = hashlib.sha256(f"{library.name} {kernel.symbol} {names}".encode()).digest()
        choose_loop = partial(self.kernels.choose_loop, kernel.name)
        return Call(entry, choose_loop, tuple(given), wanted, int.from_bytes(digest[:8], "big", signed=True))

    def _find_blocks(
        self, call: Call, of: Mapping[str, int], by: Mapping[str, int], sides: Sequence[Port]
    ) -> tuple[Block, ...]:
        """Find the blocks among the results of a call; rows count entries of the arguments `sides`."""
        blocks = []
        for number, port in enumerate(call.wanted):
            a = port.argument
            row, col = of[str(a.of)], by[str(a.by)]
            rows, cols = _list_places(port)
            nonzeros = _number_nonzeros(sides[row])[rows], _number_nonzeros(self.value.given[col])[cols]
            shape = sides[row].argument.nnz, self.value.given[col].argument.nnz
            blocks.append(Block(number, row, col, *nonzeros, shape))
        return tuple(blocks)


def _find_turn(port: Port) -> bool:
    return port.argument.role is Role.SEED


def _index(ports: Sequence[Port]) -> dict[str, int]:
    return {port.argument.name: number for number, port in enumerate(ports)}


def _list_places(port: Port) -> tuple[Places, Places]:
    """Return the rows and columns of the nonzeros."""
    a = port.argument
    if port.places is not None:
        return port.places
    return np.tile(np.arange(a.rows), a.cols), np.repeat(np.arange(a.cols), a.rows)


def _number_nonzeros(port: Port) -> Places:
    """Return, for each entry, column by column, the number of its nonzero."""
    rows, cols = _list_places(port)
    numbers = np.full(port.argument.rows * port.argument.cols, -1, dtype=np.intp)
    numbers[cols * port.argument.rows + rows] = np.arange(rows.size)
    return numbers
